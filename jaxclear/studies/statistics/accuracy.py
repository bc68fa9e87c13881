"""Whether means are known as accurately as was asked."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxclear.ground.arguments import check_known, check_number
from jaxclear.studies.statistics.scrambled import jackknifed

# What is asked of each response by name, and whether it is a share of its root mean square.
Asked = tuple[dict[str, float], bool]


def asked_of(accuracy: Any, responses: tuple[str, ...], owner: str = "monte_carlo") -> Asked | None:
    """What a user asks of the means. Raises `ValueError` with a sentence."""
    if accuracy is None:
        return None
    if not isinstance(accuracy, Mapping):
        check_number(f"accuracy of {owner}", accuracy, above=0)
        return dict.fromkeys(responses, float(accuracy)), True
    for name, wanted in accuracy.items():
        check_known("response", name, responses, " in this problem")
        check_number(f'accuracy of "{name}"', wanted, above=0)
    return {name: float(wanted) for name, wanted in accuracy.items()}, False


def told(
    asked: Asked, responses: dict[str, np.ndarray], group: np.ndarray
) -> dict[str, tuple[float, float]]:
    """(half of the 95 % interval, what was asked) of each mean that is not known well enough."""
    short = {}
    for name, wanted in asked[0].items():
        good = np.isfinite(responses[name])
        values = responses[name][good]
        half = jackknifed(np.mean, values, group[good]).error
        size = float(np.sqrt(np.mean(values**2))) if asked[1] and len(values) else 1.0
        # A response that is always zero is known.
        if not half <= wanted * size:
            short[name] = half, wanted * size
    return short


def unreached(short: dict[str, tuple[float, float]]) -> str:
    """A sentence for the means that are not known well enough; "" where all are."""
    if not short:
        return ""
    means = "; ".join(
        f"{name} to {half:.2g}, not {size:.2g}" for name, (half, size) in short.items()
    )
    return f"The accuracy asked is not reached (mean of {means}): allow more samples."
