"""The command line: `jaxclear four-bar`, `antenna` and `guide` run studies, `jaxclear parameters`
lists a scene's numbers with units.

A study is one module with two functions: `declare` names its arguments, `run` answers them. A new
one is that module and a line in STUDIES.
"""

import argparse
import os
from pathlib import Path

import jax

import jaxclear as jc
from jaxclear.commands import antenna, four_bar, guide

__all__ = ["main"]

STUDIES = {"four-bar": four_bar, "antenna": antenna, "guide": guide}
# Programs that compile faster than this are not kept [s].
WORTH_KEEPING = 0.5


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the `jaxclear` command."""
    parser = argparse.ArgumentParser(prog="jaxclear", description=__doc__.split("\n\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    for name, module in STUDIES.items():
        module.declare(commands.add_parser(name, help=module.HELP))
    commands.add_parser("parameters", help="all numbers of the four-bar with unit and meaning")
    options = parser.parse_args(arguments)
    _keep_compiled_programs()
    if options.command == "parameters":
        print(jc.scenes.four_bar().parameters().to_string(index=False))
        return
    if options.out.exists() and not options.out.is_dir():
        parser.error(f"--out is {options.out}, which is a file; give a folder.")
    STUDIES[options.command].run(options)


def _keep_compiled_programs() -> None:
    """Compiled programs are kept between runs, in $JAX_COMPILATION_CACHE_DIR or the user's cache
    folder.
    """
    default = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "jaxclear"
    folder = os.environ.get("JAX_COMPILATION_CACHE_DIR", str(default))
    jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", WORTH_KEEPING)


if __name__ == "__main__":
    main()
