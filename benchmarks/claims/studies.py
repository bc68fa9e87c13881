"""Samples a second of each study on each scene, on one core and on two, by CPU time of warm
programs.

    python -m benchmarks.claims.studies [--quick] [--scenes antenna ...] [--json FILE]

`stack of ten` and `four-bar, 36 positions` know no time (`positions`); the antenna and the four-bar
are those of `jaxclear design`, the slider-crank rattles at 50 rad/s over two turns. A sample is one
run of the problem, whatever the study asks it for: all that it runs counts. On two cores it is per
CPU second of both together: where nothing is lost to the second, it is the rate of one, and a
second of the clock has two of these. Designs are in `design`, campaigns in `campaign`.
"""

import os

# Threads of NumPy's linear algebra that wait for each other count as CPU time; read when it is
# loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import contextlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import jaxclear as jc
from benchmarks.claims import coverage, positions
from benchmarks.measure import report, sign
from jaxclear.commands.design import antenna_question, four_bar_question

SCENES: dict[str, Callable[[], Any]] = {
    "stack of ten": positions.stack,
    "four-bar, 36 positions": positions.four_bar,
    "antenna": lambda: antenna_question().problem,
    "four-bar": lambda: four_bar_question().problem,
    "slider-crank": lambda: coverage.crank("crank 50 rad/s"),
}
# Samples of scenes in time, and of others.
SLOW, FAST = 128, 2048
# The share of samples that a reliability is asked to stay below.
OFTEN = 0.98


def studies(problem: Any, samples: int) -> dict[str, Callable[[], int]]:
    """Each study of a problem, which tells how many runs it took."""
    response, variable = problem.response_names[0], problem.names[0]
    drawn = jc.monte_carlo(problem, samples, seed=3).good(response)[0]
    limit = jc.limit_state.Above(response, float(np.quantile(drawn, OFTEN)))

    def sensitivity() -> int:
        found = jc.sensitivity(problem, variable, sample=samples).derivatives.values()
        methods = {name for own in found for name in own.estimates}
        most = lambda name: max(own.estimates[name].runs for own in found)
        return sum(map(most, methods))

    return {
        "monte_carlo": lambda: jc.monte_carlo(problem, samples).count,
        "sensitivity": sensitivity,
        "surface": lambda: len(jc.surface(problem, samples).values),
        "sobol_indices": lambda: jc.sobol_indices(problem, samples // 4).runs,
        "reliability": lambda: jc.reliability(problem, limit).runs,
        "worst_case": lambda: jc.worst_case(problem, samples=samples // 2).runs,
    }


def on_cores(count: int) -> None:
    """All threads of this process run on so many cores."""
    chosen = sorted(ALL)[:count]
    for thread in map(int, os.listdir("/proc/self/task")):
        # One may end meanwhile.
        with contextlib.suppress(ProcessLookupError):
            os.sched_setaffinity(thread, chosen)


ALL = os.sched_getaffinity(0)


def rows_of(scene: str, samples: int) -> list[dict[str, Any]]:
    problem = SCENES[scene]()
    asked = studies(problem, samples)
    rows: list[dict[str, Any]] = [{"scene": scene, "study": name} for name in asked]
    for cores in (1, 2):
        on_cores(cores)
        for row, study in zip(rows, asked.values(), strict=True):
            study()
            begun = time.process_time()
            runs = study()
            row |= {"samples": runs}
            name = f"samples per CPU s, {cores} core{'s' * (cores > 1)}"
            row[name] = float(f"{runs / (time.process_time() - begun):.3g}")
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--scenes", nargs="*", default=list(SCENES), choices=list(SCENES))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    for scene in options.scenes[: 1 if options.quick else None]:
        title = f"Studies of the {scene}"
        timeless = scene in ("stack of ten", "four-bar, 36 positions")
        report(title, rows_of(scene, FAST if timeless else SLOW), options)
        sign("benchmarks.claims.studies", options.json, [title])


if __name__ == "__main__":
    main()
