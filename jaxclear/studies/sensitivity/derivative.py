"""A derivative as an answer: a value, its error, the method that gave it, and a verdict.

At least two methods agree within their errors, or the verdict says that they do not. An error is
half the width of a 95 % interval, in the derivative's own unit. A regression has seen the most
parts, and runs further out than these, so it is the answer wherever it has one. What has seen fewer
confirms it, and does not take its place where it states a smaller error: it may lack a branch.
"""

from typing import NamedTuple

import equinox as eqx
import numpy as np

from jaxclear.ground.printing import AbstractShown, in_few, with_error, with_text_repr
from jaxclear.ground.wording import unit_of_rate
from jaxclear.studies.answer import DATASET, RESPONSE, VARIABLE, AbstractAnswer, Column, Stated
from jaxclear.studies.monte_carlo import MonteCarlo
from jaxclear.studies.run_warnings import FEW_WARNED
from jaxclear.studies.sensitivity.estimand import Size
from jaxclear.studies.statistics.scrambled import half_widths

# An answer this many times less certain than another is large agrees with anything, and confirms
# nothing; of a zero, one whose error is no small part of all that the variable could do.
VAGUE = 3.0
# Of a difference of numbers that are nearly the same, which no scatter of samples shows; and what
# is smaller than this share of another method's error is zero.
ROUNDING = 1e-9
# Share of a derivative, or of all that the variable could do, by which methods of vanishing scatter
# differ because of the runs' own steps.
STEPS = 1e-6
# Methods that are both right differ by more than this many times the 95 % error of their difference
# once in a hundred; what is called a disagreement should be one.
TOGETHER = 2.576 / 1.96
# The method that has seen the most parts, and runs further out than these.
WIDEST = "regression"
# What is told of each method beside the answer.
PARTS = ("value", "error", "refusal", "warnings")


@with_text_repr
class Estimate(NamedTuple):
    """A derivative by one method. `error` is half the width of its 95 % interval, bias included;
    `refusal` says why a method has no answer (then value and error are nan). `doubt` says what its
    error leaves out: such an estimate stands only beside one without doubt that agrees with it.
    `warned` [1] is the share of its runs with warnings that concern the response, `warnings` what
    they are; `runs` is how many it took."""

    value: float
    error: float
    refusal: str = ""
    doubt: str = ""
    warned: float = 0.0
    warnings: str = ""
    runs: int = 0

    def __str__(self) -> str:
        return f"no answer: {self.refusal}" if self.refusal else with_error(self.value, self.error)


def from_parts(parts: np.ndarray, bias: float = 0.0) -> Estimate:
    """The mean of contributions (scramblings,), with their interval and a bias."""
    if len(parts) < 2 or not np.all(np.isfinite(parts)):
        return refused("the sample has too few independent scramblings to tell an error.")
    return Estimate(float(parts.mean()), float(np.hypot(max(half_widths(parts)), bias)))


def refused(why: str) -> Estimate:
    """No answer, and the sentence that says why."""
    return Estimate(np.nan, np.nan, why)


@with_text_repr
class Derivative(AbstractShown):
    """Derivative of a statistic of a response over the tolerances (by default its mean) with
    respect to one variable or the width of its distribution, with its 95 % error.

    `value` and `error` are in [response/variable]; see `Sensitivity.unit`. The error holds what the
    steps of the study do, as its replicas tell it. `estimates` are the methods' own answers, whose
    errors do not; `verdict` is a sentence that says whether they agree, and which of their runs
    warn, and `trustworthy` whether at least two do and hardly any warns.
    """

    response: str = eqx.field(static=True)
    variable: str = eqx.field(static=True)
    value: float
    error: float
    method: str = eqx.field(static=True)
    verdict: str = eqx.field(static=True)
    trustworthy: bool = eqx.field(static=True)
    estimates: dict[str, Estimate]

    def _summary(self):
        return self.sentence()

    def sentence(self, unit: str = "") -> str:
        """The derivative, in a `unit`, and its verdict."""
        value = f"{with_error(self.value, self.error)} {unit}".rstrip()
        return f"d({self.response})/d({self.variable}) = {value}. {self.verdict}"


class Sensitivity(AbstractAnswer):
    """Derivatives by (response, variable), and the sample behind them. Statistics other than means
    and widths of distributions go by their own names, "standard deviation of force", "tolerance of
    clearance"; `units` are theirs."""

    derivatives: dict[tuple[str, str], Derivative]
    sample: MonteCarlo
    units: dict[str, str] = eqx.field(static=True, default_factory=dict)

    def unit(self, response: str, variable: str) -> str:
        """Unit of a derivative, that of the response by that of the variable."""
        problem = self.sample.problem
        units = dict(zip(problem.names, problem.variable_units, strict=True)) | self.units
        above = self.units.get(response) or problem.units()[response]
        return unit_of_rate(above, units[variable])

    def _summary(self):
        return "\n".join(self._lines())

    def sentence(self) -> str:
        """Every derivative with its verdict."""
        return " ".join(self._lines())

    def _lines(self) -> list[str]:
        lines = [
            derivative.sentence(self.unit(response, variable))
            for (response, variable), derivative in self.derivatives.items()
        ]
        failed, count = len(self.sample.failed), self.sample.count
        if failed:
            lines.append(
                f"{failed} of {count} samples failed and are left out: that a variable moves which "
                "of them fail is not in its derivatives."
            )
        return lines

    def _stated(self):
        over, every = (RESPONSE, VARIABLE), self.derivatives
        read = lambda part: {key: getattr(e, part) for key, e in every.items()}
        columns = {
            "derivative": Column(
                over, read("value"), error=read("error"), error_name="error (95 %)"
            ),
            "error": Column(over, read("error"), only=DATASET),
            "unit": Column(over, {key: self.unit(*key) for key in every}),
            "method": Column(over, read("method")),
            "verdict": Column(over, read("verdict")),
            "trustworthy": Column(over, read("trustworthy"), only=DATASET),
        }
        for method in dict.fromkeys(m for e in every.values() for m in e.estimates):
            ones = {key: d.estimates[method] for key, d in every.items() if method in d.estimates}
            entries = {part: {k: getattr(one, part) for k, one in ones.items()} for part in PARTS}
            columns[method] = Column(over, entries["value"], error=entries["error"])
            columns[f"{method} refusal"] = Column(over, entries["refusal"])
            columns[f"{method} warnings"] = Column(over, entries["warnings"])
        numbers = {"samples": self.sample.count}
        return Stated("sensitivity", columns, self.sample.problem, (), numbers)


def confirmed(
    response: str, variable: str, estimates: dict[str, Estimate], size: Size = Size()
) -> Derivative:
    """One derivative from the estimates of several methods.

    It is the regression's, or else the most certain one without doubt, if another method confirms
    it.

    Args:
        response: its name.
        variable: its name.
        estimates: by method.
        size: beside which a derivative of zero is small.
    """
    estimates = _without_unconfirmed(estimates)
    order = sorted(_by_certainty(estimates, size), key=lambda name: name != WIDEST)
    # Errors hold what arithmetic leaves.
    off = lambda estimate: float(np.hypot(estimate.error, size.rounding))
    estimates = {name: one._replace(error=off(one)) for name, one in estimates.items()}

    def answer(value, error, method, verdict, trustworthy=False):
        verdict += "".join(
            f" In {name}, {e.warnings}" for name, e in estimates.items() if e.warnings
        )
        if trustworthy and max(e.warned for e in estimates.values()) > FEW_WARNED:
            verdict, trustworthy = f"{verdict} Too many for agreement to count.", False
        return Derivative(response, variable, value, error, method, verdict, trustworthy, estimates)

    for name in order:
        best = estimates[name]
        if best.doubt:
            continue
        partners = [other for other in order if other != name and _agree(best, estimates[other])]
        if partners:
            verdict = _agreement(estimates, name, partners, order)
            return answer(best.value, best.error, name, verdict, trustworthy=True)
    why = "".join(f" No {name}: {e.refusal}" for name, e in estimates.items() if e.refusal)
    if not order:
        return answer(np.nan, np.nan, "none", f"No method has an answer.{why}")
    if len(order) == 1:
        best = estimates[order[0]]
        vague = [n for n, e in estimates.items() if n != order[0] and np.isfinite(e.value)]
        unsure = f"Unconfirmed: the error of {' and '.join(vague)} is too large to tell.{why}"
        verdict = unsure if vague else f"Unconfirmed: only {order[0]} has an answer.{why}"
        return answer(best.value, best.error, order[0], verdict)
    middle, spread = _covering([estimates[name] for name in order])
    if spread <= STEPS * max(abs(middle), size.value):
        names = " and ".join(order)
        verdict = f"From {names}, which agree."
        return answer(middle, spread, names, verdict, trustworthy=True)
    return answer(middle, spread, "spread of methods", "The methods disagree.")


def _covering(estimates: list[Estimate]) -> tuple[float, float]:
    """(a value near the more certain ones, half of an interval about it that holds the whole
    interval of each): of equally certain ones the middle."""
    values, errors = (np.array(column) for column in zip(*[e[:2] for e in estimates], strict=True))
    # An error of zero would leave no weight to others that are as certain.
    weights = np.maximum(errors, max(ROUNDING * errors.max(), np.finfo(float).tiny)) ** -2.0
    middle = float(weights @ values / weights.sum())
    return middle, float(np.max(np.abs(values - middle) + errors))


def _without_unconfirmed(estimates: dict[str, Estimate]) -> dict[str, Estimate]:
    """The estimates, those in doubt refused unless they lie within the error of one without."""
    sure = [e for e in estimates.values() if not e.doubt and np.isfinite(e.value + e.error)]

    def check(estimate):
        if not estimate.doubt or any(_agree(estimate, other) for other in sure):
            return estimate
        which = "other methods disagree" if sure else "no other method has an answer"
        return refused(f"{estimate.value:.4g}, but {which}, and {estimate.doubt}.")

    return {name: check(estimate) for name, estimate in estimates.items()}


def _by_certainty(estimates: dict[str, Estimate], size: Size = Size()) -> list[str]:
    """The methods with an answer that is not vague beside the most certain one, which is first. One
    that contradicts it does not agree with anything."""
    answers = {name: e for name, e in estimates.items() if np.isfinite(e.value + e.error)}
    order = sorted(answers, key=lambda name: (bool(answers[name].doubt), answers[name].error))
    if not order:
        return []
    best = answers[order[0]]
    largest = max(VAGUE * (abs(best.value) + best.error), size.value / VAGUE, size.rounding)
    # A zero, but for rounding, makes no other answer vague.
    least = ROUNDING * max(answers[name].error for name in order)
    if largest <= least:
        return order
    is_vague = lambda answer: answer.error > largest and _agree(best, answer)
    return [name for name in order if not is_vague(answers[name])]


def _agree(a: Estimate, b: Estimate) -> bool:
    """Whether the difference of two estimates is chance, or rounding."""
    rounding = ROUNDING * max(abs(a.value), abs(b.value))
    return bool(abs(a.value - b.value) <= TOGETHER * np.hypot(a.error, b.error) + rounding)


def confirms(estimates: dict[str, Estimate], name: str) -> bool:
    """Whether a method confirms another one that is more certain."""
    order = _by_certainty(estimates)
    best = estimates[order[0]] if order else None
    return (
        best is not None and not best.doubt and name in order[1:] and _agree(best, estimates[name])
    )


def _agreement(
    estimates: dict[str, Estimate], name: str, partners: list[str], order: list[str]
) -> str:
    best = estimates[name]
    others = [other for other in order if other != name and other not in partners]
    nearest = min(estimates[other].error for other in partners)
    zero = best.error > abs(best.value)
    # What is wider than the value agrees with its opposite too.
    is_wide = nearest > abs(best.value) and not zero
    width = f" (±{in_few(nearest, 2)})" if nearest > ROUNDING * abs(best.value) else ""
    by = f"{' and '.join(partners)}{width}"
    verdict = f"From {name}, confirmed by {by}."
    if is_wide:
        verdict = f"From {name}. That by {by} is consistent but too wide to confirm it."
    verdict += f" Not confirmed by {' and '.join(others)}." if others else ""
    return f"{verdict} Not distinguishable from zero." if zero else verdict
