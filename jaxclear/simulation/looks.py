"""Looks at some of a run's saved states, by which a run is judged: where they lie, and how
functions of an instant are taken of them: all at once, so that what they share is worked out once.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxclear.formulations.model import Instant, Model
from jaxclear.ground import sparse as sp
from jaxclear.ground.quantity import constant
from jaxclear.multibody import kinematics, state
from jaxclear.native import through_rows
from jaxclear.results.state_history import StateHistory

# Saved states of a run, at most, that are looked at: a loop that has come open stays so for long.
MOST = 50


class Looks(NamedTuple):
    """The saving `intervals` at whose ends a run looks, at its start too; its `history`, of which
    nothing is differentiated, and its `model`."""

    intervals: np.ndarray
    history: StateHistory
    model: Model

    @property
    def rows(self) -> np.ndarray:
        """Their places among the saving times, the start in front."""
        return np.concatenate([[0], 1 + self.intervals])

    def of(self, function: Callable[[Instant], dict[str, Any]]) -> dict[str, Any]:
        """What a function of an instant says of every look. No derivatives."""
        rows, times, states = self.rows, jnp.asarray(self.history.time), self.history.states
        worn = self.history.read
        # Means of forces are those from one look to the next.
        begins, ends = np.append(rows[:1], rows[:-1]), np.append(rows[1:2], rows[1:])
        impulses = range(self.model.layout.impulse_start, self.model.layout.energy_start)

        def seen(row: Any, begin: Any, end: Any) -> dict[str, Any]:
            before, after = (_numbers_of(states, k, impulses) for k in (begin, end))
            length = times[end] - times[begin]
            means = [(late - early) / length for early, late in zip(before, after, strict=True)]
            time, entries = times[row], _numbers_of(states, row)
            read = jax.tree.map(lambda depths: depths[row], worn)
            model, system = self.model, self.model.system
            q, v = state.unpack_motion(system, entries)
            now = Model(system, read, model.stabilisation, model.layout, model.projects)
            motions = kinematics.link_motions(system, q, v, time)
            return sp.dense(function(Instant(now, motions, q, v, time, entries, means)))

        return through_rows(seen, rows, begins, ends)


def _numbers_of(rows: Array, row: Any, columns: Any = None) -> list[Array]:
    """The numbers of a row of many, one by one: so a kernel reads any number of them by index."""
    columns = range(rows.shape[1]) if columns is None else columns
    return [jax.lax.dynamic_slice(rows, (row, k), (1, 1))[0, 0] for k in columns]


def look(history: StateHistory, model: Model) -> Looks:
    """The looks of a run at itself: up to `MOST`, evenly spread, the last saving time among
    them."""
    count = len(history.time) - 1
    intervals = np.unique(np.linspace(0, count - 1, min(count, MOST)).round().astype(int))
    return Looks(intervals, *constant((history, model)))
