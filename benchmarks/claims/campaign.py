"""What a campaign on two workers of Dask is beside the plain study: CPU time of all processes that
compute, the two studies taking turns.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jaxclear as jc
from benchmarks.claims.positions import four_bar as four_bar_positions
from benchmarks.claims.positions import stack
from benchmarks.measure import run_tables, stored_rows
from jaxclear.commands.four_bar import problem as four_bar

SEED = 1
# [s] for which a cluster is watched that does nothing.
IDLE = 5.0
# A cluster as the book's page on campaigns sets it: its workers draw no profile of themselves, and
# XLA knows that each of them has one core.
SPARING = {
    "distributed.worker.profile.enabled": False,
    "distributed.nanny.pre-spawn-environ.PJRT_NPROC": 1,
}


def four_bar_in_motion() -> jc.Problem:
    return four_bar(0.05, 26)


PROBLEMS: dict[str, tuple[Callable[[], Any], int, int]] = {
    "four-bar, 0.05 s of motion": (four_bar_in_motion, 128, 2048),
    "four-bar, 36 positions": (four_bar_positions, 1 << 14, 1 << 17),
    "stack of ten": (stack, 1 << 17, 1 << 20),
}


def fresh() -> Path:
    """A folder that there is not."""
    return Path(tempfile.mkdtemp()) / "campaign"


def dask_row(name: str, problem: Any, samples: int, settings: dict[str, Any]) -> dict[str, Any]:
    """Two workers of one thread beside the plain study on two threads, by turns: CPU time of all
    processes, the client's own work and Dask's included. The cluster is the usual one but for the
    settings; what it takes while nothing is asked of it is told by itself, and the scheduler's part
    of that is in the plain study's time too, which runs in its process."""
    import dask
    import distributed

    plain = lambda: jc.monte_carlo(problem, samples, seed=SEED)
    plain()
    with dask.config.set(settings):
        cluster = distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None
        )
    with cluster, distributed.Client(cluster) as client:
        ask = lambda: jc.campaign(problem, samples, folder=fresh(), seed=SEED, client=client)
        worked = lambda: sum(client.run(time.process_time).values())
        ask()
        turns = [(_spent(plain), _spent(ask, worked)) for _ in range(3)]
        idle = _spent(lambda: time.sleep(IDLE), worked)
    alone, workers = map(min, zip(*turns, strict=True))
    return {
        "problem": name,
        "samples": samples,
        "plain, samples per CPU s": samples / alone,
        "workers over plain, CPU time": workers / alone,
        "idle cluster [CPU s per s]": idle / IDLE,
    }


def _spent(work: Callable[[], Any], elsewhere: Callable[[], float] = lambda: 0.0) -> float:
    """CPU seconds of some work here, with those that other processes give it."""
    others, cpu = elsewhere(), time.process_time()
    work()
    return time.process_time() - cpu + elsewhere() - others


def rows_of(title: str, settings: dict[str, Any]) -> Callable:
    """A row for each problem that is asked for, others as they stand."""

    def rows(options: Any) -> list[dict[str, Any]]:
        found = [
            dask_row(name, build(), few if options.quick else many, settings)
            for name, (build, few, many) in PROBLEMS.items()
            if options.problem in name
        ]
        names = {row["problem"] for row in found}
        return [row for row in stored_rows(title, options) if row["problem"] not in names] + found

    return rows


PLAIN = "A campaign on two workers of Dask beside the plain study"
LEAN = "A campaign on two workers of Dask that draw no profile and have one core each"
TABLES = {PLAIN: rows_of(PLAIN, {}), LEAN: rows_of(LEAN, SPARING)}

if __name__ == "__main__":
    run_tables(TABLES, problem={"default": "", "help": "problems whose names hold this"})
