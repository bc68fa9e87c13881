"""How programs are traced: like pieces once, and mapped over, however they are named.

Two calls are alike when the trees of their arguments have the same shape, static fields and
structural zeros. A group of alike calls becomes one `vmap`; small groups are unrolled, because a
few fused scalars are cheaper than a short axis. What several programs of a run ask for, or one
program at several places, is traced at the first of them (`share_trace`, `by_form`).
"""

import functools
import gc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxclear.ground.grouping import LARGEST_UNROLLED, stacked, unstacked
from jaxclear.ground.quantity import is_traced


@contextmanager
def uncollected() -> Iterator[None]:
    """Within it Python does not look for cycles of garbage. Tracing makes objects by the million,
    most of which stay for as long as it lasts: going through them again and again is an eighth of a
    first run. Where two threads are within it, it ends with the one that came first."""
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


# From this many alike pieces on, one mapped trace beats repeated ones in compile time.
SMALLEST_GROUP = 4
# Kinds of calls that are kept of a function that is traced once.
LATEST = 64
# Stands for a leaf that may vary.
VARYING = object()


def signature(tree: Any) -> tuple:
    """Hashable description of a tree: structure, structural integers, functions, and shapes and
    types of arrays.
    """
    leaves, structure = jax.tree.flatten(tree)
    kinds = tuple(
        leaf if _is_structure(leaf) else (jnp.shape(leaf), str(jnp.result_type(leaf)))
        for leaf in leaves
    )
    return structure, kinds


def _is_structure(leaf: Any) -> bool:
    """What stands in a program as it is, and cannot vary within a group."""
    return isinstance(leaf, int) or callable(leaf)


def map_grouped(function: Callable, calls: Sequence[tuple], smallest: int = SMALLEST_GROUP) -> list:
    """[function(*arguments) for arguments in calls], with alike calls mapped together.

    Args:
        function: pure; its result may hold structural integers that do not depend on array values.
        calls: arguments of each call; those of equal structure and shapes are alike.
        smallest: smallest number of alike calls that are mapped.
    """
    groups: dict[tuple, list[int]] = {}
    for index, arguments in enumerate(calls):
        groups.setdefault(signature(arguments), []).append(index)
    results: list = [None] * len(calls)
    for members in groups.values():
        if len(members) < smallest:
            for index in members:
                results[index] = function(*calls[index])
        else:
            for index, result in zip(
                members, _map_calls(function, [calls[index] for index in members]), strict=True
            ):
                results[index] = result
    return results


def map_many(function: Callable, calls: Sequence[tuple]) -> list:
    """As `map_grouped`; few alike calls are written out: what is not worth a map."""
    return map_grouped(function, calls, LARGEST_UNROLLED)


def _map_calls(function, calls):
    leaves, structure = jax.tree.flatten(calls[0])
    varying = [position for position, leaf in enumerate(leaves) if not _is_structure(leaf)]
    all_leaves = [jax.tree.leaves(call) for call in calls]
    many = len(calls) >= LARGEST_UNROLLED and is_traced(all_leaves)
    least = LARGEST_UNROLLED if many else len(calls) + 1
    columns = []
    for position in list(varying):
        column = [each[position] for each in all_leaves]
        if many and all(x is column[0] for x in column):
            # The same for all: the loop reads it from outside.
            varying.remove(position)
        else:
            columns.append(stacked(column, least))
    if not columns:
        yield from [function(*calls[0])] * len(calls)
        return
    if not varying and not many:
        yield from (function(*call) for call in calls)
        return
    template: dict[str, Any] = {}

    def one(arrays):
        filled = list(leaves)
        for position, array in zip(varying, arrays, strict=True):
            filled[position] = array
        out_leaves, template["structure"] = jax.tree.flatten(
            function(*jax.tree.unflatten(structure, filled))
        )
        template["leaves"] = [leaf if isinstance(leaf, int) else None for leaf in out_leaves]
        return [leaf for leaf in out_leaves if not isinstance(leaf, int)]

    if many:
        mapped = jax.lax.scan(lambda _, row: (None, one(row)), None, columns)[1]
    else:
        mapped = jax.vmap(one)(columns)
    entries = [unstacked(array, least) for array in mapped]
    for row in zip(*entries, strict=True) if entries else [()] * len(calls):
        arrays = iter(row)
        filled = [next(arrays) if leaf is None else leaf for leaf in template["leaves"]]
        yield jax.tree.unflatten(template["structure"], filled)


def share_trace(function: Callable) -> Callable:
    """The function, traced once for all calls that are alike, in whatever program they are.

    It must be pure, and close over no numbers; its result may contain structural integers, which
    must not depend on array values. A call with a function among its arguments, which may close
    over anything, is traced by itself.
    """

    @functools.lru_cache(maxsize=LATEST)
    def compile_for(structure, kinds):
        form: list = []

        @jax.jit
        def one(arrays):
            arrays = iter(arrays)
            leaves = [next(arrays) if kind is VARYING else kind[1] for kind in kinds]
            out, out_structure = jax.tree.flatten(function(*jax.tree.unflatten(structure, leaves)))
            form[:] = out_structure, [leaf if isinstance(leaf, int) else VARYING for leaf in out]
            return [leaf for leaf in out if not isinstance(leaf, int)]

        return one, form

    @functools.wraps(function)
    def call(*arguments):
        leaves, structure = jax.tree.flatten(arguments)
        if any(callable(leaf) for leaf in leaves) or not is_traced(leaves):
            return function(*arguments)
        # True is 1, but not alike.
        kinds = tuple((type(x), x) if isinstance(x, int) else VARYING for x in leaves)
        one, form = compile_for(structure, kinds)
        outputs = iter(one([leaf for leaf in leaves if not isinstance(leaf, int)]))
        out_structure, out = form
        return jax.tree.unflatten(
            out_structure, [next(outputs) if x is VARYING else x for x in out]
        )

    return call


def by_form(function: Callable) -> Callable:
    """The function, asked once for all calls that are alike: what it says must hang on the form of
    its arguments alone. It is shown no numbers, so JAX compiles none of its operations."""

    @functools.lru_cache(maxsize=LATEST)
    def evaluate_form(structure, kinds):
        results: list = []
        varying = [kind for marker, kind in kinds if marker is VARYING]

        def record_result(arrays):
            arrays = iter(arrays)
            leaves = [next(arrays) if marker is VARYING else kind for marker, kind in kinds]
            results.append(function(*jax.tree.unflatten(structure, leaves)))

        jax.eval_shape(record_result, [jax.ShapeDtypeStruct(*kind) for kind in varying])
        return results[0]

    @functools.wraps(function)
    def call(*arguments):
        leaves, structure = jax.tree.flatten(arguments)
        numbers = map(eqx.is_array, leaves)
        kinds = tuple(
            (VARYING, (x.shape, x.dtype)) if number else (type(x), x)
            for x, number in zip(leaves, numbers, strict=True)
        )
        if any(callable(leaf) for leaf in leaves):
            return evaluate_form.__wrapped__(structure, kinds)
        return evaluate_form(structure, kinds)

    return call
