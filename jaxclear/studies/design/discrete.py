"""The best of what can only be chosen: sizes of catalogues, and processes where costs offer them.

Each choice is an option, the places that it leaves a number: one for a size, a range for a process.
Of all combinations (of a catalogue the two sizes about the relaxed optimum, of a fit all classes,
whose means move with them) those are searched that may be cheaper than the best so far, by their
cost at the widest tolerances (the tighter, the dearer), and that may keep the limits. Where these
are too many, one number after the other is changed while that helps.
"""

import itertools
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxclear.studies.design.cost import Processes
from jaxclear.studies.design.optimise import NEGLIGIBLE_EXCESS, Candidate, Search, cheapest, judged
from jaxclear.studies.design.question import TOLERANCE

# Combinations that are all tried, at the most; where none is left out by its cost, and other
# numbers are free; rounds of changing one number after the other.
MOST_COMBINATIONS, MOST_UNBOUNDED, SWEEPS = 512, 64, 4


class Option(NamedTuple):
    """The places (low, high) that a choice leaves a free number, and the number of its process;
    None of a size in a catalogue."""

    low: float
    high: float
    process: int | None = None


def chosen(search: Search, relaxed: Candidate) -> Candidate:
    """The best candidate whose numbers can be had; the relaxed one where all can."""
    options = _list_options(search)
    if not options:
        return relaxed
    tried: dict[tuple[int, ...], Candidate] = {}

    def narrowed(which: tuple[int, ...]) -> Search:
        pairs = zip(options.items(), which, strict=True)
        return _narrow_search(search, {i: row[k] for (i, row), k in pairs})

    def best(which: tuple[int, ...]) -> Candidate:
        if which not in tried:
            one = narrowed(which)
            place = np.clip(relaxed.place, one.low, one.high)
            fixed = np.array_equal(one.low, one.high)
            tried[which] = judged(one, place) if fixed else cheapest(one, [place])
        return tried[which]

    choices = search.question.freedom.choices
    near = [_near(row, relaxed.place[i], bool(choices[i].nominals)) for i, row in options.items()]
    here = tuple(row[0] for row in near)
    bounded = isinstance(search.question.cost, dict)
    free = len(options) < len(search.low)
    most = MOST_COMBINATIONS if bounded or not free else MOST_UNBOUNDED
    if np.prod([float(len(row)) for row in near]) <= most:
        combinations = list(itertools.product(*near))
        searches = [narrowed(which) for which in combinations]
        price = lambda one: float(one.question.price(jnp.asarray(one.high)))
        least = [price(one) if bounded else -np.inf for one in searches]
        result = best(here)
        for i in np.argsort(least, kind="stable"):
            cheaper = result.broken > NEGLIGIBLE_EXCESS or least[i] < result.cost
            if cheaper and not _is_hopeless(searches[i], relaxed.place, list(options)):
                other = best(combinations[i])
                result = other if other.better(result) else result
        return result
    for _ in range(SWEEPS):
        before = here
        for k, row in enumerate(options.values()):
            neighbours = range(max(here[k] - 1, 0), min(here[k] + 2, len(row)))
            for index in neighbours if row[0].process is None else near[k]:
                moved = (*here[:k], int(index), *here[k + 1 :])
                here = moved if best(moved).better(best(here)) else here
        if here == before:
            break
    return best(here)


def _list_options(search: Search) -> dict[int, list[Option]]:
    """What each free number may be chosen from, by its number."""
    freedom, cost = search.question.freedom, search.question.cost
    options_of: dict[int, list[Option]] = {}
    for i, choice in enumerate(freedom.choices):
        cost_term = cost.get(freedom.names[choice.variable]) if isinstance(cost, dict) else None
        if choice.offered:
            options_of[i] = [Option(place, place) for place in freedom.places(i)]
        elif choice.kind == TOLERANCE and isinstance(cost_term, Processes):
            options = []
            for number, ends in enumerate(np.asarray(cost_term.ranges)):
                places = [freedom.place(i, t) for t in np.clip(ends, choice.low, choice.high)]
                low, high = max(places[0], search.low[i]), min(places[1], search.high[i])
                if low <= high and ends[0] <= choice.high:
                    options.append(Option(low, high, number))
            options_of |= {i: options} if options else {}
    return options_of


def _near(options: list[Option], place: float, every: bool) -> list[int]:
    """Of a catalogue the sizes on either side of a place, the tighter first, which keeps limits
    wherever less width is the safer; all processes, or all sizes if `every`, the one that holds it
    or is nearest to it first."""
    if options[0].process is None and not every:
        after = int(np.searchsorted([option.low for option in options], place))
        after = min(max(after, 1), len(options) - 1)
        return [after - 1, after]
    away = [abs(np.clip(place, option.low, option.high) - place) for option in options]
    return np.argsort(away, kind="stable").tolist()


def _narrow_search(search: Search, taken: dict[int, Option]) -> Search:
    """The same search with these options, by the number of the free number."""
    low, high, question = search.low.copy(), search.high.copy(), search.question
    for i, option in taken.items():
        low[i], high[i] = option.low, option.high
        if option.process is not None:
            name = question.freedom.names[question.freedom.choices[i].variable]
            where_held = lambda q, name=name: q.cost[name].fixed_process
            question = eqx.tree_at(where_held, question, jnp.asarray(option.process))
    return search._replace(question=question, low=low, high=high)


def _is_hopeless(search: Search, place: np.ndarray, chosen: list[int]) -> bool:
    """Whether a limit is broken with the finest of these tolerances, and nothing that may move from
    there lowers its excess, to first order."""
    place = np.clip(place, search.low, search.high)
    place[chosen] = search.low[chosen]
    values, slopes = search.evaluate(place)
    worst = 1 + int(np.argmax(values[1:]))
    down = np.where(place > search.low, slopes[worst], 0.0) > 0
    up = np.where(place < search.high, slopes[worst], 0.0) < 0
    return bool(values[worst] > NEGLIGIBLE_EXCESS and not (down | up).any())
