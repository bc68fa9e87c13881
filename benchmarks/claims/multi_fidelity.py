"""What cheaper models save: closed forms of known correlation, and mechanisms.

    python -m benchmarks.claims.multi_fidelity [--quick] [--json FILE]

Known correlations first; a call that is stopped leaves what it has measured.

`Known correlation`: two normal numbers of this correlation at a share of the work, random sampling,
200 repetitions: work of plain sampling to the same error, as theory foresees it for the best
allocation (Giles 2008; numbers of runs are doubled, which costs up to a half) and as the scatter of
the answers has it; how often 95 % intervals held, and stated over true error. `Mechanisms`: the
four-bar by steps of 20 us with contacts that open and close, beside cheaper rungs, quasi-random
sampling: the gain that the study states over quasi-random sampling of the accurate problem alone.
"No gain" is an answer.
"""

import time

import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, report, sign
from jaxclear.studies.statistics.scrambled import student

CASES = ((0.8, 1 / 16), (0.95, 1 / 64), (0.99, 1 / 16), (0.5, 1 / 4))
REPETITIONS, SAMPLES = 200, 2048
TURN = 2 * np.pi / 10.0
Normal = jc.distribution.Normal


def known(correlation: float, cost: float, repetitions: int) -> dict:
    numbers = {name: jc.Dimension(0.0, Normal(1.0)) for name in "ab"}
    rest = np.sqrt(1 - correlation**2)
    problem = jc.FunctionProblem(lambda a, b: {"y": 1.0 + a + 0 * b}, numbers)
    cheap = jc.FunctionProblem(lambda a, b: {"y": correlation * a + rest * b}, numbers)
    found = [
        jc.multi_fidelity(
            problem, cheap, SAMPLES, costs={"cheaper": cost}, sampling="random", seed=s
        )
        for s in range(repetitions)
    ]
    away = np.array([one.means["y"].value - 1.0 for one in found])
    half = np.array([one.means["y"].error for one in found])
    spread = [one.standard_deviations["y"] for one in found]
    work = np.mean([one.work for one in found])
    best = 1 / (rest * np.sqrt(1 + cost) + correlation * np.sqrt(cost)) ** 2
    return {
        "correlation": correlation,
        "cost of a cheap run": cost,
        "cheap runs used [%]": 100 * np.mean([len(one.used) > 1 for one in found]),
        "gain by theory": best,
        "gain by the scatter": 1 / (np.mean(away**2) * work),
        "gain stated (median)": float(np.median([one.gains["y"] for one in found])),
        "held: mean [%]": 100 * np.mean(np.abs(away) <= half),
        "held: deviation [%]": 100 * np.mean([one.low <= 1.0 <= one.high for one in spread]),
        "stated over true error": np.sqrt(np.mean((half / student(16)) ** 2) / np.mean(away**2)),
        "repetitions": repetitions,
    }


def four_bar(duration: float, integrator=None) -> jc.Problem:
    saves = 101
    ideal = jc.simulate(jc.scenes.four_bar("ideal"), duration, save=saves)
    wanted = ideal.body("follower").com
    places = {
        "clearance": lambda rig: rig.connections["B"].joint.clearance,
        "coupler length": lambda rig: rig.connections["B"].parent.at[0],
        "follower length": lambda rig: rig.connections["B"].child.at[0],
    }
    return jc.Problem(
        jc.scenes.four_bar("spatial", 0.2e-3),
        {
            "follower error": jc.response.PositionError("follower", wanted, axes=(0, 1)),
            "mean force": jc.response.MeanContactForce("B"),
            "worn volume": jc.response.WornVolume("B"),
        },
        {name: jc.Variable(where, tolerance=20e-6) for name, where in places.items()},
        duration=duration,
        save=saves,
        integrator=integrator or jc.integrator.FixedStep(2e-5, "semi_implicit"),
    )


def mechanism(name: str, problem: jc.Problem, integrator, samples: int) -> list[dict]:
    begun = time.process_time()
    found = jc.multi_fidelity(problem, {name: problem.with_integrator(integrator)}, samples)
    spent = time.process_time() - begun
    print(found.sentence(), flush=True)
    return [
        {
            "cheaper": name,
            "response": response,
            "correlation": found.correlations[name, response],
            "cost of a cheap run": found.costs[name],
            "used": name in found.used,
            "runs": " + ".join(map(str, found.runs)),
            "work [runs]": found.work,
            "pilot [runs]": found.pilot,
            "gain stated": found.gains[response],
            "mean": found.means[response].value,
            "its error": found.means[response].error,
            "CPU s with compilation": spent,
        }
        for response in problem.response_names
    ]


def main() -> None:
    options = arguments(__doc__ or "")
    cases, repetitions = (CASES[1:2], 4) if options.quick else (CASES, REPETITIONS)
    rows = []
    for case in cases:
        rows.append(known(*case, repetitions))
        report("Known correlation", rows, options)
    problem = four_bar((0.02 if options.quick else 0.5) * TURN)
    cheaper = {
        "NonColliding(1e-3)": jc.integrator.NonColliding(1e-3),
        "steps of 40 us": jc.integrator.FixedStep(4e-5, "semi_implicit"),
        "steps of 100 us": jc.integrator.FixedStep(1e-4, "semi_implicit"),
    }
    rows = []
    for name in list(cheaper)[: 1 if options.quick else 3]:
        rows += mechanism(name, problem, cheaper[name], 512 if options.quick else 1024)
        report("Mechanisms", rows, options)
    sign("benchmarks.claims.multi_fidelity", options.json)


if __name__ == "__main__":
    main()
