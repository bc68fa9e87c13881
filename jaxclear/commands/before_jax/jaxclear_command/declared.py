"""A command and a group of commands that answer a mistake with one sentence, and whose --help ends
in examples.
"""

from collections.abc import Callable
from typing import Any

import click

from jaxclear_command.wording import extra_argument, hint


class Command(click.Command):
    """A command with examples, of which each is a line as it is typed."""

    def __init__(self, name: str, examples: list[str], callback: Callable[..., None], **settings):
        # What is too many is refused in our own words.
        settings["context_settings"] = {"allow_extra_args": True}
        click.Command.__init__(self, name, callback=callback, **settings)
        self.examples = examples

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Reads what was typed; a mistake knows the command that it was made in."""
        try:
            return click.Command.parse_args(self, ctx, args)
        except click.UsageError as error:
            error.ctx = error.ctx or ctx
            raise

    def invoke(self, ctx: click.Context) -> Any:
        """Runs it, once all that was typed has been understood."""
        if ctx.args:
            raise click.UsageError(extra_argument(self, ctx.args[0]), ctx)
        return click.Command.invoke(self, ctx)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The examples."""
        _write_examples(self.examples, formatter)


class Group(click.Group):
    """Commands under headings. `headings`: names of commands by what they are for."""

    def __init__(self, headings: dict[str, list[click.Command]], examples: list[str], **settings):
        every = [command for under in headings.values() for command in under]
        click.Group.__init__(self, commands=every, **settings)
        self.headings, self.examples = headings, examples

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """The command that is named first."""
        first = args[0]
        if first not in self.commands and not first.startswith("-") and not ctx.resilient_parsing:
            known = ", ".join(self.commands)
            raise click.UsageError(
                f'no command "{first}"; there are {known}.{hint(first, self.commands)}', ctx
            )
        return click.Group.resolve_command(self, ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """A section for each heading."""
        for heading, commands in self.headings.items():
            rows = [(one.name or "", one.get_short_help_str(limit=90)) for one in commands]
            with formatter.section(heading):
                formatter.write_dl(rows)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The examples."""
        _write_examples(self.examples, formatter)


def _write_examples(examples: list[str], formatter: click.HelpFormatter) -> None:
    if examples:
        with formatter.section("Examples"):
            for line in examples:
                formatter.write(f"  {line}\n")
