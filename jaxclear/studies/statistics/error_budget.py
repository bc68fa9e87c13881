"""What each variable contributes to the variance of a response, from a Monte Carlo sample alone.

A plane through the responses has a slope by every variable; slope times deviation, squared, is that
variable's part of the variance. What no plane explains (curvature, interplay, chaos) stands beside
them. Of correlated variables a part holds half of what each pair shares, and may be negative.
"""

from typing import Any

import numpy as np

from jaxclear.studies.statistics.scrambled import Statistic, jackknifed

REST = "what no plane explains"


def error_budget(
    values: np.ndarray, responses: np.ndarray, group: np.ndarray, names: tuple[str, ...]
) -> dict[str, Statistic]:
    """Parts of the variance [response's unit squared] by variable, of `values` (samples,
    variables) and `responses` (samples,), the rest last; they sum to the variance."""

    def part(which: int) -> Any:
        return lambda rows: _parts(rows)[which]

    rows = np.column_stack([responses, values])
    return {name: jackknifed(part(i), rows, group) for i, name in enumerate([*names, REST])}


def _parts(rows: np.ndarray) -> np.ndarray:
    responses, values = rows[:, 0] - rows[:, 0].mean(), rows[:, 1:] - rows[:, 1:].mean(axis=0)
    slopes = np.linalg.lstsq(values, responses, rcond=None)[0]
    free = max(len(rows) - 1, 1)
    covariance = values.T @ values / free
    own = slopes * (covariance @ slopes)
    return np.append(own, responses @ responses / free - own.sum())
