"""The parts that a design makes: one sample of standard normal points for every candidate.

With common points a response is a smooth function of nominal values and tolerances. Where rare
parts decide, some of the points are drawn about those, and weighted by how much rarer they are.
"""

import equinox as eqx
import numpy as np
import scipy

from jaxclear.studies.scrambling import scrambled_shares

# Points lie no further out than this share: quantiles of distributions without ends are finite.
EDGE = 1e-15


class Points(eqx.Module):
    """Standard normal points (samples, variables) and their weights (samples,), which add up to
    1."""

    normal: np.ndarray
    weights: np.ndarray


def points(
    variables: int,
    samples: int,
    seed: int,
    shifts: tuple[np.ndarray, ...] = (),
    matched: bool = False,
) -> Points:
    """Quasi-random points. `shifts`: centres (variables,) of rare regions, each of which gets as
    many points as the middle; all are weighted by the balance heuristic of Veach & Guibas 1995
    (https://doi.org/10.1145/218380.218498). `matched`: mean and covariance are those of the
    distribution itself, where there are no shifts."""
    if not shifts and matched:
        return Points(_matched(variables, samples, seed), np.full(samples, 1.0 / samples))
    centres = [np.zeros(variables), *shifts]
    parts = []
    for number, centre in enumerate(centres):
        rng = np.random.default_rng([seed, number])
        parts.append(_drawn(variables, samples, rng) + centre)
    normal = np.concatenate(parts)
    # Density of the mixture in multiples of the standard normal one.
    grown = np.mean([np.exp(normal @ c - 0.5 * c @ c) for c in centres], axis=0)
    weights = 1.0 / grown
    return Points(normal, weights / weights.sum())


def _drawn(variables: int, samples: int, rng: np.random.Generator) -> np.ndarray:
    return scipy.stats.norm.ppf(np.clip(scrambled_shares(samples, variables, rng), EDGE, 1 - EDGE))


def _matched(variables: int, samples: int, seed: int) -> np.ndarray:
    """Points and their mirror images, stretched until their covariance is the unit matrix."""
    half = _drawn(variables, -(-samples // 2), np.random.default_rng([seed, 0]))
    normal = np.concatenate([half, -half])[:samples]
    return np.linalg.solve(
        np.linalg.cholesky(np.cov(normal.T, ddof=0).reshape(variables, -1)), normal.T
    ).T
