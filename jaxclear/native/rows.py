"""Functions of few numbers over many rows, such as the states of a run at its saving times, and
functions through whose batches XLA goes sample by sample.

XLA fuses what a function works out into every place that reads it. Of an unrolled factorisation,
mapped over rows, it makes so much code that a mechanism with two spatial loops did not compile in
20 minutes; without fusion 4 s, as a kernel 2 s. So a long function becomes a kernel, and a short
one, which costs more to hand over than to compute, is left to XLA.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

from jaxclear.native.program import constants_first, fix_arguments, still, traced
from jaxclear.native.while_loops import as_kernel, scan

# Operations up to which a function is short: a body's place has some 100, the reactions of a
# slider-crank have 456.
SHORT = 200
# Rows that a kernel is handed at a time: constants come with every row.
AT_A_TIME = 1024


def over_rows(function: Callable, *rows: Any) -> Any:
    """As `jax.vmap(function)(*rows)`. Derivatives of long functions are taken row by row."""
    first = jax.tree.map(lambda each: jax.ShapeDtypeStruct(each.shape[1:], each.dtype), rows)
    traced = jax.jit(function)
    if _is_short(traced, first):
        return jax.vmap(traced)(*rows)
    one = jax.vmap(lambda row: as_kernel(traced, *row))
    count = len(jax.tree.leaves(rows)[0])
    times = -(-count // AT_A_TIME)
    if times <= 1:
        return one(rows)
    # The last row stands in for those that the last portion lacks: portions alike are one program.
    portion = np.arange(-(-count // times) * times).clip(max=count - 1).reshape(times, -1)
    portion_results = jax.lax.map(one, jax.tree.map(lambda each: each[portion], rows))
    return jax.tree.map(lambda each: each.reshape(-1, *each.shape[2:])[:count], portion_results)


def through_rows(function: Callable, *rows: Any) -> Any:
    """As `over_rows`, one row after the other in a single kernel: constants come once, not with
    every row, and what a row needs of long arrays that the function closes over is read by index.
    For a batch, or where little is asked of each row. Its derivatives are not asked for."""
    return scan(lambda none, row: (none, function(*row)), (), rows)[1]


def one_row(function: Callable, *numbers: Any) -> Any:
    """As `function(*numbers)`, a kernel where that is long: XLA takes a millisecond and more to
    compile each of its operations."""
    traced = jax.jit(function)
    return (traced if _is_short(traced, numbers) else functools.partial(as_kernel, traced))(
        *numbers
    )


def in_one(function: Callable, *numbers: Any) -> Any:
    """As `function(*numbers)`, one kernel where it is long and all of it can be one; otherwise as
    it is, and nobody is told."""
    traced = jax.jit(function)
    long = functools.partial(as_kernel, traced, vmapped=True)
    return (traced if _is_short(traced, numbers) else long)(*numbers)


def _is_short(function: Callable, numbers: Any) -> bool:
    return operations_of(jax.make_jaxpr(function)(*numbers).jaxpr) <= SHORT


def operations_of(program: Jaxpr) -> int:
    """How many operations a program writes out, those of the programs it calls among them."""
    count = 0
    for equation in program.eqns:
        inner = [p.jaxpr if isinstance(p, ClosedJaxpr) else p for p in equation.params.values()]
        called = [p for p in inner if isinstance(p, Jaxpr)]
        count += sum(map(operations_of, called)) if called else 1
    return count


# Derivatives that are kept.
LATEST = 16
in_turn_p = Primitive("jaxclear_one_by_one")
in_turn_p.multiple_results = True


def one_by_one(function: Callable) -> Callable:
    """The function, whose samples in a batch are gone through one after the other. Differentiable
    forwards."""

    def wrapped(*numbers: Any) -> Any:
        program, shape = jax.make_jaxpr(function, return_shape=True)(*numbers)
        values = [*program.consts, *map(jnp.asarray, jax.tree.leaves(numbers))]
        results = in_turn_p.bind(*values, program=constants_first(program), motion=None)
        return jax.tree.unflatten(jax.tree.structure(shape), results)

    return wrapped


def _run(*values: Any, program: ClosedJaxpr, motion: tuple[int, int] | None) -> list:
    return list(jaxpr_as_fun(program)(*values))


def _differentiate(primals, tangents, *, program, motion):
    floats = [jnp.issubdtype(aval.dtype, jnp.floating) for aval in program.out_avals]
    moving = tuple(i for i, tangent in enumerate(tangents) if not isinstance(tangent, ad.Zero))
    counts = len(primals), len(floats)
    inputs = [*primals, *(tangents[i] for i in moving)]
    results = in_turn_p.bind(*inputs, program=_with_tangents(program, moving), motion=counts)
    out, moved = results[: counts[1]], iter(results[counts[1] :])
    pairs = zip(floats, out, strict=True)
    return out, [next(moved) if is_float else still(each) for is_float, each in pairs]


# JAX asks for the derivative of a loop's turn several times.
@functools.lru_cache(maxsize=LATEST)
def _with_tangents(program: ClosedJaxpr, moving: tuple[int, ...]) -> ClosedJaxpr:
    """The program over its inputs and tangents of those that move, to its results and the tangents
    of those that are floats."""
    count = len(program.in_avals)

    def pushed(*numbers):
        values, tangents = numbers[:count], numbers[count:]
        function = fix_arguments(jaxpr_as_fun(program), values, moving)
        out, moved = jax.jvp(function, [values[i] for i in moving], list(tangents))
        pairs = zip(moved, program.out_avals, strict=True)
        return [*out, *(m for m, aval in pairs if jnp.issubdtype(aval.dtype, jnp.floating))]

    avals = [*program.in_avals, *(program.in_avals[i] for i in moving)]
    return constants_first(traced(pushed, avals))


def _in_turn() -> bool:
    return jax.default_backend() == "cpu"


def _batch(values, dims, *, program, motion):
    batched = [dim is not None for dim in dims]
    if motion is not None and not any(batched[: motion[0]]):
        # Several tangents of one motion.
        mapped = jax.vmap(
            jaxpr_as_fun(program),
            in_axes=tuple(dims),
            out_axes=[None if i < motion[1] else 0 for i in range(len(program.out_avals))],
        )
        results = in_turn_p.bind(
            *values, program=constants_first(jax.make_jaxpr(mapped)(*values)), motion=motion
        )
        return results, [None if i < motion[1] else 0 for i in range(len(results))]

    if not _in_turn():
        out = jax.vmap(jaxpr_as_fun(program), in_axes=tuple(dims))(*values)
        return list(out), [0] * len(out)

    def sample(batch_values):
        batch_values = iter(batch_values)
        pairs = zip(values, batched, strict=True)
        inputs = [next(batch_values) if has_axis else value for value, has_axis in pairs]
        return in_turn_p.bind(*inputs, program=program, motion=motion)

    pairs = zip(values, dims, strict=True)
    results = jax.lax.map(sample, [jnp.moveaxis(v, dim, 0) for v, dim in pairs if dim is not None])
    return results, [0] * len(results)


in_turn_p.def_impl(lambda *values, **params: jax.jit(lambda *v: _run(*v, **params))(*values))
in_turn_p.def_abstract_eval(lambda *_, program, motion: program.out_avals)
batching.primitive_batchers[in_turn_p] = _batch
ad.primitive_jvps[in_turn_p] = _differentiate
mlir.register_lowering(in_turn_p, mlir.lower_fun(_run, multiple_results=True))
