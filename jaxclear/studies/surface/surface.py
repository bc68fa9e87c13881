"""A surface through a few runs that stands for a problem's responses: `jaxclear.surface`.

A polynomial in the variables themselves, not in the standard normal numbers behind them, because
responses are smooth in dimensions whatever the distribution. How far it can be trusted is told by
runs that it has not seen, one by one (leave-one-out); below R2 = 0.9 it says that it cannot.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_flags, check_name, check_number, expect
from jaxclear.studies.experiment import SampleResult
from jaxclear.studies.infinite_responses import refuse_infinite
from jaxclear.studies.problem import Problem
from jaxclear.studies.sampling import all_values
from jaxclear.studies.scrambling import scrambled_normal
from jaxclear.studies.store.batch import evaluate_all
from jaxclear.studies.store.result import GivenSample, sample_of
from jaxclear.studies.store.store import stored
from jaxclear.studies.surface.fitting import fitted
from jaxclear.studies.surface.polynomials import powers
from jaxclear.studies.surface.response_surface import ResponseSurface

NUMBER = (int, float, np.integer, np.floating)
# So many times the spread of the variables, or ranges by name.
Region = float | Mapping[str, tuple[float, float]]


def drawn(problem: Problem, runs: int, over: Region, seed: int) -> np.ndarray:
    """Values (runs, variables) that fill a region.

    Args:
        problem: with the variables.
        runs: their number.
        over: multiple of the standard deviations, or ranges by variable.
        seed: of the points.
    """
    rng = np.random.default_rng(seed)
    normal = scrambled_normal(runs, len(problem.names), rng)
    wide = normal if isinstance(over, Mapping) else over * normal
    values = all_values(problem, wide)
    for name, (low, high) in (over if isinstance(over, Mapping) else {}).items():
        share = scipy.special.ndtr(normal[:, problem.names.index(name)])
        values[:, problem.names.index(name)] = low + (high - low) * share
    return values


def check_region(problem: Problem, over: Any) -> None:
    """What a surface may be fitted over."""
    if not isinstance(over, Mapping):
        check_number("over of surface (or ranges by name)", over, above=0)
        return
    for name, bounds in over.items():
        check_name("variable", name, problem.names, " in this problem")
        pair = isinstance(bounds, (tuple, list)) and len(bounds) == 2
        if (
            not pair
            or not all(isinstance(x, NUMBER) and np.isfinite(x) for x in bounds)
            or bounds[0] >= bounds[1]
        ):
            raise ValueError(
                f'over["{name}"] of surface is {bounds!r}; it must be two finite numbers, low and '
                "high."
            )


# Runs for each term of a quadratic surface, and in all, where no number is asked for.
RUNS_PER_TERM, FEWEST = 3, 32
INSTEAD = "limits of jaxclear.design and jaxclear.reliability take it"  # what has no surface


@answering
@stored("a response surface")
def surface(
    problem: Problem,
    sample: int | GivenSample | None = None,
    *,
    over: Region = 1.0,
    seed: int = 0,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> ResponseSurface:
    """Fit a polynomial response surface to a few runs of a problem.

    The degree is that of 1 to 4 that predicts runs best, for each response.

    Args:
        problem: the problem.
        sample: number of runs, or a `MonteCarlo` or `Campaign` of this problem; None (default) for
            three runs for each term of a quadratic.
        over: where the surface is fitted: a factor of the spread of the variables [1], 1 by
            default, larger for rare parts; or a dictionary of ranges (low, high) by variable, in
            its unit, filled evenly, for nominal values that are to be chosen.
        seed: seed of the random numbers; 0 by default.
        store: folder that keeps the runs; None (default) for none.
        progress_bar: whether to show the progress; False by default.

    Returns:
        The `ResponseSurface`.

    Raises:
        ValueError: if an argument is wrong, or too few runs reach their end.
    """
    expect(problem, Problem, "what a surface is fitted to", "a problem of jaxclear")
    if not problem.names:
        raise ValueError("the problem has no variables; a surface would have none: give it some.")
    check_count("seed of surface", seed, at_least=0)
    check_flags("surface", progress_bar=progress_bar)
    check_region(problem, over)
    lacking = ""
    if isinstance(sample, GivenSample):
        study = sample_of(problem, sample)
        ends = jnp.asarray(study.outcome), jnp.asarray(study.ended)
        responses = jax.tree.map(jnp.asarray, study.responses)
        values, lacking = study.values, study.unreached
        result = SampleResult(responses, *ends, study.checks)
    else:
        count = len(powers(np.full(len(problem.names), 2), 2))
        runs = max(RUNS_PER_TERM * count, FEWEST) if sample is None else sample
        check_count("sample of surface (how many runs, a Monte Carlo study or a campaign)", runs)
        values = drawn(problem, runs, over, seed)
        points = jnp.asarray(values)
        result = evaluate_all(problem, points, progress_bar=progress_bar, label="surface")
    refuse_infinite(problem, result.responses, "surface", INSTEAD)
    return dataclasses.replace(fitted(problem, values, result), unreached=lacking)
