"""What the animation of a run takes: CPU time beside the run it shows, size of its one file, by
frames a second; for the four-bar over 10 s (16 turns of its crank).
"""

import time

import jax

import jaxclear as jc
from benchmarks.measure import run_tables
from jaxclear import plot


def timed(function) -> tuple:
    """(result, CPU seconds)."""
    start = time.process_time()
    result = jax.block_until_ready(function())
    return result, time.process_time() - start


def rows(options):
    """A row for each number of frames a second."""
    duration = 1.0 if options.quick else 10.0
    rig, integrator = jc.scenes.four_bar("spatial", 0.2e-3), jc.integrator.ImplicitStep()
    save = round(200 * duration) + 1
    simulate = lambda: jc.simulate(rig, duration, save=save, integrator=integrator)
    simulate()
    run, run_time = timed(simulate)
    plot.animate(run, fps=1)
    for fps in (15, 30, 60):
        page, cpu = timed(lambda fps=fps: plot.animate(run, fps=fps, slower=1.0).html)
        yield {
            "frames a second": fps,
            "frames": plot.animate(run, fps=fps, slower=1.0).frames,
            "file [MB]": len(page.encode()) / 1e6,
            "page [CPU s]": cpu,
            "page / run [1]": cpu / run_time,
        }


if __name__ == "__main__":
    run_tables({"Animation of the four-bar, 10 s": rows})
