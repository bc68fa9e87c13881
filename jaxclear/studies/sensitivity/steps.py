"""How far the steps of a study put its derivatives off, from the replicas of its first samples.

What a replica changes in a response is a function of the variables, and its derivative the bias of
the response's: that of a plane through the differences, bent along the variable in question. It
takes no run more; what the plane leaves tells the interval. Of shares of parts and of quantiles,
which so few samples do not tell, the bias is taken to be as large a share as that of the mean.
"""

import numpy as np

from jaxclear.studies.monte_carlo import MonteCarlo
from jaxclear.studies.sensitivity.estimand import Direction, Functional
from jaxclear.studies.statistics.accuracy import NumericalError
from jaxclear.studies.statistics.scrambled import student


def error_by_steps(
    sample: MonteCarlo, direction: Direction, one: Functional, value: float, error: float
) -> NumericalError | None:
    """Numerical error of a derivative beside its statistical `error` (both [response/variable]).

    Args:
        sample: the study, whose replicas tell it.
        direction: what the derivative is by.
        one: the statistic that is differentiated.
        value: the derivative.
        error: half of its 95 % interval, without what steps do.

    Returns:
        The error, or None where the study has no replicas.
    """
    replicas = sample.replicas
    if replicas is None:
        return None
    values, finer = replicas.coarse[one.response], replicas.responses[one.response]
    good = np.isfinite(values) & np.isfinite(finer)
    values, finer = values[good], finer[good]
    terms, mean_slopes = _plane_terms(sample, direction)
    terms = terms[: len(good)][good]
    freedom = len(terms) - terms.shape[1]
    if freedom < 1:
        return NumericalError(0.0, np.inf, error, len(values))

    def mean_slope(target: np.ndarray) -> tuple[float, float]:
        """The mean slope along the direction of what is fitted to these values (replicas,), and
        half of its 95 % interval."""
        fitted = np.linalg.lstsq(terms, target, rcond=None)[0]
        variance = np.sum((target - terms @ fitted) ** 2) / freedom
        factor = mean_slopes @ np.linalg.pinv(terms.T @ terms) @ mean_slopes
        return float(mean_slopes @ fitted), student(freedom + 1) * float(np.sqrt(variance * factor))

    is_smooth = one.place(values) is None
    of = one.influence if is_smooth else (lambda _: lambda y: y)
    bias, uncertainty = mean_slope((of(values)(values) - of(finer)(finer)) / (1 - replicas.share))
    share = 1.0 if is_smooth else abs(value / mean_slope(values)[0])
    return NumericalError(share * bias, share * uncertainty, error, len(values))


def _plane_terms(sample: MonteCarlo, direction: Direction) -> tuple[np.ndarray, np.ndarray]:
    """A plane in all variables, bent along that of the direction: its terms (samples, terms), and
    the means of their slopes along the direction (terms,)."""
    problem, i = sample.problem, direction.variable
    scale = np.asarray(problem.inputs.deviations())
    scores = (sample.values - np.asarray(problem.nominal())) / scale
    terms = np.column_stack([np.ones(len(scores)), scores, scores[:, i] ** 2])
    velocities = direction.velocities(problem, sample.values) / scale[i]
    means = np.zeros(terms.shape[1])
    means[1 + i], means[-1] = velocities.mean(), (2 * velocities * scores[:, i]).mean()
    return terms, means
