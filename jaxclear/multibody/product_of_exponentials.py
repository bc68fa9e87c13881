"""Kinematics of a serial chain as a product of exponentials, and how deviations in its joints reach
the tip.

From base to tip, connection after connection: T = ... M_j exp [delta_j] N_j ..., with M_j fixed on
a body, N_j the motion that the joint is made for (exp [S_j q_j], S_j its screw axis) and delta_j
the twist, in the axes of the bearing (the parent's marker), by which the journal departs from it; a
connection met from its child's side enters inverted. To first order the tip departs by the sum of
[Ad_{Y_j^-1}] delta_j, Y_j the tip seen from the bearing of the nominal chain: the adjoint error
model. One way of writing transformations throughout: the matrices of `ground.transform`. Source:
POE in local form, Lynch & Park 2017, Modern Robotics, doi:10.1017/9781316661239, sections 4.1, 5.1.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.body import GROUND
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.transform import (
    Transform,
    TwistVector,
    adjoint_of_inverse,
    exponentials,
    inverse,
    logarithms,
    transform,
)
from jaxclear.multibody.chain import ACROSS_HELD, AXES_HELD, AXIS_HELD, Chain

__all__ = [
    "ChainConfiguration",
    "TipError",
    "forward_kinematics",
    "measured_configuration",
    "nominal_motion",
    "tip_error",
]


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

    `exact`: logarithm of the displacement; `deviations` and `motions`: what the deviation and the
    motion of each joint give to first order, `None` where they cannot differ; `plays`: the
    deviations taken apart, by name; `pointing_angle` [rad] between the tips' z axes;
    `position_error` [m] between their origins.
    """

    exact: TwistVector
    deviations: tuple[TwistVector | None, ...]
    plays: dict[str, tuple[TwistVector | None, ...]]
    motions: tuple[TwistVector | None, ...]
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
    found = iter(logarithms(away))
    return ChainConfiguration(
        tuple(motions),
        tuple(None if joint.ideal or joint.permanent else next(found) for joint in chain.joints),
    )


def nominal_motion(rows: tuple[str, ...], relative: Transform) -> Transform:
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
        cosine, sine = jnp.cos(angle), jnp.sin(angle)
        rotation = jnp.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    elif held == AXES_HELD:
        rotation = jnp.eye(3)
    elif held == ACROSS_HELD:
        # The shortest turn that lays the child's z axis back into the plane across x.
        x, y, z = rotation[:, 2]
        across = safe_sqrt(y * y + z * z)
        lean = safe_divide(jnp.arctan2(x, across), across)
        none = jnp.zeros_like(x)
        turn = exponentials([lean * jnp.stack([none, none, none, none, -z, y])])[0]
        rotation = turn[:3, :3] @ rotation
    return transform(rotation, kept)


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


def tips_seen_by_joints(
    chain: Chain, configuration: ChainConfiguration
) -> list[tuple[Transform, Transform]]:
    """The nominal tip as the parent's and the child's marker of each joint see it."""
    ahead, seen = jnp.eye(4), []
    parts = zip(chain.joints, configuration.motions, chain.fixed_transforms()[1:], strict=True)
    for joint, motion, fixed in reversed(list(parts)):
        after = fixed @ ahead
        ahead = joint.onward(motion) @ after
        seen.append((ahead, after) if joint.forward else (after, ahead))
    return seen[::-1]


def _carried(chain: Chain, tips: list[Transform], twists: Any) -> tuple:
    """Twists of each joint's child against its parent, carried to the tip; against the direction of
    travel they count the other way."""
    signs = [1.0 if joint.forward else -1.0 for joint in chain.joints]
    return tuple(
        None if t is None else sign * adjoint_of_inverse(tip, t)
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
    tips = tips_seen_by_joints(start_chain, start)
    changes = [
        _change(now, then) for now, then in zip(actual.deviations, start.deviations, strict=True)
    ]
    turns: list[Any] = [None] * len(changes)
    if nominal is not None:
        turns = logarithms(
            [inverse(then) @ now for then, now in zip(nominal.motions, actual.motions, strict=True)]
        )
    displacement = inverse(forward_kinematics(start_chain, start)) @ forward_kinematics(
        chain, actual
    )
    x, y, z = displacement[:3, 2]
    away = displacement[:3, 3]
    parents = [parent for parent, _ in tips]
    plays = {
        play: [None if change is None else jnp.array(part, float) * change for change in changes]
        for play, part in PLAYS.items()
    }
    return TipError(
        logarithms([displacement])[0],
        _carried(start_chain, parents, changes),
        {play: _carried(start_chain, parents, twists) for play, twists in plays.items()},
        _carried(start_chain, [child for _, child in tips], turns),
        jnp.arctan2(safe_sqrt(x * x + y * y), z),
        safe_sqrt(jnp.sum(away * away)),
    )
