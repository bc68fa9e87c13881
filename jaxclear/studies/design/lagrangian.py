"""The cheapest candidate by an augmented Lagrangian whose steps optax takes: for more free numbers
than SLSQP's dense matrices like, and where slopes are known with noise only.

$$ L = C + \\frac{1}{2 \\rho} \\sum_j \\big( (\\lambda_j + \\rho g_j)_+^2 - \\lambda_j^2 \\big) $$

is lowered by Adam with steps that die away, within the bounds; then $\\lambda_j$ becomes
$\\max(0, \\lambda_j + \\rho g_j)$. What counts in the end is the mean over the last steps.

What jumps, rattles or counts has no slope that a surface or JAX could tell. But a limited number
changes with the design as its sample's weights do (score function), whatever the response: each
step sees few new runs, corrected by the surface, at the place it has come to. What the ends of
distributions that are cut off add to what the surface leaves only verification sees.

Source: Bertsekas 1982, Constrained Optimization and Lagrange Multiplier Methods, chapter 3; score
functions: Rubinstein & Shapiro 1993, Discrete Event Systems, Wiley; steps that die away: Robbins &
Monro 1951, Ann. Math. Stat. 22, 400, doi:10.1214/aoms/1177729586.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.studies.design.optimise import Candidate, Search, judged
from jaxclear.studies.design.population import AbstractModel, Points, points
from jaxclear.studies.design.question import NOMINAL, TOLERANCE, Question
from jaxclear.studies.design.runs import Runs
from jaxclear.studies.endless import bounded
from jaxclear.studies.sensitivity.estimand import Direction, weights
from jaxclear.studies.surface.control_variate import with_difference

# Adam's steps: places run from 0 to 1.
FIRST_STEP, LAST_SHARE = 0.03, 1e-3
# The penalty of a limit, in costs; how often multipliers are set anew, and steps between.
PENALTY, ROUNDS, STEPS = 20.0, 8, 120
# The mean is over this share of the last steps.
LAST = 0.2
# How often multipliers are set anew, steps between, and new runs of each step.
NOISY_ROUNDS, NOISY_STEPS, RUNS = 6, 60, 64


# (cost and excesses (1 + limits,), slopes (1 + limits, free)) of a place.
Told = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def cheapest_by_steps(search: Search, start: np.ndarray) -> Candidate:
    """The candidate that optax finds where slopes are exact."""
    found, _ = descend(search.told, start, search.low, search.high, ROUNDS, STEPS)
    return judged(search, found)


def descend(
    told: Told, start: np.ndarray, low: np.ndarray, high: np.ndarray, rounds: int, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """(place (free,), multipliers (limits,) in costs at the start) that the augmented Lagrangian
    ends with."""
    import optax

    place = np.clip(start, low, high)
    first = told(place)[0]
    whole, forces = abs(first[0]) or 1.0, np.zeros(len(first) - 1)
    for number in range(rounds):
        size = FIRST_STEP * 0.5**number if number else FIRST_STEP
        rate = optax.cosine_decay_schedule(max(size, 1e-3), steps, LAST_SHARE)
        rule = optax.adam(rate)
        state = rule.init(place)
        summed, excess, count = np.zeros_like(place), np.zeros_like(forces), 0
        for step in range(steps):
            found, slopes = told(place)
            push = np.maximum(forces + PENALTY * found[1:], 0.0)
            slope = slopes[0] / whole + push @ slopes[1:]
            change, state = rule.update(slope, state, place)
            place = np.clip(np.asarray(optax.apply_updates(place, change)), low, high)
            if step >= (1 - LAST) * steps:
                summed, excess, count = summed + place, excess + found[1:], count + 1
        place = summed / count
        forces = np.maximum(forces + PENALTY * excess / count, 0.0)
    return place, forces


def cheapest_by_noise(search: Search, start: np.ndarray, runs: Runs, seed: int) -> Candidate:
    """The candidate that the mean of the last steps gives."""
    seen = _Seen(search, runs, seed)
    place, forces = descend(seen.told, start, search.low, search.high, NOISY_ROUNDS, NOISY_STEPS)
    cost = float(search.question.price(jnp.asarray(place)))
    return Candidate(place, cost, seen.lately(), forces * seen.whole)


class _Seen:
    """What the steps see: new runs each, and what they told of the limits since the multipliers
    were set last."""

    def __init__(self, search: Search, runs: Runs, seed: int):
        self.search, self.runs, self.seed = search, runs, seed
        self.excesses: list[np.ndarray] = []
        self.whole = abs(float(search.question.price(jnp.asarray(search.low)))) or 1.0

    def told(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cost and excesses, (1 + limits,), and their slopes, (1 + limits, free)."""
        question, model = self.search.question, self.search.model
        count = len(question.freedom.names)
        drawn = points(count, RUNS, self.seed + 7919 * (1 + len(self.excesses)))
        values = np.asarray(question.values(jnp.asarray(place), drawn.normal))
        responses = self.runs.ask(values, "steps")
        good = ~np.isnan(responses).any(axis=1)
        if not good.any():
            raise ValueError(_all_failed(question, place, values[0]))
        names = self.runs.problem.response_names
        known = np.where(good[:, None], responses, 0.0).T
        pairs = zip(names, known, strict=True)
        told = {
            name: bounded(self.runs.problem, name, own, question.levels(name))
            for name, own in pairs
        }
        scores = scores_of(question, self.runs.problem, place, drawn.normal)
        found, slopes = noisy(
            question,
            model,
            self.search.points,
            Batch(jnp.asarray(values), jnp.asarray(scores), jnp.asarray(good / good.sum()), told),
            jnp.asarray(place),
        )
        if not self.excesses:
            self.whole = abs(float(found[0])) or 1.0
        found = np.array(found)
        found[1:] += self.search.shift
        self.excesses.append(found[1:])
        return found, np.asarray(slopes)

    def lately(self) -> np.ndarray:
        """Excesses (limits,), a mean over the last steps."""
        return np.mean(self.excesses[-NOISY_STEPS // 2 :], axis=0)


def _all_failed(question: Question, place: np.ndarray, values: np.ndarray) -> str:
    """What is said of a step without a run that tells anything. `values` (variables,) are those of
    its first run."""
    nominal, tolerance = (np.asarray(own) for own in question.freedom.decoded(jnp.asarray(place)))
    of = {NOMINAL: nominal, TOLERANCE: tolerance}
    said = [
        f"{question.freedom.label(i)} = {of[choice.kind][choice.variable]:.6g}"
        for i, choice in enumerate(question.freedom.choices)
    ]
    first = ", ".join(
        f"{name} = {own:.6g}" for name, own in zip(question.freedom.names, values, strict=True)
    )
    return (
        f"all {RUNS} runs of a step of the design failed, at {', '.join(said)}: none reached its "
        f"end with finite responses. Look at one of them, such as that of {first}, or narrow what "
        "may be chosen."
    )


class Batch(eqx.Module):
    """Runs of one step: `values` (runs, variables) in their own units, `scores` (runs, free) [1],
    `shares` (runs,) [1], 0 for those that failed, and responses (runs,) by name."""

    values: Float[Array, "runs variables"]
    scores: Float[Array, "runs free"]
    shares: Float[Array, " runs"]
    responses: dict[str, Any]


def scores_of(
    question: Question, problem: Any, place: np.ndarray, normal: np.ndarray
) -> np.ndarray:
    """Score functions (runs, free) of parts by the free numbers, between 0 and 1: the relative
    growth of their density as each of these grows."""
    freedom = question.freedom
    _, tolerance = (np.asarray(own) for own in freedom.decoded(jnp.asarray(place)))
    columns = []
    for choice in freedom.choices:
        i = choice.variable
        usual, name = float(freedom.usual[i]), freedom.names[i]
        nominal = choice.kind == NOMINAL
        by = Direction(name, i, None if nominal else usual)
        speed = choice.high - choice.low if nominal else np.log(choice.high / choice.low)
        # Of the distribution as wide as the design has it; by the logarithm of a tolerance.
        speed *= usual / tolerance[i] if nominal else usual
        columns.append(speed * weights(problem, by, normal))
    return np.stack(columns, axis=1)


@eqx.filter_jit
def noisy(question: Question, model: AbstractModel, drawn: Points, batch: Batch, place: Any) -> Any:
    """Cost and excesses of a candidate, (1 + limits,), and their slopes, (1 + limits, free): of a
    large sample of the surface, corrected by a batch of runs."""

    def both(own):
        samples = question.samples(own, model, drawn)
        grown = batch.shares * (1.0 + batch.scores @ (own - jax.lax.stop_gradient(own)))
        share = grown / jnp.sum(grown)
        surface = model(batch.values)
        excesses = []
        for limit, sample in zip(question.limits, samples, strict=True):
            if limit.response in surface and not limit.extreme():
                here = batch.responses[limit.response], surface[limit.response]
                sample = with_difference(sample, *here, share)
            excesses.append(limit.excess(sample))
        found = jnp.append(question.price(own), jnp.stack(excesses) / question.sizes)
        return found, found

    slopes, found = jax.jacrev(both, has_aux=True)(place)
    return found, slopes
