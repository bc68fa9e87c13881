"""How often 95 % intervals of derivatives hold the truth, and how wide they are beside what the
scatter of the answers asks for: jaxclear.sensitivity repeated with other random numbers.

    python -m benchmarks.claims.coverage [--quick] [--cases ball1 ...] [--repetitions N]
        [--reference RUNS] [--pathwise] [--json FILE]

The truth is the integral over the tolerance of the response times the score function, by a grid of
`--reference` runs and what the ends add; its own error is how far a third of the grid is off.
`ball`: a journal
dropped in its bearing, 1 to 6 bounces. `crank`: the slider-crank at 50 rad/s or 5000 rpm over two
turns. `four-bar`: mean force over 0.1 turns. Steps are such that runs do not warn: a derivative of
runs in doubt is not called agreed. The last columns are stated over true standard
error of the Monte Carlo mean of the same samples, and variance (of answers that are agreed) times
runs beside the best method's: an answer takes the runs of all methods, of which one confirms the
other.
"""

import time

import jax.numpy as jnp
import numpy as np
from scipy import stats

import jaxclear as jc
from benchmarks.measure import arguments, report, sign
from jaxclear.studies.store.batch import evaluate_all
from jaxclear.studies.statistics.scrambled import standard_error

GRAVITY, CLEARANCE = 9.81, 1e-3
FALL = np.sqrt(2 * CLEARANCE / GRAVITY)
# Duration in times of the first fall: 1, 2, 3 and 6 bounces at a restitution of 0.7.
BALLS = {"ball1": 1.6, "ball2": 2.0, "ball3": 3.5, "ball6": 5.0}
CRANKS = {"crank 50 rad/s": (50.0, 5e-6), "crank 5000 rpm": (523.6, 5e-6)}
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
        integrator=jc.integrator.FixedStep(2.5e-6, "semi_implicit"),
    )


CASES = dict.fromkeys(BALLS, ball) | dict.fromkeys(CRANKS, crank) | {"four-bar": four_bar}


def reference(problem: jc.Problem, runs: int) -> dict[str, tuple[float, float]]:
    """(derivative of the mean, its own error) by response, by a grid over the tolerance."""
    own = problem.variables[problem.names[0]].distribution
    spread, bound = float(own.standard_deviation), float(own.bound)
    cut = stats.truncnorm(-bound / spread, bound / spread, scale=spread)
    runs = runs // 3 * 3
    at = ((np.arange(runs) + 0.5) / runs * 2 - 1) * bound
    values = float(problem.nominal()[0]) + np.concatenate([at, [-bound, bound]])
    found = evaluate_all(problem, jnp.asarray(values)[:, None])
    truth = {}
    for name, response in found.responses.items():
        inner, ends = response[:-2], response[-2:]
        score = inner * at / spread**2 * cut.pdf(at) * (2 * bound / runs)
        ends = float((ends[1] - ends[0]) * cut.pdf(bound))
        # The middles of the grid's threes are a grid of their own.
        truth[name] = float(score.sum()) + ends, abs(score.sum() - 3 * score[1::3].sum())
    return truth


def one_study(problem: jc.Problem, methods: tuple, seed: int) -> list[dict]:
    """What one study says: by response and method its value, error and whether it is trusted; and
    the mean of its sample with the standard error stated."""
    begun = time.process_time()
    study = jc.sensitivity(problem, methods=methods, seed=seed)
    spent = time.process_time() - begun
    told = []
    for (response, _), derivative in study.derivatives.items():
        values, group = study.sample.good(response)
        mean = float(values.mean()), standard_error(np.mean, values, group)[0]
        own = derivative.estimates
        runs = {method: e.runs for method, e in own.items()}
        runs["answer"] = sum(runs.values())
        for method, e in {"answer": derivative, **own}.items():
            row = {"response": response, "method": method, "value": float(e.value)}
            row["runs"] = runs[method]
            row |= {"error": float(e.error), "agreed": derivative.trustworthy}
            told.append(row | {"mean": mean[0], "stated": mean[1], "CPU s": spent})
    return told


def rows_of(studies: list[list[dict]], truth: dict) -> list[dict]:
    """Rows: response and method, how often its interval held, how wide it was."""
    rows = []
    for place, first in enumerate(studies[0]):
        told = {name: np.array([study[place][name] for study in studies]) for name in first}
        value, error = told["value"], told["error"]
        fine = np.isfinite(value)
        exact, own = truth[first["response"]]
        away = value[fine] - exact
        held = np.abs(away) <= error[fine] + own
        rms = np.sqrt(np.mean(away**2)) if fine.any() else np.nan
        # An answer that is not agreed is the middle of all methods, and says so.
        sure = told["agreed"][fine] if told["agreed"].any() else np.ones(fine.sum(), bool)
        scatter = np.sqrt(np.mean(away[sure] ** 2)) if fine.any() else np.nan
        rows.append(
            {
                "response": first["response"],
                "method": first["method"],
                "repetitions": len(studies),
                "answers": int(fine.sum()),
                "held [%]": 100 * held.mean() if fine.any() else np.nan,
                "agreed [%]": 100 * told["agreed"].mean(),
                "truth": exact,
                "its error": own,
                "bias": away.mean() if fine.any() else np.nan,
                "scatter": scatter,
                "half width over 1.96 rms error": error[fine].mean() / (LEAST_TIMES * rms),
                "stated over true error of the mean": np.sqrt(np.mean(told["stated"] ** 2))
                / told["mean"].std(ddof=1),
                "CPU s a study": float(np.median(told["CPU s"])),
                "runs": float(told["runs"].mean()),
                "variance x runs": scatter**2 * float(told["runs"].mean()),
            }
        )
    return _compared(rows)


def _compared(rows: list[dict]) -> list[dict]:
    """Variance and variance x runs over those of the best method; the answer's runs are those of
    all methods."""
    for row in rows:
        own = [r for r in rows if r["response"] == row["response"] and r["method"] != "answer"]
        best = min(r["variance x runs"] for r in own)
        row["variance over the best"] = (row["scatter"] / min(r["scatter"] for r in own)) ** 2
        row["variance x runs over the best"] = row["variance x runs"] / best
    return rows


def main() -> None:
    options = arguments(
        str(__doc__),
        cases={"nargs": "*", "default": list(CASES), "choices": list(CASES)},
        repetitions={"type": int, "default": 400},
        reference={"type": int, "default": 16384},
        pathwise={"action": "store_true"},
    )
    if options.quick:
        options.cases, options.repetitions, options.reference = ["ball1"], 4, 1024
    for name in options.cases:
        problem, title = CASES[name](name), f"Intervals: {name}"
        truth = reference(problem, options.reference)
        # Tangents through rattling are refused, and dear.
        methods = ("regression", "differences") + ("pathwise",) * options.pathwise
        seeds = range(1000, 1000 + 10 * options.repetitions, 10)
        studies = [one_study(problem, methods, seed) for seed in seeds]
        report(title, rows_of(studies, truth), options)
        sign("benchmarks.claims.coverage", options.json, [title])


if __name__ == "__main__":
    main()
