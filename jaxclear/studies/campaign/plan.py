"""What a campaign computes: which samples, in which batches and chunks, and one chunk of them.

A sample is drawn by its own number, and computed in a batch whose size depends on the problem
alone: it is the same to the last bit in whatever chunks, threads and processes the work is done.
"""

import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.native import stops
from jaxclear.studies.base import AbstractProblem, SampleResult
from jaxclear.studies.batch import CHUNK_MEMORY, asked_of_lapack, evaluate_chunk
from jaxclear.studies.campaign.devices import devices, laid_out, on_all_devices
from jaxclear.studies.sampling import draw, groups

__all__ = ["Evaluation", "Plan", "Stopped", "planned"]

# A campaign has about this many chunks at the most. Samples that are cheap beside a file come in
# fewer and larger ones.
MOST_CHUNKS, MOST_CHEAP_CHUNKS, LEAST_CHEAP_CHUNK = 1024, 32, 1 << 14
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

    def span(self, number: int) -> tuple[int, int]:
        """First sample of a chunk, and the one after its last."""
        return number * self.chunk, min((number + 1) * self.chunk, self.samples)

    def groups(self) -> np.ndarray:
        """The scrambling (samples,) of every sample."""
        return groups(self.samples, self.scramblings)


def planned(
    problem: AbstractProblem,
    samples: int,
    seed: int,
    sampling: str,
    scramblings: int,
    chunk: int | None,
) -> Plan:
    """The plan, in chunks of at least so many samples if they are given."""
    fits = max(CHUNK_MEMORY // max(problem.sample_memory(), 1), 1)
    batch = int(min(problem.most_together(), fits, samples))
    if chunk is None:
        # Runs have an idle form; what is evaluated at once has none.
        cheap = problem.idle() is problem
        most, least = (MOST_CHEAP_CHUNKS, LEAST_CHEAP_CHUNK) if cheap else (MOST_CHUNKS, 1)
        chunk = max(-(-samples // most), least, batch * devices())
    return Plan(samples, seed, sampling, scramblings, batch, -(-chunk // batch) * batch)


class Evaluation:
    """A problem's compiled program in this process, shared by its threads."""

    def __init__(self, problem: AbstractProblem, plan: Plan):
        self.problem, self.plan = problem, plan
        self.begun = stops()
        self._compiling, self._alone = threading.Lock(), threading.Lock()
        self._compiled = self._calls_lapack = False
        self._drawing = threading.Lock()
        self._drawn: dict[int, np.ndarray] = {}

    def compiled(self) -> SampleResult:
        """What a batch of work as little as possible gives; compiles the program."""
        nominal = np.tile(self.problem.nominal(), (self.plan.batch * devices(), 1))
        found, lapack = _evaluated(self.problem.idle(), nominal)
        self._compiled, self._calls_lapack = True, bool(lapack)
        return found

    def traced(self) -> SampleResult:
        """The same with shapes in place of numbers; compiles nothing."""
        nominal = jnp.tile(self.problem.nominal(), (self.plan.batch, 1))
        return eqx.filter_eval_shape(evaluate_chunk, self.problem, nominal)

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
                plan, ends = self.plan, (block * size, min((block + 1) * size, self.plan.samples))
                how = plan.seed, plan.sampling, plan.scramblings
                self._drawn[block] = draw(self.problem, plan.samples, *how, ends)
            return self._drawn[block][first - block * size : last - block * size]

    def chunk(self, values: np.ndarray) -> SampleResult:
        """What the samples of a chunk give. Raises `Stopped` where Ctrl-C ended the program."""
        with self._compiling:
            if not self._compiled:
                self.compiled()
        batch, count = self.plan.batch * devices(), len(values)
        # The last batch is filled up with copies, so that all run the one compiled program.
        padded = np.concatenate([values, np.repeat(values[-1:], -count % batch, axis=0)])
        found = [self._one(piece) for piece in padded.reshape(-1, batch, values.shape[1])]
        return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *found)

    def _one(self, values: np.ndarray) -> SampleResult:
        # Programs that call LAPACK go one by one (see `native.calls_lapack`).
        lock = self._alone if self._calls_lapack else _Free()
        with lock:
            found, _ = _evaluated(self.problem, values)
        if stops() != self.begun:
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
