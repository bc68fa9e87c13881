"""Sentences for what is wrong with what was typed: one line that names what there is, and what was
probably meant.
"""

import difflib
from collections.abc import Iterable

import click


def hint(name: str, known: Iterable[str]) -> str:
    """ " Did you mean ...?" for the known name most like another; "" where none is."""
    found = difflib.get_close_matches(name.lower(), list(known), 1)
    return f' Did you mean "{found[0]}"?' if found else ""


def _flags(command: click.Command) -> list[str]:
    """Names of the arguments that a command takes by name."""
    return [one for p in command.params if isinstance(p, click.Option) for one in p.opts]


def extra_argument(command: click.Command, given: str) -> str:
    """A sentence for an argument that a command does not take."""
    flags = _flags(command)
    known = ", ".join(flags) or "none"
    return f'no argument "{given}"; there are {known}.{hint(given, flags)}'


def said(error: click.UsageError) -> str:
    """The sentence for a mistake, without a stop where it ends in a question."""
    command = error.ctx.command if error.ctx else None
    if isinstance(error, click.NoSuchOption) and command:
        return extra_argument(command, error.option_name)
    if isinstance(error, click.BadOptionUsage):
        return f"{error.option_name}: {_misused(error)}"
    if isinstance(error, click.MissingParameter) and error.param:
        kind = error.param.type.name
        return f"{(error.param.name or '').upper()} is missing; it must be named ({kind})"
    if isinstance(error, click.BadParameter) and error.param:
        named = isinstance(error.param, click.Option)
        return f"{error.param.opts[0]}: {error.message}" if named else error.message
    return error.message


def _misused(error: click.BadOptionUsage) -> str:
    takes = "requires an argument" in error.message
    return "it must have a value" if takes else "it takes no value"
