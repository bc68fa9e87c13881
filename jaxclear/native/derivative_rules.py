"""Custom derivative rules: a function whose derivative backwards is made of derivatives forwards,
of a column for each number that moves; numbers that are not differentiated backwards.

Of a long run that few numbers enter this is the cheap way backwards: no states are kept, columns
share the motion, and what has no way backwards needs none. Forwards it is the function itself. The
product of columns with tangents is linear in these, forwards and backwards.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir
from jax.interpreters import partial_eval as pe

from jaxclear.native.dead_code import drop_by, without_results, without_the_unasked
from jaxclear.native.program import constants_first, fix_arguments, heard, samples_in, still

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


def _apply_columns(*numbers: Any, columns: int, maps: tuple[Map, ...]) -> list:
    """Columns times tangents."""

    def one(matrices, tangents):
        flat_tangent = jnp.concatenate([jnp.ravel(each) for each in tangents])
        shaped = lambda m: flat_tangent.reshape(-1, *[1] * (m.ndim - 1))
        return [jnp.sum(heard(m, shaped(m)), axis=0) for m in matrices]

    for batch_map in maps:
        one = jax.vmap(one, (list(batch_map.values), list(batch_map.tangents)))
    return one(list(numbers[:columns]), list(numbers[columns:]))


@applied_p.def_impl
def _apply(*numbers, **params):
    return jax.jit(functools.partial(_apply_columns, **params))(*numbers)


@applied_p.def_abstract_eval
def _shapes_applied(*avals, **params):
    shapes = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in avals]
    result_shapes = jax.eval_shape(functools.partial(_apply_columns, **params), *shapes)
    return [jax.core.ShapedArray(each.shape, each.dtype) for each in result_shapes]


def _batch_applied(numbers, dims, *, columns, maps):
    size = samples_in(numbers, dims)
    batch_map = Map(size, tuple(dims[:columns]), tuple(dims[columns:]))
    out = applied_p.bind(*numbers, columns=columns, maps=(*maps, batch_map))
    return out, [0] * len(out)


def _differentiate_applied(numbers, tangents, **params):
    product = functools.partial(_apply_columns, **params)
    return jax.jvp(product, list(numbers), list(map(ad.instantiate_zeros, tangents)))


def _transpose_columns(cotangents, *numbers, columns, maps):
    """What the results' cotangents make of the tangents'."""
    heeded = [i for i, each in enumerate(cotangents) if not isinstance(each, ad.Zero)]
    tangents = numbers[columns:]
    avals = [t.aval if ad.is_undefined_primal(t) else jax.typeof(t) for t in tangents]
    shapes = [list(aval.shape) for aval in avals]
    for batch_map in reversed(maps):
        for shape, axis in zip(shapes, batch_map.tangents, strict=True):
            if axis is not None:
                del shape[axis]
    splits = np.cumsum([math.prod(shape) for shape in shapes])[:-1]

    def one(matrices, cotangents_of_results):
        parts = [heard(m, a[None]) for m, a in zip(matrices, cotangents_of_results, strict=True)]
        total = sum(jnp.sum(each.reshape(each.shape[0], -1), axis=1) for each in parts)
        return [p.reshape(s) for p, s in zip(jnp.split(total, splits), shapes, strict=True)]

    for batch_map in maps:
        axes = [batch_map.values[i] for i in heeded]
        one = _sum_over_map(jax.vmap(one, (axes, 0)), batch_map.tangents)
    if not heeded:
        return [None] * len(numbers)
    products = one([numbers[i] for i in heeded], [cotangents[i] for i in heeded])
    unknown = map(ad.is_undefined_primal, tangents)
    return [None] * columns + [f if u else None for f, u in zip(products, unknown, strict=True)]


def _sum_over_map(mapped: Callable, axes: Sequence[int | None]) -> Callable:
    """What a map gives backwards: a tangent that is the same for all hears the sum."""

    def function(*numbers):
        pairs = zip(mapped(*numbers), axes, strict=True)
        return [jnp.sum(f, 0) if a is None else jnp.moveaxis(f, 0, a) for f, a in pairs]

    return function


batching.primitive_batchers[applied_p] = _batch_applied
mlir.register_lowering(applied_p, mlir.lower_fun(_apply_columns, multiple_results=True))
ad.primitive_jvps[applied_p] = _differentiate_applied
ad.primitive_transposes[applied_p] = _transpose_columns


# Columns that go through the function side by side: more gain little beside the memory that what
# they leave takes.
TOGETHER = 16

columns_p = Primitive("jaxclear_columns")
columns_p.multiple_results = True


def by_columns(function: Callable, *arguments: Any) -> Any:
    """As `function(*arguments)`. Where numbers of the arguments are being traced, a derivative in
    reverse mode by these is made of as many in forward mode as there are such numbers that move."""
    leaves, structure = jax.tree.flatten(arguments)
    places = [i for i, leaf in enumerate(leaves) if isinstance(leaf, jax.core.Tracer)]
    shapes: list[Any] = []

    def of_traced(*numbers):
        given = dict(zip(places, numbers, strict=True))
        values = [given.get(i, leaf) for i, leaf in enumerate(leaves)]
        out, shape = jax.tree.flatten(function(*jax.tree.unflatten(structure, values)))
        traced = [i for i, leaf in enumerate(out) if isinstance(leaf, jax.core.Tracer)]
        shapes.append(
            (shape, traced, [None if i in traced else leaf for i, leaf in enumerate(out)])
        )
        return [out[i] for i in traced]

    numbers = [leaves[i] for i in places]
    program = jax.make_jaxpr(of_traced)(*numbers) if places else None
    if program is None or program.jaxpr.effects:
        return function(*arguments)
    shape, traced, out = shapes[0]
    constants = program.consts
    answers = columns_p.bind(
        *constants, *numbers, program=constants_first(program), moving=(), maps=()
    )
    for place, answer in zip(traced, answers, strict=True):
        out[place] = answer
    return jax.tree.unflatten(shape, out)


def _float_results(program: ClosedJaxpr) -> list[int]:
    """Which results have a derivative."""
    avals = program.out_avals
    return [i for i, aval in enumerate(avals) if np.issubdtype(aval.dtype, np.floating)]


def _push(program: ClosedJaxpr, moving: Sequence[int], values: Any, tangents: Any) -> tuple:
    """(results, tangents of those that have one) of one sample."""
    function = fix_arguments(jaxpr_as_fun(program), values, moving)
    out, moved = jax.jvp(function, [values[i] for i in moving], list(tangents))
    return list(out), [moved[i] for i in _float_results(program)]


def _reference(*numbers: Any, program: ClosedJaxpr, moving: tuple, maps: tuple[Map, ...]) -> list:
    """Results, and behind them the tangents of those that have one, where something moves."""
    count = len(program.in_avals)

    def one(values, tangents):
        if not moving:
            return list(jaxpr_as_fun(program)(*values)), []
        return _push(program, moving, values, tangents)

    for batch_map in maps:
        # None: the same for all tangents, and known to be.
        axis = None if the_same(batch_map.values) else 0
        one = jax.vmap(one, (list(batch_map.values), list(batch_map.tangents)), (axis, 0))
    out, moved = one(list(numbers[:count]), list(numbers[count:]))
    return [*out, *moved]


def _lowered(*numbers: Any, **params: Any) -> list:
    return without_the_unasked(functools.partial(_reference, **params), *numbers)


@columns_p.def_impl
def _run(*numbers, **params):
    return jax.jit(functools.partial(_reference, **params))(*numbers)


@columns_p.def_abstract_eval
def _shapes(*_, program, moving, maps):
    ahead = [m.size for m in reversed(maps) if not the_same(m.values)]
    both = [m.size for m in reversed(maps)]
    avals = program.out_avals
    out = [jax.core.ShapedArray((*ahead, *a.shape), a.dtype) for a in avals]
    moved = [avals[i] for i in _float_results(program)] if moving else []
    return [*out, *(jax.core.ShapedArray((*both, *a.shape), a.dtype) for a in moved)]


def _drop_unread_results(used, equation):
    """The same without results that nobody asks for, nor their tangents."""
    program = equation.params["program"]
    count, floats = len(program.out_avals), _float_results(program)
    mask = list(used[:count])
    for i, is_used in zip(floats, used[count:], strict=False):
        mask[i] = mask[i] or is_used
    if not any(mask):
        return [False] * len(equation.invars), None
    all_used = [*mask, *(mask[i] for i in floats)][: len(used)]
    out = [v for v, flag in zip(equation.outvars, all_used, strict=True) if flag]
    params = equation.params | {"program": without_results(program, mask)}
    return [True] * len(equation.invars), equation.replace(outvars=out, params=params)


def _batch(numbers, dims, *, program, moving, maps):
    size = samples_in(numbers, dims)
    count, results = len(program.in_avals), len(program.out_avals)
    batch_map = Map(size, tuple(dims[:count]), tuple(dims[count:]))
    out = columns_p.bind(*numbers, program=program, moving=moving, maps=(*maps, batch_map))
    axis = None if the_same(batch_map.values) else 0
    return out, [axis] * results + [0] * (len(out) - results)


def _differentiate(values, tangents, *, program, moving, maps):
    moved = tuple(i for i, t in enumerate(tangents) if not isinstance(t, ad.Zero))
    moving_tangents = [tangents[i] for i in moved]
    if moving:
        params = {"program": program, "moving": moving, "maps": maps}
        return _push_second_order(values, moved, moving_tangents, params)
    maps = tuple(m._replace(tangents=tuple(m.values[i] for i in moved)) for m in maps)
    results = columns_p.bind(*values, *moving_tangents, program=program, moving=moved, maps=maps)
    out, slopes = results[: len(program.out_avals)], iter(results[len(program.out_avals) :])
    have = set(_float_results(program))
    return out, [next(slopes) if i in have else still(each) for i, each in enumerate(out)]


def _push_second_order(values, moved, tangents, params):
    """The tangents' own tangents."""
    function = fix_arguments(functools.partial(_reference, **params), values, moved)
    out, slopes = jax.jvp(function, [values[i] for i in moved], tangents)
    pairs = zip(out, slopes, strict=True)
    return out, [s if jnp.issubdtype(o.dtype, jnp.floating) else still(o) for o, s in pairs]


def _columns_of_program(*values: Any, program: ClosedJaxpr, moving: tuple, maps: tuple) -> tuple:
    """(results, for each that has a derivative its columns in front, one for each number that
    moves)."""
    shapes = [program.in_avals[i].shape for i in moving]
    sizes = [math.prod(shape) for shape in shapes]
    count = sum(sizes)
    portions = max(1, -(-count // TOGETHER))
    together = -(-count // portions)
    unit_tangents = np.eye(portions * together, count).reshape(portions, together, count)

    def one(values):
        def push(flat_tangent):
            parts = jnp.split(flat_tangent, np.cumsum(sizes)[:-1])
            tangent_parts = [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]
            return _push(program, moving, values, tangent_parts)

        if count == 0:
            out = jaxpr_as_fun(program)(*values)
            return list(out), [jnp.zeros((0, *out[i].shape)) for i in _float_results(program)]
        side_by_side = jax.vmap(push, out_axes=(None, 0))
        if portions == 1:
            return side_by_side(jnp.asarray(unit_tangents[0]))
        out, columns = jax.lax.map(side_by_side, jnp.asarray(unit_tangents))
        rows = portions * together
        flat = [c.reshape(rows, *c.shape[2:])[:count] for c in columns]
        return [o[0] for o in out], flat

    for batch_map in maps:
        if not the_same(batch_map.values):
            one = jax.vmap(one, (list(batch_map.values),))
    return one(list(values))


def _split_known(trace, *tracers, program, moving, maps):
    """What is linearised about known values: these go through the function once, together with
    the columns; what is left is their product with the tangents."""
    count = len(program.in_avals)
    values, tangents = tracers[:count], tracers[count:]
    all_known = all(each.pval.is_known() for each in values)
    if not all_known or all(each.pval.is_known() for each in tangents):
        params = {"program": program, "moving": moving, "maps": maps}
        return trace.default_process_primitive(columns_p, tracers, params)
    run = functools.partial(_columns_of_program, program=program, moving=moving, maps=maps)
    out, columns = jax.jit(run)(*(each.pval.get_known() for each in values))
    inner_maps = tuple(
        Map(m.size, tuple(None if the_same(m.values) else 0 for _ in columns), m.tangents)
        for m in maps
    )
    traced_inputs = [*map(trace.new_const, columns), *tangents]
    params = {"columns": len(columns), "maps": inner_maps}
    moved = trace.default_process_primitive(applied_p, traced_inputs, params)
    return [*map(trace.new_const, out), *moved]


batching.primitive_batchers[columns_p] = _batch
mlir.register_lowering(columns_p, mlir.lower_fun(_lowered, multiple_results=True))
drop_by(columns_p, _drop_unread_results)
ad.primitive_jvps[columns_p] = _differentiate
pe.custom_partial_eval_rules[columns_p] = _split_known


_forwards_p = Primitive("jaxclear_forwards_only")


def forwards_only(sentence: str, numbers: Any) -> Any:
    """The numbers as they are; a derivative in reverse mode raises `ValueError` with the sentence,
    in the place of what JAX says to a loop that it cannot go through backwards."""
    return jax.tree.map(
        lambda each: (
            _forwards_p.bind(each, sentence=sentence)
            if jnp.issubdtype(jnp.result_type(each), jnp.floating)
            else each
        ),
        numbers,
    )


def _refuse_backwards(_, __, *, sentence):
    raise ValueError(sentence)


def _forwards_only_jvp(primals, tangents, **params):
    (value,), (tangent,) = primals, tangents
    moved = tangent if isinstance(tangent, ad.Zero) else _forwards_p.bind(tangent, **params)
    return _forwards_p.bind(value, **params), moved


_forwards_p.def_impl(lambda value, *, sentence: value)
_forwards_p.def_abstract_eval(lambda aval, *, sentence: aval)
batching.defvectorized(_forwards_p)
mlir.register_lowering(_forwards_p, lambda _, value, *, sentence: [value])
ad.primitive_jvps[_forwards_p] = _forwards_only_jvp
ad.primitive_transposes[_forwards_p] = _refuse_backwards
