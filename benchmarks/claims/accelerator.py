"""An accelerator beside the processor of its machine: the same batches of runs on the processor,
on the accelerator by XLA's loops, and there by kernels (JAXCLEAR_GPU_KERNELS=1), each in a process
of its own; wall time, the one that all have. `--json benchmarks/results/accelerator.json` keeps it.

Of the kernels it says first what the driver makes of them (registers of a thread, and bytes that it
keeps beside them), or why there are none. Values and slopes are compared with the processor's. Each
figure is printed when it is known. Without an accelerator it says so, and measures nothing.

`--platform cuda` names the accelerator as `JAX_PLATFORMS` does; `--most` bounds the samples of a
batch, `--limit` the seconds of a case one way, and `--minutes` those of all: what comes later is
left out. `--quick` takes six minutes at most. `--assembled` needs no device: what NVIDIA's
assembler ptxas, of the package nvidia-cuda-nvcc-cu12, makes of the kernels.
"""

import functools
import importlib.util
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.claims.slopes import bouncing
from benchmarks.measure import arguments, loop_reasons, report, sign
from jaxclear.native import gpu, gpu_ptx, gpu_threads
from jaxclear.native import kernel as kernels
from jaxclear.studies.store import batch

SIZES = (4096, 16384, 65536, 262_144, 1_000_000)
QUICK_SIZES = (4096, 32768, 131_072)
# What a device is given at once by kernels, whose threads fill it: some times what it holds.
TOGETHER = 131_072
# Seconds after which no larger batch is asked for, in all cases and in quick ones.
PATIENCE, QUICK_PATIENCE = 12.0, 4.0
# Minutes of all cases.
LONGEST, QUICK_LONGEST = 60.0, 6.0
# Seconds that a case needs to begin.
LEAST = 20.0
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
# What decides most first: a lease of an accelerator ends.
CASES = [
    ("slider-crank", "FixedStep(2e-5)", VALUES),
    ("bouncing journal", "FixedStep(2e-5)", SLOPES),
    ("slider-crank", "Adaptive()", VALUES),
    ("four-bar that wears", "FixedStep(2e-5)", VALUES),
    ("slider-crank that wears", "FixedStep(2e-5)", VALUES),
    ("bouncing journal", "FixedStep(2e-5)", VALUES),
    ("slider-crank", "ImplicitStep(1e-4)", VALUES),
    ("slider-crank", "MoreauJean(2e-5)", VALUES),
    ("bouncing journal", "Adaptive()", SLOPES),
]
QUICK = 5
# Further ones that are assembled.
SPATIAL = [
    ("four-bar that wears", "ImplicitStep(1e-4)", VALUES),
    ("four-bar that wears", "Adaptive()", VALUES),
]
# By which runs are gone through, in this order; the variable that decides on an accelerator.
PROCESSOR, KERNELS, XLA = "processor", "kernels", "accelerator"
SWITCH = {PROCESSOR: "0", KERNELS: "1", XLA: "0"}
MADE = "Kernels on an accelerator"
ASSEMBLED = "Kernels assembled for a GPU"
BATCHES = "Batches on an accelerator and on the processor of its machine"
SAVES = 21
Case = tuple[str, str, str]


@dataclass
class Found:
    """What a process of its own has found: seconds by size of batch, what 64 of its samples gave,
    steps of the nominal run, registers and bytes beside them of its largest kernel, and why loops
    were left to XLA."""

    seconds: dict[str, list[float]] = field(default_factory=dict)
    values: dict[str, list[list[float]]] = field(default_factory=dict)
    steps: int | None = None
    registers: int | None = None
    local_bytes: int | None = None
    kernels: int = 0
    left_to_xla: list[str] = field(default_factory=list)


def question(scene: str, rung: str) -> jc.Problem:
    clearance = jc.Variable(lambda m: m.connections["B"].joint.clearance, tolerance=20e-6)
    force = jc.response.MeanContactForce("B")
    build, duration = SCENES[scene]
    how = {"integrator": RUNGS[rung], "duration": duration, "save": SAVES}
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


def measured(case: Case, way: str, sizes: list[int], patience: float, kept: Path) -> None:
    """What this process finds, in a file after each size."""
    scene, rung, asked = case
    problem, found = question(scene, rung), Found()
    function = with_slopes if asked == SLOPES else responses
    if way == PROCESSOR:
        build, duration = SCENES[scene]
        how = {"integrator": RUNGS[rung], "save": SAVES, "verify": False}
        run = jc.simulate(build(), duration, **how)
        found.steps = int(run.stats.accepted_steps)
    for size in sizes:
        spread = np.random.default_rng(size).uniform(-2e-5, 2e-5, size=(size, 1))
        samples = jnp.asarray(np.asarray(problem.nominal()) + spread)
        chunk = min(size, TOGETHER) if way == KERNELS else None
        spent = []
        for _ in range(2):
            begun = time.perf_counter()
            with loop_reasons() as reasons:
                given = batch.evaluate_all(problem, samples, chunk=chunk, function=function)
            found.left_to_xla = sorted({*found.left_to_xla, *reasons})
            spent.append(time.perf_counter() - begun)
        found.seconds[str(size)], found.values[str(size)] = spent, given[:64].tolist()
        if way == KERNELS:
            _look_at_kernels(found)
        shown = f"{spent[1]:.3g} s (first {spent[0]:.3g} s)"
        print(f"{way}: {', '.join(case)}; {size} samples: {shown}", flush=True)
        kept.write_text(json.dumps(asdict(found)))
        if spent[1] > patience:
            break


def _look_at_kernels(found: Found) -> None:
    """What the driver made of the kernels."""
    known = gpu.list_kernels()
    loaded = [each for kernel in known for each in kernel.loaded]
    found.kernels = len(known)
    if loaded:
        largest = max(loaded, key=lambda each: (each.local_bytes, each.registers))
        found.registers, found.local_bytes = largest.registers, largest.local_bytes


def elsewhere(platform: str, case: Case, way: str, limit: float, options: Any) -> Found:
    """What `measured` finds in a process of its own whose device is this."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "found.json"
        name = "benchmarks.claims.accelerator"
        asked = [sys.executable, "-m", name, "--child", json.dumps(case), "--way", way]
        known = os.environ | {"JAX_PLATFORMS": platform, "JAXCLEAR_GPU_KERNELS": SWITCH[way]}
        command = [*asked, "--json", str(path), "--most", str(options.most)]
        command += ["--quick"] if options.quick else []
        try:
            subprocess.run(command, env=known, check=True, timeout=limit)
        except subprocess.TimeoutExpired:
            print(f"{way}: larger batches are left out after {limit:.0f} s", flush=True)
        except subprocess.CalledProcessError:
            print(f"{way}: the process has failed", flush=True)
        return Found(**json.loads(path.read_text())) if path.exists() else Found()


def apart(own: Any, other: Any, column: int) -> float | None:
    """Largest difference in a column, over the largest of what is compared."""
    if own is None or other is None or np.shape(own)[1] <= column:
        return None
    a, b = np.asarray(own)[:, column], np.asarray(other)[:, column]
    return float(np.max(np.abs(a - b)) / np.max(np.abs(a)))


def rows_of(case: Case, ways: dict[str, Found]) -> list[dict[str, Any]]:
    """A row for each size of a batch."""
    ours, rows = ways[PROCESSOR], []
    sizes = {int(size) for found in ways.values() for size in found.seconds}
    for size in map(str, sorted(sizes)):
        first, again = (
            {w: f.seconds.get(size, [None] * 2)[k] for w, f in ways.items()} for k in (0, 1)
        )
        values = {w: found.values.get(size) for w, found in ways.items()}
        steps = (ours.steps or 0) * int(size)
        row: dict[str, Any] = dict(zip(("scene", "integrator", "asked"), case, strict=True))
        row["samples"] = int(size)
        row["processor, again [s]"] = again[PROCESSOR]
        for way in (XLA, KERNELS):
            row[f"{way}, again [s]"], row[f"{way}, first [s]"] = again.get(way), first.get(way)
        for way in (XLA, KERNELS):
            spent = again[PROCESSOR], again.get(way)
            row[f"processor over {way}"] = None if None in spent else spent[0] / spent[1]
        spent = again.get(KERNELS)
        row["steps of kernels [1/s]"] = steps / spent if spent and steps else None
        for word, way in (("", XLA), (" by kernels", KERNELS)):
            pair = values[PROCESSOR], values.get(way)
            row[f"largest difference of values{word}, relative"] = apart(*pair, 0)
            row[f"of slopes{word}"] = apart(*pair, 1)
        rows.append(row)
    return rows


def made(case: Case, found: Found) -> dict[str, Any]:
    """A row about the kernels of a case."""
    row: dict[str, Any] = dict(zip(("scene", "integrator", "asked"), case, strict=True))
    row |= {"kernels": found.kernels, "registers": found.registers}
    row |= {"bytes beside them": found.local_bytes}
    row["left to XLA"] = " ".join(found.left_to_xla) or "nothing"
    return row


def main() -> None:
    options = arguments(
        __doc__,
        platform={"default": "cuda"},
        most={"type": int, "default": SIZES[-1]},
        limit={"type": float, "default": 300.0},
        minutes={"type": float, "default": None},
        child={"default": None, "help": "for this program itself"},
        way={"default": KERNELS, "help": "for this program itself"},
        assembled={"action": "store_true", "help": "needs no device"},
        only={"default": "", "help": "cases whose name has this"},
    )
    sizes = [n for n in (QUICK_SIZES if options.quick else SIZES) if n <= options.most]
    if options.child is not None:
        patience = QUICK_PATIENCE if options.quick else PATIENCE
        case = tuple(json.loads(options.child))
        measured(case, options.way, sizes, patience, options.json)
        return
    if options.assembled:
        all_assembled(options)
        return
    if not is_there(options.platform):
        print(f"JAX sees no device of {options.platform!r} here: nothing is measured.")
        return
    minutes = options.minutes or (QUICK_LONGEST if options.quick else LONGEST)
    ends = time.monotonic() + 60 * minutes
    cases = [case for case in CASES if options.only in " ".join(case)]
    rows, kernels = [], []
    for case in cases[:QUICK] if options.quick else cases:
        ways: dict[str, Found] = {}
        # XLA's loops are known: in a hurry they wait.
        for way in (KERNELS, PROCESSOR) if options.quick else (KERNELS, PROCESSOR, XLA):
            left = ends - time.monotonic()
            if left < LEAST:
                print("The time is over.", flush=True)
                break
            platform = "cpu" if way == PROCESSOR else options.platform
            ways[way] = elsewhere(platform, case, way, min(options.limit, left), options)
            if way == KERNELS:
                kernels.append(made(case, ways[way]))
                report(MADE, kernels, options)
        if PROCESSOR in ways:
            rows += rows_of(case, ways)
        if rows:
            report(BATCHES, rows, options)
    sign("benchmarks.claims.accelerator", options.json)


class Assembled(NamedTuple):
    """What NVIDIA's assembler makes of a kernel: lines of its text, registers of a thread, bytes
    that it stores beside them and reads again, and CPU seconds of LLVM and of the assembler."""

    lines: int
    registers: int
    stored: int
    read: int
    by_llvm: float
    by_assembler: float


def ptxas() -> str | None:
    """NVIDIA's assembler, where its package is installed."""
    spec = importlib.util.find_spec("nvidia")
    for folder in (spec.submodule_search_locations or []) if spec else []:
        for found in Path(folder).glob("*/bin/ptxas"):
            return str(found)
    return None


def assembled(program: Any) -> Assembled:
    """The kernel of a loop, assembled for an H100 or H200."""
    begun = time.process_time()
    text = gpu_threads.text_of(program).replace("@NAME", "@jaxclear")
    ptx = gpu_ptx.ptx_of(text, "sm_80")
    by_llvm = time.process_time() - begun
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "kernel.ptx"
        path.write_text(ptx)
        asked = [
            str(ptxas()),
            "-v",
            "-arch=sm_90",
            str(path),
            "-o",
            str(path.with_suffix(".cubin")),
        ]
        begun = sum(os.times()[2:4])
        said = subprocess.run(asked, capture_output=True, text=True, check=True)
        by_assembler = sum(os.times()[2:4]) - begun
    count = lambda form: max(map(int, re.findall(form, said.stdout + said.stderr)))
    found = count(r"Used (\d+) reg"), count(r"(\d+) bytes spill s"), count(r"(\d+) bytes spill l")
    return Assembled(text.count("\n"), *found, by_llvm, by_assembler)


def largest_kernel(case: Case) -> Any:
    """The loop of the longest text of a case, of several samples."""
    programs, build = [], kernels.build
    kernels.build = lambda program, *rest: programs.append(program) or build(program, *rest)
    problem = question(*case[:2])
    function = with_slopes if case[2] == SLOPES else responses
    values = jnp.tile(jnp.asarray(problem.nominal()), (2, 1))
    function.lower(problem, values)
    kernels.build = build
    return max(programs, key=lambda program: gpu_threads.text_of(program).count("\n"))


def all_assembled(options: Any) -> None:
    """Every case's largest kernel."""
    rows = []
    cases = [case for case in [*CASES, *SPATIAL] if options.only in " ".join(case)]
    for case in cases[:1] if options.quick else cases:
        found = assembled(largest_kernel(case))
        row: dict[str, Any] = dict(zip(("scene", "integrator", "asked"), case, strict=True))
        row |= {"lines": found.lines, "registers": found.registers}
        row |= {"stored beside [bytes]": found.stored, "read again [bytes]": found.read}
        row |= {"LLVM [s]": found.by_llvm, "ptxas [s]": found.by_assembler}
        rows.append(row)
        report(ASSEMBLED, rows, options)
    sign("benchmarks.claims.accelerator", options.json, (ASSEMBLED,))


def is_there(platform: str) -> bool:
    """Whether JAX finds such a device, asked in a process of its own: it takes most of a device's
    memory."""
    look = "import jax; jax.devices()"
    known = os.environ | {"JAX_PLATFORMS": platform}
    return not subprocess.run(
        [sys.executable, "-c", look], env=known, capture_output=True, check=False
    ).returncode


if __name__ == "__main__":
    main()
