"""Functions through whose batches XLA goes sample by sample: what a choice within one costs is then
asked of the samples that make it, not of all. No kernels, and no derivatives in reverse mode. On an
accelerator all samples go side by side: there each operation is started for all of them at once.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

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
        found = in_turn_p.bind(*values, program=_closed(program), motion=None)
        return jax.tree.unflatten(jax.tree.structure(shape), found)

    return wrapped


def _closed(program: ClosedJaxpr) -> ClosedJaxpr:
    """The program, its constants as leading arguments."""
    jaxpr = program.jaxpr
    invars = [*jaxpr.constvars, *jaxpr.invars]
    return ClosedJaxpr(jaxpr.replace(constvars=[], invars=invars), [])


def _run(*values: Any, program: ClosedJaxpr, motion: tuple[int, int] | None) -> list:
    return list(jaxpr_as_fun(program)(*values))


def _differentiate(primals, tangents, *, program, motion):
    floats = [jnp.issubdtype(aval.dtype, jnp.floating) for aval in program.out_avals]
    moving = tuple(i for i, tangent in enumerate(tangents) if not isinstance(tangent, ad.Zero))
    counts = len(primals), len(floats)
    given = [*primals, *(tangents[i] for i in moving)]
    found = in_turn_p.bind(*given, program=_with_tangents(program, moving), motion=counts)
    out, moved = found[: counts[1]], iter(found[counts[1] :])
    still = (ad.Zero(jax.core.ShapedArray(o.shape, o.dtype).to_tangent_aval()) for o in out)
    return out, [
        next(moved) if is_float else zero for is_float, zero in zip(floats, still, strict=True)
    ]


# JAX asks for the derivative of a loop's turn several times.
@functools.lru_cache(maxsize=LATEST)
def _with_tangents(program: ClosedJaxpr, moving: tuple[int, ...]) -> ClosedJaxpr:
    """The program over its inputs and tangents of those that move, to its results and the tangents
    of those that are floats."""
    count = len(program.in_avals)

    def pushed(*given):
        values, ways = given[:count], given[count:]

        def of_moving(*some):
            filled = list(values)
            for i, each in zip(moving, some, strict=True):
                filled[i] = each
            return jaxpr_as_fun(program)(*filled)

        out, moved = jax.jvp(of_moving, [values[i] for i in moving], list(ways))
        pairs = zip(moved, program.out_avals, strict=True)
        return [*out, *(m for m, aval in pairs if jnp.issubdtype(aval.dtype, jnp.floating))]

    avals = [*program.in_avals, *(program.in_avals[i] for i in moving)]
    return _closed(jax.make_jaxpr(pushed)(*(jax.ShapeDtypeStruct(a.shape, a.dtype) for a in avals)))


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
            *values, program=_closed(jax.make_jaxpr(ways)(*values)), motion=motion
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
