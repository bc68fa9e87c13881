"""Steps in which impacts rise little, and what swings many times, get a second look too."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators import Check
from jaxclear.simulation.doubts import swings_on
from tests.rigs.attacked import run_of


@pytest.mark.slow
def test_first_order_steps_whose_impacts_rise_little_are_looked_at_again():
    """Symplectic Euler in 1.6 us: the mean force is 11 % off, and indentations rise by 0.085."""
    steps = jc.integrator.FixedStep(1.63226e-06, method="semi_implicit")
    tight = jc.integrator.Adaptive(rtol=1e-9)
    found, exact = (run_of(18, 18, each, balance=True) for each in (steps, tight))
    forces = [float(jc.response.MeanContactForce("B")(run)) for run in (found, exact)]
    assert abs(forces[0] / forces[1] - 1) > 0.05
    told = {check for check, beyond in found.checks.beyond().items() if beyond}
    assert {Check.MEAN_FORCE, Check.HALVED_WEAR, Check.FRICTION_LOSS} <= told


@pytest.mark.parametrize(
    ("draw", "rtol"), [(20, None), (20, 3.5e-5), (46, 2.14865e-5)], ids=["default", "loose", "few"]
)
def test_where_a_stiff_spring_throws_a_body_is_said(draw, rtol):
    """Some forty times, or a few: neighbouring ways part."""
    usual = jc.integrator.Adaptive()
    steps = usual if rtol is None else jc.integrator.Adaptive(rtol=rtol, atol=1e-2 * rtol)
    found, exact = run_of(30, draw, steps), run_of(30, draw, jc.integrator.Adaptive(rtol=1e-11))
    places = [np.asarray(run.body("bob").com) for run in (found, exact)]
    way = np.abs(places[1] - places[1][0]).max()
    assert np.abs(places[0] - places[1]).max() > 0.02 * way
    assert Check.HALVED_MOTION in found.checks.figures and found.warnings != ()
    assert exact.warnings == ()


class Magnet(jc.load.AbstractCoordinateLoad):
    """A user's own load that pulls back to the middle of a slide."""

    connection: str
    pull: jc.Scalar = jc.quantity(1.0, "N m", "pull")

    def force(self, time, position, speed):
        return -self.pull * jnp.sin(position), -self.pull * jnp.cos(position), 0, 0


@pytest.mark.parametrize(
    ("load", "swings"),
    [
        (Magnet("G"), True),
        (jc.load.JointSpring("G", stiffness=10.0), True),
        (jc.load.JointSpring("G", damping=10.0), False),
        (jc.load.JointTorque("G", 1.0), False),
        (jc.load.Gravity(), False),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_springs_back_swings_on_whoever_wrote_it(load, swings):
    rig, integrator = jc.scenes.slider_crank("ideal"), jc.integrator.FixedStep(1e-4)
    run = jc.simulate(rig.with_loads({"own": load}), 1e-3, save=3, integrator=integrator)
    assert swings_on(run, integrator) == swings


def test_where_a_shaken_pendulum_is_is_said():
    """On a slide that goes to and fro fifteen times: a loose run is 12 % of its way off."""
    steps = jc.integrator.Adaptive(rtol=1.9574e-6, atol=1.9574e-8)
    found, exact = run_of(37, 24, steps), run_of(37, 24, jc.integrator.Adaptive(rtol=1e-11))
    places = [np.asarray(run.body("arm").com) for run in (found, exact)]
    assert np.abs(places[0] - places[1]).max() > 0.1 * np.abs(places[1] - places[1][0]).max()
    assert {check for check, beyond in found.checks.beyond().items() if beyond} & {
        Check.HALVED_MOTION,
        Check.BODY_PLACES,
    }


@pytest.mark.slow
def test_implicit_steps_whose_indentations_rise_by_a_fiftieth_are_looked_at_again():
    """A four-bar's journal is 5 % of its clearance off."""
    found = run_of(19, 27, jc.integrator.ImplicitStep(6e-6, rebound=1.0))
    assert found.checks.figures[Check.CONTACT_STEP].worst.max() < 0.035
    assert "elsewhere in their gap" in found.result


@pytest.mark.parametrize(
    "steps",
    [jc.integrator.ImplicitStep(1.34429e-5), jc.integrator.MoreauJean(2.5513e-5)],
    ids=["implicit", "rigid"],
)
def test_where_a_bob_on_a_stiff_spring_is_by_steps_of_a_given_length_is_said(steps):
    """By a tenth and a third of its way off, of which windows tell less than a ten-thousandth; by
    rk4 it is right."""
    found, right = run_of(30, 34, steps, balance=True), run_of(30, 34, jc.integrator.FixedStep())
    places = [np.asarray(run.body("bob").com) for run in (found, right)]
    assert np.abs(places[0] - places[1]).max() > 0.09 * np.abs(places[1] - places[1][0]).max()
    assert "bodies would be elsewhere" in found.result and right.warnings == ()
    assert Check.HALVED_MOTION in right.checks.figures
