"""Levels of models: which cheaper ones are worth their runs, and samples of them, doubled where a
run tells most for its cost.

The mean of the accurate problem is that of its difference from a share of the next cheaper model,
and of as much of that model's own mean, which many more runs tell. A pilot sample that serves
nothing else chooses: with variances V and costs C of the links, the least cost to a variance goes
as (sum sqrt(V C))^2; where plain sampling is not above that, nothing is gained. Every link has
independent scramblings of its own, so that the variances of links add up.

Source: Giles 2008, Oper. Res. 56, 607, doi:10.1287/opre.1070.0496; weights and choice of models:
Peherstorfer, Willcox & Gunzburger 2016, SIAM J. Sci. Comput. 38, A3163, doi:10.1137/15M1046472;
doubling: Giles & Waterhouse 2009, Advanced Financial Modelling, de Gruyter, 165,
doi:10.1515/9783110213140.165.
"""

from collections.abc import Callable
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np

from jaxclear.studies.fidelity.model import Model, model_responses
from jaxclear.studies.sampling import by_scrambling, draw
from jaxclear.studies.scrambling import seed_of
from jaxclear.studies.surface.control_variate import regressed

# A gain that the pilot sample puts below this may be chance, and does not pay the pilot.
LEAST_GAIN = 1.2
# Points of a scrambling that a link begins with, a power of two, and the most to begin with.
FIRST, MOST_FIRST = 4, 256


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
        model_costs = each[list(self.models)]
        return model_costs + np.append(model_costs[1:], 0.0)


def scatter(numbers: np.ndarray, parts: int) -> np.ndarray:
    """Variance of the mean of `numbers` (samples, moments), by its scramblings, which take turns,
    for one sample: n times that of n."""
    means = by_scrambling(numbers, parts).mean(axis=1)
    return means.var(axis=0, ddof=1) * (len(numbers) // parts)


def chosen(moments: list[np.ndarray], costs: np.ndarray, target: np.ndarray, parts: int) -> Chain:
    """The chain of models of least work for means of a given accuracy.

    Args:
        moments: of each model in the pilot sample, shape (samples, moments), the accurate one
            first.
        costs: of a run of each model.
        target: accuracy of each mean, shape (responses,).
        parts: number of scramblings.
    """
    alone = _one_chain((0,), moments, costs, target, parts)
    cheap = sorted(range(1, len(moments)), key=lambda m: -costs[m])
    best = alone
    for count in range(1, len(cheap) + 1):
        for some in combinations(cheap, count):
            chain = _one_chain((0, *some), moments, costs, target, parts)
            best = max(best, chain, key=lambda chain: chain.gain)
    return best if best.gain >= LEAST_GAIN else alone


def _one_chain(models, moments, costs, target, parts) -> Chain:
    weights = np.array([regressed(moments[a], moments[b]) for a, b in pairwise(models)]).reshape(
        len(models) - 1, moments[0].shape[1]
    )
    plain = scatter(moments[0], parts) * costs[0]
    chain = Chain(models, weights, 1.0, np.zeros(len(models)))
    work, _ = _chain_work(chain, moments, costs, parts)
    # What a chain does not serve is left to the runs of the accurate problem themselves.
    chain = chain._replace(weights=np.where(work < plain, weights, 0.0))
    work, need = _chain_work(chain, moments, costs, parts)
    count = len(target)
    hard = lambda variances: np.max(variances[:count] / target**2)
    most = int(np.argmax(work[:count] / target**2))
    gain = hard(plain) / hard(work) if hard(work) > 0 else 1.0
    return chain._replace(gain=float(gain), need=need[:, most])


def _chain_work(chain: Chain, moments, costs, parts) -> tuple[np.ndarray, np.ndarray]:
    """Work for a variance of 1 (moments,), and variances by link (links, moments)."""
    need = []
    for i, model in enumerate(chain.models):
        link = moments[model]
        if i < len(chain.weights):
            link = link - chain.weights[i] * moments[chain.models[i + 1]]
        need.append(scatter(link, parts) * chain.carried()[i] ** 2)
    rows = np.array(need)
    return np.sum(np.sqrt(rows * chain.costs(costs)[:, None]), axis=0) ** 2, rows


class Link:
    """Samples of one link: moments by scrambling (scramblings, points, moments), and of the first
    link how many runs there were and which were good."""

    def __init__(self, models: list[Model], weights: np.ndarray | None, cost: float):
        self.models, self.weights, self.cost = models, weights, cost
        self.residuals = self.moments = np.zeros((0, 0, 0))
        self.good = self.warned = np.zeros(0, bool)

    def add(self, values: np.ndarray, parts: int, question, progress_bar: bool) -> None:
        """Runs further samples of this level and adds them.

        Args:
            values: of the variables, shape (samples, variables); scramblings take turns.
            parts: number of scramblings.
            question: names of responses, and how warnings are read.
            progress_bar: whether one is shown.
        """
        upper = self.models[0].runs(values, progress_bar)
        upper_runs = model_responses(self.models[0], question.names, upper)
        moments = upper_runs.moments(question.middle)
        correction = moments
        if self.weights is not None:
            lower = model_responses(self.models[1], question.names, self.models[1].runs(values))
            correction = moments - self.weights * lower.moments(question.middle)
        empty = (parts, -1, moments.shape[1])
        cut = lambda array: by_scrambling(array, parts)
        self.residuals = np.concatenate([self.residuals.reshape(empty), cut(correction)], axis=1)
        self.moments = np.concatenate([self.moments.reshape(empty), cut(moments)], axis=1)
        self.good = np.concatenate([self.good, upper_runs.good])
        self.warned = np.concatenate([self.warned, question.doubt(upper, len(values))])

    @property
    def points(self) -> int:
        """Points of each scrambling."""
        return self.residuals.shape[1]

    def means(self) -> np.ndarray:
        """By scrambling, (scramblings, moments)."""
        return self.residuals.mean(axis=1)


class Links:
    """All links of a chain. `most` is the work that they may take, in runs of the problem."""

    def __init__(self, question, models: list[Model], chain: Chain, costs: np.ndarray):
        selected = [models[i] for i in chain.models]
        each = chain.costs(costs)
        self.question, self.chain = question, chain
        self.links = [
            Link(selected[i : i + 2], chain.weights[i] if i < len(chain.weights) else None, each[i])
            for i in range(len(selected))
        ]
        self.carried = chain.carried()

    @property
    def work(self) -> float:
        """What the links took, in runs of the problem."""
        parts = self.question.parts
        return sum(parts * link.points * link.cost for link in self.links)

    def begin(self, most: float) -> None:
        """The first points of each link, in the proportion that the pilot sample asks for; fewer of
        what takes most where that is more work than `most`."""
        need, each = self.chain.need, [link.cost for link in self.links]
        times = np.sqrt(np.maximum(need / each, 0.0) / max(need[0] / each[0], 1e-300))
        ratio = np.clip(times, 1.0, MOST_FIRST / FIRST)
        wish = [FIRST, *(FIRST * 2 ** int(np.log2(multiple)) for multiple in ratio[1:])]
        taken = lambda i: self.question.parts * wish[i] * each[i]
        while sum(map(taken, range(len(wish)))) > most and max(wish) > FIRST:
            wish[max((i for i, count in enumerate(wish) if count > FIRST), key=taken)] //= 2
        for i, link in enumerate(self.links):
            self._grow_link(i, link, wish[i])

    def grow(self, most: float, hardest: Callable[[np.ndarray], int]) -> bool:
        """Doubles the link that tells most of the hardest mean for its cost, of those for which
        there is work left; whether there was one."""
        parts = self.question.parts
        budget = most - self.work
        able = [i for i, link in enumerate(self.links) if parts * link.points * link.cost <= budget]
        if not able:
            return False
        which = hardest(self.parts())
        var_of = lambda i: self.carried[i, which] ** 2 * self.links[i].means()[:, which].var(ddof=1)
        worth = {i: var_of(i) / (self.links[i].points * self.links[i].cost) for i in able}
        best = max(able, key=lambda i: worth[i])
        self._grow_link(best, self.links[best], self.links[best].points)
        return True

    def _grow_link(self, place: int, link: Link, more: int) -> None:
        question = self.question
        seed = seed_of(question.seed, place)
        span = link.points * question.parts, (link.points + more) * question.parts
        values = draw(question.problem, span[1], seed, question.sampling, question.parts, span)
        link.add(values, question.parts, question, question.progress_bar)

    def parts(self) -> np.ndarray:
        """Contributions of the scramblings to each moment of the runs that did not fail,
        (scramblings, moments)."""
        estimates = sum(
            weight * link.means() for weight, link in zip(self.carried, self.links, strict=True)
        )
        return estimates / max(self.links[0].good.mean(), 1e-300)

    def plain(self) -> np.ndarray:
        """The same of the runs of the problem alone, by half, a quarter and an eighth of the points
        too: (sizes, scramblings, moments), the largest first."""
        moments = self.links[0].moments
        sizes: list[np.ndarray] = []
        count = moments.shape[1]
        while count >= 1 and len(sizes) < 4:
            sizes.append(moments[:, :count].mean(axis=1))
            count //= 2
        return np.array(sizes)
