"""Derivatives of a life: `jaxclear.wear_life_derivatives`.

Whole lives with one variable moved up and down, at two widths, all by the steps of the life itself,
so that no choice of steps is taken for a change. The two widths tell how far curvature and cycles
that settle otherwise spoil a difference; noise of chaotic motion is added, and what the steps are
off, four times as large for a derivative: their error goes with the fourth power of the rate.
"""

from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_flags, check_name, expect
from jaxclear.ground.printing import with_text_repr
from jaxclear.ground.wording import unit_of_rate
from jaxclear.simulation import progress
from jaxclear.simulation.simulate import SimulationError
from jaxclear.studies.life.rates import Rates
from jaxclear.studies.life.result import CONFIDENCE, VOLUME, WearLife
from jaxclear.studies.life.settling import Patience
from jaxclear.studies.life.wear_life import SETTLED, lived
from jaxclear.studies.store.store import open_store

# Moves of a variable, in widths.
MOVES = (-1.0, -0.5, 0.5, 1.0)
# An error below this share of a derivative is said without more words.
AGREED = 0.1
# Power of the rate with which the error of a step goes.
POWER = 4


@with_text_repr
class LifeDerivative(NamedTuple):
    """Derivative of a life with respect to a variable, in `unit`: its `value`, half the width of a
    95 % interval (nan where there is none), and a sentence."""

    value: float
    error: float
    unit: str
    sentence: str

    def __str__(self) -> str:
        return self.sentence


@answering
def wear_life_derivatives(
    life: WearLife,
    quantity: str = "depth",
    limit: float | None = None,
    *,
    max_cycles: int = 12,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> dict[str, LifeDerivative]:
    """Derivatives of a quantity at the end of a life, or of the life itself, by the variables.

    It takes four more lives for each variable, which is changed by its standard deviation and half
    of it.

    Args:
        life: a `WearLife` of a problem.
        quantity: name of the quantity; "depth" by default.
        limit: value of the quantity, in its unit, for derivatives of the cycles until it is
            reached; None (default) for those at the end.
        max_cycles: largest number of cycles over which a rate is averaged; 12 by default.
        store: folder that keeps every cycle, that of the life or another; None (default) for none.
        progress_bar: whether to show the progress; False by default.

    Returns:
        By variable a `LifeDerivative`.

    Raises:
        ValueError: if an argument is wrong, or the life does not reach the limit.
    """
    expect(life, WearLife, "the life", "what jaxclear.wear_life returns")
    check_name("quantity", quantity, life.quantities, " in this life")
    check_flags("wear_life_derivatives", progress_bar=progress_bar)
    problem = life.problem
    if not problem.names:
        raise ValueError("the problem of this life has no variables; give it some.")
    if limit is not None and not np.isfinite(life.until(quantity, limit).cycles):
        raise ValueError(f"{life.until(quantity, limit).sentence} Ask for a longer life.")
    derivatives = {}
    with open_store(store, "a wear life", problem), progress.bar(progress_bar, "lives"):
        for name in problem.names:
            width = float(problem.marginals[name].deviation())
            derivatives[name] = _derivative_by(life, quantity, limit, name, width, max_cycles)
            progress.advance(1 / len(problem.names))
    return derivatives


def _derivative_by(
    life: WearLife, quantity: str, limit: float | None, name: str, width: float, max_cycles: int
) -> LifeDerivative:
    """By one variable."""
    problem = life.problem
    place = problem.names.index(name)
    unit = "cycles" if limit is not None else life.quantities[quantity]
    unit = unit_of_rate(unit, problem.variable_units[place])
    what = quantity if limit is None else f"life until {quantity} {limit:.4g}"
    values, noises, warned = [], [], 0
    for move in MOVES:
        moved = problem.nominal() + move * width * jnp.eye(len(problem.names))[place]
        try:
            other = _relive(life, moved, max_cycles)
        except (SimulationError, ValueError) as reason:
            return _none(unit, f"The {what} has no derivative by {name} here: {reason}")
        length = _length_and_noise(other, quantity, limit)
        if other.ended or not np.isfinite(length[0]):
            why = other.ended or f"moved by {move * width:.3g} it is not reached."
            return _none(unit, f"The {what} has no derivative by {name} here: {why}")
        values.append(length[0])
        noises.append(length[1])
        warned += bool(other.warnings)
    far, near = (values[3] - values[0]) / (2 * width), (values[2] - values[1]) / width
    noise = CONFIDENCE * np.hypot(noises[1], noises[2]) / width
    steps = POWER * float(life.errors.max()) * near
    error = float(np.sqrt((near - far) ** 2 + noise**2 + steps**2))
    sentence = f"The {what} changes by {near:.4g} ± {error:.2g} {unit} of {name}"
    sentence += "." if error <= AGREED * abs(near) else ", which is known no better."
    if error > abs(near):
        sentence += " Not distinguishable from zero."
    if warned:
        sentence += f" {warned} of {len(MOVES)} lives warn."
    return LifeDerivative(float(near), error, unit, sentence)


def _none(unit: str, why: str) -> LifeDerivative:
    return LifeDerivative(np.nan, np.nan, unit, why)


def _relive(life: WearLife, values: Any, max_cycles: int) -> WearLife:
    """The life with other numbers, by the same steps."""
    accurate = life.accuracy if np.isfinite(life.accuracy) else 1.0
    rates = Rates(life.problem, values, Patience(SETTLED, accurate, max_cycles))
    return lived(rates, life.requested_cycles, life.accuracy, None, life.lengths)


def _length_and_noise(life: WearLife, quantity: str, limit: float | None) -> tuple[float, float]:
    """(what is differentiated, what noise leaves of it as a standard deviation)."""
    at = float(life.cycles[-1])
    value = life.at_end(quantity)
    if quantity in life.problem.response_names:
        noise = life.stages[-1].settled.responses()[quantity][1]
    else:
        deviations = life.stages[-1].node.deviations(life.cells, life.stages[0].node)
        noise = abs(value) * float(np.max(deviations[quantity.startswith(VOLUME)]))
    if limit is None:
        return value, noise
    at = life.until(quantity, limit).cycles
    return at, noise / max(abs(value), np.finfo(float).tiny) * at
