"""A process that was forked after jaxclear was imported cannot compute: XLA's threads are not
forked with it, and it would wait for them for ever. So the first number it makes, and its first
run, end in a sentence.
"""

import os

__all__ = ["check_not_forked"]

_forked = False


def _note() -> None:
    global _forked
    _forked = True


if os.name == "posix":
    os.register_at_fork(after_in_child=_note)


def check_not_forked() -> None:
    """Raises `RuntimeError` in the child of a fork of a process that had imported jaxclear."""
    if _forked:
        raise RuntimeError(
            "this process was forked from one that had imported jaxclear, and XLA's threads are "
            "not forked with it: it would wait for ever. Start processes by "
            'multiprocessing.get_context("spawn") or "forkserver", or let jaxclear.monte_carlo run '
            "the samples, on all cores by itself."
        )
