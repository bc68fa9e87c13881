"""Rules for sums, products, extrema over axes, and products of matrices."""

import math
from typing import Any

import numpy as np

from jaxclear.native.arithmetic import compare
from jaxclear.native.rules import known, number_of, rule
from jaxclear.native.writer import FLOAT, TRUTH, WHOLE, Unsupported, Writer, kind_of


def combine(writer: Writer, name: str, kind: str, x: Any, y: Any) -> Any:
    """Sum, product, extremum, and, or of two numbers."""
    if kind == FLOAT and name in ("sum", "prod"):
        if known(x, y):
            return x + y if name == "sum" else x * y
        return writer.operate(
            ("fadd" if name == "sum" else "fmul") + " contract {type} {0}, {1}", kind, x, y
        )
    if kind == TRUTH:
        if known(x, y):
            return (x or y) if name in ("or", "max") else (x and y)
        return writer.operate(
            ("or" if name in ("or", "max") else "and") + " {type} {0}, {1}", kind, x, y
        )
    if name in ("max", "min"):
        if known(x, y):
            return number_of(np.maximum(x, y) if name == "max" else np.minimum(x, y))
        first = compare(writer, "gt" if name == "max" else "lt", kind, x, y)
        if kind == FLOAT and isinstance(x, str):
            lost = writer.operate("fcmp uno {type} {0}, {0}", kind, x)
            first = writer.operate("or {type} {0}, {1}", TRUTH, first, lost)
        return writer.choose(first, x, y, kind)
    if kind == WHOLE and name in ("sum", "prod"):
        return writer.operate(("add" if name == "sum" else "mul") + " {type} {0}, {1}", kind, x, y)
    raise Unsupported(f"the reduction {name}")


_NEUTRAL = {"sum": 0, "prod": 1, "and": True, "or": False, "max": -math.inf, "min": math.inf}


@rule("reduce_sum", "reduce_prod", "reduce_max", "reduce_min", "reduce_and", "reduce_or")
def _reduce(writer, equation, a):
    name, kind = (
        equation.primitive.name.removeprefix("reduce_"),
        kind_of(equation.invars[0].aval.dtype),
    )
    a, axes = a, equation.params["axes"]
    rest = [i for i in range(a.ndim) if i not in axes]
    rows = a.transpose([*rest, *axes]).reshape([a.shape[i] for i in rest] + [-1])
    out = np.empty(rows.shape[:-1], object)
    for index in np.ndindex(*out.shape):
        row = list(rows[index])
        if not row:
            if kind == WHOLE and name in ("max", "min"):
                raise Unsupported(f"a {name} over no whole numbers")
            out[index] = {FLOAT: float, WHOLE: int, TRUTH: bool}[kind](_NEUTRAL[name])
            continue
        total = row[0]
        for value in row[1:]:
            total = combine(writer, name, kind, total, value)
        out[index] = total
    return out


@rule("dot_general")
def _dot(writer, equation, a, b):
    (left, right), (batch_left, batch_right) = equation.params["dimension_numbers"]
    if kind_of(equation.outvars[0].aval.dtype) != FLOAT:
        raise Unsupported("a product of whole matrices")
    free_a = [i for i in range(a.ndim) if i not in (*left, *batch_left)]
    free_b = [i for i in range(b.ndim) if i not in (*right, *batch_right)]
    a = a.transpose([*batch_left, *free_a, *left])
    b = b.transpose([*batch_right, *free_b, *right])
    batch = a.shape[: len(batch_left)]
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
                        product if known(total) else combine(writer, "sum", FLOAT, total, product)
                    )
                out[index + i + j] = total
    return out
