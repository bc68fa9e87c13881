"""The worst that tolerances allow: `jaxclear.worst_case`, the extremes of a response over the box
of all its variables (the disc, of two that vary so), beside the bound of first order.

From the corner to which the slopes at nominal point, and from the worst of all corners and of a few
hundred points spread over the box, each extreme is climbed to by its gradient (L-BFGS-B). Where a
derivative is refused, because contacts open and close, steps along the variables serve (compass
search). What is found is a value that occurs: the true extreme is at least as far out. Points that
have no answer, of which no mechanism can be built, are counted: the worst may be that.

Source: Byrd, Lu, Nocedal & Zhu 1995, SIAM J. Sci. Comput. 16, 1190, doi:10.1137/0916069; compass
search: Kolda, Lewis & Torczon 2003, SIAM Rev. 45, 385, doi:10.1137/S003614450242889.
"""

import itertools
import math
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_flags, check_number
from jaxclear.ground.printing import AbstractShown, with_text_repr
from jaxclear.integrators import Outcome
from jaxclear.integrators.checks import Checks
from jaxclear.studies.answer import RESPONSE, TABLE, VARIABLE, AbstractAnswer, Column, Stated
from jaxclear.studies.distribution.base import END_SCORE
from jaxclear.studies.infinite_responses import replace_infinite, successes, why_unanswered
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_warnings import by_kind, codes_of, concerning
from jaxclear.studies.sampling import check_sampled
from jaxclear.studies.scrambling import scrambled_shares
from jaxclear.studies.store.batch import evaluate_all
from jaxclear.studies.store.store import stored

# Points from which each extreme is climbed to, the corner of the slopes apart.
STARTS = 4
# Corners of the box are all asked where there are no more, those of ten variables.
MOST_CORNERS = 2**10
# So many times the width of a box is beyond it in any direction.
FAR = 1e3
# A compass search ends when its steps are this share of the box, or after so many rounds.
SHORTEST, MOST_ROUNDS = 1e-3, 60


@with_text_repr
class Extreme(AbstractShown):
    """The least or largest value found of a response [its unit], `values` (variables,) where it
    occurs, and the value of first order there: nominal and slopes times deviations, nan where
    there are no slopes."""

    value: float
    values: np.ndarray
    first_order: float

    def _summary(self):
        return f"{self.value:.6g} (of first order {self.first_order:.6g})"


class WorstCase(AbstractAnswer):
    """The extremes of every response over the box from `low` to `high` (variables,), and its
    `nominal` values. Of the `points` asked over the box, its corners among them, `failed` (failed,
    variables) have no answer; `warnings` say so, and which extremes are those of runs that warn."""

    problem: Problem
    low: np.ndarray
    high: np.ndarray
    nominal: dict[str, float]
    least: dict[str, Extreme]
    largest: dict[str, Extreme]
    failed: np.ndarray
    points: int = eqx.field(static=True)
    runs: int = eqx.field(static=True)
    warnings: tuple[str, ...] = eqx.field(static=True, default=())

    def sentence(self) -> str:
        """Between which values each response lies over the box, as far as the runs found."""
        units = self.problem.units()
        sentences = []
        for name in self.nominal:
            ends = f"{self.least[name].value:.4g} and {self.largest[name].value:.4g} {units[name]}"
            ends = ends.removesuffix(" 1")
            sentences.append(f'"{name}" lies between {ends} within the tolerances.')
        return " ".join(sentences)

    def _stated(self):
        problem, ends = self.problem, {"least": self.least, "largest": self.largest}
        names, over = list(self.nominal), (RESPONSE, "end")
        grid = lambda read: [[read(points[name]) for points in ends.values()] for name in names]
        columns = {
            "unit": Column((RESPONSE,), {n: problem.units()[n] for n in names}),
            "nominal": Column((RESPONSE,), self.nominal),
        }
        for end, points in ends.items():
            rows = {
                end: lambda one: one.value,
                f"{end} of first order": lambda one: one.first_order,
            }
            units = dict.fromkeys(rows, "")
            for i, name in enumerate(problem.names):
                rows[f"{end}: {name}"] = lambda one, i=i: float(one.values[i])
                units[f"{end}: {name}"] = problem.variable_units[i]
            for label, read in rows.items():
                values = {name: read(points[name]) for name in names}
                columns[label] = Column((RESPONSE,), values, units[label], only=TABLE)
        place = grid(lambda one: one.values)
        columns |= {
            "value": Column(over, grid(lambda one: one.value), "", "found by runs"),
            "first order": Column(over, grid(lambda one: one.first_order), "", "by slopes"),
            "place": Column((*over, VARIABLE), place, "", "where it is met"),
            "low": Column((VARIABLE,), self.low, "", "end of the box"),
            "high": Column((VARIABLE,), self.high, "", "end of the box"),
            "variable unit": Column((VARIABLE,), list(problem.variable_units)),
            "end": Column(("end",), list(ends)),
            VARIABLE: Column((VARIABLE,), list(problem.names)),
        }
        numbers = {"runs": self.runs, "points": self.points, "failed": len(self.failed)}
        return Stated("worst case", columns, problem, self.warnings, numbers, labelled=False)


@answering
@stored("a worst case")
def worst_case(
    problem: Problem,
    *,
    samples: int = 256,
    sigmas: float = 3.0,
    seed: int = 0,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> WorstCase:
    """Find the smallest and largest value of every response over the box of the variables.

    The box reaches to the ends of distributions that have ends. Points that cannot be built or fail
    are in no extreme; `failed` lists them. The probability of an extreme is the business of
    `jaxclear.monte_carlo`.

    Args:
        problem: the problem.
        samples: number of points spread over the box at first, besides all corners for up to ten
            variables; 256 by default.
        sigmas: half width of the box in standard normal scores for distributions without ends [1];
            3 by default.
        seed: seed of the random numbers; 0 by default.
        store: folder that keeps the runs; None (default) for none.
        progress_bar: whether to show the progress; False by default.

    Returns:
        The `WorstCase`.

    Raises:
        ValueError: if an argument is wrong.
    """
    check_sampled(problem, samples, seed)
    check_number("sigmas of worst_case", sigmas, above=0)
    check_flags("worst_case", progress_bar=progress_bar)
    check_count("samples of worst_case", samples)
    low, high = box(problem, sigmas)
    spread = scrambled_shares(samples, len(low), np.random.default_rng(seed))
    nominal = np.asarray(problem.nominal())
    search = Search(problem, low, high, progress_bar)
    corners = search.confined(corners_of(low, high))
    points = np.concatenate([nominal[None], corners, search.confined(low + spread * (high - low))])
    responses = search.responses(points)
    # Before others are asked.
    unanswered, failed = search.unanswered(points, len(corners)), points[search.failed]
    extremes: dict[int, dict] = {-1: {}, 1: {}}
    for name in problem.response_names:
        slopes = search.slopes(name, nominal)
        for sign, extreme in extremes.items():
            corner = search.corner(sign * slopes, nominal)
            first = float(responses[name][0] + slopes @ (corner - nominal))
            order = np.argsort(np.where(np.isnan(responses[name]), np.inf, -sign * responses[name]))
            starts = [corner, *points[order[:STARTS]]]
            extreme[name] = search.climbed(name, sign, starts, first)
    at_nominal = {name: float(responses[name][0]) for name in problem.response_names}
    least, largest = extremes[-1], extremes[1]
    warnings = unanswered + search.warnings(nominal, {"least": least, "largest": largest})
    values = at_nominal, least, largest, failed
    return WorstCase(problem, low, high, *values, len(points), search.runs, warnings)


def corners_of(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """All corners of a box (corners, variables); none where they are too many."""
    ends = [np.unique(pair) for pair in zip(low, high, strict=True)]
    if math.prod(len(pair) for pair in ends) > MOST_CORNERS:
        return np.zeros((0, len(low)))
    return np.array(list(itertools.product(*ends)))


def box(problem: Problem, sigmas: float) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest value of each variable, (variables,) each."""
    nominal, ends = np.asarray(problem.nominal()), []
    for distribution in problem.inputs.distributions:
        cut = np.array(distribution.end_densities()) > 0
        scores = np.where(cut | (not distribution.is_continuous()), END_SCORE, sigmas)
        ends.append(np.asarray(distribution.of_score(np.array([-1.0, 1.0]) * scores)))
    for first, joint in problem.inputs.joints:
        for i, distribution in enumerate(joint.marginals(), first):
            # To the last digit: the edge of a disc is its worst.
            last = np.asarray(distribution.quantile(jnp.array([0.0, 1.0])))
            ends[i] = np.where(np.isfinite(last), last, ends[i])
    low, high = np.array(ends).T
    return nominal + low, nominal + high


def confined(problem: Problem, values: Any) -> Any:
    """Values (..., variables) in the box brought to where numbers that vary together can be."""
    joints, nominal = problem.inputs.joints, problem.nominal()
    for first, joint_law in joints:
        part = slice(first, first + len(joint_law.parts))
        near = joint_law.nearest(values[..., part] - nominal[part])
        values = values.at[..., part].set(nominal[part] + near)
    return values


@eqx.filter_jit
def _value_and_slopes(problem, name, values):
    def response(values):
        result = problem.evaluate(confined(problem, values))
        return result.responses[name], result

    slopes, result = jax.jacfwd(response, has_aux=True)(values)
    return result.responses[name], slopes, result.outcome, result.checks


class Search:
    """Runs a problem in search of extremes, and counts the runs."""

    def __init__(self, problem: Problem, low, high, progress_bar: bool):
        self.problem, self.low, self.high, self.bar = problem, low, high, progress_bar
        self.joints = problem.inputs.joints
        self.runs = 0
        # Of the points asked last: whether one has no answer, and how and when [s] each ended.
        self.failed, self.ends = np.zeros(0, bool), (np.zeros(0, int), np.zeros(0))
        # Of what the runs warn, by their values.
        self.codes: dict[bytes, int] = {}
        self.differentiable = not any(problem.description.derivative)

    def confined(self, points: np.ndarray) -> np.ndarray:
        """Points (..., variables) of the box brought to where numbers that vary together can be."""
        if not self.joints:
            return points
        return np.asarray(confined(self.problem, jnp.asarray(points)))

    def corner(self, slopes: np.ndarray, nominal: np.ndarray) -> np.ndarray:
        """The farthest point along slopes (variables,)."""
        high, low = self.high, self.low
        corner = np.where(slopes > 0, high, np.where(slopes < 0, low, nominal))
        for first, joint_law in self.joints:
            part = slice(first, first + len(joint_law.parts))
            steep = np.abs(slopes[part]).max()
            away = slopes[part] / (steep or 1.0) * FAR * (high - low)[part].max()
            corner[part] = nominal[part] + np.asarray(joint_law.nearest(jnp.asarray(away)))
        return np.clip(corner, low, high)

    def responses(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """By name at points (points, variables); nan where one failed."""
        self.runs += len(points)
        result = evaluate_all(
            self.problem, jnp.asarray(points), progress_bar=self.bar, label="worst case"
        )
        self._keep(points, result.checks)
        good, responses = successes(self.problem, result.outcome, result.responses)
        self.failed, self.ends = ~good, (np.asarray(result.outcome), np.asarray(result.ended))
        return responses

    def unanswered(self, points: np.ndarray, corners: int) -> tuple[str, ...]:
        """How many of the points asked last have no answer, the first of which is the nominal one
        and the next are `corners`, and why the first of them has none."""
        failures = np.flatnonzero(self.failed)
        if not len(failures):
            return ()
        outcome, ended = (end[failures[0]] for end in self.ends)
        why = why_unanswered(self.problem, outcome, ended).rstrip(".")
        at = int(np.sum((failures > 0) & (failures <= corners)))
        among = f", {at} of its {corners} corners among them," if corners else ""
        return (
            f"{len(failures)} of {len(points)} points within the tolerances{among} cannot be built "
            f"or have no answer (the first of them: {why}). The least and the largest are those of "
            "the part that has, and may lie on its edge.",
        )

    def _keep(self, points: np.ndarray, checks: Checks) -> None:
        codes = codes_of(checks, len(points)).tolist()
        self.codes |= zip((point.tobytes() for point in points), codes, strict=True)

    def warnings(self, nominal: np.ndarray, ends: dict[str, dict[str, Extreme]]) -> tuple[str, ...]:
        """Which of the nominal values and the extremes are of runs that warn of what concerns
        them, and of what."""
        sentences = []
        for name in self.problem.response_names:
            places = {"nominal": nominal} | {end: data[name].values for end, data in ends.items()}
            for end, at in places.items():
                codes = np.array([self.codes.get(at.tobytes(), 0)])
                kinds = by_kind(concerning(self.problem, name, codes))
                if kinds:
                    labels = ", ".join(check.label for check in kinds)
                    sentences.append(f'The run of the {end} "{name}" warns ({labels}).')
        return tuple(sentences)

    def slopes(self, name: str, at: np.ndarray) -> np.ndarray:
        """Of a response at a point (variables,): derivatives, or differences across the box where
        these are refused."""
        if self.differentiable:
            self.runs += 1
            slopes = np.asarray(_value_and_slopes(self.problem, name, jnp.asarray(at))[1])
            return np.where(np.isfinite(slopes), slopes, 0.0)
        both = np.stack([np.where(np.eye(len(at)), end, at) for end in (self.low, self.high)])
        ends = replace_infinite(self.responses(both.reshape(-1, len(at)))[name].reshape(2, -1))
        width = self.high - self.low
        return np.nan_to_num((ends[1] - ends[0]) / np.where(width > 0, width, 1.0))

    def climbed(self, name: str, sign: int, starts: list, first: float) -> Extreme:
        """The extreme to which climbs from several starts lead.

        Args:
            name: of the response.
            sign: 1 for the largest, -1 for the least.
            starts: values (variables,) at which climbs begin.
            first: extreme by first order.
        """
        climb = self._by_gradient if self.differentiable else self._by_compass
        ends = [climb(name, sign, np.asarray(start)) for start in starts]
        ends = [(value, at) for value, at in ends if not np.isnan(value)]
        if not ends:
            return Extreme(np.nan, np.full(len(self.low), np.nan), first)
        value, at = max(ends, key=lambda end: sign * end[0])
        return Extreme(float(value), at, first)

    def _by_gradient(self, name, sign, start):
        width = np.where(self.high > self.low, self.high - self.low, 1.0)
        size = 1.0
        best = (np.nan, start)

        def evaluate(share):
            nonlocal best
            at = np.clip(self.low + share * width, self.low, self.high)
            outputs = _value_and_slopes(self.problem, name, jnp.asarray(at))
            value, slopes, outcome, checks = outputs
            at = self.confined(at)
            self.runs += 1
            self._keep(at[None], checks)
            if outcome != Outcome.REACHED or not np.isfinite(value):
                return np.inf, np.zeros(len(at))
            if not sign * value <= sign * best[0]:
                best = (float(value), at)
            return -sign * float(value) / size, -sign * np.asarray(slopes) * width / size

        first, slope = evaluate((start - self.low) / width)
        # Numbers of any unit: what the box can change is 1.
        size = float(np.sum(np.abs(slope))) or 1.0
        if np.isfinite(first):
            bounds = [(0.0, float(above)) for above in self.high > self.low]
            scipy.optimize.minimize(
                evaluate, (start - self.low) / width, jac=True, method="L-BFGS-B", bounds=bounds
            )
        return best

    def _by_compass(self, name, sign, start):
        value = float(self.responses(start[None])[name][0])
        step, count = 0.25, len(start)
        for _ in range(MOST_ROUNDS):
            if step < SHORTEST:
                break
            moves = step * (self.high - self.low) * np.concatenate([np.eye(count), -np.eye(count)])
            around = self.confined(np.clip(start + moves, self.low, self.high))
            values = self.responses(around)[name]
            best = 0 if np.isnan(values).all() else int(np.nanargmax(sign * values))
            if np.isnan(value) or sign * values[best] > sign * value:
                value, start = float(values[best]), around[best]
            else:
                step *= 0.5
        return value, start
