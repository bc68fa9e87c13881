"""Answers `jaxclear report`."""

from pathlib import Path

import click

from jaxclear.commands.report.campaign_page import campaign_page
from jaxclear.commands.report.folder_page import folder_page
from jaxclear.studies.campaign.samples import holds_campaign

__all__ = ["report"]

PAGE = "report.html"


def report(store: Path, to: Path | None = None) -> None:
    """Writes one page of what a folder holds, beside it as report.html or to a file."""
    page = campaign_page(store) if holds_campaign(store) else folder_page(store)
    if page is None:
        raise click.UsageError(
            f"{store} holds neither a campaign nor figures or tables; it must be a folder that "
            "jaxclear has written."
        )
    path = store / PAGE if to is None else to
    page.write(path)
    click.echo(f"{path.resolve()} ({path.stat().st_size / 1e3:.0f} kB)")
