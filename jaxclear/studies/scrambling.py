"""Scrambled points of Sobol's sequence, of which all quasi-random samples are made."""

import numpy as np
import scipy

# Shares that have a finite score.
LEAST_SHARE = 1e-12


def scrambled_shares(count: int, dimensions: int, rng: np.random.Generator) -> np.ndarray:
    """Points (count, dimensions) of the unit cube: one scrambling of Sobol's sequence."""
    return ScrambledSequence(dimensions, rng).points(0, count)


def scrambled_normal(count: int, dimensions: int, rng: np.random.Generator) -> np.ndarray:
    """Standard normal numbers (count, dimensions): one scrambling."""
    return normal_scores(scrambled_shares(count, dimensions, rng))


class ScrambledSequence:
    """One scrambling of Sobol's sequence. What follows what was asked last is cheapest."""

    def __init__(self, dimensions: int, rng: np.random.Generator):
        self.engine = scipy.stats.qmc.Sobol(dimensions, scramble=True, rng=rng)
        self.next = 0

    def points(self, first: int, last: int) -> np.ndarray:
        """Points (last - first, dimensions) of the unit cube, from the first number up to the
        last."""
        if first < self.next:
            self.engine.reset()
            self.next = 0
        if first > self.next:
            self.engine.fast_forward(first - self.next)
        # The first one by itself: the engine warns of other beginnings than powers of two.
        alone = 1 if first == 0 and last > 0 else 0
        points = [self.engine.random(alone), self.engine.random(last - first - alone)]
        self.next = last
        return np.concatenate(points)


def scores_by_scrambling(sizes: np.ndarray, dimensions: int, seed: int) -> np.ndarray:
    """Standard normal numbers (samples, dimensions): parts of these sizes, one after the other, of
    one scrambled sequence.

    The whole is as even as one sequence, and each part is a sample by itself. Parts fill the gaps
    of each other, so that their mean is nearer to the truth than their differences say: an error
    that these tell is too large rather than too small.
    """
    return scrambled_normal(int(np.sum(sizes)), dimensions, np.random.default_rng((seed, 0)))


def seed_of(*numbers: int) -> int:
    """A seed of its own for each row of numbers, which a study of a number near one of them does
    not have."""
    return int(np.random.SeedSequence(numbers).generate_state(1)[0])


def normal_scores(shares: np.ndarray) -> np.ndarray:
    """Standard normal numbers of which these shares [1] lie below."""
    return scipy.special.ndtri(np.clip(shares, LEAST_SHARE, 1 - LEAST_SHARE))
