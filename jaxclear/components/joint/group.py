"""Ideal joints whose coordinates form a group: rotations as unit quaternions, positions with an
orientation. Speeds are in the child's axes.

Exponentials and brackets of rotations and rigid displacements, for increments in body axes, on
sparse scalars.

An increment is a velocity in body axes held for unit time: `turn_quaternion`, `move_pose` and
`move_in_plane` tell where it ends. Quaternions are made unit again after each product, exactly:
products alone drift like a random walk of rounding errors. Twists are linear then angular.
Coefficients are entire functions of the squared angle (Murray, Li & Sastry 1994, A Mathematical
Introduction to Robotic Manipulation, section 2.3), summed as series below SERIES_SQUARE, so every
derivative is finite at rest.
"""

import functools
from math import factorial
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.components.joint.base import (
    ANGULAR,
    LINEAR,
    AbstractGroupJoint,
    angle,
    check_complete,
)
from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import Pose, quaternion_rate, rotation_from_quaternion, rotation_z
from jaxclear.ground.quantity import concrete
from jaxclear.native.compiled import compiled_quickly

NO_TURN = (1.0, 0.0, 0.0, 0.0)


# What runs once in building; compiled as JAX does, and kept for other processes.
@functools.partial(compiled_quickly, options={})
def _quaternion_of_vector(x: Any, y: Any, z: Any) -> tuple:
    """Quaternion of a rotation vector [rad]."""
    import jaxlie

    return tuple(jaxlie.SO3.exp(jnp.stack([x, y, z])).wxyz)


class Spherical(AbstractGroupJoint):
    """Turns freely about a point: q unit quaternion (w, x, y, z), v angular velocity [rad/s] in the
    child's axes.
    """

    home: ClassVar = NO_TURN
    units: ClassVar = ("1", "1", "1", "1")
    rows: ClassVar = ("x", "y", "z")
    reversal: ClassVar = sp.IDENTITY

    def motion(self, q):
        return Pose(rotation_from_quaternion(q), sp.ZERO)

    def columns(self, q):
        return ANGULAR

    def rate(self, q, v):
        return quaternion_rate(q, v)

    def bias(self, q, v):
        return None

    def moved(self, q, increment):
        return turn_quaternion(q, increment)

    def retracted(self, q, increment):
        return _normalise([a + b for a, b in zip(q, self.rate(q, increment), strict=True)])

    def bracket(self, a, b):
        return sp.cross(a, b)

    def coordinates_at(self, pose):
        return _quaternion_of_matrix(pose.rotation)

    def speeds_at(self, pose, velocity, spin):
        return sp.apply_transposed(pose.rotation, spin)

    def start(self, values):
        if len(values) in (1, 3):
            # A rotation vector [rad]; one number turns about z.
            turn = [0.0] * (3 - len(values)) + list(values)
            # Numbers, by whose values no program is kept.
            return _quaternion_of_vector(
                *(x if isinstance(x, jax.Array) else np.asarray(x, float) for x in turn)
            )
        return check_complete(self, _check_quaternion(values))


class Planar(AbstractGroupJoint):
    """Moves in the x-y plane and turns about z: q (x [m], y [m], angle [rad]), v in the child's
    axes.
    """

    home: ClassVar = (0.0, 0.0, 0.0)
    units: ClassVar = ("m", "m", "rad")
    rows: ClassVar = ("z", "x.z", "y.z")
    reversal: ClassVar = sp.IDENTITY

    def motion(self, q):
        return Pose(rotation_z(q[2]), (q[0], q[1], 0))

    def columns(self, q):
        return (LINEAR[0], LINEAR[1], ANGULAR[2])

    def rate(self, q, v):
        cosine, sine = jnp.cos(q[2]), jnp.sin(q[2])
        return (cosine * v[0] - sine * v[1], sine * v[0] + cosine * v[1], v[2])

    def bias(self, q, v):
        return None

    def moved(self, q, increment):
        return move_in_plane(q, increment)

    def retracted(self, q, increment):
        return tuple(a + b for a, b in zip(q, self.rate(q, increment), strict=True))

    def bracket(self, a, b):
        return planar_bracket(a, b)

    def coordinates_at(self, pose):
        x, y, _ = pose.translation
        return (x, y, angle(pose.rotation[1][0], pose.rotation[0][0]))

    def speeds_at(self, pose, velocity, spin):
        x, y, _ = sp.apply_transposed(pose.rotation, velocity)
        return (x, y, spin[2])

    def start(self, values):
        return check_complete(self, values)


class Free(AbstractGroupJoint):
    """No constraint: q (x, y, z [m], quaternion w, x, y, z), v twist in the child's axes, linear
    then angular.
    """

    home: ClassVar = (0.0, 0.0, 0.0, *NO_TURN)
    units: ClassVar = ("m", "m", "m", "1", "1", "1", "1")
    rows: ClassVar = ()
    reversal: ClassVar = sp.IDENTITY

    def motion(self, q):
        return Pose(rotation_from_quaternion(q[3:]), tuple(q[:3]))

    def columns(self, q):
        return LINEAR + ANGULAR

    def rate(self, q, v):
        return (
            *sp.apply(rotation_from_quaternion(q[3:]), tuple(v[:3])),
            *quaternion_rate(q[3:], v[3:]),
        )

    def bias(self, q, v):
        return None

    def moved(self, q, increment):
        return move_pose(q, increment)

    def retracted(self, q, increment):
        place = [a + b for a, b in zip(q, self.rate(q, increment), strict=True)]
        return (*place[:3], *_normalise(place[3:]))

    def bracket(self, a, b):
        return twist_bracket(a, b)

    def coordinates_at(self, pose):
        return (*pose.translation, *_quaternion_of_matrix(pose.rotation))

    def speeds_at(self, pose, velocity, spin):
        return (
            *sp.apply_transposed(pose.rotation, velocity),
            *sp.apply_transposed(pose.rotation, spin),
        )

    def start(self, values):
        if len(values) == 3:
            return (*values, *NO_TURN)
        return check_complete(self, _check_quaternion(values))

    def start_mask(self, values):
        return (True,) * 3 + (len(values) != 3,) * 3


def _check_quaternion(values: tuple) -> tuple:
    """Coordinates that end in a quaternion, which must not be zero."""
    if len(values) >= 4 and all(concrete(x) == 0 for x in values[-4:]):
        raise ValueError(f"ends in a quaternion (w, x, y, z) of zeros; no rotation is {NO_TURN}.")
    return values


def _normalise(quaternion: list) -> tuple:
    length = jnp.sqrt(sum(x * x for x in quaternion))
    return tuple(x / length for x in quaternion)


def _quaternion_of_matrix(rotation: sp.Mat) -> tuple:
    matrix = jnp.stack([sp.stack(row) for row in rotation])
    import jaxlie

    return tuple(jaxlie.SO3.from_matrix(matrix).wxyz)


# Squared angle [rad^2] below which series are summed. There the closed forms have lost a factor 24
# to cancellation at most, and SERIES_TERMS leave less than 1e-17.
SERIES_SQUARE = 0.25
SERIES_TERMS = 7


def _alternating_series(x: Any, first: int) -> Any:
    """Sum of (-x)^n / (2 n + first)!."""
    out = 1.0 / factorial(2 * SERIES_TERMS + first)
    for n in range(SERIES_TERMS - 1, -1, -1):
        out = 1.0 / factorial(2 * n + first) - x * out
    return out


def half_turn(square: Any) -> tuple[Any, Any]:
    """cos(a/2) and sin(a/2)/a from the squared angle a^2."""
    small, quarter = square <= SERIES_SQUARE, 0.25 * square
    # A square root of the clamped square: its derivative would be infinite at zero.
    half = 0.5 * jnp.sqrt(jnp.maximum(square, SERIES_SQUARE))
    cosine = jnp.where(small, _alternating_series(quarter, 0), jnp.cos(half))
    return cosine, 0.5 * jnp.where(small, _alternating_series(quarter, 1), jnp.sin(half) / half)


def lag(square: Any, cosine: Any, sine: Any) -> Any:
    """(a - sin a) / a^3 of an angle a, by its series where a is small.

    Args:
        square: a^2 [rad^2].
        cosine, sine: cos(a/2), and sin(a/2) / a, as `half_turn` returns them.
    """
    return jnp.where(
        square <= SERIES_SQUARE,
        _alternating_series(square, 3),
        (1.0 - 2.0 * cosine * sine) / jnp.maximum(square, SERIES_SQUARE),
    )


def turn_quaternion(quaternion: tuple, angular: sp.Vec) -> tuple:
    """The unit quaternion after a turn by a rotation vector [rad] in body axes, of a quaternion of
    any nonzero length.
    """
    return _rotate(quaternion, angular, half_turn(sp.dot(angular, angular)))


def move_pose(coordinates: tuple, twist: tuple) -> tuple:
    """Position and unit quaternion after the screw motion of a twist (linear [m], angular [rad]) in
    body axes.
    """
    linear, angular = tuple(twist[:3]), tuple(twist[3:])
    square = sp.dot(angular, angular)
    cosine, sine = half_turn(square)
    sideways = sp.cross(angular, linear)
    bent = sp.cross(angular, sideways)
    along = sp.plus(
        linear, sp.scale(2.0 * sine * sine, sideways), sp.scale(lag(square, cosine, sine), bent)
    )
    position = sp.plus(
        tuple(coordinates[:3]), sp.apply(rotation_from_quaternion(coordinates[3:]), along)
    )
    return (*position, *_rotate(coordinates[3:], angular, (cosine, sine)))


def move_in_plane(coordinates: tuple, twist: tuple) -> tuple:
    """Position x, y and angle after the turn of a planar twist (x, y [m], angle [rad]) in body
    axes.
    """
    (x, y, angle), (a, b, turn) = coordinates, twist
    cosine, sine = half_turn(turn * turn)
    along, across = 2.0 * cosine * sine, 2.0 * sine * sine * turn
    a, b = along * a - across * b, across * a + along * b
    return (
        x + jnp.cos(angle) * a - jnp.sin(angle) * b,
        y + jnp.sin(angle) * a + jnp.cos(angle) * b,
        angle + turn,
    )


def twist_bracket(a: tuple, b: tuple) -> tuple:
    """Lie bracket of two twists: a b - b a of their matrices."""
    linear = sp.plus(sp.cross(tuple(a[3:]), tuple(b[:3])), sp.cross(tuple(a[:3]), tuple(b[3:])))
    return (*linear, *sp.cross(tuple(a[3:]), tuple(b[3:])))


def planar_bracket(a: tuple, b: tuple) -> tuple:
    """Lie bracket of two planar twists."""
    return (b[2] * a[1] - a[2] * b[1], a[2] * b[0] - b[2] * a[0], 0)


def _rotate(quaternion, angular, half):
    w, x, y, z = quaternion
    c, (i, j, k) = half[0], sp.scale(half[1], angular)
    product = (
        w * c - x * i - y * j - z * k,
        w * i + x * c + y * k - z * j,
        w * j - x * k + y * c + z * i,
        w * k + x * j - y * i + z * c,
    )
    shrink = 1.0 / jnp.sqrt(sp.dot(product, product))
    return tuple(shrink * part for part in product)
