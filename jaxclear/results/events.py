"""Touches and releases of a run as a table: when, in which joint, at what speed."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from jaxclear.ground.table import as_table
from jaxclear.ground.warning import warn
from jaxclear.integrators.events import Events
from jaxclear.results.histories import check_contact_joint
from jaxclear.results.state_history import StateHistory

COLUMNS = ["time [s]", "joint", "contact", "event", "speed [m/s]"]


def table(history: StateHistory, noted: Events | None, names: tuple[str, ...]) -> Any:
    """The events of joints in the order of time. Raises `ValueError` for a run that kept none, or
    an unknown joint; warns where some were not kept."""
    if noted is None:
        raise ValueError(
            "this run kept no touches and releases; simulate(..., save=Saving(events=10)) keeps 10 "
            "of each contact between two saving times."
        )
    for name in names:
        check_contact_joint(history, name)
    rows, lost = [], 0
    for own in of_contacts(history, noted):
        if names and own.joint not in names:
            continue
        lost += own.lost
        for time, rate in zip(own.times[own.kept], own.rates[own.kept], strict=True):
            event = "touch" if rate > 0 else "release"
            rows.append((time, own.joint, own.contact, event, abs(rate)))
    warn_of_lost(lost, noted)
    return as_table(sorted(rows), columns=COLUMNS)


class ContactEvents(NamedTuple):
    """Events of one contact: `times` [s] and `rates` [m/s] (intervals, most) and how many there
    were in each interval (`counts`), kept or not."""

    joint: str
    contact: str
    times: np.ndarray
    rates: np.ndarray
    counts: np.ndarray

    @property
    def kept(self) -> np.ndarray:
        """Which places of `times` hold an event."""
        return np.arange(self.times.shape[1]) < self.counts[:, None]

    @property
    def lost(self) -> int:
        """How many were not kept."""
        return int(self.counts.sum()) - int(self.kept.sum())


def of_contacts(history: StateHistory, noted: Events) -> Iterator[ContactEvents]:
    """The events of every contact of a run, in the order of its joints."""
    times, rates, counts = (np.asarray(part) for part in noted)
    bearings = history.model().system.bearings.items()
    places = [(name, each) for name, own in bearings for each in own.joint.contact_names()]
    for k, (joint, contact) in enumerate(places):
        yield ContactEvents(joint, contact, times[:, k], rates[:, k], counts[:, k])


def warn_of_lost(lost: int, noted: Events) -> None:
    """Warns where some events were not kept."""
    if lost:
        warn(
            f"{lost} touches and releases were not kept: more than {noted.times.shape[2]} of a "
            "contact fell between two saving times. Give Saving more events, or save more often.",
        )
