"""A program gone through equation by equation."""

from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Literal

from jaxclear.native.calls import CALLS, called


def known_first(program: ClosedJaxpr, arguments: Sequence[Any]) -> dict[Any, Any]:
    """Values of a program's variables as it begins."""
    jaxpr = program.jaxpr
    names = [*jaxpr.constvars, *jaxpr.invars]
    return dict(zip(names, [*program.consts, *arguments], strict=True))


def read(atoms: Sequence[Any], values: dict[Any, Any]) -> list:
    """What variables and numbers of a program stand for."""
    return [_number(atom) if isinstance(atom, Literal) else values[atom] for atom in atoms]


def _number(literal: Any) -> Any:
    return jnp.asarray(literal.val, literal.aval.dtype)


def applied(equation: Any, inputs: Sequence[Any], parameters: dict[str, Any]) -> Sequence[Any]:
    """What the operation of an equation gives, with these parameters."""
    found = equation.primitive.bind(*inputs, **parameters)
    return found if equation.primitive.multiple_results else [found]


def replayed(
    program: ClosedJaxpr,
    arguments: Sequence[Any],
    one: Callable[[Any, list], Sequence[Any]] = lambda e, inputs: applied(e, inputs, e.params),
) -> list:
    """The program's results, the functions that it calls written out; `one`: what an equation gives
    of its inputs."""
    values = known_first(program, arguments)
    for equation in program.jaxpr.eqns:
        inputs = read(equation.invars, values)
        if equation.primitive.name in CALLS:
            inner = called(equation.params)
            inner = inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, [])
            found: Sequence[Any] = replayed(inner, inputs, one)
        else:
            found = one(equation, inputs)
        values |= dict(zip(equation.outvars, found, strict=True))
    return read(program.jaxpr.outvars, values)
