"""Which variable makes a response spread: `jaxclear.sobol_indices`, shares of its variance.

The first-order index of a variable is the share of the variance that goes if it is fixed; the total
index is the share that stays if all others are fixed, interplay counted in. Estimated by exchanging
one column between two samples, with errors from independent scramblings.

Source: first order: Saltelli et al. 2010, Comput. Phys. Commun. 181, 259,
doi:10.1016/j.cpc.2009.09.018, eq. (b) of table 2; total: Jansen 1999, Comput. Phys. Commun. 117,
35, doi:10.1016/S0010-4655(98)00154-4.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import check_flags
from jaxclear.ground.shown import AbstractShown, left_out
from jaxclear.ground.table import as_table
from jaxclear.integrators import Outcome
from jaxclear.studies.base import AbstractProblem
from jaxclear.studies.batch import evaluate_all
from jaxclear.studies.datasets import of_indices
from jaxclear.studies.endless import refuse_endless
from jaxclear.studies.sampling import check_sampled, checked_scramblings, groups
from jaxclear.studies.scrambling import scores_by_scrambling
from jaxclear.studies.statistics.scrambled import Statistic, jackknifed
from jaxclear.studies.warned import told


class SobolIndices(AbstractShown):
    """`first` and `total` indices [1] by (response, variable), each with its 95 % interval; `runs`
    that they took, how many of the base samples `failed`, and of what runs warn (`warnings`)."""

    problem: AbstractProblem
    first: dict[tuple[str, str], Statistic]
    total: dict[tuple[str, str], Statistic]
    runs: int = eqx.field(static=True)
    failed: int = eqx.field(static=True)
    warnings: tuple[str, ...] = eqx.field(static=True, default=())

    def _shown(self):
        said = [*left_out(self.failed, "base samples"), *self.warnings]
        return self.table(), *said

    def to_dataset(self) -> Any:
        """Both indices with their intervals as an xarray Dataset by response and variable, with
        provenance."""
        return of_indices(self)

    def table(self) -> Any:
        """A pandas table by response and variable: both indices with their errors."""
        rows = [
            {
                "response": response,
                "variable": variable,
                "first order": first.value,
                "first order error": first.error,
                "total": self.total[response, variable].value,
                "total error": self.total[response, variable].error,
            }
            for (response, variable), first in self.first.items()
        ]
        units = {"first order": "1", "total": "1"}
        return as_table(rows, index=["response", "variable"], units=units)


@answering
def sobol_indices(
    problem: AbstractProblem,
    samples: int = 512,
    *,
    seed: int = 0,
    scramblings: int | None = None,
    progress_bar: bool = False,
) -> SobolIndices:
    """Sobol' indices of every response by every variable, from `samples` (variables + 2) runs.

    Raises `ValueError` for correlated variables: their shares of a variance are not defined, and
    `jaxclear.shapley_effects` are what to ask instead.
    """
    check_sampled(problem, samples, seed)
    check_flags("sobol_indices", progress_bar=progress_bar)
    parts = checked_scramblings("sobol_indices", samples, scramblings)
    if not problem.inputs.independent:
        raise ValueError(
            "Sobol' indices need independent variables; those of this problem are correlated, so "
            "that a variance has no shares. Shapley effects tell what each then contributes: "
            "jaxclear.shapley_effects."
        )
    count = len(problem.names)
    group = np.sort(groups(samples, parts))
    normal = scores_by_scrambling(np.bincount(group, minlength=parts), 2 * count, seed)
    base, other = normal[:, :count], normal[:, count:]
    columns = [base, other]
    for i in range(count):
        mixed = base.copy()
        mixed[:, i] = other[:, i]
        columns.append(mixed)
    values = problem.inputs.values(jnp.asarray(np.concatenate(columns)))
    found = evaluate_all(problem, values, progress_bar=progress_bar, label="Sobol' indices")
    reached = (np.asarray(found.outcome) == Outcome.REACHED).reshape(len(columns), -1)
    refuse_endless(problem, found.responses, "variance")
    first, total = {}, {}
    good = np.all(reached, axis=0)
    for name in problem.response_names:
        rows = np.asarray(found.responses[name]).reshape(len(columns), -1)[:, good].T
        for i, variable in enumerate(problem.names):
            three = rows[:, [0, 1, 2 + i]]
            first[name, variable] = jackknifed(_first, three, group[good])
            total[name, variable] = jackknifed(_total, three, group[good])
    warnings = told(problem, found.checks, reached.ravel())
    return SobolIndices(problem, first, total, len(values), int(np.sum(~good)), warnings)


def _first(rows: np.ndarray) -> float:
    """From responses (samples, 3) of both samples and of the mixed one."""
    base, other, mixed = rows.T
    variance = np.var(rows[:, :2])
    mean = rows[:, :2].mean()
    return float(np.mean((other - mean) * (mixed - base)) / variance) if variance > 0 else 0.0


def _total(rows: np.ndarray) -> float:
    base, _, mixed = rows.T
    variance = np.var(rows[:, :2])
    return float(0.5 * np.mean((base - mixed) ** 2) / variance) if variance > 0 else 0.0
