"""A while loop as two programs, and how its numbers reach a kernel.

A kernel takes one packed row of floats for each sample (constants, then the first state; whole
numbers and truth values as floats, which is exact to 2^53), and long arrays of constants, which it
reads by index; it gives one packed row, the last state.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jax.extend.core import ClosedJaxpr

from jaxclear.native.writer import LONGEST_IN_REGISTERS


class Program(NamedTuple):
    """A while loop as two programs: condition over (its constants, state), body over (its
    constants, state). `once`: it always takes one turn, and so is a function. `tangents`: inputs of
    the body that nothing but other tangents depends on; `motion`: the loop without the last of
    them.
    """

    condition: ClosedJaxpr
    body: ClosedJaxpr
    condition_constants: int
    body_constants: int
    once: bool = False
    tangents: frozenset[int] = frozenset()
    motion: "Program | None" = None


def avals_of(program: Program) -> tuple[list, list]:
    """Shapes and types of (constants of both programs in turn, state)."""
    first, second = program.condition.in_avals[: program.condition_constants], program.body.in_avals
    return [*first, *second[: program.body_constants]], list(second[program.body_constants :])


def in_memory(program: Program) -> list[bool]:
    """For each constant and then each part of the state, whether it is read by index instead of
    being packed.
    """
    constants, state = avals_of(program)
    long = [
        int(np.prod(a.shape)) > LONGEST_IN_REGISTERS and a.dtype == np.float64 for a in constants
    ]
    return [*long, *[False] * len(state)]


def floats_in(avals: Sequence) -> int:
    """Numbers in arrays of these shapes."""
    return sum(int(np.prod(a.shape)) for a in avals)


def packed(values: Sequence[Any]) -> np.ndarray:
    """Arrays as one row of floats."""
    return np.concatenate([np.ravel(v).astype(float) for v in values])
