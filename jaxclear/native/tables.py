"""What a kernel writes: the last state as a packed row, its long arrays where they stand, and the
tables that turns of a scan leave: each is an array of its own in memory, in which every sample has
its rows.

Samples of a scan go through the same turns, so that a turn's place in a table is one for all.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxclear.native.program import Program, floats_in, in_memory, row_of
from jaxclear.native.rules import array_of
from jaxclear.native.writer import FLOAT, WHOLE, InMemory, Writer, kind_of

# Fills an array with nan, which nobody takes for an answer.
SPOIL = """define internal void @NAME.spoil(ptr %array, i64 %numbers) {
entry:
  br label %more
more:
  %k = phi i64 [ 0, %entry ], [ %next, %one ]
  %going = icmp slt i64 %k, %numbers
  br i1 %going, label %one, label %done
one:
  %place = getelementptr double, ptr %array, i64 %k
  store double 0x7FF8000000000000, ptr %place
  %next = add i64 %k, 1
  br label %more
done:
  ret void
}"""


def array_starts(writer: Writer, slot: int) -> list[str]:
    """Registers with the place of each sample's part of the array that is so far behind the packed
    row."""
    first = slot * writer.lanes
    places = [
        writer.put(f"getelementptr ptr, ptr %big, i64 {first + lane}")
        for lane in range(writer.lanes)
    ]
    return [writer.put(f"load ptr, ptr {place}") for place in places]


def sizes_of_tables(program: Program) -> list[int]:
    """Numbers in each of the tables of a sample."""
    pairs = zip(program.tables, row_of(program), strict=True)
    return [table.height * floats_in([aval]) for table, aval in pairs]


class Tables:
    """The tables of a program whose kernel is being written; `constants` are its body's."""

    def __init__(self, writer: Writer, program: Program, constants: Sequence[Any]):
        self.writer, self.program, self.constants = writer, program, constants
        ahead = sum(in_memory(program)) + len(program.long)
        self.starts = [array_starts(writer, ahead + k) for k in range(len(program.tables))]
        self.avals = row_of(program)

    def begin(self) -> None:
        """Their first rows as they stand from the start: zeros where no constant says otherwise,
        for a turn to write over."""
        for k, (table, aval) in enumerate(zip(self.program.tables, self.avals, strict=True)):
            given = 0 if table.begins is None else self.constants[table.begins]
            long = isinstance(given, InMemory)
            self._put(k, given if long else array_of(given, aval.shape), "0")

    def leave(self, row: Sequence[np.ndarray]) -> None:
        """A turn's row, each of its arrays at its place, where it has one."""
        turn, writer = self.writer.turn, self.writer
        kinds = {(table.places, table.height) for table in self.program.tables}
        for places, height in sorted(kinds):
            start = self.constants[places].places[0]
            where = writer.put(f"getelementptr double, ptr {start}, i64 {turn}")
            said = writer.put(f"load double, ptr {where}, !invariant.load !0")
            place = writer.put(f"fptosi double {said} to i64")
            wanted = writer.put(f"icmp slt i64 {place}, {height}")
            left, passed = writer.fresh("left")[1:], writer.fresh("passed")[1:]
            writer.say(f"br i1 {wanted}, label %{left}, label %{passed}")
            writer.start(left)
            for k, table in enumerate(self.program.tables):
                if (table.places, table.height) == (places, height):
                    self._put(k, row[k], place)
            writer.say(f"br label %{passed}")
            writer.start(passed)

    def _put(self, k: int, array: Any, place: str) -> None:
        """Every sample's numbers of an array into a row of its table."""
        writer, kind = self.writer, kind_of(self.avals[k].dtype)
        count = floats_in([self.avals[k]])
        ahead = writer.put(f"mul i64 {place}, {count}")
        rows = [
            writer.put(f"getelementptr double, ptr {start}, i64 {ahead}")
            for start in self.starts[k]
        ]
        if isinstance(array, InMemory):
            writer.copy(array, rows, count)
            return
        words = [as_float(writer, value, kind) for value in array.flat]
        for lane, own in enumerate(rows):
            for j, word in enumerate(words):
                number = word
                if writer.lanes > 1:
                    wide = writer.wide(FLOAT)
                    number = writer.put(f"extractelement {wide} {word}, i64 {lane}")
                target = writer.put(f"getelementptr double, ptr {own}, i64 {j}")
                writer.say(f"store double {number}, ptr {target}")

    def spoil_unless_whole(self, turns: Any, checked: str, state: Sequence[Any]) -> None:
        """All rows, and long arrays of the state, become nan where the loop was stopped before it
        had taken all its `turns`; a kernel under check takes one."""
        writer = self.writer
        taken = writer.lane(turns, WHOLE, 0)
        ended = writer.put(f"icmp eq i64 {taken}, {self.program.length}")
        whole = writer.put(f"or i1 {ended}, {checked}")
        spoil, done = writer.fresh("spoil")[1:], writer.fresh("whole")[1:]
        writer.say(f"br i1 {whole}, label %{done}, label %{spoil}")
        writer.start(spoil)
        arrays = list(zip(self.starts, sizes_of_tables(self.program), strict=True))
        arrays += [(a.places, math.prod(a.shape)) for a in state if isinstance(a, InMemory)]
        for start, size in [(start, size) for own, size in arrays for start in own]:
            writer.say(f"call void @NAME.spoil(ptr {start}, i64 {size})")
        writer.say(f"br label %{done}")
        writer.start(done)


def handed_over(writer: Writer, program: Program, state: Sequence[Any]) -> list[Any]:
    """The first state, its long arrays where the kernel leaves them: what it is given stays."""
    out, ahead = list(state), sum(in_memory(program))
    for k, i in enumerate(sorted(program.long)):
        places = array_starts(writer, ahead + k)
        writer.copy(state[i], places, math.prod(state[i].shape))
        out[i] = InMemory(places, state[i].shape, version=0)
    return out


def store(writer: Writer, position: int, value: Any, kind: str) -> None:
    """A number of the packed row."""
    place = writer.put(f"getelementptr double, ptr %out, i64 {position * writer.lanes}")
    writer.say(f"store {writer.wide(FLOAT)} {as_float(writer, value, kind)}, ptr {place}")


def as_float(writer: Writer, value: Any, kind: str) -> str:
    """A number of any kind as the float that stands for it in memory."""
    word = writer.text(value, kind)
    if kind == FLOAT:
        return word
    convert = "sitofp" if kind == WHOLE else "uitofp"
    return writer.put(f"{convert} {writer.wide(kind)} {word} to {writer.wide(FLOAT)}")
