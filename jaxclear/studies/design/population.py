"""The parts that a design makes, and what answers for their responses: the problem itself where it
answers at once, else a polynomial surface through its runs.

With one sample of standard normal points for every candidate a response is a smooth function of
nominal values and tolerances. Where rare parts decide, some of the points are drawn about those,
and weighted by how much rarer they are.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.integrators import Outcome
from jaxclear.studies.experiment import SampleResult
from jaxclear.studies.problem import Problem
from jaxclear.studies.scrambling import scrambled_normal
from jaxclear.studies.surface.fitting import fitted
from jaxclear.studies.surface.polynomials import Polynomials, products

# Independent scramblings.
GROUPS = 8


class Points(eqx.Module):
    """Standard normal points (samples, variables) and their weights (samples,), which add up to
    1."""

    normal: np.ndarray
    weights: np.ndarray


def points(
    variables: int,
    samples: int,
    seed: int,
    shifts: tuple[np.ndarray, ...] = (),
    matched: bool = False,
) -> Points:
    """Quasi-random standard normal points, weighted by the balance heuristic around rare regions.

    Args:
        variables: number of variables.
        samples: points around each centre.
        seed: of the scrambling.
        shifts: centres (variables,) of rare regions, besides the middle.
        matched: whether mean and covariance are made those of the distribution; without shifts
            only.

    Source: Veach & Guibas 1995, SIGGRAPH 95, 419, doi:10.1145/218380.218498.
    """
    if not shifts and matched:
        return Points(_mirrored_points(variables, samples, seed), np.full(samples, 1.0 / samples))
    centres = [np.zeros(variables), *shifts]
    parts = []
    for number, centre in enumerate(centres):
        rng = np.random.default_rng([seed, number])
        parts.append(scrambled_normal(samples, variables, rng) + centre)
    normal = np.concatenate(parts)
    # Density of the mixture in multiples of the standard normal one.
    grown = np.mean([np.exp(normal @ c - 0.5 * c @ c) for c in centres], axis=0)
    weights = 1.0 / grown
    return Points(normal, weights / weights.sum())


def in_groups(
    names: Sequence[str], least: int, seed: int, shifts: tuple[np.ndarray, ...] = ()
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (samples, names) of independent scramblings, their weights, and their scramblings.

    Args:
        names: of the variables.
        least: smallest number of points.
        seed: of the scramblings.
        shifts: centres (variables,) of rare regions (`points`).
    """
    each = -(-least // (GROUPS * (1 + len(shifts))))
    sets = [points(len(names), each, seed * GROUPS + k, shifts) for k in range(GROUPS)]
    normal = np.concatenate([one.normal for one in sets])
    weights = np.concatenate([one.weights for one in sets]) / GROUPS
    return normal, weights, np.repeat(np.arange(GROUPS), len(normal) // GROUPS)


def _mirrored_points(variables: int, samples: int, seed: int) -> np.ndarray:
    """Points and their mirror images, stretched until their covariance is the unit matrix."""
    half = scrambled_normal(-(-samples // 2), variables, np.random.default_rng([seed, 0]))
    normal = np.concatenate([half, -half])[:samples]
    return np.linalg.solve(
        np.linalg.cholesky(np.cov(normal.T, ddof=0).reshape(variables, -1)), normal.T
    ).T


class AbstractModel(eqx.Module):
    """Responses by name, (samples,), of values (samples, variables); differentiable."""

    @eqx.filter_jit
    def __call__(self, values: Float[Array, "samples variables"]) -> dict[str, Array]:
        """The responses of all samples."""
        return jax.vmap(self.one)(values)

    @abstractmethod
    def one(self, values: Float[Array, " variables"]) -> dict[str, Array]:
        """The responses of one sample."""


class Direct(AbstractModel):
    """The problem itself."""

    problem: Problem

    def one(self, values):
        return self.problem.evaluate(values).responses


class Surface(AbstractModel):
    """A polynomial of each response (`studies.surface`), without the runs that it came from."""

    polynomials: Polynomials
    powers: Int[Array, "terms variables"]
    coefficients: Float[Array, "responses terms"]
    names: tuple[str, ...] = eqx.field(static=True)

    def one(self, values):
        terms = products(self.polynomials, self.powers, values)
        return dict(zip(self.names, self.coefficients @ terms, strict=True))


def surface_through(
    problem: Any, values: np.ndarray, responses: np.ndarray
) -> tuple[Surface, dict[str, float]]:
    """The polynomial surface through runs, and its leave-one-out R2 [1] by response.

    Args:
        problem: names its responses and variables.
        values: of the variables, shape (runs, variables).
        responses: shape (runs, responses).
    """
    names = problem.response_names
    result = SampleResult(
        dict(zip(names, responses.T, strict=True)),
        jnp.full(len(values), int(Outcome.REACHED)),
        jnp.zeros(len(values)),
    )
    surface = fitted(problem, values, result)
    rows = jnp.stack([surface.coefficients[name] for name in names])
    return Surface(surface.polynomials, surface.powers, rows, names), surface.quality
