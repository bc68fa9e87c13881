"""A problem beside others of the same question: what each run of it tells, and what it costs.

A cheaper model takes those of the accurate problem's variables that it has, and answers those of
its responses that it has. Any function of the variables may carry an estimate, so a run of a
cheaper model that fails, or a response that it lacks, counts as the middle: it explains nothing and
makes no error.
"""

import time
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.ground.arguments import expect
from jaxclear.ground.wording import listed
from jaxclear.studies.infinite_responses import refuse_infinite
from jaxclear.studies.problem import Problem
from jaxclear.studies.store.batch import chunk_size, evaluate_all
from jaxclear.studies.store.digest import in_texts
from jaxclear.studies.store.store import CURRENT, compute_address, use_store

# What a single cheaper model is called.
ALONE = "cheaper"
ACCURATE = "the problem"
# What takes less [s] is timed in full chunks, the shortest of so many; clocks tell no less than a
# moment [s].
SHORT, TIMES, MOMENT = 0.05, 3, 1e-6


class Model(NamedTuple):
    """A problem by the name it has in this study, which of the accurate problem's variables it
    takes, and how many samples it runs together."""

    name: str
    problem: Problem
    columns: tuple[int, ...]
    chunk: int

    def runs(self, values: np.ndarray, progress_bar: bool = False) -> Any:
        """Its samples at values (samples, variables) of the accurate problem."""
        return evaluate_all(
            self.problem,
            jnp.asarray(values[:, list(self.columns)]),
            chunk=self.chunk,
            progress_bar=progress_bar,
            label=self.name,
        )

    def timed(self, values: np.ndarray, progress_bar: bool = False) -> tuple[Any, float]:
        """Its samples at values, and what a run takes [s] without compilation: CPU time, or where
        an accelerator computes the time on the clock. What is too short to be timed is timed in
        full chunks, as the study runs them."""
        result, store = self.runs(values, progress_bar), CURRENT.get()
        if store is None:
            return result, self._seconds_a_run(values)
        # What is read from a store takes no time: the first time it was computed counts.
        address = compute_address(in_texts(self.problem), "seconds a run", self.chunk)

        def load() -> Any:
            chunk = store.load(address)
            return None if chunk is None else float(chunk.arrays["seconds"])

        def compute() -> float:
            with use_store(None):
                seconds = self._seconds_a_run(values)
            store.write(address, {"seconds": seconds})
            return seconds

        return result, store.obtain(address, load, compute, wait=True)

    def _seconds_a_run(self, values: np.ndarray) -> float:
        """What a run takes [s], without compilation."""
        one = values[: self.chunk]
        # The first may find something left to compile.
        spent = min(self._seconds(one), self._seconds(one))
        if spent < SHORT:
            one = np.resize(values, (self.chunk, values.shape[1]))
            self.runs(one)
            spent = min([self._seconds(one) for _ in range(TIMES)])
        return max(spent, MOMENT) / len(one)

    def _seconds(self, values: np.ndarray) -> float:
        """What runs at values take, compiled before."""
        clock = time.process_time if jax.default_backend() == "cpu" else time.perf_counter
        start = clock()
        self.runs(values)
        return clock() - start


def models_of(problem: Problem, cheaper: Any, samples: int) -> list[Model]:
    """The accurate problem and the cheaper ones as models.

    Args:
        problem: the accurate one.
        cheaper: a problem, or several by name.
        samples: number of samples, which bounds chunks.

    Raises:
        ValueError: a cheaper problem has other variables, or no common response.
    """
    mapping = cheaper if isinstance(cheaper, Mapping) else {ALONE: cheaper}
    if not mapping:
        raise ValueError("cheaper is empty; give a cheaper problem, or several by name.")
    every = tuple(range(len(problem.names)))
    models = [Model(ACCURATE, problem, every, chunk_size(problem, samples))]
    for name, model in mapping.items():
        expect(name, str, "a name in cheaper", "a text")
        expect(model, Problem, f'cheaper "{name}"', "a problem of jaxclear")
        strange = [n for n in model.names if n not in problem.names]
        if strange or not model.names:
            raise ValueError(
                f'cheaper "{name}" varies {listed(model.names) or "nothing"}; its variables must '
                f"be among those of the problem: {listed(problem.names)}."
            )
        if not set(model.response_names) & set(problem.response_names):
            raise ValueError(
                f'cheaper "{name}" answers {listed(model.response_names)}; it must have a response '
                f"of the problem: {listed(problem.response_names)}."
            )
        columns = tuple(problem.names.index(n) for n in model.names)
        models.append(Model(name, model, columns, chunk_size(model, samples)))
    return models


class ModelResponses(NamedTuple):
    """What runs of a model tell of each response of the problem: `responses` (samples, responses),
    nan where it failed or has none, and whether each run is good and carries no warning."""

    responses: np.ndarray
    good: np.ndarray

    def moments(self, middle: np.ndarray) -> np.ndarray:
        """(samples, 2 responses): deviations from the middle (responses,) and their squares, 0
        where a run tells nothing."""
        away = np.where(np.isfinite(self.responses), self.responses - middle, 0.0)
        return np.concatenate([away, away**2], axis=1)


def model_responses(model: Model, names: tuple[str, ...], result: Any) -> ModelResponses:
    """Responses of samples of a model, nan where it lacks them or failed.

    Args:
        model: that was run.
        names: of the responses, in the order of the result.
        result: of the runs.
    """
    reached, nothing = result.reached_responses(), np.full(len(result.outcome), np.nan)
    refuse_infinite(model.problem, result.responses, "mean or deviation")
    indices = [i for i, name in enumerate(names) if name in model.problem.response_names]
    responses = np.stack([reached.get(name, nothing) for name in names], axis=1)
    good = np.all(np.isfinite(responses[:, indices]), axis=1)
    return ModelResponses(np.where(good[:, None], responses, np.nan), good)
