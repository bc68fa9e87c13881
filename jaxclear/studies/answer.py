"""What a study answers: columns over dimensions, each stated once with its unit and its error, and
sentences. Its table, its xarray Dataset, what is printed and what a notebook shows are made of
these.
"""

import itertools
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxclear.ground import datasets
from jaxclear.ground.printing import AbstractShown
from jaxclear.ground.table import as_table
from jaxclear.studies.problem import Problem
from jaxclear.studies.store.digest import in_texts

RESPONSE, VARIABLE = "response", "variable"
# Columns that stand in one of the two only.
TABLE, DATASET = "table", "dataset"


class Column(NamedTuple):
    """Numbers or texts over dimensions. `values`: an array, or a mapping from the labels of its
    dimensions ({"force": 2.0}, {("force", "mass"): 0.1}), or a function that gives one of these
    when it is asked. `unit`: "" for texts and where each row has its own, in a column "unit".
    `error`: half of the 95 % interval, in the same form, in a column `error_name`. `only`: TABLE or
    DATASET; `label`: what it is called in the table, where it is another name."""

    dims: tuple[str, ...]
    values: Any
    unit: str = ""
    meaning: str = ""
    kind: str = ""
    error: Any = None
    error_name: str = ""
    only: str = ""
    label: str = ""

    @property
    def computed(self) -> "Column":
        """With its values known."""
        return self._replace(values=self.values()) if callable(self.values) else self


class Stated(NamedTuple):
    """All that an answer holds: what study it is of, its columns by name, of which those over the
    dimensions of the first make its table, the problem, sentences that warn (or a function that
    gives them), and more numbers that a Dataset has as attributes. `labelled`: whether the labels
    of the rows are the index of the table, or columns of it."""

    what: str
    columns: Mapping[str, Column]
    problem: Problem | None = None
    warnings: tuple[str, ...] | Callable[[], tuple[str, ...]] = ()
    numbers: Mapping[str, Any] = {}
    labelled: bool = True

    @property
    def warned(self) -> tuple[str, ...]:
        """The sentences that warn."""
        return self.warnings() if callable(self.warnings) else self.warnings


class AbstractAnswer(AbstractShown):
    """Columns and sentences that a study answers with."""

    @abstractmethod
    def _stated(self) -> Stated:
        """What it holds."""

    @abstractmethod
    def sentence(self) -> str:
        """The answer in words; "" where its table says all."""

    def _summary(self):
        stated = self._stated()
        return *filter(None, [self.sentence()]), table_of(stated), *stated.warned

    def table(self) -> Any:
        """The answer as a pandas table, numbers beside their errors."""
        return table_of(self._stated())

    def to_dataset(self) -> Any:
        """The answer as an xarray Dataset: columns by name with units, sentences, what was asked
        and by what it was computed as attributes."""
        stated = self._stated()
        attributes = {"result": self.sentence(), "warnings": " ".join(stated.warned)}
        return dataset_of(stated, **(attributes | dict(stated.numbers)))

    def to_csv(self, path: Any) -> Path:
        """Write a CSV file: a row for each label of the first dimension (a sample, a variable).

        Names have units; every digit is kept.

        Args:
            path: name of the file.

        Returns:
            The path of the file.
        """
        return datasets.write_csv(self.to_dataset(), path)


def with_interval(
    name: str, dims: tuple[str, ...], statistics: Mapping[Any, Any], unit: str = "1"
) -> dict[str, Column]:
    """Columns of statistics: values with errors, and in the Dataset the ends of intervals.

    Args:
        name: of the column of values.
        dims: dimensions over which the statistics are.
        statistics: with `value`, `low`, `high` and `error`, by label.
        unit: of the values.
    """
    read = lambda part: {key: float(getattr(one, part)) for key, one in statistics.items()}
    ends = {f"{name} {end}": Column(dims, read(end), unit, only=DATASET) for end in ("low", "high")}
    return {name: Column(dims, read("value"), unit, error=read("error"))} | ends


def with_unit(name: str, unit: str) -> str:
    """What a column is called that tells its unit in a table."""
    return "" if unit == "1" else f"{name} [{unit}]"


def means_and_deviations(
    means: Mapping[str, Any], deviations: Mapping[str, Any]
) -> dict[str, Column]:
    """Columns of means and standard deviations of responses, each with its error, which have the
    units of their rows."""
    columns = {"mean": ("mean", means), "standard deviation": ("deviation", deviations)}
    read = lambda table, part: {name: float(getattr(one, part)) for name, one in table.items()}
    return {
        name: Column(
            (RESPONSE,),
            read(table, "value"),
            error=read(table, "error"),
            error_name=f"error of {short} (95 %)",
        )
        for name, (short, table) in columns.items()
    }


def columns_of(table: Any, dim: str, before: str = "") -> dict[str, Column]:
    """The columns of another table of an answer, for its Dataset.

    Args:
        table: of pandas, with units as attributes.
        dim: dimension of its rows.
        before: prefix of the columns' names.
    """
    units = table.attrs.get("units", {})
    counted = table.index.name is None
    return {
        f"{before}{name}": Column(
            (dim,),
            table[name].to_numpy() if counted else table[name].to_dict(),
            units.get(name, ""),
        )
        for name in table.columns
    }


def table_of(stated: Stated) -> Any:
    """The table of what is stated."""
    dims = next(iter(stated.columns.values())).dims
    used_columns = {
        name: column.computed
        for name, column in stated.columns.items()
        if (column.dims == dims and column.only != DATASET) or name in dims
    }
    keys = _row_labels(used_columns, dims)
    columns: dict[str, Any] = {}
    if keys is not None:
        columns |= {dim: [_label_part(key, i) for key in keys] for i, dim in enumerate(dims)}
    units, errors = {n: c.unit for n, c in used_columns.items() if n in dims and c.unit}, {}
    for name, column in used_columns.items():
        if name in dims:
            continue
        label = column.label or name
        columns[label] = _values_by_row(column.values, keys)
        if column.unit and not column.label:
            units[label] = column.unit
        if column.error is not None:
            errors[label] = column.error_name or f"{name} error"
            columns[errors[label]] = _values_by_row(column.error, keys)
    index: Any = None if keys is None or not stated.labelled else list(dims)
    index = index[0] if index is not None and len(index) == 1 else index
    return as_table(columns, index=index, units=units, errors=errors)


def dataset_of(stated: Stated, **attributes: Any) -> Any:
    """The Dataset of what is stated; `attributes`: more attributes."""
    every = {n: c.computed for n, c in stated.columns.items() if c.only != TABLE}
    labels = {n: c for n, c in every.items() if c.dims == (n,)}
    for column in every.values():
        for i, dim in enumerate(column.dims if isinstance(column.values, Mapping) else ()):
            if dim not in every:
                existing = labels[dim].values if dim in labels else []
                merged = dict.fromkeys([*existing, *(_label_part(key, i) for key in column.values)])
                labels[dim] = Column((dim,), list(merged))
    columns: dict[str, datasets.Column] = {}
    for name, column in every.items():
        if name not in labels:
            columns[datasets.spelt(name)] = _column_array(column, column.values, labels)
        if column.error is not None:
            called = datasets.spelt(column.error_name or f"{name} error")
            columns[called] = _column_array(column, column.error, labels)
    coordinates = {dim: _column_array(label, label.values, labels) for dim, label in labels.items()}
    parts = None if stated.problem is None else in_texts(stated.problem)
    return datasets.dataset(columns, coordinates, what=stated.what, problem=parts, **attributes)


def _column_array(column: Column, values: Any, labels: Mapping[str, Column]) -> datasets.Column:
    """A column as an array over its dimensions; nan, or "", where a mapping has no value."""
    if isinstance(values, Mapping):
        shape = [len(labels[dim].values) for dim in column.dims]
        keys = list(itertools.product(*(labels[dim].values for dim in column.dims)))
        values = np.array(_values_by_row(values, keys)).reshape(shape)
    return datasets.Column(column.dims, values, column.unit, column.meaning, column.kind)


def _label_part(key: Any, place: int) -> Any:
    return key[place] if isinstance(key, tuple) else key


def _row_labels(columns: Mapping[str, Column], dims: tuple[str, ...]) -> list[Any] | None:
    """The labels of the rows of a table, in their order; None where rows are only counted."""
    if all(dim in columns for dim in dims):
        return list(itertools.product(*(columns[dim].values for dim in dims)))
    mappings = [column.values for column in columns.values() if isinstance(column.values, Mapping)]
    return list(dict.fromkeys(key for mapping in mappings for key in mapping)) or None


def _values_by_row(values: Any, keys: Sequence[Any] | None) -> Any:
    """Values of a column, row by row."""
    if not isinstance(values, Mapping):
        return values if isinstance(values, list) else np.asarray(values).ravel()
    empty = "" if any(isinstance(value, str) for value in values.values()) else np.nan
    alone = lambda key: key[0] if isinstance(key, tuple) and len(key) == 1 else key
    return [values.get(alone(key), empty) for key in keys or ()]
