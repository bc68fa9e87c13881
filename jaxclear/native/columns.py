"""A function whose derivative backwards is made of derivatives forwards: of a column for each
number that moves.

Of a long run that few numbers enter this is the cheap way backwards: no states are kept, columns
share the motion, and what has no way backwards needs none. Forwards it is the function itself.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir
from jax.interpreters import partial_eval as pe

from jaxclear.native.column_product import Map, applied_p, the_same
from jaxclear.native.unasked import drop_by, without_results, without_the_unasked

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
    kept: list[Any] = []

    def of_traced(*traced):
        given = list(leaves)
        for place, number in zip(places, traced, strict=True):
            given[place] = number
        out, shape = jax.tree.flatten(function(*jax.tree.unflatten(structure, given)))
        found = [i for i, leaf in enumerate(out) if isinstance(leaf, jax.core.Tracer)]
        kept.append((shape, found, [None if i in found else leaf for i, leaf in enumerate(out)]))
        return [out[i] for i in found]

    numbers = [leaves[i] for i in places]
    program = jax.make_jaxpr(of_traced)(*numbers) if places else None
    if program is None or program.jaxpr.effects:
        return function(*arguments)
    shape, found, out = kept[0]
    constants = program.consts
    inside = program.jaxpr
    given = [*inside.constvars, *inside.invars]
    program = ClosedJaxpr(inside.replace(constvars=[], invars=given), [])
    answers = columns_p.bind(*constants, *numbers, program=program, moving=(), maps=())
    for place, answer in zip(found, answers, strict=True):
        out[place] = answer
    return jax.tree.unflatten(shape, out)


def _floats(program: ClosedJaxpr) -> list[int]:
    """Which results have a derivative."""
    avals = program.out_avals
    return [i for i, aval in enumerate(avals) if np.issubdtype(aval.dtype, np.floating)]


def _pushed(program: ClosedJaxpr, moving: Sequence[int], values: Any, tangents: Any) -> tuple:
    """(results, tangents of those that have one) of one sample."""
    function = jaxpr_as_fun(program)

    def of_moving(*some):
        given = list(values)
        for place, value in zip(moving, some, strict=True):
            given[place] = value
        return function(*given)

    out, moved = jax.jvp(of_moving, [values[i] for i in moving], list(tangents))
    return list(out), [moved[i] for i in _floats(program)]


def _reference(*numbers: Any, program: ClosedJaxpr, moving: tuple, maps: tuple[Map, ...]) -> list:
    """Results, and behind them the tangents of those that have one, where something moves."""
    count = len(program.in_avals)

    def one(values, tangents):
        if not moving:
            return list(jaxpr_as_fun(program)(*values)), []
        return _pushed(program, moving, values, tangents)

    for own in maps:
        # None: the same for all tangents, and known to be.
        axis = None if the_same(own.values) else 0
        one = jax.vmap(one, (list(own.values), list(own.tangents)), (axis, 0))
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
    moved = [avals[i] for i in _floats(program)] if moving else []
    return [*out, *(jax.core.ShapedArray((*both, *a.shape), a.dtype) for a in moved)]


def _without(used, equation):
    """The same without results that nobody asks for, nor their tangents."""
    program = equation.params["program"]
    count, floats = len(program.out_avals), _floats(program)
    kept = list(used[:count])
    for i, wanted in zip(floats, used[count:], strict=False):
        kept[i] = kept[i] or wanted
    if not any(kept):
        return [False] * len(equation.invars), None
    whole = [*kept, *(kept[i] for i in floats)][: len(used)]
    out = [v for v, own in zip(equation.outvars, whole, strict=True) if own]
    params = equation.params | {"program": without_results(program, kept)}
    return [True] * len(equation.invars), equation.replace(outvars=out, params=params)


def _batch(numbers, dims, *, program, moving, maps):
    size = next(x.shape[d] for x, d in zip(numbers, dims, strict=True) if d is not None)
    count, results = len(program.in_avals), len(program.out_avals)
    own = Map(size, tuple(dims[:count]), tuple(dims[count:]))
    out = columns_p.bind(*numbers, program=program, moving=moving, maps=(*maps, own))
    axis = None if the_same(own.values) else 0
    return out, [axis] * results + [0] * (len(out) - results)


def _differentiate(values, tangents, *, program, moving, maps):
    moved = tuple(i for i, t in enumerate(tangents) if not isinstance(t, ad.Zero))
    given = [tangents[i] for i in moved]
    if moving:
        return _of_second_order(values, moved, given, (program, moving, maps))
    maps = tuple(m._replace(tangents=tuple(m.values[i] for i in moved)) for m in maps)
    found = columns_p.bind(*values, *given, program=program, moving=moved, maps=maps)
    out, slopes = found[: len(program.out_avals)], iter(found[len(program.out_avals) :])
    have = set(_floats(program))
    return out, [next(slopes) if i in have else _still(each) for i, each in enumerate(out)]


def _of_second_order(values, moved, tangents, params):
    """The tangents' own tangents."""
    program, moving, maps = params

    def of_moving(*some):
        given = list(values)
        for place, value in zip(moved, some, strict=True):
            given[place] = value
        return _reference(*given, program=program, moving=moving, maps=maps)

    out, slopes = jax.jvp(of_moving, [values[i] for i in moved], tangents)
    pairs = zip(out, slopes, strict=True)
    return out, [s if jnp.issubdtype(o.dtype, jnp.floating) else _still(o) for o, s in pairs]


def _still(value: Any) -> ad.Zero:
    return ad.Zero(jax.core.ShapedArray(value.shape, value.dtype).to_tangent_aval())


def _with_columns(*values: Any, program: ClosedJaxpr, moving: tuple, maps: tuple) -> tuple:
    """(results, for each that has a derivative its columns in front, one for each number that
    moves)."""
    shapes = [program.in_avals[i].shape for i in moving]
    sizes = [math.prod(shape) for shape in shapes]
    count = sum(sizes)
    portions = max(1, -(-count // TOGETHER))
    together = -(-count // portions)
    ways = np.eye(portions * together, count).reshape(portions, together, count)

    def one(values):
        def push(way):
            parts = jnp.split(way, np.cumsum(sizes)[:-1])
            own = [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]
            return _pushed(program, moving, values, own)

        if count == 0:
            out = jaxpr_as_fun(program)(*values)
            return list(out), [jnp.zeros((0, *out[i].shape)) for i in _floats(program)]
        side_by_side = jax.vmap(push, out_axes=(None, 0))
        if portions == 1:
            return side_by_side(jnp.asarray(ways[0]))
        out, columns = jax.lax.map(side_by_side, jnp.asarray(ways))
        return [o[0] for o in out], [c.reshape(-1, *c.shape[2:])[:count] for c in columns]

    for own in maps:
        if not the_same(own.values):
            one = jax.vmap(one, (list(own.values),))
    return one(list(values))


def _known_first(trace, *tracers, program, moving, maps):
    """What is linearised about known values: these go through the function once, together with
    the columns; what is left is their product with the tangents."""
    count = len(program.in_avals)
    values, tangents = tracers[:count], tracers[count:]
    known = all(each.pval.is_known() for each in values)
    if not known or all(each.pval.is_known() for each in tangents):
        params = {"program": program, "moving": moving, "maps": maps}
        return trace.default_process_primitive(columns_p, tracers, params)
    run = functools.partial(_with_columns, program=program, moving=moving, maps=maps)
    out, columns = jax.jit(run)(*(each.pval.get_known() for each in values))
    own = tuple(
        Map(m.size, tuple(None if the_same(m.values) else 0 for _ in columns), m.tangents)
        for m in maps
    )
    given = [*map(trace.new_const, columns), *tangents]
    params = {"columns": len(columns), "maps": own}
    moved = trace.default_process_primitive(applied_p, given, params)
    return [*map(trace.new_const, out), *moved]


batching.primitive_batchers[columns_p] = _batch
mlir.register_lowering(columns_p, mlir.lower_fun(_lowered, multiple_results=True))
drop_by(columns_p, _without)
ad.primitive_jvps[columns_p] = _differentiate
pe.custom_partial_eval_rules[columns_p] = _known_first
