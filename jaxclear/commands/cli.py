"""Answers the command line: `jaxclear four-bar`, `antenna`, `guide`, `flap`, `3rsr`, `wear-life`
and `design` run studies, `jaxclear parameters` lists a scene's numbers with units.

What may be asked stands in `jaxclear_command`, which answers mistakes before this package is
loaded. A new study is a module with a function `run`, a line here and an entry there.
"""

import argparse
import os
from pathlib import Path

import jax

import jaxclear as jc
from jaxclear.commands import antenna, design, flap, four_bar, guide, parallel_3rsr, wear_life

__all__ = ["answer"]

STUDIES = {
    "four-bar": four_bar,
    "antenna": antenna,
    "guide": guide,
    "flap": flap,
    "3rsr": parallel_3rsr,
    "wear-life": wear_life,
    "design": design,
}
# Programs that compile faster than this are not kept [s].
WORTH_KEEPING = 0.5


def answer(options: argparse.Namespace) -> None:
    """Runs what was asked."""
    _keep_compiled_programs()
    if options.command == "parameters":
        print(jc.scenes.four_bar().parameters().to_string(index=False))
        return
    STUDIES[options.command].run(options)


def _keep_compiled_programs() -> None:
    """Compiled programs are kept between runs, in $JAX_COMPILATION_CACHE_DIR or the user's cache
    folder.
    """
    default = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "jaxclear"
    folder = os.environ.get("JAX_COMPILATION_CACHE_DIR", str(default))
    jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", WORTH_KEEPING)
