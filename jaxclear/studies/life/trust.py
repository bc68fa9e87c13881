"""What a life may be off by, told once all its steps are known.

Smooth rates: the errors of the steps add up. A second opinion comes from the rates at the stages of
the whole life: a cubic spline through them, integrated, is of higher order than the steps, so what
a step is apart from it is that step's error. It knows the law that the rates follow where a single
step supposes one; of the two the lesser is told.

Rates that scatter without saying so (means over cycles tell their noise): how much is known from
all steps that were tried, those taken back among them. Were they left out, steps whose rates lie by
chance on a line would be kept and believed. From few steps a scatter is little known, and Student's
factor widens what is told.
"""

from collections.abc import Sequence

import numpy as np

from jaxclear.studies.life.nodes import Cells, Node, Trial

# A normal variable stays within this many deviations in 95 % of cases; errors told are that many.
NORMAL = 1.96
# A spline is cubic where it has so many places, and what is apart from it counts so many times.
PLACES, MARGIN = 5, 1.25
# Estimates so many times larger than those of smooth rates come of scatter.
CLEARLY = 1.3


def trusted(
    nodes: Sequence[Node], trials: Sequence[Trial], cells: Cells, of_scatter: float
) -> tuple[Node, ...]:
    """The nodes with what is told of them at the end of the life; scatter is `of_scatter` times
    larger in the answer of a step than in its estimate."""
    errors = _errors(nodes, trials, cells)
    scatter = _scatter(trials, len(cells.surfaces))
    found, variance = [nodes[0]], np.zeros_like(nodes[0].variance)
    for before, after, error in zip(nodes[:-1], nodes[1:], errors[1:], strict=True):
        trial = next((one for one in trials if one.after is after), None)
        if trial is not None:
            own = cells.shares(trial.estimate, after.depth - before.depth)
            # Without scatter, what little is beyond smooth rates.
            less = np.maximum(trial.shares - trial.smooth, 0.0)
            part = np.where(scatter > 0, scatter, less)
            part = np.divide(part, own, out=np.zeros_like(own), where=own > 0)
            variance = variance + (of_scatter * trial.estimate * cells.each(part)) ** 2
        found.append(after._replace(error=error, variance=after.variance + variance))
    return tuple(found)


def _errors(nodes: Sequence[Node], trials: Sequence[Trial], cells: Cells) -> list[np.ndarray]:
    """Of smooth rates, by surface, at each node [m]."""
    told = [node.error for node in nodes]
    if len(nodes) < PLACES:
        return told
    import scipy.interpolate

    cycles = np.array([node.cycles for node in nodes])
    rates = np.array([node.rate.wear for node in nodes])
    path = scipy.interpolate.CubicSpline(cycles, rates).antiderivative()(cycles)
    stepped = {id(trial.after) for trial in trials}
    sum_, found = np.zeros(len(cells.surfaces)), [told[0]]
    for i, node in enumerate(nodes[1:], 1):
        before, now = cells.sizes(rates[i - 1]), cells.sizes(rates[i])
        # An error grows with the rate where that grows with wear; that it shrinks is not counted.
        growth = np.divide(now, before, out=np.ones_like(now), where=before > 0)
        sum_ = sum_ * np.maximum(growth, 1.0)
        if id(node) in stepped:
            apart = node.depth - nodes[i - 1].depth - (path[i] - path[i - 1])
            sum_ = sum_ + MARGIN * cells.sizes(apart)
        found.append(np.minimum(told[i], sum_))
    return found


def _scatter(trials: Sequence[Trial], surfaces: int) -> np.ndarray:
    """Of the estimates of steps, as shares of what they wear, by surface; with Student's factor."""
    found = np.zeros(surfaces)
    if not trials:
        return found
    import scipy.stats

    smooth = np.array([trial.smooth for trial in trials])
    noise = np.array([trial.noise for trial in trials]).T
    for i, shares in enumerate(np.array([trial.shares for trial in trials]).T):
        beyond = shares[shares > CLEARLY * smooth]
        if not len(beyond) or noise[i].any():
            continue
        # Also the steps tell in which smooth rates could not have made as much.
        telling = shares[smooth <= np.sqrt(np.mean(beyond**2))]
        factor = scipy.stats.t.ppf(0.975, len(telling)) / NORMAL
        found[i] = factor * np.sqrt(np.mean(telling**2))
    return found
