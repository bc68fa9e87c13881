"""Machine code of a whole while loop, called from compiled JAX programs.

The loop is written by the rules, compiled by LLVM, and entered in the table of `dispatch` under a
number that its text decides. Samples run `lanes` at a time. A kernel writes the last state as a
packed row, its long arrays where they stand, and the tables that turns of a scan leave: each is an
array of its own in memory, in which every sample has its rows. Samples of a scan go through the
same turns, so that a turn's place in a table is one for all.
"""

import collections
import contextlib
import functools
import hashlib
import math
import threading
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxclear.native import check, dispatch, elementary, object_code, stopping
from jaxclear.native import indexing as _indexing  # noqa: F401  (its rules register themselves)
from jaxclear.native import linear_systems as _linear_systems  # noqa: F401
from jaxclear.native import long_rules as _long_rules  # noqa: F401
from jaxclear.native.control import write_loop
from jaxclear.native.long_arrays import for_each
from jaxclear.native.program import (
    Program,
    arrays_in_memory,
    avals_of,
    floats_in,
    in_memory,
    packed_state,
    row_of,
)
from jaxclear.native.writer import (
    FLOAT,
    INT,
    TRUTH,
    InMemory,
    Long,
    Writer,
    array_of,
    kind_of,
    write_closed,
)


def text_of(program: Program, lanes: int, checked: bool = False) -> str:
    """LLVM code of the loop, function `NAME.loop(in, out, big)`, and of what it calls.

    Args:
        program: the loop, its condition and body as JAX programs.
        lanes: samples that it takes at once.
        checked: whether it takes one turn only.
    """
    writer = Writer(lanes, bool(program.length), checked)
    values = _load_arguments(writer, program)
    c, b = program.condition_constants, program.body_constants
    fixed_condition, fixed_body, first = values[:c], values[c : c + b], values[c + b :]
    first = copy_long_state(writer, program, first)
    kinds = [kind_of(a.dtype) for a in avals_of(program)[1]]
    tables = Tables(writer, program, fixed_body)

    def turn(state):
        results = write_closed(writer, program.body, [*fixed_body, *state])
        tables.leave(results[len(state) :])
        return results[: len(state)]

    tables.begin()
    last = write_loop(
        writer,
        lambda s: write_closed(writer, program.condition, [*fixed_condition, *s])[0].item(),
        turn,
        first,
        kinds,
        outermost=True,
        together=bool(program.length),
    )
    if program.tables and not checked:
        tables.invalidate_if_stopped(last[0].item(), first)
    position = 0
    for array, kind in zip(last, kinds, strict=True):
        position += 0 if isinstance(array, InMemory) else _store(writer, position, array, kind)
    parts = [_head_of_loop(lanes), *writer.frame, *writer.lines, "  ret void\n}"]
    needs = set(writer.needs)
    for name, make in elementary.DEFINITIONS.items():
        if name in needs:
            lines, further = make(lanes)
            parts, needs = [*lines, *parts], (needs - {name}) | further
    parts += [SPOIL] if program.tables else []
    return "\n".join([*sorted(needs), *parts, "!0 = !{}"])


def _head_of_loop(lanes: int) -> str:
    """The first lines of the loop's function."""
    # LLVM lays a vector that it puts aside wherever the stack happens to be: across two lines of
    # the cache a step took 4 % longer, or not, as a change anywhere in the loop moved them.
    aligned = f"alignstack({8 * lanes}) " if lanes > 1 else ""
    return (
        "define internal void @NAME.loop(ptr noalias %in, ptr noalias %out, ptr noalias %big) "
        f"{aligned}{{\nentry:"
    )


def _load_arguments(writer: Writer, program: Program) -> list:
    """Constants and first state: arrays of registers, loaded one by one, or arrays in memory."""
    constants, state = avals_of(program)
    position, slot = 0, 0
    values: list[Any] = []
    for i, (aval, long) in enumerate(zip([*constants, *state], in_memory(program), strict=True)):
        kind, shape = kind_of(aval.dtype), tuple(aval.shape)
        if long:
            starts = array_starts(writer, slot)
            is_shared = i in program.shared
            values.append(InMemory(starts[:1] * writer.lanes if is_shared else starts, shape))
            slot += 1
            continue
        array = array_of(None, shape)
        for index in np.ndindex(*shape):
            array[index] = _load_number(writer, position, kind)
            position += 1
        values.append(array)
    return values


def _load_number(writer: Writer, position: int, kind: str) -> str:
    place = writer.put(f"getelementptr double, ptr %in, i64 {position * writer.lanes}")
    value = writer.put(f"load {writer.wide(FLOAT)}, ptr {place}")
    if kind == INT:
        return writer.put(f"fptosi {writer.wide(FLOAT)} {value} to {writer.wide(INT)}")
    return writer.operate("fcmp une {type} {0}, {1}", FLOAT, value, 0.0) if kind == TRUTH else value


class Kernel:
    """Compiled code, and the number by which a program calls it.

    It goes with the last program that keeps it, and the last executable of XLA's that calls it: its
    number then leaves the table, and its machine code the memory.
    """

    def __init__(self, number: int, name: str, engine: Any, key: str):
        self.number, self._entry = number, engine.get_function_address(name)
        self._identity = number, name, key
        weakref.finalize(self, _dropped, number, self._entry, engine).atexit = False

    def __reduce__(self):
        # A program that is kept on disk keeps its kernels by the keys under which they lie there.
        return restore_kernel, self._identity

    def publish(self) -> None:
        """Programs may call it from now on."""
        dispatch.enter_kernel(self.number, self._entry)


# Numbers, addresses and machine code of kernels that no program keeps, but perhaps an executable. A
# deque: finalizers, in whatever thread, may not wait for a lock.
_LINGERING: "collections.deque[tuple[int, int, Any]]" = collections.deque()


def _dropped(number: int, entry: int, engine: Any) -> None:
    """No program keeps a kernel any more, whose machine code `engine` holds."""
    _LINGERING.append((number, entry, engine))
    free_the_unused()


def free_the_unused() -> None:
    """Frees machine code that lingers, where no executable calls it any more."""
    for _ in range(len(_LINGERING)):
        with contextlib.suppress(IndexError):
            number, entry, engine = _LINGERING.popleft()
            if dispatch.row_of_kernel(number).executables:
                _LINGERING.append((number, entry, engine))
            else:
                dispatch.remove(number, entry)


# Two threads that compile the same loop share one kernel.
_BUILDING = threading.RLock()
_KERNELS: "weakref.WeakValueDictionary[int, Kernel]" = weakref.WeakValueDictionary()


def _assembled(
    program: Program, lanes: int, checked: bool = False, is_run_once: bool = False
) -> tuple[str, int, str]:
    """The name and the number of a kernel, which its whole text and how it is compiled decide, and
    this text."""
    text = text_of(program, lanes, checked)
    constants, state = avals_of(program)
    array_shapes = list(zip([*constants, *state], in_memory(program), strict=True))
    long = [aval for aval, is_long in array_shapes if is_long]
    shared = [i in program.shared for i, is_long in enumerate(in_memory(program)) if is_long]
    form = f"{lanes}{[a.shape for a in long]}{shared}{program.tables}{program.length}{program.long}"
    form += "once" if is_run_once else ""
    changed = [floats_in([aval]) for aval in arrays_in_memory(program)]
    mark = hashlib.sha256(f"{text}{form}".encode()).hexdigest()
    name = f"jaxclear_{mark[:24]}"
    frame = dispatch.frame_code(
        name,
        lanes,
        width=floats_in([aval for aval, is_long in array_shapes if not is_long]),
        height=floats_in(packed_state(program)),
        in_memory=[0 if one else floats_in([aval]) for aval, one in zip(long, shared, strict=True)],
        tables=[*changed, *sizes_of_tables(program)],
    )
    flag = f"@{stopping.SYMBOL} = external global i64\n"
    full_text = flag + text.replace("@NAME", f"@{name}") + frame
    return (name, max(int(mark[:16], 16) >> 1, 1), full_text)


def build(program: Program, lanes: int, is_run_once: bool = False) -> Kernel:
    """Compile and make known, and check where that is asked for.

    Args:
        program: of the loop.
        lanes: number of samples that the kernel takes at once.
        is_run_once: whether it runs once, and so is not optimised.

    Raises:
        Unsupported: a part of the program has no machine code.
    """
    dispatch.register_with_xla()
    free_the_unused()
    name, number, text = _assembled(program, lanes, is_run_once=is_run_once)
    with _BUILDING:
        kernel = _KERNELS.get(number)
        if kernel is None:
            if check.is_check_enabled():
                _check_turn(program, lanes)
            code = object_code.load_or_compile(text, is_run_once)
            kernel = _register_kernel(number, name, *code)
        return kernel


def _register_kernel(number: int, name: str, engine: Any, key: str) -> Kernel:
    kernel = Kernel(number, name, engine, key)
    kernel.publish()
    _KERNELS[number] = kernel
    return kernel


def restore_kernel(number: int, name: str, key: str) -> Kernel:
    """A kernel of an earlier process, from the files in the cache.

    Args:
        number: by which programs call it.
        name: in messages and profiles.
        key: under which it is stored.

    Raises:
        FileNotFoundError: it is not in the cache.
    """
    dispatch.register_with_xla()
    with _BUILDING:
        kernel = _KERNELS.get(number)
        if kernel is None:
            engine = object_code.from_disk(key)
            if engine is None:
                raise FileNotFoundError(f"no kernel {key}")
            kernel = _register_kernel(number, name, engine, key)
        return kernel


def turn_of(program: Program, lanes: int) -> check.Turn:
    """One turn of the loop by a kernel of this processor. Raises `Unsupported`."""
    name, _, text = _assembled(program, lanes, checked=True)
    engine = object_code.compiled(text)

    address = lambda: engine.get_function_address(f"{name}.samples")
    return lambda samples: check.turn_by_kernel(program, address(), samples)


def _check_turn(program: Program, lanes: int) -> None:
    """Raises `Unsupported` where one turn of the loop is not what JAX makes of it."""
    check.check(program, turn_of(program, lanes), functools.partial(check.turn_by_jax, program))


def over_numbers(head: str, count: str, lines: str) -> str:
    """LLVM code of a function that loops over numbers.

    Args:
        head: its name and parameters.
        count: register or literal with the number of turns.
        lines: code of a turn, which has the index in `%k`.
    """
    return f"""define internal void @NAME.{head} {{
entry:
  br label %more
more:
  %k = phi i64 [ 0, %entry ], [ %next, %one ]
  %going = icmp slt i64 %k, {count}
  br i1 %going, label %one, label %done
one:
{lines}
  %next = add i64 %k, 1
  br label %more
done:
  ret void
}}"""


# Fills an array with nan, which nobody takes for an answer.
SPOIL = over_numbers(
    "spoil(ptr %array, i64 %numbers)",
    "%numbers",
    """  %place = getelementptr double, ptr %array, i64 %k
  store double 0x7FF8000000000000, ptr %place""",
)


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
            initial_row = 0 if table.start is None else self.constants[table.start]
            long = isinstance(initial_row, InMemory)
            self._put_row(k, initial_row if long else array_of(initial_row, aval.shape), "0")

    def leave(self, row: Sequence[np.ndarray]) -> None:
        """A turn's row, each of its arrays at its place, where it has one."""
        turn, writer = self.writer.turn, self.writer
        kinds = {(table.places, table.height) for table in self.program.tables}
        for places, height in sorted(kinds):
            start = self.constants[places].places[0]
            where = writer.put(f"getelementptr double, ptr {start}, i64 {turn}")
            place_loaded = writer.put(f"load double, ptr {where}, !invariant.load !0")
            place = writer.put(f"fptosi double {place_loaded} to i64")
            is_within = writer.put(f"icmp slt i64 {place}, {height}")
            before_label, after_label = writer.fresh("left")[1:], writer.fresh("passed")[1:]
            writer.say(f"br i1 {is_within}, label %{before_label}, label %{after_label}")
            writer.start(before_label)
            for k, table in enumerate(self.program.tables):
                if (table.places, table.height) == (places, height):
                    self._put_row(k, row[k], place)
            writer.say(f"br label %{after_label}")
            writer.start(after_label)

    def _put_row(self, k: int, array: Any, place: str) -> None:
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
        if isinstance(array, Long):

            def put(k):
                word = as_float(writer, array.entry(k), kind)
                for lane, row in enumerate(rows):
                    target = writer.put(f"getelementptr double, ptr {row}, i64 {k}")
                    writer.say(f"store double {writer.lane(word, FLOAT, lane)}, ptr {target}")

            for_each(writer, count, put)
            return
        words = [as_float(writer, value, kind) for value in array.flat]
        for lane, row in enumerate(rows):
            for j, word in enumerate(words):
                number = word
                if writer.lanes > 1:
                    wide = writer.wide(FLOAT)
                    number = writer.put(f"extractelement {wide} {word}, i64 {lane}")
                target = writer.put(f"getelementptr double, ptr {row}, i64 {j}")
                writer.say(f"store double {number}, ptr {target}")

    def invalidate_if_stopped(self, turns: Any, state: Sequence[Any]) -> None:
        """All rows, and long arrays of the state, become nan where the loop was stopped before it
        had taken all its `turns`."""
        writer = self.writer
        taken = writer.lane(turns, INT, 0)
        is_complete = writer.put(f"icmp eq i64 {taken}, {self.program.length}")
        spoil, done = writer.fresh("spoil")[1:], writer.fresh("whole")[1:]
        writer.say(f"br i1 {is_complete}, label %{done}, label %{spoil}")
        writer.start(spoil)
        arrays = list(zip(self.starts, sizes_of_tables(self.program), strict=True))
        arrays += [(a.places, math.prod(a.shape)) for a in state if isinstance(a, InMemory)]
        for start, size in [(start, size) for spans, size in arrays for start in spans]:
            writer.say(f"call void @NAME.spoil(ptr {start}, i64 {size})")
        writer.say(f"br label %{done}")
        writer.start(done)


def copy_long_state(writer: Writer, program: Program, state: Sequence[Any]) -> list[Any]:
    """The first state, with long arrays copied to where the kernel returns them; its inputs stay.

    Args:
        writer: LLVM text under construction.
        program: the loop, its condition and body as JAX programs.
        state: arrays of registers, or in memory.
    """
    out, ahead = list(state), sum(in_memory(program))
    for k, i in enumerate(sorted(program.long)):
        places = array_starts(writer, ahead + k)
        writer.copy(state[i], places, math.prod(state[i].shape))
        out[i] = InMemory(places, state[i].shape, version=0)
    return out


def _store(writer: Writer, position: int, array: Any, kind: str) -> int:
    """Puts an array into the packed row, from a position on; how many numbers these are."""
    if not isinstance(array, Long):
        for k, value in enumerate(array.flat, position):
            store_number(writer, k, value, kind)
        return array.size

    def put(k):
        ahead = writer.put(f"add i64 {k}, {position}")
        place = writer.put(f"getelementptr {writer.wide(FLOAT)}, ptr %out, i64 {ahead}")
        word = as_float(writer, array.entry(k), kind)
        writer.say(f"store {writer.wide(FLOAT)} {word}, ptr {place}")

    for_each(writer, array.size, put)
    return array.size


def store_number(writer: Writer, position: int, value: Any, kind: str) -> None:
    """Writes a number into the packed row of results.

    Args:
        writer: LLVM text under construction.
        position: of the number in the row.
        value: register name or Python number.
        kind: of the number: `FLOAT`, `INT` or `TRUTH`.
    """
    place = writer.put(f"getelementptr double, ptr %out, i64 {position * writer.lanes}")
    writer.say(f"store {writer.wide(FLOAT)} {as_float(writer, value, kind)}, ptr {place}")


def as_float(writer: Writer, value: Any, kind: str) -> str:
    """A number of any kind as the float that stands for it in memory.

    Args:
        writer: LLVM text under construction.
        value: register name or Python number.
        kind: of the number: `FLOAT`, `INT` or `TRUTH`.
    """
    word = writer.text(value, kind)
    if kind == FLOAT:
        return word
    convert = "sitofp" if kind == INT else "uitofp"
    return writer.put(f"{convert} {writer.wide(kind)} {word} to {writer.wide(FLOAT)}")
