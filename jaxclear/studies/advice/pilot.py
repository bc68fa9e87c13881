"""A short piece of a problem, run by one integrator after another: what each answers for a few
copies, and what that costs.

The pilot keeps the saving times of the problem and ends at one of them, so a response sees the
start of what it will see. Its copies are the nominal values and some drawn from the tolerances.
Where joints have clearance, what a step is off by hangs on where in it an impact falls, and copies
that are alike meet the same places: so a few nominal runs are a little shorter, and so are their
steps. Steps and tolerances are numbers, so each kind of integrator compiles once.
"""

import dataclasses
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground.arguments import check_flags, check_number
from jaxclear.ground.quantity import AbstractQuantified, count
from jaxclear.integrators import AbstractIntegrator, Adaptive, Outcome
from jaxclear.simulation.simulate import check_run
from jaxclear.studies.base import SampleResult
from jaxclear.studies.batch import evaluate_all
from jaxclear.studies.problem import Problem
from jaxclear.studies.sampling import draw
from jaxclear.studies.warned import concern
from jaxclear.studies.work_precision import tight_reference

# Share of the problem's duration that a pilot runs unless told otherwise.
SHARE = 0.25
# All copies are timed again until this has been spent [s], or this many times; the best time
# counts: a busy machine only adds.
TIMING, MOST_TIMINGS = 0.2, 40
# What assembly and the start of a program take is taken off, but not more than this share of a run.
MOST_TAKEN_OFF = 0.95
# Shorter runs are so by at most this share, spread by the golden section: a hundred steps then move
# by up to three, no two runs alike.
SHORTER, GOLDEN = 0.03, 0.5 * (5**0.5 - 1)
# What decides accuracy is said of an integrator even where it is the default.
ALWAYS_SAID = ("step", "rtol", "atol")


class PilotSettings(AbstractQuantified):
    """Which short runs an advice is founded on.

    `copies`: nominal and perturbed runs; more of them where the answer says that motion is chaotic.
    `duration` [s]: how long they are, a quarter of the problem's by default. `seed` draws the
    copies. `reference`: an `Adaptive` trusted as the truth, checked against itself at ten times its
    tolerances. `whole`: whether the choice is then confirmed over the whole problem; otherwise
    what is found holds for the pilot. `shorter`: nominal runs that end up to 3 % earlier, where
    joints have clearance, so that impacts meet the steps elsewhere.
    """

    copies: int = count(8, "nominal and perturbed runs")
    duration: float | None = eqx.field(static=True, default=None)
    seed: int = count(0, "seed that draws the copies", at_least=0)
    reference: Adaptive = eqx.field(default_factory=tight_reference)
    whole: bool = eqx.field(static=True, default=True)
    shorter: int = count(3, "nominal runs that end a little earlier", at_least=0)

    def __check_init__(self):
        check_flags("PilotSettings", whole=self.whole)
        if self.duration is not None:
            check_number("duration of PilotSettings", self.duration, "s", above=0)


class Pilot(eqx.Module):
    """The problem up to a saving time, and the values (copies, variables) it is run for, nominal
    first; `whole` [s] is how long the problem itself lasts; `shares` of the duration for which the
    nominal values are run, too.
    """

    problem: Problem
    values: np.ndarray
    whole: float
    shares: np.ndarray = eqx.field(default_factory=lambda: np.zeros(0))

    @property
    def duration(self) -> float:
        """Simulated time of one copy [s]."""
        return float(self.problem.duration)

    @property
    def runs(self) -> int:
        """Copies and shorter runs."""
        return len(self.values) + len(self.shares)

    def with_copies(self, kept: np.ndarray) -> "Pilot":
        """The same pilot for the copies that are `kept` of all its runs."""
        return dataclasses.replace(self, values=self.values[kept[: len(self.values)]])

    def runs_of(self, problem: Problem) -> list[tuple[Problem, np.ndarray]]:
        """The problem and the values of every run: those of the copies, then the shorter ones."""
        duration = float(problem.duration)
        lasting = lambda time: eqx.tree_at(lambda p: p.duration, problem, jnp.asarray(time, float))
        shorter = [(lasting(share * duration), self.values[0]) for share in self.shares]
        return [*((lasting(duration), row) for row in self.values), *shorter]


class Trial(eqx.Module):
    """One integrator on the pilot. `responses` (runs,) by name, nan where a run failed; `cost`
    [s/s] is wall time for a simulated second of one copy alone, `cost_in_batch` [s/s] the same of a
    sample in a batch (nan: not measured); `compile` [s] the time until its program was ready (near
    0 where another trial has the same); `failure` a sentence, empty if all went well; `warnings`
    one on the copies whose runs warn of what concerns a response."""

    integrator: AbstractIntegrator
    responses: dict[str, np.ndarray]
    outcome: np.ndarray
    cost: float
    compile: float
    failure: str = eqx.field(static=True)
    cost_in_batch: float = np.nan
    warnings: str = eqx.field(static=True, default="")


@eqx.filter_jit
def evaluate_one(problem: Problem, values: Float[Array, " variables"]) -> SampleResult:
    """Result of one set of values."""
    return problem.evaluate(values)


def pilot_of(
    problem: Problem, settings: PilotSettings, longer: float | None = None, means: bool = False
) -> Pilot:
    """The pilot of a problem: as long as asked for, or `longer` [s], rounded up to a saving
    time; `means`: of means over the copies alone."""
    whole = float(problem.duration)
    wanted = SHARE * whole if settings.duration is None else settings.duration
    wanted = wanted if longer is None else longer
    shares = np.asarray(problem.shares)
    saves = int(np.searchsorted(shares, wanted / whole * (1 - 1e-9))) + 1
    piece = problem if saves >= len(shares) else _up_to(problem, saves)
    values = np.asarray(problem.nominal())[None] if problem.names else np.zeros((1, 0))
    if problem.names and settings.copies > 1:
        values = np.concatenate([values, draw(problem, settings.copies - 1, settings.seed)])
    impacts = bool(problem.mechanism.topology.clearances) and not means
    turns = GOLDEN * (1 + np.arange(settings.shorter if impacts else 0))
    return Pilot(piece, values, whole, 1 - SHORTER * (turns % 1.0))


def _up_to(problem, saves):
    """The first `saves` saving times; what a response holds for every saving time is cut with
    them."""

    def cut(leaf):
        over_time = (
            isinstance(leaf, (jax.Array, np.ndarray))
            and leaf.ndim
            and leaf.shape[0] == len(problem.shares)
        )
        return leaf[:saves] if over_time else leaf

    last = problem.shares[saves - 1]
    parts = (
        problem.duration * last,
        problem.shares[:saves] / last,
        jax.tree.map(cut, problem.response),
    )
    return eqx.tree_at(lambda p: (p.duration, p.shares, p.response), problem, parts)


def measure(pilot: Pilot, integrator: AbstractIntegrator) -> Trial:
    """Runs every copy, one after another. What an integrator cannot do is a trial with a sentence,
    not an exception.
    """
    problem = eqx.tree_at(lambda p: p.integrator, pilot.problem, integrator)
    begun = time.perf_counter()
    try:
        check_run(problem.mechanism, integrator)
        start = eqx.tree_at(lambda p: p.duration, problem, jnp.zeros(()))
        jax.block_until_ready(evaluate_one(start, jnp.asarray(pilot.values[0])))
    except (ValueError, TypeError, NotImplementedError) as error:
        return _no_trial(
            pilot,
            integrator,
            f"{type(error).__name__}: {error}" if isinstance(error, TypeError) else str(error),
        )
    ready = time.perf_counter() - begun
    outcomes, seconds = _run_all(pilot.runs_of(problem), start)
    for name, found in outcomes.responses.items():
        if found.ndim != 1:
            return _no_trial(
                pilot,
                integrator,
                f'response "{name}" is an array for each run; it must be one number.',
            )
    responses = {
        name: np.where(outcomes.outcome == Outcome.REACHED, outcomes.responses[name], np.nan)
        for name in problem.response_names
    }
    failure = failure_in_words(outcomes, responses)
    trial = Trial(integrator, responses, outcomes.outcome, seconds / pilot.duration, ready, failure)
    return dataclasses.replace(trial, warnings=_warnings_in_words(problem, outcomes))


def _run_all(runs, start):
    """Outcomes of all runs, and the time [s] one takes in the middle, less that of a run of no
    length (`start`).
    """
    best, idle = np.full(len(runs), np.inf), np.inf
    begun = time.perf_counter()
    for _ in range(MOST_TIMINGS):
        found = []
        for i, run in enumerate((one, jnp.asarray(row)) for one, row in runs):
            # Side by side, so that what else runs on the machine touches both.
            idle = min(idle, _timed(lambda row=run[1]: evaluate_one(start, row))[1])
            outcome, seconds = _timed(lambda run=run: evaluate_one(*run))
            found.append(outcome)
            best[i] = min(best[i], seconds)
        if time.perf_counter() - begun > TIMING:
            break
    outcomes = jax.tree.map(lambda *parts: np.stack([np.asarray(p) for p in parts]), *found)
    middle = float(np.median(best))
    return outcomes, max(middle - idle, (1 - MOST_TAKEN_OFF) * middle)


def _timed(action):
    """What an action returns, and its time [s]: wall time, but not what other programs took of it
    where all work is the CPU's.
    """
    wall, cpu = time.perf_counter(), time.process_time()
    found = jax.block_until_ready(action())
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return found, min(wall, cpu) if jax.default_backend() == "cpu" else wall


def _no_trial(pilot, integrator, why):
    empty = {name: np.full(pilot.runs, np.nan) for name in pilot.problem.response_names}
    return Trial(integrator, empty, np.full(pilot.runs, Outcome.REACHED), np.nan, 0.0, why)


def _warnings_in_words(problem: Problem, outcomes: SampleResult) -> str:
    """A sentence on the copies that reached their end with a warning; empty if none did."""
    reached = np.asarray(outcomes.outcome == Outcome.REACHED)
    told = [concern(problem, name, outcomes.checks, reached) for name in problem.response_names]
    return max(told)[1]


def failure_in_words(outcomes: SampleResult, responses: dict[str, np.ndarray]) -> str:
    """A sentence on the copies that failed; empty if none did."""
    lost = np.flatnonzero(outcomes.outcome != Outcome.REACHED)
    copies = len(outcomes.outcome)
    many = f"{len(lost)} of {copies} copies: " if copies > 1 else ""
    if len(lost):
        first = lost[0]
        reason = Outcome(int(outcomes.outcome[first]))
        if not reason.began:
            return f"{many}{reason.sentence[0].lower()}{reason.sentence[1:]}"
        return f"{many}the run ended after {float(outcomes.ended[first]):.3g} s. {reason.sentence}"
    wrong = [f'"{name}"' for name, values in responses.items() if not np.all(np.isfinite(values))]
    return f"not finite: response {', '.join(wrong)}." if wrong else ""


def time_in_batch(pilot: Pilot, trial: Trial, samples: int) -> Trial:
    """The trial with its cost for a sample of a batch, run as a Monte Carlo study would run it."""
    problem = eqx.tree_at(lambda p: p.integrator, pilot.problem, trial.integrator)
    values = jnp.asarray(pilot.values[np.arange(samples) % len(pilot.values)])
    start = eqx.tree_at(lambda p: p.duration, problem, jnp.zeros(()))
    evaluate_all(start, values)
    begun, best, idle = time.perf_counter(), np.inf, np.inf
    for _ in range(MOST_TIMINGS):
        idle = min(idle, _timed(lambda: evaluate_all(start, values))[1])
        best = min(best, _timed(lambda: evaluate_all(problem, values))[1])
        if time.perf_counter() - begun > TIMING:
            break
    seconds = max(best - idle, (1 - MOST_TAKEN_OFF) * best)
    return dataclasses.replace(trial, cost_in_batch=seconds / samples / pilot.duration)


def describe(integrator: AbstractIntegrator) -> str:
    """An integrator as a user would write it, defaults left out: FixedStep(step=5e-05,
    method="semi_implicit").
    """
    parts = []
    for field in dataclasses.fields(integrator):
        value = getattr(integrator, field.name)
        if isinstance(value, (jax.Array, float)) and np.ndim(value) == 0:
            if (
                field.name not in ALWAYS_SAID
                and field.default is not dataclasses.MISSING
                and value == field.default
            ):
                continue
            parts.append(f"{field.name}={float(value):.6g}")
        elif isinstance(value, eqx.Module):
            usual = field.default_factory is not dataclasses.MISSING and type(
                field.default_factory()
            ) is type(value)
            parts += [] if usual else [f"{field.name}={type(value).__name__}()"]
        elif value is not None and value != field.default:
            parts.append(
                f'{field.name}="{value}"' if isinstance(value, str) else f"{field.name}={value!r}"
            )
    return f"{type(integrator).__name__}({', '.join(parts)})"
