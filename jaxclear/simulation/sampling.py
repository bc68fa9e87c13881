"""Loads that look at the motion from time to time (a controller with a period): what they hold in
between changes at their instants alone, and steps end there.

An instant is a whole number of periods from the start. The parts between them lie within a saving
interval, so that nothing else of a run knows of them.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

# Share of a period by which rounding may miss an instant.
SLIVER = 1e-9


def due(time: Any, period: Any) -> Any:
    """Whether a time [s] is an instant of a period [s]."""
    turns = time / period
    return jnp.abs(turns - jnp.round(turns)) < SLIVER


def next_instant(time: Any, periods: list, stop: Any) -> Any:
    """The first instant [s] of any of the periods [s] after a time, at the latest `stop`."""
    ahead = stop
    for period in periods:
        instant = (jnp.floor(time / period + SLIVER) + 1) * period
        # One that is nearly the end is the end.
        ahead = jnp.where(instant < stop - SLIVER * period, jnp.minimum(ahead, instant), ahead)
    return ahead
