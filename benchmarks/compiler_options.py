"""What the compiler option that jaxclear sets is worth: the same run with and without it, each in a process of its own.

The option is read when JAX starts, so it cannot be changed within a process; the processes take turns, and the smallest of
several times counts.
"""

import os
import subprocess
import sys
from pathlib import Path

# Run as a file, Python looks into benchmarks/ first, where trace.py hides the standard module of that name.
sys.path[0] = str(Path(__file__).parents[1])

import json
import time

from benchmarks.measure import arguments, report

DURATION = 0.2
REPEATS = 3


def measured() -> dict[str, dict[str, float]]:
    """Seconds of the first call (compiling) and ns a step of later ones, by integrator, in this process."""
    import jaxclear as jc

    rig = jc.scenes.four_bar()
    found = {}
    for integrator in (jc.integrator.FixedStep(), jc.integrator.Adaptive()):
        begun = time.perf_counter()
        run = jc.simulate(rig, DURATION, save=41, integrator=integrator)
        first = time.perf_counter() - begun
        best = float("inf")
        for _ in range(REPEATS):
            begun = time.perf_counter()
            run = jc.simulate(rig, DURATION, save=41, integrator=integrator)
            best = min(best, time.perf_counter() - begun)
        steps = int(run.accepted_steps) + int(run.rejected_steps)
        found[type(integrator).__name__] = {"first call [s]": first, "wall [ns/step]": best / steps * 1e9}
    return found


def in_a_process(plain: bool) -> dict[str, dict[str, float]]:
    environment = os.environ | {"JAXCLEAR_PLAIN_XLA": "1" if plain else "0"}
    command = [sys.executable, __file__, "--measure"]
    return json.loads(subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout)


def main() -> None:
    if "--measure" in sys.argv:
        print(json.dumps(measured()))
        return
    options = arguments(__doc__)
    best: dict[tuple[str, bool], dict[str, float]] = {}
    for _ in range(1 if options.quick else 3):
        for plain in (True, False):
            for name, figures in in_a_process(plain).items():
                old = best.get((name, plain), figures)
                best[name, plain] = {key: min(old[key], value) for key, value in figures.items()}
    rows = [
        {"integrator": name, "option": "off" if plain else "on"}
        | figures
        | {"faster than off": best[name, True]["wall [ns/step]"] / figures["wall [ns/step]"]}
        for (name, plain), figures in sorted(best.items(), key=lambda item: (item[0][0], not item[0][1]))
    ]
    report("compiler option: steps of the four-bar, spatial clearance with friction, wear and collars", rows, options)


if __name__ == "__main__":
    main()
