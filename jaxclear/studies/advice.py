"""The integrator to take for a problem at an accuracy of its responses, what the others cost, and
what another model of contact leaves out.

It is the choice that `accuracy=` makes (`errors.choice`), asked of more rungs and of several
samples, with all that it saw. A setting's error is what finer ones, its replicas, change; what a
model leaves out is how far it is from the stated one, beside that one's reference.
"""

import math
import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from tqdm import tqdm

from jaxclear.errors.accuracy import ratio_to_allowed
from jaxclear.errors.choice import Question, Rung, Search, Tried, budget_of, others_of, rungs_of
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_flags, check_number, expect
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.printing import as_typed, with_text_repr
from jaxclear.ground.quantity import AbstractQuantified, count, inside, numbers
from jaxclear.integrators import AbstractIntegrator
from jaxclear.native.compiled import AROUND_A_KERNEL, compiled_quickly
from jaxclear.simulation.initial_state import beginning
from jaxclear.simulation.saving import Saving
from jaxclear.simulation.simulate import How, check_run, repeated
from jaxclear.studies.answer import AbstractAnswer, Column, Stated
from jaxclear.studies.problem import Problem
from jaxclear.studies.responses import answer
from jaxclear.studies.run_experiment import RunExperiment
from jaxclear.studies.sampling import draw

# What the user had.
PRESENT = "the problem's own"
# Of n copies the worst must keep within n / (n + SPARED) of the accuracy: then another one exceeds
# it about once in a hundred where errors scatter normally, whatever n.
SPARED = 3.0
# So many times the work of a choice may go into an advice where that does not pay for a run under
# error control, beside which the others stand: the contacts of a flap, of rates of 1e9 1/s, close
# all at once.
MORE = 10.0
PARTING = "Where single runs part, as chaotic ones do, ask for means over a sample (monte_carlo)."


class PilotSettings(AbstractQuantified):
    """The trial runs on which an advice is based.

    Args:
        copies: number of copies of the mechanism, the nominal one and others drawn from the
            tolerances; 8 by default. Use more where the answer says that paths separate.
        seed: seed that draws the copies; 0 by default.
    """

    copies: int = count(8, "nominal and perturbed runs")
    seed: int = count(0, "seed that draws the copies", at_least=0)


class Runs(NamedTuple):
    """The runs of all copies by one setting: `answers` (copies,) by response; steps accepted and
    rejected in a run, on the mean; why one failed ("": none did), what they warn of; whether
    nothing by this kind of steps can be asked (`refused`)."""

    answers: dict[str, np.ndarray]
    accepted_steps: float
    rejected_steps: float
    failure: str
    warnings: str
    refused: bool

    @property
    def succeeded(self) -> bool:
        """Whether all runs gave numbers."""
        return not self.failure

    @property
    def steps(self) -> float:
        """Steps of a run, on the mean."""
        return self.accepted_steps + self.rejected_steps


class Copies:
    """A problem and the values (copies, variables) that it is run for, nominal first; by every
    setting once. `times` [s]: its saving times."""

    def __init__(self, problem: Problem, values: np.ndarray):
        self.problem, self.values = problem, values
        self.times = np.asarray(problem.shares * problem.duration)
        how = How(Saving(self.times, problem.events), problem.state)
        duration = float(problem.duration)
        self._runs = [repeated(problem.with_values(row), duration, how) for row in values]
        self._drawn = compiled_quickly(self._answers, AROUND_A_KERNEL)
        self._cache: dict[tuple, Runs] = {}

    def _answers(self, run: Any) -> dict[str, Any]:
        return {name: answer(name, f, run) for name, f in self.problem.response.items()}

    def run(self, integrator: AbstractIntegrator, share: float = 1.0) -> Runs:
        """All copies over a share of the duration. What an integrator cannot do is a sentence."""
        leaves, kind = jax.tree.flatten(integrator)
        key = kind, share, *(np.asarray(leaf).tobytes() for leaf in leaves)
        if key not in self._cache:
            self._cache[key] = self._run(integrator, share)
        return self._cache[key]

    def _run(self, integrator: AbstractIntegrator, share: float) -> Runs:
        rows, steps = [], np.zeros(2)
        warned: list[str] = []
        failure, refused = "", False
        for again in self._runs:
            try:
                run = again(integrator, share)
                steps += int(run.accepted_steps), int(run.rejected_steps)
                failure = "" if run.succeeded else run.result
                answers = {} if failure else self._drawn(run)
            except (ValueError, TypeError, NotImplementedError) as error:
                failure, refused = str(error), True
            if failure:
                break
            warned += run.warnings[:1]
            rows.append({name: float(x) for name, x in answers.items()})
        accepted, rejected = steps / max(len(rows), 1)
        answers = {n: np.array([row[n] for row in rows]) for n in self.problem.response_names}
        endless = [f'"{n}"' for n, values in answers.items() if not np.all(np.isfinite(values))]
        if endless and not failure:
            failure = f"not finite: response {', '.join(endless)}."
        message = f"{len(warned)} of {len(rows)} runs warn: {warned[0]}" if warned else ""
        return Runs(answers, accepted, rejected, failure, message, refused)

    def seconds(self, integrator: AbstractIntegrator) -> float:
        """Computing time of the nominal run [s], compiled before."""
        start = time.process_time()
        self._drawn(self._runs[0](integrator, 1.0))
        return time.process_time() - start


class Accuracy(NamedTuple):
    """The accuracy [1] asked of responses, beside their root mean square over the copies."""

    accuracy: float

    def limit(self, copies: int) -> float:
        """The largest error told that passes [1]."""
        return self.accuracy * (1.0 if copies == 1 else copies / (copies + SPARED))

    def error_ratios(self, one: dict, other: dict) -> dict[str, float]:
        """By response how far two settings are apart, beside what is allowed."""
        ratios = {}
        for name, values in one.items():
            allowed = float(np.sqrt(np.mean(values**2))) * self.limit(len(values))
            ratios[name] = ratio_to_allowed(float(np.max(np.abs(values - other[name]))), allowed)
        return ratios


@with_text_repr
class Trial(NamedTuple):
    """A setting of a `method`: its `work` in a run [evaluations of forces], its `errors` by
    response as shares [1] of that, as told by finer settings; what its model leaves out
    (`left_out`, the same, empty where it is the stated one), whether it `meets` the accuracy."""

    method: str
    integrator: AbstractIntegrator
    work: int
    errors: dict[str, float]
    left_out: dict[str, float]
    meets: bool
    remark: str = ""

    @property
    def total(self) -> dict[str, float]:
        """Errors with what the model leaves out."""
        return {n: max(error, self.left_out.get(n, 0.0)) for n, error in self.errors.items()}

    @property
    def worst(self) -> tuple[str, float]:
        """The response that is off furthest, and by which share."""
        total = self.total
        name = max(total, key=lambda each: total[each], default="")
        return name, total.get(name, math.nan)

    def __str__(self) -> str:
        """The setting, its error and its work as a sentence."""
        if self.remark:
            return f"{as_typed(self.integrator)} fails: {self.remark}"
        (name, error), verb = self.worst, "keeps" if self.meets else "does not keep"
        return (
            f"{as_typed(self.integrator)} {verb} the accuracy: estimated error {_percent(error)} "
            f'in "{name}", {self.work} evaluations of forces a run.'
        )


class Advice(AbstractAnswer):
    """What to take for `original_problem`. `recommended` is the integrator, `problem` the problem
    with it, `sentence()` the answer in words, `why_not()` what is wrong with the others, `table()`
    every trial; `jaxclear.plot.work_precision` draws it.

    `chosen`: the trial that is recommended, `trials` all of them; `cost` [s/s]: CPU time for a
    simulated second of one run. `at(accuracy)` asks the same at another accuracy, and runs
    only what is not known yet.
    """

    copies: Copies = eqx.field(static=True)
    request: Accuracy
    rungs: "_Rungs"
    trials: tuple[Trial, ...]
    chosen: Trial
    cost: float

    @property
    def original_problem(self) -> Problem:
        """The problem without the advice."""
        return self.copies.problem

    @property
    def accuracy(self) -> float:
        """The accuracy that was asked for [1]."""
        return self.request.accuracy

    @property
    def is_accurate(self) -> bool:
        """True where the recommended setting keeps the accuracy, as finer ones tell."""
        return self.chosen.meets

    @property
    def recommended(self) -> AbstractIntegrator:
        """The integrator to take."""
        return self.chosen.integrator

    @property
    def problem(self) -> Problem:
        """The problem with the recommended integrator."""
        return self.original_problem.with_integrator(self.recommended)

    def at(self, accuracy: float) -> "Advice":
        """The same at another accuracy."""
        return _advised(self.copies, self.request._replace(accuracy=_checked(accuracy)), self.rungs)

    def sentence(self) -> str:
        """The answer in plain words."""
        parts = [self._recommended(), *self._models(), self._present_text()]
        if not self.is_accurate:
            parts.append(PARTING)
        many = len(self.copies.values)
        runs = "one run" if many == 1 else f"{many} runs within the tolerances"
        return " ".join([*parts, *self.warnings(), f"From {runs}."])

    def _recommended(self) -> str:
        trial, limit = self.chosen, _percent(self.accuracy)
        text, (which, error) = as_typed(trial.integrator), trial.worst
        named = f' in "{which}"' if len(trial.errors) > 1 else ""
        keeps = f"{text} keeps {limit}:"
        head = keeps if self.is_accurate else f"No integrator that was tried keeps {limit}; {text}:"
        seconds = f"{self.cost * float(self.original_problem.duration):.2g} s"
        return (
            f"{head} estimated error {_percent(error)}{named}, {trial.work} evaluations of forces "
            f"a run, {seconds} here."
        )

    def _models(self) -> Iterator[str]:
        for name in self.rungs.other:
            trials = [trial for trial in self.trials if trial.method == name and trial.left_out]
            if trials:
                best = min(trials, key=lambda trial: trial.worst[1])
                which, off = best.worst
                yield (
                    f"{as_typed(best.integrator)}, another model of contact, is {_percent(off)} "
                    f'off in "{which}" with {self._times(best)}.'
                )

    def _times(self, trial: Trial) -> str:
        return f"{trial.work / max(self.chosen.work, 1):.2g} times the work"

    def _present_text(self) -> str:
        (present,) = (trial for trial in self.trials if trial.method == PRESENT)
        text = f"The problem's own {as_typed(present.integrator)}"
        if present.remark:
            return f"{text} fails: {present.remark}"
        which, off = present.worst
        return f'{text} is {_percent(off)} off in "{which}" with {self._times(present)}.'

    def _summary(self):
        others = (f"Not {name}: {why}" for name, why in self.why_not().items())
        return self.sentence(), *others

    def warnings(self) -> list[str]:
        """What the runs of the recommended setting warn of, in sentences."""
        warnings = self.copies.run(self.recommended).warnings
        return [warnings] if warnings else []

    def why_not(self) -> dict[str, str]:
        """Why each other method is not the one recommended, in a sentence."""
        names = [*self.rungs.stated, *self.rungs.other]
        return {name: self._why_not(name) for name in names if name != self.chosen.method}

    def _why_not(self, name: str) -> str:
        trials = [trial for trial in self.trials if trial.method == name]
        tried = [trial for trial in trials if not trial.remark]
        if trials and not tried:
            return f"fails: {trials[-1].remark}"
        if not tried:
            return "dearer: its first setting takes more than what is recommended."
        best = min(tried, key=lambda trial: trial.worst[1])
        ratio = self._times(best)
        if best.meets:
            cause = "another model of contact" if best.left_out else "dearer"
            return f"{cause}: {as_typed(best.integrator)} keeps it with {ratio}."
        which, off = best.worst
        text = f'{_percent(off)} in "{which}" with {as_typed(best.integrator)}'
        if best.left_out:
            return f"another model of contact: {text}, at {ratio}."
        if off <= self.accuracy:
            return f"too near: {text}, at {ratio}, leaves too little to samples not seen."
        return f"too inaccurate: {text}, at {ratio}."

    def _stated(self):
        responses, every = self.original_problem.response_names, self.trials
        over = lambda read: [read(trial) for trial in every]
        entries = {
            "method": over(lambda t: t.method),
            "setting": over(lambda t: as_typed(t.integrator)),
            "work": over(lambda t: t.work),
            "worst response": over(lambda t: t.worst[0]),
            "error": over(lambda t: t.worst[1]),
        }
        for name in responses:
            entries[f"error in {name}"] = over(lambda t, name=name: t.errors.get(name, math.nan))
        omitted = lambda t: max(t.left_out.values(), default=math.nan)
        entries |= {
            "left out by the model": over(omitted),
            "meets": over(lambda t: t.meets),
            "recommended": over(lambda t: t is self.chosen),
            "remark": over(lambda t: t.remark),
        }
        columns = {name: Column(("trial",), values) for name, values in entries.items()}
        return Stated("advice", columns, self.original_problem)


class _Rungs(NamedTuple):
    """Rungs by the name of their method: of the model as it is `stated`, and of `other` models of
    contact."""

    stated: dict[str, Rung]
    other: dict[str, Rung]


@answering
def advise(
    problem: Problem,
    accuracy: float = 0.01,
    *,
    pilot: PilotSettings | None = None,
    progress_bar: bool = False,
) -> Advice:
    """Find the integrator that reaches an accuracy in every response at the least work.

    It makes the choice of `Problem(accuracy=)` from several copies of the mechanism and more
    methods. Work is counted in evaluations of forces.

    Args:
        problem: the `Problem`.
        accuracy: largest error of a response, as a factor of its root mean square over the copies
            [1]; 0.01 by default.
        pilot: `PilotSettings` of the trial runs; None for the defaults.
        progress_bar: whether to show the progress; False by default.

    Returns:
        The `Advice`.

    Raises:
        ValueError: if an argument is wrong, or no run gives numbers.
    """
    check_double_precision()
    expected = "a jaxclear.Problem of a mechanism in time"
    expect(problem, Problem, "what advice is given on", expected)
    expect(problem.experiment, RunExperiment, "what advice is given on", expected)
    pilot = PilotSettings() if pilot is None else pilot
    expect(pilot, PilotSettings, "the pilot", "a jaxclear.PilotSettings")
    check_flags("advise", progress_bar=progress_bar)
    request, copies = Accuracy(_checked(accuracy)), Copies(problem, _values(problem, pilot))
    return _advised(copies, request, _rungs(problem, copies.times), progress_bar)


def _searched(
    copies: Copies, request: Accuracy, rungs: _Rungs, bar: Any
) -> tuple[Search, dict[str, list[Tried]]]:
    """The search among rungs of the stated model, and by method what was judged, of others too."""
    difference = lambda _, one, other: request.error_ratios(one, other)
    question = Question(lambda runs: runs.answers, difference, copies.times)
    tried: dict[str, list[Tried]] = {}
    for budget in (budget_of(copies.times), MORE * budget_of(copies.times)):
        search = Search(copies.run, question, budget)
        for name, rung in rungs.stated.items():
            judged_before = len(search.judged)
            search.climb(rung)
            tried[name] = search.judged[judged_before:]
            bar.update(1)
        controlled = [name for name, rung in rungs.stated.items() if rung.controlled]
        if not controlled or any(tried[name] for name in controlled):
            break
    for name, rung in rungs.other.items():
        aside = Search(copies.run, question, budget, search.best)
        if copies.run(rung.first).refused:
            aside.judged.append(Tried(rung, rung.first, None, None, 0, {}))
        else:
            aside.climb(rung)
        tried[name] = aside.judged
        bar.update(1)
    return search, tried


def _advised(
    copies: Copies, request: Accuracy, rungs: _Rungs, progress_bar: bool = False
) -> Advice:
    steps = len(rungs.stated) + len(rungs.other)
    with tqdm(total=steps, desc="advice", disable=not progress_bar) as bar:
        search, tried = _searched(copies, request, rungs, bar)
    best = search.best or search.nearest
    if best is None:
        raise ValueError(_why_nothing(copies, rungs))
    for name, answers in best.observed.items():
        if not np.any(answers):
            raise ValueError(
                f'response "{name}" is 0 in every copy, which gives an error no measure; add its '
                "size to it, or leave it out."
            )
    reference, limit = (search.reference or best).observed, request.limit(len(copies.values))
    shares = lambda errors: {name: limit * error for name, error in errors.items()}
    off = lambda answers: shares(request.error_ratios(answers, reference))
    are_within_limit = lambda errors: all(error <= limit for error in errors.values())

    def trial(name: str, one: Tried) -> Trial:
        omitted = off(one.observed) if name in rungs.other and one.errors else {}
        meets = one.error_ratio <= 1 and are_within_limit(omitted)
        why = copies.run(one.integrator).failure or ("" if one.errors else "in finer steps.")
        return Trial(name, one.integrator, one.work, shares(one.errors), omitted, meets, why)

    trials = {id(one): trial(name, one) for name, candidates in tried.items() for one in candidates}
    integrator = copies.problem.integrator
    runs, work = copies.run(integrator), integrator.evaluations(copies.problem.mechanism)
    errors = {} if runs.failure else off(runs.answers)
    meets = not runs.failure and are_within_limit(errors)
    present = Trial(PRESENT, integrator, round(work * runs.steps), errors, {}, meets, runs.failure)
    chosen = trials[id(best)]
    cost = copies.seconds(chosen.integrator) / float(copies.problem.duration)
    return Advice(copies, request, rungs, (present, *trials.values()), chosen, cost)


def _rungs(problem: Problem, times: np.ndarray) -> _Rungs:
    """All that suits the mechanism."""
    mechanism = problem.mechanism
    accepts = lambda integrator: check_run(mechanism, integrator)
    more, other = others_of(mechanism, times, accepts)
    stated = [*rungs_of(mechanism, times, accepts), *more]
    return _Rungs(*({_method(rung.first): rung for rung in rungs} for rungs in (stated, other)))


def _method(integrator: Any) -> str:
    """What a kind of steps is called."""
    kind = type(integrator).__name__
    if kind != "FixedStep":
        return kind
    return f"{kind} {integrator.method if integrator.contact_steps is None else 'contact_steps'}"


def _values(problem: Problem, pilot: PilotSettings) -> np.ndarray:
    """Values (copies, variables), nominal first, of mechanisms that can be."""
    if not problem.names:
        return np.zeros((1, 0))
    nominal = np.asarray(problem.nominal())[None]
    if pilot.copies == 1:
        return nominal
    drawn = draw(problem, pilot.copies - 1, pilot.seed)
    return np.concatenate([nominal, [row for row in drawn if _possible(problem, row)]])


def _possible(problem: Problem, values: np.ndarray) -> bool:
    """Whether there is a mechanism of these values, and it can start."""
    mechanism = problem.model(problem.setting(values))
    if not all(bool(np.all(inside(leaf, metadata))) for _, leaf, metadata in numbers(mechanism)):
        return False
    try:
        beginning(mechanism, problem.integrator.formulation, problem.state)
    except ValueError:
        return False
    return True


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 1 else f"{100 * share:.3g} %"


def _why_nothing(copies: Copies, rungs: _Rungs) -> str:
    first = next(iter(rungs.stated.values())).first
    why = copies.run(first).failure or "no finer steps tell its error within the work allowed."
    return f"no setting tried gives numbers to compare; with {as_typed(first)}: {why}"


def _checked(accuracy: Any) -> float:
    expected = "the accuracy (a share of each response, 0.01 for 1 %)"
    check_number(expected, accuracy, above=0, below=1)
    return float(accuracy)
