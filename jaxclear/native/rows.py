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

from jaxclear.native.program import constants_first, of_moving, still, traced
from jaxclear.native.while_loops import once, scan

# Operations up to which a function is short: a body's place has some 100, the reactions of a
# slider-crank have 456.
SHORT = 200
# Operations from which on what runs once is a kernel: to compile 2 500 of them LLVM takes as long
# as XLA (0.5 s), for 47 000 a quarter of the time (5 s) and of the memory.
LONG = 5000
# Rows that a kernel is handed at a time: constants come with every row.
AT_A_TIME = 1024


def over_rows(function: Callable, *rows: Any) -> Any:
    """As `jax.vmap(function)(*rows)`. Derivatives of long functions are taken row by row."""
    first = jax.tree.map(lambda each: jax.ShapeDtypeStruct(each.shape[1:], each.dtype), rows)
    traced = jax.jit(function)
    if _is_short(traced, first, SHORT):
        return jax.vmap(traced)(*rows)
    one = jax.vmap(lambda row: once(traced, *row))
    count = len(jax.tree.leaves(rows)[0])
    times = -(-count // AT_A_TIME)
    if times <= 1:
        return one(rows)
    # The last row stands in for those that the last portion lacks: portions alike are one program.
    portion = np.arange(-(-count // times) * times).clip(max=count - 1).reshape(times, -1)
    found = jax.lax.map(one, jax.tree.map(lambda each: each[portion], rows))
    return jax.tree.map(lambda each: each.reshape(-1, *each.shape[2:])[:count], found)


def through_rows(function: Callable, *rows: Any) -> Any:
    """As `over_rows`, one row after the other in a single kernel: constants come once, not with
    every row, and what a row needs of long arrays that the function closes over is read by index.
    For a batch, or where little is asked of each row. Its derivatives are not asked for."""
    return scan(lambda none, row: (none, function(*row)), (), rows)[1]


def one_row(function: Callable, *numbers: Any) -> Any:
    """As `function(*numbers)`, a kernel where that is long: XLA takes a millisecond and more to
    compile each of its operations."""
    traced = jax.jit(function)
    return (traced if _is_short(traced, numbers, SHORT) else functools.partial(once, traced))(
        *numbers
    )


def in_one(function: Callable, *numbers: Any) -> Any:
    """As `function(*numbers)`, one kernel where it is long and all of it can be one; otherwise as
    it is, and nobody is told."""
    return _kernel_if_above(SHORT, function, numbers)


def compiled_sooner(function: Callable, *numbers: Any) -> Any:
    """As `in_one`, where a kernel also compiles in less time and memory than XLA takes: for what
    runs once."""
    return _kernel_if_above(LONG, function, numbers)


def _kernel_if_above(operations: int, function: Callable, numbers: Any) -> Any:
    traced = jax.jit(function)
    long = functools.partial(once, traced, whole=True)
    return (traced if _is_short(traced, numbers, operations) else long)(*numbers)


def _is_short(function: Callable, numbers: Any, operations: int) -> bool:
    return operations_of(jax.make_jaxpr(function)(*numbers).jaxpr) <= operations


def operations_of(program: Jaxpr) -> int:
    """How many operations a program writes out, those of the programs it calls among them."""
    found = 0
    for equation in program.eqns:
        inner = [p.jaxpr if isinstance(p, ClosedJaxpr) else p for p in equation.params.values()]
        called = [p for p in inner if isinstance(p, Jaxpr)]
        found += sum(map(operations_of, called)) if called else 1
    return found


# Derivatives that are kept.
LATEST = 16
in_turn_p = Primitive("jaxclear_one_by_one")
in_turn_p.multiple_results = True


def one_by_one(function: Callable) -> Callable:
    """The function, whose samples in a batch are gone through one after the other. Differentiable
    forwards."""

    def wrapped(*given: Any) -> Any:
        program, shape = jax.make_jaxpr(function, return_shape=True)(*given)
        values = [*program.consts, *map(jnp.asarray, jax.tree.leaves(given))]
        found = in_turn_p.bind(*values, program=constants_first(program), motion=None)
        return jax.tree.unflatten(jax.tree.structure(shape), found)

    return wrapped


def _run(*values: Any, program: ClosedJaxpr, motion: tuple[int, int] | None) -> list:
    return list(jaxpr_as_fun(program)(*values))


def _differentiate(primals, tangents, *, program, motion):
    floats = [jnp.issubdtype(aval.dtype, jnp.floating) for aval in program.out_avals]
    moving = tuple(i for i, tangent in enumerate(tangents) if not isinstance(tangent, ad.Zero))
    counts = len(primals), len(floats)
    given = [*primals, *(tangents[i] for i in moving)]
    found = in_turn_p.bind(*given, program=_with_tangents(program, moving), motion=counts)
    out, moved = found[: counts[1]], iter(found[counts[1] :])
    pairs = zip(floats, out, strict=True)
    return out, [next(moved) if is_float else still(each) for is_float, each in pairs]


# JAX asks for the derivative of a loop's turn several times.
@functools.lru_cache(maxsize=LATEST)
def _with_tangents(program: ClosedJaxpr, moving: tuple[int, ...]) -> ClosedJaxpr:
    """The program over its inputs and tangents of those that move, to its results and the tangents
    of those that are floats."""
    count = len(program.in_avals)

    def pushed(*given):
        values, ways = given[:count], given[count:]
        function = of_moving(jaxpr_as_fun(program), values, moving)
        out, moved = jax.jvp(function, [values[i] for i in moving], list(ways))
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
        ways = jax.vmap(
            jaxpr_as_fun(program),
            in_axes=tuple(dims),
            out_axes=[None if i < motion[1] else 0 for i in range(len(program.out_avals))],
        )
        found = in_turn_p.bind(
            *values, program=constants_first(jax.make_jaxpr(ways)(*values)), motion=motion
        )
        return found, [None if i < motion[1] else 0 for i in range(len(found))]

    if not _in_turn():
        out = jax.vmap(jaxpr_as_fun(program), in_axes=tuple(dims))(*values)
        return list(out), [0] * len(out)

    def sample(own):
        own = iter(own)
        pairs = zip(values, batched, strict=True)
        given = [next(own) if has_axis else value for value, has_axis in pairs]
        return in_turn_p.bind(*given, program=program, motion=motion)

    pairs = zip(values, dims, strict=True)
    found = jax.lax.map(sample, [jnp.moveaxis(v, dim, 0) for v, dim in pairs if dim is not None])
    return found, [0] * len(found)


in_turn_p.def_impl(lambda *values, **params: jax.jit(lambda *v: _run(*v, **params))(*values))
in_turn_p.def_abstract_eval(lambda *_, program, motion: program.out_avals)
batching.primitive_batchers[in_turn_p] = _batch
ad.primitive_jvps[in_turn_p] = _differentiate
mlir.register_lowering(in_turn_p, mlir.lower_fun(_run, multiple_results=True))
