"""Derivatives of implicit steps, and of explicit ones of low order, are those of the motion beside
them, in parts that resolve contacts: beside closed forms, and beside differences of tight runs.
Where the run has parted from that motion there are none.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from benchmarks import attack_slopes
from benchmarks.attacks.structures import structures
from tests.integrators.test_derivatives_through_touches import (
    CASES,
    CLEARANCE,
    DOWN,
    ELASTIC,
    ENDS,
    KINDS,
    LAWS,
    answer,
    assert_right,
    bouncing,
    problem,
    start_speed,
)
from tests.rigs.cells import slow

# Without numerical damping of contacts, which takes a run off its motion.
LOSSLESS = jc.integrator.ImplicitStep(2e-5, rebound=1.0)
SPEED, OMEGA = -0.05, 3e3
PEAK = jc.response.PeakContactForce("B")


def with_step(asked, step):
    return eqx.tree_at(lambda own: own.integrator.step, asked, step)


def lossless_bounce(end, rung=LOSSLESS):
    """A problem without gravity, of which everything is known: y = -2 c - v0 (T - pi / omega), the
    largest force -omega v0."""
    rig = bouncing(jc.contact.Linear(stiffness=OMEGA**2))
    rig = jc.Mechanism(rig.bodies, rig.connections, speeds=rig.speeds)
    asked = problem(rig, "journal", 1, (start_speed, CLEARANCE, ELASTIC), rung)
    state = jc.State(concentric=False)
    return eqx.tree_at(lambda own: (own.state, own.duration), asked, (state, end))


def test_a_lossless_bounce_has_the_derivatives_of_its_closed_form():
    """In steps that turn the contact by 0.06 rad, by 0.3 and by 1; and none where a bounce takes a
    twentieth of the speed."""
    end = 0.03
    asked = lossless_bounce(end)

    @jax.jit
    def slopes(step, rebound):
        numbers = lambda own: (own.integrator.step, own.integrator.rebound)
        run = eqx.tree_at(numbers, asked, (step, rebound))
        return 1e-3 * jax.jacfwd(lambda v: answer(run, v, end))(asked.nominal())

    wanted = -(end - np.pi / OMEGA), -2.0, 0.5 * SPEED * np.pi / -(OMEGA**3)
    for step in (2e-5, 1e-4, 3e-4):
        np.testing.assert_allclose(slopes(step, 1.0), wanted, rtol=2e-3)
    # By itself, or in the steps twice as long that it is compared with.
    for step in (1e-3, 4e-4):
        assert "3 % of the narrowest gap" in jc.explain_nan(slopes(step, 0.95))


@pytest.mark.parametrize("method", [*slow("heun"), "semi_implicit"])
def test_explicit_steps_of_low_order_have_the_derivatives_of_its_closed_form(method):
    """Their own, through the bounce, are 8 % off and more; and none where runs are off it."""
    end = 0.03
    asked = lossless_bounce(end, jc.integrator.FixedStep(2e-5, method))
    run = lambda step: eqx.tree_at(lambda own: own.integrator.step, asked, step)
    numbers = asked.nominal()
    slopes = jax.jit(lambda h: 1e-3 * jax.jacfwd(lambda v: answer(run(h), v, end))(numbers))
    wanted = -(end - np.pi / OMEGA), -2.0, 0.5 * SPEED * np.pi / -(OMEGA**3)
    np.testing.assert_allclose(slopes(2e-5), wanted, rtol=2e-3)
    assert np.all(np.isnan(slopes(4e-4)))


@pytest.mark.slow
@pytest.mark.parametrize("method", ["heun", "semi_implicit"])
@pytest.mark.parametrize("name", ["slider in its guide", "LuGre"])
def test_explicit_steps_of_low_order_have_those_of_joints_and_friction(name, method):
    rig, *case = CASES[name]
    assert_right(rig(), *case, 6e-3, jc.integrator.FixedStep(5e-6, method))


@pytest.mark.slow
def test_the_largest_force_of_a_lossless_bounce_has_the_derivatives_of_its_closed_form():
    asked = eqx.tree_at(lambda own: own.response, lossless_bounce(0.025), {"response": PEAK})
    evaluate = lambda v: asked.evaluate(v).responses["response"]
    by_speed, by_clearance, by_stiffness = jax.jit(jax.jacfwd(evaluate))(asked.nominal())
    np.testing.assert_allclose(by_speed, -OMEGA, rtol=1e-3)
    np.testing.assert_allclose(by_stiffness, 0.5 * -SPEED / OMEGA, rtol=1e-3)
    assert abs(by_clearance * 1e-3) < 1e-4 * -OMEGA * SPEED


@pytest.mark.slow
def test_of_parts_too_long_for_a_spring_beside_contacts_it_is_no_number():
    """A mass at rest on its spring, beside a journal that bounces in between: 1 - cos(omega t). At
    1 rad in a step of 0.1 ms it was 1.0 for 0.004, beyond 2.83 rad it grew to 1e7 and 1e88."""
    step, end, load = 1e-4, 0.03, 10.0
    joint = {"G": jc.Connection(jc.joint.Prismatic(), "ground", "mass", axis="x")}

    @jax.jit
    def slope(angle):
        stiffness = (angle / step) ** 2

        def place(force):
            rig = bouncing(jc.contact.Linear(stiffness=OMEGA**2))
            loads = {
                "spring": jc.load.JointSpring("G", stiffness=stiffness),
                "force": jc.load.Force(jc.Marker("mass"), (force, 0.0)),
            }
            rig = jc.Mechanism(
                {"mass": jc.Body(1.0, 1e-3), **rig.bodies},
                {**joint, **rig.connections},
                loads,
                start={"G": load / stiffness},
                speeds=rig.speeds,
            )
            how = {"integrator": jc.integrator.ImplicitStep(step, rebound=1.0), "throw": False}
            run = jc.simulate(rig, end, save=3, state=jc.State(concentric=False), **how)
            return run.coordinate("G")[-1]

        return stiffness * jax.jvp(place, (load,), (1.0,))[1]

    np.testing.assert_allclose(slope(0.1), 1 - np.cos(0.1 * end / step), rtol=1e-3)
    assert np.all(np.isnan([slope(angle) for angle in (1.0, 2.9, 4.0)]))


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [1e9, 1e18])
def test_a_journal_at_rest_lies_lower_by_what_its_clearance_is_larger(stiffness):
    """Where its vibration is resolved by 64 parts of a step; in a stiffer bearing nothing is
    known."""
    contact = jc.contact.HuntCrossley(stiffness=stiffness, restitution=0.8)
    rig = bouncing(contact)
    rig = jc.Mechanism(rig.bodies, rig.connections, DOWN)
    asked = problem(rig, "journal", 1, (CLEARANCE,), jc.integrator.ImplicitStep(1e-4))
    asked = eqx.tree_at(lambda own: own.state, asked, jc.resting_state(rig))
    slope = jax.jit(jax.jacfwd(lambda v: 1e-3 * answer(asked, v, 0.01)))(asked.nominal())[0]
    if stiffness > 1e12:
        assert np.isnan(slope)
    else:
        np.testing.assert_allclose(slope, -1.0, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "step"), [*((law, 2e-5) for law in KINDS), ("Flores", 1e-4), ("AdamsImpact", 1e-4)]
)
def test_bounces_have_the_derivatives_of_the_motion(law, step):
    """Through one to six bounces; where a damper is cut off before contact ends, to 2 %. Runs in
    steps twice as long as 0.1 ms are off the motion from the second bounce by Flores on."""
    contact, *numbers = LAWS[law]
    within = 2e-2 if law in ("KelvinVoigt", "AdamsImpact") else 3e-3
    variables = CLEARANCE, start_speed, *numbers
    ends = ENDS if step < 1e-4 else ENDS[: 1 if law == "Flores" else 3]
    rung = jc.integrator.ImplicitStep(step, rebound=1.0)
    assert_right(bouncing(contact), "journal", 1, variables, ends, within, rung)
    if len(ends) == 1:
        asked = problem(bouncing(contact), "journal", 1, variables, rung)
        slopes = jax.jit(jax.jacfwd(lambda v: answer(asked, v, ENDS[1])))(asked.nominal())
        assert np.all(np.isnan(slopes)) and "3 % of the narrowest gap" in jc.explain_nan(slopes)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ball in its socket", "slider in its guide", "LuGre"])
def test_joints_and_friction_have_the_derivatives_of_the_motion(name):
    rig, *case = CASES[name]
    assert_right(rig(), *case, 6e-3, jc.integrator.ImplicitStep(5e-6, rebound=1.0))


@pytest.mark.slow
def test_numerical_damping_takes_a_run_off_its_motion_and_its_derivative_away():
    """By default a run loses a fifth of a per cent of its speed in every bounce: after six of them
    its derivative is nan, and in steps a tenth as long that of the motion."""
    variables = CLEARANCE, start_speed
    rig = bouncing(LAWS["Flores"][0])
    asked = problem(rig, "journal", 1, variables, jc.integrator.ImplicitStep(5e-5))
    slope = jax.jit(
        lambda step, end: jax.jacfwd(lambda v: answer(with_step(asked, step), v, end))(
            asked.nominal()
        )
    )
    assert np.all(np.isnan(slope(5e-5, ENDS[-1])))
    assert np.all(np.isfinite(slope(5e-5, ENDS[0])))
    assert_right(rig, "journal", 1, variables, ENDS, 2e-3, jc.integrator.ImplicitStep(5e-6))


@pytest.mark.slow
def test_the_run_is_the_same_whether_it_is_differentiated():
    asked = problem(bouncing(LAWS["Flores"][0]), "journal", 1, (CLEARANCE,), LOSSLESS)
    function, x = lambda v: answer(asked, v, 0.03), asked.nominal()
    alone = jax.jit(function)(x)
    value, forwards = jax.jit(lambda v: jax.jvp(function, (v,), (jnp.ones(1),)))(x)
    assert value == alone and np.isfinite(forwards)


@pytest.mark.slow
def test_instants_of_touches_have_no_derivative():
    asked = problem(bouncing(LAWS["Flores"][0]), "journal", 1, (CLEARANCE,), LOSSLESS)
    asked = jc.Problem(
        asked.mechanism,
        lambda run: run.noted.times[0, 0, 0],
        asked.variables,
        duration=0.02,
        save=jc.Saving(2, 1),
        integrator=LOSSLESS,
    )
    evaluate = lambda v: asked.evaluate(v).responses["response"]
    assert np.isnan(jax.jit(jax.jacfwd(evaluate))(asked.nominal()))


@pytest.mark.slow
def test_bristles_that_settle_faster_than_a_step_are_followed_beside_it():
    """A spinning journal is thrown on LuGre's bristles, whose deflection settles within 2 us of
    sliding: in steps of 20 us slopes of what wears were five times too large, those of the mean
    force 9 % off. Beside extrapolated differences of `Adaptive` at 1e-10 (benchmarks.attack_slopes,
    case 940), which know the wear to 2 %."""
    structure = next(each for each in structures() if each.number == 9)
    asked = attack_slopes.problem(structure.case(40), jc.integrator.ImplicitStep(2e-5))
    slopes = jax.jit(jax.jacfwd(lambda values: asked.evaluate(values).responses))(asked.nominal())
    assert slopes["mean force"][0] == pytest.approx(-58603.7, rel=2e-3)
    assert slopes["worn volume"][0] == pytest.approx(-6.28e-13, rel=0.04)
    assert slopes["worn volume"][2] == pytest.approx(3.864e-15, rel=0.02)
