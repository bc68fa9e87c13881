"""Is a kernel right? One turn of its loop on random numbers against NumPy, before it is used.

Each draw has three samples: one of positive numbers alike in size, on which rounding tells most,
and the same with the loop's state, of either sign, small beside its constants and large beside
them. Between these two a comparison of the state with a constant (a place with a clearance) falls
out either way, so that a touching contact is looked at and a parted one.
"""

import ctypes
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from jaxclear.native.by_numpy import evaluator
from jaxclear.native.program import (
    Program,
    Table,
    avals_of,
    changing,
    floats_in,
    in_memory,
    packed,
    packed_state,
    row_of,
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
# Draws that are asked where the first one disagrees, until two of them tell.
SECOND_LOOKS = (1, 2, 3, 4)
# Draws that are asked where none of these tells, their numbers of either sign: a product of several
# matrices of positive numbers is nearly singular (as of many frames one upon the other), and what
# is solved with it is rounding. Two of them must tell.
SIGNED = range(7, 13)
ABSURD = 1e60


def check(program: Program, address: int) -> None:
    """One turn of the kernel at an address on random numbers against NumPy. Raises `Unsupported`
    where they differ.

    Where a difference of like numbers is exactly zero in one order of operations and rounding in
    the other, a choice or a quotient that hangs on it differs wholly. That does not recur: two
    more draws that tell, and no other that disagrees, outweigh it, and a fault shows there too.
    States of either sign may be none that the loop was written for: there one draw that agrees
    outweighs the others.
    """
    turn = evaluator(program.body)
    first, anywhere = _agrees(program, address, turn, 0)
    if all(first) and anywhere:
        return
    looks: list = []
    for draw in SECOND_LOOKS:
        if sum(tells for (_, tells), _ in looks) < 2:
            looks.append(_agrees(program, address, turn, draw))
    agree = all(close for (close, _), _ in looks)
    usual = all(first) or (agree and sum(tells for (_, tells), _ in looks) >= 2)
    if not usual and all(close for (close, _), _ in [(first, anywhere), *looks]):
        found = [_agrees(program, address, turn, draw)[0] for draw in SIGNED]
        close, tell = zip(*found, strict=True)
        usual = all(close) and sum(tell) >= 2
    if not (usual and (anywhere or any(look[1] for look in looks))):
        raise Unsupported("a loop whose kernel does not agree with NumPy")


def _agrees(
    program: Program, address: int, turn: Callable[..., list], draw: int
) -> tuple[tuple[bool, bool], bool]:
    """What `judged` says of the first sample of a draw's random numbers, and whether the kernel
    agrees with NumPy, which goes through a `turn`, on all others."""
    constants, state = avals_of(program)
    samples = random_values(constants, state, draw)
    samples = [_within_tables(program, own) for own in samples]
    found = _one_turn(program, address, samples)

    def by_numpy(sample):
        given = sample[program.condition_constants :]
        out = turn(*given)
        rows = zip(program.tables, out[len(state) :], strict=True)
        return packed([*out, *(_first_row(table, row, given) for table, row in rows)])

    def anywhere(sample):
        try:
            return by_numpy(sample)
        except (Unsupported, ValueError, OverflowError, IndexError):
            # A loop that does not end here, a whole number from nan: no evidence.
            return np.full(found.shape[1], np.nan)

    with jax.ensure_compile_time_eval(), np.errstate(all="ignore"):
        wanted, changed = (
            np.array([by_numpy(own[0]), *map(anywhere, own[1:])])
            for own in (samples, [nudged(sample) for sample in samples])
        )
    first = np.zeros(found.shape)
    before = np.array([packed(s[len(constants) :]) for s in samples])
    first[:, : before.shape[1]] = before
    # What a turn leaves of a long array as it was tells nothing.
    long = np.repeat([i in program.long for i in range(len(state))], list(map(_size, state)))
    asked = np.any((wanted != first) | (found != first), axis=0)
    asked[: len(long)] |= ~long
    parts = [(a[:1, asked], a[1:, asked]) for a in (found, wanted, changed, first)]
    usual, others = (judged(*part) for part in zip(*parts, strict=True))
    return usual, others[0]


def _size(aval: Any) -> int:
    return floats_in([aval])


def _one_turn(program: Program, address: int, samples: list) -> np.ndarray:
    """The state of each sample after one turn by the kernel, the row that this leaves, and the
    first rows of all tables."""
    kept = in_memory(program)
    rows = [packed([v for v, k in zip(s, kept, strict=True) if not k]) for s in samples]
    given = np.ascontiguousarray(rows)
    big = [np.ascontiguousarray([s[i] for s in samples]) for i, k in enumerate(kept) if k]
    out = np.zeros((len(samples), floats_in(packed_state(program))))
    long = [np.zeros((len(samples), _size(aval))) for aval in changing(program)]
    tables = [
        np.zeros((len(samples), table.height, floats_in([aval])))
        for table, aval in _tables(program)
    ]
    big += [*long, *tables]
    data = (ctypes.c_void_p * (1 + len(big)))(given.ctypes.data, *[b.ctypes.data for b in big])
    call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)
    call(address)(ctypes.cast(data, ctypes.c_void_p), out.ctypes.data, len(samples), 1)
    short = np.split(out, np.cumsum(list(map(_size, packed_state(program))))[:-1], axis=1)
    parts = {i: each for each, i in zip(long, sorted(program.long), strict=True)}
    others = (i for i in range(len(avals_of(program)[1])) if i not in program.long)
    parts |= dict(zip(others, short, strict=False))
    last = [parts[i] for i in sorted(parts)]
    return np.hstack([*last, *(rows[:, -1] for rows in tables), *(rows[:, 0] for rows in tables)])


def _tables(program: Program) -> list[tuple[Table, Any]]:
    return list(zip(program.tables, row_of(program), strict=True))


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


def _first_row(table: Table, row: np.ndarray, constants: list[np.ndarray]) -> np.ndarray:
    """What stands in the first row of a table after a turn that leaves this one as the last."""
    if table.height == 1:
        return row
    return np.broadcast_to(0.0 if table.begins is None else constants[table.begins], row.shape)


def random_values(constants: list, state: list, draw: int) -> list[list[np.ndarray]]:
    """For each sample of a draw a value of each shape and type."""
    rng = np.random.default_rng(draw)

    def one(aval):
        if aval.dtype == bool:
            return rng.random(aval.shape) < 0.5
        if np.issubdtype(aval.dtype, np.integer):
            return rng.integers(0, MOST_PLACES, aval.shape).astype(aval.dtype)
        size = rng.uniform(0.1, 1.0, aval.shape)
        return size * (rng.integers(0, 2, aval.shape) * 2 - 1) if draw in SIGNED else size

    known, first = ([np.asarray(one(a)) for a in avals] for avals in (constants, state))
    rng = np.random.default_rng(0)
    signs = [rng.integers(0, 2, value.shape) * 2 - 1 for value in first]

    def resized(size):
        pairs = zip(first, signs, strict=True)
        return [value * size * sign if value.dtype == float else value for value, sign in pairs]

    return [[*known, *(first if size == 1.0 else resized(size))] for size in SIZES]


def nudged(sample: list[np.ndarray]) -> list[np.ndarray]:
    """The same values, each float changed in its last digits, up or down by chance: what cancels
    within an array must not cancel any more."""
    rng = np.random.default_rng(1)

    def nudge(value):
        signs = rng.integers(0, 2, value.shape) * 2 - 1
        return value * (1 + NUDGE * signs) if value.dtype == float else value

    return [nudge(value) for value in sample]


def judged(
    found: np.ndarray, wanted: np.ndarray, changed: np.ndarray, first: np.ndarray
) -> tuple[bool, bool]:
    """Whether a kernel gave what is wanted, as far as `changed` (for nudged numbers) lets one tell,
    and whether half of it tells.

    `first` is what the turn began with: a sum that cancels it rounds like it.
    """
    with np.errstate(all="ignore"):
        # Where numbers overflow, inf or nan is a matter of the order of operations.
        finite = np.isfinite(wanted) & np.isfinite(changed)
        doubt = MARGIN * np.where(finite, np.abs(changed - wanted), np.inf)
        size = np.abs(wanted) + np.abs(first) + AGREEMENT
        # A division by what is exactly zero in one order of operations and rounding in another.
        absurd = np.abs(found) > ABSURD
        close = ~finite | absurd | (np.abs(found - wanted) <= AGREEMENT * size + doubt)
        telling = finite & ~absurd & (doubt <= VAGUE * size)
    return bool(close.all()), bool(telling.mean() >= 0.5)
