"""Rotations and rigid displacements on sparse scalars.

The hot path needs rotations whose zeros are known before tracing (see `sparse`); jaxlie's SO3 and
SE3 carry dense 3x3 products and are used where speed does not matter (conversions of results,
increments during assembly). Quaternions are scalar first. A `Pose` maps child coordinates to parent
coordinates: x_parent = p + R x_child.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground import sparse as sp
from jaxclear.ground.argument_errors import nothing_else

__all__ = [
    "AXES",
    "FLIP",
    "REST",
    "STILL",
    "Pose",
    "Twist",
    "frame_in_plane",
    "frame_with_axis",
    "quaternion_from_rotation",
    "quaternion_rate",
    "rotation_from_quaternion",
    "rotation_x",
    "rotation_y",
    "rotation_z",
]
__getattr__, __dir__ = nothing_else("jaxclear.pose", __all__)


class Pose(NamedTuple):
    """Rotation R (axes of the child in the parent) and translation p (origin of the child in the
    parent).
    """

    rotation: sp.Mat
    translation: sp.Vec

    def after(self, inner: "Pose") -> "Pose":
        """Composition: first `inner`, then this one."""
        return Pose(
            sp.product(self.rotation, inner.rotation),
            sp.plus(self.translation, sp.apply(self.rotation, inner.translation)),
        )

    def inverse(self) -> "Pose":
        rotation = sp.transpose(self.rotation)
        return Pose(rotation, tuple(sp.neg(x) for x in sp.apply(rotation, self.translation)))

    def point(self, local: sp.Vec) -> sp.Vec:
        return sp.plus(self.translation, sp.apply(self.rotation, local))


class Twist(NamedTuple):
    """Linear velocity of the frame's origin and angular velocity, both in the frame's own axes."""

    linear: sp.Vec
    angular: sp.Vec


REST = Pose(sp.IDENTITY, sp.ZERO)
STILL = Twist(sp.ZERO, sp.ZERO)
FLIP: sp.Mat = ((1, 0, 0), (0, -1, 0), (0, 0, -1))
# Frames whose z axis lies along the named axis of the parent, of zeros and ones, so that zeros stay
# structural. Along x and y the frame's x axis lies in the parent's x-y plane, a quarter turn ahead
# (for -x and -y behind): there are the walls of a guide.
AXES: dict[str, sp.Mat] = {
    "z": sp.IDENTITY,
    "x": ((0, 0, 1), (1, 0, 0), (0, 1, 0)),
    "y": ((-1, 0, 0), (0, 0, 1), (0, 1, 0)),
    "-z": FLIP,
    "-x": ((0, 0, -1), (1, 0, 0), (0, -1, 0)),
    "-y": ((-1, 0, 0), (0, 0, -1), (0, -1, 0)),
}


def rotation_z(angle: Any) -> sp.Mat:
    """Rotation about z by an angle [rad]."""
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    return ((cosine, -sine, 0), (sine, cosine, 0), (0, 0, 1))


def rotation_x(angle: Any) -> sp.Mat:
    """Rotation about x by an angle [rad]."""
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    return ((1, 0, 0), (0, cosine, -sine), (0, sine, cosine))


def rotation_y(angle: Any) -> sp.Mat:
    """Rotation about y by an angle [rad]."""
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    return ((cosine, 0, sine), (0, 1, 0), (-sine, 0, cosine))


def rotation_from_quaternion(quaternion: tuple) -> sp.Mat:
    """Rotation of a quaternion (w, x, y, z) of any nonzero length: the length drops out, so drift
    cannot scale it.
    """
    w, x, y, z = quaternion
    s = 2.0 / (w * w + x * x + y * y + z * z)
    sx, sy, sz = s * x, s * y, s * z
    wx, wy, wz = w * sx, w * sy, w * sz
    xx, xy, xz = x * sx, x * sy, x * sz
    yy, yz, zz = y * sy, y * sz, z * sz
    return (
        (1.0 - (yy + zz), xy - wz, xz + wy),
        (xy + wz, 1.0 - (xx + zz), yz - wx),
        (xz - wy, yz + wx, 1.0 - (xx + yy)),
    )


def quaternion_rate(quaternion: tuple, angular: sp.Vec) -> tuple:
    """dq/dt = 1/2 q * (0, omega) for an angular velocity in body axes."""
    w, x, y, z = quaternion
    a, b, c = angular
    return (
        0.5 * (-x * a - y * b - z * c),
        0.5 * (w * a + y * c - z * b),
        0.5 * (w * b + z * a - x * c),
        0.5 * (w * c + x * b - y * a),
    )


def quaternion_from_rotation(rotation: Float[Array, "*n 3 3"]) -> Float[Array, "*n 4"]:
    r"""Unit quaternion (w, x, y, z), w >= 0, of rotation matrices.

    The matrix gives :math:`4 q q^T`; q is the row of its largest diagonal entry, made a unit.

    Source: Shepperd 1978, J. Guidance and Control 1, 223, doi:10.2514/3.55767b.
    """
    turn = jnp.moveaxis(jnp.asarray(rotation, float), (-2, -1), (0, 1))
    a, b, c = turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]
    x, y, z = turn[0, 0], turn[1, 1], turn[2, 2]
    xy, xz, yz = turn[0, 1] + turn[1, 0], turn[0, 2] + turn[2, 0], turn[1, 2] + turn[2, 1]
    products = (
        (1 + x + y + z, a, b, c),
        (a, 1 + x - y - z, xy, xz),
        (b, xy, 1 - x + y - z, yz),
        (c, xz, yz, 1 - x - y + z),
    )
    matrix = jnp.stack([jnp.stack(row, axis=-1) for row in products], axis=-2)
    largest = jnp.argmax(jnp.diagonal(matrix, axis1=-2, axis2=-1), axis=-1)
    row = jnp.take_along_axis(matrix, largest[..., None, None], axis=-2)[..., 0, :]
    side = jnp.where(row[..., :1] < 0, -1.0, 1.0)
    return side * row / jnp.linalg.norm(row, axis=-1, keepdims=True)


def frame_with_axis(axis: tuple) -> sp.Mat:
    """A rotation whose third column is the given axis [any length]; its first column is as near to
    x as it can be.

    Smooth in the axis except where it points along -z (Frisvad 2012, J. Graphics Tools 16, 151, eq.
    3).
    """
    x, y, z = axis
    length = jnp.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    a = 1.0 / (1.0 + z)
    b = -x * y * a
    return ((1.0 - x * x * a, b, x), (b, 1.0 - y * y * a, y), (-x, -y, z))


def frame_in_plane(axis: tuple) -> sp.Mat:
    """A rotation whose third column is the given axis, of 2 or 3 numbers [any length] and not along
    z; its first column lies in the x-y plane, a quarter turn ahead of the axis, as in `AXES`.
    """
    x, y, z = axis if len(axis) == 3 else (*axis, 0)
    flat = jnp.sqrt(x * x + y * y)
    first: sp.Vec = (-y / flat, x / flat, 0)
    length = flat if len(axis) == 2 else jnp.sqrt(flat * flat + z * z)
    third = tuple(0 if sp.is_zero(part) else part / length for part in (x, y, z))
    return sp.transpose((first, sp.cross(third, first) if len(axis) == 3 else (0, 0, 1), third))
