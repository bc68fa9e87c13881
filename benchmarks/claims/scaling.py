"""What running costs as scenes grow: with the number of clearance joints, of samples, and with
simulated time; and what the engine's own compiled loops are worth against XLA's.

Times are the smallest of several, of compiled programs; compiling is given apart, in CPU seconds.
Each chain is measured in a process of its own with a time limit, because long chains may not
compile in bearable time; everything else takes turns in one process.
"""

import json
import logging
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.claims.chain import chain
from benchmarks.measure import arguments, report, seconds_to_compile, side_by_side, sign
from jaxclear.simulation.simulate import run
from jaxclear.studies.store.batch import evaluate_all

PLAIN_LOOPS = "JAXCLEAR_PLAIN_LOOPS"
# Chain: step [s] of the fixed ones, simulated time [s], and how long a process may take [s].
CHAIN_STEP, CHAIN_TIME = 1e-5, 0.05
STEP = 2e-5
# Saving times of the runs over simulated time lie so far apart [s].
SAVING = 2.5e-3
# Samples of a batch in one program, in the comparison of loops.
BATCH = 64
# A batch that would take longer than this [s] is left out.
LONGEST = 120.0
# Running must take this share of what a run of no length takes, or the time of its steps is not
# told.
CLEAR = 0.2


def integrators(step: float, implicit: bool = False) -> dict[str, Any]:
    """One of each kind."""
    found = {"FixedStep rk4": jc.integrator.FixedStep(step), "Adaptive": jc.integrator.Adaptive()}
    return found | ({"ImplicitStep": jc.integrator.ImplicitStep(step)} if implicit else {})


# Of clearance and length [m].
TOLERANCES = (20e-6, 50e-6)
SCENES: dict[str, Callable[[], jc.Mechanism]] = {
    "four-bar": jc.scenes.four_bar,
    "slider-crank": jc.scenes.slider_crank,
}


class _Reasons(logging.Handler):
    """Keeps why loops were left to XLA."""

    def __init__(self):
        super().__init__(logging.INFO)
        self.found: list[str] = []

    def emit(self, record):
        self.found.append(record.getMessage())


@contextmanager
def reasons() -> Iterator[list[str]]:
    log, handler = logging.getLogger("jaxclear.native.loop"), _Reasons()
    level = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield handler.found
    finally:
        log.removeHandler(handler)
        log.setLevel(level)


@contextmanager
def loops(plain: bool) -> Iterator[None]:
    """Programs lowered within take XLA's loops (`plain`) or the engine's own."""
    before = os.environ.get(PLAIN_LOOPS)
    os.environ[PLAIN_LOOPS] = "1" if plain else "0"
    try:
        yield
    finally:
        os.environ.pop(PLAIN_LOOPS)
        if before is not None:
            os.environ[PLAIN_LOOPS] = before


def program(
    mechanism: jc.Mechanism, integrator: Any, times: Any, samples: int = 1
) -> tuple[Callable, dict[str, Any]]:
    """A compiled run (or so many alike side by side in one program), and what compiling it said."""
    start = jc.assemble(mechanism)
    numbers, rest = eqx.partition((mechanism, integrator), eqx.is_array)

    def one(numbers, q, v):
        mechanism, integrator = eqx.combine(numbers, rest)
        found = run(mechanism, q, v, times, integrator)
        return found.states, found.accepted_steps + found.rejected_steps, found.outcome

    def batch(numbers, q, v):
        return jax.vmap(one, in_axes=(None, 0, 0))(numbers, q, v)

    args = (numbers, start.coordinates, start.speeds)
    if samples > 1:
        # Turned a little apart, so that no two samples are the same.
        apart = 1 + 1e-6 * jnp.arange(samples)[:, None]
        args = (numbers, start.coordinates * apart, start.speeds * apart)
    with reasons() as why:
        compiled, seconds = seconds_to_compile(one if samples == 1 else batch, *args)
    own = 'custom_call_target="jaxclear_' in compiled.as_text()
    told = {
        "loop": "XLA" if not own else "own and XLA" if why else "own",
        "compile CPU [s]": seconds,
    }
    return lambda: compiled(*args), told | {"reason": why[0] if why else ""}


def _ended(outcomes: Any) -> str:
    worst = int(np.max(np.asarray(outcomes)))
    return "ok" if worst == jc.integrator.Outcome.REACHED else jc.integrator.Outcome(worst).sentence


def _sentence(error: BaseException) -> str:
    return f"{type(error).__name__}: {(str(error).splitlines() or [''])[0]}"


# Number of joints


def chain_figures(joints: int, name: str, repeats: int) -> dict[str, Any]:
    """One chain, measured in this process."""
    times = jnp.linspace(0.0, CHAIN_TIME, 3)
    go, told = program(chain(joints), integrators(CHAIN_STEP, implicit=True)[name], times)
    _, steps, outcome = go()
    _, cpu = side_by_side({"run": go}, repeats)["run"]
    share = 1e9 / int(steps)
    figures = {"steps": int(steps), "CPU [ns/step]": cpu * share}
    figures["CPU [ns/step/joint]"] = cpu * share / joints
    reason = told.pop("reason")
    return told | figures | {"result": f"{_ended(outcome)} {reason}".strip()}


def chain_rows(quick: bool) -> list[dict[str, Any]]:
    sizes, limit, repeats = ((1, 4), 40, 2) if quick else ((1, 4, 16, 64), 150, 5)
    keys = (
        "loop",
        "compile CPU [s]",
        "steps",
        "CPU [ns/step]",
        "CPU [ns/step/joint]",
    )
    rows: list[dict[str, Any]] = []
    for name in integrators(CHAIN_STEP, implicit=True):
        lost = None
        for joints in sizes:
            row = {"integrator": name, "joints": joints} | dict.fromkeys(keys, "-")
            if lost is None:
                row |= _in_a_process(joints, name, repeats, limit)
                lost = joints if row["result"].startswith(TOO_LONG) else None
            else:
                row["result"] = f"not tried: {lost} joints took too long"
            rows.append(row)
    return rows


TOO_LONG = "not compiled and run within"


def _in_a_process(joints: int, name: str, repeats: int, limit: int) -> dict[str, Any]:
    command = [
        sys.executable,
        "-m",
        "benchmarks.claims.scaling",
        "--chain",
        str(joints),
        name,
        str(repeats),
    ]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit)
    except subprocess.TimeoutExpired:
        return {"result": f"{TOO_LONG} {limit} s"}
    if done.returncode != 0:
        return {"result": f"the process ended with code {done.returncode}"}
    return json.loads(done.stdout.splitlines()[-1])


# Number of samples


def question(mechanism: jc.Mechanism, integrator: Any, duration: float) -> jc.Problem:
    """Clearance, and the length of the link that carries the bearing, vary; answers how many steps
    a sample took.
    """
    return jc.Problem(
        mechanism,
        {"steps": lambda run: run.accepted_steps + run.rejected_steps},
        {
            "clearance": jc.Variable(
                lambda rig: rig.connections["B"].joint.clearance, tolerance=TOLERANCES[0]
            ),
            "length": jc.Variable(
                lambda rig: rig.connections["B"].parent.at[0], tolerance=TOLERANCES[1]
            ),
        },
        duration=duration,
        integrator=integrator,
        save=11,
    )


def sample_rows(quick: bool) -> list[dict[str, Any]]:
    scenes = {"slider-crank": jc.scenes.slider_crank} if quick else SCENES
    sizes, duration = ((1, 256), 0.01) if quick else ((1, 4, 16, 64, 256, 1024, 4096, 16384), 0.02)
    rows = []
    for scene, build in scenes.items():
        for name, integrator in integrators(STEP).items():
            first, expected = None, 0.0
            for size in sizes:
                row = {"scene": scene, "integrator": name, "samples": size} | dict.fromkeys(
                    SAMPLE_KEYS, "-"
                )
                if expected * size > LONGEST:
                    row["result"] = f"left out: would take {expected * size:.0f} s"
                else:
                    row |= _samples(
                        question(build(), integrator, duration),
                        size,
                        1 if quick or size > 256 else 5,
                    )
                    expected = row["CPU [ms/sample]"] / 1e3
                    first = first or expected
                    row["faster than one"] = first / expected
                rows.append(row)
    return rows


SAMPLE_KEYS = (
    "CPU [ms/sample]",
    "at no length [ms/sample]",
    "faster than one",
    "steps/sample",
    "most / mean",
)
SAMPLE_KEYS += ("varied [ns/step]", "alike [ns/step]", "waiting", "result")


def _samples(asked: jc.Problem, size: int, repeats: int) -> dict[str, Any]:
    """One line: samples that differ, samples that are alike (where each chooses its steps), and
    runs of no length, which assemble, answer and start the program only. Waiting: a step of those
    that differ over a step of those alike."""
    rng = np.random.default_rng(0)
    nominal, tolerances = np.asarray(asked.nominal()), np.array(TOLERANCES)
    varied = nominal + tolerances * np.clip(rng.normal(size=(size, 2)) / 3, -1, 1)
    answers: dict[str, Any] = {}

    def go(key, problem, values):
        answers[key] = evaluate_all(problem, values)
        return answers[key].responses["steps"]

    at_once = eqx.tree_at(lambda p: p.duration, asked, jnp.zeros(()))
    cases = {
        "varied": lambda: go("varied", asked, varied),
        "starting": lambda: go("starting", at_once, varied),
    }
    if isinstance(asked.integrator, jc.integrator.Adaptive):
        cases["alike"] = lambda: go("alike", asked, np.tile(nominal, (size, 1)))
    spent_by = {key: cpu for key, (_, cpu) in side_by_side(cases, repeats).items()}
    moving = {key: spent_by[key] - spent_by["starting"] for key in answers if key != "starting"}
    # A difference that is a small part of what is subtracted says nothing.
    clear = {key: spent for key, spent in moving.items() if spent > CLEAR * spent_by["starting"]}
    each = {
        key: float(spent / np.sum(answers[key].responses["steps"]) * 1e9)
        for key, spent in clear.items()
    }
    steps, well = (
        answers["varied"].responses["steps"],
        answers["varied"].outcome == jc.integrator.Outcome.REACHED,
    )
    row = {
        "CPU [ms/sample]": 1e3 * spent_by["varied"] / size,
        "at no length [ms/sample]": 1e3 * spent_by["starting"] / size,
    }
    row |= {
        "steps/sample": float(np.mean(steps)),
        "most / mean": float(np.max(steps) / np.mean(steps)),
    }
    row |= {f"{key} [ns/step]": value for key, value in each.items()}
    row |= {"waiting": each["varied"] / each["alike"]} if len(each) == 2 else {}
    return row | {"result": f"{np.sum(well)} of {size} ended well"}


# Simulated time


def duration_rows(quick: bool) -> list[dict[str, Any]]:
    durations = (0.05, 0.2) if quick else (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
    rows = []
    for name, integrator in integrators(STEP).items():
        told: dict[float, tuple] = {}
        cases, loop = {}, {}
        for duration in durations:
            go, said = program(
                jc.scenes.four_bar(),
                integrator,
                jnp.linspace(0.0, duration, round(duration / SAVING) + 1),
            )
            told[duration], cases[duration], loop[duration] = go()[1:], go, said["loop"]
        spent_by = {
            duration: cpu for duration, (_, cpu) in side_by_side(cases, 1 if quick else 5).items()
        }
        for duration, before in zip(durations, (None, *durations), strict=False):
            steps, outcome = int(told[duration][0]), told[duration][1]
            row = {
                "integrator": name,
                "loop": loop[duration],
                "simulated [s]": duration,
                "CPU [s]": spent_by[duration],
                "CPU per simulated s [s]": spent_by[duration] / duration,
                "steps per simulated s": steps / duration,
                "CPU [ns/step]": spent_by[duration] / steps * 1e9,
                # Exponent of the time with which the cost grew since the line above: 1 is linear.
                "exponent": "-"
                if before is None
                else math.log(spent_by[duration] / spent_by[before]) / math.log(duration / before),
            }
            rows.append(row | {"result": _ended(outcome)})
    return rows


# The engine's loops and XLA's


def loop_rows(quick: bool) -> list[dict[str, Any]]:
    scenes = {"slider-crank": jc.scenes.slider_crank} if quick else SCENES
    duration, repeats = (0.05, 3) if quick else (0.2, 5)
    rows = []
    for scene, build in scenes.items():
        for name, integrator in integrators(STEP, implicit=not quick).items():
            rows += _both_loops(
                scene, build(), name, integrator, jnp.linspace(0.0, duration, 11), repeats
            )
    return rows


def _both_loops(
    scene: str, mechanism: Any, name: str, integrator: Any, times: Any, repeats: int
) -> list[dict[str, Any]]:
    rows, cases, counts = [], {}, {}
    for samples in (1, BATCH):
        for plain in (False, True):
            row = {
                "scene": scene,
                "integrator": name,
                "samples": samples,
                "asked for": "XLA" if plain else "own",
            }
            row |= dict.fromkeys(
                ("loop", "compile CPU [s]", "CPU [ns/step/sample]", "own is faster", "result"), "-"
            )
            rows.append(row)
            key = (samples, plain)
            try:
                with loops(plain):
                    go, told = program(mechanism, integrator, times, samples)
                _, steps, outcome = go()
            except Exception as error:
                row["result"] = _sentence(error)
                continue
            reason = told.pop("reason")
            row |= told | {"result": f"{_ended(outcome)} {reason}".strip()}
            cases[key], counts[key] = go, int(np.sum(np.asarray(steps)))
    spent_by = {key: cpu for key, (_, cpu) in side_by_side(cases, repeats).items()}
    for row in rows:
        samples, plain = row["samples"], row["asked for"] == "XLA"
        if (samples, plain) in spent_by:
            row["CPU [ns/step/sample]"] = spent_by[samples, plain] / counts[samples, plain] * 1e9
            if (samples, not plain) in spent_by and not plain:
                row["own is faster"] = (
                    spent_by[samples, True]
                    / counts[samples, True]
                    * counts[samples, False]
                    / spent_by[samples, False]
                )
    return rows


PARTS = {
    f"scaling: a hanging chain, {CHAIN_TIME:g} s, fixed steps of {CHAIN_STEP:g} s": chain_rows,
    "scaling: samples through evaluate_all, on all cores": sample_rows,
    f"scaling: simulated time, four-bar, saved every {SAVING:g} s": duration_rows,
    "scaling: the engine's own loops against XLA's, one thread": loop_rows,
}


def main() -> None:
    if "--chain" in sys.argv:
        joints, name, repeats = sys.argv[sys.argv.index("--chain") + 1 :]
        try:
            print(json.dumps(chain_figures(int(joints), name, int(repeats))))
        except Exception as error:
            print(json.dumps({"result": _sentence(error)}))
        return
    options = arguments(__doc__)
    for title, rows in PARTS.items():
        begun = time.perf_counter()
        try:
            found = rows(options.quick)
        except Exception as error:
            found = [{"result": _sentence(error)}]
        report(title, found, options)
        print(f"({time.perf_counter() - begun:.0f} s)")
    sign("benchmarks.claims.scaling", options.json)


if __name__ == "__main__":
    main()
