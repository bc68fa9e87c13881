"""A record explained by the signal itself: where the unknowns' signals are nearest to it, and what
the record leaves of their prior.

Intervals are Laplace's: the posterior about each optimum is normal, in the unknowns' normal scores.
It is tempered: a residual that is alike over t samples makes every t samples one, so that a model
which misses a record by more than its noise is not believed to the last digit. With a known noise
the sum of squares must be what that noise makes; if it is not, no interval is told.

Source: normal about the optimum, Tierney & Kadane 1986, J. Am. Stat. Assoc. 81, 82,
doi:10.1080/01621459.1986.10478240; likelihoods to a power, Bissiri, Holmes & Walker 2016, J. R.
Stat. Soc. B 78, 1103, doi:10.1111/rssb.12158; the time scale of correlated samples, Thiébaux &
Zwiers 1984, J. Clim. Appl. Meteorol. 23, 800; where to end its sum, Geyer 1992, Stat. Sci. 7, 473,
doi:10.1214/ss/1177011137.
"""

import math
from typing import NamedTuple

import numpy as np
import scipy
from jax.scipy.special import ndtr

from jaxclear.errors.estimates import HALF
from jaxclear.ground.quantity import with_fields
from jaxclear.studies.identification.forward import Forward, Record, check_signals
from jaxclear.studies.identification.least_squares import (
    Optimum,
    finer_residuals,
    optima,
    starts_of,
)
from jaxclear.studies.infinite_responses import successes
from jaxclear.studies.store.batch import evaluate_all

# A noise is known to within this share of it: its power, and what is left of a record, to twice.
NOISE_TOLERANCE = 0.2
# One right model in a thousand is refused.
REFUSED = 1e-3
# Of a signal whose noise is not known, shares of its deviation: no instrument leaves less than the
# first, and beyond the last its mean would explain it better.
LEAST_MISFIT, MOST_MISFIT = 1e-6, 1.1
# What an interval holds, and shares below and above which half of the rest lies.
CONTENT, ENDS = 0.95, (0.025, 0.975)
# Searches, the nominal values among their starts.
STARTS = 8
# Optima that intervals hold, and draws that tell these.
MOST_CENTRES, DRAWS = 3, 4096
# An end of the prior whose density is above this share of the largest is not excluded: twice the
# logarithm of their ratio is what chi-square with one degree of freedom exceeds in 5 %.
AT_END = math.exp(-0.5 * 1.959964**2)
# Parts of an interval in which densities are compared.
PARTS = 10


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
    signal; `values` (draws, variables) follow the posterior; `unknowns` and `answers`, their
    intervals by name; `together`: correlations [1] of the unknowns' normal scores, by pair; `runs`
    that it took; `refusal`: why there are no intervals, "" where there are; `by_steps`: by how many
    of its standard deviations each unknown is off by the steps of the runs, by name."""

    best: np.ndarray
    misfits: dict[str, Misfit]
    values: np.ndarray
    unknowns: dict[str, CredibleInterval]
    answers: dict[str, CredibleInterval]
    together: dict[tuple[str, str], float]
    runs: int
    refusal: str = ""
    by_steps: dict[str, float] | None = None


def fit_signal(
    forward: Forward,
    record: Record,
    *,
    windows: int = 1,
    draws: int = 512,
    seed: int = 0,
) -> SignalFit:
    """The posterior of a problem's unknowns given a record of its signals.

    Where no search ends at an optimum, or a known noise does not explain the residual, there are no
    intervals and `refusal` says why.

    Args:
        forward: signals of the unknowns, with derivatives.
        record: to be fitted.
        windows: how often each search's window doubles until it holds the record.
        draws: runs that sample what follows for the responses.
        seed: of starts and draws.

    Raises:
        ValueError: signals and problem do not fit together.
    """
    check_signals(forward, record)
    begin = starts_of(STARTS, len(forward.problem.names), seed)
    scale = _first_scale(record)
    candidates, runs = optima(forward, record, begin, scale, windows)
    if not candidates:
        return _make_refused_fit(forward, record, None, runs, _NOT_FINITE)
    # What the nearest leaves tells how much each sample is worth; then once more from there.
    scale = _weigh_samples(record, _measure_misfits(record, candidates[0]))
    # As many rows as before run the same program.
    again = np.resize([optimum.normal for optimum in candidates[:MOST_CENTRES]], begin.shape)
    repeated, more = optima(forward, record, again, scale)
    candidates, runs = repeated or candidates[:MOST_CENTRES], runs + more
    best = candidates[0]
    misfits = _measure_misfits(record, best)
    refusal = _why_refused(best, misfits)
    if refusal:
        return _make_refused_fit(forward, record, best, runs, refusal)
    fit = _make_fit(forward, record, candidates, misfits, runs, draws, seed)
    moves = _moves_by_steps(forward, record, best, _weigh_samples(record, misfits))
    return fit._replace(by_steps=dict(zip(forward.problem.names, moves.tolist(), strict=False)))


def _moves_by_steps(
    forward: Forward, record: Record, best: Optimum, scale: np.ndarray
) -> np.ndarray:
    """By how many of their standard deviations unknowns (variables,) follow what the steps of runs
    leave in the signals: one step of Gauss and Newton; none where steps cannot be refined."""
    finer = forward.problem.refine()
    if finer is None or finer.shares.shape != forward.problem.shares.shape:
        return np.zeros(0)
    # As many rows as before run the same program.
    normals = np.resize(best.normal, (STARTS, len(best.normal)))
    seen = finer_residuals(with_fields(forward, problem=finer), normals, record.row)
    error = (best.residual - seen) / (1 - HALF)
    matrix = np.linalg.inv(best.information(scale))
    return matrix @ (best.slopes.T @ (error / scale**2)) / np.sqrt(np.diag(matrix))


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


def _measure_misfits(record: Record, best: Optimum) -> dict[str, Misfit]:
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


def _weigh_samples(record: Record, misfits: dict[str, Misfit]) -> np.ndarray:
    """Standard deviation with which each sample counts: larger where neighbours say the same."""
    scales = []
    for name, signal in record.signals.items():
        misfit, noise = misfits[name], record.noise.get(name)
        size = noise if noise is not None else max(misfit.size, 0.1 * LEAST_MISFIT * _size(signal))
        scales.append(np.full(len(signal), size * np.sqrt(misfit.time)))
    return np.concatenate(scales)


def _why_refused(best: Optimum, misfits: dict[str, Misfit]) -> str:
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


def _make_refused_fit(
    forward: Forward, record: Record, best: Optimum | None, runs: int, why: str
) -> SignalFit:
    names = forward.problem.names
    values, misfits = np.full(len(names), np.nan), dict[str, Misfit]()
    if best is not None:
        values = np.asarray(forward.problem.inputs.values(best.normal))
        misfits = _measure_misfits(record, best)
    return SignalFit(values, misfits, np.zeros((0, len(names))), {}, {}, {}, runs, why)


def _draw_laplace(
    optima: list[Optimum], record: Record, misfits: dict[str, Misfit], rng: np.random.Generator
) -> np.ndarray:
    """Normal numbers (DRAWS, variables) of the posterior: normal about each optimum, by its
    curvature, each as often as its density and its size make it likely. Of a noise that is not
    known, by Student's t of as many samples as the records are worth."""
    scale = _weigh_samples(record, misfits)
    matrices = [np.linalg.inv(optimum.information(scale)) for optimum in optima]
    sizes = [0.5 * np.linalg.slogdet(matrix)[1] for matrix in matrices]
    likely = scipy.special.softmax(sizes - np.array([optimum.cost for optimum in optima]))
    variables = len(optima[0].normal)
    spread = np.ones((DRAWS, 1))
    if any(noise is None for noise in record.noise.values()):
        samples = sum(misfit.samples / misfit.time for misfit in misfits.values())
        freedom = max(samples - variables, 1.0)
        spread = np.sqrt(max(samples, 1.0) / rng.chisquare(freedom, (DRAWS, 1)))
    rows = rng.standard_normal((DRAWS, variables)) * spread
    place = np.repeat(np.arange(len(optima)), rng.multinomial(DRAWS, likely))
    roots = np.linalg.cholesky(matrices)[place]
    centres = np.array([optimum.normal for optimum in optima])[place]
    return rng.permutation(centres + np.einsum("nij,nj->ni", roots, rows))


def _make_fit(
    forward: Forward,
    record: Record,
    optima: list[Optimum],
    misfits: dict[str, Misfit],
    runs: int,
    draws: int,
    seed: int,
) -> SignalFit:
    """Intervals about the optima."""
    problem, rng = forward.problem, np.random.default_rng(seed)
    normal = _draw_laplace(optima, record, misfits, rng)
    values, scores = (
        np.asarray(convert(normal)) for convert in (problem.inputs.values, problem.inputs.scores)
    )
    shares = np.asarray(ndtr(scores))
    unknowns = {
        name: _interval_of_unknown(problem, i, shares[:, i], values[:, i])
        for i, name in enumerate(problem.names)
    }
    answers = {}
    if forward.asked.response_names:
        prior = problem.inputs.values(rng.standard_normal((draws, values.shape[1])))
        both = np.concatenate([values[:draws], prior])
        runs += len(both)
        result = evaluate_all(forward.asked, both)
        responses = successes(forward.asked, result.outcome, result.responses)[1]
        for name, response in responses.items():
            after, before = (part[np.isfinite(part)] for part in np.split(response, [-draws]))
            ends = (*np.quantile(after, (0.5, *ENDS)), after.std(), *np.quantile(before, ENDS))
            answers[name] = CredibleInterval(*map(float, ends))
    best = np.asarray(problem.inputs.values(optima[0].normal))
    correlation = np.atleast_2d(np.corrcoef(scores.T))
    pairs = [(i, j) for j in range(len(problem.names)) for i in range(j)]
    together = {(problem.names[i], problem.names[j]): float(correlation[i, j]) for i, j in pairs}
    return SignalFit(best, misfits, values, unknowns, answers, together, runs)


def shortest_interval(shares: np.ndarray) -> tuple[float, float]:
    """The shortest interval of the prior's shares (draws,) [1] that holds 95 % of them:
    where little speaks against an end of the prior, it reaches that end."""
    ordered = np.sort(shares)
    inside = int(np.ceil(CONTENT * len(ordered)))
    start = int(np.argmin(ordered[inside - 1 :] - ordered[: len(ordered) - inside + 1]))
    low, high = float(ordered[start]), float(ordered[start + inside - 1])
    step = (high - low) / PARTS
    most = np.histogram(ordered, PARTS, (low, high))[0].max()
    at_end = np.sum(ordered <= step), np.sum(ordered >= 1.0 - step)
    low, high = (
        limit if count >= AT_END * most else end
        for limit, count, end in zip((0.0, 1.0), at_end, (low, high), strict=True)
    )
    return low, high


def _interval_of_unknown(problem, place, shares, values) -> CredibleInterval:
    low, high = shortest_interval(shares)
    distribution, nominal = problem.inputs.distributions[place], float(problem.nominal()[place])
    at = lambda share: nominal + float(distribution.quantile(share))
    inside = lambda share, extreme: at(share) if np.isfinite(at(share)) else extreme
    ends = inside(low, values.min()), inside(high, values.max())
    return CredibleInterval(float(np.median(values)), *ends, float(values.std()), *map(at, ENDS))
