"""Derivatives that steps do not determine are no numbers: of rigid steps where runs in other steps
have others, beside the closed form of a journal that bounces; where friction that stops slip within
a step carries it to and fro.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from benchmarks.attacks.structures import structures
from benchmarks.claims import through_touches as bounces

# One bounce [s]; its slope by clearance is off by half a hundredth in steps of 1 us, by three
# hundredths in steps of 5 us.
END = 0.025
FINE, COARSE = 1e-6, 5e-6
# Steps [s] of which an impact is about one before the end.
BEFORE_THE_END = 4e-6


def asked(step, responses):
    """By clearance, start speed and restitution."""
    problem = bounces.asked(bounces.RIGID[0], jc.integrator.MoreauJean(step), *bounces.RIGID[1:])
    rig, steps = problem.mechanism, problem.integrator
    return jc.Problem(rig, responses, problem.variables, duration=END, integrator=steps, save=2)


def height(run):
    """[mm]."""
    return 1e3 * run.body("journal").com[-1, 1]


def of_the_motion(values):
    return np.asarray(jax.jacfwd(bounces.by_hand)(values, END))


@pytest.mark.slow(sample=False)
def test_a_slope_is_refused_where_its_parts_nearly_cancel_in_a_response():
    """What is left of the height is a hundredth of its slope, by no more than whose error it is
    told: of that no state of the run knows."""
    values = jnp.array([bounces.CLEARANCE, bounces.SPEED, bounces.RESTITUTION])
    wanted = of_the_motion(values)
    joint = lambda run: run.mechanism.connections["B"].joint
    left = lambda run: height(run) - 0.99 * wanted[0] * joint(run).clearance
    problem = asked(FINE, {"height": height, "left": left})
    slopes = lambda way: jax.jvp(lambda v: problem.evaluate(v).responses, (values,), (way,))[1]
    found = jax.jit(slopes)(jnp.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(found["height"], wanted[0], rtol=0.01)
    assert np.isnan(found["left"])


@pytest.mark.slow(sample=False)
def test_a_slope_is_refused_where_a_run_ends_before_it_takes_an_impact_that_is_due():
    """Steps take an impact in their second half one step later: a run that ends between is on the
    other side of it, and runs in longer steps are too."""
    problem = asked(BEFORE_THE_END, {"height": height})
    values = problem.nominal()
    speed = jnp.sqrt(bounces.SPEED**2 + 2 * bounces.GRAVITY * bounces.CLEARANCE)
    impact = float(bounces.SPEED + speed) / bounces.GRAVITY

    @jax.jit
    def slopes(end):
        own = eqx.tree_at(lambda known: known.duration, problem, end)
        return jax.jacfwd(lambda values: own.evaluate(values).responses["height"])(values)

    assert np.isnan(slopes(impact + 0.25 * BEFORE_THE_END)).all()
    still_flying, end = impact - 0.25 * BEFORE_THE_END, impact + 1000 * BEFORE_THE_END
    np.testing.assert_allclose(slopes(still_flying), [0.0, 1e3 * still_flying, 0.0], rtol=1e-9)
    wanted = np.asarray(jax.jacfwd(bounces.by_hand)(values, end))
    np.testing.assert_allclose(slopes(end), wanted, rtol=0.01)


@pytest.mark.slow(sample=False)
def test_slopes_of_coarse_steps_are_right_or_refused_both_ways():
    problem = asked(COARSE, {"height": height})
    values = problem.nominal()
    wanted = of_the_motion(values)
    answer = lambda values: problem.evaluate(values).responses["height"]
    for way in (jax.jacfwd, jax.jacrev):
        found = np.asarray(jax.jit(way(answer))(values))
        assert np.isnan(found[0])
        np.testing.assert_allclose(found[1:], wanted[1:], rtol=0.01)


@pytest.mark.slow(sample=False)
@pytest.mark.parametrize("saves", [2, 26, 10001])
def test_slopes_of_a_run_are_right_or_refused(saves):
    """However often it is saved: twice in a step too, where other steps are shorter ones. On the
    way a slope that passes through nothing is told beside what it has been."""
    problem = asked(COARSE, {"height": height})
    values = problem.nominal()

    def heights(values):
        rig, how = problem.with_values(values), jc.integrator.MoreauJean(COARSE)
        run = jc.simulate(rig, END, integrator=how, save=saves, throw=False)
        return 1e3 * run.body("journal").com[:, 1]

    for way in (jax.jacfwd, jax.jacrev) if saves == 2 else (jax.jacfwd,):
        found = np.asarray(way(heights)(values))
        off = abs(found[-1] / of_the_motion(values) - 1)
        assert not (off > 0.02).any() and not np.isnan(off[1:]).any()
        assert np.isnan(found).mean() < 0.2
    if saves == 2:
        assert np.isnan(off[0])


def test_what_a_drive_says_has_the_derivative_zero_though_steps_round_it_each_in_their_way():
    rig = jc.scenes.slider_crank()
    mass = jc.Variable(lambda m: m.bodies["slider"].mass, tolerance=1e-3)
    place = lambda run: jnp.sum(run.states[-1][:4])
    steps = jc.integrator.NonColliding(1e-4)
    asked = jc.Problem(rig, place, {"mass": mass}, duration=0.01, integrator=steps, save=3)
    answer = lambda values: asked.evaluate(values).responses["response"]
    assert abs(jax.jit(jax.jacfwd(answer))(asked.nominal())) < 1e-9


SLIDER_CRANK, DRAW = 14, 40


def shares(integrator):
    """Of the mean force and the worn volume of the attack's slider-crank, which sticks in its
    bearing in the middle of a hit, by its clearance and the stiffness of its contact, as shares."""
    case = structures()[SLIDER_CRANK].case(DRAW)
    joint = lambda rig: rig.connections["B"].joint
    places = {
        "clearance": lambda rig: joint(rig).clearance,
        "stiffness": lambda rig: joint(rig).contact.elastic.stiffness,
    }
    asked = jc.Problem(
        case.mechanism,
        {
            "mean force": jc.response.MeanContactForce("B"),
            "worn volume": lambda run: run.worn_volume("B", "bearing")[-1],
        },
        {name: jc.Variable(of, tolerance=1e-3 * of(case.mechanism)) for name, of in places.items()},
        duration=case.duration,
        integrator=integrator,
        save=51,
        state=jc.State(concentric=case.concentric),
    )
    evaluate = lambda values: asked.evaluate(values).responses
    at = asked.nominal()
    found, values = jax.jit(lambda at: (jax.jacfwd(evaluate)(at), evaluate(at)))(at)
    return {name: np.asarray(each * at) / values[name] for name, each in found.items()}


@pytest.mark.slow(sample=False)
def test_of_slip_that_chatters_there_is_none():
    """At 20 us, a study's default, they were 10 % (mean force) and 23 % (wear) off."""
    told = shares(jc.integrator.FixedStep())
    assert np.isnan(told["mean force"]).all() and np.isnan(told["worn volume"]).all()


@pytest.mark.slow(sample=False)
def test_steps_that_resolve_it_have_one():
    """Also where wear enters at updates: then `Adaptive` is a loop within another one, which goes
    through its motion once for every variable."""
    told = shares(jc.integrator.FixedStep(2e-6))
    known = shares(jc.integrator.Adaptive(rtol=1e-9, atol=1e-11))
    for name in ("mean force", "worn volume"):
        np.testing.assert_allclose(told[name], known[name], rtol=1e-4)
