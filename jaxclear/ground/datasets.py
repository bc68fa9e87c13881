"""Results as xarray Datasets: numbers by name with units, and where they come from as attributes.

Values and attributes are of kinds that netCDF and Zarr keep: numbers, texts, no truths and no
objects. What computed them and what was asked stand in the attributes `versions` and `problem`, as
JSON.

Which programs compute here: what numbers are kept with, so that they can be had again.
"""

import csv
import datetime
import json
import math
import platform
from collections.abc import Iterable, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

LIBRARIES = ("jaxclear", "jax", "jaxlib", "numpy", "scipy", "xarray", "zarr")


def library_versions() -> dict[str, str]:
    """Name and version of what computes here: libraries, Python, the kind of device."""
    versions = {"python": platform.python_version()}
    versions |= {library: installed(library) for library in LIBRARIES}
    device = jax.devices()[0]
    kind = platform.machine() if device.platform == "cpu" else device.device_kind
    return versions | {"device": f"{device.platform} ({kind})"}


def installed(library: str) -> str:
    """The version of a library that is installed here; "unknown" of one that is not."""
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return "unknown"


class Column(NamedTuple):
    """Values over dimensions, their unit ("" for texts) and what they are."""

    dims: tuple[str, ...]
    values: Any
    unit: str = ""
    meaning: str = ""
    kind: str = ""


def dataset(
    columns: Mapping[str, Column],
    coordinates: Mapping[str, Column] | None = None,
    *,
    what: str,
    problem: Mapping[str, str] | None = None,
    **further: Any,
) -> Any:
    """An xarray Dataset with provenance as attributes.

    Args:
        columns: variables by name, with dimensions and units.
        coordinates: by name; a dimension without one is counted.
        what: what the set holds, an attribute.
        problem: text for each part of the problem, an attribute.
        further: more attributes.
    """
    import xarray

    attributes: dict[str, Any] = {"what": what}
    if problem is not None:
        attributes["problem"] = json.dumps(dict(problem))
    attributes |= {name: _as_attribute(value) for name, value in further.items()}
    attributes |= provenance()
    return xarray.Dataset(
        {name: _as_variable(column) for name, column in columns.items()},
        {name: _as_variable(column) for name, column in (coordinates or {}).items()},
        attributes,
    )


def write_csv(data: Any, path: Any) -> Path:
    """Write a Dataset as a table: a row for each place along the first dimension of its first
    variable, names with units in the head. What does not begin with that dimension is left out."""
    along = next(own.dims[0] for own in data.data_vars.values() if own.dims)
    columns: dict[str, list[Any]] = {}
    for name, own in [*data.coords.items(), *data.data_vars.items()]:
        if own.dims[:1] == (along,):
            unit = own.attrs.get("units", "1")
            values = own.values
            for place in np.ndindex(values.shape[1:]):
                labels = [data[dim].values[k] for dim, k in zip(own.dims[1:], place, strict=True)]
                head = ".".join(map(str, [name, *labels]))
                columns[head if unit == "1" else f"{head} [{unit}]"] = values[:, *place].tolist()
    path = Path(path)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return path


def provenance() -> dict[str, str]:
    """What computed this and when, as attributes."""
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {"versions": json.dumps(library_versions()), "created": now}


def spelt(name: str) -> str:
    """A name without signs that files take for something else."""
    return name.replace("%", "percent").replace("/", " per ")


def _as_variable(column: Column) -> tuple:
    values = np.asarray(column.values)
    if values.dtype.kind == "b":
        values = values.astype(np.int8)
    if values.dtype.kind in "OU":
        # As objects: Zarr has no settled form for texts of a fixed length.
        texts = [_as_text(one) for one in values.ravel()]
        values = np.array(texts, object).reshape(values.shape)
    attributes = {"units": column.unit, "long_name": column.meaning, "kind": column.kind}
    return column.dims, values, {name: text for name, text in attributes.items() if text}


def _as_text(value: Any) -> str:
    return "" if value is None or (isinstance(value, float) and np.isnan(value)) else str(value)


def _as_attribute(value: Any) -> Any:
    """An attribute that every format keeps."""
    if isinstance(value, (bool, np.bool_)):
        return int(value)
    if isinstance(value, (str, int, float)):
        # Zarr keeps attributes as JSON, which has no word for what is not finite.
        return value if isinstance(value, str) or math.isfinite(value) else str(value)
    if isinstance(value, Iterable):
        return " ".join(str(one) for one in value)
    return str(value)
