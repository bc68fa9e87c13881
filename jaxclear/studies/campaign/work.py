"""Who computes the chunks of a campaign, and how: each is claimed, drawn, computed, kept. Here by
the threads of this process; other processes may be at the same folder.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from jaxclear.integrators import Outcome
from jaxclear.native import stop, stoppable
from jaxclear.studies.base import AbstractProblem, SampleResult
from jaxclear.studies.batch import threads_of
from jaxclear.studies.campaign.devices import devices
from jaxclear.studies.campaign.plan import Evaluation, Plan, Program, Stopped
from jaxclear.studies.campaign.samples import Samples
from jaxclear.studies.endless import answered
from jaxclear.studies.replicas import replica_chunk

__all__ = ["AbstractWork", "Heard", "Threads", "done", "failures", "finer"]

# [s] between looks at whether others have finished the chunks that they are at.
PATIENCE = 0.2
# Told of every chunk that is finished: its number and how many of its samples failed.
Heard = Callable[[int, int], None]


def failures(problem: AbstractProblem, found: SampleResult) -> int:
    """How many of these samples failed."""
    told = answered(problem, found.responses)
    return int(np.sum((found.outcome != Outcome.REACHED) | ~told))


def done(samples: Samples, evaluation: Evaluation, number: int) -> int | None:
    """Computes a chunk and keeps it: how many of its samples failed; None where another thread or
    process is at it."""
    problem = evaluation.program.problem
    with samples.claimed(number) as mine:
        if samples.is_finished(number):
            return failures(problem, samples.found(slice(*samples.plan.span(number))))
        if not mine:
            return None
        values = evaluation.values(number)
        found = evaluation.chunk(values)
        samples.write(number, values, found)
        return failures(problem, found)


def finer(problem: AbstractProblem, plan: Plan, values: np.ndarray) -> SampleResult | None:
    """What samples of these values give in finer runs, in batches of the plan where they are of one
    program; None where the problem has none."""
    replica = problem.replica()
    if replica is None:
        return None
    batch = replica_chunk(problem, replica, len(values), plan.batch)
    return Evaluation(Program(replica), plan._replace(batch=batch)).chunk(values)


class AbstractWork(ABC):
    """Who computes the chunks of a campaign of a `problem`."""

    problem: AbstractProblem

    @abstractmethod
    def begun(self, plan: Plan) -> SampleResult:
        """What a batch of work as little as possible gives; the program is compiled then."""

    @abstractmethod
    def compute(self, samples: Samples, numbers: Sequence[int], heard: Heard) -> None:
        """Computes and keeps the chunks of these numbers, and waits for those that other processes
        are at. Raises `Extended` where another process has planned more samples."""

    @abstractmethod
    def replicated(self, plan: Plan, values: np.ndarray) -> SampleResult | None:
        """What samples of these values (samples, variables) give in finer runs; None where the
        problem has none."""

    @abstractmethod
    def __enter__(self) -> "AbstractWork":
        """Begins; all is done within."""

    @abstractmethod
    def __exit__(self, *reason: Any) -> None:
        """Lets go of what it held."""


class Threads(AbstractWork):
    """The threads of this process, side by side. Interrupted, it loses the chunks in work."""

    def __init__(self, problem: AbstractProblem):
        self.problem, self._program = problem, Program(problem)
        self._evaluation: Evaluation | None = None

    def begun(self, plan):
        return self._program.begun(plan.batch)

    def compute(self, samples, numbers, heard):
        if self._evaluation is None:
            self._evaluation = Evaluation(self._program, samples.plan)
        evaluation, left = self._evaluation, list(numbers)
        evaluation.follow(samples.plan)
        # Several devices are busy side by side as it is.
        threads = threads_of() if devices() == 1 else 1
        with stoppable(), ThreadPoolExecutor(threads) as pool:
            try:
                while left:
                    found = pool.map(lambda number: done(samples, evaluation, number), left)
                    left = list(_told(zip(left, found, strict=True), heard))
                    time.sleep(PATIENCE if left else 0)
            except BaseException as reason:
                # The machine is to be idle when the user has the word again.
                if isinstance(reason, (KeyboardInterrupt, Stopped)):
                    stop()
                pool.shutdown(wait=True, cancel_futures=True)
                if isinstance(reason, Stopped):
                    raise KeyboardInterrupt from None
                raise

    def replicated(self, plan, values):
        with stoppable():
            try:
                return finer(self.problem, plan, values)
            except Stopped:
                raise KeyboardInterrupt from None

    def __enter__(self):
        return self

    def __exit__(self, *reason): ...


def _told(found: Iterable[tuple[int, int | None]], heard: Heard) -> Iterator[int]:
    """Tells of the chunks that are finished; the others remain."""
    for number, failed in found:
        if failed is None:
            yield number
        else:
            heard(number, failed)
