"""How often 95 % intervals of derivatives hold the truth, and how wide they are beside what the
scatter of the answers asks for: jaxclear.sensitivity repeated with other random numbers.

    python -m benchmarks.claims.coverage [--quick] [--cases ball1 ...] [--repetitions N]
        [--reference RUNS] [--pathwise] [--json FILE]

The truth is the integral over the tolerance of the response times the score function, by a grid of
`--reference` runs and what the ends add; its own error is that of half the grid. `ball`: a journal
dropped in its bearing, 1 to 6 bounces. `crank`: the slider-crank at 50 rad/s or 5000 rpm over two
turns. `four-bar`: mean force over 0.1 turns. The last columns are stated over true standard
error of the Monte Carlo mean of the same samples.
"""

import argparse
import json
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from scipy import stats

import jaxclear as jc
from benchmarks.measure import about, report
from jaxclear.studies.batch import evaluate_all
from jaxclear.studies.statistics.scrambled import standard_error

GRAVITY, CLEARANCE = 9.81, 1e-3
FALL = np.sqrt(2 * CLEARANCE / GRAVITY)
# Duration in times of the first fall: 1, 2, 3 and 6 bounces at a restitution of 0.7.
BALLS = {"ball1": 1.6, "ball2": 2.0, "ball3": 3.5, "ball6": 5.0}
CRANKS = {"crank 50 rad/s": (50.0, 2e-5), "crank 5000 rpm": (523.6, 5e-6)}
LEAST_TIMES = 1.96


def ball(name: str) -> jc.Problem:
    law = jc.contact.Flores(stiffness=1e8, restitution=0.7)
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {
            "B": jc.Connection(
                jc.clearance.PlanarJournalBearing(law, clearance=CLEARANCE), "ground", "journal"
            )
        },
        {"gravity": jc.load.Gravity((0.0, -GRAVITY))},
    )
    clearance = jc.Variable(lambda rig: rig.connections["B"].joint.clearance, tolerance=1e-4)
    return jc.Problem(
        rig,
        {"height": lambda run: run.body("journal").com[-1, 1]},
        {"clearance": clearance},
        duration=BALLS[name] * FALL,
        save=11,
        integrator=jc.integrator.FixedStep(1e-5, "semi_implicit"),
    )


def crank(name: str) -> jc.Problem:
    speed, step = CRANKS[name]
    rig = jc.scenes.slider_crank(crank_speed=speed, wear=True)
    clearance = jc.Variable(lambda rig: rig.connections["B"].joint.clearance, tolerance=20e-6)
    return jc.Problem(
        rig,
        {
            "mean force": jc.response.MeanContactForce("B"),
            "worn volume": jc.response.WornVolume("B"),
        },
        {"clearance": clearance},
        duration=2 * 2 * np.pi / speed,
        save=101,
        integrator=jc.integrator.FixedStep(step, "semi_implicit"),
    )


def four_bar(name: str) -> jc.Problem:
    clearance = jc.Variable(lambda rig: rig.connections["B"].joint.clearance, tolerance=20e-6)
    return jc.Problem(
        jc.scenes.four_bar("spatial", 0.2e-3),
        {"mean force": jc.response.MeanContactForce("B")},
        {"clearance": clearance},
        duration=0.1 * 2 * np.pi / 10.0,
        save=26,
        integrator=jc.integrator.FixedStep(2e-5, "semi_implicit"),
    )


CASES = dict.fromkeys(BALLS, ball) | dict.fromkeys(CRANKS, crank) | {"four-bar": four_bar}


def reference(problem: jc.Problem, runs: int) -> dict[str, tuple[float, float]]:
    """(derivative of the mean, its own error) by response, by a grid over the tolerance."""
    own = problem.variables[problem.names[0]].distribution
    spread, bound = float(own.standard_deviation), float(own.bound)
    cut = stats.truncnorm(-bound / spread, bound / spread, scale=spread)
    at = ((np.arange(runs) + 0.5) / runs * 2 - 1) * bound
    values = float(problem.nominal()[0]) + np.concatenate([at, [-bound, bound]])
    found = evaluate_all(problem, jnp.asarray(values)[:, None])
    truth = {}
    for name, response in found.responses.items():
        inner, ends = response[:-2], response[-2:]
        score = inner * at / spread**2 * cut.pdf(at) * (2 * bound / runs)
        ends = float((ends[1] - ends[0]) * cut.pdf(bound))
        halves = [2 * score[i::2].sum() for i in (0, 1)]
        truth[name] = float(score.sum()) + ends, 0.5 * abs(halves[0] - halves[1])
    return truth


def repeated(problem: jc.Problem, truth: dict, repetitions: int, methods: tuple) -> list[dict]:
    """Rows: response and method, how often its interval held, how wide it was."""
    kept: dict = {}
    means: dict = {}
    begun = time.process_time()
    for i in range(repetitions):
        study = jc.sensitivity(problem, methods=methods, seed=1000 + 10 * i)
        for (response, _), derivative in study.derivatives.items():
            for method, e in {"answer": derivative, **derivative.estimates}.items():
                row = e.value, e.error, derivative.trustworthy
                kept.setdefault((response, method), []).append(row)
            values, group = study.sample.good(response)
            row = values.mean(), standard_error(np.mean, values, group)[0]
            means.setdefault(response, []).append(row)
    each = (time.process_time() - begun) / repetitions
    rows = []
    for (response, method), told in kept.items():
        value, error, agreed = np.array(told, float).T
        fine = np.isfinite(value)
        exact, own = truth[response]
        away = value[fine] - exact
        held = np.abs(away) <= error[fine] + own
        mean, stated = np.array(means[response]).T
        scatter = np.sqrt(np.mean(away**2)) if fine.any() else np.nan
        rows.append(
            {
                "response": response,
                "method": method,
                "answers": int(fine.sum()),
                "held [%]": 100 * held.mean() if fine.any() else np.nan,
                "agreed [%]": 100 * agreed.mean(),
                "truth": exact,
                "its error": own,
                "bias": away.mean() if fine.any() else np.nan,
                "half width over 1.96 rms error": error[fine].mean() / (LEAST_TIMES * scatter),
                "stated over true error of the mean": np.sqrt(np.mean(stated**2))
                / mean.std(ddof=1),
                "CPU s a study": each,
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--repetitions", type=int, default=400)
    parser.add_argument("--reference", type=int, default=16384)
    parser.add_argument("--pathwise", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.quick:
        options.cases, options.repetitions, options.reference = ["ball1"], 4, 1024
    for name in options.cases:
        problem = CASES[name](name)
        truth = reference(problem, options.reference)
        # Tangents through rattling are refused, and dear.
        methods = ("regression", "differences") + ("pathwise",) * options.pathwise
        rows = repeated(problem, truth, options.repetitions, methods)
        report(f"{name}, {options.repetitions} repetitions", rows, options)
    if options.json is not None:
        known = json.loads(options.json.read_text())
        known["about"] = about("benchmarks.claims.coverage", options.json)
        options.json.write_text(json.dumps(known, indent=1) + "\n")


if __name__ == "__main__":
    main()
