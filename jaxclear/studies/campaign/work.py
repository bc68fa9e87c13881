"""Chunks of a campaign, one by one: claimed, drawn, computed, kept. By the threads of this process;
other processes may be at the same folder.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from jaxclear.integrators import Outcome
from jaxclear.native import stop, stoppable
from jaxclear.studies.base import SampleResult
from jaxclear.studies.batch import threads_of
from jaxclear.studies.campaign.devices import devices
from jaxclear.studies.campaign.plan import Evaluation, Stopped
from jaxclear.studies.campaign.samples import Samples

__all__ = ["by_threads", "done", "failures"]

# [s] between looks at whether others have finished the chunks that they are at.
PATIENCE = 0.2
# Told of every chunk that is finished: its number and how many of its samples failed.
Heard = Callable[[int, int], None]


def failures(found: SampleResult) -> int:
    """How many of these samples failed."""
    finite = np.all([np.isfinite(own) for own in found.responses.values()], axis=0)
    return int(np.sum((found.outcome != Outcome.REACHED) | ~finite))


def done(samples: Samples, evaluation: Evaluation, number: int) -> int | None:
    """Computes a chunk and keeps it: how many of its samples failed; None where another thread or
    process is at it."""
    with samples.claimed(number) as mine:
        if samples.is_finished(number):
            return failures(samples.found(slice(*samples.plan.span(number))))
        if not mine:
            return None
        values = evaluation.values(number)
        found = evaluation.chunk(values)
        samples.write(number, values, found)
        return failures(found)


def by_threads(
    samples: Samples, evaluation: Evaluation, numbers: Iterable[int], heard: Heard
) -> None:
    """Computes chunks side by side, and waits for those that other processes are at. Raises
    `KeyboardInterrupt` when it is interrupted; the chunks in work are then lost."""
    left = list(numbers)
    # Several devices are busy side by side as it is.
    threads = threads_of() if devices() == 1 else 1
    with stoppable(), ThreadPoolExecutor(threads) as pool:
        try:
            while left:
                found = pool.map(lambda number: done(samples, evaluation, number), left)
                left = list(_told(zip(left, found, strict=True), heard))
                time.sleep(PATIENCE if left else 0)
        except BaseException as reason:
            # The machine is to be idle when the user has the word again.
            if isinstance(reason, (KeyboardInterrupt, Stopped)):
                stop()
            pool.shutdown(wait=True, cancel_futures=True)
            if isinstance(reason, Stopped):
                raise KeyboardInterrupt from None
            raise


def _told(found: Iterable[tuple[int, int | None]], heard: Heard) -> Iterator[int]:
    """Tells of the chunks that are finished; the others remain."""
    for number, failed in found:
        if failed is None:
            yield number
        else:
            heard(number, failed)
