"""Serial chains of connections through a mechanism: which joints lie between a base and a tip, and
from which side each is met.
"""

from collections.abc import Iterator
from itertools import islice

import equinox as eqx

from jaxclear.components.body import GROUND, Marker
from jaxclear.components.clearance import AbstractPermanentJoint
from jaxclear.components.joint import AbstractJoint
from jaxclear.ground.transform import Transform, from_pose, inverse
from jaxclear.ground.wording import unknown
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.pose_rows import closing_rows

__all__ = ["Chain", "ChainJoint", "chain"]

# Which conditions an ideal joint may hold on the rotation, beside none: those of a revolute joint,
# of one that does not turn, of a universal one.
AXIS_HELD, AXES_HELD, ACROSS_HELD = {"x.z", "y.z"}, {"x.z", "y.z", "x.y"}, {"x.z"}


class ChainJoint(eqx.Module):
    """One connection of a chain; `parent` and `child` are its markers in their bodies' frames, T
    [1, m]. `forward`: met from its parent's side; `ideal`: cannot deviate; `permanent`: moves as an
    ideal joint and deviates as its reaction says.
    """

    name: str = eqx.field(static=True)
    forward: bool = eqx.field(static=True)
    ideal: bool = eqx.field(static=True)
    permanent: bool = eqx.field(static=True)
    rows: tuple[str, ...] = eqx.field(static=True)
    bodies: tuple[str, str] = eqx.field(static=True)
    parent: Transform
    child: Transform

    def onward(self, motion: Transform) -> Transform:
        """Motion of the child in the parent as the way from base to tip meets it."""
        return motion if self.forward else inverse(motion)


class Chain(eqx.Module):
    """The connections from a base to the `tip`, a marker on the last body, T [1, m]."""

    joints: tuple[ChainJoint, ...]
    tip: Transform

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(joint.name for joint in self.joints)

    @property
    def bodies(self) -> tuple[str, ...]:
        """All bodies of the chain, the ground left out."""
        names = [body for joint in self.joints for body in joint.bodies if body != GROUND]
        return tuple(dict.fromkeys(names))

    def fixed_transforms(self) -> list[Transform]:
        """M_j: the marker met first of each joint, seen from the one left last before (first: from
        the base); then the tip.
        """
        met, left = [], []
        for joint in self.joints:
            ends = (joint.parent, joint.child) if joint.forward else (joint.child, joint.parent)
            met.append(ends[0])
            left.append(ends[1])
        between = zip(left, [*met[1:], self.tip], strict=True)
        return [met[0], *(inverse(before) @ after for before, after in between)]


def chain(mechanism: Mechanism, base: str, tip: Marker, through: tuple[str, ...] = ()) -> Chain:
    """The serial chain from a base ("ground" or a body) to a tip.

    Several ways lead there where the mechanism closes a loop: `through` names connections until one
    way is left. Raises `ValueError` with a sentence.
    """
    _check(mechanism, base, tip, through)
    ways = _ways(mechanism, base, tip.body, ())
    found = list(islice((way for way in ways if {*through} <= {name for name, _ in way}), 2))
    if not found:
        by = f" through {', '.join(map(repr, through))}" if through else ""
        raise ValueError(f'no chain of joints leads from "{base}" to "{tip.body}"{by}.')
    if len(found) > 1:
        first, second = (" - ".join(name for name, _ in way) for way in found)
        raise ValueError(
            f'the chain from "{base}" to "{tip.body}" must be serial, but it runs by {first} or by '
            f"{second}; name connections in `through` until one way is left."
        )
    return Chain(tuple(_joint(mechanism, *entry) for entry in found[0]), from_pose(tip.pose()))


def _check(mechanism: Mechanism, base: str, tip: Marker, through: tuple[str, ...]) -> None:
    known = (GROUND, *mechanism.bodies)
    for what, body in (("base", base), ("tip", tip.body)):
        if not isinstance(body, str) or body not in known:
            raise ValueError(unknown("body", body, known, f" for the {what}"))
    if base == tip.body:
        raise ValueError(f'the tip is on the base "{base}" itself; no joint lies between them.')
    for name in through:
        if name not in mechanism.connections:
            raise ValueError(unknown("joint to go through", name, mechanism.connections))


def _ways(
    mechanism: Mechanism, here: str, end: str, way: tuple
) -> Iterator[tuple[tuple[str, bool], ...]]:
    """Every way between two bodies that meets no body twice, as (connection, forward)."""
    if here == end:
        yield way
        return
    met = {here} | {body for name, _ in way for body in _ends(mechanism, name)}
    for name in mechanism.connections:
        ends = _ends(mechanism, name)
        if here in ends:
            forward = ends[0] == here
            beyond = ends[forward]
            if beyond not in met:
                yield from _ways(mechanism, beyond, end, (*way, (name, forward)))


def _ends(mechanism: Mechanism, name: str) -> tuple[str, str]:
    connection = mechanism.connections[name]
    return (connection.parent.body, connection.child.body)


def _joint(mechanism: Mechanism, name: str, forward: bool) -> ChainJoint:
    connection = mechanism.connections[name]
    joint = connection.joint
    permanent = isinstance(joint, AbstractPermanentJoint)
    ideal = isinstance(joint, AbstractJoint) and not permanent
    rows = closing_rows(joint) if ideal or permanent else joint.ideal_rows
    held = {row for row in rows if len(row) > 1}
    if not ideal and held not in (set(), AXIS_HELD, AXES_HELD, ACROSS_HELD):
        raise ValueError(
            f'joint "{name}" becomes an ideal joint with the rows {", ".join(rows)}; of rotations, '
            "a chain knows joints that hold none, x.z, x.z "
            "with y.z, or all three."
        )
    markers = (from_pose(connection.parent.pose()), from_pose(connection.child.pose()))
    return ChainJoint(
        name, forward, ideal, permanent, tuple(rows), _ends(mechanism, name), *markers
    )
