"""Responses over a grid of a problem's variables: `jaxclear.sweep`.

What curves and maps are drawn from. Nothing varies by chance: variables that are not swept stand at
their nominal values.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_flags, check_name, expect
from jaxclear.ground.wording import described
from jaxclear.studies.answer import AbstractAnswer, Column, Stated
from jaxclear.studies.infinite_responses import successes, why_unanswered
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_warnings import sentences_among
from jaxclear.studies.store.batch import evaluate_all
from jaxclear.studies.store.store import stored


class Sweep(AbstractAnswer):
    """Responses over a grid. `over` are the values of each swept variable, in its unit;
    `responses` by name, one axis for each swept variable in their order, nan where a run failed;
    `reasons` why, by the place in the grid; `warnings` of what runs warn."""

    problem: Problem
    over: dict[str, np.ndarray]
    responses: dict[str, np.ndarray]
    reasons: dict[tuple[int, ...], str]
    warnings: tuple[str, ...] = eqx.field(static=True, default=())

    def failures(self) -> dict[tuple[int, ...], str]:
        """Why each point that failed did, by its place in the grid."""
        return dict(self.reasons)

    def sentence(self) -> str:
        """Between which values each response lies over the grid; how many points failed, and where
        and why the first of them did."""
        units, sentences = self.units(), []
        for name, values in self.responses.items():
            if np.isfinite(values).any():
                ends = f"{np.nanmin(values):.4g} and {np.nanmax(values):.4g} {units[name]}"
                sentences.append(f'"{name}" lies between {ends.removesuffix(" 1")} over the grid.')
        return " ".join([*sentences, *filter(None, [self._failed_text()])])

    def _failed_text(self) -> str:
        """How many points failed; "" where none did."""
        if not self.reasons:
            return ""
        place, why = next(iter(self.reasons.items()))
        units, axes = self.units(), self.over.items()
        at = ", ".join(
            f"{name} {axis[k]:.6g} {units[name]}".rstrip()
            for (name, axis), k in zip(axes, place, strict=True)
        )
        count = next(iter(self.responses.values())).size
        return f"{len(self.reasons)} of {count} points failed; the first of them, {at}: {why}"

    def _stated(self):
        units, names = self.units(), tuple(self.over)
        columns = {name: Column(names, data, units[name]) for name, data in self.responses.items()}
        columns |= {name: Column((name,), data, units[name]) for name, data in self.over.items()}
        numbers = {"failed": len(self.reasons)}
        return Stated("sweep", columns, self.problem, self.warnings, numbers)

    def units(self) -> dict[str, str]:
        """Units of variables and responses, by name."""
        pairs = zip(self.problem.names, self.problem.variable_units, strict=True)
        return dict(pairs) | dict(self.problem.units())


@answering
@stored("a sweep")
def sweep(
    problem: Problem,
    over: Mapping[str, Sequence[float]],
    *,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> Sweep:
    """Run a problem at every point of a grid, in one compiled program.

    A point that fails is recorded with its reason; the others are computed.

    Args:
        problem: the problem.
        over: values of each variable to sweep, by its name, in its unit; the others have their
            nominal values.
        store: folder that keeps the runs; None (default) for none.
        progress_bar: whether to show the progress; False by default.

    Returns:
        The `Sweep`.

    Raises:
        ValueError: if there is no such variable or values are not finite.
    """
    expect(problem, Problem, "what is swept", "a jaxclear.Problem")
    expect(over, Mapping, "over of sweep", "values by the names of variables")
    check_flags("sweep", progress_bar=progress_bar)
    axes = {name: _check_axis(name, axis_values, problem) for name, axis_values in over.items()}
    if not axes:
        raise ValueError("over of sweep is empty; name a variable and the values it shall take.")
    grid = np.meshgrid(*axes.values(), indexing="ij")
    values = np.tile(np.asarray(problem.nominal()), (grid[0].size, 1))
    for name, axis_values in zip(axes, grid, strict=True):
        values[:, problem.names.index(name)] = axis_values.ravel()
    result = evaluate_all(problem, values, progress_bar=progress_bar, label="sweep")
    outcome, ended = np.asarray(result.outcome), np.asarray(result.ended)
    good, numbers = successes(problem, outcome, result.responses)
    shape = grid[0].shape
    responses = {name: numbers[name].reshape(shape) for name in problem.response_names}
    reasons = {
        tuple(int(k) for k in np.unravel_index(i, shape)): why_unanswered(
            problem, outcome[i], ended[i]
        )
        for i in np.flatnonzero(~good)
    }
    return Sweep(problem, axes, responses, reasons, sentences_among(problem, result.checks, good))


def _check_axis(name: str, values: Any, problem: Problem) -> np.ndarray:
    """The values of a variable. Raises `ValueError` with a sentence."""
    check_name("variable", name, problem.names, " in this problem")
    try:
        axis = np.asarray(values, float)
    except (TypeError, ValueError):
        axis = np.zeros(0)
    if axis.ndim != 1 or not axis.size or not np.all(np.isfinite(axis)):
        raise ValueError(
            f'the values of "{name}" in sweep are {described(values)}; they must be a row of '
            "finite numbers, such as numpy.linspace(low, high, 11)."
        )
    return axis
