"""What a run of joints that always touch tells of them: how they carry, and when that changes.

Reactions are means over the saving intervals, so save every step where instants matter; they are
written at an interval's end, where the states stand.
"""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Int

from jaxclear.components.clearance import SITUATIONS, situation
from jaxclear.ground import sparse as sp
from jaxclear.ground.table import as_table
from jaxclear.results.histories import check_contact_joint
from jaxclear.results.state_history import StateHistory, over_time

LINE = SITUATIONS.index("a line (points on one side)")


def _over_ends(history: StateHistory, name: str, function: Any) -> Any:
    """Maps a function of where the gap carries over the saving times."""
    check_contact_joint(history, name)

    def one(now):
        ends = history.formulation.contact(now, name).ends
        if not ends:
            raise ValueError(
                f'how joint "{name}" carries is known of joints that always touch: run '
                "integrator.NonColliding."
            )
        return function(ends)

    return over_time(history, one)


@eqx.filter_jit
def situations(history: StateHistory, name: str) -> Int[Array, " time"]:
    """How a joint carries at every saving time: index into `SITUATIONS`."""
    return _over_ends(history, name, situation)


@eqx.filter_jit
def _sides(history: StateHistory, name: str):
    """Product of the two ends' forces: below zero while they press on opposite sides; and their
    sum.
    """

    def one(ends):
        first, last = ends[0].force, ends[-1].force
        return sp.dot(first, last), sp.stack(sp.plus(first, last))

    return _over_ends(history, name, one)


def switchings(history: StateHistory, name: str) -> Any:
    """Instants at which a joint begins to carry in another way, as a pandas table (time [s], from,
    to).

    Between two ways of two points the instant is where the forces of the ends change sign against
    each other, read off a straight line between the middles of the saving intervals; others are
    known to an interval. A line that changes sides within an interval becomes a line again, at the
    instant of no force.
    """
    codes, products, sums, time = (
        np.asarray(x) for x in (situations(history, name), *_sides(history, name), history.time)
    )
    middles = np.concatenate([time[:1], 0.5 * (time[1:] + time[:-1])])
    rows = []
    for i in range(2, len(codes)):
        turned = sums[i] @ sums[i - 1]
        if codes[i] == codes[i - 1] and (codes[i] != LINE or turned >= 0):
            continue
        instant = 0.5 * (middles[i] + middles[i - 1])
        if products[i] * products[i - 1] < 0:
            instant = middles[i - 1] + (middles[i] - middles[i - 1]) * products[i - 1] / (
                products[i - 1] - products[i]
            )
        elif codes[i] == codes[i - 1]:
            before = sums[i - 1] @ sums[i - 1]
            instant = middles[i - 1] + (middles[i] - middles[i - 1]) * before / (before - turned)
        other = ", on the other side" if codes[i] == codes[i - 1] else ""
        rows.append((instant, SITUATIONS[codes[i - 1]], SITUATIONS[codes[i]] + other))
    return as_table(rows, columns=["time [s]", "from", "to"])
