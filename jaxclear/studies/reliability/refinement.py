"""A surface that is right where parts fail: runs at its design points tell, and runs about them
mend it."""

import jax
import numpy as np

from jaxclear.studies.base import SampleResult
from jaxclear.studies.endless import endless_sentences
from jaxclear.studies.reliability.design_point import DesignPoint, design_points
from jaxclear.studies.reliability.models import RunModel, SurfaceModel
from jaxclear.studies.surface.drawing import scrambled_normal
from jaxclear.studies.surface.fitting import fitted
from jaxclear.studies.surface.polynomials import powers
from jaxclear.studies.surface.response_surface import ResponseSurface

# The first surface is fitted over parts this many times as wide as they are.
WIDE = 1.5
# Runs for each term of a quadratic surface, and at the least.
RUNS_PER_TERM, FEWEST = 3, 32
# A surface is right where its design points are off by less [deviations].
RIGHT = 0.1
# How a sentence begins that stands in place of one.
NO_SURFACE = "There is no surface"
# Times it is mended, runs about a design point for each variable, how far about it [deviations].
MOST_ROUNDS, RUNS_ABOUT, ABOUT = 3, 3, 0.7


def surface_where_it_fails(
    model: RunModel, seed: int
) -> tuple[ResponseSurface | str, list[DesignPoint], bool]:
    """A surface of the problem for these limits, its design points, and whether runs at these
    confirm it; a sentence in place of one where responses are infinite. Raises `ValueError` where
    too few runs reach their end."""
    variables, cuts = len(model.problem.names), model.limit.cut_sets()
    rng = np.random.default_rng([seed, 6])
    runs = max(RUNS_PER_TERM * len(powers(np.full(variables, 2), 2, 1.0)), FEWEST)
    seen = [_counted(model, WIDE * scrambled_normal(runs, variables, rng))]
    for _ in range(MOST_ROUNDS):
        values, found = _together(seen)
        asked = {own.response: found.responses[own.response] for own in model.limit.limits()}
        endless = endless_sentences(model.problem, asked)
        if endless:
            return f"{NO_SURFACE}: {' '.join(endless)}", [], False
        surface = fitted(model.problem, values, found)
        if not all(surface.trusted(own.response) for own in model.limit.limits()):
            return surface, [], False
        own = SurfaceModel(surface, model.limit)
        points = design_points(own, cuts, variables, seed)
        if not points:
            return surface, points, True
        at = np.stack([point.normal for point in points])
        values, found = model.responses(at)
        gap = model.of(found) - own.margins(at)
        sizes = [np.max(abs(g[list(p.cut)]) / p.slopes) for g, p in zip(gap, points, strict=True)]
        if np.nanmax(sizes, initial=0.0) <= RIGHT and np.isfinite(sizes).all():
            return surface, points, True
        seen.append((values, found))
        for point, size in zip(points, sizes, strict=True):
            if not size <= RIGHT:
                about = scrambled_normal(RUNS_ABOUT * (variables + 1), variables, rng)
                seen.append(_counted(model, point.normal + ABOUT * about))
    return surface, points, False


def _counted(model: RunModel, normal: np.ndarray) -> tuple[np.ndarray, SampleResult]:
    values, found = model.responses(normal)
    model.of(found)
    return values, found


def _together(seen: list[tuple[np.ndarray, SampleResult]]) -> tuple[np.ndarray, SampleResult]:
    values = np.concatenate([own for own, _ in seen])
    found = jax.tree.map(lambda *parts: np.concatenate(parts), *(own for _, own in seen))
    return values, found
