"""Touches and releases of contacts, noted as a run steps over them, and the deepest indentation of
every contact in a run, and how hard those that damp were pressed at most, with their derivatives.

A contact touches where its indentation rises through 0 and is released where it falls through it.
Between the ends of a step the indentation follows Hermite's cubic through the depths and rates
there. So many events of each contact as are asked for are kept between two saving times; all are
counted.

Of peaks, steps know the contacts at both their ends, and the largest of these is kept. The
derivative is that of the highest point of the path: there the rate is 0, so that it does not hang
on when that is, and of the end of a step it would be off by the step's length times that of the
rate. Between the ends of the step in which a contact turns, derivatives follow Hermite's cubic, as
the indentation does, and the law of its force along it. Largest values are those of a saving
interval, but their derivatives those of the largest of the run so far (`since`): a contact may turn
in the first step of an interval, deepest at the end of the one before; and the motion whose
derivative is asked for may press hardest an interval sooner or later than the run beside which it
goes.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.formulations.compliant import CompliantContact
from jaxclear.formulations.impact_speed import (
    ContactMotion,
    PerContact,
    bends,
    cubic,
    passage,
    summit,
    with_path_derivative,
)
from jaxclear.formulations.model import Model, State
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.quantity import constant
from jaxclear.ground.tangents import apply_if, derived, moved, moving_with, pushed
from jaxclear.multibody import kinematics
from jaxclear.multibody.forces import force_of, transmitting
from jaxclear.multibody.state import unpack_followed, unpack_motion


class Events(NamedTuple):
    """Events of each contact in a saving interval: `times` [s], `rates` of the indentation there
    [m/s] (positive: touch), and how many there were, kept or not."""

    times: Float[Array, "*intervals contacts most"]
    rates: Float[Array, "*intervals contacts most"]
    counts: Float[Array, "*intervals contacts"]


class Watch(NamedTuple):
    """How the contacts moved at the end of the last step, and the events until then (None: none are
    asked for); the largest that each coupling whose force follows from the state has transmitted
    where steps begin [N m, N] (None: there is none)."""

    motion: Any  # ContactMotion | None
    events: Any  # Events | None
    transmitted: Any


def watch_from(model: Model, time: Any, state: State) -> Watch:
    """The record of events at the start of a saving interval.

    Args:
        model: of the run.
        time: start of the interval [s].
        state: at the start, shape (n,).
    """
    couplings = len(transmitting(model.system))
    none = jnp.zeros(couplings) if couplings else None
    if not model.events:
        return Watch(None, None, none)
    motion = contact_motion(model, time, state)
    return Watch(motion, nothing(motion, model.events), none)


def transmitted(model: Model, time: Any, state: State, largest: Any) -> Any:
    """Largest force that each coupling has transmitted, updated at an instant [N m, N].

    Args:
        model: of the run.
        time: instant [s].
        state: shape (n,).
        largest: before; None: not followed.
    """
    if largest is None:
        return None
    system, entries = model.system, model.entries(state)
    motions = kinematics.link_motions(system, *unpack_motion(system, entries), time)
    instant = time, unpack_followed(model.layout, entries)
    sizes = [abs(force_of(system, motions, name, *instant)) for name in transmitting(system)]
    return jnp.where(sp.stack(sizes) > largest, sp.stack(sizes), largest)


def nothing(motion: ContactMotion, most: int) -> Events:
    """No events yet."""
    none = jnp.zeros_like(motion.depths)
    blank = jnp.zeros((len(none), most))
    return Events(blank, blank, none)


def contact_motion(model: Model, time: Any, state: State) -> ContactMotion:
    """Indentations and their rates, of all contacts.

    Args:
        model: of the run.
        time: instant [s].
        state: shape (n,).
    """
    return CompliantContact().contacts(model, time, state)


def watched(
    watch: Watch, model: Model, time: Any, length: Any, before: State, after: State
) -> Watch:
    """The record of events after a step.

    Args:
        watch: before the step.
        model: of the run.
        time, length: start and length of the step [s].
        before, after: states at its ends, shape (n,).
    """
    watch = watch._replace(transmitted=transmitted(model, time, before, watch.transmitted))
    if watch.events is None:
        return watch
    motion = contact_motion(model, time + length, after)
    events = noted(watch.events, time, length, watch.motion, motion)
    return watch._replace(motion=motion, events=events)


def noted(
    events: Events, time: Any, length: Any, before: ContactMotion, after: ContactMotion
) -> Events:
    """The events with those of a step.

    Args:
        events: before the step.
        time, length: start and length of the step [s].
        before, after: motion of the contacts at its ends.
    """
    closed = before.depths >= 0
    happened = closed != (after.depths >= 0)
    path = (before.depths, after.depths, length * before.rates, length * after.rates)

    share = with_path_derivative(path, passage(constant(path), 0.0, jnp.ones_like(before.depths)))
    rate = safe_divide(cubic(path, share)[1], length)
    places = jnp.arange(events.times.shape[1], dtype=float)
    here = (places == events.counts[:, None]) & happened[:, None]
    return Events(
        jnp.where(here, (time + share * length)[:, None], events.times),
        jnp.where(here, rate[:, None], events.rates),
        events.counts + jnp.where(happened, 1.0, 0.0),
    )


def together(before: Events, more: Events) -> Events:
    """The events of two parts of a saving interval, of each contact the first ones."""
    places = jnp.arange(before.times.shape[1], dtype=float)
    behind = places - before.counts[:, None]
    moved = behind[:, :, None] == places

    def both(old: Array, new: Array) -> Array:
        moved_in = jnp.sum(jnp.where(moved, new[:, None, :], 0.0), axis=2)
        return jnp.where(behind >= 0, moved_in, old)

    times, rates = both(before.times, more.times), both(before.rates, more.rates)
    return Events(times, rates, before.counts + more.counts)


# The highest point of a force within a step is sought by halving it so often.
HALVINGS = 12
# Forces that differ by no more than this share of themselves are the same but for rounding.
ROUNDING = 1e-9
# A later peak that is smaller than this share of an earlier one has nothing to say about it.
NEAR = 0.9


class Peaks(NamedTuple):
    """The largest so far of every possible contact: indentation [m], and normal force [N] where
    some contact damps (None: where none does)."""

    depths: PerContact
    forces: Any = None


def no_peaks(depths: PerContact, damped: bool) -> Peaks:
    """Before the first step of a run with so many contacts."""
    return Peaks(jnp.zeros_like(depths), jnp.zeros_like(depths) if damped else None)


def risen(peaks: Peaks, depths: PerContact, forces: Any) -> Peaks:
    """The peaks with the depths and forces of an instant; nan does not count.

    Args:
        peaks: largest depths and forces so far.
        depths: indentations [m].
        forces: normal forces of contacts that damp [N].
    """
    larger = lambda new, old: jnp.where(new > old, new, old)
    pressed = None if peaks.forces is None else larger(forces, peaks.forces)
    return Peaks(larger(depths, peaks.depths), pressed)


def since(so_far: Peaks | None, first: Peaks) -> Peaks:
    """What a saving interval has met where it begins, with the derivative of the largest `so_far`
    in the run (None: it is not known) where that is as large."""
    return _with_derivative(lambda so_far, first: first > so_far, so_far, first)


def among(so_far: Peaks | None, peaks: Peaks) -> Peaks:
    """The `peaks` of a saving interval by steps that know of no peaks before it, with the
    derivative of the largest in the run."""
    return _with_derivative(lambda so_far, peaks: peaks >= so_far, so_far, peaks)


def newest(so_far: Any, peaks: Any, counts: Any) -> Any:
    """The larger of two peaks, with the derivative of the later one, which contains the other's.

    Only a later peak that counts and comes as near as `NEAR` gives its derivative.

    Args:
        so_far: peak until the interval began.
        peaks: peak until its end.
        counts: whether the later one is valid.
    """

    def rule(numbers, tangents):
        so_far, peaks, counts = numbers
        before, after = map(moved, tangents[:2])
        return jnp.where(counts & ~(peaks < NEAR * so_far), after, before)

    larger = lambda so_far, peaks, counts: jnp.where(counts & ~(peaks < so_far), peaks, so_far)
    return derived(larger, rule)(so_far, peaks, counts)


def _with_derivative(counts: Callable, so_far: Peaks | None, peaks: Peaks) -> Peaks:
    """These `peaks`, with their derivative where it is their own, otherwise that of those
    `so_far`."""

    def one(so_far, peaks):
        if so_far is None or peaks is None:
            return peaks

        def rule(numbers, tangents):
            before, after = map(moved, tangents)
            return jnp.where(counts(*numbers), after, before)

        return derived(lambda so_far, peaks: moving_with(so_far, peaks), rule)(so_far, peaks)

    return peaks if so_far is None else Peaks(*map(one, so_far, peaks))


def peaks(
    motion: Any, arrays: Any, ends: tuple, motions: tuple, peaks: Peaks, so_far: Peaks | None = None
) -> Peaks:
    """The peaks after a step, with their derivatives.

    Args:
        motion: of the model (`saltation.motion_of`).
        arrays: of the model.
        ends: (time [s], state) at the start and at the end.
        motions: of the contacts there, whose own derivatives do not count.
        peaks: until the start of the step.
        so_far: peaks of the run until the interval began; None: none.
    """

    def larger(arrays, start, end, motions, peaks, _):
        forces = None if peaks.forces is None else motion.pressing(arrays, end[1], motions[1])
        return moving_with(end[1][0], risen(peaks, motions[1].depths, forces))

    def moving(numbers, tangents):
        arrays, start, end, motions, peaks, before = numbers
        d_arr, *d_in, _, so_far, _ = tangents
        so_far, length = jax.tree.map(moved, so_far), end[0] - start[0]
        peaks = peaks if before is None else risen(peaks, *before)
        deeper, share = _deeper(peaks.depths, motions, length)
        force = _Force(motion, arrays, (start, end), motions, length)
        pressed = force.reaches(peaks.forces)

        def ahead(so_far):
            result = [
                pushed(motion.contacts, (arrays, *point), (d_arr, *each))[1]
                for point, each in zip((start, end), d_in, strict=True)
            ]
            moves = [moved(each[0]) for each in d_in]
            bent = bends(_path(motions, length))
            result = _at_fixed_times(result, motions, moves, bent, length)
            depths = jnp.where(deeper, cubic(_path(result, length), share)[0], so_far.depths)
            forces = force.moved(pressed, (d_arr, d_in[1][1], result), so_far.forces)
            return Peaks(depths, forces)

        needed = jnp.any(deeper) if pressed is None else jnp.any(deeper | pressed)
        return apply_if(needed, ahead, so_far)

    return derived(larger, moving)(arrays, *ends, motions, peaks, so_far)


def _deeper(peaks: PerContact, motions: tuple, length: Any) -> tuple:
    """Which contacts are deepest in a step, and at which share of it. One that turns in it has been
    deepest before, at the end of this step or nowhere."""
    before, after = motions
    turns = (before.rates > 0) & (after.rates <= 0)
    turns = turns & (jnp.maximum(before.depths, after.depths) >= peaks)
    share = jnp.where(turns, summit(_path(motions, length)), 1.0)
    return turns | (after.depths > peaks), share


def _path(motions: Any, length: Any) -> tuple:
    """Hermite's cubic through the motion at both ends of a step, or what it moves by."""
    before, after = motions
    return before.depths, after.depths, length * before.rates, length * after.rates


class _Force(NamedTuple):
    """Normal forces along a step of this length [s] between two `ends`, (time [s], state), from the
    `motions` of the contacts there and the impact speeds at its end."""

    motion: Any
    arrays: Any
    ends: tuple
    motions: tuple[ContactMotion, ContactMotion]
    length: Any

    def at_ends(self) -> list:
        state = self.ends[1][1]
        return [self.motion.pressing(self.arrays, state, motion) for motion in self.motions]

    def reaches(self, peaks: Any) -> Any:
        """Which contacts are pressed harder in the step than ever, or have just been."""
        if peaks is None:
            return None
        most = jnp.maximum(*self.at_ends())
        return (most > 0) & (most >= (1 - ROUNDING) * peaks)

    def moved(self, pressed: Any, d_in: tuple, so_far: Any) -> Any:
        """The derivative of the largest forces, of those `pressed` at the highest point of this
        step; `d_in`: of (arrays, state, contacts at both ends)."""
        if pressed is None:
            return None
        rises, share, continues = self._summit()
        d_arr, d_state, d_so_far = d_in
        # There a force does not hang on when it is: without the time by which all comes later,
        # which is large beside a contact and would have to cancel. A force that still grows as the
        # step ends is the largest where the run ends with it: at that time, whatever comes later.
        gains = self._gains()
        early, late = (_later(*each) for each in zip(self.motions, d_so_far, gains, strict=True))
        later = jnp.where(jnp.less(*self.at_ends()), late, early)
        later = jnp.where(continues, 0.0, later)
        d_so_far = [
            ContactMotion(*(x + later * gain for x, gain in zip(now, gains, strict=True)))
            for now, gains in zip(d_so_far, gains, strict=True)
        ]
        along = lambda arrays, state, path: self._at(arrays, state, path, share)
        numbers = self.arrays, self.ends[1][1], _path(self.motions, self.length)
        moves = pushed(along, numbers, (d_arr, d_state, _path(d_so_far, self.length)))[1]
        return jnp.where(pressed & rises, moves, so_far)

    def _gains(self) -> list[ContactMotion]:
        """Rates of the contacts' motion at both ends."""
        contacts = lambda time, state: self.motion.contacts(self.arrays, time, state)
        gains = []
        for (time, state), motion in zip(self.ends, self.motions, strict=True):
            shares = jnp.where(motion.depths >= 0, 1.0, 0.0)
            flow = self.motion.rates(self.arrays, shares, time, state)
            gains.append(jax.jvp(contacts, (time, state), (jnp.ones_like(time), flow))[1])
        return gains

    def _at(self, arrays: Any, state: Any, path: tuple, share: Any) -> Any:
        depths, slopes = cubic(path, share)
        return self.motion.pressing(arrays, state, ContactMotion(depths, slopes / self.length))

    def _summit(self) -> tuple[Any, Any, Any]:
        """Whether each force grows where the step begins, the share of the step up to which it
        does, and whether it still grows as the step ends."""
        path = _path(self.motions, self.length)
        force = lambda share: self._at(self.arrays, self.ends[1][1], path, share)

        def grows(share):
            _, slope = jax.jvp(force, (share,), (jnp.ones_like(share),))
            depth, rate = cubic(path, share)
            return jnp.where(depth < 0, rate, slope) > 0

        def halve(carry):
            i, low, high = carry
            middle = 0.5 * (low + high)
            early = grows(middle)
            return i + 1, jnp.where(early, middle, low), jnp.where(early, high, middle)

        start, end = jnp.zeros_like(path[0]), jnp.ones_like(path[0])
        first = jnp.zeros((), int), start, end
        _, low, high = jax.lax.while_loop(lambda carry: carry[0] < HALVINGS, halve, first)
        return grows(start), 0.5 * (low + high), grows(end)


def _later(motion: ContactMotion, moves: ContactMotion, gains: ContactMotion) -> Any:
    """By how much later a contact moves as it does [s]: as near as that comes to how it is moved,
    with rates beside depths as in its vibration."""
    stiffness = abs(safe_divide(gains.rates, motion.depths))
    weigh = lambda a, b: stiffness * a.depths * b.depths + a.rates * b.rates
    return -safe_divide(weigh(moves, gains), weigh(gains, gains))


def _at_fixed_times(results: list, motions: Any, moves: Any, bent: Any, length: Any) -> list:
    """Derivatives of contacts at instants that do not move, from those at ends of a step that
    `moves` tell of."""
    gains = [safe_divide(each, length * length) for each in bent]
    return [
        ContactMotion(result.depths - move * now.rates, result.rates - move * gain)
        for result, now, move, gain in zip(results, motions, moves, gains, strict=True)
    ]
