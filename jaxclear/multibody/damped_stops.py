"""The damping of stops that say which share of a speed comes back, where their force is that of a
spring: it follows from the inertia along their coordinate as the mechanism stands. And the numbers
of other loads that follow from that inertia where a run starts.

Nothing here is evaluated in a mechanism without such loads, nor where stops are rigid.
"""

import dataclasses
from typing import Any

import equinox as eqx

from jaxclear.components.load_base import AbstractCoordinateLoad, AbstractStateLoad
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar
from jaxclear.laws.rebound import damping_ratio_of
from jaxclear.multibody import constraints, dynamics, kinematics, tree
from jaxclear.multibody.forces import (
    NOTHING_FOLLOWED,
    Forces,
    applied_forces,
    read_coordinate,
)
from jaxclear.multibody.kinematics import JacobianRow
from jaxclear.multibody.mechanism import Mechanism, rebuilt
from jaxclear.multibody.system import System, coordinate_loads
from jaxclear.multibody.tree import Motion


class StopOfRatio(AbstractCoordinateLoad):
    """A `stop` whose damping is this `ratio` [1] of the critical one."""

    connection: str = eqx.field(static=True)
    stop: AbstractCoordinateLoad
    ratio: Scalar

    def force(self, time, position, speed):
        return self.stop.force(time, position, speed)

    def sides(self):
        return self.stop.sides()

    def damped(self, inertia: Any) -> AbstractCoordinateLoad:
        """The stop with its damping, for an inertia along its coordinate [kg m^2, kg]."""
        stop: Any = self.stop
        damping = 2 * self.ratio * safe_sqrt(stop.stiffness * inertia)
        return dataclasses.replace(stop, damping=damping)


def with_damping_ratios(system: System) -> System:
    """The system with the damping ratios of its stops in the place of their restitution."""
    loads: Any = coordinate_loads(system)
    result = {
        name: StopOfRatio(load.connection, load, damping_ratio_of(load.restitution))
        for name, load in loads
        if any(side.stop is load for side in load.sides())
        and load.damping is None
        and None not in (load.restitution, load.stiffness)
    }
    return dataclasses.replace(system, loads=system.loads | result) if result else system


def with_damped_stops(system: System, motions: tuple[Motion, ...]) -> System:
    """The system with the damping of its stops, as the links stand."""
    stops = {name: x for name, x in coordinate_loads(system) if isinstance(x, StopOfRatio)}
    if not stops:
        return system
    rows = [_coordinate_row(system, motions, stop.connection) for stop in stops.values()]
    # In a dead centre nothing moves along a coordinate: a damper has nothing to take.
    inertias = [safe_divide(1.0, each) for each in _inverse_inertia_along(system, motions, rows)]
    pairs = zip(stops.items(), inertias, strict=True)
    damped = {name: stop.damped(inertia) for (name, stop), inertia in pairs}
    return dataclasses.replace(system, loads=system.loads | damped)


def forces_at(system: System, motions: tuple[Motion, ...], *others: Any) -> Forces:
    """`forces.applied_forces`, with the damping of stops as the links stand."""
    return applied_forces(with_damped_stops(system, motions), motions, *others)


def with_settled_loads(
    mechanism: Mechanism, system: System, motions: tuple[Motion, ...], delay: Any, times: Any
) -> Mechanism:
    """The mechanism with the numbers of loads that follow from the inertia along their coordinates.

    Args:
        mechanism: its loads without these numbers.
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at the start, at which the inertia is taken.
        delay: time that the steps resolve [s].
        times: saving times of the run [s].
    """
    names = loads_to_settle(mechanism)
    loads: dict[str, Any] = dict(mechanism.loads)
    rows = [_coordinate_row(system, motions, *loads[name].coordinates()) for name in names]
    for name, lightness in zip(names, _inverse_inertia_along(system, motions, rows), strict=True):
        loads[name] = loads[name].for_inertia(1 / lightness, delay, times)
    return rebuilt(mechanism, loads=loads)


def loads_to_settle(mechanism: Mechanism) -> list[str]:
    """The loads of which numbers follow from the inertia along their coordinate."""
    every = mechanism.loads.items()
    return [n for n, x in every if isinstance(x, AbstractStateLoad) and x.needs_inertia()]


def _coordinate_row(system: System, motions: tuple[Motion, ...], name: str) -> JacobianRow:
    """The rate of the coordinate of a joint or motor by the free speeds."""
    reading = read_coordinate(system, motions, name, NOTHING_FOLLOWED)
    return reading.direction.jacobian(system, motions)


def _inverse_inertia_along(system: System, motions: tuple[Motion, ...], rows: list) -> list:
    """By how much a unit of force along each row accelerates it, the loops closed."""
    masses: list[Any] = [
        tree.mass_matrix(*kinematics.by_subtree(subtree, system.links, motions))
        for subtree in system.topology.subtrees
    ]
    loops = constraints.ClosureEquations([], [], (), None)
    if system.closures:
        loops = constraints.acceleration_equations(system, motions, None)
    respond, constrain = dynamics.constrained_inverse(
        masses, loops.rows, loops.kinds, loops.dependence
    )
    size = sum(len(mass) for mass in masses)
    none = [0] * len(loops.rows)
    moved = respond([[row.get(j, 0) for j in range(size)] for row in rows])
    closed = [constrain(each, none)[0] for each in moved]
    return [kinematics.along(row, each) for row, each in zip(rows, closed, strict=True)]
