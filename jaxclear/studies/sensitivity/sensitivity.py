"""Derivatives of statistics of responses with respect to what varies: `jaxclear.sensitivity`.

Each direction is differentiated by several methods (`regression`, `differences`, `pathwise`), each
on a sample of its own, so that chance and bias of one are not those of another; their answers meet
in one (`derivative`).
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_methods, expect
from jaxclear.studies.monte_carlo import MonteCarlo, monte_carlo
from jaxclear.studies.problem import Problem
from jaxclear.studies.sampling import draw, groups, usual_scramblings
from jaxclear.studies.scrambling import seed_of
from jaxclear.studies.sensitivity.derivative import (
    Estimate,
    Sensitivity,
    confirmed,
    confirms,
    refused,
)
from jaxclear.studies.sensitivity.differences import (
    Runs,
    differences,
    looks,
    moved,
    no_differences,
)
from jaxclear.studies.sensitivity.estimand import Direction, Functional, directions, functionals
from jaxclear.studies.sensitivity.pathwise import pathwise
from jaxclear.studies.sensitivity.regression import (
    Ends,
    no_regression,
    regressions,
    runs_at_ends,
    runs_outside,
)
from jaxclear.studies.sensitivity.steps import error_by_steps
from jaxclear.studies.store.result import GivenSample, sample_of
from jaxclear.studies.store.store import stored

METHODS = ("regression", "differences", "pathwise")
# Independent parts of a sample of differences: as many as of the Monte Carlo sample.
SCRAMBLINGS = 16
# Sets what these studies draw apart from what others do by the same seed.
SEEDS = 811


@answering
@stored("a sensitivity study")
def sensitivity(
    problem: Problem,
    variables: str | Sequence[str] | None = None,
    *,
    sample: GivenSample | int = 256,
    difference_samples: int = 128,
    of: Any = ("mean",),
    methods: Sequence[str] = ("regression", "differences"),
    seed: int = 0,
    verify: bool = True,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> Sensitivity:
    """Derivatives of the mean of every response, or of other statistics, by the variables.

    Args:
        problem: the problem.
        variables: names of variables; also of widths of distributions, such as "tolerance of
            clearance", "standard deviation of length", "half width of slot". All variables by
            default.
        sample: number of samples to draw, or a `MonteCarlo` or `Campaign` of this problem; 256 by
            default.
        difference_samples: number of samples for differences; 128 by default. They begin with 16
            and double until they confirm a more certain answer.
        of: statistics of every response, some of "mean" (default), "standard deviation",
            ("quantile", share [1]), ("above", limit), ("below", limit), with limits in the
            response's unit; or a dictionary from responses to statistics. A statistic that fewer
            than 4 samples decide is refused.
        methods: names of methods, some of "regression" (polynomial with the score function; a
            quarter more runs, at most 128, with a wider spread), "differences" (small steps),
            both by default, and "pathwise" (fixed steps only; shown where another method agrees,
            never the answer through contacts).
        seed: seed of the random numbers; 0 by default.
        verify: whether to repeat samples with finer steps, as of `monte_carlo`; errors then include
            what steps change in a derivative. True by default.
        store: folder that keeps the runs; None (default) for none.
        progress_bar: whether to show the progress; False by default.

    Returns:
        The `Sensitivity`.

    Raises:
        ValueError: if an argument is wrong, or the sample is of another problem.
    """
    expect(problem, Problem, "what is differentiated", "a jaxclear.Problem")
    variables = [variables] if isinstance(variables, str) else variables
    _check(variables, sample, difference_samples, methods, seed)
    all_directions = directions(problem, list(problem.names if variables is None else variables))
    estimands = functionals(of, problem)
    if isinstance(sample, GivenSample):
        drawn = sample_of(problem, sample)
    else:
        drawn = monte_carlo(problem, sample, seed=seed, verify=verify, progress_bar=progress_bar)
    results: dict[Direction, dict] = {}
    # Once for all directions of a variable.
    ends: dict[int, Ends | None] = {}
    bar = {"progress_bar": progress_bar}
    outer = None
    refusals = {d: no_regression(drawn, d) for d in all_directions}
    # Where all are refused no regression would see them.
    if "regression" in methods and not all(refusals.values()):
        outer = runs_outside(problem, drawn.scrambling, seed_of(seed, SEEDS, 4), **bar)
    for direction in all_directions:
        answers: dict[str, dict[str, Estimate]] = {}
        if "regression" in methods:
            place, parts = direction.variable, len(np.unique(drawn.scrambling))
            if place not in ends and not refusals[direction]:
                ends[place] = runs_at_ends(problem, place, parts, seed_of(seed, SEEDS, 3), **bar)
            answers["regression"] = regressions(drawn, direction, estimands, ends.get(place), outer)
        sampled = lambda d: _draw_sample(problem, difference_samples, seed_of(seed, SEEDS, d))
        if "pathwise" in methods:
            answers["pathwise"] = pathwise(problem, sampled(2), direction, estimands, **bar)
        if "differences" in methods:
            answers["differences"] = _confirming_differences(
                problem, direction, sampled(1), answers, estimands, progress_bar
            )
        results[direction] = {name: answers[name] for name in METHODS if name in answers}
    return _merge(results, estimands, drawn)


def _confirming_differences(
    problem: Problem,
    direction: Direction,
    sample: tuple[np.ndarray, np.ndarray],
    others: dict[str, dict[str, Estimate]],
    functionals: list[Functional],
    progress_bar: bool,
) -> dict[str, Estimate]:
    """Differences along a direction on as much of a sample, values (samples, variables) and their
    scramblings (samples,), as confirms what `others` answer, by method and label."""
    why = no_differences(problem, direction)
    if why:
        return {one.label: refused(why) for one in functionals}
    values, group = sample
    runs: Runs | None = None
    answers: dict[str, Estimate] = {}
    remaining = functionals
    for look in looks(group):
        if not remaining:
            break
        new = moved(problem, (values[look], group[look]), direction, progress_bar=progress_bar)
        runs = new if runs is None else runs.and_also(new)
        answers |= differences(problem, runs, direction, remaining)
        every = others | {"differences": answers}
        estimates_of = lambda one, every=every: {name: of[one.label] for name, of in every.items()}
        remaining = [one for one in functionals if not confirms(estimates_of(one), "differences")]
    return answers


def _merge(every: dict[Direction, dict], goals: list[Functional], drawn: MonteCarlo) -> Sensitivity:
    """One answer from the methods' answers, for each direction and statistic."""
    derivatives = {}
    for direction, answers in every.items():
        step = direction.step(drawn.problem)
        for one in goals:
            estimates = {method: by_label[one.label] for method, by_label in answers.items()}
            key = one.label, direction.label
            size = one.size(drawn.good(one.response)[0], step)
            answer = confirmed(*key, estimates, size)
            # All methods share the steps of the study: what these do to a derivative is no part of
            # whether they agree.
            steps = error_by_steps(drawn, direction, one, answer.value, answer.error)
            unresolved = "" if steps is None or steps.is_resolved else steps.unresolved
            # What brings the sample's response in doubt, and what the sample lacks of what was
            # asked for.
            doubts = [unresolved, *drawn.accuracy_warnings_of(one.response), drawn.unreached]
            verdict = " ".join(filter(None, [answer.verdict, *doubts]))
            error = answer.error if steps is None or unresolved else steps.whole
            derivatives[key] = dataclasses.replace(answer, verdict=verdict, error=error)
    problem = drawn.problem
    units = {one.label: one.unit(problem.units()[one.response]) for one in goals}
    units |= {d.label: problem.variable_units[d.variable] for d in every}
    return Sensitivity(derivatives, drawn, units)


def _draw_sample(problem: Problem, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A sample of a method's own: values (samples, variables) and scramblings (samples,)."""
    parts = SCRAMBLINGS if samples >= 4 * SCRAMBLINGS else usual_scramblings(samples)
    return draw(problem, samples, seed, scramblings=parts), groups(samples, parts)


def _check(variables: Any, sample: Any, difference_samples: Any, methods: Any, seed: Any) -> None:
    """What a study of derivatives may be asked for."""
    if variables is not None:
        which = "names of the problem's variables"
        expect(variables, (list, tuple), "variables of sensitivity", which)
    check_methods("sensitivity", methods, METHODS)
    if not isinstance(sample, GivenSample):
        what = "sample of sensitivity (a Monte Carlo study, a campaign, or how many samples)"
        check_count(what, sample)
    check_count("difference_samples of sensitivity", difference_samples)
    check_count("seed of sensitivity", seed, at_least=0)
