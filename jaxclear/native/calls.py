"""Rules for programs that a program calls, and for errors that it would raise on the host."""

from typing import Any

from jaxclear.native.rules import array_of, rule, write_closed
from jaxclear.native.writer import FLOAT, Unsupported, kind_of

CALLS = (
    "jit",
    "pjit",
    "closed_call",
    "core_call",
    "eval_jaxpr",
    "remat",
    "checkpoint",
    "remat2",
    "custom_jvp_call",
    "custom_vjp_call",
)


def called(parameters: dict) -> Any:
    """The program that one of the `CALLS` calls."""
    return next(parameters[k] for k in ("jaxpr", "call_jaxpr", "fun_jaxpr") if k in parameters)


@rule(*CALLS, reads_memory=True)
def _call(writer, equation, *arguments):
    return write_closed(writer, called(equation.params), arguments)


def is_an_error(parameters: dict) -> bool:
    """Whether a call of the host by these parameters is Equinox's way to raise an error."""
    function = getattr(parameters["callback"], "callback_func", None)
    return getattr(function, "__module__", "") == "equinox._errors"


@rule("pure_callback")
def _raise(writer, equation, *arguments):
    """A kernel cannot raise. What an error guards becomes nan, as Equinox has it where it may not
    raise either."""
    if not is_an_error(equation.params):
        raise Unsupported("a call of the host")
    avals = [atom.aval for atom in equation.outvars]
    if any(kind_of(aval.dtype) != FLOAT for aval in avals):
        raise Unsupported("an error about whole numbers")
    return [array_of(float("nan"), aval.shape) for aval in avals]
