"""The cheapest candidate on a model: scipy's SLSQP, with exact slopes, and the best of a catalogue.

Multipliers are those that best close the conditions of Karush, Kuhn and Tucker at the optimum, by
non-negative least squares, whichever method found it. The relaxed optimum lies between neighbours
of each catalogue: with few of them every combination of the two nearest is tried, the numbers that
are free of catalogues optimised anew for each; with many, one catalogue after the other is set and
moved while that helps.
"""

import itertools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy

from jaxclear.studies.design.cost import Processes
from jaxclear.studies.design.population import AbstractModel, Points
from jaxclear.studies.design.question import TOLERANCE, Question

# A limit broken by less than this share is kept: rounding of the optimiser.
KEPT = 1e-6
# A limit or bound within this share is one that decides.
ACTIVE = 1e-4
STEPS, ACCURACY = 100, 1e-9
# Excess of a limit that is wholly broken [1].
WHOLLY = 1.0
# Combinations that are all tried, at the most; rounds of moving one number after the other.
MOST_COMBINATIONS, SWEEPS = 512, 4
# Of those with a search of their own for what is free.
MOST_SEARCHES = 64


class Candidate(NamedTuple):
    """A candidate: its `place`, `cost`, `excess` (limits,) [1], what it breaks as a whole [1], and
    `multipliers` (limits,): cost saved by an excess of 1."""

    place: np.ndarray
    cost: float
    excess: np.ndarray
    multipliers: np.ndarray

    @property
    def broken(self) -> float:
        """The largest excess [1]; 0 where all limits are kept."""
        return float(max(self.excess.max(initial=0.0), 0.0))

    def better(self, other: "Candidate") -> bool:
        """Whether it is to be preferred: it keeps limits that the other breaks, or is cheaper."""
        if max(self.broken, other.broken) > KEPT:
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

    def told(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cost and excesses, (1 + limits,), and their slopes, (1 + limits, free). A limit whose
        response is no number for some parts is wholly broken."""
        found, slopes = told(self.question, self.model, self.points, jnp.asarray(place))
        found, slopes = np.array(found), np.array(slopes)
        found[1:] += self.shift
        lost = np.isnan(found)
        found[lost], slopes[lost] = WHOLLY, 0.0
        return found, slopes


@eqx.filter_jit
def told(question: Question, model: AbstractModel, points: Points, place: Any):
    """Cost and excesses of a candidate, (1 + limits,), and their slopes, (1 + limits, free)."""

    def both(own):
        found = jnp.append(question.price(own), question.excesses(own, model, points))
        return found, found

    slopes, found = jax.jacrev(both, has_aux=True)(place)
    return found, slopes


def cheapest(search: Search, starts: list[np.ndarray]) -> Candidate:
    """The best that SLSQP finds from several starts."""
    found = [_from_one(search, np.clip(start, search.low, search.high)) for start in starts]
    return best_of(found)


def best_of(candidates: list[Candidate]) -> Candidate:
    """The one that is to be preferred to all others."""
    best = candidates[0]
    for one in candidates[1:]:
        best = one if one.better(best) else best
    return best


def _from_one(search: Search, start: np.ndarray) -> Candidate:
    kept: dict[bytes, tuple] = {}

    def at(place):
        key = place.tobytes()
        if key not in kept:
            kept.clear()
            kept[key] = search.told(place)
        return kept[key]

    whole = abs(at(start)[0][0]) or 1.0
    found = scipy.optimize.minimize(
        lambda place: at(place)[0][0] / whole,
        start,
        jac=lambda place: at(place)[1][0] / whole,
        method="SLSQP",
        bounds=list(zip(search.low, search.high, strict=True)),
        constraints={
            "type": "ineq",
            "fun": lambda place: -at(place)[0][1:],
            "jac": lambda place: -at(place)[1][1:],
        },
        options={"maxiter": STEPS, "ftol": ACCURACY},
    )
    return judged(search, np.clip(found.x, search.low, search.high))


def judged(search: Search, place: np.ndarray) -> Candidate:
    """A place as a candidate, with its multipliers."""
    found, slopes = search.told(place)
    sizes = multipliers(found[1:], slopes, place, search)
    return Candidate(place, float(found[0]), found[1:], sizes)


def multipliers(
    excess: np.ndarray, slopes: np.ndarray, place: np.ndarray, search: Search
) -> np.ndarray:
    """Multipliers (limits,) of the limits that decide, 0 of the others: $\\nabla C = -\\sum
    \\lambda_j \\nabla g_j$, but for places at their ends, with $\\lambda_j \\ge 0$."""
    deciding = np.flatnonzero(excess > -ACTIVE)
    low, high = place - search.low < ACTIVE, search.high - place < ACTIVE
    unit = np.eye(len(place))
    columns = np.concatenate([slopes[1:][deciding], -unit[low], unit[high]]).T
    found = np.zeros(len(excess))
    if columns.size:
        found[deciding] = scipy.optimize.nnls(columns, -slopes[0])[0][: len(deciding)]
    return found


def chosen(search: Search, relaxed: Candidate) -> Candidate:
    """The best candidate by a choice of processes, where costs offer one, and of what catalogues
    have. Of all combinations of processes those are searched that may be cheaper than the best so
    far, by their cost at the widest tolerances (the tighter, the dearer), and that may keep the
    limits; where combinations are too many, one process after the other is changed while that
    helps."""
    spans = _processes(search)
    if not spans:
        return chosen_from_catalogues(search, relaxed)
    tried: dict[tuple[int, ...], Candidate] = {}

    def narrowed(which: tuple[int, ...]) -> Search:
        own = [span[k] for span, k in zip(spans.values(), which, strict=True)]
        return _narrowed(search, dict(zip(spans, own, strict=True)))

    def best(which: tuple[int, ...]) -> Candidate:
        if which not in tried:
            narrow = narrowed(which)
            found = cheapest(narrow, [np.clip(relaxed.place, narrow.low, narrow.high)])
            tried[which] = chosen_from_catalogues(narrow, found)
        return tried[which]

    here = tuple(_nearest(own, relaxed.place[i]) for i, own in spans.items())
    counts = [len(span) for span in spans.values()]
    if np.prod([float(count) for count in counts]) <= MOST_COMBINATIONS:
        every = list(itertools.product(*map(range, counts)))
        searches = [narrowed(which) for which in every]
        least = [float(one.question.price(jnp.asarray(one.high))) for one in searches]
        found = best(here)
        for i in np.argsort(least, kind="stable"):
            cheaper = found.broken > KEPT or least[i] < found.cost
            if cheaper and not _hopeless(searches[i], relaxed.place, list(spans)):
                found = best_of([found, best(every[i])])
        return found
    for _ in range(SWEEPS):
        before = here
        for k, count in enumerate(counts):
            for other in range(count):
                moved = (*here[:k], other, *here[k + 1 :])
                here = moved if best(moved).better(best(here)) else here
        if here == before:
            break
    return best(here)


def _nearest(spans: "list[_Span]", place: float) -> int:
    """The process that holds a place, or whose tolerances are nearest to it."""
    return int(np.argmin([abs(np.clip(place, own.low, own.high) - place) for own in spans]))


def _hopeless(search: Search, place: np.ndarray, widths: list[int]) -> bool:
    """Whether a limit is broken with the finest tolerances, of these numbers, and nothing that may
    move from there lowers its excess, to first order."""
    place = np.clip(place, search.low, search.high)
    place[widths] = search.low[widths]
    found, slopes = search.told(place)
    worst = 1 + int(np.argmax(found[1:]))
    down = np.where(place > search.low, slopes[worst], 0.0) > 0
    up = np.where(place < search.high, slopes[worst], 0.0) < 0
    return bool(found[worst] > KEPT and not (down | up).any())


class _Span(NamedTuple):
    """A process by its number, and the places (low, high) of the tolerances that it holds."""

    process: int
    low: float
    high: float


def _processes(search: Search) -> dict[int, list[_Span]]:
    """The processes that each free tolerance without a catalogue may be made by, by its number."""
    freedom, cost = search.question.freedom, search.question.cost
    found: dict[int, list[_Span]] = {}
    for i, choice in enumerate(freedom.choices):
        own = cost.get(freedom.names[choice.variable]) if isinstance(cost, dict) else None
        if choice.kind != TOLERANCE or choice.offered or not isinstance(own, Processes):
            continue
        spans = []
        for number, ends in enumerate(np.asarray(own.ranges)):
            places = [freedom.place(i, t) for t in np.clip(ends, choice.low, choice.high)]
            low, high = max(places[0], search.low[i]), min(places[1], search.high[i])
            if low <= high and ends[0] <= choice.high:
                spans.append(_Span(number, low, high))
        if spans:
            found[i] = spans
    return found


def _narrowed(search: Search, spans: dict[int, _Span]) -> Search:
    """The same search with these processes held, by the number of the free tolerance."""
    low, high, question = search.low.copy(), search.high.copy(), search.question
    for i, span in spans.items():
        low[i], high[i] = span.low, span.high
        name = question.freedom.names[question.freedom.choices[i].variable]
        held = lambda q, name=name: q.cost[name].held
        question = eqx.tree_at(held, question, jnp.asarray(span.process))
    return search._replace(question=question, low=low, high=high)


def chosen_from_catalogues(search: Search, relaxed: Candidate) -> Candidate:
    """The best candidate whose numbers come from their catalogues; the relaxed one where there are
    none."""
    choices = search.question.freedom.choices
    bound = [i for i, choice in enumerate(choices) if choice.offered]
    if not bound:
        return relaxed
    places = {i: _offered(search, i) for i in bound}
    near = {i: _neighbours(places[i], relaxed.place[i]) for i in bound}
    free = len(bound) < len(choices)
    combinations = int(np.prod([float(len(own)) for own in near.values()]))
    if combinations <= (MOST_SEARCHES if free else MOST_COMBINATIONS):
        held = [dict(zip(bound, own, strict=True)) for own in itertools.product(*near.values())]
        return best_of([_with(search, relaxed, own, free) for own in held])
    return _moved_one_by_one(search, relaxed, places, near, free)


def _moved_one_by_one(search, relaxed, places, near, free):
    # The tighter neighbour first: it keeps the limits wherever less width is the safer.
    held = {i: own[0] for i, own in near.items()}
    best = _with(search, relaxed, held, free)
    for _ in range(SWEEPS):
        before = best
        for i, own in places.items():
            at = int(np.argmin(np.abs(own - held[i])))
            for other in own[max(at - 1, 0) : at + 2]:
                found = _with(search, relaxed, held | {i: other}, free)
                if found.better(best):
                    best, held = found, held | {i: other}
        if best is before:
            break
    return best


def _offered(search: Search, i: int) -> np.ndarray:
    """Places of everything that a catalogue has."""
    return np.array(search.question.freedom.places(i))


def _neighbours(places: np.ndarray, wanted: float) -> np.ndarray:
    """The nearest on either side, tighter first."""
    after = int(np.clip(np.searchsorted(places, wanted), 1, len(places) - 1))
    return places[after - 1 : after + 1]


def _with(search: Search, relaxed: Candidate, held: dict[int, float], free: bool) -> Candidate:
    """A candidate with these numbers held, and the others searched for."""
    numbers = list(held)
    place = relaxed.place.copy()
    place[numbers] = [held[i] for i in numbers]
    if not free:
        return judged(search, place)
    low, high = search.low.copy(), search.high.copy()
    low[numbers] = high[numbers] = place[numbers]
    return cheapest(search._replace(low=low, high=high), [place])
