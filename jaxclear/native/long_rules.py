"""Rules for operations on long arrays: how they are looked up elsewhere, or become loops over their
entries. What stands here goes before the rules of the same primitives for arrays in registers."""

import math
from collections.abc import Callable

import numpy as np

from jaxclear.native import control as _control  # noqa: F401  (its rules hand arrays on)
from jaxclear.native import elementary as _elementary  # noqa: F401
from jaxclear.native.arithmetic import combine
from jaxclear.native.indexing import gathered_places, spans_of
from jaxclear.native.long_arrays import (
    Room,
    entries_of,
    entrywise,
    for_each,
    joined,
    stored,
    unstacked,
    view,
)
from jaxclear.native.program import CALLS
from jaxclear.native.writer import (
    FLOAT,
    LONGEST_IN_REGISTERS,
    RULES,
    Long,
    array_of,
    in_registers,
    kind_of,
    kinds_of,
    known,
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
HANDED_ON = (*CALLS, "copy", "copy_p", "stop_gradient", "optimization_barrier", "reduce_precision")
HANDED_ON += ("scan", "while", "cond", "jaxclear_loop")


def _by_entries(rule: Callable) -> Callable:
    """The rule for long arrays of an operation on each entry by itself."""

    def own(writer, equation, *arrays):
        if math.prod(equation.outvars[0].aval.shape) <= LONGEST_IN_REGISTERS:
            return rule(writer, equation, *map(in_registers, arrays))
        return entrywise(writer, rule, equation, arrays)

    return own


for _name in ENTRYWISE:
    if _name in RULES:
        long_rule(_name)(_by_entries(RULES[_name]))
for _name in HANDED_ON:
    if _name in RULES:
        long_rule(_name)(RULES[_name])


@long_rule("reshape", "squeeze", "expand_dims")
def _reshaped(writer, equation, a):
    return a.reshaped(tuple(equation.outvars[0].aval.shape))


@long_rule("broadcast_in_dim")
def _broadcast(writer, equation, a):
    shape, axes = equation.params["shape"], equation.params["broadcast_dimensions"]
    wide = [1] * len(shape)
    for axis, size in zip(axes, a.shape, strict=True):
        wide[axis] = size
    return view(writer, a, a.kind, np.broadcast_to(_places(a).reshape(wide), shape))


def _places(a):
    return np.arange(a.size).reshape(a.shape)


@long_rule("transpose")
def _transposed(writer, equation, a):
    return view(writer, a, a.kind, _places(a).transpose(equation.params["permutation"]))


@long_rule("slice")
def _sliced(writer, equation, a):
    return view(writer, a, a.kind, _places(a)[spans_of(equation)])


@long_rule("unstack")
def _unstacked(writer, equation, a):
    places = np.moveaxis(_places(a), equation.params["axis"], 0)
    return unstacked(writer, equation, a, a.kind, places)


@long_rule("concatenate")
def _concatenated(writer, equation, *arrays):
    kind = kind_of(equation.outvars[0].aval.dtype)
    return joined(writer, arrays, kind, equation.params["dimension"])


@long_rule("gather")
def _gathered(writer, equation, a, indices):
    places = gathered_places(equation, a.shape, in_registers(indices))
    if places is None:
        return RULES["gather"](writer, equation, in_registers(a), in_registers(indices))
    return view(writer, a, a.kind, places)


@long_rule("reduce_sum", "reduce_max", "reduce_min", "reduce_and", "reduce_or")
def _reduced(writer, equation, a):
    """Over all axes, one entry after the other."""
    if len(equation.params["axes"]) < len(a.shape):
        return RULES[equation.primitive.name](writer, equation, in_registers(a))
    name = equation.primitive.name.removeprefix("reduce_")
    room = Room(writer, (), a.kind)
    room.put(0, a.entry(0))
    further = lambda k: a.entry(writer.put(f"add i64 {k}, 1"))

    def turn(k):
        room.put(0, combine(writer, name, a.kind, room.array().entry(0), further(k)))

    for_each(writer, a.size - 1, turn)
    return array_of(room.array().entry(0), ())


@long_rule("scatter-add")
def _summed(writer, equation, a, indices, terms):
    """One term after the other, at places that are known."""
    numbers = equation.params["dimension_numbers"]
    plain = len(a.shape) == 1 and not numbers.update_window_dims
    places = in_registers(indices)
    if not plain or not known(*places.flat):
        return RULES["scatter-add"](writer, equation, *map(in_registers, (a, places, terms)))
    sums = stored(writer, a, FLOAT)
    entry, table = entries_of(writer, terms, FLOAT), writer.table(places.ravel())

    def turn(k):
        at = writer.put(f"getelementptr i32, ptr {table}, i64 {k}")
        said = writer.put(f"load i32, ptr {at}, !invariant.load !0")
        place = writer.put(f"zext i32 {said} to i64")
        sums.room.put(place, combine(writer, "sum", FLOAT, sums.entry(place), entry(k)))

    for_each(writer, terms.size, turn)
    return sums


@rule("jaxclear_in_memory")
@long_rule("jaxclear_in_memory")
def _in_memory(writer, equation, a):
    few = math.prod(a.shape) <= LONGEST_IN_REGISTERS
    return a if few or isinstance(a, Long) else stored(writer, a, kinds_of(equation)[0])
