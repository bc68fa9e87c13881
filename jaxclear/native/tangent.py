"""The derivative of a loop, forwards, is a loop: its body carries the state and the state's
tangent. So it becomes a kernel as every other loop does.

The condition asks for the state alone. Of the state only those numbers get a tangent that depend on
what moves: times, indices and whole numbers do not. Of several tangents at once some stand side by
side in one body, which goes through the motion itself once for all of them.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal, jaxpr_as_fun

from jaxclear.native.program import (
    CALLS,
    Narrow,
    Program,
    avals_of,
    batches_loops,
    called_program,
    row_of,
    samples_in,
    scan_counts,
    traced,
)

# Tangents in one body at the most: more of them gain little, and outgrow the registers.
SIDE_BY_SIDE = 4
# Samples that a kernel goes through at a time, where there is but one motion.
LANES = 8


def moving_state(
    program: Program, constants: Sequence[bool], state: Sequence[bool]
) -> tuple[bool, ...]:
    """Which parts of the state ever have a tangent, followed by the same for the tables.

    Args:
        program: the loop, its condition and body as JAX programs.
        constants: which constants of the body have a tangent.
        state: which parts of the first state have one.
    """
    now, out = _moving_fixed_point(program.body, constants, state)
    initial_moves = (t.start is not None and constants[t.start] for t in program.tables)
    rows = zip(out[len(now) :], initial_moves, strict=True)
    return (*now, *(row or first for row, first in rows))


def _moving_fixed_point(
    body: ClosedJaxpr, fixed: Sequence[bool], first: Sequence[bool], rows: Sequence[bool] = ()
) -> tuple[tuple[bool, ...], list[bool]]:
    """(which parts of what a body hands on to itself ever move, which of its results do)."""
    now = tuple(first)
    while True:
        out = _moving_results(body, [*fixed, *now, *rows])
        after = tuple(a or b for a, b in zip(now, out, strict=False))
        if after == now:
            return now, out
        now = after


def _moving_results(program: ClosedJaxpr, inputs: Sequence[bool]) -> list[bool]:
    """Which results depend on the inputs that move."""
    jaxpr = getattr(program, "jaxpr", program)
    moving = {v for v, moves in zip(jaxpr.invars, inputs, strict=True) if moves}

    def moves(atom):
        return not isinstance(atom, Literal) and atom in moving

    for equation in jaxpr.eqns:
        moving_in = [moves(atom) for atom in equation.invars]
        if any(moving_in):
            flags = zip(equation.outvars, _is_result_moved(equation, moving_in), strict=True)
            moving |= {v for v, m in flags if m and np.issubdtype(v.aval.dtype, np.floating)}
    return [moves(atom) for atom in jaxpr.outvars]


def _is_result_moved(equation: Any, inputs: list[bool]) -> list[bool]:
    """Which results of an operation depend on its inputs that move."""
    name, p = equation.primitive.name, equation.params
    if name == "stop_gradient":
        return [False]
    if name in CALLS:
        return _moving_results(called_program(p), inputs)
    if name == "jaxclear_loop":
        inner = p["program"]
        c, b = inner.condition_constants, inner.condition_constants + inner.body_constants
        return list(moving_state(inner, inputs[c:b], inputs[b:]))
    if name == "cond":
        branches = [_moving_results(branch, inputs[1:]) for branch in p["branches"]]
        return [any(each) for each in zip(*branches, strict=True)]
    if name == "while":
        c, b = p["cond_nconsts"], p["cond_nconsts"] + p["body_nconsts"]
        return list(_moving_fixed_point(p["body_jaxpr"], inputs[c:b], inputs[b:])[0])
    if name == "scan":
        fixed, carried = scan_counts(p)
        carried += fixed
        parts = inputs[:fixed], inputs[fixed:carried], inputs[carried:]
        now, out = _moving_fixed_point(p["jaxpr"], *parts)
        return [*now, *out[len(now) :]]
    return [True] * len(equation.outvars)


def tangent_program(
    program: Program, constants: Sequence[bool], results: Sequence[bool]
) -> Program:
    """The loop that carries tangents with the state.

    Tangents follow the body's constants, the state and a row, for those parts that have one.

    Args:
        program: the loop, its condition and body as JAX programs.
        constants: which constants of the body have a tangent.
        results: which parts of state and row have one (`moving_state`).
    """
    c, b = program.condition_constants, program.body_constants
    fixed, first = avals_of(program)
    fixed, n = fixed[c:], len(first)
    of_constants, of_results = np.flatnonzero(constants), np.flatnonzero(results)
    of_state = of_results[of_results < n]
    turns, tests = jaxpr_as_fun(program.body), jaxpr_as_fun(program.condition)
    shift = b + len(of_constants)

    def turn(*numbers):
        k, dk, s, ds = numbers[:b], numbers[b:shift], numbers[shift:][:n], numbers[shift + n :]

        def moved(*moving):
            inputs = [*k, *s]
            for place, value in zip([*of_constants, *(b + of_state)], moving, strict=True):
                inputs[place] = value
            out = turns(*inputs)
            return [out[i] for i in of_results], out

        moving = [*(k[i] for i in of_constants), *(s[i] for i in of_state)]
        _, tangents, out = jax.jvp(moved, moving, [*dk, *ds], has_aux=True)
        count = len(of_state)
        return [*out[:n], *tangents[:count], *out[n:], *tangents[count:]]

    behind = [first[i] for i in of_state]
    body = traced(turn, [*fixed, *(fixed[i] for i in of_constants), *first, *behind])
    condition = traced(
        lambda *numbers: tests(*numbers[: c + n]), [*program.condition.in_avals, *behind]
    )
    # A table of tangents begins with the tangent of what the motion's begins with.
    moved_places = {old: b + k for k, old in enumerate(of_constants)}
    tables = [program.tables[i - n] for i in of_results[len(of_state) :]]
    tangent_tables = [t._replace(start=moved_places.get(t.start)) for t in tables]
    earlier = {i if i < b else i + len(of_constants) for i in program.tangents}
    tangents = earlier | {*range(b, shift), *range(shift + n, shift + n + len(behind))}
    return program._replace(
        condition=condition,
        body=body,
        body_constants=shift,
        tangents=frozenset(tangents),
        motion=program,
        narrow=None,
        tables=(*program.tables, *tangent_tables),
        long=program.long | {n + k for k, i in enumerate(of_state) if i in program.long},
    )


def motion_in(program: Program) -> list[int]:
    """Where, among the results of a loop with tangents, those of the motion alone are."""
    assert program.motion is not None
    state = len(avals_of(program.motion)[1])
    row, behind = len(row_of(program.motion)), len(avals_of(program)[1])
    return [*range(state), *range(behind, behind + row)]


def bundle_tangents(
    program: Program, values: Sequence[Any], dims: Sequence[int | None], rank: int
) -> tuple[Program, list[Any], list[int | None]] | None:
    """The loop that carries several tangents side by side, where these are all that differs.

    Args:
        program: the loop, its condition and body as JAX programs.
        values: its inputs, one axis of which counts tangents.
        dims: this axis in each of the inputs; None: it has none.
        rank: number of batch axes that precede it.

    Returns:
        The loop, its inputs, and the axis of tangents in each result (None: the same for all); None
        where other numbers than tangents differ.
    """
    c, b = program.condition_constants, program.body_constants
    batched = [d is not None for d in dims]
    differing = {i for i, d in enumerate(batched[c:]) if d}
    if any(batched[:c]) or not differing <= program.tangents:
        return None
    moving = moving_state(program, batched[c : c + b], batched[c + b :])
    state = len(values) - c - b
    batched = [*batched[: c + b], *moving[:state]]
    count = samples_in(values, dims)
    narrow = Narrow(program, tuple(batched), moving, count)

    def arranged(value, dim, differs):
        if not differs:
            return value
        if dim is not None:
            return jnp.moveaxis(value, dim, rank)
        lead, rest = np.shape(value)[:rank], np.shape(value)[rank:]
        return jnp.broadcast_to(jnp.expand_dims(value, rank), (*lead, count, *rest))

    arranged_values = [arranged(*each) for each in zip(values, dims, batched, strict=True)]
    # A table has its rows in front of what stands in them.
    axes = [rank + (i >= state) if moves else None for i, moves in enumerate(moving)]
    return widen(narrow, count), arranged_values, axes


def side_by_side(wide: Program, samples: int) -> int:
    """How many of its tangents a kernel takes at once, which goes through so many samples: the
    portions in which these lie are further samples, and least work is wanted, where a tangent is as
    much of it as the motion. All portions are about as large. One, where a loop within has steps of
    its own for every tangent."""
    narrow = wide.narrow
    assert narrow is not None
    most = 1 if batches_loops(wide.body) else min(SIDE_BY_SIDE, narrow.tangents)
    sizes = {-(-narrow.tangents // -(-narrow.tangents // size)) for size in range(1, most + 1)}
    turns = lambda size: -(-samples * -(-narrow.tangents // size) // LANES)
    return min(sorted(sizes), key=lambda size: turns(size) * (1 + size))


def by_portions(values: Sequence[Any], wide: Program, rank: int, size: int, run: Any) -> list[Any]:
    """Results of a loop with many tangents, computed by one that takes fewer at once.

    Args:
        values: inputs of the wide loop.
        wide: loop of all tangents (`bundle_tangents`).
        rank: number of batch axes that precede that of the tangents.
        size: tangents at once.
        run: function `run(values, program, rank)` that evaluates a loop.
    """
    narrow = wide.narrow
    assert narrow is not None
    portions = -(-narrow.tangents // size)
    # The last one stands in for those that the last portion lacks.
    places = np.arange(portions * size).clip(max=narrow.tangents - 1)

    def arranged(i, value, differs):
        if i in wide.shared:
            return value
        if not differs:
            return jnp.broadcast_to(value, (portions, *value.shape))
        value = jnp.moveaxis(value, rank, 0)[places]
        return jnp.moveaxis(value.reshape(portions, size, *value.shape[1:]), 1, 1 + rank)

    pairs = enumerate(zip(values, narrow.batched, strict=True))
    arranged_values = [arranged(i, *each) for i, each in pairs]
    out = run(arranged_values, widen(narrow, size), rank + 1)
    state = len(avals_of(narrow.program)[1])
    results: list[Any] = []
    for place, (part, moves) in enumerate(zip(out, narrow.moving, strict=True)):
        if not moves:
            results.append(part[0])
            continue
        axis = rank + (place >= state)
        ahead = jnp.moveaxis(part, axis + 1, 1)
        ahead = ahead.reshape(-1, *ahead.shape[2:])[: narrow.tangents]
        results.append(jnp.moveaxis(ahead, 0, axis))
    return results


def widen(narrow: Narrow, count: int) -> Program:
    """The loop whose inputs and results that differ have a leading axis of so many tangents."""
    program = narrow.program
    c, b = program.condition_constants, program.body_constants
    axes = [0 if each else None for each in narrow.batched[c:]]
    out_axes = [0 if each else None for each in narrow.moving]
    turns, tests = jaxpr_as_fun(program.body), jaxpr_as_fun(program.condition)

    def wide(aval, axis):
        return jax.ShapeDtypeStruct(
            aval.shape if axis is None else (count, *aval.shape), aval.dtype
        )

    body = traced(
        lambda *numbers: jax.vmap(lambda *row_values: turns(*row_values), axes, out_axes)(*numbers),
        list(map(wide, program.body.in_avals, axes)),
    )
    shapes = [*program.condition.in_avals[:c]]
    shapes += map(wide, program.condition.in_avals[c:], axes[b:])

    def test(*numbers):
        # It reads no tangent: any will do.
        places = [*[None] * c, *axes[b:]]
        any_of = lambda each: jnp.zeros(each.shape[1:], each.dtype)
        return tests(*(n if a is None else any_of(n) for n, a in zip(numbers, places, strict=True)))

    same = narrow if count == narrow.tangents else None
    return program._replace(condition=traced(test, shapes), body=body, motion=None, narrow=same)
