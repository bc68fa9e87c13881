"""A process that was forked after JAX had begun to compute cannot compute: XLA's threads are not
forked with it, and it would wait for them for ever. So the first number it makes, and its first
run, end in a sentence.

Whether numbers are of double precision: gaps of 1e-5 m beside coordinates of 1 m have no meaning
in single precision, so whatever computes looks first; here it also learns that it was forked.
"""

import os
import sys
from typing import Any

import jax

_forked = False


def _has_computed() -> bool:
    """Whether JAX has begun to compute in this process. Where it does not say so any more, it is
    taken to have."""
    bridge = sys.modules.get("jax._src.xla_bridge")
    is_initialised = getattr(bridge, "backends_are_initialized", lambda: True)
    return bool(is_initialised())


def _note_fork() -> None:
    global _forked
    _forked = _forked or _has_computed()


if os.name == "posix":
    os.register_at_fork(after_in_child=_note_fork)


def check_not_forked() -> None:
    """Raises `RuntimeError` in the child of a fork of a process in which JAX computed."""
    if _forked:
        raise RuntimeError(
            "this process was forked from one in which JAX had begun to compute, and XLA's threads "
            "are not forked with it: it would wait for ever. Start processes by "
            'multiprocessing.get_context("spawn") or "forkserver", or let jaxclear.monte_carlo run '
            "the samples, on all cores by itself."
        )


def check_double_precision() -> None:
    """Raises `RuntimeError` where float64 has been switched off since jaxclear was imported, and in
    the child of a fork."""
    check_not_forked()
    # Not every version of JAX names its settings to type checkers.
    settings: Any = jax.config
    if not settings.jax_enable_x64:
        raise RuntimeError(
            "jaxclear needs float64, and jax_enable_x64 has been switched off: leave it on "
            "(importing jaxclear switches it on)."
        )
