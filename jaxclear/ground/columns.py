"""Columns of a table in a text file."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from jaxclear.ground.wording import unknown

LARGEST = 64_000_000


def columns_of(path: str | Path, names: Iterable[str]) -> list[np.ndarray]:
    """Columns of numbers by name from a file whose first line names them. They stand between
    commas; or between semicolons or tabs, and then numbers may have a decimal comma. Raises
    `ValueError` with a sentence where there is no such file, column or number."""
    import pandas

    path = Path(path)
    if not path.is_file():
        raise ValueError(f"the table {path.name} is no file; give the path of a CSV file.")
    if path.stat().st_size > LARGEST:
        raise ValueError(f"the table {path.name} is larger than {LARGEST} bytes.")
    try:
        between, decimal = _detect_separators(path)
        table = pandas.read_csv(
            path, sep=between, decimal=decimal, skipinitialspace=True, encoding="utf-8-sig"
        )
    except (ValueError, UnicodeDecodeError, pandas.errors.ParserError) as error:
        reason = str(error).strip().splitlines()[0].rstrip(".")
        raise ValueError(f"the table {path.name} cannot be read: {reason}.") from None
    columns = []
    for name in names:
        if name not in table.columns:
            table_names = list(map(str, table.columns))
            raise ValueError(unknown("column", name, table_names, f" in {path.name}"))
        try:
            columns.append(table[name].to_numpy(float))
        except (TypeError, ValueError):
            raise ValueError(f'column "{name}" of {path.name} holds what is no number.') from None
    return columns


def _detect_separators(path: Path) -> tuple[str, str]:
    """What stands between columns, and before decimals."""
    with path.open(encoding="utf-8-sig") as file:
        first = file.readline()
        between = next((mark for mark in (";", "\t") if mark in first), ",")
        has_commas = between != "," and any("," in line for line in file)
    return between, "," if has_commas else "."
