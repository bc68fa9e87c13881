"""How often a limit is broken, however rarely: `jaxclear.reliability`.

Design points are found on the exact slopes of functions, else on a surface that is mended by runs
where parts fail. From there FORM and SORM answer at once, and importance sampling says how
far they are right; where it is not certain enough, subset simulation takes its place. Where
nothing that fails is found, a search of few runs says whether any is within reach.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_flags, check_methods, check_number, expect
from jaxclear.studies.experiment import SampleResult
from jaxclear.studies.infinite_responses import check_within_horizon, infinite_messages
from jaxclear.studies.limit_state import AbstractLimitState, check_limit, system_margin
from jaxclear.studies.problem import Problem
from jaxclear.studies.reliability.design_point import DesignPoint, design_points
from jaxclear.studies.reliability.first_order import curvatures, form, sorm
from jaxclear.studies.reliability.importance import Proposal, importance
from jaxclear.studies.reliability.models import (
    AbstractModel,
    Probability,
    RunModel,
    SurfaceModel,
    refused,
)
from jaxclear.studies.reliability.result import Reliability
from jaxclear.studies.reliability.subset import PILOT, Reach, repetitions, subset
from jaxclear.studies.scrambling import scrambled_normal
from jaxclear.studies.store.store import stored
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
    runs = max(RUNS_PER_TERM * len(powers(np.full(variables, 2), 2)), FEWEST)
    samples = [_run_and_count(model, WIDE * scrambled_normal(runs, variables, rng))]
    for _ in range(MOST_ROUNDS):
        values = np.concatenate([points for points, _ in samples])
        result = jax.tree.map(lambda *parts: np.concatenate(parts), *(runs for _, runs in samples))
        limited = {part.response: result.responses[part.response] for part in model.limit.limits()}
        endless = infinite_messages(model.problem, limited)
        if endless:
            return f"{NO_SURFACE}: {' '.join(endless)}", [], False
        surface = fitted(model.problem, values, result)
        if not all(surface.trusted(part.response) for part in model.limit.limits()):
            return surface, [], False
        fit = SurfaceModel(surface, model.limit)
        points = design_points(fit, cuts, variables, seed)
        if not points:
            return surface, points, True
        at = np.stack([point.normal for point in points])
        values, result = model.responses(at)
        gap = model.of(result) - fit.margins(at)
        sizes = [np.max(abs(g[list(p.cut)]) / p.slopes) for g, p in zip(gap, points, strict=True)]
        if np.nanmax(sizes, initial=0.0) <= RIGHT and np.isfinite(sizes).all():
            return surface, points, True
        samples.append((values, result))
        for point, size in zip(points, sizes, strict=True):
            if not size <= RIGHT:
                about = scrambled_normal(RUNS_ABOUT * (variables + 1), variables, rng)
                samples.append(_run_and_count(model, point.normal + ABOUT * about))
    return surface, points, False


def _run_and_count(model: RunModel, normal: np.ndarray) -> tuple[np.ndarray, SampleResult]:
    values, result = model.responses(normal)
    model.of(result)
    return values, result


METHODS = ("form", "sorm", "importance", "subset")
# Without a wish: subset simulation only where importance sampling does not do.
USUAL = ("form", "sorm", "importance")
# Regions that importance sampling looks at, at the most.
MOST_REGIONS = 16


@answering
@stored("a reliability")
def reliability(
    problem: Problem,
    limit: AbstractLimitState,
    *,
    methods: Sequence[str] | None = None,
    variation: float = 0.1,
    most_runs: int = 20_000,
    seed: int = 0,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> Reliability:
    """Probability that a limit is exceeded, with its error and the number of runs.

    Where runs are expensive or have no exact slopes, design points are searched on a
    `ResponseSurface`, which reduces the variance of importance sampling too.

    Args:
        problem: the problem.
        limit: limit state, one of `jaxclear.limit_state`: `Above("response", threshold)`, `Below`,
            or several in `Series` or `Parallel`.
        methods: names of methods, some of "form", "sorm", "importance" and "subset"; None (default)
            for the first three, and the last where importance sampling does not reach `variation`.
        variation: required coefficient of variation of the probability [1], > 0; 0.1 by default.
        most_runs: largest number of runs of each sampling; 20 000 by default. Subset simulation
            divides them among eight repetitions, after a search of at most some 2360 runs; where
            this finds no failure, the limit is reported as beyond all samples.
        seed: seed of the random numbers; 0 by default.
        store: folder that keeps the runs; None (default) for none.
        progress_bar: whether to show the progress; False by default.

    Returns:
        The `Reliability`.

    Raises:
        ValueError: if an argument is wrong.
    """
    expect(problem, Problem, "what reliability is asked of", "a problem of jaxclear")
    names = _check_request(problem, limit, methods)
    check_number("variation of reliability", variation, above=0, at_most=1)
    check_count("most_runs of reliability", most_runs)
    check_count("seed of reliability", seed, at_least=0)
    check_flags("reliability", progress_bar=progress_bar)
    model = RunModel(problem, limit, progress_bar)
    reach = Reach(model, seed)
    points, fitted, notes = _find_design_points(model, names, seed, reach)
    estimates: dict[str, Probability] = {}
    none = _none(fitted, limit, notes)
    if "form" in names:
        estimates["form"] = Probability(form(points), runs=model.runs) if points else none
    if "sorm" in names:
        search = model if fitted is None else SurfaceModel(fitted, limit)
        estimates |= _sorm_answers(search, model, points)
    if "importance" in names:
        settings = variation, most_runs, seed
        by_points = _sample_at_points(model, fitted, points, settings, notes)
        estimates["importance"] = by_points or none
    missed = "importance" in estimates and not estimates["importance"].variation <= variation
    looked = "subset" in names or (methods is None and missed)
    sampled = "importance" in estimates and np.isfinite(estimates["importance"].value)
    # Something is known to fail by a sample, or a design point of the runs themselves.
    if looked and (sampled or (points and fitted is None) or not reach.beyond()):
        estimates["subset"] = subset(model, variation, most_runs, seed, reach)
    if reach.sentence:
        nothing = refused(reach.sentence, model.runs)
        estimates = dict.fromkeys([*estimates, "subset"], nothing)
    counts = model.runs, model.failed
    texts = tuple(notes), model.warnings()
    return Reliability(problem, limit, estimates, tuple(points), fitted, *counts, variation, *texts)


def _sample_at_points(
    model: RunModel,
    fitted: ResponseSurface | None,
    points: list[DesignPoint],
    settings: tuple[float, int, int],
    notes: list[str],
) -> Probability | None:
    """What importance sampling answers; None without a design point. `settings`: variation, most
    runs, seed."""
    if not points:
        return None
    limit = model.limit
    trusted = fitted is not None and all(fitted.trusted(part.response) for part in limit.limits())
    control = SurfaceModel(fitted, limit) if fitted is not None and trusted else None
    proposal = Proposal.at([point.normal for point in points], [point.beta for point in points])
    if control is not None or model.problem.cost().is_negligible:
        proposal = _add_other_regions(control or model, proposal, settings)
        more = len(proposal.centres) - 1 - len(points)
        if more:
            notes.append(
                f"Parts fail in {more} region{'s' if more > 1 else ''} beside the "
                f"{len(points)} design point{'s' if len(points) > 1 else ''}, as samples found."
            )
    else:
        notes.append("Whether parts fail away from the design points was not searched.")
    return importance(model, control, proposal, *settings)


def _add_other_regions(
    search: RunModel | SurfaceModel, proposal: Proposal, settings: tuple[float, int, int]
) -> Proposal:
    """The proposal, and a centre in each region of failing parts which it hardly samples, as a
    small subset simulation finds them.

    The mean of the weights of failing parts over their probability is the number of samples that
    tell it to 100 %, as many as give the variation asked for from the most runs at the most: what
    weighs more is not sampled.
    """
    variation, most_runs, seed = settings
    failing: list[np.ndarray] = []

    def see(normal: np.ndarray, margins: np.ndarray) -> None:
        finite = np.where(np.isnan(margins), -1.0, margins)
        failing.append(normal[system_margin(finite, search.limit.cut_sets()) < 0])

    (share,), *_ = repetitions(search, 1, PILOT, np.random.default_rng([seed, 8]), see)
    fails, most = np.concatenate(failing), most_runs * variation**2 * share
    centres, betas = list(proposal.centres[1:]), list(proposal.betas)
    while len(fails) and most > 0 and len(centres) < MOST_REGIONS:
        fails = fails[proposal.weights(fails) > most]
        if not len(fails):
            break
        sizes = np.linalg.norm(fails, axis=1)
        centres.append(fails[np.argmin(sizes)])
        betas.append(float(sizes.min()))
        proposal = Proposal.at(centres, betas)
    return proposal


def _find_design_points(
    model: RunModel, names: Sequence[str], seed: int, reach: Reach
) -> tuple[list[DesignPoint], ResponseSurface | None, list[str]]:
    """Design points, the surface on which they were found (None: on runs), and sentences."""
    if set(names) <= {"subset"}:
        return [], None, []
    cuts, variables = model.limit.cut_sets(), len(model.problem.names)
    hopeless = lambda: bool(reach.beyond())
    exact = not any(model.problem.description.derivative)
    if exact and model.problem.cost().is_negligible:
        return design_points(model, cuts, variables, seed, hopeless), None, []
    result, points, right = surface_where_it_fails(model, seed)
    if isinstance(result, str):
        return [], None, [result]
    notes = [result.sentence()]
    if exact and not points:
        return design_points(model, cuts, variables, seed, hopeless), None, notes
    if points and not right:
        notes.append("Runs at its design points do not confirm the surface.")
    return points, result, notes


def _none(
    surface: ResponseSurface | None, limit: AbstractLimitState, notes: list[str]
) -> Probability:
    """What methods answer that have no design point."""
    if surface is not None:
        trusted = all(surface.trusted(part.response) for part in limit.limits())
        why = "nothing fails on the surface" if trusted else "the surface is too rough to search"
        return refused(f"{why}.")
    none = bool(notes) and notes[0].startswith(NO_SURFACE)
    return refused("there is no surface." if none else "no design point is found.")


def _sorm_answers(
    search: AbstractModel, model: RunModel, points: list[DesignPoint]
) -> dict[str, Probability]:
    """SORM's answers by its two formulas."""
    names = ("breitung", "tvedt")
    if not points:
        return dict.fromkeys(names, refused("there is no design point."))
    if any(len(point.cut) > 1 for point in points):
        why = "it has no formula for limits that are broken together."
        return dict.fromkeys(names, refused(why))
    if any(point.beta <= 0.0 for point in points):
        return dict.fromkeys(names, refused("parts in the middle fail."))
    answers = sorm(points, [curvatures(search, point) for point in points])
    bent = refused("the limit bends around the middle.", model.runs)
    return {
        name: Probability(value, runs=model.runs) if value == value else bent
        for name, value in zip(names, answers, strict=True)
    }


def _check_request(problem: Problem, limit: Any, methods: Any) -> tuple[str, ...]:
    """The methods wanted. Raises `ValueError` for what cannot be asked."""
    if not problem.names:
        raise ValueError(
            "the problem has no variables; nothing would fail by chance: give it some."
        )
    check_limit(limit, problem.response_names, "reliability")
    for part in limit.limits():
        check_within_horizon(problem, part.response, part.threshold)
    if methods is None:
        return USUAL
    if isinstance(methods, str):
        methods = (methods,)
    check_methods("reliability", methods, METHODS)
    return tuple(methods)
