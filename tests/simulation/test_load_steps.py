"""A push that is shorter than a step is told of, and steps that find their own length do not pass
over it. Oracle: a body on a slide that is pushed moves by the impulse over its mass."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators.checks import Check
from jaxclear.simulation.load_steps import load_steps, missed_shares

MASS, FORCE, BEGIN, LASTS = 2.0, 3e4, 0.051, 3e-5
PULSE = jc.TimeTable(
    [0.0, BEGIN, BEGIN + 1e-6, BEGIN + LASTS, BEGIN + LASTS + 1e-6, 1.0],
    [0.0, 0.0, FORCE, FORCE, 0.0, 0.0],
    "linear",
)


def pushed(push, mass=MASS, **more):
    """A cart on a slide that a force [N] pushes."""
    slide = jc.Connection(jc.joint.Prismatic(), "ground", "cart", axis="x")
    loads = {"push": jc.load.JointTorque("G", push)} | more
    return jc.Mechanism({"cart": jc.Body(mass, 1.0)}, {"G": slide}, loads)


def speed(run):
    return float(run.speed("G")[-1])


def test_adaptive_does_not_pass_over_a_push_far_shorter_than_its_steps():
    run = jc.simulate(pushed(PULSE), 0.1, save=6)
    assert speed(run) == pytest.approx(FORCE * LASTS / MASS, rel=1e-5) and not run.warnings


@pytest.mark.parametrize("step", [1e-4, 5e-7])
def test_steps_longer_than_a_push_say_so(step):
    run = jc.simulate(pushed(PULSE), 0.1, save=6, integrator=jc.integrator.FixedStep(step))
    right = speed(run) == pytest.approx(FORCE * LASTS / MASS, rel=0.02)
    assert right == (step < LASTS) == (not run.warnings)
    sentence = 'of the impulse of "push"'
    assert right or [sentence in said for said in run.warnings].count(True) == 1


@pytest.mark.parametrize(("frequency", "said"), [(100.0, False), (1e4, True), (9.9e3, True)])
def test_what_vibrates_faster_than_steps_is_told(frequency, said):
    functions = {"load": lambda time: jnp.cos(2 * jnp.pi * frequency * time)}
    shares = missed_shares(functions, np.linspace(0.0, 0.1, 6), 1e-4)
    assert (shares["load"] > Check.LOAD_STEP.limit) == said


def test_what_changes_slowly_leaves_adaptive_as_it_is():
    """And so does a drive of constant speed, of which nothing is told."""
    integrator, times = jc.integrator.Adaptive(), np.linspace(0.0, 0.1, 6)
    slow = pushed(lambda time: 5 * jnp.sin(20 * time))
    assert load_steps(slow, integrator, times) == (integrator, {})
    assert load_steps(slow, jc.integrator.FixedStep(), times).passed["push"] < 1e-9
    driven = jc.scenes.slider_crank("ideal")
    assert load_steps(driven, integrator, times) == (integrator, {})


@pytest.mark.verified
@pytest.mark.parametrize(("step", "said"), [(2e-4, True), (2e-6, False)])
def test_steps_that_meet_a_stop_midway_say_so(step, said):
    """A cart pushed against an elastic stop leaves it with the speed at which it came, and is back
    where it began after twice the time it took, and half a vibration of the stop."""
    mass, push, way, stiffness = 1.0, 50.0, 0.01, 1e8
    rig = pushed(push, mass, stop=jc.load.JointStop("G", upper=way, stiffness=stiffness))
    there, swing = (2 * way * mass / push) ** 0.5, np.pi * (mass / stiffness) ** 0.5
    duration = 4 * (2 * there + swing)
    steps = jc.integrator.FixedStep(step)
    run = jc.simulate(rig, duration, save=6, integrator=steps, verify=True)
    assert (abs(run.coordinate("G")[-1]) > 0.02 * way) == said == bool(run.warnings)


@pytest.mark.slow
def test_a_study_is_held_to_the_push_too_and_says_what_its_steps_pass_over():
    mass = jc.Variable(lambda rig: rig.bodies["cart"].mass, jc.distribution.Uniform(0.1))
    end = {"speed": lambda run: run.speed("G")[-1]}
    question = lambda integrator: jc.Problem(
        pushed(PULSE), end, {"mass": mass}, duration=0.1, save=6, integrator=integrator
    )
    held = question(jc.integrator.Adaptive())
    found = jax.jit(held.evaluate)(held.nominal()).responses["speed"]
    assert float(found) == pytest.approx(FORCE * LASTS / MASS, rel=1e-5)
    assert "push" in question(jc.integrator.FixedStep(1e-4)).description.warnings[0]


def pulse(time):
    inside = (time > 20.0031) & (time < 20.0036)
    return 4000.0 * jnp.where(inside, 1.0, 0.0)


def bell(time):
    return 2e3 * jnp.exp(-(((time - 33.0017) / 2e-4) ** 2))


def train(time):
    """Of 0.5 ms every 7 s."""
    return 5e3 * jnp.where(jnp.mod(time, 7.0) > 6.9995, 1.0, 0.0)


def crossed(time):
    """One that is turned on by another function's zero."""
    return jnp.where(jnp.abs(jnp.sin(0.31 * time) - 0.5) < 1e-4, 1e3, 0.0)


def impulse(function, until):
    """By adaptive quadrature around the instants at which each acts."""
    known = {
        pulse: 4000.0 * 0.5e-3,
        bell: 2e3 * 2e-4 * np.sqrt(np.pi),
        train: 5e3 * 5e-4 * int(until / 7.0),
        crossed: 1e3 * np.diff(np.arcsin([0.4999, 0.5001]))[0] / 0.31 * 6,
    }
    return known[function]


@pytest.mark.parametrize("push", [pulse, bell, train, crossed], ids=lambda each: each.__name__)
def test_a_function_of_time_is_felt_however_shortly_it_acts(push):
    """Speed is impulse over mass, in a run of a minute whose steps are as long as they like;
    edges between two looks are left to error control."""
    run = jc.simulate(pushed(push), 60.0, save=6)
    assert speed(run) == pytest.approx(impulse(push, 60.0) / MASS, rel=5e-5)
    assert int(run.accepted_steps) < 20_000 and not run.warnings


def test_a_run_within_a_program_of_the_user_feels_the_push_too():
    """There the numbers of an integrator are traced, of which the looks need none."""
    run = lambda mass: jc.simulate(pushed(pulse, mass), 60.0, save=2, throw=False)
    end = jax.jit(lambda mass: run(mass).speed("G")[-1])
    assert float(end(MASS)) == pytest.approx(impulse(pulse, 60.0) / MASS, rel=5e-5)


def pulse_table(force, beyond="held"):
    """0.3 ms within a second, made anew each time it is called."""
    edges = [0.0, BEGIN, BEGIN + 1e-6, BEGIN + 3e-4, BEGIN + 3e-4 + 1e-6, 1.0]
    return jc.TimeTable(edges, [0.0, 0.0, force, force, 0.0, 0.0], "linear", beyond=beyond)


def switched(force):
    return lambda time: jnp.where((time > BEGIN) & (time < BEGIN + 3e-4), force, 0.0)


# A force that is traced; a table whose every number is made within the program of the user.
PUSHES = {
    "table": pulse_table,
    "table of known numbers": lambda force: pulse_table(1e3),
    "function": switched,
}


@pytest.mark.parametrize("push", PUSHES.values(), ids=PUSHES)
def test_steps_of_a_program_of_the_user_say_what_they_pass_over(push):
    """Not a warning less than outside it, whatever is traced: the numbers of the integrator, those
    of the push or both."""

    def shares(force, step):
        rig, steps = pushed(push(force)), jc.integrator.FixedStep(step)
        return jc.simulate(rig, 0.1, save=3, integrator=steps, throw=False).invariants

    traced = jax.jit(jax.vmap(shares, (None, 0)))(1e3, jnp.array([1e-2, 5e-6]))
    judged = np.asarray(traced.figures[Check.LOAD_STEP].worst)[:, 0]
    assert judged[0] == pytest.approx(1.0) and judged[1] < Check.LOAD_STEP.limit
    known = load_steps(pushed(push(1e3)), jc.integrator.FixedStep(2e-4), np.linspace(0, 0.1, 3))
    again = float(jax.jit(shares)(1e3, 2e-4).figures[Check.LOAD_STEP].worst[0])
    assert again == pytest.approx(known.passed["push"], rel=0.05)


@pytest.mark.parametrize(
    ("push", "until"),
    [(pulse_table, 1.0), (lambda f: pulse_table(f, "repeated"), 3.0), (switched, 1.0)],
    ids=["table", "repeated", "function"],
)
def test_adaptive_in_a_program_of_the_user_feels_pushes_that_it_traces(push, until):
    def end(force):
        return jc.simulate(pushed(push(force)), until, save=2, throw=False).speed("G")[-1]

    value, slope = jax.jit(lambda force: jax.jvp(end, (force,), (1.0,)))(1e3)
    impulse = 3e-4 * until
    assert float(value) == pytest.approx(1e3 * impulse / MASS, rel=1e-3)
    assert float(slope) == pytest.approx(impulse / MASS, rel=1e-3)


def test_steps_end_at_breaks_that_are_asked_for():
    breaks = [0.0123, 0.0456]
    run = jc.simulate(pushed(5.0), 0.1, save=2, integrator=jc.integrator.Adaptive(breaks=breaks))
    assert speed(run) == pytest.approx(5.0 * 0.1 / MASS)
    free = jc.simulate(pushed(5.0), 0.1, save=2)
    assert int(run.accepted_steps) > int(free.accepted_steps)


class Strip(jc.load.AbstractCoordinateLoad):
    """A strip across the way, half a millimetre wide, that brakes what passes."""

    connection: str = eqx.field(static=True)

    def force(self, time, position, speed):
        on = (position > 0.7101) & (position < 0.7106)
        force = jnp.where(on, -2e4, 0.0) * jnp.sign(speed)
        return force, 0.0, -force * speed, 0.0


class Knock(jc.load.AbstractCoordinateLoad):
    """A cosine's bell of 2 ms about an instant."""

    connection: str = eqx.field(static=True)

    def force(self, time, position, speed):
        part = jnp.clip((time - 3.1234) / 1e-3, -1.0, 1.0)
        force = 500.0 * (1 + jnp.cos(jnp.pi * part))
        return force, 0.0, 0.0, force * speed


class StripOnBody(jc.load.AbstractBodyLoad):
    """The strip by a body's place in the ground frame."""

    marker: jc.Marker

    def markers(self):
        return (self.marker,)

    def effect(self, time, motions):
        (motion,) = motions
        force, *energies = Strip("").force(time, motion.pose.translation[0], motion.velocity[0])
        return jc.load.Effect((jc.load.Action(self.marker, (force, 0, 0), (0, 0, 0)),), *energies)


class StripInJoint(jc.load.AbstractJointLoad):
    """The strip by how far the parts of a joint are apart along its axis."""

    connection: str = eqx.field(static=True)

    def act(self, time, motion, states):
        force = Strip("").force(time, motion.pose.translation[2], motion.velocity[2])[0]
        return jc.load.JointEffect((0, 0, force))


def with_own(load, initial):
    slide = jc.Connection(jc.joint.Prismatic(), "ground", "cart", axis="x")
    place = jc.Marker("cart") if issubclass(load, jc.load.AbstractBodyLoad) else "G"
    cart, loads = jc.Body(MASS, 1.0), {"own": load(place)}
    return jc.Mechanism({"cart": cart}, {"G": slide}, loads, speeds={"G": initial})


BEHIND_THE_STRIP = np.sqrt(6.0**2 - 2 * 2e4 * 0.5e-3 / MASS)
STRIPS = (Strip, StripOnBody, StripInJoint)


@pytest.mark.parametrize("strip", STRIPS, ids=lambda each: each.__name__)
def test_a_load_of_the_users_own_is_felt_wherever_it_acts(strip):
    """On a coordinate, a body or in a joint; or steps of fixed length say that they passed it."""
    rig = with_own(strip, 6.0)
    braked = jc.simulate(rig, 1.0, save=3)
    assert speed(braked) == pytest.approx(BEHIND_THE_STRIP, rel=3e-5) and not braked.warnings
    passed = jc.simulate(rig, 1.0, save=3, integrator=jc.integrator.FixedStep(1e-3), verify=False)
    assert ['of the impulse of "own"' in said for said in passed.warnings] == [True]


@pytest.mark.slow
@pytest.mark.parametrize("strip", STRIPS, ids=lambda each: each.__name__)
def test_a_study_feels_loads_of_the_users_own_too_or_says_so(strip):
    """Of each sample, as the nominal one shows that there is something."""
    mass = jc.Variable(lambda rig: rig.bodies["cart"].mass, jc.distribution.Uniform(0.1))
    end = {"speed": lambda run: run.speed("G")[-1]}
    question = lambda integrator: jc.Problem(
        with_own(strip, 6.0), end, {"mass": mass}, duration=1.0, save=3, integrator=integrator
    )
    answer = question(jc.integrator.Adaptive()).evaluate([0.95 * MASS])
    left = np.sqrt(6.0**2 - 2 * 2e4 * 0.5e-3 / (0.95 * MASS))
    assert float(answer.responses["speed"]) == pytest.approx(left, rel=1e-4)
    passed = question(jc.integrator.FixedStep(1e-3)).evaluate([MASS]).checks
    assert passed.figures[Check.LOAD_STEP].worst[0] == pytest.approx(1.0)


def test_a_study_of_a_load_that_steps_resolve_does_not_look_at_each_sample():
    mass = jc.Variable(lambda rig: rig.bodies["cart"].mass, jc.distribution.Uniform(0.1))
    end = {"speed": lambda run: run.speed("G")[-1]}
    steps = jc.integrator.FixedStep(1e-5)
    rig = with_own(Knock, 0.0)
    calm = jc.Problem(rig, end, {"mass": mass}, duration=0.1, save=3, integrator=steps)
    assert not calm.experiment.looks_along


@pytest.mark.parametrize("save", [3, 101])
def test_a_load_of_the_users_own_is_felt_however_shortly_it_acts(save):
    """By its work, and by its impulse."""
    braked = jc.simulate(with_own(Strip, 6.0), 1.0, save=save)
    assert speed(braked) == pytest.approx(BEHIND_THE_STRIP, rel=3e-5) and not braked.warnings
    knocked = jc.simulate(with_own(Knock, 0.0), 5.0, save=save)
    assert speed(knocked) == pytest.approx(1e3 * 1e-3 / MASS, rel=1e-5)


def test_steps_of_fixed_length_say_what_they_pass_over():
    """Of a load of the user's own, too."""
    for rig, duration, step, name in (
        (pushed(pulse), 60.0, 5e-3, "push"),
        (with_own(Strip, 6.0), 1.0, 1e-3, "own"),
    ):
        run = jc.simulate(rig, duration, save=3, integrator=jc.integrator.FixedStep(step))
        assert [f'of the impulse of "{name}"' in said for said in run.warnings].count(True) == 1


@pytest.mark.parametrize(("load", "initial"), [(Strip, 6.0), (Knock, 0.0)])
def test_a_load_of_the_users_own_is_felt_in_a_program_of_the_user_too(load, initial):
    """Or said to be passed over, by steps of fixed length; the numbers are those of the run alone,
    of the strip by its work, of the knock by its impulse."""

    def run(mass, integrator):
        rig = eqx.tree_at(lambda rig: rig.bodies["cart"].mass, with_own(load, initial), mass)
        return jc.simulate(rig, 5.0, save=101, integrator=integrator, throw=False, verify=False)

    after = BEHIND_THE_STRIP if load is Strip else 1.0 / MASS
    felt = jax.jit(lambda mass: run(mass, jc.integrator.Adaptive()).speed("G")[-1])
    assert float(felt(MASS)) == pytest.approx(after, rel=1e-4)
    steps = jc.integrator.FixedStep(5e-3 if load is Knock else 1e-3)
    share = jax.jit(lambda mass: run(mass, steps).invariants.figures[Check.LOAD_STEP].worst[0])
    known = run(MASS, steps).invariants.figures[Check.LOAD_STEP].worst[0]
    assert float(share(MASS)) == pytest.approx(float(known), rel=0.05) and known > 0.005


def test_slopes_of_a_short_push_are_those_of_its_impulse():
    """Of impulse over mass, by mass."""
    after = lambda mass: jc.simulate(pushed(pulse, mass), 60.0, save=6, throw=False).speed("G")[-1]
    slope = jax.jvp(after, (MASS,), (1.0,))[1]
    assert float(slope) == pytest.approx(-impulse(pulse, 60.0) / MASS**2, rel=1e-4)
