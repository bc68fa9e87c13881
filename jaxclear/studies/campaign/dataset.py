"""Samples of a campaign as an xarray Dataset: by name, with units, read when they are used."""

import json
from typing import Any

import numpy as np

from jaxclear.studies.campaign.layout import (
    ENDED,
    FINISHED,
    OUTCOME,
    RESPONSES,
    SAMPLES,
    UNKNOWN,
    VALUES,
    WHEN,
    WORST,
)
from jaxclear.studies.campaign.samples import Samples
from jaxclear.studies.campaign.verified import known_replicas
from jaxclear.studies.monte_carlo import FINER, finer_name

__all__ = ["dataset_of"]


def dataset_of(samples: Samples) -> Any:
    """The Dataset of a campaign; variables, responses and sentences of outcomes by name."""
    import xarray

    samples.trim()
    kept = xarray.open_zarr(
        samples.folder / SAMPLES, chunks=None, consolidated=False, mask_and_scale=False
    )
    plan = samples.plan
    kept = kept.isel(sample=slice(plan.samples), chunk=slice(plan.chunks))
    unfinished = kept[FINISHED].values == 0
    if unfinished.any():
        kept = _without(kept, np.repeat(unfinished, plan.chunk)[: plan.samples])
    recorded = samples.told["recorded"]
    columns: dict[str, Any] = {}
    kinds = (
        (VALUES, "variable", recorded["names"], recorded["variable_units"]),
        (RESPONSES, "response", recorded["response_names"], recorded["response_units"]),
    )
    for name, kind, labels, units in kinds:
        for i, (label, unit) in enumerate(zip(labels, units, strict=True)):
            columns[label] = kept[name][:, i].assign_attrs(units=unit, kind=kind)
    endings = {str(code): text for code, text in enumerate(recorded["endings"])}
    columns[OUTCOME] = kept[OUTCOME].assign_attrs(
        long_name="how a sample ended; 0 is success, -1 is not finished", **endings
    )
    columns[ENDED] = kept[ENDED].assign_attrs(units="s", long_name="when it ended")
    if WORST in kept:
        told = {"long_name": "worst figure that a run found out about itself"}
        columns[WORST] = kept[WORST].assign_attrs(told)
        columns[WHEN] = kept[WHEN].assign_attrs(units="s", long_name="when the worst was met")
    # Four bytes a sample: it is the one column that is not read when it is used.
    turns = np.resize(np.arange(plan.scramblings, dtype=np.int32), plan.samples)
    told = {"units": "1", "long_name": "independent part of the sample"}
    columns["scrambling"] = xarray.Variable("sample", turns, told)
    replicas = known_replicas(samples.folder)
    units = dict(zip(recorded["response_names"], recorded["response_units"], strict=True))
    for name, values in ({} if replicas is None else replicas.responses).items():
        told = {"units": units[name], "long_name": FINER}
        columns[finer_name(name)] = xarray.Variable("replica", values, told)
    # The marks themselves are longer than a number of netCDF's third version.
    done = (kept[FINISHED] != 0).astype("int8")
    columns[FINISHED] = done.assign_attrs(long_name="1 for a chunk that is finished")
    figures = [f"{check}, {place}" if place else check for check, place in samples.figures]
    coordinates = {"figure": figures} if figures else {}
    attributes = {
        "what": samples.told["what"],
        "problem": samples.told["problem"],
        "versions": json.dumps(list(samples.versions().values())),
    }
    return xarray.Dataset(columns, coordinates, attributes | plan._asdict())


def _without(kept: Any, unfinished: np.ndarray) -> Any:
    """The samples without what earlier, smaller plans left of unfinished ones (samples,); read at
    once."""
    import xarray

    there = xarray.DataArray(~unfinished, dims="sample")
    fill = {OUTCOME: np.int8(UNKNOWN)}
    named = [name for name, column in kept.items() if "sample" in column.dims]
    return kept.assign({name: kept[name].where(there, fill.get(name, np.nan)) for name in named})
