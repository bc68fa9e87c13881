"""When a machine will be worn out, from what records at different times told of it:
`jaxclear.remaining_life`.

Wear at a steady load goes in proportion to the cycles (Archard 1953, J. Appl. Phys. 24, 981): the
clearance grows along a straight line, whose slope only records at different times tell. The band of
the cycle at which it reaches its limit is that of all lines which the records' intervals allow.
"""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import numpy as np
import scipy

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_number, expect
from jaxclear.studies.answer import AbstractAnswer, Column, Stated
from jaxclear.studies.identification.result import Identified

# Lines that the records allow, drawn.
DRAWS = 20_000
# A straight line that is right is doubted once in a thousand times.
DOUBTED = 1e-3


class RemainingLife(AbstractAnswer):
    """The growth of an unknown and the cycle at which it reaches its limit. `name` and `unit` of
    the unknown, `limit` in that unit; `rate` (draws,) [unit a cycle] and `failure` (draws,)
    [cycles] of the lines that the records allow (inf: it does not grow); `cycles` (records,) at
    which it was measured, `values` and `deviations` (records,) in its unit; `level` [1] of the
    bands."""

    name: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    limit: float = eqx.field(static=True)
    level: float = eqx.field(static=True)
    cycles: np.ndarray
    values: np.ndarray
    deviations: np.ndarray
    rate: np.ndarray
    failure: np.ndarray
    warnings: tuple[str, ...] = eqx.field(static=True, default=())

    def band(self, what: np.ndarray) -> tuple[float, float, float]:
        """Median and ends of the band of draws (draws,)."""
        half = 0.5 * (1.0 - self.level)
        shares = (0.5, half, 1.0 - half)
        # The ends themselves, and not what is between: some lines never reach the limit.
        ends = np.quantile(what, shares, method="inverted_cdf")
        return float(ends[0]), float(ends[1]), float(ends[2])

    @property
    def failure_band(self) -> tuple[float, float, float]:
        """Cycle of failure: median and ends of the band."""
        return self.band(self.failure)

    @property
    def remaining(self) -> tuple[float, float, float]:
        """Cycles left after the last record: median and ends of the band."""
        middle, low, high = self.band(np.maximum(self.failure - self.cycles[-1], 0.0))
        return middle, low, high

    def sentence(self) -> str:
        """Growth, cycle of failure and what is left, in words."""
        words = lambda values: [f"{x:.3g}" if np.isfinite(x) else "no end" for x in values]
        share = f"{100 * self.level:g} %"
        rate, low, high = words(self.band(self.rate))
        ends, first, last = words(self.failure_band)
        life = words(self.remaining)
        return (
            f"{self.name} grows by {rate} {self.unit} a cycle, {low} to {high} with {share}, and "
            f"reaches {self.limit:.4g} {self.unit} after {ends} cycles, {first} to "
            f"{last}: {life[1]} to {life[2]} are left after the last of {len(self.cycles)} records."
        )

    def _stated(self):
        over = ("record",)
        columns = {
            "cycles": Column(over, self.cycles, "1"),
            self.name: Column(over, self.values, self.unit, error=1.96 * self.deviations),
        }
        numbers = {"limit": self.limit}
        numbers |= dict(zip(("failure", "low", "high"), self.failure_band, strict=True))
        return Stated("remaining life", columns, None, self.warnings, numbers)


@answering
def remaining_life(
    fits: Mapping[float, Identified], name: str, limit: float, *, level: float = 0.9, seed: int = 0
) -> RemainingLife:
    """The cycle at which an unknown that grows steadily reaches its limit.

    Growth is proportional to the cycles and positive. Errors of records are independent; an error
    that all share cancels in the growth.

    Args:
        fits: answers of `jaxclear.identify` by the number of cycles that the machine had run, two
            at least.
        name: name of the unknown, such as "clearance B".
        limit: value at which the machine is worn out, in the unit of the unknown.
        level: probability of the bands [1], between 0 and 1; 0.9 by default.
        seed: seed of their draws; 0 by default.

    Returns:
        The `RemainingLife`.

    Raises:
        ValueError: if an argument is wrong.
    """
    expect(fits, Mapping, "fits of remaining_life", "a dictionary from cycles to answers")
    if len(fits) < 2:
        raise ValueError(
            f"remaining_life is given {len(fits)} records; growth takes two at least, at "
            "different cycles."
        )
    for cycles, answers in fits.items():
        check_number("cycles of remaining_life", cycles, at_least=0)
        expect(answers, Identified, "what a record told", "what jaxclear.identify returns")
    check_number("limit of remaining_life", limit)
    check_number("level of remaining_life", level, above=0, below=1)
    order = sorted(fits)
    rows = [fits[cycles][name] for cycles in order]
    values = np.array([unknown.estimate for unknown in rows])
    deviations = np.array([_deviation_of(fits[cycles], name) for cycles in order])
    rate, failure, misfit = _draw_lines(np.array(order, float), values, deviations, limit, seed)
    warnings = []
    chi2 = float(scipy.stats.chi2.isf(DOUBTED, max(len(order) - 2, 1)))
    if len(order) > 2 and misfit > chi2:
        warnings.append(
            f"{name} does not grow along a straight line: the squares of what is left of it are "
            f"{misfit:.3g} beside their intervals', where {chi2:.3g} is the most; the band does "
            "not hold a growth that speeds up."
        )
    if not all(unknown.verdict == "identified" for unknown in rows):
        warnings.append(f"{name} is not identified by every record: the prior decides, too.")
    fields = (np.array(order, float), values, deviations, rate, failure)
    return RemainingLife(name, rows[0].unit, float(limit), float(level), *fields, tuple(warnings))


def _deviation_of(identified: Identified, name: str) -> float:
    if name in identified.problem.names:
        samples = identified.posterior_values[:, identified.problem.names.index(name)]
        return float(samples.std())
    row: Any = identified[name]
    return (row.high - row.low) / 3.92


def _draw_lines(
    cycles: np.ndarray, values: np.ndarray, deviations: np.ndarray, limit: float, seed: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Slopes and cycles of failure of lines that rise, drawn from what weighted least squares
    leave, and the squares of what is left beside the deviations."""
    middle, length = cycles.mean(), np.ptp(cycles)
    design = np.stack([np.ones_like(cycles), (cycles - middle) / length], axis=1)
    weighted = design / deviations[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    best = covariance @ weighted.T @ (values / deviations)
    misfit = float(np.sum(((values - design @ best) / deviations) ** 2))
    rng = np.random.default_rng(seed)
    drawn = rng.multivariate_normal(best, covariance, DRAWS)
    rising = drawn[:, 1] > 0
    drawn = drawn[rising] if rising.any() else np.abs(drawn)
    slope = drawn[:, 1] / length
    with np.errstate(over="ignore"):
        failure = middle + (limit - drawn[:, 0]) / slope
    return slope, np.maximum(failure, 0.0), misfit
