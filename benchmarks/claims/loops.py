"""What runs the time loop, and what that is worth: XLA as it comes, XLA with the compiler option
that jaxclear sets, and jaxclear's own kernels (`jaxclear.native`). The four-bar, alone and in a
batch, each way in a process of its own.

The option is read when JAX starts, so it cannot be changed within a process; the processes take
turns, and the smallest of several times counts.
"""

import json
import os
import subprocess
import sys
import time

from benchmarks.measure import arguments, report

DURATION = 0.05
SAMPLES = 128
REPEATS = 3
WAYS = {
    "XLA as it comes": {"JAXCLEAR_PLAIN_XLA": "1", "JAXCLEAR_PLAIN_LOOPS": "1"},
    "XLA with the option": {"JAXCLEAR_PLAIN_XLA": "0", "JAXCLEAR_PLAIN_LOOPS": "1"},
    "kernels": {"JAXCLEAR_PLAIN_XLA": "0", "JAXCLEAR_PLAIN_LOOPS": "0"},
}


def measured() -> dict[str, dict[str, float]]:
    """Seconds of the first call (compiling) and ns a step of later ones, by integrator, alone and
    in a batch.
    """
    import jaxclear as jc
    from jaxclear.studies.batch import evaluate_all
    from jaxclear.studies.sampling import draw

    rig, found = jc.scenes.four_bar(), {}
    jc.assemble(rig)
    variables = {"c": jc.Variable(lambda m: m.connections["B"].joint.clearance, tolerance=20e-6)}
    for integrator in (
        jc.integrator.FixedStep(),
        jc.integrator.ImplicitStep(),
        jc.integrator.Adaptive(),
    ):
        run, first, best = _timed(
            lambda i=integrator: jc.simulate(rig, DURATION, save=21, integrator=i)
        )
        steps = int(run.accepted_steps) + int(run.rejected_steps)
        row = {"first run alone [s]": first, "alone [ns/step]": best / steps * 1e9}
        problem = jc.Problem(
            rig, _steps_taken, variables, duration=DURATION, save=21, integrator=integrator
        )
        values = draw(problem, SAMPLES, 0)
        outcome, first, best = _timed(lambda p=problem, v=values: evaluate_all(p, v))
        row |= {
            "first batch [s]": first,
            "batch [ns/step and sample]": best / outcome.responses["response"].sum() * 1e9,
        }
        found[type(integrator).__name__] = row
    return found


def _steps_taken(run):
    return (run.accepted_steps + run.rejected_steps).astype(float)


def _timed(call):
    begun = time.perf_counter()
    result = call()
    first, best = time.perf_counter() - begun, float("inf")
    for _ in range(REPEATS):
        begun = time.perf_counter()
        result = call()
        best = min(best, time.perf_counter() - begun)
    return result, first, best


def in_a_process(settings: dict[str, str]) -> dict[str, dict[str, float]]:
    command = [sys.executable, "-m", "benchmarks.claims.loops", "--measure"]
    done = subprocess.run(
        command, env=os.environ | settings, capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


def main() -> None:
    if "--measure" in sys.argv:
        print(json.dumps(measured()))
        return
    options = arguments(__doc__)
    best: dict[tuple[str, str], dict[str, float]] = {}
    for _ in range(1 if options.quick else 2):
        for way, settings in WAYS.items():
            for name, figures in in_a_process(settings).items():
                old = best.get((name, way), figures)
                best[name, way] = {key: min(old[key], value) for key, value in figures.items()}
    rows = []
    for name in dict.fromkeys(key[0] for key in best):
        mark = best[name, "XLA as it comes"]
        for way in WAYS:
            figures = best[name, way]
            ratios = {
                f"{k.split()[0]}: faster than XLA as it comes": mark[k] / figures[k]
                for k in figures
                if "ns" in k
            }
            rows.append({"integrator": name, "loop": way} | figures | ratios)
    report(
        "loops: steps of the four-bar, spatial clearance with friction, wear and collars",
        rows,
        options,
    )


if __name__ == "__main__":
    main()
