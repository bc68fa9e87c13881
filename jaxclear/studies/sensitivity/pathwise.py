"""Derivatives of statistics through every step of every run.

The tangent of a run is exact for the discrete run and cheap. Where contacts open and close that is
not the derivative of the motion: it stands only where another method confirms it. Behind many
impacts it grows without bound, and is refused.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.integrators import Outcome
from jaxclear.studies.experiment import SampleResult
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_warnings import concern
from jaxclear.studies.sensitivity.derivative import Estimate, from_parts, refused
from jaxclear.studies.sensitivity.estimand import Direction, Functional
from jaxclear.studies.statistics.scrambled import pseudo_values
from jaxclear.studies.store.batch import evaluate_all

# From this many times the typical size of single derivatives on, the error of their mean shows that
# a mean does not exist.
REFUSAL_SPREAD = 30.0


@eqx.filter_jit
def _tangents_of_chunk(problem: Problem, packed: Float[Array, "samples pairs"]) -> SampleResult:
    """Responses and their tangents along a direction, stacked: `packed` (samples, 2 variables) are
    values and directions.
    """
    count = packed.shape[1] // 2

    def one(row):
        def responses(values):
            result = problem.evaluate(values, discrete_derivatives=True)
            return result.responses, (result.outcome, result.ended, result.checks)

        values, tangents, rest = jax.jvp(responses, (row[:count],), (row[count:],), has_aux=True)
        both = {name: jnp.stack([values[name], tangents[name]]) for name in values}
        return SampleResult(both, *rest)

    return jax.vmap(one)(packed)


def pathwise(
    problem: Problem,
    sample: tuple[np.ndarray, np.ndarray],
    direction: Direction,
    functionals: list[Functional],
    *,
    progress_bar: bool = False,
) -> dict[str, Estimate]:
    """Mean of the derivatives of all runs, by label of the statistic.

    It is refused where it has no mean, and in doubt where contacts open and close.

    Args:
        problem: with the variables.
        sample: values (samples, variables) and scramblings (samples,).
        direction: variable and number that is differentiated by.
        functionals: statistics that are differentiated.
        progress_bar: whether one is shown.
    """
    refusal, doubt = problem.description.derivative
    values, group = sample
    if refusal:
        return {one.label: refused(refusal) for one in functionals}
    axes = np.zeros_like(values)
    axes[:, direction.variable] = direction.velocities(problem, values)
    packed = jnp.asarray(np.concatenate([values, axes], axis=1))
    result = evaluate_all(
        problem, packed, progress_bar=progress_bar, label="tangents", function=_tangents_of_chunk
    )
    good = np.asarray(result.outcome == Outcome.REACHED)
    answers = {}
    for one in functionals:
        share, words = concern(problem, one.response, result.checks, good)
        responses, tangents = np.asarray(result.responses[one.response])[good].T
        answer = _mean_tangent(one, responses, tangents, group[good])
        answers[one.label] = answer._replace(
            doubt=doubt, warned=share, warnings=words, runs=len(good)
        )
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
        lambda mask: float(np.mean(one.tangent(responses[mask], tangents[mask]))), group
    )
    answer = from_parts(parts)
    if answer.error > REFUSAL_SPREAD * np.median(abs(tangents)):
        return refused(
            f"single runs differ by up to {np.abs(tangents).max():.1e}: the tangent grows without "
            "bound through impacts."
        )
    return answer
