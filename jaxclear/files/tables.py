"""A table over time as a file holds it: its numbers, as it is written, or the columns of a CSV file
beside it."""

from pathlib import Path
from typing import Any

from jaxclear.components.time_table import TimeTable

__all__ = ["time_table"]


def time_table(
    times: Any = None,
    values: Any = None,
    interpolation: str = "cubic",
    beyond: str = "held",
    factor: float = 1.0,
    csv: Path | None = None,
    columns: tuple[str, ...] | None = None,
) -> TimeTable:
    """`times` and `values`, or a file `csv` and the names of its `columns`, that of the time first.
    Raises `ValueError` with a sentence."""
    further: dict[str, Any] = {"beyond": beyond, "factor": factor}
    if (csv is None) == (times is None) or (csv is None) != (columns is None):
        raise ValueError("TimeTable needs times and values, or csv and columns.")
    if csv is None:
        return TimeTable(times, values, interpolation, **further)
    first, *rest = columns or ("",)
    if not rest:
        raise ValueError("columns of a TimeTable must name the time and what is read over it.")
    names: Any = rest[0] if len(rest) == 1 else rest
    return TimeTable.from_csv(csv, first, names, interpolation, **further)
