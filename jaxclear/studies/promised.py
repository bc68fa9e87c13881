"""How far off a response of a mechanism may be by what is promised of its runs."""

from typing import Any

import numpy as np

from jaxclear.errors.observables import GAPS
from jaxclear.integrators.promise import PART_OF, Promise
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.reach import rooms
from jaxclear.multibody.system import longest_arm, prepare
from jaxclear.results.abstract_response import needs_of, unit_of

__all__ = ["promised_of"]

PLACES = "places"


def promised_of(mechanism: Mechanism, promise: Promise, response: Any, size: float) -> float | None:
    """Largest error of a response of this `size`, in its unit, within a promise; None where that
    says nothing of what the response is drawn from. Places are promised beside the
    ways of bodies, of which the response may be a small rest: beside the longest arm of a body and
    a hundred times the widest gap at least, and angles beside 1 rad."""
    part = PART_OF.get(needs_of(response))
    share = None if part is None else promise._asdict()[part]
    if share is None:
        return None
    return share * max(size, _way(mechanism, unit_of(response, mechanism)) if part == PLACES else 0)


def _way(mechanism: Mechanism, unit: str) -> float:
    """Of what goes by a unit the least way that places are measured beside."""
    if unit != "m":
        return 1.0 if unit == "rad" else 0.0
    system = prepare(mechanism)
    widest = float(np.max(np.asarray(rooms(system)), initial=0.0)) if system.bearings else 0.0
    return max(float(longest_arm(system)), GAPS * widest)
