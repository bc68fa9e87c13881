"""What nobody asks for is not worked out: a loop drops the parts of its state, and of what its
turns leave, that neither its condition nor anything read of it later depends on.

JAX drops what a compiled program does not need, but looks into no loop but its own scan. A run
follows more than most responses ask for, and the derivative of each of these costs as much as that
of what is asked for.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import partial_eval as pe

from jaxclear.native.loop import loop_p
from jaxclear.native.program import Narrow, Program, avals_of
from jaxclear.native.tangent import widen


class Needs(NamedTuple):
    """Which of a loop's constants, of both programs, parts of its state and tables are needed."""

    of_condition: list[bool]
    of_body: list[bool]
    state: list[bool]
    tables: list[bool]

    @property
    def inputs(self) -> list[bool]:
        """Of all that the loop is given."""
        return [*self.of_condition, *self.of_body, *self.state]

    @property
    def results(self) -> list[bool]:
        """Of all that it gives."""
        return [*self.state, *self.tables]


def without_the_unasked(function: Any, *numbers: Any) -> list:
    """As `function(*numbers)`, a list of arrays, without what these do not need."""
    program = jax.make_jaxpr(function)(*numbers)
    jaxpr, _ = pe.dce_jaxpr(program.jaxpr, True, instantiate=True)
    return jaxpr_as_fun(_close_jaxpr(jaxpr, program))(*numbers)


def without_results(program: ClosedJaxpr, retained: Sequence[bool]) -> ClosedJaxpr:
    """A program with as many inputs, and only the results that are `retained`."""
    return _cut(program, retained, [True] * len(program.in_avals))


def _close_jaxpr(jaxpr: Jaxpr, like: ClosedJaxpr) -> ClosedJaxpr:
    return ClosedJaxpr(jaxpr, like.consts)


def find_needs(program: Program, used: Sequence[bool]) -> Needs:
    """What the results that are `used` need, in a loop with tangents and in its motion alone."""
    needed = _trace_needs(program, used)
    motion = program.motion
    if motion is None or program.within:
        return needed
    while True:
        # A derivative of its own asks for more where it is still to be taken.
        needs = _trace_needs(motion, _needs_of_motion(needed, motion).results)
        pairs = zip(needed, needs, strict=True)
        both = Needs(*([*_or_each(flags, more), *flags[len(more) :]] for flags, more in pairs))
        if both == needed:
            return needed
        now = _trace_needs(program, both.results)
        needed = Needs(*(_or_each(*each) for each in zip(both, now, strict=True)))


def _trace_needs(program: Program, used: Sequence[bool]) -> Needs:
    c, b, count = program.condition_constants, program.body_constants, len(avals_of(program)[1])
    state, tables = list(used[:count]), list(used[count:])
    _, tests = pe.dce_jaxpr(program.condition.jaxpr, True)
    state = _or_each(state, tests[c:])
    if program.length:
        state[0] = True  # it counts the turns
    while True:
        _, inputs = pe.dce_jaxpr(program.body.jaxpr, [*state, *tables])
        now = _or_each(state, inputs[b:])
        if now == state:
            break
        state = now
    fixed = list(inputs[:b])
    for table, is_needed in zip(program.tables, tables, strict=True):
        for place in (table.places, table.start):
            if is_needed and place is not None:
                fixed[place] = True
    return Needs(list(tests[:c]), fixed, state, tables)


def _or_each(these: Sequence[bool], those: Sequence[bool]) -> list[bool]:
    return [a or b for a, b in zip(these, those, strict=False)]


def _needs_of_motion(needs: Needs, motion: Program) -> Needs:
    """What of it is the motion's: that comes first everywhere."""
    return Needs(
        needs.of_condition,
        needs.of_body[: motion.body_constants],
        needs.state[: len(avals_of(motion)[1])],
        needs.tables[: len(motion.tables)],
    )


def reduce_program(program: Program, needs: Needs) -> Program:
    """The loop with nothing but these. One within another is not asked for its motion alone."""
    places = _new_positions([*needs.of_body, *needs.state])
    everywhere, of_state = _new_positions(needs.inputs), _new_positions(needs.state)
    tables = [
        t._replace(places=places[t.places], start=None if t.start is None else places[t.start])
        for t, need in zip(program.tables, needs.tables, strict=True)
        if need
    ]
    motion = None if program.within else program.motion
    return program._replace(
        condition=_cut(program.condition, [True], [*needs.of_condition, *needs.state]),
        body=_cut(program.body, needs.results, [*needs.of_body, *needs.state]),
        condition_constants=sum(needs.of_condition),
        body_constants=sum(needs.of_body),
        tangents=_renumber(program.tangents, places),
        motion=None if motion is None else reduce_program(motion, _needs_of_motion(needs, motion)),
        tables=tuple(tables),
        shared=_renumber(program.shared, everywhere),
        long=_renumber(program.long, of_state),
    )


def _renumber(numbers: frozenset[int], places: dict[int, int]) -> frozenset[int]:
    return frozenset(places[i] for i in numbers if i in places)


def _new_positions(mask: Sequence[bool]) -> dict[int, int]:
    """Where what is kept stands afterwards."""
    return {old: new for new, old in enumerate(i for i, flag in enumerate(mask) if flag)}


def _cut(program: ClosedJaxpr, results: Sequence[bool], inputs: Sequence[bool]) -> ClosedJaxpr:
    jaxpr, used = pe.dce_jaxpr(program.jaxpr, results, instantiate=inputs)
    assert list(used) == list(inputs)
    return _close_jaxpr(jaxpr, program)


def _drop_unused_outputs(used: list[bool], equation: Any) -> tuple[list[bool], Any]:
    if not any(used):
        return [False] * len(equation.invars), None
    program = equation.params["program"]
    narrow = program.narrow
    needs = find_needs(program if narrow is None else narrow.program, used)
    inputs, results = needs.inputs, needs.results
    # Tangents that are unknown, nan whatever moves, depend on none, and still there are several.
    lone = narrow is not None and not any(np.logical_and(narrow.batched, inputs))
    if lone or (all(inputs) and all(results)):
        return [True] * len(inputs), equation
    if narrow is None:
        program = reduce_program(program, needs)
    else:
        shared = _renumber(program.shared, _new_positions(inputs))
        program = widen(_reduced_narrow(narrow, needs), narrow.tangents)._replace(shared=shared)
    select_needed = lambda values, needs: [v for v, w in zip(values, needs, strict=True) if w]
    return inputs, equation.replace(
        invars=select_needed(equation.invars, inputs),
        outvars=select_needed(equation.outvars, results),
        params=equation.params | {"program": program},
    )


def _reduced_narrow(narrow: Narrow, needs: Needs) -> Narrow:
    program = reduce_program(narrow.program, needs)
    batched = tuple(b for b, need in zip(narrow.batched, needs.inputs, strict=True) if need)
    moving = tuple(m for m, need in zip(narrow.moving, needs.results, strict=True) if need)
    return narrow._replace(program=program, batched=batched, moving=moving)


def drop_by(primitive: Primitive, rule: Callable[[list[bool], Any], tuple]) -> None:
    """JAX drops of a primitive what a rule (of results that are used, and an equation) finds."""
    # JAX 0.12 tells which inputs may be used, too, between the two.
    pe.dce_rules[primitive] = lambda used, *then: rule(used, then[-1])


drop_by(loop_p, _drop_unused_outputs)
