"""Where importance sampling samples: a mixture of normal distributions about the design points, and
one about the middle for what lies elsewhere."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from jaxclear.studies.reliability.design_point import DesignPoint

# Share of samples about the middle, at the least.
MIDDLE = 0.1
# Where failing is more frequent than this, sampling about the middle is as good as any.
FREQUENT = 0.1
# The rarest design point still gets this share of the likeliest one's samples.
LEAST = 0.05


class Proposal(NamedTuple):
    """A mixture of standard normal distributions about `centres` (parts, variables) with `shares`
    (parts,) [1]."""

    centres: np.ndarray
    shares: np.ndarray

    @classmethod
    def at(cls, points: Sequence[DesignPoint]) -> "Proposal":
        """About design points, each by how likely it is, and the middle."""
        likely = scipy.special.ndtr([-own.beta for own in points])
        about = np.maximum(likely, LEAST * likely.max())
        middle = MIDDLE if likely.max() < FREQUENT else 1.0 - MIDDLE
        shares = np.concatenate([[middle], (1 - middle) * about / about.sum()])
        return cls(np.stack([np.zeros(len(points[0].normal)), *(p.normal for p in points)]), shares)

    @property
    def dimensions(self) -> int:
        """Standard normal numbers that a sample takes: its own, and one that tells the part."""
        return self.centres.shape[1] + 1

    def drawn(self, normal: np.ndarray) -> np.ndarray:
        """Samples (samples, variables) of the mixture from standard normal numbers (samples,
        variables + 1)."""
        part = np.searchsorted(np.cumsum(self.shares), scipy.special.ndtr(normal[:, -1]))
        return normal[:, :-1] + self.centres[np.minimum(part, len(self.shares) - 1)]

    def weights(self, normal: np.ndarray) -> np.ndarray:
        """Density of the parts over that of the mixture at samples (samples, variables)."""
        logs = normal @ self.centres.T - 0.5 * np.sum(self.centres**2, axis=1)
        return np.exp(-scipy.special.logsumexp(logs + np.log(self.shares), axis=1))
