"""How the journal of a clearance joint moves: free flight, impact, contact, and from when to when;
and touches and releases as a table.

A joint touches where one of its indentations is above 0. Touching begins as an impact, and lasts as
one until the bodies have come back from it: the indentation's rate, the approach speed at first,
falls to 0 and turns, and the impact ends where it turns again or where they part; or, where they do
not come back, as soon as the rate has fallen to 0. What lasts beyond is contact. 0 is `SHARE` of
the approach speed. Source: the three modes of Ravn 1998, Multibody Syst. Dyn. 2, 1,
doi:10.1023/A:1009759826529.

Depths and rates are known at the saving times; where the run kept its events (located within its
steps) also there, with depth 0. In between, indentation follows Hermite's cubic. Without events a
touch is found within a fraction of a saving interval; with events a contact opens and closes at
these and nowhere else. Where some of an interval were not kept, the rest of it is as without.
"""

import enum
import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import scipy

from jaxclear.formulations.model import Instant
from jaxclear.ground import sparse as sp
from jaxclear.ground.printing import with_text_repr
from jaxclear.ground.table import as_table
from jaxclear.ground.warning import warn
from jaxclear.integrators.events import Events
from jaxclear.multibody import contact_point, kinematics
from jaxclear.multibody.topology import moves_along
from jaxclear.native.compiled import compiled_quickly
from jaxclear.results.histories import check_contact_joint, contact
from jaxclear.results.state_history import StateHistory, over_time

COLUMNS = ["time [s]", "joint", "contact", "event"]


def event_table(history: StateHistory, noted: Events | None, names: tuple[str, ...]) -> Any:
    """Touches and releases as a table, in the order of time; warns where some were not stored.

    Args:
        history: states of the run.
        noted: events that the run stored; None: none.
        names: joints; empty: all.

    Raises:
        ValueError: the run stored no events, or a joint is unknown.
    """
    if noted is None:
        raise ValueError(
            "this run kept no touches and releases; simulate(..., save=Saving(events=10)) keeps 10 "
            "of each contact between two saving times."
        )
    for name in names:
        if name not in history.layout().plays:
            check_contact_joint(history, name)
    mechanism, rows, missing = history.mechanism, [], 0
    for c in events_by_contact(history, noted):
        if names and c.joint not in names:
            continue
        missing += c.missing
        for time, rate in zip(c.times[c.is_saved], c.rates[c.is_saved], strict=True):
            event = "touch" if rate > 0 else "release"
            rows.append((time, c.joint, c.contact, event, abs(rate)))
    warn_of_missing(missing, noted)
    unit = {name: _unit_of_rate(mechanism, name) for name in {row[1] for row in rows}}
    units = sorted({*unit.values()}) or ["m/s"]
    table = as_table(sorted(rows), columns=[*COLUMNS, f"speed [{' or '.join(units)}]"])
    return table if len(units) == 1 else table.assign(unit=[unit[row[1]] for row in sorted(rows)])


def _unit_of_rate(mechanism: Any, name: str) -> str:
    """Of the indentation of a joint's contacts, or of the twist of a coupling."""
    coupling = mechanism.couplings.get(name)
    return "m/s" if coupling is None or moves_along(mechanism, coupling) else "rad/s"


class ContactEvents(NamedTuple):
    """Events of one contact: `times` [s] and `rates` [m/s] (intervals, most) and how many there
    were in each interval (`counts`), kept or not."""

    joint: str
    contact: str
    times: np.ndarray
    rates: np.ndarray
    counts: np.ndarray

    @property
    def is_saved(self) -> np.ndarray:
        """Which places of `times` hold an event."""
        return np.arange(self.times.shape[1]) < self.counts[:, None]

    @property
    def missing(self) -> int:
        """How many were not kept."""
        return int(self.counts.sum()) - int(self.is_saved.sum())


# The flanks of play: where the twist is largest, and least.
FLANKS = ("upper", "lower")


def events_by_contact(history: StateHistory, noted: Events) -> Iterator[ContactEvents]:
    """The events of every contact of a run, in the order of its joints."""
    times, rates, counts = (np.asarray(part) for part in noted)
    bearings = history.model().system.bearings.items()
    places = [(name, each) for name, bearing in bearings for each in bearing.joint.contact_names()]
    places += [(name, each) for name in history.layout().plays for each in FLANKS]
    for k, (joint, name) in enumerate(places):
        yield ContactEvents(joint, name, times[:, k], rates[:, k], counts[:, k])


def warn_of_missing(missing: int, noted: Events) -> None:
    """Warns where some events were not kept."""
    if missing:
        warn(
            f"{missing} touches and releases were not kept: more than {noted.times.shape[2]} of a "
            "contact fell between two saving times. Give Saving more events, or save more often.",
        )


# What tells of an instant.
EVENT, SAVES, START = "event", "saving times", "start of the run"


class Spell(NamedTuple):
    """From `start` to `stop` [s] a joint is `touching` or not; what tells of the start."""

    start: float
    stop: float
    touching: bool
    source: str


class Change(NamedTuple):
    """A contact closes or opens at a `time` [s]."""

    time: float
    closes: bool
    source: str


def contact_path(history: StateHistory, name: str, noted: Events | None) -> tuple[Any, list[Spell]]:
    """Largest indentation [m] of a joint as a function of time, and its spells of contact.

    Args:
        history: states of the run.
        name: clearance joint.
        noted: events that the run stored, which give exact times; None: interpolated.
    """
    time = np.asarray(history.time)
    depths, rates = (np.asarray(each) for each in _indentations(history, name))
    if noted is None:
        path = _path_of_deepest(time, depths, rates)
        changes = _zeros_between(path, time[0], time[-1])
        first = changes[0].time if changes else time[-1]
        return path, _spells_between(time, changes, bool(path(0.5 * (time[0] + first)) > 0))
    contacts = [each for each in events_by_contact(history, noted) if each.joint == name]
    warn_of_missing(sum(each.missing for each in contacts), noted)
    paths = [_with_events(time, depths[:, k], rates[:, k], each) for k, each in enumerate(contacts)]
    knots = np.unique(np.concatenate([path.x for path in paths]))
    at = lambda order: np.stack([path(knots, order) for path in paths], axis=1)
    changes_of = [
        _contact_changes(path, time, depths[:, k], each)
        for k, (path, each) in enumerate(zip(paths, contacts, strict=True))
    ]
    return _path_of_deepest(knots, at(0), at(1)), _join_contacts(time, changes_of)


@compiled_quickly
def _indentations(history, name):
    """Indentation [m] of each contact of a joint and its rate [m/s], (time, contacts)."""

    def one(now: Instant):
        bearing = now.model.system.bearings[name]
        relative = kinematics.relative_motion(bearing.closure, now.motions)[2]
        worn = now.model.worn.get(name, {})
        points = contact_point.point_motions(bearing.joint, relative, worn)
        return tuple(sp.stack([point[i] for point in points]) for i in (0, 1))

    return over_time(history, one)


def _path_of_deepest(time: np.ndarray, depths: np.ndarray, rates: np.ndarray) -> Any:
    """Through the deepest of all contacts at each time."""
    which = np.argmax(depths, axis=1)[:, None]
    along = (np.take_along_axis(each, which, axis=1)[:, 0] for each in (depths, rates))
    return scipy.interpolate.CubicHermiteSpline(time, *along)


def _with_events(time: Any, depth: Any, rate: Any, events_of: ContactEvents) -> Any:
    """The indentation of a contact through its saving times and its events."""
    times = np.concatenate([time, events_of.times[events_of.is_saved]])
    depth = np.concatenate([depth, np.zeros(len(times) - len(time))])
    rate = np.concatenate([rate, events_of.rates[events_of.is_saved]])
    # Of an event at a saving time the saved numbers are taken.
    times, first = np.unique(times, return_index=True)
    return scipy.interpolate.CubicHermiteSpline(times, depth[first], rate[first])


def _zeros_between(path: Any, start: float, stop: float) -> list[Change]:
    """Where a curve passes 0, as far as saving times tell."""
    roots = np.unique(path.roots(discontinuity=False, extrapolate=False))
    roots = roots[np.isfinite(roots) & (roots > start) & (roots < stop)]
    after = np.append(roots, stop)[1:]
    return [
        Change(float(root), bool(path(0.5 * (root + end)) > 0), SAVES)
        for root, end in zip(roots, after, strict=True)
    ]


def _contact_changes(
    path: Any, time: np.ndarray, depth: np.ndarray, events_of: ContactEvents
) -> tuple[bool, list[Change]]:
    """(whether a contact is closed at first, when it closes and opens)."""
    ends = depth[1:] >= 0
    # A surface that loses depth at a saving time may part there: an interval begins as its end
    # and the number of its events say.
    is_closed_at_start = ends ^ (events_of.counts.astype(int) % 2 == 1)
    closed, changes = bool(is_closed_at_start[0]), []
    for i, (start, stop) in enumerate(itertools.pairwise(time)):
        if is_closed_at_start[i] != closed:
            closed = bool(is_closed_at_start[i])
            changes.append(Change(start, closed, SAVES))
        for at in events_of.times[i][events_of.is_saved[i]]:
            closed = not closed
            changes.append(Change(float(at), closed, EVENT))
            start = float(at)
        if events_of.counts[i] > events_of.is_saved[i].sum():
            changes += _zeros_between(path, start, stop)
            closed = bool(ends[i])
    return bool(is_closed_at_start[0]), changes


def _join_contacts(time: np.ndarray, contacts: list[tuple[bool, list[Change]]]) -> list[Spell]:
    """When any of a joint's contacts is closed."""
    closed = [first for first, _ in contacts]
    touching, changes = any(closed), []
    all_changes = [(change, k) for k, (_, its) in enumerate(contacts) for change in its]
    for change, k in sorted(all_changes, key=lambda each: each[0].time):
        closed[k] = change.closes
        if any(closed) != touching:
            touching = any(closed)
            changes.append(Change(change.time, touching, change.source))
    return _spells_between(time, changes, any(first for first, _ in contacts))


def _spells_between(time: np.ndarray, changes: list[Change], touching: bool) -> list[Spell]:
    """The spells between changes, from the first saving time to the last."""
    marks = [Change(float(time[0]), touching, START), *changes]
    stops = [*(change.time for change in changes), float(time[-1])]
    pairs = zip(marks, stops, strict=True)
    return [Spell(m.time, stop, bool(m.closes), m.source) for m, stop in pairs if stop > m.time]


# Share of the approach speed below which a journal counts as stopped.
SHARE = 0.05


class Mode(enum.IntEnum):
    """How a journal moves in its bearing: free flight, impact or contact."""

    FREE_FLIGHT = 0
    IMPACT = 1
    CONTACT = 2

    @property
    def label(self) -> str:
        """The mode in words."""
        return self.name.lower().replace("_", " ")


@with_text_repr
class Phase(NamedTuple):
    """A time interval in which a journal moves in one mode.

    Args:
        start: start [s].
        stop: end [s].
        mode: free flight, impact or contact.
        approach: speed at the touch [m/s] of an impact; nan for others.
        known_by: source of the start: an event of the run, its saving times, or the start of the
            run.
    """

    start: float
    stop: float
    mode: Mode
    approach: float
    source: str

    def __str__(self) -> str:
        speed = f" at {self.approach:.4g} m/s" if self.mode == Mode.IMPACT else ""
        return f"{self.mode.label}{speed} from {self.start:.6g} to {self.stop:.6g} s"


INSTANTS = {
    True: "Touches and releases are events of the run, located within its steps; that an impact "
    "turns into contact is told by cubics through events and saving times.",
    False: "Instants are those of cubics between the saving times; "
    "simulate(..., save=Saving(events=10)) keeps those of the run's steps.",
}


def phases(history: StateHistory, name: str, noted: Events | None = None) -> list[Phase]:
    """Phases of free flight, impact and contact of a joint, one after the other.

    Args:
        history: states of the run.
        name: clearance joint.
        noted: events that the run stored, which give exact times; None: interpolated.

    Raises:
        ValueError: the joint has no contacts.
    """
    check_contact_joint(history, name)
    time = np.asarray(history.time)
    if history.formulation.forces_are_means:
        return _phases_of_forces(time, np.asarray(contact(history, name).normal_force).sum(axis=1))
    if name not in history.mechanism.topology.clearances:
        # An ideal joint that rubs.
        return [Phase(time[0], time[-1], Mode.CONTACT, np.nan, START)]
    path, spells = contact_path(history, name, noted)
    result: list[Phase] = []
    for start, stop, touching, source in spells:
        if not touching:
            result.append(Phase(start, stop, Mode.FREE_FLIGHT, np.nan, source))
        elif source == START:
            result.append(Phase(start, stop, Mode.CONTACT, np.nan, source))
        else:
            result += _phases_in_contact(path, start, stop, source)
    return _merge_phases(result)


def table(history: StateHistory, name: str, noted: Events | None = None) -> Any:
    """The phases of a joint as a pandas table.

    Args:
        history: states of the run.
        name: clearance joint.
        noted: events that the run stored; None: none.
    """
    listed = phases(history, name, noted)
    rows = [(p.start, p.stop, p.mode.label, p.approach, p.source) for p in listed]
    labels = ["from [s]", "to [s]", "mode", "approach speed [m/s]", "start known by"]
    return _add_source(as_table(rows, columns=labels), noted)


def combined(history: StateHistory, names: tuple[str, ...], noted: Events | None = None) -> Any:
    """The phases of several joints as a pandas table, with a row whenever one changes.

    Args:
        history: states of the run.
        names: clearance joints.
        noted: events that the run stored; None: none.
    """
    by_joint = {name: phases(history, name, noted) for name in names}
    starts = np.unique([phase.start for each in by_joint.values() for phase in each])
    columns: dict[str, Any] = {
        "from [s]": starts,
        "to [s]": np.append(starts[1:], np.asarray(history.time)[-1]),
    }
    for name, each in by_joint.items():
        place = np.searchsorted([phase.start for phase in each], starts, side="right") - 1
        columns[name] = [each[i].mode.label for i in place]
    return _add_source(as_table(columns), noted)


def _add_source(frame: Any, noted: Events | None) -> Any:
    """A table that says where its instants come from."""
    frame.attrs["instants"] = INSTANTS[noted is not None]
    return frame


def _phases_in_contact(path: Any, start: float, stop: float, source: str) -> list[Phase]:
    """An impact, and the contact that it may end in."""
    approach = float(path.derivative()(start))
    end = _end_of_impact(path.derivative(), start, stop, SHARE * approach)
    result = [Phase(start, end, Mode.IMPACT, approach, source)]
    return [*result, Phase(end, stop, Mode.CONTACT, np.nan, SAVES)] if end < stop else result


def _end_of_impact(rate: Any, start: float, stop: float, least: float) -> float:
    """When bodies that touched have come to rest, or have come back and stopped again [s]."""
    stopped = _first_passage(rate, least, start, stop)
    if stopped is None:
        return stop
    # As long again as it took to stop, and once more: they come back by then, or not at all.
    returning = _first_passage(rate, -least, stopped, min(stop, stopped + 2 * (stopped - start)))
    if returning is None:
        return stopped
    back = _first_passage(rate, -least, np.nextafter(returning, np.inf), stop)
    return stop if back is None else back


def _first_passage(rate: Any, level: float, start: float, stop: float) -> float | None:
    """The first instant after `start` at which a rate passes a level; None where it does not."""
    lower, upper = np.searchsorted(rate.x, [start, stop])
    pieces = slice(max(lower - 1, 0), min(upper, len(rate.x) - 1))
    part = scipy.interpolate.PPoly(rate.c[:, pieces], rate.x[pieces.start : pieces.stop + 1])
    times = part.solve(level, discontinuity=False, extrapolate=False)
    times = times[np.isfinite(times) & (times > start) & (times < stop)]
    return float(times.min()) if len(times) else None


def _phases_of_forces(time: np.ndarray, force: np.ndarray) -> list[Phase]:
    """Phases of forces that are means over the saving intervals: known to an interval."""
    result: list[Phase] = []
    for i, (start, stop) in enumerate(itertools.pairwise(time)):
        mode = Mode.CONTACT if force[i + 1] > 0 else Mode.FREE_FLIGHT
        if mode == Mode.CONTACT and result and result[-1].mode == Mode.FREE_FLIGHT:
            mode = Mode.IMPACT
        result.append(Phase(start, stop, mode, np.nan, SAVES if i else START))
    return _merge_phases(result)


def _merge_phases(separate: list[Phase]) -> list[Phase]:
    """Neighbours of one mode as one, but for impacts."""
    out: list[Phase] = []
    for phase in separate:
        if out and out[-1].mode == phase.mode != Mode.IMPACT:
            out[-1] = out[-1]._replace(stop=phase.stop)
        else:
            out.append(phase)
    return out
