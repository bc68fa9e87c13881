"""How accurately statistics are known: whether means are as was asked, and how far a statistic is
off by what discretises its runs, as pairs of runs of the same samples tell it.

Source: multilevel Monte Carlo: Giles 2008, Oper. Res. 56, 607, doi:10.1287/opre.1070.0496.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from jaxclear.ground.arguments import check_name, check_number
from jaxclear.ground.printing import with_text_repr
from jaxclear.studies.statistics.scrambled import jackknifed, student

# What is asked of each response by name, and whether it is a share of its root mean square.
Goals = tuple[dict[str, float], bool]
# Responses by name (samples,) of some samples, and their scramblings (samples,).
Piece = tuple[dict[str, np.ndarray], np.ndarray]


def parse_accuracy(
    accuracy: Any, responses: tuple[str, ...], owner: str = "monte_carlo"
) -> Goals | None:
    """Required accuracies of means, by response; None for none.

    Args:
        accuracy: one number [1] for all, or numbers in units by response.
        responses: their names.
        owner: function in messages.

    Raises:
        ValueError: a name is unknown, or a number not above 0.
    """
    if accuracy is None:
        return None
    if not isinstance(accuracy, Mapping):
        check_number(f"accuracy of {owner}", accuracy, above=0)
        return dict.fromkeys(responses, float(accuracy)), True
    for name, value in accuracy.items():
        check_name("response", name, responses, " in this problem")
        check_number(f'accuracy of "{name}"', value, above=0)
    return {name: float(value) for name, value in accuracy.items()}, False


def missed_accuracies(request: Goals, pieces: Iterable[Piece]) -> dict[str, tuple[float, float]]:
    """(half of the 95 % interval, what was asked) of each mean that is not known well enough, of a
    sample that comes in pieces."""
    columns: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {name: [] for name in request[0]}
    for responses, group in pieces:
        for name, column in columns.items():
            good = np.isfinite(responses[name])
            column.append((responses[name][good], group[good]))
    short = {}
    for name, target in request[0].items():
        values, group = (np.concatenate(part) for part in zip(*columns[name], strict=True))
        half = jackknifed(np.mean, values, group).error if len(values) > 1 else np.inf
        size = float(np.sqrt(np.mean(values**2))) if request[1] and len(values) else 1.0
        # A response that is always zero is known.
        if not half <= target * size:
            short[name] = half, target * size
    return short


def unreached(short: dict[str, tuple[float, float]]) -> str:
    """A sentence for the means that are not known well enough; "" where all are."""
    if not short:
        return ""
    means = "; ".join(
        f"{name} to {half:.2g}, not {size:.2g}" for name, (half, size) in short.items()
    )
    return f"The accuracy asked is not reached (mean of {means}): allow more samples."


@with_text_repr
class NumericalError(NamedTuple):
    """How far a statistic is off by what discretises its runs, in its unit: told by so many
    `replicas`, it is too large by `bias`, known to ± `uncertainty` (95 %); `sampling` is half of
    the statistic's own 95 % interval, which chance leaves."""

    bias: float
    uncertainty: float
    sampling: float
    replicas: int

    @property
    def error(self) -> float:
        """The largest that it may be."""
        return abs(self.bias) + self.uncertainty

    @property
    def is_resolved(self) -> bool:
        """Whether replicas tell the bias: as well as samples tell the statistic, or from none."""
        return self.uncertainty <= max(self.sampling, abs(self.bias))

    @property
    def whole(self) -> float:
        """Half of the one interval that holds both, sampling and steps; nan where replicas do not
        resolve the bias: two figures then, side by side."""
        return self.sampling + self.error if self.is_resolved else np.nan

    @property
    def wanted(self) -> float:
        """How many replicas would resolve it, about."""
        if self.is_resolved:
            return self.replicas
        if not np.isfinite(self.uncertainty) or self.sampling <= 0:
            return np.inf
        return float(np.ceil(self.replicas * (self.uncertainty / self.sampling) ** 2))

    def __str__(self) -> str:
        if self.is_resolved:
            return f"± {self.whole:.2g} (samples {self.sampling:.2g}, steps {self.error:.2g})"
        return f"± {self.sampling:.2g} (samples). {self.unresolved}"

    @property
    def unresolved(self) -> str:
        """A sentence for a bias that replicas do not resolve."""
        text = (
            f"The error by the steps, {self.bias:.2g} ± {self.uncertainty:.2g} from "
            f"{self.replicas} companion runs, is not resolved"
        )
        more = f"; about {self.wanted:.0f} would resolve it" if np.isfinite(self.wanted) else ""
        return f"{text}{more}."


def bias_of(
    values: np.ndarray,
    finer: np.ndarray,
    share: float,
    statistic: Callable[[np.ndarray], float] = np.mean,
) -> tuple[float, float]:
    """Bias of a statistic by the discretisation of runs, and half of its 95 % interval.

    The interval is that of leaving out one pair after the other; of a mean, Student's of the
    differences.

    Args:
        values: of samples, shape (pairs,).
        finer: of their finer runs, shape (pairs,).
        share: steps of the finer runs over those of the others [1].
        statistic: function of values.
    """
    count = len(values)
    difference = lambda mask: (statistic(values[mask]) - statistic(finer[mask])) / (1 - share)
    bias = float(difference(np.ones(count, bool))) if count else np.nan
    if count < 2:
        return bias, np.inf
    without = np.array([difference(mask) for mask in ~np.eye(count, dtype=bool)])
    half = student(count) * float(without.std(ddof=1)) * (count - 1) / math.sqrt(count)
    return bias, half if np.isfinite(half) else np.inf
