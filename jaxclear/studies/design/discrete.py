"""From widths and sizes that nobody makes to those of a catalogue.

The relaxed optimum lies between neighbours of each catalogue. With few of them every combination of
the two nearest is tried, the numbers that are free of catalogues optimised anew for each; with
many, one catalogue after the other is set and moved while that helps.
"""

import itertools

import numpy as np

from jaxclear.studies.design.optimise import Candidate, Search, best_of, cheapest, judged

# Combinations that are all tried, at the most; rounds of moving one number after the other.
MOST_COMBINATIONS, SWEEPS = 512, 4
# Of those with a search of their own for what is free.
MOST_SEARCHES = 64


def chosen_from_catalogues(search: Search, relaxed: Candidate) -> Candidate:
    """The best candidate whose numbers come from their catalogues; the relaxed one where there are
    none."""
    choices = search.question.freedom.choices
    bound = [i for i, choice in enumerate(choices) if choice.offered]
    if not bound:
        return relaxed
    places = {i: _places(search, i) for i in bound}
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


def _places(search: Search, i: int) -> np.ndarray:
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
