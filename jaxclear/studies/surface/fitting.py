"""Polynomials through runs by least squares, and what they say of runs that they have not seen.

Each run is left out once, without another fit: the hat matrix tells what the fit would have said
of it. Slopes of a run are more equations, left out with it.
"""

from math import comb
from typing import Any, NamedTuple

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
# Degrees that are tried where none is asked for.
HIGHEST = 4
# Terms of a fit for each of its equations, at the most.
MOST_SHARE = 0.7
# Numbers of a fit, equations times terms, at the most: 2 GiB, of which it takes a few.
MOST_NUMBERS = 1 << 28


class Fit(NamedTuple):
    """Coefficients (terms, responses), leave-one-out R2 (responses,) [1] and what each run is
    predicted to give by the others, (runs, responses)."""

    coefficients: np.ndarray
    quality: np.ndarray
    predictions: np.ndarray


def least_squares(design: np.ndarray, target: np.ndarray) -> Fit:
    """Fit of `target` (runs, equations, responses), of which the first equation of a run is its
    value, by the terms `design` (runs, equations, terms).

    R2 is that of the values left out, $1 - \\sum (y_i - y_{-i})^2 / \\sum (y_i - \\bar y_{-i})^2$,
    in which the mean leaves the run out as well; 1 where a response does not vary and is met.
    """
    runs, equations, terms = design.shape
    left, sizes, right = np.linalg.svd(design.reshape(-1, terms), full_matrices=False)
    mask = sizes > RANK * sizes[0]
    left = left[:, mask]
    flat = target.reshape(runs * equations, -1)
    coefficients = right[mask].T @ ((left.T @ flat) / sizes[mask, None])
    residual = (flat - left @ (left.T @ flat)).reshape(runs, equations, -1)
    blocks = left.reshape(runs, equations, -1)
    freedom = np.eye(equations) - np.einsum("rik,rjk->rij", blocks, blocks)
    # A run that the fit follows by itself says nothing of its error: taken for the worst.
    error = np.einsum("rij,rjm->rim", np.linalg.pinv(freedom, rtol=RANK, hermitian=True), residual)
    alone = np.linalg.eigvalsh(freedom)[:, 0] < RANK
    values = target[:, 0]
    without = (values - values.mean(axis=0)) * runs / max(runs - 1, 1)
    error = np.where(alone[:, None], without, error[:, 0])
    total = (without**2).sum(axis=0)
    tiny = np.finfo(float).eps * np.sqrt(runs) * abs(values).max(axis=0)
    flat_response = total <= (10 * tiny) ** 2
    quality = 1.0 - (error**2).sum(axis=0) / np.where(flat_response, 1.0, total)
    quality = np.where(flat_response, 1.0, quality)
    return Fit(coefficients, quality, values - error)


def fitted(
    problem: Problem,
    values: np.ndarray,
    result: SampleResult,
    *,
    degree: int | None = None,
    gradients: dict[str, np.ndarray] | None = None,
) -> ResponseSurface:
    """The polynomial surface through runs; failed runs are left out and counted.

    Args:
        problem: names responses and variables.
        values: of the variables, shape (runs, variables).
        result: of the runs.
        degree: of the polynomials; None: for each response that of 1 to 4 which predicts runs best.
        gradients: slopes of each response, shape (runs, variables); None: without.

    Raises:
        ValueError: too few runs reached their end.
    """
    names = problem.response_names
    values, target, slopes, failed = _good_runs(names, values, result, gradients)
    equations = len(values) * (1 + (values.shape[1] if gradients is not None else 0))
    degrees = (degree,) if degree is not None else _degrees(values.shape[1], equations)
    if len(values) < 2 or not degrees:
        raise ValueError(
            f"{len(values)} of {len(values) + failed} runs reached their end, too few for a "
            f"surface of {values.shape[1]} variables: take more runs (sample=...)."
        )
    polynomials = orthonormal(values, degrees[-1])
    table = powers(levels(polynomials), degrees[-1])
    if len(table) * equations > MOST_NUMBERS:
        fewer = ", or slopes=False" if gradients is not None else ""
        raise ValueError(
            f"a surface of degree {degrees[-1]} in {values.shape[1]} variables has {len(table)} "
            f"terms, and {len(values)} runs give {equations} equations for them: "
            f"{8 * len(table) * equations / 2**30:.2g} GiB, and several times that to solve. Take "
            f"{MOST_NUMBERS // len(table) * len(values) // equations} runs at the most, or a lower "
            f"degree{fewer}."
        )
    if degree is not None and len(table) > MOST_SHARE * equations:
        run_count = int(np.ceil(len(table) / MOST_SHARE * len(values) / equations))
        raise ValueError(
            f"a surface of degree {degree} in {values.shape[1]} variables has {len(table)} terms, "
            f"and {len(values)} runs reached their end; take at least {run_count} runs, or a lower "
            "degree."
        )
    term_sets = [np.flatnonzero(table.sum(axis=1) <= d) for d in degrees]
    system = _fit_equations(polynomials, table, values, target, slopes)
    coefficients, chosen, which = _best_fits(*system, term_sets)
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
    design: np.ndarray, aims: np.ndarray, term_sets: list[np.ndarray]
) -> tuple[np.ndarray, list[Fit], np.ndarray]:
    """For each response the fit that predicts runs best: coefficients (responses, terms), the fits,
    and their places in `term_sets`, which are the terms of each."""
    fits = [least_squares(design[:, :, terms], aims) for terms in term_sets]
    best = np.argmax([fit.quality for fit in fits], axis=0)
    coefficients = np.zeros((len(best), design.shape[2]))
    for i, which in enumerate(best):
        coefficients[i, term_sets[which]] = fits[which].coefficients[:, i]
    return coefficients, [fits[which] for which in best], best


def _good_runs(
    names: tuple[str, ...],
    values: np.ndarray,
    result: SampleResult,
    gradients: dict[str, np.ndarray] | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, int]:
    """Values (runs, variables), responses (runs, responses) and slopes (runs, variables, responses)
    of the runs that reached their end, and how many did not."""
    target = np.stack([np.asarray(result.responses[name], float) for name in names], axis=1)
    good = (np.asarray(result.outcome) == Outcome.REACHED) & np.isfinite(target).all(axis=1)
    slopes = None
    if gradients is not None:
        slopes = np.stack([gradients[name] for name in names], axis=2)
        good &= np.isfinite(slopes).all(axis=(1, 2))
        slopes = slopes[good]
    return np.asarray(values)[good], target[good], slopes, int((~good).sum())


def _degrees(variables: int, equations: int) -> tuple[int, ...]:
    """Degrees that so many equations determine, and that memory has room for."""
    most = min(
        MOST_SHARE * equations, MOST_TERMS, max(MOST_NUMBERS // max(equations, 1), 1 + variables)
    )
    return tuple(d for d in range(1, HIGHEST + 1) if comb(variables + d, d) <= most)


def _fit_equations(
    polynomials: Any, table: np.ndarray, values: np.ndarray, target: np.ndarray, slopes: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Terms (runs, equations, terms) and what they are to give (runs, equations, responses): the
    value of each run, and its slopes for one deviation of each variable."""
    terms = lambda at: products(polynomials, jnp.asarray(table), at)
    design = np.asarray(jax.jit(jax.vmap(terms))(jnp.asarray(values)))[:, None]
    aims = target[:, None]
    if slopes is None:
        return design, aims
    scale = np.asarray(polynomials.scale)
    steep = np.asarray(jax.jit(jax.vmap(jax.jacfwd(terms)))(jnp.asarray(values))) * scale
    design = np.concatenate([design, np.swapaxes(steep, 1, 2)], axis=1)
    return design, np.concatenate([aims, slopes * scale[:, None]], axis=1)
