"""What each JAX primitive becomes as LLVM code: one rule each, on NumPy object arrays of registers
and known numbers.

Shapes are NumPy's business (reshape, broadcast, transpose move names about and cost nothing);
arithmetic writes one instruction per number. `write` is the only entry.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from jaxclear.native.writer import FLOAT, TRUTH, WHOLE, InMemory, Unsupported, Writer, kind_of

Rule = Callable[..., Any]
RULES: dict[str, Rule] = {}
# Names of the rules that take arrays in memory as well.
READ_MEMORY: set[str] = set()


def rule(*names: str, reads_memory: bool = False) -> Callable[[Rule], Rule]:
    """Registers the rule of some primitives; `reads_memory`: it takes arrays in memory as well."""

    def keep(function: Rule) -> Rule:
        RULES.update(dict.fromkeys(names, function))
        READ_MEMORY.update(names if reads_memory else ())
        return function

    return keep


def array_of(values: Any, shape: tuple[int, ...]) -> np.ndarray:
    out = np.empty(shape, object)
    out[...] = values
    return out


def _scalar(value: Any) -> Any:
    return value.item() if isinstance(value, (np.generic, np.ndarray)) else value


def write(writer: Writer, jaxpr: Jaxpr, constants: Any, arguments: Any) -> list:
    """The outputs of a program for given constants and arguments, all as object arrays (or
    `InMemory`).
    """
    values: dict[Any, Any] = dict(zip(jaxpr.constvars, constants, strict=True))
    values |= dict(zip(jaxpr.invars, arguments, strict=True))

    def get(atom):
        if isinstance(atom, Literal):
            kind_of(atom.aval.dtype)
            return (
                array_of(_scalar(atom.val), ())
                if np.ndim(atom.val) == 0
                else np.asarray(atom.val).astype(object)
            )
        return values[atom]

    for equation in jaxpr.eqns:
        name = equation.primitive.name
        if name not in RULES:
            raise Unsupported(f"the primitive {name}")
        inputs = [get(atom) for atom in equation.invars]
        if name not in READ_MEMORY and any(isinstance(value, InMemory) for value in inputs):
            raise Unsupported(f"{name} of a long array")
        found = RULES[name](writer, equation, *inputs)
        values |= dict(
            zip(equation.outvars, found if isinstance(found, list) else [found], strict=True)
        )
    return [get(atom) for atom in jaxpr.outvars]


def write_closed(writer: Writer, program: Any, arguments: Any) -> list:
    """The outputs of a program whose constants are known."""
    if isinstance(program, ClosedJaxpr):
        return write(writer, program.jaxpr, [known_array(c) for c in program.consts], arguments)
    return write(writer, program, [], arguments)


def known_array(value: Any) -> np.ndarray:
    """A NumPy array of numbers as an object array of Python numbers."""
    plain = np.asarray(value)
    kind_of(plain.dtype)
    return plain.astype(object)


def refuse_memory(*arrays: Any) -> None:
    if any(isinstance(a, InMemory) for a in arrays):
        raise Unsupported("a long array that changes")


def _kinds(equation: Any) -> list[str]:
    return [kind_of(atom.aval.dtype) for atom in equation.invars]


def each(function: Callable, *arrays: np.ndarray) -> np.ndarray:
    """A function of single numbers over arrays of one shape (or scalars)."""
    shape = np.broadcast_shapes(*[a.shape for a in arrays])
    arrays = [np.broadcast_to(a, shape) for a in arrays]
    out = np.empty(shape, object)
    for index in np.ndindex(*shape):
        out[index] = function(*[a[index] for a in arrays])
    return out


def known(*values: Any) -> bool:
    return not any(isinstance(v, str) for v in values)


# ---- arithmetic: {name: (text for floats, text for whole numbers, the same on known numbers)}
_FLOAT_OPS = {"add": "fadd", "add_any": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_WHOLE_OPS = {
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
def _arithmetic(writer, equation, a, b):
    name, kind = equation.primitive.name, _kinds(equation)[0]

    def one(x, y):
        if known(x, y):
            if kind == WHOLE and name == "div":
                return int(x / y)
            with np.errstate(all="ignore"):
                return _scalar(_ON_NUMBERS[name](np.asarray(x), np.asarray(y)))
        if kind == FLOAT:
            if name == "rem":
                return writer.library("fmod", x, y)
            return writer.operate(f"{_FLOAT_OPS[name]} contract {{type}} {{0}}, {{1}}", kind, x, y)
        return writer.operate(f"{_WHOLE_OPS[name]} {{type}} {{0}}, {{1}}", kind, x, y)

    return each(one, a, b)


@rule("neg")
def _negate(writer, equation, a):
    kind = _kinds(equation)[0]

    def one(x):
        if known(x):
            return -x
        return writer.operate(
            "fneg {type} {0}" if kind == FLOAT else "sub {type} zeroinitializer, {0}", kind, x
        )

    if kind == WHOLE and writer.lanes == 1:
        return each(lambda x: -x if known(x) else writer.operate("sub {type} 0, {0}", kind, x), a)
    return each(one, a)


@rule("max", "min")
def _extremum(writer, equation, a, b):
    kind, largest = _kinds(equation)[0], equation.primitive.name == "max"

    def one(x, y):
        if known(x, y):
            return _scalar(np.maximum(x, y) if largest else np.minimum(x, y))
        if kind == TRUTH:
            return writer.operate(("or" if largest else "and") + " {type} {0}, {1}", kind, x, y)
        if kind == WHOLE:
            first = writer.operate(
                f"icmp {'sgt' if largest else 'slt'} {{type}} {{0}}, {{1}}", kind, x, y
            )
            return writer.choose(first, x, y, kind)
        # A first operand that is not a number is passed on; a second one is too, because then
        # neither comparison holds.
        first = writer.operate(
            f"fcmp {'ogt' if largest else 'olt'} {{type}} {{0}}, {{1}}", kind, x, y
        )
        if isinstance(x, str):
            lost = writer.operate("fcmp uno {type} {0}, {0}", kind, x)
            first = writer.operate("or {type} {0}, {1}", TRUTH, first, lost)
        return writer.choose(first, x, y, kind)

    return each(one, a, b)


@rule("clamp")
def _clamp(writer, equation, low, a, high):
    kind = kind_of(equation.invars[1].aval.dtype)

    def one(lo, x, hi):
        if kind == WHOLE:
            x = writer.choose(compare(writer, "lt", WHOLE, x, lo), lo, x, kind)
            return writer.choose(compare(writer, "gt", WHOLE, x, hi), hi, x, kind)
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


def compare(writer, name, kind, x, y):
    floats, wholes, numbers = _COMPARISONS[name]
    if known(x, y):
        return bool(numbers(x, y))
    form = (
        f"fcmp {floats}"
        if kind == FLOAT
        else f"icmp {wholes if kind == WHOLE else wholes.replace('s', 'u', 1)}"
    )
    return writer.operate(form + " {type} {0}, {1}", kind, x, y)


@rule(*_COMPARISONS)
def _compare(writer, equation, a, b):
    kind = _kinds(equation)[0]
    if kind == TRUTH and equation.primitive.name not in ("eq", "ne"):
        raise Unsupported("an order of truth values")
    return each(lambda x, y: compare(writer, equation.primitive.name, kind, x, y), a, b)


@rule("and", "or", "xor")
def _logic(writer, equation, a, b):
    kind, name = _kinds(equation)[0], equation.primitive.name

    def one(x, y):
        if known(x, y):
            return {"and": x & y, "or": x | y, "xor": x ^ y}[name]
        return writer.operate(name + " {type} {0}, {1}", kind, x, y)

    return each(one, a, b)


@rule("not")
def _not(writer, equation, a):
    kind = _kinds(equation)[0]
    if kind != TRUTH:
        raise Unsupported("the complement of whole numbers")
    return each(
        lambda x: (not x) if known(x) else writer.operate("xor {type} {0}, {1}", kind, x, True), a
    )


@rule("select_n")
def _select(writer, equation, which, *cases):
    kind = kind_of(equation.outvars[0].aval.dtype)
    if len(cases) != 2 or kind_of(equation.invars[0].aval.dtype) != TRUTH:
        raise Unsupported("a choice among more than two")
    return each(lambda w, no, yes: writer.choose(w, yes, no, kind), which, *cases)


@rule("convert_element_type")
def _convert(writer, equation, a):
    old, new = _kinds(equation)[0], kind_of(equation.params["new_dtype"])
    wide_old, wide_new = writer.wide(old), writer.wide(new)

    def one(x):
        if known(x):
            return {FLOAT: float, WHOLE: int, TRUTH: bool}[new](x)
        if old == new:
            return x
        if new == TRUTH:
            return compare(writer, "ne", old, x, 0.0 if old == FLOAT else 0)
        if old == FLOAT:
            suffix = (
                ("i64", "f64")
                if writer.lanes == 1
                else (f"v{writer.lanes}i64", f"v{writer.lanes}f64")
            )
            name = f"@llvm.fptosi.sat.{suffix[0]}.{suffix[1]}"
            writer.needs.add(f"declare {wide_new} {name}({wide_old})")
            return writer.put(f"call {wide_new} {name}({wide_old} {x})")
        instruction = "sitofp" if old == WHOLE else ("uitofp" if new == FLOAT else "zext")
        return writer.put(f"{instruction} {wide_old} {x} to {wide_new}")

    return each(one, a)


# ---- functions of one or two floats
_INTRINSICS = {"sqrt": "sqrt", "abs": "fabs", "floor": "floor", "ceil": "ceil"}


@rule(*_INTRINSICS)
def _intrinsic(writer, equation, a):
    name, kind = equation.primitive.name, _kinds(equation)[0]
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


@rule(
    *[
        "exp",
        "exp2",
        "expm1",
        "log",
        "log1p",
        "tan",
        "tanh",
        "sinh",
        "cosh",
        "asin",
        "acos",
        "asinh",
        "acosh",
        "atanh",
        "erf",
        "cbrt",
    ]
)
def _from_library(writer, equation, a):
    return each(lambda x: writer.library(equation.primitive.name, x), a)


@rule("pow")
def _power(writer, equation, a, b):
    if _kinds(equation) != [FLOAT, FLOAT]:
        raise Unsupported("a power of whole numbers")
    return each(lambda x, y: writer.library("pow", x, y), a, b)


@rule("sin", "cos")
def _sine(writer, equation, a):
    def one(x):
        pair = writer.once(("sincos", x), lambda: writer.own("sincos", x))
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
    kind = _kinds(equation)[0]
    one, zero = (1.0, 0.0) if kind == FLOAT else (1, 0)

    def sign(x):
        below = writer.choose(compare(writer, "lt", kind, x, zero), -one, x, kind)
        return writer.choose(compare(writer, "gt", kind, x, zero), one, below, kind)

    return each(sign, a)


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
    kind = _kinds(equation)[0]
    word = "fmul contract" if kind == FLOAT else "mul"
    return each(
        lambda x: x * x if known(x) else writer.operate(word + " {type} {0}, {0}", kind, x), a
    )


@rule("integer_pow")
def _integer_power(writer, equation, a):
    count = equation.params["y"]
    if _kinds(equation)[0] != FLOAT:
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
