"""A distribution of scipy as a file holds it: by scipy's name and numbers, as a user writes it, or
by its table, as it is written (an object knows its table, not the name that it came from).

A table over time as a file holds it: its numbers, as it is written, or the columns of a CSV file
beside it.
"""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxclear.components.function_of_time import TimeTable
from jaxclear.ground.wording import described, unknown
from jaxclear.studies.distribution.tabulated import FromScipy, Table

ROWS = ("scores", "deviations", "slopes")


def table_of(distribution: FromScipy) -> dict[str, Any]:
    """Rows of its table: scores [1], deviations and slopes [the number's unit]."""
    return {row: getattr(distribution.table, row) for row in ROWS}


def from_scipy(
    scipy: str | None = None,
    numbers: dict[str, float] | None = None,
    about: float = 0.0,
    table: dict[str, Any] | None = None,
    spread: float | None = None,
) -> FromScipy:
    """A distribution of scipy, by its name or by its table.

    Args:
        scipy: name in scipy.stats, such as "weibull_min".
        numbers: its parameters by name.
        about: nominal value of a distribution of the dimension itself (`FromScipy`).
        table: scores, deviations and slopes, instead of a name.
        spread: standard deviation of a table, in the variable's unit, > 0.

    Raises:
        ValueError: not exactly one of name and table is given, or the table is malformed.
    """
    if (scipy is None) == (table is None):
        raise ValueError("distribution.FromScipy needs scipy (a name) or a table, one of the two.")
    if scipy is not None:
        return FromScipy(_frozen_distribution(scipy, numbers or {}), about=about)
    columns: dict[str, Any] = table or {}
    rows = [np.asarray(columns.get(row, ()), float) for row in ROWS]
    fits = all(row.shape == rows[0].shape and row.ndim == 1 for row in rows) and len(rows[0]) > 1
    if not fits or not np.isfinite(rows).all() or np.any(np.diff(rows[0]) <= 0):
        raise ValueError(
            "distribution.FromScipy has a table whose scores, deviations and slopes must be as "
            "many finite numbers each, two or more, scores rising."
        )
    if spread is None or not 0 < spread < np.inf:
        raise ValueError(
            f"distribution.FromScipy has spread = {described(spread)}; it must be above 0."
        )
    # Its constructor takes a distribution of scipy, which is gone.
    built = object.__new__(FromScipy)
    object.__setattr__(built, "table", Table(*map(jnp.asarray, rows)))
    object.__setattr__(built, "spread", jnp.asarray(spread, float))
    return built


def _frozen_distribution(name: str, numbers: dict[str, float]) -> Any:
    """A distribution of scipy whose quantile is a formula: others take minutes to tabulate."""
    from scipy import stats

    generic = stats.rv_continuous
    frozen = getattr(stats, name, None) if not name.startswith("_") else None
    if not isinstance(frozen, generic):
        names = [n for n in dir(stats) if isinstance(getattr(stats, n), generic)]
        raise ValueError(unknown("continuous distribution of scipy.stats", name, names))
    if type(frozen)._ppf is generic._ppf:
        raise ValueError(
            f"scipy has no formula for the quantile of {name}; build it in Python, where it may "
            "take minutes, and write the scene from there."
        )
    try:
        return frozen(**numbers)
    except TypeError as error:
        raise ValueError(f"scipy.stats.{name}: {error}.") from None


def time_table(
    times: Any = None,
    values: Any = None,
    interpolation: str = "cubic",
    beyond: str = "held",
    factor: float = 1.0,
    csv: Path | None = None,
    columns: tuple[str, ...] | None = None,
) -> TimeTable:
    """A table over time, from numbers or from columns of a file.

    Args:
        times, values: instants [s] and values; None: from `csv`.
        interpolation, beyond, factor: as of `TimeTable`.
        csv: path of the file.
        columns: names in it, that of the time first.

    Raises:
        ValueError: not exactly one of numbers and file is given.
    """
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
