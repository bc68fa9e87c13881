"""A while loop over a few numbers that runs at the speed of compiled C: `while_loop`, in the place
of `jax.lax.while_loop`.

On a CPU the loop becomes one kernel of machine code (`kernel`), several samples of a batch side by
side, each ending by itself. Elsewhere, where a part of the program has no rule, and for
derivatives, it is JAX's own loop. JAXCLEAR_PLAIN_LOOPS=1 switches the kernel off.
"""

import functools
import logging
import os
import warnings
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

from jaxclear.native import dispatch
from jaxclear.native import kernel as kernels
from jaxclear.native.control import CALLS
from jaxclear.native.machine import widest
from jaxclear.native.program import Program, avals_of, floats_in, in_memory
from jaxclear.native.verdicts import NOT_A_CPU, SWITCHED_OFF, tell
from jaxclear.native.writer import LONGEST_IN_REGISTERS, Unsupported

LOG = logging.getLogger(__name__)
loop_p = Primitive("jaxclear_loop")
loop_p.multiple_results = True
# Reasons that have been told.
_WARNED: set[str] = set()


def while_loop(condition: Callable[[Any], Any], body: Callable[[Any], Any], first: Any) -> Any:
    """As `jax.lax.while_loop`, for a state of few numbers; forward-mode differentiable, maps over
    batches.
    """
    return _loop(condition, body, first, False)


def once(function: Callable, *numbers: Any) -> Any:
    """A function of few numbers as a kernel: a loop of one turn. Differentiable as the function is;
    where there is no kernel, samples of a batch are gone through one after the other.
    """
    traced = jax.jit(function)
    shapes = jax.eval_shape(traced, *numbers)
    nothing = jax.tree.map(lambda each: jnp.zeros(each.shape, each.dtype), shapes)
    turn = lambda carry: (carry[0] + 1, traced(*numbers))
    return _loop(lambda carry: carry[0] < 1, turn, (jnp.zeros((), int), nothing), True)[1]


def _loop(condition: Callable, body: Callable, first: Any, once: bool) -> Any:
    first = jax.tree.map(jnp.asarray, first)
    leaves, structure = jax.tree.flatten(first)
    tests, fixed_tests = _open(jax.make_jaxpr(condition)(first))
    turns, fixed_turns = _open(jax.make_jaxpr(body)(first))
    if [(a.shape, a.dtype) for a in turns.out_avals] != [(v.shape, v.dtype) for v in leaves]:
        raise TypeError(
            f"the body of a loop must keep shapes and types: {leaves} became {turns.out_avals}."
        )
    program = Program(tests, turns, len(fixed_tests), len(fixed_turns), once)
    out = loop_p.bind(*fixed_tests, *fixed_turns, *leaves, program=program, rank=0)
    return jax.tree.unflatten(structure, out)


def with_fast_loops(function: Callable) -> Callable:
    """The function, its outermost `jax.lax.while_loop`s run as by `while_loop`: for the loops that
    a library writes.
    """

    def wrapped(*arguments):
        leaves, structure = jax.tree.flatten(arguments)
        kept: dict[str, Any] = {}

        def flat(*values):
            out, kept["structure"] = jax.tree.flatten(
                function(*jax.tree.unflatten(structure, values))
            )
            return out

        found = jax.make_jaxpr(flat)(*leaves)
        program = ClosedJaxpr(
            found.jaxpr.replace(constvars=[], invars=[*found.jaxpr.constvars, *found.jaxpr.invars]),
            [],
        )
        fast = jax.custom_jvp(lambda *values: _replay(program, values))
        fast.defjvp(lambda values, tangents: jax.jvp(jaxpr_as_fun(program), values, tangents))
        return jax.tree.unflatten(kept["structure"], fast(*found.consts, *leaves))

    return wrapped


def _replay(program: ClosedJaxpr, arguments: list) -> list:
    jaxpr = program.jaxpr
    values = dict(
        zip([*jaxpr.constvars, *jaxpr.invars], [*program.consts, *arguments], strict=True)
    )

    def get(atom):
        return jnp.asarray(atom.val, atom.aval.dtype) if isinstance(atom, Literal) else values[atom]

    for equation in jaxpr.eqns:
        inputs, p = [get(atom) for atom in equation.invars], equation.params
        if equation.primitive.name == "while":
            counts = p["cond_nconsts"], p["body_nconsts"]
            out = loop_p.bind(
                *inputs, program=Program(p["cond_jaxpr"], p["body_jaxpr"], *counts), rank=0
            )
        elif equation.primitive.name in CALLS:
            inner = next(p[k] for k in ("jaxpr", "call_jaxpr", "fun_jaxpr") if k in p)
            out = _replay(
                inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, []), inputs
            )
        else:
            out = equation.primitive.bind(*inputs, **p)
            out = out if equation.primitive.multiple_results else [out]
        values |= dict(zip(equation.outvars, out, strict=True))
    return [get(atom) for atom in jaxpr.outvars]


def _open(program: ClosedJaxpr) -> tuple[ClosedJaxpr, list]:
    """Constants that are not yet known as leading arguments, and these; known numbers stay
    inside."""
    pairs = list(zip(program.jaxpr.constvars, program.consts, strict=True))
    known = [
        p
        for p in pairs
        if not isinstance(p[1], jax.core.Tracer) and np.size(p[1]) <= LONGEST_IN_REGISTERS
    ]
    others = [p for p in pairs if not any(p[0] is k[0] for k in known)]
    jaxpr = program.jaxpr.replace(
        constvars=[k[0] for k in known], invars=[*[o[0] for o in others], *program.jaxpr.invars]
    )
    return ClosedJaxpr(jaxpr, [k[1] for k in known]), [o[1] for o in others]


def reference(*values: Any, program: Program) -> list:
    """The same by `jax.lax.while_loop`, or by the body alone where it takes one turn."""
    c, b = program.condition_constants, program.body_constants
    tests, turns = jaxpr_as_fun(program.condition), jaxpr_as_fun(program.body)
    fixed_condition, fixed_body, first = values[:c], values[c : c + b], list(values[c + b :])
    if program.once:
        return list(turns(*fixed_body, *first))
    return list(
        jax.lax.while_loop(
            lambda s: tests(*fixed_condition, *s)[0], lambda s: list(turns(*fixed_body, *s)), first
        )
    )


def _batched_reference(*values, program, rank):
    function = functools.partial(reference, program=program)
    for _ in range(rank):
        function = _row_by_row(function) if program.once else jax.vmap(function)
    return function(*values)


def _row_by_row(function):
    # XLA would fuse what a long function works out into every place that reads it, over whole
    # arrays, and compile without end.
    return lambda *values: jax.lax.map(lambda row: function(*row), values)


@loop_p.def_impl
def _run(*values, program, rank):
    return jax.jit(functools.partial(loop_p.bind, program=program, rank=rank))(*values)


@loop_p.def_abstract_eval
def _shapes(*avals, program, rank):
    state = avals[program.condition_constants + program.body_constants :]
    return [jax.core.ShapedArray(a.shape, a.dtype) for a in state]


def _batch(values, dims, *, program, rank):
    size = next(v.shape[d] for v, d in zip(values, dims, strict=True) if d is not None)
    moved = [
        jnp.broadcast_to(v, (size, *jnp.shape(v))) if d is None else jnp.moveaxis(v, d, 0)
        for v, d in zip(values, dims, strict=True)
    ]
    out = loop_p.bind(*moved, program=program, rank=rank + 1)
    return out, [0] * len(out)


def _differentiate(values, tangents, *, program, rank):
    moving = [i for i, t in enumerate(tangents) if not isinstance(t, ad.Zero)]

    def of_moving(*some):
        filled = list(values)
        for i, value in zip(moving, some, strict=True):
            filled[i] = value
        return _batched_reference(*filled, program=program, rank=rank)

    return jax.jvp(of_moving, [values[i] for i in moving], [tangents[i] for i in moving])


batching.primitive_batchers[loop_p] = _batch
ad.primitive_jvps[loop_p] = _differentiate


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
    height = floats_in(state)
    shape = jax.ShapeDtypeStruct((*batch, height), jnp.float64)
    call = jax.ffi.ffi_call(dispatch.TARGET, shape)
    packed = call(jnp.concatenate(rows, -1), *big, kernel=np.int64(number))
    out, position = [], 0
    for aval in state:
        size = int(np.prod(aval.shape))
        part = packed[..., position : position + size].reshape(batch + aval.shape)
        out.append((part != 0) if aval.dtype == bool else part.astype(aval.dtype))
        position += size
    return out


def _lower_elsewhere(ctx, *values, program, rank, reason=NOT_A_CPU):
    tell(ctx, reason)
    lower = mlir.lower_fun(_batched_reference, multiple_results=True)
    return lower(ctx, *values, program=program, rank=rank)


def _lower_on_cpu(ctx, *values, program, rank):
    if os.environ.get("JAXCLEAR_PLAIN_LOOPS", "0") not in ("", "0"):
        return _lower_elsewhere(ctx, *values, program=program, rank=rank, reason=SWITCHED_OFF)
    try:
        batch = ctx.avals_in[-1].shape[:rank]
        kernel = kernels.build(program, widest() if int(np.prod(batch)) > 1 else 1)
        # The compiled program keeps it.
        ctx.module_context.add_keepalive(kernel)
        lower = mlir.lower_fun(_native, multiple_results=True)
        out = lower(ctx, *values, program=program, rank=rank, number=kernel.number)
        tell(ctx, None)
        return out
    except (Unsupported, ImportError) as missing:
        reason = f"there is no machine code for {missing}"
    except Exception as failure:
        # The fast path must not cost a run: say so, and let XLA compile the loop.
        reason = f"the kernel could not be written: {failure!r}"
    if not program.once:
        _warn_once(reason)
    return _lower_elsewhere(ctx, *values, program=program, rank=rank, reason=reason)


def _warn_once(reason: str) -> None:
    """A loop takes ten times as long as need be: said once for each reason in a process."""
    LOG.info("A loop is left to XLA: %s.", reason)
    if reason in _WARNED:
        return
    _WARNED.add(reason)
    warnings.warn(
        f"jaxclear runs a time loop through XLA, which takes some ten times as long to run and "
        f"longer to compile: {reason}.",
        RuntimeWarning,
        2,
    )


mlir.register_lowering(loop_p, _lower_elsewhere)
mlir.register_lowering(loop_p, _lower_on_cpu, platform="cpu")
