"""Rules for programs that a program calls, for choices and loops, and how a loop of registers is
written: its turns, when it ends, and what it leaves where it was stopped. Every sample takes its
own number of turns, or all take the same.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from jaxclear.native.arithmetic import compare
from jaxclear.native.long_arrays import carried_in_memory, join_rows, map_rows, put_back
from jaxclear.native.program import CALLS, called_program, numbers_in, scan_counts, size_of
from jaxclear.native.writer import (
    FLOAT,
    INT,
    LONGEST_IN_REGISTERS,
    STOP_FLAG,
    TRUTH,
    InMemory,
    Long,
    Unsupported,
    Writer,
    array_of,
    each,
    in_registers,
    kind_of,
    refuse_memory,
    rule,
    write_closed,
)

# Turns after which a loop within the loop is given up in a kernel that is checked.
MOST_TURNS = 10_000


def phi_line(writer: Writer, name: str, kind: str, values: tuple, blocks: tuple[str, str]) -> str:
    """Line of code for a register that depends on the block from which control comes.

    Args:
        writer: LLVM text under construction.
        name: of the register.
        kind: of its numbers: `FLOAT`, `INT` or `TRUTH`.
        values: its values when coming from the first and from the second block.
        blocks: labels of the two blocks.
    """
    (old, new), (before, last) = values, blocks
    return (
        f"  {name} = phi {writer.wide(kind)} [ {writer.text(old, kind)}, %{before} ], "
        f"[ {writer.text(new, kind)}, %{last} ]"
    )


def phi_of_turns(turn: str, following: str, blocks: tuple[str, str]) -> str:
    """Line of code for a counter of turns: 0 when coming from the first block, else `following`.

    Args:
        turn: register of the counter.
        following: register with the counter plus one.
        blocks: labels of the two blocks.
    """
    return f"  {turn} = phi i64 [ 0, %{blocks[0]} ], [ {following}, %{blocks[1]} ]"


def write_loop(
    writer: Writer,
    condition: Callable,
    body: Callable,
    carry: Any,
    kinds: list[str],
    outermost: bool = False,
    together: bool = False,
    resumed: bool = False,
) -> list:
    """Writes a while loop over arrays of registers, and of changing ones in memory.

    Every sample stops by itself; the loop ends with the last one, or where it is `resumed`.

    Args:
        writer: LLVM text under construction.
        condition: function of the state that writes the test and returns its register.
        body: function of the state that writes a turn and returns the new state.
        carry: first state, arrays of registers or in memory.
        kinds: of each array: `FLOAT`, `INT` or `TRUTH`.
        outermost: whether it, and a time loop within it, reads the flag that stops all kernels;
            then
            what is unfinished becomes nan.
        together: whether all samples take the same turns, which the first number of the state
            counts.
        resumed: whether it ends when half of the samples have, as the loop around it goes on with
            the others.
    """
    # A turn may change them, so that as they were before the loop they can be read no more.
    rooms = carried_in_memory(writer, carry, kinds)
    long = [
        writer.renewed(a) if isinstance(a, InMemory) else buffer and buffer.array()
        for a, buffer in zip(carry, rooms, strict=True)
    ]
    head, inside, behind = (writer.fresh(word)[1:] for word in ("head", "inside", "behind"))
    flat = _register_entries(carry, kinds, long)
    start = writer.lane(flat[0][0], INT, 0) if together else "0"
    before = writer.block
    writer.say(f"br label %{head}")
    writer.start(head)
    registers, places = [writer.fresh("s") for _ in flat], len(writer.lines)
    turn = writer.fresh("turn")
    region, outer = writer.enter(), writer.active
    state = _state_of_turn(writer, registers, turn, start) if together else registers
    truth = condition(_shape_like(state, carry, long))
    go, truth, stopped = _write_loop_test(writer, truth, turn, outermost, resumed)
    writer.say(f"br i1 {go}, label %{inside}, label %{behind}")
    writer.start(inside)
    writer.active = truth if writer.lanes > 1 and not together else None
    writer.depth += 1
    after = body(_shape_like(state, carry, long))
    writer.depth -= 1
    put_back(writer, rooms, after)
    long = [_require_same_memory(writer, *pair) for pair in zip(long, after, strict=True)]
    entries = _register_entries(after, kinds, long)
    if writer.active is not None:
        pairs = zip(entries, registers, strict=True)
        entries = [(writer.choose(truth, new, old, kind), kind) for (new, kind), old in pairs]
    writer.active = outer
    writer.leave(region)
    ends, following = (before, writer.block), writer.put(f"add i64 {turn}, 1")
    values = zip(registers, entries, flat, strict=True)
    phis = [phi_line(writer, name, k, (old, new), ends) for name, (new, _), (old, k) in values]
    writer.lines[places:places] = [*phis, phi_of_turns(turn, following, ends)]
    writer.say(f"br label %{head}")
    writer.start(behind)
    long = [_nan_where_stopped(writer, stopped, array) for array in long]
    return _shape_like(_results_of_stopped_loop(writer, stopped, registers, flat), carry, long)


def _register_entries(arrays: Any, kinds: list[str], long: list[Any]) -> list[tuple[Any, str]]:
    """(value, kind) of all entries of arrays that do not stand in memory, as `long` ones do."""
    each = zip(arrays, kinds, long, strict=True)
    return [(value, k) for a, k, part in each if part is None for value in in_registers(a).flat]


def _require_same_memory(writer: Writer, before: Any, after: Any) -> InMemory | Long | None:
    """An array in memory as a turn leaves it. Raises `Unsupported` for another one."""
    if isinstance(before, Long):
        return before
    if before is None:
        if isinstance(after, InMemory):
            raise Unsupported("a long array in the place of registers")
        return None
    if not isinstance(after, InMemory) or after.places != before.places:
        raise Unsupported("another long array in the place of one")
    writer.check_latest(after)
    return after.reshaped(before.shape)


def _nan_where_stopped(writer: Writer, stopped: Any, array: Any) -> Any:
    """An array that a loop leaves, nan where it was stopped."""
    if stopped is None or not isinstance(array, Long) or array.kind != FLOAT:
        return array
    wide, nan = writer.wide(FLOAT), writer.text(float("nan"), FLOAT)

    def entry(k):
        return writer.put(f"select i1 {stopped}, {wide} {nan}, {wide} {array.entry(k)}")

    return Long(array.shape, FLOAT, entry)


def _state_of_turn(writer, registers, turn, start):
    """The state of samples that take the same turns, the first of which has the number `start`."""
    writer.turn = writer.put(f"add i64 {start}, {turn}")
    return [writer.spread(writer.turn, INT), *registers[1:]]


def _shape_like(values, like, long):
    """Single values as arrays of the shapes of others, `long` ones among them."""
    values, out = iter(values), []
    for array, long_array in zip(like, long, strict=True):
        if long_array is not None:
            out.append(long_array)
            continue
        out.append(array_of(None, array.shape))
        for index in np.ndindex(*array.shape):
            out[-1][index] = next(values)
    return out


def _write_loop_test(writer, truth, turn, outermost, resumed):
    """Whether to go on, each sample's truth, and (of the outermost loop) whether it was stopped."""
    if writer.checked and outermost:
        return writer.put(f"icmp slt i64 {turn}, 1"), writer.text(True, TRUTH), None
    if writer.active is not None:
        truth = writer.operate("and {type} {0}, {1}", TRUTH, truth, writer.active)
    go = writer.most(truth, writer.active) if resumed else writer.any(truth)
    if writer.checked:
        allowed = writer.put(f"icmp slt i64 {turn}, {MOST_TURNS}")
        return writer.put(f"and i1 {go}, {allowed}"), truth, None
    if not outermost:
        return go, truth, None
    flag = writer.put(f"load volatile i64, ptr {STOP_FLAG}")
    stopped = writer.put(f"icmp ne i64 {flag}, 0")
    onward = writer.put(f"xor i1 {stopped}, true")
    return writer.put(f"and i1 {go}, {onward}"), truth, stopped


def _results_of_stopped_loop(writer, stopped, registers, flat):
    """What a loop leaves: nan where it was stopped, which nobody takes for an answer."""
    if stopped is None:
        return registers
    wide, nan = writer.wide(FLOAT), writer.text(float("nan"), FLOAT)
    return [
        writer.put(f"select i1 {stopped}, {wide} {nan}, {wide} {register}")
        if kind == FLOAT
        else register
        for register, (_, kind) in zip(registers, flat, strict=True)
    ]


@rule(*CALLS, reads_memory=True)
def _write_call(writer, equation, *arguments):
    return write_closed(writer, called_program(equation.params), arguments)


def is_an_error(parameters: dict) -> bool:
    """Whether a call of the host by these parameters is Equinox's way to raise an error."""
    function = getattr(parameters["callback"], "callback_func", None)
    return getattr(function, "__module__", "") == "equinox._errors"


@rule("pure_callback")
def _write_error_guard(writer, equation, *arguments):
    """A kernel cannot raise. What an error guards becomes nan, as Equinox has it where it may not
    raise either."""
    if not is_an_error(equation.params):
        raise Unsupported("a call of the host")
    avals = [atom.aval for atom in equation.outvars]
    if any(kind_of(aval.dtype) != FLOAT for aval in avals):
        raise Unsupported("an error about whole numbers")
    return [array_of(float("nan"), aval.shape) for aval in avals]


# Loops of known length are written out up to this many turns, and while they have at most so many
# equations.
LONGEST_WRITTEN_OUT = 16
LARGEST_WRITTEN_OUT = 2000
# The same of the numbers that these equations go through: LLVM compiles some 10 000 a second.
MOST_NUMBERS = 20_000
# Maps over rows of so many and more are loops over these: as `ground.grouping` has it.
SHORTEST_MAP = 12


@rule("cond", reads_memory=True)
def _write_cond(writer, equation, which, *arguments):
    branches = equation.params["branches"]
    if len(branches) != 2:
        raise Unsupported("a choice among more than two")
    results = [write_closed(writer, branch, arguments) for branch in branches]
    refuse_memory(*results[0], *results[1])
    results = [list(map(in_registers, branch_results)) for branch_results in results]
    kind = kind_of(equation.invars[0].aval.dtype)
    truth = which.item() if kind == TRUTH else compare(writer, "gt", INT, which.item(), 0)
    out = []
    for atom, no, yes in zip(equation.outvars, *results, strict=True):
        kind = kind_of(atom.aval.dtype)
        out.append(each(lambda n, y, k=kind: writer.choose(truth, y, n, k), no, yes))
    return out


@rule("scan", reads_memory=True)
def _write_scan(writer, equation, *arguments):
    p = equation.params
    constants, carried = scan_counts(p)
    fixed, carry, rows = (
        arguments[:constants],
        list(arguments[constants:][:carried]),
        arguments[constants + carried :],
    )
    kinds = [kind_of(a.dtype) for a in p["jaxpr"].in_avals]
    if not carried and p["length"] >= SHORTEST_MAP:
        avals = [atom.aval for atom in equation.outvars]
        body = lambda picked: write_closed(writer, p["jaxpr"], [*fixed, *picked])
        return map_rows(writer, rows, kinds[constants:], avals, body)
    refuse_memory(*carry, *rows)
    rows = list(map(in_registers, rows))
    long = p["length"] > LONGEST_WRITTEN_OUT
    # A row of the turn is chosen among all, which costs no more than what a turn carries.
    few = sum(row.size for row in rows) <= max(LONGEST_IN_REGISTERS, sum(x.size for x in carry))
    as_a_loop = len(equation.outvars) == carried and not p["reverse"] and (few or not long)
    large = p["length"] * size_of(p["jaxpr"]) > LARGEST_WRITTEN_OUT
    large |= p["length"] * numbers_in(p["jaxpr"]) > MOST_NUMBERS
    if as_a_loop and (long or large):
        return _write_counted_loop(writer, p["jaxpr"], fixed, carry, rows, p["length"], kinds)
    if long:
        raise Unsupported("a long scan inside the loop")
    collected: list[list] = []
    turns = range(p["length"])
    for turn in reversed(turns) if p["reverse"] else turns:
        results = write_closed(
            writer, p["jaxpr"], [*fixed, *carry, *[array_of(r[turn], r.shape[1:]) for r in rows]]
        )
        carry = results[:carried]
        collected.append(results[carried:])
    if p["reverse"]:
        collected.reverse()
    kinds = [kind_of(atom.aval.dtype) for atom in equation.outvars[carried:]]
    return carry + [
        join_rows(writer, parts, kind)
        for parts, kind in zip(zip(*collected, strict=True), kinds, strict=True)
    ]


def _write_counted_loop(writer, body, fixed, carry, rows, length, kinds):
    """A scan as a loop: every sample takes all turns; a row is chosen by the turn's number."""
    head, behind = writer.fresh("turns")[1:], writer.fresh("done")[1:]
    carried = kinds[len(fixed) :][: len(carry)]
    rooms = carried_in_memory(writer, carry, carried)
    carry = [in_registers(c) if space is None else c for c, space in zip(carry, rooms, strict=True)]
    before = writer.block
    writer.say(f"br label %{head}")
    writer.start(head)
    turn, places = writer.fresh("turn"), len(writer.lines)
    state = [
        each(lambda _: writer.fresh("s"), c) if space is None else space.array()
        for c, space in zip(carry, rooms, strict=True)
    ]
    region = writer.enter()
    picked = [
        _choose_row(writer, row, turn, kind)
        for row, kind in zip(rows, kinds[len(fixed) + len(carry) :], strict=True)
    ]
    results = write_closed(writer, body, [*fixed, *state, *picked])
    put_back(writer, rooms, results)
    results = [x if r is None else r.array() for x, r in zip(results, rooms, strict=True)]
    writer.leave(region)
    ends = before, writer.block
    phis = []
    for names, olds, news, kind in zip(state, carry, results, carried, strict=True):
        if isinstance(names, Long):
            continue
        for name, old, new in zip(names.flat, olds.flat, in_registers(news).flat, strict=True):
            phis.append(phi_line(writer, name, kind, (old, new), ends))
    following = writer.put(f"add i64 {turn}, 1")
    phis.append(phi_of_turns(turn, following, ends))
    writer.lines[places:places] = phis
    more = writer.put(f"icmp slt i64 {following}, {length}")
    writer.say(f"br i1 {more}, label %{head}, label %{behind}")
    writer.start(behind)
    return results


def _choose_row(writer, row, turn, kind):
    """row[turn], chosen among all rows."""

    def one(*options):
        chosen = options[0]
        for number, option in enumerate(options[1:], 1):
            if option != chosen or number > 1:
                here = writer.put(f"icmp eq i64 {turn}, {number}")
                wide = writer.wide(kind)
                yes, no = writer.text(option, kind), writer.text(chosen, kind)
                chosen = writer.put(f"select i1 {here}, {wide} {yes}, {wide} {no}")
        return chosen

    return each(one, *[array_of(row[k], row.shape[1:]) for k in range(len(row))])


@rule("while", reads_memory=True)
def _write_while(writer, equation, *arguments):
    p = equation.params
    if writer.leaves_rows and writer.depth < 2:
        # One of a library's, with tangents: no check sees through it to its end.
        raise Unsupported("a loop within turns that leave rows")
    counts = p["cond_nconsts"], p["body_nconsts"]
    return _inner_loop(writer, equation, (p["cond_jaxpr"], p["body_jaxpr"]), counts, arguments)


@rule("jaxclear_loop", reads_memory=True)
def _write_time_loop(writer, equation, *arguments):
    """A loop of this room within another one: as that, it ends when all kernels are stopped."""
    program, rank = equation.params["program"], equation.params["rank"]
    if program.single_turn and rank == 1 and all(isinstance(a, np.ndarray) for a in arguments):
        return _write_row_by_row(writer, program, arguments, equation.outvars)
    if rank or program.length:
        raise Unsupported("a batch of loops within a loop")
    if program.single_turn:
        return write_closed(writer, program.body, arguments[program.condition_constants :])
    counts = program.condition_constants, program.body_constants
    programs, flags = (program.condition, program.body), (True, False, program.resumed)
    return _inner_loop(writer, equation, programs, counts, arguments, flags)


def _write_row_by_row(writer, program, arguments, outvars):
    """A function of each of few rows, written out for one after the other."""
    rows = []
    for k in range(outvars[0].aval.shape[0]):
        own = [
            a if i in program.shared else array_of(a[k], a.shape[1:])
            for i, a in enumerate(arguments)
        ]
        rows.append(write_closed(writer, program.body, own[program.condition_constants :]))
    return [np.stack(column) for column in zip(*rows, strict=True)]


def _inner_loop(writer, equation, programs, counts, arguments, flags=()):
    """A loop by its programs (condition, body), of whose arguments so many are constants, with the
    `flags` of `write_loop`."""
    (condition, body), (first, second) = programs, counts
    fixed_condition, fixed_body = arguments[:first], arguments[first : first + second]
    return write_loop(
        writer,
        lambda state: write_closed(writer, condition, [*fixed_condition, *state])[0].item(),
        lambda state: write_closed(writer, body, [*fixed_body, *state]),
        arguments[first + second :],
        [kind_of(atom.aval.dtype) for atom in equation.outvars],
        *flags,
    )
