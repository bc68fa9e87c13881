"""Exponentials and brackets of rotations and rigid displacements, for increments in body axes, on
sparse scalars.

An increment is a velocity in body axes held for unit time: `turned`, `displaced` and `slid` tell
where it ends. Quaternions are made unit again after each product, exactly: products alone drift
like a random walk of rounding errors. Twists are linear then angular. Coefficients are entire
functions of the squared angle (Murray, Li & Sastry 1994, A Mathematical Introduction to Robotic
Manipulation, section 2.3), summed as series below SERIES_SQUARE, so every derivative is finite at
rest.
"""

from math import factorial
from typing import Any

import jax.numpy as jnp

from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import rotation_from_quaternion

__all__ = [
    "SERIES_SQUARE",
    "SERIES_TERMS",
    "displaced",
    "half_turn",
    "lag",
    "planar_bracket",
    "slid",
    "turned",
    "twist_bracket",
]

# Squared angle [rad^2] below which series are summed. There the closed forms have lost a factor 24
# to cancellation at most, and SERIES_TERMS leave less than 1e-17.
SERIES_SQUARE = 0.25
SERIES_TERMS = 7


def _series(x: Any, first: int) -> Any:
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
    cosine = jnp.where(small, _series(quarter, 0), jnp.cos(half))
    return cosine, 0.5 * jnp.where(small, _series(quarter, 1), jnp.sin(half) / half)


def lag(square: Any, cosine: Any, sine: Any) -> Any:
    """(a - sin a) / a^3 from the squared angle and what `half_turn` makes of it."""
    return jnp.where(
        square <= SERIES_SQUARE,
        _series(square, 3),
        (1.0 - 2.0 * cosine * sine) / jnp.maximum(square, SERIES_SQUARE),
    )


def turned(quaternion: tuple, angular: sp.Vec) -> tuple:
    """The unit quaternion after a turn by a rotation vector [rad] in body axes, of a quaternion of
    any nonzero length.
    """
    return _turned(quaternion, angular, half_turn(sp.dot(angular, angular)))


def displaced(coordinates: tuple, twist: tuple) -> tuple:
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
    return (*position, *_turned(coordinates[3:], angular, (cosine, sine)))


def slid(coordinates: tuple, twist: tuple) -> tuple:
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


def _turned(quaternion, angular, half):
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
