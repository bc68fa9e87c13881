"""What a design by gradients costs, and how good it is: against the closed form on linear stacks
and on a four-bar over positions; and designs of the four-bar and the antenna in motion, whose
limits are asked of fresh samples.

    python -m benchmarks.claims.design [--quick] [--scenes antenna four-bar] [--json FILE]

CPU seconds of warm programs; one run of the problem is one sample.
"""

import time
from typing import Any

import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import report, run_tables, stored_rows
from jaxclear.commands.design import QUESTIONS, DesignQuestion
from jaxclear.studies.store.batch import evaluate_all
from jaxclear.studies.design.population import points
from tests.rigs import positioned_four_bar

# Samples that a design has not seen.
FRESH = 2048


def fresh_excess(result: Any) -> float:
    """The largest excess [%] of the limits on spreads of a design, at fresh points, by runs
    alone."""
    normal = points(len(result.problem.names), FRESH, 99).normal
    place = result.round.candidate.place
    values = np.asarray(result.question.values(jnp.asarray(place), normal))
    runs = evaluate_all(result.problem, jnp.asarray(values), chunk=32)
    shares = []
    for limit in result.limits:
        if not limit.extreme():
            response = np.asarray(runs.responses[limit.response])
            spread = response.mean() + float(limit.deviations) * response.std(ddof=1)
            shares.append(100 * (spread / float(limit.bound()) - 1))
    return max(shares)


def scene_row(name: str, question: DesignQuestion, options: Any) -> dict[str, Any]:
    """A design of a scene."""
    seconds = []
    for _ in range(2):
        start = time.process_time()
        result = question.designed()
        seconds.append(time.process_time() - start)
    tables = {
        "variables": result.table(),
        "limits": result.limit_table(),
        "rounds": result.history(),
    }
    for what, table in tables.items():
        report(f"Design of the {name}: {what}", table.to_dict("records"), options)
    return {
        "scene": name,
        "cost": result.cost,
        "holds": result.holds,
        "excess on fresh samples [%]": fresh_excess(result),
        "runs": result.runs,
        "CPU s": seconds[1],
        "CPU s with compilation": seconds[0],
    }


def stack_row(count: int) -> dict[str, Any]:
    """A linear stack of so many dimensions with reciprocal costs against its closed form."""
    slopes = np.where(np.arange(count) % 2, 1.0, -1.0) * (1 + np.arange(count) % 3)
    priced = 1e-4 * (1 + np.arange(count) % 4)
    names = [f"x{i}" for i in range(count)]
    problem = jc.FunctionProblem(
        lambda **x: sum(s * x[n] for s, n in zip(slopes, names, strict=True)),
        {name: jc.Dimension(0.02, tolerance=2e-5) for name in names},
    )
    room, middle = 1e-4, float(slopes.sum() * 0.02)
    limit = jc.limit.MeanAndDeviation("response", at_most=middle + room, deviations=3)
    costs = {n: jc.cost.Reciprocal(b) for n, b in zip(names, priced, strict=True)}
    begun = time.process_time()
    found = jc.design(problem, costs, limit, tolerance=dict.fromkeys(names, (1e-6, 2e-4)))
    spent = time.process_time() - begun
    spread = float(jc.distribution.TruncatedNormal(1 / 3, bound=1.0).deviation())
    shape = (priced / slopes**2) ** (1 / 3)
    best = shape * room / (3 * spread * np.linalg.norm(slopes * shape))
    cost = (priced / best).sum()
    return {
        "dimensions": count,
        "cost": found.cost,
        "error of cost [1]": abs(found.cost / cost - 1),
        "error of price [%]": 100 * abs(found.prices[0] / (cost / room) - 1),
        "CPU s with compilation": spent,
    }


def position_row(crank: float) -> dict[str, Any]:
    """A four-bar at one position of its crank against its closed form."""
    best = positioned_four_bar.optimum(crank)
    begun = time.process_time()
    found = positioned_four_bar.designed(crank)
    return {
        "crank [rad]": crank,
        "cost": found.cost,
        "error of cost [1]": abs(found.cost / best.cost - 1),
        "error of price [%]": 100 * abs(found.prices[0] / best.price - 1),
        "holds": found.holds,
        "samples": found.runs,
        "CPU s with compilation": time.process_time() - begun,
    }


def stack_rows(options: Any) -> list[dict[str, Any]]:
    return [stack_row(count) for count in ((3,) if options.quick else (3, 6, 12))]


def position_rows(options: Any) -> list[dict[str, Any]]:
    cranks = positioned_four_bar.CRANKS[: 1 if options.quick else None]
    return [position_row(crank) for crank in cranks]


def scene_rows(options: Any) -> list[dict[str, Any]]:
    """Of these scenes anew, of others as they stand."""
    rows = [row for row in stored_rows(SCENES, options) if row["scene"] not in options.scenes]
    return rows + [scene_row(name, QUESTIONS[name](), options) for name in options.scenes]


SCENES = "Designs of scenes"
TABLES = {
    "Linear stacks": stack_rows,
    "A four-bar at a position": position_rows,
    SCENES: scene_rows,
}

if __name__ == "__main__":
    names = list(QUESTIONS)
    run_tables(TABLES, scenes={"nargs": "*", "default": names, "choices": names})
