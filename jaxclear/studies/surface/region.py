"""Where a surface is fitted: over the variables' own spread, a wider one, or ranges of some."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy

from jaxclear.ground.arguments import check_known, check_number
from jaxclear.studies.base import AbstractProblem
from jaxclear.studies.surface.drawing import all_values, scrambled_normal

NUMBER = (int, float, np.integer, np.floating)
# So many times the spread of the variables, or ranges by name.
Region = float | Mapping[str, tuple[float, float]]


def drawn(problem: AbstractProblem, runs: int, over: Region, seed: int) -> np.ndarray:
    """Values (runs, variables) that fill a region."""
    rng = np.random.default_rng(seed)
    normal = scrambled_normal(runs, len(problem.names), rng)
    wide = normal if isinstance(over, Mapping) else over * normal
    values = all_values(problem, wide)
    for name, (low, high) in (over if isinstance(over, Mapping) else {}).items():
        share = scipy.special.ndtr(normal[:, problem.names.index(name)])
        values[:, problem.names.index(name)] = low + (high - low) * share
    return values


def check_region(problem: AbstractProblem, over: Any) -> None:
    """What a surface may be fitted over."""
    if not isinstance(over, Mapping):
        check_number("over of surface (or ranges by name)", over, above=0)
        return
    for name, own in over.items():
        check_known("variable", name, problem.names, " in this problem")
        pair = isinstance(own, (tuple, list)) and len(own) == 2
        if (
            not pair
            or not all(isinstance(x, NUMBER) and np.isfinite(x) for x in own)
            or own[0] >= own[1]
        ):
            raise ValueError(
                f'over["{name}"] of surface is {own!r}; it must be two finite numbers, low and '
                "high."
            )
