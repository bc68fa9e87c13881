"""Scrambled points of Sobol's sequence, of which all quasi-random samples are made."""

import numpy as np
import scipy


def scrambled_shares(count: int, dimensions: int, rng: np.random.Generator) -> np.ndarray:
    """Points (count, dimensions) of the unit cube: one scrambling of Sobol's sequence. A power of
    two keeps it balanced; what is more than asked for is left out."""
    power = int(np.ceil(np.log2(max(count, 1))))
    return scipy.stats.qmc.Sobol(dimensions, scramble=True, rng=rng).random_base2(power)[:count]
