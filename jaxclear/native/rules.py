"""The registry of rules, and how a program is written by them.

A rule says what one of JAX's primitives becomes as LLVM code: `(writer, equation, *inputs)` to the
outputs, on NumPy object arrays of registers and known numbers. Shapes are NumPy's business
(reshape, broadcast, transpose move names about and cost nothing); arithmetic writes one instruction
for each number. The rules stand in `arithmetic`, `elementary`, `shapes`, `reductions`, `indexing`
and `control`.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from jaxclear.native.writer import InMemory, Unsupported, Writer, kind_of

Rule = Callable[..., Any]
RULES: dict[str, Rule] = {}
# Names of the rules that take arrays in memory as well.
READ_MEMORY: set[str] = set()


def rule(*names: str, reads_memory: bool = False) -> Callable[[Rule], Rule]:
    """Registers the rule of some primitives; `reads_memory`: it takes arrays in memory as well."""

    def keep(function: Rule) -> Rule:
        RULES.update(dict.fromkeys(names, function))
        READ_MEMORY.update(names if reads_memory else ())
        return function

    return keep


def array_of(values: Any, shape: tuple[int, ...]) -> np.ndarray:
    """An object array filled with registers or numbers."""
    out = np.empty(shape, object)
    out[...] = values
    return out


def number_of(value: Any) -> Any:
    """A NumPy scalar as a Python number."""
    return value.item() if isinstance(value, (np.generic, np.ndarray)) else value


def write(writer: Writer, jaxpr: Jaxpr, constants: Any, arguments: Any) -> list:
    """The outputs of a program for given constants and arguments, all as object arrays (or
    `InMemory`).
    """
    values: dict[Any, Any] = dict(zip(jaxpr.constvars, constants, strict=True))
    values |= dict(zip(jaxpr.invars, arguments, strict=True))

    def get(atom):
        if isinstance(atom, Literal):
            if atom.aval.dtype == np.uint64 and np.ndim(atom.val) == 0:
                return array_of(int(np.asarray(atom.val, np.uint64).view(np.int64)), ())
            kind_of(atom.aval.dtype)
            return (
                array_of(number_of(atom.val), ())
                if np.ndim(atom.val) == 0
                else np.asarray(atom.val).astype(object)
            )
        return values[atom]

    for equation in jaxpr.eqns:
        name = equation.primitive.name
        if name not in RULES:
            raise Unsupported(f"the primitive {name}")
        inputs = [get(atom) for atom in equation.invars]
        if name not in READ_MEMORY and any(isinstance(value, InMemory) for value in inputs):
            raise Unsupported(f"{name} of a long array")
        found = RULES[name](writer, equation, *inputs)
        values |= dict(
            zip(equation.outvars, found if isinstance(found, list) else [found], strict=True)
        )
    return [get(atom) for atom in jaxpr.outvars]


def write_closed(writer: Writer, program: Any, arguments: Any) -> list:
    """The outputs of a program whose constants are known."""
    if isinstance(program, ClosedJaxpr):
        return write(writer, program.jaxpr, [known_array(c) for c in program.consts], arguments)
    return write(writer, program, [], arguments)


def known_array(value: Any) -> np.ndarray:
    """A NumPy array of numbers as an object array of Python numbers."""
    plain = np.asarray(value)
    kind_of(plain.dtype)
    return plain.astype(object)


def refuse_memory(*arrays: Any) -> None:
    """Raises `Unsupported` where one of them is kept in memory."""
    if any(isinstance(a, InMemory) for a in arrays):
        raise Unsupported("a long array that changes")


def kinds_of(equation: Any) -> list[str]:
    """The LLVM types of an equation's inputs."""
    return [kind_of(atom.aval.dtype) for atom in equation.invars]


def each(function: Callable, *arrays: np.ndarray) -> np.ndarray:
    """A function of single numbers over arrays of one shape (or scalars)."""
    shape = arrays[0].shape
    if any(a.shape != shape for a in arrays):
        shape = np.broadcast_shapes(*[a.shape for a in arrays])
        arrays = tuple(np.broadcast_to(a, shape) for a in arrays)
    if shape == ():
        return array_of(function(*[a.item() for a in arrays]), ())
    out = np.empty(math.prod(shape), object)
    for k, numbers in enumerate(zip(*[a.ravel().tolist() for a in arrays], strict=True)):
        out[k] = function(*numbers)
    return out.reshape(shape)


def known(*values: Any) -> bool:
    """Whether all are numbers known while writing."""
    return not any(isinstance(v, str) for v in values)
