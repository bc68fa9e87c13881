"""Importance sampling at the design points, in independent scramblings until it is accurate enough.

Where a surface is trusted it takes up what it explains: its own probability by the same sampling,
from as many points as wanted, and runs only for where it is wrong.

Source: Melchers 1989, Struct. Saf. 6, 3, doi:10.1016/0167-4730(89)90003-9.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from jaxclear.studies.limit_state import system_margin
from jaxclear.studies.reliability.models import Probability, RunModel, SurfaceModel, refused
from jaxclear.studies.surface.control_variate import Mean, normal_blocks

# Runs of one scrambling, scramblings before the first look, and added between looks.
BLOCK, FIRST, MORE = 32, 8, 4
# The surface's own probability: so many scramblings of so many points.
SURFACE_BLOCKS, SURFACE_POINTS = 16, 4096
# Runs after which it is told how many it takes, and given up where they are too many.
LOOK = 1024
# Share of samples about the middle, at the least.
MIDDLE = 0.1
# Where failing is more frequent than this, sampling about the middle is as good as any.
FREQUENT = 0.1
# The rarest design point still gets this share of the likeliest one's samples.
LEAST = 0.05


class Proposal(NamedTuple):
    """A mixture of normal distributions about `centres` (parts, variables) with `shares` (parts,)
    [1] and deviations `widths` (parts,) [1]; all but the first, about the middle, have their
    distances `betas`."""

    centres: np.ndarray
    shares: np.ndarray
    widths: np.ndarray
    betas: Sequence[float]

    @classmethod
    def at(cls, centres: Sequence[np.ndarray], betas: Sequence[float]) -> "Proposal":
        """About centres of what fails, each by how likely it is, and about the middle: there as
        wide as the nearest centre is away, so that no direction has next to no samples."""
        likely = scipy.special.ndtr(-np.asarray(betas))
        about = np.maximum(likely, LEAST * likely.max())
        rare = likely.max() < FREQUENT
        middle = MIDDLE if rare else 1.0 - MIDDLE
        shares = np.concatenate([[middle], (1 - middle) * about / about.sum()])
        wide = max(min(betas) / np.sqrt(len(centres[0])), 1.0) if rare else 1.0
        widths = np.concatenate([[wide], np.ones(len(centres))])
        return cls(np.stack([np.zeros(len(centres[0])), *centres]), shares, widths, betas)

    @property
    def dimensions(self) -> int:
        """Standard normal numbers that a sample takes: its own, and one that tells the part."""
        return self.centres.shape[1] + 1

    def drawn(self, normal: np.ndarray) -> np.ndarray:
        """Samples (samples, variables) of the mixture from standard normal numbers (samples,
        variables + 1)."""
        part = np.searchsorted(np.cumsum(self.shares), scipy.special.ndtr(normal[:, -1]))
        part = np.minimum(part, len(self.shares) - 1)
        return normal[:, :-1] * self.widths[part, None] + self.centres[part]

    def weights(self, normal: np.ndarray) -> np.ndarray:
        """Density of the parts over that of the mixture at samples (samples, variables)."""
        away = np.sum((normal[:, None] - self.centres) ** 2, axis=2) / self.widths**2
        logs = 0.5 * (np.sum(normal**2, axis=1)[:, None] - away)
        logs -= normal.shape[1] * np.log(self.widths)
        return np.exp(-scipy.special.logsumexp(logs + np.log(self.shares), axis=1))


def importance(
    model: RunModel,
    surface: SurfaceModel | None,
    proposal: Proposal,
    variation: float,
    most_runs: int,
    seed: int,
) -> Probability:
    """Probability of failing by importance sampling at design points.

    Args:
        model: margins by runs.
        surface: control variate; None: without.
        proposal: mixture of densities at the design points.
        variation: required coefficient of variation [1].
        most_runs: largest number of runs.
        seed: of the samples.
    """
    cuts = model.limit.cut_sets()
    before, failed = model.runs, model.failed
    exact = _surface_probability(surface, proposal, cuts, seed) if surface is not None else None
    means, within, counts, unknown = np.zeros(0), np.zeros(0), 0, 0.0
    while True:
        new = FIRST if not len(means) else MORE
        drawn = normal_blocks(new, BLOCK, proposal.dimensions, (seed, 3), first=len(means))
        normal = proposal.drawn(drawn)
        margins, weights = model.margins(normal), proposal.weights(normal)
        is_missing = np.isnan(margins).any(axis=1)
        fails = is_missing | (system_margin(np.where(is_missing[:, None], -1.0, margins), cuts) < 0)
        counts, unknown = counts + int(fails.sum()), unknown + float(np.sum(weights * is_missing))
        weighted = weights * fails
        if surface is not None:
            weighted = weighted - weights * (system_margin(surface.margins(normal), cuts) < 0)
        blocks = weighted.reshape(new, BLOCK)
        means = np.concatenate([means, blocks.mean(axis=1)])
        within = np.concatenate([within, blocks.var(axis=1, ddof=1) / BLOCK])
        result = _answer(means, within, exact, counts)
        runs = model.runs - before
        if result.variation <= variation:
            break
        # A coefficient of variation falls with the root of the runs.
        needed = runs * (result.variation / variation) ** 2 if counts else np.inf
        if runs + MORE * BLOCK > most_runs or (runs >= LOOK and needed > 2 * most_runs):
            break
    share = unknown / (runs * result.value) if result.value > 0 else 0.0
    if counts == 0 or not result.value > 0:
        why = f"none of {runs} samples about the design points fails"
        return refused(f"{why}.", runs, model.failed - failed)
    return result._replace(runs=runs, failed=model.failed - failed, unknown=share)


def _answer(means: np.ndarray, within: np.ndarray, exact: Mean | None, counts: int) -> Probability:
    """The answer so far: the mean of the blocks and its variation, by their spread or, where that
    is larger, by the spread within them (variances of means, (blocks,)): few blocks are like each
    other by chance, and sampling until they are would be biased. As if one failing sample more had
    differed: that a surface is right at all samples does not make it right."""
    value = means.mean() + (exact.value if exact else 0.0)
    if not value > 0 or not counts:
        return Probability(max(float(value), 0.0), np.inf, blocks=len(means))
    variance = max(means.var(ddof=1), within.mean()) / len(means)
    variance += exact.variance + (value / counts) ** 2 if exact else 0.0
    return Probability(float(value), float(np.sqrt(variance) / value), blocks=len(means))


def _surface_probability(surface: SurfaceModel, proposal: Proposal, cuts, seed: int) -> Mean:
    drawn = normal_blocks(SURFACE_BLOCKS, SURFACE_POINTS, proposal.dimensions, (seed, 4))
    normal = proposal.drawn(drawn)
    fails = system_margin(surface.margins(normal), cuts) < 0
    return Mean.of(proposal.weights(normal) * fails, SURFACE_BLOCKS)
