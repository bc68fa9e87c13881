"""Looks at some of a run's saved states, of which a run judges itself: where they lie, and how
functions of an instant are taken of them.

All functions are taken of a look at once, by one kernel: what they share is worked out once, and
XLA, which would compile them for longer than the run's own loop, sees one call.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxclear.formulations.model import Instant
from jaxclear.ground.quantity import constant
from jaxclear.native import while_loop
from jaxclear.results.state_history import StateHistory, reader

# Saved states of a run, at most, that are looked at: a loop that has come open stays so for long.
MOST = 50


class Looks(NamedTuple):
    """The saving `intervals` at whose ends a run looks, and what it has `seen`: the states at its
    start and there."""

    intervals: np.ndarray
    seen: StateHistory

    def of(self, function: Callable[[Instant], dict[str, Array]]) -> dict[str, Array]:
        """What a function says of every state seen, the run's start in front. No derivatives."""
        one, rows = reader(self.seen, function)
        return jax.vmap(lambda *row: _once(one, *row))(*rows)


def look(history: StateHistory) -> Looks:
    """Up to `MOST` of the saving intervals, evenly spread, the last among them."""
    count = len(history.time) - 1
    intervals = np.unique(np.linspace(0, count - 1, min(count, MOST)).round().astype(int))
    rows = np.concatenate([[0], 1 + intervals])
    still = constant(history)
    time, states, read = jax.tree.map(
        lambda x: jnp.asarray(x)[rows], (still.time, still.states, still.read)
    )
    return Looks(intervals, dataclasses.replace(still, time=time, states=states, read=read))


def _once(function: Callable, *numbers: Any) -> Any:
    """A function of few numbers as a loop of one turn: so it becomes a kernel."""
    traced = jax.jit(function)
    shapes = jax.eval_shape(traced, *numbers)
    nothing = jax.tree.map(lambda each: jnp.zeros(each.shape, each.dtype), shapes)
    turn = lambda carry: (carry[0] + 1, traced(*numbers))
    return while_loop(lambda carry: carry[0] < 1, turn, (jnp.zeros((), int), nothing))[1]
