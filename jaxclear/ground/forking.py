"""A process that was forked after JAX had begun to compute cannot compute: XLA's threads are not
forked with it, and it would wait for them for ever. So the first number it makes, and its first
run, end in a sentence.
"""

import os
import sys

__all__ = ["check_not_forked"]

_forked = False


def _computes() -> bool:
    """Whether JAX has begun to compute in this process. Where it does not say so any more, it is
    taken to have."""
    bridge = sys.modules.get("jax._src.xla_bridge")
    begun = getattr(bridge, "backends_are_initialized", lambda: True)
    return bool(begun())


def _note() -> None:
    global _forked
    _forked = _forked or _computes()


if os.name == "posix":
    os.register_at_fork(after_in_child=_note)


def check_not_forked() -> None:
    """Raises `RuntimeError` in the child of a fork of a process in which JAX computed."""
    if _forked:
        raise RuntimeError(
            "this process was forked from one in which JAX had begun to compute, and XLA's threads "
            "are not forked with it: it would wait for ever. Start processes by "
            'multiprocessing.get_context("spawn") or "forkserver", or let jaxclear.monte_carlo run '
            "the samples, on all cores by itself."
        )
