"""Unit forces, and what acts along them by the element that gives it.

A direction is a unit force at one or more places: a force on the coordinate of a link, or a wrench
between two markers. Its rate, its Jacobian row and the wrenches on the links follow by virtual
power. Whatever acts is a row, so reports are sums over rows.
"""

import functools
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import map_many
from jaxclear.ground.pose import Pose
from jaxclear.multibody import kinematics, tree
from jaxclear.multibody.kinematics import JacobianRow, along
from jaxclear.multibody.loops import Closure
from jaxclear.multibody.system import System
from jaxclear.multibody.tree import NOTHING, Motion, Wrench


class LinearRate(NamedTuple):
    """A rate that is linear in the free speeds: its `value` at those at which the motions are
    taken, and its row of the Jacobian."""

    value: Any
    row: JacobianRow

    def at(self, change: Any) -> Any:
        """Its value at speeds that differ by a `change`."""
        return sp.add(self.value, along(self.row, change))

    def times(self, factor: Any) -> "LinearRate":
        """So many times the rate."""
        row = {j: sp.mul(factor, entry) for j, entry in self.row.items()}
        return LinearRate(sp.mul(factor, self.value), row)


def combine_rates(weights: Iterable[Any], rates: Iterable[LinearRate]) -> LinearRate:
    """The sum of rates with these weights."""
    value, row = 0, dict[int, Any]()
    for rate in (rate.times(weight) for weight, rate in zip(weights, rates, strict=True)):
        value = sp.add(value, rate.value)
        for j, entry in rate.row.items():
            row[j] = sp.add(row.get(j, 0), entry)
    return LinearRate(value, {j: entry for j, entry in row.items() if not sp.is_zero(entry)})


class OnLink(NamedTuple):
    """A force on a coordinate of a link, the first or another `component`, of this size."""

    link: int
    factor: Any = 1
    component: int = 0

    def unit_rate(self, motions: tuple[Motion, ...]) -> Any:
        """Speed of the coordinate."""
        return motions[self.link].speeds[self.component]


class OnClosure(NamedTuple):
    """A wrench on the child of a closure about its marker, in the parent marker's axes, times a
    factor, and its opposite on the parent; `joint`: the connection between these markers (None:
    they are no joint's)."""

    closure: Closure
    pose: Pose
    wrench: Wrench
    joint: str | None = None
    factor: Any = 1

    def unit_rate(self, motions: tuple[Motion, ...]) -> Any:
        """Power of the wrench."""
        _, velocity, spin = kinematics.relative_motion(self.closure, motions)[2]
        return _power_of_wrench(self.wrench, velocity, spin)


class Direction(NamedTuple):
    """A unit force: what it is at each place where it acts."""

    places: tuple[OnLink | OnClosure, ...]

    def times(self, factor: Any) -> "Direction":
        """The direction of a quantity that is `factor` times as large by unit motion."""
        return Direction(
            tuple(place._replace(factor=sp.mul(factor, place.factor)) for place in self.places)
        )

    def rate(self, motions: tuple[Motion, ...]) -> Any:
        """Its rate as the links move."""
        return sp.total(sp.mul(place.factor, place.unit_rate(motions)) for place in self.places)

    def linear_rate(self, system: System, motions: tuple[Motion, ...]) -> LinearRate:
        """Its rate, and that by the free speeds."""
        return LinearRate(self.rate(motions), self.jacobian(system, motions))

    def jacobian(self, system: System, motions: tuple[Motion, ...]) -> JacobianRow:
        """Its rate by the free speeds; none of a coordinate that a drive prescribes."""
        row: JacobianRow = {}
        for place in self.places:
            entries: JacobianRow = {}
            if isinstance(place, OnClosure):
                power = lambda _, *moving, on=place.wrench: (_power_of_wrench(on, *moving),)
                ends = place.closure, place.pose
                (entries,) = kinematics.relative_jacobian(system, motions, *ends, power)
            elif motions[place.link].columns:
                start = system.topology.branches[place.link].speeds.start
                entries = {start + place.component: 1}
            for j, entry in entries.items():
                row[j] = sp.add(row.get(j, 0), sp.mul(place.factor, entry))
        return row


def _power_of_wrench(wrench: Wrench, velocity: sp.Vec, spin: sp.Vec) -> Any:
    return sp.add(sp.dot(wrench.force, velocity), sp.dot(wrench.torque, spin))


class CoordinateReading(NamedTuple):
    """The coordinate of a joint or motor at an instant: its `position` [rad, m] and `speed`, and
    the direction of a force along it."""

    position: Any
    speed: Any
    direction: Direction


class Row(NamedTuple):
    """A force [N, N m] along a direction, and the element that gives it."""

    owner: str
    direction: Direction
    force: Any


def row_of_wrench(owner: str, closure: Closure, pose: Pose, wrench: Wrench, joint: str) -> Row:
    """A wrench in a joint, as the force of an element.

    Args:
        owner: element that gives the wrench.
        closure: markers of the joint.
        pose: the child's marker in the parent's.
        wrench: on the child about its marker, in the parent marker's axes [N, N m].
        joint: connection between these markers.
    """
    return Row(owner, Direction((OnClosure(closure, pose, wrench, joint),)), 1)


def add_wrenches(wrenches: list[Wrench], rows: Iterable[Row]) -> None:
    """Adds what rows do between markers to the wrenches on the links."""
    places, calls = [], []
    acting: list[list[Wrench]] = [[] for _ in wrenches]
    for row, place in _iterate_on_closures(rows):
        closure = place.closure
        ends = (
            None if closure.parent_link is None else closure.parent,
            None if closure.child_link is None else closure.child,
        )
        places.append((closure.child_link, closure.parent_link))
        calls.append((*ends, place.pose, *_scaled_wrench(row, place)))
    for links, ends in zip(places, map_many(_action_and_reaction, calls), strict=True):
        for link, wrench in zip(links, ends, strict=True):
            if link is not None:
                acting[link].append(wrench)
    total = lambda *each: functools.reduce(sum_wrenches, each)
    moved = [i for i, wrench in enumerate(acting) if wrench]
    sums = map_many(total, [(wrenches[i], *acting[i]) for i in moved])
    for i, wrench in zip(moved, sums, strict=True):
        wrenches[i] = wrench


def _iterate_on_closures(rows: Iterable[Row]) -> Iterator[tuple[Row, OnClosure]]:
    for row in rows:
        for place in row.direction.places:
            if isinstance(place, OnClosure):
                yield row, place


def wrench_in_joint(rows: Iterable[Row], joint: str | None) -> Wrench:
    """The sum of rows in a joint, on its child about its marker, in the parent marker's axes."""
    pairs = (_scaled_wrench(*pair) for pair in _iterate_on_closures(rows) if pair[1].joint == joint)
    return functools.reduce(sum_wrenches, pairs, NOTHING)


def forces_on_drives(motions: tuple[Motion, ...], rows: Iterable[Row]) -> dict[int, Any]:
    """Sums of rows along coordinates that drives prescribe, by link."""
    sums: dict[int, Any] = {}
    for row in rows:
        for place in row.direction.places:
            if isinstance(place, OnLink) and motions[place.link].prescribed:
                size = sp.mul(place.factor, row.force)
                sums[place.link] = sp.add(sums.get(place.link, 0), size)
    return sums


def _scaled_wrench(row: Row, place: OnClosure) -> Wrench:
    size = sp.mul(row.force, place.factor)
    return Wrench(*(sp.scale(size, part) for part in place.wrench))


def _action_and_reaction(
    parent: Pose | None, child: Pose | None, pose: Pose, force: sp.Vec, torque: sp.Vec
) -> tuple[Any, Any]:
    """Wrenches on the links of the child's marker and of the parent's, in their axes; None where
    that is the ground."""
    on_child = on_parent = None
    if child is not None:
        rotated = (
            sp.apply_transposed(pose.rotation, force),
            sp.apply_transposed(pose.rotation, torque),
        )
        on_child = tree.transform_wrench(child, Wrench(*rotated))
    if parent is not None:
        moment = sp.plus(torque, sp.cross(pose.translation, force))
        back = Wrench(tuple(sp.neg(x) for x in force), tuple(sp.neg(x) for x in moment))
        on_parent = tree.transform_wrench(parent, back)
    return on_child, on_parent


def sum_wrenches(a: Wrench, b: Wrench) -> Wrench:
    """The sum of two wrenches about the same point."""
    return Wrench(sp.plus(a.force, b.force), sp.plus(a.torque, b.torque))
