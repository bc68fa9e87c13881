"""Whether means are known as accurately as was asked."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from jaxclear.ground.arguments import check_known, check_number
from jaxclear.studies.statistics.scrambled import jackknifed

# What is asked of each response by name, and whether it is a share of its root mean square.
Asked = tuple[dict[str, float], bool]
# Responses by name (samples,) of some samples, and their scramblings (samples,).
Piece = tuple[dict[str, np.ndarray], np.ndarray]


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


def told(asked: Asked, pieces: Iterable[Piece]) -> dict[str, tuple[float, float]]:
    """(half of the 95 % interval, what was asked) of each mean that is not known well enough, of a
    sample that comes in pieces, one in memory at a time."""
    sums = {name: np.zeros((3, 0)) for name in asked[0]}
    for responses, group in pieces:
        sums = {name: _added(own, responses[name], group) for name, own in sums.items()}
    short = {}
    for name, wanted in asked[0].items():
        parts = sums[name].T[sums[name][0] > 0]
        half = jackknifed(_mean, parts, np.arange(len(parts))).error if len(parts) > 1 else np.inf
        count, _, squares = parts.sum(axis=0)
        size = float(np.sqrt(squares / count)) if asked[1] and count else 1.0
        # A response that is always zero is known.
        if not half <= wanted * size:
            short[name] = half, wanted * size
    return short


def _added(sums: np.ndarray, values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Number, sum and sum of squares (3, scramblings) of a response, and those of more samples:
    finite values (samples,) of scramblings `group` (samples,)."""
    good = np.isfinite(values)
    more, place = values[good], group[good]
    width = max(sums.shape[1], int(place.max(initial=-1)) + 1)
    known = np.pad(sums, ((0, 0), (0, width - sums.shape[1])))
    # What is known comes first: all is added in the order of the samples, whatever the pieces.
    place = np.concatenate([np.arange(width), place])
    pairs = zip(known, (np.ones_like(more), more, more**2), strict=True)
    return np.stack([np.bincount(place, np.concatenate(pair), width) for pair in pairs])


def _mean(parts: np.ndarray) -> float:
    """Mean of all samples whose sums are in these rows (scramblings, 3)."""
    return float(parts[:, 1].sum() / parts[:, 0].sum())


def unreached(short: dict[str, tuple[float, float]]) -> str:
    """A sentence for the means that are not known well enough; "" where all are."""
    if not short:
        return ""
    means = "; ".join(
        f"{name} to {half:.2g}, not {size:.2g}" for name, (half, size) in short.items()
    )
    return f"The accuracy asked is not reached (mean of {means}): allow more samples."
