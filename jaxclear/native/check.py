"""Is a kernel right? One turn of its loop on random numbers against NumPy, before it is used."""

import ctypes

import jax
import numpy as np

from jaxclear.native.by_numpy import evaluator
from jaxclear.native.program import Program, avals_of, floats_in, in_memory, packed
from jaxclear.native.writer import Unsupported

# Two evaluations of the same turn differ by rounding, which the turn may enlarge: a second
# evaluation, its numbers changed by a rounding or two, tells by how much; what it changes by more
# than this share is no evidence.
AGREEMENT, NUDGE, MARGIN, VAGUE = 1e-9, 4e-16, 1e3, 1e-3
SAMPLES = 3
# Draws that are asked where the first one disagrees.
SECOND_LOOKS = (1, 2)
ABSURD = 1e60


def check(program: Program, address: int) -> None:
    """One turn of the kernel at an address on random numbers against NumPy. Raises `Unsupported`
    where they differ.

    Where a difference of like numbers is exactly zero in one order of operations and rounding in
    the other, a choice or a quotient that hangs on it differs wholly. That does not recur: two
    more draws that agree outweigh it, and a fault shows there too.
    """
    if _agrees(program, address, 0):
        return
    if not all(_agrees(program, address, draw) for draw in SECOND_LOOKS):
        raise Unsupported("a loop whose kernel does not agree with NumPy")


def _agrees(program: Program, address: int, draw: int) -> bool:
    """Whether the kernel agrees with NumPy on the random numbers of a draw."""
    constants, state = avals_of(program)
    samples = random_values([*constants, *state], draw)
    found = _one_turn(program, address, samples)
    turn_of = evaluator(program.body)

    def by_numpy(sample):
        return packed(turn_of(*sample[program.condition_constants :]))

    with jax.ensure_compile_time_eval(), np.errstate(all="ignore"):
        wanted = np.array([by_numpy(s) for s in samples])
        changed = np.array([by_numpy(nudged(s)) for s in samples])
    first = np.array([packed(s[len(constants) :]) for s in samples])
    return agree(found, wanted, changed, first)


def _one_turn(program: Program, address: int, samples: list) -> np.ndarray:
    """The state of each sample after one turn by the kernel."""
    kept = in_memory(program)
    rows = [packed([v for v, k in zip(s, kept, strict=True) if not k]) for s in samples]
    given = np.ascontiguousarray(rows)
    big = [np.ascontiguousarray([s[i] for s in samples]) for i, k in enumerate(kept) if k]
    out = np.zeros((len(samples), floats_in(avals_of(program)[1])))
    data = (ctypes.c_void_p * (1 + len(big)))(given.ctypes.data, *[b.ctypes.data for b in big])
    call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)
    call(address)(ctypes.cast(data, ctypes.c_void_p), out.ctypes.data, len(samples), 1)
    return out


def random_values(avals: list, draw: int) -> list[list[np.ndarray]]:
    """For each sample of a draw a value of each shape and type."""
    rng = np.random.default_rng(draw)

    def one(aval):
        if aval.dtype == bool:
            return rng.random(aval.shape) < 0.5
        if np.issubdtype(aval.dtype, np.integer):
            return rng.integers(0, 3, aval.shape).astype(aval.dtype)
        return rng.uniform(0.1, 1.0, aval.shape)

    return [[np.asarray(one(a)) for a in avals] for _ in range(SAMPLES)]


def nudged(sample: list[np.ndarray]) -> list[np.ndarray]:
    """The same values, each float changed in its last digits, up or down by chance: what cancels
    within an array must not cancel any more."""
    rng = np.random.default_rng(1)

    def nudge(value):
        signs = rng.integers(0, 2, value.shape) * 2 - 1
        return value * (1 + NUDGE * signs) if value.dtype == float else value

    return [nudge(value) for value in sample]


def agree(found: np.ndarray, wanted: np.ndarray, changed: np.ndarray, first: np.ndarray) -> bool:
    """Whether a kernel gave what is wanted, as far as `changed` (for nudged numbers) lets one tell;
    half must tell.

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
    return bool(close.all() and telling.mean() >= 0.5)
