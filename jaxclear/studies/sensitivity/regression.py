"""The derivative of a statistic from a sample, without bias: a polynomial through the responses,
and the score function for what it leaves.

Moving a variable's distribution weighs the samples anew, so the derivative of a mean is the mean of
the response times the score function, whatever the response: rough, kinked or chaotic. That alone
is noisy; the polynomial takes up what it explains, whose mean derivative is known from as many
evaluations as wanted. Where a distribution is cut off, as inspected parts are, its ends move too:
what the polynomial leaves there is found by runs at the ends.

A kink or jump far out lies in few samples, or in none, and a sample that lacks it tells nothing of
its weight. So some runs are drawn from wider distributions. They join the sample with the weights
of a mixture, which leaves means without bias and bounds every weight; what a polynomial misses
among them tells how much parts that no run has seen may add.

Source: score functions with control variates: Rubinstein & Shapiro 1993, Discrete Event Systems,
Wiley; L'Ecuyer 1990, Manage. Sci. 36, 1364, doi:10.1287/mnsc.36.11.1364; defensive importance
sampling: Hesterberg 1995, Technometrics 37, 185, doi:10.1080/00401706.1995.10484303; Owen & Zhou
2000, J. Am. Stat. Assoc. 95, 135, doi:10.1080/01621459.2000.10473909.
"""

from typing import NamedTuple

import numpy as np
import scipy

from jaxclear.studies.distribution.base import END_SCORE
from jaxclear.studies.monte_carlo import MonteCarlo
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_warnings import concern
from jaxclear.studies.sampling import by_scrambling, draw
from jaxclear.studies.scrambling import normal_density, scrambled_shares
from jaxclear.studies.sensitivity.derivative import Estimate, from_parts, refused
from jaxclear.studies.sensitivity.estimand import Direction, Functional, weights
from jaxclear.studies.statistics.scrambled import SAMPLES_A_TERM, pseudo_values, student
from jaxclear.studies.store.batch import evaluate_all

# Points at which the polynomial's mean derivative is taken, and what draws them.
MANY, MANY_SEED = 8192, 20260
# The fewest samples for a line.
FEWEST = 8
# Width of the smooth step [standard deviations of the response] where a surface explains all of it,
# and the share of the variance from which on it stands for the response.
LEAST_STEP, EXPLAINED = 0.15, 0.9
# Densities at an end [1/standard deviation] that are no density: what grows without bound there.
LARGEST_END_DENSITY = 20.0
# Standard deviations of the runs in those of the sample, in turn: what the sample reaches, up to
# twice and a half as far.
SCALES = np.array([1.25, 1.6, 2.0, 2.5])
# One run for so many of the sample, and the most.
SHARE, MOST = 4, 128
# The 95 % bound of Poisson's distribution, for none seen.
UNSEEN = 3.0


class Ends(NamedTuple):
    """Runs with a variable at its ends: densities (2,) [1/unit], velocities (2,), values (2, runs,
    variables), responses by name (2, runs), and the scrambling of each (runs,)."""

    densities: np.ndarray
    velocities: np.ndarray
    values: np.ndarray
    responses: dict[str, np.ndarray]
    scrambling: np.ndarray


class Outer(NamedTuple):
    """Runs further out: independent standard normal numbers and values (runs, variables), responses
    by name (runs,), and the scrambling of each (runs,)."""

    normal: np.ndarray
    values: np.ndarray
    responses: dict[str, np.ndarray]
    scrambling: np.ndarray


def runs_outside(problem: Problem, scramblings: np.ndarray, seed: int, progress_bar: bool) -> Outer:
    """Further runs outside the bulk of the distribution, for the polynomial.

    Args:
        problem: with the variables.
        scramblings: of the sample's members, shape (samples,).
        seed: of the runs.
        progress_bar: whether one is shown.
    """
    names, count = np.unique(scramblings), len(problem.names)
    each = min(len(scramblings) // SHARE, MOST) // len(names)
    numbers = [
        scrambled_shares(each, count, np.random.default_rng((seed, i))) for i in range(len(names))
    ]
    shares = np.concatenate(numbers) if each else np.zeros((0, count))
    # Points in a row fill the space, each fourth of them a corner of it.
    factors = SCALES[np.arange(each) * len(SCALES) // max(each, 1)]
    scales = np.tile(factors, len(names))[:, None]
    # Within the scores at which distributions are asked.
    inside = scipy.special.ndtr(-END_SCORE / scales)
    normal = scales * scipy.special.ndtri(inside + (1.0 - 2.0 * inside) * shares)
    values = np.asarray(problem.inputs.values(normal))
    group = np.repeat(names, each)
    if not len(shares):
        return Outer(normal, values, {n: np.zeros(0) for n in problem.response_names}, group)
    result = evaluate_all(problem, values, progress_bar=progress_bar, label="further out")
    return Outer(normal, values, result.reached_responses(), group)


def mixture_weights(normal: np.ndarray, inside: int) -> np.ndarray:
    """Density of the variables over that of the mixture of `inside` samples and runs further out,
    (samples and runs,), at independent standard normal numbers (samples and runs, variables)."""
    count, variables = normal.shape
    square = np.sum(normal**2, axis=1)
    wider = np.zeros(count)
    for scale in SCALES:
        share_inside = 1.0 - 2.0 * scipy.special.ndtr(-END_SCORE / scale)
        density = np.exp(0.5 * square * (1.0 - scale**-2.0)) / (scale * share_inside) ** variables
        wider += density / len(SCALES)
    return count / (inside + (count - inside) * wider)


def widened(
    error: float, weighed: np.ndarray, outside: np.ndarray, count: int, parts: int
) -> float:
    """Half of a 95 % interval, widened for few deciding samples and for what no sample has seen.

    Args:
        error: half interval from the scatter of the scramblings.
        weighed: residuals beside the polynomial in the estimate's mean, shape (samples and runs,).
        outside: the same of the runs further out without their weights, shape (runs,).
        count: number of samples.
        parts: number of scramblings.
    """
    squares = weighed**2
    total = float(squares.sum())
    if total == 0.0:
        return error
    deciding = total**2 / float((squares**2).sum())
    freedom = np.clip(deciding, 2.0, parts)
    seen_error = error * student(float(freedom)) / student(parts)
    rms = float(np.sqrt(np.mean(outside**2))) if len(outside) else 0.0
    return float(np.hypot(seen_error, UNSEEN / count * rms * min(1.0, parts / deciding)))


def no_regression(sample: MonteCarlo, direction: Direction) -> str:
    """Why a sample tells no derivative by regression; "" where it does."""
    problem = sample.problem
    values = np.delete(sample.values, sample.failed, axis=0)
    if len(values) < 2 * len(problem.names) + FEWEST:
        return (
            f"{len(values)} good samples are too few for a fit in {len(problem.names)} variables."
        )
    if np.ptp(values[:, direction.variable]) == 0:
        return "the variable does not vary in the sample."
    return no_score_function(problem, direction)


def no_score_function(problem: Problem, direction: Direction) -> str:
    """Why the score function does not tell a derivative; "" where it does."""
    inputs, i = problem.inputs, direction.variable
    law = inputs.distributions[i]
    if any(first <= i < first + len(joint.parts) for first, joint in inputs.joints):
        return "the variable has several numbers, which end together; take differences."
    if not law.is_continuous():
        return "the variable comes in single sizes, which have no density; take differences."
    if inputs.independent:
        ends = np.array(law.end_densities()) * float(law.deviation())
        if np.any(ends > LARGEST_END_DENSITY):
            return "the density of the variable grows without bound at its end; take differences."
        return ""
    if any(law.end_densities()) or not all(d.is_continuous() for d in inputs.distributions):
        return (
            "the variable is cut off, or another one discrete, and variables are correlated: at "
            "its end the others have no distribution; take differences."
        )
    return ""


def runs_at_ends(
    problem: Problem, variable: int, scramblings: int, seed: int, progress_bar: bool
) -> Ends | None:
    """Runs with a variable at its distribution's ends, one for each scrambling; None without ends.

    Args:
        problem: with the variables.
        variable: its index.
        scramblings: their number.
        seed: of the other variables.
        progress_bar: whether one is shown.
    """
    distribution = problem.inputs.distributions[variable]
    densities = np.array(distribution.end_densities())
    if not densities.any():
        return None
    alone = len(problem.names) == 1
    base = draw(problem, 1 if alone else scramblings, seed, scramblings=1 if alone else scramblings)
    values = np.stack([base, base])
    ends = np.asarray(distribution.of_score(np.array([-END_SCORE, END_SCORE])))
    values[:, :, variable] = float(problem.nominal()[variable]) + ends[:, None]
    flat = values.reshape(-1, values.shape[2])
    result = evaluate_all(problem, flat, progress_bar=progress_bar, label="ends")
    responses = {name: r.reshape(2, -1) for name, r in result.reached_responses().items()}
    group = np.full(1, -1) if alone else np.arange(scramblings)
    return Ends(densities, ends, values, responses, group)


class LocalPolynomial:
    """Polynomials of the variables in standard deviations about nominal: as many terms as the
    samples bear, those of the variable in question up to its cube."""

    def __init__(self, problem: Problem, variable: int, samples: int):
        self.nominal = np.asarray(problem.nominal())
        self.scale = np.asarray(problem.inputs.deviations())
        count, i = len(self.nominal), variable
        lines = [(j,) for j in range(count)]
        pure = [(i, i), (i, i, i)]
        squares = [(j, j) for j in range(count) if j != i]
        mixed = [(j, k) for j in range(count) for k in range(j)]
        self.terms: list[tuple[int, ...]] = [(), *lines]
        for more in (pure, squares, [p for p in mixed if i in p], [p for p in mixed if i not in p]):
            if len(self.terms) + len(more) <= samples / SAMPLES_A_TERM:
                self.terms += more
        self.variable = variable

    def basis(self, values: np.ndarray) -> np.ndarray:
        """(samples, terms)"""
        x = (values - self.nominal) / self.scale
        return np.stack([np.prod(x[:, list(t)], axis=1) for t in self.terms], axis=1)

    def slopes(self, values: np.ndarray) -> np.ndarray:
        """(samples, terms), by the variable in question [1/unit]"""
        x = (values - self.nominal) / self.scale
        i = self.variable
        columns = []
        for term in self.terms:
            times = term.count(i)
            rest = [j for j in term if j != i]
            power = x[:, i] ** max(times - 1, 0)
            columns.append(times * power * np.prod(x[:, rest], axis=1) / self.scale[i])
        return np.stack(columns, axis=1)


def regressions(
    sample: MonteCarlo,
    direction: Direction,
    functionals: list[Functional],
    ends: Ends | None,
    outer: Outer | None,
) -> dict[str, Estimate]:
    """Derivatives of statistics from a sample by regression, by label.

    Args:
        sample: Monte Carlo study.
        direction: variable and number that is differentiated by.
        functionals: statistics that are differentiated.
        ends: runs at the ends of the variable; None: it has none.
        outer: runs further out; None where there is no regression.
    """
    problem, i = sample.problem, direction.variable
    good = np.isin(np.arange(sample.count), sample.failed, invert=True)
    values, group = sample.values[good], sample.scrambling[good]
    why = no_regression(sample, direction)
    if why:
        return {one.label: refused(why) for one in functionals}
    assert outer is not None
    fit = LocalPolynomial(problem, i, len(values))
    normal = np.asarray(problem.inputs.normal(values))
    weight = weights(problem, direction, np.concatenate([normal, outer.normal]))
    many = Many.drawn(problem, direction, fit, len(np.unique(group)), MANY_SEED + sample.seed)
    answers = {}
    for one in functionals:
        responses = sample.responses[one.response][good]
        few = one.undecided(responses, by="sample") or one.unbounded(responses)
        if few:
            answers[one.label] = refused(few)
            continue
        joined = _Joined.of(one, (values, normal, responses, group), weight, outer)
        estimator = Slope(one, joined, fit.basis(joined.values), many)
        ending = None if ends is None else ending_of(ends, fit, direction, one)
        slope = lambda mask, estimator=estimator, ending=ending: estimator.of(mask, ending)
        # What the many points do not know of the polynomial's slope is shared out to the parts.
        parts = pseudo_values(slope, joined.group) + estimator.scatter()
        warning = concern(problem, one.response, sample.checks, good)
        bias = abs(parts.mean()) * estimator.unknown
        answer = from_parts(parts, bias)
        resid = estimator.residuals
        answer = answer._replace(
            error=widened(
                answer.error, joined.ratio * resid, resid[~joined.inside], len(resid), len(parts)
            )
        )
        runs = sample.count + len(outer.values) + (0 if ends is None else ends.values[..., 0].size)
        answers[one.label] = answer._replace(warned=warning[0], warnings=warning[1], runs=runs)
    return answers


class _Joined(NamedTuple):
    """A sample and the runs further out whose response is a number, one after the other: values
    (samples, variables), responses, scramblings, score functions (`weight`), which are of the
    sample (`inside`) and their weights `ratio` [1], (samples,)."""

    values: np.ndarray
    responses: np.ndarray
    group: np.ndarray
    weight: np.ndarray
    inside: np.ndarray
    ratio: np.ndarray

    @classmethod
    def of(
        cls, one: Functional, sample: tuple[np.ndarray, ...], weight: np.ndarray, outer: Outer
    ) -> "_Joined":
        """As a statistic sees the responses; `weight` (samples and runs,)."""
        more = outer.values, outer.normal, outer.responses[one.response], outer.scrambling
        count, good = len(sample[0]), np.isfinite(more[2])
        values, normal, responses, group = (
            np.concatenate([old, further[good]]) for old, further in zip(sample, more, strict=True)
        )
        mask = np.concatenate([np.ones(count, bool), good])
        inside, ratio = np.arange(len(values)) < count, mixture_weights(normal, count)
        return cls(values, one.bounded(responses), group, weight[mask], inside, ratio)


class Many(NamedTuple):
    """Points by which the mean derivative of what is fitted is known: values of its terms and their
    slopes along the direction (scramblings, points, terms)."""

    basis: np.ndarray
    slopes: np.ndarray

    @classmethod
    def drawn(cls, problem, direction, fit, scramblings, seed) -> "Many":
        """Points at which the mean derivative of a polynomial is computed.

        Args:
            problem: with the joint distribution.
            direction: variable and number that is differentiated by.
            fit: terms of the polynomial.
            scramblings: number of scramblings of the sample.
            seed: of the points.
        """
        values = draw(problem, MANY, seed, scramblings=scramblings)
        slopes = direction.velocities(problem, values)[:, None] * fit.slopes(values)
        each = MANY // scramblings
        cut = lambda array: by_scrambling(array[: each * scramblings], scramblings)
        return cls(cut(fit.basis(values)), cut(slopes))


class Ending(NamedTuple):
    """What the two ends of a distribution add: factors (2,) of means over runs there, the terms of
    the polynomial (2, runs, terms), responses (2, runs) and scramblings (runs,)."""

    factors: np.ndarray
    basis: np.ndarray
    responses: np.ndarray
    scrambling: np.ndarray


def ending_of(ends: Ends, fit: LocalPolynomial, direction: Direction, one: Functional) -> Ending:
    """What the ends of a distribution add to the derivative of one statistic.

    Args:
        ends: runs there.
        fit: terms of the polynomial.
        direction: variable and number that is differentiated by.
        one: the statistic.
    """
    speeds = np.ones(2) if direction.number is None else ends.velocities / direction.number
    basis = np.stack([fit.basis(row) for row in ends.values])
    factors = np.array([-1.0, 1.0]) * speeds * ends.densities
    return Ending(factors, basis, one.bounded(ends.responses[one.response]), ends.scrambling)


def fitted(basis: np.ndarray, target: np.ndarray, ratio: np.ndarray | None = None) -> np.ndarray:
    """Coefficients (terms,) of weighted least squares, by normal equations.

    Terms of deviations are well conditioned, so these serve.

    Args:
        basis: values of the terms, shape (samples, terms).
        target: shape (samples,).
        ratio: weights of the equations, shape (samples,); None: equal.
    """
    weighed = basis if ratio is None else basis * ratio[:, None]
    return np.linalg.lstsq(weighed.T @ basis, weighed.T @ target, rcond=None)[0]


class Slope:
    """The derivative of a statistic from any selection of the sample's scramblings.

    Where parts are told apart (a limit, a quantile) and how dense they are there is read from the
    whole sample once: both jump as samples come and go. `unknown` [1] is what half of the 95 %
    interval of the density leaves unknown of the derivative; `residuals` (samples,) is what each
    adds beside the polynomial.
    """

    def __init__(self, one: Functional, joined: _Joined, basis, many: Many):
        self.one, self.joined, self.basis = one, joined, basis
        self.many, self.last = many, np.zeros(len(many.basis))
        self.residuals = np.zeros(len(basis))
        responses, inner = joined.responses[joined.inside], basis[joined.inside]
        surface = fitted(inner, responses)
        larger = self._larger_sample(surface, responses, inner)
        self.place, self.unknown = one.place(larger), one.unknown(larger)
        self.full_influence = one.influence(larger)

    def of(self, mask: np.ndarray, ending: Ending | None) -> float:
        """From the samples `mask` (samples,)."""
        joined, inner = self.joined, mask & self.joined.inside
        y, basis = joined.responses[inner], self.basis[inner]
        influence = self.one.influence(y) if self.place is None else self.full_influence
        step = self._fit_influence(y, basis)
        target, rows, ratio = (
            influence(joined.responses[mask]), step(self.basis[mask]), joined.ratio[mask],
        )  # fmt: skip
        theta = fitted(rows, target, ratio)
        residuals = (target - rows @ theta) * joined.weight[mask]
        each = np.array([np.mean(step(b, d) @ theta) for b, d in zip(*self.many, strict=True)])
        if mask.all():
            self.last, self.residuals = each - each.mean(), residuals
        total = each.mean() + np.average(residuals, weights=ratio)
        if ending is None:
            return total
        chosen = np.isin(ending.scrambling, joined.group[mask]) | (ending.scrambling < 0)
        for factor, terms, runs in zip(*ending[:3], strict=True):
            residuals = influence(runs[chosen]) - step(terms[chosen]) @ theta
            residuals = residuals[np.isfinite(runs[chosen])]
            total += factor * residuals.mean() if len(residuals) else 0.0
        return total

    def scatter(self) -> np.ndarray:
        """How the slope of what was fitted differs between the scramblings of the many points."""
        return self.last

    def _fit_influence(self, y, basis):
        """What is fitted to the influence function, from the polynomial's terms, or by its slopes:
        these terms, and for a share of parts a smooth step where the surface passes its limit."""
        place, surface = self.place, fitted(basis, y)
        width = np.hypot(np.std(y - basis @ surface), LEAST_STEP * np.std(y))
        # Responses that are one number pass no limit.
        if place is None or width == 0.0:
            return lambda terms, slopes=None: terms if slopes is None else slopes

        def columns(terms, slopes=None):
            z = (terms @ surface - place) / width
            if slopes is None:
                last, first = scipy.special.ndtr(z), terms
            else:
                last, first = normal_density(z) * (slopes @ surface) / width, slopes
            return np.column_stack([first, last])

        return columns

    def _larger_sample(self, surface, responses, basis) -> np.ndarray:
        """A larger sample like this one where the surface explains it: what it leaves, spread over
        many points; the sample itself elsewhere."""
        residuals = responses - basis @ surface
        if np.var(residuals) > (1.0 - EXPLAINED) * np.var(responses):
            return responses
        smooth = (self.many.basis @ surface).ravel()
        return smooth + np.resize(residuals, len(smooth))
