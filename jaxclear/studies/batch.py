"""Runs a problem for many sets of values: compiled once, in chunks that fit memory, one thread a
core.

Compiled programs leave Python free while they run, so two chunks run side by side on two cores
without splitting a device.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from tqdm import tqdm

from jaxclear.ground.precision import check_double_precision
from jaxclear.native import calls_lapack, stop, stoppable
from jaxclear.studies.base import AbstractProblem, SampleResult

# Who answers instead of `evaluate_all`, from a folder maybe; None where samples are computed.
KEEPER: ContextVar[Callable | None] = ContextVar("keeper of samples", default=None)
# Memory for one chunk [bytes] on machines with a few GiB a core.
CHUNK_MEMORY = 1 << 30


@eqx.filter_jit
def evaluate_chunk(
    problem: AbstractProblem, values: Float[Array, "samples variables"]
) -> SampleResult:
    """Outcomes of a chunk of samples."""
    return jax.vmap(problem.evaluate)(values)


@eqx.filter_jit
def asked_of_lapack(function, problem, values):
    """What the function of a chunk gives, and whether its program calls LAPACK."""
    found = function(problem, values)
    return found, calls_lapack(*jax.tree.leaves(found))


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads_of() -> int:
    """Chunks that run side by side."""
    return 1 if jax.default_backend() != "cpu" else cores()


def chunk_size(problem: AbstractProblem, samples: int, chunk: int | None = None) -> int:
    """Samples a chunk: those wanted, or else all threads busy and no chunk above the memory set
    aside for it.
    """
    if chunk is not None:
        return min(chunk, samples)
    fits = CHUNK_MEMORY // max(problem.sample_memory(), 1)
    return int(max(1, min(problem.most_together(), fits, -(-samples // threads_of()))))


@eqx.filter_jit
def _mapped(function: Callable[[Array], Any], values: Float[Array, "samples variables"]) -> Any:
    return jax.vmap(function)(values)


def sample_of_chunk(
    function: Callable[[Array], Any], values: Float[Array, " variables"], index: int, chunk: int
) -> Any:
    """What a function of one sample, a method of a problem, gives for sample `index` of a study in
    chunks of this size, bit for bit as it was there: in the same lane of the same kernel, between
    copies of itself.
    """
    with stoppable():
        found = _mapped(function, jnp.tile(values, (chunk, 1)))
        return jax.tree.map(lambda leaf: leaf[index % chunk], jax.block_until_ready(found))


def evaluate_all(
    problem: AbstractProblem,
    values: Float[Array, "samples variables"],
    *,
    chunk: int | None = None,
    progress_bar: bool = False,
    label: str = "samples",
    function=evaluate_chunk,
    kept_as: str = "asked",
) -> SampleResult:
    """Outcomes of all samples, in the order of `values`; arrays on the host. `kept_as`: among which
    sets of samples a folder counts them, if a study is kept."""
    keeper = KEEPER.get()
    if keeper is not None:
        shown = {"progress_bar": progress_bar, "label": label, "kept_as": kept_as}
        return keeper(problem, values, chunk=chunk, function=function, **shown)
    check_double_precision()
    samples = len(values)
    # Any other function of a chunk is a compiled program, which a problem that is none refuses.
    if not problem.compiled() and function is evaluate_chunk:
        return _each_alone(problem, np.asarray(values), progress_bar, label)
    threads = threads_of()
    chunk = chunk_size(problem, samples, chunk)
    count = -(-samples // chunk)
    # The last chunk is filled up with copies, so that all chunks run the one compiled program.
    padded = jnp.concatenate([values, jnp.repeat(values[-1:], count * chunk - samples, axis=0)])
    pieces = padded.reshape(count, chunk, -1)

    def one(piece, problem=problem):
        return jax.tree.map(np.asarray, asked_of_lapack(function, problem, piece))

    with stoppable(), tqdm(total=samples, desc=label, disable=not progress_bar) as bar:
        # Compile before the threads start, or each of them would: the same program, on a run of no
        # length.
        if count > 1:
            idle = problem.idle()
            # Chunks that call LAPACK go one by one (a user's response may; see `calls_lapack`).
            threads = 1 if one(pieces[0], idle)[1] else threads
        outcomes = []
        with ThreadPoolExecutor(threads) as pool:
            try:
                for outcome, _ in pool.map(one, pieces):
                    outcomes.append(outcome)
                    bar.update(min(chunk, samples - bar.n))
            except BaseException as reason:
                # The machine is to be idle when the user has the word again.
                if isinstance(reason, KeyboardInterrupt):
                    stop()
                pool.shutdown(wait=True, cancel_futures=True)
                raise
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:samples], *outcomes)


def _each_alone(
    problem: AbstractProblem, values: np.ndarray, progress_bar: bool, label: str
) -> SampleResult:
    """Outcomes of samples that are no compiled program, one after the other: what they run may call
    LAPACK (see `calls_lapack`), which is not known before. In the caller's thread, so that each
    of their runs hears Ctrl-C."""
    shown = tqdm(values, desc=label, disable=not progress_bar)
    outcomes = [problem.evaluate(own) for own in shown]
    return jax.tree.map(lambda *parts: np.stack(parts), *outcomes)
