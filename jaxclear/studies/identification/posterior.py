"""A posterior from weighted draws: adaptive importance sampling over the unknowns' standard normal
numbers, and the intervals that the draws give.

Draws of every round count together, each by the target over the mixture of all that was drawn from
(the deterministic mixture), so that a round that missed a part of the posterior does no harm.

Source: Cornuet, Marin, Mira & Robert 2012, Scand. J. Stat. 39, 798,
doi:10.1111/j.1467-9469.2011.00756.x.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy

# Tails of the proposals: heavier than those of any posterior over normal scores.
FREEDOM = 4
# Share of every round that is drawn from the prior: nothing that it allows is left out for good.
FROM_PRIOR = 0.2
# Proposals begin twice as wide as what is near an optimum: a ridge that bends is longer.
WIDER = 4.0
# Draws whose weights are worth this many equal ones make an interval of 95 %; fewer than the least
# none.
ENOUGH, LEAST = 400.0, 60.0
LEAST_ROUNDS, MOST_ROUNDS = 3, 8
# An end of the prior whose density is above this share of the largest is not excluded: twice the
# logarithm of their ratio is what chi-square with one degree of freedom exceeds in 5 %.
AT_END = math.exp(-0.5 * 1.959964**2)
# Parts of an interval in which densities are compared.
PARTS = 10


class Proposal(NamedTuple):
    """What draws come from: places (parts, variables) [1] of Student's distributions, roots of
    their matrices (parts, variables, variables), and how likely each is [1]; the rest of the draws
    come from the prior."""

    centres: np.ndarray
    matrices: np.ndarray
    shares: np.ndarray

    def density(self, normal: np.ndarray) -> np.ndarray:
        """Logarithm of the density (draws,)."""
        count = normal.shape[1]
        prior = -0.5 * np.sum(normal**2, axis=1) - 0.5 * count * np.log(2 * np.pi)
        densities = [
            np.log((1 - FROM_PRIOR) * share)
            + scipy.stats.multivariate_t.logpdf(normal, centre, matrix, FREEDOM).reshape(-1)
            for centre, matrix, share in zip(*self, strict=True)
        ]
        return scipy.special.logsumexp([np.log(FROM_PRIOR) + prior, *densities], axis=0)

    def draw(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Draws (count, variables)."""
        variables = self.centres.shape[1]
        weights = np.concatenate([[FROM_PRIOR], (1 - FROM_PRIOR) * self.shares])
        sizes = rng.multinomial(count, weights / weights.sum())
        points = [rng.standard_normal((sizes[0], variables))]
        for size, centre, matrix in zip(sizes[1:], self.centres, self.matrices, strict=True):
            root = np.linalg.cholesky(matrix)
            scale = np.sqrt(FREEDOM / rng.chisquare(FREEDOM, (size, 1)))
            points.append(centre + scale * rng.standard_normal((size, variables)) @ root.T)
        return np.concatenate(points)


class Draws(NamedTuple):
    """Draws of the unknowns' normal numbers (draws, variables) [1], their weights [1], which sum to
    1, those with which they follow the prior, and what the target told beside its density, a row a
    draw."""

    normal: np.ndarray
    weights: np.ndarray
    prior_weights: np.ndarray
    extras: Any

    @property
    def effective(self) -> float:
        """How many draws of equal weight they are worth."""
        return float(1.0 / np.sum(self.weights**2))


def importance_sampled(
    target: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    centres: Sequence[np.ndarray],
    matrices: Sequence[np.ndarray],
    draws: int,
    seed: int,
) -> Draws:
    """Draws from a density over normal numbers, begun about some `centres` (variables,) with
    `matrices` (variables, variables) of what is near them. `target`: the logarithm of the density
    (draws,), -inf where nothing is, and what is told beside it (draws, any); `draws` a round, of as
    many rounds as make their weights enough."""
    rng, count = np.random.default_rng(seed), len(centres)
    proposal = Proposal(np.array(centres), WIDER * np.array(matrices), np.full(count, 1 / count))
    used: list[Proposal] = []
    normal = np.zeros((0, len(centres[0])))
    density, extras = np.zeros(0), []
    for number in range(MOST_ROUNDS):
        points = proposal.draw(draws, rng)
        point_density, more = target(points)
        used.append(proposal)
        normal, density = np.concatenate([normal, points]), np.concatenate([density, point_density])
        extras.append(more)
        mixed = scipy.special.logsumexp([p.density(normal) for p in used], axis=0)
        prior = -0.5 * np.sum(normal**2, axis=1)
        weights = _normalised(density - mixed), _normalised(prior - mixed)
        result = Draws(normal, *weights, np.concatenate(extras))
        # What the first round draws from knows only what is near the optima.
        if number + 1 >= LEAST_ROUNDS and result.effective >= ENOUGH:
            break
        proposal = _adapted(result)
    return result


def _normalised(logarithms: np.ndarray) -> np.ndarray:
    largest = logarithms.max()
    if not np.isfinite(largest):
        return np.full(len(logarithms), 1 / len(logarithms))
    weights = np.exp(logarithms - largest)
    return weights / weights.sum()


def _adapted(draws: Draws) -> Proposal:
    """Places and matrices that fit the draws: one for all, and one about the likeliest."""
    mean = draws.weights @ draws.normal
    deviations = draws.normal - mean
    matrix = deviations.T @ (draws.weights[:, None] * deviations) + 1e-8 * np.eye(len(mean))
    best = draws.normal[np.argmax(draws.weights)]
    return Proposal(np.array([mean, best]), np.array([matrix, matrix / 4]), np.array([0.7, 0.3]))


def weighted_quantile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    """The value below which a share [1] of the weight lies."""
    order = np.argsort(values)
    middle = np.cumsum(weights[order]) - 0.5 * weights[order]
    return float(np.interp(share, middle, values[order]))


def equally_weighted(weights: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Places (count,) of draws that follow the weights, each as often as it has weight."""
    steps = (rng.random() + np.arange(count)) / count
    indices = np.searchsorted(np.cumsum(weights), steps)
    return rng.permutation(np.minimum(indices, len(weights) - 1))


def shortest_interval(
    shares: np.ndarray, weights: np.ndarray, content: float = 0.95
) -> tuple[float, float]:
    """The shortest interval of the prior's shares (draws,) [1] that holds `content` [1] of the
    weight: where little speaks against an end of the prior, it reaches that end."""
    order = np.argsort(shares)
    ordered, reached = shares[order], np.cumsum(weights[order])
    before = reached - weights[order]
    last = np.searchsorted(reached, before + content - 1e-12)
    first = np.flatnonzero(last < len(ordered))
    length = ordered[last[first]] - ordered[first]
    start = first[np.argmin(length)]
    end = last[start]
    low, high = float(ordered[start]), float(ordered[end])
    edges = np.linspace(low, high, PARTS + 1)
    step = edges[1] - edges[0]
    most = np.histogram(ordered, edges, weights=weights[order])[0].max()
    at_end = weights[order][ordered <= step].sum(), weights[order][ordered >= 1.0 - step].sum()
    low, high = (
        limit if share_at_end >= AT_END * most else end
        for limit, share_at_end, end in zip((0.0, 1.0), at_end, (low, high), strict=True)
    )
    return low, high
