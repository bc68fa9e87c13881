"""The claims (a) to (e) about the four-bar with three-dimensional clearance and wear (paper 001),
on two turns of the crank."""

import numpy as np
import pytest
from scipy.special import i0e

import jaxclear as jc
from jaxclear import plot
from jaxclear.commands.four_bar import CELLS
from jaxclear.integrators.checks import Check
from jaxclear.scenes.four_bar import BEARING_LENGTH, CLEARANCES, four_bar
from tests.rigs.figures import assert_complete

DURATION, SAVES = 1.26, 631
INTEGRATOR = jc.integrator.FixedStep(2e-5)


@pytest.fixture(scope="module")
def ideal():
    return jc.simulate(four_bar("ideal"), DURATION, save=SAVES)


@pytest.fixture(scope="module")
def runs():
    how = {"save": SAVES, "integrator": INTEGRATOR}
    rigs = {c: four_bar("spatial", c, cells=CELLS) for c in CLEARANCES[1:]}
    return {c: jc.simulate(rig, DURATION, **how) for c, rig in rigs.items()}


def in_plane(run):
    return np.asarray(run.body("follower").com)[:, :2]


def test_follower_strays_further_from_the_ideal_path_as_clearance_grows(runs, ideal):
    errors = [
        np.sqrt(((in_plane(run) - in_plane(ideal)) ** 2).sum(axis=1).mean())
        for run in runs.values()
    ]
    assert np.all(np.diff(errors) > 0)
    # A journal resting on the wall moves the follower's middle by about half the clearance, a
    # geometric fact.
    np.testing.assert_allclose(errors, np.array(list(runs)), rtol=0.35)


def test_angular_velocity_fluctuates_about_the_ideal_one(runs, ideal):
    spin = np.asarray(runs[CLEARANCES[-1]].body("follower").spin)[:, 2]
    reference = np.asarray(ideal.body("follower").spin)[:, 2]
    deviation = spin - reference
    assert np.count_nonzero(np.diff(np.sign(deviation))) > 20
    assert abs(deviation.mean()) < 0.2 * deviation.std() < 0.2 * reference.std()
    narrow = np.asarray(runs[CLEARANCES[1]].body("follower").spin)[:, 2] - reference
    assert deviation.std() > 1.5 * narrow.std()


def dense_regions(angles, width, least):
    """Arcs in which directions [rad] lie at least `least` times as dense as if they were spread
    evenly (a von Mises kernel of `width` [deg]): how many, and what share of the directions they
    hold."""
    kappa = np.radians(width) ** -2
    at = np.radians(np.arange(360))
    kernel = np.exp(kappa * (np.cos(at[:, None] - angles) - 1.0)) / i0e(kappa)
    dense = kernel.mean(axis=1) >= least
    held = dense[np.round(np.degrees(angles)).astype(int) % 360].mean()
    return np.count_nonzero(dense & ~np.roll(dense, 1)), held


def test_journal_ends_stay_in_the_clearance_circle(runs):
    for clearance, run in runs.items():
        radius = np.linalg.norm(plot.end_centres(run, "B"), axis=-1)
        # The walls yield by micrometres and have worn by one.
        assert radius.max() < clearance + 15e-6
        assert np.all(radius.mean(axis=1) > 0.95 * clearance)


@pytest.mark.parametrize(("width", "least"), [(8.0, 1.5), (10.0, 1.35), (12.0, 1.25)])
def test_journal_ends_dwell_in_two_dense_regions(runs, width, least):
    """Figure 6 of the paper shows two, at one end, with 0.2 mm. Here each end has two from 0.1 mm
    on; with 0.05 mm the lower end goes all the way round its circle and dwells in one.

    With these thresholds by width no number of regions hangs on the step: at the lower end the
    second is 1.77 to 1.92, 1.58 to 1.69 and 1.46 to 1.54 times as dense with 0.1 mm, up to 1.26,
    1.14 and 1.05 times with 0.05 mm, in seven steps of 10 to 20 us."""
    found = {}
    for clearance, run in runs.items():
        for end in plot.end_centres(run, "B"):
            touching = end[np.linalg.norm(end, axis=-1) > 0.98 * clearance]
            regions, held = dense_regions(np.arctan2(*touching.T[::-1]), width, least)
            found.setdefault(clearance, []).append(regions)
            if clearance == CLEARANCES[-1]:
                assert held > 0.75
    assert found == {c: [1 if c == CLEARANCES[1] else 2, 2] for c in runs}


def test_wear_concentrates_near_the_edges_and_its_two_ends_differ(runs):
    depth = np.asarray(runs[CLEARANCES[-1]].worn["B"]["bearing"])
    millimetre = round(depth.shape[1] * 1e-3 / BEARING_LENGTH)
    ends = depth[:, :millimetre].sum(), depth[:, -millimetre:].sum()
    assert sum(ends) > 0.5 * depth.sum()
    assert max(ends) > 1.5 * min(ends)


def test_worn_depths_do_not_hang_on_cells_unasked_in_the_plane_in_space_on_these(runs):
    planar = jc.simulate(four_bar("planar"), DURATION / 2, save=SAVES, integrator=INTEGRATOR)
    assert not np.any(planar.invariants.beyond()[Check.WEAR_BY_CELLS])
    # Motions that rattle scatter, and with them how narrow a scar is: 0.07 to 0.13.
    limit = 1.5 * Check.WEAR_BY_CELLS.limit
    for run in runs.values():
        assert np.max(run.invariants.figures[Check.WEAR_BY_CELLS].worst) < limit
    for run in (planar, *runs.values()):
        assert float(run.worn_depth("B", "bearing").max()) > 0


@pytest.mark.slow
def test_without_the_follower_beside_the_coupler_both_ends_wear_alike():
    run = jc.simulate(
        four_bar("spatial", follower_offset=0.0), 0.2, save=101, integrator=INTEGRATOR
    )
    depth = np.asarray(run.worn["B"]["bearing"])
    np.testing.assert_allclose(depth[:, 0], depth[:, -1], rtol=1e-6, atol=1e-15)


def test_worn_volume_is_in_the_map(runs):
    run = runs[CLEARANCES[-1]]
    wear_map = run.mechanism.connections["B"].joint.maps()["bearing"][0]
    volume = float((np.asarray(wear_map.areas()) * np.asarray(run.worn["B"]["bearing"])).sum())
    np.testing.assert_allclose(volume, float(run.worn_volume("B", "bearing")[-1]), rtol=1e-12)


@pytest.mark.slow
def test_fixed_and_adaptive_steps_agree_on_what_wears(runs):
    adaptive = jc.simulate(four_bar("spatial"), DURATION, save=SAVES)
    fixed = runs[CLEARANCES[-1]]
    volumes = [float(run.worn_volume("B", "bearing")[-1]) for run in (adaptive, fixed)]
    # Rattling phases are chaotic; the volume is a sum over the whole run and feels little of it.
    np.testing.assert_allclose(*volumes, rtol=0.05)


@pytest.mark.slow
def test_planar_and_spatial_bearings_agree_while_the_journal_stays_parallel():
    planar = jc.simulate(four_bar("planar", wear=False), 0.05, save=51)
    spatial = jc.simulate(four_bar("spatial", wear=False, follower_offset=0.0), 0.05, save=51)
    force = [np.asarray(run.contact("B").normal_force).sum(axis=1) for run in (planar, spatial)]
    # Two ends of stiffness K are together twice as stiff as the planar joint's one: bounces part by
    # a share of the clearance.
    np.testing.assert_allclose(in_plane(planar), in_plane(spatial), atol=20e-6)
    # Once the bounces have died out, both carry the same load.
    np.testing.assert_allclose(force[0][-8:], force[1][-8:], rtol=1e-3)


@pytest.mark.slow
def test_every_figure_is_drawn_and_named(runs, ideal):
    run = runs[CLEARANCES[-1]]
    figures = [
        plot.displacement({"0.2 mm": run}, ideal, "follower"),
        plot.angular_velocity(run, ideal, "follower"),
        plot.journal_ends(run, "B"),
        plot.wear_unrolled(run, "B"),
        plot.wear_surface(run, "B"),
    ]
    for figure in figures:
        assert_complete(figure)
