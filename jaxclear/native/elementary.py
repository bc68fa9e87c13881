"""Rules for functions of one or two numbers: roots, powers, exponentials, angles, rounding.

Sine, cosine and angle of several samples at once are LLVM functions of our own: polynomials of
Moshier's Cephes library (sin.c, atan.c), the argument reduced by pi/2 in three parts with fused
multiply-adds; sine and cosine beyond 1e8 rad are left to the C library. Within 2 units in the last
place of NumPy's (tests/native/test_native_loops.py).
"""

import numpy as np

from jaxclear.native.arithmetic import compare
from jaxclear.native.writer import (
    FLOAT,
    INT,
    PURE,
    TRUTH,
    Unsupported,
    Writer,
    each,
    is_num,
    kinds_of,
    rule,
)

# pi/2 as a sum of three numbers, each the remainder of the one before rounded to double precision.
HALF_PI = (1.5707963267948966, 6.123233995736766e-17, -1.4973849048591833e-33)
LARGEST_ANGLE = 1e8
SINE = (
    1.58962301576546568060e-10,
    -2.50507477628578072866e-8,
    2.75573136213857245213e-6,
    -1.98412698295895385996e-4,
    8.33333333332211858878e-3,
    -1.66666666666666307295e-1,
)
COSINE = (
    -1.13585365213876817300e-11,
    2.08757008419747316778e-9,
    -2.75573141792967388112e-7,
    2.48015872888517045348e-5,
    -1.38888888888730564116e-3,
    4.16666666666665929218e-2,
)
ANGLE_TOP = (
    -8.750608600031904122785e-1,
    -1.615753718733365076637e1,
    -7.500855792314704667340e1,
    -1.228866684490136173410e2,
    -6.485021904942025371773e1,
)
ANGLE_BOTTOM = (
    1.0,
    2.485846490142306297962e1,
    1.650270098316988542046e2,
    4.328810604912902668951e2,
    4.853903996359136964868e2,
    1.945506571482613964425e2,
)
# Ratio above which the angle is taken from 45 degrees on.
TURN_RATIO = 0.66


def _horner(w: Writer, x, coefficients):
    total = coefficients[0]
    for c in coefficients[1:]:
        total = w.call("fma", total, x, c)
    return total


def _float(w: Writer, form: str, *values):
    return w.operate(form, FLOAT, *values)


def sincos(lanes: int) -> tuple[list[str], set[str]]:
    """@jc.sincos(x) -> {sine, cosine}."""
    w = Writer(lanes)
    wide = w.wide(FLOAT)
    size = w.call("fabs", "%x")
    # Not "greater": an argument that is not a number goes to the C library too.
    far = w.operate("fcmp ugt {type} {0}, {1}", FLOAT, size, LARGEST_ANGLE)
    w.say(f"br i1 {w.any(far)}, label %far, label %near")
    w.start("near")
    count = w.call("roundeven", _float(w, "fmul {type} {0}, {1}", "%x", 1 / HALF_PI[0]))
    back = _float(w, "fneg {type} {0}", count)
    r = "%x"
    for part in HALF_PI:
        r = w.call("fma", back, part, r)
    square = _float(w, "fmul {type} {0}, {0}", r)
    cube = _float(w, "fmul {type} {0}, {1}", square, r)
    sine = w.call("fma", cube, _horner(w, square, SINE), r)
    flat = w.call("fma", square, -0.5, 1.0)
    fourth = _float(w, "fmul {type} {0}, {0}", square)
    cosine = w.call("fma", fourth, _horner(w, square, COSINE), flat)
    quadrant = w.put(f"fptosi {wide} {count} to {w.wide('i64')}")
    odd, half = [
        w.operate(
            "icmp ne {type} {0}, {1}",
            INT,
            w.operate("and {type} {0}, {1}", INT, quadrant, bit),
            0,
        )
        for bit in (1, 2)
    ]
    above = w.operate("add {type} {0}, {1}", INT, quadrant, 1)
    negated = w.operate(
        "icmp ne {type} {0}, {1}", INT, w.operate("and {type} {0}, {1}", INT, above, 2), 0
    )
    s, c = w.choose(odd, cosine, sine, FLOAT), w.choose(odd, sine, cosine, FLOAT)
    s = w.choose(half, _float(w, "fneg {type} {0}", s), s, FLOAT)
    c = w.choose(negated, _float(w, "fneg {type} {0}", c), c, FLOAT)
    _return_pair(w, s, c)
    w.start("far")
    _return_pair(w, w.library("sin", "%x"), w.library("cos", "%x"))
    head = f"define internal {{{wide}, {wide}}} @jc.sincos({wide} %x) {PURE} {{"
    return [head, "entry:", *w.lines, "}"], w.needs


def _return_pair(w: Writer, sine, cosine):
    wide = w.wide(FLOAT)
    first = w.put(f"insertvalue {{{wide}, {wide}}} poison, {wide} {sine}, 0")
    both = w.put(f"insertvalue {{{wide}, {wide}}} {first}, {wide} {cosine}, 1")
    w.say(f"ret {{{wide}, {wide}}} {both}")


def atan2(lanes: int) -> tuple[list[str], set[str]]:
    """@jc.atan2(y, x); zero at the origin, the sign of y on the branch cut."""
    w = Writer(lanes)
    wide = w.wide(FLOAT)
    up, along = w.call("fabs", "%y"), w.call("fabs", "%x")
    steep = w.operate("fcmp ogt {type} {0}, {1}", FLOAT, up, along)
    small, large = w.choose(steep, along, up, FLOAT), w.choose(steep, up, along, FLOAT)
    nowhere = w.operate("fcmp oeq {type} {0}, {1}", FLOAT, large, 0.0)
    # One division: (small - large) / (small + large) beyond a ratio.
    limit = _float(w, "fmul {type} {0}, {1}", TURN_RATIO, large)
    wide_angle = w.operate("fcmp ogt {type} {0}, {1}", FLOAT, small, limit)
    less, more = (
        _float(w, "fsub {type} {0}, {1}", small, large),
        _float(w, "fadd {type} {0}, {1}", small, large),
    )
    over, under = w.choose(wide_angle, less, small, FLOAT), w.choose(wide_angle, more, large, FLOAT)
    t = _float(w, "fdiv {type} {0}, {1}", over, w.choose(nowhere, 1.0, under, FLOAT))
    z = _float(w, "fmul {type} {0}, {0}", t)
    share = _float(w, "fdiv {type} {0}, {1}", _horner(w, z, ANGLE_TOP), _horner(w, z, ANGLE_BOTTOM))
    arc = w.call("fma", _float(w, "fmul {type} {0}, {1}", z, share), t, t)
    lifted = _float(w, "fadd {type} {0}, {1}", arc, 0.5 * HALF_PI[1])
    arc = w.choose(
        wide_angle, _float(w, "fadd {type} {0}, {1}", lifted, 0.5 * HALF_PI[0]), arc, FLOAT
    )
    rest = _float(w, "fsub {type} {0}, {1}", HALF_PI[1], arc)
    arc = w.choose(steep, _float(w, "fadd {type} {0}, {1}", HALF_PI[0], rest), arc, FLOAT)
    behind = w.put(f"bitcast {wide} %x to {w.wide('i64')}")
    negative = w.operate("icmp slt {type} {0}, {1}", INT, behind, 0)
    rest = _float(w, "fsub {type} {0}, {1}", 2 * HALF_PI[1], arc)
    arc = w.choose(negative, _float(w, "fadd {type} {0}, {1}", 2 * HALF_PI[0], rest), arc, FLOAT)
    w.say(f"ret {wide} {w.call('copysign', arc, '%y')}")
    head = f"define internal {wide} @jc.atan2({wide} %y, {wide} %x) {PURE} {{"
    return [head, "entry:", *w.lines, "}"], w.needs


DEFINITIONS = {"sincos": sincos, "atan2": atan2}


# The least float above 0.
SMALLEST = 5e-324

# LLVM has its own of these; those of the C library are called for each sample.
_INTRINSICS = {"sqrt": "sqrt", "abs": "fabs", "floor": "floor", "ceil": "ceil"}


@rule(*_INTRINSICS)
def _write_intrinsic(writer, equation, a):
    name, kind = equation.primitive.name, kinds_of(equation)[0]
    if kind != FLOAT:
        if name == "abs":
            return each(lambda x: abs(x) if is_num(x) else _absolute_integer(writer, x), a)
        raise Unsupported(f"{name} of whole numbers")
    return each(lambda x: writer.call(_INTRINSICS[name], x), a)


def _absolute_integer(writer, x):
    return writer.choose(
        compare(writer, "lt", INT, x, 0),
        writer.operate("sub {type} {1}, {0}", INT, x, 0),
        x,
        INT,
    )


# Sum, difference and product.
_PIECES = {FLOAT: ("fadd contract", "fsub contract", "fmul contract"), INT: ("add", "sub", "mul")}

# fmt: off
_LIBRARY = (
    "exp", "exp2", "expm1", "log", "log1p", "log2", "tan", "tanh", "sinh", "cosh", "asin", "acos",
    "asinh", "acosh", "atanh", "erf", "cbrt",
)
# fmt: on


@rule(*_LIBRARY)
def _write_library_call(writer, equation, a):
    return each(lambda x: writer.library(equation.primitive.name, x), a)


@rule("pow")
def _write_power(writer, equation, a, b):
    if kinds_of(equation) != [FLOAT, FLOAT]:
        raise Unsupported("a power of whole numbers")
    return each(lambda x, y: writer.library("pow", x, y), a, b)


@rule("sin", "cos")
def _write_sine(writer, equation, a):
    def one(x):
        pair = writer.call_defined("sincos", x)
        wide = writer.wide(FLOAT)
        return writer.put(
            f"extractvalue {{{wide}, {wide}}} {pair}, {int(equation.primitive.name == 'cos')}"
        )

    return each(one, a)


@rule("atan2")
def _write_angle(writer, equation, a, b):
    return each(lambda y, x: writer.call_defined("atan2", y, x), a, b)


@rule("atan")
def _write_arctangent(writer, equation, a):
    return each(lambda x: writer.call_defined("atan2", x, 1.0), a)


@rule("rsqrt")
def _write_inverse_root(writer, equation, a):
    return each(
        lambda x: writer.operate("fdiv {type} {0}, {1}", FLOAT, 1.0, writer.call("sqrt", x)), a
    )


@rule("round")
def _write_rounding(writer, equation, a):
    even = int(equation.params["rounding_method"]) == 1
    return each(lambda x: writer.call("roundeven" if even else "round", x), a)


@rule("sign")
def _write_sign(writer, equation, a):
    kind = kinds_of(equation)[0]
    one, zero = (1.0, 0.0) if kind == FLOAT else (1, 0)

    def sign(x):
        below = writer.choose(compare(writer, "lt", kind, x, zero), -one, x, kind)
        return writer.choose(compare(writer, "gt", kind, x, zero), one, below, kind)

    return each(sign, a)


@rule("nextafter")
def _write_next_float(writer, equation, a, b):
    """Floats in order of size are in order as whole numbers too, without their sign."""

    def one(x, y):
        if is_num(x, y):
            return float(np.nextafter(x, y))
        up, below = compare(writer, "gt", FLOAT, y, x), compare(writer, "lt", FLOAT, x, 0.0)
        away = writer.operate("xor {type} {0}, {1}", TRUTH, up, below)
        step = writer.choose(away, 1, -1, INT)
        floats, wholes = writer.wide(FLOAT), writer.wide(INT)
        bits = writer.put(f"bitcast {floats} {writer.text(x, FLOAT)} to {wholes}")
        bits = writer.operate("add {type} {0}, {1}", INT, bits, step)
        moved = writer.put(f"bitcast {wholes} {bits} to {floats}")
        tiny = writer.choose(up, SMALLEST, -SMALLEST, FLOAT)
        moved = writer.choose(compare(writer, "eq", FLOAT, x, 0.0), tiny, moved, FLOAT)
        moved = writer.choose(compare(writer, "eq", FLOAT, x, y), y, moved, FLOAT)
        is_nan = writer.operate("fcmp uno {type} {0}, {1}", FLOAT, x, y)
        return writer.choose(is_nan, float("nan"), moved, FLOAT)

    return each(one, a, b)


@rule("is_finite")
def _finite(writer, equation, a):
    def one(x):
        size = writer.call("fabs", x)
        return writer.operate("fcmp olt {type} {0}, {1}", FLOAT, size, float("inf"))

    return each(one, a)


def _multiply_contracted(writer, x, y):
    return writer.operate("fmul contract {type} {0}, {1}", FLOAT, x, y)


@rule("square")
def _write_square(writer, equation, a):
    kind = kinds_of(equation)[0]
    word = "fmul contract" if kind == FLOAT else "mul"
    return each(
        lambda x: x * x if is_num(x) else writer.operate(word + " {type} {0}, {0}", kind, x), a
    )


@rule("one_minus_square")
def _write_one_minus_square(writer, equation, a):
    """In two factors, as JAX has it: close to 1 the square itself has lost the difference."""
    kind = kinds_of(equation)[0]
    add, sub, mul = _PIECES[kind]
    one = 1.0 if kind == FLOAT else 1

    def both(x):
        if is_num(x):
            return (one + x) * (one - x)
        more = writer.operate(f"{add} {{type}} {{0}}, {{1}}", kind, one, x)
        less = writer.operate(f"{sub} {{type}} {{0}}, {{1}}", kind, one, x)
        return writer.operate(f"{mul} {{type}} {{0}}, {{1}}", kind, more, less)

    return each(both, a)


@rule("polynomial")
def _write_polynomial(writer, equation, a, *coefficients):
    """By Horner's scheme; the coefficient of the highest power is the last."""
    if set(kinds_of(equation)) != {FLOAT}:
        raise Unsupported("a polynomial of whole numbers")

    def one(x, *factors):
        result = factors[-1]
        for factor in reversed(factors[:-1]):
            product = _multiply_contracted(writer, result, x)
            result = writer.operate("fadd contract {type} {0}, {1}", FLOAT, product, factor)
        return result

    return each(one, a, *coefficients)


@rule("integer_pow")
def _write_integer_power(writer, equation, a):
    count = equation.params["y"]
    if kinds_of(equation)[0] != FLOAT:
        raise Unsupported("a power of whole numbers")

    def one(x):
        result, square, remaining_power = None, x, abs(count)
        while remaining_power:
            if remaining_power & 1:
                result = square if result is None else _multiply_contracted(writer, result, square)
            remaining_power >>= 1
            square = _multiply_contracted(writer, square, square) if remaining_power else square
        result = 1.0 if result is None else result
        return writer.operate("fdiv {type} {0}, {1}", FLOAT, 1.0, result) if count < 0 else result

    return each(one, a)
