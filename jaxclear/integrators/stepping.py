"""What all integrators with fixed steps share: how many steps fill an interval, going through them,
and the answer at its end.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxclear.formulations.contact_rows import TimeStep
from jaxclear.integrators.base import Advance, Interval
from jaxclear.integrators.events import Watch
from jaxclear.integrators.outcome import Outcome
from jaxclear.integrators.peaks import Peaks
from jaxclear.native import while_loop

# Share of a step by which rounding may miss the end of an interval.
SLIVER = 1e-9
# More steps than any run takes: at 200 ns each, a kernel's fastest, two days.
MOST_STEPS = 1e12


def divide(interval: Interval, step: Any, fixed: int | None = None) -> tuple[Any, Any]:
    """(number of steps, their length [s]): the fewest equal ones no longer than `step`, or the
    `fixed` number. Where that is more
    than any run takes (a step of 0, which only a traced number can be here) one step of nan.
    """
    start, stop = interval.start, interval.stop
    count = jnp.maximum(jnp.ceil((stop - start) / step * (1 - SLIVER)), 1.0)
    count = count if fixed is None else jnp.asarray(float(fixed))
    known = count <= MOST_STEPS
    return jnp.where(known, count, 1.0).astype(int), (stop - start) / jnp.where(
        known, count, jnp.nan
    )


def resolved(step: Any, interval: Interval) -> Any:
    """A step [s], nan where it is so short that the time at the end of an interval does not grow by
    it: a loop that waits for the end would wait for ever."""
    return jnp.where(interval.stop + step > interval.stop, step, jnp.nan)


def march(
    one: Callable[[Any, Any, Any], tuple], steps: Any, state: Any, warm_start: Any
) -> tuple[Any, Any]:
    """State and warm start after `steps` turns of (index, state,
    warm start) -> (state, warm start), in one loop."""
    turn = lambda carry: (carry[0] + 1, *one(*carry))
    _, state, warm_start = while_loop(
        lambda carry: carry[0] < steps, turn, (jnp.zeros((), int), state, warm_start)
    )
    return state, warm_start


def counted(one: Callable[[Any, Any], Any], steps: int, first: Any) -> Any:
    """What is handed on after so many turns of (index, what is handed on) -> what is handed on, in
    a loop that reverse mode goes through backwards: it keeps what a turn is handed within one
    interval at a time, and of the others what these begin with, and goes through all once more."""
    turn = jax.checkpoint(lambda carry, index: (one(index, carry), None), prevent_cse=False)
    through = lambda first: jax.lax.scan(turn, first, jnp.arange(steps))[0]
    return jax.checkpoint(through, prevent_cse=False)(first)


def arrived(
    end: Any,
    steps: Any,
    warm_start: Any,
    met: Peaks | None = None,
    watch: Watch | None = None,
) -> Advance:
    """The answer of steps that are never rejected, and that have `met` so deep contacts; `watch`:
    events on the way."""
    outcome = jnp.where(jnp.all(jnp.isfinite(end)), Outcome.REACHED, Outcome.NOT_FINITE)
    events = None if watch is None else watch.events
    return Advance(end, steps, jnp.zeros_like(steps), warm_start, outcome, met, events)


def searching_steps(
    interval: Interval, longest: Any, step: Callable, carry: tuple, loose: float
) -> Advance:
    """The answer of equal steps, each of which searches for percussions or friction.

    `longest`: length [s] that no step exceeds; `step`: (time step, state, last) -> (state, last);
    `carry`: state and warm start. The last entry of the warm start (of its first array) is the
    largest residual with which a search has ended, and beyond `loose` the laws are not met.
    """
    steps, h = divide(interval, longest)

    def one(index, state, last):
        return step(TimeStep(interval.start + index * h, h), state, last)

    state, warm_start = carry
    (first, *others), structure = jax.tree.flatten(warm_start)
    begun = jax.tree.unflatten(structure, [first.at[-1].set(0.0), *others])
    state, warm_start = march(one, steps, state, begun)
    found = arrived(state, steps, warm_start)
    residual = jax.tree.leaves(warm_start)[0][-1]
    failed = (found.outcome == Outcome.REACHED) & (residual > loose)
    return found._replace(outcome=jnp.where(failed, Outcome.LAWS_NOT_MET, found.outcome))
