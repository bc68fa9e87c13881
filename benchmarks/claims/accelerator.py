"""An accelerator beside the processor of its machine: the same batches of runs on both, each in a
process of its own, wall time (the one that both have). `--json benchmarks/results/accelerator.json`
keeps it.

Values of the two are compared too: no kernel of machine code takes part on an accelerator, so this
holds kernels to XLA's loops on another device. `--platform cuda` names the accelerator as
`JAX_PLATFORMS` does; `--most` bounds the samples of a batch.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, report, sign
from jaxclear.studies import batch

SIZES = (1, 64, 1024, 16384)
# Seconds after which no larger batch is asked for.
PATIENCE = 12.0
# Length of the runs [s]: before neighbouring paths part, so that values can be compared.
DURATION = 0.01
CASES = {
    ("slider-crank", "FixedStep(2e-5)"): (jc.scenes.slider_crank, jc.integrator.FixedStep(2e-5)),
    ("slider-crank", "MoreauJean(2e-5)"): (jc.scenes.slider_crank, jc.integrator.MoreauJean(2e-5)),
    ("slider-crank", "ImplicitStep(1e-4)"): (
        jc.scenes.slider_crank,
        jc.integrator.ImplicitStep(1e-4),
    ),
    ("four-bar", "FixedStep(2e-5)"): (jc.scenes.four_bar, jc.integrator.FixedStep(2e-5)),
    ("slider-crank", "Adaptive()"): (jc.scenes.slider_crank, jc.integrator.Adaptive()),
}


def question(case: tuple[str, str]) -> jc.Problem:
    scene, integrator = CASES[case]
    rig = scene()
    clearance = jc.Variable(lambda m: m.connections["B"].joint.clearance, tolerance=20e-6)
    force = jc.response.MeanContactForce("B")
    how = {"integrator": integrator, "save": 21}
    return jc.Problem(rig, force, {"c": clearance}, duration=DURATION, **how)


def measured(case: tuple[str, str], most: int) -> tuple[list[dict], dict[str, list[float]]]:
    """Rows of this process's device, and values of the samples by size of batch."""
    problem = question(case)
    rows, values = [], {}
    for size in SIZES:
        if size > most:
            break
        spread = np.random.default_rng(size).uniform(-2e-5, 2e-5, size=(size, 1))
        asked = jax.numpy.asarray(np.asarray(problem.nominal()) + spread)
        chunk = batch.chunk_size(problem, size)
        spent = []
        for _ in range(2):
            begun = time.perf_counter()
            found = batch.evaluate_all(problem, asked)
            spent.append(time.perf_counter() - begun)
        told = np.asarray(jax.tree.leaves(found.responses)[0]).ravel()
        values[str(size)] = told[:64].tolist()
        rows.append(
            {
                "scene": case[0],
                "integrator": case[1],
                "samples": size,
                "samples a chunk": chunk,
                "first [s]": spent[0],
                "again [s]": spent[1],
            }
        )
        print(rows[-1], flush=True)
        if spent[1] > PATIENCE:
            break
    return rows, values


def elsewhere(platform: str, case: tuple[str, str], most: int) -> tuple[list[dict], dict]:
    """`measured` in a process of its own whose device is this."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "found.json"
        asked = [sys.executable, "-m", "benchmarks.claims.accelerator", "--child", json.dumps(case)]
        known = os.environ | {"JAX_PLATFORMS": platform}
        subprocess.run([*asked, "--json", str(path), "--most", str(most)], env=known, check=True)
        rows, values = json.loads(path.read_text())
        return rows, values


def compared(case: tuple[str, str], platform: str, most: int) -> list[dict]:
    ours, expected = elsewhere("cpu", case, most)
    theirs, values = elsewhere(platform, case, most)
    rows = []
    for own, other in zip(ours, theirs, strict=False):
        size = str(own["samples"])
        a, b = np.asarray(expected[size]), np.asarray(values[size])
        row = {name: own[name] for name in ("scene", "integrator", "samples")}
        row["processor, again [s]"] = own["again [s]"]
        row["accelerator, again [s]"] = other["again [s]"]
        row["accelerator, first [s]"] = other["first [s]"]
        row["processor over accelerator"] = own["again [s]"] / other["again [s]"]
        row["largest difference of values, relative"] = float(np.max(np.abs(a - b) / np.abs(a)))
        rows.append(row)
    return rows


def main() -> None:
    options = arguments(
        __doc__,
        platform={"default": "cuda"},
        most={"type": int, "default": SIZES[-1]},
        child={"default": None, "help": "for this program itself"},
        only={"default": "", "help": "cases whose name has this"},
    )
    if options.child is not None:
        found = measured(tuple(json.loads(options.child)), options.most)
        options.json.write_text(json.dumps(found))
        return
    cases = [case for case in CASES if options.only in " ".join(case)]
    rows = []
    for case in cases[:1] if options.quick else cases:
        rows += compared(case, options.platform, options.most)
        report("Batches on an accelerator and on the processor of its machine", rows, options)
    sign("benchmarks.claims.accelerator", options.json)


if __name__ == "__main__":
    main()
