"""Which of many variables matter at all, from few runs: `jaxclear.screening`, the method of Morris.

Trajectories through the unit cube move one variable at a time. The elementary effect of a variable
is what its move changes in a response, over the share of the population that it moved through, so
that each point stands for equally many parts whatever the distributions. Starts and steps are drawn
anew for each move, from a third to two thirds of the population: steps of one length, as a grid has
them, do not see a response that repeats itself after such a step. What leaves the cube on one side
comes back on the other, so that all shares are equally likely before a move and after it.

Source: Morris 1991, Technometrics 33, 161, doi:10.1080/00401706.1991.10484804; mu*: Campolongo,
Cariboni & Saltelli 2007, Environ. Model. Softw. 22, 1509, doi:10.1016/j.envsoft.2006.10.004; steps
of different lengths: Campolongo, Saltelli & Cariboni 2011, Comput. Phys. Commun. 182, 978,
doi:10.1016/j.cpc.2010.12.039.
"""

from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_flags
from jaxclear.studies.answer import RESPONSE, VARIABLE, AbstractAnswer, Column, Stated
from jaxclear.studies.infinite_responses import refuse_infinite, successes
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_warnings import sentences_among
from jaxclear.studies.sampling import all_values, check_sampled
from jaxclear.studies.scrambling import normal_scores
from jaxclear.studies.statistics.scrambled import Statistic, deviation, jackknifed
from jaxclear.studies.store.batch import evaluate_all
from jaxclear.studies.store.store import stored

# Shares of the population [1] that a move goes through: their mean is that of Morris' steps.
SHORTEST, LONGEST = 1 / 3, 2 / 3


class Screening(AbstractAnswer):
    """Elementary effects of variables on responses, by (response, variable), in the response's
    unit: `mu_star`, their mean size, tells whether a variable matters; `sigma`, their deviation,
    whether its effect hangs on where it and the others stand. `effects` (trajectories,) are nan
    where a run failed, of which there are `failed` among `runs`."""

    problem: Problem
    mu_star: dict[tuple[str, str], Statistic]
    sigma: dict[tuple[str, str], Statistic]
    effects: dict[tuple[str, str], np.ndarray]
    runs: int = eqx.field(static=True)
    failed: int = eqx.field(static=True)
    warnings: tuple[str, ...] = eqx.field(static=True, default=())

    def sentence(self) -> str:
        """Which variable matters most to each response, and how many runs failed."""
        sentences = []
        for name in self.problem.response_names:
            effects = {v: self.mu_star[name, v].value for v in self.problem.variable_names}
            some = {v: value for v, value in effects.items() if np.isfinite(value)}
            if some:
                sentences.append(f'"{name}" moves most with "{max(some, key=lambda v: some[v])}".')
        text = f"{self.runs} runs"
        text += f", {self.failed} failed: their moves are left out." if self.failed else "."
        return " ".join([text, *sentences])

    def _stated(self):
        over, units = (RESPONSE, VARIABLE), self.problem.units()
        read = lambda statistics, part: {key: getattr(one, part) for key, one in statistics.items()}
        columns = {
            "unit": Column(over, {key: units[key[0]] for key in self.mu_star}),
            "mu*": Column(over, read(self.mu_star, "value"), error=read(self.mu_star, "error")),
            "sigma": Column(over, read(self.sigma, "value"), error=read(self.sigma, "error")),
        }
        numbers = {"runs": self.runs, "failed": self.failed}
        return Stated("screening", columns, self.problem, self.warnings, numbers)


@answering
@stored("a screening")
def screening(
    problem: Problem,
    trajectories: int = 16,
    *,
    seed: int = 0,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> Screening:
    """Find the variables that matter, by the method of Morris.

    It takes `trajectories` times (variables + 1) runs. Trajectories are independent; 95 % intervals
    follow from their differences. Correlated variables are moved by their independent numbers. A
    move with a failed run is left out.

    Args:
        problem: the problem.
        trajectories: number of trajectories; 16 by default.
        seed: seed of the random numbers; 0 by default.
        store: folder that keeps the runs; None (default) for none.
        progress_bar: whether to show the progress; False by default.

    Returns:
        The `Screening`.

    Raises:
        ValueError: if an argument is wrong.
    """
    check_sampled(problem, trajectories, seed)
    check_count("trajectories of screening", trajectories, at_least=2)
    check_flags("screening", progress_bar=progress_bar)
    together = list(problem.groups.values())
    shares = _trajectories(together, trajectories, seed)
    values = jnp.asarray(all_values(problem, normal_scores(shares)))
    result = evaluate_all(problem, values, progress_bar=progress_bar, label="screening")
    refuse_infinite(problem, result.responses, "elementary effect")
    columns = {name: np.asarray(result.responses[name], float) for name in problem.response_names}
    good, columns = successes(problem, result.outcome, columns)
    moves = np.diff(shares.reshape(trajectories, -1, shares.shape[1]), axis=1)
    effects, mu_star, sigma = {}, {}, {}
    for name, responses in columns.items():
        path_values = responses.reshape(trajectories, -1)
        for variable, (i, *_) in problem.groups.items():
            # Each trajectory moves each variable once, and its numbers by the same share.
            moved = np.argmax(np.abs(moves[:, :, i]), axis=1)[:, None]
            change, share = (
                np.take_along_axis(rows, moved, axis=1)[:, 0]
                for rows in (np.diff(path_values, axis=1), moves[:, :, i])
            )
            effects[name, variable] = change / share
            defined = effects[name, variable][np.isfinite(change)]
            group = np.arange(len(defined))
            squares = (defined - defined.mean()) ** 2
            mu_star[name, variable] = jackknifed(np.mean, np.abs(defined), group)
            sigma[name, variable] = jackknifed(deviation, defined, group, squares, grouped=True)
    counts = len(values), int((~good).sum())
    return Screening(
        problem, mu_star, sigma, effects, *counts, sentences_among(problem, result.checks, good)
    )


def _trajectories(groups: list[range], count: int, seed: int) -> np.ndarray:
    """Shares [1] of the trajectories' points, (count (groups + 1), variables), of which those of a
    group move together."""
    rng, variables = np.random.default_rng(seed), len(groups)
    start = rng.random((count, 1, sum(map(len, groups))))
    step = rng.uniform(SHORTEST, LONGEST, (count, 1, variables))
    # The variable that moves first has moved at all points but the first.
    order = rng.permuted(np.tile(np.arange(variables), (count, 1)), axis=1)[:, None]
    moved = np.arange(variables + 1)[:, None] > order
    moves = np.repeat(moved * step, [len(group) for group in groups], axis=2)
    return ((start + moves) % 1.0).reshape(-1, start.shape[2])
