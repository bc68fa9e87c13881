"""Errors of statistics and of Sobol' indices beside other libraries', at equal runs.

    python -m benchmarks.claims.sampling [--quick] [--parts statistics index] [--repetitions N]
        [--json FILE]

Five functions of six variables: a stack of parts, a curved one, one with a kink, a heavy-tailed one
and one that rattles. jaxclear's mean, standard deviation, 95 % quantile and yield stand beside
those of one scrambled Sobol' sequence in one piece (scipy), which tells no error, and of a randomly
shifted one (OpenTURNS); its Sobol' indices beside SALib's and OpenTURNS's. Errors are root mean
squares over `--repetitions` seeds, those of indices over all variables and both kinds; "held" is
how many of jaxclear's 95 % intervals hold the truth.
"""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import openturns as ot
import SALib.analyze.sobol
import SALib.sample.sobol
from scipy import special, stats

import jaxclear as jc
from benchmarks.measure import arguments, report, sign

VARIABLES = 6
SLOPES = jnp.arange(1.0, VARIABLES + 1.0)
SIZE = float(np.linalg.norm(np.arange(1, VARIABLES + 1)))
RUNS = (256, 1024, 4096)
# Of indices: base samples, of which each takes eight runs.
BASES = (32, 128, 512)
SHARE, QUANTILE = 0.9, 0.95


def stack(x):
    """Lengths between -1 and 1, one squared."""
    return x @ SLOPES + 3.0 * x[..., 0] ** 2


def curved(z):
    return z @ SLOPES / SIZE + 0.15 * z[..., 5] * z[..., 4] + 0.05 * z[..., 5] ** 2


def kinked(z):
    return jnp.abs(z @ SLOPES / SIZE) + 0.1 * z[..., 0]


def heavy(z):
    return jnp.exp(z @ SLOPES / SIZE)


def rattling(x):
    return stack(x) + 5.0 * jnp.sin(1e6 * (x @ (SLOPES + 0.3)))


UNIFORM, NORMAL = jc.distribution.Uniform(1.0), jc.distribution.Normal(1.0)
FUNCTIONS: dict[str, tuple[Callable, Any]] = {
    "stack": (stack, UNIFORM),
    "curved": (curved, NORMAL),
    "kinked": (kinked, NORMAL),
    "heavy-tailed": (heavy, NORMAL),
    "rattling": (rattling, UNIFORM),
}


def problem_of(function: Callable, law: Any) -> jc.Problem:
    names = [f"x{i}" for i in range(VARIABLES)]
    of = lambda **x: function(jnp.stack(list(x.values()), axis=-1))
    return jc.FunctionProblem(of, {name: jc.Dimension(0.0, law) for name in names})


def at_shares(function: Callable, law: Any) -> Callable[[np.ndarray], np.ndarray]:
    """The function of points (samples, variables) of the unit cube."""
    compiled = jax.jit(function)
    own = special.ndtri if law is NORMAL else lambda share: 2.0 * share - 1.0
    return lambda shares: np.asarray(compiled(own(np.clip(shares, 1e-12, 1 - 1e-12))))


def numbers(values: np.ndarray, limit: float) -> np.ndarray:
    """Mean, standard deviation, quantile, yield of a sample."""
    quantile = np.quantile(values, QUANTILE)
    return np.array([values.mean(), values.std(ddof=1), quantile, np.mean(values <= limit)])


def scrambled(points: int, dimensions: int, seed: int) -> np.ndarray:
    return stats.qmc.Sobol(dimensions, rng=np.random.default_rng(seed)).random(points)


def shifted(points: int, seed: int) -> np.ndarray:
    """OpenTURNS's sequence with a random shift."""
    ot.RandomGenerator.SetSeed(seed)
    law = ot.JointDistribution([ot.Uniform(0.0, 1.0)] * VARIABLES)
    plan = ot.LowDiscrepancyExperiment(ot.SobolSequence(), law, points)
    plan.setRandomize(True)
    return np.asarray(plan.generate())


def statistics_rows(name: str, repetitions: int, sizes: tuple[int, ...]) -> list[dict[str, Any]]:
    """A row for each number of runs and each statistic."""
    function, law = FUNCTIONS[name]
    problem, by_share = problem_of(function, law), at_shares(function, law)
    large = np.concatenate([by_share(scrambled(1 << 18, VARIABLES, 10_000 + i)) for i in range(8)])
    limit = float(np.quantile(large, SHARE))
    truth, spread = numbers(large, limit), float(large.std())
    scale, rows = np.array([spread, spread, spread, 1.0]), []
    for runs in sizes:
        own, held, whole, other = [], [], [], []
        for seed in range(repetitions):
            study = jc.monte_carlo(problem, runs, seed=seed)
            told = (
                study.mean("response"),
                study.standard_deviation("response"),
                study.quantile("response", QUANTILE),
                study.share_within({"response": (None, limit)}),
            )
            own.append([one.value for one in told])
            held.append([one.low <= e <= one.high for one, e in zip(told, truth, strict=True)])
            whole.append(numbers(by_share(scrambled(runs, VARIABLES, seed)), limit))
            other.append(numbers(by_share(shifted(runs, seed)), limit))
        rms = [np.sqrt(np.mean(((np.array(e) - truth) / scale) ** 2, axis=0)) for e in
               (own, whole, other)]  # fmt: skip
        for i, statistic in enumerate(("mean", "standard deviation", "95 % quantile", "yield")):
            mine, one_piece, openturns = (float(e[i]) for e in rms)
            rows.append(
                {
                    "function": name,
                    "runs": runs,
                    "statistic": statistic,
                    "error": mine,
                    "over scipy in one piece": mine / one_piece,
                    "over OpenTURNS": mine / openturns,
                    "held [%]": 100 * float(np.mean(np.array(held)[:, i])),
                }
            )
    return rows


def salib_indices(by_share: Callable, base: int, seed: int) -> np.ndarray:
    """(2, variables)"""
    asked = {
        "num_vars": VARIABLES,
        "names": [str(i) for i in range(VARIABLES)],
        "bounds": [[0.0, 1.0]] * VARIABLES,
    }
    plan = SALib.sample.sobol.sample(asked, base, calc_second_order=False, seed=seed)
    found = SALib.analyze.sobol.analyze(
        asked, by_share(plan), calc_second_order=False, num_resamples=2, seed=seed
    )
    return np.array([found["S1"], found["ST"]])


def openturns_indices(by_share: Callable, base: int, seed: int) -> np.ndarray:
    """(2, variables), by Saltelli's estimator from a randomly shifted sequence."""
    ot.RandomGenerator.SetSeed(seed)
    law = ot.JointDistribution([ot.Uniform(0.0, 1.0)] * (2 * VARIABLES))
    plan = ot.LowDiscrepancyExperiment(ot.SobolSequence(), law, base)
    plan.setRandomize(True)
    both = np.asarray(plan.generate())
    first, second = both[:, :VARIABLES], both[:, VARIABLES:]
    columns = [first, second]
    for i in range(VARIABLES):
        mixed = first.copy()
        mixed[:, i] = second[:, i]
        columns.append(mixed)
    inputs = np.concatenate(columns)
    found = ot.SaltelliSensitivityAlgorithm(
        ot.Sample(inputs), ot.Sample(by_share(inputs)[:, None]), base
    )
    return np.array([found.getFirstOrderIndices(), found.getTotalOrderIndices()])


def true_indices(by_share: Callable) -> np.ndarray:
    """(2, variables), by SALib from 2^17 base samples of four seeds."""
    return np.mean([salib_indices(by_share, 1 << 17, 77 + i) for i in range(4)], axis=0)


def linear_indices() -> np.ndarray:
    """Of the parts that a sum's terms have in closed form: x_i uniform, the first squared too."""
    parts = np.arange(1.0, VARIABLES + 1.0) ** 2 / 3.0
    parts[0] += 9.0 * (1.0 / 5.0 - 1.0 / 9.0)
    return parts


def truth_of_indices(name: str, by_share: Callable) -> np.ndarray:
    """In closed form where there is one."""
    if name == "stack":
        parts = linear_indices()
        return np.array([parts, parts]) / parts.sum()
    if name == "rattling":
        # The waves belong to all variables together.
        parts, waves = linear_indices(), 12.5
        return np.array([parts, parts + waves]) / (parts.sum() + waves)
    if name == "heavy-tailed":
        shares = np.arange(1.0, VARIABLES + 1.0) ** 2 / SIZE**2
        return np.array([np.expm1(shares), math.e * -np.expm1(-shares)]) / math.expm1(1.0)
    return true_indices(by_share)


def index_rows(name: str, repetitions: int, bases: tuple[int, ...]) -> list[dict[str, Any]]:
    """A row for each number of runs."""
    function, law = FUNCTIONS[name]
    problem, by_share = problem_of(function, law), at_shares(function, law)
    truth, rows = truth_of_indices(name, by_share), []
    for base in bases:
        own, held, others = [], [], {"SALib": [], "OpenTURNS": []}
        for seed in range(repetitions):
            study = jc.sobol_indices(problem, base, seed=seed)
            told = [
                [kind["response", variable] for variable in problem.names]
                for kind in (study.first, study.total)
            ]
            own.append([[one.value for one in row] for row in told])
            # Truths that are sampled are so exact.
            near = 0.0 if name in ("stack", "rattling", "heavy-tailed") else 1e-4
            held.append(
                [
                    one.low - near - 1e-12 <= e <= one.high + near + 1e-12
                    for row, exact in zip(told, truth, strict=True)
                    for one, e in zip(row, exact, strict=True)
                ]
            )
            others["SALib"].append(salib_indices(by_share, base, seed))
            others["OpenTURNS"].append(openturns_indices(by_share, base, seed))
        rms = lambda values: float(np.sqrt(np.mean((np.array(values) - truth) ** 2)))
        mine = rms(own)
        rows.append(
            {
                "function": name,
                "runs": base * (VARIABLES + 2),
                "error": mine,
                "over SALib": mine / rms(others["SALib"]),
                "over OpenTURNS": mine / rms(others["OpenTURNS"]),
                "held [%]": 100 * float(np.mean(held)),
            }
        )
    return rows


def main() -> None:
    more = {"nargs": "*", "default": ["statistics", "index"]}
    options = arguments(str(__doc__), repetitions={"type": int, "default": 400}, parts=more)
    names = list(FUNCTIONS)[: 1 if options.quick else None]
    repetitions = 4 if options.quick else options.repetitions
    few = 1 if options.quick else None
    titles = "Statistics beside other libraries", "Sobol' indices beside other libraries"
    for title, rows_of, sizes in (
        (titles[0], statistics_rows, RUNS),
        (titles[1], index_rows, BASES),
    ):
        if rows_of.__name__.partition("_")[0] not in options.parts:
            continue
        rows = [row for name in names for row in rows_of(name, repetitions, sizes[:few])]
        report(title, rows, options)
        sign("benchmarks.claims.sampling", options.json, [title])


if __name__ == "__main__":
    main()
