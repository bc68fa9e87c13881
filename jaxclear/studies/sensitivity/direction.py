"""What a derivative is taken by: the nominal value of a variable, or the width of its
distribution.

Both move the values of a sample: the nominal value all by the same amount, the width each by its
own deviation. How fast a value moves is its velocity, by which every method goes.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.ground.arguments import check_known
from jaxclear.ground.numerics import safe_divide
from jaxclear.studies.base import AbstractProblem


class Direction(NamedTuple):
    """The nominal value of a variable, by its place, or its width: `number` [the variable's unit]
    by which the width is told, None for the nominal value."""

    label: str
    variable: int
    number: float | None

    def velocities(self, problem: AbstractProblem, values: np.ndarray) -> np.ndarray:
        """Of the variable's values (samples, variables), per unit: (samples,)."""
        if self.number is None:
            return np.ones(len(values))
        own = values[:, self.variable] - float(problem.nominal()[self.variable])
        return own / self.number

    def step(self, problem: AbstractProblem) -> float:
        """How far a difference moves it [its unit]: by one standard deviation, or half a width."""
        if self.number is None:
            return float(problem.inputs.deviations()[self.variable])
        return 0.5 * self.number


def directions(problem: AbstractProblem, wanted: list[str]) -> list[Direction]:
    """The directions of these names: a variable's own, or that of its width, "tolerance of
    clearance". Raises `ValueError` for names that there are not."""
    known = {name: Direction(name, i, None) for i, name in enumerate(problem.names)}
    for i, name in enumerate(problem.names):
        what, number = problem.variables[name].distribution.width()
        known[f"{what} of {name}"] = Direction(f"{what} of {name}", i, float(number))
    for name in wanted:
        own = [one for one in problem.names if str(name).endswith(f" of {one}")]
        if name not in known and own:
            what = problem.variables[own[-1]].distribution.width()[0]
            raise ValueError(f'no "{name}" in this problem; there is "{what} of {own[-1]}".')
        check_known("variable", name, known, " in this problem")
    return [known[name] for name in wanted]


def _speed(distribution, number):
    """How fast a standard normal score moves, of it."""

    def speed(u):
        value, slope = jax.jvp(distribution.of_score, (u,), (jnp.ones_like(u),))
        return safe_divide(1.0 if number is None else value / number, slope)

    return speed


@eqx.filter_jit
def _weights(distribution, number, scores, leaning):
    found, rate = jax.jvp(_speed(distribution, number), (scores,), (jnp.ones_like(scores),))
    return found * leaning - rate


@eqx.filter_jit
def _flow(distribution, number, scores):
    return _speed(distribution, number)(scores) * jax.scipy.stats.norm.pdf(scores)


def flow(problem: AbstractProblem, direction: Direction, scores: np.ndarray) -> np.ndarray:
    """Share of parts [1/unit] that pass the values of standard normal scores (points,) as the
    distribution moves; upwards is positive."""
    own = problem.inputs.distributions[direction.variable]
    return np.array(_flow(own, direction.number, jnp.asarray(scores)))


def weights(problem: AbstractProblem, direction: Direction, normal: np.ndarray) -> np.ndarray:
    """Score function of the sample's distribution, (samples,) [1/unit]: the derivative of a mean is
    the mean of the response times this, and what its ends add.

    `normal` (samples, variables): the independent standard normal numbers of the sample.
    """
    inputs, i = problem.inputs, direction.variable
    scores, leaning = normal[:, i], normal[:, i]
    if not inputs.independent:
        scores = normal @ np.asarray(inputs.root)[i]
        # The i-th component of correlation^-1 scores.
        leaning = normal @ np.asarray(inputs.inverse_root)[:, i]
    own = inputs.distributions[i]
    return np.asarray(_weights(own, direction.number, jnp.asarray(scores), jnp.asarray(leaning)))
