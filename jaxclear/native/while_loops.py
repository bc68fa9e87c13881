"""Loops as a user of this room writes them: `while_loop` in the place of `jax.lax.while_loop`,
functions as loops of one turn, and the loops that a library has written."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

from jaxclear.native.loop import loop_p
from jaxclear.native.program import Program, Table, apply, constants_first, loops_marked, replay
from jaxclear.native.writer import LONGEST_IN_REGISTERS


def while_loop(
    condition: Callable[[Any], Any],
    body: Callable[[Any], Any],
    first: Any,
    long: Any = False,
    single_turn: bool = False,
    vmapped: bool = False,
    resumed: bool = False,
) -> Any:
    """As `jax.lax.while_loop`, for a state of few numbers; forward-mode differentiable and batched.

    Args:
        condition, body: functions of the state; the body keeps its shapes and types.
        first: initial state, a pytree of arrays.
        long: prefix of the state, true where arrays may be long; these stand in memory and are
            read and
            changed by index; after a change the previous array can no longer be read.
        single_turn: whether it is a function, a loop of one turn.
        vmapped: whether XLA gets it as if this module had not been used, where it becomes no
            kernel.
        resumed: whether the loop around it takes it up again where the condition still holds, so
            that samples of a kernel need not wait for the last of them.
    """
    in_memory = _leaves_in_memory(long, first)
    first = jax.tree.map(jnp.asarray, first)
    leaves, structure = jax.tree.flatten(first)
    tests, fixed_tests = open_constants(jax.make_jaxpr(condition)(first))
    turns, fixed_turns = open_constants(jax.make_jaxpr(body)(first))
    if [(a.shape, a.dtype) for a in turns.out_avals] != [(v.shape, v.dtype) for v in leaves]:
        raise TypeError(
            f"the body of a loop must keep shapes and types: {leaves} became {turns.out_avals}."
        )
    program = Program(tests, turns, len(fixed_tests), len(fixed_turns), single_turn, long=in_memory)
    program = program._replace(vmapped=vmapped, resumed=resumed)
    out = loop_p.bind(*fixed_tests, *fixed_turns, *leaves, program=program, rank=0)
    return jax.tree.unflatten(structure, out)


def _leaves_in_memory(long: Any, first: Any) -> frozenset[int]:
    """Which leaves of a state stand in memory."""
    wide = jax.tree.map(lambda flag, part: [flag] * len(jax.tree.leaves(part)), long, first)
    pairs = zip(jax.tree.leaves(wide), jax.tree.leaves(first), strict=True)
    sizes = ((flag, np.size(each)) for flag, each in pairs)
    return frozenset(i for i, (flag, n) in enumerate(sizes) if flag and n > LONGEST_IN_REGISTERS)


def as_kernel(function: Callable, *numbers: Any, vmapped: bool = False) -> Any:
    """A function of few numbers as a kernel: a loop of one turn. Differentiable as the function is;
    where there is no kernel, samples of a batch are gone through one after the other, or
    (`vmapped`) as XLA goes through any other function.
    """
    traced = jax.jit(function)
    shapes = jax.eval_shape(traced, *numbers)
    nothing = jax.tree.map(lambda each: jnp.zeros(each.shape, each.dtype), shapes)
    turn = lambda carry: (carry[0] + 1, traced(*numbers))
    first = jnp.zeros((), int), nothing
    return while_loop(lambda carry: carry[0] < 1, turn, first, single_turn=True, vmapped=vmapped)[1]


class TableLayout(NamedTuple):
    """How a part of what turns leave is kept: that of each turn at one of `places`, in a table of
    so many rows as the largest of these within `height`, where each place is somebody's; from
    `height` on a turn's part goes nowhere. `start`: what stands in row 0 from the start."""

    places: np.ndarray
    height: int
    start: Any = None


def scan(
    turn: Callable[[Any, Any], tuple],
    first: Any,
    rows: Any,
    layouts: Sequence[TableLayout] = (),
    long: Any = False,
) -> tuple[Any, Any]:
    """As `jax.lax.scan(turn, first, rows)`, for a state and rows of few numbers, as one kernel.

    Loops within the turns are part of the kernel. Forward-mode differentiable, maps over batches.

    Args:
        turn: function of the state and a row; gives the new state and its outputs.
        first: initial state, a pytree of arrays.
        rows: pytree of arrays with a row for each turn along the first axis.
        layouts: at which rows each part of the outputs is stored; empty: turn after turn.
        long: as of `while_loop`.
    """
    length = len(jax.tree.leaves(rows)[0])
    tables = jax.tree.map(_memory_table, rows)
    places = [_memory_table(each.places) for each in layouts] or [_memory_table(np.arange(length))]
    starts = [jax.tree.map(jnp.asarray, jax.tree.leaves(each.start)) for each in layouts]
    for each in layouts:
        _check_layout(each, length)
    parts_in_memory = _leaves_in_memory((False, long), (0, first))
    first = jax.tree.map(jnp.asarray, (0, first))
    form: list[Any] = []

    def body(fixed_arrays, carry):
        index, state = carry
        row = jax.tree.map(
            lambda each, like: each[index].astype(jnp.asarray(like).dtype), tables, rows
        )
        state, outputs = turn(state, row)
        leaves, structure = jax.tree.flatten(outputs)
        parts = [len(jax.tree.leaves(part)) for part in outputs] if layouts else [len(leaves)]
        form.append((structure, parts))
        return (index + 1, state), leaves

    leaves, structure = jax.tree.flatten(first)
    tests, _ = open_constants(jax.make_jaxpr(lambda carry: carry[0] < length)(first))
    turns, fixed = open_constants(jax.make_jaxpr(body)((places, starts), first))
    shape, parts = form[0]
    fixed_arrays = jax.tree.leaves((places, starts))
    heights = [each.height for each in layouts] or [length]
    tables_out = _make_tables(parts, heights, [len(each) for each in starts] or [0], len(fixed))
    fixed = [*fixed, *fixed_arrays]
    body_of_all = loops_marked(turns, within=True)
    program = Program(tests, body_of_all, 0, len(fixed), length=length, tables=tables_out)
    program = program._replace(long=parts_in_memory)
    out = loop_p.bind(*fixed, *leaves, program=program, rank=0)
    _, last = jax.tree.unflatten(structure, out[: len(leaves)])
    return last, jax.tree.unflatten(shape, out[len(leaves) :])


def _check_layout(layout: TableLayout, length: int) -> None:
    """Raises `ValueError` for a table that is none, or that is not filled; a kernel would write a
    place below 0 into another array's memory."""
    places = np.asarray(layout.places)
    if layout.height < 1:
        raise ValueError(f"a table of a scan has {layout.height} rows; it needs one at least.")
    if places.shape != (length,) or not np.issubdtype(places.dtype, np.integer):
        raise ValueError(f"a table of a scan of {length} turns needs a whole number for each.")
    if np.any(places < 0):
        raise ValueError("a table of a scan has places below 0.")
    taken = {*places, *([] if layout.start is None else [0])}
    if not taken >= set(range(layout.height)):
        raise ValueError("a table of a scan has rows that no turn leaves.")


def _memory_table(table: Any) -> Any:
    """A table as floats that a kernel reads from memory, however short: an entry of registers is
    chosen among all of them."""
    beyond = max(0, LONGEST_IN_REGISTERS + 1 - len(table))
    by = np if isinstance(table, np.ndarray) else jnp
    filled = by.zeros((beyond, *np.shape(table)[1:]))
    return jnp.asarray(by.concatenate([by.asarray(table, float), filled]))


def _make_tables(
    parts: Sequence[int], heights: Sequence[int], starts: Sequence[int], ahead: int
) -> tuple[Table, ...]:
    """The table of each array that turns leave, where so many arrays are in each of the parts, as
    many or none of which have `starts`: behind so many constants stand their places, then these."""
    out, start = [], ahead + len(parts)
    for k, (count, height, first) in enumerate(zip(parts, heights, starts, strict=True)):
        out += [Table(height, ahead + k, start + i if first else None) for i in range(count)]
        start += first
    return tuple(out)


def with_fast_loops(function: Callable) -> Callable:
    """The function, its outermost `jax.lax.while_loop`s run as by `while_loop`: for the loops that
    a library writes.
    """

    def wrapped(*arguments):
        leaves, structure = jax.tree.flatten(arguments)
        structures: dict[str, Any] = {}

        def flat(*values):
            out, structures["structure"] = jax.tree.flatten(
                function(*jax.tree.unflatten(structure, values))
            )
            return out

        flat_program = jax.make_jaxpr(flat)(*leaves)
        program = constants_first(flat_program)
        fast = jax.custom_jvp(lambda *values: replay(program, values, _loops_bound))
        fast.defjvp(lambda values, tangents: jax.jvp(jaxpr_as_fun(program), values, tangents))
        return jax.tree.unflatten(structures["structure"], fast(*flat_program.consts, *leaves))

    return wrapped


def _loops_bound(equation: Any, inputs: list) -> Sequence[Any]:
    p = equation.params
    if equation.primitive.name != "while":
        return apply(equation, inputs, p)
    counts = p["cond_nconsts"], p["body_nconsts"]
    program = Program(p["cond_jaxpr"], p["body_jaxpr"], *counts)
    return loop_p.bind(*inputs, program=program, rank=0)


def open_constants(program: ClosedJaxpr) -> tuple[ClosedJaxpr, list]:
    """Constants that are not yet known as leading arguments, and these; known numbers stay
    inside."""
    pairs = list(zip(program.jaxpr.constvars, program.consts, strict=True))
    inline = [p for p in pairs if not isinstance(p[1], jax.core.Tracer) and _is_inline(p[1])]
    others = [p for p in pairs if not any(p[0] is k[0] for k in inline)]
    jaxpr = program.jaxpr.replace(
        constvars=[k[0] for k in inline], invars=[*[o[0] for o in others], *program.jaxpr.invars]
    )
    return ClosedJaxpr(jaxpr, [k[1] for k in inline]), [o[1] for o in others]


def _is_inline(constant: Any) -> bool:
    """Whether the text of a kernel holds a constant: few numbers, and places in arrays."""
    is_integer = np.issubdtype(constant.dtype, np.integer)
    return bool(is_integer or np.size(constant) <= LONGEST_IN_REGISTERS)
