"""Runs a problem for many sets of values: compiled once, in chunks that fit memory, one thread a
core; from a store as far as it holds them.

Compiled programs leave Python free while they run, so two chunks run side by side on two cores
without splitting a device. Several accelerators share a chunk: each computes samples of its own, by
the same program as alone.
"""

import functools
import itertools
import os
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
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

from jaxclear.ground.description import describe
from jaxclear.ground.precision import check_double_precision
from jaxclear.integrators.checks import Check, Checks
from jaxclear.native import calls_lapack, stop, stoppable, stops
from jaxclear.native.compiled import Prepared, prepared
from jaxclear.studies.experiment import LANES, SampleResult
from jaxclear.studies.problem import Problem
from jaxclear.studies.store.digest import in_texts
from jaxclear.studies.store.store import CURRENT, Chunk, Store, compute_address

# Memory for one chunk [bytes] on machines with a few GiB a core.
CHUNK_MEMORY = 1 << 30
# Runs come in chunks of no fewer samples than these, where there are as many, so that there are so
# many chunks for each thread: the threads end together, and what is finished is seen.
LEAST_CHUNK, CHUNKS_A_THREAD = 64, 8
# [s] between looks at whether others have finished the chunks that they are at.
PATIENCE = 0.2
# What is kept of each sample; the figures of its checks, and when they were met.
COLUMNS = ("values", "responses", "outcome", "ended", "worst", "when")
VALUES, RESPONSES, OUTCOME, ENDED, WORST, WHEN = COLUMNS


class Stopped(Exception):
    """The chunk in work was interrupted; what was computed of it counts for nothing."""


@eqx.filter_jit
def evaluate_chunk(problem: Problem, values: Float[Array, "samples variables"]) -> SampleResult:
    """Outcomes of a chunk of samples."""
    return jax.vmap(problem.evaluate)(values)


@eqx.filter_jit
def uses_lapack(function, problem, values):
    """Results of a chunk, and whether their program calls LAPACK.

    Args:
        function: of a problem and values.
        problem: that is run.
        values: shape (samples, variables).
    """
    result = function(problem, values)
    return result, calls_lapack(*jax.tree.leaves(result))


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
    """Samples of a chunk, such that all threads are busy and memory suffices.

    Args:
        problem: says what a sample costs.
        samples: their number.
        chunk: as requested; None: chosen.
    """
    if chunk is not None:
        return min(chunk, samples)
    size = min(usual_batch(problem), -(-samples // threads_of()))
    if jax.default_backend() == "cpu" and not problem.cost().cheap:
        size = min(size, max(LEAST_CHUNK, -(-samples // (CHUNKS_A_THREAD * threads_of()))))
    # Fewer than fill a vector of the processor take as long, and a program of their own.
    return max(1, size, min(-(-size // LANES) * LANES, usual_batch(problem)))


@eqx.filter_jit
def _mapped(function: Callable[[Array], Any], values: Float[Array, "samples variables"]) -> Any:
    return jax.vmap(function)(values)


def sample_of_chunk(
    function: Callable[[Array], Any], values: Float[Array, " variables"], index: int, chunk: int
) -> Any:
    """What a function gives for one sample of a study in chunks, bit for bit as it was there.

    The sample is computed in the same lane of the same kernel, between copies of itself.

    Args:
        function: of one sample, a method of a problem.
        values: of the sample.
        index: of the sample in the study.
        chunk: samples of a chunk.
    """
    with stoppable():
        result = _mapped(function, jnp.tile(values, (chunk, 1)))
        return jax.tree.map(lambda leaf: leaf[index % chunk], jax.block_until_ready(result))


def _of_chunk(function: Callable, problem: Problem, values: Array) -> Any:
    """The runs of a study, many at once."""
    return function(problem, values)


class Program:
    """A function of chunks of a problem, compiled in this process and shared by its threads. `wide`
    ones lie in equal parts on all devices."""

    def __init__(self, problem: Problem, function: Callable = evaluate_chunk, wide: bool = False):
        self.problem = problem
        many = wide and devices() > 1
        self._function = _on_each if many else function
        self._laid_out = _split_over_devices if many else jnp.asarray
        self._compiling, self._alone = threading.Lock(), threading.Lock()
        # By size of chunks: what computes them, and whether it calls LAPACK.
        self._prepared: dict[int, Prepared] = {}

    def run(self, values: np.ndarray, before: int, single_use: bool = False) -> Any:
        """Results of a chunk, on the host.

        Args:
            values: shape (chunk, variables).
            before: number of interrupts when the study began.
            single_use: whether no other chunk follows.

        Raises:
            Stopped: runs were interrupted since.
        """
        program = self._find_program(values, single_use)
        # Programs that call LAPACK go one by one (a user's response may; see `calls_lapack`).
        with self._alone if program.lapack else nullcontext():
            result = jax.tree.map(np.asarray, program.call(values))
        if stops() != before:
            raise Stopped
        return result

    def compiled(self, values: np.ndarray) -> bool:
        """Compiles the program for chunks like this; whether it calls LAPACK."""
        return self._find_program(values).lapack

    def _find_program(self, values: np.ndarray, single_use: bool = False) -> Prepared:
        with self._compiling:
            program = self._prepared.get(len(values))
            if program is None:
                program = self._prepared[len(values)] = self._prepare(values, single_use)
            return program

    def _prepare(self, values: np.ndarray, single_use: bool) -> Prepared:
        # Compiled as a part of the program that is prepared.
        plain = getattr(self._function, "__wrapped__", self._function)
        program = prepared(_of_chunk, plain, self.problem, values)
        if program is not None:
            return program

        def evaluated(problem, values):
            function: Callable = uses_lapack
            return function(self._function, problem, self._laid_out(values))

        # Compiled by a run of no length.
        idle = self.problem.cost().idle
        little = self.problem if idle is None else self.problem.with_experiment(idle)
        lapack = not single_use and bool(evaluated(little, values)[1])
        return Prepared(lambda values: evaluated(self.problem, values)[0], lapack)


@functools.cache
def _mesh() -> Mesh:
    return Mesh(np.array(jax.local_devices()), ("samples",))


def _split_over_devices(values: np.ndarray) -> Array:
    return jax.device_put(values, NamedSharding(_mesh(), PartitionSpec("samples")))


def _on_each(problem: Problem, values: Float[Array, "samples variables"]) -> SampleResult:
    """A chunk of samples, an equal part of it on each device."""
    numbers, rest = eqx.partition(problem, eqx.is_array)

    def apply(numbers, values):
        return evaluate_chunk(eqx.combine(numbers, rest), values)

    # A device's part is a program of its own: its numbers are those of a batch of this size.
    parts = PartitionSpec(), PartitionSpec("samples")
    mapped = jax.shard_map(apply, mesh=_mesh(), in_specs=parts, out_specs=parts[1], check_vma=False)
    return mapped(numbers, values)


def side_by_side(
    one: Callable[[int], Any], numbers: Iterable[int], heard: Callable[[int, Any], None]
) -> None:
    """Calls a function for each number in threads, and reports results in their order.

    An interrupt ends the work in progress before it reaches the user.

    Args:
        one: function of a number.
        numbers: in the order of reports.
        heard: function of a number and its result.
    """
    numbers = list(numbers)
    # Several devices are busy side by side as it is.
    threads = threads_of() if devices() == 1 else 1
    with stoppable(), ThreadPoolExecutor(threads) as pool:
        try:
            for number, result in zip(numbers, pool.map(one, numbers), strict=True):
                heard(number, result)
        except BaseException as reason:
            if isinstance(reason, (KeyboardInterrupt, Stopped)):
                stop()
            pool.shutdown(wait=True, cancel_futures=True)
            if isinstance(reason, Stopped):
                raise KeyboardInterrupt from None
            raise


def in_turn(
    one: Callable[[int], Any], numbers: Iterable[int], heard: Callable[[int, Any], None]
) -> None:
    """As `side_by_side`, in the caller's thread.

    It serves samples that are no compiled program: they may call LAPACK, which is not known before,
    and each of their runs reacts to Ctrl-C.

    Args:
        one: function of a number.
        numbers: in the order of reports.
        heard: function of a number and its result.
    """
    for number in numbers:
        heard(number, one(number))


def until_all(
    one: Callable[[int], Any],
    numbers: Iterable[int],
    heard: Callable[[int, Any], None],
    run: Callable[..., None] = side_by_side,
) -> None:
    """As `side_by_side`, repeated for numbers at which another process works.

    Args:
        one: function of a number; None: another process is at it.
        numbers: in the order of reports.
        heard: function of a number and its result.
        run: `side_by_side` or `in_turn`.
    """
    remaining = list(numbers)
    while remaining:
        busy: list[int] = []

        def note(number: int, result: Any, busy: list[int] = busy) -> None:
            if result is None:
                busy.append(number)
            else:
                heard(number, result)

        run(one, remaining, note)
        remaining = busy
        time.sleep(PATIENCE if remaining else 0)


def pack(names: Sequence[str], values: Any, result: SampleResult) -> tuple[dict, dict[str, Any]]:
    """Arrays of samples by column, and a description of them, as a store holds them.

    Args:
        names: of the responses.
        values: of the variables, shape (samples, variables).
        result: of the samples.
    """
    rows = np.array([result.responses[name] for name in names], float)
    checks = result.checks
    columns = {
        VALUES: values,
        RESPONSES: rows.reshape(len(names), len(values)).T,
        OUTCOME: np.asarray(result.outcome, np.int8),
        ENDED: result.ended,
        WORST: checks.worst,
        WHEN: checks.time,
    }
    figures = [(check.name, place) for check, places in checks.named for place in places]
    return columns, {"figures": figures, "samples": len(values)}


def unpack(names: Sequence[str], figures: Any, columns: Mapping[str, Any]) -> SampleResult:
    """The samples of stored columns.

    Args:
        names: of the responses.
        figures: (check, place) of each column of checks.
        columns: arrays by name.
    """
    grouped = itertools.groupby(figures, key=lambda figure: figure[0])
    named = tuple((Check[check], tuple(place for _, place in places)) for check, places in grouped)
    return SampleResult(
        dict(zip(names, columns[RESPONSES].T, strict=True)),
        columns[OUTCOME].astype(np.int32),
        columns[ENDED],
        Checks(columns[WORST], columns[WHEN], named),
    )


class _Saved:
    """Chunks of these values (chunks, samples, variables) in a store: what a function of a chunk
    gives, as samples or as any tree of arrays."""

    def __init__(self, store: Store, problem: Problem, function: Any, pieces: np.ndarray):
        question = compute_address(in_texts(problem), describe([("", function)]))
        self.store, self.pieces, self.names = store, pieces, problem.response_names
        self.addresses = [compute_address(question, piece) for piece in pieces]
        self.kind: Any = None
        if function is not evaluate_chunk:
            shapes_of, values = eqx.filter_eval_shape, jnp.asarray(pieces[0])
            self.kind = functools.cache(lambda: shapes_of(function, problem, values))

    def load(self, number: int) -> Any:
        chunk = self.store.load(self.addresses[number])
        self.store.loaded += 0 if chunk is None else len(self.pieces[number])
        if chunk is None or self.kind is not None:
            return as_tree(self.kind, chunk)
        return unpack(self.names, chunk.about["figures"], chunk.arrays)

    def save(self, number: int, result: Any) -> Any:
        packed: tuple = (as_arrays(result),)
        if self.kind is None:
            packed = pack(self.names, self.pieces[number], result)
        self.store.write(self.addresses[number], *packed)
        return result


def as_arrays(tree: Any) -> dict[str, Any]:
    """The arrays of a tree, by their number."""
    return {str(i): leaf for i, leaf in enumerate(jax.tree.leaves(tree))}


def as_tree(kind: Callable[[], Any], chunk: Chunk | None) -> Any:
    """The tree whose arrays a chunk holds, like that of `kind`, which has shapes in place of
    arrays; None where it holds others, or there is none. Shapes take tracing what is computed, so
    they are asked for where a chunk is there."""
    if chunk is None:
        return None
    leaves, tree = jax.tree.flatten(kind())
    arrays = [*chunk.arrays.values()]
    if [(a.shape, a.dtype) for a in arrays] != [(a.shape, a.dtype) for a in leaves]:
        return None
    return jax.tree.unflatten(tree, arrays)


def evaluate_all(
    problem: Problem,
    values: Any,
    *,
    chunk: int | None = None,
    progress_bar: bool = False,
    label: str = "samples",
    function=evaluate_chunk,
) -> SampleResult:
    """Results of samples, in their order; arrays on the host.

    What the current store holds is not computed; what it lacks is saved, each chunk as it is
    finished, and computed by one of the processes that share the folder.

    Args:
        problem: that is run.
        values: of the variables, shape (samples, variables).
        chunk: samples computed together; None: chosen.
        progress_bar: whether one is shown.
        label: of the progress bar.
        function: of a problem and the values of a chunk.
    """
    check_double_precision()
    samples, values, store = len(values), np.asarray(values), CURRENT.get()
    # Any other function of a chunk is a compiled program, which a problem that is none refuses.
    compiled = problem.cost().compiled or function is not evaluate_chunk
    chunk = chunk_size(problem, samples, chunk) if compiled else 1
    count = -(-samples // chunk)
    # The last chunk is filled up with copies, so that all chunks run the one compiled program.
    padded = np.concatenate([values, np.repeat(values[-1:], count * chunk - samples, axis=0)])
    pieces = padded.reshape(count, chunk, -1)
    saved = None if store is None else _Saved(store, problem, function, pieces)
    results: list[Any] = [None if saved is None else saved.load(n) for n in range(count)]
    remaining = [number for number, result in enumerate(results) if result is None]
    program, before = Program(problem, function), stops()

    def compute(number: int) -> Any:
        if compiled:
            return program.run(pieces[number], before, single_use=len(remaining) == 1)
        return jax.tree.map(lambda leaf: np.asarray(leaf)[None], problem.evaluate(values[number]))

    def one(number: int) -> Any:
        if saved is None:
            return compute(number)
        load, save = lambda: saved.load(number), lambda: saved.save(number, compute(number))
        return saved.store.obtain(saved.addresses[number], load, save)

    with tqdm(total=samples, desc=label, disable=not progress_bar) as bar:
        bar.update(max(samples - len(remaining) * chunk, 0))

        def heard(number: int, result: Any) -> None:
            results[number] = result
            bar.update(min(chunk, samples - bar.n))

        if remaining:
            until_all(one, remaining, heard, side_by_side if compiled else in_turn)
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:samples], *results)
