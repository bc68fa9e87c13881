"""Rules for arithmetic, comparisons, truth values, choices and conversions of single numbers, and
for their sums, products and extrema over axes.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxclear.native.writer import (
    FLOAT,
    INT,
    TRUTH,
    Unsupported,
    Writer,
    each,
    is_num,
    kind_of,
    kinds_of,
    number_of,
    rule,
)

# By primitive: the instruction for floats, for whole numbers, and the same on known numbers.
_FLOAT_OPS = {"add": "fadd", "add_any": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_INT_OPS = {
    "add": "add",
    "add_any": "add",
    "sub": "sub",
    "mul": "mul",
    "div": "sdiv",
    "rem": "srem",
}
_ON_NUMBERS: dict[str, Callable] = {
    "add": np.add,
    "add_any": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "rem": np.fmod,
}


@rule("add", "add_any", "sub", "mul", "div", "rem")
def _write_arithmetic(writer, equation, a, b):
    name, kind = equation.primitive.name, kinds_of(equation)[0]

    def one(x, y):
        if is_num(x, y):
            if kind == INT and name == "div":
                return int(x / y) if y != 0 else -1
            if kind == INT and name == "rem" and y == 0:
                return x
            with np.errstate(all="ignore"):
                return number_of(_ON_NUMBERS[name](np.asarray(x), np.asarray(y)))
        if kind == FLOAT:
            if name == "rem":
                return writer.library("fmod", x, y)
            return writer.operate(f"{_FLOAT_OPS[name]} contract {{type}} {{0}}, {{1}}", kind, x, y)
        if name in ("div", "rem") and not (is_num(y) and y not in (0, -1)):
            return _guarded_quotient(writer, name, x, y)
        return writer.operate(f"{_INT_OPS[name]} {{type}} {{0}}, {{1}}", kind, x, y)

    return each(one, a, b)


def _guarded_quotient(writer, name, x, y):
    """A quotient or remainder of whole numbers where the processor would stop: by 0 it is -1 or x,
    as JAX has it; by -1 the smallest number has no quotient, so that is a change of sign."""
    by_zero, by_minus = compare(writer, "eq", INT, y, 0), compare(writer, "eq", INT, y, -1)
    safe = writer.choose(by_minus, 1, writer.choose(by_zero, 1, y, INT), INT)
    quotient = writer.operate(f"{_INT_OPS[name]} {{type}} {{0}}, {{1}}", INT, x, safe)
    negated = writer.operate("sub {type} {0}, {1}", INT, 0, x) if name == "div" else 0
    quotient = writer.choose(by_minus, negated, quotient, INT)
    return writer.choose(by_zero, -1 if name == "div" else x, quotient, INT)


@rule("neg")
def _write_negation(writer, equation, a):
    kind = kinds_of(equation)[0]

    def one(x):
        if is_num(x):
            return -x
        return writer.operate(
            "fneg {type} {0}" if kind == FLOAT else "sub {type} zeroinitializer, {0}", kind, x
        )

    if kind == INT and writer.lanes == 1:
        return each(lambda x: -x if is_num(x) else writer.operate("sub {type} 0, {0}", kind, x), a)
    return each(one, a)


@rule("max", "min")
def _write_extremum(writer, equation, a, b):
    name, kind = equation.primitive.name, kinds_of(equation)[0]
    return each(lambda x, y: combine(writer, name, kind, x, y), a, b)


@rule("clamp")
def _write_clamp(writer, equation, low, a, high):
    kind = kind_of(equation.invars[1].aval.dtype)

    def one(lo, x, hi):
        if kind == INT:
            x = writer.choose(compare(writer, "lt", INT, x, lo), lo, x, kind)
            return writer.choose(compare(writer, "gt", INT, x, hi), hi, x, kind)
        x = writer.choose(compare(writer, "lt", FLOAT, x, lo), lo, x, kind)
        return writer.choose(compare(writer, "gt", FLOAT, x, hi), hi, x, kind)

    return each(one, low, a, high)


_COMPARISONS = {
    "eq": ("oeq", "eq", np.equal),
    "ne": ("une", "ne", np.not_equal),
    "lt": ("olt", "slt", np.less),
    "le": ("ole", "sle", np.less_equal),
    "gt": ("ogt", "sgt", np.greater),
    "ge": ("oge", "sge", np.greater_equal),
}


def compare(writer: Writer, name: str, kind: str, x: Any, y: Any) -> Any:
    """The truth value of a comparison of two numbers.

    Args:
        writer: LLVM text under construction.
        name: of JAX's primitive, such as "lt".
        kind: of both numbers: `FLOAT`, `INT` or `TRUTH`.
        x, y: register names or Python numbers; of two numbers the result is a Python bool.
    """
    floats, wholes, numbers = _COMPARISONS[name]
    if is_num(x, y):
        return bool(numbers(x, y))
    form = (
        f"fcmp {floats}"
        if kind == FLOAT
        else f"icmp {wholes if kind == INT else wholes.replace('s', 'u', 1)}"
    )
    return writer.operate(form + " {type} {0}, {1}", kind, x, y)


@rule(*_COMPARISONS)
def _write_comparison(writer, equation, a, b):
    kind = kinds_of(equation)[0]
    if kind == TRUTH and equation.primitive.name not in ("eq", "ne"):
        raise Unsupported("an order of truth values")
    return each(lambda x, y: compare(writer, equation.primitive.name, kind, x, y), a, b)


# Of numbers without a sign only the bits are known here, kept as those of a whole number.
_BITS = {np.dtype(np.float64): FLOAT, np.dtype(np.int64): INT, np.dtype(np.uint64): INT}


@rule("bitcast_convert_type")
def _write_bitwise(writer, equation, a):
    old, new = equation.invars[0].aval.dtype, np.dtype(equation.params["new_dtype"])
    if old not in _BITS or new not in _BITS:
        raise Unsupported(f"the bits of numbers of type {old} as {new}")
    before, after = _BITS[old], _BITS[new]

    def one(x):
        if before == after:
            return x
        if is_num(x):
            plain = np.float64 if before == FLOAT else np.int64
            return plain(x).view(np.float64 if after == FLOAT else np.int64).item()
        return writer.put(f"bitcast {writer.wide(before)} {x} to {writer.wide(after)}")

    return each(one, a)


@rule("and", "or", "xor")
def _write_logic(writer, equation, a, b):
    dtype, name = equation.invars[0].aval.dtype, equation.primitive.name
    kind = INT if dtype == np.uint64 else kinds_of(equation)[0]

    def one(x, y):
        if is_num(x, y):
            return {"and": x & y, "or": x | y, "xor": x ^ y}[name]
        return writer.operate(name + " {type} {0}, {1}", kind, x, y)

    return each(one, a, b)


@rule("not")
def _write_not(writer, equation, a):
    kind = kinds_of(equation)[0]
    if kind != TRUTH:
        raise Unsupported("the complement of whole numbers")
    return each(
        lambda x: (not x) if is_num(x) else writer.operate("xor {type} {0}, {1}", kind, x, True), a
    )


@rule("select_n")
def _write_selection(writer, equation, which, *cases):
    kind = kind_of(equation.outvars[0].aval.dtype)
    if len(cases) != 2 or kind_of(equation.invars[0].aval.dtype) != TRUTH:
        raise Unsupported("a choice among more than two")
    return each(lambda w, no, yes: writer.choose(w, yes, no, kind), which, *cases)


@rule("convert_element_type")
def _write_conversion(writer, equation, a):
    old, new = kinds_of(equation)[0], kind_of(equation.params["new_dtype"])
    wide_old, wide_new = writer.wide(old), writer.wide(new)

    def one(x):
        if is_num(x):
            return {FLOAT: float, INT: int, TRUTH: bool}[new](x)
        if old == new:
            return x
        if new == TRUTH:
            return compare(writer, "ne", old, x, 0.0 if old == FLOAT else 0)
        if old == FLOAT:
            return _to_int(writer, x)
        instruction = "sitofp" if old == INT else ("uitofp" if new == FLOAT else "zext")
        return writer.put(f"{instruction} {wide_old} {x} to {wide_new}")

    return each(one, a)


def _to_int(writer, x):
    """The whole number towards zero, the nearest there is beyond all of these, 0 of nan: as
    `llvm.fptosi.sat` has it, which LLVM writes number by number where there are several lanes."""
    if writer.lanes == 1:
        writer.needs.add("declare i64 @llvm.fptosi.sat.i64.f64(double)")
        return writer.put(f"call i64 @llvm.fptosi.sat.i64.f64(double {x})")
    most = 2.0**63
    integer = writer.put(f"fptosi {writer.wide(FLOAT)} {x} to {writer.wide(INT)}")
    high = writer.operate("fcmp oge {type} {0}, {1}", FLOAT, x, most)
    integer = writer.choose(high, 2**63 - 1, integer, INT)
    low = writer.operate("fcmp olt {type} {0}, {1}", FLOAT, x, -most)
    integer = writer.choose(low, -(2**63), integer, INT)
    none = writer.operate("fcmp uno {type} {0}, {1}", FLOAT, x, x)
    return writer.choose(none, 0, integer, INT)


def combine(writer: Writer, name: str, kind: str, x: Any, y: Any) -> Any:
    """Two numbers combined as a reduction does.

    Args:
        writer: LLVM text under construction.
        name: of the reduction: "sum", "prod", "max", "min", "and", "or".
        kind: of both numbers: `FLOAT`, `INT` or `TRUTH`.
        x, y: register names or Python numbers.

    Raises:
        Unsupported: there is no such reduction of this kind.
    """
    if kind == FLOAT and name in ("sum", "prod"):
        if is_num(x, y):
            return x + y if name == "sum" else x * y
        return writer.operate(
            ("fadd" if name == "sum" else "fmul") + " contract {type} {0}, {1}", kind, x, y
        )
    if kind == TRUTH:
        if is_num(x, y):
            return (x or y) if name in ("or", "max") else (x and y)
        return writer.operate(
            ("or" if name in ("or", "max") else "and") + " {type} {0}, {1}", kind, x, y
        )
    if name in ("max", "min"):
        if is_num(x, y):
            return number_of(np.maximum(x, y) if name == "max" else np.minimum(x, y))
        # A first operand that is not a number is passed on; a second one is too, because then
        # neither comparison holds.
        first = compare(writer, "gt" if name == "max" else "lt", kind, x, y)
        if kind == FLOAT and isinstance(x, str):
            is_nan = writer.operate("fcmp uno {type} {0}, {0}", kind, x)
            first = writer.operate("or {type} {0}, {1}", TRUTH, first, is_nan)
        return writer.choose(first, x, y, kind)
    if kind == INT and name in ("sum", "prod"):
        return writer.operate(("add" if name == "sum" else "mul") + " {type} {0}, {1}", kind, x, y)
    raise Unsupported(f"the reduction {name}")


_NEUTRAL = {"sum": 0, "prod": 1, "and": True, "or": False, "max": -math.inf, "min": math.inf}


@rule("reduce_sum", "reduce_prod", "reduce_max", "reduce_min", "reduce_and", "reduce_or")
def _write_reduction(writer, equation, a):
    name, kind = (
        equation.primitive.name.removeprefix("reduce_"),
        kind_of(equation.invars[0].aval.dtype),
    )
    axes = equation.params["axes"]
    rest = [i for i in range(a.ndim) if i not in axes]
    many = math.prod(a.shape[i] for i in axes)
    rows = a.transpose([*rest, *axes]).reshape([a.shape[i] for i in rest] + [many])
    out = np.empty(rows.shape[:-1], object)
    for index in np.ndindex(*out.shape):
        row = list(rows[index])
        if not row:
            if kind == INT and name in ("max", "min"):
                raise Unsupported(f"a {name} over no whole numbers")
            out[index] = {FLOAT: float, INT: int, TRUTH: bool}[kind](_NEUTRAL[name])
            continue
        total = row[0]
        for value in row[1:]:
            total = combine(writer, name, kind, total, value)
        out[index] = total
    return out


@rule("dot_general")
def _write_dot_product(writer, equation, a, b):
    (lhs, right), (batch_lhs, batch_right) = equation.params["dimension_numbers"]
    if kind_of(equation.outvars[0].aval.dtype) != FLOAT:
        raise Unsupported("a product of whole matrices")
    free_a = [i for i in range(a.ndim) if i not in (*lhs, *batch_lhs)]
    free_b = [i for i in range(b.ndim) if i not in (*right, *batch_right)]
    a = a.transpose([*batch_lhs, *free_a, *lhs])
    b = b.transpose([*batch_right, *free_b, *right])
    batch = a.shape[: len(batch_lhs)]
    shape_a, shape_b = (
        a.shape[len(batch) : len(batch) + len(free_a)],
        b.shape[len(batch) : len(batch) + len(free_b)],
    )
    out = np.empty(batch + shape_a + shape_b, object)
    for index in np.ndindex(*batch):
        for i in np.ndindex(*shape_a):
            for j in np.ndindex(*shape_b):
                total: Any = 0.0
                for x, y in zip(a[index + i].flat, b[index + j].flat, strict=True):
                    product = writer.operate("fmul contract {type} {0}, {1}", FLOAT, x, y)
                    total = (
                        product if is_num(total) else combine(writer, "sum", FLOAT, total, product)
                    )
                out[index + i + j] = total
    return out
