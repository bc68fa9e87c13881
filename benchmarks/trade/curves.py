"""Error and cost of every rung on a question, coarse to fine.

Errors are root mean squares over a few copies within the tolerances, as shares of the response's
own; the reference is `Adaptive` at two tolerances, whose difference is the doubt about it. Costs
are CPU seconds for a simulated second, assembly and responses included, compilation left out:
alone, and a sample of a batch.
"""

import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.trade.questions import Question
from jaxclear.ground.printing import as_typed
from jaxclear.studies.store.batch import evaluate_all
from jaxclear.studies.sampling import draw

COPIES, BATCH = 3, 16
STEPS = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7)
RTOLS = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
REFERENCES = (1e-9, 1e-10)
# A curve ends where every error is below this, or where one run takes longer than this [s CPU].
GOOD, LONG = 1e-4, 1.5
# A batch is timed where a run alone is shorter than this [s CPU].
BATCHED = 0.15
# The shortest of so many runs counts; short ones are repeated more often, for so long [s CPU].
REPEATS, MOST_REPEATS, TIMED = 3, 20, 0.05
I = jc.integrator  # noqa: E741


class Point(NamedTuple):
    """One setting on a curve: errors by response, CPU seconds for a simulated second alone and in a
    batch (nan: not measured), and what its runs say (empty: they reached their end)."""

    rung: str
    setting: str
    errors: dict[str, float]
    alone: float
    in_batch: float
    said: str


class Curves(NamedTuple):
    """All points of a question, how far the references are apart by response, and the cost of the
    tighter."""

    points: list[Point]
    doubts: dict[str, float]
    reference: float


def _adaptive(rtol: float) -> Any:
    return I.Adaptive(rtol=rtol, atol=1e-2 * rtol)


def ladders(question: Question) -> dict[str, list[Any]]:
    """Settings of every rung that a question can be run on, coarse to fine."""
    gaps = bool(question.problem.mechanism.topology.clearances)
    interval = float(np.max(np.diff(question.problem.shares)) * question.problem.duration)
    steps = [step for step in STEPS if question.shortest <= step < 1.01 * interval]
    steps = [interval, *(step for step in steps if step < 0.5 * interval)]
    found = {
        "Adaptive": [_adaptive(rtol) for rtol in RTOLS],
        "FixedStep rk4": [I.FixedStep(step) for step in steps],
        "FixedStep semi_implicit": [I.FixedStep(step, "semi_implicit") for step in steps],
        "ImplicitStep": [I.ImplicitStep(step) for step in steps],
    }
    if gaps:
        found |= {
            "FixedStep, contact_steps": [I.FixedStep(step, contact_steps=20) for step in steps],
            "MoreauJean": [I.MoreauJean(step) for step in steps],
            "NonColliding": [I.NonColliding(step) for step in steps],
        }
    return {name: ladder for name, ladder in found.items() if name not in question.without}


@eqx.filter_jit
def _evaluate(problem: jc.Problem, values: Any) -> Any:
    return problem.evaluate(values)


class Measured(NamedTuple):
    """Responses (copies,) by name, CPU seconds of a run, and the sentence where one failed."""

    responses: dict[str, np.ndarray]
    seconds: float
    said: str


def measure(problem: jc.Problem, values: np.ndarray) -> Measured:
    """Run every copy; the shortest of a few CPU times of the first counts."""
    try:
        first = jax.block_until_ready(_evaluate(problem, jnp.asarray(values[0])))
    except (ValueError, NotImplementedError) as error:
        return Measured({}, math.nan, str(error))
    best, begun = math.inf, time.process_time()
    for repeat in range(MOST_REPEATS):
        best = min(best, _seconds(lambda: _evaluate(problem, jnp.asarray(values[0]))))
        spent = time.process_time() - begun
        if best > 0.3 * LONG or (repeat >= REPEATS - 1 and spent > TIMED):
            break
    found = [first, *(_evaluate(problem, jnp.asarray(row)) for row in values[1:])]
    ended = [int(one.outcome) for one in found]
    said = next((I.Outcome(code).sentence for code in ended if code), "")
    names = problem.response_names
    responses = {name: np.array([float(one.responses[name]) for one in found]) for name in names}
    return Measured(responses, best, said)


def in_batch(problem: jc.Problem, values: np.ndarray) -> float:
    """CPU seconds of a sample in a batch."""
    many = jnp.asarray(values[np.arange(BATCH) % len(values)])
    evaluate_all(problem, many)
    return min(_seconds(lambda: evaluate_all(problem, many)) for _ in range(REPEATS)) / BATCH


def copies(problem: jc.Problem, count: int, seed: int = 0) -> np.ndarray:
    """Values (count, variables): the nominal ones, and others drawn from the tolerances."""
    nominal = np.asarray(problem.nominal())[None]
    return np.concatenate([nominal, draw(problem, count - 1, seed)])


def _seconds(action: Callable[[], Any]) -> float:
    """CPU seconds of an action."""
    begun = time.process_time()
    jax.block_until_ready(action())
    return time.process_time() - begun


def curves(question: Question) -> Curves:
    """Every rung from coarse to fine."""
    values, duration = copies(question.problem, COPIES), float(question.problem.duration)

    def with_one(one: Any) -> jc.Problem:
        return eqx.tree_at(lambda p: p.integrator, question.problem, one)

    loose, tight = (measure(with_one(_adaptive(rtol)), values) for rtol in REFERENCES)
    if loose.said or tight.said:
        raise ValueError(f"the reference fails: {loose.said or tight.said}")
    doubts = errors(loose.responses, tight.responses)
    points = []
    for name, ladder in ladders(question).items():
        for integrator in ladder:
            found = measure(with_one(integrator), values)
            off = {} if found.said else errors(found.responses, tight.responses)
            batched = math.nan
            if not found.said and found.seconds < BATCHED:
                batched = in_batch(with_one(integrator), values) / duration
            points.append(
                Point(
                    name, as_typed(integrator), off, found.seconds / duration, batched, found.said
                )
            )
            if found.seconds > LONG or (off and max(off.values()) < GOOD):
                break
    return Curves(points, doubts, tight.seconds / duration)


def errors(found: dict[str, np.ndarray], wanted: dict[str, np.ndarray]) -> dict[str, float]:
    """Root mean square difference over the copies by response, as a share of the wanted one."""
    shares = {}
    for name, answers in wanted.items():
        size = float(np.sqrt(np.mean(answers**2)))
        off = float(np.sqrt(np.mean((found[name] - answers) ** 2)))
        shares[name] = off / size if np.isfinite(off) and size > 0 else math.inf
    return shares
