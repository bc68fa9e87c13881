"""Who computes the chunks of a campaign, and how: each is claimed, drawn, computed, kept. Here by
the threads of this process; other processes may be at the same folder.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxclear.integrators import Outcome
from jaxclear.native import stoppable
from jaxclear.studies.base import AbstractProblem, SampleResult
from jaxclear.studies.campaign.plan import Evaluation, Plan
from jaxclear.studies.campaign.samples import OUTCOME, RESPONSES, Samples
from jaxclear.studies.endless import answered
from jaxclear.studies.ledger.batch import Program, Stopped, side_by_side
from jaxclear.studies.replicas import replica_chunk

# [s] between looks at whether others have finished the chunks that they are at.
PATIENCE = 0.2
# Told of every chunk that is finished: its number and how many of its samples failed.
Heard = Callable[[int, int], None]


def failures(problem: AbstractProblem, outcome: Any, responses: dict[str, Any]) -> int:
    """How many of these samples failed."""
    return int(np.sum((outcome != Outcome.REACHED) | ~answered(problem, responses)))


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
        if mine and not samples.pieces.path(samples.address(number)).exists():
            # Of an earlier version.
            samples.keep(number, known)
        by_name = dict(zip(problem.response_names, known.arrays[RESPONSES].T, strict=True))
        return failures(problem, known.arrays[OUTCOME], by_name)


def finer(problem: AbstractProblem, plan: Plan, values: np.ndarray) -> SampleResult:
    """What samples of these values give in finer runs, in batches of the plan where they are of one
    program."""
    replica: Any = problem.replica()
    batch = replica_chunk(problem, replica, len(values), plan.batch)
    return Evaluation(Program(replica, wide=True), plan._replace(batch=batch)).chunk(values)


class AbstractWork(ABC):
    """Who computes the chunks of a campaign of a `problem`."""

    problem: AbstractProblem

    @abstractmethod
    def compute(self, samples: Samples, numbers: Sequence[int], heard: Heard) -> None:
        """Computes and keeps the chunks of these numbers, and waits for those that other processes
        are at."""

    @abstractmethod
    def replicated(self, plan: Plan, values: np.ndarray) -> SampleResult:
        """What samples of these values (samples, variables) give in finer runs."""

    @abstractmethod
    def __enter__(self) -> "AbstractWork":
        """Begins; all is done within."""

    @abstractmethod
    def __exit__(self, *reason: Any) -> None:
        """Lets go of what it held."""


class Threads(AbstractWork):
    """The threads of this process, side by side. Interrupted, it loses the chunks in work."""

    def __init__(self, problem: AbstractProblem):
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
        with stoppable():
            try:
                return finer(self.problem, plan, values)
            except Stopped:
                raise KeyboardInterrupt from None

    def __enter__(self):
        return self

    def __exit__(self, *reason): ...
