"""The product of a derivative's columns with tangents: linear in these, forwards and backwards. A
column that is not asked for may have overflowed."""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

applied_p = Primitive("jaxclear_applied_columns")
applied_p.multiple_results = True


class Map(NamedTuple):
    """One `jax.vmap`: its size, and the axis of each value and of each tangent (None: the same for
    all)."""

    size: int
    values: tuple[int | None, ...]
    tangents: tuple[int | None, ...]


def the_same(axes: Sequence[int | None]) -> bool:
    """Whether what has these axes is the same for all."""
    return all(axis is None for axis in axes)


def _product(*numbers: Any, columns: int, maps: tuple[Map, ...]) -> list:
    """Columns times tangents."""

    def one(matrices, tangents):
        way = jnp.concatenate([jnp.ravel(each) for each in tangents])
        shaped = lambda m: way.reshape(-1, *[1] * (m.ndim - 1))
        return [jnp.sum(_heard(m, shaped(m)), axis=0) for m in matrices]

    for own in maps:
        one = jax.vmap(one, (list(own.values), list(own.tangents)))
    return one(list(numbers[:columns]), list(numbers[columns:]))


def _heard(said: Any, asked: Any) -> Any:
    """Their product, where what is not asked for may have overflowed: inf * 0 is 0 here. A finite
    one stays, for its product has a slope where what is asked passes through 0."""
    return jnp.where((asked == 0) & ~jnp.isfinite(said), 0.0, said) * asked


@applied_p.def_impl
def _apply(*numbers, **params):
    return jax.jit(functools.partial(_product, **params))(*numbers)


@applied_p.def_abstract_eval
def _shapes_applied(*avals, **params):
    given = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in avals]
    found = jax.eval_shape(functools.partial(_product, **params), *given)
    return [jax.core.ShapedArray(each.shape, each.dtype) for each in found]


def _batch_applied(numbers, dims, *, columns, maps):
    size = next(x.shape[d] for x, d in zip(numbers, dims, strict=True) if d is not None)
    own = Map(size, tuple(dims[:columns]), tuple(dims[columns:]))
    out = applied_p.bind(*numbers, columns=columns, maps=(*maps, own))
    return out, [0] * len(out)


def _differentiate_applied(numbers, tangents, **params):
    product = functools.partial(_product, **params)
    return jax.jvp(product, list(numbers), list(map(ad.instantiate_zeros, tangents)))


def _backwards(cotangents, *numbers, columns, maps):
    """What the results' cotangents make of the tangents'."""
    heeded = [i for i, each in enumerate(cotangents) if not isinstance(each, ad.Zero)]
    ways = numbers[columns:]
    avals = [way.aval if ad.is_undefined_primal(way) else jax.typeof(way) for way in ways]
    shapes = [list(aval.shape) for aval in avals]
    for own in reversed(maps):
        for shape, axis in zip(shapes, own.tangents, strict=True):
            if axis is not None:
                del shape[axis]
    splits = np.cumsum([math.prod(shape) for shape in shapes])[:-1]

    def one(matrices, asked):
        heard = [_heard(m, a[None]) for m, a in zip(matrices, asked, strict=True)]
        total = sum(jnp.sum(each.reshape(each.shape[0], -1), axis=1) for each in heard)
        return [p.reshape(s) for p, s in zip(jnp.split(total, splits), shapes, strict=True)]

    for own in maps:
        axes = [own.values[i] for i in heeded]
        one = _gathered(jax.vmap(one, (axes, 0)), own.tangents)
    if not heeded:
        return [None] * len(numbers)
    found = one([numbers[i] for i in heeded], [cotangents[i] for i in heeded])
    unknown = map(ad.is_undefined_primal, ways)
    return [None] * columns + [f if u else None for f, u in zip(found, unknown, strict=True)]


def _gathered(mapped: Callable, axes: Sequence[int | None]) -> Callable:
    """What a map gives backwards: a tangent that is the same for all hears the sum."""

    def function(*numbers):
        pairs = zip(mapped(*numbers), axes, strict=True)
        return [jnp.sum(f, 0) if a is None else jnp.moveaxis(f, 0, a) for f, a in pairs]

    return function


batching.primitive_batchers[applied_p] = _batch_applied
mlir.register_lowering(applied_p, mlir.lower_fun(_product, multiple_results=True))
ad.primitive_jvps[applied_p] = _differentiate_applied
ad.primitive_transposes[applied_p] = _backwards
