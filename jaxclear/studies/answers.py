"""What a problem answers for one set of values, with its derivatives.

Where derivatives are compared with those in other steps (`simulation.derivatives`), responses are
what is compared: what nearly cancels in one is seen.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground.quantity import inside, numbers
from jaxclear.integrators import Outcome
from jaxclear.multibody.assembly import is_sound
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.derivatives import (
    backwards,
    compared,
    guarded,
    in_other_steps,
    is_compared,
    order_of,
    where_alike,
)
from jaxclear.simulation.singular_positions import diagnosed_outcome
from jaxclear.studies.base import SampleResult
from jaxclear.studies.responses import answer


def answers(problem: Any, values: Float[Array, " variables"], discrete: bool) -> SampleResult:
    """Responses of a `Problem` for one set of values; `discrete`: derivatives of the discrete run
    are wanted, where the integrator has them."""
    integrator = problem.integrator
    own = discrete and integrator.pathwise
    seen = integrator.formulation.seen(problem.mechanism)
    if not own and is_compared(seen, integrator):
        known = compared(_answered, _finer, _alike, _steps, order_of(integrator))
        return backwards(integrator)(known, problem, values)
    started = lambda problem, values: problem.started(values, own)
    mechanism, start, run = backwards(integrator)(started, problem, values)
    return _taken(problem, mechanism, start, guarded(run, integrator, discrete))


def _taken(problem: Any, mechanism: Any, start: Any, run: Trajectory) -> SampleResult:
    responses = {name: answer(name, response, run) for name, response in problem.response.items()}
    ranges = [jnp.all(inside(leaf, known)) for _, leaf, known in numbers(mechanism)]
    possible = jnp.all(jnp.stack(ranges))
    sound = is_sound(mechanism, start)
    kept = problem.keeps_mode(mechanism, start)
    outcome = jnp.where(kept, diagnosed_outcome(run), Outcome.OTHER_MODE)
    outcome = jnp.where(sound, outcome, Outcome.UNASSEMBLED)
    outcome = jnp.where(possible, outcome, Outcome.OUT_OF_RANGE)
    return SampleResult(responses, outcome, run.ended, run.invariants)


def _answered(problem: Any, values: Array) -> SampleResult:
    return _taken(problem, *problem.started(values))


def _finer(share: Any, problem: Any, values: Array) -> tuple[Any, Array]:
    """The same in other steps."""
    steps = in_other_steps(problem.integrator, share)
    return eqx.tree_at(lambda known: known.integrator, problem, steps), values


def _steps(problem: Any, _: Any) -> tuple[Any, Any]:
    return problem.integrator.asked_step(), problem.shares * problem.duration


def _alike(found: SampleResult, ways: SampleResult, ratios: Array, least: Any) -> SampleResult:
    """Derivatives of what is answered; those of responses are nan where steps decide them."""
    told = {
        name: where_alike(way, ratios, abs(way[0]), least * abs(found.responses[name]))
        for name, way in ways.responses.items()
    }
    moves = jax.tree.map(lambda each: each[0], ways)
    return SampleResult(told, moves.outcome, moves.ended, moves.checks)
