"""The claims (a) to (e) about the four-bar with three-dimensional clearance and wear (paper 001),
on two turns of the crank.
"""

import numpy as np
import pytest

import jaxclear as jc
from jaxclear import plot
from jaxclear.scenes.four_bar import CLEARANCES, four_bar

DURATION, SAVES = 1.26, 631
INTEGRATOR = jc.integrator.FixedStep(2e-5)


@pytest.fixture(scope="module")
def ideal():
    return jc.simulate(four_bar("ideal"), DURATION, save=SAVES)


@pytest.fixture(scope="module")
def runs():
    return {
        c: jc.simulate(four_bar("spatial", c), DURATION, save=SAVES, integrator=INTEGRATOR)
        for c in CLEARANCES[1:]
    }


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


def test_journal_ends_stay_in_the_clearance_circle_and_dwell_in_two_regions(runs):
    clearance = CLEARANCES[-1]
    ends = plot.end_centres(runs[clearance], "B")
    radius = np.linalg.norm(ends, axis=-1)
    # The walls yield by micrometres and have worn by one.
    assert radius.max() < clearance + 15e-6
    for end, distance in zip(ends, radius, strict=True):
        touching = distance > 0.98 * clearance
        angles = np.degrees(np.arctan2(end[touching, 1], end[touching, 0])) % 360
        count, _ = np.histogram(angles, bins=12, range=(0, 360))
        dense = count > 2 * count.mean()
        regions = np.count_nonzero(dense & ~np.roll(dense, 1))
        assert 1 <= regions <= 3 and count[count > count.mean()].sum() > 0.7 * count.sum()
    assert sum(np.linalg.norm(end, axis=-1).mean() > 0.8 * clearance for end in ends) == 2


def test_wear_concentrates_near_the_edges_and_its_two_ends_differ(runs):
    depth = np.asarray(runs[CLEARANCES[-1]].worn["B"]["bearing"])
    by_row = depth.sum(axis=0)
    assert by_row[0] + by_row[-1] > 0.5 * by_row.sum()
    assert max(by_row[0], by_row[-1]) > 1.5 * min(by_row[0], by_row[-1])


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


def test_every_figure_draws(runs, ideal, tmp_path):
    run = runs[CLEARANCES[-1]]
    figures = [
        plot.displacement({"0.2 mm": run}, ideal, "follower"),
        plot.angular_velocity(run, ideal, "follower"),
        plot.journal_ends(run, "B"),
        plot.wear_unrolled(run, "B"),
        plot.wear_surface(run, "B"),
    ]
    for number, figure in enumerate(figures):
        figure.savefig(tmp_path / f"{number}.png")
        assert all(axis.get_xlabel() or axis.get_shared_x_axes() for axis in figure.axes)
