"""Rules for operations on long arrays: how they are looked up elsewhere, or become loops over their
entries. What stands here goes before the rules of the same primitives for arrays in registers."""

import math
from collections.abc import Callable

import numpy as np

from jaxclear.native import control as _control  # noqa: F401  (its rules hand arrays on)
from jaxclear.native import elementary as _elementary  # noqa: F401
from jaxclear.native.arithmetic import combine
from jaxclear.native.indexing import gathered_places, places_of, spans_of
from jaxclear.native.long_arrays import (
    Buffer,
    entrywise,
    for_each,
    join_arrays,
    stored,
    unstack_rows,
    update_long,
    view,
)
from jaxclear.native.program import CALLS
from jaxclear.native.writer import (
    LONGEST_IN_REGISTERS,
    RULES,
    InMemory,
    Long,
    array_of,
    in_registers,
    is_num,
    kind_of,
    kinds_of,
    long_rule,
    rule,
)

# Operations on each entry by itself.
ENTRYWISE = (
    *("add", "add_any", "sub", "mul", "div", "rem", "neg", "max", "min", "clamp"),
    *("eq", "ne", "lt", "le", "gt", "ge", "and", "or", "xor", "not", "select_n"),
    *("convert_element_type", "bitcast_convert_type", "sqrt", "rsqrt", "abs", "sign", "floor"),
    *("ceil", "round", "is_finite", "square", "integer_pow", "pow", "exp", "log", "sin", "cos"),
    *("tan", "atan", "atan2", "tanh", "exp2", "log1p", "expm1"),
)
# What hands arrays on, or takes them as they are.
HANDED_ON: tuple[str, ...] = (
    *CALLS,
    "copy",
    "copy_p",
    "stop_gradient",
    "optimization_barrier",
    "reduce_precision",
)
HANDED_ON += ("scan", "while", "cond", "jaxclear_loop")


def _rule_by_entries(rule: Callable) -> Callable:
    """The rule for long arrays of an operation on each entry by itself."""

    def entry_rule(writer, equation, *arrays):
        if math.prod(equation.outvars[0].aval.shape) <= LONGEST_IN_REGISTERS:
            return rule(writer, equation, *map(in_registers, arrays))
        return entrywise(writer, rule, equation, arrays)

    return entry_rule


for _name in ENTRYWISE:
    if _name in RULES:
        long_rule(_name)(_rule_by_entries(RULES[_name]))
for _name in HANDED_ON:
    if _name in RULES:
        long_rule(_name)(RULES[_name])


@long_rule("reshape", "squeeze", "expand_dims")
def _reshape_long(writer, equation, a):
    return a.reshaped(tuple(equation.outvars[0].aval.shape))


@long_rule("broadcast_in_dim")
def _broadcast_long(writer, equation, a):
    shape, axes = equation.params["shape"], equation.params["broadcast_dimensions"]
    wide = [1] * len(shape)
    for axis, size in zip(axes, a.shape, strict=True):
        wide[axis] = size
    return view(writer, a, a.kind, np.broadcast_to(_flat_places(a).reshape(wide), shape))


def _flat_places(a):
    return np.arange(a.size).reshape(a.shape)


@long_rule("transpose")
def _transpose_long(writer, equation, a):
    return view(writer, a, a.kind, _flat_places(a).transpose(equation.params["permutation"]))


@long_rule("slice")
def _slice_long(writer, equation, a):
    return view(writer, a, a.kind, _flat_places(a)[spans_of(equation)])


@long_rule("unstack")
def _unstack_long(writer, equation, a):
    places = np.moveaxis(_flat_places(a), equation.params["axis"], 0)
    return unstack_rows(writer, equation, a, a.kind, places)


@long_rule("concatenate")
def _concatenate_long(writer, equation, *arrays):
    kind = kind_of(equation.outvars[0].aval.dtype)
    return join_arrays(writer, arrays, kind, equation.params["dimension"])


@long_rule("gather")
def _gather_long(writer, equation, a, indices):
    places = gathered_places(equation, a.shape, in_registers(indices))
    if places is None:
        return RULES["gather"](writer, equation, in_registers(a), in_registers(indices))
    return view(writer, a, a.kind, places)


@long_rule("scatter", "scatter-add")
def _scatter_long(writer, equation, a, indices, update):
    name, numbers = equation.primitive.name, equation.params["dimension_numbers"]
    indices, kind = in_registers(indices), kind_of(equation.invars[0].aval.dtype)
    unknown = not is_num(*indices.flat) or numbers.operand_batching_dims
    if unknown or isinstance(a, InMemory):
        return RULES[name](writer, equation, *map(in_registers, (a, indices, update)))
    clips = "CLIP" in str(equation.params["mode"])
    to = places_of(writer, numbers, a.shape, indices, update.shape, clips)
    inside = all(0 <= i < n for place in to.values() for i, n in zip(place, a.shape, strict=True))
    if not inside:
        return RULES[name](writer, equation, *map(in_registers, (a, indices, update)))
    places = np.array([np.ravel_multi_index(place, a.shape) for place in to.values()], int)
    join = lambda old, new: combine(writer, "sum", kind, old, new) if "add" in name else new
    return update_long(writer, a, kind, places, update, join)


@long_rule("reduce_sum", "reduce_max", "reduce_min", "reduce_and", "reduce_or")
def _reduce_long(writer, equation, a):
    """Over all axes, one entry after the other."""
    if len(equation.params["axes"]) < len(a.shape):
        return RULES[equation.primitive.name](writer, equation, in_registers(a))
    name = equation.primitive.name.removeprefix("reduce_")
    buffer = Buffer(writer, (), a.kind)
    buffer.put(0, a.entry(0))
    further = lambda k: a.entry(writer.put(f"add i64 {k}, 1"))

    def turn(k):
        buffer.put(0, combine(writer, name, a.kind, buffer.array().entry(0), further(k)))

    for_each(writer, a.size - 1, turn)
    return array_of(buffer.array().entry(0), ())


@rule("jaxclear_in_memory")
@long_rule("jaxclear_in_memory")
def _keep_in_memory(writer, equation, a):
    few = math.prod(a.shape) <= LONGEST_IN_REGISTERS
    return a if few or isinstance(a, Long) else stored(writer, a, kinds_of(equation)[0])
