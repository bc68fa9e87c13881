"""Arrays that are too long for registers, in loops within a kernel.

Programs over many alike pieces map over them. Such a map is written as a loop: its rows are read,
and what it leaves is put, by index; arithmetic on arrays that it leaves is a loop over their
entries. A long array is a function from an index, the same for all samples, to a register: an array
in memory, or what another one is where an index is looked up in a table. What has no rule for long
arrays is handed all of their entries in registers.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.extend.core import DropVar

from jaxclear.native.writer import (
    FLOAT,
    INT,
    InMemory,
    Long,
    Unsupported,
    Writer,
    array_of,
    in_registers,
    is_num,
    kind_of,
)

# Memory of one kernel for what stands in it while it runs [bytes]: a share of a thread's stack.
MOST_MEMORY = 1 << 21
# Of an array in memory so many entries are read at once; more are looked up where they are needed.
LONGEST_LOOKED_UP = 11


def for_each(writer: Writer, count: int, turn: Callable[[str], None]) -> None:
    """Writes a loop with a fixed number of turns, which leave their results in memory.

    Args:
        writer: LLVM text under construction.
        count: number of turns.
        turn: function that writes a turn; it gets the register of the index.
    """
    head, behind = writer.fresh("each")[1:], writer.fresh("all")[1:]
    before = writer.block
    writer.say(f"br label %{head}")
    writer.start(head)
    index, place = writer.fresh("k"), len(writer.lines)
    region = writer.enter()
    turn(index)
    writer.leave(region)
    following = writer.fresh("k")
    writer.say(f"{following} = add i64 {index}, 1")
    writer.lines.insert(
        place, f"  {index} = phi i64 [ 0, %{before} ], [ {following}, %{writer.block} ]"
    )
    more = writer.put(f"icmp slt i64 {following}, {count}")
    writer.say(f"br i1 {more}, label %{head}, label %{behind}")
    writer.start(behind)


class Buffer:
    """Memory for an array of registers, which lasts as long as the kernel runs."""

    def __init__(self, writer: Writer, shape: tuple[int, ...], kind: str):
        self.writer, self.shape, self.kind = writer, shape, kind
        count = max(math.prod(shape), 1)
        writer.memory += 8 * writer.lanes * count
        if writer.memory > MOST_MEMORY:
            raise Unsupported("arrays this long")
        self.start = writer.fresh("room")
        writer.frame.append(f"  {self.start} = alloca [{count} x {writer.wide(kind)}], align 64")

    def put(self, index: Any, value: Any) -> None:
        """Writes an entry."""
        word = self.writer.text(value, self.kind)
        self.writer.say(f"store {self.writer.wide(self.kind)} {word}, ptr {self._place(index)}")

    def array(self) -> Long:
        """What stands in it."""
        return Long(self.shape, self.kind, self._load_entry, self)

    def _load_entry(self, index: Any) -> str:
        wide = self.writer.wide(self.kind)
        return self.writer.put(f"load {wide}, ptr {self._place(index)}")

    def _place(self, index: Any) -> str:
        wide = self.writer.wide(self.kind)
        return self.writer.put(f"getelementptr {wide}, ptr {self.start}, i64 {index}")


def entries_of(writer: Writer, array: Any, kind: str) -> Callable[[Any], Any]:
    """A function from an index, known or in a register, to an entry of an array.

    Args:
        writer: LLVM text under construction.
        array: of registers, in memory, or long.
        kind: of its numbers: `FLOAT`, `INT` or `TRUTH`.
    """
    if isinstance(array, Long):
        return array.entry
    if isinstance(array, InMemory):
        return lambda k: writer.read(array, k if is_num(k) else writer.spread(k, INT))
    flat = array.ravel()
    if len(flat) and all(x is flat[0] or x == flat[0] for x in flat):
        return lambda _: flat[0]
    if kind == FLOAT and is_num(*flat):
        return lambda k: flat[k] if is_num(k) else _look_up(writer, flat, k)
    return stored(writer, array, kind).entry


def _look_up(writer: Writer, numbers: np.ndarray, index: str) -> str:
    """One of many known numbers."""
    table = writer.table(numbers, FLOAT)
    place = writer.put(f"getelementptr double, ptr {table}, i64 {index}")
    return writer.spread(writer.put(f"load double, ptr {place}, !invariant.load !0"), FLOAT)


def stored(writer: Writer, array: Any, kind: str) -> Long:
    """An array copied into memory of its own.

    Args:
        writer: LLVM text under construction.
        array: of registers, in memory, or looked up.
        kind: of its numbers: `FLOAT`, `INT` or `TRUTH`.
    """
    buffer = Buffer(writer, tuple(array.shape), kind)
    if isinstance(array, (Long, InMemory)) or (kind == FLOAT and is_num(*array.flat)):
        entry = entries_of(writer, array, kind)
        for_each(writer, math.prod(array.shape), lambda k: buffer.put(k, entry(k)))
    else:
        for k, value in enumerate(array.flat):
            buffer.put(k, value)
    return buffer.array()


def view(writer: Writer, array: Any, kind: str, places: np.ndarray) -> Any:
    """The entries of an array at known places, in registers if there are few.

    Args:
        writer: LLVM text under construction.
        array: of registers, in memory, or long.
        kind: of its numbers: `FLOAT`, `INT` or `TRUTH`.
        places: row-major indices; their shape is that of the result.
    """
    entry, flat = entries_of(writer, array, kind), places.ravel()
    if len(flat) <= LONGEST_LOOKED_UP:
        entries = array_of(None, (len(flat),))
        for k, place in enumerate(flat.tolist()):
            entries[k] = entry(place)
        return entries.reshape(places.shape)
    index = _index_of_places(writer, flat)
    return Long(places.shape, kind, lambda k: entry(index(k)))


def _index_of_places(writer: Writer, places: np.ndarray) -> Callable[[Any], Any]:
    """Known places, by a number that is known or in a register."""
    first, step = int(places[0]), int(places[-1] - places[0]) // max(len(places) - 1, 1)
    if (np.diff(places) == step).all():

        def along(k):
            if is_num(k):
                return first + step * k
            ahead = k if step == 1 else writer.put(f"mul i64 {k}, {step}")
            return ahead if first == 0 else writer.put(f"add i64 {ahead}, {first}")

        return along
    table = writer.table(places)

    def looked_up(k):
        if is_num(k):
            return int(places[k])
        place = writer.put(f"getelementptr i32, ptr {table}, i64 {k}")
        index_loaded = writer.put(f"load i32, ptr {place}, !invariant.load !0")
        return writer.put(f"zext i32 {index_loaded} to i64")

    return looked_up


def update_long(
    writer: Writer, array: Any, kind: str, places: np.ndarray, update: Any, combine: Callable
) -> Long:
    """A copy of an array, with entries at known places combined with an update, one after another.

    Args:
        writer: LLVM text under construction.
        array: of registers, in memory, or long.
        kind: of its numbers: `FLOAT`, `INT` or `TRUTH`.
        places: row-major indices, in the shape of the update.
        update: array of registers, in memory, or long.
        combine: function that writes the new entry from the old one and that of the update.
    """
    out, entry, index = stored(writer, array, kind).buffer, entries_of(writer, update, kind), None
    if not places.size:
        return out.array()
    index, old_entry = _index_of_places(writer, places.ravel()), out.array().entry

    def put(k):
        place = index(k)
        out.put(place, combine(old_entry(place), entry(k)))

    for_each(writer, places.size, put)
    return out.array()


def unstack_rows(writer: Writer, equation: Any, array: Any, kind: str, places: np.ndarray) -> list:
    """The rows of an array that the program reads; empty arrays for the others.

    Args:
        writer: LLVM text under construction.
        equation: of the primitive; outputs that it drops are not read.
        array: of registers, in memory, or long.
        kind: of its numbers: `FLOAT`, `INT` or `TRUTH`.
        places: row-major indices, a row for each output.
    """
    return [
        array_of(None, row.shape) if isinstance(atom, DropVar) else view(writer, array, kind, row)
        for row, atom in zip(places, equation.outvars, strict=True)
    ]


def join_arrays(writer: Writer, arrays: Sequence[Any], kind: str, axis: int) -> Any:
    """Arrays joined along an axis, at least one of them long.

    Args:
        writer: LLVM text under construction.
        arrays: of registers, in memory, or long.
        kind: of all their numbers: `FLOAT`, `INT` or `TRUTH`.
        axis: along which they follow each other.
    """
    places, start = [], 0
    for array in arrays:
        count = math.prod(array.shape)
        places.append(np.arange(start, start + count).reshape(array.shape))
        start += count
    buffer, first = Buffer(writer, (start,), kind), 0
    for array in arrays:
        count, ahead = math.prod(array.shape), first
        if isinstance(array, (Long, InMemory)):
            entry = entries_of(writer, array, kind)

            def put(k, ahead=ahead, entry=entry):
                buffer.put(writer.put(f"add i64 {k}, {ahead}"), entry(k))

            for_each(writer, count, put)
        else:
            for k, value in enumerate(array.flat):
                buffer.put(ahead + k, value)
        first += count
    order = np.concatenate(places, axis)
    if (np.diff(order.ravel()) == 1).all():
        return buffer.array().reshaped(order.shape)
    return view(writer, buffer.array(), kind, order)


def join_rows(writer: Writer, rows: Sequence[Any], kind: str) -> Any:
    """Arrays of one shape as the rows of one array, which is long where one of them is.

    Args:
        writer: LLVM text under construction.
        rows: arrays of registers, or long.
        kind: of all their numbers: `FLOAT`, `INT` or `TRUTH`.
    """
    if not any(isinstance(row, Long) for row in rows):
        return np.stack(rows)
    return join_arrays(writer, [_as_row(row) for row in rows], kind, 0)


def _as_row(array: Any) -> Any:
    shape = (1, *array.shape)
    return array.reshaped(shape) if isinstance(array, Long) else array.reshape(shape)


def _broadcast_entries(writer: Writer, array: Any, kind: str, shape: tuple[int, ...]) -> Callable:
    """The entries of an array as those of one of this shape: of an axis of length 1 the one entry
    stands for all."""
    if math.prod(array.shape) == 1:
        one: str = in_registers(array).item()
        return lambda _: one
    entry = entries_of(writer, array, kind)
    if tuple(array.shape) == shape:
        return entry
    places = np.arange(math.prod(array.shape)).reshape(array.shape)
    index = _index_of_places(writer, np.broadcast_to(places, shape).ravel())
    return lambda k: entry(index(k))


def entrywise(writer: Writer, rule: Callable, equation: Any, arrays: Sequence[Any]) -> Long:
    """An elementwise operation on long arrays, as a loop over entries.

    Args:
        writer: LLVM text under construction.
        rule: function that writes the operation for single numbers.
        equation: of the primitive, with the shape of the result.
        arrays: operands: long arrays of this shape, and single numbers.
    """
    aval = equation.outvars[0].aval
    kinds = [kind_of(atom.aval.dtype) for atom in equation.invars]
    buffer = Buffer(writer, tuple(aval.shape), kind_of(aval.dtype))
    pairs = zip(arrays, kinds, strict=True)
    each = [_broadcast_entries(writer, array, kind, buffer.shape) for array, kind in pairs]

    def turn(k):
        entry_result = rule(writer, equation, *[array_of(entry(k), ()) for entry in each])
        buffer.put(k, entry_result.item())

    for_each(writer, math.prod(aval.shape), turn)
    return buffer.array()


def map_rows(
    writer: Writer, rows: Sequence[Any], kinds: Sequence[str], avals: Sequence[Any], body: Callable
) -> list[Long]:
    """Results of a function of each row of arrays, as a loop over rows.

    Args:
        writer: LLVM text under construction.
        rows: arrays with rows along their first axis.
        kinds: of each of these.
        avals: shapes and types of the results, rows along their first axis.
        body: function that writes one turn: from a list of arrays of registers to a list of such.
    """
    rooms = [Buffer(writer, tuple(aval.shape), kind_of(aval.dtype)) for aval in avals]
    entries = [entries_of(writer, row, kind) for row, kind in zip(rows, kinds, strict=True)]

    def index(k, j, size):
        ahead = k if size == 1 else writer.put(f"mul i64 {k}, {size}")
        return ahead if j == 0 else writer.put(f"add i64 {ahead}, {j}")

    def turn(k):
        picked = []
        for row, entry in zip(rows, entries, strict=True):
            row_at_turn = array_of(None, row.shape[1:])
            for j, place in enumerate(np.ndindex(*row_at_turn.shape)):
                row_at_turn[place] = entry(index(k, j, row_at_turn.size))
            picked.append(row_at_turn)
        for buffer, result in zip(rooms, body(picked), strict=True):
            for j, value in enumerate(in_registers(result).flat):
                buffer.put(index(k, j, result.size), value)

    for_each(writer, rows[0].shape[0] if rows else avals[0].shape[0], turn)
    return [buffer.array() for buffer in rooms]


# An array of the state that is longer than this stands in memory while a loop goes on.
LONGEST_CARRIED = 256


def carried_in_memory(writer: Writer, carry: Sequence[Any], kinds: Sequence[str]) -> list[Any]:
    """Memory for each array that a loop carries, filled with its first value.

    None for arrays in registers, and for those that have a place in memory already.

    Args:
        writer: LLVM text under construction.
        carry: first state of the loop.
        kinds: of its arrays.
    """
    rooms: list[Buffer | None] = []
    for array, kind in zip(carry, kinds, strict=True):
        buffer = None
        if not isinstance(array, InMemory) and math.prod(array.shape) > LONGEST_CARRIED:
            buffer = Buffer(writer, tuple(array.shape), kind)
            # Those that have ended have nothing there yet.
            active, writer.active = writer.active, None
            fill(writer, buffer, array)
            writer.active = active
        rooms.append(buffer)
    return rooms


def fill(writer: Writer, buffer: Buffer, array: Any) -> None:
    """Writes an array into memory; samples that have ended keep what is there.

    Args:
        writer: LLVM text under construction.
        buffer: memory of the array's shape and kind.
        array: of registers, in memory, or long.
    """
    old_entry = buffer.array().entry

    def put(k, value):
        if writer.active is not None:
            value = writer.choose(writer.active, value, old_entry(k), buffer.kind)
        buffer.put(k, value)

    if isinstance(array, (Long, InMemory)):
        entry = entries_of(writer, array, buffer.kind)
        for_each(writer, math.prod(array.shape), lambda k: put(k, entry(k)))
    else:
        for k, value in enumerate(array.flat):
            put(k, value)


def put_back(writer: Writer, rooms: Sequence[Buffer | None], after: Sequence[Any]) -> None:
    """Writes the state after a turn to where the next turn reads it.

    Entries that are looked up in arrays before this turn are computed before one of them changes.

    Args:
        writer: LLVM text under construction.
        rooms: memory of each array; None for those in registers.
        after: state after the turn.
    """
    new_values = []
    for buffer, array in zip(rooms, after, strict=True):
        elsewhere = (
            isinstance(array, Long) and array.buffer is not None and array.buffer not in rooms
        )
        if buffer is None or not isinstance(array, Long) or array.buffer is buffer or elsewhere:
            new_values.append(array)
        else:
            new_values.append(stored(writer, array, buffer.kind))
    for buffer, array in zip(rooms, new_values, strict=True):
        if buffer is not None and not (isinstance(array, Long) and array.buffer is buffer):
            fill(writer, buffer, array)
