"""Which variable makes a response spread: `jaxclear.sobol_indices`, shares of its variance.

The first-order index of a variable is the share of the variance that goes if it is fixed; the total
index is the share that stays if all others are fixed, interplay counted in. Estimated by exchanging
one column between two samples, with errors from independent scramblings. A polynomial takes up what
it explains, whose shares are exact: the samples of a scrambling are corrected by the polynomial
through all the others, so that no run judges a polynomial that it helped to find. What it says of
parts beyond the outermost runs is no knowledge: by how much that moves an index is in its error, or
it is left out where runs alone tell the index better.

Source: first order: Saltelli et al. 2010, Comput. Phys. Commun. 181, 259,
doi:10.1016/j.cpc.2009.09.018, eq. (b) of table 2; total: Jansen 1999, Comput. Phys. Commun. 117,
35, doi:10.1016/S0010-4655(98)00154-4; polynomials: Sudret 2008, Reliab. Eng. Syst. Saf. 93, 964,
doi:10.1016/j.ress.2007.04.002; as control variates whose coefficients come from other samples:
Avramidis & Wilson 1993, Manage. Sci. 39, 1094, doi:10.1287/mnsc.39.9.1094.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_flags
from jaxclear.ground.printing import failed_samples_sentence
from jaxclear.integrators import Outcome
from jaxclear.studies.answer import RESPONSE, VARIABLE, AbstractAnswer, Stated, with_interval
from jaxclear.studies.infinite_responses import refuse_infinite, undrawn_levels
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_warnings import sentences_among
from jaxclear.studies.sampling import check_sampled, checked_scramblings, groups
from jaxclear.studies.scrambling import scores_by_scrambling
from jaxclear.studies.statistics.scrambled import (
    ROUNDING,
    SAMPLES_A_TERM,
    UNKNOWN,
    Statistic,
    jackknifed,
)
from jaxclear.studies.store.batch import evaluate_all
from jaxclear.studies.store.store import stored
from jaxclear.studies.surface.fitting import HIGHEST
from jaxclear.studies.surface.polynomials import Expansion, levels, orthonormal, powers, products
from jaxclear.studies.surface.response_surface import ResponseSurface

# Parts beyond the outermost of n independent runs are more than this over n once in 2000 samples.
MOST_OUTSIDE = 10.0
# Terms at the most: their equations are solved once for each scrambling.
MOST_TERMS = 300


class SobolIndices(AbstractAnswer):
    """`first` and `total` indices [1] by (response, variable), each with its 95 % interval; `runs`
    that they took, how many of the base samples `failed`, and of what runs warn (`warnings`)."""

    problem: Problem
    first: dict[tuple[str, str], Statistic]
    total: dict[tuple[str, str], Statistic]
    runs: int = eqx.field(static=True)
    failed: int = eqx.field(static=True)
    warnings: tuple[str, ...] = eqx.field(static=True, default=())

    def sentence(self) -> str:
        """Which variables contribute most to the variance of each response, and how many base
        samples failed."""
        led = leading(self.total, "total index")
        return " ".join(filter(None, [led, failed_samples_sentence(self.failed, "base sample")]))

    def _stated(self):
        over = (RESPONSE, VARIABLE)
        columns = with_interval("first order", over, self.first)
        columns |= with_interval("total", over, self.total)
        numbers = {"runs": self.runs, "failed": self.failed}
        return Stated("Sobol' indices", columns, self.problem, self.warnings, numbers)


@answering
@stored("a study of Sobol' indices")
def sobol_indices(
    of: Problem | ResponseSurface,
    samples: int = 512,
    *,
    seed: int = 0,
    scramblings: int | None = None,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> SobolIndices:
    """Sobol' indices of every response by every variable.

    A variable of several numbers has one index: they are exchanged together. A problem is run
    `samples` (variables + 2) times. The indices of a surface take no run; their
    error is the variance that the surface does not explain.

    Args:
        of: the problem, or its `ResponseSurface`.
        samples: number of samples; 512 by default.
        seed: seed of the random numbers; 0 by default.
        scramblings: number of independent subsets of the sample; None (default) for the usual one.
        store: folder that keeps the runs; None (default) for none.
        progress_bar: whether to show the progress; False by default.

    Returns:
        The `SobolIndices`.

    Raises:
        ValueError: if variables are correlated (use `jaxclear.shapley_effects`), or a surface was
            not fitted over their whole spread.
    """
    surface = of if isinstance(of, ResponseSurface) else None
    problem: Any = of if surface is None else surface.problem
    check_sampled(problem, samples, seed)
    check_flags("sobol_indices", progress_bar=progress_bar)
    parts = checked_scramblings("sobol_indices", samples, scramblings)
    if not problem.inputs.independent:
        raise ValueError(
            "Sobol' indices need independent variables; those of this problem are correlated, so "
            "that a variance has no shares. Shapley effects tell what each then contributes: "
            "jaxclear.shapley_effects."
        )
    if surface is not None:
        return _of_surface(surface)
    count = len(problem.names)
    group = np.sort(groups(samples, parts))
    normal = scores_by_scrambling(np.bincount(group, minlength=parts), 2 * count, seed)
    base, other = normal[:, :count], normal[:, count:]
    columns = [base, other]
    for members in problem.groups.values():
        mixed = base.copy()
        mixed[:, list(members)] = other[:, list(members)]
        columns.append(mixed)
    values = problem.inputs.values(np.concatenate(columns))
    result = evaluate_all(problem, values, progress_bar=progress_bar, label="Sobol' indices")
    reached = (np.asarray(result.outcome) == Outcome.REACHED).reshape(len(columns), -1)
    refuse_infinite(problem, result.responses, "variance")
    good = np.all(reached, axis=0)
    rows = np.stack([result.responses[name] for name in problem.response_names], axis=-1)
    rows = rows.reshape(len(columns), len(group), -1)[:, good]
    at = np.asarray(values).reshape(len(columns), len(group), -1)[:, good]
    first, total = {}, {}
    every: Any = [None] * len(problem.response_names)
    if good.any():
        every = _parts(problem, at, rows, group[good])
    for name, numerators in zip(problem.response_names, every, strict=True):
        for i, variable in enumerate(problem.variable_names):
            first[name, variable] = _share(numerators, i)
            total[name, variable] = _share(numerators, len(columns) - 2 + i)
    warnings = sentences_among(problem, result.checks, reached.ravel())
    remarks = open_shares(problem, np.asarray(values)[np.tile(good, len(columns))], first, total)
    return SobolIndices(
        problem, first, total, len(values), int(np.sum(~good)), (*warnings, *remarks)
    )


def open_shares(
    problem: Problem, values: np.ndarray, *shares: dict[tuple[str, str], Statistic]
) -> tuple[str, ...]:
    """Sentences for variables with a level that no run (runs, variables) has seen, whose shares of
    a variance are then open: 0 to 1."""
    undrawn = undrawn_levels(problem, values)
    for table in shares:
        for response, variable in table:
            if variable in undrawn:
                share = table[response, variable]
                table[response, variable] = Statistic(share.value, 0.0, 1.0)
    return tuple(undrawn.values())


def leading(shares: Mapping[tuple[str, str], Statistic], what: str) -> str:
    """Which variable has the largest share of the variance of each response, in words, and which
    may have as large ones within their intervals."""
    sentences = []
    for response in dict.fromkeys(name for name, _ in shares):
        table = {variable: share for (name, variable), share in shares.items() if name == response}
        ranking = [(share.value, variable) for variable, share in table.items() if share.value > 0]
        if not ranking:
            sentences.append(f'"{response}" does not vary with any variable.')
            continue
        first = table[max(ranking)[1]]
        level = [variable for _, variable in sorted(ranking, reverse=True)]
        level = [name for name in level if table[name] is first or table[name].high >= first.low]
        text = " and ".join(f'"{name}" ({what} {table[name]})' for name in level)
        verb = "contributes" if len(level) == 1 else "contribute"
        sentences.append(f'{text} {verb} most to the variance of "{response}".')
    return " ".join(sentences)


def refuse_part_of_spread(surface: ResponseSurface, outside: np.ndarray) -> None:
    """Raises `ValueError` for a surface beyond whose runs more of the parts lie, `outside`
    (variables,) [1], than chance leaves there."""
    for name, share in zip(surface.problem.names, outside, strict=True):
        if share > MOST_OUTSIDE / len(surface.values):
            raise ValueError(
                f'the surface was fitted where {100 * share:.2g} % of "{name}" are not; its '
                "indices would be those of another spread: fit it with over=1, or give the problem."
            )


def open_share(surface: ResponseSurface, name: str, variance: float) -> tuple[float, float]:
    """(share of the variance that a surface leaves unexplained, share that it explains) [1].

    Both are 0 for a response that does not vary.

    Args:
        surface: with its error.
        name: of the response.
        variance: of the surface.
    """
    error, values = surface.error(name) ** 2, surface.responses[name]
    if np.ptp(values) <= ROUNDING * np.abs(values).max():
        return 0.0, 0.0
    total = variance + error
    return error / total, variance / total


def _of_surface(surface: ResponseSurface) -> SobolIndices:
    """Indices of polynomials: what they do not explain may belong to any variable."""
    problem = surface.problem
    args = surface.polynomials, np.asarray(surface.powers), problem.inputs, surface.values
    groups = tuple(problem.groups.values())
    spread, clipped = Expansion.of(*args, groups), Expansion.of(*args, groups, is_clipped=True)
    refuse_part_of_spread(surface, spread.outside)
    indices: tuple[dict, dict] = ({}, {})
    for name in problem.response_names:
        coefficients = np.asarray(surface.coefficients[name])
        totals = []
        for expansion in (spread, clipped):
            _, variance, *shares = expansion.variances(coefficients)
            open_, explained = open_share(surface, name, variance)
            totals.append(np.array(shares) * (explained / variance if variance > 0 else 0.0))
        half = open_ + np.abs(totals[0] - totals[1])
        for kind, shares, halves in zip(indices, totals[0], half, strict=True):
            for variable, share, half_width in zip(
                problem.variable_names, shares, halves, strict=True
            ):
                low, high = float(share - half_width), float(share + half_width)
                kind[name, variable] = Statistic(float(share), low, high)
    remarks = open_shares(problem, surface.values, *indices)
    return SobolIndices(problem, *indices, 0, 0, (*surface.warnings, *remarks))


class _Parts(NamedTuple):
    """What each scrambling says: numerators of all indices, second moment and mean about one place
    as columns (scramblings, 2 variables + 2): by runs alone (`plain`), with polynomials that go on
    beyond the outermost runs (`spread`), and with such as stay there as they are (`clipped`); and
    how many samples it has (scramblings,)."""

    plain: np.ndarray
    spread: np.ndarray
    clipped: np.ndarray
    samples: np.ndarray


def _share(parts: _Parts | None, place: int) -> Statistic:
    """An index from its numerator's place among the columns."""
    if parts is None:
        return UNKNOWN

    def of(rows: np.ndarray) -> float:
        numerator, second, mean = np.average(rows[:, :3], axis=0, weights=rows[:, 3])
        variance = second - mean**2
        return float(numerator / variance) if variance > 0 else 0.0

    each = np.arange(len(parts.samples))
    plain, spread, clipped = (
        jackknifed(of, np.column_stack([row[:, [place, -2, -1]], parts.samples]), each)
        for row in parts[:3]
    )
    beyond = abs(spread.value - clipped.value)
    best, beyond = (spread, beyond) if beyond <= plain.error else (clipped, plain.error)
    low, high = np.hypot(best.value - best.low, beyond), np.hypot(best.high - best.value, beyond)
    if max(low, high) > plain.error:
        return plain
    return Statistic(best.value, best.value - float(low), best.value + float(high))


def _parts(problem: Problem, at: np.ndarray, rows: np.ndarray, group: np.ndarray) -> list[_Parts]:
    """For each response what the scramblings say, from values (columns, samples, variables) and
    responses (columns, samples, responses)."""
    scramblings = [group == label for label in np.unique(group)]
    samples = np.array([mask.sum() for mask in scramblings])
    away = rows - rows[:2].mean(axis=(0, 1))
    is_constant = np.ptp(rows, axis=(0, 1)) <= ROUNDING * np.abs(rows).max(axis=(0, 1))
    away = np.where(is_constant, 0.0, away)
    plain = np.array([_numbers(away[:, mask]) for mask in scramblings])
    fitted = _Polynomial.through(problem, at, away, scramblings)
    spread, clipped = (0.0, 0.0) if fitted is None else fitted.corrections(scramblings)
    kinds = plain, plain + spread, plain + clipped
    each = [[kind[:, :, i] for kind in kinds] for i in range(rows.shape[2])]
    return [_Parts(one, other, third, samples) for one, other, third in each]


def _numbers(rows: np.ndarray) -> np.ndarray:
    """Numerators of first-order and total indices, second moment and mean (2 variables + 2,
    responses) from responses (variables + 2, samples, responses) about one place."""
    base, other, mixed = rows[0], rows[1], rows[2:]
    first = np.mean(other * (mixed - base), axis=1)
    total = 0.5 * np.mean((base - mixed) ** 2, axis=1)
    second = 0.5 * np.mean(base**2 + other**2, axis=0)
    return np.concatenate([first, total, second[None], 0.5 * np.mean(base + other, axis=0)[None]])


class _Polynomial(NamedTuple):
    """Polynomials that stand in for responses: terms at all runs (columns, samples, terms), for
    each scrambling the coefficients (terms, responses) through all others, and what turns these
    into shares of a variance: polynomials that go on beyond the outermost runs, and held ones."""

    terms: np.ndarray
    coefficients: np.ndarray
    expansions: tuple[Expansion, Expansion]

    @classmethod
    def through(
        cls, problem: Problem, at: np.ndarray, rows: np.ndarray, scramblings: list[np.ndarray]
    ) -> "_Polynomial | None":
        """Of the degree that predicts the left out scramblings best, for each response; None where
        runs are too few for a line."""
        runs = rows.shape[0] * (rows.shape[1] - max(int(mask.sum()) for mask in scramblings))
        most = min(runs // SAMPLES_A_TERM, MOST_TERMS)
        if len(scramblings) < 2 or most < at.shape[2] + 1:
            return None
        polynomials = orthonormal(at[:2].reshape(-1, at.shape[2]), HIGHEST)
        highest, degree = levels(polynomials), 1
        while degree < HIGHEST and len(powers(highest, degree + 1)) <= most:
            degree += 1
        table = powers(highest, degree)
        evaluate = lambda values: products(polynomials, jnp.asarray(table), values)
        terms = np.asarray(jax.jit(jax.vmap(jax.vmap(evaluate)))(jnp.asarray(at)))
        matrices = np.array([_equations(terms[:, mask], terms[:, mask]) for mask in scramblings])
        aims = np.array([_equations(terms[:, mask], rows[:, mask]) for mask in scramblings])
        matrices, aims = matrices.sum(axis=0) - matrices, aims.sum(axis=0) - aims
        best = np.full(rows.shape[2], np.inf)
        coefficients = np.zeros((len(scramblings), len(table), rows.shape[2]))
        for chosen in (table.sum(axis=1) <= d for d in range(1, degree + 1)):
            fitted = np.zeros_like(coefficients)
            for i in range(len(scramblings)):
                matrix = matrices[i][np.ix_(chosen, chosen)]
                fitted[i, chosen] = np.linalg.lstsq(matrix, aims[i][chosen], rcond=None)[0]
            missed = sum(
                np.sum((rows[:, mask] - terms[:, mask] @ each) ** 2, axis=(0, 1))
                for mask, each in zip(scramblings, fitted, strict=True)
            )
            coefficients = np.where(missed < best, fitted, coefficients)
            best = np.minimum(missed, best)
        points = at[:2].reshape(-1, at.shape[2])
        arguments = polynomials, table, problem.inputs, points, tuple(problem.groups.values())
        spread, clipped = Expansion.of(*arguments), Expansion.of(*arguments, is_clipped=True)
        return cls(terms, coefficients, (spread, clipped))

    def corrections(self, scramblings: list[np.ndarray]) -> list[np.ndarray]:
        """What to add to the numbers of each scrambling (scramblings, 2 variables + 2, responses),
        by either expansion: those of the polynomials exactly less those at the samples."""
        pairs = list(zip(scramblings, self.coefficients, strict=True))
        sampled = np.array([_numbers(self.terms[:, mask] @ each) for mask, each in pairs])
        corrections = []
        for expansion in self.expansions:
            exact = [
                [_exactly(expansion, column) for column in each.T] for each in self.coefficients
            ]
            corrections.append(np.swapaxes(np.array(exact), 1, 2) - sampled)
        return corrections


def _exactly(expansion: Expansion, coefficients: np.ndarray) -> np.ndarray:
    """The numbers (2 variables + 2,) of a polynomial under the law of the variables."""
    mean, variance, first, total = expansion.variances(coefficients)
    return np.concatenate([first, total, [variance + mean**2, mean]])


def _equations(terms: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Sums over runs (columns, samples) of terms times others."""
    return np.einsum("cst,csr->tr", terms, other, optimize=True)
