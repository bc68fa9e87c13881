"""A while loop over a few numbers as a primitive of JAX: how it batches and what it becomes.

On a CPU the loop becomes one kernel of machine code (`kernel`), several samples of a batch side by
side, each ending by itself. Elsewhere and where a part of the program has no rule it is JAX's own
loop. JAXCLEAR_PLAIN_LOOPS=1 switches the kernel off.
"""

import functools
import logging
import os
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive, jaxpr_as_fun
from jax.interpreters import batching, mlir

from jaxclear.ground.warning import warn
from jaxclear.native import dispatch
from jaxclear.native import kernel as kernels
from jaxclear.native.machine import widest
from jaxclear.native.pieces import in_pieces
from jaxclear.native.program import (
    Program,
    Table,
    avals_of,
    changing,
    floats_in,
    in_memory,
    loops_marked,
    packed_state,
    row_of,
)
from jaxclear.native.tangent import bundled, by_portions, side_by_side
from jaxclear.native.verdicts import NOT_A_CPU, SWITCHED_OFF, left_to_xla, tell
from jaxclear.native.writer import Unsupported

LOG = logging.getLogger(__name__)
loop_p = Primitive("jaxclear_loop")
loop_p.multiple_results = True
# Reasons that have been told.
_WARNED: set[str] = set()


def reference(*values: Any, program: Program, function_of: Callable = jaxpr_as_fun) -> list:
    """The same by `jax.lax.while_loop`, or by the body alone where it takes one turn. `function_of`
    makes functions of programs."""
    c, b = program.condition_constants, program.body_constants
    tests, turns = jaxpr_as_fun(program.condition), function_of(program.body)
    fixed_condition, fixed_body, first = values[:c], values[c : c + b], list(values[c + b :])
    if program.once:
        return list(turns(*fixed_body, *first))
    if program.length:
        # The loops within it are then kernels by themselves.
        turns = function_of(loops_marked(program.body, within=False))
        places = [fixed_body[table.places] for table in program.tables]
        empty = list(map(_begun(fixed_body), program.tables, row_of(program)))

        def turn(carry, index):
            state, tables = carry
            found = turns(*fixed_body, *state)
            rows = zip(tables, places, found[len(first) :], strict=True)
            put = [t.at[p[index].astype(int)].set(row, mode="drop") for t, p, row in rows]
            return (found[: len(first)], put), None

        (last, tables), _ = jax.lax.scan(turn, (first, empty), jnp.arange(program.length))
        return [*last, *tables]
    return list(
        jax.lax.while_loop(
            lambda s: tests(*fixed_condition, *s)[0], lambda s: list(turns(*fixed_body, *s)), first
        )
    )


def _begun(constants: Sequence[Any]) -> Callable[[Table, Any], Any]:
    """What a table, of rows of a shape and type, holds before the first turn."""

    def begun(table, aval):
        rows = jnp.zeros((table.height, *aval.shape), aval.dtype)
        return rows if table.begins is None else rows.at[0].set(constants[table.begins])

    return begun


def reference_of_batch(*values: Any, program: Program, rank: int) -> list:
    """The same for batches of so many leading axes."""
    function = functools.partial(reference, program=program)
    return _of_batch(function, _row_by_row if program.once else jax.vmap, values, program, rank)


def reference_in_pieces(*values: Any, program: Program, rank: int) -> list:
    """The same for accelerators: samples side by side, programs `in_pieces`."""
    function = functools.partial(reference, program=program, function_of=in_pieces)
    return _of_batch(function, jax.vmap, values, program, rank)


def _of_batch(function, batched, values, program, rank):
    axes = [None if i in program.shared else 0 for i in range(len(values))]
    for _ in range(rank):
        function = batched(function, axes)
    return function(*values)


def _row_by_row(function, axes):
    # XLA would fuse what a long function works out into every place that reads it, over whole
    # arrays, and compile without end.
    def by_row(*values):
        def one(row):
            own = iter(row)
            pairs = zip(values, axes, strict=True)
            return function(*(v if axis is None else next(own) for v, axis in pairs))

        return jax.lax.map(one, [v for v, a in zip(values, axes, strict=True) if a is not None])

    return by_row


@loop_p.def_impl
def _run(*values, program, rank):
    return jax.jit(functools.partial(loop_p.bind, program=program, rank=rank))(*values)


@loop_p.def_abstract_eval
def _shapes(*avals, program, rank):
    state = avals[program.condition_constants + program.body_constants :]
    lead = avals[-1].shape[:rank]
    return [
        *(jax.core.ShapedArray(a.shape, a.dtype) for a in state),
        *(
            jax.core.ShapedArray((*lead, table.height, *a.shape), a.dtype)
            for table, a in zip(program.tables, row_of(program), strict=True)
        ),
    ]


def _batch(values, dims, *, program, rank):
    bundle = bundled(program, values, dims, rank)
    if bundle is not None:
        return loop_p.bind(*bundle.values, program=bundle.program, rank=rank), bundle.axes
    # The new axis stands behind those before it: what a function asks for within itself, such as
    # runs in other steps, takes more or fewer turns, and lanes wait for each other.
    size = next(v.shape[d] for v, d in zip(values, dims, strict=True) if d is not None)
    # A long array that is the same for all samples is read where it is.
    fixed = len(values) - len(avals_of(program)[1])
    alike = {i for i, long in enumerate(in_memory(program)[:fixed]) if long and dims[i] is None}
    alike -= {program.condition_constants + i for i in program.tangents}
    shared = frozenset(alike & program.shared if rank else alike)
    lead = list(np.shape(values[-1]))
    if dims[-1] is not None:
        del lead[dims[-1]]

    def moved(i, value, dim):
        if i in shared:
            return value
        known = rank if i not in program.shared else 0
        if dim is None:
            value, dim = jnp.broadcast_to(value, (size, *jnp.shape(value))), 0
        inside = jnp.moveaxis(value, dim, known)
        if known == rank:
            return inside
        return jnp.broadcast_to(inside, (*lead[:rank], *inside.shape))

    given = [moved(i, *pair) for i, pair in enumerate(zip(values, dims, strict=True))]
    out = loop_p.bind(*given, program=program._replace(shared=shared), rank=rank + 1)
    return out, [rank] * len(out)


batching.primitive_batchers[loop_p] = _batch


def _native(*values, program, rank, number):
    """Through the kernel of this number."""
    _, state = avals_of(program)
    batch = values[-1].shape[:rank]
    kept = in_memory(program)
    rows = [
        jnp.reshape(v.astype(float), (*batch, -1))
        for v, k in zip(values, kept, strict=True)
        if not k
    ]
    big = [v for v, k in zip(values, kept, strict=True) if k]
    short, long = packed_state(program), changing(program)
    shapes = [jax.ShapeDtypeStruct((*batch, floats_in(short)), jnp.float64)]
    shapes += [jax.ShapeDtypeStruct((*batch, *aval.shape), jnp.float64) for aval in long]
    row = row_of(program)
    for table, aval in zip(program.tables, row, strict=True):
        shape = (*batch, table.height, *aval.shape)
        shapes.append(jax.ShapeDtypeStruct(shape, jnp.float64))
    call = jax.ffi.ffi_call(dispatch.TARGET, shapes)
    packed, *arrays = call(jnp.concatenate(rows, -1), *big, kernel=np.int64(number))
    found, own = iter(_unpacked(packed, short)), iter(arrays)
    last = [next(own if i in program.long else found) for i in range(len(state))]
    return [*last, *(_typed(each, aval.dtype) for each, aval in zip(own, row, strict=True))]


def _unpacked(packed: Any, avals: Sequence[Any]) -> list:
    """Arrays of these shapes and types, behind the leading axes, from rows of floats."""
    out, position, lead = [], 0, packed.shape[:-1]
    for aval in avals:
        size = int(np.prod(aval.shape))
        part = packed[..., position : position + size].reshape(lead + aval.shape)
        out.append(_typed(part, aval.dtype))
        position += size
    return out


def _typed(floats: Any, kind: Any) -> Any:
    return (floats != 0) if np.dtype(kind) == np.bool_ else floats.astype(kind)


def _by_portions(*values, program, rank, samples):
    def run(given, narrower, rank):
        own = narrower._replace(shared=program.shared)
        return loop_p.bind(*given, program=own, rank=rank)

    size = side_by_side(program.narrow, samples)
    return by_portions(values, program, rank, size, run)


def _lower_elsewhere(ctx, *values, program, rank, reason=NOT_A_CPU):
    if not program.length:
        tell(ctx, reason)
    written = reference_in_pieces if reason is NOT_A_CPU else reference_of_batch
    lower = mlir.lower_fun(written, multiple_results=True)
    return lower(ctx, *values, program=program, rank=rank)


def _switched_off() -> bool:
    return os.environ.get("JAXCLEAR_PLAIN_LOOPS", "0") not in ("", "0")


def has_kernels() -> bool:
    """Whether loops become kernels here at all: on a CPU, unless they are switched off."""
    return jax.default_backend() == "cpu" and not _switched_off()


def _lower_on_cpu(ctx, *values, program, rank):
    if _switched_off():
        return _lower_elsewhere(ctx, *values, program=program, rank=rank, reason=SWITCHED_OFF)
    samples = int(np.prod(ctx.avals_in[-1].shape[:rank]))
    if (
        program.narrow is not None
        and side_by_side(program.narrow, samples) < program.narrow.tangents
    ):
        lower = mlir.lower_fun(_by_portions, multiple_results=True)
        return lower(ctx, *values, program=program, rank=rank, samples=samples)
    try:
        kernel = kernels.build(program, widest() if samples > 1 else 1)
        kernels.keep(kernel, ctx.module_context)
        lower = mlir.lower_fun(_native, multiple_results=True)
        out = lower(ctx, *values, program=program, rank=rank, number=kernel.number)
        tell(ctx, None)
        return out
    except (Unsupported, ImportError) as missing:
        reason = f"there is no machine code for {missing}"
    except Exception as failure:
        # The fast path must not cost a run: say so, and let XLA compile the loop.
        reason = f"the kernel could not be written: {failure!r}"
    if not program.once and not program.length:
        left_to_xla(reason)
        _warn_once(reason)
    return _lower_elsewhere(ctx, *values, program=program, rank=rank, reason=reason)


def _warn_once(reason: str) -> None:
    """A loop takes ten times as long as need be: said once for each reason in a process."""
    LOG.info("A loop is left to XLA: %s.", reason)
    if reason in _WARNED:
        return
    _WARNED.add(reason)
    warn(
        f"jaxclear runs a time loop through XLA, which takes some ten times as long to run and "
        f"longer to compile: {reason}.",
        RuntimeWarning,
    )


mlir.register_lowering(loop_p, _lower_elsewhere)
mlir.register_lowering(loop_p, _lower_on_cpu, platform="cpu")
