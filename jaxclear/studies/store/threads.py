"""Who computes the chunks of a campaign, and how: each is claimed, drawn, computed, kept. Here by
the threads of this process; other processes may be at the same folder.

A sample is drawn by its own number, and computed in a batch whose size depends on the problem
alone: it is the same to the last bit in whatever chunks, threads and processes the work is done.
"""

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import jax
import numpy as np

from jaxclear.native import stops
from jaxclear.studies.endless import successes
from jaxclear.studies.experiment import SampleResult
from jaxclear.studies.problem import Problem
from jaxclear.studies.replicas import finer_runs
from jaxclear.studies.sampling import Drawing
from jaxclear.studies.store.batch import Program, devices, side_by_side
from jaxclear.studies.store.samples import OUTCOME, RESPONSES, Plan, Samples

# [s] between looks at whether others have finished the chunks that they are at.
PATIENCE = 0.2
# Samples are drawn in blocks of whole chunks, about so many, because a small draw costs as much.
DRAWN = 1 << 14
# Told of every chunk that is finished: its number and how many of its samples failed.
Heard = Callable[[int, int], None]


class Evaluation:
    """What a plan asks a program for, chunk by chunk."""

    def __init__(self, program: Program, plan: Plan):
        self.program, self.plan = program, plan
        self._stops = stops()
        self._drawing = threading.Lock()
        self._drawn: dict[int, np.ndarray] = {}

    @cached_property
    def _sample(self) -> Drawing:
        plan = self.plan
        return Drawing(self.program.problem, plan.seed, plan.sampling, plan.scramblings)

    def values(self, number: int) -> np.ndarray:
        """Values (samples, variables) of a chunk."""
        chunk = self.plan.chunk
        size = max(DRAWN // chunk, 1) * chunk
        first, last = self.plan.span(number)
        block = first // size
        with self._drawing:
            if block not in self._drawn:
                # Threads may still be at the block before.
                self._drawn = {n: own for n, own in self._drawn.items() if n == block - 1}
                ends = block * size, min((block + 1) * size, self.plan.samples)
                self._drawn[block] = self._sample.span(*ends)
            return self._drawn[block][first - block * size : last - block * size]

    def chunk(self, values: np.ndarray) -> SampleResult:
        """What the samples of a chunk give. Raises `Stopped` where Ctrl-C ended the program."""
        batch, count = self.plan.batch * devices(), len(values)
        # The last batch is filled up with copies, so that all run the one compiled program.
        padded = np.concatenate([values, np.repeat(values[-1:], -count % batch, axis=0)])
        pieces = padded.reshape(-1, batch, values.shape[1])
        found = [self.program.run(piece, self._stops) for piece in pieces]
        return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *found)


def failures(problem: Problem, outcome: Any, responses: dict[str, Any]) -> int:
    """How many of these samples failed."""
    return int(np.sum(~successes(problem, outcome, responses)[0]))


def done(samples: Samples, evaluation: Evaluation, number: int) -> int | None:
    """Computes a chunk and keeps it: how many of its samples failed; None where another thread or
    process is at it."""
    problem = evaluation.program.problem
    with samples.claimed(number) as mine:
        known = samples.chunk(number)
        if known is None and not mine:
            return None
        if known is None:
            values = evaluation.values(number)
            found = evaluation.chunk(values)
            samples.write(number, values, found)
            return failures(problem, found.outcome, found.responses)
        by_name = dict(zip(problem.response_names, known.arrays[RESPONSES].T, strict=True))
        return failures(problem, known.arrays[OUTCOME], by_name)


class AbstractWork(ABC):
    """Who computes the chunks of a campaign of a `problem`."""

    problem: Problem

    @abstractmethod
    def compute(self, samples: Samples, numbers: Sequence[int], heard: Heard) -> None:
        """Computes and keeps the chunks of these numbers, and waits for those that other processes
        are at."""

    @abstractmethod
    def replicated(self, plan: Plan, values: np.ndarray) -> SampleResult | None:
        """What samples of these values (samples, variables) give in finer runs, if there are
        any."""


class Threads(AbstractWork):
    """The threads of this process, side by side. Interrupted, it loses the chunks in work."""

    def __init__(self, problem: Problem):
        self.problem, self._program = problem, Program(problem, wide=True)

    def compute(self, samples, numbers, heard):
        evaluation, left = Evaluation(self._program, samples.plan), list(numbers)
        while left:
            busy: list[int] = []

            def told(number: int, failed: int | None, busy: list[int] = busy) -> None:
                if failed is None:
                    busy.append(number)
                else:
                    heard(number, failed)

            side_by_side(lambda number: done(samples, evaluation, number), left, told)
            left = busy
            time.sleep(PATIENCE if left else 0)

    def replicated(self, plan, values):
        return finer_runs(self.problem, values, plan.batch)
