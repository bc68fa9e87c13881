"""How deep a joint's contacts were between the instants at which that is known, and from when to
when one of them touched.

Depths and rates are known at the saving times; where the run kept its events (touches and releases,
located within its steps) also there, with depth 0. In between, indentation follows Hermite's cubic.
Without events a touch is found within a fraction of a saving interval, and one that begins and ends
within it where its rates tell of it; with events a contact opens and closes at these and nowhere
else. Where some of an interval were not kept, the rest of it is as without.
"""

import itertools
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
import scipy

from jaxclear.formulations.model import Instant
from jaxclear.ground import sparse as sp
from jaxclear.integrators.events import Events
from jaxclear.multibody import contact_point, kinematics
from jaxclear.results.events import ContactEvents, of_contacts, warn_of_lost
from jaxclear.results.state_history import StateHistory, over_time

# What tells of an instant.
EVENT, SAVES, START = "event", "saving times", "start of the run"


class Spell(NamedTuple):
    """From `start` to `stop` [s] a joint is `touching` or not; what tells of the start."""

    start: float
    stop: float
    touching: bool
    known_by: str


class Change(NamedTuple):
    """A contact closes or opens at a `time` [s]."""

    time: float
    closes: bool
    known_by: str


def contact_path(history: StateHistory, name: str, noted: Events | None) -> tuple[Any, list[Spell]]:
    """(largest indentation [m] of a joint over time, when it touches and when not)."""
    time = np.asarray(history.time)
    depths, rates = (np.asarray(each) for each in _indentations(history, name))
    if noted is None:
        path = _deepest(time, depths, rates)
        changes = _changes_between(path, time[0], time[-1])
        first = changes[0].time if changes else time[-1]
        return path, _spells_of(time, changes, bool(path(0.5 * (time[0] + first)) > 0))
    own = [each for each in of_contacts(history, noted) if each.joint == name]
    warn_of_lost(sum(each.lost for each in own), noted)
    paths = [_with_events(time, depths[:, k], rates[:, k], each) for k, each in enumerate(own)]
    knots = np.unique(np.concatenate([path.x for path in paths]))
    at = lambda order: np.stack([path(knots, order) for path in paths], axis=1)
    found = [
        _contact(path, time, depths[:, k], each)
        for k, (path, each) in enumerate(zip(paths, own, strict=True))
    ]
    return _deepest(knots, at(0), at(1)), _joined(time, found)


@eqx.filter_jit
def _indentations(history, name):
    """Indentation [m] of each contact of a joint and its rate [m/s], (time, contacts)."""

    def one(now: Instant):
        bearing = now.model.system.bearings[name]
        relative = kinematics.relative_motion(bearing.closure, now.motions)[2]
        worn = now.model.worn.get(name, {})
        found = contact_point.indentation_rates(bearing.joint, relative, worn)
        return tuple(sp.stack([point[i] for point in found]) for i in (0, 1))

    return over_time(history, one)


def _deepest(time: np.ndarray, depths: np.ndarray, rates: np.ndarray) -> Any:
    """Through the deepest of all contacts at each time."""
    which = np.argmax(depths, axis=1)[:, None]
    own = (np.take_along_axis(each, which, axis=1)[:, 0] for each in (depths, rates))
    return scipy.interpolate.CubicHermiteSpline(time, *own)


def _with_events(time: Any, depth: Any, rate: Any, own: ContactEvents) -> Any:
    """The indentation of a contact through its saving times and its events."""
    times = np.concatenate([time, own.times[own.kept]])
    depth = np.concatenate([depth, np.zeros(len(times) - len(time))])
    rate = np.concatenate([rate, own.rates[own.kept]])
    # Of an event at a saving time the saved numbers are taken.
    times, first = np.unique(times, return_index=True)
    return scipy.interpolate.CubicHermiteSpline(times, depth[first], rate[first])


def _changes_between(path: Any, start: float, stop: float) -> list[Change]:
    """Where a curve passes 0, as far as saving times tell."""
    roots = np.unique(path.roots(discontinuity=False, extrapolate=False))
    roots = roots[np.isfinite(roots) & (roots > start) & (roots < stop)]
    after = np.append(roots, stop)[1:]
    return [
        Change(float(root), bool(path(0.5 * (root + end)) > 0), SAVES)
        for root, end in zip(roots, after, strict=True)
    ]


def _contact(
    path: Any, time: np.ndarray, depth: np.ndarray, own: ContactEvents
) -> tuple[bool, list[Change]]:
    """(whether a contact is closed at first, when it closes and opens)."""
    ends = depth[1:] >= 0
    # A surface that loses depth at a saving time may part there: an interval begins as its end
    # and the number of its events say.
    begins = ends ^ (own.counts.astype(int) % 2 == 1)
    closed, found = bool(begins[0]), []
    for i, (start, stop) in enumerate(itertools.pairwise(time)):
        if begins[i] != closed:
            closed = bool(begins[i])
            found.append(Change(start, closed, SAVES))
        for at in own.times[i][own.kept[i]]:
            closed = not closed
            found.append(Change(float(at), closed, EVENT))
            start = float(at)
        if own.counts[i] > own.kept[i].sum():
            found += _changes_between(path, start, stop)
            closed = bool(ends[i])
    return bool(begins[0]), found


def _joined(time: np.ndarray, contacts: list[tuple[bool, list[Change]]]) -> list[Spell]:
    """When any of a joint's contacts is closed."""
    closed = [first for first, _ in contacts]
    touching, found = any(closed), []
    all_changes = [(change, k) for k, (_, own) in enumerate(contacts) for change in own]
    for change, k in sorted(all_changes, key=lambda each: each[0].time):
        closed[k] = change.closes
        if any(closed) != touching:
            touching = any(closed)
            found.append(Change(change.time, touching, change.known_by))
    return _spells_of(time, found, any(first for first, _ in contacts))


def _spells_of(time: np.ndarray, changes: list[Change], touching: bool) -> list[Spell]:
    """The spells between changes, from the first saving time to the last."""
    marks = [Change(float(time[0]), touching, START), *changes]
    stops = [*(change.time for change in changes), float(time[-1])]
    pairs = zip(marks, stops, strict=True)
    return [Spell(m.time, stop, bool(m.closes), m.known_by) for m, stop in pairs if stop > m.time]
