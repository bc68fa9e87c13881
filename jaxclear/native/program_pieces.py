"""Long functions in pieces that XLA compiles apart from each other, for accelerators.

There XLA makes one kernel of hundreds of operations on a few numbers, and works out anew, wherever
a number is read at another place than before (of an array that was put together of single numbers,
say), all that leads to it. What a piece hands on is stored, so that this ends with it.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, Literal, jaxpr_as_fun

from jaxclear.native.program import apply, evaluate_constants, read, replay, traced

# A piece ends where one of its numbers takes so many operations, those done anew included. Of 64,
# 128 and 512, 128 was the fastest on an H200 (4096 slider-cranks, two integrators).
WORK = 128
# Programs that are kept.
LATEST = 64
# What loops call the program of a turn.
TURNS = {"scan": "jaxpr", "while": "body_jaxpr"}
# Operations whose results stand at other places than what they read, be the shapes alike or not,
# and those that are compiled apart by themselves.
MOVING = ("cumsum", "gather", "rev", "transpose")
# These work out where to read for each number that they read: what is more than so many operations
# is stored before.
SOUGHT, LITTLE = ("dynamic_slice", "dynamic_update_slice", "gather", "scatter", "scatter-add"), 8
SEPARATE = ("cholesky", "cond", "jaxclear_loop", "scan", "sort", "triangular_solve", "while")


def in_pieces(program: ClosedJaxpr) -> Callable[..., list]:
    """The function of a program, in pieces; those of loops within it likewise."""
    return jaxpr_as_fun(_rewrite_with_barriers(program))


@functools.lru_cache(maxsize=LATEST)
def _rewrite_with_barriers(program: ClosedJaxpr) -> ClosedJaxpr:
    written_out = traced(lambda *values: replay(program, values), program.in_avals)
    return traced(functools.partial(_evaluate_with_barriers, written_out), program.in_avals)


def _evaluate_with_barriers(program: ClosedJaxpr, *arguments: Any) -> list:
    jaxpr, values = program.jaxpr, evaluate_constants(program, arguments)
    last = {v: i for i, e in enumerate(jaxpr.eqns) for v in _variables(e.invars)}
    last |= dict.fromkeys(_variables(jaxpr.outvars), len(jaxpr.eqns))
    # Of what the piece has worked out: the operations that one number takes, by their indices.
    piece: dict[Any, dict[int, int]] = {}
    for i, equation in enumerate(jaxpr.eqns):
        name, parameters = equation.primitive.name, equation.params
        if name in SOUGHT and any(
            sum(piece.get(v, {}).values()) > LITTLE for v in _variables(equation.invars)
        ):
            piece = _piece_with_inputs(piece, [v for v in piece if last.get(v, -1) >= i], values)
        inputs, turn = read(equation.invars, values), TURNS.get(name)
        if turn is not None:
            parameters = parameters | {turn: _rewrite_with_barriers(parameters[turn])}
        results = apply(equation, inputs, parameters)
        values |= dict(zip(equation.outvars, results, strict=True))
        work = _op_count(equation, i, piece)
        piece |= dict.fromkeys(equation.outvars, work)
        if sum(work.values()) >= WORK:
            piece = _piece_with_inputs(piece, [v for v in piece if last.get(v, -1) > i], values)
    return read(jaxpr.outvars, values)


def _piece_with_inputs(piece: dict, needed: list, values: dict) -> dict:
    """The piece after one that ends here: what is `needed` of that is stored, in `values`."""
    if needed:
        barriered = jax.lax.optimization_barrier(read(needed, values))
        values |= dict(zip(needed, barriered, strict=True))
    return {}


def _op_count(equation: Any, index: int, piece: dict[Any, dict[int, int]]) -> dict[int, int]:
    """Operations for one number of what an equation gives: those at the same place are done once,
    whoever reads them."""
    name, out = equation.primitive.name, equation.outvars[0].aval
    if name in SEPARATE:
        return {}
    before = [piece[v] for v in _variables(equation.invars) if v in piece]
    shapes = [v.aval.shape for v in equation.invars if not isinstance(v, Literal)]
    if name not in MOVING and all(shape == out.shape for shape in shapes):
        return functools.reduce(dict.__or__, before, {index: 1})
    times = 1
    if name == "dot_general":
        (summed, _), _ = equation.params["dimension_numbers"]
        times = math.prod(shapes[0][axis] for axis in summed)
    elif name.startswith("reduce_"):
        times = equation.invars[0].aval.size // max(out.size, 1)
    return {index: 1 + times * sum(sum(each.values()) for each in before)}


def _variables(atoms: Sequence[Any]) -> list:
    return [v for v in atoms if not isinstance(v, Literal)]
