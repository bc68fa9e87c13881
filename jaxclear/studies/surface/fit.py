"""Coefficients of a surface by least squares, and what it says of runs that it has not seen.

Each run is left out once, without another fit: the hat matrix tells what the fit would have said
of it. Slopes of a run are more equations, left out with it.
"""

from typing import NamedTuple

import numpy as np

# Singular values below this share of the largest carry no number.
RANK = 1e-10


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
    kept = sizes > RANK * sizes[0]
    left = left[:, kept]
    flat = target.reshape(runs * equations, -1)
    coefficients = right[kept].T @ ((left.T @ flat) / sizes[kept, None])
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
