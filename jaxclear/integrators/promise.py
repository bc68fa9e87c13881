"""The accuracy that a rung promises: the largest errors with which a run by it says nothing.

They are measured beside references (`benchmarks.attack`); the book's page on accuracy shows them.
"""

from typing import NamedTuple


class Promise(NamedTuple):
    """Largest error [1] of `places` (beside the longest way of a body), of places in `gaps` (beside
    the clearance), of mean and peak contact forces, and of `losses` (friction loss, worn volumes
    and depths), each beside itself; None: not promised."""

    places: float | None
    gaps: float | None
    mean_force: float | None
    peak_force: float | None
    losses: float | None


# What a response is drawn from, and the part of a promise that holds of it.
PART_OF = {
    "motion": "places",
    "places in gaps": "gaps",
    "forces": "mean_force",
    "peak forces": "peak_force",
    "wear": "losses",
    "worn depth": "losses",
}
# A journal that may be anywhere in its gap is off by two clearances, of the hundred by which places
# are measured at least.
IN_GAP = 0.02
REFERENCE = Promise(0.001, 0.02, 0.02, 0.05, 0.02)
LOOSE = Promise(0.005, 0.1, 0.1, 0.2, 0.1)
STUDIES = Promise(0.005, 0.05, 0.02, 0.1, 0.02)
RUNGE_KUTTA = Promise(0.005, 0.05, 0.05, 0.2, 0.05)
FIRST_ORDER = Promise(IN_GAP, None, 0.1, 0.3, 0.1)
IMPLICIT = Promise(IN_GAP, None, 0.1, 0.5, 0.1)
RIGID = Promise(IN_GAP, None, 0.1, None, 0.1)
PERMANENT = Promise(IN_GAP, None, 0.05, None, 0.05)
