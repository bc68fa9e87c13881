"""Samples of a problem that a design has computed, in memory for the surfaces to come.

They are asked for in batches of one size, so that one compiled program serves them all and a store
finds them again.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from jaxclear.studies.infinite_responses import bounded, successes
from jaxclear.studies.run_warnings import codes_of
from jaxclear.studies.store.batch import evaluate_all
from jaxclear.studies.store.store import CURRENT

# Samples a batch: one record of the store, and one chunk of the compiled program.
BATCH = 32


class Runs:
    """Values (samples, variables) and responses (samples, responses), `nan` of those that failed;
    `codes` (samples,): of what they warn (`studies.run_warnings`)."""

    def __init__(self, problem: Any, show: bool, batch: int = BATCH):
        self.problem, self.show, self.batch = problem, show, batch
        self.values = np.zeros((0, len(problem.names)))
        self.responses = np.zeros((0, len(problem.response_names)))
        self.codes = np.zeros(0, np.int64)
        self.computed = 0

    @property
    def count(self) -> int:
        """Samples computed or taken from the store."""
        return len(self.values)

    @property
    def failed(self) -> int:
        """Samples without a response."""
        return int(np.sum(np.isnan(self.responses).any(axis=1)))

    def warned(self, first: int) -> np.ndarray:
        """Codes (runs,) of those that did not fail, from the sample of this number on."""
        return self.codes[first:][~np.isnan(self.responses[first:]).any(axis=1)]

    def named(self, first: int) -> dict[str, np.ndarray]:
        """Responses by name (samples,), from the sample of this number on."""
        return dict(zip(self.problem.response_names, self.responses[first:].T, strict=True))

    def ask(self, values: np.ndarray, label: str) -> np.ndarray:
        """Responses (samples, responses) of values (samples, variables)."""
        count, store = len(values), CURRENT.get()
        before = store.loaded if store else 0
        padded = np.concatenate([values, np.repeat(values[-1:], -count % self.batch, axis=0)])
        result = evaluate_all(
            self.problem, padded, chunk=self.batch, progress_bar=self.show, label=f"design, {label}"
        )
        self.computed += len(padded) - (store.loaded - before if store else 0)
        good, responses = successes(self.problem, result.outcome, result.responses)
        columns = [responses[name][:count] for name in self.problem.response_names]
        self.values = np.concatenate([self.values, values])
        self.responses = np.concatenate([self.responses, np.stack(columns, axis=1)])
        # A failed run is none that warns.
        codes = np.where(good, codes_of(result.checks, len(padded)), 0)[:count]
        self.codes = np.concatenate([self.codes, codes])
        return self.responses[-count:]

    def good(self, inside: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Whether each sample (samples,) succeeded and lies inside."""
        return ~np.isnan(self.responses).any(axis=1) & inside(self.values)

    def within(
        self, inside: Callable[[np.ndarray], np.ndarray], levels: Callable[[str], list[float]]
    ) -> tuple[np.ndarray, np.ndarray]:
        """(values, responses) of the samples that succeeded and lie inside, for a surface: where
        responses are infinite, what they are told up to, or beyond all that are not and beyond the
        levels of a response that limits hold it against."""
        good = self.good(inside)
        names = self.problem.response_names
        pairs = zip(names, self.responses[good].T, strict=True)
        columns = [bounded(self.problem, name, values, levels(name)) for name, values in pairs]
        return self.values[good], np.stack(columns, axis=1)
