"""Rules for choices and loops. Every sample takes its own number of turns."""

import numpy as np

from jaxclear.native.arithmetic import compare
from jaxclear.native.program import scan_counts, size_of
from jaxclear.native.rules import array_of, each, refuse_memory, rule, write_closed
from jaxclear.native.turning import loop, phi, phi_of_turns
from jaxclear.native.writer import TRUTH, WHOLE, Unsupported, kind_of

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
    constants, carried = scan_counts(p)
    fixed, carry, rows = (
        arguments[:constants],
        list(arguments[constants:][:carried]),
        arguments[constants + carried :],
    )
    refuse_memory(*carry, *rows)
    long = p["length"] > LONGEST_WRITTEN_OUT
    as_a_loop = len(equation.outvars) == carried and not p["reverse"] and not (long and rows)
    if as_a_loop and (long or p["length"] * size_of(p["jaxpr"]) > LARGEST_WRITTEN_OUT):
        kinds = [kind_of(a.dtype) for a in p["jaxpr"].in_avals]
        return _counted_loop(writer, p["jaxpr"], fixed, carry, rows, p["length"], kinds)
    if long:
        raise Unsupported("a long scan inside the loop")
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
            phis.append(phi(writer, name, kind, (old, new), ends))
    following = writer.put(f"add i64 {turn}, 1")
    phis.append(phi_of_turns(turn, following, ends))
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
                here = writer.put(f"icmp eq i64 {turn}, {number}")
                wide = writer.wide(kind)
                yes, no = writer.text(option, kind), writer.text(found, kind)
                found = writer.put(f"select i1 {here}, {wide} {yes}, {wide} {no}")
        return found

    return each(one, *[array_of(row[k], row.shape[1:]) for k in range(len(row))])


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
