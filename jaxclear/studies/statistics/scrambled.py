"""Statistics of a response with the error that its independent scramblings tell.

Means, standard deviations and all that is made of them are taken from the whole sample, and their
error from leaving out one scrambling after the other (a jackknife of groups): right for correlated
points within a scrambling, for smooth functions of means. The interval of a quantile is that of the
share of samples below it, read off as quantiles (Woodruff). All intervals are Student's, 95 %;
where contributions are skewed, as squares are, the farther end is moved by what skewness adds. Few
scramblings tell of it less than all samples, where their contributions are known.

Source: jackknife of groups: Miller 1974, Biometrika 61, 1, doi:10.1093/biomet/61.1.1; skewness:
Johnson 1978, J. Am. Stat. Assoc. 73, 536, doi:10.1080/01621459.1978.10480051, to second order Hall
1983, Ann. Stat. 11, 569, doi:10.1214/aos/1176346162; quantiles: Woodruff 1952, J. Am. Stat. Assoc.
47, 635, doi:10.1080/01621459.1952.10483443; smooth ones: Harrell & Davis 1982, Biometrika 69, 635,
doi:10.1093/biomet/69.3.635; shares of which few samples tell: Clopper & Pearson 1934, Biometrika
26, 404, doi:10.1093/biomet/26.4.404.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import equinox as eqx
import numpy as np
import scipy

from jaxclear.ground.printing import in_digits, with_error, with_text_repr

# A 95 % interval leaves half of 5 % on each side.
CONFIDENCE = 0.95
# Contributions that differ by less than this share of themselves are one number.
ROUNDING = 1e-12
# Samples for each coefficient of a polynomial that takes up what it explains of them.
SAMPLES_A_TERM = 6
# Of an error budget, beside its variables.
REST = "remainder (not linear)"


@with_text_repr
class Statistic(eqx.Module):
    """A statistic of a response: its `value`, and the 95 % interval from `low` to `high`, in the
    statistic's `unit` ("": not told); infinite where the sample is too small to bound it. A row of
    three numbers to whoever takes it apart."""

    value: float
    low: float
    high: float
    unit: str = eqx.field(static=True, default="")

    @property
    def error(self) -> float:
        """How far the farther end of the interval is away."""
        if np.isinf(self.value):
            return np.inf
        return max(self.high - self.value, self.value - self.low)

    def in_unit(self, unit: str) -> "Statistic":
        """The same with its unit told."""
        return Statistic(self.value, self.low, self.high, unit)

    def __iter__(self) -> Iterator[float]:
        return iter((self.value, self.low, self.high))

    def __str__(self) -> str:
        unit = "" if self.unit in ("", "1") else f" {self.unit}"
        ends = [float(end) for end in self]
        if np.isfinite(self.low) != np.isfinite(self.high):
            interval_text = (
                f"at least {self.low:.6g}" if np.isfinite(self.low) else f"at most {self.high:.6g}"
            )
            return f"{ends[0]:.6g}{unit} (95 %: {interval_text})"
        value, low, high = ends
        if low >= 0 and high <= 1 and not self.error <= value <= 1 - self.error:
            # The farther end laid to the other side would leave what the statistic may be.
            texts = [in_digits(end, high - low, 3) for end in ends]
            return f"{texts[0]}{unit} (95 %: {texts[1]} to {texts[2]})"
        return f"{with_error(value, float(self.error))}{unit}"


UNKNOWN = Statistic(np.nan, np.nan, np.nan)


def student(groups: float) -> float:
    """Half the width of a 95 % interval in standard errors, which come from so many groups."""
    return (
        float(scipy.special.stdtrit(groups - 1, 0.5 + 0.5 * CONFIDENCE)) if groups > 1 else np.inf
    )


def half_width(parts: np.ndarray) -> float:
    """Half of the 95 % interval of the mean of independent contributions (parts,)."""
    return student(len(parts)) * float(parts.std(ddof=1)) / np.sqrt(len(parts))


def standard_error(
    statistic: Callable[[np.ndarray], float], values: np.ndarray, group: np.ndarray
) -> tuple[float, int]:
    """Standard error of a statistic, and the number of scramblings from which it is.

    Args:
        statistic: function of values.
        values: shape (samples,).
        group: scrambling of each sample.
    """
    parts = pseudo_values(lambda mask: statistic(values[mask]), group)
    count = len(parts)
    return float(parts.std(ddof=1) / np.sqrt(count)) if count > 1 else np.nan, count


def pseudo_values(statistic: Callable[[np.ndarray], Any], group: np.ndarray) -> np.ndarray:
    """Contributions (scramblings,) to a statistic of a selection (samples,) of the sample: their
    mean is the statistic without its first-order bias (jackknife)."""
    present = np.unique(group)
    count, estimate = len(present), statistic(np.ones(len(group), bool))
    if count < 2:
        return np.array([estimate] * count)
    without = np.array([statistic(group != label) for label in present])
    return count * estimate - (count - 1) * without


def jackknifed(
    statistic: Callable[..., float],
    values: np.ndarray,
    group: np.ndarray,
    contributions: np.ndarray | None = None,
    grouped: bool = False,
) -> Statistic:
    """A smooth function of means over the sample, with its interval.

    Args:
        statistic: function of values, and of scramblings where `grouped`.
        values: shape (samples,) or (samples, columns).
        group: scrambling of each sample.
        contributions: of samples to the statistic, to a factor and a summand, shape (samples,), as
            those to a mean are; None: unknown.
        grouped: whether the function takes the scramblings as well.
    """
    if len(values) < 2:
        return UNKNOWN
    of = statistic if grouped else lambda values, group: statistic(values)
    value = float(of(values, group))
    parts = pseudo_values(lambda mask: of(values[mask], group[mask]), group)
    if len(parts) < 2 or not np.all(np.isfinite(parts)):
        return Statistic(value, -np.inf, np.inf)
    below, above = half_widths(parts, values if statistic is np.mean else contributions)
    return Statistic(value, value - below, value + above)


def half_widths(parts: np.ndarray, contributions: np.ndarray | None = None) -> tuple[float, float]:
    """How far the ends of the 95 % interval of the mean of contributions of scramblings (parts,)
    lie below and above it, by their skewness: what few of them show beyond what normal ones would,
    to first order (Johnson), and what the `contributions` (samples,) of all samples do, which show
    it better, to second (Hall), as of parts with a gamma distribution; even points are taken to be
    as skewed as independent ones."""
    count, spread, half = len(parts), float(parts.std(ddof=1)), half_width(parts)
    # What differs by rounding only has no shape.
    if spread <= ROUNDING * abs(float(parts.mean())) or count < 3:
        return half, half
    times = student(count)

    def far(skewness: float) -> float:
        return half + abs(skewness) * spread * (2 * times**2 + 1) / (6 * count)

    chance = 6 * count * (count - 1) / ((count - 2) * (count + 1) * (count + 3))
    skewness = skewness_of(parts) * np.sqrt((count - 1) * count) / (count - 2)
    end = far(np.sqrt(max(skewness**2 - chance, 0.0)))
    below, above = (half, end) if skewness > 0 else (end, half)
    if contributions is None or len(contributions) < 3:
        return below, above
    if contributions.std() <= ROUNDING * abs(float(contributions.mean())):
        return below, above
    skewness = skewness_of(contributions) * np.sqrt(count / len(contributions))
    z = float(scipy.special.ndtri(0.5 + 0.5 * CONFIDENCE))
    # 11/72: 5/18 by the square of skewness, less 1/8 by a gamma distribution's kurtosis.
    end = far(skewness) + 11 / 72 * skewness**2 * z * (z**2 + 2) * spread / count**1.5
    return (below, max(above, end)) if skewness > 0 else (max(below, end), above)


def skewness_of(numbers: np.ndarray) -> float:
    """Skewness [1] of numbers, of which not all are the same."""
    away = numbers - numbers.mean()
    return float(np.mean(away**2 * away) / np.mean(away**2) ** 1.5)


def contributions_to_moments(values: np.ndarray, deviations: float) -> np.ndarray:
    """Contributions (samples,) to the mean of values plus so many standard deviations."""
    spread = float(values.std())
    away = values - values.mean()
    return values + deviations * away**2 / (2 * spread) if spread > 0 else values


def deviation_of_moments(
    first: np.ndarray, second: np.ndarray, extra_variance: float = 0.0
) -> tuple[float, float]:
    """A standard deviation and half of its 95 % interval, from contributions to two moments.

    Squares of means are products of different scramblings, so that the variance has no bias.

    Args:
        first, second: contributions to the moments about one place, shape (scramblings,).
        extra_variance: variance of further parts of the second moment.
    """
    count = len(first)

    def variance(mask):
        one, n = first[mask], int(mask.sum())
        return second[mask].mean() - (one.sum() ** 2 - (one**2).sum()) / (n * (n - 1))

    full, each = variance(np.ones(count, bool)), np.arange(count)
    half = max(half_widths(pseudo_values(variance, each)))
    half = float(np.hypot(half, student(count) * np.sqrt(extra_variance)))
    root = float(np.sqrt(max(full, 0.0)))
    return root, half / (2 * root) if root > 0 else np.inf


def covariance(rows: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Covariance (columns, columns) of `rows` (samples, columns) whose scramblings are `group`
    (samples,), without bias.

    The moments about a sample's mean are too small by the variance of that mean. This is taken from
    the means of the scramblings: 1/n of the variance for independent samples (the usual n - 1), far
    less for quasi-random ones. A single scrambling counts as independent samples.
    """
    away = rows - rows.mean(axis=0)
    place, sizes = np.unique(group, return_inverse=True, return_counts=True)[1:]
    count = len(sizes)
    if count < 2:
        return away.T @ away / (len(rows) - 1)
    sums = np.zeros((count, rows.shape[1]))
    np.add.at(sums, place, away)
    of_mean = sums.T @ sums * count / (count - 1) / len(rows) ** 2
    return away.T @ away / len(rows) + of_mean


def deviation(values: np.ndarray, group: np.ndarray) -> float:
    """Standard deviation of a sample whose scramblings are `group` (samples,), nan of fewer than
    two."""
    return float(np.sqrt(covariance(values[:, None], group)[0, 0])) if len(values) > 1 else np.nan


def ordinary_quantile(values: np.ndarray, share: float) -> float:
    """The value that a share [1] of the responses does not exceed; infinite where one of the two
    samples that it lies between is.

    Source: definition 7 of Hyndman & Fan 1996, Am. Stat. 50, 361, doi:10.2307/2684934.
    """
    ends = [float(np.quantile(values, share, method=method)) for method in ("lower", "higher")]
    if np.all(np.isfinite(ends)):
        return float(np.quantile(np.where(np.isfinite(values), values, ends[1]), share))
    return next(end for end in ends[::-1] if not np.isfinite(end))


def quantile(values: np.ndarray, group: np.ndarray, share: float) -> Statistic:
    """The value that a share of the responses does not exceed, with its interval.

    Args:
        values: shape (samples,).
        group: scrambling of each sample.
        share: [1].
    """
    count = len(values)
    if count < 2:
        return UNKNOWN
    value = ordinary_quantile(values, share)
    below = (values <= value).astype(float)
    error, groups = standard_error(np.mean, below, group)
    half = student(groups) * error if np.isfinite(error) else np.inf
    # One sample more on each side: what lies between two of them is not seen.
    ordered = np.concatenate([[-np.inf], np.sort(values), [np.inf]])
    low, high = (share - half) * count, (share + half) * count + 1
    places = [int(np.floor(np.clip(low, 0, count))), int(np.ceil(np.clip(high, 1, count + 1)))]
    return Statistic(value, float(ordered[places[0]]), float(ordered[places[1]]))


def smooth_quantile(values: np.ndarray, share: float) -> float:
    """The value that a share [1] of the responses does not exceed, as a mean of all of them in
    their order, weighed by how likely each is to be it: where a single sample would jump from one
    to the next, and a jackknife of it tells nothing, this is smooth (Harrell & Davis)."""
    count = len(values)
    edges = np.arange(count + 1) / count
    weights = np.diff(scipy.special.betainc(share * (count + 1), (1 - share) * (count + 1), edges))
    return float(weights @ np.sort(values))


def share(inside: np.ndarray, group: np.ndarray) -> Statistic:
    """The share [1] of samples that are `inside` (samples,), with its interval.

    Where fewer samples are inside, or outside, than there are scramblings, their differences tell
    too little, and the interval is that of independent samples, which is wider.
    """
    count = len(inside)
    if count == 0:
        return UNKNOWN
    k, value = int(inside.sum()), float(inside.mean())
    groups = len(np.unique(group))
    if groups < 2 or min(k, count - k) < groups:
        tail = 0.5 * (1 - CONFIDENCE)
        low = scipy.special.betaincinv(k, count - k + 1, tail) if k else 0.0
        high = scipy.special.betaincinv(k + 1, count - k, 1 - tail) if k < count else 1.0
        return Statistic(value, float(low), float(high))
    statistic = jackknifed(np.mean, inside.astype(float), group)
    return Statistic(value, max(statistic.low, 0.0), min(statistic.high, 1.0))


def capability(low: float | None, high: float | None) -> Callable[..., float]:
    """Cpk [1] of a sample between limits: distance of the mean from the nearer limit, in three
    standard deviations."""

    def of(values: np.ndarray, group: np.ndarray) -> float:
        mean, spread = values.mean(), 3.0 * deviation(values, group)
        rooms = [mean - low] if low is not None else []
        rooms += [high - mean] if high is not None else []
        return float(min(rooms) / spread) if spread > 0 else np.inf

    return of


def error_budget(
    values: np.ndarray, responses: np.ndarray, group: np.ndarray, groups: Mapping[str, Any]
) -> dict[str, Statistic]:
    """Parts of the variance of a response by variable, the rest last; they sum to the variance.

    A plane through the responses has a slope by every variable; slope times deviation, squared, is
    that variable's part. The rest holds curvature, interactions and chaos. Of correlated variables
    a part holds half of what each pair shares, and may be negative.

    Args:
        values: of the variables, shape (samples, variables).
        responses: shape (samples,).
        group: scrambling of each sample.
        groups: columns of the numbers of each variable.
    """

    def part(which: list[int]) -> Any:
        return lambda rows, group: _parts(rows, group)[which].sum()

    rows = np.column_stack([responses, values])
    of = {name: list(cols) for name, cols in groups.items()} | {REST: [values.shape[1]]}
    return {name: jackknifed(part(cols), rows, group, grouped=True) for name, cols in of.items()}


def _parts(rows: np.ndarray, group: np.ndarray) -> np.ndarray:
    responses, values = rows[:, 0] - rows[:, 0].mean(), rows[:, 1:] - rows[:, 1:].mean(axis=0)
    slopes = np.linalg.lstsq(values, responses, rcond=None)[0]
    matrix = covariance(rows, group) if len(rows) > 1 else np.zeros((rows.shape[1],) * 2)
    shares = slopes * (matrix[1:, 1:] @ slopes)
    return np.append(shares, matrix[0, 0] - shares.sum())
