"""Spot checks: a few short windows of a run gone through twice more, with its own steps and with
steps of half their length, and what both end with compared.

They see whatever is too stiff for the steps, in any load, law or joint, on every rung. Windows
begin at saving times, are spread over the run and take a fixed share of it. They are turns of the
run's own loop, *shadows*: nothing of them enters the run.

A window is four turns: through it with the run's own steps, and on over an instant, from which the
accelerations (so the forces) at its end follow; then the same with finer steps.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxclear.formulations.model import Model
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.quantity import Scalar
from jaxclear.integrators.checks import Check
from jaxclear.integrators.stepping import SLIVER
from jaxclear.multibody.given import speed_scales
from jaxclear.multibody.system import longest_arm

# Share of a run's steps that windows take; in a window steps are taken 1 + 2 times.
SHARE, PASSES = 0.03, 3.0
# Length of the steps in the second pass beside those of the run.
FINER = 0.5
# An instant beside the length of a window: short beside any step, long beside rounding.
INSTANT = 1e-5
# Windows of a run at most; one at least.
MOST = 4
# They begin at multiples of the golden section of a run: spread, and out of step with any turning.
GOLDEN = 0.5 * (5**0.5 - 1)
TURNS = 4
# Size, beside the largest, below which a coordinate's changes do not matter.
LEAST = 0.1


class Turns(NamedTuple):
    """Turns of a run's loop, one after the other: from `start` to `stop` [s], with steps of this
    `share` of the usual length; whether a turn is the run's `own` or a shadow, and whether that
    `goes_on` from where the shadow before has ended; the saving interval by which the run gets on.
    """

    start: Float[Array, " turns"]
    stop: Float[Array, " turns"]
    share: Float[Array, " turns"]
    own: Bool[Array, " turns"]
    goes_on: Bool[Array, " turns"]
    progress: Float[Array, " turns"]


class Plan(NamedTuple):
    """A run's `turns`; where among them its own are, and those of each window (windows, 4)."""

    turns: Turns
    own: np.ndarray
    shadows: np.ndarray


def plan(times: Float[Array, " saves"], step: Scalar | None) -> Plan:
    """The turns of a run that is saved at these times; `step` [s]: the usual one, which a window
    holds at least (None: no windows)."""
    count = len(times) - 1
    windows = [] if step is None else window_starts(count)
    # (saving interval, share of the steps, own, goes on)
    rows: list[tuple] = []
    for interval in range(count):
        for finer in (1.0, FINER) if interval in windows else ():
            rows += [(interval, finer, False, False), (interval, 1.0, False, True)]
        rows.append((interval, 1.0, True, False))
    index, share, own, goes_on = map(np.array, zip(*rows, strict=True))
    times = jnp.asarray(times)
    starts, stops = times[index], times[index + 1]
    progress = jnp.where(own, stops - starts, 0.0) / (times[-1] - times[0])
    if step is not None and windows:
        length = min(1.0, SHARE * count / (PASSES * len(windows)))
        asked = starts + jnp.maximum(length * (stops - starts), step)
        # A window that fills its interval ends with it, to the last bit.
        ends = jnp.where(asked > stops - SLIVER * (stops - starts), stops, asked)
        starts, stops = (
            jnp.where(goes_on, ends, starts),
            jnp.where(own, stops, jnp.where(goes_on, ends + INSTANT * (ends - starts), ends)),
        )
    turns = Turns(
        starts, stops, jnp.asarray(share), jnp.asarray(own), jnp.asarray(goes_on), progress
    )
    return Plan(turns, np.flatnonzero(own), np.flatnonzero(~own).reshape(-1, TURNS))


def window_starts(count: int) -> list[int]:
    """The saving intervals, of `count`, at whose start a window begins."""
    number = max(1, min(MOST, int(SHARE * count / TURNS)))
    return sorted({int(count * ((k + 0.5) * GOLDEN % 1.0)) for k in range(number)})


def figures(model: Model, plan: Plan, states: Array, ends: Array) -> dict[Check, Array]:
    """What the windows tell, from the states at the saving times and at the end of every turn: by
    how much changes of the speeds (so mean forces), accelerations at their ends (so forces) and
    worn volumes differ between the two passes, beside their sizes."""
    if not len(plan.shadows):
        return {}
    layout = model.layout
    begin = states[np.searchsorted(plan.own, plan.shadows[:, 0])]
    coarse, coarse_on, fine, fine_on = (ends[plan.shadows[:, k]] for k in range(TURNS))
    speeds = slice(layout.coordinates, layout.memory_start)
    # What makes each speed one in m/s: the longest arm for those of turning.
    arm = longest_arm(model.system)
    scales = arm / speed_scales(model.system, arm)
    usual = _usual_rates(plan, states)
    met = usual * jnp.sum(_durations(plan, 0))
    found = {
        Check.HALVED_MEAN_FORCES: _difference(coarse - begin, fine - begin, met, speeds, scales)
    }
    if not layout.impulses:
        found[Check.HALVED_FORCES] = _difference(
            safe_divide(coarse_on - coarse, _durations(plan, 1)),
            safe_divide(fine_on - fine, _durations(plan, 3)),
            usual * len(plan.shadows),
            speeds,
            scales,
        )
    if layout.wear:
        volumes = np.array([slot.start for slot in layout.wear])
        found[Check.HALVED_WEAR] = _difference(
            coarse - begin, fine - begin, met, volumes, jnp.ones(len(volumes))
        )
    # They stand for the run as a whole: at its end.
    last = len(plan.own) - 1
    return {check: jnp.zeros((last + 1, len(x))).at[last].set(x) for check, x in found.items()}


def _durations(plan: Plan, turn: int) -> Float[Array, "windows 1"]:
    """How long one of its four turns takes in each window [s]."""
    rows = plan.shadows[:, turn]
    return (plan.turns.stop[rows] - plan.turns.start[rows])[:, None]


def _usual_rates(plan: Plan, states: Array) -> Float[Array, " states"]:
    """How fast each entry of the state changes over the run, from one saving time to the next
    [1/s]: a window that is quiet beside that tells nothing of the run."""
    turns = jax.tree.map(lambda each: each[plan.own], plan.turns)
    way = jnp.sum(abs(states[1:] - states[:-1]), axis=0)
    return safe_divide(way, turns.stop[-1] - turns.start[0])


def _difference(
    coarse: Array, fine: Array, usual: Array, entries: Any, scales: Array
) -> Float[Array, " entries"]:
    """Difference of some entries beside their size, both summed over the windows, or beside the
    size that is `usual` in the run if that is more; entries that are small beside the largest
    count as a tenth of it."""
    met = jnp.sum(jnp.maximum(abs(coarse), abs(fine)), axis=0)
    size = jnp.maximum(met, usual)[entries] * scales
    off = jnp.sum(abs(fine - coarse)[:, entries], axis=0) * scales
    return safe_divide(off, jnp.maximum(size, LEAST * jnp.max(size, initial=0.0)))
