"""The cheapest tolerances, clearances and nominal dimensions that keep limits: `jaxclear.design`.

What may be chosen, what it costs and what must hold is the user's; candidates are judged on a
surface through few runs, or on the problem itself where it answers at once, and the last one by
runs that had no part in finding it.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_flags, expect
from jaxclear.studies.design.limit import AbstractLimit
from jaxclear.studies.design.lines import cost_by_number, line_choices
from jaxclear.studies.design.question import Question, checked_cost, checked_limits, freedom_of
from jaxclear.studies.design.result import Design, prices_of
from jaxclear.studies.design.runs import BATCH, Runs
from jaxclear.studies.design.search import DesignSettings, Sought, sought
from jaxclear.studies.infinite_responses import infinite_messages
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_warnings import sentences
from jaxclear.studies.store.store import stored


@answering
@stored("a design")
def design(
    problem: Problem,
    cost: Any,
    limits: Sequence[AbstractLimit] | AbstractLimit,
    *,
    tolerance: Mapping[str, Any] | None = None,
    nominal: Mapping[str, Any] | None = None,
    choose: Mapping[str, Any] | None = None,
    settings: DesignSettings | None = None,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> Design:
    """Find the cheapest design of a problem that satisfies all limits.

    The design is verified by runs with other random numbers and tightened until the limits hold;
    its sentence says whether they do. Ctrl-C ends the search with the best design so far.

    Args:
        problem: the problem.
        cost: members of `jaxclear.cost` by the name of the variable whose tolerance they price, or
            a differentiable function of two dictionaries (nominal values, tolerances).
        limits: one member of `jaxclear.limit` or a sequence, on responses or variables.
        tolerance: tolerances to choose, by name of the variable: (smallest, largest) in its unit,
            or a member of `jaxclear.catalogue`. A tolerance scales the variable's distribution; it
            is half of its range (three standard deviations where it has no ends). None by default.
        nominal: nominal values to choose, by name of the variable, likewise. None by default.
        choose: lines of a `jaxclear.Drawing` to choose, by name: a `jaxclear.catalogue.Fits` for a
            fit, whose costs go by "name hole" and "name shaft"; (smallest, largest) size [m] of a
            zone, or a `Sizes`, whose cost goes by "name". None by default.
        settings: `DesignSettings` of the search; None for the defaults.
        store: folder that keeps the runs; None (default) for none.
        progress_bar: whether to show the progress; False by default.

    Returns:
        The `Design`.

    Raises:
        ValueError: if an argument is wrong.
    """
    question = _make_question(problem, cost, limits, tolerance, nominal, choose)
    settings = _check_settings(settings)
    check_flags("design", progress_bar=progress_bar)
    return _search_design(question, _make_runs(problem, settings, progress_bar), settings)


@answering
@stored("a design")
def pareto_front(
    problem: Problem,
    cost: Any,
    limits: Sequence[AbstractLimit] | AbstractLimit,
    bounds: Sequence[float],
    *,
    limit: int = 0,
    tolerance: Mapping[str, Any] | None = None,
    nominal: Mapping[str, Any] | None = None,
    choose: Mapping[str, Any] | None = None,
    settings: DesignSettings | None = None,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> list[Design]:
    """The Pareto front of cost against the bound of one limit.

    Each design is verified; runs of one serve the surfaces of the next.

    Args:
        problem: the problem.
        cost: cost of tolerances, a dictionary or function, as of `design`.
        limits: one member of `jaxclear.limit` or a sequence.
        bounds: values of the bound, a sequence, in the unit of the limit.
        limit: index of the limit that has these bounds; 0 by default.
        tolerance, nominal, choose: mapping from names to what to choose, as of `design`; None by
            default.
        settings: `DesignSettings` of the search; None for the defaults.
        store: folder that keeps the runs; None (default) for none.
        progress_bar: whether to show the progress; False by default.

    Returns:
        A list of `Design`, one for each bound.

    Raises:
        ValueError: if an argument is wrong.
    """
    check_flags("pareto_front", progress_bar=progress_bar)
    question = _make_question(problem, cost, limits, tolerance, nominal, choose)
    check_count("limit of pareto_front", limit, at_least=0)
    if limit >= len(question.limits):
        raise ValueError(f"there is no limit {limit}; there are {len(question.limits)}, from 0 on.")
    settings = _check_settings(settings)
    runs = _make_runs(problem, settings, progress_bar)
    designs = []
    for bound in bounds:
        bounded_limits = list(question.limits)
        bounded_limits[limit] = bounded_limits[limit].with_bound(bound)
        designs.append(_search_design(question.with_limits(tuple(bounded_limits)), runs, settings))
    return designs


def _make_question(
    problem: Any, cost: Any, limits: Any, tolerance: Any, nominal: Any, choose: Any
) -> Question:
    """The question, checked."""
    expect(problem, Problem, "what is designed", "a problem of jaxclear")
    freedom = freedom_of(problem, nominal, tolerance, line_choices(problem, choose))
    cost = cost_by_number(problem, choose, cost)
    checked = checked_limits(limits, problem)
    return Question(
        freedom, checked_cost(cost, freedom), checked, problem.inputs, np.ones(len(checked))
    )


def _check_settings(settings: DesignSettings | None) -> DesignSettings:
    settings = DesignSettings() if settings is None else settings
    expect(settings, DesignSettings, "settings of design", "a jaxclear.DesignSettings")
    return settings


def _is_direct(problem: Problem, settings: DesignSettings) -> bool:
    """Whether the problem answers without a surface."""
    refused, in_doubt = problem.description.derivative
    if settings.surface is False and refused:
        raise ValueError(
            f"design goes by derivatives where there is no surface, and {refused}; leave "
            "`surface` out of the DesignSettings, and a response surface has them."
        )
    if settings.surface is not None:
        return not settings.surface
    return problem.cost().is_negligible and not refused and not in_doubt


def _make_runs(problem: Problem, settings: DesignSettings, show: bool) -> Runs:
    cost = problem.cost()
    batch = BATCH if cost.compiled and not cost.cheap else cost.batch
    return Runs(problem, show, min(batch, settings.samples))


def _search_design(question: Question, runs: Runs, settings: DesignSettings) -> Design:
    before = runs.count, runs.computed, runs.failed
    search = sought(question, runs, settings, _is_direct(runs.problem, settings))
    return _make_design(search, runs, settings, before)


def _make_design(search: Sought, runs: Runs, settings: DesignSettings, before: tuple) -> Design:
    """The best round as a result."""
    best, question = search.rounds[search.best], search.question
    place = jnp.asarray(best.candidate.place)
    names = question.freedom.names
    nominal, tolerance = question.freedom.drawn(place)
    samples = question.samples(place, search.model, search.points)
    none = np.full(len(question.limits), np.nan)
    limited = [one.response for one in question.limits]
    check, prices = best.check, prices_of(question, best.candidate.multipliers, samples)
    return Design(
        runs.problem,
        question,
        dict(zip(names, map(float, nominal), strict=True)),
        dict(zip(names, map(float, tolerance), strict=True)),
        best.candidate.cost,
        none if check is None else check.numbers,
        none if check is None else check.errors,
        none if check is None else check.excess,
        none if search.ended == "infeasible" or best.confined else prices,
        tuple(search.rounds),
        search.best,
        search.ended,
        float(settings.allowed_excess),
        runs.count - before[0],
        runs.computed - before[1],
        runs.failed - before[2],
        tuple(infinite_messages(runs.problem, runs.named(before[0]))),
        sentences(runs.problem, runs.warned(before[0]), limited),
    )
