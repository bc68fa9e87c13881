"""A record explained by the signal itself: where the unknowns' signals are nearest to it, and what
the record leaves of their prior.

The posterior is tempered: a residual that is alike over t samples makes every t samples one, so
that a model which misses a record by more than its noise is not believed to the last digit. With a
known noise the sum of squares must be what that noise makes; if it is not, no interval is told.

Source: likelihoods to a power, Bissiri, Holmes & Walker 2016, J. R. Stat. Soc. B 78, 1103,
doi:10.1111/rssb.12158; the time scale of correlated samples, Thiébaux & Zwiers 1984, J. Clim. Appl.
Meteorol. 23, 800; where to end its sum, Geyer 1992, Stat. Sci. 7, 473, doi:10.1214/ss/1177011137.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jax.scipy.special import ndtr

from jaxclear.studies.identification.forward import (
    Forward,
    Record,
    answered,
    check_signals,
)
from jaxclear.studies.identification.least_squares import Optimum, optima, starts_of
from jaxclear.studies.identification.posterior import (
    LEAST,
    Draws,
    importance_sampled,
    shortest_interval,
    weighted_quantile,
)

# A noise is known to within this share of it: its power, and what is left of a record, to twice.
NOISE_TOLERANCE = 0.2
# One right model in a thousand is refused.
REFUSED = 1e-3
# Of a signal whose noise is not known, shares of its deviation: no instrument leaves less than the
# first, and beyond the last its mean would explain it better.
LEAST_MISFIT, MOST_MISFIT = 1e-6, 1.1
# Shares below and above which half of the rest of 95 % lies.
ENDS = (0.025, 0.975)
# Places that the sampling of the posterior begins about.
MOST_CENTRES = 3


class Misfit(NamedTuple):
    """What is left of one signal. `size`: root mean square, in its unit; `share` [1] of the
    signal's own deviation, or of its value where it is constant; `time`: samples that one
    independent sample is worth; `chi2` [1]: mean
    square over that of the noise, and `limit`, the largest that the noise explains; nan where the
    noise is not known; `samples`, how many there are."""

    size: float
    share: float
    time: float
    chi2: float
    limit: float
    samples: int

    @property
    def explained(self) -> bool:
        """Whether the noise explains what is left, as far as it is known."""
        return not self.chi2 > self.limit


class CredibleInterval(NamedTuple):
    """A median, the ends of a 95 % interval, a standard deviation, and the ends of the prior's
    interval, all in the unit of what they are of."""

    value: float
    low: float
    high: float
    deviation: float
    prior_low: float
    prior_high: float

    @property
    def width(self) -> float:
        """Of the interval, beside the prior's [1]."""
        prior = self.prior_high - self.prior_low
        return (self.high - self.low) / prior if prior > 0 else np.nan


class SignalFit(NamedTuple):
    """What one record tells by one model. `best` (variables,): the nearest values; `misfits` by
    signal; `values` (draws, variables) and `responses` (draws,) by name follow the posterior with
    `weights` [1]; `unknowns` and `answers`, their intervals by name; `together`: correlations
    [1] of the unknowns' normal scores, by pair; `refusal`: why there are no intervals, "" where
    there are."""

    best: np.ndarray
    row: np.ndarray
    misfits: dict[str, Misfit]
    values: np.ndarray
    weights: np.ndarray
    responses: dict[str, np.ndarray]
    unknowns: dict[str, CredibleInterval]
    answers: dict[str, CredibleInterval]
    together: dict[tuple[str, str], float]
    runs: int
    refusal: str = ""


def fit_signal(
    forward: Forward,
    record: Record,
    *,
    starts: int = 8,
    windows: int = 1,
    draws: int = 512,
    seed: int = 0,
) -> SignalFit:
    """The posterior of a problem's unknowns given a record of its signals.

    `starts`: places that searches begin at, the nominal values among them; `windows`: how often
    each search's window doubles until it holds the record; `draws`: runs of a round of the
    posterior's sampling. Where no search ends at an optimum, where a known noise does not explain
    what is left, or where the draws are too few, `refusal` says so in a sentence, and there are no
    intervals. Raises `ValueError` where signals and problem do not fit together."""
    check_signals(forward, record)
    begin = starts_of(starts, len(forward.problem.names), seed)
    scale = _first_scale(record)
    candidates = optima(forward, record, begin, scale, windows)
    if not candidates:
        return _refused(forward, record, None, _NOT_FINITE)
    # What the nearest leaves tells how much each sample is worth; then once more from there.
    misfits = _misfits(record, candidates[0])
    scale = _scale(record, misfits)
    # As many rows as before run the same program.
    again = np.resize([optimum.normal for optimum in candidates[:MOST_CENTRES]], begin.shape)
    candidates = optima(forward, record, again, scale) or candidates[:MOST_CENTRES]
    best = candidates[0]
    misfits = _misfits(record, best)
    refusal = _refusal(best, misfits)
    if refusal:
        return _refused(forward, record, best, refusal)
    sampled = _sampled(forward, record, candidates, misfits, draws, seed)
    return _make_fit(forward, record, best, misfits, sampled)


def correlation_time(residual: np.ndarray) -> float:
    """Samples (at least 1) that one independent sample of a residual (n,) is worth:
    1 + 2 (sum of its autocorrelations until the first that is not positive)."""
    centred = np.asarray(residual, float) - np.mean(residual)
    count, power = len(centred), centred @ centred
    if count < 2 or power <= 0.0:
        return 1.0
    # Twice as long with zeros, so that the transform's circle does not close.
    spectrum = np.abs(np.fft.rfft(centred, 2 * count)) ** 2
    correlation = np.fft.irfft(spectrum, 2 * count)[:count] / power
    ends = np.flatnonzero(correlation <= 0.0)
    last = ends[0] if len(ends) else count
    return float(1.0 + 2.0 * correlation[1:last].sum())


_NOT_FINITE = (
    "no start gave signals and derivatives that are finite; narrow the distributions of the "
    'unknowns, or ask how="statistics", which takes no derivatives.'
)


def _first_scale(record: Record) -> np.ndarray:
    """Before anything is fitted: the noise, or a tenth of the signal's own deviation."""
    scales = [
        np.full(len(signal), record.noise.get(name) or 0.1 * (np.std(signal) or 1.0))
        for name, signal in record.signals.items()
    ]
    return np.concatenate(scales)


def _misfits(record: Record, best: Optimum) -> dict[str, Misfit]:
    misfits = {}
    for name, part in zip(record.names, record.parts, strict=True):
        residual, noise = best.residual[part], record.noise.get(name)
        square, count = float(np.mean(residual**2)), len(residual)
        chi2 = limit = np.nan
        if noise is not None:
            chi2 = square / noise**2
            tolerance = (1.0 + NOISE_TOLERANCE) ** 2
            limit = tolerance * float(scipy.stats.chi2.isf(REFUSED, count)) / count
        share = np.sqrt(square) / _size(record.signals[name])
        time = min(correlation_time(residual), float(count))
        misfits[name] = Misfit(float(np.sqrt(square)), float(share), time, chi2, limit, count)
    return misfits


def _size(signal: np.ndarray) -> float:
    """Of a signal: by how much it varies, and where it is constant, its value."""
    return float(np.std(signal) or np.max(np.abs(signal)) or 1.0)


def _scale(record: Record, misfits: dict[str, Misfit]) -> np.ndarray:
    """Standard deviation with which each sample counts: larger where neighbours say the same."""
    scales = []
    for name, signal in record.signals.items():
        misfit, noise = misfits[name], record.noise.get(name)
        size = noise if noise is not None else max(misfit.size, 0.1 * LEAST_MISFIT * _size(signal))
        scales.append(np.full(len(signal), size * np.sqrt(misfit.time)))
    return np.concatenate(scales)


def _refusal(best: Optimum, misfits: dict[str, Misfit]) -> str:
    """Why no interval is told; "" where nothing is against it."""
    for name, fit in misfits.items():
        if not fit.explained:
            return (
                f'no values within the distributions explain the signal "{name}": what is left is '
                f"{fit.chi2:.3g} times what its noise makes, where {fit.limit:.3g} is the most. "
                'Another law may; how="statistics" asks less of it.'
            )
        if np.isnan(fit.chi2) and fit.share < LEAST_MISFIT:
            return (
                f'the signal "{name}" is explained to {fit.share:.1g} of itself, as none is that '
                "an instrument showed, so that what is left tells no noise; give its sensor one."
            )
        if np.isnan(fit.chi2) and fit.share > MOST_MISFIT:
            return (
                f'no values within the distributions explain the signal "{name}": what is left is '
                f"{fit.share:.3g} times what it varies by, so that its mean explains it better. "
                "Wider distributions may, or another law."
            )
    if not best.converged:
        return (
            "no search ended at an optimum, so that no interval is told; give more starts, or ask "
            'how="statistics".'
        )
    return ""


def _refused(forward: Forward, record: Record, best: Optimum | None, why: str) -> SignalFit:
    names = forward.problem.names
    if best is None:
        values, row, misfits = np.full(len(names), np.nan), record.row * np.nan, {}
    else:
        values = np.asarray(forward.problem.inputs.values(best.normal))
        row, misfits = record.row + best.residual, _misfits(record, best)
    none = np.zeros((0, len(names)))
    return SignalFit(values, row, misfits, none, np.zeros(0), {}, {}, {}, {}, 0, why)


class _Sample(NamedTuple):
    draws: Draws
    values: np.ndarray
    responses: dict[str, np.ndarray]
    runs: int


def _sampled(
    forward: Forward,
    record: Record,
    optima: list[Optimum],
    misfits: dict[str, Misfit],
    draws: int,
    seed: int,
) -> _Sample:
    """Draws from the tempered posterior, begun about the optima."""
    inputs, names = forward.problem.inputs, list[str]()
    measured, nearest = record.row, optima[0].residual

    def target(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows, responses = answered(forward, np.asarray(inputs.values(normal)))
        residuals = rows - measured
        density = -0.5 * np.sum(normal**2, axis=1)
        for name, part in zip(record.names, record.parts, strict=True):
            square, noise = np.sum(residuals[:, part] ** 2, axis=1), record.noise.get(name)
            worth = misfits[name].time
            if noise is None:
                # Of a noise of any size, all equally likely on a logarithmic scale.
                least = max(float(np.sum(nearest[part] ** 2)), np.finfo(float).tiny)
                density = density - 0.5 * (part.stop - part.start) / worth * np.log(square / least)
            else:
                density = density - 0.5 * square / (noise**2 * worth)
        names[:] = responses
        answer_rows = np.array(list(responses.values())).reshape(len(names), len(residuals)).T
        return np.where(np.isfinite(density), density, -np.inf), answer_rows

    scale = _scale(record, misfits)
    matrices = [np.linalg.inv(fit.information(scale)) for fit in optima]
    sample = importance_sampled(target, [fit.normal for fit in optima], matrices, draws, seed)
    values = np.asarray(inputs.values(sample.normal))
    responses = dict(zip(names, sample.extras.T, strict=True))
    return _Sample(sample, values, responses, len(values))


def _make_fit(
    forward: Forward, record: Record, best: Optimum, misfits: dict[str, Misfit], sample: _Sample
) -> SignalFit:
    """Intervals of what was sampled."""
    problem, weights = forward.problem, sample.draws.weights
    if sample.draws.effective < LEAST:
        return _refused(
            forward,
            record,
            best,
            f"{len(weights)} draws are worth {sample.draws.effective:.0f} of equal weight, too few "
            'for an interval; give more draws, or ask how="statistics".',
        )
    scores = np.asarray(problem.inputs.scores(sample.draws.normal))
    shares = np.asarray(ndtr(scores))
    unknowns = {
        name: _interval_of_unknown(problem, i, shares[:, i], sample.values[:, i], weights)
        for i, name in enumerate(problem.names)
    }
    answers = {}
    for name, response in sample.responses.items():
        middle, low, high = (weighted_quantile(response, weights, x) for x in (0.5, *ENDS))
        prior = (weighted_quantile(response, sample.draws.prior_weights, x) for x in ENDS)
        answers[name] = CredibleInterval(middle, low, high, _deviation(response, weights), *prior)
    values = np.asarray(problem.inputs.values(best.normal))
    return SignalFit(
        values,
        record.row + best.residual,
        misfits,
        sample.values,
        weights,
        sample.responses,
        unknowns,
        answers,
        _correlations(problem.names, scores, weights),
        sample.runs,
    )


def _interval_of_unknown(problem, place, shares, values, weights) -> CredibleInterval:
    low, high = shortest_interval(shares, weights)
    distribution, nominal = problem.inputs.distributions[place], float(problem.nominal()[place])
    at = lambda share: nominal + float(distribution.quantile(share))
    inside = lambda share, extreme: at(share) if np.isfinite(at(share)) else extreme
    ends = inside(low, values.min()), inside(high, values.max())
    median = weighted_quantile(values, weights, 0.5)
    return CredibleInterval(median, *ends, _deviation(values, weights), *map(at, ENDS))


def _deviation(values: np.ndarray, weights: np.ndarray) -> float:
    mean = weights @ values
    return float(np.sqrt(weights @ (values - mean) ** 2))


def _correlations(names, scores, weights) -> dict[tuple[str, str], float]:
    residuals = scores - weights @ scores
    matrix = residuals.T @ (weights[:, None] * residuals)
    size = np.sqrt(np.diag(matrix))
    pairs = [(i, j) for j in range(len(names)) for i in range(j)]
    return {(names[i], names[j]): float(matrix[i, j] / (size[i] * size[j])) for i, j in pairs}
