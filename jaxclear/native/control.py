"""Rules for choices and loops. Every sample takes its own number of turns."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr

from jaxclear.native.arithmetic import compare
from jaxclear.native.program import scan_counts
from jaxclear.native.rules import array_of, each, refuse_memory, rule, write_closed
from jaxclear.native.writer import FLOAT, STOP_FLAG, TRUTH, WHOLE, Unsupported, Writer, kind_of

# Loops of known length are written out up to this many turns, and while they have at most so many
# equations.
LONGEST_WRITTEN_OUT = 16
LARGEST_WRITTEN_OUT = 2000


@rule("cond", reads_memory=True)
def _cond(writer, equation, which, *arguments):
    branches = equation.params["branches"]
    if len(branches) != 2:
        raise Unsupported("a choice among more than two")
    results = [write_closed(writer, branch, arguments) for branch in branches]
    refuse_memory(*results[0], *results[1])
    kind = kind_of(equation.invars[0].aval.dtype)
    truth = which.item() if kind == TRUTH else compare(writer, "gt", WHOLE, which.item(), 0)
    out = []
    for atom, no, yes in zip(equation.outvars, *results, strict=True):
        kind = kind_of(atom.aval.dtype)
        out.append(each(lambda n, y, k=kind: writer.choose(truth, y, n, k), no, yes))
    return out


@rule("scan", reads_memory=True)
def _scan(writer, equation, *arguments):
    p = equation.params
    if p["length"] > LONGEST_WRITTEN_OUT:
        raise Unsupported("a long scan inside the loop")
    constants, carried = scan_counts(p)
    fixed, carry, rows = (
        arguments[:constants],
        list(arguments[constants:][:carried]),
        arguments[constants + carried :],
    )
    refuse_memory(*carry, *rows)
    if (
        p["length"] * size_of(p["jaxpr"]) > LARGEST_WRITTEN_OUT
        and len(equation.outvars) == carried
        and not p["reverse"]
    ):
        kinds = [kind_of(a.dtype) for a in p["jaxpr"].in_avals]
        return _counted_loop(writer, p["jaxpr"], fixed, carry, rows, p["length"], kinds)
    collected: list[list] = []
    turns = range(p["length"])
    for turn in reversed(turns) if p["reverse"] else turns:
        found = write_closed(
            writer, p["jaxpr"], [*fixed, *carry, *[array_of(r[turn], r.shape[1:]) for r in rows]]
        )
        carry = found[:carried]
        collected.append(found[carried:])
    if p["reverse"]:
        collected.reverse()
    return carry + [np.stack(parts) for parts in zip(*collected, strict=True)]


def size_of(program: Any) -> int:
    """Equations of a program, those of programs within it included."""
    total = 0
    for equation in getattr(program, "jaxpr", program).eqns:
        inner = [v for v in equation.params.values() if isinstance(v, (Jaxpr, ClosedJaxpr))]
        total += sum(map(size_of, inner)) if inner else 1
    return total


def _counted_loop(writer, body, fixed, carry, rows, length, kinds):
    """A scan as a loop: every sample takes all turns; a row is chosen by the turn's number."""
    head, behind = writer.fresh("turns")[1:], writer.fresh("done")[1:]
    carried = kinds[len(fixed) :][: len(carry)]
    before = writer.block
    writer.say(f"br label %{head}")
    writer.start(head)
    turn, places = writer.fresh("turn"), len(writer.lines)
    state = [each(lambda _: writer.fresh("s"), c) for c in carry]
    region = writer.enter()
    picked = [
        _row_of_the_turn(writer, row, turn, kind)
        for row, kind in zip(rows, kinds[len(fixed) + len(carry) :], strict=True)
    ]
    found = write_closed(writer, body, [*fixed, *state, *picked])
    writer.leave(region)
    ends = before, writer.block
    phis = []
    for names, olds, news, kind in zip(state, carry, found, carried, strict=True):
        for name, old, new in zip(names.flat, olds.flat, news.flat, strict=True):
            phis.append(_phi(writer, name, kind, (old, new), ends))
    following = writer.put(f"add i64 {turn}, 1")
    phis.append(_phi_of_turns(turn, following, ends))
    writer.lines[places:places] = phis
    more = writer.put(f"icmp slt i64 {following}, {length}")
    writer.say(f"br i1 {more}, label %{head}, label %{behind}")
    writer.start(behind)
    return found


def _row_of_the_turn(writer, row, turn, kind):
    """row[turn], chosen among all rows."""

    def one(*options):
        found = options[0]
        for number, option in enumerate(options[1:], 1):
            if option != found or number > 1:
                here = writer.once(
                    ("turn", turn, number),
                    lambda n=number: writer.put(f"icmp eq i64 {turn}, {n}"),
                )
                wide = writer.wide(kind)
                yes, no = writer.text(option, kind), writer.text(found, kind)
                found = writer.put(f"select i1 {here}, {wide} {yes}, {wide} {no}")
        return found

    return each(one, *[array_of(row[k], row.shape[1:]) for k in range(len(row))])


def _phi(writer, name, kind, values, blocks):
    """A register that is the first value when coming from the first block, else the second."""
    (old, new), (before, last) = values, blocks
    return (
        f"  {name} = phi {writer.wide(kind)} [ {writer.text(old, kind)}, %{before} ], "
        f"[ {writer.text(new, kind)}, %{last} ]"
    )


def _phi_of_turns(turn, following, blocks):
    return f"  {turn} = phi i64 [ 0, %{blocks[0]} ], [ {following}, %{blocks[1]} ]"


@rule("while", reads_memory=True)
def _while(writer, equation, *arguments):
    p = equation.params
    if writer.leaves_rows and writer.depth < 2:
        # One of a library's, with tangents: no check sees through it to its end.
        raise Unsupported("a loop within turns that leave rows")
    first, second = p["cond_nconsts"], p["body_nconsts"]
    fixed_cond, fixed_body, carry = (
        arguments[:first],
        arguments[first : first + second],
        arguments[first + second :],
    )
    kinds = [kind_of(atom.aval.dtype) for atom in equation.outvars]
    return loop(
        writer,
        lambda state: write_closed(writer, p["cond_jaxpr"], [*fixed_cond, *state])[0].item(),
        lambda state: write_closed(writer, p["body_jaxpr"], [*fixed_body, *state]),
        carry,
        kinds,
    )


@rule("jaxclear_loop", reads_memory=True)
def _time_loop(writer, equation, *arguments):
    """A loop of this room within another one: as that, it ends when all kernels are stopped."""
    program, rank = equation.params["program"], equation.params["rank"]
    if rank or program.length:
        raise Unsupported("a batch of loops within a loop")
    first, second = program.condition_constants, program.body_constants
    fixed_cond, fixed_body, carry = (
        arguments[:first],
        arguments[first : first + second],
        arguments[first + second :],
    )
    if program.once:
        return write_closed(writer, program.body, [*fixed_body, *carry])
    kinds = [kind_of(atom.aval.dtype) for atom in equation.outvars]
    return loop(
        writer,
        lambda state: write_closed(writer, program.condition, [*fixed_cond, *state])[0].item(),
        lambda state: write_closed(writer, program.body, [*fixed_body, *state]),
        carry,
        kinds,
        outermost=True,
    )


def loop(
    writer: Writer,
    condition: Callable,
    body: Callable,
    carry: Any,
    kinds: list[str],
    outermost: bool = False,
    together: bool = False,
) -> list:
    """A while loop over arrays of registers: every sample stops by itself, the loop ends with the
    last one; `together`: all take the same turns, which the state's first number counts.

    The `outermost` one, and a time loop within it, looks at `writer.most` and at the flag that
    stops all kernels: the unfinished becomes nan. Others are bounded while a kernel is checked.
    """
    refuse_memory(*carry)
    head, inside, behind = (writer.fresh(word)[1:] for word in ("head", "inside", "behind"))
    flat = [(value, kind) for array, kind in zip(carry, kinds, strict=True) for value in array.flat]
    begun = writer.lane(flat[0][0], WHOLE, 0) if together else ""
    before = writer.block
    writer.say(f"br label %{head}")
    writer.start(head)
    registers, places = [writer.fresh("s") for _ in flat], len(writer.lines)
    turn = writer.fresh("turn")
    region, outer = writer.enter(), writer.active
    state = registers
    if together:
        writer.turn = writer.put(f"add i64 {begun}, {turn}")
        state = [writer.spread(writer.turn, WHOLE), *registers[1:]]
    truth = condition(_shaped(state, carry))
    if outer is not None:
        truth = writer.operate("and {type} {0}, {1}", TRUTH, truth, outer)
    go, truth, stopped = _bounded(writer, truth, turn, outermost)
    writer.say(f"br i1 {go}, label %{inside}, label %{behind}")
    writer.start(inside)
    masked = writer.lanes > 1 and not together
    writer.active = truth if masked else None
    writer.depth += 1
    found = [value for array in body(_shaped(state, carry)) for value in array.flat]
    writer.depth -= 1
    if masked:
        found = [
            writer.choose(truth, new, old, kind)
            for new, old, (_, kind) in zip(found, registers, flat, strict=True)
        ]
    writer.active = outer
    writer.leave(region)
    ends = before, writer.block
    phis = []
    for name, new, (old, kind) in zip(registers, found, flat, strict=True):
        phis.append(_phi(writer, name, kind, (old, new), ends))
    phis.append(_phi_of_turns(turn, writer.put(f"add i64 {turn}, 1"), ends))
    writer.lines[places:places] = phis
    writer.say(f"br label %{head}")
    writer.start(behind)
    kinds_of_all = [kind for _, kind in flat]
    return _shaped(_spoilt(writer, stopped, registers, kinds_of_all), carry)


def _shaped(values, like):
    """Single values as arrays of the shapes of others."""
    values, out = iter(values), []
    for array in like:
        out.append(array_of(None, array.shape))
        for index in np.ndindex(*array.shape):
            out[-1][index] = next(values)
    return out


def _bounded(writer, truth, turn, outermost):
    """Whether to go on, each sample's truth, and (of the outermost loop) whether it was stopped."""
    go = writer.any(truth)
    if outermost:
        go, truth = _within_turns(writer, go, truth, turn)
        go, stopped = _unless_stopped(writer, go)
        return go, truth, stopped
    allowed = writer.put(f"icmp slt i64 {turn}, {writer.most_inside}")
    return writer.put(f"and i1 {go}, {allowed}"), truth, None


def _within_turns(writer, go, truth, turn):
    """Whether to go on, and each sample's truth, where the number of turns is bounded: with a bound
    of one the first turn is taken whatever the condition says."""
    early = writer.put(f"icmp slt i64 {turn}, 1")
    forced = writer.put(f"icmp eq i64 {writer.most}, 1")
    first = writer.put(f"and i1 {early}, {forced}")
    allowed = writer.put(f"icmp slt i64 {turn}, {writer.most}")
    go = writer.put(f"and i1 {go}, {allowed}")
    go = writer.put(f"or i1 {go}, {first}")
    wide = writer.wide(TRUTH)
    yes, own = writer.text(True, TRUTH), writer.text(truth, TRUTH)
    return go, writer.put(f"select i1 {forced}, {wide} {yes}, {wide} {own}")


def _unless_stopped(writer, go):
    """Whether to go on, and whether it is the flag that says no; a kernel under check is not
    stopped."""
    flag = writer.put(f"load volatile i64, ptr {STOP_FLAG}")
    raised = writer.put(f"icmp ne i64 {flag}, 0")
    free = writer.put(f"icmp ne i64 {writer.most}, 1")
    stopped = writer.put(f"and i1 {raised}, {free}")
    onward = writer.put(f"xor i1 {stopped}, true")
    return writer.put(f"and i1 {go}, {onward}"), stopped


def _spoilt(writer, stopped, registers, kinds):
    """What a loop leaves: nan where it was stopped, which nobody takes for an answer."""
    if stopped is None:
        return registers
    wide, nan = writer.wide(FLOAT), writer.text(float("nan"), FLOAT)
    return [
        writer.put(f"select i1 {stopped}, {wide} {nan}, {wide} {register}")
        if kind == FLOAT
        else register
        for register, kind in zip(registers, kinds, strict=True)
    ]
