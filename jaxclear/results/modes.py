"""How the journal of a clearance joint moves: free flight, impact, contact; and from when to when.

A joint touches where one of its indentations is above 0. Touching begins as an impact, and lasts as
one until the bodies have come back from it: the indentation's rate, the approach speed at first,
falls to 0 and turns, and the impact ends where it turns again or where they part; or, where they do
not come back, as soon as the rate has fallen to 0. What lasts beyond is contact. 0 is `SHARE` of
the approach speed. Where and when contacts touch and part is told by the run's events where it kept
them, otherwise by its saving times (`contact_paths`).

Source: the three modes of Ravn 1998, Multibody Syst. Dyn. 2, 1, doi:10.1023/A:1009759826529.
"""

import enum
import itertools
from typing import Any, NamedTuple

import numpy as np
import scipy

from jaxclear.ground.shown import shown_in_words
from jaxclear.ground.table import as_table
from jaxclear.integrators.events import Events
from jaxclear.results.contact_paths import SAVES, START, contact_path
from jaxclear.results.histories import check_contact_joint, contact
from jaxclear.results.state_history import StateHistory

# Share of the approach speed below which a journal counts as stopped.
SHARE = 0.05


class Mode(enum.IntEnum):
    """How a journal moves in its bearing."""

    FREE_FLIGHT = 0
    IMPACT = 1
    CONTACT = 2

    @property
    def label(self) -> str:
        """The mode in words."""
        return self.name.lower().replace("_", " ")


@shown_in_words
class Phase(NamedTuple):
    """A mode from `start` to `stop` [s]; `approach` [m/s]: speed at the touch, of an impact;
    `known_by`: what tells of its start: an event of the run, its saving times, or that the run
    started there."""

    start: float
    stop: float
    mode: Mode
    approach: float
    known_by: str

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
    """The modes of a joint, one after the other, by the events that were `noted` where there are
    any. Raises `ValueError` for another joint."""
    check_contact_joint(history, name)
    time = np.asarray(history.time)
    if history.formulation.forces_are_means:
        return _of_forces(time, np.asarray(contact(history, name).normal_force).sum(axis=1))
    if name not in history.mechanism.topology.clearances:
        # An ideal joint that rubs.
        return [Phase(time[0], time[-1], Mode.CONTACT, np.nan, START)]
    path, spells = contact_path(history, name, noted)
    found: list[Phase] = []
    for start, stop, touching, known_by in spells:
        if not touching:
            found.append(Phase(start, stop, Mode.FREE_FLIGHT, np.nan, known_by))
        elif known_by == START:
            found.append(Phase(start, stop, Mode.CONTACT, np.nan, known_by))
        else:
            found += _touching(path, start, stop, known_by)
    return _merged(found)


def table(history: StateHistory, name: str, noted: Events | None = None) -> Any:
    """The phases as a pandas table."""
    found = phases(history, name, noted)
    rows = [(p.start, p.stop, p.mode.label, p.approach, p.known_by) for p in found]
    labels = ["from [s]", "to [s]", "mode", "approach speed [m/s]", "start known by"]
    return _told(as_table(rows, columns=labels), noted)


def combined(history: StateHistory, names: tuple[str, ...], noted: Events | None = None) -> Any:
    """The modes of several joints side by side, as a pandas table: a row whenever one changes."""
    own = {name: phases(history, name, noted) for name in names}
    starts = np.unique([phase.start for each in own.values() for phase in each])
    columns: dict[str, Any] = {
        "from [s]": starts,
        "to [s]": np.append(starts[1:], np.asarray(history.time)[-1]),
    }
    for name, each in own.items():
        place = np.searchsorted([phase.start for phase in each], starts, side="right") - 1
        columns[name] = [each[i].mode.label for i in place]
    return _told(as_table(columns), noted)


def _told(found: Any, noted: Events | None) -> Any:
    """A table that says where its instants come from."""
    found.attrs["instants"] = INSTANTS[noted is not None]
    return found


def _touching(path: Any, start: float, stop: float, known_by: str) -> list[Phase]:
    """An impact, and the contact that it may end in."""
    approach = float(path.derivative()(start))
    end = _end_of_impact(path.derivative(), start, stop, SHARE * approach)
    found = [Phase(start, end, Mode.IMPACT, approach, known_by)]
    return [*found, Phase(end, stop, Mode.CONTACT, np.nan, SAVES)] if end < stop else found


def _end_of_impact(rate: Any, start: float, stop: float, least: float) -> float:
    """When bodies that touched have come to rest, or have come back and stopped again [s]."""
    stopped = _first(rate, least, start, stop)
    if stopped is None:
        return stop
    # As long again as it took to stop, and once more: they come back by then, or not at all.
    returning = _first(rate, -least, stopped, min(stop, stopped + 2 * (stopped - start)))
    if returning is None:
        return stopped
    back = _first(rate, -least, np.nextafter(returning, np.inf), stop)
    return stop if back is None else back


def _first(rate: Any, level: float, start: float, stop: float) -> float | None:
    """The first instant after `start` at which a rate passes a level; None where it does not."""
    lower, upper = np.searchsorted(rate.x, [start, stop])
    pieces = slice(max(lower - 1, 0), min(upper, len(rate.x) - 1))
    part = scipy.interpolate.PPoly(rate.c[:, pieces], rate.x[pieces.start : pieces.stop + 1])
    times = part.solve(level, discontinuity=False, extrapolate=False)
    times = times[np.isfinite(times) & (times > start) & (times < stop)]
    return float(times.min()) if len(times) else None


def _of_forces(time: np.ndarray, force: np.ndarray) -> list[Phase]:
    """Phases of forces that are means over the saving intervals: known to an interval."""
    found: list[Phase] = []
    for i, (start, stop) in enumerate(itertools.pairwise(time)):
        mode = Mode.CONTACT if force[i + 1] > 0 else Mode.FREE_FLIGHT
        if mode == Mode.CONTACT and found and found[-1].mode == Mode.FREE_FLIGHT:
            mode = Mode.IMPACT
        found.append(Phase(start, stop, mode, np.nan, SAVES if i else START))
    return _merged(found)


def _merged(found: list[Phase]) -> list[Phase]:
    """Neighbours of one mode as one, but for impacts."""
    out: list[Phase] = []
    for phase in found:
        if out and out[-1].mode == phase.mode != Mode.IMPACT:
            out[-1] = out[-1]._replace(stop=phase.stop)
        else:
            out.append(phase)
    return out
