"""What the steps of a life are made of: rates, points, steps that were tried; sizes of errors by
surface."""

from typing import Any, NamedTuple

import numpy as np

# A surface that wears less than this share of the one that wears most is judged beside that.
NEGLIGIBLE = 0.01


class Rate(NamedTuple):
    """Depth [m] that a cycle wears in each cell, its standard error, the number of cycles that it
    took to know it, and what else these told."""

    wear: np.ndarray
    noise: np.ndarray
    cost: int
    told: Any = None


class Cells(NamedTuple):
    """How the cells of all surfaces stand in one row: those of each surface, and all their areas
    [m2]."""

    surfaces: tuple[slice, ...]
    areas: np.ndarray

    def sizes(self, depths: np.ndarray) -> np.ndarray:
        """Root mean square over the cells of each surface."""
        squares = self.areas * depths * depths
        return np.array(
            [np.sqrt(squares[own].sum() / self.areas[own].sum()) for own in self.surfaces]
        )

    def shares(self, errors: np.ndarray, of: np.ndarray) -> np.ndarray:
        """Sizes of errors as shares of those of something else, by surface."""
        whole = self.sizes(of)
        whole = np.maximum(whole, NEGLIGIBLE * whole.max(initial=0.0))
        return np.divide(self.sizes(errors), whole, out=np.zeros(len(whole)), where=whole > 0)

    def each(self, values: np.ndarray) -> np.ndarray:
        """For each cell the value of its surface."""
        return np.repeat(values, [own.stop - own.start for own in self.surfaces])


class Node(NamedTuple):
    """A point of a life: after so many `cycles` the `depth` [m] of each cell and the `rate`; since
    the start the `error` [m], by surface, and the variance [m2] that noise has left in each
    cell."""

    cycles: float
    depth: np.ndarray
    rate: Rate
    error: np.ndarray
    variance: np.ndarray


class Trial(NamedTuple):
    """A step that was tried, kept or taken back: the node `after` it; the estimate [m] of each
    cell; its `shares` of what each surface wears in the step, beyond what `noise` explains
    (shares too), and up to which share it is `smooth`."""

    after: Node
    estimate: np.ndarray
    shares: np.ndarray
    noise: np.ndarray
    smooth: float
