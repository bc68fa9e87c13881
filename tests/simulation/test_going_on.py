"""A run goes on from a saved state and from worn surfaces: as one run would, and not otherwise."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.scenes.slider_crank import slider_crank
from tests.rigs.loaded_bearing import loaded_bearing

# Powers of two: instants of both ways are the same to the last bit.
HALF, SAVES, STEP = 2.0**-8, 5, 2.0**-16


def rod_length(rig):
    return rig.connections["B"].parent.at[0]


def bearing(updates=None):
    friction = jc.friction.CoulombTanh(transition_speed=1e-2)
    return loaded_bearing(100.0, friction, sliding=True, updates=updates)


def first_half(rig, integrator):
    return jc.simulate(rig, HALF, save=SAVES, integrator=integrator)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["fixed", "adaptive"])
def test_two_halves_are_the_whole(kind):
    """With a law that remembers, and a surface that wears: updated at each saving time, in both."""
    adaptive, within = jc.integrator.Adaptive(rtol=1e-9), 1e-5 if kind == "adaptive" else 0.0
    integrator = adaptive if kind == "adaptive" else jc.integrator.FixedStep(STEP)
    updates = SAVES - 1
    rig, twice = bearing(updates), bearing(2 * updates)
    whole = jc.simulate(twice, 2 * HALF, save=2 * SAVES - 1, integrator=integrator)
    one = first_half(rig, integrator)
    two = jc.simulate(rig, HALF, save=SAVES, integrator=integrator, state=one.state())
    np.testing.assert_array_equal(two.time, whole.time[SAVES - 1 :])
    motion = rig.topology.coordinate_count + rig.topology.speed_count
    found, wanted = two.states[:, :motion], whole.states[SAVES - 1 :, :motion]
    np.testing.assert_allclose(found, wanted, rtol=within, atol=within * 1e-3)
    depths = [run.worn_depth("B", "bearing") for run in (two, whole)]
    assert depths[0].sum() > one.worn_depth("B", "bearing").sum() > 0
    # An arc is the root of what a mean direction lacks of length one: of rounding too.
    np.testing.assert_allclose(*depths, rtol=1e-9 + 10 * within, atol=0)
    volumes = [run.worn_volume("B", "bearing") for run in (one, two, whole)]
    np.testing.assert_allclose(volumes[0][-1] + volumes[1][-1], volumes[2][-1], rtol=1e-12 + within)


@pytest.mark.slow
def test_problem_goes_on_as_simulate_does():
    rig, integrator = bearing(), jc.integrator.FixedStep(STEP)
    how = {"save": SAVES, "integrator": integrator, "state": first_half(rig, integrator).state()}
    depth = jc.response.PeakWornDepth("B")
    where = lambda rig: rig.connections["B"].joint.clearance
    varied = {"clearance": jc.Variable(where, tolerance=1e-6)}
    problem = jc.Problem(rig, depth, varied, duration=HALF, **how)
    found = eqx.filter_jit(jc.Problem.evaluate)(problem, problem.nominal()).responses["response"]
    np.testing.assert_allclose(found, depth(jc.simulate(rig, HALF, **how)), rtol=1e-12)


def test_a_worn_gap_is_deeper():
    """A journal pressed on a surface worn evenly lies as much deeper."""
    rig, how = bearing(), {"save": SAVES, "integrator": jc.integrator.FixedStep(STEP)}
    depth, plain = 1e-6, jc.simulate(rig, HALF, **how)
    flat = jc.State({"B": {"bearing": jnp.full_like(plain.worn["B"]["bearing"], depth)}})
    runs = plain, jc.simulate(rig, HALF, state=flat, **how)
    gaps = [float(run.contact("B").indentation[0, 0]) for run in runs]
    assert gaps[0] - gaps[1] == pytest.approx(depth, rel=1e-9)


@pytest.mark.slow
def test_a_state_closes_the_loops_of_other_lengths():
    """The nearest place that does; the drive goes on from the time of the state."""
    rig = slider_crank("ideal")
    run = jc.simulate(rig, 0.01, save=5)
    long = eqx.tree_at(rod_length, rig, rod_length(rig) + 1e-4)
    again = jc.simulate(long, 0.01, save=5, state=run.state())
    assert float(again.time[0]) == float(run.time[-1])
    opening = max(float(jnp.max(each)) for each in again.drift().values())
    assert opening < 1e-8
    places = [each.body("slider").com[k] for each, k in ((run, -1), (again, 0))]
    assert 0 < jnp.linalg.norm(places[1] - places[0]) < 2e-4


def test_what_does_not_belong_is_refused_by_name():
    rig, integrator = bearing(), jc.integrator.FixedStep(STEP)
    one = first_half(rig, integrator)
    other = jc.simulate(slider_crank("ideal"), 1e-3, save=2)
    depth = one.worn["B"]["bearing"]
    for sentence, state in {
        'no worn joint "C" in this mechanism; there is "B"': lambda: jc.State({"C": {}}),
        'no worn surface "bore" of joint "B"': lambda: jc.State({"B": {"bore": 0.0}}),
        r'"bearing"\] has the shape \(3,\)': lambda: jc.State({"B": {"bearing": jnp.zeros(3)}}),
        "below 0 m": lambda: jc.State({"B": {"bearing": -depth}}),
        "worn of a State is a Trajectory": lambda: jc.State(one),
        "state is a Trajectory": lambda: one,
        "state is ": dict,
        "another mechanism": other.state,
        "worn depths are known at the end of a run only": lambda: one.state(0),
    }.items():
        with pytest.raises(ValueError, match=sentence):
            jc.simulate(rig, HALF, save=SAVES, integrator=integrator, state=state())
    with pytest.raises(ValueError, match="saving time 5 was asked for; the run has 5"):
        one.state(5)
