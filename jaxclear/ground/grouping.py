"""Numbers of many pieces as few arrays: taken out of an array one by one, and put together again.

Equations of motion are written number by number (`sparse`), which costs a program in proportion to
its pieces. Where an entry was taken from is remembered, so that many entries put together again are
one look into that array, or the array itself; what is done to alike pieces (`map_grouped`) then
goes from array to array. Of few numbers nothing is remembered, and programs are what they
were.
"""

import weakref
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

# From so many numbers on entries remember where they were taken from.
MANY = 65
# From so many alike pieces on a map over them stays a loop, in machine code too.
# Of chains of 16 loose joints the loop makes a step of ImplicitStep 4.2 us (5.4 written out), one
# of FixedStep 4.4 us (3.8), and compiling a fifth shorter.
LARGEST_UNROLLED = 12


class _Origin(NamedTuple):
    """An entry of an array, and the number that it is."""

    number: weakref.ref
    array: jax.Array
    place: int


# By the identity of numbers, for as long as they live.
_ORIGINS: dict[int, _Origin] = {}


def unstacked(array: jax.Array, least: int = MANY) -> list[jax.Array]:
    """The entries of an array along its first axis; of `least` and more it is remembered where
    they were taken from."""
    count = len(array)
    if count < least or not isinstance(array, jax.core.Tracer):
        return [array[i] for i in range(count)]
    entries = jnp.unstack(array)
    for index, entry in enumerate(entries):
        key = id(entry)
        forget = lambda _, key=key: _ORIGINS.pop(key, None)
        _ORIGINS[key] = _Origin(weakref.ref(entry, forget), array, index)
    return list(entries)


def _array_of_origin(number: Any) -> _Origin | None:
    origin = _ORIGINS.get(id(number))
    return origin if origin is not None and origin.number() is number else None


def stacked(numbers: Sequence[Any], least: int = MANY) -> jax.Array:
    """Arrays of one shape on a new first axis; `least` and more of them are looked up in the arrays
    from which they were taken."""
    if len(numbers) < least:
        return jnp.stack(numbers)
    origins = [_array_of_origin(each) for each in numbers]
    sources: list[Any] = []
    lengths = [0]
    starts: dict[int, int] = {}
    for o in origins:
        if o is not None and id(o.array) not in starts:
            starts[id(o.array)] = lengths[-1]
            sources.append(o.array)
            lengths.append(lengths[-1] + len(o.array))
    alone = [each for each, o in zip(numbers, origins, strict=True) if o is None]
    if 4 * (len(sources) + len(alone)) > len(numbers) or any(
        x.dtype != sources[0].dtype for x in sources
    ):
        return jnp.stack(numbers)
    if alone:
        sources.append(jnp.stack([jnp.asarray(x, sources[0].dtype) for x in alone]))
    joined = sources[0] if len(sources) == 1 else jnp.concatenate(sources)
    further = iter(range(lengths[-1], lengths[-1] + len(alone)))
    places = [next(further) if o is None else starts[id(o.array)] + o.place for o in origins]
    return looked_up(joined, np.array(places))


def looked_up(array: jax.Array, places: np.ndarray) -> jax.Array:
    """The entries of an array at known places."""
    steps = np.unique(np.diff(places))
    if len(steps) == 1 and steps[0] > 0:
        first, last, step = int(places[0]), int(places[-1]), int(steps[0])
        if (first, last, step) == (0, len(array) - 1, 1):
            return array
        return lax.slice_in_dim(array, first, last + 1, step)
    numbers = lax.GatherDimensionNumbers(
        offset_dims=tuple(range(1, array.ndim)), collapsed_slice_dims=(0,), start_index_map=(0,)
    )
    return lax.gather(
        array,
        places[:, None].astype(np.int32),
        numbers,
        (1, *array.shape[1:]),
        mode=lax.GatherScatterMode.PROMISE_IN_BOUNDS,
    )


def summed(terms: jax.Array, places: np.ndarray, count: int) -> jax.Array:
    """Sums of terms by index, shape (count,).

    Args:
        terms: shape (n,).
        places: index of the sum to which each term goes, shape (n,).
        count: number of sums.
    """
    numbers = lax.ScatterDimensionNumbers(
        (), inserted_window_dims=(0,), scatter_dims_to_operand_dims=(0,)
    )
    return lax.scatter_add(
        jnp.zeros(count),
        places[:, None].astype(np.int32),
        terms,
        numbers,
        mode=lax.GatherScatterMode.PROMISE_IN_BOUNDS,
    )


in_memory_p = Primitive("jaxclear_in_memory")


def in_memory(array: jax.Array) -> jax.Array:
    """An array that in a kernel stands in memory: what is done to it is a loop there."""
    return in_memory_p.bind(array)


in_memory_p.def_impl(lambda array: array)
in_memory_p.def_abstract_eval(lambda array: array)
ad.deflinear2(in_memory_p, lambda cotangent, _: [cotangent])
batching.defvectorized(in_memory_p)
mlir.register_lowering(in_memory_p, lambda _, array: [array])


class _Packed(eqx.Module):
    """What is no single number of a tree, and its single numbers as one array."""

    others: list[Any]
    numbers: jax.Array


class _Rest(eqx.Module):
    """What is needed to take a packed tree apart."""

    rest: Any
    structure: Any = eqx.field(static=True)
    single: tuple[int, ...] = eqx.field(static=True)


def has_large_group(tree: Any) -> bool:
    """Whether a container of the tree holds so many alike pieces that a map over them is a loop."""
    level = jax.tree_util.default_registry.flatten_one_level(tree)
    pieces = [] if level is None else list(level[0])
    kinds = Counter(
        jax.tree.structure(each) for each in pieces if not jax.tree_util.all_leaves([each])
    )
    return max(kinds.values(), default=0) >= LARGEST_UNROLLED or any(map(has_large_group, pieces))


def packed(tree: Any) -> tuple[Any, Any]:
    """As `equinox.partition(tree, equinox.is_array)`; of a tree with many alike pieces the single
    numbers become one array. One number that moves then moves them all, in batches and in
    derivatives: what has few pieces keeps its numbers apart."""
    arrays, rest = eqx.partition(tree, eqx.is_array)
    if not has_large_group(arrays):
        return arrays, rest
    leaves, structure = jax.tree.flatten(arrays)
    single = tuple(i for i, x in enumerate(leaves) if jnp.shape(x) == () and x.dtype == jnp.float64)
    if len(single) < MANY or not any(isinstance(x, jax.core.Tracer) for x in leaves):
        return arrays, rest
    others = [x for i, x in enumerate(leaves) if i not in set(single)]
    return _Packed(others, stacked([leaves[i] for i in single])), _Rest(rest, structure, single)


def unpacked(arrays: Any, rest: Any) -> Any:
    """The inverse of `packed`, with its arrays, or others of their shapes."""
    if not isinstance(rest, _Rest):
        return eqx.combine(arrays, rest)
    numbers = iter(unstacked(arrays.numbers))
    others, single = iter(arrays.others), set(rest.single)
    count = len(arrays.others) + len(single)
    leaves = [next(numbers) if i in single else next(others) for i in range(count)]
    return eqx.combine(jax.tree.unflatten(rest.structure, leaves), rest.rest)


def bare(rest: Any) -> Any:
    """The tree of which something is the rest, without its arrays."""
    return rest.rest if isinstance(rest, _Rest) else rest
