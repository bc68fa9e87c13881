"""Machine code of a whole while loop, called from compiled JAX programs.

The loop is written by the rules, compiled by LLVM, checked on random numbers, and entered in the
table of `dispatch` under a number that its text decides. Samples run `lanes` at a time.
"""

import collections
import contextlib
import hashlib
import threading
import weakref
from typing import Any

import numpy as np

from jaxclear.native import (  # noqa: F401  (rules register themselves when imported)
    call_frame,
    calls,
    control,
    dispatch,
    elementary,
    functions,
    indexing,
    machine,
    shapes,
    stopping,
)
from jaxclear.native.by_numpy import LONGEST_LOOP
from jaxclear.native.check import check
from jaxclear.native.program import (
    Program,
    avals_of,
    changing,
    floats_in,
    in_memory,
    packed_state,
)
from jaxclear.native.rules import array_of, write_closed
from jaxclear.native.tables import SPOIL, Tables, array_starts, handed_over, sizes_of_tables, store
from jaxclear.native.turning import loop
from jaxclear.native.writer import (
    ENDLESS,
    FLOAT,
    STOP_FLAG,
    TRUTH,
    WHOLE,
    InMemory,
    Writer,
    kind_of,
)

# Turns after which a loop within the loop is given up while a kernel is checked.
MOST_TURNS = 10 * LONGEST_LOOP


def text_of(program: Program, lanes: int) -> str:
    """The loop as LLVM code, function `NAME.loop(in, out, big, most)`, and what it calls."""
    writer = Writer(lanes, bool(program.length))
    values = _arguments(writer, program)
    c, b = program.condition_constants, program.body_constants
    fixed_condition, fixed_body, first = values[:c], values[c : c + b], values[c + b :]
    first = handed_over(writer, program, first)
    kinds = [kind_of(a.dtype) for a in avals_of(program)[1]]
    tables = Tables(writer, program, fixed_body)

    def turn(state):
        found = write_closed(writer, program.body, [*fixed_body, *state])
        tables.leave(found[len(state) :])
        return found[: len(state)]

    checked = writer.put("icmp sgt i64 %most, 0")
    writer.most = writer.put(f"select i1 {checked}, i64 %most, i64 {ENDLESS}")
    writer.most_inside = writer.put(f"select i1 {checked}, i64 {MOST_TURNS}, i64 {ENDLESS}")
    tables.begin()
    last = loop(
        writer,
        lambda s: write_closed(writer, program.condition, [*fixed_condition, *s])[0].item(),
        turn,
        first,
        kinds,
        outermost=True,
        together=bool(program.length),
    )
    if program.tables:
        tables.spoil_unless_whole(last[0].item(), checked, first)
    numbers = [
        (value, kind)
        for array, kind in zip(last, kinds, strict=True)
        if not isinstance(array, InMemory)
        for value in array.flat
    ]
    for position, (value, kind) in enumerate(numbers):
        store(writer, position, value, kind)
    parts = [_head(lanes), *writer.lines, "  ret void\n}"]
    needs = set(writer.needs)
    for name, make in functions.OWN.items():
        if name in needs:
            lines, further = make(lanes)
            parts, needs = [*lines, *parts], (needs - {name}) | further
    parts += [SPOIL] if program.tables else []
    return "\n".join([*sorted(needs), *parts, "!0 = !{}"])


def _head(lanes: int) -> str:
    """The first lines of the loop's function."""
    # LLVM lays a vector that it puts aside wherever the stack happens to be: across two lines of
    # the cache a step took 4 % longer, or not, as a change anywhere in the loop moved them.
    aligned = f"alignstack({8 * lanes}) " if lanes > 1 else ""
    return (
        "define internal void @NAME.loop(ptr noalias %in, ptr noalias %out, ptr noalias %big, "
        f"i64 %most) {aligned}{{\nentry:"
    )


def _arguments(writer: Writer, program: Program) -> list:
    """Constants and first state: arrays of registers, loaded one by one, or arrays in memory."""
    constants, state = avals_of(program)
    position, slot = 0, 0
    values: list[Any] = []
    for i, (aval, long) in enumerate(zip([*constants, *state], in_memory(program), strict=True)):
        kind, shape = kind_of(aval.dtype), tuple(aval.shape)
        if long:
            starts = array_starts(writer, slot)
            alike = i in program.shared
            values.append(InMemory(starts[:1] * writer.lanes if alike else starts, shape))
            slot += 1
            continue
        array = array_of(None, shape)
        for index in np.ndindex(*shape):
            array[index] = _load(writer, position, kind)
            position += 1
        values.append(array)
    return values


def _load(writer: Writer, position: int, kind: str) -> str:
    place = writer.put(f"getelementptr double, ptr %in, i64 {position * writer.lanes}")
    value = writer.put(f"load {writer.wide(FLOAT)}, ptr {place}")
    if kind == WHOLE:
        return writer.put(f"fptosi {writer.wide(FLOAT)} {value} to {writer.wide(WHOLE)}")
    return writer.operate("fcmp une {type} {0}, {1}", FLOAT, value, 0.0) if kind == TRUTH else value


class Kernel:
    """Compiled code: the number by which a program calls it, and its address for a direct call.

    It goes with the last program that keeps it: its number then leaves the table, and its machine
    code the memory, as soon as no call of it is under way.
    """

    def __init__(self, number: int, name: str, engine: Any):
        self.number, self.address = number, engine.get_function_address(f"{name}.samples")
        self._entry = engine.get_function_address(name)
        weakref.finalize(self, _dropped, number, self._entry, engine).atexit = False

    def publish(self) -> None:
        """Programs may call it from now on."""
        dispatch.enter(self.number, self._entry)


# Machine code of kernels that were dropped while a call was under way, with their places in the
# table. A deque: finalizers, in whatever thread, may not wait for a lock.
_LINGERING: "collections.deque[tuple[int, Any]]" = collections.deque()


def _dropped(number: int, entry: int, engine: Any) -> None:
    """A kernel leaves the table; its machine code, kept by `engine`, goes when nobody is in it."""
    _LINGERING.append((dispatch.remove(number, entry), engine))
    free_the_unused()


def free_the_unused() -> None:
    """Frees machine code that lingers, where no call of it is under way any more."""
    for _ in range(len(_LINGERING)):
        with contextlib.suppress(IndexError):
            place, engine = _LINGERING.popleft()
            if dispatch.in_use(place):
                _LINGERING.append((place, engine))


# JAX computes in the background: a program may have been dropped before its kernels have begun. So
# those of so many of the latest programs [2 MB each kernel] stay all the same.
LATEST = 8
_LATEST: "collections.deque[list]" = collections.deque(maxlen=LATEST)
# Two threads that compile the same loop share one kernel.
_BUILDING = threading.RLock()
_KERNELS: "weakref.WeakValueDictionary[int, Kernel]" = weakref.WeakValueDictionary()


def build(program: Program, lanes: int) -> Kernel:
    """Compile, check, and make known. Raises `Unsupported`."""
    dispatch.known_to_xla()
    free_the_unused()
    text = text_of(program, lanes)
    constants, state = avals_of(program)
    kept = list(zip([*constants, *state], in_memory(program), strict=True))
    long = [aval for aval, is_long in kept if is_long]
    ways = [i in program.shared for i, is_long in enumerate(in_memory(program)) if is_long]
    form = f"{lanes}{[a.shape for a in long]}{ways}{program.tables}{program.length}{program.long}"
    changed = [floats_in([aval]) for aval in changing(program)]
    mark = hashlib.sha256(f"{text}{form}".encode()).hexdigest()
    number = max(int(mark[:16], 16) >> 1, 1)
    name = f"jaxclear_{mark[:24]}"
    frame = call_frame.text(
        name,
        lanes,
        width=floats_in([aval for aval, is_long in kept if not is_long]),
        height=floats_in(packed_state(program)),
        in_memory=[0 if way else floats_in([aval]) for aval, way in zip(long, ways, strict=True)],
        tables=[*changed, *sizes_of_tables(program)],
    )
    whole = text.replace("@NAME", f"@{name}").replace(STOP_FLAG, stopping.flag_in_llvm()) + frame
    with _BUILDING:
        kernel = _KERNELS.get(number)
        if kernel is None:
            kernel = Kernel(number, name, machine.compiled(whole))
            check(program, kernel.address)
            kernel.publish()
            _KERNELS[number] = kernel
        return kernel


def keep(kernel: Kernel, module: Any) -> None:
    """The program that is being compiled, whose context this is, keeps a kernel."""
    module.add_keepalive(kernel)
    if not any(module.keepalives is each for each in _LATEST):
        _LATEST.append(module.keepalives)
