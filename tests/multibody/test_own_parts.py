"""A load or drive of a user's own that answers something else than what the equations take, or no
number, is refused by its name; what acts on nothing is too."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jaxclear.load import Action, Effect

import jaxclear as jc

BODY = jc.Body(1.0, 1e-2, (0.1, 0.0))
TIP, GROUND = jc.Marker("arm", (0.2, 0.0)), jc.Marker("ground")
ZERO = (0.0, 0.0, 0.0)
STEP = jc.integrator.FixedStep(1e-4)


def arm(drive=None, **changes):
    pin = jc.Connection(jc.joint.Revolute(drive=drive), "ground", "arm")
    return jc.Mechanism({"arm": BODY}, {"pin": pin}, **changes)


class Push(jc.load.AbstractBodyLoad):
    told: Any = eqx.field(static=True)

    def markers(self):
        return (TIP, GROUND)

    def effect(self, time, motions):
        return self.told(time, motions)


class Turn(jc.load.AbstractCoordinateLoad):
    connection: str = eqx.field(static=True)
    told: Any = eqx.field(static=True)

    def force(self, time, position, speed):
        return self.told(time, position, speed)


class Motion(jc.drive.AbstractDrive):
    told: Any = eqx.field(static=True)

    def motion(self, time):
        return self.told(time)


def both(force, torque=ZERO):
    return Effect((Action(TIP, force, torque), Action(GROUND, ZERO, ZERO)), 0, 0, 0)


ANSWERS = {
    "a marker that it has not": (
        Push(lambda t, m: Effect((Action(jc.Marker("rod"), ZERO, ZERO),), 0, 0, 0)),
        'an action on a marker on "rod", of which its markers.. has none',
    ),
    "a plane force": (
        Push(lambda t, m: both((1.0, 0.0))),
        "force, returns 2 numbers; .*return 3: x, y",
    ),
    "a force": (Push(lambda t, m: ZERO), "returns what is .*; it must be a jaxclear.load.Effect"),
    "a tuple for an action": (
        Push(lambda t, m: Effect((ZERO, ZERO), 0, 0, 0)),
        "an action that is .*must be a jaxclear.load.Action",
    ),
    "no energy": (Push(lambda t, m: both(ZERO)._replace(stored=None)), "returns no numbers"),
    "float": (Push(lambda t, m: both((float(t), 0.0, 0.0))), 'leaves JAX in ".*float'),
    "a slip": (Push(lambda t, m: m[0].position), "fails in .*AttributeError.*position"),
    "one number": (
        Turn("pin", lambda t, q, v: -q),
        "returns 1 number; it must return 4: generalised force",
    ),
    "an array": (Turn("pin", lambda t, q, v: jnp.zeros(2)), "returns 2 numbers"),
    "float of a coordinate": (Turn("pin", lambda t, q, v: (float(q), 0, 0, 0)), "leaves JAX"),
    "a drive's two": (
        Motion(lambda t: (t, 1.0)),
        "returns 2 numbers; it must return 3: position, speed",
    ),
    "a drive's float": (Motion(lambda t: (float(t), 1.0, 0.0)), "leaves JAX"),
}


@pytest.mark.parametrize("name", ANSWERS)
def test_a_part_that_answers_something_else_is_refused_by_its_name(name):
    part, sentence = ANSWERS[name]
    driven = isinstance(part, Motion)
    place = 'drive of joint "pin"' if driven else 'load "push"'
    with pytest.raises(ValueError, match=f"{place}.*{sentence}"):
        arm(part) if driven else arm(loads={"push": part})


def test_what_answers_as_it_must_is_taken():
    assert arm(loads={"push": Push(lambda t, m: both((t, 0.0, np.float64(1.0)), (0, 0, t)))})
    assert arm(loads={"push": Turn("pin", lambda t, q, v: [-q, 0.5 * q * q, 0, 0])})
    assert arm(Motion(lambda t: (jnp.sin(t), jnp.cos(t), -jnp.sin(t))))


@pytest.mark.parametrize(
    "load",
    [
        jc.load.Force(GROUND, (1.0, 0.0)),
        jc.load.Spring(GROUND, jc.Marker("ground", (0.1, 0.0)), 10.0),
        jc.load.Torque(GROUND, 1.0),
    ],
)
def test_a_load_on_the_ground_is_refused(load):
    with pytest.raises(ValueError, match='load "push" acts on "ground" alone, which nothing moves'):
        arm(loads={"push": load})


NOWHERE = {
    "a drive at its start": (
        lambda: arm(jc.drive.Position(lambda t: jnp.sqrt(t))),
        'drive of joint "pin" is not finite at 0 s; its position, speed and acceleration must',
    ),
    "a drive of one's own": (lambda: arm(Motion(lambda t: (jnp.sqrt(t - 1), 0.0, 0.0))), "at 0 s"),
    "a drive on its way": (
        lambda: arm(jc.drive.Position(lambda t: jnp.sqrt(4e-4 - t))),
        'drive of joint "pin" is not finite at 0.0004',
    ),
    "a load on its way": (
        lambda: arm(loads={"push": jc.load.Force(TIP, lambda t: (jnp.log(4e-4 - t), 0.0))}),
        'load "push" is not finite at 0.0004.* s; what it gives must be finite',
    ),
    "a torque": (
        lambda: arm(loads={"push": jc.load.JointTorque("pin", lambda t: jnp.sin(t) / t)}),
        'load "push" is not finite at 0 s',
    ),
}


@pytest.mark.parametrize("name", NOWHERE)
@pytest.mark.parametrize("problem", [False, True])
def test_a_function_of_time_that_is_no_number_is_refused_before_a_run(name, problem, monkeypatch):
    def refused(*_):
        raise AssertionError("it is assembled before its functions of time are looked at")

    monkeypatch.setattr("jaxclear.simulation.simulate.beginning", refused)
    monkeypatch.setattr("jaxclear.studies.run_experiment.sampled", refused)
    build, sentence = NOWHERE[name]
    mass = {"mass": jc.Variable(lambda rig: rig.bodies["arm"].mass, tolerance=0.1)}
    more = {"duration": 1e-3, "save": 3, "integrator": STEP}
    with pytest.raises(ValueError, match=sentence):
        if problem:
            jc.Problem(build(), lambda run: run.ended, mass, **more)
        else:
            jc.simulate(build(), **more)


def test_a_run_that_a_load_of_ones_own_ends_names_it():
    lost = Turn("pin", lambda t, q, v: (jnp.sqrt(1e-4 - q), 0, 0, 0))
    rig = arm(loads={"gravity": jc.load.Gravity(), "push": lost}, speeds={"pin": 1.0})
    with pytest.raises(jc.SimulationError, match='What load "push" gives is not finite'):
        jc.simulate(rig, 1e-3, save=3, integrator=STEP)


class DoubledAcceleration(jc.drive.AbstractDrive):
    def motion(self, time):
        return jnp.sin(time), jnp.cos(time), -2.0 * jnp.sin(time)


def test_a_drive_whose_acceleration_is_not_the_rate_of_its_speed_is_refused():
    """Its loads were called too short for the steps, and shorter steps advised."""
    with pytest.raises(ValueError, match='joint "O".* acceleration .* must be the rate'):
        jc.Mechanism(
            {"crank": jc.Body(1.0, 0.1)},
            {"O": jc.Connection(jc.joint.Revolute(drive=DoubledAcceleration()), "ground", "crank")},
        )


class Apart(jc.load.AbstractBodyLoad):
    """Presses two carts apart, its actions in one order or the other, by markers of its own or new
    ones."""

    left: jc.Marker
    right: jc.Marker
    turned_round: bool = eqx.field(static=True)
    anew: bool = eqx.field(static=True)

    def markers(self):
        return (self.left, self.right)

    def effect(self, time, motions):
        left, right = self.markers()
        if self.anew:
            left, right = (
                jc.Marker(own.body, (0.0, 2 * (0.5 * own.at[1]))) for own in (left, right)
            )
        power = motions[1].velocity[0] * 4.0 - motions[0].velocity[0] * 2.0
        actions = Action(left, (-2.0, 0.0, 0.0), ZERO), Action(right, (4.0, 0.0, 0.0), ZERO)
        return Effect(actions[::-1] if self.turned_round else actions, 0, 0, power)


@pytest.mark.parametrize("anew", [False, True])
def test_an_action_moves_the_body_of_its_marker_whatever_the_order(anew):
    carts = {name: jc.Body(2.0, 1e-3) for name in ("left", "right")}
    slides = {name: jc.Connection(jc.joint.Prismatic(), "ground", name, axis="x") for name in carts}
    push = Apart(jc.Marker("left", (0.0, 0.1)), jc.Marker("right", (0.0, 0.2)), True, anew)
    run = jc.simulate(jc.Mechanism(carts, slides, {"push": push}), 0.5, save=2, integrator=STEP)
    ways = [float(np.ravel(run.coordinate(name))[-1]) for name in carts]
    np.testing.assert_allclose(ways, [-0.5 * 1.0 * 0.25, 0.5 * 2.0 * 0.25], rtol=1e-9)


def test_an_action_between_several_markers_of_its_body_names_one_of_them():
    near, far, other = (jc.Marker("arm", (x, 0.0)) for x in (0.1, 0.2, 0.3))
    assert Action(jc.Marker("arm", (0.2, 0.0)), ZERO, ZERO).place_among((near, far), 0) == 1
    assert Action(other, ZERO, ZERO).place_among((near, far), 1) == 1
    with pytest.raises(ValueError, match='marker on "arm", of which its markers.. has several'):
        Action(other, ZERO, ZERO).place_among((near, far), 2)
