"""The figure of what a record tells: its statistics within those of prior and posterior, what each
unknown may be beside its prior, which of them hang together, and how the sample's own runs, left
out, were told. And the figure of what records at several times tell of the life that is left.
"""

import itertools
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import expect
from jaxclear.plot.canvas import Roomy, as_warnings, key, panels, readable
from jaxclear.studies.identification.remaining_life import RemainingLife
from jaxclear.studies.identification.result import IDENTIFIED, Evidence, Identified, prior_quantiles

# Panels side by side, and pairs of unknowns, at the most.
MOST_COLUMNS, MOST_PAIRS = 3, 6
# Of the sample's runs those nearest to the estimates make the band of the posterior.
NEAREST = 0.1
BAND = (5, 95)
BINS = 24
# Points of a line.
POINTS = 100


@answering
def identification(result: Identified, *, ax: Any = None) -> Any:
    """What a record says of the unknowns of a mechanism.

    Panels: each kind of statistic of the record, over the 5 to 95 % bands of all runs (prior) and
    of the tenth nearest to the estimates (posterior); the distribution of each unknown before and
    after, with the 95 % interval; pairs of unknowns; estimates for the sample's own runs, each left
    out, with their true values. An identification from signals has unknowns and pairs only.

    Args:
        result: a `Identified`, as `jaxclear.identify` returns it.
        ax: `matplotlib.axes.Axes` to draw in, one for each panel; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `result` is something else.
    """
    expect(result, Identified, "the identification", "what jaxclear.identify returns")
    drawn = _panel_functions(result)
    columns = len(drawn) if ax is not None else min(len(drawn), MOST_COLUMNS)
    rows = -(-len(drawn) // columns)
    sheet = panels("identification", ax, rows, columns, (4.4 * columns, 3.2 * rows))
    for empty in sheet.axes.flat[len(drawn) :]:
        empty.remove()
    for axis, draw in zip(sheet.axes.flat, drawn, strict=False):
        draw(axis)
    count = sum(u.verdict == IDENTIFIED for u in result.unknowns)
    sheet.title(f"{count} of {len(result.unknowns)} unknowns identified, from {result.runs} runs")
    return sheet.done(as_warnings(result.warned))


@answering
def remaining_life(result: RemainingLife, *, ax: Any = None) -> Any:
    """The unknown at each record, and the lines that the records allow, up to the limit.

    Args:
        result: a `RemainingLife`, as `jaxclear.remaining_life` returns it.
        ax: `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `result` is something else.
    """
    expect(result, RemainingLife, "the life", "what jaxclear.remaining_life returns")
    sheet = panels("remaining_life", ax, 1, 1, (6.4, 4.0))
    (axis,) = sheet.axes.flat
    middle, low, high = result.failure_band
    factor, unit = readable([result.limit, *result.values], result.unit)
    cycles = np.linspace(result.cycles[0], max(high, result.cycles[-1]), POINTS)
    lines = result.limit + result.rate[:, None] * (cycles - result.failure[:, None])
    ends = np.array([result.band(line) for line in lines.T]).T * factor
    share = f"{100 * result.level:g} %"
    axis.fill_between(cycles, *ends[1:], color="C0", alpha=0.25, lw=0, label=f"{share} of lines")
    axis.plot(cycles, ends[0], color="C0", lw=1.0)
    bars = 1.96 * factor * result.deviations
    axis.errorbar(result.cycles, factor * result.values, bars, fmt="ko", ms=4, capsize=3, lw=1.0)
    axis.axhline(factor * result.limit, color="C3", ls="--", lw=1.0, label="limit")
    axis.axvspan(low, high, color="C3", alpha=0.15, lw=0, label=f"{share} of failures")
    axis.axvline(middle, color="C3", lw=1.0)
    top = factor * max(result.limit, *result.values)
    axis.set_ylim(top=top + 0.15 * (top - ends.min()))
    axis.set_xlabel("cycles [1]")
    axis.set_ylabel(f"{result.name} [{unit}]")
    key(axis)
    sheet.title(result.sentence())
    return sheet.done(as_warnings(result.warnings))


def _panel_functions(result: Identified) -> list[Callable[[Any], None]]:
    """What each panel draws."""
    drawn: list[Callable[[Any], None]] = []
    evidence, unknowns = result.evidence, range(len(result.unknowns))
    if evidence is not None:
        near = _nearest_runs(evidence)
        kinds = evidence.kinds.items()
        drawn += [partial(_statistics, what=w, runs=r, record=s, near=near) for w, (r, s) in kinds]
    drawn += [partial(_draw_marginal, result=result, k=k) for k in unknowns]
    pairs = itertools.islice(itertools.combinations(unknowns, 2), MOST_PAIRS)
    drawn += [partial(_draw_pair, result=result, i=i, k=k) for i, k in pairs]
    if evidence is not None:
        part = evidence.coverage().mean(0)
        drawn += [
            partial(_leave_one_out, result=result, evidence=evidence, k=k, part=float(part[k]))
            for k in unknowns
        ]
    return drawn


def _nearest_runs(evidence: Evidence) -> np.ndarray:
    """The runs whose unknowns are nearest to what the record leaves."""
    middle, spread = evidence.shares.mean(0), evidence.shares.std(0)
    distance = np.sum(((evidence.fitted.unknowns - middle) / spread) ** 2, axis=1)
    return np.argsort(distance, kind="stable")[: max(int(NEAREST * len(distance)), 10)]


def _statistics(axis: Any, what: str, runs: np.ndarray, record: np.ndarray, near: Any) -> None:
    count = np.arange(1, len(record) + 1)
    for sample, name, colour in ((runs, "prior", "0.8"), (runs[near], "posterior", "C0")):
        low, high = np.percentile(sample, BAND, axis=0)
        alone: dict[str, Any] = {"color": colour, "alpha": 0.6, "lw": 0, "label": name}
        if len(record) == 1:
            axis.bar(count, high - low, bottom=low, width=0.6, **alone)
        else:
            axis.fill_between(count, low, high, **alone)
    axis.plot(count, record, "k.-", ms=4, lw=0.8, label="record")
    axis.set_ylabel(what)
    axis.set_xlabel("number of the statistic")
    axis.xaxis.set_major_locator(Roomy(integers=True))
    key(axis)


def _draw_marginal(axis: Any, result: Identified, k: int) -> None:
    u = result.unknowns[k]
    draws = result.posterior_values[:, k]
    prior = prior_quantiles(result.problem, u.name, (np.arange(400) + 0.5) / 400)
    factor, unit = readable([u.prior_low, u.prior_high], u.unit)
    edges = np.linspace(min(prior.min(), draws.min()), max(prior.max(), draws.max()), BINS + 1)
    for values, name, colour in ((prior, "prior", "0.8"), (draws, "posterior", "C0")):
        how: dict[str, Any] = {"density": True, "alpha": 0.7, "label": name, "color": colour}
        axis.hist(factor * values, bins=factor * edges, **how)
    axis.axvspan(factor * u.low, factor * u.high, color="C1", alpha=0.25, zorder=0, label="95 %")
    axis.axvline(factor * u.estimate, color="k", lw=1.0)
    axis.set_xlabel(f"{u.name} [{unit}], {u.verdict}")
    axis.set_ylabel("density")
    axis.set_yticks([])
    key(axis)


def _draw_pair(axis: Any, result: Identified, i: int, k: int) -> None:
    labels = []
    values = []
    for one in (i, k):
        u = result.unknowns[one]
        factor, unit = readable([u.prior_low, u.prior_high], u.unit)
        values.append(factor * result.posterior_values[:, one])
        labels.append(f"{u.name} [{unit}]")
    axis.plot(*values, "o", ms=3, mew=0, alpha=0.5)
    axis.set_xlabel(labels[0])
    axis.set_ylabel(labels[1])


def _leave_one_out(axis: Any, result: Identified, evidence: Evidence, k: int, part: float) -> None:
    u = result.unknowns[k]
    fitted, name = evidence.fitted, u.name
    factor, unit = readable([u.prior_low, u.prior_high], u.unit)
    as_value = lambda shares: factor * prior_quantiles(result.problem, name, shares)
    estimates = as_value(np.clip(fitted.surfaces[k].predictions, 0.0, 1.0))
    axis.plot(estimates, as_value(fitted.unknowns[:, k]), "o", ms=3, mew=0, alpha=0.5)
    ends = factor * np.array([u.prior_low, u.prior_high])
    axis.plot(ends, ends, color="0.5", lw=0.8)
    axis.axvline(factor * u.estimate, color="k", lw=1.0)
    axis.set_xlabel(f"{name} told of runs left out [{unit}]")
    axis.set_ylabel(f"what it was [{unit}]")
    axis.set_title(f"95 % intervals hold {100 * part:.0f} % of the runs", fontsize=8)
