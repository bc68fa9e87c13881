"""Which cheaper models are worth their runs: a chain from the accurate problem down, chosen by a
pilot sample that serves nothing else.

The mean of the accurate problem is that of its difference from a share of the next cheaper model,
and of as much of that model's own mean, which many more runs tell. With variances V and costs C of
the links, the least cost to a variance goes as (sum sqrt(V C))^2; where plain sampling is not above
that, nothing is gained.

Source: Giles 2008, Oper. Res. 56, 607, doi:10.1287/opre.1070.0496; weights and choice of models:
Peherstorfer, Willcox & Gunzburger 2016, SIAM J. Sci. Comput. 38, A3163, doi:10.1137/15M1046472.
"""

from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np

from jaxclear.studies.sampling import by_scrambling

# A gain that the pilot sample puts below this may be chance, and does not pay the pilot.
LEAST_GAIN = 1.2


class Chain(NamedTuple):
    """Models by place, the accurate one first, each cheaper than the one before; `weights` (links,
    moments) [1], how much of the next model each takes; `gain` [1], how many times less work than
    plain sampling the pilot sample says; `need` (links,), variance by link for one run."""

    models: tuple[int, ...]
    weights: np.ndarray
    gain: float
    need: np.ndarray

    def carried(self) -> np.ndarray:
        """How much of each link's mean is in the answer, (links + 1, moments) [1]."""
        first = np.ones((1, self.weights.shape[1]))
        return np.concatenate([first, np.cumprod(self.weights, axis=0)])

    def costs(self, each: np.ndarray) -> np.ndarray:
        """What a sample of each link costs, where a run of a model costs `each` (models,)."""
        own = each[list(self.models)]
        return own + np.append(own[1:], 0.0)


def scatter(numbers: np.ndarray, parts: int) -> np.ndarray:
    """Variance of the mean of `numbers` (samples, moments), by its scramblings, which take turns,
    for one sample: n times that of n."""
    means = by_scrambling(numbers, parts).mean(axis=1)
    return means.var(axis=0, ddof=1) * (len(numbers) // parts)


def regressed(upper: np.ndarray, lower: np.ndarray) -> np.ndarray:
    """Weights (moments,) of the lower model's moments in those of the upper (samples, moments)."""
    one, other = upper - upper.mean(axis=0), lower - lower.mean(axis=0)
    spread = np.sum(other**2, axis=0)
    return np.where(spread > 0, np.sum(one * other, axis=0) / np.where(spread > 0, spread, 1.0), 0)


def chosen(moments: list[np.ndarray], costs: np.ndarray, wanted: np.ndarray, parts: int) -> Chain:
    """The chain of the least work for means as certain as `wanted` (responses,), from the moments
    (samples, moments) of each model in the pilot sample and the cost of a run of each."""
    alone = _chain((0,), moments, costs, wanted, parts)
    cheap = sorted(range(1, len(moments)), key=lambda m: -costs[m])
    best = alone
    for count in range(1, len(cheap) + 1):
        for some in combinations(cheap, count):
            found = _chain((0, *some), moments, costs, wanted, parts)
            best = max(best, found, key=lambda chain: chain.gain)
    return best if best.gain >= LEAST_GAIN else alone


def _chain(models, moments, costs, wanted, parts) -> Chain:
    weights = np.array([regressed(moments[a], moments[b]) for a, b in pairwise(models)]).reshape(
        len(models) - 1, moments[0].shape[1]
    )
    plain = scatter(moments[0], parts) * costs[0]
    found = Chain(models, weights, 1.0, np.zeros(len(models)))
    work, _ = _work(found, moments, costs, parts)
    # What a chain does not serve is left to the runs of the accurate problem themselves.
    found = found._replace(weights=np.where(work < plain, weights, 0.0))
    work, need = _work(found, moments, costs, parts)
    count = len(wanted)
    hard = lambda own: np.max(own[:count] / wanted**2)
    most = int(np.argmax(work[:count] / wanted**2))
    gain = hard(plain) / hard(work) if hard(work) > 0 else 1.0
    return found._replace(gain=float(gain), need=need[:, most])


def _work(chain: Chain, moments, costs, parts) -> tuple[np.ndarray, np.ndarray]:
    """Work for a variance of 1 (moments,), and variances by link (links, moments)."""
    need = []
    for i, model in enumerate(chain.models):
        link = moments[model]
        if i < len(chain.weights):
            link = link - chain.weights[i] * moments[chain.models[i + 1]]
        need.append(scatter(link, parts) * chain.carried()[i] ** 2)
    rows = np.array(need)
    return np.sum(np.sqrt(rows * chain.costs(costs)[:, None]), axis=0) ** 2, rows
