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
from jaxclear.native.tangent import widened


class Asked(NamedTuple):
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
    return jaxpr_as_fun(_closed(jaxpr, program))(*numbers)


def without_results(program: ClosedJaxpr, kept: Sequence[bool]) -> ClosedJaxpr:
    """A program with as many inputs, and only the results that are `kept`."""
    return _cut(program, kept, [True] * len(program.in_avals))


def _closed(jaxpr: Jaxpr, like: ClosedJaxpr) -> ClosedJaxpr:
    return ClosedJaxpr(jaxpr, like.consts)


def asked(program: Program, used: Sequence[bool]) -> Asked:
    """What the results that are `used` need, in a loop with tangents and in its motion alone."""
    wanted = _asked(program, used)
    motion = program.motion
    if motion is None or program.within:
        return wanted
    while True:
        # A derivative of its own asks for more where it is still to be taken.
        needs = _asked(motion, _of_motion(wanted, motion).results)
        pairs = zip(wanted, needs, strict=True)
        both = Asked(*([*_either(own, more), *own[len(more) :]] for own, more in pairs))
        if both == wanted:
            return wanted
        now = _asked(program, both.results)
        wanted = Asked(*(_either(*each) for each in zip(both, now, strict=True)))


def _asked(program: Program, used: Sequence[bool]) -> Asked:
    c, b, count = program.condition_constants, program.body_constants, len(avals_of(program)[1])
    state, tables = list(used[:count]), list(used[count:])
    _, tests = pe.dce_jaxpr(program.condition.jaxpr, True)
    state = _either(state, tests[c:])
    if program.length:
        state[0] = True  # it counts the turns
    while True:
        _, inputs = pe.dce_jaxpr(program.body.jaxpr, [*state, *tables])
        now = _either(state, inputs[b:])
        if now == state:
            break
        state = now
    fixed = list(inputs[:b])
    for table, wanted in zip(program.tables, tables, strict=True):
        for place in (table.places, table.begins):
            if wanted and place is not None:
                fixed[place] = True
    return Asked(list(tests[:c]), fixed, state, tables)


def _either(these: Sequence[bool], those: Sequence[bool]) -> list[bool]:
    return [a or b for a, b in zip(these, those, strict=False)]


def _of_motion(wanted: Asked, motion: Program) -> Asked:
    """What of it is the motion's: that comes first everywhere."""
    return Asked(
        wanted.of_condition,
        wanted.of_body[: motion.body_constants],
        wanted.state[: len(avals_of(motion)[1])],
        wanted.tables[: len(motion.tables)],
    )


def reduced(program: Program, wanted: Asked) -> Program:
    """The loop with nothing but these. One within another is not asked for its motion alone."""
    places = _places([*wanted.of_body, *wanted.state])
    everywhere, of_state = _places(wanted.inputs), _places(wanted.state)
    tables = [
        t._replace(places=places[t.places], begins=None if t.begins is None else places[t.begins])
        for t, own in zip(program.tables, wanted.tables, strict=True)
        if own
    ]
    motion = None if program.within else program.motion
    return program._replace(
        condition=_cut(program.condition, [True], [*wanted.of_condition, *wanted.state]),
        body=_cut(program.body, wanted.results, [*wanted.of_body, *wanted.state]),
        condition_constants=sum(wanted.of_condition),
        body_constants=sum(wanted.of_body),
        tangents=_found(program.tangents, places),
        motion=None if motion is None else reduced(motion, _of_motion(wanted, motion)),
        tables=tuple(tables),
        shared=_found(program.shared, everywhere),
        long=_found(program.long, of_state),
    )


def _found(numbers: frozenset[int], places: dict[int, int]) -> frozenset[int]:
    return frozenset(places[i] for i in numbers if i in places)


def _places(kept: Sequence[bool]) -> dict[int, int]:
    """Where what is kept stands afterwards."""
    return {old: new for new, old in enumerate(i for i, own in enumerate(kept) if own)}


def _cut(program: ClosedJaxpr, results: Sequence[bool], inputs: Sequence[bool]) -> ClosedJaxpr:
    jaxpr, used = pe.dce_jaxpr(program.jaxpr, results, instantiate=inputs)
    assert list(used) == list(inputs)
    return _closed(jaxpr, program)


def _rule(used: list[bool], equation: Any) -> tuple[list[bool], Any]:
    if not any(used):
        return [False] * len(equation.invars), None
    program = equation.params["program"]
    narrow = program.narrow
    wanted = asked(program if narrow is None else narrow.program, used)
    inputs, results = wanted.inputs, wanted.results
    # Tangents that are unknown, nan whatever moves, depend on none, and still there are several.
    lone = narrow is not None and not any(np.logical_and(narrow.batched, inputs))
    if lone or (all(inputs) and all(results)):
        return [True] * len(inputs), equation
    if narrow is None:
        program = reduced(program, wanted)
    else:
        shared = _found(program.shared, _places(inputs))
        program = widened(_reduced_narrow(narrow, wanted), narrow.tangents)._replace(shared=shared)
    kept = lambda own, wanted: [v for v, w in zip(own, wanted, strict=True) if w]
    return inputs, equation.replace(
        invars=kept(equation.invars, inputs),
        outvars=kept(equation.outvars, results),
        params=equation.params | {"program": program},
    )


def _reduced_narrow(narrow: Narrow, wanted: Asked) -> Narrow:
    program = reduced(narrow.program, wanted)
    batched = tuple(b for b, own in zip(narrow.batched, wanted.inputs, strict=True) if own)
    moving = tuple(m for m, own in zip(narrow.moving, wanted.results, strict=True) if own)
    return narrow._replace(program=program, batched=batched, moving=moving)


def drop_by(primitive: Primitive, rule: Callable[[list[bool], Any], tuple]) -> None:
    """JAX drops of a primitive what a rule (of results that are used, and an equation) finds."""
    # JAX 0.12 tells which inputs may be used, too, between the two.
    pe.dce_rules[primitive] = lambda used, *then: rule(used, then[-1])


drop_by(loop_p, _rule)
