"""Which limits take infinite responses, such as lives that outlast what is followed.

Where a search or a verification works with numbers, an infinite response is a finite one beyond all
others and beyond the `levels` that decide. That is right for a limit that only asks on which side
of its levels parts lie. Others are refused before anything is run: those that name no levels, and
those to which it makes a difference how far beyond them a part lies.
"""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxclear.studies.design.abstract_limit import AbstractLimit, Sample
from jaxclear.studies.endless import check_told, finite_beside

__all__ = ["SAME", "check_levels"]

# A unit by which to see whether a limit's number has that of its response.
SAME = "the response's unit"
# What lies so many times as far beyond a limit's levels is the same to it, but for rounding. Levels
# that are none (a share that bounds a limit) may be far smaller than those that decide.
FAR, ROUNDING = 1e12, 1e-6
# Parts of a population that a limit is tried on, and of how many the others lie beyond: a quantile
# may lie between these and the rest in one of both populations, not in both.
PARTS, BEYOND = 64, (4, 16)


def check_levels(problem: Any, limit: AbstractLimit) -> None:
    """Raises `ValueError` for a limit that cannot take what its response may answer."""
    name, levels = limit.response, [float(level) for level in limit.levels()]
    why = problem.endless(name)
    what = f'"{name}" may be infinite ({why}), and limit.{type(limit).__name__}'
    instead = "give it `levels`, or take limit.Quantile or limit.Probability."
    if why and not levels and not limit.by_moments():
        raise ValueError(
            f"{what} names no values of it that decide, beyond which an infinite one could stand: "
            f"{instead}"
        )
    check_told(problem, name, *levels)
    if not why or limit.by_moments():
        return
    if _hangs_on_how_far(limit, levels, problem.told_up_to(name)):
        told = ", ".join(f"{level:.6g}" for level in levels)
        raise ValueError(
            f"{what} hangs on how far beyond its `levels` ({told}) a value lies, which of an "
            f"infinite one nobody knows: {instead}"
        )


def _hangs_on_how_far(limit: AbstractLimit, levels: list[float], most: float) -> bool:
    """Whether parts far beyond all levels of a limit are another thing to it than those just beyond
    them, or than those at the `most` that is told, which stand for infinite ones."""
    low, beside = min(levels), float(finite_beside(np.array([np.inf]), *levels)[0])
    far = beside + FAR * (beside - low)
    below = low - 0.5 * (beside - low)
    # The most that is told is on no side of a level that lies just there.
    for near in (beside, most) if max(levels) < most < np.inf else (beside,):
        if _broken(limit, near) != _broken(limit, far):
            return True
        if all(_moved(limit, [_mixed(below, own, few) for own in (near, far)]) for few in BEYOND):
            return True
    return False


def _broken(limit: AbstractLimit, value: float) -> bool:
    """Whether a population whose parts all lie at a value breaks a limit."""
    sample = _mixed(value, value, 0)
    return bool(limit.excess(sample) > ROUNDING * limit.size(sample))


def _moved(limit: AbstractLimit, samples: list[Sample]) -> bool:
    """Whether the number of a limit is another one for the second of two samples; one that lies
    beyond all levels in both is told as infinite."""
    near, far = (float(limit.number(sample)) for sample in samples)
    if math.isclose(near, far, rel_tol=ROUNDING):
        return False
    alike = limit.unit(SAME) == SAME
    return not (alike and min(near, far) >= max(float(level) for level in limit.levels()))


def _mixed(most: float, others: float, few: int) -> Sample:
    """A population at one value, but for a few of its parts, which lie at another above it."""
    values = jnp.where(jnp.arange(PARTS) < few, others, most)
    return Sample(values, jnp.full(PARTS, 1.0 / PARTS), jnp.array([most, others]))
