"""An accelerator beside the processor of its machine: the same batches of runs on both, each in a
process of its own, wall time (the one that both have). `--json benchmarks/results/accelerator.json`
keeps it.

Values of the two are compared too: no kernel of machine code takes part on an accelerator, so this
holds kernels to XLA's loops on another device, and their derivatives to those of XLA's loops.
`--platform cuda` names the accelerator as `JAX_PLATFORMS` does; `--most` bounds the samples of a
batch, and `--limit` the seconds of a case on one device: larger batches are then left out.
"""

import functools
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.claims.slopes import bouncing
from benchmarks.measure import arguments, report, sign
from jaxclear.studies.ledger import batch

SIZES = (1, 64, 4096, 16384)
# Seconds after which no larger batch is asked for.
PATIENCE = 12.0
# Scenes and the length of their runs [s]: before neighbouring paths part, so that values can be
# compared. Slopes are known to the end where a journal bounces without rubbing.
SCENES = {
    "slider-crank": (jc.scenes.slider_crank, 0.01),
    "slider-crank that wears": (functools.partial(jc.scenes.slider_crank, wear=True), 0.01),
    "four-bar that wears": (jc.scenes.four_bar, 0.01),
    "bouncing journal": (bouncing, 0.05),
}
RUNGS = {
    "FixedStep(2e-5)": jc.integrator.FixedStep(2e-5),
    "MoreauJean(2e-5)": jc.integrator.MoreauJean(2e-5),
    "ImplicitStep(1e-4)": jc.integrator.ImplicitStep(1e-4),
    "Adaptive()": jc.integrator.Adaptive(),
}
VALUES, SLOPES = "values", "values and their slopes"
# What wears and what has slopes first: a lease of an accelerator ends.
CASES = [
    ("four-bar that wears", "FixedStep(2e-5)", VALUES),
    ("slider-crank that wears", "FixedStep(2e-5)", VALUES),
    ("bouncing journal", "FixedStep(2e-5)", SLOPES),
    ("slider-crank", "FixedStep(2e-5)", VALUES),
    ("slider-crank", "ImplicitStep(1e-4)", VALUES),
    ("slider-crank", "MoreauJean(2e-5)", VALUES),
    ("slider-crank", "Adaptive()", VALUES),
]
Case = tuple[str, str, str]


def question(scene: str, rung: str) -> jc.Problem:
    clearance = jc.Variable(lambda m: m.connections["B"].joint.clearance, tolerance=20e-6)
    force = jc.response.MeanContactForce("B")
    build, duration = SCENES[scene]
    how = {"integrator": RUNGS[rung], "duration": duration, "save": 21}
    return jc.Problem(build(), force, {"c": clearance}, **how)


@eqx.filter_jit
def responses(problem: jc.Problem, values: jax.Array) -> jax.Array:
    """Force of each sample [N], (samples, 1)."""
    force = lambda value: problem.evaluate(value).responses["response"]
    return jax.vmap(force)(values)[:, None]


@eqx.filter_jit
def with_slopes(problem: jc.Problem, values: jax.Array) -> jax.Array:
    """Force of each sample [N] and its slope [N/m], (samples, 2)."""
    force = lambda value: problem.evaluate(value).responses["response"]
    push = lambda value: jnp.stack(jax.jvp(force, (value,), (jnp.ones_like(value),)))
    return jax.vmap(push)(values)


def measured(case: Case, most: int, kept: Path) -> None:
    """Rows of this process's device, and what 64 of the samples gave by size of batch, in a file
    after each size."""
    scene, rung, asked = case
    problem = question(scene, rung)
    function = with_slopes if asked == SLOPES else responses
    rows, values = [], {}
    for size in (size for size in SIZES if size <= most):
        spread = np.random.default_rng(size).uniform(-2e-5, 2e-5, size=(size, 1))
        samples = jnp.asarray(np.asarray(problem.nominal()) + spread)
        spent = []
        for _ in range(2):
            begun = time.perf_counter()
            found = batch.evaluate_all(problem, samples, function=function)
            spent.append(time.perf_counter() - begun)
        values[str(size)] = found[:64].tolist()
        chunk = batch.chunk_size(problem, size)
        rows.append({"samples": size, "chunk": chunk, "first [s]": spent[0], "again [s]": spent[1]})
        print(rows[-1], flush=True)
        kept.write_text(json.dumps([rows, values]))
        if spent[1] > PATIENCE:
            break


def elsewhere(platform: str, case: Case, most: int, limit: float) -> tuple[list[dict], dict]:
    """What `measured` finds in a process of its own whose device is this."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "found.json"
        asked = [sys.executable, "-m", "benchmarks.claims.accelerator", "--child", json.dumps(case)]
        known = os.environ | {"JAX_PLATFORMS": platform}
        command = [*asked, "--json", str(path), "--most", str(most)]
        try:
            subprocess.run(command, env=known, check=True, timeout=limit)
        except subprocess.TimeoutExpired:
            print("larger batches are left out:", *case, platform, flush=True)
        except subprocess.CalledProcessError:
            print("the process has failed:", *case, platform, flush=True)
        return tuple(json.loads(path.read_text())) if path.exists() else ([], {})


def apart(own: np.ndarray, other: np.ndarray) -> float:
    """Largest difference, over the largest of what is compared."""
    return float(np.max(np.abs(own - other)) / np.max(np.abs(own)))


def compared(case: Case, platform: str, most: int, limit: float) -> list[dict]:
    ours, expected = elsewhere("cpu", case, most, limit)
    theirs, values = elsewhere(platform, case, most, limit)
    rows = []
    for own, other in zip(ours, theirs, strict=False):
        size = str(own["samples"])
        a, b = np.asarray(expected[size]), np.asarray(values[size])
        row = dict(zip(("scene", "integrator", "asked"), case, strict=True))
        row["samples"] = own["samples"]
        row["processor, again [s]"] = own["again [s]"]
        row["accelerator, again [s]"] = other["again [s]"]
        row["accelerator, first [s]"] = other["first [s]"]
        row["processor over accelerator"] = own["again [s]"] / other["again [s]"]
        row["largest difference of values, relative"] = apart(a[:, 0], b[:, 0])
        slopes = case[2] == SLOPES
        row["of slopes"] = apart(a[:, 1], b[:, 1]) if slopes else None
        rows.append(row)
    return rows


def main() -> None:
    options = arguments(
        __doc__,
        platform={"default": "cuda"},
        most={"type": int, "default": SIZES[-1]},
        limit={"type": float, "default": 300.0},
        child={"default": None, "help": "for this program itself"},
        only={"default": "", "help": "cases whose name has this"},
    )
    if options.child is not None:
        measured(tuple(json.loads(options.child)), options.most, options.json)
        return
    cases = [case for case in CASES if options.only in " ".join(case)]
    rows = []
    for case in cases[:1] if options.quick else cases:
        rows += compared(case, options.platform, options.most, options.limit)
        if rows:
            report("Batches on an accelerator and on the processor of its machine", rows, options)
    sign("benchmarks.claims.accelerator", options.json)


if __name__ == "__main__":
    main()
