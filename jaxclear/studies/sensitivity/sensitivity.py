"""Derivatives of statistics of responses with respect to what varies: `jaxclear.sensitivity`.

Each direction is differentiated by several methods (`regression`, `differences`, `pathwise`), each
on a sample of its own, so that chance and bias of one are not those of another; their answers meet
in one (`derivative`).
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import check_count, check_methods, expect
from jaxclear.studies.base import AbstractProblem
from jaxclear.studies.campaign.result import GivenSample, given_sample
from jaxclear.studies.monte_carlo import MonteCarlo, monte_carlo
from jaxclear.studies.sampling import draw, groups, usual_scramblings
from jaxclear.studies.scrambling import seed_of
from jaxclear.studies.sensitivity.derivative import (
    Derivative,
    Estimate,
    Sensitivity,
    confirmed,
    confirms,
    refused,
)
from jaxclear.studies.sensitivity.differences import (
    differences,
    doubling,
    looks,
    moved,
    refusal,
)
from jaxclear.studies.sensitivity.direction import Direction, directions
from jaxclear.studies.sensitivity.functional import Functional, functionals
from jaxclear.studies.sensitivity.opposed import (
    Opposed,
    between_distributions,
    opposed_of,
    paired,
)
from jaxclear.studies.sensitivity.outer import runs_outside
from jaxclear.studies.sensitivity.pathwise import pathwise
from jaxclear.studies.sensitivity.regression import refusal as no_score
from jaxclear.studies.sensitivity.regression import regressions, runs_at_ends

METHODS = ("regression", "differences", "pathwise")
# Independent parts of a sample of differences: as many as of the Monte Carlo sample.
SCRAMBLINGS = 16
# Sets what these studies draw apart from what others do by the same seed.
SEEDS = 811


@answering
def sensitivity(
    problem: AbstractProblem,
    variables: str | Sequence[str] | None = None,
    *,
    sample: GivenSample | int = 256,
    difference_samples: int = 128,
    of: Any = ("mean",),
    methods: Sequence[str] = ("regression", "differences"),
    seed: int = 0,
    verify: bool = True,
    progress_bar: bool = False,
) -> Sensitivity:
    """Derivatives of the mean of every response, or of other statistics, with respect to
    `variables`: names (all by default), and widths of distributions by theirs, "tolerance of
    clearance", "standard deviation of length", "half width of slot".

    `sample`: a Monte Carlo sample or a campaign to read slopes from, or how many samples to draw
    for it. `of`: any of "mean", "standard deviation", ("quantile", share [1]), ("above", limit),
    ("below", limit), for every response, or {response: statistics}; limits in the response's unit,
    the share of parts beyond one is a probability of failure; what fewer than 4 samples decide is
    refused. `methods`: any of "regression" (a polynomial, corrected by the score function; takes a
    quarter of the sample's runs more, 128 at the most, further out than the sample reaches),
    "differences" (by small steps over a first 16 of `difference_samples` where these confirm a more
    certain answer, else between values that become likelier and such as become less so, or by steps
    over all), "pathwise" (fixed-step integrators only; the cheapest where nothing opens and closes;
    through contacts it is shown only where another method agrees with it, and is never the answer).
    `verify`: the sample drawn here has replicas, as in `monte_carlo`; verdicts say what they doubt.
    Raises `ValueError` with a sentence for a name that there is not, and for another's sample.
    """
    expect(problem, AbstractProblem, "what is differentiated", "a jaxclear.Problem")
    _check(sample, difference_samples, methods, seed)
    wanted = directions(problem, _wanted(problem, variables))
    asked = functionals(of, problem)
    if isinstance(sample, GivenSample):
        drawn = given_sample(problem, sample)
    else:
        drawn = monte_carlo(problem, sample, seed=seed, verify=verify, progress_bar=progress_bar)
    found: dict[Direction, dict] = {}
    ends: dict[int, Any] = {}
    bar = {"progress_bar": progress_bar}
    outer = None
    # Where no direction has a score function no regression would see them.
    if "regression" in methods and not all(no_score(problem, own) for own in wanted):
        outer = runs_outside(problem, drawn.scrambling, seed_of(seed, SEEDS, 4), **bar)
    for direction in wanted:
        answers: dict[str, dict[str, Estimate]] = {}
        if "regression" in methods:
            own = _ends(drawn, direction, ends, seed, **bar)
            answers["regression"] = regressions(drawn, direction, asked, own, outer)
        sampled = lambda own: _shared(problem, difference_samples, seed_of(seed, SEEDS, own))
        if "pathwise" in methods:
            answers["pathwise"] = pathwise(problem, sampled(2), direction, asked, **bar)
        if "differences" in methods:
            before = asked, answers
            answers["differences"] = _differences(problem, sampled(1), direction, before, **bar)
        found[direction] = {name: answers[name] for name in METHODS if name in answers}
    return _met(found, asked, drawn)


def _ends(
    drawn: MonteCarlo, direction: Direction, known: dict[int, Any], seed: int, progress_bar: bool
) -> Any:
    """Runs at the ends of a variable, once for all its directions."""
    place = direction.variable
    if place not in known:
        parts = len(np.unique(drawn.scrambling))
        known[place] = runs_at_ends(
            drawn.problem, place, parts, seed_of(seed, SEEDS, 3), progress_bar
        )
    return known[place]


def _differences(
    problem: AbstractProblem,
    sample: tuple[np.ndarray, np.ndarray],
    direction: Direction,
    before: tuple[list[Functional], dict[str, dict[str, Estimate]]],
    **bar: bool,
) -> dict[str, Estimate]:
    """By differences on as much of a sample as is needed: a first look by small steps, and what of
    it confirms no more certain answer by pairs, or by steps on all of the sample. `before`: what is
    asked, and the answers of other methods."""
    asked, others = before
    why = refusal(problem, direction)
    if why:
        return {one.label: refused(why) for one in asked}
    (values, group), (first, *rest) = sample, looks(sample[1])
    runs = moved(problem, (values[first], group[first]), direction, **bar)
    answers = differences(problem, runs, direction, asked)
    left = _unconfirmed(asked, others, answers)
    if not left or not rest:
        return answers
    # Small steps of what rattles tell little, whatever the sample: whole distributions tell more.
    linear = [one for one in left if one.linear and _surer(others, one, answers)]
    between = opposed_of(problem, direction) if linear else None
    if between is not None:
        told, spent = _by_pairs(problem, sample, (direction, between), (linear, others), **bar)
        taken = len(runs.found.outcome)
        answers |= {name: own._replace(runs=own.runs + taken) for name, own in told.items()}
        left = [one for one in left if one.label not in told]
    for look in rest if left else ():
        runs = runs.and_also(moved(problem, (values[look], group[look]), direction, **bar))
        answers |= differences(problem, runs, direction, left)
    # What pairs were run for in vain took them too.
    for name in [one.label for one in left if between is not None and one in linear]:
        answers[name] = answers[name]._replace(runs=len(runs.found.outcome) + spent)
    return answers


def _by_pairs(
    problem: AbstractProblem,
    sample: tuple[np.ndarray, np.ndarray],
    way: tuple[Direction, Opposed],
    before: tuple[list[Functional], dict[str, dict[str, Estimate]]],
    **bar: bool,
) -> tuple[dict[str, Estimate], int]:
    """By pairs on an eighth of a sample, and on twice as much while that confirms too little: the
    answers that they tell, and how many runs they took; `before` as above."""
    (values, group), (asked, others) = sample, before
    pairs, answers, spent = None, {}, 0
    for look in doubling(group):
        now = paired(problem, (values[look], group[look]), way[0], way[1], **bar)
        spent += len(now.found.outcome)
        pairs = now if pairs is None else pairs.and_also(now)
        answers = between_distributions(problem, pairs, asked)
        told = [one for one in asked if one.label in answers]
        if len(told) == len(asked) and not _unconfirmed(told, others, answers):
            break
    return answers, spent


def _unconfirmed(asked: list[Functional], others: dict, answers: dict) -> list[Functional]:
    """What is asked whose differences do not confirm a more certain answer."""

    def known(one):
        return {name: of[one.label] for name, of in others.items()}

    own = lambda one: known(one) | {"differences": answers[one.label]}
    return [one for one in asked if not confirms(own(one), "differences")]


def _surer(others: dict, one: Functional, answers: dict[str, Estimate]) -> bool:
    """Whether another method has a more certain answer than differences have."""
    known = [of[one.label].error for of in others.values()]
    return any(np.isfinite(own) and not own >= answers[one.label].error for own in known)


def _met(found: dict[Direction, dict], asked: list[Functional], drawn: MonteCarlo) -> Sensitivity:
    """One answer from the methods' answers, for each direction and statistic."""
    derivatives = {}
    for direction, answers in found.items():
        for one in asked:
            estimates = {method: own[one.label] for method, own in answers.items()}
            key = one.label, direction.label
            derivatives[key] = _in_doubt(drawn, one.response, confirmed(*key, estimates))
    problem = drawn.problem
    units = {one.label: one.unit(problem.units()[one.response]) for one in asked}
    units |= {d.label: problem.variable_units[d.variable] for d in found}
    return Sensitivity(derivatives, drawn, units)


def _in_doubt(drawn: MonteCarlo, response: str, answer: Derivative) -> Derivative:
    """The answer, its verdict with what brings the sample's response in doubt, and what the sample
    lacks of what was asked for."""
    told = filter(None, [answer.verdict, *drawn.doubts_of(response), drawn.unreached])
    return dataclasses.replace(answer, verdict=" ".join(told))


def _shared(problem: AbstractProblem, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A sample of a method's own: values (samples, variables) and scramblings (samples,)."""
    parts = SCRAMBLINGS if samples >= 4 * SCRAMBLINGS else usual_scramblings(samples)
    return draw(problem, samples, seed, scramblings=parts), groups(samples, parts)


def _check(sample: Any, difference_samples: Any, methods: Any, seed: Any) -> None:
    """What a study of derivatives may be asked for."""
    check_methods("sensitivity", methods, METHODS)
    if not isinstance(sample, GivenSample):
        what = "sample of sensitivity (a Monte Carlo study, a campaign, or how many samples)"
        check_count(what, sample)
    check_count("difference_samples of sensitivity", difference_samples)
    check_count("seed of sensitivity", seed, at_least=0)


def _wanted(problem: AbstractProblem, variables: str | Sequence[str] | None) -> list[str]:
    """The names asked for."""
    if variables is None:
        return list(problem.names)
    wanted = [variables] if isinstance(variables, str) else variables
    expect(wanted, (list, tuple), "variables of sensitivity", "names of the problem's variables")
    return list(wanted)
