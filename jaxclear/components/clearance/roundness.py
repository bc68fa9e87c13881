r"""A bore that is not round: its radius in Fourier form, and where a journal touches it.

:math:`R(\varphi) = R_B + r(\varphi)`, :math:`r = \sum_k a_k \cos k\varphi + b_k \sin k\varphi`, in
the bearing's axes, small beside the radius. A journal at e then overlaps the wall by the largest of
:math:`e \cdot n(\varphi) - c - r(\varphi)`; it touches at one angle, whatever e, while
:math:`c + r + r'' > 0` (r is then the support function of the places that the journal's centre may
take). Two lobes are an oval, three a bore bent by its chuck.
Source: Whitehouse 2011, Handbook of Surface and Nanometrology, 2nd ed., ch. 2 (roundness in Fourier
form).
"""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp

from jaxclear.components.clearance.base import direction
from jaxclear.ground import sparse as sp
from jaxclear.ground.quantity import AbstractQuantified, Scalar, concrete, count, quantity

# Turns of Newton's method on the angle; each squares what is left.
TURNS = 5


class Lobes(AbstractQuantified):
    """One harmonic of a bore's radius, `cosine` cos(k phi) + `sine` sin(k phi), k = `number` of
    lobes: 2 an oval, 3 a trefoil. Peak to valley it is out of round by twice its amplitude."""

    number: int = count(2, "lobes around the bore", at_least=2)
    cosine: Scalar = quantity(0.0, "m", "deviation of the radius, cosine part", kw_only=True)
    sine: Scalar = quantity(0.0, "m", "deviation of the radius, sine part", kw_only=True)


def radius_deviation(lobes: Sequence[Lobes], x: Any, y: Any) -> tuple[Any, Any, Any]:
    """r, r' and r'' [m] in the direction (x, y) of length 1."""
    value, slope, bend = 0.0, 0.0, 0.0
    for own in lobes:
        k = own.number
        c, s = _turned(x, y, k)
        wave = own.cosine * c + own.sine * s
        value, bend = value + wave, bend - k * k * wave
        slope = slope + k * (own.sine * c - own.cosine * s)
    return value, slope, bend


def _turned(x: Any, y: Any, times: int) -> tuple[Any, Any]:
    """The direction at so many times the angle of (x, y), by squares: binary digits count."""
    c, s = x, y
    for digit in f"{times:b}"[1:]:
        c, s = c * c - s * s, 2 * (c * s)
        if digit == "1":
            c, s = c * x - s * y, s * x + c * y
    return c, s


def touched(lobes: Sequence[Lobes], clearance: Any, offset: sp.Vec) -> tuple[Any, Any, Any]:
    """Direction (x, y) in which a journal at `offset` [m] comes nearest to the wall, and its
    overlap there [m]; exact where the journal touches, below zero where it does not."""
    x, y = direction(offset, 2)
    for _ in range(TURNS):
        value, slope, bend = radius_deviation(lobes, x, y)
        along = offset[0] * x + offset[1] * y
        across = offset[1] * x - offset[0] * y
        # What is farther in than the wall is treated as if it touched: there is no angle to find.
        step = (across - slope) / (jnp.maximum(along, clearance + value) + bend)
        size = 1 / jnp.sqrt(1 + step * step)
        x, y = size * (x - step * y), size * (y + step * x)
    value = radius_deviation(lobes, x, y)[0]
    return x, y, offset[0] * x + offset[1] * y - clearance - value


def leaned(lobes: Sequence[Lobes], clearance: Any, lean: sp.Vec) -> sp.Vec:
    """Where a journal lies [m] that is pressed in the direction `lean` (length 1, or 0)."""
    x, y = lean[:2]
    value, slope, _ = radius_deviation(lobes, x, y)
    out = clearance + value
    return (out * x - slope * y, out * y + slope * x, 0)


def check_roundness(joint: Any) -> None:
    """Raises `ValueError` unless the journal touches the bore at one angle only, for sure."""
    lobes = joint.roundness
    if lobes is None:
        return
    known = isinstance(lobes, tuple) and all(isinstance(own, Lobes) for own in lobes)
    if not known or not lobes:
        raise ValueError(
            f"a {type(joint).__name__} has a roundness that is no tuple of "
            "jaxclear.clearance.Lobes; give a tuple of them, or None for a round bore."
        )
    clearance = concrete(joint.clearance)
    sizes: list[Any] = [(own.number, concrete(own.cosine), concrete(own.sine)) for own in lobes]
    if clearance is None or any(None in size for size in sizes):
        return
    bent = sum((k * k - 1) * (a * a + b * b) ** 0.5 for k, a, b in sizes)
    if bent >= clearance:
        raise ValueError(
            f"a {type(joint).__name__} has lobes so high for a clearance of {clearance:g} m that "
            "the journal may touch two of them at once: the sum of (number^2 - 1) x amplitude is "
            f"{bent:.3g} m and must stay below the clearance."
        )
