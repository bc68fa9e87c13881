"""Samples of a campaign as an xarray Dataset: by name, with units, read when they are used."""

import functools
import json
from typing import Any

import numpy as np

from jaxclear.studies.monte_carlo import FINER, finer_name
from jaxclear.studies.store.batch import ENDED, OUTCOME, RESPONSES, VALUES, WHEN, WORST
from jaxclear.studies.store.samples import Samples

# An outcome that no sample has, and how outcomes are kept.
UNKNOWN = (np.dtype(np.int8), -1)


def dataset_of(samples: Samples) -> Any:
    """The Dataset of a campaign; variables, responses and sentences of outcomes by name."""
    import xarray

    plan, recorded = samples.plan, samples.description["recorded"]
    finished = samples.finished()
    there = np.isin(np.arange(plan.chunks), finished)

    def column(name: str, which: int | None = None, **attributes: str) -> Any:
        data = _lazy_column_class()(samples, there, name, which)
        return xarray.Variable(("sample", "figure")[: len(data.shape)], data, attributes)

    columns: dict[str, Any] = {}
    kinds = (
        (VALUES, "variable", recorded["names"], recorded["variable_units"]),
        (RESPONSES, "response", recorded["response_names"], recorded["response_units"]),
    )
    for name, kind, labels, units in kinds:
        for i, (label, unit) in enumerate(zip(labels, units, strict=True)):
            columns[label] = column(name, i, units=unit, kind=kind)
    endings = {str(code): text for code, text in enumerate(recorded["endings"])}
    ended = {"long_name": "how a sample ended; 0 is success, -1 is not finished"} | endings
    columns[OUTCOME] = column(OUTCOME, **ended)
    columns[ENDED] = column(ENDED, units="s", long_name="when it ended")
    if samples.figures:
        description = "worst figure that a run found out about itself"
        columns["check_worst"] = column(WORST, long_name=description)
        columns["check_time"] = column(WHEN, units="s", long_name="when the worst was met")
    # Four bytes a sample: it is the one column that is not read when it is used.
    turns = np.resize(np.arange(plan.scramblings, dtype=np.int32), plan.samples)
    about = {"units": "1", "long_name": "independent part of the sample"}
    columns["scrambling"] = xarray.Variable("sample", turns, about)
    replicas = samples.replicas()
    units_of = dict(zip(recorded["response_names"], recorded["response_units"], strict=True))
    for name, values in ({} if replicas is None else replicas.responses).items():
        about = {"units": units_of[name], "long_name": FINER}
        columns[finer_name(name)] = xarray.Variable("replica", values, about)
    about = {"long_name": "1 for a chunk that is finished"}
    columns["finished"] = xarray.Variable("chunk", there.astype("int8"), about)
    figures = [f"{check.lower()} {place}".rstrip() for check, place in samples.figures]
    coordinates = {"figure": figures} if figures else {}
    attributes = {
        "what": samples.description["what"],
        "problem": samples.description["problem"],
        "versions": json.dumps(list(samples.versions())),
    }
    return xarray.Dataset(columns, coordinates, attributes | plan._asdict())


@functools.cache
def _lazy_column_class() -> Any:
    """The class of a column that is read when it is used."""
    from xarray.backends import BackendArray
    from xarray.core import indexing

    class Column(BackendArray):
        def __init__(self, samples, there, name, which):
            self.samples, self.there, self.name, self.which = samples, there, name, which
            self.dtype, self.fill = UNKNOWN if name == OUTCOME else (np.dtype(float), np.nan)
            wide = (len(samples.figures),) if name in (WORST, WHEN) else ()
            self.shape = (samples.plan.samples, *wide)

        def __getitem__(self, key):
            basic = indexing.IndexingSupport.BASIC
            return indexing.explicit_indexing_adapter(key, self.shape, basic, self._at)

        def _at(self, key):
            at, *rest = key
            if not isinstance(at, slice):
                return self._rows(int(at), int(at) + 1)[(0, *rest)]
            sel = range(self.shape[0])[at]
            first, last = (min(sel), max(sel) + 1) if sel else (0, 0)
            rows = self._rows(first, last)
            return (rows if sel.step > 0 else rows[::-1])[(slice(None, None, abs(sel.step)), *rest)]

        def _rows(self, first, last):
            values = np.full((last - first, *self.shape[1:]), self.fill, self.dtype)
            size = self.samples.plan.chunk
            for number in range(first // size, -(-last // size)):
                at = slice(max(first, number * size), min(last, (number + 1) * size))
                if self.there[number]:
                    rows = self.samples.read(at, self.name)[self.name]
                    rows = rows if self.which is None else rows[:, self.which]
                    values[at.start - first : at.stop - first] = rows
            return values

    return lambda *arguments: indexing.LazilyIndexedArray(Column(*arguments))
