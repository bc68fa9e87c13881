"""Whether `jaxclear.advise` chooses well: its choice beside the cheapest right one, on every scene
and ten problems each.

    python -m benchmarks.claims.advice [--quick] [--scene NAME ...] [--json FILE]

Problems differ in the responses asked about, speeds, clearances, durations and accuracies. The
advisor does what it always does; all its candidates are then run on the whole problem, for copies
that it has not seen. A setting is right if its error over all of these is within the accuracy in
every response, and its next finer one's too. The choice is wrong if it is said to meet the accuracy
and does not. Costs are CPU seconds of one run.
"""

import argparse
import copy
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

import jaxclear as jc
from benchmarks.measure import about
from benchmarks.trade import questions
from benchmarks.trade.curves import Measured, copies, ladders, measure
from benchmarks.trade.questions import Question
from jaxclear.ground.printing import as_typed

# Copies beside the nominal one by which the advisor is judged, drawn by another seed.
OTHERS = 3
# Candidates this many times as dear as the cheapest right one are not run.
TOO_DEAR = 3.0
# By how much the choice may be dearer than the cheapest right one, and how far the reference may be
# off, as a share of the accuracy, where it tells right from wrong.
ALLOWED, TRUSTED = 1.5, 0.5
# What a choice can be; without a reference it is told apart whether the advisor was sure.
# In doubt: off by more than the accuracy, but not by more than the references are apart.
UNJUDGED, SURE, IN_DOUBT = "no reference", "no reference, sure", "in doubt"
VERDICTS = (
    *("right", "right, dear", "wrong", "wrong, said so"),
    *(IN_DOUBT, UNJUDGED, SURE, "refused"),
)
# Rungs that are no candidates.
OTHER_MODELS = ("MoreauJean", "NonColliding")
# A size of a response beside which no error counts.
QUICK = ("slider-crank, ideal",)

# What is asked together, and at which accuracies.
FORCES = ("mean force", "peak force")
MOTION = ("worn volume", "friction loss", "position error", "pointing", "place")
ACCURACIES = (0.01, 0.05, 0.01, 0.02, 0.01)
# Speed, clearance [m] and share of the duration of five problems, beside those of the scene.
NUMBERS = ((1.0, 1.0, 1.0), (2.0, 1.0, 0.5), (0.5, 1.0, 0.5), (1.0, 0.3, 1.0), (1.5, 2.0, 0.7))


def _varied(build: Callable, speed: float, clearance: float | None) -> Callable[..., Question]:
    def make(faster: float, wider: float, share: float) -> Question:
        gap = {} if clearance is None else {"clearance": wider * clearance}
        return build(speed=faster * speed, share=share, **gap)

    return make


def _antenna(faster: float, wider: float, share: float) -> Question:
    return questions.antenna(wider * 0.2e-3, share * 0.1)


def _flap(faster: float, wider: float, share: float) -> Question:
    return questions.flap(wider * 1e-4, share)


def _parallel_3rsr(usual: float, cycles: float) -> Callable[..., Question]:
    def make(faster: float, wider: float, share: float) -> Question:
        period = usual / faster
        return questions.parallel_3rsr(period, share * cycles * period, wider * 5e-4)

    return make


def _ideal_antenna(faster: float, wider: float, share: float) -> Question:
    return questions.ideal_antenna(share)


SCENES: dict[str, Callable[[float, float, float], Question]] = {
    "slider-crank": _varied(questions.slider_crank, 50.0, 1e-4),
    "slider-crank, ideal": _varied(questions.ideal_slider_crank, 50.0, None),
    "four-bar, planar": _varied(
        lambda **numbers: questions.four_bar("planar", **numbers), 10.0, 2e-4
    ),
    "four-bar, spatial": _varied(
        lambda **numbers: questions.four_bar("spatial", **numbers), 10.0, 2e-4
    ),
    "four-bar, ideal": _varied(questions.ideal_four_bar, 10.0, None),
    "guide": _varied(questions.guide, 5.0, 1e-4),
    "guide, ideal": _varied(questions.ideal_guide, 5.0, None),
    "antenna": _antenna,
    "antenna, ideal": _ideal_antenna,
    "flap": _flap,
    "3RSR, quiet": _parallel_3rsr(questions.QUIET, 1 / 4),
    "3RSR, rattling": _parallel_3rsr(questions.RATTLING, 1 / 3),
}


Names = tuple[str, ...]


class Judge(NamedTuple):
    """Copies on which candidates are judged, the reference's answers, and the responses asked
    about."""

    values: np.ndarray
    wanted: Measured
    names: Names


class Tried(NamedTuple):
    """A candidate on the whole problem: largest error, CPU seconds, whether it is right."""

    setting: str
    error: float
    seconds: float
    right: bool


def with_one(problem: jc.Problem, integrator: Any) -> jc.Problem:
    """The problem on another integrator."""
    return eqx.tree_at(lambda p: p.integrator, problem, integrator)


def largest_error(found: Measured, wanted: Measured, names: Names) -> float:
    """Largest error over copies and these responses, as a share of a response's root mean
    square."""
    if found.said:
        return math.inf
    worst = 0.0
    for name in names:
        answers = wanted.responses[name]
        size = float(np.sqrt(np.mean(answers**2)))
        off = float(np.max(np.abs(found.responses[name] - answers)))
        worst = max(worst, off / size if np.isfinite(off) and size > 0 else math.inf)
    return worst


def tried_on(question: Question, accuracy: float, judge: Judge) -> list[Tried]:
    """All candidates of the advisor on the whole problem, the cheap ones of each method."""
    best, found = math.inf, []
    values, wanted, names = judge
    for name, ladder in ladders(question).items():
        if name in OTHER_MODELS:
            continue
        own: list[Tried] = []
        for integrator in ladder:
            got = measure(with_one(question.problem, integrator), values)
            error = largest_error(got, wanted, names)
            own.append(Tried(as_typed(integrator), error, got.seconds, False))
            if len(own) > 1 and max(own[-1].error, own[-2].error) <= accuracy:
                own[-2] = own[-2]._replace(right=True)
                best = min(best, own[-2].seconds)
                break
            if got.seconds > TOO_DEAR * min(best, wanted.seconds):
                break
        found += own
    return found


def only(problem: jc.Problem, names: Names) -> jc.Problem:
    """The problem with these responses alone."""
    found = copy.copy(problem)
    object.__setattr__(found, "response", {name: problem.response[name] for name in names})
    object.__setattr__(found, "response_names", names)
    return found


def judged(scene: str, question: Question, names: Names, accuracy: float) -> dict[str, Any]:
    """The advisor's choice beside the cheapest right one, of the responses that are asked about."""
    problem = question.problem
    names = tuple(name for name in names if name in problem.response_names)
    row = {"scene": scene, "responses": ", ".join(names), "accuracy": accuracy}
    row |= {"duration [s]": float(problem.duration)}
    try:
        advice = jc.advise(only(problem, names), accuracy)
    except ValueError as error:
        return row | {"verdict": "refused", "said": str(error)}
    row |= {"choice": as_typed(advice.recommended)}
    values = copies(problem, 1 + OTHERS, seed=1)
    tight = jc.integrator.Adaptive(rtol=1e-10, atol=1e-12)
    wanted = measure(with_one(problem, tight), values)
    loose = measure(with_one(problem, jc.integrator.Adaptive(rtol=1e-9, atol=1e-11)), values)
    doubt = largest_error(loose, wanted, names)
    if doubt > TRUSTED * accuracy:
        verdict = SURE if advice.met else UNJUDGED
        return row | {"verdict": verdict, "references apart": doubt}
    chosen = measure(with_one(problem, advice.recommended), values)
    error = largest_error(chosen, wanted, names)
    tried = [one for one in tried_on(question, accuracy, Judge(values, wanted, names)) if one.right]
    cheapest = min(tried, key=lambda one: one.seconds, default=None)
    row |= {"error": error, "CPU [ms]": 1e3 * chosen.seconds}
    if cheapest is not None:
        same = cheapest.setting == row["choice"]
        ratio = 1.0 if same else chosen.seconds / cheapest.seconds
        row |= {"cheapest right": cheapest.setting, "ratio": ratio}
    if accuracy < error <= accuracy + doubt:
        return row | {"verdict": IN_DOUBT, "references apart": doubt}
    return row | {"verdict": _verdict(advice.met, error <= accuracy, row.get("ratio"))}


def _verdict(met: bool, right: bool, ratio: float | None) -> str:
    if not right:
        return "wrong" if met else "wrong, said so"
    if ratio is not None and ratio > ALLOWED:
        return "right, dear"
    return "right"


def rows_of(scene: str, numbers: tuple = NUMBERS) -> list[dict[str, Any]]:
    """Ten problems of a scene: two sets of responses, five sets of numbers."""
    rows = []
    for names in (FORCES, MOTION):
        for (faster, wider, share), accuracy in zip(numbers, ACCURACIES, strict=False):
            row = judged(scene, SCENES[scene](faster, wider, share), names, accuracy)
            rows.append(row)
            print("   ", row, flush=True)
    return rows


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row a scene: how often the choice was what, and its largest and mean ratio."""
    table = []
    for scene in [*dict.fromkeys(row["scene"] for row in rows), "all"]:
        own = [row for row in rows if scene in (row["scene"], "all")]
        ratios = [row["ratio"] for row in own if row.get("ratio") and row["verdict"] != "wrong"]
        counts = {verdict: sum(row["verdict"] == verdict for row in own) for verdict in VERDICTS}
        table.append(
            {"scene": scene, "problems": len(own)}
            | counts
            | {"mean ratio": float(np.mean(ratios)) if ratios else None}
            | {"largest ratio": max(ratios, default=None)}
        )
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one scene, two problems")
    parser.add_argument("--scene", nargs="*", choices=SCENES, help="these scenes alone")
    parser.add_argument("--sets", type=int, default=len(NUMBERS), help="sets of numbers, of five")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here")
    options = parser.parse_args()
    known = json.loads(options.json.read_text()) if options.json and options.json.exists() else {}
    every = known.get("every problem", [])
    for scene in options.scene or (QUICK if options.quick else SCENES):
        begun = time.process_time()
        rows = rows_of(scene, NUMBERS[: 1 if options.quick else options.sets])
        every = [row for row in every if row["scene"] != scene] + rows
        for row in summary(rows)[:1]:
            print(row, f"{time.process_time() - begun:.0f} s CPU", flush=True)
        jax.clear_caches()
        known |= {"about": about("benchmarks.claims.advice", options.json)}
        known |= {"the advisor's choice": summary(every), "every problem": every}
        if options.json:
            options.json.write_text(json.dumps(known, indent=1) + "\n")


if __name__ == "__main__":
    main()
