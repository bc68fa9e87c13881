"""Bores that are not round, against brute force: circle and bore point by point."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.components.clearance.journal_base import radius_deviation

RADIUS, CLEARANCE = 10e-3, 50e-6
OVAL = jc.clearance.Lobes(2, cosine=5e-6, sine=-3e-6)
TREFOIL = jc.clearance.Lobes(3, cosine=1e-6, sine=2e-6)
AROUND = np.linspace(0, 2 * np.pi, 40001)


def bearing(*lobes, kind=jc.clearance.PlanarJournalBearing, **more):
    return kind(
        jc.contact.Hertz(),
        bearing_radius=RADIUS,
        clearance=CLEARANCE,
        roundness=lobes or None,
        **more,
    )


def wall(angle):
    """Deviation of the radius, and its first derivative."""
    value = 5e-6 * np.cos(2 * angle) - 3e-6 * np.sin(2 * angle)
    value += 1e-6 * np.cos(3 * angle) + 2e-6 * np.sin(3 * angle)
    slope = -10e-6 * np.sin(2 * angle) - 6e-6 * np.cos(2 * angle)
    return value, slope - 3e-6 * np.sin(3 * angle) + 6e-6 * np.cos(3 * angle)


def brute_overlap(offset):
    """Largest overlap of the journal's circle and the bore, both as points about the centre."""
    journal = RADIUS - CLEARANCE
    x = offset[0] + journal * np.cos(AROUND)
    y = offset[1] + journal * np.sin(AROUND)
    return np.max(np.hypot(x, y) - RADIUS - wall(np.arctan2(y, x))[0])


def test_overlap_is_that_of_a_circle_and_the_bore():
    """To second order in gaps beside the radius: 60 um squared over 10 mm."""
    rng = np.random.default_rng(0)
    angles, sizes = rng.uniform(0, 2 * np.pi, 12), rng.uniform(1.0, 1.2, 12) * CLEARANCE
    for angle, size in zip(angles, sizes, strict=True):
        offset = size * np.array([np.cos(angle), np.sin(angle)])
        (found,) = bearing(OVAL, TREFOIL).indentations((*map(jnp.asarray, offset), 0), (), {})
        assert float(found) == pytest.approx(brute_overlap(offset), abs=4e-7)
        # on the angle of the offset itself it would be off by far more, at some of these angles
        assert float(found) >= size - CLEARANCE - wall(angle)[0] - 1e-12


def test_a_round_bore_asked_for_by_lobes_of_no_height_is_the_round_bore():
    offset = (jnp.asarray(3e-5), jnp.asarray(-4.2e-5), 0)
    flat, plain = bearing(jc.clearance.Lobes(4)), bearing()
    one, other = (own.indentations(offset, (), {})[0] for own in (flat, plain))
    assert float(one) == pytest.approx(float(other), abs=1e-18)


def test_a_pressed_journal_lies_as_far_as_the_bore_lets_it():
    """Of all places that do not overlap, the seat is the farthest along the load, and touches."""
    joint = bearing(OVAL, TREFOIL)
    overlap = jax.jit(jax.vmap(lambda x, y: joint.indentations((x, y, 0), (), {})[0]))
    for angle in np.linspace(0, 6, 7):
        load = np.array([np.cos(angle), np.sin(angle)])
        seat = np.array(joint.seat((-10 * load[0], -10 * load[1], 0), (0, 0, 0))[0][:2], float)
        others = seat + np.random.default_rng(0).normal(size=(4000, 2)) * 1e-5
        depths = np.asarray(overlap(*np.vstack([seat, others]).T))
        assert depths[0] == pytest.approx(0.0, abs=1e-12)
        inside = depths[1:] <= 0
        assert 100 < inside.sum() < 3900
        assert (others[inside] @ load).max() <= seat @ load + 1e-12


def test_both_ends_of_a_spatial_bearing_see_the_lobes():
    joint = bearing(OVAL, TREFOIL, kind=jc.clearance.JournalBearing, length=20e-3)
    planar = bearing(OVAL, TREFOIL)
    offset = (jnp.asarray(4e-5), jnp.asarray(3.5e-5), jnp.asarray(0.0))
    ends = joint.indentations(offset, ((0, 0, 1),), {})
    (alone,) = planar.indentations((*offset[:2], 0), (), {})
    np.testing.assert_allclose(np.array(ends), float(alone), rtol=1e-12)


def test_lobes_that_would_touch_twice_are_refused():
    with pytest.raises(ValueError, match="may touch two of them at once"):
        bearing(jc.clearance.Lobes(5, cosine=3e-6))
    with pytest.raises(ValueError, match=r"no tuple of jaxclear\.clearance\.Lobes"):
        bearing(3.0)


@pytest.mark.parametrize("number", [2, 3, 12, 37, 10**9])
def test_any_number_of_lobes_is_turned_at_once(number):
    lobes = (jc.clearance.Lobes(number, cosine=2e-6, sine=1e-6),)
    angle = 0.3
    value, slope, bend = radius_deviation(lobes, np.cos(angle), np.sin(angle))
    turned, within = number * angle, 1e-15 * number**2
    expected = 2e-6 * np.cos(turned) + 1e-6 * np.sin(turned)
    if number < 100:
        np.testing.assert_allclose(value, expected, atol=1e-6 * within)
        derivative = number * (1e-6 * np.cos(turned) - 2e-6 * np.sin(turned))
        np.testing.assert_allclose(slope, derivative, atol=1e-6 * within * number)
    assert abs(bend + number**2 * value) <= 1e-15 * number**2


def turning(law):
    """A journal of 1 kg in a bearing with lobes that turns slowly, a quarter in the second."""
    joint = jc.clearance.PlanarJournalBearing(
        law, bearing_radius=RADIUS, clearance=CLEARANCE, roundness=(OVAL, TREFOIL)
    )
    drive = jc.drive.ConstantSpeed(0.5 * np.pi)
    return jc.Mechanism(
        {"ring": jc.Body(1.0, 1e-3), "journal": jc.Body(1.0, 1e-4)},
        {
            "post": jc.Connection(jc.joint.Revolute(drive=drive), "ground", "ring"),
            "bearing": jc.Connection(joint, "ring", "journal"),
        },
        {"gravity": jc.load.Gravity((0.0, -9.81))},
    )


@pytest.mark.slow
@pytest.mark.parametrize("rung", ["permanent", "compliant"])
def test_a_slowly_pushed_journal_runs_along_its_lobed_bore(rung):
    """In the bearing's axes the weight goes round, and the journal follows the curve whose support
    function the gap is: e = (c + r) n + r' t. The compliant one sinks in by its weight over the
    stiffness, 10 nm, and swings from its start by its speed over its frequency, 0.18 um."""
    rig = turning(jc.contact.Linear(stiffness=1e9, restitution=0.5))
    kinds = {
        "permanent": (jc.integrator.NonColliding(1e-3), 1e-8),
        "compliant": (jc.integrator.FixedStep(1e-5, "semi_implicit"), 2.2e-7),
    }
    integrator, within = kinds[rung]
    state = jc.resting_state(rig) if rung == "compliant" else None
    run = jc.simulate(rig, 1.0, save=41, integrator=integrator, state=state)
    assert run.succeeded
    # That of permanent contact is a mean since the save before.
    since = 0.0125 if rung == "permanent" else 0.0
    angle = -0.5 * np.pi * (1 + np.asarray(run.time[1:]) - since)
    value, slope = wall(np.asarray(angle))
    x, y = np.cos(angle), np.sin(angle)
    curve = np.stack([(CLEARANCE + value) * x - slope * y, (CLEARANCE + value) * y + slope * x], 1)
    np.testing.assert_allclose(run.contact("bearing").offset[1:, :2], curve, atol=within)
