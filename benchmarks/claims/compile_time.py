"""What a user waits for before the first result: `simulate` of the four-bar in a new process, by
rung, without and with the persistent cache of compiled programs."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.measure import arguments, report

PROGRAM = """
import time
start = time.perf_counter()
import jaxclear as jc
import jax
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
rig = jc.scenes.four_bar()
imported = time.perf_counter()
jc.assemble(rig)
assembled = time.perf_counter()
jc.simulate(rig, 1e-3, integrator=jc.integrator.{integrator}, save=11)
first = time.perf_counter()
jc.simulate(rig, 2e-3, integrator=jc.integrator.{integrator}, save=11)
second = time.perf_counter()
print(imported - start, assembled - imported, first - assembled, second - first)
"""
RUNGS = (
    "FixedStep()",
    "FixedStep(1e-5, 'semi_implicit')",
    "FixedStep(contact_steps=4.0)",
    "ImplicitStep()",
    "Adaptive()",
)
LIMIT = 5.0


def measured(integrator: str, cache: str | None) -> list[float]:
    """Seconds to import and build, to assemble, of the first run, and of the second one, in a new
    process.
    """
    environment = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    environment |= {"JAX_COMPILATION_CACHE_DIR": cache} if cache else {}
    environment["PYTHONPATH"] = str(Path(__file__).parents[2])
    program = PROGRAM.format(integrator=integrator)
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    return [float(word) for word in done.stdout.split()]


def main() -> None:
    options = arguments(__doc__)
    rows = []
    for rung in RUNGS[:: 2 if options.quick else 1]:
        with tempfile.TemporaryDirectory() as folder:
            plain = measured(rung, None)
            measured(rung, folder)
            cached = measured(rung, folder)
        row = {"rung": rung, "import [s]": plain[0], "assembly: compile and run [s]": plain[1]}
        row |= {
            "first run [s]": plain[2],
            "second run [s]": plain[3],
            "compile [s]": plain[2] - plain[3],
        }
        row |= {
            "with the cache: compile [s]": cached[2] - cached[3],
            "assembly with the cache [s]": cached[1],
        }
        row[f"at most {LIMIT:g} s"] = "yes" if plain[2] - plain[3] <= LIMIT else "no"
        rows.append(row)
    report(
        "compile: the four-bar in a new process, without and with the persistent cache",
        rows,
        options,
    )


if __name__ == "__main__":
    main()
