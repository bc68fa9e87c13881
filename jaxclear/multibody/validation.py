"""What a mechanism is refused for, in sentences that name the body, joint, load or coupling and say
what would be right.

A part checks itself when it is built; here is what needs the other parts: names, what a slot holds,
numbers that were changed afterwards, drives, loads and starts that fit the tree, and what loads and
drives of a user's own class answer, looked at once by shapes alone.
"""

import dataclasses
import itertools
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.components.beam import Beam
from jaxclear.components.body import GROUND, Body, Connection, Marker
from jaxclear.components.clearance import AbstractClearance
from jaxclear.components.coupling import (
    AbstractCoordinateCoupling,
    AbstractCoupling,
    AbstractForceCoupling,
)
from jaxclear.components.drive import AbstractDrive
from jaxclear.components.joint import AbstractJoint, AbstractRubbingJoint, Revolute
from jaxclear.components.joint.base import drive_of
from jaxclear.components.load import (
    AbstractBodyLoad,
    AbstractCoordinateLoad,
    AbstractJointLoad,
    AbstractLoad,
    AbstractStateLoad,
    Action,
    CoordinateEffect,
    Effect,
    Gravity,
    JointEffect,
    JointMotion,
    MarkerMotion,
)
from jaxclear.components.load_base import acts_on_coordinates
from jaxclear.ground.arguments import check_name, expect
from jaxclear.ground.pose import Pose
from jaxclear.ground.quantity import check_kinds, check_range, is_one_number, is_traced, numbers
from jaxclear.ground.warning import call_user, shape_of, warn
from jaxclear.ground.wording import listed, meant
from jaxclear.laws.stiffness import fitted
from jaxclear.multibody.contact_point import check_followed
from jaxclear.multibody.meshes import (
    drawn_pose,
    is_distance_free,
    markers,
    rolls_on_its_carriers_base,
)
from jaxclear.multibody.pose_rows import check_rows
from jaxclear.multibody.topology import MOTOR, Topology, coordinate_joint, motors

NUMBER = jax.ShapeDtypeStruct((), jnp.float64)
VECTOR = (NUMBER,) * 3
MARKER_MOTION = MarkerMotion(Pose((VECTOR,) * 3, VECTOR), VECTOR, VECTOR)
IN_JOINT = JointMotion(Pose((VECTOR,) * 3, VECTOR), VECTOR, VECTOR)
ON_COORDINATE = ("generalised force", "stored energy", "dissipated power", "external power")
MOTION = ("position", "speed", "acceleration")
# Instants [s] at which rates are looked at, which no period divides; and how near they are.
INSTANTS, CLOSE = (0.0137, 0.113, 0.371), 1e-6


def check_user_drive(name: str, drive: AbstractDrive | None) -> None:
    """Raises `ValueError` with a sentence where the drive of a joint answers something else than
    its motion."""
    if drive is not None and is_users(drive):
        what = f'the drive of joint "{name}", its motion(time),'
        shape_of(lambda time: _numbers(what, call_user(what, drive.motion, time), MOTION), NUMBER)
        if not is_traced(drive):
            _check_rates(name, drive)


def _check_rates(name: str, drive: AbstractDrive) -> None:
    """Raises `ValueError` where the speed of a drive is not the rate of its position, or its
    acceleration not that of its speed, at any of a few instants."""
    motion = lambda time: tuple(jnp.asarray(part, float) for part in drive.motion(time))
    # Also where something else is being traced.
    with jax.ensure_compile_time_eval():
        looks = [jax.jvp(motion, (time,), (1.0,)) for time in INSTANTS]
    for below, above in itertools.pairwise(range(3)):
        rates = [(float(result[above]), float(rate[below])) for result, rate in looks]
        if all(abs(report - rate) > CLOSE * (abs(report) + abs(rate)) for report, rate in rates):
            (report, rate), time = rates[0], INSTANTS[0]
            raise ValueError(
                f'the drive of joint "{name}", its motion(time), returns the {MOTION[above]} '
                f"{report:.6g} at {time:g} s, where its {MOTION[below]} changes by {rate:.6g} a "
                "second; each must be the rate of the one before."
            )


def check_user_load(name: str, load: Any) -> None:
    """The same of a load and its effect, or force."""
    if not is_users(load):
        return
    if isinstance(load, AbstractJointLoad):
        what, states = f'load "{name}", its act(time, motion, states),', load.states()
        describe = lambda *at: _check_joint_effect(what, call_user(what, load.act, *at), states)
        shape_of(describe, NUMBER, IN_JOINT, (NUMBER,) * len(states))
    elif isinstance(load, AbstractStateLoad) and not isinstance(load, AbstractCoordinateLoad):
        kind = "coupling" if isinstance(load, AbstractForceCoupling) else "load"
        what = f'{kind} "{name}", its effect(time, positions, speeds, states),'
        count, states = len(load.coordinates()), (NUMBER,) * len(load.states())
        view = (NUMBER,) * count
        describe = lambda *at: _on_coordinates(what, call_user(what, load.effect, *at), load)
        shape_of(describe, NUMBER, view, view, states)
    if isinstance(load, AbstractCoordinateLoad):
        what = f'load "{name}", its force(time, position, speed),'
        describe = lambda *at: _numbers(what, call_user(what, load.force, *at), ON_COORDINATE)
        shape_of(describe, NUMBER, NUMBER, NUMBER)
    if isinstance(load, AbstractBodyLoad):
        what, markers = f'load "{name}", its effect(time, motions),', load.markers()
        describe = lambda *at: _check_body_effect(what, call_user(what, load.effect, *at), markers)
        shape_of(describe, NUMBER, (MARKER_MOTION,) * len(markers))


def _on_coordinates(what: str, effect: Any, load: Any) -> None:
    expect(effect, CoordinateEffect, f"{what} returns what", "a jaxclear.load.CoordinateEffect")
    target = (("forces", load.coordinates()), ("rates", [x.name for x in load.states()]))
    for part, names in target:
        _numbers(f"{what} the {part}", tuple(getattr(effect, part)), tuple(names))
    _numbers(what, effect[2:], CoordinateEffect._fields[2:])


def _check_joint_effect(what: str, effect: Any, states: tuple) -> None:
    expect(effect, JointEffect, f"{what} returns what", "a jaxclear.load.JointEffect")
    _numbers(f"{what} the force,", tuple(effect.force), "xyz")
    _numbers(f"{what} the torque,", tuple(effect.torque), "xyz")
    _numbers(f"{what} the rates", tuple(effect.rates), tuple(x.name for x in states))
    loss = 0 if effect.dissipated is None else effect.dissipated
    _numbers(what, (effect.stored, loss, effect.external), JointEffect._fields[3:])


def is_users(part: Any) -> bool:
    """Whether a part is of a class from outside this package."""
    return type(part).__module__.partition(".")[0] != __name__.partition(".")[0]


def _check_body_effect(what: str, effect: Any, markers: tuple[Marker, ...]) -> None:
    expect(effect, Effect, f"{what} returns what", "a jaxclear.load.Effect")
    for order, action in enumerate(effect.actions):
        expect(action, Action, f"{what} returns an action that", "a jaxclear.load.Action")
        try:
            action.place_among(markers, order)
        except ValueError as error:
            raise ValueError(f"{what} returns {error}") from None
        _numbers(f"{what} an action's force,", action.force, "xyz")
        _numbers(f"{what} an action's torque,", action.torque, "xyz")
    _numbers(what, effect[1:], Effect._fields[1:])


def _numbers(what: str, result: Any, names: Any) -> None:
    """Raises `ValueError` where what was found is not one number for each name."""
    several = isinstance(result, (tuple, list)) or getattr(result, "ndim", 0) == 1
    parts = list(result) if several else [result]
    if len(parts) != len(names) or not all(map(is_one_number, parts)):
        count = len(parts) if all(map(is_one_number, parts)) else "no"
        raise ValueError(
            f"{what} returns {count} number{'s' * (count != 1)}; it must return {len(names)}: "
            f"{', '.join(names)}."
        )


def check_parts(bodies: dict, connections: dict, loads: dict, couplings: dict) -> None:
    """Raises `ValueError` for parts of a wrong type, unknown names or impossible numbers.

    Args:
        bodies, connections, loads, couplings: parts of the mechanism, each by name.
    """
    if not bodies:
        raise ValueError("a mechanism needs at least one body.")
    if GROUND in bodies:
        raise ValueError(
            f'"{GROUND}" is the fixed frame and cannot be a body; choose another name.'
        )
    for name, body in bodies.items():
        expect(body, (Body, Beam), f'body "{name}"', "a jaxclear.Body or a jaxclear.Beam")
        _check_slots(f'body "{name}"', body)
        check_values(f'body "{name}"', body)
    for name, connection in connections.items():
        _check_connection(name, connection, bodies)
    for name, coupling in couplings.items():
        expect(coupling, AbstractCoupling, f'coupling "{name}"', "one of jaxclear.coupling")
        _check_slots(f'coupling "{name}"', coupling)
        check_values(f'coupling "{name}"', coupling)
    values = _check_motor_names(bodies, connections, couplings)
    for name, load in loads.items():
        _check_load(name, load, bodies, connections, values)
        if isinstance(load, AbstractStateLoad):
            _check_motors(name, load, couplings)
            _check_pressed(name, load, loads, couplings)
        if name in couplings and isinstance(load, AbstractStateLoad):
            raise ValueError(
                f'"{name}" is a coupling and a load; both may have states, so give one of them '
                "another name."
            )
    if sum(isinstance(load, Gravity) for load in loads.values()) > 1:
        raise ValueError("a mechanism has more than one load.Gravity; give one.")
    _check_reach(bodies, connections)


def _check_connection(name: str, connection: Any, bodies: dict) -> None:
    expect(connection, Connection, f'joint "{name}"', "a jaxclear.Connection")
    joint = connection.joint
    target = "one of jaxclear.joint or jaxclear.clearance"
    expect(joint, (AbstractJoint, AbstractClearance), f'joint "{name}"', target)
    _check_slots(f'joint "{name}"', joint)
    check_values(f'joint "{name}"', joint)
    for side, marker in (("parent", connection.parent), ("child", connection.child)):
        _check_body(f'joint "{name}" refers to', marker.body, bodies)
        _check_slots(f'the {side} marker of joint "{name}"', marker)
        check_values(f'the {side} marker of joint "{name}"', marker)
    if connection.parent.body == connection.child.body:
        raise ValueError(
            f'joint "{name}" joins "{connection.parent.body}" to itself; it needs two bodies.'
        )
    check_user_drive(name, drive_of(joint))
    if isinstance(joint, AbstractJoint):
        check_rows(name, joint)
    if isinstance(joint, AbstractClearance):
        try:
            plain = _with_numpy_leaves(joint)
            for laws in plain.contact_laws():
                # What a law asks of a shape hangs on its form: no number is worked out.
                eqx.filter_eval_shape(fitted, laws.contact, laws.shape)
                if laws.contact.reach is not None and plain.gap_load(name) is None:
                    raise ValueError(
                        f"contact.{type(laws.contact).__name__} is for a PlanarJournalBearing with "
                        "a film=, whose asperities carry what the film does not."
                    )
            check_followed(plain)
        except ValueError as error:
            raise ValueError(f'joint "{name}": {error}') from None


def _with_numpy_leaves(tree: Any) -> Any:
    """The same with numbers that NumPy computes with: JAX would compile each operation."""
    evaluate = lambda leaf: isinstance(leaf, jax.Array) and not isinstance(leaf, jax.core.Tracer)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[()] if evaluate(leaf) else leaf, tree)


def _check_motor_names(bodies: dict, connections: dict, couplings: dict) -> list[str]:
    """Names of motors. Raises `ValueError` where a joint or a body has such a name."""
    result = [*motors(couplings)]
    for name in result:
        if name in connections or name in bodies:
            what = "joint" if name in connections else "body"
            raise ValueError(
                f'"{name}" is a {what}, and what the motor of coupling '
                f'"{name.removesuffix(MOTOR)}" goes by; give one of them another name.'
            )
    return result


def _check_load(name: str, load: Any, bodies: dict, connections: dict, values: list[str]) -> None:
    expect(load, AbstractLoad, f'load "{name}"', "one of jaxclear.load")
    _check_slots(f'load "{name}"', load)
    check_values(f'load "{name}"', load)
    check_user_load(name, load)
    if isinstance(load, AbstractBodyLoad):
        markers = load.markers()
        for marker in markers:
            _check_body(f'load "{name}" acts on', marker.body, bodies)
        if markers and all(marker.body == GROUND for marker in markers):
            raise ValueError(
                f'load "{name}" acts on "{GROUND}" alone, which nothing moves; put a marker of it '
                f"on one of the bodies {listed(bodies)}."
            )
    if isinstance(load, AbstractJointLoad):
        check_name("joint", load.connection, connections, f' for load "{name}" to act in')
    if isinstance(load, AbstractStateLoad):
        for place in load.coordinates():
            _check_acts(name, place, bodies, connections, values)


def _check_motors(name: str, load: AbstractStateLoad, couplings: dict) -> None:
    """That one motor at most turns the joint on whose motor a load acts, and one where it must."""
    joint = load.motor_of()
    turning = [n for n, c in couplings.items() if c.motor is not None and joint in c.joints()]
    if joint is None:
        return
    if load.needs_motor() and not turning:
        raise ValueError(
            f'load "{name}" reads the encoder of the motor of joint "{joint}", which no '
            'coupling.Motor turns; give the joint a coupling with one, or encoder="load".'
        )
    if len(turning) > 1:
        raise ValueError(
            f'load "{name}" acts on the motor of joint "{joint}", which the motors of '
            f"{listed(turning)} turn; take a load of your own on one of them."
        )


def _check_pressed(name: str, load: AbstractStateLoad, loads: dict, couplings: dict) -> None:
    """That what presses a load is there, and has a force at an instant in every integrator."""
    by = load.pressed_by()
    if by is None:
        return
    acting = {n: part for n, part in loads.items() if acts_on_coordinates(part)}
    check_name("load or coupling", by, [*acting, *couplings], f' to press load "{name}"')
    coupling, presser = couplings.get(by), acting.get(by)
    if coupling is not None and not (coupling.gives or isinstance(coupling, AbstractForceCoupling)):
        raise ValueError(
            f'load "{name}" is pressed by coupling "{by}", which is rigid and has no force at an '
            "instant; give it stiffness."
        )
    if presser is not None and (presser.sides() or presser.dry_friction() is not None):
        raise ValueError(
            f'load "{name}" is pressed by load "{by}", a {type(presser).__name__}, whose force '
            "steps find; put a spring (load.JointSpring) or a torque in its place."
        )


def _check_acts(name: str, place: str, bodies: dict, connections: dict, values: list[str]) -> None:
    """That a load may act on the coordinate of a joint, or of a motor."""
    if place in values:
        return
    part = f' for load "{name}" to act on'
    check_name("joint", place, [*connections, *values] if values else connections, part)
    joint = one_coordinate(
        f'load "{name}" acts on',
        place,
        bodies,
        connections,
        " Put the load on markers (jaxclear.load.Torque) or on another joint.",
    )
    if drive_of(joint) is not None:
        raise ValueError(
            f'load "{name}" acts on joint "{place}", whose coordinate is driven; leave '
            "the drive out, or put the load on markers (jaxclear.load.Torque) or on another joint."
        )


def one_coordinate(what: str, name: str, bodies: dict, connections: dict, else_: str = "") -> Any:
    """The joint `name` as its single coordinate is read.

    Args:
        what: begins the message: who reads the coordinate.
        name: connection, body or motor.
        bodies, connections: parts of the mechanism, each by name.
        else_: ends the message: what would be right.

    Raises:
        ValueError: there is no such joint, or it has not exactly one coordinate.
    """
    try:
        joint = coordinate_joint(name, bodies, connections)
    except ValueError as error:
        raise ValueError(f'{what} joint "{name}", which {error}') from None
    if len(joint.home) != 1:
        raise ValueError(
            f'{what} the coordinate of joint "{name}", which must have one, of turning or sliding; '
            f"it has {len(joint.home)}.{else_}"
        )
    return joint


def _check_body(what: str, body: str, bodies: dict) -> None:
    if body not in bodies and body != GROUND:
        raise ValueError(
            f'{what} body "{body}", which does not exist: the bodies are {listed(bodies)} and '
            f'"{GROUND}".{meant(body, [*bodies, GROUND])}'
        )


def _check_reach(bodies: dict, connections: dict) -> None:
    reached, frontier = {GROUND}, [GROUND]
    while frontier:
        body = frontier.pop()
        for connection in connections.values():
            ends = [connection.parent.body, connection.child.body]
            if body in ends:
                other = ends[1 - ends.index(body)]
                if other not in reached:
                    reached.add(other)
                    frontier.append(other)
    loose = [body for body in bodies if body not in reached]
    if loose:
        raise ValueError(
            f"no chain of joints leads from the ground to {', '.join(map(repr, loose))}; connect "
            'it, or let it float with jaxclear.joint.Free() from "ground".'
        )


def _check_slots(what: str, module: eqx.Module) -> None:
    """Fields must hold what they are declared to, also where one was changed after its part was
    built.
    """
    check_kinds(lambda: what, module)
    for field in dataclasses.fields(module):
        value = getattr(module, field.name)
        if isinstance(value, eqx.Module):
            _check_slots(f"{what.removesuffix(',')}, {field.name},", value)


def check_values(what: str, part: Any) -> None:
    """Numbers must be finite and within their ranges, also where one was changed after its part was
    built.
    """
    for path, leaf, metadata in numbers(part):
        if "unit" in metadata:
            check_range(lambda: what, path, leaf, metadata)
        else:
            check_finite(f"{what}, {path},", leaf)


def check_finite(what: str, part: Any) -> None:
    """Numbers must be finite; those that are being traced are not known."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(part):
        if not eqx.is_array(leaf) or isinstance(leaf, jax.core.Tracer):
            continue
        if not (math.isfinite(float(leaf)) if leaf.ndim == 0 else np.all(np.isfinite(leaf))):
            name = jax.tree_util.keystr(path).removeprefix(".")
            raise ValueError(f"{what} has {name} = {leaf}; it must be a finite number.")


def check_tree(topology: Topology, connections: dict, loads: dict) -> None:
    """Raises `ValueError` for drives that close loops and inertias on coordinates outside the tree.

    Args:
        topology: with the tree that was grown.
        connections, loads: parts of the mechanism, each by name.
    """
    for name in topology.closing:
        if drive_of(connections[name].joint) is not None:
            raise ValueError(
                f'joint "{name}" is driven but closes a loop of driven joints; a loop can follow '
                "one of them only."
            )
    for name, load in loads.items():
        if not isinstance(load, AbstractStateLoad) or load.inertia_along() is None:
            continue
        (place,) = load.coordinates()
        if topology.branch_of(place) is None and place not in dict(topology.geared):
            why = "has clearance" if place in topology.clearances else "closes a loop"
            raise ValueError(
                f'load "{name}" is an inertia on the coordinate of joint "{place}", '
                f"which {why}; only a joint that the tree carries can have it. Take the load out "
                "(mechanism.with_loads), and add its inertia to a body if it matters."
            )


def check_start(
    topology: Topology, bodies: dict, connections: dict, places: dict, speeds: dict
) -> None:
    """Raises `ValueError` for starting values of what has no coordinates, or in a wrong number.

    Args:
        topology: with the motors.
        bodies, connections: parts of the mechanism, each by name.
        places: coordinates under "start" and "guess", each by name.
        speeds: by name.
    """
    present = tuple(branch.name for branch in topology.branches if branch.motor)
    for what, place in places.items():
        for name, values in place.items():
            joint = _find_joint_with_coordinates(what, name, bodies, connections, present)
            try:
                joint.start(values)
            except ValueError as error:
                raise ValueError(f'{what} of "{name}" {error}') from None
    for name, values in speeds.items():
        joint = _find_joint_with_coordinates("speeds", name, bodies, connections, present)
        width = len(joint.columns(joint.home))
        if len(values) != width:
            many = f"{width} number{'s' * (width != 1)}"
            raise ValueError(f'speeds of "{name}" need {many}, not {len(values)}.')


def _find_joint_with_coordinates(
    what: str, name: str, bodies: dict, connections: dict, values: tuple[str, ...]
) -> AbstractJoint:
    if name in values:
        return Revolute()
    if name not in connections and name not in bodies:
        raise ValueError(
            f'{what} names "{name}", which carries no coordinates; it may name the joints '
            f"{listed(connections)} and the bodies {listed(bodies)}."
            + meant(name, [*connections, *bodies])
        )
    try:
        joint = coordinate_joint(name, bodies, connections)
    except ValueError as error:
        raise ValueError(f'{what} names "{name}", which {error}') from None
    if not joint.home or drive_of(joint) is not None:
        raise ValueError(
            f'{what} names "{name}", whose motion is prescribed or fixed; leave it out.'
        )
    return joint


# Beside factors of couplings [1].
ROUNDING = 1e-9


def check_couplings(couplings: dict, topology: Topology, bodies: dict, connections: dict) -> None:
    """Raises `ValueError` for a coupling of joints that there are not, or that do not fit.

    Args:
        couplings: by name.
        topology: which joints the tree carries.
        bodies, connections: parts of the mechanism, each by name.
    """
    _warn_of_locks(couplings)
    for name, coupling in couplings.items():
        if name in connections and (name in topology.couplings or coupling.motor is None):
            raise ValueError(f'"{name}" is a coupling and a joint; give one of them another name.')
        names = coupling.joints()
        for joint in names:
            if names.count(joint) > 1:
                raise ValueError(
                    f'coupling "{name}" names joint "{joint}" twice; it couples different joints.'
                )
            check_name("joint", joint, connections, f' for coupling "{name}"')
        if isinstance(coupling, AbstractForceCoupling):
            _check_forces(name, coupling, couplings, bodies, connections)
            continue
        if coupling.play is not None and coupling.play.wear is not None:
            _check_flanks(name, coupling, bodies, connections)
        if isinstance(coupling, AbstractCoordinateCoupling) or coupling.motor is not None:
            if coupling.motor is not None:
                coupling.terms()
            _check_coordinates(name, coupling, topology, bodies, connections)
            continue
        first, second = markers(coupling, connections)
        if first.body == second.body:
            raise ValueError(
                f'coupling "{name}" ties body "{first.body}" to itself; its joints '
                f"{listed(names)} carry one body."
            )
        _check_moves(name, coupling, bodies, connections)
        if not is_traced((coupling, bodies, connections)):
            try:
                drawn = drawn_pose(coupling, bodies, connections)
                coupling.check(drawn)
                if rolls_on_its_carriers_base(coupling, connections):
                    coupling.check_rolling(drawn)
            except ValueError as error:
                raise ValueError(f'coupling "{name}" {error}') from None
            _warn_of_distant_wheels(name, coupling, topology, bodies, connections)


def _check_flanks(name: str, coupling: Any, bodies: dict, connections: dict) -> None:
    """That it is known with what flanks that wear slide, and with which lever they press."""
    summed = isinstance(coupling, AbstractCoordinateCoupling) or coupling.motor is not None
    if not summed and coupling.has_linear_play:
        raise ValueError(
            f'coupling "{name}" has a play that wears and is seen along the axis of a '
            f"{type(coupling).__name__} of two bodies, where no one coordinate tells how it "
            "slides; leave its wear out."
        )
    first = coupling.terms()[0].joint if summed else coupling.play_joint()
    turns = True
    if isinstance(first, str):
        check_name("joint", first, connections, f' for coupling "{name}"')
        what = f'coupling "{name}" has a play that wears along'
        turns = one_coordinate(what, first, bodies, connections).units == ("rad",)
    if turns != (coupling.play.pitch_radius is not None):
        names = "an angle: give its play the pitch_radius at which flanks press"
        raise ValueError(
            f'the play of coupling "{name}" wears and is '
            f"{names if turns else 'a length: leave its pitch_radius out'}."
        )
    joint = connections[name].joint if name in connections else None
    if isinstance(joint, (AbstractClearance, AbstractRubbingJoint)) and joint.maps():
        raise ValueError(
            f'"{name}" is a coupling whose play wears and a joint that wears; give one of them '
            "another name."
        )


def _warn_of_distant_wheels(
    name: str, coupling: Any, topology: Topology, bodies: dict, connections: dict
) -> None:
    """Warns where nothing holds two wheels as far apart as they are drawn; loops may."""
    wheels = len(coupling.joints()) == 2 and coupling.moves() == (("rad",), ("rad",))
    if wheels and not topology.closing and is_distance_free(coupling, bodies, connections):
        warn(
            f'coupling "{name}" ties the wheels of joints {listed(coupling.joints())}, which no '
            "body carries together: the distance of their axes changes as others move, and they "
            "mesh only as drawn. Put both joints on one body, or couple coordinates (coupling."
            "Ratio)."
        )


def _check_forces(
    name: str, coupling: Any, couplings: dict, bodies: dict, connections: dict
) -> None:
    """That the joints of a coupling that is a force have one coordinate each, one of them at least
    free, and its motors are there."""
    check_user_load(name, coupling)
    values, driven = _check_motor_names(bodies, connections, couplings), []
    for place in coupling.coordinates():
        if place not in coupling.joints():
            check_name("motor", place, values, f' for coupling "{name}"')
            continue
        joint = one_coordinate(f'coupling "{name}" speaks of', place, bodies, connections)
        driven += [place] if drive_of(joint) is not None else []
    if len(driven) == len(coupling.coordinates()):
        raise ValueError(
            f'coupling "{name}" ties joints {listed(driven)}, all of which are driven; leave one '
            "of the drives out."
        )


def _warn_of_locks(couplings: dict) -> None:
    """Warns where sums of coordinates, each of two or more joints, leave a joint one place only."""
    part = {
        n: c.terms()
        for n, c in couplings.items()
        if isinstance(c, AbstractCoordinateCoupling) and not c.gives and c.motor is None
    }
    if len(part) < 2 or is_traced(part):
        return
    joints = list(dict.fromkeys(term.joint for terms in part.values() for term in terms))
    rows = np.zeros((len(part), len(joints)))
    for row, terms in zip(rows, part.values(), strict=True):
        for joint, factor in terms:
            row[joints.index(joint)] = float(factor)
    for place, joint in zip(np.eye(len(joints)), joints, strict=True):
        shares = np.linalg.lstsq(rows.T, place, rcond=None)[0]
        tying = [n for n, share in zip(part, shares, strict=True) if abs(share) > ROUNDING]
        if len(tying) > 1 and np.allclose(rows.T @ shares, place, atol=ROUNDING):
            warn(
                f'couplings {listed(tying)} together leave joint "{joint}" one place only: they '
                "contradict each other in motion, and nothing that they tie can move. Leave one of "
                "them out."
            )
            return


def _check_moves(name: str, coupling: Any, bodies: dict, connections: dict) -> None:
    """That the joints leave free what the coupling ties; a part may be held by a fixed one."""
    names = {"rad": "turn", "m": "slide"}
    for joint, needed in zip(coupling.joints(), coupling.moves(), strict=True):
        ideal = coordinate_joint(joint, bodies, connections)
        rest = [names[unit] for unit in needed if unit not in ideal.units]
        if rest and ideal.units:
            raise ValueError(
                f'coupling "{name}", a {type(coupling).__name__}, needs a joint "{joint}" whose '
                f"parts {' and '.join(names[unit] for unit in needed)}; those of a "
                f"{type(connections[joint].joint).__name__} do not {' and '.join(rest)}."
            )


def _check_coordinates(
    name: str, coupling: Any, topology: Topology, bodies: dict, connections: dict
) -> None:
    """That the joints have one coordinate each, of which one at least is free, and one at most is
    an angle outside the tree."""
    driven, uncounted = [], []
    for place in coupling.joints():
        joint = one_coordinate(f'coupling "{name}" speaks of', place, bodies, connections)
        driven += [place] if drive_of(joint) is not None else []
        outside = topology.branch_of(place) is None
        uncounted += [place] if outside and joint.units == ("rad",) else []
    if len(driven) == len(coupling.joints()) and coupling.motor is None:
        raise ValueError(
            f'coupling "{name}" ties joints {listed(driven)}, all of which are driven; leave one '
            "of the drives out."
        )
    if len(uncounted) > 1:
        raise ValueError(
            f'coupling "{name}" ties joints {listed(uncounted)}, whose whole turns are not counted '
            "because the tree does not carry them (they have clearance or close loops); one at "
            "most may be such a joint. Couple the bodies in their place (jaxclear.coupling.Gear)."
        )
