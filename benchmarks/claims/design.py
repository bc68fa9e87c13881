"""What a design by gradients costs, and how good it is: against the closed form on a linear stack
and on a four-bar over positions, and against a global search on Monte Carlo (scipy's differential
evolution, the same points for every candidate, and from its cheapest candidate on COBYQA on the
same points, because an evolution comes near the ends of many bounds at once only slowly) on the
antenna and the four-bar, beside tolerances that are all equal. Limits of both designs are asked of
the same fresh samples: a search on few points keeps them on these.

    python -m benchmarks.claims.design [--quick] [--scenes antenna four-bar] [--json FILE]

CPU seconds of warm programs; one run of the problem is one sample.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.optimize import NonlinearConstraint, differential_evolution, minimize

import jaxclear as jc
from benchmarks.measure import report, sign
from jaxclear.commands.design import QUESTIONS, DesignQuestion
from jaxclear.studies.store.batch import evaluate_all
from jaxclear.studies.design.question import TOLERANCE
from jaxclear.studies.design.population import points
from tests.rigs import positioned_four_bar

# Points of a candidate of the global search, its candidates in a generation, and generations.
POINTS = {"antenna": 32, "four-bar": 16}
CANDIDATES = 24
GENERATIONS = {"antenna": 80, "four-bar": 30}
EQUAL_CANDIDATES, EQUAL_GENERATIONS = 12, 20
# Candidates of the search that ends it.
LAST_CANDIDATES = 200
# What a broken limit adds, in costs for each part of it.
PENALTY, FRESH = 20.0, 2048


class Evolution:
    """The global search: candidates are judged by runs alone."""

    def __init__(self, found: Any, count: int, equal: bool):
        self.question, self.problem, self.equal = found.question, found.problem, equal
        self.normal = points(len(found.problem.names), count, 77, matched=True).normal
        self.runs, self.cpu, self.best, self.best_place = 0, 0.0, np.inf, np.zeros(0)
        kinds = [choice.kind for choice in self.question.freedom.choices]
        self.tolerances = [i for i, kind in enumerate(kinds) if kind == TOLERANCE]
        self.nominals = [i for i, kind in enumerate(kinds) if kind != TOLERANCE]

    @property
    def size(self):
        return (1 if self.equal else len(self.tolerances)) + len(self.nominals)

    def place(self, numbers):
        """Places of the free numbers from those that are searched."""
        place = np.zeros(len(self.tolerances) + len(self.nominals))
        split = self.size - len(self.nominals)
        place[self.tolerances], place[self.nominals] = numbers[:split], numbers[split:]
        return place

    def __call__(self, columns):
        """Cost with penalties (candidates,) of `columns` (numbers, candidates)."""
        places = [self.place(own) for own in columns.T]
        told = self.evaluate(places)
        return np.array([cost + PENALTY * np.maximum(excess, 0.0).sum() for cost, excess in told])

    def evaluate(self, places):
        """(cost, excesses) of candidates; the cheapest that keeps its limits is remembered."""
        begun = time.process_time()
        values = [np.asarray(self.question.values(jnp.asarray(p), self.normal)) for p in places]
        flat = jnp.asarray(np.concatenate(values))
        found = evaluate_all(self.problem, flat, chunk=32)
        self.runs += len(flat)
        parts = {k: np.asarray(v).reshape(len(places), -1) for k, v in found.responses.items()}
        told = []
        for i, place in enumerate(places):
            own = {name: part[i] for name, part in parts.items()}
            excess = np.nan_to_num(self.excess(place, values[i], own), nan=1.0)
            cost = float(self.question.price(jnp.asarray(place)))
            if np.maximum(excess, 0.0).sum() <= 1e-4 and cost < self.best:
                self.best, self.best_place = cost, place
            told.append((cost, excess))
        self.cpu += time.process_time() - begun
        return told

    def ended(self):
        """The cheapest, from the best so far on by a search that learns slopes; infinite where no
        candidate so far keeps its limits."""
        if not len(self.best_place):
            return np.inf
        price = lambda place: float(self.question.price(jnp.asarray(place)))
        known: dict[bytes, np.ndarray] = {}

        def limits(place):
            # It asks again for what it has asked.
            if place.tobytes() not in known:
                known[place.tobytes()] = self.evaluate([place])[0][1]
            return known[place.tobytes()]

        minimize(
            price,
            self.best_place,
            method="COBYQA",
            bounds=[(0.0, 1.0)] * len(self.best_place),
            constraints=NonlinearConstraint(limits, -np.inf, 0.0),
            options={
                "maxfev": LAST_CANDIDATES,
                "initial_tr_radius": 0.1,
            },
        )
        return self.best

    def excess(self, place, values, responses):
        """By how much each limit is broken, as a share of its bound."""
        nominal, tolerance = self.question.freedom.decoded(jnp.asarray(place))
        found = []
        for limit in self.question.limits:
            bound = float(limit.bound())
            if limit.extreme():
                i = self.problem.names.index(limit.response)
                found.append(1 - float(nominal[i] - tolerance[i]) / bound)
                continue
            own = responses[limit.response]
            found.append((own.mean() + float(limit.deviations) * own.std()) / bound - 1)
        return np.array(found)

    def search(self, candidates, generations):
        """The cheapest candidate that keeps its limits."""
        differential_evolution(
            self,
            [(0.0, 1.0)] * self.size,
            maxiter=generations - 1,
            popsize=max(candidates // self.size, 2),
            tol=1e-8,
            rng=np.random.default_rng(5),
            polish=False,
            vectorized=True,
            updating="deferred",
        )
        return self.best


def fresh_excess(found: Any, place: np.ndarray) -> float:
    """The largest excess [%] of the limits on spreads of a design, at fresh points, by runs
    alone."""
    normal = points(len(found.problem.names), FRESH, 99).normal
    values = np.asarray(found.question.values(jnp.asarray(place), normal))
    runs = evaluate_all(found.problem, jnp.asarray(values), chunk=32)
    shares = []
    for limit in found.limits:
        if not limit.extreme():
            own = np.asarray(runs.responses[limit.response])
            spread = own.mean() + float(limit.deviations) * own.std(ddof=1)
            shares.append(100 * (spread / float(limit.bound()) - 1))
    return max(shares)


def scene_row(name: str, asked: DesignQuestion, options: Any) -> dict[str, Any]:
    """A design of a scene beside the global search."""
    begun = time.process_time()
    found = asked.designed()
    first = time.process_time() - begun
    begun = time.process_time()
    found = asked.designed()
    spent = time.process_time() - begun
    tables = {"variables": found.table(), "limits": found.limit_table(), "rounds": found.history()}
    for what, table in tables.items():
        report(f"Design of the {name}: {what}", table.to_dict("records"), options)
    quick = options.quick
    search = Evolution(found, POINTS[name], equal=False)
    evolved = search.search(CANDIDATES, 4 if quick else GENERATIONS[name])
    best = search.ended()
    equal = Evolution(found, POINTS[name], equal=True)
    alike = equal.search(EQUAL_CANDIDATES, 4 if quick else EQUAL_GENERATIONS)
    return {
        "scene": name,
        "cost": found.cost,
        "cost by evolution": evolved,
        "cost by global search": best,
        "over the global search [%]": 100 * (found.cost / best - 1),
        "cost of equal tolerances": alike,
        "saving over equal [%]": 100 * (1 - found.cost / alike),
        "holds": found.holds,
        "excess on fresh samples [%]": fresh_excess(found, found.rounds[-1].candidate.place),
        "excess of the global search's [%]": (
            fresh_excess(found, search.best_place) if len(search.best_place) else None
        ),
        "runs": found.runs,
        "runs of global search": search.runs,
        "CPU s": spent,
        "CPU s with compilation": first,
        "CPU s of global search": search.cpu,
        "times cheaper": search.cpu / spent,
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--scenes", nargs="*", default=list(QUESTIONS), choices=list(QUESTIONS))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    stacks = (3,) if options.quick else (3, 6, 12)
    report("Linear stacks", [stack_row(count) for count in stacks], options)
    cranks = positioned_four_bar.CRANKS[: 1 if options.quick else None]
    report("A four-bar at a position", [position_row(own) for own in cranks], options)
    parts = ["Linear stacks", "A four-bar at a position"]
    title, rows = "Scenes against a global search", []
    if options.json is not None and options.json.exists():
        known = json.loads(options.json.read_text()).get(title, [])
        rows = [row for row in known if row["scene"] not in options.scenes]
    for name in options.scenes:
        rows.append(scene_row(name, QUESTIONS[name](), options))
        report(title, rows, options)
        parts += [f"{title}, {name}", f"Design of the {name}"]
    sign("benchmarks.claims.design", options.json, parts)


if __name__ == "__main__":
    main()
