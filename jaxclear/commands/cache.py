"""The command `cache`: what is kept of compiled programs between processes, and its end."""

import time

import click

from jaxclear.ground import cache_folder

# Seconds.
DAY = 86400.0
WORDS = {cache_folder.KERNEL: "kernels of time loops", cache_folder.PROGRAM: "programs around them"}


def cache(clear: bool = False) -> None:
    """Lists the compiled programs that are kept, or removes them all (`clear`)."""
    folder = cache_folder.folder_path()
    if folder is None:
        click.echo(f"Nothing is kept: {cache_folder.VARIABLE} is off.")
        return
    if clear:
        click.echo(f"{cache_folder.clear()} files removed from {folder}")
        return
    files = cache_folder.list_files()
    for kind, words in WORDS.items():
        of_kind = [one for one in files if one.path.suffix == f".{kind}"]
        click.echo(f"{len(of_kind):6} {words}, {sum(one.size for one in of_kind) / 1e6:.1f} MB")
    if files:
        days = (time.time() - files[0].used) / DAY
        click.echo(f"The oldest was last used {days:.1f} days ago.")
    most = cache_folder.MOST / 1e6
    click.echo(
        f"They lie in {folder}, which holds {most:.0f} MB at most; see jaxclear cache --help."
    )
