"""What a campaign computes: which samples, in which batches and chunks, and one chunk of them.

A sample is drawn by its own number, and computed in a batch whose size depends on the problem
alone: it is the same to the last bit in whatever chunks, threads and processes the work is done.
"""

import threading
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxclear.native import stops
from jaxclear.studies.base import AbstractProblem, SampleResult
from jaxclear.studies.batch import CHUNK_MEMORY, asked_of_lapack
from jaxclear.studies.campaign.devices import devices, laid_out, on_all_devices
from jaxclear.studies.sampling import Drawing, groups

__all__ = ["Evaluation", "Plan", "Program", "Stopped", "planned", "usual_batch"]

# A campaign has about this many chunks at the most. Samples that are cheap beside a file come in
# fewer and larger ones.
MOST_CHUNKS, MOST_CHEAP_CHUNKS, LEAST_CHEAP_CHUNK = 1024, 32, 1 << 14
# A chunk of runs is a batch, of a large campaign so many batches (files cost where runs are quick),
# but no more than this part of it.
BATCHES, OF_CAMPAIGN = 4, 64
# Samples are drawn in blocks of whole chunks, about so many, because a small draw costs as much.
DRAWN = 1 << 14


class Stopped(Exception):
    """The chunk in work was interrupted; what was computed of it counts for nothing."""


class Plan(NamedTuple):
    """`samples` in independent `scramblings`, drawn from `seed`; computed in batches of `batch`,
    kept in chunks of `chunk` samples, a multiple of the batch."""

    samples: int
    seed: int
    sampling: str
    scramblings: int
    batch: int
    chunk: int

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return -(-self.samples // self.chunk)

    def larger(self, samples: int, usual: int) -> "Plan":
        """The plan of more samples. A campaign that was to be smaller than a batch of the `usual`
        size gets larger ones; nothing of it stays, for no chunk is smaller than such a batch."""
        small = self.samples < self.chunk
        larger = max(self.batch, min(usual, samples)) if small else self.batch
        return self._replace(samples=samples, batch=larger)

    def span(self, number: int) -> tuple[int, int]:
        """First sample of a chunk, and the one after its last."""
        return number * self.chunk, min((number + 1) * self.chunk, self.samples)

    def groups(self) -> np.ndarray:
        """The scrambling (samples,) of every sample."""
        return groups(self.samples, self.scramblings)


def usual_batch(problem: AbstractProblem) -> int:
    """Samples of a problem that are best computed together."""
    fits = max(CHUNK_MEMORY // max(problem.sample_memory(), 1), 1)
    return int(min(problem.most_together(), fits))


def planned(
    problem: AbstractProblem, drawn: tuple[int, int, str, int], chunk: int | None, most: int
) -> Plan:
    """The plan of samples, seed, sampling and scramblings to begin with, of which there will be
    `most`; in chunks of at least so many samples if they are given. Chunks are of whole batches of
    the usual size, also where there are not as many samples."""
    batch = usual_batch(problem)
    if chunk is None:
        # Runs have an idle form; what is evaluated at once has none.
        cheap = problem.idle() is problem
        some = min(BATCHES * batch, most // OF_CAMPAIGN)
        chunks, least = (MOST_CHEAP_CHUNKS, LEAST_CHEAP_CHUNK) if cheap else (MOST_CHUNKS, some)
        chunk = max(-(-most // chunks), least, batch * devices())
    return Plan(*drawn, min(batch, most), -(-chunk // batch) * batch)


class Program:
    """A problem's compiled program in this process, shared by its threads."""

    def __init__(self, problem: AbstractProblem):
        self.problem = problem
        self._compiling, self._alone = threading.Lock(), threading.Lock()
        # By size of batches: what one of no work gave, and whether the program calls LAPACK.
        self._compiled: dict[int, tuple[SampleResult, bool]] = {}

    def begun(self, batch: int) -> SampleResult:
        """What a batch of work as little as possible gives; compiles the program, once."""
        return self._of(batch * devices())[0]

    def run(self, values: np.ndarray) -> SampleResult:
        """What a batch of samples gives."""
        # Programs that call LAPACK go one by one (see `native.calls_lapack`).
        _, calls_lapack = self._of(len(values))
        with self._alone if calls_lapack else _Free():
            return _evaluated(self.problem, values)[0]

    def _of(self, batch: int) -> tuple[SampleResult, bool]:
        with self._compiling:
            if batch not in self._compiled:
                nominal = np.tile(self.problem.nominal(), (batch, 1))
                found, lapack = _evaluated(self.problem.idle(), nominal)
                self._compiled[batch] = found, bool(lapack)
            return self._compiled[batch]


class Evaluation:
    """What a plan asks a program for, chunk by chunk."""

    def __init__(self, program: Program, plan: Plan):
        self.program, self.plan = program, plan
        self._stops = stops()
        self._drawing = threading.Lock()
        self._drawn: dict[int, np.ndarray] = {}

    def follow(self, plan: Plan) -> None:
        """Goes over to a plan of other sizes."""
        self.plan, self._drawn = plan, {}

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
        found = [self._one(piece) for piece in padded.reshape(-1, batch, values.shape[1])]
        return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *found)

    def _one(self, values: np.ndarray) -> SampleResult:
        found = self.program.run(values)
        if stops() != self._stops:
            raise Stopped
        return found


class _Free:
    """A lock that everyone may hold."""

    def __enter__(self) -> None: ...

    def __exit__(self, *reason: Any) -> None: ...


def _evaluated(problem: AbstractProblem, values: np.ndarray) -> tuple[SampleResult, Any]:
    """What a batch on each device gives, on the host, and whether its program calls LAPACK."""
    evaluate: Callable = asked_of_lapack
    return jax.tree.map(np.asarray, evaluate(on_all_devices(), problem, laid_out(values)))
