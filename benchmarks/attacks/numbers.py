"""Numbers drawn at random, each draw repeatable by its seed.

A mechanism is written once, as a function of a `Draw`. Its first draw takes the middle of every
range, where a user would begin; later ones any place, so that only numbers differ and nothing
compiles anew.
"""

import math

import numpy as np


class Draw:
    """Source of numbers: the middle of a range where `plain`, any place in it otherwise."""

    def __init__(self, *seed: int, plain: bool = False):
        self.plain = plain
        self.generator = np.random.default_rng(seed)

    def log(self, low: float, high: float, usual: float | None = None) -> float:
        """Even on a logarithmic scale."""
        share = self._share()
        if self.plain and usual is not None:
            return usual
        return math.exp(math.log(low) + share * math.log(high / low))

    def flat(self, low: float, high: float, usual: float | None = None) -> float:
        """Even on a linear scale."""
        share = self._share()
        return usual if self.plain and usual is not None else low + share * (high - low)

    def sign(self) -> float:
        """1 or -1."""
        return 1.0 if self._share() < 0.75 else -1.0

    def _share(self) -> float:
        share = float(self.generator.random())
        return 0.5 if self.plain else share
