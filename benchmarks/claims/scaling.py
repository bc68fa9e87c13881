"""What running costs as scenes grow: with the number of clearance joints and of samples.

Times are the smallest of several, of compiled programs; compiling is given apart, in CPU seconds.
Each chain is measured in a process of its own with a time limit, because long chains may not
compile in bearable time; everything else takes turns in one process. No link of a chain is held by
an ideal joint: it hangs together by contact forces alone, let go straight, away from the vertical.
"""

import dataclasses
import functools
import json
import math
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import loop_reasons, run_tables, seconds_to_compile, side_by_side
from jaxclear.simulation.simulate import run
from jaxclear.studies.store.batch import evaluate_all

# Chain: step [s] of the fixed ones, simulated time [s], and how long a process may take [s].
CHAIN_STEP, CHAIN_TIME = 1e-5, 0.05
STEP = 2e-5
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


def program(
    mechanism: jc.Mechanism, integrator: Any, times: Any
) -> tuple[Callable, dict[str, Any]]:
    """A compiled run, and what compiling it said."""
    start = jc.assemble(mechanism)
    numbers, rest = eqx.partition((mechanism, integrator), eqx.is_array)

    def one(numbers, q, v):
        mechanism, integrator = eqx.combine(numbers, rest)
        found = run(mechanism, q, v, times, integrator)
        return found.states, found.accepted_steps + found.rejected_steps, found.outcome

    args = (numbers, start.coordinates, start.speeds)
    with loop_reasons() as why:
        compiled, seconds = seconds_to_compile(one, *args)
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

# Links of steel, 10 mm x 20 mm x 100 mm: length [m], mass [kg].
LENGTH, MASS = 0.1, 0.15
CLEARANCE = 0.1e-3
# Angle from the vertical at which the chain is let go [rad].
LEAN = 0.5


def bearing() -> jc.clearance.PlanarJournalBearing:
    """Each joint of the chain: Lankarani-Nikravesh contact between steel, with friction."""
    steel = jc.Material(young_modulus=207e9, poisson_ratio=0.3)
    contact = jc.contact.LankaraniNikravesh(
        stiffness=jc.stiffness.HertzStiffness(steel, steel), restitution=0.9
    )
    friction = jc.friction.ThreeZone(
        mu_static=0.15, mu_kinetic=0.1, static_speed=0.1, kinetic_speed=1.0
    )
    return jc.clearance.PlanarJournalBearing(
        contact, friction, bearing_radius=10e-3, clearance=CLEARANCE
    )


def chain(joints: int) -> jc.Mechanism:
    """`joints` links, the first hanging from the ground: as many clearance joints, three speeds a
    link.
    """
    names = [f"link {i}" for i in range(1, joints + 1)]
    angle = LEAN - math.pi / 2
    link = jc.Body(MASS, MASS * LENGTH**2 / 12, (LENGTH / 2, 0.0))
    ends = [jc.Marker("ground")] + [jc.Marker(name, (LENGTH, 0.0)) for name in names[:-1]]
    return jc.Mechanism(
        bodies=dict.fromkeys(names, link),
        connections={
            f"joint {i}": jc.Connection(bearing(), ends[i - 1], name)
            for i, name in enumerate(names, 1)
        },
        loads={"gravity": jc.load.Gravity((0.0, -9.81))},
        start={
            name: (i * LENGTH * math.cos(angle), i * LENGTH * math.sin(angle), angle)
            for i, name in enumerate(names)
        },
    )


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


def chain_rows(options: Any) -> list[dict[str, Any]]:
    sizes, limit, repeats = ((1, 4), 40, 2) if options.quick else ((1, 4, 16, 64), 150, 5)
    keys = ("loop", "compile CPU [s]", "steps", "CPU [ns/step]", "CPU [ns/step/joint]")
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
    module = [sys.executable, "-m", "benchmarks.claims.scaling"]
    command = [*module, "--chain", str(joints), name, str(repeats)]
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


def sample_rows(options: Any) -> list[dict[str, Any]]:
    quick = options.quick
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


# Samples of the four-bar, and its durations [s]; the longest is a turn of the crank.
WEARING_SAMPLES, WEARING_TIMES = 64, (0.02, 0.2, 0.628)


def wear_rows(options: Any) -> list[dict[str, Any]]:
    """CPU time of a step of the four-bar in a batch with wear, with a surface that is updated once,
    and without wear, each without what a run of no length takes."""
    rows, updates = [], {"wear": None, "one update": 1}
    is_wearing = lambda node: isinstance(node, jc.Wearing)
    for duration in WEARING_TIMES[: 1 if options.quick else None]:
        cases, answers = {}, {}
        for name in ("dry", *updates):
            rig = jc.scenes.four_bar(wear=name in updates)
            rarer = lambda node, n=updates.get(name): (
                dataclasses.replace(node, updates=n) if is_wearing(node) else node
            )
            rig = jax.tree.map(rarer, rig, is_leaf=is_wearing)
            asked = question(rig, jc.integrator.FixedStep(STEP), duration)
            spread = np.random.default_rng(0).normal(size=(WEARING_SAMPLES, 2)) / 3
            values = np.asarray(asked.nominal()) + np.array(TOLERANCES) * np.clip(spread, -1, 1)
            at_once = eqx.tree_at(lambda p: p.duration, asked, jnp.asarray(1e-9))

            def go(key, problem, values=values):
                answers[key] = evaluate_all(problem, values)
                return answers[key].responses["steps"]

            cases[name, True] = functools.partial(go, (name, True), asked)
            cases[name, False] = functools.partial(go, (name, False), at_once)
        spent = {key: cpu for key, (_, cpu) in side_by_side(cases, 3).items()}
        row: dict[str, Any] = {"duration [s]": duration, "samples": WEARING_SAMPLES}
        for name in ("dry", *updates):
            steps = np.sum(answers[name, True].responses["steps"])
            row[f"{name} [ns/step]"] = 1e9 * (spent[name, True] - spent[name, False]) / float(steps)
        row["share of wear [%]"] = 100 * (1 - row["dry [ns/step]"] / row["wear [ns/step]"])
        rows.append(row)
    return rows


TABLES = {
    f"scaling: a hanging chain, {CHAIN_TIME:g} s, fixed steps of {CHAIN_STEP:g} s": chain_rows,
    "scaling: samples through evaluate_all, on all cores": sample_rows,
    "scaling: wear of the four-bar in a batch, FixedStep": wear_rows,
}

if __name__ == "__main__":
    if "--chain" in sys.argv:
        joints, name, repeats = sys.argv[sys.argv.index("--chain") + 1 :]
        try:
            print(json.dumps(chain_figures(int(joints), name, int(repeats))))
        except Exception as error:
            print(json.dumps({"result": _sentence(error)}))
    else:
        run_tables(TABLES)
