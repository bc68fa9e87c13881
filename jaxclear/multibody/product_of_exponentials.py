"""Kinematics of a serial chain of connections as a product of exponentials, and how deviations in
its joints reach the tip.

From base to tip, connection after connection: T = ... M_j exp [delta_j] N_j ..., with M_j fixed on
a body, N_j the motion that the joint is made for (exp [S_j q_j], S_j its screw axis) and delta_j
the twist, in the axes of the bearing (the parent's marker), by which the journal departs from it; a
connection met from its child's side enters inverted. To first order the tip departs by the sum of
[Ad_{Y_j^-1}] delta_j, Y_j the tip seen from the bearing of the nominal chain: the adjoint error
model. T (4, 4) maps a child's coordinates to the parent's; twists [m, rad] are linear then angular,
in body axes. Products of matrices compile several times faster than jaxlie's quaternions. Source:
Lynch & Park 2017, Modern Robotics, doi:10.1017/9781316661239, chapter 3, sections 4.1, 5.1.
"""

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.beam import on_piece
from jaxclear.components.body import GROUND, Marker
from jaxclear.components.clearance import AbstractPermanentJoint
from jaxclear.components.joint import AbstractJoint
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.pose import Pose
from jaxclear.ground.wording import unknown
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.pose_rows import closing_rows

Transform = Float[Array, "4 4"]
TwistVector = Float[Array, " 6"]


def transform(rotation: Float[Array, "3 3"], translation: Float[Array, " 3"]) -> Transform:
    """T of a rotation R and a translation p [m]."""
    upper = jnp.concatenate([rotation, translation[:, None]], axis=1)
    return jnp.concatenate([upper, jnp.array([[0.0, 0.0, 0.0, 1.0]])])


def from_pose(pose: Pose) -> Transform:
    """T of a pose on sparse scalars."""
    return transform(
        jnp.stack([sp.stack(row) for row in pose.rotation]), sp.stack(pose.translation)
    )


def inverse(pose: Transform) -> Transform:
    """T^-1: R^T and -R^T p."""
    rotated = pose[:3, :3].T
    return transform(rotated, -rotated @ pose[:3, 3])


def exponentials(twists: Sequence[TwistVector]) -> list[Transform]:
    """exp [V] of each twist; all at once, because this function and the next are slow to
    compile."""
    import jaxlie

    return list(jaxlie.SE3.exp(jnp.stack(twists)).as_matrix()) if twists else []


def logarithms(poses: Sequence[Transform]) -> list[TwistVector]:
    """The twist V with exp [V] = T of each transformation."""
    import jaxlie

    return list(jaxlie.SE3.from_matrix(jnp.stack(poses)).log()) if poses else []


def adjoint_of_inverse(pose: Transform, twist: TwistVector) -> TwistVector:
    """[Ad_{T^-1}] V: a twist in the parent's axes, seen by the child that is rigidly joined to
    it: R^T (v + w x p), R^T w.
    """
    linear, angular = twist[:3], twist[3:]
    turn = pose[:3, :3].T
    return jnp.concatenate([turn @ (linear + jnp.cross(angular, pose[:3, 3])), turn @ angular])


# Which conditions an ideal joint may hold on the rotation, beside none: those of a revolute joint,
# of one that does not turn, of a universal one.
AXIS_FIXED, AXES_FIXED, ACROSS_FIXED = {"x.z", "y.z"}, {"x.z", "y.z", "x.y"}, {"x.z"}


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
        peaks, rest = [], []
        for joint in self.joints:
            ends = (joint.parent, joint.child) if joint.forward else (joint.child, joint.parent)
            peaks.append(ends[0])
            rest.append(ends[1])
        between = zip(rest, [*peaks[1:], self.tip], strict=True)
        return [peaks[0], *(inverse(before) @ after for before, after in between)]


def chain(mechanism: Mechanism, base: str, tip: Marker, through: tuple[str, ...] = ()) -> Chain:
    """The serial chain of connections from a base to a tip.

    Args:
        mechanism: which may close loops.
        base: "ground" or name of a body.
        tip: marker on the last body.
        through: names of connections on the path, where several lead to the tip.

    Raises:
        ValueError: no path, or more than one, leads there.
    """
    tip = on_piece(mechanism.bodies, tip)
    _check(mechanism, base, tip, through)
    paths = _iterate_paths(mechanism, base, tip.body, ())
    result = list(islice((path for path in paths if {*through} <= {name for name, _ in path}), 2))
    if not result:
        by = f" through {', '.join(map(repr, through))}" if through else ""
        raise ValueError(f'no chain of joints leads from "{base}" to "{tip.body}"{by}.')
    if len(result) > 1:
        first, second = (" - ".join(name for name, _ in path) for path in result)
        raise ValueError(
            f'the chain from "{base}" to "{tip.body}" must be serial, but it runs by {first} or by '
            f"{second}; name connections in `through` until one way is left."
        )
    return Chain(tuple(_joint(mechanism, *entry) for entry in result[0]), from_pose(tip.pose()))


def _check(mechanism: Mechanism, base: str, tip: Marker, through: tuple[str, ...]) -> None:
    values = (GROUND, *mechanism.bodies)
    for what, body in (("base", base), ("tip", tip.body)):
        if not isinstance(body, str) or body not in values:
            raise ValueError(unknown("body", body, values, f" for the {what}"))
    if base == tip.body:
        raise ValueError(f'the tip is on the base "{base}" itself; no joint lies between them.')
    for name in through:
        if name not in mechanism.connections:
            raise ValueError(unknown("joint to go through", name, mechanism.connections))


def _iterate_paths(
    mechanism: Mechanism, here: str, end: str, path: tuple
) -> Iterator[tuple[tuple[str, bool], ...]]:
    """Every way between two bodies that meets no body twice, as (connection, forward)."""
    if here == end:
        yield path
        return
    peaks = {here} | {body for name, _ in path for body in _bodies_joined(mechanism, name)}
    for name in mechanism.connections:
        ends = _bodies_joined(mechanism, name)
        if here in ends:
            forward = ends[0] == here
            beyond = ends[forward]
            if beyond not in peaks:
                yield from _iterate_paths(mechanism, beyond, end, (*path, (name, forward)))


def _bodies_joined(mechanism: Mechanism, name: str) -> tuple[str, str]:
    connection = mechanism.connections[name]
    return (connection.parent.body, connection.child.body)


def _joint(mechanism: Mechanism, name: str, forward: bool) -> ChainJoint:
    connection = mechanism.connections[name]
    joint = connection.joint
    permanent = isinstance(joint, AbstractPermanentJoint)
    ideal = isinstance(joint, AbstractJoint) and not permanent
    rows = closing_rows(joint) if ideal or permanent else joint.ideal_rows
    fixed = {row for row in rows if len(row) > 1}
    if not ideal and fixed not in (set(), AXIS_FIXED, AXES_FIXED, ACROSS_FIXED):
        raise ValueError(
            f'joint "{name}" becomes an ideal joint with the rows {", ".join(rows)}; of rotations, '
            "a chain knows joints that hold none, x.z, x.z "
            "with y.z, or all three."
        )
    markers = (from_pose(connection.parent.pose()), from_pose(connection.child.pose()))
    return ChainJoint(
        name, forward, ideal, permanent, tuple(rows), _bodies_joined(mechanism, name), *markers
    )


class ChainConfiguration(eqx.Module):
    """How the joints of a chain stand: `motions` N_j, and `deviations` delta_j [m, rad] in the
    bearings' axes, `None` where there is none."""

    motions: tuple[Transform, ...]
    deviations: tuple[TwistVector | None, ...]

    def ideal(self) -> "ChainConfiguration":
        """The same motions without deviations."""
        return ChainConfiguration(self.motions, (None,) * len(self.motions))


# A deviation's parts: across the joint's axis, along it, and its tilt.
PLAYS = {"across": (1, 1, 0, 0, 0, 0), "along": (0, 0, 1, 0, 0, 0), "tilt": (0, 0, 0, 1, 1, 1)}


class TipError(eqx.Module):
    """Departure of the tip from its nominal pose, twists [m, rad] linear then angular in the axes
    of the nominal tip.

    `exact`: logarithm of the displacement; `deviations`: what the deviation of each joint gives to
    first order, `None` where there is none; `plays`: the deviations taken apart, by name;
    `pointing_angle` [rad] between the tips' z axes; `position_error` [m] between their origins.
    """

    exact: TwistVector
    deviations: tuple[TwistVector | None, ...]
    plays: dict[str, tuple[TwistVector | None, ...]]
    pointing_angle: Float[Array, ""]
    position_error: Float[Array, ""]


def measured_configuration(chain: Chain, bodies: dict[str, Transform]) -> ChainConfiguration:
    """How the joints stand, from the poses of the bodies in the ground frame; these do not tell how
    a permanent joint deviates.
    """
    poses = {GROUND: jnp.eye(4)} | bodies
    motions, away = [], []
    for joint in chain.joints:
        parent, child = joint.bodies
        relative = inverse(poses[parent] @ joint.parent) @ (poses[child] @ joint.child)
        exact = joint.ideal or joint.permanent
        motions.append(relative if exact else nominal_motion(joint.rows, relative))
        away.extend([] if exact else [relative @ inverse(motions[-1])])
    result = iter(logarithms(away))
    return ChainConfiguration(
        tuple(motions),
        tuple(None if joint.ideal or joint.permanent else next(result) for joint in chain.joints),
    )


def nominal_motion(rows: tuple[str, ...], relative: Transform) -> Transform:
    """The motion that keeps the rows of an ideal joint and is nearest to the given pose of the
    child in the parent.

    Displacements that the rows leave free are kept. The rotation is the one at the smallest angle
    from the given one: for a joint about z the angle atan2(R_yx - R_xy, R_xx + R_yy), whichever way
    the axis tilts.
    """
    saved = jnp.array([row not in rows for row in "xyz"], float) * relative[:3, 3]
    fixed = {row for row in rows if len(row) > 1}
    rotation = relative[:3, :3]
    if fixed == AXIS_FIXED:
        angle = jnp.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])
        cosine, sine = jnp.cos(angle), jnp.sin(angle)
        rotation = jnp.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    elif fixed == AXES_FIXED:
        rotation = jnp.eye(3)
    elif fixed == ACROSS_FIXED:
        # The shortest turn that lays the child's z axis back into the plane across x.
        x, y, z = rotation[:, 2]
        across = safe_sqrt(y * y + z * z)
        lean = safe_divide(jnp.arctan2(x, across), across)
        none = jnp.zeros_like(x)
        turn = exponentials([lean * jnp.stack([none, none, none, none, -z, y])])[0]
        rotation = turn[:3, :3] @ rotation
    return transform(rotation, saved)


def forward_kinematics(chain: Chain, configuration: ChainConfiguration) -> Transform:
    """Product of exponentials: the tip in the base's frame."""
    pose, *fixed = chain.fixed_transforms()
    deviations = [d for d in configuration.deviations if d is not None]
    away = iter(exponentials(deviations))
    parts = zip(chain.joints, configuration.motions, configuration.deviations, fixed, strict=True)
    for joint, motion, deviation, after in parts:
        moved = motion if deviation is None else next(away) @ motion
        pose = pose @ joint.onward(moved) @ after
    return pose


def tips_from_joints(chain: Chain, configuration: ChainConfiguration) -> list[Transform]:
    """The nominal tip as the parent's marker of each joint sees it."""
    ahead, view = jnp.eye(4), []
    parts = zip(chain.joints, configuration.motions, chain.fixed_transforms()[1:], strict=True)
    for joint, motion, fixed in reversed(list(parts)):
        after = fixed @ ahead
        ahead = joint.onward(motion) @ after
        view.append(ahead if joint.forward else after)
    return view[::-1]


def _carry_to_tip(chain: Chain, tips: list[Transform], twists: Any) -> tuple:
    """Twists of each joint's child against its parent, carried to the tip; against the direction of
    travel they count the other way."""
    signs = [1.0 if joint.forward else -1.0 for joint in chain.joints]
    return tuple(
        None if t is None else sign * adjoint_of_inverse(tip, t)
        for sign, tip, t in zip(signs, tips, twists, strict=True)
    )


def tip_error(chain: Chain, actual: ChainConfiguration) -> TipError:
    """Exact and first-order error of the tip against the same chain at the same motions without
    deviations; pure, maps and differentiates.

    Args:
        chain: from base to tip.
        actual: motions and deviations of its joints.
    """
    nominal = actual.ideal()
    tips = tips_from_joints(chain, nominal)
    displacement = inverse(forward_kinematics(chain, nominal)) @ forward_kinematics(chain, actual)
    x, y, z = displacement[:3, 2]
    away = displacement[:3, 3]
    deviations = actual.deviations
    plays = {
        play: [None if d is None else jnp.array(part, float) * d for d in deviations]
        for play, part in PLAYS.items()
    }
    return TipError(
        logarithms([displacement])[0],
        _carry_to_tip(chain, tips, deviations),
        {play: _carry_to_tip(chain, tips, twists) for play, twists in plays.items()},
        jnp.arctan2(safe_sqrt(x * x + y * y), z),
        safe_sqrt(jnp.sum(away * away)),
    )
