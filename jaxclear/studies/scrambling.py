"""Scrambled points of Sobol's sequence, of which all quasi-random samples are made."""

import functools
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import scipy

# Shares that have a finite score.
LEAST_SHARE = 1e-12
# Binary digits of a point, and by how many places each is moved, the highest first. SciPy keeps the
# direction numbers; `scipy.stats` itself takes 0.6 s to import.
BITS = 30
DIGITS = np.arange(BITS)[::-1]
DIRECTION_FILE = "stats/_sobol_direction_numbers.npz"
# Numbers of a point at the most: so many direction numbers are published.
MOST_DIMENSIONS = 21_201


def scrambled_shares(count: int, dimensions: int, rng: np.random.Generator) -> np.ndarray:
    """Points of the unit cube: one scrambling of Sobol's sequence.

    Args:
        count: number of points.
        dimensions: of the cube.
        rng: random generator of the scrambling.
    """
    return ScrambledSequence(dimensions, rng).points(0, count)


def scrambled_normal(count: int, dimensions: int, rng: np.random.Generator) -> np.ndarray:
    """Standard normal numbers (count, dimensions): one scrambling of Sobol's sequence.

    Args:
        count: number of points.
        dimensions: numbers of a point.
        rng: random generator of the scrambling.
    """
    return normal_scores(scrambled_shares(count, dimensions, rng))


@functools.lru_cache(maxsize=64)
def _direction_bits(dimensions: int) -> np.ndarray:
    """Binary digits (dimensions, direction numbers, digits) of Sobol's direction numbers."""
    with np.load(Path(scipy.__file__).parent / DIRECTION_FILE) as table:
        pairs = zip(
            *(table[name][1:dimensions].tolist() for name in ("poly", "vinit")), strict=True
        )
    directions = [[1] * BITS]
    for polynomial, initial in pairs:
        degree = polynomial.bit_length() - 1
        row = initial[:degree]
        for j in range(degree, BITS):
            row.append(row[j - degree])
            for k in range(1, degree + 1):
                if polynomial >> (degree - k) & 1:
                    row[j] ^= row[j - k] << k
        directions.append(row)
    return (np.array(directions) << DIGITS)[:, :, None] >> DIGITS & 1


class ScrambledSequence:
    """One scrambling of Sobol's sequence: a random lower triangular matrix of binary digits for
    each dimension, and a digital shift. Its points are those of `scipy.stats.qmc.Sobol`.

    Source: Joe & Kuo 2008, SIAM J. Sci. Comput. 30, 2635, doi:10.1137/070709359; Matousek 1998,
    J. Complexity 14, 527, doi:10.1006/jcom.1998.0489.
    """

    def __init__(self, dimensions: int, rng: np.random.Generator):
        if dimensions > MOST_DIMENSIONS:
            raise ValueError(
                f"samples have {dimensions} random numbers each; Sobol's sequence has at most "
                f"{MOST_DIMENSIONS}: vary fewer quantities, or take coarser fields."
            )
        self.of_scipy: Any = None
        try:
            bits = _direction_bits(dimensions)
        except (OSError, KeyError):
            # Where SciPy has its table elsewhere its own sequence has the same points.
            from scipy.stats import qmc

            self.of_scipy = qmc.Sobol(dimensions, bits=BITS, rng=rng)
            return
        draw_digits = functools.partial(rng.spawn(1)[0].integers, 2, dtype=np.uint32)
        self.shift = draw_digits(size=(dimensions, BITS)) @ (1 << DIGITS[::-1])
        lower = np.tril(draw_digits(size=(dimensions, BITS, BITS)), -1) + np.eye(BITS, dtype=int)
        scrambled = bits @ lower.swapaxes(1, 2) & 1
        self.directions = scrambled @ (1 << DIGITS)

    def points(self, first: int, last: int) -> np.ndarray:
        """Points (last - first, dimensions) of the unit cube, from the first number up to the
        last. Raises `ValueError` beyond the last that the sequence has."""
        if last > 2**BITS:
            raise ValueError(
                f"a study asks for {last} samples of one sequence, which has 2^{BITS}: take fewer "
                "samples, or several studies with seeds of their own."
            )
        if self.of_scipy is not None:
            self.of_scipy.reset()
            if first:
                self.of_scipy.fast_forward(first)
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "The balance properties")
                return self.of_scipy.random(last - first)
        numbers = np.arange(first, last)
        gray_code = numbers ^ numbers >> 1
        points = np.tile(self.shift, (last - first, 1))
        for digit in range(int(last - 1).bit_length()):
            points ^= (gray_code >> digit & 1)[:, None] * self.directions[:, digit]
        return points * 2.0**-BITS


def scores_by_scrambling(sizes: np.ndarray, dimensions: int, seed: int) -> np.ndarray:
    """Standard normal numbers (samples, dimensions) in consecutive parts of one scrambled sequence.

    The whole is as even as one sequence, and each part is a sample by itself. Parts fill the gaps
    of each other, so their mean is nearer to the truth than their differences indicate: an error
    from these is too large rather than too small.

    Args:
        sizes: numbers of samples of the parts.
        dimensions: numbers of a sample.
        seed: of the scrambling.
    """
    return scrambled_normal(int(np.sum(sizes)), dimensions, np.random.default_rng((seed, 0)))


def seed_of(*numbers: int) -> int:
    """A seed of its own for each row of numbers, which a study of a number near one of them does
    not have."""
    return int(np.random.SeedSequence(numbers).generate_state(1)[0])


def normal_scores(shares: np.ndarray) -> np.ndarray:
    """Standard normal numbers of which these shares [1] lie below."""
    return scipy.special.ndtri(np.clip(shares, LEAST_SHARE, 1 - LEAST_SHARE))


def normal_density(scores: np.ndarray) -> np.ndarray:
    """Density of the standard normal distribution."""
    return np.exp(-0.5 * np.square(scores)) / np.sqrt(2 * np.pi)
