"""Looks at some of a run's saved states, of which a run judges itself: where they lie, and how
functions of an instant are taken of them: all at once, so that what they share is worked out once.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxclear.formulations.model import Instant, Model
from jaxclear.ground.quantity import constant
from jaxclear.results.state_history import StateHistory, over_time

# Saved states of a run, at most, that are looked at: a loop that has come open stays so for long.
MOST = 50


class Looks(NamedTuple):
    """The saving `intervals` at whose ends a run looks, and what it has `seen`: the states at its
    start and there, of which `model`."""

    intervals: np.ndarray
    seen: StateHistory
    model: Model

    @property
    def rows(self) -> np.ndarray:
        """Their places among the saving times, the start in front."""
        return np.concatenate([[0], 1 + self.intervals])

    def of(self, function: Callable[[Instant], dict[str, Array]]) -> dict[str, Array]:
        """What a function says of every state seen, the run's start in front. No derivatives."""
        return over_time(self.seen, function, self.model)


def looked_at(count: int) -> np.ndarray:
    """Up to `MOST` of so many saving intervals, evenly spread, the last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, MOST)).round().astype(int))


def look(history: StateHistory, model: Model) -> Looks:
    """The looks of a run at itself."""
    intervals = looked_at(len(history.time) - 1)
    rows = np.concatenate([[0], 1 + intervals])
    still, model = constant((history, model))
    time, states, read = jax.tree.map(
        lambda x: jnp.asarray(x)[rows], (still.time, still.states, still.read)
    )
    return Looks(intervals, dataclasses.replace(still, time=time, states=states, read=read), model)
