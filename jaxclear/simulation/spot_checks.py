"""Spot checks: a few short windows of a run gone through twice more, with its own steps and with
steps of half their length, and what both end with compared.

They see whatever is too stiff for the steps, in any load, law or joint, on every rung. Windows
begin at saving times, are spread over the run and take a fixed share of it. They are turns of the
run's own loop, *shadows*, between parts of it: nothing of them enters the run, and its own turns do
not look for them.

A window is four turns: through it with the run's own steps, and on over an instant, from which the
accelerations (so the forces) at its end follow; then the same with finer steps. One that fills its
saving interval takes the run's own turn for the first of them. Where forces are means there are
none at an instant, and no turns on.
"""

from collections.abc import Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.formulations.model import Model
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar
from jaxclear.integrators.checks import Check
from jaxclear.integrators.stepping import SLIVER
from jaxclear.multibody.given import speed_scales
from jaxclear.multibody.reach import driven_ways, reaches
from jaxclear.multibody.system import longest_arm
from jaxclear.native import has_kernels, once
from jaxclear.simulation.tally import Tally, compared
from jaxclear.simulation.two_passes import (
    CARRIED,
    CARRIED_NOW,
    by_contacts,
    difference,
    least_volumes,
)
from jaxclear.simulation.ways import STILL, Led, longest_way

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
# The turns of a window by what they are, in the order in which they are gone through; of one that
# fills its saving interval the run's own turn stands before the last.
COARSE, COARSE_ON, FINE, FINE_ON = "coarse", "coarse, on", "fine", "fine, on"
APART, WHOLE = (COARSE, COARSE_ON, FINE, FINE_ON), (FINE, FINE_ON, COARSE_ON)
ON = (COARSE_ON, FINE_ON)


class Turns(NamedTuple):
    """Turns of a run's loop: from `start` to `stop` [s], with steps of this `share` of the usual
    length; `progress`: by which share of the whole the run gets on.
    """

    start: Float[Array, " turns"]
    stop: Float[Array, " turns"]
    share: Float[Array, " turns"]
    progress: Float[Array, " turns"]


class Parts(NamedTuple):
    """Parts of a run's loop in the order in which they are gone through: each the turns from
    `first` up to `stop`; whether they are the run's `own` or a shadow, and whether that `goes_on`
    from where the shadow before has ended.
    """

    first: np.ndarray
    stop: np.ndarray
    own: np.ndarray
    goes_on: np.ndarray


class Plan(NamedTuple):
    """A run's `turns`, one for each saving interval and behind them those of the windows; the
    `parts` in which they are gone through, and the saving intervals at whose start a window
    begins; `names` of the turns of a window, and whether each fills the `whole` of its interval."""

    turns: Turns
    parts: Parts
    windows: np.ndarray
    names: tuple[str, ...]
    whole: bool

    @property
    def intervals(self) -> int:
        """How many of the turns are the run's own."""
        return int(np.max(self.parts.stop[self.parts.own]))

    @property
    def times(self) -> Float[Array, " saves"]:
        """The run's saving times [s]."""
        starts, stops = self.turns.start[: self.intervals], self.turns.stop[: self.intervals]
        return jnp.append(starts, stops[-1])

    @property
    def duration(self) -> Float[Array, ""]:
        """How long the run is [s]."""
        return self.turns.stop[self.intervals - 1] - self.turns.start[0]

    def shadows(self, name: str) -> np.ndarray:
        """Where among the parts the turn of this name of each window is."""
        return np.flatnonzero(~self.parts.own)[self.among_shadows(name)]

    def among_shadows(self, name: str) -> np.ndarray:
        """Where among the turns of windows, in the order in which they are gone through, that of
        this name of each is."""
        return np.arange(len(self.windows)) * len(self.names) + self.names.index(name)


def plan(times: Float[Array, " saves"], step: Scalar | None, means: bool = False) -> Plan:
    """The turns of a run that is saved at these times; `step` [s]: the usual one, which a window
    holds at least (None: no windows); whether forces are `means`."""
    count = len(times) - 1
    windows = np.array([] if step is None else window_starts(count), int)
    times = jnp.asarray(times)
    starts, stops = times[:-1], times[1:]
    share, progress = jnp.ones(count), (stops - starts) / (times[-1] - times[0])
    whole = len(windows) > 0 and _length(count, len(windows)) == 1.0
    names = tuple(name for name in (WHOLE if whole else APART) if not (means and name in ON))
    if step is not None and len(windows):
        begin, end = _windows(starts[windows], stops[windows], count, step)
        instant = end + INSTANT * (end - begin)
        starts = jnp.concatenate([starts, _in_turn(end if k in ON else begin for k in names)])
        stops = jnp.concatenate([stops, _in_turn(instant if k in ON else end for k in names)])
        shares = np.tile([FINER if k == FINE else 1.0 for k in names], len(windows))
        share = jnp.concatenate([share, shares])
        progress = jnp.concatenate([progress, jnp.zeros(len(shares))])
    turns = Turns(starts, stops, share, progress)
    return Plan(turns, _parts(count, windows, names, whole), windows, names, whole)


def _length(count: int, windows: int) -> float:
    """Length of so many windows beside that of their saving intervals, of `count`."""
    return min(1.0, SHARE * count / (PASSES * windows))


def _windows(starts: Array, stops: Array, count: int, step: Scalar) -> tuple[Array, Array]:
    """Beginnings and ends [s] of the windows in these saving intervals of `count`."""
    length = _length(count, len(starts))
    asked = starts + jnp.maximum(length * (stops - starts), step)
    # A window that fills its interval ends with it, to the last bit.
    return starts, jnp.where(asked > stops - SLIVER * (stops - starts), stops, asked)


def _in_turn(turns: Iterable[Float[Array, " windows"]]) -> Float[Array, " turns"]:
    return jnp.stack(list(turns), axis=1).ravel()


def _parts(count: int, windows: np.ndarray, names: tuple[str, ...], whole: bool) -> Parts:
    """Where each window begins the run is left for its turns, which stand behind its own."""
    rows: list[tuple[int, int, bool, bool]] = []
    done, shadow = 0, count
    for start in windows:
        rows += [(done, start, True, False)] if start > done else []
        done = start
        for name in names:
            if whole and name == COARSE_ON:
                done = start + 1
                rows.append((start, done, True, False))
            rows.append((shadow, shadow + 1, False, name in ON))
            shadow += 1
    rows += [(done, count, True, False)] if done < count else []
    return Parts(*map(np.array, zip(*rows, strict=True)))


def window_starts(count: int) -> list[int]:
    """The saving intervals, of `count`, at whose start a window begins."""
    number = max(1, min(MOST, int(SHARE * count / len(APART))))
    return sorted({int(count * ((k + 0.5) * GOLDEN % 1.0)) for k in range(number)})


def figures(
    model: Model, plan: Plan, states: Array, ends: Array | None, tally: Tally, means: bool
) -> dict[Check, Float[Array, " places"]]:
    """What the windows tell, from the states at the saving times and at the ends of their turns
    (None: no windows), and from what the run has followed of itself: by how much changes of the
    speeds (so mean forces), impulses of contacts and accelerations at their ends (so forces at an
    instant; not where forces are `means`) and worn volumes differ between the two passes, beside
    their sizes."""
    if ends is None:
        return {}
    led = driven_ways(model.system, plan.times)
    # As a kernel: XLA starts some fifty operations on few numbers, for what they cost a twentieth
    # of a short run.
    found = lambda: _figures(model, plan, states, ends, tally, means, led)
    return once(found) if has_kernels() else found()


def _figures(
    model: Model, plan: Plan, states: Array, ends: Array, tally: Tally, means: bool, led: Led
) -> dict[Check, Float[Array, " places"]]:
    """As `figures`."""
    layout = model.layout
    begin = _rows(states, plan.windows)
    of = lambda name: _rows(ends, plan.among_shadows(name))
    fine = of(FINE)
    coarse = _rows(states, plan.windows + 1) if plan.whole else of(COARSE)
    # What makes each speed one in m/s: the longest arm for those of turning.
    arm = longest_arm(model.system)
    scales = arm / speed_scales(model.system, arm)
    rough, close = (compared(layout, end - begin, not means) for end in (coarse, fine))
    # How fast each changes over the run: a window that is quiet beside that tells nothing.
    usual = jax.tree.map(lambda way: safe_divide(way, plan.duration), tally.way)
    lasting = jnp.sum(_durations(plan, FINE))
    met = jax.tree.map(lambda rate: rate * lasting, usual)
    # What is slower than this [m/s] stands still.
    slow = STILL * arm / plan.duration
    least = jnp.maximum(slow, CARRIED * by_contacts(model, close.impulses))
    found = {
        Check.HALVED_MEAN_FORCES: difference(rough.speeds, close.speeds, met.speeds, scales, least),
        Check.HALVED_MOTION: _motion(model, plan, tally, coarse - fine, scales, led)[None],
    }
    if not means:
        fine_on, coarse_on = of(FINE_ON), of(COARSE_ON)
        carried = by_contacts(model, close.impulses / _durations(plan, FINE))
        speeds = lambda change, name: safe_divide(
            compared(layout, change).speeds, _durations(plan, name)
        )
        found[Check.HALVED_FORCES] = difference(
            speeds(coarse_on - coarse, COARSE_ON),
            speeds(fine_on - fine, FINE_ON),
            usual.speeds * len(plan.windows),
            scales,
            jnp.maximum(slow / plan.duration, CARRIED_NOW * carried),
        )
        if layout.impulses:
            found[Check.HALVED_CONTACT_FORCES] = difference(
                rough.impulses, close.impulses, met.impulses
            )
    if layout.wear:
        least = safe_divide(lasting, plan.duration) * jnp.stack(least_volumes(model))
        found[Check.HALVED_WEAR] = difference(rough.volumes, close.volumes, met.volumes, 1.0, least)
    return found


def _motion(
    model: Model, plan: Plan, tally: Tally, off: Array, scales: Array, led: Led
) -> Float[Array, ""]:
    """By how much bodies would be elsewhere at the end of the run, beside their way, if all of it
    were `off` by what the windows end with (windows, states).

    Beside the longest way of a coordinate (`ways`); speeds beside the usual ones, where no contact
    vibrates.
    """
    layout = model.layout
    count = layout.coordinates
    share = safe_divide(plan.duration, jnp.sum(_durations(plan, FINE)))
    total = share * jnp.sum(abs(off), axis=0)
    gone = total[:count] * reaches(model.system, longest_arm(model.system))
    places = safe_divide(jnp.max(gone, initial=0.0), longest_way(model, tally.reach, led))
    if tally.squares is None:
        return places
    speeds = slice(count, layout.memory_start)
    usual = jnp.max(safe_sqrt(tally.squares / (plan.intervals + 1)) * scales, initial=0.0)
    usual = jnp.maximum(usual, STILL * longest_arm(model.system) / plan.duration)
    faster = jnp.max(total[speeds] * scales, initial=0.0) / usual
    return jnp.maximum(places, faster)


def _durations(plan: Plan, turn: str) -> Float[Array, "windows 1"]:
    """How long the turn of this name takes in each window [s]."""
    rows = plan.parts.first[plan.shadows(turn)]
    return (_rows(plan.turns.stop, rows) - _rows(plan.turns.start, rows))[:, None]


def _rows(array: Array, places: np.ndarray) -> Array:
    """Rows of an array at places known beforehand, which a kernel reads by themselves."""
    return jnp.stack([array[int(k)] for k in places])
