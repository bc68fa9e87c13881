"""Coordinates and speeds of a joint that the tree goes through from its child to its parent.

Those of a connection are always its child's, seen from its parent. With its markers turned by
`reversal` a joint of one coordinate or two has the same ones either way; a rotation, or a place
with an orientation, becomes its inverse.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.joint import AbstractGroupJoint, AbstractJoint
from jaxclear.ground import sparse as sp
from jaxclear.multibody.loops import Relative, reverse
from jaxclear.multibody.topology import Branch


def goes_backwards(branch: Branch, joint: AbstractJoint) -> bool:
    """Whether the tree's coordinates are those of the parent, seen from the child."""
    return branch.reversed and isinstance(joint, AbstractGroupJoint)


def turned_round(joint: AbstractJoint, q: tuple, v: tuple) -> tuple[tuple, tuple]:
    """Coordinates and speeds with which the inner marker moves as seen from the outer one, from
    those with which the outer one moves as seen from the inner: its own inverse."""
    pose = joint.motion(q)
    columns = joint.columns(q)
    linear, angular = (
        sp.plus(sp.ZERO, *(sp.scale(x, part) for x, part in zip(v, parts, strict=True)))
        for parts in ([c.linear for c in columns], [c.angular for c in columns])
    )
    out = Relative(pose, sp.apply(pose.rotation, linear), sp.apply(pose.rotation, angular))
    back = reverse(out, joint.reversal)
    return joint.coordinates_at(back.pose), joint.speeds_at(*back)


def rows_turned_round(
    joint: AbstractJoint, q: Float[Array, "time q"], v: Float[Array, "time v"]
) -> tuple[Float[Array, "time q"], Float[Array, "time v"]]:
    """The same of every row; quaternions, which tell a rotation twice, go on with their sign."""

    def one(q, v):
        return tuple(map(sp.stack, turned_round(joint, tuple(q), tuple(v))))

    q, v = jax.vmap(one)(q, v)
    quaternion = [i for i, unit in enumerate(joint.units) if unit == "1"]
    if quaternion:
        own = q[:, jnp.array(quaternion)]
        steady = jnp.sum(own[1:] * own[:-1], axis=1) >= 0
        sign = jnp.concatenate([jnp.ones(1), jnp.cumprod(jnp.where(steady, 1.0, -1.0))])
        q = q.at[:, jnp.array(quaternion)].multiply(sign[:, None])
    return q, v


def at_start(branch: Branch, joint: AbstractJoint, q: Any, v: Any) -> tuple[tuple, tuple]:
    """The tree's coordinates and speeds from those of the connection."""
    return turned_round(joint, tuple(q), tuple(v)) if goes_backwards(branch, joint) else (q, v)
