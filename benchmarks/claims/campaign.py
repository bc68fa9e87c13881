"""What keeping a study on disk costs: samples a CPU second beside the plain study, on the threads
of one process and on two workers of Dask; a finished folder asked again; memory against samples;
size of a sample in the folder.

CPU time of all processes that compute counts, the two studies taking turns. Memory is the largest
resident set of a process of its own for each number of samples.
"""

import functools
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jaxclear as jc
from benchmarks.claims.positions import four_bar as four_bar_positions
from benchmarks.claims.positions import stack
from benchmarks.measure import arguments, report, side_by_side
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
    "four-bar, 0.05 s of motion, four times as many": (four_bar_in_motion, 256, 8192),
    "four-bar, 36 positions": (four_bar_positions, 1 << 14, 1 << 17),
    "four-bar, 36 positions, eight times as many": (four_bar_positions, 1 << 15, 1 << 20),
    "stack of ten": (stack, 1 << 17, 1 << 20),
}


def fresh() -> Path:
    """A folder that there is not."""
    return Path(tempfile.mkdtemp()) / "campaign"


def rate_row(name: str, problem: Any, samples: int) -> dict[str, Any]:
    """Both studies of the same samples, by turns."""
    cases = {
        "plain": lambda: jc.monte_carlo(problem, samples, seed=SEED).values,
        "kept": lambda: jc.campaign(problem, samples, folder=fresh(), seed=SEED).finished,
    }
    spent = side_by_side(cases, 3)
    return {
        "problem": name,
        "samples": samples,
        "plain, samples per CPU s": samples / spent["plain"][1],
        "campaign, samples per CPU s": samples / spent["kept"][1],
        "campaign over plain": spent["plain"][1] / spent["kept"][1],
    }


def dask_row(
    name: str, problem: Any, samples: int, settings: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Two workers of one thread beside the plain study on two threads, by turns: wall time, and CPU
    time of all processes, the client's own work and Dask's included. The cluster is the usual one
    but for the settings; what it takes while nothing is asked of it is told by itself, and the
    scheduler's part of that is in the plain study's time too, which runs in its process. So is told
    what the first campaign takes, compiled on both workers."""
    import dask
    import distributed

    plain = lambda: jc.monte_carlo(problem, samples, seed=SEED)
    plain()
    with dask.config.set(settings or {}):
        cluster = distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None
        )
    with cluster, distributed.Client(cluster) as client:
        ask = lambda: jc.campaign(problem, samples, folder=fresh(), seed=SEED, client=client)
        worked = lambda: sum(client.run(time.process_time).values())
        first, _ = _spent(ask, worked)
        turns = [(_spent(plain, lambda: 0.0), _spent(ask, worked)) for _ in range(3)]
        idle = _spent(lambda: time.sleep(IDLE), worked)
    wall, cpu = ([min(turn[who][what] for turn in turns) for who in (0, 1)] for what in (0, 1))
    return {
        "problem": name,
        "samples": samples,
        "plain, samples per s": samples / wall[0],
        "two workers, samples per s": samples / wall[1],
        "workers over plain": wall[0] / wall[1],
        "plain, samples per CPU s": samples / cpu[0],
        "two workers, samples per CPU s": samples / cpu[1],
        "workers over plain, CPU": cpu[0] / cpu[1],
        "idle cluster [CPU s per s]": idle[1] / idle[0],
        "first campaign [s]": first,
    }


def _spent(work: Callable[[], Any], elsewhere: Callable[[], float]) -> tuple[float, float]:
    """(wall, CPU) seconds of some work here, with the CPU time that other processes give it."""
    others, cpu, wall = elsewhere(), time.process_time(), time.perf_counter()
    work()
    spent = time.perf_counter() - wall, time.process_time() - cpu
    return spent[0], spent[1] + elsewhere() - others


def folder_row(name: str, problem: Any, samples: int) -> dict[str, Any]:
    """A finished folder: its size, and what it takes to ask for it again."""
    place = fresh()
    found = jc.campaign(problem, samples, folder=place, seed=SEED)
    again = {"again": lambda: jc.campaign(problem, samples, folder=place, seed=SEED).finished}
    spent = side_by_side(again, 3)["again"]
    size = sum(path.stat().st_size for path in place.rglob("*") if path.is_file())
    return {
        "problem": name,
        "samples": samples,
        "chunks": found.plan.chunks,
        "asked again [CPU s]": spent[1],
        "bytes a sample": size / samples,
        "numbers a sample": len(problem.names) + len(problem.response_names),
    }


def memory_rows(most: int) -> list[dict[str, Any]]:
    """Largest resident set of a campaign of so many samples, also with the summary read from its
    folder, of one that doubles its samples toward an accuracy, and of the plain study."""
    rows = []
    samples = 1000
    while samples <= most:
        row: dict[str, Any] = {"samples": samples}
        for what in ("campaign", "campaign and summary", "to an accuracy", "plain study"):
            told = [sys.executable, "-m", "benchmarks.claims.campaign", "peak", what, str(samples)]
            found = subprocess.run(told, capture_output=True, text=True, check=True)
            row[f"{what} [MB]"] = float(found.stdout.split()[-1])
        rows.append(row)
        samples *= 10
    return rows


def print_peak(what: str, samples: int) -> None:
    """Of this process, which does nothing else."""
    problem = stack()
    if what == "plain study":
        jc.monte_carlo(problem, samples, seed=SEED)
    else:
        # One that no sample reaches: all are computed, up to a power of two.
        accuracy = 1e-12 if what == "to an accuracy" else None
        found = jc.campaign(problem, samples, folder=fresh(), seed=SEED, accuracy=accuracy)
        if what == "campaign and summary":
            found.summary()
    # Of this program alone: `ru_maxrss` would hold what its parent had when it began.
    status = Path("/proc/self/status").read_text()
    print(float(status.split("VmHWM:")[1].split()[0]) / 1024)


def main() -> None:
    if sys.argv[1:2] == ["peak"]:
        print_peak(sys.argv[2], int(sys.argv[3]))
        return
    told = {"default": "", "help": "only rows whose part and problem hold this text"}
    options = arguments(__doc__, only=told)
    for part, (title, row) in PARTS.items():
        for name, (build, few, many) in PROBLEMS.items():
            if options.only in f"{part} {name}":
                found = row(name, build(), few if options.quick else many)
                report(title, [*others(title, name, options.json), found], options)
    if options.only in "memory":
        most = 100_000 if options.quick else 1_000_000
        report("Largest memory against samples (stack of ten)", memory_rows(most), options)


def others(title: str, name: str, path: Path | None) -> list[dict[str, Any]]:
    """What is known of other problems."""
    known = json.loads(path.read_text()) if path is not None and path.exists() else {}
    return [row for row in known.get(title, ()) if row["problem"] != name]


PARTS = {
    "rates": ("A campaign beside the plain study", rate_row),
    "dask": ("A campaign on two workers of Dask beside the plain study", dask_row),
    "sparing dask": (
        "A campaign on two workers of Dask that draw no profile and have one core each",
        functools.partial(dask_row, settings=SPARING),
    ),
    "folders": ("A finished folder", folder_row),
}


if __name__ == "__main__":
    main()
