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
from jaxclear.ground.argument_errors import defined_names, nothing_else


class Pose(NamedTuple):
    """Rotation and translation of a child frame in its parent: x_parent = p + R x_child.

    Args:
        rotation: axes of the child in the parent [1], 3 rows of 3.
        translation: origin of the child in the parent [m], 3 numbers.
    """

    rotation: sp.Mat
    translation: sp.Vec

    def after(self, inner: "Pose") -> "Pose":
        """Composition: first `inner`, then this pose.

        Args:
            inner: pose in the child frame of this one.

        Returns:
            The pose of the inner child in this pose's parent.
        """
        return Pose(
            sp.product(self.rotation, inner.rotation),
            sp.plus(self.translation, sp.apply(self.rotation, inner.translation)),
        )

    def inverse(self) -> "Pose":
        """The pose of the parent in the child.

        Returns:
            The inverse.
        """
        rotation = sp.transpose(self.rotation)
        return Pose(rotation, tuple(sp.neg(x) for x in sp.apply(rotation, self.translation)))

    def point(self, local: sp.Vec) -> sp.Vec:
        """A point in parent coordinates.

        Args:
            local: the point in child coordinates [m], 3 numbers.

        Returns:
            The point in parent coordinates [m], 3 numbers.
        """
        return sp.plus(self.translation, sp.apply(self.rotation, local))


class Twist(NamedTuple):
    """Velocity of a frame, in its own axes.

    Args:
        linear: velocity of its origin [m/s], 3 numbers.
        angular: angular velocity [rad/s], 3 numbers.
    """

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
    """Rotation about z.

    Args:
        angle: angle [rad].

    Returns:
        The rotation matrix, 3 rows of 3.
    """
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    return ((cosine, -sine, 0), (sine, cosine, 0), (0, 0, 1))


def rotation_x(angle: Any) -> sp.Mat:
    """Rotation about x.

    Args:
        angle: angle [rad].

    Returns:
        The rotation matrix, 3 rows of 3.
    """
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    return ((1, 0, 0), (0, cosine, -sine), (0, sine, cosine))


def rotation_y(angle: Any) -> sp.Mat:
    """Rotation about y.

    Args:
        angle: angle [rad].

    Returns:
        The rotation matrix, 3 rows of 3.
    """
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    return ((cosine, 0, sine), (0, 1, 0), (-sine, 0, cosine))


def rotation_from_quaternion(quaternion: tuple) -> sp.Mat:
    """Rotation matrix of a quaternion of any length above zero.

    The length is divided out, so drift of the length does not scale the rotation.

    Args:
        quaternion: (w, x, y, z) [1], scalar first.

    Returns:
        The rotation matrix, 3 rows of 3.
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
    """Rate of a quaternion, 1/2 q * (0, omega).

    Args:
        quaternion: (w, x, y, z) [1], scalar first.
        angular: angular velocity in body axes [rad/s], 3 numbers.

    Returns:
        The rate [1/s], 4 numbers.
    """
    w, x, y, z = quaternion
    a, b, c = angular
    return (
        0.5 * (-x * a - y * b - z * c),
        0.5 * (w * a + y * c - z * b),
        0.5 * (w * b + z * a - x * c),
        0.5 * (w * c + x * b - y * a),
    )


def quaternion_from_rotation(rotation: Float[Array, "*n 3 3"]) -> Float[Array, "*n 4"]:
    """Unit quaternions of rotation matrices.

    The matrix gives :math:`4 q q^T`; q is the row of its largest diagonal entry, normalised.

    Args:
        rotation: rotation matrices [1], shape (*n, 3, 3).

    Returns:
        Quaternions (w, x, y, z), w >= 0, shape (*n, 4).

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
    """A rotation whose third column is an axis and whose first column is as near to x as possible.

    It is smooth in the axis except where the axis points along -z.

    Args:
        axis: axis, 3 numbers of any length above zero, not along -z.

    Returns:
        The rotation matrix, 3 rows of 3.

    Source: Frisvad 2012, J. Graphics Tools 16, 151, eq. 3.
    """
    x, y, z = axis
    length = jnp.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    a = 1.0 / (1.0 + z)
    b = -x * y * a
    return ((1.0 - x * x * a, b, x), (b, 1.0 - y * y * a, y), (-x, -y, z))


def frame_in_plane(axis: tuple) -> sp.Mat:
    """A rotation whose third column is an axis and whose first column lies in the x-y plane.

    The first column is a quarter turn ahead of the axis, as in `AXES`.

    Args:
        axis: axis, 2 or 3 numbers of any length above zero, not along z.

    Returns:
        The rotation matrix, 3 rows of 3.
    """
    x, y, z = axis if len(axis) == 3 else (*axis, 0)
    flat = jnp.sqrt(x * x + y * y)
    first: sp.Vec = (-y / flat, x / flat, 0)
    length = flat if len(axis) == 2 else jnp.sqrt(flat * flat + z * z)
    third = tuple(0 if sp.is_zero(part) else part / length for part in (x, y, z))
    return sp.transpose((first, sp.cross(third, first) if len(axis) == 3 else (0, 0, 1), third))


__all__ = defined_names(globals(), "AXES", "FLIP", "REST", "STILL")
__getattr__, __dir__ = nothing_else("jaxclear.pose", __all__)
