"""Large symmetric systems in a kernel: loops over tables (`ground.elimination`), in functions that
every place calls where such a system is solved.

Numbers of a system stand in memory of the kernel's own, those of all lanes side by side. What has
been factorised stays so until the program comes to another region: of several solutions of one
system only the first factorises it.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxclear.ground.elimination import Pattern, Tables, tables_of
from jaxclear.native.long_arrays import Buffer, entries_of, for_each, view
from jaxclear.native.writer import FLOAT, TRUTH, Writer, in_registers, long_rule, rule

# Systems of one pattern that stay factorised at a time: the stages of a step have one each.
MOST_FACTORISED = 8
# Marks in the text of a kernel that a pattern's functions take.
MARKS = 9


@rule("jaxclear_symmetric_solve")
@long_rule("jaxclear_symmetric_solve")
def _write_solve(writer, equation, *operands):
    system, lead = _System(writer, equation.params["pattern"]), operands[-1].shape[:-1]
    if not lead:
        return system.solved(*operands)
    operands = [np.broadcast_to(a, (*lead, a.shape[-1])) for a in map(in_registers, operands)]
    out = np.empty(operands[-1].shape, object)
    for index in np.ndindex(*lead):
        out[index] = in_registers(system.solved(*(a[index] for a in operands)))
    return out


class _System:
    """Systems of a pattern, in the kernel that is being written."""

    def __init__(self, writer: Writer, pattern: Pattern):
        self.writer, self.tables = writer, tables_of(pattern)
        self.number = writer.patterns.setdefault(pattern, len(writer.patterns))

    def solved(self, *operands: Any) -> Any:
        """The solution for a matrix, with the least pivots or without, and a right-hand side."""
        *matrix, right = operands
        factors = self._factor_in_memory(*matrix)
        x = Buffer(self.writer, right.shape, FLOAT)
        self._put_numbers(x, self.tables.unknown, right)
        self._call_function("solve", factors, x)
        return view(self.writer, x.array(), FLOAT, np.array(self.tables.unknown))

    def _factor_in_memory(self, entries: Any, least: Any = None) -> Buffer:
        """Memory with the factors of a matrix."""
        writer, tables, number = self.writer, self.tables, self.number
        names = (tuple(a.flat) if isinstance(a, np.ndarray) else a for a in (entries, least))
        key, owners = (number, *names), writer.owners
        if key in owners:
            return writer.factors[number, owners[key]]
        stale = [k for k in owners if k[0] == number]
        # Memory that is free, or was taken first.
        slot = len(stale) if len(stale) < MOST_FACTORISED else owners.pop(stale[0])
        if (number, slot) not in writer.factors:
            writer.factors[number, slot] = Buffer(writer, (tables.numbers,), FLOAT)
        buffer = writer.factors[number, slot]
        filled = sorted(set(range(tables.numbers)) - set(tables.at))
        self._put_numbers(buffer, filled, np.zeros(len(filled), object))
        self._put_numbers(buffer, tables.at, entries)
        if least is None:
            self._call_function("factorise", buffer)
        else:
            bounds = Buffer(writer, least.shape, FLOAT)
            self._put_numbers(bounds, tables.unknown, least)
            self._call_function("factorise_some", buffer, bounds)
        owners[key] = slot
        return buffer

    def _put_numbers(self, buffer: Buffer, places: Sequence[int], array: Any) -> None:
        """Puts the numbers of an array at places in memory."""
        writer = self.writer
        if isinstance(array, np.ndarray):
            for place, number in zip(places, array, strict=True):
                buffer.put(place, number)
            return
        entry, table = entries_of(writer, array, FLOAT), writer.table(np.array(places))

        def turn(k):
            at = writer.put(f"getelementptr i32, ptr {table}, i64 {k}")
            index_loaded = writer.put(f"load i32, ptr {at}, !invariant.load !0")
            buffer.put(writer.put(f"zext i32 {index_loaded} to i64"), entry(k))

        for_each(writer, len(places), turn)

    def _call_function(self, name: str, *rooms: Buffer) -> None:
        make = _solve_function if name == "solve" else _factor_function
        function = make(self.writer, name, self.number, self.tables)
        self.writer.needs |= {_table_constants(self.number, self.tables), function}
        pointer_arguments = ", ".join(f"ptr {buffer.start}" for buffer in rooms)
        self.writer.say(f"call void @NAME.{name}{self.number}({pointer_arguments})")


def _table_constants(number: int, tables: Tables) -> str:
    """The tables as constants."""
    return "\n".join(
        _constant_line(f"{name}{number}", np.array(getattr(tables, name)))
        for name in ("columns", "update_starts", "updates", "solve_starts", "solves")
    )


def _constant_line(name: str, values: np.ndarray) -> str:
    numbers = ", ".join(f"i32 {value}" for value in values.ravel())
    return f"@NAME.{name} = private constant [{values.size} x i32] [{numbers}]"


def _read_table_line(table: str, *names: str, line: str) -> str:
    """Lines that give names to the numbers in a line of a table of as many columns."""
    out, width = [], len(names)
    for column, name in enumerate(names):
        place = f"getelementptr [{width} x i32], ptr @NAME.{table}, i64 {line}, i64 {column}"
        out += [f"  %{name}.at = {place}", f"  %{name}.i = load i32, ptr %{name}.at"]
        out += [f"  %{name} = zext i32 %{name}.i to i64"]
    return "\n".join(out)


def _factor_function(writer: Writer, name: str, number: int, tables: Tables) -> str:
    """The function that puts the factors of a matrix in its place: of every column the inverse of
    its pivot, then L."""
    wide, one = writer.wide(FLOAT), writer.text(1.0, FLOAT)
    infinite = writer.text(math.inf, FLOAT)
    some = name == "factorise_some"
    bounded = f"""
  %least.at = getelementptr {wide}, ptr %least, i64 %j
  %bound = load {wide}, ptr %least.at
  %counts = fcmp ugt {wide} %said, %bound
  %pivot = select {writer.wide(TRUTH)} %counts, {wide} %said, {wide} {infinite}"""
    # Numbers of a stretch do not depend on each other: `parallel` says so.
    domain, loop, parallel = (f"!{MARKS * number + k + 3 * some}" for k in (1, 2, 3))
    return f"""define internal void @NAME.{name}{number}(ptr noalias %a{
        ", ptr noalias %least" if some else ""
    }) noinline {{
entry:
  %ahead = alloca [{tables.longest} x {wide}]
  br label %column
column:
  %j = phi i64 [ 0, %entry ], [ %after, %next ]
  %after = add i64 %j, 1
{_read_table_line(f"columns{number}", "start", line="%j")}
{_read_table_line(f"columns{number}", "end", line="%after")}
{_read_table_line(f"update_starts{number}", "line.first", line="%j")}
{_read_table_line(f"update_starts{number}", "line.end", line="%after")}
  %pivot.at = getelementptr {wide}, ptr %a, i64 %start
  %{"said" if some else "pivot"} = load {wide}, ptr %pivot.at{bounded if some else ""}
  %inverse = fdiv {wide} {one}, %pivot
  store {wide} %inverse, ptr %pivot.at
  %first = add i64 %start, 1
  %longer = icmp slt i64 %first, %end
  br i1 %longer, label %scale, label %next
scale:
  %e = phi i64 [ %first, %column ], [ %e.next, %scale ]
  %e.at = getelementptr {wide}, ptr %a, i64 %e
  %entry.said = load {wide}, ptr %e.at
  %k = sub i64 %e, %first
  %k.at = getelementptr {wide}, ptr %ahead, i64 %k
  store {wide} %entry.said, ptr %k.at
  %scaled = fmul {wide} %entry.said, %inverse
  store {wide} %scaled, ptr %e.at
  %e.next = add i64 %e, 1
  %e.more = icmp slt i64 %e.next, %end
  br i1 %e.more, label %scale, label %update
update:
  %line = phi i64 [ %line.first, %scale ], [ %line.next, %updated ]
{_read_table_line(f"updates{number}", "target", "source", "share", "length", line="%line")}
  %factor.at = getelementptr {wide}, ptr %ahead, i64 %share
  %factor = load {wide}, ptr %factor.at
  br label %stretch
stretch:
  %q = phi i64 [ 0, %update ], [ %q.next, %stretch ]
  %t = add i64 %target, %q
  %t.at = getelementptr {wide}, ptr %a, i64 %t
  %old = load {wide}, ptr %t.at, !llvm.access.group {domain}
  %s = add i64 %source, %q
  %s.at = getelementptr {wide}, ptr %a, i64 %s
  %l = load {wide}, ptr %s.at, !llvm.access.group {domain}
  %part = fmul contract {wide} %l, %factor
  %new = fsub contract {wide} %old, %part
  store {wide} %new, ptr %t.at, !llvm.access.group {domain}
  %q.next = add i64 %q, 1
  %q.more = icmp slt i64 %q.next, %length
  br i1 %q.more, label %stretch, label %updated, !llvm.loop {loop}
updated:
  %line.next = add i64 %line, 1
  %line.more = icmp slt i64 %line.next, %line.end
  br i1 %line.more, label %update, label %next
next:
  %more = icmp slt i64 %after, {len(tables.unknown)}
  br i1 %more, label %column, label %done
done:
  ret void
}}
{domain} = distinct !{{}}
{loop} = distinct !{{{loop}, {parallel}}}
{parallel} = !{{!"llvm.loop.parallel_accesses", {domain}}}"""


# What a table says of a stretch of a column.
STRETCH = ("row", "source", "length")


def _solve_function(writer: Writer, name: str, number: int, tables: Tables) -> str:
    """The function that puts the solution in the place of a right-hand side b: y of L y = b, column
    by column, and over the pivots; x of L^T x = y, from the end."""
    wide, last = writer.wide(FLOAT), len(tables.unknown) - 1
    domain, loop, parallel = (f"!{MARKS * number + k}" for k in (7, 8, 9))
    return f"""define internal void @NAME.{name}{number}(ptr noalias %a, ptr noalias %x) noinline {{
{_forward_lines(wide, number, last, f", !llvm.access.group {domain}", f", !llvm.loop {loop}")}
{_backward_lines(wide, number, last)}
done:
  ret void
}}
{domain} = distinct !{{}}
{loop} = distinct !{{{loop}, {parallel}}}
{parallel} = !{{!"llvm.loop.parallel_accesses", {domain}}}"""


def _column_lines(wide: str, number: int, ahead: str) -> str:
    """Lines that begin with a column: its place `j`, and the unknown there."""
    return f"""  %{ahead}j.next = add i64 %{ahead}j, 1
{_read_table_line(f"solve_starts{number}", f"{ahead}line.first", line=f"%{ahead}j")}
{_read_table_line(f"solve_starts{number}", f"{ahead}line.end", line=f"%{ahead}j.next")}
  %{ahead}x.at = getelementptr {wide}, ptr %x, i64 %{ahead}j
  %{ahead}x.said = load {wide}, ptr %{ahead}x.at
  %{ahead}any = icmp slt i64 %{ahead}line.first, %{ahead}line.end"""


def _entry_lines(wide: str, ahead: str, marks: str = "") -> str:
    """Lines with an entry of L and the unknown of its row."""
    return f"""  %{ahead}r = add i64 %{ahead}row, %{ahead}q
  %{ahead}r.at = getelementptr {wide}, ptr %x, i64 %{ahead}r
  %{ahead}old = load {wide}, ptr %{ahead}r.at{marks}
  %{ahead}s = add i64 %{ahead}source, %{ahead}q
  %{ahead}s.at = getelementptr {wide}, ptr %a, i64 %{ahead}s
  %{ahead}l = load {wide}, ptr %{ahead}s.at{marks}"""


def _forward_lines(wide: str, number: int, last: int, access: str, parallel: str) -> str:
    """Lines of the columns from the first to the last."""
    return f"""entry:
  br label %column
column:
  %j = phi i64 [ 0, %entry ], [ %j.next, %next ]
{_column_lines(wide, number, "")}
{_read_table_line(f"columns{number}", "start", line="%j")}
  %pivot.at = getelementptr {wide}, ptr %a, i64 %start
  %inverse = load {wide}, ptr %pivot.at
  %over = fmul {wide} %x.said, %inverse
  store {wide} %over, ptr %x.at
  br i1 %any, label %update, label %next
update:
  %line = phi i64 [ %line.first, %column ], [ %line.next, %updated ]
{_read_table_line(f"solves{number}", *STRETCH, line="%line")}
  br label %stretch
stretch:
  %q = phi i64 [ 0, %update ], [ %q.next, %stretch ]
{_entry_lines(wide, "", access)}
  %part = fmul contract {wide} %l, %x.said
  %new = fsub contract {wide} %old, %part
  store {wide} %new, ptr %r.at{access}
  %q.next = add i64 %q, 1
  %q.more = icmp slt i64 %q.next, %length
  br i1 %q.more, label %stretch, label %updated{parallel}
updated:
  %line.next = add i64 %line, 1
  %line.more = icmp slt i64 %line.next, %line.end
  br i1 %line.more, label %update, label %next
next:
  %more = icmp slt i64 %j, {last}
  br i1 %more, label %column, label %b.column"""


def _backward_lines(wide: str, number: int, last: int) -> str:
    """Lines of the columns from the last to the first."""
    return f"""b.column:
  %b.j = phi i64 [ {last}, %next ], [ %b.j.before, %b.next ]
{_column_lines(wide, number, "b.")}
  br i1 %b.any, label %b.update, label %b.next
b.update:
  %b.line = phi i64 [ %b.line.first, %b.column ], [ %b.line.next, %b.updated ]
  %b.begun = phi {wide} [ %b.x.said, %b.column ], [ %b.new, %b.updated ]
{_read_table_line(f"solves{number}", *(f"b.{each}" for each in STRETCH), line="%b.line")}
  br label %b.stretch
b.stretch:
  %b.q = phi i64 [ 0, %b.update ], [ %b.q.next, %b.stretch ]
  %b.sum = phi {wide} [ %b.begun, %b.update ], [ %b.new, %b.stretch ]
{_entry_lines(wide, "b.")}
  %b.part = fmul contract {wide} %b.l, %b.old
  %b.new = fsub contract {wide} %b.sum, %b.part
  %b.q.next = add i64 %b.q, 1
  %b.q.more = icmp slt i64 %b.q.next, %b.length
  br i1 %b.q.more, label %b.stretch, label %b.updated
b.updated:
  %b.line.next = add i64 %b.line, 1
  %b.line.more = icmp slt i64 %b.line.next, %b.line.end
  br i1 %b.line.more, label %b.update, label %b.next
b.next:
  %b.found = phi {wide} [ %b.x.said, %b.column ], [ %b.new, %b.updated ]
  store {wide} %b.found, ptr %b.x.at
  %b.j.before = sub i64 %b.j, 1
  %b.more = icmp sgt i64 %b.j, 0
  br i1 %b.more, label %b.column, label %done"""
