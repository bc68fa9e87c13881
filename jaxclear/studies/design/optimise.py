"""The cheapest candidate on a model: scipy's SLSQP, with exact slopes.

Multipliers are those that best close the conditions of Karush, Kuhn and Tucker at the optimum, by
non-negative least squares, whichever method found it.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy

from jaxclear.studies.design.population import AbstractModel, Points
from jaxclear.studies.design.question import Question

# A limit broken by less than this share is kept: rounding of the optimiser.
NEGLIGIBLE_EXCESS = 1e-6
# A limit or bound within this share is one that decides.
ACTIVE = 1e-4
STEPS, ACCURACY = 100, 1e-9
# Excess of a limit that is wholly broken [1].
WHOLLY = 1.0


class Candidate(NamedTuple):
    """A candidate: its `place`, `cost`, `excess` (limits,) [1], what it breaks as a whole [1],
    `multipliers` (limits,): cost saved by an excess of 1, and the `slope` (free,) of the cost along
    the limits, which ends of free numbers take."""

    place: np.ndarray
    cost: float
    excess: np.ndarray
    multipliers: np.ndarray
    slope: np.ndarray

    @property
    def broken(self) -> float:
        """The largest excess [1]; 0 where all limits are kept."""
        return float(max(self.excess.max(initial=0.0), 0.0))

    def better(self, other: "Candidate") -> bool:
        """Whether it is to be preferred: it keeps limits that the other breaks, or is cheaper."""
        if max(self.broken, other.broken) > NEGLIGIBLE_EXCESS:
            return self.broken < other.broken
        return self.cost < other.cost


class Search(NamedTuple):
    """What an optimiser works on: `shift` (limits,) [1] is added to every excess, `low` and `high`
    (free,) enclose the places it may take."""

    question: Question
    model: AbstractModel
    points: Points
    shift: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def evaluate(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cost and excesses, (1 + limits,), and their slopes, (1 + limits, free). A limit whose
        response is no number for some parts is wholly broken. Raises `ValueError` where there is a
        number without a slope."""
        values, slopes = linearise(self.question, self.model, self.points, jnp.asarray(place))
        values, slopes = np.array(values), np.array(slopes)
        values[1:] += self.shift
        is_missing = np.isnan(values)
        without_slope = np.argwhere(~np.isfinite(slopes) & ~is_missing[:, None])
        if len(without_slope):
            words = ["cost", *(limit.words() for limit in self.question.limits)]
            which = " or the ".join(words[row] for row in np.unique(without_slope[:, 0]))
            number = self.question.freedom.label(without_slope[0, 1])
            raise ValueError(
                f"the {which} has no finite derivative by the {number}: write its function so that "
                "it has one, or let a response surface stand in, DesignSettings(surface=True)."
            )
        values[is_missing], slopes[is_missing] = WHOLLY, 0.0
        return values, slopes


@eqx.filter_jit
def linearise(question: Question, model: AbstractModel, points: Points, place: Any):
    """Cost and excesses of a candidate, (1 + limits,), and their slopes, (1 + limits, free).

    Args:
        question: cost and limits.
        model: responses of a candidate's parts.
        points: standard normal points of the population.
        place: the candidate, shape (free,), scaled numbers.
    """

    def both(at):
        values = jnp.append(question.price(at), question.excesses(at, model, points))
        return values, values

    try:
        slopes, values = jax.jacrev(both, has_aux=True)(place)
    except ValueError:
        # Loops whose number of turns depends on values have forward derivatives only.
        slopes, values = jax.jacfwd(both, has_aux=True)(place)
    return values, slopes


def cheapest(search: Search, starts: list[np.ndarray]) -> Candidate:
    """The best that SLSQP finds from several starts."""
    best = None
    for start in starts:
        one = _optimise_from(search, np.clip(start, search.low, search.high))
        best = one if best is None or one.better(best) else best
    assert best is not None
    return best


def _optimise_from(search: Search, start: np.ndarray) -> Candidate:
    cache: dict[bytes, tuple] = {}

    def at(place):
        key = place.tobytes()
        if key not in cache:
            cache.clear()
            cache[key] = search.evaluate(place)
        return cache[key]

    scale = abs(at(start)[0][0]) or 1.0
    result = scipy.optimize.minimize(
        lambda place: at(place)[0][0] / scale,
        start,
        jac=lambda place: at(place)[1][0] / scale,
        method="SLSQP",
        bounds=list(zip(search.low, search.high, strict=True)),
        constraints={
            "type": "ineq",
            "fun": lambda place: -at(place)[0][1:],
            "jac": lambda place: -at(place)[1][1:],
        },
        options={"maxiter": STEPS, "ftol": ACCURACY},
    )
    return judged(search, np.clip(result.x, search.low, search.high))


def judged(search: Search, place: np.ndarray) -> Candidate:
    """A place as a candidate, with its multipliers."""
    values, slopes = search.evaluate(place)
    sizes = multipliers(values[1:], slopes, place, search)
    return Candidate(place, float(values[0]), values[1:], sizes, slopes[0] + sizes @ slopes[1:])


def multipliers(
    excess: np.ndarray, slopes: np.ndarray, place: np.ndarray, search: Search
) -> np.ndarray:
    r"""Multipliers (limits,) of the limits that decide, 0 of the others.

    $\nabla C = -\sum \lambda_j \nabla g_j$, but for places at their ends, with $\lambda_j \ge 0$.

    Args:
        excess: of the limits [1], shape (limits,).
        slopes: of cost and excesses by the free numbers, shape (1 + limits, free).
        place: the candidate, shape (free,).
        search: with the ends of the free numbers.
    """
    deciding = np.flatnonzero(excess > -ACTIVE)
    low, high = place - search.low < ACTIVE, search.high - place < ACTIVE
    unit = np.eye(len(place))
    columns = np.concatenate([slopes[1:][deciding], -unit[low], unit[high]]).T
    result = np.zeros(len(excess))
    if columns.size:
        result[deciding] = scipy.optimize.nnls(columns, -slopes[0])[0][: len(deciding)]
    return result
