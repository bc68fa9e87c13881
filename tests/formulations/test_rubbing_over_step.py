"""Friction and wear of ideal joints on implicit steps: beside explicit ones of a small step, and in
closed form."""

import jax
import numpy as np
import pytest

import jaxclear as jc
from tests.formulations.test_joint_friction import (
    BRAKING,
    LAW,
    LENGTH,
    LOAD,
    MU,
    RADIUS,
    RATE,
    SPEED,
    crank,
    rotor,
    slider,
)

SMOOTH = jc.friction.CoulombTanh(mu_kinetic=MU, transition_speed=1e-2)
STEEP = jc.friction.CoulombTanh(mu_kinetic=MU, transition_speed=1e-5)
STIFF = jc.contact.CarvalhoMartins(stiffness=1e9, restitution=0.5)
SMALL = jc.integrator.FixedStep(1e-6)


@pytest.mark.slow
def test_a_bearing_is_braked_and_held_in_steps_far_longer_than_friction_takes():
    """At 1000 transition speeds friction is Coulomb's; it brakes within a thousandth of a step."""
    mechanism = rotor(STEEP, length=LENGTH, wear=jc.Wearing(LAW))
    run = jc.simulate(
        mechanism, 0.1, integrator=jc.integrator.ImplicitStep(1e-3), save=11, balance=True
    )
    left = np.maximum(SPEED - BRAKING * np.asarray(run.time), 0.0)
    np.testing.assert_allclose(run.speed("B"), left, atol=0.01 * SPEED)
    slid = 0.5 * SPEED * 0.05 * RADIUS
    volume = RATE * LOAD / np.sqrt(1 + MU**2) * slid
    np.testing.assert_allclose(run.worn_volume("B", "bearing")[-1], volume, rtol=0.01)
    np.testing.assert_allclose(run.contact_impulse("B")[-1], 0.1 * LOAD, rtol=0.01)


def driven_crank(friction=SMOOTH):
    """Turned by a drive; the slider rubs as well."""
    slide = jc.joint.Slideway(friction, length=0.05, width=0.03)
    more = {"friction": friction, "radius": RADIUS, "slide": slide, "guess": {"D": 0.4}}
    return crank(jc.joint.PlainBearing, drive=jc.drive.ConstantSpeed(50.0), **more)


@pytest.mark.slow
def test_a_drive_gives_what_all_joints_of_its_mechanism_take():
    """In a closed loop, where the drive's torque is found with the reactions."""
    run, true = (
        jc.simulate(driven_crank(), 0.13, integrator=integrator, save=14, balance=True)
        for integrator in (jc.integrator.ImplicitStep(1e-4), jc.integrator.FixedStep(2e-6))
    )
    given, wanted = run.energy_balance(), true.energy_balance()
    assert float(wanted.input[-1]) > 1.0
    np.testing.assert_allclose(given.input[-1], wanted.input[-1], rtol=1e-3)
    assert float(np.abs(given.error).max()) < 3e-4 * float(given.input[-1])


def with_play(law=STIFF, **numbers):
    """The crank with a journal that has clearance at the slider."""
    gap = jc.clearance.PlanarJournalBearing(law, bearing_radius=10e-3, clearance=0.1e-3)
    guess = {"B": -1.284, "D": 0.342}
    return crank(jc.joint.PlainBearing, gap, guess, **numbers)


NUMBERS = {"friction": SMOOTH, "radius": RADIUS, "length": LENGTH, "wear": jc.Wearing(LAW)}
RIGS = {
    "closed loop": lambda: crank(jc.joint.PlainBearing, **NUMBERS),
    "beside a gap": lambda: with_play(**NUMBERS),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RIGS)
def test_friction_and_wear_in_a_mechanism_are_those_of_explicit_steps(name):
    run, true = (
        jc.simulate(RIGS[name](), 0.05, integrator=integrator, save=6, balance=True)
        for integrator in (jc.integrator.ImplicitStep(5e-6), SMALL)
    )
    np.testing.assert_allclose(run.speed("A"), true.speed("A"), rtol=1e-4)
    for joint in "AB":
        for found in ("worn_volume", "contact_impulse"):
            ask = (joint, "bearing") if found == "worn_volume" else (joint,)
            one, other = (float(getattr(each, found)(*ask)[-1]) for each in (run, true))
            assert one == pytest.approx(other, rel=1e-4), found
    lost = [float(each.energy_balance().friction_loss[-1]) for each in (run, true)]
    assert lost[0] == pytest.approx(lost[1], rel=2e-4) and lost[0] > 0.1
    error = run.energy_balance().error
    assert float(np.abs(error).max()) < 1e-4


def pendulum(friction=SMOOTH):
    """A body that turns in all directions about a ball joint that rubs."""
    return jc.Mechanism(
        {"bob": jc.Body(1.0, (2e-3, 3e-3, 4e-3), com=(0.1, 0.0, 0.0))},
        {"S": jc.Connection(jc.joint.BallJoint(friction, radius=RADIUS), "ground", "bob")},
        {"g": jc.load.Gravity((0.0, 0.0, -9.81))},
        speeds={"S": (20.0, 3.0, 5.0)},
    )


@pytest.mark.slow
@pytest.mark.parametrize("rig", [pendulum, lambda: slider(SMOOTH, 0.5)], ids=["ball", "slideway"])
def test_balls_and_slideways_rub_as_on_explicit_steps(rig):
    run, true = (
        jc.simulate(rig(), 0.05, integrator=integrator, save=6, balance=True)
        for integrator in (jc.integrator.ImplicitStep(1e-5), SMALL)
    )
    last = np.asarray(true.states)[-1]
    np.testing.assert_allclose(np.asarray(run.states)[-1], last, atol=1e-4 * np.abs(last).max())
    lost = [float(each.energy_balance().friction_loss[-1]) for each in (run, true)]
    assert lost[0] == pytest.approx(lost[1], rel=1e-3) and lost[0] > 0


def last_state(integrator):
    def last(mu):
        law = jc.friction.CoulombTanh(mu_kinetic=mu, transition_speed=1e-3)
        run = jc.simulate(pendulum(law), 0.01, integrator=integrator, save=3, throw=False)
        return run.states[-1]

    return last


@pytest.mark.slow
@pytest.mark.parametrize(
    "integrator",
    [
        jc.integrator.ImplicitStep(1e-3, steps_per_save=5),
        jc.integrator.FixedStep(1e-3, steps_per_save=5),
    ],
    ids=["implicit", "explicit"],
)
def test_reverse_mode_says_where_it_does_not_pass_friction(integrator):
    with pytest.raises(ValueError, match="friction in ideal joints"):
        jax.jacrev(last_state(integrator))(MU)


@pytest.mark.slow
def test_reverse_mode_passes_friction_where_the_run_is_one_kernel():
    """Implicit steps take friction towards their end, so their derivatives are of first order: in
    steps of 0.1 ms within 1 % of those of explicit ones, which differences confirm; in steps of 1
    ms all are off by more than 1 %, which is nan forwards as backwards, three by 2.5 to 3.8 %."""
    found = {}
    for integrator in (jc.integrator.FixedStep(1e-3), jc.integrator.ImplicitStep(1e-4)):
        last = last_state(integrator)
        backwards, forwards = (jax.jit(way(last))(MU) for way in (jax.jacrev, jax.jacfwd))
        assert float(np.abs(forwards).max()) > 1e-3
        np.testing.assert_allclose(backwards, forwards, rtol=1e-9, atol=1e-12)
        found[type(integrator)] = forwards
    true, implicit = found.values()
    np.testing.assert_allclose(implicit, true, rtol=1e-2)
    explicit = last_state(jc.integrator.FixedStep(1e-3))
    change = 1e-4
    differences = (explicit(MU + change) - explicit(MU - change)) / (2 * change)
    np.testing.assert_allclose(true, differences, rtol=1e-5)
    last = last_state(jc.integrator.ImplicitStep(1e-3))
    for mode in (jax.jacrev, jax.jacfwd):
        coarse = np.asarray(jax.jit(mode(last))(MU))
        off = abs((last(MU + change) - last(MU - change)) / (2 * change) / true - 1)
        # Other steps tell errors of first order, a tenth of them too small.
        assert (off > 0.02).sum() == 3
        assert np.isnan(coarse)[off > 0.02].all() and (off[np.isnan(coarse)] > 0.01).all()
