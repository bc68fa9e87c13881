"""Two threads beside one: a Monte Carlo of the slider-crank in chunks, wall time and CPU time, the
two by turns in one process. Asks for a machine that nobody else loads: with others on its cores the
ratio says nothing. `--json benchmarks/results/threads.json` keeps it.
"""

import os
import statistics
import time

import jax
import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, report, sign
from jaxclear.studies.store import batch

# Chunks for each of two threads, and samples in each.
CHUNKS, CHUNK = 8, 64
RUNGS = {
    "FixedStep(2e-5)": jc.integrator.FixedStep(2e-5),
    "ImplicitStep(1e-4)": jc.integrator.ImplicitStep(1e-4),
    "Adaptive()": jc.integrator.Adaptive(),
}
# A core that others take a share of spoils a turn: what is told is the median of this many.
TURNS = 15


def question(integrator: jc.integrator.AbstractIntegrator) -> jc.Problem:
    rig = jc.scenes.slider_crank()
    clearance = jc.Variable(lambda m: m.connections["B"].joint.clearance, tolerance=20e-6)
    force = jc.response.MeanContactForce("B")
    return jc.Problem(rig, force, {"c": clearance}, duration=0.1, integrator=integrator, save=21)


def measured(name: str, turns: int) -> dict[str, float | str]:
    problem = question(RUNGS[name])
    spread = np.random.default_rng(0).uniform(-2e-5, 2e-5, size=(2 * CHUNKS * CHUNK, 1))
    values = jax.numpy.asarray(np.asarray(problem.nominal()) + spread)
    own, spent = batch.threads_of, {1: [], 2: []}
    try:
        for turn in range(turns + 1):
            for threads in (1, 2):
                batch.threads_of = lambda count=threads: count
                cpu, wall = time.process_time(), time.perf_counter()
                batch.evaluate_all(problem, values, chunk=CHUNK)
                if turn:  # the first one compiles
                    spent[threads].append((time.perf_counter() - wall, time.process_time() - cpu))
    finally:
        batch.threads_of = own
    pairs = list(zip(spent[1], spent[2], strict=True))
    wall, cpu = ([one[i] / two[i] for one, two in pairs] for i in (0, 1))
    row: dict[str, float | str] = {"rung": name, "samples": len(values), "samples a chunk": CHUNK}
    row["one thread [ms]"] = 1e3 * statistics.median(one[0] for one, _ in pairs)
    row["one thread over two, wall time"] = statistics.median(wall)
    row["CPU time of two over one"] = 1 / statistics.median(cpu)
    row["load before"] = os.getloadavg()[0]
    return row


def main() -> None:
    options = arguments(__doc__)
    names = list(RUNGS)[:1] if options.quick else list(RUNGS)
    rows = [measured(name, 3 if options.quick else TURNS) for name in names]
    report("A Monte Carlo on two threads beside one", rows, options)
    sign("benchmarks.claims.threads", options.json)


if __name__ == "__main__":
    main()
