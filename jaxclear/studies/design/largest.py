"""How large a number may be, `jaxclear.largest`: the largest mean of one variable at which a limit
holds with the upper end of the 95 % interval of its number (the lower end, of a limit from below).
The same random numbers serve all trials, so the number changes smoothly with the variable and is
bracketed. Intervals of quantiles are read off from those of shares: a jackknife of them is too
narrow.
"""

from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_flags, check_name, check_number, expect
from jaxclear.ground.printing import as_written, in_few, with_error, with_text_repr
from jaxclear.studies.answer import AbstractAnswer, Column, Stated
from jaxclear.studies.design.limit import AbstractLimit
from jaxclear.studies.design.population import GROUPS, in_groups
from jaxclear.studies.design.question import Question, checked_limits, freedom_of
from jaxclear.studies.design.runs import BATCH, Runs
from jaxclear.studies.design.verification import FEW_FAILED, INSTEAD
from jaxclear.studies.infinite_responses import refuse_infinite
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_warnings import sentences
from jaxclear.studies.statistics.summary import samples_that_bound
from jaxclear.studies.store.store import stored


@with_text_repr
class Trial(NamedTuple):
    """A trial at a `value` of the variable: the limited `number` with its 95 % `error`, by how much
    both are beyond the bound (`excess`, inf where too many runs fail), the share of
    `failed` runs, and what runs warn of."""

    value: float
    number: float
    error: float
    excess: float
    failed: float
    warnings: tuple[str, ...]

    def __str__(self) -> str:
        holds = "holds" if self.excess <= 0 else "does not hold"
        number = with_error(self.number, self.error)
        return f"at {in_few(self.value, 4)} the limit {holds}: {number}"


class Largest(AbstractAnswer):
    """The largest `value` of a variable at which a limit holds; nan where it holds at neither end
    of the range. `trials` are sorted by value; `best` is that of the answer."""

    problem: Problem
    limit: AbstractLimit
    variable: str = eqx.field(static=True)
    trials: tuple[Trial, ...] = eqx.field(static=True)
    runs: int = eqx.field(static=True)

    @property
    def best(self) -> Trial | None:
        """The trial with the largest value of those that hold; None if none does."""
        return max((t for t in self.trials if t.excess <= 0), key=lambda t: t.value, default=None)

    @property
    def value(self) -> float:
        """The largest value, in the unit of the variable."""
        return np.nan if self.best is None else self.best.value

    @property
    def units(self) -> tuple[str, str]:
        """Units of the variable and of the limited number."""
        by_name = dict(zip(self.problem.names, self.problem.variable_units, strict=True))
        response = (self.problem.units() | by_name)[self.limit.response]
        return by_name[self.variable], self.limit.unit(response)

    def sentence(self) -> str:
        """How large the variable may be, and what limits it."""
        units = [unit.removeprefix("1") for unit in self.units]
        side = "at most" if self.limit.upper() else "at least"
        bound = f"{side} {as_written(self.limit.bound())} {units[1]}".rstrip()
        best = self.best

        def result(trial):
            if trial.failed > _allowed_failures(self.limit):
                return f"{100 * trial.failed:.3g} % of the runs fail"
            number = f"{with_error(trial.number, trial.error)} {units[1]}".rstrip()
            return f"the {self.limit.words()} is {number}"

        place = lambda trial: f"{in_few(trial.value, 4)} {units[0]}".rstrip()
        if best is None:
            ends = " and ".join(f"at {place(t)} {result(t)}" for t in self.trials)
            return f"{self.variable} keeps the limit ({bound}) at neither end of its range: {ends}."
        start, there = f"{self.variable} may be {place(best)}", f"there {result(best)} ({bound})"
        if best is self.trials[-1]:
            return f"{start}, the largest of its range: {there}."
        above = self.trials[self.trials.index(best) + 1]
        text = f"{start} at most: {there}, by {self.runs} runs."
        error = f" At {place(above)} only the error is beyond it: more samples make it smaller."
        return text + error * (above.excess <= above.error)

    def _stated(self):
        read = lambda part: [getattr(trial, part) for trial in self.trials]
        of_variable, of_number = self.units
        over = ("trial",)
        columns = {
            self.variable: Column(over, read("value"), of_variable),
            self.limit.words(): Column(over, read("number"), of_number, error=read("error")),
            "holds": Column(over, [trial.excess <= 0 for trial in self.trials]),
            "failed": Column(over, read("failed"), "1"),
        }
        warnings = () if self.best is None else self.best.warnings
        return Stated("largest value", columns, self.problem, warnings, labelled=False)


def _allowed_failures(limit: AbstractLimit) -> float:
    """Share of the runs that may fail [1]."""
    return min(FEW_FAILED, limit.rarest())


@answering
@stored("a largest value")
def largest(
    problem: Problem,
    variable: str,
    limit: AbstractLimit,
    between: tuple[float, float],
    *,
    accuracy: float = 0.01,
    samples: int = 256,
    seed: int = 0,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> Largest:
    """Find the largest mean of a variable at which a limit holds.

    The variable keeps its tolerance, all others vary as the problem says. The limit holds where its
    number, with its 95 % error, is within the bound. A limit that holds, fails and holds again over
    the range is bracketed at one of its crossings.

    Args:
        problem: the problem.
        variable: name of the variable.
        limit: a member of `jaxclear.limit` other than `WorstCase`.
        between: smallest and largest mean, a pair in the unit of the variable.
        accuracy: width of the last bracket relative to the answer [1], > 0 and < 1; 0.01 by
            default.
        samples: number of runs of each trial, >= 16, and so many that some are beyond the bound
            of a rare share; 256 by default, enough for a share of 0.03.
        seed: seed of the random numbers; 0 by default.
        store: folder that keeps the runs; None (default) for none.
        progress_bar: whether to show the progress; False by default.

    Returns:
        The `Largest`.

    Raises:
        ValueError: if an argument is wrong, or samples are too few for the limit.
    """
    expect(problem, Problem, "the problem of largest", "a problem of jaxclear")
    check_name("variable", variable, problem.names, " in this problem")
    [checked] = checked_limits(limit, problem)
    if checked.extreme():
        raise ValueError(
            f'limit.{type(limit).__name__} of "{limit.response}" looks at the ends of tolerances, '
            "largest at samples: give a limit.Quantile or a limit.Probability."
        )
    freedom = freedom_of(problem, {variable: between}, None, [])
    check_number("accuracy of largest", accuracy, above=0, below=1)
    check_count("samples of largest", samples, at_least=16)
    needed = samples_that_bound(checked.rarest(), GROUPS)
    if samples < needed:
        raise ValueError(
            f"samples of largest is {samples}, too few for the {checked.words()}: it must be at "
            f"least {needed:.0f}."
        )
    check_count("seed of largest", seed, at_least=0)
    check_flags("largest", progress_bar=progress_bar)
    question = Question(freedom, {}, (checked,), problem.inputs, np.ones(1))
    runs = Runs(problem, progress_bar, min(BATCH, samples))
    # The same parts in each trial, but for the mean of the variable.
    normal, _, group = in_groups(problem.names, samples, seed)
    trials: list[Trial] = []

    def excess_at(value: float) -> float:
        first = runs.count
        values = np.asarray(question.values(jnp.array([freedom.place(0, value)]), normal))
        responses = runs.ask(values, "trials")
        good = ~np.isnan(responses).any(axis=1)
        by_name = dict(zip(problem.response_names, responses.T, strict=True))
        data = np.asarray(question.of(checked, values, by_name))[good]
        if checked.by_moments():
            refuse_infinite(problem, {checked.response: data}, "mean or deviation", INSTEAD)
        estimate = checked.estimate(data, group[good])
        failed, excess, bound = 1.0 - float(good.mean()), np.inf, float(checked.bound())
        if failed <= _allowed_failures(checked):
            excess = estimate.high - bound if checked.upper() else bound - estimate.low
        warnings = sentences(problem, runs.warned(first), [limit.response])
        numbers = float(estimate.value), float(estimate.error)
        trials.append(Trial(value, *numbers, float(excess), failed, warnings))
        return trials[-1].excess

    low, high = map(float, between)
    below, above = excess_at(low), excess_at(high)
    # Illinois: regula falsi that halves the weight of an end that stays.
    while below <= 0 < above and high - low > accuracy * max(abs(low), abs(high)):
        is_finite = np.isfinite(above) and below < above
        share = below / (below - above) if is_finite else 0.5
        # Neither end is tried again, and the bracket shrinks.
        middle = low + float(np.clip(share, 0.05, 0.95)) * (high - low)
        excess = excess_at(middle)
        if excess <= 0:
            low, below, above = middle, excess, 0.5 * above
        else:
            high, above, below = middle, excess, 0.5 * below
    return Largest(problem, checked, variable, tuple(sorted(trials)), runs.count)
