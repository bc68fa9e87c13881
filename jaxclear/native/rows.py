"""A function of few numbers over many rows of them, such as the states of a run at its saving
times.

XLA fuses what a function works out into every place that reads it. Of an unrolled factorisation,
mapped over rows, it makes so much code that a mechanism with two spatial loops did not compile in
20 minutes; without fusion 4 s, as a kernel 2 s. So a long function becomes a kernel, and a short
one, which costs more to hand over than to compute, is left to XLA.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr

from jaxclear.native.while_loops import once, scan

# Operations up to which a function is short: a body's place has some 100, the reactions of a
# slider-crank have 456.
SHORT = 200
# Rows that a kernel is handed at a time: constants come with every row.
AT_A_TIME = 1024


def over_rows(function: Callable, *rows: Any) -> Any:
    """As `jax.vmap(function)(*rows)`. Derivatives of long functions are taken row by row."""
    first = jax.tree.map(lambda each: jax.ShapeDtypeStruct(each.shape[1:], each.dtype), rows)
    traced = jax.jit(function)
    if _is_short(traced, first):
        return jax.vmap(traced)(*rows)
    one = jax.vmap(lambda row: once(traced, *row))
    count = len(jax.tree.leaves(rows)[0])
    times = -(-count // AT_A_TIME)
    if times <= 1:
        return one(rows)
    # The last row stands in for those that the last portion lacks: portions alike are one program.
    portion = np.arange(-(-count // times) * times).clip(max=count - 1).reshape(times, -1)
    found = jax.lax.map(one, jax.tree.map(lambda each: each[portion], rows))
    return jax.tree.map(lambda each: each.reshape(-1, *each.shape[2:])[:count], found)


def through_rows(function: Callable, *rows: Any) -> Any:
    """As `over_rows`, one row after the other in a single kernel: constants come once, not with
    every row, and what a row needs of long arrays that the function closes over is read by index.
    For a batch, or where little is asked of each row. Its derivatives are not asked for."""
    return scan(lambda none, row: (none, function(*row)), (), rows)[1]


def one_row(function: Callable, *numbers: Any) -> Any:
    """As `function(*numbers)`, a kernel where that is long: XLA takes a millisecond and more to
    compile each of its operations."""
    traced = jax.jit(function)
    return (traced if _is_short(traced, numbers) else functools.partial(once, traced))(*numbers)


def _is_short(function: Callable, numbers: Any) -> bool:
    return _operations(jax.make_jaxpr(function)(*numbers).jaxpr) <= SHORT


def _operations(program: Jaxpr) -> int:
    """How many operations a program writes out, those of the programs it calls among them."""
    found = 0
    for equation in program.eqns:
        inner = [p.jaxpr if isinstance(p, ClosedJaxpr) else p for p in equation.params.values()]
        called = [p for p in inner if isinstance(p, Jaxpr)]
        found += sum(map(_operations, called)) if called else 1
    return found
