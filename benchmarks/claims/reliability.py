"""How many runs a rare failure takes: published limit states, the four-bar and the antenna.

    python -m benchmarks.claims.reliability [--quick] [--only TEXT] [--json FILE]

Limit states: seven of tests/rigs/limit_states.py, to a coefficient of variation of 10 % (a slow
test holds all 26 to their intervals). The runs are all of them, those of the search for design
points too (a run with slopes counts as one for each variable more), beside those of plain Monte
Carlo to the same error, (1 - P) / (P 0.1^2). "off" is the distance from the reference in standard
errors. What one run tells of its own error is held against studies with other seeds: their scatter
about their mean, the coefficient of variation that they tell (root mean square), and how many of
their 95 % intervals hold the reference.

Mechanisms: the four-bar (two turns' error of the follower, clearance and four lengths with standard
deviations of a third of 20 um) and the antenna (four clearances, two joints radial and axial). A
threshold that fails often is asked as well and compared with plain Monte Carlo, for nobody can run
that of the rare one.
"""

import functools
import time
from typing import Any

import numpy as np

import jaxclear as jc
from benchmarks.measure import run_tables
from jaxclear.scenes.antenna import BASE, TIP, antenna
from jaxclear.scenes.four_bar import four_bar
from tests.rigs.limit_states import case

ACCURACY = 0.1
CHOSEN = ("RP8", "RP22", "RP57", "RP89", "RP111", "Four-branch serial system", "R-S")
MOST_RUNS = 400_000
TURN = 2 * np.pi / 10.0
DEVIATION = 20e-6 / 3
Normal, Above = jc.distribution.Normal, jc.limit_state.Above
# Rare thresholds [m, rad].
FOLLOWER, POINTING = 190e-6, 10.29e-3
# The frequent threshold is that which this share of plain samples stays below.
OFTEN, PLAIN = 0.98, 2048
# Studies with other seeds that tell how far one scatters.
SEEDS = 8
STEP, SECONDS, SAVES = 1e-3, 0.5, 51


def plain_runs(probability: float) -> float:
    return (1 - probability) / (probability * ACCURACY**2)


def over_seeds(ask, low: float, high: float, seeds: int) -> dict:
    """What studies by `ask(seed)` scatter, tell and hold of a reference from `low` to `high`."""
    found = [ask(seed) for seed in range(1, seeds + 1)]
    values, told = np.array([(own.probability, own.variation) for own in found]).T
    held = [own.interval[0] <= high and low <= own.interval[1] for own in found]
    return {
        f"scatter over {seeds} seeds": float(values.std(ddof=1) / values.mean()),
        "told": float(np.sqrt(np.mean(told**2))),
        "intervals that hold": int(np.sum(held)),
        "runs in the mean": float(np.mean([own.runs for own in found])),
    }


def together(seeds: int) -> list[dict]:
    """All limit states together: scatter over what is told, and intervals that hold."""
    rows = limit_states(seeds)
    shares = np.array([row[f"scatter over {seeds} seeds"] / row["told"] for row in rows])
    return [
        {
            "limit states": len(rows),
            "scatter over told, root mean square": float(np.sqrt(np.mean(shares**2))),
            "intervals that hold [%]": 100
            * sum(row["intervals that hold"] for row in rows)
            / (seeds * len(rows)),
        }
    ]


@functools.cache
def limit_states(seeds: int) -> list[dict]:
    rows = []
    for name in CHOSEN:
        problem, limit, reference = case(name)
        begun = time.process_time()
        found = jc.reliability(problem, limit, variation=ACCURACY, most_runs=MOST_RUNS)
        spent = time.process_time() - begun
        print(f"{name}: {found.sentence()}", flush=True)
        nearest = np.clip(found.probability, reference["low"], reference["high"])
        form = found.estimates["form"].value
        ask = lambda seed, problem=problem, limit=limit: jc.reliability(
            problem, limit, variation=ACCURACY, most_runs=MOST_RUNS, seed=seed
        )
        rows.append(
            {
                "case": name,
                "variables": len(problem.names),
                "reference": reference["published"],
                "probability": found.probability,
                "coefficient of variation": found.variation,
                "off [standard errors]": float(
                    (found.probability - nearest) / (found.variation * found.probability)
                ),
                "within 95 %": bool(
                    found.interval[0] <= reference["high"] and reference["low"] <= found.interval[1]
                ),
                "method": found.method,
                "design points": len(found.points),
                "FORM": form,
                "runs": found.runs,
                "plain Monte Carlo": round(plain_runs(reference["published"])),
                "times fewer": plain_runs(reference["published"]) / found.runs,
                "CPU [s]": spent,
            }
            | over_seeds(ask, reference["low"], reference["high"], seeds)
        )
    return rows


def four_bar_problem() -> jc.Problem:
    saves = 201
    ideal = jc.simulate(four_bar("ideal"), 2 * TURN, save=saves)
    places = {
        "clearance": lambda rig: rig.connections["B"].joint.clearance,
        "crank length": lambda rig: rig.connections["A"].parent.at[0],
        "coupler length": lambda rig: rig.connections["B"].parent.at[0],
        "follower length": lambda rig: rig.connections["B"].child.at[0],
        "ground length": lambda rig: rig.connections["D"].parent.at[0],
    }
    error = jc.response.PositionError("follower", ideal.body("follower").com, axes=(0, 1))
    return jc.Problem(
        four_bar("spatial", 0.2e-3, wear=False),
        {"follower error": error},
        {name: jc.Variable(where, Normal(DEVIATION)) for name, where in places.items()},
        duration=2 * TURN,
        save=saves,
        integrator=jc.integrator.FixedStep(2e-5, "semi_implicit"),
    )


def antenna_problem() -> jc.Problem:
    places = {}
    for joint in ("J1", "J2"):
        places[f"{joint} radial"] = lambda rig, joint=joint: rig.connections[joint].joint.clearance
        places[f"{joint} axial"] = lambda rig, joint=joint: (
            rig.connections[joint].joint.flange.clearance
        )
    return jc.Problem(
        antenna(),
        {"pointing error": jc.response.PointingAngle(TIP, BASE, through=("J1", "J2"))},
        {name: jc.Variable(where, Normal(DEVIATION)) for name, where in places.items()},
        duration=SECONDS,
        save=SAVES,
        integrator=jc.integrator.NonColliding(STEP),
    )


def mechanism(name: str, problem: jc.Problem, rare: float) -> list[dict]:
    """The rare threshold, and one that fails often beside plain Monte Carlo."""
    (response,) = problem.response_names
    drawn = jc.monte_carlo(problem, PLAIN, seed=7, sampling="random").responses[response]
    often = float(f"{np.nanquantile(drawn, OFTEN):.4g}")
    rows = []
    for threshold in (rare, often):
        begun = time.process_time()
        found = jc.reliability(problem, Above(response, threshold), variation=ACCURACY)
        spent = time.process_time() - begun
        share = np.mean(drawn > threshold)
        spread = np.sqrt((1 - share) / (share * PLAIN)) if share > 0 else None
        limit = Above(response, threshold)
        ask = lambda seed, limit=limit: jc.reliability(
            problem, limit, variation=ACCURACY, seed=seed
        )
        # No other reference than the studies' own mean: nobody runs that many.
        seeds = over_seeds(ask, 0.0, 1.0, SEEDS)
        del seeds["intervals that hold"]
        rows.append(
            {
                "mechanism": name,
                f"{response} above": threshold,
                "probability": found.probability,
                "coefficient of variation": found.variation,
                "method": found.method,
                "runs": found.runs,
                "FORM": found.estimates["form"].value,
                "SORM (Tvedt)": found.estimates["tvedt"].value,
                "leave-one-out R2": found.surface.quality[response] if found.surface else None,
                f"plain Monte Carlo, {PLAIN} runs": share,
                "its coefficient of variation": spread,
                "plain Monte Carlo's runs to 10 %": round(plain_runs(found.probability)),
                "CPU [s]": spent,
            }
            | seeds
        )
        print(found.sentence(), flush=True)
    return rows


def seeds_of(options: Any) -> int:
    return 2 if options.quick else SEEDS


TABLES = {
    "reliability: limit states": lambda options: limit_states(seeds_of(options)),
    "reliability: over seeds": lambda options: together(seeds_of(options)),
    "reliability: four-bar": lambda _: mechanism("four-bar", four_bar_problem(), FOLLOWER),
    "reliability: antenna": lambda _: mechanism("antenna", antenna_problem(), POINTING),
}

if __name__ == "__main__":
    run_tables(TABLES)
