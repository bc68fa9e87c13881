"""How programs are compiled that do little work themselves, and where they are kept: how long they
compile counts more than how fast they are.

A program is found by the form of its arguments (`forms`): first in this process, then on disk,
where an earlier process has left it with its kernels; else it is traced and compiled, and left
there. What is found is called with plain arrays, so that a call costs little beside its work.
"""

import functools
import io
import logging
import pickle
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import serialize_executable
from jax.extend.core import Jaxpr, Literal, jaxpr_as_fun
from jaxlib.lapack import prepare_lapack_call

from jaxclear.ground import cache_folder
from jaxclear.ground.compiling import uncollected
from jaxclear.ground.quantity import is_traced, is_tracing
from jaxclear.ground.recent_results import Latest
from jaxclear.native import check, dispatch, verdicts
from jaxclear.native.derivative_rules import columns_p
from jaxclear.native.forms import (
    Untold,
    environment_of_program,
    function_in_text,
    in_text,
    tree_in_text,
)
from jaxclear.native.rows import operations_of
from jaxclear.native.verdicts import NoKernel, only_kernels

# XLA's newer emitters of fusions compile a third longer. Around a loop of machine code they gain
# 1 to 5 % of a run, and 17 % of one that XLA's own loop goes through.
AROUND_A_KERNEL = {"xla_cpu_use_fusion_emitters": False}
# What runs once is not optimised either: assemblies compile three times as fast and take no longer.
# A loop that XLA goes through itself takes two to three times as long so.
QUICK = {
    **AROUND_A_KERNEL,
    "xla_backend_optimization_level": 0,
    "xla_llvm_disable_expensive_passes": True,
}
# XLA drops options between its versions, and says so by this; those that this one lacks.
NO_OPTION = "No such compile option"
_unknown: set[str] = set()
LOG = logging.getLogger(__name__)
# Compiling [s] after which a user is told what is compiled.
PATIENCE = 10.0
# Settings of JAX that one process may change between two calls of the same function.
SETTINGS = (
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_default_prng_impl",
    "jax_numpy_dtype_promotion",
    "jax_numpy_rank_promotion",
)
# JAX records this where it finds a program that an earlier process has compiled.
CACHE_HIT_EVENT = "/jax/compilation_cache/cache_hits"
# Programs that a process has at hand take so much of its memory [B], as far as their operations
# tell: of slider-crank and four-bar a program takes 3 kB an operation beside 0.5 MB.
AT_HAND = 50e6
A_PROGRAM, AN_OPERATION = 0.5e6, 3e3


@dataclass(frozen=True)
class Place:
    """Stands for an array of a program's results, that of a number; `is_input`: for its argument of
    this number, as it was given."""

    number: int
    is_input: bool = False


class _Compiled:
    """A compiled program over a list of arrays, whether it calls `lapack`, how many `operations` it
    writes out, and what its results are put together to: things that are no arrays, and `Place`s
    for those that are."""

    def __init__(self, program: Any, lapack: bool, operations: int, leaves: list, structure: Any):
        self.program, self.lapack, self.operations = program, lapack, operations
        self.leaves, self.structure = leaves, structure
        places = [(i, x) for i, x in enumerate(leaves) if type(x) is Place]
        self.call_defined = [(i, place.number) for i, place in places if not place.is_input]
        self.passed_through = [(i, place.number) for i, place in places if place.is_input]

    def __call__(self, arrays: Sequence[Any]) -> Any:
        results, out = self.program(*arrays), self.leaves.copy()
        for i, number in self.call_defined:
            out[i] = results[number]
        for i, number in self.passed_through:
            array = arrays[number]
            out[i] = array if isinstance(array, jax.Array) else jnp.asarray(array)
        return jax.tree.unflatten(self.structure, out)


_AT_HAND: Latest[_Compiled] = Latest(AT_HAND)


def compiled_quickly(
    function: Callable[..., Any], options: dict[str, Any] | None = None
) -> Callable[..., Any]:
    """As `equinox.filter_jit`, compiled with these options of XLA's; without any, as what runs
    once: `QUICK`, and its functions that are kernels are not optimised either. Within another
    program it is part of that one, and compiled as that one is."""
    xla_options = QUICK if options is None else options
    # Its annotations leave out what it hands on to `jax.jit`.
    compiled: Any = eqx.filter_jit
    plain = compiled(function)

    @functools.cache
    def quick(unknown: frozenset[str]) -> Callable[..., Any]:
        return compiled(function, compiler_options=_supported(xla_options, unknown))

    @functools.wraps(function)
    def call(*arguments):
        leaves, tree = jax.tree.flatten(arguments)
        # JAX refuses options of a program within a program.
        if is_traced(leaves) or is_tracing():
            return plain(*arguments)
        while True:
            unknown = frozenset(_unknown)
            try:
                with verdicts.lowered_to_run_once(options is None):
                    program = _find(function, _supported(xla_options, unknown), leaves, tree)
                    if program is None:
                        with uncollected():
                            return quick(unknown)(*arguments)
                return program([leaf for leaf in leaves if eqx.is_array(leaf)])
            except jax.errors.JaxRuntimeError as error:
                lacking = [name for name in xla_options if f"{NO_OPTION}: '{name}'" in str(error)]
                if not lacking:
                    raise
                _unknown.update(lacking)

    return call


class Prepared(NamedTuple):
    """A compiled function of arrays that are all of one form, and whether it calls `lapack`."""

    call: Callable[[Any], Any]
    lapack: bool


def prepared(function: Callable[..., Any], *arguments: Any) -> Prepared | None:
    """A function of what is like the last of these arguments, an array, the others being these:
    they are looked at once, so that a call costs little. None where programs are JAX's to keep."""
    leaves, tree = jax.tree.flatten(arguments)
    program = _find(function, {}, leaves, tree)
    if program is None:
        return None
    arrays = [jax.device_put(leaf) for leaf in leaves[:-1] if eqx.is_array(leaf)]
    return Prepared(lambda last: program([*arrays, last]), program.lapack)


def _supported(options: dict[str, Any], unknown: frozenset[str]) -> dict[str, Any]:
    return {name: value for name, value in options.items() if name not in unknown}


def _find(function: Callable, options: dict[str, Any], leaves: list, tree: Any) -> _Compiled | None:
    """The program of such arguments; None where it is JAX's to keep."""
    if not _is_cache_usable():
        return None
    kinds = tuple(_type_of_array(x) if eqx.is_array(x) else (type(x), x) for x in leaves)
    settings = tuple(getattr(jax.config, name) for name in SETTINGS)
    form = function, tuple(options), tree, kinds, settings
    program = _AT_HAND.get(form)
    if program is None:
        program = _load_or_compile(function, options, leaves, tree)
        _AT_HAND.keep(form, program, A_PROGRAM + AN_OPERATION * program.operations)
    return program


def _type_of_array(array: Any) -> Any:
    # What `jax.typeof` answers of JAX's own arrays, without asking which kind of thing they are.
    return array.aval if isinstance(array, jax.Array) else jax.typeof(array)


def _is_cache_usable() -> bool:
    """Whether programs are kept at all: those of one processor, of which nothing special is asked
    that JAX alone does."""
    settings: Any = jax.config
    is_debugging = settings.jax_debug_nans or settings.jax_debug_infs or settings.jax_disable_jit
    if is_debugging or cache_folder.folder_path() is None or check.is_check_enabled():
        return False
    return jax.default_backend() == "cpu" and jax.local_device_count() == 1


def _load_or_compile(
    function: Callable, options: dict[str, Any], leaves: list, tree: Any
) -> _Compiled:
    key = _key(function, options, leaves, tree)
    program = None if key is None else _load_from_disk(key)
    return _compile(function, options, leaves, tree, key) if program is None else program


def _key(function: Callable, options: dict[str, Any], leaves: list, tree: Any) -> str | None:
    """Under which a program is kept on disk; None where no other process could use it."""
    try:
        description = function_in_text(function), str(options), tree_in_text(tree)
        around = environment_of_program()
        kinds = [
            f"{leaf.shape}{leaf.dtype}{jax.typeof(leaf).weak_type}"
            if eqx.is_array(leaf)
            else in_text(leaf)
            for leaf in leaves
        ]
    except Untold:
        return None
    return cache_folder.key_of(*description, *kinds, around)


def _compile(function: Callable, options: dict, leaves: list, tree: Any, key: Any) -> _Compiled:
    """Traces and compiles a program, and leaves it on disk under its key, if it has one."""
    form: list[Any] = []

    def flat(*arrays):
        array_iterator = iter(arrays)
        values = [next(array_iterator) if eqx.is_array(leaf) else leaf for leaf in leaves]
        out, structure = jax.tree.flatten(function(*jax.tree.unflatten(tree, values)))
        form[:] = out, structure
        return [leaf for leaf in out if eqx.is_array(leaf)]

    flat.__name__ = flat.__qualname__ = getattr(function, "__name__", "program")
    arrays = [leaf for leaf in leaves if eqx.is_array(leaf)]
    with uncollected(), _report_if_long(function):
        traced = jax.jit(flat).trace(*arrays)
        lowered, places = _lower_without_copies(traced, arrays, flat.__name__)
        place_iterator, (out, structure) = iter(places), form
        out = [next(place_iterator) if eqx.is_array(leaf) else leaf for leaf in out]
        lapack = verdicts.any_lapack(lowered.compiler_ir().operation)
        count, before = operations_of(traced.jaxpr.jaxpr), _count_cache_hits()
        made = _Compiled(lowered.compile(compiler_options=options), lapack, count, out, structure)
    # One that XLA has read and writes again lacks its functions, and fails when it is called.
    if key is None or _count_cache_hits() > before:
        return made
    try:
        content = pickle.dumps((_serialise(made), lapack, count, verdicts.SENTENCES))
    except Exception:
        # Not every program can be kept: one that calls back into Python, for one.
        return made
    cache_folder.write(cache_folder.PROGRAM, key, content)
    return made


@contextmanager
def _report_if_long(function: Callable) -> Iterator[None]:
    """What is compiled within, said where it takes longer than `PATIENCE`: who waits does not know
    for what."""
    what = (function.__doc__ or function.__name__).strip().partition("\n")[0]
    sentence = "jaxclear has been compiling for %g s: %s"
    timer = threading.Timer(PATIENCE, LOG.warning, (sentence, PATIENCE, what))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


_HITS = threading.local()


@functools.cache
def _start_counting_hits() -> None:
    """This process counts what JAX finds on disk, by threads."""

    def count(event: str, **_: Any) -> None:
        if event == CACHE_HIT_EVENT:
            _HITS.count = getattr(_HITS, "count", 0) + 1

    jax.monitoring.register_event_listener(count)


def _count_cache_hits() -> int:
    """How many programs JAX has found on disk in this thread."""
    _start_counting_hits()
    return getattr(_HITS, "count", 0)


def _lower_without_copies(traced: Any, arrays: list, name: str) -> tuple[Any, list[Place]]:
    """A traced program, lowered without the results that are its arguments as they were given, and
    where each result is then."""
    results = traced.jaxpr.jaxpr.outvars
    origins = [_argument_of_result(traced.jaxpr.jaxpr, result) for result in results]
    # Numbers that come from NumPy are JAX's by being results.
    origins = [x if x is None or isinstance(arrays[x], jax.Array) else None for x in origins]
    computed = [i for i, origin in enumerate(origins) if origin is None]
    places = [
        Place(computed.index(i)) if x is None else Place(x, is_input=True)
        for i, x in enumerate(origins)
    ]
    if len(computed) == len(results):
        return traced.lower(), places
    all_results = jaxpr_as_fun(traced.jaxpr)

    def without(*arrays):
        results = all_results(*arrays)
        return [results[i] for i in computed]

    without.__name__ = without.__qualname__ = name
    return jax.jit(without).lower(*arrays), places


# Steps that are a program of their own, by the name of the parameter that holds it.
_WITHIN = {columns_p.name: "program", "custom_jvp_call": "call_jaxpr", "jit": "jaxpr"}


def _argument_of_result(program: Jaxpr, result: Any) -> int | None:
    """The number of the argument that a result of a program is; None where it is worked out."""
    if isinstance(result, Literal):
        return None
    if result in program.invars:
        return program.invars.index(result)
    for step in program.eqns:
        if result not in step.outvars:
            continue
        within = _WITHIN.get(step.primitive.name)
        # Where something is moved, results are more than those of the program.
        if within is None or step.params.get("moving") or step.params.get("maps"):
            return None
        inner = step.params[within].jaxpr
        number = _argument_of_result(inner, inner.outvars[step.outvars.index(result)])
        return None if number is None else _argument_of_result(program, step.invars[number])
    return None


def _serialise(program_found: _Compiled) -> tuple[bytes, int, int, Any]:
    program, inputs, taken = serialize_executable.serialize(program_found.program)
    result = jax.tree.unflatten(program_found.structure, program_found.leaves)
    return program, inputs.num_leaves, taken.num_leaves, result


def _load_from_disk(key: str) -> _Compiled | None:
    content = cache_folder.read(cache_folder.PROGRAM, key)
    if content is None:
        return None
    try:
        (program, args, taken, result), lapack, count, sentences = pickle.load(io.BytesIO(content))
        dispatch.register_with_xla()
        if lapack:
            _initialise_lapack()
        trees = jax.tree.structure(((0,) * args, {})), jax.tree.structure([0] * taken)
        loaded = serialize_executable.deserialize_and_load(program, *trees)
    except Exception:
        # Of another version, or without its kernels: as if it were not there.
        return None
    verdicts.SENTENCES.update(sentences)
    return _Compiled(loaded, lapack, count, *jax.tree.flatten(result))


@functools.cache
def _initialise_lapack() -> None:
    """jaxlib finds LAPACK when the first program that calls it is lowered, which one that is loaded
    is not."""
    prepare_lapack_call("potrf_ffi", np.dtype(float))


def compiled_for_kernels(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `equinox.filter_jit`, compiled as what runs `QUICK` if its time loops are kernels, and
    otherwise `AROUND_A_KERNEL`: XLA then goes through them itself."""
    soon = compiled_quickly(function, QUICK)
    return kernels_or(soon, compiled_quickly(function, AROUND_A_KERNEL))


def kernels_or(soon: Callable[..., Any], usual: Callable[..., Any]) -> Callable[..., Any]:
    """A compiled function, and another in its place where its time loops are no kernels."""
    refused: set[Any] = set()

    @functools.wraps(usual)
    def call(*arguments):
        if refused and _kind_of_arguments(arguments) in refused:
            return usual(*arguments)
        try:
            with only_kernels():
                return soon(*arguments)
        except NoKernel:
            refused.add(_kind_of_arguments(arguments))
        return usual(*arguments)

    return call


def _kind_of_arguments(arguments: Any) -> Any:
    """What of arguments decides which program they are compiled to."""
    leaves, structure = jax.tree.flatten(arguments)
    shapes = (jax.typeof(x) if eqx.is_array(x) else x for x in leaves)
    return structure, tuple(shapes)
