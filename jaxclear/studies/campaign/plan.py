"""What a campaign computes: which samples, in which batches and chunks, and one chunk of them.

A sample is drawn by its own number, and computed in a batch whose size depends on the problem
alone: it is the same to the last bit in whatever chunks, threads and processes the work is done.
"""

import threading
from functools import cached_property
from typing import NamedTuple

import jax
import numpy as np

from jaxclear.native import stops
from jaxclear.studies.base import AbstractProblem, SampleResult
from jaxclear.studies.ledger.batch import Program, devices, usual_batch
from jaxclear.studies.sampling import Drawing, groups

# A campaign has about this many chunks at the most. Samples that are cheap beside a file come in
# fewer and larger ones.
MOST_CHUNKS, MOST_CHEAP_CHUNKS, LEAST_CHEAP_CHUNK = 1024, 32, 1 << 14
# A chunk of runs is a batch, of a large campaign so many batches (files cost where runs are quick),
# but no more than this part of it.
BATCHES, OF_CAMPAIGN = 4, 64
# Samples are drawn in blocks of whole chunks, about so many, because a small draw costs as much.
DRAWN = 1 << 14


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
