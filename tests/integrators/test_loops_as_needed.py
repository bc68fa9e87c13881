"""Loops of a mechanism that does not say how they are held: closed as the integrator needs it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.files.parts import Part
from jaxclear.integrators.checks import Check
from jaxclear.multibody.loops import AsNeeded
from jaxclear.simulation.simulate import run

# The crank at 200 revolutions a minute.
SPEED = 200 * np.pi / 30
OPENING = {
    "semi-implicit": jc.integrator.FixedStep(1e-4, "semi_implicit"),
    "heun": jc.integrator.FixedStep(1e-3, "heun"),
    "implicit": jc.integrator.ImplicitStep(1e-3),
    "rigid": jc.integrator.MoreauJean(1e-3),
    "non-colliding": jc.integrator.NonColliding(1e-3),
}
EXACT = {
    "rk4": jc.integrator.FixedStep(1e-4),
    "group": jc.integrator.FixedStep(1e-4, "munthe_kaas4"),
    "adaptive": jc.integrator.Adaptive(),
}


def slider_crank(held="default"):
    whole = jc.scenes.slider_crank("ideal", crank_speed=SPEED)
    parts = whole.bodies, whole.connections, whole.loads
    return jc.Mechanism(*parts, guess=whole.guess, stabilisation=held)


def open_by(run):
    return max(float(part.max()) for part in run.drift().values())


@pytest.mark.parametrize("name", OPENING)
def test_steps_that_open_loops_close_them(name):
    """And the slider is where the closed form has it; Baumgarte's terms leave 1e-7 to 5e-5 m."""
    made = jc.simulate(slider_crank(), 0.05, save=6, integrator=OPENING[name])
    pulled = jc.simulate(slider_crank(jc.Baumgarte()), 0.05, save=6, integrator=OPENING[name])
    turned = SPEED * np.asarray(made.time)
    place = 0.05 * np.cos(turned) + np.sqrt(0.12**2 - (0.05 * np.sin(turned)) ** 2)
    # A Newton step leaves the square of what a step opens, 4e-5 of the rod.
    assert open_by(made) < 1e-12 < 1e-8 < open_by(pulled)
    np.testing.assert_allclose(made.body("slider").com[:, 0], place, atol=1e-12)


@pytest.mark.parametrize("name", EXACT)
def test_steps_that_open_no_loop_are_left_as_they_are(name):
    made = jc.simulate(slider_crank(), 0.05, save=6, integrator=EXACT[name])
    pulled = jc.simulate(slider_crank(jc.Baumgarte()), 0.05, save=6, integrator=EXACT[name])
    np.testing.assert_array_equal(made.states, pulled.states)


def test_what_is_given_counts():
    """Also where it is put in place of what was not."""
    none = eqx.tree_at(lambda m: m.stabilisation, slider_crank(), None)
    for rig in (slider_crank(None), none):
        found = jc.simulate(rig, 0.05, save=6, integrator=OPENING["implicit"])
        assert found.mechanism.stabilisation is None and open_by(found) > 1e-8


def test_the_mechanism_of_a_run_goes_on_by_another_integrator():
    made = jc.simulate(slider_crank(), 0.01, save=2, integrator=OPENING["implicit"])
    assert made.mechanism.projects
    again = jc.simulate(made.mechanism, 0.01, save=2)
    assert again.mechanism.baumgarte is not None and not again.mechanism.projects


def test_a_file_holds_what_was_given():
    def told(rig):
        return Part((jc.Mechanism,)).plain(rig, "", rig).get("stabilisation")

    assert told(slider_crank()) is None
    assert "Projection" in str(told(slider_crank(jc.Projection())))
    assert isinstance(slider_crank().with_loads({}).stabilisation, AsNeeded)


def test_drift_is_judged_by_the_smallest_clearance():
    """A loop is open by less than a thousandth of its crank, and by more than a hundredth of the
    clearance in which a bob hangs from the slider."""
    whole = slider_crank()
    gap = jc.clearance.PlanarJournalBearing(
        jc.contact.Hertz(stiffness=1e9), None, bearing_radius=0.01, clearance=1e-4
    )
    bodies = whole.bodies | {"bob": jc.Body(0.1, 1e-4, (0.0, -0.03))}
    joints = whole.connections | {"H": jc.Connection(gap, "slider", "bob")}

    def said(**held):
        rig = jc.Mechanism(bodies, joints, whole.loads, guess=whole.guess, **held)
        found = jc.simulate(
            rig, 0.02, save=11, integrator=jc.integrator.ImplicitStep(1e-3), throw=False
        )
        return found.invariants.figures, [each for each in found.warnings if "open" in each]

    figures, warned = said(stabilisation=jc.Baumgarte())
    assert figures[Check.LOOP_DRIFT].worst[0] < Check.LOOP_DRIFT.limit
    ratio = figures[Check.LOOP_DRIFT_IN_GAPS].worst[0] / figures[Check.LOOP_DRIFT].worst[0]
    assert ratio == pytest.approx(0.05 / 1e-4)
    assert len(warned) == 1 and "of the smallest clearance" in warned[0]
    assert said()[1] == []


@pytest.mark.parametrize("name", ["semi-implicit", "implicit", "rigid", "non-colliding"])
def test_derivatives_are_those_of_the_closed_run(name):
    """Of a slider-crank that falls, by gravity: beside central differences."""
    whole = slider_crank()
    joints = whole.connections | {"O": jc.Connection(jc.joint.Revolute(), "ground", "crank")}
    rig = jc.Mechanism(whole.bodies, joints, whole.loads, start={"O": 0.8}, guess={"G": 0.15})
    start, times = jc.assemble(rig), jnp.array([0.0, 0.02])

    def end(gravity):
        there = eqx.tree_at(lambda m: m.loads["gravity"].acceleration, rig, (0.0, -gravity, 0.0))
        found = run(there, start.coordinates, start.speeds, times, OPENING[name])
        return found.states[-1, :6]

    slope, plain, width = jax.jit(jax.jacfwd(end))(9.81), jax.jit(end), 1e-3
    difference = (plain(9.81 + width) - plain(9.81 - width)) / (2 * width)
    assert float(abs(slope).min()) > 1e-5
    # Curvature times the square of the width, and rounding of 1e-16 / width.
    np.testing.assert_allclose(slope, difference, rtol=1e-6, atol=1e-11)
