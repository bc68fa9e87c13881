"""Spot checks: a few short windows of a run gone through twice more, with its own steps and with
steps of half their length, and what both end with compared.

They see whatever is too stiff for the steps, in any load, law or joint, on every rung. Windows
begin at saving times, are spread over the run and take a fixed share of it. They are gone through
when the run has ended, by its *shadows*: from the states, surfaces and warm starts that it has left
there, so that its own turns pay nothing for them.

A window is four turns: through it with the run's own steps, and on over an instant, from which the
accelerations (so the forces) at its end follow; then the same with finer steps.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.formulations.model import Model
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar
from jaxclear.integrators.checks import Check
from jaxclear.integrators.stepping import SLIVER
from jaxclear.multibody.given import speed_scales
from jaxclear.multibody.reach import narrowest_gap, reaches, turning
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
# A turn moves bodies by no more than so many arms; less than so many clearances is no way.
ACROSS, GAPS = 2.0, 100.0


class Turns(NamedTuple):
    """Turns of a loop: from `start` to `stop` [s], with steps of this `share` of the usual length;
    `progress`: by which share of the whole the run gets on.
    """

    start: Float[Array, "*turns"]
    stop: Float[Array, "*turns"]
    share: Float[Array, "*turns"]
    progress: Float[Array, "*turns"]


class Plan(NamedTuple):
    """A run's `turns`, one for each saving interval; the saving intervals at whose start
    `windows` begin, and the `shadows` that go through these (windows, 4)."""

    turns: Turns
    windows: np.ndarray
    shadows: Turns


def plan(times: Float[Array, " saves"], step: Scalar | None) -> Plan:
    """The turns of a run that is saved at these times; `step` [s]: the usual one, which a window
    holds at least (None: no windows)."""
    count = len(times) - 1
    windows = np.array([] if step is None else window_starts(count), int)
    times = jnp.asarray(times)
    starts, stops = times[:-1], times[1:]
    own = Turns(starts, stops, jnp.ones(count), (stops - starts) / (times[-1] - times[0]))
    begin, end = starts[windows], stops[windows]
    if step is not None and len(windows):
        begin, end = _windows(begin, end, count, step)
    instant = end + INSTANT * (end - begin)
    shape = (len(windows), TURNS)
    shadows = Turns(
        jnp.stack([begin, end, begin, end], axis=1),
        jnp.stack([end, instant, end, instant], axis=1),
        jnp.broadcast_to(jnp.array([1.0, 1.0, FINER, 1.0]), shape),
        jnp.zeros(shape),
    )
    return Plan(own, windows, shadows)


def _windows(starts: Array, stops: Array, count: int, step: Scalar) -> tuple[Array, Array]:
    """Beginnings and ends [s] of the windows in these saving intervals of `count`."""
    length = min(1.0, SHARE * count / (PASSES * len(starts)))
    asked = starts + jnp.maximum(length * (stops - starts), step)
    # A window that fills its interval ends with it, to the last bit.
    return starts, jnp.where(asked > stops - SLIVER * (stops - starts), stops, asked)


def window_starts(count: int) -> list[int]:
    """The saving intervals, of `count`, at whose start a window begins."""
    number = max(1, min(MOST, int(SHARE * count / TURNS)))
    return sorted({int(count * ((k + 0.5) * GOLDEN % 1.0)) for k in range(number)})


def figures(
    model: Model, plan: Plan, states: Array, ends: Array | None
) -> dict[Check, Float[Array, " places"]]:
    """What the windows tell, from the states at the saving times and at the ends of the shadows
    (windows, 4, states) (None: no windows): by how much changes of the speeds (so mean forces),
    accelerations at their ends (so forces), worn volumes, places and speeds differ between the two
    passes, beside their sizes."""
    if ends is None:
        return {}
    layout = model.layout
    begin = states[plan.windows]
    coarse, coarse_on, fine, fine_on = (ends[:, k] for k in range(TURNS))
    speeds = slice(layout.coordinates, layout.memory_start)
    # What makes each speed one in m/s: the longest arm for those of turning.
    arm = longest_arm(model.system)
    scales = arm / speed_scales(model.system, arm)
    usual = _usual_rates(plan, states)
    met = usual * jnp.sum(_durations(plan, 0))
    found = {
        Check.HALVED_MEAN_FORCES: _difference(coarse - begin, fine - begin, met, speeds, scales),
        Check.HALVED_MOTION: _motion(model, plan, states, coarse - fine, scales)[None],
    }
    if not layout.impulses:
        found[Check.HALVED_FORCES] = _difference(
            safe_divide(coarse_on - coarse, _durations(plan, 1)),
            safe_divide(fine_on - fine, _durations(plan, 3)),
            usual * len(plan.windows),
            speeds,
            scales,
        )
    if layout.wear:
        volumes = np.array([slot.start for slot in layout.wear])
        found[Check.HALVED_WEAR] = _difference(
            coarse - begin, fine - begin, met, volumes, jnp.ones(len(volumes))
        )
    return found


def _motion(model: Model, plan: Plan, states: Array, off: Array, scales: Array) -> Float[Array, ""]:
    """By how much bodies would be elsewhere at the end of the run, beside their way, if all of it
    were `off` by what the windows end with (windows, states).

    Beside the longest way of a coordinate, no more than that of a turn there and back, or `GAPS`
    clearances; speeds beside the usual ones, where no contact vibrates.
    """
    system, layout = model.system, model.layout
    count, reach = layout.coordinates, reaches(system, longest_arm(system))
    share = safe_divide(_length(plan), jnp.sum(_durations(plan, 0)))
    total = share * jnp.sum(abs(off), axis=0)
    way = jnp.max(abs(states[:, :count] - states[0, :count]), axis=0)
    turned = jnp.where(turning(system), jnp.minimum(way, ACROSS), way)
    longest = jnp.max(turned * reach, initial=0.0)
    if system.bearings:
        longest = jnp.maximum(longest, GAPS * narrowest_gap(system))
    places = safe_divide(jnp.max(total[:count] * reach, initial=0.0), longest)
    if system.bearings:
        return places
    speeds = slice(count, layout.memory_start)
    squares = jnp.ones(len(states)) @ states[:, speeds] ** 2 / len(states)
    usual = jnp.max(safe_sqrt(squares) * scales, initial=0.0)
    faster = safe_divide(jnp.max(total[speeds] * scales, initial=0.0), usual)
    return jnp.maximum(places, faster)


def _length(plan: Plan) -> Scalar:
    """Length of the run [s]."""
    return plan.turns.stop[-1] - plan.turns.start[0]


def _durations(plan: Plan, turn: int) -> Float[Array, "windows 1"]:
    """How long one of its four turns takes in each window [s]."""
    return (plan.shadows.stop - plan.shadows.start)[:, turn, None]


def _usual_rates(plan: Plan, states: Array) -> Float[Array, " states"]:
    """How fast each entry of the state changes over the run, from one saving time to the next
    [1/s]: a window that is quiet beside that tells nothing of the run."""
    # XLA sums along a long first axis many times slower than it multiplies by it.
    way = jnp.ones(len(states) - 1) @ abs(states[1:] - states[:-1])
    return safe_divide(way, _length(plan))


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
