"""What the animation of a run takes: CPU time beside the run it shows, size of its one file, by
frames a second; for the four-bar over 10 s (16 turns of its crank).
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import jax

import jaxclear as jc
from benchmarks.measure import arguments, report
from jaxclear import plot


def spent(function) -> tuple:
    """(what it gives, CPU seconds)."""
    begun = time.process_time()
    found = jax.block_until_ready(function())
    return found, time.process_time() - begun


def main() -> None:
    options = arguments(__doc__)
    duration = 1.0 if options.quick else 10.0
    rig, integrator = jc.scenes.four_bar("spatial", 0.2e-3), jc.integrator.ImplicitStep()
    save = round(200 * duration) + 1
    simulate = lambda: jc.simulate(rig, duration, save=save, integrator=integrator)
    simulate()
    run, run_time = spent(simulate)
    plot.animate(run, fps=1)
    rows = []
    for fps in (15, 30, 60):
        page, cpu = spent(lambda fps=fps: plot.animate(run, fps=fps, slower=1.0).html)
        with TemporaryDirectory() as folder:
            path = Path(folder) / "run.html"
            path.write_text(page, encoding="utf-8")
            size = path.stat().st_size
        frames = plot.animate(run, fps=fps, slower=1.0).frames
        rows.append(
            {
                "frames a second": fps,
                "frames": frames,
                "file [MB]": size / 1e6,
                "page [CPU s]": cpu,
                "page / run [1]": cpu / run_time,
            }
        )
    report(f"Animation of the four-bar, {duration:g} s", rows, options)


if __name__ == "__main__":
    main()
