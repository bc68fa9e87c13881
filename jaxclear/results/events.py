"""Touches and releases of a run as a table: when, in which joint, at what speed."""

import warnings
from typing import Any

import numpy as np

from jaxclear.integrators.events import Events
from jaxclear.results.histories import check_contact_joint
from jaxclear.results.state_history import StateHistory

COLUMNS = ["time [s]", "joint", "contact", "event", "speed [m/s]"]


def table(history: StateHistory, noted: Events | None, names: tuple[str, ...]) -> Any:
    """The events of joints in the order of time. Raises `ValueError` for a run that kept none, or
    an unknown joint; warns where some were not kept."""
    import pandas

    if noted is None:
        raise ValueError(
            "this run kept no touches and releases; simulate(..., save=Saving(events=10)) keeps 10 "
            "of each contact between two saving times."
        )
    for name in names:
        check_contact_joint(history, name)
    times, rates, counts = (np.asarray(part) for part in noted)
    places = [
        (name, contact)
        for name, bearing in history.model().system.bearings.items()
        for contact in bearing.joint.contact_names()
    ]
    rows, lost = [], 0
    for k, (joint, contact) in enumerate(places):
        if names and joint not in names:
            continue
        kept = np.arange(times.shape[2]) < counts[:, k, None]
        lost += int(np.sum(counts[:, k])) - int(np.sum(kept))
        for time, rate in zip(times[:, k][kept], rates[:, k][kept], strict=True):
            rows.append((time, joint, contact, "touch" if rate > 0 else "release", abs(rate)))
    if lost:
        warnings.warn(
            f"{lost} touches and releases were not kept: more than {times.shape[2]} of a contact "
            "fell between two saving times. Give Saving more events, or save more often.",
            stacklevel=4,
        )
    return pandas.DataFrame(sorted(rows), columns=COLUMNS)
