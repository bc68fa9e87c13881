"""Which integrator, and which steps, keep the accuracy that is asked for, at the least work.

Every rung that solves the model as it is stated is climbed from coarse to fine, on one run. The
next settings of a rung are the replicas of the one before (`told.richardson`), so a ladder
of n settings costs n runs. What agrees with itself may still agree by chance where its steps pass
over impacts: beside the runs under error control no answer may differ from them by more than is
asked, and without these two finer runs must agree. Work is counted in evaluations of forces, never
timed: the same question always gets the same answer.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxclear.errors.estimates import richardson
from jaxclear.errors.verification import DOUBT
from jaxclear.formulations.contact_rates import contact_rates
from jaxclear.ground.printing import as_typed
from jaxclear.integrators.adaptive import Adaptive
from jaxclear.integrators.base import SLIVER, AbstractIntegrator
from jaxclear.integrators.fixed_step import USUAL_STEP, FixedStep
from jaxclear.integrators.implicit_step import ImplicitStep
from jaxclear.integrators.moreau_jean import MoreauJean
from jaxclear.integrators.non_colliding import NonColliding
from jaxclear.multibody.mechanism import Mechanism

# Share of 1 / rate of a contact that the first steps have: near where rk4 is stable at all.
FIRST_SHARE = 1.44
# Bounds: the loosest where nothing touches, the tightest; each ten times tighter, which takes
# the fifth root of that more steps. Where joints have clearance looser ones than the usual count as
# the usual (`Adaptive`).
LOOSEST, TIGHTEST, TIGHTER = 1e-4, 1e-12, 0.1
ORDER = 5
ABSOLUTE = 0.01
# What a setting of a rung is to the one before, by its steps or by the errors of its tolerances.
HALF = 0.5
# Short steps in contact to one in flight: as far as a bounce is stiffer than the motion in most
# bearings.
SHORT_STEPS = 20.0


class Rung(NamedTuple):
    """Settings from `first` on, each followed by a `finer` one (None: by none); `evaluations` of
    forces in a step; whether steps are under error control (`controlled`), and then by what factor
    the work grows from one to the next (`growth`)."""

    first: AbstractIntegrator
    finer: Callable[[AbstractIntegrator], AbstractIntegrator | None]
    evaluations: int
    controlled: bool = False
    growth: float = 2.0

    def work_of(self, run: Any) -> int:
        """Evaluations of forces that a run took."""
        return self.evaluations * (int(run.accepted_steps) + int(run.rejected_steps))

    def work_before(self, setting: AbstractIntegrator, times: np.ndarray) -> float | None:
        """The same before the run, saved at these times [s]; None where steps follow the motion."""
        step, counted = setting.requested_step(), setting.steps_between_saves
        if counted is not None:
            return float(self.evaluations * counted * (len(times) - 1))
        if step is None:
            return None
        counts = np.ceil(np.diff(times) / float(step) * (1 - SLIVER))
        return self.evaluations * float(np.sum(np.maximum(counts, 1)))

    def share(self, setting: AbstractIntegrator, finer: AbstractIntegrator) -> float | None:
        """The share of its steps that a finer setting has; None where nobody knows."""
        step, shorter = setting.requested_step(), finer.requested_step()
        return None if step is None or shorter is None else float(shorter / step)


def rungs_of(
    mechanism: Mechanism, times: np.ndarray, accepts: Callable[[AbstractIntegrator], None]
) -> list[Rung]:
    """Rungs that solve the model of a mechanism as it is stated.

    Rigid contact is among them only where no other takes it and no law is compliant.

    Args:
        mechanism: of the run.
        times: saving times [s].
        accepts: function that raises `ValueError` for an integrator that does not suit the
            mechanism.

    Raises:
        ValueError: no integrator suits.
    """
    first = _first_step(mechanism, times)
    rungs = [
        _controlled(mechanism),
        halving_rung(ImplicitStep(first, rebound=1.0), mechanism),
        halving_rung(FixedStep(first), mechanism),
    ]
    suitable = [rung for rung in rungs if _is_suitable(rung, accepts)]
    if not suitable and _has_elastic_law(mechanism):
        accepts(rungs[0].first)
    if not suitable:
        interval = float(np.min(np.diff(times)))
        rigid = MoreauJean(min(interval, float(MoreauJean().step)))
        accepts(rigid)
        suitable = [halving_rung(rigid, mechanism)]
    return suitable


def others_of(
    mechanism: Mechanism, times: np.ndarray, accepts: Callable[[AbstractIntegrator], None]
) -> tuple[list[Rung], list[Rung]]:
    """Further rungs: of the model as it is stated, and of other models of contact.

    Args:
        mechanism: of the run.
        times: saving times [s].
        accepts: function that raises `ValueError` for an integrator that does not suit the
            mechanism.

    Returns:
        Rungs of order 1, or with short steps in contact alone; rungs with rigid and permanent
        contact.
    """
    first, interval = _first_step(mechanism, times), float(np.min(np.diff(times)))
    rungs = [FixedStep(first, "semi_implicit")]
    models: list[AbstractIntegrator] = []
    if mechanism.topology.clearances:
        rungs.append(FixedStep(min(interval, SHORT_STEPS * first), contact_steps=SHORT_STEPS))
    if _has_elastic_law(mechanism):
        models = [
            type(x)(min(_next_shorter_step(interval), float(x.step)))
            for x in (MoreauJean(), NonColliding())
        ]
    halved = ([halving_rung(x, mechanism) for x in each] for each in (rungs, models))
    stated, other = ([rung for rung in each if _is_suitable(rung, accepts)] for each in halved)
    return stated, other


def halving_rung(first: AbstractIntegrator, mechanism: Mechanism) -> Rung:
    """Steps of a length, each setting half as long as the one before."""
    return Rung(first, lambda setting: setting.with_finer_steps(HALF), first.evaluations(mechanism))


def _is_suitable(rung: Rung, accepts: Callable[[AbstractIntegrator], None]) -> bool:
    try:
        accepts(rung.first)
    except ValueError:
        return False
    return True


def _has_elastic_law(mechanism: Mechanism) -> bool:
    """Whether a contact of the mechanism has an elastic law."""
    joints = [mechanism.connections[name].joint for name in mechanism.topology.clearances]
    return any(laws.contact.compliant for joint in joints for laws in joint.contact_laws())


def _controlled(mechanism: Mechanism) -> Rung:
    """Steps under error control."""
    usual = Adaptive()
    first = usual if mechanism.topology.clearances else _adaptive_at(LOOSEST)

    def finer(setting):
        rtol = TIGHTER * float(setting.rtol)
        return _adaptive_at(rtol) if rtol > TIGHTEST * (1 - SLIVER) else None

    return Rung(first, finer, usual.evaluations(mechanism), True, TIGHTER ** (-1 / ORDER))


def _adaptive_at(rtol: float) -> Adaptive:
    return Adaptive(rtol=rtol, atol=ABSOLUTE * rtol)


def _first_step(mechanism: Mechanism, times: np.ndarray) -> float:
    """The longest step [s] of a run saved at these times [s] that resolves its contacts."""
    return min(float(np.min(np.diff(times))), _step_that_resolves_contact(mechanism, times))


def _step_that_resolves_contact(mechanism: Mechanism, times: np.ndarray) -> float:
    """The longest step [s] that resolves a contact; endless where none may open and close."""
    if not mechanism.topology.clearances:
        return math.inf
    duration = float(times[-1] - times[0])
    rates = contact_rates(mechanism, duration, min(USUAL_STEP, duration)).values()
    fastest = max((rate.contact for rate in rates), default=0.0)
    return _next_shorter_step(FIRST_SHARE / fastest) if fastest > 0 else math.inf


def _next_shorter_step(step: float) -> float:
    """The next shorter length [s] of two digits, which is told as it is."""
    power = math.floor(math.log10(step)) - 1
    return float(f"{math.floor(step / 10.0**power)}e{power}")


# Evaluations of forces in a step of the classical Runge-Kutta method.
RK4 = 4
# So many times the work of the usual steps of studies may go into a choice; at least as many
# evaluations of forces as take seconds in any mechanism.
PATIENCE, LEAST_BUDGET = 20.0, 4e6
# Share of the duration over which a rung is tried first whose work nobody knows beforehand, and how
# many times as long each further part is. It may take half of what is left.
FIRST_PART, LONGER = 1 / 512, 8

# A run by an integrator over this share of the duration, or several in one: whether they
# `succeeded`, their `accepted_steps` and `rejected_steps`.
Again = Callable[[AbstractIntegrator, float], Any]


class Question(NamedTuple):
    """What is compared of a run, as `seen(run)`; and, as `beside(run, one, other)`, how far two
    runs are apart, by answer, beside what is allowed; the saving `times` [s]."""

    observe: Callable[[Any], Any]
    compare: Callable[[Any, Any, Any], dict[str, float]]
    times: np.ndarray


class Chosen(NamedTuple):
    """The `integrator`, and `why`, in a sentence; the error told beside what is allowed (`told`,
    at most 1 where the accuracy is reached); `work` of a run, and `spent` on the choice
    [evaluations of forces]."""

    integrator: AbstractIntegrator
    why: str
    error_ratio: float
    work: int
    spent: int

    @property
    def reached(self) -> bool:
        """Whether the accuracy is reached."""
        return self.error_ratio <= 1


class Tried(NamedTuple):
    """A setting of a rung, the run by it (None: it failed), what is compared of that, and its work
    [evaluations of forces]; its `errors` beside what is allowed, by answer."""

    rung: Rung
    integrator: AbstractIntegrator
    run: Any
    observed: Any
    work: int
    errors: dict[str, float]

    @property
    def worst(self) -> str:
        """The answer that is nearest to what is allowed, or furthest beyond."""
        return max(self.errors, key=lambda name: self.errors[name], default="the run")

    @property
    def error_ratio(self) -> float:
        """Its error; endless where the run failed."""
        return max(self.errors.values(), default=math.inf)


def budget_of(times: np.ndarray) -> float:
    """What a choice for a run saved at these times [s] may take [evaluations of forces]."""
    return max(PATIENCE * usual_work(times), LEAST_BUDGET)


def usual_work(times: np.ndarray) -> float:
    """What the usual steps of studies take for a run saved at these times [s] [evaluations of
    forces]."""
    return RK4 * max(float(times[-1] - times[0]) / USUAL_STEP, len(times))


def is_usual_cheap(mechanism: Mechanism, again: Again, question: Question) -> bool:
    """Whether a run by `Adaptive()` costs less than a choice of the integrator may.

    Args:
        mechanism: of the run.
        again: repeats the run with an integrator over a share of its duration.
        question: accuracy and saving times.
    """
    rung = _controlled(mechanism)._replace(first=Adaptive())
    budget = PATIENCE * usual_work(question.times)
    return Search(again, question, budget).affords(rung, rung.first, [])


def keeps_accuracy(run: Any, finer: Any, question: Question) -> bool:
    """Whether a run is as accurate as required, estimated from a run with half its steps.

    Args:
        run: trajectory that is judged.
        finer: the same with half the step.
        question: what is compared, and how accurate it must be.
    """
    off = question.compare(run, question.observe(run), question.observe(finer))
    return all(float(richardson([each])) <= 1 for each in off.values())


def choose_setting(
    rungs: list[Rung], again: Again, question: Question, budget: float | None = None
) -> Chosen:
    """The cheapest setting that keeps the accuracy; else the most accurate one tried.

    Args:
        rungs: families of settings; the first is under error control if any is.
        again: repeats the run with an integrator over a share of its duration.
        question: what is compared, and how accurate it must be.
        budget: evaluations of forces that may be spent; None: `budget_of` the run.
    """
    search = Search(again, question, budget)
    for rung in rungs:
        search.climb(rung)
    spent, choice = search.spent, search.best or search.nearest
    if choice is None:
        usual = Adaptive() if rungs[0].controlled else rungs[0].first
        why = f"Run with integrator.{as_typed(usual)}: no setting tried gives an estimate."
        return Chosen(usual, why, math.inf, 0, spent)
    if search.best is not None:
        why = (
            f"the cheapest setting tried that keeps the accuracy asked (estimated error "
            f"{choice.error_ratio:.0%} of it), {choice.work} evaluations of forces a run"
        )
    else:
        why = (
            f"nothing within {search.budget:.2g} evaluations of forces keeps the accuracy asked; "
            f"the error of {choice.worst} is {choice.error_ratio:.2g} times that"
        )
    why = f"Run with integrator.{as_typed(choice.integrator)}: {why}."
    return Chosen(choice.integrator, why, choice.error_ratio, choice.work, spent)


class Search:
    """What is known so far: the cheapest setting that keeps the accuracy (`best`), all that were
    `judged`, the finest run under error control where that keeps it (`reference`), and the work
    that was `spent` [evaluations of forces]."""

    def __init__(
        self,
        again: Again,
        question: Question,
        budget: float | None = None,
        best: Tried | None = None,
    ):
        self.again, self.question = again, question
        self.budget = budget_of(question.times) if budget is None else budget
        self.spent = 0
        self.best = best
        self.reference: Tried | None = None
        self.judged: list[Tried] = []

    @property
    def nearest(self) -> Tried | None:
        """The most accurate of all settings that were judged; None where none was."""
        finite = [each for each in self.judged if each.error_ratio < math.inf]
        return min(finite, key=lambda each: each.error_ratio, default=None)

    def climb(self, rung: Rung) -> None:
        """Settings of a rung from coarse to fine, until one keeps the accuracy, or none that does
        can be cheaper than the best, or the budget is spent."""
        settings: list[Tried] = []
        first = 0
        following: AbstractIntegrator | None = rung.first
        while following is not None and self.affords(rung, following, settings[first:]):
            settings.append(self._try_setting(rung, following))
            while first + 1 < len(settings):
                one = self._judge_setting(settings[first], settings[first + 1 : first + 3])
                if one is None:
                    break
                self.judged.append(one)
                if one.error_ratio <= 1:
                    self._record_setting(one, settings[-1])
                    return
                first += 1
            following = rung.finer(following)
        self._judge_undecided(settings[first:])

    def _judge_undecided(self, undecided: list[Tried]) -> None:
        """What is left where another run cannot be had: one that does not agree by chance counts by
        what is known of it."""
        if len(undecided) < 2:
            return
        one = self._add_errors(undecided[0], undecided[1:3])
        self.judged.append(one)
        if one.error_ratio <= 1 and self._is_controlled_or_confirmed(one):
            self._record_setting(one, undecided[-1])

    def _is_controlled_or_confirmed(self, one: Tried) -> bool:
        """Whether a setting is under error control, or stands beside one that is."""
        return one.rung.controlled or self.reference is not None

    def affords(self, rung: Rung, setting: AbstractIntegrator, open_settings: list[Tried]):
        """Whether a setting is worth a run, within the budget and the best work so far.

        Args:
            rung: its family.
            setting: integrator with its steps.
            open_settings: runs of the rung that are not decided yet.
        """
        work = rung.work_before(setting, self.question.times)
        last = open_settings[-1].work if open_settings else None
        least_work = open_settings[0].work if open_settings else work
        if self.best is not None and least_work is not None and least_work >= self.best.work:
            return False
        if work is None:
            work = self._predict_work(rung, setting) if last is None else rung.growth * last
        return self.spent + work <= self.budget

    def _predict_work(self, rung: Rung, setting: AbstractIntegrator) -> float:
        """Work of a run that finds its steps itself, from runs of longer and longer first parts,
        until one shows that it is too dear; steps that end at saving times are as many in each."""
        saves = rung.evaluations * len(self.question.times)
        work, share = 0.0, FIRST_PART
        while share < 1:
            work = rung.work_of(self.again(setting, share))
            self.spent += int(work)
            work, share = LONGER * max(work - saves, 0) + saves, LONGER * share
            if work > 0.5 * (self.budget - self.spent):
                return math.inf
        return work

    def _try_setting(self, rung: Rung, setting: AbstractIntegrator) -> Tried:
        run = self.again(setting, 1.0)
        work = rung.work_of(run)
        self.spent += work
        observed = self.question.observe(run) if run.succeeded else None
        return Tried(rung, setting, run if run.succeeded else None, observed, work, {})

    def _judge_setting(self, one: Tried, finer: list[Tried]) -> Tried | None:
        """A setting with its error, as finer ones tell it; None where another one must."""
        judged = self._add_errors(one, finer)
        sure = judged.error_ratio <= DOUBT and self._is_controlled_or_confirmed(one)
        return judged if len(finer) > 1 or sure or judged.error_ratio > 1 else None

    def _add_errors(self, one: Tried, finer: list[Tried]) -> Tried:
        """A setting with its error, as far as finer ones and the reference tell it."""
        if one.run is None or any(each.run is None for each in finer):
            return one
        off = [self.question.compare(one.run, one.observed, each.observed) for each in finer]
        shares = [one.rung.share(one.integrator, each.integrator) for each in finer]
        errors = {name: float(richardson([each[name] for each in off], shares)) for name in off[0]}
        if self.reference is not None:
            from_reference = self.question.compare(one.run, one.observed, self.reference.observed)
            errors = {name: max(error, from_reference[name]) for name, error in errors.items()}
        errors = {name: math.inf if math.isnan(error) else error for name, error in errors.items()}
        return one._replace(errors=errors)

    def _record_setting(self, one: Tried, finest: Tried) -> None:
        if self.best is None or one.work < self.best.work:
            self.best = one
        if one.rung.controlled and self.reference is None:
            self.reference = finest
