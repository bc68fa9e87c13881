"""Tables to look at: pandas tables that print whole in a terminal of 80 columns, and as HTML in a
notebook, with four significant digits a column, units in the heads, and a number beside its error
as value ± error. Where it takes fewer lines, rows stand as columns.

Only the print is rounded: numbers stay as they are, and all that pandas does with a table works.
"""

import copy
import functools
import html
import itertools
import math
import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxclear.ground.printing import PLAIN, SMALL, WIDTH, displayed_error, in_few, with_error

# Spaces between columns; where the names of rows, and heads over narrow columns, are broken.
GAP, NAMES, HEAD = 2, 40, 12
# Digits of a column, and the most where its numbers differ by less, as a micrometre beside a metre,
# or rise by less, as times do.
DIGITS, MOST_DIGITS, MOST_OF_STEPS = 4, 7, 9
# Numbers of a column are alike in size where the least is at least this share of the largest.
SIMILAR_SHARE = 0.1
# A longer table shows its first and its last rows, as many as stand here second.
MOST_ROWS, ENDS = 200, 10
# Longer texts than this stand below a table that has no room for them.
LONG = 24
# For a space at which no line may break, as between a number and its error.
FIRM = "\u00a0"
# A unit behind a name.
UNIT = re.compile(r"\[[^\[\]]*\]$")
# Where a line may break.
PIECE = re.compile(r"(?<= )(?=[^ ])|(?<=[.-])(?=[^ \d])")


def as_table(
    rows: Any = None,
    *,
    index: str | list[str] | None = None,
    units: Mapping[str, str] | None = None,
    errors: Mapping[str, str] | None = None,
    columns: Sequence[str] | None = None,
) -> Any:
    """A pandas table of rows (dictionaries), columns or another table, for printing.

    Args:
        rows: what pandas takes, or a table, whose units and errors are kept.
        index: columns that name its rows.
        units: by column; a column "unit" has those of the rows.
        errors: by column, the column of its error; by default "mean error" for "mean".
        columns: which columns, in order; None: all.
    """
    table = _table_class()(rows, columns=columns)
    table = table if index is None else table.set_index(index)
    attributes = {"units": dict(units or {}), "errors": dict(errors or {})}
    table.attrs = attributes | getattr(rows, "attrs", {})
    return table


@functools.cache
def _table_class() -> Any:
    """The class; of a library that most runs do without."""
    import pandas

    class Table(pandas.DataFrame):
        """A pandas table that prints as this module says."""

        @property
        def _constructor(self):
            return Table

        def __finalize__(self, other, method=None, **kwargs):
            table = pandas.DataFrame.__finalize__(self, other, method=method, **kwargs)
            if method in ("corr", "cov"):
                table.attrs = {}
            return table

        def _arith_method(self, other, operation):
            return pandas.DataFrame(self)._arith_method(other, operation)

        def __array_ufunc__(self, ufunc, method, *inputs, **kwargs):
            plain = [pandas.DataFrame(x) if isinstance(x, Table) else x for x in inputs]
            return getattr(ufunc, method)(*plain, **kwargs)

        def rename(self, *args, **kwargs):
            """A plain pandas table: units go by the names of columns."""
            return pandas.DataFrame(self).rename(*args, **kwargs)

        def __repr__(self):
            return "\n".join(_terminal_lines(_make_cells(self)))

        def _repr_html_(self):
            return _html_table(_make_cells(self))

        def __reduce__(self):
            # Another process gets a plain one: it need not know this class.
            plain = pandas.DataFrame(self)
            plain.attrs = dict(self.attrs)
            return copy.copy, (plain,)

    return Table


class _Column(NamedTuple):
    """A head, the cells below it, and whether these are text."""

    head: str
    cells: list[str]
    is_text: bool

    @property
    def long(self) -> bool:
        """Whether it is text that wants more than a column."""
        return self.is_text and _widest(self.cells) > LONG

    @property
    def is_constant(self) -> bool:
        """Whether all rows have the same long text, or none."""
        is_same = self.is_text and len(set(self.cells)) == 1
        return is_same and (not self.cells[0] or (self.long and len(self.cells) > 1))

    @property
    def narrowest(self) -> int:
        """Its width where its head is broken and its cells are not."""
        head = min(max(HEAD, _widest(PIECE.split(self.head))), LONG)
        return max(_widest(self.cells), _widest(_break_lines(self.head, head)))


class _Cells(NamedTuple):
    """What is shown of a table: the columns that name its rows, the others, and lines below it."""

    names: list[_Column]
    columns: list[_Column]
    notes: list[str]

    @property
    def swapped(self) -> "_Cells":
        """Rows as columns."""
        name = _Column(
            ", ".join(filter(None, (n.head for n in self.names))),
            [column.head for column in self.columns],
            True,
        )
        heads = zip(*(n.cells for n in self.names), strict=True)
        rows = zip(*(column.cells for column in self.columns), strict=True)
        columns = [
            _Column(" ".join(filter(None, head)), list(row), False)
            for head, row in zip(heads, rows, strict=True)
        ]
        return _Cells([name], columns, self.notes)


def _make_cells(frame: Any) -> _Cells:
    """What is shown of a table."""
    notes = []
    if len(frame) > MOST_ROWS:
        notes = [f"The first and the last {ENDS} of {len(frame)} rows; .to_string() has all."]
        frame = frame.iloc[[*range(ENDS), *range(-ENDS, 0)]]
    labels = [" ".join(map(str, n)) if isinstance(n, tuple) else str(n) for n in frame.columns]
    values = [frame.iloc[:, k].tolist() for k in range(len(labels))]
    units, errors = frame.attrs.get("units", {}), frame.attrs.get("errors", {})
    error_columns = {n: errors.get(n, f"{n} error") for n in labels}
    error_columns = {
        n: labels.index(error) for n, error in error_columns.items() if error in labels
    }
    of_rows = values[labels.index("unit")] if "unit" in labels else []
    plain = [v for n, v in zip(labels, values, strict=True) if n not in units]
    by_row = zip(*plain, strict=True)
    rows = [_format_for_row(_floats(row)) for row in by_row] if of_rows else None
    columns = [
        _format_column(
            _head_with_unit(label, units.get(label)),
            values[k],
            values[error_columns[label]] if label in error_columns else None,
            rows if label not in units else None,
        )
        for k, label in enumerate(labels)
        if label != "unit" and k not in error_columns.values()
    ]
    if columns and columns[0].is_text and frame.index.names == [None]:
        names, columns = columns[:1], columns[1:]
    else:
        levels = [frame.index.get_level_values(k) for k in range(frame.index.nlevels)]
        heads = [_head_with_unit(str(c.name or ""), units.get(c.name)) for c in levels]
        names = [_format_column(head, c.tolist()) for head, c in zip(heads, levels, strict=True)]
        labels_with_units = [_head_with_unit(n, units.get(n)) for n in names[-1].cells]
        names[-1] = names[-1]._replace(cells=labels_with_units)
    if of_rows:
        labels_with_units = list(map(_head_with_unit, names[-1].cells, of_rows))
        names[-1] = names[-1]._replace(cells=labels_with_units)
    if notes:
        names = [_mark_omitted_rows(c, "...") for c in names]
        columns = [_mark_omitted_rows(c, "") for c in columns]
    return _move_texts_to_notes(_Cells(names, columns, notes))


def _move_texts_to_notes(cells: _Cells) -> _Cells:
    """With texts that all rows have, and long ones where a line has no room, among the notes."""
    constant = [c for c in cells.columns if c.is_constant]
    columns = [c for c in cells.columns if not c.is_constant]
    notes = [*cells.notes, *(f"{c.head}: {c.cells[0]}" for c in constant if c.long)]
    empty = [c.head for c in constant if not c.long]
    notes += [f"{', '.join(empty)}: none."] if empty else []
    taken = sum(_share_width(cells._replace(columns=columns))) + sum(
        c.narrowest + GAP for c in columns if not c.long
    )
    long = [c for c in columns if c.long]
    if WIDTH - taken >= len(long) * (LONG + GAP):
        return _Cells(cells.names, columns, notes)
    numbers: dict[str, int] = {}
    columns_shown = []
    for c in columns:
        if c.long:
            marks = [f"({numbers.setdefault(x, len(numbers) + 1)})" if x else "" for x in c.cells]
            columns_shown.append(_Column(c.head, marks, False))
        else:
            columns_shown.append(c)
    return _Cells(
        cells.names, columns_shown, notes + [f"({k}) {text}" for text, k in numbers.items()]
    )


def _mark_omitted_rows(column: _Column, mark: str) -> _Column:
    """With a cell where rows are not shown."""
    return column._replace(cells=[*column.cells[:ENDS], mark, *column.cells[ENDS:]])


def _head_with_unit(name: str, unit: str | None) -> str:
    """A name with a unit, which is not broken."""
    named = f"{name} [{unit}]" if unit else name
    return UNIT.sub(lambda match: match[0].replace(" ", FIRM), named)


def _format_column(
    head: str, values: list, errors: list | None = None, rows: list[Callable] | None = None
) -> _Column:
    """Of values, with their errors; `rows`: how numbers are written in each row, of several
    units."""
    columns = [_format_for_column(_floats(values))] * len(values)
    cells = [_format_cell(x, write) for x, write in zip(values, rows or columns, strict=True)]
    if errors is not None:
        pairs = zip(cells, values, errors, strict=True)
        cells = [_cell_with_error(cell, x, error) for cell, x, error in pairs]
    return _Column(head, cells, any(isinstance(x, str) for x in values))


def _floats(values: Iterable) -> list[float]:
    """The numbers among values that say what digits they need."""
    return [x for x in values if isinstance(x, float) and math.isfinite(x) and x]


def _cell_with_error(cell: str, value: Any, error: Any) -> str:
    """A cell, with the error of its value where there is one."""
    if not (_floats([value]) or value == 0) or not isinstance(error, float) or math.isnan(error):
        return cell
    text = (
        with_error(value, error)
        if _floats([error])
        else f"{cell} ± {in_few(displayed_error(error), 2)}"
    )
    return text.replace(" ", FIRM)


def _format_cell(value: Any, write: Callable[[float], str]) -> str:
    """A value in a cell; `write`: how a number is written there."""
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, float):
        return write(value) if math.isfinite(value) and value else _format_alone(value)
    if isinstance(value, (list, tuple)):
        few = len(value) <= DIGITS
        entries = f",{FIRM}".join(_format_cell(x, _format_alone) for x in value)
        return f"({entries})" if few else f"{len(value)}{FIRM}numbers"
    return "" if value is None else " ".join(str(value).split())


def _format_alone(value: float) -> str:
    """A number that no other has to be compared with."""
    return in_few(value, DIGITS)


def _digits_to_separate(numbers: list[float], step: float = 0.0) -> int:
    """As many as tell apart what is alike in size, and steps."""
    size = max(map(abs, numbers))
    similar = [x for x in numbers if abs(x) >= SIMILAR_SHARE * size]
    spreads = {MOST_DIGITS: (max(similar) - min(similar)) / 10, MOST_OF_STEPS: step}
    digit_counts = ((most, math.log10(size / s)) for most, s in spreads.items() if s > 0)
    return max([DIGITS, *(min(math.ceil(power) + 1, most) for most, power in digit_counts)])


def _format_for_row(numbers: list[float]) -> Callable[[float], str]:
    """How numbers of one unit beside each other are written."""
    if not numbers:
        return _format_alone
    most, size = _digits_to_separate(numbers), max(map(abs, numbers))
    return lambda x: in_few(x, most if abs(x) >= SIMILAR_SHARE * size else DIGITS)


def _format_for_column(numbers: list[float]) -> Callable[[float], str]:
    """How the numbers of a column are written: without zeros in which all of them end, and with as
    many digits behind the point where they are alike in size or rise, as times do."""
    if not numbers:
        return _format_alone
    steps = [after - before for before, after in itertools.pairwise(numbers)]
    least = min(steps) if len(steps) > 1 else 0.0
    most, sizes = _digits_to_separate(numbers, least), [abs(x) for x in numbers]
    size, is_similar = max(sizes), least > 0 or min(sizes) >= SIMILAR_SHARE * max(sizes)
    if SMALL <= size < PLAIN and is_similar:
        places = max(most - 1 - math.floor(math.log10(size)), 0)
        return _first([f".{places_or_digits}f" for places_or_digits in range(places + 1)], numbers)
    write = _first([f"#.{places_or_digits}g" for places_or_digits in range(1, most + 1)], numbers)
    return lambda x: f"{x:.0f}" if size < PLAIN and "e+" in write(x) else write(x)


def _first(formats: list[str], numbers: list[float]) -> Callable[[float], str]:
    """The first of the ways to write numbers that says as much of them as the last."""
    rounded = lambda spec: [float(f"{x:{spec}}") for x in numbers]
    chosen = next(spec for spec in formats if rounded(spec) == rounded(formats[-1]))
    return lambda x: f"{x:{chosen}}".replace(".e", "e").rstrip(".")


def _widest(texts: Sequence[str]) -> int:
    return max(map(len, texts), default=0)


def _break_lines(text: str, width: int) -> list[str]:
    """Lines of at most so many characters, broken behind spaces and points."""
    lines = [""]
    for piece in PIECE.split(text):
        if lines[-1] and len(lines[-1]) + len(piece.rstrip()) > width:
            lines.append("")
        while len(piece.rstrip()) > width > 0:
            lines[-1:], piece = [piece[:width], ""], piece[width:]
        lines[-1] += piece
    return [line.rstrip() for line in lines]


def _share_width(cells: _Cells) -> list[int]:
    """What columns that name the rows take of a line: what others leave, or what may be."""
    width = lambda c: min(c.narrowest, LONG) if c.is_text else c.narrowest
    others = sum(width(c) + GAP for c in cells.columns)
    free = WIDTH - others
    # Names that are broken are read better than rows that are.
    most = (free if free >= LONG else max(NAMES, free)) // len(cells.names)
    return [min(c.narrowest, most - GAP) + GAP for c in cells.names]


class _Fitted(NamedTuple):
    """A column in lines: its head, its cells, its width, and whether it stands at the left."""

    head: list[str]
    cells: list[list[str]]
    width: int
    at_left: bool


def _fit_column(column: _Column, most: int, to_left: bool) -> _Fitted:
    """A column of at most so many characters."""
    width = min(column.narrowest, most)
    cells = [_break_lines(cell, width) for cell in column.cells]
    return _Fitted(_break_lines(column.head, max(width, 1)), cells, width, to_left)


def _choose_orientation(cells: _Cells) -> _Cells:
    """The way round that is less broken, or takes fewer lines."""
    if len(cells.names[0].cells) > WIDTH or not cells.columns:
        return cells
    shapes = [(lines.count(""), len(lines)) for lines in map(_stack_blocks, (cells, cells.swapped))]
    return cells.swapped if shapes[0][0] and shapes[1] <= shapes[0] else cells


def _terminal_lines(cells: _Cells) -> list[str]:
    """The table in lines of a terminal."""
    notes = [textwrap.wrap(note, WIDTH, subsequent_indent="    ") for note in cells.notes]
    lines = itertools.chain(_stack_blocks(_choose_orientation(cells)), *notes)
    return [line.replace(FIRM, " ") for line in lines]


def _stack_blocks(cells: _Cells) -> list[str]:
    """As many columns side by side as a line holds, the others below, after an empty line."""
    shares = _share_width(cells)
    names = [_fit_column(n, s - GAP, True) for n, s in zip(cells.names, shares, strict=True)]
    free_width = WIDTH - sum(shares)
    long = [column for column in cells.columns if column.long]
    free = free_width - sum(column.narrowest + GAP for column in cells.columns if not column.long)
    share = max(free // max(len(long), 1) - GAP, LONG)
    blocks: list[list[_Fitted]] = [[]]
    for column in cells.columns:
        fitted = _fit_column(column, share if column.long else free_width, column.is_text)
        if blocks[-1] and sum(c.width + GAP for c in [*blocks[-1], fitted]) > free_width + GAP:
            blocks.append([])
        blocks[-1].append(fitted)
    lines: list[str] = []
    for block in blocks:
        lines += [""] * bool(lines) + _join_columns([*names, *block])
    return lines


def _join_columns(columns: list[_Fitted]) -> list[str]:
    """Columns side by side, with their heads."""
    deepest = max(len(column.head) for column in columns)
    lines = [[[""] * (deepest - len(column.head)) + column.head for column in columns]]
    lines += map(list, zip(*(column.cells for column in columns), strict=True))
    drawn = []
    for row in lines:
        for parts in itertools.zip_longest(*row, fillvalue=""):
            pairs = zip(parts, columns, strict=True)
            placed = [x.ljust(c.width) if c.at_left else x.rjust(c.width) for x, c in pairs]
            drawn.append((" " * GAP).join(placed).rstrip())
    return drawn


def _html_table(cells: _Cells) -> str:
    """The table in a page, lying as it does in a terminal."""
    cells = _choose_orientation(cells)
    columns = [*cells.names, *cells.columns]
    # Sentences get a width of their own: on a narrow page they stood one word a line.
    kinds = ['td class="sentence"' if c.long else "td" for c in columns]
    cell = lambda kind, text: f"<{kind}>{html.escape(text)}</{kind[:2]}>"
    row = lambda kinds, texts: "".join(map(cell, kinds, texts))
    rows = zip(*(c.cells for c in columns), strict=True)
    head = f"<thead><tr>{row(['th'] * len(columns), [c.head for c in columns])}</tr></thead>"
    body = "".join(f"<tr>{row(kinds, c)}</tr>" for c in rows)
    notes = "".join(f"<p>{html.escape(note)}</p>" for note in cells.notes)
    return f'<table class="dataframe">{head}<tbody>{body}</tbody></table>{notes}'
