"""Chunks of a campaign on the workers of Dask, which write them themselves.

Dask decides who computes what, and asks again for what a lost worker was at. Only the problem
travels (pickled by Dask, between processes of one user), once to each worker, and the number of a
chunk; no samples do. A worker compiles the program once, for
later campaigns of the same problem too.
"""

import functools
import hashlib
import secrets
import time
from collections import deque
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from jaxclear.ground.wording import described
from jaxclear.studies.base import AbstractProblem
from jaxclear.studies.campaign.plan import Evaluation
from jaxclear.studies.campaign.samples import SAMPLES, Samples
from jaxclear.studies.campaign.work import PATIENCE, Heard, done

__all__ = ["by_workers", "check_client"]

# Chunks asked of the scheduler at a time, at least, and for each thread of the workers.
LEAST_ASKED, ASKED_A_THREAD = 64, 4


def check_client(client: Any) -> None:
    """Raises `ValueError` with a sentence for what is no client of Dask."""
    kinds = {f"{kind.__module__}.{kind.__qualname__}" for kind in type(client).__mro__}
    if "distributed.client.Client" not in kinds or client.asynchronous:
        raise ValueError(
            f"client of campaign is {described(client)}; it must be a dask.distributed.Client (not "
            'asynchronous): python -m pip install "jaxclear[dask]".'
        )


def by_workers(
    client: Any, samples: Samples, problem: AbstractProblem, numbers: Iterable[int], heard: Heard
) -> None:
    """Computes chunks on all workers of a client. Interrupted, it asks for no more; chunks in work
    are finished. Raises `RuntimeError` with a sentence where a chunk ends its workers."""
    import distributed

    folder = str(samples.folder.resolve())
    # The texts that a folder is known by tell a worker whether it has compiled the problem before.
    which = hashlib.sha256(samples.told["problem"].encode()).hexdigest()
    token = f"{which} {secrets.token_hex(8)}"
    there = client.submit(_itself, problem, pure=False)
    left: deque[int] = deque(numbers)
    asked: dict[Any, int] = {}
    running = distributed.as_completed()
    most = max(LEAST_ASKED, ASKED_A_THREAD * sum(client.nthreads().values()))
    try:
        while left or asked:
            while left and len(asked) < most:
                number = left.popleft()
                future = client.submit(_on_worker, there, folder, number, token, pure=False)
                asked[future.key] = number
                running.add(future)
            future = next(running)
            number = asked.pop(future.key)
            failed = _answer(future, number)
            if failed is None:
                left.append(number)
                time.sleep(PATIENCE)
            else:
                heard(number, failed)
    finally:
        client.cancel([*running.futures, there])


def _answer(future: Any, number: int) -> int | None:
    """What a worker says of a chunk."""
    import distributed

    try:
        return future.result()
    except distributed.KilledWorker as reason:
        raise RuntimeError(
            f"chunk {number} of the campaign ended every worker that computed it, for want of "
            "memory maybe; finished chunks are kept. Give workers more memory, or a smaller chunk."
        ) from reason


def _itself(problem: AbstractProblem) -> AbstractProblem:
    """The problem, as something that Dask holds for all workers."""
    return problem


def _on_worker(problem: AbstractProblem, folder: str, number: int, token: str) -> int | None:
    """Computes and keeps a chunk, on a worker."""
    problem = _known(_Once(token.partition(" ")[0], problem))
    return done(*_ready(_Once(token, problem), folder), number)


class _Once:
    """A problem that counts as the one that came first with the same token: its program is compiled
    once, however often Dask sends it."""

    def __init__(self, token: str, problem: AbstractProblem):
        self.token, self.problem = token, problem

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Once) and self.token == other.token

    def __hash__(self) -> int:
        return hash(self.token)


@functools.lru_cache(maxsize=4)
def _known(known: _Once) -> AbstractProblem:
    """The problem as it came first: what is compiled for it serves later campaigns too."""
    return known.problem


@functools.lru_cache(maxsize=4)
def _ready(known: _Once, folder: str) -> tuple[Samples, Evaluation]:
    """The folder and the program of a campaign on this worker."""
    if not (Path(folder) / SAMPLES).exists():
        raise ValueError(
            f"a worker does not see the folder {folder} of the campaign; give one that all workers "
            "share."
        )
    samples = Samples(Path(folder))
    return samples, Evaluation(known.problem, samples.plan)
