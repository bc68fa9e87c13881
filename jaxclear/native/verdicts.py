"""What became of a program's loops: machine code, or XLA and why. The program itself tells.

Only while a program is lowered for its platform is it decided whether a loop becomes a kernel. Each
loop then leaves a word in the module being lowered, and `verdict` becomes a constant of that same
module: a number that stands for a sentence. So it travels with the compiled program, through caches
and threads, and a second run says what the first one said.
"""

import threading
import zlib
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

KERNELS = "The time loops ran as machine code."
NO_LOOPS = (
    "No time loop asked for machine code: fixed numbers of steps do not, nor do derivatives of "
    "adaptive ones."
)
SWITCHED_OFF = "the kernels are switched off by JAXCLEAR_PLAIN_LOOPS"
NOT_A_CPU = "kernels are for CPUs, and for NVIDIA GPUs where JAXCLEAR_GPU_KERNELS=1 asks for them"
# Under this name loops leave their words in the dictionary of the module that is being lowered.
PLACE = "jaxclear: what became of the loops"
# The number of a sentence depends on it alone, so that programs compare equal between processes.
SENTENCES: dict[int, str] = {}

verdict_p = Primitive("jaxclear_verdict")
calls_lapack_p = Primitive("jaxclear_calls_lapack")


def verdict(after: Any) -> Any:
    """A number that `explain` turns into a sentence: how the loops of this program are run.

    `after`: any array that comes out of the last of the loops; loops behind it are not counted.
    """
    return verdict_p.bind(jnp.asarray(after))


def calls_lapack(*after: Any) -> Any:
    """Whether this program factorises by LAPACK anywhere before these arrays are known.

    Two such programs side by side can wait for each other for ever: jaxlib shares a batch of
    matrices out among the threads of its pool, and waits for them in a thread of that pool.
    """
    return calls_lapack_p.bind(*map(jnp.asarray, after))


def explain(number: int) -> str:
    """The sentence that a verdict stands for."""
    return SENTENCES.get(int(number), "The time loops were compiled by another process.")


class NoKernel(Exception):
    """A time loop of the program under way is left to XLA; the reason."""


class _Lowering(threading.local):
    """How programs are lowered in a thread."""

    only_kernels = False
    run_once = False


_LOWERING = _Lowering()


@contextmanager
def _lowering(name: str, value: bool) -> Iterator[None]:
    before = getattr(_LOWERING, name)
    setattr(_LOWERING, name, value)
    try:
        yield
    finally:
        setattr(_LOWERING, name, before)


def only_kernels() -> AbstractContextManager[None]:
    """Within it no program is compiled one of whose time loops is left to XLA: `NoKernel` ends
    that before XLA has begun."""
    return _lowering("only_kernels", True)


def lowered_to_run_once(is_run_once: bool) -> AbstractContextManager[None]:
    """Within it programs are compiled that run once, or not."""
    return _lowering("run_once", is_run_once)


def is_lowered_to_run_once() -> bool:
    """Whether the program that is being compiled is one that runs once."""
    return _LOWERING.run_once


def note_fallback(reason: str) -> None:
    """A time loop of the module under way has no kernel. Raises `NoKernel` within
    `only_kernels`."""
    if _LOWERING.only_kernels:
        raise NoKernel(reason)


def note_verdict(context: Any, reason: str | None) -> None:
    """A loop of the module under way becomes a kernel (None), or is left to XLA for this reason."""
    context.module_context.cached_primitive_lowerings.setdefault(PLACE, []).append(reason)


def _hash_sentence(sentence: str) -> int:
    """A whole number of 31 bits."""
    number = zlib.crc32(sentence.encode()) >> 1
    SENTENCES[number] = sentence
    return number


def _join_reasons(words: list[str | None]) -> str:
    reasons = sorted({word for word in words if word is not None})
    if not reasons:
        return KERNELS if words else NO_LOOPS
    fallback_share = f"{len(words) - words.count(None)} of {len(words)} time loops ran through XLA"
    return f"{fallback_share}: {'; '.join(reasons)}."


def _lower(context, _):
    words = context.module_context.cached_primitive_lowerings.get(PLACE, [])
    return [mlir.ir_constant(np.int32(_hash_sentence(_join_reasons(words))))]


def _lower_lapack(context, *_):
    return [mlir.ir_constant(np.bool_(any_lapack(context.module_context.module.operation)))]


def any_lapack(operation: Any) -> bool:
    """Whether a program, or a part of one, as it is handed to XLA calls LAPACK."""
    target = "call_target_name"
    if target in operation.attributes and "lapack" in str(operation.attributes[target]):
        return True
    return any(
        any_lapack(inner.operation)
        for region in operation.regions
        for block in region
        for inner in block
    )


@calls_lapack_p.def_impl
def _lapack_alone(*after):
    return jax.jit(calls_lapack_p.bind)(*after)


@calls_lapack_p.def_abstract_eval
def _lapack_shape(*after):
    return jax.core.ShapedArray((), jnp.bool_)


@verdict_p.def_impl
def _alone(after):
    return jax.jit(verdict_p.bind)(after)


@verdict_p.def_abstract_eval
def _shape(after):
    return jax.core.ShapedArray((), jnp.int32)


def _batch(values, dims):
    return verdict_p.bind(*values), None  # the same for every sample


def _differentiate(values, tangents):
    return verdict_p.bind(*values), ad.Zero(jax.core.ShapedArray((), jax.dtypes.float0))


batching.primitive_batchers[verdict_p] = _batch
ad.primitive_jvps[verdict_p] = _differentiate
mlir.register_lowering(verdict_p, _lower)
mlir.register_lowering(calls_lapack_p, _lower_lapack)
