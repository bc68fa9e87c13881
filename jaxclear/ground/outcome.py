"""How something that a compiled program does can end: numbers while it runs, sentences when a user
reads them.

Why a derivative is no number: a nan that carries its reason.

A nan has 51 bits that nobody reads, and arithmetic hands them on: through sums, products and
choices, through `jax.jit`, `jax.grad` and kernels. So the reason needs no place in a result, and
costs nothing. Processors of CPUs keep these bits; accelerators may not, and the reason is then one
of all (`Unknown.SOMEHOW`).
"""

import enum
from typing import Any

import jax
import numpy as np


class AbstractOutcome(enum.IntEnum):
    """A family of outcomes of a compiled program.

    Each member is a number, which the program compares, and has a `sentence`.
    """

    sentence: str

    def __new__(cls, code: int, sentence: str = ""):
        member = int.__new__(cls, code)
        member._value_ = code
        member.sentence = sentence
        return member


# The bits of a quiet nan, and behind them a word by which such a nan is told from any other; its
# reason is in the last bits.
QUIET, WORD, REASON = 0x7FF8 << 48, 0x4A43 << 32, 0xFFFF


class Unknown(AbstractOutcome):
    """Reasons why a derivative is nan."""

    SOMEHOW = (
        0,
        "it is not a number, and where that was found has been lost: impacts have made its error "
        "grow, or steps do not resolve it. Take shorter steps or a tighter rtol, or "
        "jaxclear.sensitivity.",
    )
    STEPS_DECIDE = (
        1,
        "in steps of another length it is another, or none: take shorter steps or a tighter rtol, "
        "or, where surfaces wear, more saving times, at which they are updated.",
    )
    GROWN = (
        2,
        "impacts have made its error grow beyond what the steps determine: take a tighter rtol or "
        "shorter steps, a shorter run, or jaxclear.sensitivity.",
    )
    UNRESOLVED = (
        3,
        "the steps that it asks for are too many or too short: allow Adaptive more max_steps, or "
        "take jaxclear.sensitivity.",
    )
    PARTED = (
        4,
        "the run is off the motion by more than 3 % of the narrowest gap, as numerical dissipation "
        "or long steps make it: take shorter steps, or ImplicitStep(rebound=1.0).",
    )
    NOT_FOLLOWED = (
        5,
        "this integrator does not follow how instants and rates of touches move: take "
        "integrator.Adaptive().",
    )
    AT_ONCE = (
        6,
        "contacts strike at once in a step that would not move alike, or the run ends before it "
        "takes an impact that is due: take shorter steps or another end.",
    )
    AT_LIMIT = (
        7,
        "the integral of a controller stands still at its torque limit, and how that instant moves "
        "is not followed: give it a period, or no torque_limit, or take jaxclear.sensitivity.",
    )

    NOT_REACHED = (
        8,
        "the run ended before the instant whose derivative it is; its result says why.",
    )

    @property
    def number(self) -> np.float64:
        """The nan that carries this reason in its bits."""
        return np.uint64(QUIET | WORD | self.value).view(np.float64)


def explain_nan(derivatives: Any) -> str:
    """The reasons why derivatives are nan.

    Args:
        derivatives: what `jax.jvp`, `jax.jacfwd` or `jax.grad` of a run or a `Problem` returned: an
            array, or a pytree of arrays.

    Returns:
        A sentence for each reason; "" where no number is nan.
    """
    reasons: dict[Unknown, None] = {}
    for leaf in jax.tree.leaves(derivatives):
        leaf = np.asarray(leaf)
        if leaf.dtype == np.float64:
            bits = np.unique(leaf[np.isnan(leaf)].view(np.uint64))
            reasons |= dict.fromkeys(map(_reason_of_bits, bits.tolist()))
    return " ".join(f"{each.sentence[0].upper()}{each.sentence[1:]}" for each in reasons)


def _reason_of_bits(bits: int) -> Unknown:
    has_reason = (bits & (REASON << 32)) == WORD and (bits & REASON) in set(Unknown)
    return Unknown(bits & REASON) if has_reason else Unknown.SOMEHOW
