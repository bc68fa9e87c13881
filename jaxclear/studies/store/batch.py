"""Runs a problem for many sets of values: compiled once, in chunks that fit memory, one thread a
core; from a ledger as far as it is there.

Compiled programs leave Python free while they run, so two chunks run side by side on two cores
without splitting a device. Several accelerators share a chunk: each computes samples of its own, by
the same program as alone.
"""

import functools
import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float
from tqdm import tqdm

from jaxclear.ground.precision import check_double_precision
from jaxclear.native import calls_lapack, stop, stoppable, stops
from jaxclear.native.compiled import Prepared, prepared
from jaxclear.studies.experiment import SampleResult
from jaxclear.studies.problem import Problem
from jaxclear.studies.store.store import CURRENT, Question

# Memory for one chunk [bytes] on machines with a few GiB a core.
CHUNK_MEMORY = 1 << 30
# Runs come in chunks of no fewer samples than these, where there are as many, so that there are so
# many chunks for each thread: the threads end together, and what is finished is seen.
LEAST_CHUNK, CHUNKS_A_THREAD = 64, 8


class Stopped(Exception):
    """The chunk in work was interrupted; what was computed of it counts for nothing."""


@eqx.filter_jit
def evaluate_chunk(problem: Problem, values: Float[Array, "samples variables"]) -> SampleResult:
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


def devices() -> int:
    """Devices of this process that compute side by side."""
    return jax.local_device_count()


def threads_of() -> int:
    """Chunks that run side by side."""
    return 1 if jax.default_backend() != "cpu" else cores()


def usual_batch(problem: Problem) -> int:
    """Samples of a problem that are best computed together."""
    cost = problem.cost()
    return int(min(cost.batch, max(CHUNK_MEMORY // max(cost.memory, 1), 1)))


def chunk_size(problem: Problem, samples: int, chunk: int | None = None) -> int:
    """Samples a chunk: those wanted, or else all threads busy and no chunk above the memory set
    aside for it.
    """
    if chunk is not None:
        return min(chunk, samples)
    whole = min(usual_batch(problem), -(-samples // threads_of()))
    if jax.default_backend() == "cpu" and not problem.cost().cheap:
        whole = min(whole, max(LEAST_CHUNK, -(-samples // (CHUNKS_A_THREAD * threads_of()))))
    return max(1, whole)


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


def _of_chunk(function: Callable, problem: Problem, values: Array) -> Any:
    return function(problem, values)


class Program:
    """A function of chunks of a problem, compiled in this process and shared by its threads. `wide`
    ones lie in equal parts on all devices."""

    def __init__(self, problem: Problem, function: Callable = evaluate_chunk, wide: bool = False):
        self.problem = problem
        many = wide and devices() > 1
        self._function = _on_each if many else function
        self._laid_out = _on_all_devices if many else jnp.asarray
        self._compiling, self._alone = threading.Lock(), threading.Lock()
        # By size of chunks: what computes them, and whether it calls LAPACK.
        self._prepared: dict[int, Prepared] = {}

    def run(self, values: np.ndarray, before: int, once: bool = False) -> Any:
        """What a chunk gives, on the host; `once`: no other follows. Raises `Stopped` where runs
        were stopped more often than `before`."""
        program = self._program(values, once)
        # Programs that call LAPACK go one by one (a user's response may; see `calls_lapack`).
        with self._alone if program.lapack else nullcontext():
            found = jax.tree.map(np.asarray, program.call(values))
        if stops() != before:
            raise Stopped
        return found

    def compiled(self, values: np.ndarray) -> bool:
        """Compiles the program for chunks like this; whether it calls LAPACK."""
        return self._program(values).lapack

    def _program(self, values: np.ndarray, once: bool = False) -> Prepared:
        with self._compiling:
            found = self._prepared.get(len(values))
            if found is None:
                found = self._prepared[len(values)] = self._found(values, once)
            return found

    def _found(self, values: np.ndarray, once: bool) -> Prepared:
        # Compiled as a part of the program that is prepared.
        plain = getattr(self._function, "__wrapped__", self._function)
        found = prepared(_of_chunk, plain, self.problem, values)
        if found is not None:
            return found

        def evaluated(problem, values):
            asked: Callable = asked_of_lapack
            return asked(self._function, problem, self._laid_out(values))

        # Compiled by a run of no length.
        idle = self.problem.cost().idle
        little = self.problem if idle is None else self.problem.with_experiment(idle)
        lapack = not once and bool(evaluated(little, values)[1])
        return Prepared(lambda values: evaluated(self.problem, values)[0], lapack)


@functools.cache
def _mesh() -> Mesh:
    return Mesh(np.array(jax.local_devices()), ("samples",))


def _on_all_devices(values: np.ndarray) -> Array:
    return jax.device_put(values, NamedSharding(_mesh(), PartitionSpec("samples")))


def _on_each(problem: Problem, values: Float[Array, "samples variables"]) -> SampleResult:
    """A chunk of samples, an equal part of it on each device."""
    numbers, rest = eqx.partition(problem, eqx.is_array)

    def own(numbers, values):
        return evaluate_chunk(eqx.combine(numbers, rest), values)

    # A device's part is a program of its own: its numbers are those of a batch of this size.
    parts = PartitionSpec(), PartitionSpec("samples")
    mapped = jax.shard_map(own, mesh=_mesh(), in_specs=parts, out_specs=parts[1], check_vma=False)
    return mapped(numbers, values)


def side_by_side(
    one: Callable[[int], Any], numbers: Iterable[int], heard: Callable[[int, Any], None]
) -> None:
    """Does `one` thing for each number, in threads, and tells of each in their order. Interrupted,
    it ends what is in work, and the machine is idle when the user has the word again."""
    numbers = list(numbers)
    # Several devices are busy side by side as it is.
    threads = threads_of() if devices() == 1 else 1
    with stoppable(), ThreadPoolExecutor(threads) as pool:
        try:
            for number, found in zip(numbers, pool.map(one, numbers), strict=True):
                heard(number, found)
        except BaseException as reason:
            if isinstance(reason, (KeyboardInterrupt, Stopped)):
                stop()
            pool.shutdown(wait=True, cancel_futures=True)
            if isinstance(reason, Stopped):
                raise KeyboardInterrupt from None
            raise


def evaluate_all(
    problem: Problem,
    values: Any,
    *,
    chunk: int | None = None,
    progress_bar: bool = False,
    label: str = "samples",
    function=evaluate_chunk,
) -> SampleResult:
    """Outcomes of samples of these values (samples, variables), in their order; arrays on the host.
    What the `current` ledger knows is not computed; what it does not is kept there, each chunk as
    it is finished."""
    check_double_precision()
    samples, values, ledger = len(values), np.asarray(values), CURRENT.get()
    # Any other function of a chunk is a compiled program, which a problem that is none refuses.
    if not problem.cost().compiled and function is evaluate_chunk:
        return _each_alone(problem, values, progress_bar, label)
    chunk = chunk_size(problem, samples, chunk)
    count = -(-samples // chunk)
    # The last chunk is filled up with copies, so that all chunks run the one compiled program.
    padded = np.concatenate([values, np.repeat(values[-1:], count * chunk - samples, axis=0)])
    pieces = padded.reshape(count, chunk, -1)
    found: list[Any] = [None] * count
    if ledger is not None:
        asked = Question.of(problem, function)
        kind = eqx.filter_eval_shape(function, problem, jnp.asarray(pieces[0]))
        found = [ledger.taken(piece, kind, asked) for piece in pieces]
        ledger.begin()
    left = [number for number, known in enumerate(found) if known is None]
    program, before = Program(problem, function), stops()

    def one(number: int) -> Any:
        own = program.run(pieces[number], before, once=len(left) == 1)
        if ledger is not None:
            ledger.add(pieces[number], own, asked)
        return own

    with tqdm(total=samples, desc=label, disable=not progress_bar) as bar:
        bar.update(max(samples - len(left) * chunk, 0))

        def heard(number: int, own: Any) -> None:
            found[number] = own
            bar.update(min(chunk, samples - bar.n))

        if left:
            side_by_side(one, left, heard)
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:samples], *found)


def _each_alone(
    problem: Problem, values: np.ndarray, progress_bar: bool, label: str
) -> SampleResult:
    """Outcomes of samples that are no compiled program, one after the other: what they run may call
    LAPACK (see `calls_lapack`), which is not known before. In the caller's thread, so that each
    of their runs hears Ctrl-C."""
    shown = tqdm(values, desc=label, disable=not progress_bar)
    outcomes = [problem.evaluate(own) for own in shown]
    return jax.tree.map(lambda *parts: np.stack(parts), *outcomes)
