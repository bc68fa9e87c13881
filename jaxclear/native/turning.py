"""A while loop of registers as LLVM code: its turns, when it ends, and what it leaves where it was
stopped. Every sample takes its own number of turns, or all take the same.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from jaxclear.native.rules import array_of
from jaxclear.native.writer import (
    FLOAT,
    STOP_FLAG,
    TRUTH,
    WHOLE,
    InMemory,
    Unsupported,
    Writer,
)


def phi(writer: Writer, name: str, kind: str, values: tuple, blocks: tuple[str, str]) -> str:
    """A register that is the first value when coming from the first block, else the second."""
    (old, new), (before, last) = values, blocks
    return (
        f"  {name} = phi {writer.wide(kind)} [ {writer.text(old, kind)}, %{before} ], "
        f"[ {writer.text(new, kind)}, %{last} ]"
    )


def phi_of_turns(turn: str, following: str, blocks: tuple[str, str]) -> str:
    """A count of turns: 0 when coming from the first block, else the following one."""
    return f"  {turn} = phi i64 [ 0, %{blocks[0]} ], [ {following}, %{blocks[1]} ]"


def loop(
    writer: Writer,
    condition: Callable,
    body: Callable,
    carry: Any,
    kinds: list[str],
    outermost: bool = False,
    together: bool = False,
) -> list:
    """A while loop over arrays of registers and changing ones in memory: every sample stops by
    itself, the loop ends with the last one; `together`: all take the same turns, which the state's
    first number counts.

    The `outermost` one, and a time loop within it, looks at `writer.most` and at the flag that
    stops all kernels: the unfinished becomes nan. Others are bounded while a kernel is checked.
    """
    # A turn may change them, so that as they were before the loop they can be read no more.
    long = [writer.renewed(a) if isinstance(a, InMemory) else None for a in carry]
    head, inside, behind = (writer.fresh(word)[1:] for word in ("head", "inside", "behind"))
    flat = _numbers(carry, kinds)
    begun = writer.lane(flat[0][0], WHOLE, 0) if together else "0"
    before = writer.block
    writer.say(f"br label %{head}")
    writer.start(head)
    registers, places = [writer.fresh("s") for _ in flat], len(writer.lines)
    turn = writer.fresh("turn")
    region, outer = writer.enter(), writer.active
    state = _of_the_turn(writer, registers, turn, begun) if together else registers
    truth = condition(_shaped(state, carry, long))
    go, truth, stopped = _bounded(writer, truth, turn, outermost)
    writer.say(f"br i1 {go}, label %{inside}, label %{behind}")
    writer.start(inside)
    writer.active = truth if writer.lanes > 1 and not together else None
    writer.depth += 1
    after = body(_shaped(state, carry, long))
    writer.depth -= 1
    long = [_same_place(writer, *pair) for pair in zip(long, after, strict=True)]
    found = _numbers(after, kinds)
    if writer.active is not None:
        pairs = zip(found, registers, strict=True)
        found = [(writer.choose(truth, new, old, kind), kind) for (new, kind), old in pairs]
    writer.active = outer
    writer.leave(region)
    ends, following = (before, writer.block), writer.put(f"add i64 {turn}, 1")
    values = zip(registers, found, flat, strict=True)
    phis = [phi(writer, name, k, (old, new), ends) for name, (new, _), (old, k) in values]
    writer.lines[places:places] = [*phis, phi_of_turns(turn, following, ends)]
    writer.say(f"br label %{head}")
    writer.start(behind)
    return _shaped(_spoilt(writer, stopped, registers, flat), carry, long)


def _numbers(arrays: Any, kinds: list[str]) -> list[tuple[Any, str]]:
    """(value, kind) of all entries of arrays that are no arrays in memory."""
    pairs = zip(arrays, kinds, strict=True)
    return [(value, k) for a, k in pairs if not isinstance(a, InMemory) for value in a.flat]


def _same_place(writer: Writer, before: Any, after: Any) -> InMemory | None:
    """An array in memory as a turn leaves it. Raises `Unsupported` for another one."""
    if before is None:
        if isinstance(after, InMemory):
            raise Unsupported("a long array in the place of registers")
        return None
    if not isinstance(after, InMemory) or after.places != before.places:
        raise Unsupported("another long array in the place of one")
    writer.check_latest(after)
    return after.reshaped(before.shape)


def _of_the_turn(writer, registers, turn, begun):
    """The state of samples that take the same turns, the first of which has the number `begun`."""
    writer.turn = writer.put(f"add i64 {begun}, {turn}")
    return [writer.spread(writer.turn, WHOLE), *registers[1:]]


def _shaped(values, like, long):
    """Single values as arrays of the shapes of others, `long` ones among them."""
    values, out = iter(values), []
    for array, own in zip(like, long, strict=True):
        if own is not None:
            out.append(own)
            continue
        out.append(array_of(None, array.shape))
        for index in np.ndindex(*array.shape):
            out[-1][index] = next(values)
    return out


def _bounded(writer, truth, turn, outermost):
    """Whether to go on, each sample's truth, and (of the outermost loop) whether it was stopped."""
    if writer.active is not None:
        truth = writer.operate("and {type} {0}, {1}", TRUTH, truth, writer.active)
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


def _spoilt(writer, stopped, registers, flat):
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
