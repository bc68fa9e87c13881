"""Ways to the derivative of a statistic by runs at other values, and by tangents of runs.

`differences` runs the same samples with one variable moved up and down (common random numbers), by
two steps, and extrapolates to none (Richardson). `pathwise` carries the tangent through every step:
exact for the discrete run and cheap. Where contacts open and close that is not the derivative of
the motion: it stands only where another method confirms it. Behind many impacts it grows without
bound, and is refused. Beside them stands `regression`, which needs no runs of its own.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.integrators import Outcome
from jaxclear.studies.base import AbstractProblem, SampleResult
from jaxclear.studies.batch import evaluate_all
from jaxclear.studies.sensitivity.derivative import Estimate, from_parts, refused
from jaxclear.studies.sensitivity.direction import Direction
from jaxclear.studies.sensitivity.functional import Functional
from jaxclear.studies.sensitivity.regression import pseudo_values
from jaxclear.studies.statistics.scrambled import student
from jaxclear.studies.warned import concern

# From this many times the typical size of single derivatives on, the error of their mean shows that
# a mean does not exist.
REFUSAL_SPREAD = 30.0
# Fewer differences have no error worth the name.
FEWEST = 8
# Where the two steps differ by more than chance, what a third would still move the answer: the
# extrapolation gains a factor of 4 a halving at least.
REMAINDER = 0.25


def differences(
    problem: AbstractProblem,
    sample: tuple[np.ndarray, np.ndarray],
    direction: Direction,
    wanted: list[Functional],
    *,
    progress_bar: bool = False,
) -> dict[str, Estimate]:
    """Central differences over common random numbers, `sample`: values (samples, variables) and
    their scramblings (samples,), by one step of the direction and half of it, extrapolated."""
    values, group = sample
    step = direction.step(problem)
    if not problem.inputs.distributions[direction.variable].is_continuous() and direction.number:
        why = "the variable comes in single sizes; its width has no meaning by itself."
        return {one.label: refused(why) for one in wanted}
    speed = direction.velocities(problem, values)
    shifts = np.array([-1.0, -0.5, 0.5, 1.0]) * step
    axis = np.eye(values.shape[1])[direction.variable]
    moved = np.concatenate([values + shift * speed[:, None] * axis for shift in shifts])
    found = evaluate_all(
        problem, jnp.asarray(moved), progress_bar=progress_bar, label="differences"
    )
    good = np.all((found.outcome == Outcome.REACHED).reshape(4, -1), axis=0)
    runs = np.tile(good, 4)
    answers = {}
    for one in wanted:
        if good.sum() < FEWEST:
            answers[one.label] = refused(
                f"only {good.sum()} of {len(good)} samples ran at all four widths."
            )
            continue
        rows = np.asarray(found.responses[one.response]).reshape(4, -1)[:, good]

        def slopes(kept, rows=rows, one=one):
            far_down, down, up, far_up = (one.value(row[kept]) for row in rows)
            wide, narrow = (far_up - far_down) / (2 * step), (up - down) / step
            return np.array([wide, narrow, (4 * narrow - wide) / 3])

        parts = pseudo_values(slopes, group[good]).reshape(-1, 3)
        if not one.smooth:
            # What a jackknife would correct is less than the noise that it would bring.
            parts += slopes(np.ones(int(good.sum()), bool)) - parts.mean(axis=0)
        gap = parts[:, 2] - parts[:, 1]
        half = student(len(gap)) * gap.std(ddof=1) / np.sqrt(len(gap)) if len(gap) > 1 else np.inf
        # A gap within its own noise is no sign of curvature.
        bias = REMAINDER * max(abs(gap.mean()) - half, 0.0)
        told = concern(problem, one.response, found.checks, runs)
        answer = from_parts(parts[:, 2], bias)
        answers[one.label] = answer._replace(warned=told[0], warnings=told[1])
    return answers


@eqx.filter_jit
def _tangents_of_chunk(
    problem: AbstractProblem, packed: Float[Array, "samples pairs"]
) -> SampleResult:
    """Responses and their tangents along a direction, stacked: `packed` (samples, 2 variables) are
    values and directions.
    """
    count = packed.shape[1] // 2

    def one(row):
        def responses(values):
            result = problem.evaluate(values, discrete_derivatives=True)
            return result.responses, (result.outcome, result.ended, result.checks)

        found, tangents, rest = jax.jvp(responses, (row[:count],), (row[count:],), has_aux=True)
        both = {name: jnp.stack([found[name], tangents[name]]) for name in found}
        return SampleResult(both, *rest)

    return jax.vmap(one)(packed)


def pathwise(
    problem: AbstractProblem,
    sample: tuple[np.ndarray, np.ndarray],
    direction: Direction,
    wanted: list[Functional],
    *,
    progress_bar: bool = False,
) -> dict[str, Estimate]:
    """Mean over the `sample`, values (samples, variables) and their scramblings (samples,), of the
    derivative of each run; refused where it has no mean, in doubt where contacts open and close.
    """
    refusal, doubt = problem.pathwise_limits()
    values, group = sample
    if refusal:
        return {one.label: refused(refusal) for one in wanted}
    axes = np.zeros_like(values)
    axes[:, direction.variable] = direction.velocities(problem, values)
    packed = jnp.asarray(np.concatenate([values, axes], axis=1))
    found = evaluate_all(
        problem, packed, progress_bar=progress_bar, label="tangents", function=_tangents_of_chunk
    )
    good = np.asarray(found.outcome == Outcome.REACHED)
    answers = {}
    for one in wanted:
        share, words = concern(problem, one.response, found.checks, good)
        responses, tangents = np.asarray(found.responses[one.response])[good].T
        answer = _mean_tangent(one, responses, tangents, group[good])
        answers[one.label] = answer._replace(doubt=doubt, warned=share, warnings=words)
    return answers


def _mean_tangent(
    one: Functional, responses: np.ndarray, tangents: np.ndarray, group: np.ndarray
) -> Estimate:
    finite = np.isfinite(tangents)
    if finite.sum() < len(tangents) or len(tangents) < 2:
        return refused(
            f"the tangent overflowed in {len(tangents) - finite.sum()} of {len(tangents)} runs: it "
            "grows without bound through impacts."
        )
    if one.tangent(responses, tangents) is None:
        return refused("tangents of runs do not tell how many parts pass a value.")
    parts = pseudo_values(
        lambda kept: float(np.mean(one.tangent(responses[kept], tangents[kept]))), group
    )
    answer = from_parts(parts)
    if answer.error > REFUSAL_SPREAD * np.median(abs(tangents)):
        return refused(
            f"single runs differ by up to {np.abs(tangents).max():.1e}: the tangent grows without "
            "bound through impacts."
        )
    return answer
