"""Rules for functions of one or two numbers: roots, powers, exponentials, angles, rounding."""

import numpy as np

from jaxclear.native.arithmetic import compare
from jaxclear.native.rules import each, kinds_of, known, rule
from jaxclear.native.writer import FLOAT, TRUTH, WHOLE, Unsupported

# The least float above 0.
SMALLEST = 5e-324

# LLVM has its own of these; those of the C library are called for each sample.
_INTRINSICS = {"sqrt": "sqrt", "abs": "fabs", "floor": "floor", "ceil": "ceil"}


@rule(*_INTRINSICS)
def _intrinsic(writer, equation, a):
    name, kind = equation.primitive.name, kinds_of(equation)[0]
    if kind != FLOAT:
        if name == "abs":
            return each(lambda x: abs(x) if known(x) else _absolute(writer, x), a)
        raise Unsupported(f"{name} of whole numbers")
    return each(lambda x: writer.call(_INTRINSICS[name], x), a)


def _absolute(writer, x):
    return writer.choose(
        compare(writer, "lt", WHOLE, x, 0),
        writer.operate("sub {type} {1}, {0}", WHOLE, x, 0),
        x,
        WHOLE,
    )


# Sum, difference and product.
_PIECES = {
    FLOAT: ("fadd contract", "fsub contract", "fmul contract"),
    WHOLE: ("add", "sub", "mul"),
}

# fmt: off
_LIBRARY = (
    "exp", "exp2", "expm1", "log", "log1p", "log2", "tan", "tanh", "sinh", "cosh", "asin", "acos",
    "asinh", "acosh", "atanh", "erf", "cbrt",
)
# fmt: on


@rule(*_LIBRARY)
def _from_library(writer, equation, a):
    return each(lambda x: writer.library(equation.primitive.name, x), a)


@rule("pow")
def _power(writer, equation, a, b):
    if kinds_of(equation) != [FLOAT, FLOAT]:
        raise Unsupported("a power of whole numbers")
    return each(lambda x, y: writer.library("pow", x, y), a, b)


@rule("sin", "cos")
def _sine(writer, equation, a):
    def one(x):
        pair = writer.own("sincos", x)
        wide = writer.wide(FLOAT)
        return writer.put(
            f"extractvalue {{{wide}, {wide}}} {pair}, {int(equation.primitive.name == 'cos')}"
        )

    return each(one, a)


@rule("atan2")
def _angle(writer, equation, a, b):
    return each(lambda y, x: writer.own("atan2", y, x), a, b)


@rule("atan")
def _arctangent(writer, equation, a):
    return each(lambda x: writer.own("atan2", x, 1.0), a)


@rule("rsqrt")
def _inverse_root(writer, equation, a):
    return each(
        lambda x: writer.operate("fdiv {type} {0}, {1}", FLOAT, 1.0, writer.call("sqrt", x)), a
    )


@rule("round")
def _round(writer, equation, a):
    even = int(equation.params["rounding_method"]) == 1
    return each(lambda x: writer.call("roundeven" if even else "round", x), a)


@rule("sign")
def _sign(writer, equation, a):
    kind = kinds_of(equation)[0]
    one, zero = (1.0, 0.0) if kind == FLOAT else (1, 0)

    def sign(x):
        below = writer.choose(compare(writer, "lt", kind, x, zero), -one, x, kind)
        return writer.choose(compare(writer, "gt", kind, x, zero), one, below, kind)

    return each(sign, a)


@rule("nextafter")
def _neighbour(writer, equation, a, b):
    """Floats in order of size are in order as whole numbers too, without their sign."""

    def one(x, y):
        if known(x, y):
            return float(np.nextafter(x, y))
        up, below = compare(writer, "gt", FLOAT, y, x), compare(writer, "lt", FLOAT, x, 0.0)
        away = writer.operate("xor {type} {0}, {1}", TRUTH, up, below)
        step = writer.choose(away, 1, -1, WHOLE)
        floats, wholes = writer.wide(FLOAT), writer.wide(WHOLE)
        bits = writer.put(f"bitcast {floats} {writer.text(x, FLOAT)} to {wholes}")
        bits = writer.operate("add {type} {0}, {1}", WHOLE, bits, step)
        moved = writer.put(f"bitcast {wholes} {bits} to {floats}")
        tiny = writer.choose(up, SMALLEST, -SMALLEST, FLOAT)
        moved = writer.choose(compare(writer, "eq", FLOAT, x, 0.0), tiny, moved, FLOAT)
        moved = writer.choose(compare(writer, "eq", FLOAT, x, y), y, moved, FLOAT)
        lost = writer.operate("fcmp uno {type} {0}, {1}", FLOAT, x, y)
        return writer.choose(lost, float("nan"), moved, FLOAT)

    return each(one, a, b)


@rule("is_finite")
def _finite(writer, equation, a):
    def one(x):
        size = writer.call("fabs", x)
        return writer.operate("fcmp olt {type} {0}, {1}", FLOAT, size, float("inf"))

    return each(one, a)


def _product(writer, x, y):
    return writer.operate("fmul contract {type} {0}, {1}", FLOAT, x, y)


@rule("square")
def _square(writer, equation, a):
    kind = kinds_of(equation)[0]
    word = "fmul contract" if kind == FLOAT else "mul"
    return each(
        lambda x: x * x if known(x) else writer.operate(word + " {type} {0}, {0}", kind, x), a
    )


@rule("one_minus_square")
def _one_minus_square(writer, equation, a):
    """In two factors, as JAX has it: close to 1 the square itself has lost the difference."""
    kind = kinds_of(equation)[0]
    add, sub, mul = _PIECES[kind]
    one = 1.0 if kind == FLOAT else 1

    def both(x):
        if known(x):
            return (one + x) * (one - x)
        more = writer.operate(f"{add} {{type}} {{0}}, {{1}}", kind, one, x)
        less = writer.operate(f"{sub} {{type}} {{0}}, {{1}}", kind, one, x)
        return writer.operate(f"{mul} {{type}} {{0}}, {{1}}", kind, more, less)

    return each(both, a)


@rule("polynomial")
def _polynomial(writer, equation, a, *coefficients):
    """By Horner's scheme; the coefficient of the highest power is the last."""
    if set(kinds_of(equation)) != {FLOAT}:
        raise Unsupported("a polynomial of whole numbers")

    def one(x, *factors):
        result = factors[-1]
        for factor in reversed(factors[:-1]):
            product = _product(writer, result, x)
            result = writer.operate("fadd contract {type} {0}, {1}", FLOAT, product, factor)
        return result

    return each(one, a, *coefficients)


@rule("integer_pow")
def _integer_power(writer, equation, a):
    count = equation.params["y"]
    if kinds_of(equation)[0] != FLOAT:
        raise Unsupported("a power of whole numbers")

    def one(x):
        result, square, left = None, x, abs(count)
        while left:
            if left & 1:
                result = square if result is None else _product(writer, result, square)
            left >>= 1
            square = _product(writer, square, square) if left else square
        result = 1.0 if result is None else result
        return writer.operate("fdiv {type} {0}, {1}", FLOAT, 1.0, result) if count < 0 else result

    return each(one, a)
