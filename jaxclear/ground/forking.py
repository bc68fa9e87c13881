"""A process that was forked after jaxclear was imported cannot compute: XLA's threads are not
forked with it, and it would wait for them for ever. So its first use ends in a sentence.
"""

import os

_IMPORTED_IN = os.getpid()


def check_not_forked() -> None:
    """Raises `RuntimeError` in the child of a fork of a process that had imported jaxclear."""
    if os.getpid() != _IMPORTED_IN:
        raise RuntimeError(
            "this process was forked from one that had imported jaxclear, and XLA's threads are "
            "not forked with it: it would wait for ever. Start processes by "
            'multiprocessing.get_context("spawn") or "forkserver", or let jaxclear.monte_carlo run '
            "the samples, on all cores by itself."
        )
