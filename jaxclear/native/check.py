"""Is a kernel right? One turn of its loop on random numbers against JAX, operation by operation.

For those who write laws or rules: with JAXCLEAR_CHECK_KERNELS=1 every new kernel is compared
before it is used, and one that disagrees is left to XLA, with a warning. Tests compare the kernels
of every joint on every rung so (tests/native/test_every_rung_has_a_kernel.py).

Each draw has three samples: one of positive numbers alike in size, on which rounding tells most,
and the same with the loop's state, of either sign, small beside its constants and large beside
them. Between these two a comparison of the state with a constant (a place with a clearance) falls
out either way, so that a touching contact is looked at and a parted one.
"""

import ctypes
import os
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr

from jaxclear.native.control import is_an_error
from jaxclear.native.program import (
    Program,
    Table,
    apply,
    arrays_in_memory,
    avals_of,
    floats_in,
    in_memory,
    packed,
    packed_state,
    replay,
    row_of,
    scan_counts,
)
from jaxclear.native.writer import Unsupported

# Largest whole number that is drawn: a place among the rows of a table.
MOST_PLACES = 3
# Two evaluations of the same turn differ by rounding, which the turn may enlarge: a second
# evaluation, its numbers changed by a rounding or two, tells by how much; what it changes by more
# than this share is no evidence.
AGREEMENT, NUDGE, MARGIN, VAGUE = 1e-9, 4e-16, 1e3, 1e-3
# What the state of each sample of a draw is multiplied by; the last two by signs as well, which are
# the same in every draw, and opposite in the two.
SIZES = (1.0, 1e-3, -10.0)
# Draws that are asked until two of them tell; of the last ones numbers are of either sign: a
# product of several matrices of positive numbers is nearly singular (as of many frames one upon the
# other), and what is solved with it is rounding.
DRAWS, SIGNED = range(13), range(7, 13)
ABSURD = 1e60
# Turns after which a loop within the loop is given up.
LONGEST_LOOP = 1000


def is_check_enabled() -> bool:
    """Whether kernels are checked in this process."""
    return os.environ.get("JAXCLEAR_CHECK_KERNELS", "0") not in ("", "0")


# The state of each sample of a draw after one turn, the row that this leaves, and the first rows of
# all tables.
Turn = Callable[[list], np.ndarray]


def check(program: Program, kernel: Turn, reference: Turn, other: str = "JAX") -> None:
    """Compares one turn of a kernel on random numbers with another evaluation of it.

    Where a difference of like numbers is exactly zero in one order of operations and rounding in
    the other, a choice or quotient that depends on it may differ. That does not recur: one draw may
    disagree where two agree conclusively; a fault shows in several. States with entries of either
    sign may be impossible for the loop: among these one draw that agrees outweighs the others.

    Args:
        program: the loop, its condition and body as JAX programs.
        kernel: one turn by machine code: an array (samples, numbers) from a list of samples.
        reference: the same by the other evaluation.
        other: name of the other evaluation in the message.

    Raises:
        Unsupported: they differ.
        Incomparable: random numbers do not tell whether they do.
    """
    looks: list[Judgement] = []
    # How many sizes are looked at: all until samples of the others have agreed once.
    count = len(SIZES)
    for draw in DRAWS:
        usual, others = compared(program, kernel, reference, count, draw)
        looks, count = [*looks, usual], 1 if others else count
        if sum(not look.agrees for look in looks) > 1:
            break
        if looks.count(Judgement(True, True)) >= 2 and count == 1:
            return
    if count == 1 and all(look.agrees for look in looks):
        raise Incomparable(f"a loop that random numbers do not compare with {other}")
    raise Unsupported(f"a loop whose kernel does not agree with {other}")


class Incomparable(Unsupported):
    """Random numbers do not tell whether a kernel is right."""


class Judgement(NamedTuple):
    """Whether a kernel gave what is wanted, as far as that can be told, and whether half of it
    tells."""

    agrees: bool
    is_conclusive: bool


def compared(
    program: Program, kernel: Turn, reference: Turn, count: int, draw: int
) -> tuple[Judgement, bool]:
    """The judgement of a kernel on one draw by samples of usual size, and whether all others agree.

    Args:
        program: the loop, its condition and body as JAX programs.
        kernel, reference: one turn by machine code and by the other evaluation.
        count: how many of `SIZES` are looked at.
        draw: number of the draw, which is its seed.
    """
    constants, state = avals_of(program)
    samples = [_within_tables(program, s) for s in random_values(constants, state, draw)[:count]]
    results, expected = kernel(samples), reference(samples)
    nudged = [nudge_values(sample) for sample in samples]
    first = np.zeros(results.shape)
    before = np.array([packed(s[len(constants) :]) for s in samples])
    first[:, : before.shape[1]] = before
    # What a turn leaves of a long array as it was tells nothing.
    long = [i in program.long for i, aval in enumerate(state) for _ in range(floats_in([aval]))]
    asked = np.any((expected != first) | (results != first), axis=0)
    asked[: len(long)] |= ~np.array(long, bool)
    parts = [a[:, asked] for a in (results, expected, first)]
    judge = lambda own, changed: judge_results(*(p[own] for p in (*parts, changed[:, asked])))
    usual, rest = judge(slice(1), reference(nudged[:1])), slice(1, None)
    # What agrees to rounding agrees however much the turn enlarges that.
    agree = count == 1 or judge(rest, expected).agrees or judge(rest, reference(nudged)).agrees
    return usual, agree


def turn_by_jax(program: Program, samples: list) -> np.ndarray:
    """What a turn gives, by JAX's operations one after the other; nan where those of a sample of
    numbers of either size do not end."""
    state = len(avals_of(program)[1])

    def by_jax(sample):
        body_arguments = sample[program.condition_constants :]
        out = evaluate(program.body, body_arguments)
        rows = zip(program.tables, out[state:], strict=True)
        return packed([*out, *(_first_row(table, row, body_arguments) for table, row in rows)])

    with jax.ensure_compile_time_eval():
        rows = [by_jax(samples[0])]
        for sample in samples[1:]:
            try:
                rows.append(by_jax(sample))
            except Unsupported:
                # A loop that does not end here: no evidence.
                rows.append(np.full(len(rows[0]), np.nan))
    return np.array(rows)


def evaluate(program: ClosedJaxpr, arguments: Sequence[Any]) -> list:
    """A program's results, one of JAX's operations after the other: nothing of the rules, and no
    loop without an end."""
    return replay(program, arguments, _apply_exactly)


def _apply_exactly(equation: Any, inputs: list) -> Sequence[Any]:
    name, p = equation.primitive.name, equation.params
    if name == "cond":
        return evaluate(p["branches"][int(inputs[0])], inputs[1:])
    if name == "scan":
        return _evaluate_scan(p, inputs)
    if name == "while":
        first, second = p["cond_nconsts"], p["cond_nconsts"] + p["body_nconsts"]
        state = inputs[second:]
        for _ in range(LONGEST_LOOP):
            if not evaluate(p["cond_jaxpr"], [*inputs[:first], *state])[0]:
                return state
            state = evaluate(p["body_jaxpr"], [*inputs[first:second], *state])
        raise Incomparable("a loop within the loop that does not end on random numbers")
    if name == "jaxclear_loop" and not p["rank"]:
        # As in a kernel that is checked: one turn.
        return evaluate(p["program"].body, inputs[p["program"].condition_constants :])
    if name == "pure_callback" and is_an_error(p):
        return [jnp.full(v.aval.shape, jnp.nan) for v in equation.outvars]
    return apply(equation, inputs, p)


def _evaluate_scan(p: dict, inputs: list) -> list:
    fixed, carried = scan_counts(p)
    carry, rows, outputs = inputs[fixed:][:carried], inputs[fixed + carried :], []
    for i in range(p["length"])[:: -1 if p["reverse"] else 1]:
        results = evaluate(p["jaxpr"], [*inputs[:fixed], *carry, *[row[i] for row in rows]])
        carry = results[:carried]
        outputs.append(results[carried:])
    outputs = outputs[::-1] if p["reverse"] else outputs
    return [*carry, *[jnp.stack(parts) for parts in zip(*outputs, strict=True)]]


def turn_by_kernel(program: Program, address: int, samples: list) -> np.ndarray:
    """Results of one turn of a compiled kernel, an array (samples, numbers).

    Args:
        program: the loop, its condition and body as JAX programs.
        address: of the kernel's function in this process; it must take one turn only.
        samples: for each the arrays of constants and state.
    """
    is_long = in_memory(program)
    rows = [packed([v for v, k in zip(s, is_long, strict=True) if not k]) for s in samples]
    flat = np.ascontiguousarray(rows)
    big = [np.ascontiguousarray([s[i] for s in samples]) for i, k in enumerate(is_long) if k]
    out = np.zeros((len(samples), floats_in(packed_state(program))))
    long = [np.zeros((len(samples), floats_in([aval]))) for aval in arrays_in_memory(program)]
    tables = [
        np.zeros((len(samples), table.height, floats_in([aval])))
        for table, aval in zip(program.tables, row_of(program), strict=True)
    ]
    big += [*long, *tables]
    data = (ctypes.c_void_p * (1 + len(big)))(flat.ctypes.data, *[b.ctypes.data for b in big])
    call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64)
    call(address)(ctypes.cast(data, ctypes.c_void_p), out.ctypes.data, len(samples))
    short = np.split(out, np.cumsum([floats_in([a]) for a in packed_state(program)])[:-1], axis=1)
    parts = {i: each for each, i in zip(long, sorted(program.long), strict=True)}
    others = (i for i in range(len(avals_of(program)[1])) if i not in program.long)
    parts |= dict(zip(others, short, strict=False))
    last = [parts[i] for i in sorted(parts)]
    return np.hstack([*last, *(rows[:, -1] for rows in tables), *(rows[:, 0] for rows in tables)])


def _within_tables(program: Program, sample: list[np.ndarray]) -> list[np.ndarray]:
    """The sample where its turn is one of the loop's, and leaves the last row of every table."""
    if not program.length:
        return sample
    constants, out = len(avals_of(program)[0]), list(sample)
    out[constants] = np.minimum(out[constants], np.asarray(program.length - 1))
    for table in program.tables:
        i = program.condition_constants + table.places
        out[i] = np.full_like(out[i], table.height - 1)
    return out


def _first_row(table: Table, row: Any, constants: list[np.ndarray]) -> Any:
    """What stands in the first row of a table after a turn that leaves this one as the last."""
    if table.height == 1:
        return row
    return np.broadcast_to(0.0 if table.start is None else constants[table.start], row.shape)


def random_values(constants: list, state: list, draw: int) -> list[list[np.ndarray]]:
    """Random values for each sample of a draw, of every size in `SIZES`.

    Args:
        constants, state: shapes and types of the loop's inputs.
        draw: number of the draw; those in `SIGNED` have entries of either sign.
    """
    rng = np.random.default_rng(draw)

    def one(aval):
        if aval.dtype == bool:
            return rng.random(aval.shape) < 0.5
        if np.issubdtype(aval.dtype, np.integer):
            return rng.integers(0, MOST_PLACES, aval.shape).astype(aval.dtype)
        size = rng.uniform(0.1, 1.0, aval.shape)
        return size * (rng.integers(0, 2, aval.shape) * 2 - 1) if draw in SIGNED else size

    fixed_values, first = ([np.asarray(one(a)) for a in avals] for avals in (constants, state))
    rng = np.random.default_rng(0)
    signs = [rng.integers(0, 2, value.shape) * 2 - 1 for value in first]

    def resized(size):
        pairs = zip(first, signs, strict=True)
        return [value * size * sign if value.dtype == float else value for value, sign in pairs]

    return [[*fixed_values, *(first if size == 1.0 else resized(size))] for size in SIZES]


def nudge_values(sample: list[np.ndarray]) -> list[np.ndarray]:
    """The same values, each float changed in its last digits, up or down by chance: what cancels
    within an array must not cancel any more."""
    rng = np.random.default_rng(1)

    def nudge(value):
        signs = rng.integers(0, 2, value.shape) * 2 - 1
        return value * (1 + NUDGE * signs) if value.dtype == float else value

    return [nudge(value) for value in sample]


def judge_results(
    results: np.ndarray, expected: np.ndarray, first: np.ndarray, changed: np.ndarray
) -> Judgement:
    """Whether results agree with the expected ones, and whether half of them are conclusive.

    Args:
        results: of the kernel, shape (samples, numbers).
        expected: of the reference, same shape.
        first: values before the turn: a sum that cancels them rounds as they do.
        changed: of the reference for slightly changed inputs, which measures rounding.
    """
    with np.errstate(all="ignore"):
        # Where numbers overflow, inf or nan is a matter of the order of operations.
        finite = np.isfinite(expected) & np.isfinite(changed)
        doubt = MARGIN * np.where(finite, np.abs(changed - expected), np.inf)
        size = np.abs(expected) + np.abs(first) + AGREEMENT
        # A division by what is exactly zero in one order of operations and rounding in another.
        absurd = np.abs(results) > ABSURD
        close = ~finite | absurd | (np.abs(results - expected) <= AGREEMENT * size + doubt)
        telling = finite & ~absurd & (doubt <= VAGUE * size)
    return Judgement(bool(close.all()), bool(telling.mean() >= 0.5))
