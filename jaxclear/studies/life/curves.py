"""Between the stages of a life: curves through what is known there, and where they meet a limit."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

# Places between two stages at which a limit is looked for.
LOOKS = 64


def through_rates(cycles: np.ndarray, rows: np.ndarray, rates: np.ndarray) -> Any:
    """Cubics through rows of numbers (stages, n) with their rates a cycle: of third order, as the
    steps are. A life of one stage stands still."""
    from scipy.interpolate import CubicHermiteSpline

    if len(rows) > 1:
        return CubicHermiteSpline(cycles, rows, rates)
    ends = np.array([0.0, 1.0])
    return CubicHermiteSpline(ends, rows[[0, 0]], np.zeros_like(rows)[[0, 0]])


def without_overshoot(cycles: np.ndarray, values: np.ndarray) -> Any:
    """A curve through numbers (stages,) whose rates are not known, monotone where they are."""
    from scipy.interpolate import PchipInterpolator

    if len(values) > 1:
        return PchipInterpolator(cycles, values)
    return lambda at: np.full(np.shape(at), values[0])


def first_crossing(
    function: Callable[[float], float], cycles: np.ndarray, limit: float
) -> float | None:
    """Where a function of cycles first reaches a limit; None where it does not."""
    from scipy.optimize import brentq

    places = between(cycles)
    excess = np.array([function(float(place)) for place in places]) - limit
    if excess[0] == 0:
        return float(places[0])
    crossed = np.flatnonzero(np.sign(excess[1:]) != np.sign(excess[0]))
    if not len(crossed):
        return None
    first = crossed[0]
    return float(brentq(lambda at: function(at) - limit, places[first], places[first + 1]))


def between(cycles: np.ndarray) -> np.ndarray:
    """Places at and between the stages."""
    if len(cycles) < 2:
        return cycles
    shares = np.arange(LOOKS) / LOOKS
    parts = [a + (b - a) * shares for a, b in pairwise(cycles)]
    return np.concatenate([*parts, cycles[-1:]])
