"""What a record tells of a machine: of each unknown an interval, and whether it is identified."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy

from jaxclear.ground.arguments import check_name, check_number
from jaxclear.ground.printing import with_text_repr
from jaxclear.studies.answer import DATASET, VARIABLE, AbstractAnswer, Column, Stated
from jaxclear.studies.distribution import Empirical
from jaxclear.studies.experiment import Setting
from jaxclear.studies.function_problem import Dimension, FunctionExperiment, FunctionProblem
from jaxclear.studies.identification.regression import Regression, calibration
from jaxclear.studies.inputs import LEAST_EIGENVALUE
from jaxclear.studies.problem import Problem
from jaxclear.studies.variable import Variable

IDENTIFIED, PARTLY, NOT = "identified", "partly identified", "not identified"
# Of an interval beside a record that no law of the sample explains.
UNEXPLAINED = "not explained"
# An interval ends where its prior does, if nearer than this share [1] of the prior's interval.
AT_END = 1e-4
# Width of an interval beside the prior's: from here on it is the prior's, and up to here the
# record decides more than the prior does.
NOT_ABOVE, PARTLY_ABOVE = 0.8, 0.5
# Probability of all intervals, and the largest share of runs that may lie as far from the others as
# a record that their laws explain.
LEVEL, STRANGE = 0.95, 0.01
# Of a prior [1]: its middle and its interval, what is known of an unknown of which nothing is told.
NOTHING = (0.5, 0.5 * (1 - LEVEL), 0.5 * (1 + LEVEL))
# Shares at which a prior ends where it has no end.
LEAST_SHARE = 1e-6
# A combination is told where its spread is below this share of the prior's, and that of each of
# its unknowns above; and those that weigh less belong to no combination.
TOGETHER, LEAST_WEIGHT = 0.4, 0.3
ONE_RECORD = (
    "One record does not show an elastic law beyond the priors: where the stiffness of a contact "
    "may be another than these allow, let it vary."
)


@with_text_repr
class Unknown(NamedTuple):
    """What is known of one unknown, in its `unit`: its `estimate`, `low` and `high` ends of its
    95 % interval, those of its prior, `width` of the one beside the other [1] before a verdict,
    the `verdict` in words, and the `method` that determined it."""

    name: str
    unit: str
    estimate: float
    low: float
    high: float
    prior_low: float
    prior_high: float
    width: float
    verdict: str
    method: str

    def sentence(self) -> str:
        """The unknown in words."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        ends = f"{self.low:.4g} to {self.high:.4g}{unit}"
        if self.verdict == NOT:
            return f"{self.name} is not identified: its interval is the prior's, {ends}."
        also = f", {self.verdict}" if self.verdict in (PARTLY, UNEXPLAINED) else ""
        return f"{self.name} is {self.estimate:.4g}{unit}, {ends} with 95 %{also}."

    def __str__(self) -> str:
        return self.sentence()


def unknown_of(problem: Problem, name: str, shares: Any, method: str = "") -> Unknown:
    """An unknown with its interval and verdict.

    An interval wider than 0.8 of the prior's is replaced by the prior's.

    Args:
        problem: with the unknown as variable.
        name: of the variable.
        shares: estimate, lower and upper end as shares of the prior [1].
        method: by which it was estimated.
    """
    values = prior_quantiles(problem, name, np.array([*shares, *NOTHING]))
    estimate, low, high, middle, prior_low, prior_high = map(float, values)
    width = (high - low) / (prior_high - prior_low)
    verdict = verdict_of(width)
    if verdict == NOT:
        estimate, low, high = middle, prior_low, prior_high
    elif end_reached(problem, name, low, high, prior_high - prior_low) is not None:
        verdict = PARTLY
    unit = problem.variable_units[problem.names.index(name)]
    ends = low, high, prior_low, prior_high
    return Unknown(name, unit, estimate, *ends, width, verdict, method)


def verdict_of(width: float) -> str:
    """In words, for the width [1] of an interval beside the prior's."""
    return NOT if width > NOT_ABOVE else PARTLY if width > PARTLY_ABOVE else IDENTIFIED


def end_reached(problem: Problem, name: str, low: float, high: float, prior: float) -> float | None:
    """The end of an unknown's distribution at which its interval ends; None for neither.

    Args:
        problem: with the unknown as variable.
        name: of the variable.
        low, high: ends of the interval, in the variable's unit.
        prior: width of the prior's interval.
    """
    ends = prior_quantiles(problem, name, np.array([0.0, 1.0]))
    pairs = zip(ends, (low, high), strict=True)
    return next((float(end) for end, bound in pairs if abs(end - bound) < AT_END * prior), None)


def ends_in_words(problem: Problem, unknowns: Sequence[Unknown]) -> list[str]:
    """Which intervals end where the prior does, and not by what the record says."""
    texts = []
    for row in unknowns:
        prior = row.prior_high - row.prior_low
        end = end_reached(problem, row.name, row.low, row.high, prior)
        if row.verdict != NOT and end is not None:
            texts.append(
                f'The interval of "{row.name}" ends where its distribution does, at {end:.4g}: it '
                "may lie beyond."
            )
    return texts


def unexplained(unknowns: Sequence[Unknown]) -> tuple[Unknown, ...]:
    """The same beside a record that no law of the sample explains: no interval is that of the
    machine."""
    return tuple(u if u.verdict == NOT else u._replace(verdict=UNEXPLAINED) for u in unknowns)


def prior_quantiles(problem: Problem, name: str, shares: np.ndarray) -> np.ndarray:
    """Values of an unknown below which shares of its prior lie.

    Args:
        problem: with the unknown as variable.
        name: of the variable.
        shares: [1].
    """
    nominal = float(problem.nominal()[problem.names.index(name)])
    within = jnp.asarray(np.clip(shares, LEAST_SHARE, 1 - LEAST_SHARE))
    return nominal + np.asarray(problem.marginals[name].quantile(within))


def prior_shares(problem: Problem, values: np.ndarray) -> np.ndarray:
    """Values (runs, variables) as shares of their priors."""
    nominal = np.asarray(problem.nominal())
    shares = [
        scipy.special.ndtr(np.asarray(problem.marginals[name].score(column)))
        for name, column in zip(problem.names, (values - nominal).T, strict=True)
    ]
    return np.stack(shares, axis=1)


class Evidence(NamedTuple):
    """What an identification by statistics was made of: the `fitted` regression, statistics of the
    sample's runs (runs, numbers) and of the record (numbers,), by kind and all together, and
    samples (samples, unknowns) as shares of the priors that the unknowns may be."""

    fitted: Regression
    kinds: dict[str, tuple[np.ndarray, np.ndarray]]
    shares: np.ndarray

    def coverage(self) -> np.ndarray:
        """Whether the interval of each run of the sample, left out, holds its unknowns."""
        return calibration(self.fitted, LEVEL)


class Identified(AbstractAnswer):
    """What a record tells. `unknowns` in the order of the problem's variables, `posterior_values`
    (samples, variables) what they may be together, `runs` that were compared and `failed` ones,
    `remarks` in sentences, `how`, and the `evidence` of an identification by statistics (None:
    otherwise). By signals: `answers`, what follows of the problem's responses, and `refusal`, why
    nothing is told ("": something is).

    `found["clearance B"]` is an `Unknown`; `posterior()` is the problem whose variables follow what
    the record leaves.
    """

    problem: Problem
    unknowns: tuple[Unknown, ...] = eqx.field(static=True)
    posterior_values: np.ndarray
    runs: int = eqx.field(static=True)
    failed: int = eqx.field(static=True)
    how: str = eqx.field(static=True)
    remarks: tuple[str, ...] = eqx.field(static=True, default=())
    explained: float | None = eqx.field(static=True, default=None)
    evidence: Evidence | None = None
    answers: tuple[Unknown, ...] = eqx.field(static=True, default=())
    refusal: str = eqx.field(static=True, default="")

    def __getitem__(self, name: str) -> Unknown:
        """What is known of one unknown, or of a response that follows."""
        by_name = {quantity.name: quantity for quantity in (*self.unknowns, *self.answers)}
        check_name("unknown", name, by_name, " of this identification")
        return by_name[name]

    @property
    def explains(self) -> bool | None:
        """Whether the record is like the sample's runs; None where nothing says so, as of
        fewer than a hundred runs."""
        if self.refusal:
            return False
        if self.explained is None or 1 / (self.runs + 1) > STRANGE:
            return None
        return self.explained > STRANGE

    def calibration(self) -> dict[str, float]:
        """Of each unknown the share of the sample's runs whose interval, the run left out, holds
        it: 0.95 is promised. Empty where no sample was regressed on."""
        if self.evidence is None:
            return {}
        return dict(zip(self.problem.names, self.evidence.coverage().mean(0).tolist(), strict=True))

    def posterior(self, duration: float | None = None) -> Problem:
        """The problem whose variables follow what the record leaves of their priors, with the
        correlation of their normal scores; its mechanism stands at the medians. Any study takes it.
        `duration` [s] of its runs, by default that of the problem's: lives want one period."""
        return posterior_of(self.problem, self.posterior_values, duration)

    def sentence(self) -> str:
        """Each unknown in words, and what else is to be known of the answer."""
        sentences = [quantity.sentence() for quantity in (*self.unknowns, *self.answers)]
        failures = f" {self.failed} more failed." if self.failed else ""
        sentences.append(f"From {self.runs} runs, {self.how}.{failures}")
        if self.explains:
            share = f"{100 * (self.explained or 0.0):.2g} %"
            sentences.append(f"The record is like the runs: {share} of them lie as far off as it.")
        return " ".join([*sentences, *self.remarks])

    def _stated(self):
        over = ("unknown",)
        read = lambda part: {
            row.name: getattr(row, part) for row in (*self.unknowns, *self.answers)
        }
        columns = {
            "unit": Column(over, read("unit")),
            "estimate": Column(over, read("estimate")),
            "low": Column(over, read("low"), meaning="lower end of the 95 % interval"),
            "high": Column(over, read("high"), meaning="upper end of the 95 % interval"),
            "prior low": Column(over, read("prior_low"), meaning="lower end of the prior's"),
            "prior high": Column(over, read("prior_high"), meaning="upper end of the prior's"),
            "width": Column(over, read("width"), "1", "of the interval beside the prior's"),
            "verdict": Column(over, read("verdict")),
            "told by": Column(over, read("method")),
        }
        for i, name in enumerate(self.problem.names):
            unit = self.problem.variable_units[i]
            values = self.posterior_values[:, i]
            columns[f"posterior {name}"] = Column(
                ("draw",), values, unit, kind=VARIABLE, only=DATASET
            )
        return Stated("identification", columns, self.problem, self.warned)

    @property
    def warned(self) -> tuple[str, ...]:
        """A sentence where the sample's laws do not explain the record."""
        if self.refusal:
            return (f"No interval is told: {self.refusal}",)
        if self.explained is None or self.explained > STRANGE:
            return ()
        return (
            f"No law of the sample explains the record: {100 * self.explained:.2g} % of the runs "
            "lie as far from the others as it does. Look for what differs: a sensor's numbers, "
            "loads, speeds, a part that the mechanism has not; the intervals hold none of that.",
        )


def posterior_of(problem: Problem, values: np.ndarray, duration: float | None = None) -> Problem:
    """The problem with variables that follow a posterior sample.

    Args:
        problem: with the priors.
        values: posterior sample, shape (samples, variables).
        duration: of its runs [s]; None: unchanged.
    """
    if duration is not None:
        check_number("duration of a posterior", duration, "s", above=0)
    middle = np.median(values, axis=0)
    correlation = score_correlation(values)
    ends = np.stack([prior_quantiles(problem, n, np.array([0.0, 1.0])) for n in problem.names])
    nominal, variables, moved = np.asarray(problem.nominal()), {}, []
    varied = [problem.variables[name] for name in problem.names]
    for i, (name, variable) in enumerate(zip(problem.names, varied, strict=True)):
        # What is no number of the mechanism keeps its nominal value.
        centre = middle[i] if isinstance(variable, (Variable, Dimension)) else nominal[i]
        moved.append(centre)
        shape = Empirical(values[:, i] - centre, low=ends[i, 0] - centre, high=ends[i, 1] - centre)
        variables[name] = eqx.tree_at(lambda variable: variable.distribution, variable, shape)
        if isinstance(variable, Dimension):
            variables[name] = Dimension(float(centre), shape, unit=variable.unit)
    if isinstance(problem.experiment, FunctionExperiment):
        units = problem.units()
        return FunctionProblem(problem.function, variables, units=units, correlation=correlation)
    lasts = float(problem.duration if duration is None else duration)
    at = [i for i, variable in enumerate(varied) if isinstance(variable, Variable)]
    centred = Setting(
        tuple(problem.names[i] for i in at),
        tuple(varied[i] for i in at),
        jnp.asarray([moved[i] for i in at]),
    )
    return Problem(
        centred(problem.mechanism),
        problem.response,
        variables,
        duration=lasts,
        integrator=problem.integrator,
        save=np.asarray(problem.shares) * lasts,
        state=problem.state,
        correlation=correlation,
    )


def score_correlation(values: np.ndarray) -> np.ndarray | None:
    """Correlation of the normal scores of a sample (samples, variables), from ranks."""
    count = values.shape[1]
    if count < 2:
        return None
    ranks = np.argsort(np.argsort(values, axis=0, kind="stable"), axis=0) + 0.5
    correlation = np.corrcoef(scipy.special.ndtri(ranks / len(values)).T)
    # Of few draws nearly dependent columns are possible; a little less than that is positive.
    least = np.linalg.eigvalsh(correlation)[0]
    if least < 10 * LEAST_EIGENVALUE:
        share = 1e-6
        correlation = (1 - share) * correlation + share * np.eye(count)
    return correlation


def together(names: Sequence[str], fitted: Regression, verdicts: Sequence[str]) -> tuple[str, ...]:
    """Sentences for combinations of unknowns that are identified better than each alone.

    Args:
        names: of the unknowns.
        fitted: regression, whose residuals are correlated.
        verdicts: of the unknowns.
    """
    scatter = fitted.scatter
    open_ = [k for k, verdict in enumerate(verdicts) if verdict != IDENTIFIED]
    if len(open_) < 2 or not np.all(np.isfinite(fitted.residuals)):
        return ()
    # Shares of a uniform prior have a variance of 1/12.
    covariance = 12 * np.cov(fitted.residuals[:, open_].T)
    variances, axes = np.linalg.eigh(covariance)
    groups = []
    for variance, axis in zip(variances, axes.T, strict=True):
        weights = axis / axis[np.argmax(np.abs(axis))]
        indices = [i for i, weight in enumerate(weights) if abs(weight) >= LEAST_WEIGHT]
        spread = float(np.sqrt(max(variance, 0.0)))
        least = min(scatter[open_[i]] for i in indices)
        if len(indices) > 1 and spread < TOGETHER and spread < 0.6 * least:
            parts = " ".join(
                f"{'+' if weights[i] > 0 else '-'} {abs(weights[i]):.2g} x {names[open_[i]]}"
                for i in indices
            ).removeprefix("+ ")
            groups.append(
                f"{' and '.join(names[open_[i]] for i in indices)} are identified only together: "
                f"{parts} (each as a share of its prior) is known to {100 * spread:.0f} % of what "
                "the priors leave."
            )
    return tuple(groups)
