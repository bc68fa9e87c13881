"""The values of unknowns whose signals are nearest to a record: Levenberg-Marquardt from several
starts, with JAX's own derivatives of the problem.

It goes by the unknowns' independent standard normal numbers, in which every bound of a prior lies
at infinity; the prior is one equation more for each of them, so that what the record does not tell
stays where the prior has it. From a short window of the record to all of it: of a motion with
impacts the whole has many minima, its beginning few.

Source: Levenberg 1944, Quart. Appl. Math. 2, 164; Marquardt 1963, J. SIAM 11, 431; by optimistix
(Rader, Lyons & Kidger 2024, arXiv:2402.09983).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Float

from jaxclear.studies.identification.forward import Forward, Record
from jaxclear.studies.scrambling import ScrambledSequence, normal_scores

# Relative and absolute change of the unknowns' normal numbers and of the sum of squares at an end.
TOLERANCE = 1e-4
MOST_STEPS = 40
# Starts lie within the middle of the prior: far out its scores hardly move the unknowns.
WIDEST_START = 1.5
# Two optima are one where the sums of squares and the distance of their normal numbers are this.
SAME_COST, SAME_PLACE = 1e-3, 1e-2
# A place is an optimum where a step of Gauss and Newton would move it by less than this, in
# standard deviations of what the record tells.
LARGEST_STEP = 0.1


class Optimum(NamedTuple):
    """A place of the unknowns. `normal` (variables,) [1]: their standard normal numbers; `cost`
    [1]: half the sum of squares, prior and all; `residual` (n,), signals less measurement in their
    units; `slopes` (n, variables) by normal number; `converged`: whether it is an optimum."""

    normal: np.ndarray
    cost: float
    residual: np.ndarray
    slopes: np.ndarray
    converged: bool

    def information(self, scale: np.ndarray) -> np.ndarray:
        """Curvature (variables, variables) [1] of the half sum of squares; `scale` (n,): of each
        residual, in its unit."""
        weighted = self.slopes / scale[:, None]
        return weighted.T @ weighted + np.eye(len(self.normal))


@eqx.filter_jit
def _solve_from_starts(forward: Forward, starts: Array, measured: Array, scale: Array, mask: Array):
    inputs = forward.problem.inputs

    def residual(normal, _):
        difference = mask * (forward.row(inputs.values(normal)) - measured) / scale
        return jnp.concatenate([difference, normal])

    def one(start):
        solver = optimistix.LevenbergMarquardt(TOLERANCE, TOLERANCE)
        solution = optimistix.least_squares(
            residual, solver, start, options={"jac": "fwd"}, max_steps=MOST_STEPS, throw=False
        )
        ended = solution.result == optimistix.RESULTS.successful
        return solution.value, ended, solution.stats["num_steps"]

    return jax.vmap(one)(starts)


@eqx.filter_jit
def _residuals_and_slopes(forward: Forward, normals: Array, measured: Array):
    inputs = forward.problem.inputs
    row_of = lambda normal: forward.row(inputs.values(normal))
    rows = jax.vmap(lambda normal: row_of(normal) - measured)(normals)
    return rows, jax.vmap(jax.jacfwd(row_of))(normals)


def starts_of(count: int, variables: int, seed: int) -> np.ndarray:
    """Standard normal numbers (count, variables) at which searches begin, the nominal ones first.

    Args:
        count: number of starts.
        variables: number of unknowns.
        seed: of the others, spread over the middle of the prior.
    """
    drawn = normal_scores(
        ScrambledSequence(variables, np.random.default_rng(seed)).points(0, count)
    )
    return np.concatenate([np.zeros((1, variables)), np.clip(drawn, -WIDEST_START, WIDEST_START)])[
        :count
    ]


def finer_residuals(forward: Forward, normals: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Residuals (n,) of a model at the first of some places (places, variables).

    Args:
        forward: signals of the unknowns, by finer steps.
        normals: standard normal numbers.
        measured: signals in one row.
    """
    arguments = forward, jnp.asarray(normals), jnp.asarray(measured)
    return np.asarray(_residuals_and_slopes(*arguments)[0][0])


def optima(
    forward: Forward,
    record: Record,
    starts: Float[np.ndarray, "starts variables"],
    scale: Float[np.ndarray, " n"],
    windows: int = 1,
) -> tuple[list[Optimum], int]:
    """Distinct finite ends of the searches, nearest to the record first, and the number of runs.

    Args:
        forward: signals of the unknowns, with derivatives.
        record: to be fitted.
        starts: standard normal numbers at which searches begin.
        scale: standard deviation of each sample of the record, in its unit.
        windows: how often the window doubles until it holds the whole record.
    """
    measured, normals = record.row, np.asarray(starts)
    ended, runs = np.zeros(len(normals), bool), len(normals)
    for window in range(windows):
        mask = _window_mask(record, 0.5 ** (windows - 1 - window))
        arguments = map(jnp.asarray, (normals, measured, scale, mask))
        solutions, ended, steps = _solve_from_starts(forward, *arguments)
        runs += int(np.sum(steps))
        normals = np.where(np.isfinite(solutions), solutions, normals)
    residuals, slopes = map(
        np.asarray, _residuals_and_slopes(forward, jnp.asarray(normals), jnp.asarray(measured))
    )
    every = [
        _optimum(*each, scale)
        for each in zip(normals, residuals, slopes, np.asarray(ended), strict=True)
    ]
    good = [fit for fit in every if np.isfinite(fit.cost) and np.isfinite(fit.slopes).all()]
    distinct: list[Optimum] = []
    for fit in sorted(good, key=lambda fit: fit.cost):
        is_same = lambda other, fit=fit: (
            fit.cost - other.cost <= SAME_COST * max(other.cost, 1.0)
            and np.abs(fit.normal - other.normal).max() <= SAME_PLACE
        )
        if not any(map(is_same, distinct)):
            distinct.append(fit)
    return distinct, runs


def _optimum(normal, residual, slopes, ended, scale) -> Optimum:
    cost = 0.5 * (np.sum((residual / scale) ** 2) + normal @ normal)
    optimum = Optimum(normal, float(cost), residual, slopes, bool(ended))
    if not np.isfinite(cost) or not np.isfinite(slopes).all():
        return optimum._replace(converged=False)
    gradient = slopes.T @ (residual / scale**2) + normal
    step = np.sqrt(gradient @ np.linalg.solve(optimum.information(scale), gradient))
    return optimum._replace(converged=bool(ended or step <= LARGEST_STEP))


def _window_mask(record: Record, share: float) -> np.ndarray:
    """1 for the samples (n,) in the first `share` [1] of each signal, 0 for the others."""
    masks = [np.arange(len(s)) < np.ceil(share * len(s)) for s in record.signals.values()]
    return np.concatenate(masks).astype(float)
