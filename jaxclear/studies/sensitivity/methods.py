"""Three ways to the derivative of a mean response, none of which is right everywhere.

`regression` reads the slope off a Monte Carlo sample (free, averages over the tolerances).
`differences` runs the same samples with one variable moved up and down (common random numbers), at
two widths, so that curvature shows as an error. `pathwise` carries the tangent through every step:
exact for the discrete run and cheap. Where contacts open and close that is not the derivative of
the motion: it stands only where another method confirms it. Behind many impacts it grows without
bound, and is refused.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.integrators import Outcome
from jaxclear.studies.base import AbstractProblem, SampleResult
from jaxclear.studies.batch import evaluate_all
from jaxclear.studies.monte_carlo import MonteCarlo
from jaxclear.studies.sensitivity.derivative import Estimate, refused
from jaxclear.studies.warned import concern

# A standard normal variable stays within this many deviations in 95 % of cases.
CONFIDENCE = 1.96
# From this many times the typical size of single derivatives on, the error of their mean shows that
# a mean does not exist.
REFUSAL_SPREAD = 30.0
# Fewer differences have no error worth the name; a fit takes 4 samples a coefficient besides.
FEWEST = 8
# A sample that a fit follows almost by itself (leverage near 1) is given this much freedom.
LEAST_FREEDOM = 1e-3


def regression(sample: MonteCarlo, response: str, variable: int) -> Estimate:
    """Slope at nominal of a quadratic least-squares fit over the sample, with
    heteroscedasticity-robust (HC3) errors.

    The fit is linear in all variables and quadratic in the one asked for (its place among them), so
    curvature does not leak into the slope.

    Source: HC3: MacKinnon & White 1985, J. Econometrics 29, 305, doi:10.1016/0304-4076(85)90158-7.
    """
    runs = np.isin(np.arange(sample.count), sample.failed, invert=True)
    good = np.flatnonzero(runs)
    values = sample.values[good] - np.asarray(sample.problem.nominal())
    scale = values.std(axis=0)
    if len(good) < 4 * values.shape[1] + FEWEST:
        return refused(
            f"{len(good)} good samples are too few for a fit in {values.shape[1]} variables."
        )
    if scale[variable] == 0:
        return refused("the variable does not vary in the sample.")
    x = values / np.where(scale > 0, scale, 1.0)
    design = np.column_stack([np.ones(len(x)), x, x[:, variable] ** 2])
    target = sample.responses[response][good]
    inverse = np.linalg.pinv(design.T @ design)
    coefficients = inverse @ design.T @ target
    leverage = np.einsum("ij,jk,ik->i", design, inverse, design)
    residual = (target - design @ coefficients) / np.clip(1.0 - leverage, LEAST_FREEDOM, None)
    covariance = inverse @ (design.T * residual**2) @ design @ inverse
    deviation = np.sqrt(covariance[1 + variable, 1 + variable])
    slope = coefficients[1 + variable]
    slope, error = slope / scale[variable], CONFIDENCE * deviation / scale[variable]
    told = concern(sample.problem, response, sample.checks, runs)
    return Estimate(float(slope), float(error))._replace(warned=told[0], warnings=told[1])


def differences(
    problem: AbstractProblem,
    values: np.ndarray,
    variable: int,
    width: float,
    *,
    progress_bar: bool = False,
) -> dict[str, Estimate]:
    """Central differences over common random numbers, `values` (samples, variables), at `width` (in
    the variable's unit) and half of it; their disagreement is the bias.
    """
    shifts = np.array([-1.0, -0.5, 0.5, 1.0]) * width
    direction = np.eye(values.shape[1])[variable]
    moved = np.concatenate([values + shift * direction for shift in shifts])
    found = evaluate_all(
        problem, jnp.asarray(moved), progress_bar=progress_bar, label="differences"
    )
    good = np.all((found.outcome == Outcome.REACHED).reshape(4, -1), axis=0)
    runs = np.tile(good, 4)
    estimates = {}
    for name, flat in found.responses.items():
        far_down, down, up, far_up = flat.reshape(4, -1)[:, good]
        wide, narrow = (far_up - far_down) / (2 * width), (up - down) / width
        if len(wide) < FEWEST:
            estimates[name] = refused(
                f"only {len(wide)} of {len(good)} samples ran at all four widths."
            )
            continue
        gap = abs(wide.mean() - narrow.mean())
        # A gap within its own noise is no sign of curvature.
        bias = max(gap - _half_interval(wide - narrow), 0.0)
        answer = Estimate(float(wide.mean()), float(np.hypot(_half_interval(wide), bias)))
        share, words = concern(problem, name, found.checks, runs)
        estimates[name] = answer._replace(warned=share, warnings=words)
    return estimates


def _half_interval(values: np.ndarray) -> float:
    """95 % error of the mean of independent values."""
    return float(CONFIDENCE * values.std(ddof=1) / np.sqrt(len(values)))


@eqx.filter_jit
def _tangents_of_chunk(
    problem: AbstractProblem, packed: Float[Array, "samples pairs"]
) -> SampleResult:
    """Tangents of the responses along a direction: `packed` (samples, 2 variables) are values and
    directions.
    """
    count = packed.shape[1] // 2

    def one(row):
        def responses(values):
            result = problem.evaluate(values, discrete_derivatives=True)
            return result.responses, (result.outcome, result.ended, result.checks)

        _, tangents, rest = jax.jvp(responses, (row[:count],), (row[count:],), has_aux=True)
        return SampleResult(tangents, *rest)

    return jax.vmap(one)(packed)


def pathwise(
    problem: AbstractProblem, values: np.ndarray, variable: int, *, progress_bar: bool = False
) -> dict[str, Estimate]:
    """Mean over the sample `values` (samples, variables) of the derivative of each run, with its
    standard error; refused where it has no mean, in doubt where contacts open and close.
    """
    why, doubt = problem.pathwise_limits()
    if why:
        return {name: refused(why) for name in problem.response_names}
    direction = np.zeros_like(values)
    direction[:, variable] = 1.0
    packed = jnp.asarray(np.concatenate([values, direction], axis=1))
    found = evaluate_all(
        problem, packed, progress_bar=progress_bar, label="tangents", function=_tangents_of_chunk
    )
    good = np.asarray(found.outcome == Outcome.REACHED)
    estimates = {}
    for name, tangents in found.responses.items():
        share, words = concern(problem, name, found.checks, good)
        answer = _mean_tangent(np.asarray(tangents)[good])
        estimates[name] = answer._replace(doubt=doubt, warned=share, warnings=words)
    return estimates


def _mean_tangent(tangents: np.ndarray) -> Estimate:
    finite = tangents[np.isfinite(tangents)]
    error = _half_interval(finite) if len(finite) > 1 else np.nan
    if len(finite) < len(tangents) or not np.isfinite(error):
        return refused(
            f"the tangent overflowed in {len(tangents) - len(finite)} of {len(tangents)} runs: it "
            "grows without bound through impacts."
        )
    if error > REFUSAL_SPREAD * np.median(abs(finite)):
        return refused(
            f"single runs differ by up to {np.abs(finite).max():.1e}: the tangent grows without "
            "bound through impacts."
        )
    return Estimate(float(finite.mean()), error)
