"""Who computes the chunks of a campaign: each is claimed, drawn, computed, kept; by the threads of
this process, or on the workers of Dask. Other processes may be at the same folder.

A sample is drawn by its own number, and computed in a batch whose size depends on the problem
alone: it is the same to the last bit in whatever chunks, threads and processes the work is done.

Dask decides who computes what, and asks again for what a lost worker was at. Only the problem
travels (pickled by Dask, between processes of one user), once to each worker, and numbers of
chunks; no samples do. A worker compiles the program once, for later campaigns of the same problem
too. What Dask does for a task costs some milliseconds of three processes, so a task is a block of
chunks that are quick; each of them is written by itself.
"""

import functools
import secrets
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxclear.ground.wording import described
from jaxclear.native import stops
from jaxclear.studies.experiment import SampleResult
from jaxclear.studies.infinite_responses import successes
from jaxclear.studies.problem import Problem
from jaxclear.studies.replicas import finer_runs
from jaxclear.studies.sampling import Drawing
from jaxclear.studies.store.batch import (
    OUTCOME,
    PATIENCE,
    RESPONSES,
    Program,
    devices,
    until_all,
)
from jaxclear.studies.store.digest import in_texts
from jaxclear.studies.store.samples import Plan, Samples
from jaxclear.studies.store.store import STUDY, compute_address

# Samples are drawn in blocks of whole chunks, about so many, because a small draw costs as much.
DRAWN = 1 << 14
# Blocks of chunks asked of the scheduler at a time, for each thread of the workers.
BLOCKS_PER_THREAD = 2
# [s] after which a worker answers, whatever is left of its block: Dask's own work is little beside
# it, and progress is still seen.
WORTH = 1.0
# [s] for the first worker to join.
JOINING = 60.0
# Told of every chunk that is finished: its number and how many of its samples failed.
Heard = Callable[[int, int], None]
# Held by the thread of a worker that makes what all its threads share.
_MAKING = threading.Lock()


class Evaluation:
    """What a plan asks a program for, chunk by chunk."""

    def __init__(self, program: Program, plan: Plan):
        self.program, self.plan = program, plan
        self._stops = stops()
        self._drawing = threading.Lock()
        self._drawn: dict[int, np.ndarray] = {}

    @cached_property
    def _draw_all(self) -> Drawing:
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
                self._drawn = {n: values for n, values in self._drawn.items() if n == block - 1}
                ends = block * size, min((block + 1) * size, self.plan.samples)
                self._drawn[block] = self._draw_all.span(*ends)
            return self._drawn[block][first - block * size : last - block * size]

    def chunk(self, values: np.ndarray) -> SampleResult:
        """What the samples of a chunk give. Raises `Stopped` where Ctrl-C ended the program."""
        batch, count = self.plan.batch * devices(), len(values)
        # The last batch is filled up with copies, so that all run the one compiled program.
        padded = np.concatenate([values, np.repeat(values[-1:], -count % batch, axis=0)])
        pieces = padded.reshape(-1, batch, values.shape[1])
        results = [self.program.run(piece, self._stops) for piece in pieces]
        return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *results)


def failures(problem: Problem, outcome: Any, responses: dict[str, Any]) -> int:
    """Number of samples that failed.

    Args:
        problem: says which responses count as answers.
        outcome: shape (samples,).
        responses: by name, shape (samples,).
    """
    return int(np.sum(~successes(problem, outcome, responses)[0]))


def done(samples: Samples, evaluation: Evaluation, number: int) -> int | None:
    """Computes and saves a chunk; returns how many of its samples failed.

    None where another thread or process is at it.

    Args:
        samples: of the campaign, in its folder.
        evaluation: values and program of each chunk.
        number: of the chunk.
    """
    problem = evaluation.program.problem

    def load() -> int | None:
        saved = samples.chunk(number)
        if saved is None:
            return None
        by_name = dict(zip(problem.response_names, saved.arrays[RESPONSES].T, strict=True))
        return failures(problem, saved.arrays[OUTCOME], by_name)

    def compute() -> int:
        values = evaluation.values(number)
        result = evaluation.chunk(values)
        samples.write(number, values, result)
        return failures(problem, result.outcome, result.responses)

    return samples.store.obtain(samples.address(number), load, compute)


class AbstractWork(ABC):
    """Who computes the chunks of a campaign of a `problem`."""

    problem: Problem

    @abstractmethod
    def compute(self, samples: Samples, numbers: Sequence[int], heard: Heard) -> None:
        """Computes and saves chunks, and waits for those at which other processes work.

        Args:
            samples: of the campaign, in its folder.
            numbers: of the chunks.
            heard: function of a number and how many samples failed.
        """

    @abstractmethod
    def replicated(self, plan: Plan, values: np.ndarray) -> SampleResult | None:
        """What samples of these values (samples, variables) give in finer runs, if there are
        any."""


class Threads(AbstractWork):
    """The threads of this process, side by side. Interrupted, it loses the chunks in work."""

    def __init__(self, problem: Problem):
        self.problem, self._shared_program = problem, Program(problem, wide=True)

    def compute(self, samples, numbers, heard):
        evaluation = Evaluation(self._shared_program, samples.plan)
        until_all(lambda number: done(samples, evaluation, number), numbers, heard)

    def replicated(self, plan, values):
        return finer_runs(self.problem, values, plan.batch)


def check_client(client: Any) -> None:
    """Raises `ValueError` with a sentence for what is no client of Dask."""
    kinds = {f"{kind.__module__}.{kind.__qualname__}" for kind in type(client).__mro__}
    if "distributed.client.Client" not in kinds or client.asynchronous:
        raise ValueError(
            f"client of campaign is {described(client)}; it must be a dask.distributed.Client (not "
            'asynchronous): python -m pip install "jaxclear[dask]".'
        )


class Workers(AbstractWork):
    """All workers of a client. Interrupted, it asks for no more; blocks in work are finished.
    Where none has joined, it waits for the first, for a minute."""

    def __init__(self, problem: Problem, client: Any):
        self.problem, self.client = problem, client
        # The texts that a problem is known by tell a worker whether it has compiled it before.
        self.token = compute_address(in_texts(problem))
        self.there = client.submit(_as_task_argument, problem, pure=False)

    def compute(self, samples, numbers, heard):
        """Computes and saves chunks on the workers of Dask.

        Args:
            samples: of the campaign, in its folder.
            numbers: of the chunks.
            heard: function of a number and how many samples failed.

        Raises:
            RuntimeError: a chunk ends its workers.
        """
        import distributed

        self._wait_for_worker()
        # What a worker knows of a folder is as it was when this began.
        place, most = str(samples.folder.resolve()), samples.plan.samples
        what = self.there, self.token, place, most, secrets.token_hex(8)
        threads = max(sum(self.client.nthreads().values()), 1)
        remaining, pending = deque(numbers), {}
        running = distributed.as_completed()
        try:
            while remaining or pending:
                while remaining and len(pending) < BLOCKS_PER_THREAD * threads:
                    # A block that takes too long comes back, so its size need only be fair.
                    many = -(-len(remaining) // (BLOCKS_PER_THREAD * threads))
                    block = [remaining.popleft() for _ in range(many)]
                    future = self.client.submit(_run_block, *what, block, pure=False)
                    pending[future.key] = block
                    running.add(future)
                future = next(running)
                block = pending.pop(future.key)
                answers = _read_answer(future, block)
                for number, failed in zip(block, answers, strict=False):
                    if failed is not None:
                        heard(number, failed)
                    else:
                        remaining.append(number)
                remaining.extend(block[len(answers) :])
                time.sleep(PATIENCE if None in answers else 0)
        finally:
            self.client.cancel([*running.futures])

    def replicated(self, plan, values):
        self._wait_for_worker()
        return self.client.submit(finer_runs, self.there, values, plan.batch, pure=False).result()

    def _wait_for_worker(self) -> None:
        """Waits for a worker. Raises `RuntimeError` with a sentence where none comes."""
        try:
            self.client.wait_for_workers(1, timeout=JOINING)
        except TimeoutError as reason:
            raise RuntimeError(
                f"no worker has joined the client's cluster in {JOINING:.0f} s; start workers, "
                "and ask the same again."
            ) from reason

    def close(self) -> None:
        """The workers let go of the problem."""
        self.client.cancel([self.there])


def _read_answer(future: Any, block: list[int]) -> list[int | None]:
    """What a worker says of a block."""
    import distributed

    try:
        return future.result()
    except distributed.KilledWorker as reason:
        several = f"one of {len(block)} chunks from {min(block)} to {max(block)}"
        which = several if len(block) > 1 else f"chunk {block[0]}"
        raise RuntimeError(
            f"{which} of the campaign ended every worker that computed it, for want of memory "
            "maybe; finished chunks are kept. Give workers more memory, or a smaller chunk."
        ) from reason


def _as_task_argument(problem: Problem) -> Problem:
    """The problem, as something that Dask holds for all workers."""
    return problem


def _run_block(
    problem: Problem, token: str, folder: str, most: int, campaign: str, block: list[int]
) -> list[int | None]:
    """Computes and keeps chunks of a block, on a worker, for as long as a task is to take: what
    `done` says of each."""
    with _MAKING:
        samples, evaluation = _ready(_Shared(token, problem), folder, most, campaign)
    ends, failed = time.perf_counter() + WORTH, [done(samples, evaluation, block[0])]
    for number in block[1:]:
        if time.perf_counter() > ends:
            break
        failed.append(done(samples, evaluation, number))
    return failed


class _Shared:
    """A problem that counts as the one that came first with the same token: its program is compiled
    once, however often Dask sends it."""

    def __init__(self, token: str, problem: Problem):
        self.token, self.problem = token, problem

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Shared) and self.token == other.token

    def __hash__(self) -> int:
        return hash(self.token)


@functools.lru_cache(maxsize=4)
def _shared_program(once: _Shared) -> Program:
    """The program of the problem that came first: it serves later campaigns too."""
    return Program(once.problem, wide=True)


@functools.lru_cache(maxsize=4)
def _ready(once: _Shared, folder: str, most: int, campaign: str) -> tuple[Samples, Evaluation]:
    """The folder and the program of a campaign on this worker."""
    if not (Path(folder) / STUDY).exists():
        raise ValueError(
            f"a worker does not see the folder {folder} of the campaign; give one that all workers "
            "share."
        )
    samples = Samples.open(folder).view(most)
    return samples, Evaluation(_shared_program(once), samples.plan)
