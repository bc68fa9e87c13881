"""Friction and wear of ideal joints in steps of percussions: in closed form, through an impact too,
and beside other rungs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.native.verdicts import KERNELS
from tests.formulations.test_joint_friction import (
    LAW,
    LENGTH,
    MU,
    RADIUS,
    RATE,
    STICKS,
    crank,
)
from tests.formulations.test_rubbing_over_step import STIFF, driven_crank, pendulum, with_play
from tests.rigs.slider_cranks import slider_crank

STEPS = jc.integrator.MoreauJean(1e-3)
CLEARANCE, FALL, RESTITUTION = 1e-4, 1.0, 0.5
BLOCK, JOURNAL = 2.0, 0.5


def struck(speed, friction=STICKS, clearance=CLEARANCE):
    """A block that slides, with a journal in its bore that is thrown at the wall across the sliding
    direction."""
    gap = jc.clearance.PlanarJournalBearing(
        jc.contact.Rigid(restitution=RESTITUTION), bearing_radius=10e-3, clearance=clearance
    )
    way = jc.joint.Slideway(friction, length=0.1, width=0.1, wear=jc.Wearing(LAW))
    return jc.Mechanism(
        {"block": jc.Body(BLOCK, 1e-2), "journal": jc.Body(JOURNAL, 1e-4)},
        {
            "S": jc.Connection(way, "ground", "block", axis="x"),
            "C": jc.Connection(gap, "block", "journal"),
        },
        speeds={"S": speed, "journal": (speed, -FALL, 0.0)},
    )


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.3, 0.01])
def test_an_impact_rubs_in_the_slideway_that_takes_its_impulse(speed):
    """P = m u (1 + e) across the slideway takes mu P from the block's momentum, and no more than
    it has."""
    steps = jc.integrator.MoreauJean(1e-5)
    run = jc.simulate(struck(speed), 2e-4, integrator=steps, save=3, balance=True)
    percussion = JOURNAL * FALL * (1 + RESTITUTION)
    after = max(speed - MU * percussion / BLOCK, 0.0)
    np.testing.assert_allclose(run.speed("S")[-1], after, atol=1e-12)
    for joint in "SC":
        np.testing.assert_allclose(run.contact_impulse(joint)[-1], percussion, rtol=1e-9)
    # over the step in which it strikes the block slides at the mean of its speeds
    volume = RATE * percussion * 0.5 * (speed + after)
    energies, lost = run.energy_balance(), 0.5 * BLOCK * (speed**2 - after**2)
    np.testing.assert_allclose(energies.friction_loss[-1], lost, rtol=1e-9)
    assert float(np.abs(energies.error).max()) < 1e-12
    np.testing.assert_allclose(run.worn_volume("S", "guide")[-1], volume, rtol=1e-9)


RIGS = {
    "closed loop": lambda law: crank(jc.joint.PlainBearing, friction=law, radius=RADIUS),
    "ball": pendulum,
    "driven": driven_crank,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RIGS)
def test_friction_in_a_mechanism_is_that_of_joints_that_always_touch_to_the_first_order(name):
    rig = RIGS[name](STICKS)
    true = jc.simulate(rig, 0.05, integrator=jc.integrator.NonColliding(1e-5), save=6, balance=True)
    names, errors = tuple(true.formulation.contact_joints(true.mechanism)), []
    wanted = float(true.energy_balance().friction_loss[-1])
    for step in (4e-4, 1e-4):
        integrator = jc.integrator.MoreauJean(step)
        run = jc.simulate(rig, 0.05, integrator=integrator, save=6, balance=True)
        assert run.stats.loops == KERNELS
        energies = run.energy_balance()
        errors.append(abs(float(energies.friction_loss[-1]) / wanted - 1))
        for joint in names:
            impulse = float(run.contact_impulse(joint)[-1])
            assert impulse == pytest.approx(float(true.contact_impulse(joint)[-1]), rel=10 * step)
        assert float(np.abs(energies.error).max()) < 100 * step * wanted
    assert wanted > 1e-3 and errors[1] < 0.5 * errors[0] < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", RIGS)
def test_derivatives_are_those_of_differences_or_steps_decide_them(name):
    """At a coefficient with which nothing changes its direction at the end of a step. Where a drive
    prescribes the motion, its derivative is rounding, which follows no step. A derivative is nan
    where differences in steps 1.5 and 2 times as long say that it is off by a hundredth, and only
    there; the margin of a tenth is for differences, which round. Backwards the coefficient of each
    joint moves by itself, and where steps decide one part the sum is nan."""

    def last(mu, step=2e-4):
        rig = RIGS[name](jc.friction.Coulomb(mu_kinetic=mu))
        integrator = jc.integrator.MoreauJean(step)
        run = jc.simulate(rig, 0.03, integrator=integrator, save=3, balance=True, throw=False)
        return run.states[-1]

    mu, change = 0.1037, 1e-6
    difference = lambda step: (last(mu + change, step) - last(mu - change, step)) / (2 * change)
    wanted, longer, longest = (np.asarray(difference(share * 2e-4)) for share in (1.0, 1.5, 2.0))
    forwards, backwards = (jax.jit(mode(last))(mu) for mode in (jax.jacfwd, jax.jacrev))
    scale = float(np.abs(wanted).max())
    assert scale > 0.01
    off = np.maximum(abs(longer - wanted) / 0.5, abs(longest - wanted))
    known = np.isfinite(forwards)
    assert known.mean() > 0.8
    assert (off[known] <= 0.011 * abs(wanted[known]) + 1e-9 * scale).all()
    assert (off[~known] >= 0.009 * abs(wanted[~known])).all()
    np.testing.assert_allclose(forwards[known], wanted[known], atol=1e-6 * scale)
    both = np.isfinite(backwards)
    assert both.mean() > 0.6 and known[both].all()
    np.testing.assert_allclose(backwards[both], forwards[both], atol=1e-12 * scale)
    for derivatives in (forwards, backwards):
        explanation = jc.explain_nan(derivatives)
        assert np.isfinite(derivatives).all() or explanation.startswith("In steps of another")


def rattling(contact, friction):
    """With a journal that has clearance at the slider; the pins of crank and rod wear as well."""
    numbers = {"friction": friction, "radius": RADIUS, "length": LENGTH, "wear": jc.Wearing(LAW)}
    return with_play(contact, **numbers)


@pytest.mark.slow
def test_a_joint_beside_one_that_strikes_rubs_as_in_implicit_steps():
    """As far as a rigid contact strikes as a stiff one does."""
    smooth = jc.friction.CoulombTanh(mu_kinetic=MU, transition_speed=1e-4)
    run, true = (
        jc.simulate(rattling(*laws), 0.05, integrator=integrator, save=6, balance=True)
        for laws, integrator in (
            ((jc.contact.Rigid(restitution=0.5), STICKS), jc.integrator.MoreauJean(2e-5)),
            ((STIFF, smooth), jc.integrator.ImplicitStep(5e-6)),
        )
    )
    assert run.stats.loops == KERNELS
    for joint in "AB":
        for found in ("worn_volume", "contact_impulse"):
            ask = (joint, "bearing") if found == "worn_volume" else (joint,)
            one, other = (float(getattr(each, found)(*ask)[-1]) for each in (run, true))
            assert one == pytest.approx(other, rel=0.03), found
    lost = [float(each.energy_balance().friction_loss[-1]) for each in (run, true)]
    assert lost[0] == pytest.approx(lost[1], rel=0.02) and lost[0] > 0.1
    assert float(np.abs(run.energy_balance().error).max()) < 0.01 * lost[0]


@pytest.mark.slow
def test_derivatives_of_an_impact_that_rubs_are_those_of_its_closed_form():
    """The block loses mu P / M when the journal strikes, at c / u; it slides on by s = v t - mu P /
    M (t - c / u)."""
    duration, speed = 2.05e-4, 0.3
    percussion = JOURNAL * FALL * (1 + RESTITUTION)

    def way(mu, clearance):
        rig = struck(speed, jc.friction.Coulomb(mu_kinetic=mu), clearance)
        steps = jc.integrator.MoreauJean(1e-7)
        run = jc.simulate(rig, duration, integrator=steps, save=3, throw=False)
        return run.coordinate("S")[-1]

    by_mu, by_clearance = jax.jit(jax.jacfwd(way, (0, 1)))(MU, CLEARANCE)
    left = duration - CLEARANCE / FALL
    # The step's own error: one of 1050.
    np.testing.assert_allclose(by_mu, -percussion / BLOCK * left, rtol=2e-3)
    np.testing.assert_allclose(by_clearance, MU * percussion / BLOCK / FALL, rtol=1e-6)


def test_joints_of_a_loop_that_stick_leave_sweeps_for_the_loads_that_they_carry():
    """As a crank is driven back all three stick in one step; more sweeps change nothing."""
    dry = jc.friction.Coulomb(mu_kinetic=0.2)
    loads = {
        "gravity": jc.load.Gravity(),
        "push": jc.load.JointTorque("O", lambda t: 20.0 * jnp.cos(12 * t)),
        "stop": jc.load.JointStop("G", lower=0.6, stiffness=1e5, restitution=0.4),
    }
    pin, slide = jc.joint.PlainBearing(dry, radius=0.02), jc.joint.Slideway(dry)
    rig = slider_crank(loads, 0.5, pin, slide)
    runs = [
        jc.simulate(
            rig, 0.14, save=2, integrator=jc.integrator.MoreauJean(1e-4, max_sweeps=n), verify=False
        )
        for n in (200, 20000)
    ]
    assert not any("missed the laws" in warning for run in runs for warning in run.warnings)
    ends = [np.asarray(run.coordinate("O")) for run in runs]
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-9)
