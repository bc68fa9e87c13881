"""Derivatives of error-controlled runs are those of the motion through touches and releases: beside
differences of tight runs, extrapolated to none, for contact laws and joints of every kind, and
beside closed forms.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.cells import slow_but

GRAVITY = 9.81
DOWN = {"gravity": jc.load.Gravity((0.0, -GRAVITY))}
SMOOTH = jc.friction.CoulombTanh(mu_kinetic=0.1, transition_speed=1e-2)
JOINT = lambda rig: rig.connections["B"].joint
CLEARANCE = lambda rig: JOINT(rig).clearance
DAMPED = {"stiffness": 1e9, "restitution": 0.8}
# By contact law: the law, and which of its numbers vary.
STIFFNESS = lambda rig: JOINT(rig).contact.stiffness
ELASTIC = lambda rig: JOINT(rig).contact.elastic.stiffness
RESTITUTION = lambda rig: JOINT(rig).contact.dissipation.restitution
DAMPING = lambda rig: JOINT(rig).contact.damping
LAWS = {
    "Flores": (jc.contact.Flores(**DAMPED), ELASTIC, RESTITUTION),
    "LankaraniNikravesh": (jc.contact.LankaraniNikravesh(**DAMPED), ELASTIC, RESTITUTION),
    "HuntCrossley": (jc.contact.HuntCrossley(**DAMPED), ELASTIC, RESTITUTION),
    "CarvalhoMartins": (jc.contact.CarvalhoMartins(**DAMPED), ELASTIC, RESTITUTION),
    "Hertz": (jc.contact.Hertz(stiffness=1e9), ELASTIC),
    "KelvinVoigt": (jc.contact.KelvinVoigt(stiffness=1e7, damping=2e2), STIFFNESS, DAMPING),
    "AdamsImpact": (jc.contact.AdamsImpact(stiffness=1e9, damping=2e2), STIFFNESS, DAMPING),
}
# One of each kind: an elastic force by a factor with a memory and without, a damper beside it.
KINDS = ("Flores", "Hertz", "KelvinVoigt", "AdamsImpact")
# Ends of runs [s] with one, two, three and six bounces.
ENDS = (0.025, 0.045, 0.062, 0.09)


def bouncing(contact, friction=None, sideways=0.0, spin=0.0):
    """A journal that is thrown down in its bearing."""
    bearing = jc.clearance.PlanarJournalBearing(contact, friction, clearance=1e-3)
    return jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        DOWN,
        speeds={"journal": (sideways, -0.05, spin)},
    )


def ball():
    joint = jc.clearance.BallSocket(jc.contact.Flores(**DAMPED), SMOOTH, clearance=1e-3)
    return jc.Mechanism(
        {"ball": jc.Body(1.0, (1e-4, 1e-4, 1e-4))},
        {"B": jc.Connection(joint, "ground", "ball")},
        {"gravity": jc.load.Gravity((0.0, 0.0, -GRAVITY))},
        speeds={"ball": (0.02, 0.01, -0.05, 0.0, 0.0, 0.0)},
    )


def slider():
    """Its corners strike one after the other."""
    joint = jc.clearance.SliderGuide(jc.contact.Flores(**DAMPED), SMOOTH, clearance=1e-3)
    return jc.Mechanism(
        {"slider": jc.Body(1.0, 1e-3)},
        {"B": jc.Connection(joint, jc.Marker("ground", axis="x"), jc.Marker("slider", axis="x"))},
        DOWN,
        start={"slider": (0.0, 0.0, 1e-3)},
        speeds={"slider": (0.1, -0.05, 0.0)},
    )


def crank(**how):
    return jc.scenes.slider_crank(clearance=2e-4, **how)


def problem(rig, body, axis, variables, integrator, concentric=True):
    return jc.Problem(
        rig,
        lambda run: 1e3 * run.body(body).com[-1, axis],
        {str(i): jc.Variable(each, tolerance=1e-9) for i, each in enumerate(variables)},
        duration=0.01,
        integrator=integrator,
        save=2,
        state=jc.State(concentric=concentric),
    )


def answer(asked, values, end):
    asked = eqx.tree_at(lambda own: own.duration, asked, end)
    return asked.evaluate(values).responses["response"]


def tight(rtol=1e-12):
    return jc.integrator.Adaptive(rtol=rtol, atol=1e-2 * rtol)


def assert_right(rig, body, axis, variables, ends, within, rung=None, share=1e-4):
    """Derivatives of runs of a rung (of usual tolerance) beside differences of tight ones."""
    rung = jc.integrator.Adaptive() if rung is None else rung
    usual = problem(rig, body, axis, variables, rung)
    best = problem(rig, body, axis, variables, tight())
    values = usual.nominal()
    slopes = jax.jit(jax.jacfwd(lambda v, end: answer(usual, v, end)))
    steps = share * jnp.diag(values)
    ways = jnp.concatenate([steps, -steps, 0.5 * steps, -0.5 * steps])
    around = jax.jit(jax.vmap(lambda v, end: answer(best, v, end), (0, None)))
    for end in ends:
        ahead, behind, near, close = around(values + ways, end).reshape(4, -1)
        whole, half = (ahead - behind) / (2 * share * values), (near - close) / (share * values)
        wanted = half + (half - whole) / 3
        assert np.all(abs(half - whole) < 0.5 * within * abs(wanted))
        np.testing.assert_allclose(slopes(values, end), wanted, rtol=within)


def start_speed(rig):
    return rig.speeds["journal"][1]


USUAL = ("Flores",)


@pytest.mark.parametrize("law", slow_but(USUAL, LAWS))
def test_bounces_of_every_law_have_the_derivatives_of_the_motion(law):
    """By clearance, start speed and numbers of the law, through one to six bounces. Laws whose
    clamp bends the force are resolved by steps to a per cent, the others to 1e-3."""
    contact, *numbers = LAWS[law]
    within = {"KelvinVoigt": 6e-3, "AdamsImpact": 1.5e-2}.get(law, 1e-3)
    variables = CLEARANCE, start_speed, *numbers
    assert_right(bouncing(contact), "journal", 1, variables, ENDS, within)


@pytest.mark.slow
@pytest.mark.parametrize("law", KINDS)
def test_bounces_in_equal_steps_have_the_derivatives_of_the_motion(law):
    """In steps of 20 us; a force that jumps at the touch takes shorter ones, as the run itself."""
    contact, *numbers = LAWS[law]
    jumps = law in ("KelvinVoigt", "AdamsImpact")
    rung = jc.integrator.FixedStep(2e-6 if jumps else 2e-5)
    within = 1.5e-2 if jumps else 2e-3
    variables = CLEARANCE, start_speed, *numbers
    assert_right(bouncing(contact), "journal", 1, variables, ENDS, within, rung)


CASES = {
    "ball in its socket": (ball, "ball", 2, (CLEARANCE,), (0.02, 0.08)),
    "slider in its guide": (slider, "slider", 1, (CLEARANCE,), (0.02, 0.04)),
    "LuGre": (
        lambda: bouncing(LAWS["Flores"][0], jc.friction.LuGre(), 0.02, 3.0),
        "journal",
        0,
        (CLEARANCE, lambda rig: JOINT(rig).friction.mu_kinetic),
        (0.02, 0.04),
    ),
    "slider-crank, seven impacts": (
        crank,
        "slider",
        0,
        (CLEARANCE, lambda rig: rig.bodies["slider"].mass),
        (0.01,),
    ),
    "a drive that depends on time": (
        lambda: crank(drive=jc.drive.Harmonic(amplitude=0.4, frequency=5.0)),
        "slider",
        0,
        (CLEARANCE, lambda rig: rig.connections["O"].joint.drive.frequency),
        (0.01, 0.02),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_joints_friction_and_drives_have_the_derivatives_of_the_motion(name):
    rig, *case = CASES[name]
    assert_right(rig(), *case, within=6e-3)


@pytest.mark.slow
def test_a_slope_is_right_or_refused_however_little_moves():
    """By its mass the slider moves by some 1e-3 of where it is: behind seven impacts the slope at
    the usual tolerance alone would be 0.9 % off, which tighter steps mend; 1 ms later up to 3 %."""
    rig, body, axis, variables, _ = CASES["slider-crank, seven impacts"]
    asked, best = (
        problem(rig(), body, axis, variables, rung)
        for rung in (jc.integrator.Adaptive(), tight(1e-10))
    )
    slopes, exact = (
        jax.jit(jax.jacfwd(functools.partial(answer, each), 0)) for each in (asked, best)
    )
    values = asked.nominal()
    np.testing.assert_allclose(slopes(values, 0.01), exact(values, 0.01), rtol=1e-3)
    found, wanted = slopes(values, 0.011), exact(values, 0.011)
    known = ~np.isnan(found)
    np.testing.assert_allclose(found[known], wanted[known], rtol=2e-3)
    assert known.all() or jc.explain_nan(found).startswith("In steps of another length")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ball in its socket", "slider in its guide", "LuGre"])
def test_joints_and_friction_in_equal_steps_have_the_derivatives_of_the_motion(name):
    rig, *case = CASES[name]
    assert_right(rig(), *case, 6e-3, jc.integrator.FixedStep(2e-5))


def test_in_equal_steps_a_lossless_bounce_has_the_derivative_of_its_closed_form():
    """As below; there is none where a contact is over in few steps, the run of which ends early."""
    speed, end, omega = -0.05, 0.03, 3e3
    rig = bouncing(jc.contact.Linear(stiffness=omega**2))
    rig = jc.Mechanism(rig.bodies, rig.connections, speeds=rig.speeds)
    variables = start_speed, CLEARANCE, ELASTIC
    asked = problem(rig, "journal", 1, variables, jc.integrator.FixedStep(2e-5), False)
    slopes = jax.jit(jax.jacfwd(lambda v: 1e-3 * answer(asked, v, end)))
    found = slopes(asked.nominal())
    wanted = -(end - np.pi / omega), -2.0, 0.5 * speed * np.pi / -(omega**3)
    np.testing.assert_allclose(found, wanted, rtol=2e-3)
    none = slopes(asked.nominal().at[2].set(2.5e5**2))
    assert np.all(np.isnan(none))
    assert jc.explain_nan(none).startswith("The run ended before the instant")


@pytest.mark.slow
def test_a_lossless_bounce_has_the_derivative_of_its_closed_form():
    """y = -2 c - y0 - v0 (T - pi / omega) without gravity; of a rigid wall pi / omega is 0
    (../refdata/diff_contact_gradients, one bounce)."""
    start, speed, end = 2e-4, -0.2, 0.012
    rig = bouncing(jc.contact.Linear(stiffness=1e6))
    rig = jc.Mechanism(
        rig.bodies,
        rig.connections,
        start={"journal": (0.0, start, 0.0)},
        speeds={"journal": (0.0, speed, 0.0)},
    )
    variables = lambda rig: rig.start["journal"][1], start_speed, CLEARANCE, ELASTIC
    asked = problem(rig, "journal", 1, variables, tight(1e-9), False)
    slopes = jax.jit(jax.jacfwd(lambda v: 1e-3 * answer(asked, v, end)))
    for omega in (3e3, 1e5):
        found = slopes(asked.nominal().at[3].set(omega**2))
        wanted = -1.0, -(end - np.pi / omega), -2.0, 0.5 * speed * np.pi / -(omega**3)
        np.testing.assert_allclose(found, wanted, rtol=1e-5)


@pytest.mark.slow
def test_of_two_equal_bodies_one_takes_over_from_the_other():
    """(1, 0, 1, 0) by places and speeds, where codes without the instant of the impact say (0.75,
    0.25, 0.91, 0.08) (../refdata/diff_contact_gradients, two balls). One body is the other's
    bearing; of a rigid wall, which is approached as the contact time shrinks. By the ring's place
    it is 0, the rest of parts that cancel, whose hundredth no tolerance determines: it may be nan.
    """
    clearance, end, omega = 1e-3, 0.012, 1e5
    bearing = jc.clearance.PlanarJournalBearing(
        jc.contact.Linear(stiffness=0.5 * omega**2), clearance=clearance
    )
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4), "ring": jc.Body(1.0, 1e-4)},
        {
            "B": jc.Connection(bearing, "ring", "journal"),
            "G": jc.Connection(
                jc.joint.Prismatic(), jc.Marker("ground", axis="y"), jc.Marker("ring", axis="y")
            ),
        },
        start={"journal": (0.0, 2e-4, 0.0), "G": 0.0},
        speeds={"journal": (0.0, 0.2, 0.0), "G": 0.0},
    )
    parts = (
        lambda rig: rig.start["journal"][1],
        lambda rig: rig.start["G"],
        lambda rig: rig.speeds["journal"][1],
        lambda rig: rig.speeds["G"],
    )
    asked = problem(rig, "ring", 1, parts, jc.integrator.Adaptive(), False)
    slope = jax.jit(jax.jacfwd(lambda v: 1e-3 * answer(asked, v, end)))(asked.nominal())
    slope = slope.at[1].set(jnp.where(jnp.isnan(slope[1]), 0.0, slope[1]))
    np.testing.assert_allclose(slope, (1.0, 0.0, end, 0.0), atol=np.pi / omega)


@pytest.mark.slow
def test_the_run_is_the_same_whether_it_is_differentiated():
    asked = problem(
        bouncing(LAWS["Flores"][0]), "journal", 1, (CLEARANCE,), jc.integrator.Adaptive()
    )
    function, x = lambda v: answer(asked, v, 0.09), asked.nominal()
    alone = jax.jit(function)(x)
    value, forwards = jax.jit(lambda v: jax.jvp(function, (v,), (jnp.ones(1),)))(x)
    backwards = jax.jit(jax.grad(function))(x)
    assert value == alone
    np.testing.assert_allclose(backwards[0], forwards, rtol=1e-10)


@pytest.mark.slow
def test_saving_times_may_move():
    """The derivative of a place by the end of the run is the speed there."""
    rig = bouncing(LAWS["Flores"][0])
    asked = problem(rig, "journal", 1, (CLEARANCE,), tight(1e-10))
    speed = eqx.tree_at(
        lambda own: own.response["response"], asked, lambda run: 1e3 * run.speed("journal")[-1, 1]
    )
    x, end = asked.nominal(), jnp.asarray(0.05)
    slope = jax.jit(jax.jacfwd(lambda end: answer(asked, x, end)))(end)
    np.testing.assert_allclose(slope, answer(speed, x, end), rtol=1e-6)


def test_a_second_derivative_says_why_not():
    asked = problem(
        bouncing(LAWS["Flores"][0]), "journal", 1, (CLEARANCE,), jc.integrator.Adaptive()
    )
    with pytest.raises(ValueError, match="take differences of first derivatives"):
        jax.jit(jax.hessian(lambda v: answer(asked, v, 0.09)))(asked.nominal())


@pytest.mark.slow
def test_a_derivative_that_the_tolerance_no_longer_determines_is_nan():
    """Beside differences, through ten impacts of a slider-crank derivatives of the usual tolerance
    are right, through twenty of a rattling one off by a sixth, those of a tight one by 1e-3."""
    usual = problem(crank(friction=None), "slider", 0, (CLEARANCE,), jc.integrator.Adaptive())

    @jax.jit
    def slope(end, rtol):
        tolerances = lambda own: (own.integrator.rtol, own.integrator.atol)
        asked = eqx.tree_at(tolerances, usual, (rtol, 1e-2 * rtol))
        return jax.jacfwd(lambda v: answer(asked, v, end))(asked.nominal())

    np.testing.assert_allclose(slope(0.01, 1e-7), slope(0.01, 1e-11), rtol=1e-3)
    assert np.isnan(slope(0.03, 1e-7))
    np.testing.assert_allclose(slope(0.03, 1e-10), slope(0.03, 1e-11), rtol=2e-3)


@pytest.mark.slow
def test_a_journal_at_rest_has_its_derivative_though_its_steps_grow_beyond_its_period():
    """Nothing moves, so steps of the motion grow; those of the derivative are its own: the journal
    lies lower by as much as the clearance is larger."""
    rig = bouncing(LAWS["HuntCrossley"][0])
    rig = jc.Mechanism(rig.bodies, rig.connections, DOWN)
    asked = jc.Problem(
        rig,
        lambda run: run.body("journal").com[-1, 1],
        {"clearance": jc.Variable(CLEARANCE, tolerance=1e-9)},
        duration=0.02,
        save=2,
        integrator=jc.integrator.Adaptive(),
        state=jc.resting_state(rig),
    )
    evaluate = lambda values: asked.evaluate(values).responses["response"]
    slope = jax.jit(jax.jacfwd(evaluate))(asked.nominal())[0]
    np.testing.assert_allclose(slope, -1.0, rtol=1e-6)
