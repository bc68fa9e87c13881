"""jaxclear beside other programs on a planar slider-crank with one clearance: time at equal
accuracy, alone and in a Monte Carlo.

Every program solves the rig of `peers.rig` and returns the slider's place at the saving times and
the peak contact force. Each is held against its law's reference (scipy, event by event), takes the
coarsest setting from which three in a row meet the accuracy asked, and is timed there; "agreement"
is the error of its finest run. What is not installed is left out with a word: `pip install
".[test,peers]"` brings all.
"""

import functools
import time
from typing import Any, NamedTuple

import numpy as np

from benchmarks.by_hand import slider_crank as in_numba
from benchmarks.measure import arguments, report, side_by_side, sign
from benchmarks.peers import programs as others
from benchmarks.peers import rig, with_jaxclear, with_mujoco
from benchmarks.peers.rig import Answer, Batch, Program

# (turns of the crank, samples, longest run tried on the ladder [s], seconds for one batch).
FULL, QUICK = (2.0, 1024, 25.0, 12.0), (0.2, 64, 2.0, 2.0)
# Relative tolerance and samples of a short run, of which what surrounds the steps is a large share:
# the least accurate that every program takes, its accuracy not asked for.
SHORT, SHORT_BATCH, SHORT_REPEATS = 1e-5, 64, 15
# A setting counts when it and the next finer ones meet the accuracy: errors near impacts are not
# monotonic.
IN_A_ROW = 3
# Runs longer than this [s] are timed once, on the ladder.
LONG_RUN = 5.0
# Samples from which the size of a batch is planned, and as many where a run takes longer than a
# second.
PILOT, SLOW_PILOT = 16, 4


def by_hand(question: rig.Question) -> list[Program]:
    """Loops in numba: of fixed steps, and with error control."""
    p, size = rig.LAWS["captured"], (question.saves, question.interval)
    steps = lambda k: (question.saves, int(k), question.interval / int(k))
    fixed = Batch(lambda k, c: in_numba.batch(p, c, *steps(k)), "prange")
    run = lambda k: in_numba.run(p, rig.CLEARANCE, *steps(k))
    loop = Batch(lambda r, c: in_numba.batch_adaptive(p, c, *size, r), "prange")
    adaptive = lambda r: in_numba.run_adaptive(p, rig.CLEARANCE, *size, r)
    ladder, tolerances = rig.steps_ladder(3e-6, 2e-8), rig.tolerance_ladder(1e-5, 1e-11)
    return [
        Program("numba, RK4", "captured", ladder, run, fixed),
        Program("numba, adaptive by hand", "captured", tolerances, adaptive, loop, True),
    ]


def all_programs(question: rig.Question) -> list[Program]:
    """Those of jaxclear first, then what is installed."""
    programs = (
        with_jaxclear.programs(question) + by_hand(question) + others.scipy_programs(question)
    )
    if others.installed("exudyn"):
        programs += others.exudyn_programs(question)
    if others.installed("mujoco"):
        programs += with_mujoco.mujoco_programs(question)
    if others.installed("mujoco.mjx"):
        programs += with_mujoco.mjx_programs(question)
    return programs


class Found(NamedTuple):
    """A program at its setting: settings in a row that met the accuracy, errors, error of the
    finest run tried, seconds that the first call took longer, (wall, CPU) seconds of the run."""

    program: Program
    setting: float
    met: int
    steps: int
    place_error: float
    force_error: float
    finest: float
    first_call: float
    spent: tuple[float, float]


def errors(answer: Answer, reference: Answer) -> tuple[float, float]:
    """(largest error of the slider's place [m], relative error of the peak force)."""
    return float(np.abs(answer.places - reference.places).max()), abs(
        answer.peak / reference.peak - 1
    )


def climb(program: Program, reference: Answer, patience: float) -> Found:
    """From coarse to fine until enough settings in a row meet the accuracy, or a run takes longer
    than `patience` [s].
    """

    def timed(setting):
        wall, cpu = time.perf_counter(), time.process_time()
        answer = program.run(setting)
        return answer, (time.perf_counter() - wall, time.process_time() - cpu)

    cold, warm = (timed(program.settings[0])[1][0] for _ in range(2))
    tried: list[Found] = []
    good = 0
    for setting in program.settings:
        try:
            answer, spent = timed(setting)
        except Exception as error:  # scipy's and Exudyn's solvers give up in their own ways
            print(f"{program.name} failed at {setting:.3g}: {type(error).__name__}")
            good = 0
            continue
        place, force = errors(answer, reference)
        tried.append(
            Found(
                program, setting, 0, answer.steps, place, force, place, max(cold - warm, 0.0), spent
            )
        )
        good = good + 1 if place <= rig.PLACE_ACCURACY and force <= rig.FORCE_ACCURACY else 0
        if good == IN_A_ROW or spent[0] > patience:
            break
    finest = tried[-1].place_error
    return tried[-max(good, 1)]._replace(met=good, finest=finest)


def setting_text(found: "Found", question: rig.Question) -> str:
    """A step in seconds or a tolerance."""
    return (
        f"rtol {found.setting:.1e}"
        if found.program.adaptive
        else f"{question.duration / found.steps:.2e} s"
    )


class Cost(NamedTuple):
    """Wall and CPU time of one run, or of one sample [s]."""

    wall: float
    cpu: float


def fastest(costs: dict[str, Cost], found: list[Found], *starts: str) -> str | None:
    """The program with the least CPU time among those whose names begin so; those that met the
    accuracy go first.
    """
    met = {f.program.name: f.met for f in found}
    names = [name for name in costs if any(name.startswith(start) for start in starts)]
    return min(names, key=lambda name: (not met[name], costs[name].cpu), default=None)


def alone_rows(found: list[Found], question: rig.Question) -> list[dict]:
    """Table of single runs."""
    cases = {
        f.program.name: lambda f=f: f.program.run(f.setting) for f in found if f.spent[0] < LONG_RUN
    }
    spent = {f.program.name: f.spent for f in found} | side_by_side(cases)
    costs = {name: Cost(*both) for name, both in spent.items()}
    best = costs[fastest(costs, found, "jaxclear")]
    rows = []
    for f in found:
        wall, cpu = costs[f.program.name]
        rows.append(
            {
                "program": f.program.name,
                "law": f.program.law,
                "setting": setting_text(f, question),
                "met": "yes" if f.met == IN_A_ROW else f"only {f.met}" if f.met else "NO",
                "steps": f.steps,
                "wall [ms]": wall * 1e3,
                "CPU [ms]": cpu * 1e3,
                "CPU ns/step": cpu / f.steps * 1e9,
                "CPU / jaxclear": cpu / best.cpu,
                "error x [m]": f.place_error,
                "error F": f.force_error,
                "agreement [m]": f.finest,
                "first call [s]": f.first_call,
            }
        )
    return rows


def batch_costs(
    found: list[Found], clearances: np.ndarray, budget: float
) -> tuple[dict[str, Cost], dict, dict]:
    """Cost of a sample, number of samples run, and what came out, by program; left out is what
    takes too long for one sample.
    """
    cases, sizes, answers = {}, {}, {}
    for f in found:
        batch, name = f.program.batch, f.program.name
        if batch is None or f.spent[0] * batch.share(f.setting) > budget:
            continue
        pilot = clearances[: min(PILOT if f.spent[0] < 1.0 else SLOW_PILOT, batch.most)]
        batch.go(f.setting, pilot)
        began = time.perf_counter()
        batch.go(f.setting, pilot)
        fit = budget / (time.perf_counter() - began) * len(pilot)
        sizes[name] = min(len(clearances), batch.most, max(len(pilot), int(fit) // PILOT * PILOT))

        def case(name=name, f=f):
            answers[name] = f.program.batch.go(f.setting, clearances[: sizes[name]])

        cases[name] = case
    spent, by_name = side_by_side(cases, 2), {f.program.name: f for f in found}
    costs = {}
    for name, (wall, cpu) in spent.items():
        samples = sizes[name] * by_name[name].program.batch.share(by_name[name].setting)
        costs[name] = Cost(wall / samples, (cpu + answers[name][:, 2:].sum()) / samples)
    return costs, sizes, answers


def batch_rows(
    found: list[Found], question: rig.Question, samples: int, budget: float
) -> list[dict]:
    """Table of Monte Carlos."""
    clearances = np.random.default_rng(0).uniform(0.8, 1.2, samples) * rig.CLEARANCE
    costs, sizes, answers = batch_costs(found, clearances, budget)
    failed = {name: int(np.isnan(answer[:, 0]).sum()) for name, answer in answers.items()}
    sound = {name: cost for name, cost in costs.items() if not failed[name]}
    best, rows = sound[fastest(sound, found, "jaxclear")], []
    exact = in_numba.batch_adaptive(
        rig.LAWS["captured"], clearances, question.saves, question.interval, 1e-11
    )
    for f in found:
        name, batch = f.program.name, f.program.batch
        if name not in costs:
            continue
        comparable = batch.share(f.setting) == 1.0
        apart = np.abs(answers[name][:, 0] / exact[: sizes[name], 0] - 1)
        rows.append(
            {
                "program": name,
                "how": batch.how,
                "samples run": sizes[name],
                "failed": failed[name],
                "wall [ms]": costs[name].wall * 1e3,
                "CPU [ms]": costs[name].cpu * 1e3,
                "wall / jaxclear": costs[name].wall / best.wall,
                "CPU / jaxclear": costs[name].cpu / best.cpu,
                "median error F": float(np.nanmedian(apart)) if comparable else "–",
            }
        )
    return rows


def reference_rows(question: rig.Question) -> list[dict]:
    """What the references are good for, and how far the laws lie apart."""
    solved = {law: others.reference(law, question) for law in rig.LAWS}
    captured = solved["captured"][0]
    return [
        {
            "law": law,
            "DOP853 - Radau [m]": apart,
            "peak force [N]": answer.peak,
            "off the captured law by [m]": errors(answer, captured)[0],
            "... in peak force": errors(answer, captured)[1],
        }
        for law, (answer, apart) in solved.items()
    ]


def short_rows(question: rig.Question) -> list[dict[str, Any]]:
    """jaxclear's steps under error control beside the loop by hand, at one loose tolerance: a run
    by each call of a user's, and a batch."""
    ours = next(p for p in with_jaxclear.programs(question) if p.name == "jaxclear Adaptive")
    hand = next(p for p in by_hand(question) if p.name == "numba, adaptive by hand")
    clearances = np.random.default_rng(0).uniform(0.4e-3, 0.6e-3, SHORT_BATCH)
    alone = functools.partial(hand.run, SHORT)
    batch = functools.partial(hand.batch.go, SHORT, clearances)
    calls = {
        **{name: (1, call, alone) for name, call in with_jaxclear.calls(question, SHORT).items()},
        "evaluate_all": (SHORT_BATCH, functools.partial(ours.batch.go, SHORT, clearances), batch),
    }
    cases = {(name, i): pair[i] for name, (_, *pair) in calls.items() for i in (0, 1)}
    spent = side_by_side(cases, SHORT_REPEATS)
    return [
        {
            "call": name,
            "samples": samples,
            "jaxclear Adaptive [ms]": 1e3 * spent[name, 0][1],
            "by hand [ms]": 1e3 * spent[name, 1][1],
            "ratio of CPU time": spent[name, 0][1] / spent[name, 1][1],
            "ratio of wall time": spent[name, 0][0] / spent[name, 1][0],
            "ratio of steps": ours.run(SHORT).steps / hand.run(SHORT).steps,
        }
        for name, (samples, *_) in calls.items()
    ]


def main() -> None:
    options = arguments(__doc__, short={"action": "store_true", "help": "the short form alone"})
    turns, samples, patience, budget = QUICK if options.quick else FULL
    question = rig.question(turns)
    title = f"short: {turns:g} turns at a tolerance of {SHORT:g}, error control beside that by hand"
    report(title, short_rows(question), options)
    if options.short:
        sign("benchmarks.peers.slider_crank", options.json, [title])
        return
    report("references: scipy, event by event", reference_rows(question), options)
    found = []
    for program in all_programs(question):
        found.append(climb(program, others.reference(program.law, question)[0], patience))
        print(f"  {program.name}: {setting_text(found[-1], question)}", flush=True)
    rows = alone_rows(found, question)
    report("alone, at equal accuracy", rows, options)
    rows = batch_rows(found, question, samples, budget)
    report(
        f"Monte Carlo of {samples} clearances from 0.4 to 0.6 mm, each program at the same setting",
        rows,
        options,
    )
    sign("benchmarks.peers.slider_crank", options.json)


if __name__ == "__main__":
    main()
