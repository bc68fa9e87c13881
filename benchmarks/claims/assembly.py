"""What assembly costs, and whether what is guessed is met: CPU seconds of the first assembly of
every scene in a new process, of linkages whose first search misses the guess, so that 64 are tried,
and exact guesses of linkages all of whose modes are known.
"""

import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.measure import arguments, report
from tests.multibody.test_assemblies import exact_guesses
from tests.rigs.assembly_modes import PLANAR

SCENES = ("slider_crank()", "four_bar()", "antenna()", "guide()", "flap()", "parallel_3rsr()")
# CPU seconds of the same before, on the same machine within the hour (commit ce8a193).
BEFORE = (0.316, 0.531, 1.014, 0.290, 0.623, 2.383)
OF_SCENE = """
import time
import jaxclear as jc
rig = jc.scenes.{name}
begun = time.process_time()
jc.assemble(rig)
print(time.process_time() - begun)
"""
OF_SEARCH = """
import time
import warnings
import numpy as np
import jaxclear as jc
from tests.rigs.assembly_modes import PLANAR, wrapped
warnings.simplefilter("ignore")
linkage = PLANAR["{name}"](np.random.default_rng(3))
here, there = (linkage.angles(mode) for mode in linkage.modes[:2])
rig = linkage.rig({{n: x + 0.4 * wrapped(there[n] - x) for n, x in here.items()}})
begun = time.process_time()
jc.assemble(rig)
print(time.process_time() - begun)
"""
MOST = 3.0
KINDS = ("joints", "bodies", "some joints", "some bodies")


def spent(program: str, name: str, times: int) -> float:
    """CPU seconds that a program prints in a new process, the least of several."""
    command, folder = [sys.executable, "-c", program.format(name=name)], Path(__file__).parents[2]
    done = [
        subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
        for _ in range(times)
    ]
    return min(float(one.stdout.split()[-1]) for one in done)


def met(name: str, count: int) -> dict[str, Any]:
    """Exact guesses of a linkage."""
    wrong, told, count = exact_guesses(name, KINDS, count)
    return {"linkage": name, "exact guesses": count, "missed silently": wrong, "doubtful": told}


def main() -> None:
    options = arguments(__doc__)
    times = 1 if options.quick else 3
    rows: list[dict[str, Any]] = []
    for scene, before in zip(SCENES, BEFORE, strict=True):
        now = spent(OF_SCENE, scene, times)
        rows.append({"scene": scene, "before [s]": before, "now [s]": now, "times": now / before})
    whole = [sum(row[what] for row in rows) for what in ("before [s]", "now [s]")]
    rows.append(
        {"scene": "all", "before [s]": whole[0], "now [s]": whole[1], "times": whole[1] / whole[0]}
    )
    report("First assembly of a scene in a new process, CPU time", rows, options)
    searched = [
        {"linkage": name, "CPU [s]": spent(OF_SEARCH, name, times), "asked for [s]": MOST}
        for name in PLANAR
    ]
    report("First assembly where 64 searches are tried, CPU time", searched, options)
    count = 4 if options.quick else 60
    report("Exact guesses", [met(name, count) for name in PLANAR], options)


if __name__ == "__main__":
    main()
