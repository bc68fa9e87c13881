"""What a user waits for before the first result: the first run of every scene in a new process, on
the integrator that `simulate` takes by default, or on MoreauJean where the scene's friction is
set-valued; of the four-bar on every rung; on MoreauJean with wear; of mechanisms of several
spatial loops, with the reactions and the memory; and of studies. With nothing kept by an
earlier process, and with what one has kept.

    python -m benchmarks.claims.compile_time [--quick] [--only TEXT] [--models FILE ...]
        [--json FILE]

`--models` reads robots from files of MJCF, which are measured as mechanisms of several loops.

CPU seconds, with Python's compiled modules kept as an installation has them, and the import beside
that of JAX. A first run is all from the scene's function to the first trajectory, so what the run
itself takes is part of it: the same run once more tells how much that is.
"""

import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.measure import run_tables

PROGRAM = """
import time
spent = [time.process_time()]
import jaxclear as jc
spent.append(time.process_time())
rig = jc.scenes.{scene}
jc.assemble(rig)
spent.append(time.process_time())
for _ in range(2):
    jc.simulate(rig, {span}, integrator=jc.integrator.{integrator}, save=201)
    spent.append(time.process_time())
print(*(b - a for a, b in zip(spent, spent[1:])))
"""
STUDIES = """
import time
import jaxclear as jc
problem = jc.Problem(
    jc.scenes.slider_crank(),
    jc.response.MeanContactForce("B"),
    {"clearance": jc.Variable(lambda rig: rig.connections["B"].joint.clearance, tolerance=20e-6)},
    duration=0.05,
)
spent = [time.process_time()]
for _ in range(2):
    sample = jc.monte_carlo(problem, 1024)
    spent.append(time.process_time())
    jc.sensitivity(problem, "clearance", sample=sample)
    spent.append(time.process_time())
print(*(b - a for a, b in zip(spent, spent[1:])))
"""
# CPU seconds that are asked for of each study, in a first and a second process.
OF_STUDIES = {"monte_carlo of 1 024": (2.0, 0.5), "sensitivity": (3.0, 0.8)}
# A process prints CPU seconds, and last its largest resident memory [MB].
SPATIAL = """
import time
import warnings
from pathlib import Path
spent = [time.process_time()]
import jaxclear as jc
from tests.rigs.spatial_loops import double_cardan, hinge_loops
warnings.simplefilter("ignore")
spent.append(time.process_time())
rig = {rig}
jc.assemble(rig)
spent.append(time.process_time())
run = jc.simulate(rig, 1e-3, save=3)
spent.append(time.process_time())
assert run.succeeded, run.result
run.reaction(list(rig.connections)[-1])
spent.append(time.process_time())
memory = float(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024
print(*(b - a for a, b in zip(spent, spent[1:])), memory)
"""
# Joints of each: five hinges and a ball joint a loop; two Cardan joints a branch.
LOOPS = {
    "ten hinges, two loops": "hinge_loops(2, dict(g=jc.load.Gravity()))",
    "two Cardan branches": "double_cardan(2)",
    "three Cardan branches": "double_cardan(3)",
    "four Cardan branches": "double_cardan(4)",
}
# CPU seconds and MB that are asked for.
OF_LOOPS, MEMORY = 30.0, 3000.0
SET_VALUED = ("antenna()", "guide()")
# Scenes, with a duration [s] of which a run takes a second or less.
SCENES = {
    "slider_crank()": 0.1,
    "four_bar()": 0.1,
    "antenna()": 0.1,
    "guide()": 0.1,
    "flap()": 5e-3,
    "parallel_3rsr()": 0.1,
}
RUNGS = (
    "FixedStep()",
    "FixedStep(1e-5, 'semi_implicit')",
    "FixedStep(contact_steps=4.0)",
    "ImplicitStep()",
    "MoreauJean()",
)
WEARING = ("slider_crank(wear=True)", "four_bar()", "parallel_3rsr()")
# CPU seconds that are asked for.
LIMIT, OF_MOREAU_JEAN = 8.0, 16.0
IMPORT = "import time; begun = time.process_time(); import {}; print(time.process_time() - begun)"
# Imports of each, turn by turn.
TURNS = 9


def told(program: str, cache: str | None = None) -> list[float]:
    """The numbers that a program prints in a new process."""
    without = ("JAX_COMPILATION_CACHE_DIR", "PYTHONDONTWRITEBYTECODE")
    environment = {k: v for k, v in os.environ.items() if k not in without}
    environment["JAXCLEAR_CACHE"] = "0" if cache is None else cache
    environment["PYTHONPATH"] = str(Path(__file__).parents[2])
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    return [float(word) for word in done.stdout.split()]


def imports(_: Any) -> list[dict[str, Any]]:
    """What the import takes beside JAX's own [CPU s]."""
    spent = [[told(IMPORT.format(name))[0] for name in ("jax", "jaxclear")] for _ in range(TURNS)]
    of_jax, own = (statistics.median(each) for each in zip(*spent[1:], strict=True))
    row = {"import jax [s]": of_jax, "import jaxclear [s]": own}
    return [row | {"times": own / of_jax, "asked for": 3.0}]


def row_of(scene: str, span: float, integrator: str, limit: float) -> dict[str, Any]:
    """A scene on an integrator."""
    with tempfile.TemporaryDirectory() as folder:
        program = PROGRAM.format(scene=scene, span=span, integrator=integrator)
        plain, cached = (told(program, folder) for _ in range(2))
    first = plain[1] + plain[2]
    return {
        "scene": scene,
        "integrator": integrator,
        "import [s]": plain[0],
        "assembly [s]": plain[1],
        "first run [s]": first,
        "the same again [s]": plain[3],
        "in a second process [s]": cached[1] + cached[2],
        "asked for [s]": limit,
        "met": "yes" if first <= limit else "no",
    }


def study_rows(_: Any) -> list[dict[str, Any]]:
    """The first studies of a problem: a sample, and derivatives of its mean."""
    with tempfile.TemporaryDirectory() as folder:
        first, second = (told(STUDIES, folder) for _ in range(2))
    return [
        {
            "study": name,
            "first time [s]": first[place],
            "the same again [s]": first[2 + place],
            "in a second process [s]": second[place],
            "asked for [s]": f"{limits[0]}, {limits[1]}",
        }
        for place, (name, limits) in enumerate(OF_STUDIES.items())
    ]


def loop_rows(options: Any) -> list[dict[str, Any]]:
    """Mechanisms of several spatial loops, from nothing to the first steps and a reaction."""
    robots = {Path(path).stem: f"jc.read_mjcf({path!r})" for path in options.models}
    rigs = dict(list(LOOPS.items())[:: 3 if options.quick else 1]) | robots
    rows = []
    for name, rig in rigs.items():
        own_import, assembly, run, reaction, memory = told(SPATIAL.format(rig=rig))
        rows.append(
            {
                "mechanism": name,
                "import [s]": own_import,
                "assembly [s]": assembly,
                "first steps [s]": run,
                "first reaction [s]": reaction,
                "memory [MB]": memory,
                "asked for [s]": OF_LOOPS,
                "met": "yes" if assembly + run <= OF_LOOPS and memory <= MEMORY else "no",
            }
        )
    return rows


def scene_rows(options: Any) -> list[dict[str, Any]]:
    """Of every scene on its usual integrator."""
    return [
        row_of(scene, span, "MoreauJean()" if scene in SET_VALUED else "Adaptive()", LIMIT)
        for scene, span in list(SCENES.items())[:: 3 if options.quick else 1]
    ]


def rung_rows(options: Any) -> list[dict[str, Any]]:
    """Of the four-bar."""
    span, rungs = SCENES["four_bar()"], RUNGS[:: 3 if options.quick else 1]
    return [row_of("four_bar()", span, rung, LIMIT) for rung in rungs]


def wearing_rows(options: Any) -> list[dict[str, Any]]:
    """Of scenes that wear."""
    scenes = WEARING[:: 3 if options.quick else 1]
    return [row_of(s, SCENES.get(s, 0.1), "MoreauJean()", OF_MOREAU_JEAN) for s in scenes]


TABLES = {
    "First studies in a new process, CPU time": study_rows,
    "First steps of mechanisms of several spatial loops in a new process, CPU time": loop_rows,
    "Import in a new process, CPU time": imports,
    "First run of a scene in a new process, CPU time": scene_rows,
    "First run of the four-bar in a new process, CPU time, by integrator": rung_rows,
    "First run on MoreauJean with wear in a new process, CPU time": wearing_rows,
}

if __name__ == "__main__":
    robots = {"nargs": "*", "default": [], "help": "robots in files of MJCF"}
    run_tables(TABLES, models=robots)
