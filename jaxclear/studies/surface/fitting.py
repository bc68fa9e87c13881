"""Polynomials through runs by least squares, and what they say of runs that they have not seen.

Each run is left out once, without another fit: the hat matrix tells what the fit would have said
of it.
"""

from math import comb
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.integrators import Outcome
from jaxclear.studies.experiment import SampleResult
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_warnings import sentences_among
from jaxclear.studies.surface.polynomials import (
    MOST_TERMS,
    levels,
    orthonormal,
    powers,
    products,
)
from jaxclear.studies.surface.response_surface import ResponseSurface

# Singular values below this share of the largest carry no number.
RANK = 1e-10
# Degrees that are tried.
HIGHEST = 4
# Terms of a fit for each of its runs, at the most.
MOST_SHARE = 0.7
# Numbers of a fit, runs times terms, at the most: 2 GiB, of which it takes a few.
MOST_NUMBERS = 1 << 28


class Fit(NamedTuple):
    """Coefficients (terms, responses), leave-one-out R2 (responses,) [1] and what each run is
    predicted to give by the others, (runs, responses)."""

    coefficients: np.ndarray
    quality: np.ndarray
    predictions: np.ndarray


def least_squares(design: np.ndarray, target: np.ndarray) -> Fit:
    """Fit of `target` (runs, responses) by the terms `design` (runs, terms).

    R2 is that of the values left out, $1 - \\sum (y_i - y_{-i})^2 / \\sum (y_i - \\bar y_{-i})^2$,
    in which the mean leaves the run out as well; 1 where a response does not vary and is met.
    """
    runs = len(design)
    left, sizes, right = np.linalg.svd(design, full_matrices=False)
    mask = sizes > RANK * sizes[0]
    left = left[:, mask]
    coefficients = right[mask].T @ ((left.T @ target) / sizes[mask, None])
    residual = target - left @ (left.T @ target)
    freedom = 1.0 - np.einsum("rk,rk->r", left, left)
    # A run that the fit follows by itself says nothing of its error: taken for the worst.
    alone = freedom < RANK
    without = (target - target.mean(axis=0)) * runs / max(runs - 1, 1)
    inverse = 1.0 / np.where(alone, 1.0, freedom)
    error = np.where(alone[:, None], without, residual * inverse[:, None])
    total = (without**2).sum(axis=0)
    tiny = np.finfo(float).eps * np.sqrt(runs) * abs(target).max(axis=0)
    flat_response = total <= (10 * tiny) ** 2
    quality = 1.0 - (error**2).sum(axis=0) / np.where(flat_response, 1.0, total)
    quality = np.where(flat_response, 1.0, quality)
    return Fit(coefficients, quality, target - error)


def fitted(problem: Problem, values: np.ndarray, result: SampleResult) -> ResponseSurface:
    """The polynomial surface through runs, for each response of the degree of 1 to 4 that predicts
    runs best; failed runs are left out and counted.

    Args:
        problem: names responses and variables.
        values: of the variables, shape (runs, variables).
        result: of the runs.

    Raises:
        ValueError: too few runs reached their end.
    """
    names = problem.response_names
    target = np.stack([np.asarray(result.responses[name], float) for name in names], axis=1)
    good = (np.asarray(result.outcome) == Outcome.REACHED) & np.isfinite(target).all(axis=1)
    values, target, failed = np.asarray(values)[good], target[good], int((~good).sum())
    degrees = _degrees(values.shape[1], len(values))
    if len(values) < 2 or not degrees:
        raise ValueError(
            f"{len(values)} of {len(values) + failed} runs reached their end, too few for a "
            f"surface of {values.shape[1]} variables: take more runs (sample=...)."
        )
    polynomials = orthonormal(values, degrees[-1])
    table = powers(levels(polynomials), degrees[-1])
    if len(table) * len(values) > MOST_NUMBERS:
        raise ValueError(
            f"a surface in {values.shape[1]} variables has {len(table)} terms, and {len(values)} "
            f"runs give as many equations for them: {8 * len(table) * len(values) / 2**30:.2g} "
            f"GiB, and several times that to solve. Take {MOST_NUMBERS // len(table)} runs at the "
            "most."
        )
    term_sets = [np.flatnonzero(table.sum(axis=1) <= d) for d in degrees]
    terms = lambda at: products(polynomials, jnp.asarray(table), at)
    design = np.asarray(jax.jit(jax.vmap(terms))(jnp.asarray(values)))
    coefficients, chosen, which = _best_fits(design, target, term_sets)
    by_name = lambda numbers: dict(zip(names, numbers, strict=True))
    return ResponseSurface(
        problem,
        polynomials,
        jnp.asarray(table),
        by_name(jnp.asarray(coefficients)),
        by_name([float(fit.quality[i]) for i, fit in enumerate(chosen)]),
        by_name([degrees[best] for best in which]),
        values,
        by_name(target.T),
        by_name([fit.predictions[:, i] for i, fit in enumerate(chosen)]),
        failed,
        warnings=sentences_among(
            problem, result.checks, np.asarray(result.outcome) == Outcome.REACHED
        ),
    )


def _best_fits(
    design: np.ndarray, target: np.ndarray, term_sets: list[np.ndarray]
) -> tuple[np.ndarray, list[Fit], np.ndarray]:
    """For each response the fit that predicts runs best: coefficients (responses, terms), the fits,
    and their places in `term_sets`, which are the terms of each."""
    fits = [least_squares(design[:, terms], target) for terms in term_sets]
    best = np.argmax([fit.quality for fit in fits], axis=0)
    coefficients = np.zeros((len(best), design.shape[1]))
    for i, which in enumerate(best):
        coefficients[i, term_sets[which]] = fits[which].coefficients[:, i]
    return coefficients, [fits[which] for which in best], best


def _degrees(variables: int, runs: int) -> tuple[int, ...]:
    """Degrees that so many runs determine, and that memory has room for."""
    most = min(MOST_SHARE * runs, MOST_TERMS, max(MOST_NUMBERS // max(runs, 1), 1 + variables))
    return tuple(d for d in range(1, HIGHEST + 1) if comb(variables + d, d) <= most)
