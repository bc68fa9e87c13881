"""Limits of size by ISO 286 up to 500 mm, and general tolerances of ISO 2768-1, in millimetres and
micrometres as the standards have them.

A class is a letter, where the zone lies (capital: of a hole), and a grade, how wide it is. The
tables are files of the package, which name their sources; holes follow from shafts by rules.

Source: ISO 286-1:2010, tables 1 to 5 and section 4.3.2.5 (holes); ISO 2768-1:1989, table 1.
"""

import csv
import functools
import re
from pathlib import Path

FOLDER = Path(__file__).parent / "iso"
# A size that is the end of a step but for rounding belongs to it.
ROUNDING = 1e-9
SMALLEST_GENERAL = 0.5
ABOVE_ZERO = ("k", "m", "n", "p", "r", "s", "t", "u", "v", "x", "y", "z", "za", "zb", "zc")


@functools.cache
def _table(name: str) -> dict[float, dict[str, str]]:
    """The rows of a table by the largest size [mm] that each holds."""
    with (FOLDER / f"{name}.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return {float(row.pop("up_to_mm")): row for row in rows}


def _row(name: str, size: float, standard: str = "ISO 286") -> dict[str, str]:
    """The row of a size [mm]."""
    table = _table(name)
    if not 0 < size <= max(table) * (1 + ROUNDING):
        raise ValueError(
            f"a size of {size:g} mm is beyond {standard}, which has sizes above 0 up to "
            f"{max(table):g} mm; state its limits as numbers."
        )
    return table[min(end for end in table if size <= end * (1 + ROUNDING))]


def width(size: float, grade: int) -> float:
    """Width [um] of a grade for a nominal size [mm]. Raises `ValueError` for one that ISO 286
    lacks."""
    entry = _row("widths", size).get(f"IT{grade}", "")
    if not entry:
        raise ValueError(f"ISO 286 has no grade {grade}; its grades are 1 to 18.")
    return float(entry)


def limits(size: float, code: str) -> tuple[float, float]:
    """Lower and upper limit deviation [um] of a class, such as "H7", for a nominal size [mm].
    Raises `ValueError` for a class that ISO 286 lacks at this size."""
    match = re.fullmatch(r"([A-Z]{1,2}|[a-z]{1,2})(\d{1,2})", code)
    if match is None:
        raise ValueError(
            f'"{code}" is no class of ISO 286; write a letter and a grade, such as H7 or g6.'
        )
    letter, grade = match[1].lower(), int(match[2])
    wide, row, hole = width(size, grade), _row("shafts", size), match[1].isupper()
    if letter == "js":
        return -0.5 * wide, 0.5 * wide
    if letter == "j" and hole:
        upper = _row("holes_j", size).get(code, "")
    elif letter == "j":
        upper = row.get(f"j{5 if grade == 6 else grade}", "")
    elif letter == "h" or (letter == "k" and not 4 <= grade <= 7 and not hole):
        upper = "0"
    elif letter in ("a", "b") and size <= 1:
        upper = ""
    else:
        upper = row.get(letter, "")
    if not upper or (hole and letter == "k" and grade > 8 and size > 3):
        raise ValueError(f"ISO 286 has no class {code} at {size:g} mm.")
    end = float(upper)
    if letter == "j":
        return (end - wide, end) if hole else (end, end + wide)
    if letter not in ABOVE_ZERO:
        return (-end, wide - end) if hole else (end - wide, end)
    if not hole:
        return end, end + wide
    top = -end + _rise(size, letter, grade)
    if letter == "k" and grade > 8:
        top = 0.0
    if letter == "n" and grade > 8 and size > 3:
        top = 0.0
    if code == "M6" and 250 < size <= 315:
        top = -9.0
    return top - wide, top


def _rise(size: float, letter: str, grade: int) -> float:
    """By how much [um] the zone of a hole of the letters K to ZC lies higher than that of the
    shaft mirrored, so that a fit with the next finer shaft is the same either way round."""
    coarsest = 8 if letter in ("k", "m", "n") else 7
    if size <= 3 or grade > coarsest:
        return 0.0
    return width(size, grade) - width(size, grade - 1)


def general(size: float, which: str) -> float:
    """Permitted deviation +- [mm] of a length [mm] without a tolerance of its own, by the class f,
    m, c or v of ISO 2768-1. Raises `ValueError` where it has none."""
    entry = _row("general", size, "ISO 2768-1").get(which, "") if size >= SMALLEST_GENERAL else ""
    if not entry:
        raise ValueError(
            f"ISO 2768-1 has no general tolerance of class {which} for {size:g} mm; state one."
        )
    return float(entry)
