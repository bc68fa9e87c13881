"""Limits of responses, and the share of parts that keep them."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from jaxclear.ground.arguments import check_known, check_number, expect
from jaxclear.ground.wording import described
from jaxclear.studies.statistics.scrambled import Statistic, share

# (low, high) of a response in its unit, None for no limit.
Limits = tuple[float | None, float | None]


def check_limits(limits: Any, responses: Iterable[str]) -> None:
    """Raises `ValueError` with a sentence for limits that are none."""
    expect(limits, Mapping, "limits", "a dictionary from responses to (low, high)")
    for name, pair in limits.items():
        check_known("response", name, responses, " in this study")
        if not isinstance(pair, (tuple, list)) or len(pair) != 2 or tuple(pair) == (None, None):
            raise ValueError(
                f'the limits of "{name}" are {described(pair)}; they must be two numbers, (low, '
                "high), with None in place of one of them where there is no limit."
            )
        for value in pair:
            if value is not None:
                check_number(f'a limit of "{name}"', value)
        if None not in pair and not pair[0] < pair[1]:
            raise ValueError(
                f'the limits of "{name}" are {described(pair)}; low is not below high.'
            )


def within(values: np.ndarray, limits: Limits) -> np.ndarray:
    """Whether each of the values (samples,) keeps its limits."""
    low, high = limits
    inside = np.ones(len(values), bool)
    if low is not None:
        inside &= values >= low
    if high is not None:
        inside &= values <= high
    return inside


def yield_of(
    responses: Mapping[str, np.ndarray],
    limits: Mapping[str, Limits],
    failed: np.ndarray,
    group: np.ndarray,
) -> Statistic:
    """Share of samples that keep all limits. Failed ones are unknown: outside at the lower end of
    the interval, inside at its upper."""
    inside = np.all([within(responses[name], pair) for name, pair in limits.items()], axis=0)
    good = np.setdiff1d(np.arange(len(group)), failed)
    told = share(inside[good], group[good])
    if not len(failed):
        return told
    kept = len(good) / len(group)
    return Statistic(told.value, told.low * kept, told.high * kept + 1.0 - kept)
