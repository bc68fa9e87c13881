"""A Monte Carlo sample that grows until its means are known as accurately as asked."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import jax
import numpy as np

from jaxclear.studies.experiment import SampleResult
from jaxclear.studies.infinite_responses import INSTEAD
from jaxclear.studies.problem import Problem
from jaxclear.studies.sampling import Drawing
from jaxclear.studies.statistics.accuracy import Goals, Piece, missed_accuracies, unreached

# What a study begins with that goes on until it is accurate.
FIRST_SAMPLES = 256


def first_of(samples: int, scramblings: int) -> int:
    """With how many a study of at most so many samples begins: all scramblings are of one length, a
    power of two, so that they can be doubled."""
    return scramblings * 2 ** int(np.log2(samples // scramblings))


def until_accurate(problem: Problem, first: int, most: int, request: Goals, grown: Callable) -> str:
    """Doubles a sample until its means are accurate; a sentence where they are not, else "".

    A response that is infinite in some samples has no mean: no samples are added for it.

    Args:
        problem: with the responses.
        first: number of samples to begin with.
        most: largest number of samples.
        request: required accuracies.
        grown: function of a number of samples: pieces of responses by name (samples,), and
            scramblings.
    """
    count = first
    while True:
        endless: set[str] = set()
        short = missed_accuracies(request, _note_infinite(problem, grown(count), endless))
        short = {name: value for name, value in short.items() if name not in endless}
        if not short or 2 * count > most:
            without = [_why_no_mean(problem, name) for name in request[0] if name in endless]
            return " ".join(filter(None, [unreached(short), *without]))
        count *= 2


def _note_infinite(problem: Problem, pieces: Iterable[Piece], endless: set[str]) -> Iterator[Piece]:
    """The pieces of a sample; the responses that have infinite answers in them are put down."""
    for responses, group in pieces:
        infinite = (name for name, values in responses.items() if np.isinf(values).any())
        endless.update(name for name in infinite if problem.description.responses[name].infinite)
        yield responses, group


def _why_no_mean(problem: Problem, name: str) -> str:
    """Why the accuracy of a mean is not reached that there is not."""
    return (
        f'The accuracy asked is not reached: "{name}" is infinite in some samples '
        f"({problem.description.responses[name].infinite}), and there is no mean of it; leave "
        f"accuracy out, and {INSTEAD}."
    )


class Grown:
    """A sample in memory: values (samples, variables), and what `run` gives for them, `chunk`
    samples together."""

    def __init__(self, drawing: Drawing, run: Callable[[np.ndarray], SampleResult], chunk: int):
        self.drawing, self.run, self.chunk = drawing, run, chunk
        self.values = np.zeros((0, drawing.count))
        self.result: Any = None

    def to(self, samples: int) -> None:
        """Grows it to so many samples."""
        there = len(self.values)
        # From a whole chunk on: every sample has the place in its chunk that it has by its number,
        # where `rerun` finds it.
        again = there % self.chunk
        values = self.drawing.span(there - again, samples)
        result = self.run(values)
        if self.result is not None:
            new = jax.tree.map(lambda array: array[again:], result)
            values = np.concatenate([self.values, values[again:]])
            result = jax.tree.map(lambda *both: np.concatenate(both), self.result, new)
        self.values, self.result = values, result
