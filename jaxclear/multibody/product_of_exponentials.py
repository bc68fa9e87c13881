"""Kinematics of a serial chain as a product of exponentials, and how deviations in its joints reach
the tip.

From base to tip, connection after connection: T = ... A_j exp(delta_j) N_j ..., with A_j fixed on a
body, N_j the motion that the joint is made for (exp(S_j q_j) about or along its axis) and delta_j
the twist, in the axes of the bearing (the parent's marker), by which the journal departs from it; a
connection met from its child's side enters inverted. To first order the tip departs by the sum of
Ad(Y_j^-1) delta_j, Y_j the tip seen from the bearing of the nominal chain: the adjoint error model.
Poses are matrices (4, 4): products of them compile several times faster than those of jaxlie's
quaternions, which serve for exponentials and logarithms. Source: POE in local form, Lynch & Park
2017, Modern Robotics, sections 4.1 and 5.1.
"""

from collections.abc import Iterator
from itertools import islice
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float

from jaxclear.components.body import GROUND, Marker
from jaxclear.components.clearance import AbstractPermanentJoint
from jaxclear.components.joint import AbstractJoint
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.pose import Pose, rotation_z
from jaxclear.multibody.mechanism import Mechanism

Frame = Float[Array, "4 4"]
# Which conditions a joint may hold on the rotation, beside all of them free.
AXIS_HELD, AXES_HELD, ACROSS_HELD = {"x.z", "y.z"}, {"x.z", "y.z", "x.y"}, {"x.z"}


class Step(eqx.Module):
    """One connection of a chain, with its markers in their bodies' frames. `forward`: met from its
    parent's side; `ideal`: cannot deviate; `fitted`: moves as an ideal joint and deviates as its
    reaction says."""

    name: str = eqx.field(static=True)
    forward: bool = eqx.field(static=True)
    ideal: bool = eqx.field(static=True)
    fitted: bool = eqx.field(static=True)
    rows: tuple[str, ...] = eqx.field(static=True)
    bodies: tuple[str, str] = eqx.field(static=True)
    parent: Frame
    child: Frame

    def onward(self, motion: Frame) -> Frame:
        """Motion of the child in the parent as the way from base to tip meets it."""
        return motion if self.forward else inverse(motion)


class Chain(eqx.Module):
    """The connections from a base to the tip, a marker on the last body."""

    steps: tuple[Step, ...]
    tip: Frame

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(step.name for step in self.steps)

    @property
    def bodies(self) -> tuple[str, ...]:
        """All bodies of the chain, the ground left out."""
        return tuple(
            dict.fromkeys(body for step in self.steps for body in step.bodies if body != GROUND)
        )

    def places(self) -> list[Frame]:
        """A_j: the marker met first of each step, seen from the one left last before (first: from
        the base); then the tip.
        """
        entries = [*(step.parent if step.forward else step.child for step in self.steps), self.tip]
        exits = [step.child if step.forward else step.parent for step in self.steps]
        return [
            entries[0],
            *(inverse(before) @ after for before, after in zip(exits, entries[1:], strict=True)),
        ]


class ChainConfiguration(eqx.Module):
    """How the joints of a chain stand: `motions` N_j, and `deviations` delta_j [m, rad] in the
    bearings' axes, `None` where there is none."""

    motions: tuple[Frame, ...]
    deviations: tuple[Float[Array, " 6"] | None, ...]

    def ideal(self) -> "ChainConfiguration":
        """The same motions without deviations."""
        return ChainConfiguration(self.motions, (None,) * len(self.motions))


class TipError(eqx.Module):
    """Departure of the tip from its nominal pose, twists [m, rad] linear then angular in the axes
    of the nominal tip.

    `exact`: logarithm of the displacement; `deviations` and `motions`: what the deviation and the
    motion of each joint give to first order, `None` where they cannot differ; `pointing_angle`
    [rad] between the tips' z axes; `position_error` [m] between their origins.
    """

    exact: Float[Array, " 6"]
    deviations: tuple[Float[Array, " 6"] | None, ...]
    motions: tuple[Float[Array, " 6"] | None, ...]
    pointing_angle: Float[Array, ""]
    position_error: Float[Array, ""]


def frame(rotation: Float[Array, "3 3"], translation: Float[Array, " 3"]) -> Frame:
    """A pose as a matrix."""
    return jnp.concatenate(
        [
            jnp.concatenate([rotation, translation[:, None]], axis=1),
            jnp.array([[0.0, 0.0, 0.0, 1.0]]),
        ]
    )


def inverse(pose: Frame) -> Frame:
    """The inverse of a rigid displacement."""
    turned = pose[:3, :3].T
    return frame(turned, -turned @ pose[:3, 3])


def exponentials(twists: Any) -> list[Frame]:
    """The displacement of each twist, linear then angular; all at once, because these two functions
    are slow to compile.
    """
    return list(jaxlie.SE3.exp(jnp.stack(twists)).as_matrix()) if twists else []


def logarithms(poses: Any) -> list[Float[Array, " 6"]]:
    """The twist, linear then angular, of each displacement."""
    return list(jaxlie.SE3.from_matrix(jnp.stack(poses)).log()) if poses else []


def dense(pose: Pose) -> Frame:
    """A sparse pose as a matrix."""
    return frame(jnp.stack([sp.stack(row) for row in pose.rotation]), sp.stack(pose.translation))


def chain(mechanism: Mechanism, base: str, tip: Marker, through: tuple[str, ...] = ()) -> Chain:
    """The serial chain from a base ("ground" or a body) to a tip.

    Several ways lead there where the mechanism closes a loop: `through` names connections until one
    way is left. Raises `ValueError` with a sentence.
    """
    known = (GROUND, *mechanism.bodies)
    for what, body in (("base", base), ("tip", tip.body)):
        if body not in known:
            raise ValueError(
                f'the {what} is on "{body}", which does not exist; there are '
                f"{', '.join(map(repr, known))}."
            )
    if base == tip.body:
        raise ValueError(f'the tip is on the base "{base}" itself; no joint lies between them.')
    for name in through:
        if name not in mechanism.connections:
            raise ValueError(
                f'no connection "{name}" to go through; there are '
                f"{', '.join(map(repr, mechanism.connections))}."
            )
    ways = (
        way
        for way in _ways(mechanism, base, tip.body, ())
        if {*through} <= {name for name, _ in way}
    )
    found = list(islice(ways, 2))
    if not found:
        by = f" through {', '.join(map(repr, through))}" if through else ""
        raise ValueError(f'no chain of connections leads from "{base}" to "{tip.body}"{by}.')
    if len(found) > 1:
        first, second = (" - ".join(name for name, _ in way) for way in found)
        raise ValueError(
            f'the chain from "{base}" to "{tip.body}" must be serial, but it runs by {first} or by '
            f"{second}; "
            "name connections in `through` until one way is left."
        )
    return Chain(tuple(_step(mechanism, *entry) for entry in found[0]), dense(tip.pose()))


def _ways(
    mechanism: Mechanism, here: str, end: str, way: tuple
) -> Iterator[tuple[tuple[str, bool], ...]]:
    """Every way between two bodies that meets no body twice, as (connection, forward)."""
    if here == end:
        yield way
        return
    met = {here} | {b for name, _ in way for b in (_ends(mechanism, name))}
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


def _step(mechanism: Mechanism, name: str, forward: bool) -> Step:
    connection = mechanism.connections[name]
    joint = connection.joint
    fitted = isinstance(joint, AbstractPermanentJoint)
    ideal = isinstance(joint, AbstractJoint) and not fitted
    rows = joint.rows if ideal or fitted else joint.ideal_rows
    if not ideal and {row for row in rows if len(row) > 1} not in (
        set(),
        AXIS_HELD,
        AXES_HELD,
        ACROSS_HELD,
    ):
        raise ValueError(
            f'joint "{name}" becomes an ideal joint with the rows {", ".join(rows)}; of rotations, '
            "a chain knows joints that "
            "hold none, x.z, x.z with y.z, or all three."
        )
    markers = (dense(connection.parent.pose()), dense(connection.child.pose()))
    return Step(name, forward, ideal, fitted, tuple(rows), _ends(mechanism, name), *markers)


def measure(chain: Chain, bodies: dict[str, Frame]) -> ChainConfiguration:
    """How the joints stand, from the poses of the bodies in the ground frame; these do not tell how
    a fitted joint deviates.
    """
    poses = {GROUND: jnp.eye(4)} | bodies
    motions, away = [], []
    for step in chain.steps:
        parent, child = (
            poses[b] @ marker
            for b, marker in zip(step.bodies, (step.parent, step.child), strict=True)
        )
        relative = inverse(parent) @ child
        exact = step.ideal or step.fitted
        motion = relative if exact else nominal_motion(step.rows, relative)
        motions.append(motion)
        away.extend([] if exact else [relative @ inverse(motion)])
    found = iter(logarithms(away))
    return ChainConfiguration(
        tuple(motions),
        tuple(None if step.ideal or step.fitted else next(found) for step in chain.steps),
    )


def nominal_motion(rows: tuple[str, ...], relative: Frame) -> Frame:
    """The motion that keeps the rows of an ideal joint and is nearest to the given pose of the
    child in the parent.

    Displacements that the rows leave free are kept. The rotation is the one at the smallest angle
    from the given one: for a joint about z the angle atan2(R_yx - R_xy, R_xx + R_yy), whichever way
    the axis tilts.
    """
    kept = jnp.array([row not in rows for row in "xyz"], float) * relative[:3, 3]
    held = {row for row in rows if len(row) > 1}
    rotation = relative[:3, :3]
    if held == AXIS_HELD:
        angle = jnp.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])
        rotation = jnp.stack([sp.stack(row) for row in rotation_z(angle)])
    elif held == AXES_HELD:
        rotation = jnp.eye(3)
    elif held == ACROSS_HELD:
        # The shortest turn that lays the child's z axis back into the plane across x.
        x, y, z = rotation[:, 2]
        lean = safe_divide(jnp.arcsin(x), safe_sqrt(y * y + z * z))
        rotation = (
            jaxlie.SO3.exp(lean * jnp.stack([jnp.zeros_like(x), -z, y])).as_matrix() @ rotation
        )
    return frame(rotation, kept)


def tip_pose(chain: Chain, setting: ChainConfiguration) -> Frame:
    """Product of exponentials: the tip in the base's frame."""
    pose, *others = chain.places()
    away = iter(
        exponentials([deviation for deviation in setting.deviations if deviation is not None])
    )
    for step, motion, deviation, place in zip(
        chain.steps, setting.motions, setting.deviations, others, strict=True
    ):
        joint = motion if deviation is None else next(away) @ motion
        pose = pose @ step.onward(joint) @ place
    return pose


def seen_tips(chain: Chain, setting: ChainConfiguration) -> list[tuple[Frame, Frame]]:
    """The nominal tip as the parent's and the child's marker of each joint see it."""
    ahead = jnp.eye(4)
    seen = []
    for step, motion, place in reversed(
        list(zip(chain.steps, setting.motions, chain.places()[1:], strict=True))
    ):
        after = place @ ahead
        ahead = step.onward(motion) @ after
        seen.append((ahead, after) if step.forward else (after, ahead))
    return seen[::-1]


def carry(tip: Frame, twist: Float[Array, " 6"]) -> Float[Array, " 6"]:
    """Ad(tip^-1) twist: a twist of the frame that sees the tip there, in the axes of the tip
    rigidly joined to it.
    """
    linear, angular = twist[:3], twist[3:]
    turned = tip[:3, :3].T
    return jnp.concatenate([turned @ (linear + jnp.cross(angular, tip[:3, 3])), turned @ angular])


def _carried(chain: Chain, tips: list[Frame], twists: Any) -> tuple:
    """Twists of each joint's child against its parent, carried to the tip; against the direction of
    travel they count the other way."""
    signs = [1.0 if step.forward else -1.0 for step in chain.steps]
    return tuple(
        None if t is None else sign * carry(tip, t)
        for sign, tip, t in zip(signs, tips, twists, strict=True)
    )


def _change(now: Any, then: Any) -> Any:
    """now - then, where `None` is zero."""
    if then is None:
        return now
    return -then if now is None else now - then


def tip_error(
    chain: Chain,
    actual: ChainConfiguration,
    nominal_chain: Chain | None = None,
    nominal: ChainConfiguration | None = None,
) -> TipError:
    """Exact and first-order error of the tip; pure, maps and differentiates.

    Without `nominal`, against the same chain at the same motions without deviations. With it,
    against another setting of a chain of the same connections: the first order is taken about the
    nominal one, and differences in fixed dimensions count in the exact error only.
    """
    start_chain = chain if nominal_chain is None else nominal_chain
    start = actual.ideal() if nominal is None else nominal
    tips = seen_tips(start_chain, start)
    changes = [
        _change(now, then) for now, then in zip(actual.deviations, start.deviations, strict=True)
    ]
    turns = [None] * len(changes)
    if nominal is not None:
        turns = logarithms(
            [inverse(then) @ now for then, now in zip(nominal.motions, actual.motions, strict=True)]
        )
    displacement = inverse(tip_pose(start_chain, start)) @ tip_pose(chain, actual)
    x, y, z = displacement[:3, 2]
    away = displacement[:3, 3]
    return TipError(
        logarithms([displacement])[0],
        _carried(start_chain, [parent for parent, _ in tips], changes),
        _carried(start_chain, [child for _, child in tips], turns),
        jnp.arctan2(safe_sqrt(x * x + y * y), z),
        safe_sqrt(jnp.sum(away * away)),
    )
