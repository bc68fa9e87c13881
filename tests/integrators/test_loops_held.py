"""How loops are held: closed anew after steps that open them, as the integrator needs it or as a
mechanism says; no drift, the same motion, and no use to error control.
"""

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
    "adaptive": jc.integrator.Adaptive(),
}
QUICK = "semi-implicit", "non-colliding", "adaptive"


def slow(*case):
    return pytest.param(*case, marks=pytest.mark.slow)


def each(names):
    return [name if name in QUICK else slow(name) for name in names]


def slider_crank(held="default"):
    whole = jc.scenes.slider_crank("ideal", crank_speed=SPEED)
    parts = whole.bodies, whole.connections, whole.loads
    return jc.Mechanism(*parts, guess=whole.guess, stabilisation=held)


def made(integrator, rig=None, duration=0.05):
    return jc.simulate(rig or slider_crank(), duration, save=6, integrator=integrator)


def open_by(run):
    return max(float(part.max()) for part in run.drift().values())


@pytest.mark.parametrize("name", each(OPENING))
def test_steps_that_open_loops_close_them(name):
    """And the slider is where the closed form has it; Baumgarte's terms leave 1e-7 to 5e-5 m."""
    closed = made(OPENING[name])
    pulled = made(OPENING[name], slider_crank(jc.Baumgarte()))
    turned = SPEED * np.asarray(closed.time)
    place = 0.05 * np.cos(turned) + np.sqrt(0.12**2 - (0.05 * np.sin(turned)) ** 2)
    # A Newton step leaves the square of what a step opens, 4e-5 of the rod.
    assert open_by(closed) < 1e-12 < 1e-8 < open_by(pulled)
    np.testing.assert_allclose(closed.body("slider").com[:, 0], place, atol=1e-12)


@pytest.mark.parametrize("name", each(EXACT))
def test_steps_that_open_no_loop_are_left_as_they_are(name):
    pulled = made(EXACT[name], slider_crank(jc.Baumgarte()))
    np.testing.assert_array_equal(made(EXACT[name]).states, pulled.states)


def test_what_is_given_counts_also_where_it_is_put_in_place_of_what_was_not():
    none = eqx.tree_at(lambda m: m.stabilisation, slider_crank(), None)
    for rig in (slider_crank(None), none):
        found = made(OPENING["implicit"], rig)
        assert found.mechanism.stabilisation is None and open_by(found) > 1e-8


def test_the_mechanism_of_a_run_goes_on_by_another_integrator():
    found = made(OPENING["implicit"])
    assert found.mechanism.projects
    again = jc.simulate(found.mechanism, 0.01, save=2)
    assert again.mechanism.baumgarte is not None and not again.mechanism.projects


def test_a_file_holds_what_was_given():
    def told(rig):
        return Part((jc.Mechanism,)).plain(rig, "", rig).get("stabilisation")

    assert told(slider_crank()) is None
    assert "Projection" in str(told(slider_crank(jc.Projection())))
    assert isinstance(slider_crank().with_loads({}).stabilisation, AsNeeded)


@pytest.mark.slow
def test_drift_is_judged_by_the_smallest_clearance():
    """A loop is open by less than a thousandth of its crank, and by more than a hundredth of the
    clearance in which a bob hangs from the slider."""
    whole, law = slider_crank(), jc.contact.Hertz(stiffness=1e9)
    gap = jc.clearance.PlanarJournalBearing(law, bearing_radius=0.01, clearance=1e-4)
    bodies = whole.bodies | {"bob": jc.Body(0.1, 1e-4, (0.0, -0.03))}
    joints = whole.connections | {"H": jc.Connection(gap, "slider", "bob")}

    def said(**held):
        rig = jc.Mechanism(bodies, joints, whole.loads, guess=whole.guess, **held)
        step = jc.integrator.ImplicitStep(1e-3)
        found = jc.simulate(rig, 0.02, save=11, integrator=step, throw=False)
        return found.invariants.figures, [each for each in found.warnings if "open" in each]

    figures, warned = said(stabilisation=jc.Baumgarte())
    assert figures[Check.LOOP_DRIFT].worst[0] < Check.LOOP_DRIFT.limit
    ratio = figures[Check.LOOP_DRIFT_IN_GAPS].worst[0] / figures[Check.LOOP_DRIFT].worst[0]
    assert ratio == pytest.approx(0.05 / 1e-4)
    assert len(warned) == 1 and "of the smallest clearance" in warned[0]
    assert said()[1] == []


@pytest.mark.parametrize(
    "name",
    ["implicit", *map(slow, ("semi-implicit", "rigid", "non-colliding"))],
)
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


def four_bar(stabilisation):
    whole = jc.scenes.four_bar("ideal")
    parts = whole.bodies, whole.connections, whole.loads
    return jc.Mechanism(*parts, guess={"A": 0.81, "D": 1.32}, stabilisation=stabilisation)


@pytest.mark.parametrize(
    ("name", "step", "close"),
    [
        slow("rk4", jc.integrator.FixedStep(1e-3), 1e-8),
        slow("implicit", OPENING["implicit"], 1e-3),
        slow("rigid", OPENING["rigid"], 1e-3),
        slow("non-colliding", OPENING["non-colliding"], 1e-3),
    ],
)
def test_loops_stay_closed_to_rounding_and_the_motion_is_the_same(name, step, close):
    """The motion is driven, so all that differs is where the loop is off and the error of a step in
    the angles; without anything loops drift."""
    found = jc.simulate(four_bar(jc.Projection()), 1.0, save=11, integrator=step)
    assert open_by(found) < 1e-13
    tight = jc.integrator.Adaptive(rtol=1e-10, atol=1e-12)
    exact = jc.simulate(four_bar(jc.Baumgarte(10.0, 10.0)), 1.0, save=11, integrator=tight)
    np.testing.assert_allclose(found.body("follower").com, exact.body("follower").com, atol=close)
    assert open_by(jc.simulate(four_bar(None), 1.0, save=11, integrator=step)) > 1e-11


@pytest.mark.slow
def test_derivatives_are_those_of_the_projected_run():
    """By the crank's speed, on which every angle hangs: forward, reverse, and central
    differences."""
    rig = four_bar(jc.Projection())
    start, speed, times = jc.assemble(rig), 10.0, np.linspace(0.0, 0.05, 3)

    def end(speed):
        faster = eqx.tree_at(lambda m: m.connections["O"].joint.drive.speed, rig, speed)
        scaled = start.speeds * speed / 10.0
        integrator = jc.integrator.FixedStep(steps_per_save=25)
        return run(faster, start.coordinates, scaled, times, integrator).states[-1]

    forward = jax.jit(jax.jacfwd(end))(speed)
    plain, width = jax.jit(end), 1e-3
    difference = (plain(speed + width) - plain(speed - width)) / (2 * width)
    assert float(abs(forward).min()) > 1e-3
    # curvature width^2, and rounding of 1e-15 / width
    np.testing.assert_allclose(forward, difference, rtol=1e-7)
    np.testing.assert_allclose(jax.jit(jax.jacrev(end))(speed), forward, rtol=1e-10)


def test_what_cannot_hold_loops_is_refused():
    with pytest.raises(ValueError, match="projection, which integrator.Adaptive"):
        jc.simulate(four_bar(jc.Projection()), 1.0)
    with pytest.raises(ValueError, match=r"jaxclear\.Projection, or None"):
        four_bar(3.0)
