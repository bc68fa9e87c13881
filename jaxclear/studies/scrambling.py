"""Scrambled points of Sobol's sequence, of which all quasi-random samples are made."""

import numpy as np
import scipy

# Shares that have a finite score.
LEAST_SHARE = 1e-12


def scrambled_shares(
    count: int, dimensions: int, rng: np.random.Generator, first: int = 0
) -> np.ndarray:
    """Points (count - first, dimensions) of the unit cube, from number `first` up to `count`: one
    scrambling of Sobol's sequence. A power of two keeps it balanced; what is more than asked for is
    left out."""
    engine = scipy.stats.qmc.Sobol(dimensions, scramble=True, rng=rng)
    if first:
        return engine.fast_forward(first).random(count - first)
    power = int(np.ceil(np.log2(max(count, 1))))
    return engine.random_base2(power)[:count]


def normal_scores(shares: np.ndarray) -> np.ndarray:
    """Standard normal numbers of which these shares [1] lie below."""
    return scipy.special.ndtri(np.clip(shares, LEAST_SHARE, 1 - LEAST_SHARE))
