"""Loads on coordinates whose force a step finds itself: rigid stops, and dry friction that sticks.

Where forces are percussions, or friction is set-valued, these loads have no force at an instant
(`OverStep`); they push or rub along the row of their coordinate, as contacts and joints do along
theirs. A stop with a stiffness and no restitution is a spring where steps resolve it, and rigid
where they do not: it then gives way by less than what acts moves it within a step.

Nothing here is evaluated in a mechanism without such loads.
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.clearance.backlash import middle_of
from jaxclear.components.function_of_time import value_at
from jaxclear.components.load_base import AbstractCoordinateLoad, AbstractStateLoad, Side
from jaxclear.formulations.model import Instant, Model
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part
from jaxclear.laws.rebound import restitution_of
from jaxclear.multibody import kinematics
from jaxclear.multibody.forces import Forces, as_pressed, read_coordinate, with_rows
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.rows import Direction, LinearRate, Row
from jaxclear.multibody.state import Followed, unpack_motion
from jaxclear.multibody.system import System, coordinate_loads
from jaxclear.multibody.transmissions import Pressing, twist_direction, twist_of
from jaxclear.multibody.tree import Motion

# Explicit steps h follow a spring up to h omega = 2 and a damper up to h d / m = 2; they are left
# to them up to a quarter of that.
FOLLOWED = 0.5


class OverStep(AbstractCoordinateLoad):
    """A load whose force steps find themselves."""

    connection: str = eqx.field(static=True)
    load: AbstractStateLoad

    def force(self, time, position, speed):
        return self.load.smooth_force(time, position, speed)

    def reads_position(self):
        return self.load.reads_position()

    def sides(self):
        return self.load.sides()

    def dry_friction(self):
        return self.load.dry_friction()

    def pressed_by(self):
        return self.load.pressed_by()

    def under(self, force):
        return dataclasses.replace(self, load=self.load.under(force))


class SolvedLoad(NamedTuple):
    """A load whose force a step solves for: the coordinate `on` which it acts, of a joint, a motor,
    or the twist of a coupling (then of no `load`), and the sides at which it stops that."""

    on: str
    sides: tuple[Side, ...]
    load: OverStep | None = None

    @property
    def rubs(self) -> bool:
        """Whether it has dry friction."""
        return self.load is not None and self.load.dry_friction() is not None

    def reading(
        self, system: System, motions: tuple[Motion, ...], followed: Followed
    ) -> tuple[Any, Direction]:
        """The coordinate [rad, m] on which the load acts, and the direction of a force along it.

        Args:
            system: prepared mechanism, as `prepare` returns it.
            motions: motion of every link at one instant, in the order of `system.links`.
            followed: angles over whole turns of joints outside the tree.
        """
        if self.load is not None:
            position, _, direction = read_coordinate(system, motions, self.on, followed)
            return position, direction
        flanks = system.flanks[self.on]
        direction = twist_direction(motions, flanks).times(1 / flanks.scale)
        return twist_of(motions, flanks).value, direction

    def friction(
        self, system: System, motions: tuple[Motion, ...], time: Any, followed: Followed
    ) -> Any:
        """Largest dry friction of the load [N m, N].

        Args:
            system: prepared mechanism, as `prepare` returns it.
            motions: motion of every link, for the force that presses it.
            time: instant [s].
            followed: what the state integrates beside the motion: whole-turn angles, load
                states, flanks.
        """
        load: Any = self.load
        return value_at(as_pressed(system, motions, load, time, followed).dry_friction(), time)


def with_solved_loads(system: System) -> System:
    """The system with stops and dry friction as loads whose force steps solve for."""
    replaced = {
        name: OverStep(load.coordinates()[0], load)
        for name, load in coordinate_loads(system)
        if load.sides() or load.dry_friction() is not None
    }
    return dataclasses.replace(system, loads=system.loads | replaced) if replaced else system


def check_solved_loads(mechanism: Mechanism, integrator: str, seated: bool) -> None:
    """Raises `ValueError` for a load whose force the integrator's steps cannot solve for.

    Such is one with an `effect` of its own beside stops or dry friction, and one that is pressed by
    what has no force at an instant.

    Args:
        mechanism: with its loads.
        integrator: name in the message.
        seated: whether plays count as seated; else their flanks are rigid.
    """
    for name, load in mechanism.loads.items():
        if not isinstance(load, AbstractStateLoad):
            continue
        by = mechanism.couplings.get(load.pressed_by() or "")
        if by is not None and by.play and (seated or by.play.restitution is not None):
            raise ValueError(
                f'load "{name}" is pressed by coupling "{load.pressed_by()}", whose play '
                f"{integrator} takes as {'seated' if seated else 'one between rigid flanks'}, so "
                "that it has no force at an instant; take Adaptive, FixedStep or ImplicitStep."
            )
        features = {"sides": bool(load.sides()), "dry_friction": load.dry_friction() is not None}
        kinds = type(load).__mro__
        first = lambda *names: next(
            (i for i, kind in enumerate(kinds) if not vars(kind).keys().isdisjoint(names)), 0
        )
        for what, finds in features.items():
            if finds and first("effect", "force") < first(what):
                raise ValueError(
                    f'load "{name}" is a {type(load).__name__} with an effect of its own, for '
                    f"which {integrator} does not ask: it takes {what}() of "
                    f"{kinds[first(what)].__name__}, and finds the force itself. Give the class "
                    f"{what}() too, or take Adaptive, FixedStep or ImplicitStep."
                )


def with_rigid_flanks(system: System) -> System:
    """The system whose plays with a restitution are between rigid flanks."""
    plays = {name: train.coupling.play for name, train in system.transmissions.items()}
    rigid = [name for name, play in plays.items() if play and play.restitution is not None]
    if not rigid:
        return system
    others = {n: train for n, train in system.transmissions.items() if n not in rigid}
    flanks = {name: system.transmissions[name] for name in rigid}
    return dataclasses.replace(system, transmissions=others, flanks=flanks)


def solved_loads(system: System) -> dict[str, SolvedLoad]:
    """Loads, then plays, whose force steps solve for, by the name under which states hold the
    impulse."""
    result = {
        impulse_of(name): SolvedLoad(load.connection, load.sides(), load)
        for name, load in coordinate_loads(system)
        if isinstance(load, OverStep)
    }
    for name, train in system.flanks.items():
        play: Any = train.coupling.play
        middle, half = middle_of(play), 0.5 * play.play
        sides = Side(1.0, middle - half, play), Side(-1.0, middle + half, play)
        result[f"play {name}"] = SolvedLoad(name, sides)
    return result


def may_strike(system: System) -> bool:
    """Whether something may strike: a contact, a coordinate its stop, or a flank the other."""
    return bool(system.bearings) or any(solved.sides for solved in solved_loads(system).values())


def load_components(system: System) -> tuple[tuple[str, int], ...]:
    """How many components what steps find the force of has in states that hold impulses."""
    return tuple((name, 1) for name in solved_loads(system))


def impulse_of(name: str) -> str:
    """What states call the impulse of a load: joints have names of their own."""
    return f"load {name}"


def with_loads(system: System, forces: Forces, solved_forces: dict[str, Any]) -> Forces:
    """The forces with those of loads that a step has solved for.

    Args:
        system: with the loads.
        forces: without them.
        solved_forces: by load [N m, N].
    """
    every = solved_loads(system)
    if not every:
        return forces
    motions, rows, pressing = forces.motions, [], dict(forces.pressing)
    for name, solved in every.items():
        direction = solved.reading(system, motions, forces.followed)[1]
        rows.append(Row(solved.on, direction, solved_forces[name]))
        if solved.load is None:
            torque, none = -solved_forces[name], (0.0, 0.0)
            torques = positive_part(torque), positive_part(-torque)
            twist = twist_of(motions, system.flanks[solved.on])
            pressing[solved.on] = Pressing(torque, None, 0.0, 0.0, twist, none, none, torques)
    return with_rows(forces._replace(pressing=pressing), rows)


def forces_of_means(instant: Instant) -> dict[str, Any]:
    """By its name the force [N m, N] of all that steps find it of, at a saved instant whose state
    holds impulses."""
    return {name: instant.means_of(name)[0] for name in solved_loads(instant.model.system)}


class StopInStep(NamedTuple):
    """A side of a stop in a step: its load, how far the coordinate is beyond it in the middle [rad,
    m], and the rate by which that falls."""

    name: str
    side: Side
    beyond: Any
    opening: LinearRate

    def spring(self) -> Any:
        """Force [N m, N] of what gives way there."""
        return self.side.stop.push(self.beyond, -self.opening.value)[0]

    def followed(self, lightness: Any, h: Any) -> Any:
        """Whether steps of length h [s] follow its spring and damper, which move an inertia of this
        inverse."""
        soft = h * h * self.side.stop.stiffness * lightness < FOLLOWED**2
        if self.side.stop.damping is not None:
            soft = soft & (h * self.side.stop.damping * lightness < FOLLOWED)
        return soft

    def restitution(self, lightness: Any) -> Any:
        """Share of its speed [1] that comes back where steps do not follow its spring."""
        if self.side.stop.restitution is not None:
            return self.side.stop.restitution
        if self.side.stop.damping is None:
            return 1.0
        ratio = 0.5 * self.side.stop.damping * jnp.sqrt(lightness / self.side.stop.stiffness)
        return restitution_of(ratio)


class RubInStep(NamedTuple):
    """Dry friction on a coordinate in a step: its load, largest size [N m, N], and the coordinate's
    speed."""

    name: str
    bound: Any
    sliding: LinearRate


class LoadsInStep(NamedTuple):
    """The loads of a step whose force it finds: sides of stops, then friction."""

    stops: tuple[StopInStep, ...]
    rubs: tuple[RubInStep, ...]

    @property
    def rates(self) -> list[LinearRate]:
        """Along their forces, those of stops as they open."""
        return [*(one.opening for one in self.stops), *(one.sliding for one in self.rubs)]

    def loss(self, forces: Any, change: list) -> Any:
        """Power [W] that these forces take at speeds that differ so from those at which the loads
        were read."""
        return sp.neg(sp.dot(forces, [rate.at(change) for rate in self.rates]))

    def by_load(self, system: System, values: Any) -> dict[str, Any]:
        """Forces or impulses along the rows, as sums by load."""
        sums = dict.fromkeys(solved_loads(system), 0.0)
        signs = [(one.name, one.side.sign) for one in self.stops]
        signs += [(one.name, 1.0) for one in self.rubs]
        for (name, sign), value in zip(signs, values, strict=True):
            sums[name] = sums[name] + sign * value
        return sums


NO_LOADS = LoadsInStep((), ())


def loads_in_step(
    system: System, motions: tuple[Motion, ...], time: Any, followed: Followed
) -> LoadsInStep:
    """Stops and dry friction of loads, read in the middle of a step.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        time: instant [s].
        followed: what the state integrates beside the motion: whole-turn angles, load states,
            flanks.
    """
    stops: list[StopInStep] = []
    rubs: list[RubInStep] = []
    for name, solved in solved_loads(system).items():
        position, direction = solved.reading(system, motions, followed)
        speed = direction.linear_rate(system, motions)
        if solved.rubs:
            rubs.append(RubInStep(name, solved.friction(system, motions, time, followed), speed))
        stops += [
            StopInStep(name, side, side.beyond(position), speed.times(side.sign))
            for side in solved.sides
        ]
    return LoadsInStep(tuple(stops), tuple(rubs))


def beyond_stops(model: Model, time: Any, entries: list, followed: Followed) -> list:
    """How far coordinates are beyond each side of each stop [rad, m].

    Args:
        model: of the run.
        time: instant [s] of the drives.
        entries: coordinates and speeds, one after the other.
        followed: angles over whole turns of joints outside the tree.
    """
    motions = kinematics.link_motions(model.system, *unpack_motion(model.system, entries), time)
    depths = []
    for solved in solved_loads(model.system).values():
        position = solved.reading(model.system, motions, followed)[0] if solved.sides else None
        depths += [side.beyond(position) for side in solved.sides]
    return depths
