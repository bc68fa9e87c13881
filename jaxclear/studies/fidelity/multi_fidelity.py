"""Means of an accurate problem by few of its runs and many of cheaper ones:
`jaxclear.multi_fidelity`.

A cheaper model need not be right, only move as the accurate one does: rigid joints for compliant
ones, longer steps, a plane for space, positions for a motion. What it gets wrong is in the runs of
both, so that the answer is the accurate problem's whatever the cheaper one says.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_flags, check_number
from jaxclear.studies.fidelity.levels import FIRST, Chain, Links, chosen
from jaxclear.studies.fidelity.model import Model, model_responses, models_of
from jaxclear.studies.fidelity.result import MultiFidelity, rate
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_warnings import any_warning
from jaxclear.studies.sampling import check_sampled, draw
from jaxclear.studies.scrambling import seed_of
from jaxclear.studies.statistics.scrambled import Statistic, deviation_of_moments, student
from jaxclear.studies.store.store import stored

# Independent scramblings, whose differences tell the errors.
SCRAMBLINGS = 16
# The pilot sample is this share of the work allowed, at the least so many points of a scrambling.
PILOT_SHARE, PILOT_POINTS = 1 / 16, 4
# What draws the pilot sample, which nothing else shares.
PILOT_SEED = 811
# Costs are measured to a power of this, so that another measurement says the same mostly.
ROUNDED = 2**0.5


class Question(NamedTuple):
    """What is asked of which problem, and how it is sampled; `middle` (responses,) is about where
    the means lie."""

    problem: Problem
    names: tuple[str, ...]
    middle: np.ndarray
    seed: int
    sampling: str
    parts: int
    progress_bar: bool

    def doubt(self, result: Any, runs: int) -> np.ndarray:
        """Which runs carry a warning, (runs,)."""
        return any_warning(result.checks, runs)


@answering
@stored("a study of several models")
def multi_fidelity(
    problem: Problem,
    cheaper: Problem | Mapping[str, Problem],
    samples: int = 1024,
    *,
    costs: Mapping[str, float] | None = None,
    seed: int = 0,
    sampling: str = "sobol",
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> MultiFidelity:
    """Means and standard deviations of a problem, from its own runs and many of cheaper problems.

    A pilot sample decides which cheaper problems are used and how many runs of each. The estimates
    are unbiased, whatever the cheaper problems give. Where none reduces the work, the problem is
    sampled alone, and `sentence()` of the result says so.

    Args:
        problem: the problem.
        cheaper: a problem with the same variables and responses (or some of them), such as
            `problem.with_integrator(...)`, or a dictionary of several by name.
        samples: work allowed, as a number of runs of the problem, the pilot sample included; 1024
            by default.
        costs: work of a run of each cheaper problem, as a factor of that of the problem [1], by
            name ("cheaper" for a single one); None (default) for the ratio of CPU times in the
            pilot sample without compilation, rounded to half a power of two.
        seed: seed of the random numbers; 0 by default.
        sampling: name of the method, "sobol" (default) or "random".
        store: folder that keeps the runs; None (default) for none.
        progress_bar: whether to show the progress; False by default.

    Returns:
        The `MultiFidelity`.

    Raises:
        ValueError: if an argument is wrong.
    """
    check_sampled(problem, samples, seed, sampling)
    check_flags("multi_fidelity", progress_bar=progress_bar)
    least = SCRAMBLINGS * (PILOT_POINTS + FIRST)
    check_count("samples of multi_fidelity", samples, at_least=2 * least)
    models = models_of(problem, cheaper, samples)
    fixed_costs = _check_costs(costs, models)
    points = 2 ** int(np.log2(max(samples * PILOT_SHARE / SCRAMBLINGS, PILOT_POINTS)))
    question = Question(
        problem, problem.response_names, np.zeros(0), seed, sampling, SCRAMBLINGS, progress_bar
    )
    pilot = _Pilot(question, models, points, fixed_costs)
    question = question._replace(middle=pilot.middle)
    # By this responses are weighed against each other; one that is 0 has no error to lessen.
    varies = pilot.size > 0
    errors = np.where(varies, pilot.size, 1.0)
    chain = chosen(pilot.moments(), pilot.costs, errors, SCRAMBLINGS)
    links = Links(question, models, chain, pilot.costs)
    links.begin(samples - pilot.work)
    count = len(question.names)
    times = student(SCRAMBLINGS) / np.sqrt(SCRAMBLINGS)
    half = lambda parts: times * parts[:, :count].std(axis=0, ddof=1)
    while not np.all(half(links.parts())[varies] <= 0.0):
        hardest = lambda parts: int(np.argmax(half(parts) / errors))
        if not links.grow(samples - pilot.work, hardest):
            break
    return _result(question, models, chain, links, pilot)


def _check_costs(costs: Mapping[str, float] | None, models: list[Model]) -> dict[str, float]:
    names = [model.name for model in models[1:]]
    for name, cost in (costs or {}).items():
        if name not in names:
            raise ValueError(f'costs names "{name}", which is not in cheaper: {", ".join(names)}.')
        check_number(f'cost of "{name}"', cost, above=0)
    return {name: float(cost) for name, cost in (costs or {}).items()}


class _Pilot:
    """Runs of all models at the same values, which choose and serve nothing else."""

    def __init__(self, question: Question, models: list[Model], points: int, fixed_costs: dict):
        self.question, self.models = question, models
        seed = seed_of(question.seed, PILOT_SEED)
        count = points * question.parts
        values = draw(question.problem, count, seed, question.sampling, question.parts)
        names = question.names
        plain = all(model.name in fixed_costs for model in models[1:])
        bar = question.progress_bar
        run = lambda m: (m.runs(values, bar), 1.0) if plain else m.timed(values, bar)
        results = {model.name: run(model) for model in models}
        self.outcomes = [model_responses(model, names, results[model.name][0]) for model in models]
        first = results[models[0].name][1]
        spent = {name: seconds / first for name, (_, seconds) in results.items()}
        measured = {n: ROUNDED ** np.round(np.log(x) / np.log(ROUNDED)) for n, x in spent.items()}
        self.costs = np.array([1.0, *((measured | fixed_costs)[m.name] for m in models[1:])])
        self.work = count * float(self.costs.sum())
        responses = self.outcomes[0].responses
        if not np.any(self.outcomes[0].good):
            raise ValueError(
                f"all {count} runs of the pilot sample failed; look at one with "
                "jaxclear.monte_carlo(problem, ...).failures()."
            )
        self.middle = np.nanmean(responses, axis=0)
        self.size = np.sqrt(np.nanmean(responses**2, axis=0))

    def failed(self) -> dict[str, float]:
        """Share [1] of the runs of each cheaper model that failed."""
        shares = [float((~runs.good).mean()) for runs in self.outcomes[1:]]
        return {m.name: share for m, share in zip(self.models[1:], shares, strict=True)}

    def moments(self) -> list[np.ndarray]:
        """Of each model, (samples, 2 responses)."""
        return [runs.moments(self.middle) for runs in self.outcomes]

    def correlations(self) -> dict[tuple[str, str], float]:
        """Of each cheaper model's responses with the problem's."""
        values = {}
        first = self.outcomes[0].responses
        for model, runs in zip(self.models[1:], self.outcomes[1:], strict=True):
            for i, name in enumerate(self.question.names):
                if name in model.problem.response_names:
                    both = np.isfinite(first[:, i]) & np.isfinite(runs.responses[:, i])
                    pair = first[both, i], runs.responses[both, i]
                    flat = both.sum() < 2 or min(np.std(pair[0]), np.std(pair[1])) == 0
                    values[model.name, name] = 0.0 if flat else float(np.corrcoef(*pair)[0, 1])
        return values


def _result(question, models, chain: Chain, links: Links, pilot: _Pilot) -> MultiFidelity:
    parts, names = links.parts(), question.names
    count, blocks = len(names), question.parts
    plain = links.plain()
    means, spreads, gains = {}, {}, {}
    for i, name in enumerate(names):
        half = student(blocks) * parts[:, i].std(ddof=1) / np.sqrt(blocks)
        value = float(question.middle[i] + parts[:, i].mean())
        means[name] = Statistic(value, float(value - half), float(value + half))
        spread, wide = deviation_of_moments(parts[:, i], parts[:, count + i])
        spreads[name] = Statistic(spread, max(spread - wide, 0.0), spread + wide)
        gains[name] = _gain_of_chain(plain[:, :, i], parts[:, i], links)
    return MultiFidelity(
        problem=question.problem,
        means=means,
        standard_deviations=spreads,
        correlations=pilot.correlations(),
        gains=gains,
        used=tuple(models[i].name for i in chain.models),
        runs=_runs_by_model(links),
        costs={m.name: float(c) for m, c in zip(models[1:], pilot.costs[1:], strict=True)},
        work=float(links.work),
        pilot=float(pilot.work),
        pilot_failed=pilot.failed(),
        failed=int((~links.links[0].good).sum()),
        warned=int(np.sum(links.links[0].warned & links.links[0].good)),
        scramblings=blocks,
    )


def _runs_by_model(links: Links) -> tuple[int, ...]:
    """Runs of each model of the chain, those beside a better one counted in."""
    counts = [links.question.parts * link.points for link in links.links]
    return tuple(n + (counts[i - 1] if i else 0) for i, n in enumerate(counts))


def _gain_of_chain(sizes: np.ndarray, parts: np.ndarray, links: Links) -> float:
    """Work of plain sampling to the same variance, over the work that was."""
    if len(links.links) == 1 or parts.var(ddof=1) == 0:
        return 1.0
    fall = 1.0 if links.question.sampling == "random" else rate(sizes)
    more = (sizes[0].var(ddof=1) / parts.var(ddof=1)) ** (1 / fall)
    first = links.question.parts * links.links[0].points
    return float(first * more / links.work)
