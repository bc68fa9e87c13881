"""What is differentiated, and by what: a statistic of a response (mean, standard deviation,
quantile, share of parts beyond a limit) by the nominal value of a variable or the width of its
distribution.

Each statistic has an influence function: its derivative is that of the mean of this function of the
response. So what finds derivatives of means finds those of statistics. Both directions move the
values of a sample: the nominal value all by the same amount, the width each by its own deviation.
How fast a value moves is its velocity, by which every method goes.

Source: influence functions: Hampel 1974, J. Am. Stat. Assoc. 69, 383,
doi:10.1080/01621459.1974.10482962.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from jaxclear.ground.arguments import check_name, check_number, expect
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.wording import described, listed
from jaxclear.native.compiled import compiled_quickly
from jaxclear.studies.infinite_responses import INSTEAD, check_within_horizon, replace_infinite
from jaxclear.studies.problem import Problem
from jaxclear.studies.scrambling import normal_density
from jaxclear.studies.statistics.scrambled import ordinary_quantile, smooth_quantile

# The slope of a quantile by the score of its share is taken over +- this many scores: wide enough
# for some samples to lie within, narrow enough for the slope to be that of the middle.
SCORES_ASIDE = 0.3
# Where fewer samples decide a statistic, its derivative and error are chance, often both zero: of
# what methods agreed on, 72 % held with two samples beyond a limit, 43 % with one.
FEWEST_DECIDING = 4
# Numbers of samples are told in multiples of this, as many as there are scramblings.
ROUND_TO = 16
WORDS = ("mean", "standard deviation")
KINDS = ("quantile", "above", "below")


class Size(NamedTuple):
    """How large a derivative may be, in its unit: `value` where all scatter of the response were a
    line of the variable, `rounding` what arithmetic leaves of zero."""

    value: float = 0.0
    rounding: float = 0.0


class Functional(NamedTuple):
    """A statistic of a response by kind: "mean", "standard deviation", "quantile" (of a share
    `number` [1]), "above" or "below" (share [1] of parts beyond a limit `number`)."""

    response: str
    kind: str
    number: float = np.nan

    @property
    def label(self) -> str:
        """What it is called in a study's answers; a mean as its response."""
        if self.kind == "mean":
            return self.response
        if self.kind == "quantile":
            return f"{100 * self.number:g} % quantile of {self.response}"
        if self.kind in KINDS:
            sign = ">" if self.kind == "above" else "<"
            return f"P({self.response} {sign} {self.number:g})"
        return f"{self.kind} of {self.response}"

    def unit(self, response_unit: str) -> str:
        """Its unit, from that of the response."""
        return "1" if self.kind in ("above", "below") else response_unit

    def value(self, responses: np.ndarray) -> float:
        """The statistic of a sample (samples,)."""
        if self.kind == "mean":
            return float(responses.mean())
        if self.kind == "standard deviation":
            return float(responses.std(ddof=1))
        if self.kind == "quantile":
            return smooth_quantile(responses, self.number)
        return float(np.mean(self._which_beyond(responses)))

    @property
    def smooth(self) -> bool:
        """Whether it is a smooth function of means, whose bias a jackknife tells."""
        return self.kind != "quantile"

    def deciding(self, *rows: np.ndarray) -> float:
        """How many samples decide it, of rows of responses (samples,) in the mean: those beyond a
        quantile or a limit, or all."""
        return float(np.mean([self._deciding_count(row) for row in rows]))

    def _deciding_count(self, responses: np.ndarray) -> float:
        count = len(responses)
        if self.kind == "quantile":
            return count * min(self.number, 1.0 - self.number)
        if self.kind not in KINDS:
            return float(count)
        beyond = int(np.sum(self._which_beyond(responses)))
        return float(min(beyond, count - beyond))

    def undecided(self, *rows: np.ndarray, by: str) -> str:
        """Why its derivative is not known from rows of responses (samples,), of which the mean
        counts: too few samples decide it, and how many would do of what is asked for `by` this
        name; "" where enough do."""
        deciding = self.deciding(*rows)
        if deciding >= FEWEST_DECIDING:
            return ""
        count = len(rows[0])
        text = f"only {deciding:.2g} of {count} samples decide it, and {FEWEST_DECIDING} should; "
        if not deciding:
            return f"{text}take more samples, or jaxclear.reliability for what is rare."
        enough = -(-int(np.ceil(FEWEST_DECIDING * count / deciding)) // ROUND_TO) * ROUND_TO
        return f"{text}take about {by}={enough}, or jaxclear.reliability for what is rare."

    def unbounded(self, *rows: np.ndarray) -> str:
        """Why its derivative is not known from rows of responses (samples,) of which some are
        infinite; "" where what decides is finite."""
        endless = [int(np.isinf(row).sum()) for row in rows]
        if not any(endless) or self.kind in ("above", "below"):
            return ""
        message = f"{max(endless)} of {len(rows[0])} samples are infinite, "
        if self.kind != "quantile":
            return f"{message}of which there is no {self.kind}; {INSTEAD}."
        ends = [ordinary_quantile(row, share) for row in rows for share in self._around()]
        return "" if np.all(np.isfinite(ends)) else f"{message}and the quantile is among them."

    def bounded(self, rows: np.ndarray) -> np.ndarray:
        """Responses with finite numbers in place of infinite ones, where that is no difference."""
        return replace_infinite(rows, self.number if self.kind in ("above", "below") else None)

    def _around(self) -> np.ndarray:
        """Shares (2,) [1] a little aside of that of the quantile."""
        score = scipy.special.ndtri(self.number)
        return scipy.special.ndtr([score - SCORES_ASIDE, score + SCORES_ASIDE])

    def place(self, sample: np.ndarray) -> float | None:
        """The value at which parts are told apart; None where none is."""
        if self.kind == "quantile":
            return float(np.quantile(sample, self.number))
        return self.number if self.kind in KINDS else None

    def unknown(self, sample: np.ndarray) -> float:
        """Half of the 95 % interval of the density that `influence` takes from a sample (samples,),
        as a share of it [1]: of so many samples around the quantile."""
        if self.kind != "quantile":
            return 0.0
        low, high = self._around()
        return float(scipy.special.ndtri(0.975) / np.sqrt(max(len(sample) * (high - low), 1.0)))

    def influence(self, sample: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """The function of responses whose mean has the statistic's derivative, as a sample
        (samples,) tells it."""
        if self.kind == "mean":
            return lambda y: y
        if self.kind == "standard deviation":
            mean, spread = sample.mean(), sample.std(ddof=1)
            return lambda y: (y - mean) ** 2 / (2.0 * spread) if spread > 0 else 0.0 * y
        if self.kind == "quantile":
            score = scipy.special.ndtri(self.number)
            low, high = np.quantile(sample, self._around())
            # Among samples of one value it moves by none.
            if not high > low:
                return lambda y: 0.0 * y
            density = 2 * SCORES_ASIDE * normal_density(score) / (high - low)
            place = np.quantile(sample, self.number)
            return lambda y: (y <= place) / -density
        return lambda y: self._which_beyond(y).astype(float)

    def size(self, sample: np.ndarray, step: float) -> Size:
        """How large its derivative may be, from a sample (samples,) of the response and the step of
        a direction. Sums of n numbers are off by n roundings at the most."""
        finite = sample[np.isfinite(sample)]
        if not len(finite):
            return Size()
        size = float(self.influence(finite)(finite).std()) / step
        largest = 1.0 if self.kind in ("above", "below") else float(np.abs(finite).max())
        rounding = len(finite) * np.finfo(float).eps * largest / step
        return Size(size, rounding)

    def tangent(self, responses: np.ndarray, tangents: np.ndarray) -> Any:
        """Single runs' parts of the derivative, from their tangents; None where tangents do not
        tell it."""
        if self.kind == "mean":
            return tangents
        if self.kind == "standard deviation":
            return (responses - responses.mean()) / responses.std(ddof=1) * tangents
        return None

    def _which_beyond(self, responses):
        return responses > self.number if self.kind == "above" else responses < self.number


def functionals(of: Any, problem: Problem) -> list[Functional]:
    """What a user asks derivatives of: statistics for all responses, or {response: statistics}.
    Raises `ValueError` with a sentence, also for a limit beyond what a response is told up to."""
    if not isinstance(of, Mapping):
        of = dict.fromkeys(problem.response_names, of)
    for name in of:
        check_name("response", name, problem.response_names, " in this problem")
    result = [_make_functional(name, one) for name, kinds in of.items() for one in _as_list(kinds)]
    for one in result:
        if one.kind in ("above", "below"):
            check_within_horizon(problem, one.response, one.number)
    return result


def _as_list(value: Any) -> list:
    pair = isinstance(value, tuple) and len(value) == 2 and value[0] in KINDS
    if isinstance(value, str) or pair:
        return [value]
    expect(value, (list, tuple), "of of sensitivity", 'statistics, such as ("mean",)')
    if not value:
        raise ValueError("of of sensitivity is empty; it must hold at least one statistic.")
    return list(value)


def _make_functional(response: str, value: Any) -> Functional:
    if isinstance(value, str) and value not in KINDS:
        check_name("statistic of sensitivity", value, WORDS)
        return Functional(response, value)
    if not isinstance(value, (tuple, list)) or len(value) != 2 or value[0] not in KINDS:
        raise ValueError(
            f'a statistic of sensitivity is {described(value)}; it must be "mean", "standard '
            'deviation", ("quantile", share), ("above", limit) or ("below", limit).'
        )
    kind, number = value
    if kind == "quantile":
        check_number('"quantile" of sensitivity', number, above=0, below=1)
    check_number(f'"{kind}" of sensitivity', number)
    return Functional(response, kind, float(number))


class Direction(NamedTuple):
    """The nominal value of a variable, by its place, or its width: `number` [the variable's unit]
    by which the width is told, None for the nominal value."""

    label: str
    variable: int
    number: float | None

    def velocities(self, problem: Problem, values: np.ndarray) -> np.ndarray:
        """Of the variable's values (samples, variables), per unit: (samples,)."""
        if self.number is None:
            return np.ones(len(values))
        deviations = values[:, self.variable] - float(problem.nominal()[self.variable])
        return deviations / self.number

    def step(self, problem: Problem) -> float:
        """How far a difference moves it [its unit]: by one standard deviation, or half a width."""
        if self.number is None:
            return float(problem.inputs.deviations()[self.variable])
        return 0.5 * self.number


def directions(problem: Problem, names: list[str]) -> list[Direction]:
    """The directions of these names: a variable's own, or that of its width, "tolerance of
    clearance". Raises `ValueError` for names that there are not."""
    by_name = {name: Direction(name, i, None) for i, name in enumerate(problem.names)}
    marginals = problem.marginals
    for i, (name, marginal) in enumerate(marginals.items()):
        what, number = marginal.width()
        by_name[f"{what} of {name}"] = Direction(f"{what} of {name}", i, float(number))
    for name in names:
        near = [one for one in problem.names if str(name).endswith(f" of {one}")]
        if name not in by_name and near:
            what = marginals[near[-1]].width()[0]
            raise ValueError(f'no "{name}" in this problem; there is "{what} of {near[-1]}".')
        if name in problem.variables and name not in by_name:
            numbers = listed(one for one in problem.names if one.startswith(f"{name} "))
            raise ValueError(f'"{name}" has several numbers; take a derivative by each: {numbers}.')
        check_name("variable", name, by_name, " in this problem")
    return [by_name[name] for name in names]


def _speed(distribution, number):
    """How fast a standard normal score moves, of it."""

    def speed(u):
        value, slope = jax.jvp(distribution.of_score, (u,), (jnp.ones_like(u),))
        return safe_divide(1.0 if number is None else value / number, slope)

    return speed


@compiled_quickly
def _score_weights(distribution, number, scores, leaning):
    speed, rate = jax.jvp(_speed(distribution, number), (scores,), (jnp.ones_like(scores),))
    return speed * leaning - rate


def weights(problem: Problem, direction: Direction, normal: np.ndarray) -> np.ndarray:
    """Score function of the sample's distribution, shape (samples,) [1/unit].

    The derivative of a mean is the mean of the response times this, plus what the ends of the
    distribution add.

    Args:
        problem: with the joint distribution.
        direction: variable and number that is differentiated by.
        normal: independent standard normal numbers of the sample, shape (samples, variables).
    """
    inputs, i = problem.inputs, direction.variable
    scores, leaning = normal[:, i], normal[:, i]
    if not inputs.independent:
        scores = normal @ np.asarray(inputs.root)[i]
        # The i-th component of correlation^-1 scores.
        leaning = normal @ np.asarray(inputs.inverse_root)[:, i]
    law = inputs.distributions[i]
    return np.asarray(_score_weights(law, direction.number, scores, leaning))
