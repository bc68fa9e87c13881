"""What keeping a study on disk costs: samples a CPU second beside the plain study, on the threads
of one process and on two workers of Dask; a finished folder asked again; memory against samples;
size of a sample in the folder.

CPU time of all processes that compute counts, the two studies taking turns. Memory is the largest
resident set of a process of its own for each number of samples.
"""

import resource
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


def four_bar_in_motion() -> jc.Problem:
    return four_bar(0.05, 26)


PROBLEMS: dict[str, tuple[Callable[[], Any], int, int]] = {
    "four-bar, 0.05 s of motion": (four_bar_in_motion, 128, 512),
    "four-bar, 36 positions": (four_bar_positions, 1 << 14, 1 << 17),
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


def dask_row(name: str, problem: Any, samples: int) -> dict[str, Any]:
    """Two workers of one thread, warm, beside the plain study; the client's own work counts."""
    import distributed

    plain = lambda: jc.monte_carlo(problem, samples, seed=SEED)
    plain()
    cluster = distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
    best = {"plain": float("inf"), "kept": float("inf")}
    with cluster, distributed.Client(cluster) as client:
        for turn in range(4):
            begun = time.process_time()
            plain()
            best["plain"] = min(best["plain"], time.process_time() - begun)
            begun, workers = time.process_time(), sum(client.run(time.process_time).values())
            jc.campaign(problem, samples, folder=fresh(), seed=SEED, client=client)
            spent = sum(client.run(time.process_time).values()) - workers
            # The first turn compiles on the workers.
            if turn:
                best["kept"] = min(best["kept"], spent + time.process_time() - begun)
    return {
        "problem": name,
        "samples": samples,
        "plain, samples per CPU s": samples / best["plain"],
        "two workers, samples per CPU s": samples / best["kept"],
        "workers over plain": best["plain"] / best["kept"],
    }


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
    folder, and of the plain study."""
    rows = []
    samples = 1000
    while samples <= most:
        row: dict[str, Any] = {"samples": samples}
        for what in ("campaign", "campaign and summary", "plain study"):
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
        found = jc.campaign(problem, samples, folder=fresh(), seed=SEED)
        if what == "campaign and summary":
            found.summary()
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def main() -> None:
    if sys.argv[1:2] == ["peak"]:
        print_peak(sys.argv[2], int(sys.argv[3]))
        return
    options = arguments(__doc__)
    rows, dask, folders = [], [], []
    for name, (build, few, many) in PROBLEMS.items():
        problem, samples = build(), few if options.quick else many
        rows.append(rate_row(name, problem, samples))
        dask.append(dask_row(name, problem, samples))
        folders.append(folder_row(name, problem, samples))
    report("A campaign beside the plain study", rows, options)
    report("A campaign on two workers of Dask beside the plain study", dask, options)
    report("A finished folder", folders, options)
    most = 100_000 if options.quick else 1_000_000
    report("Largest memory against samples (stack of ten)", memory_rows(most), options)


if __name__ == "__main__":
    main()
