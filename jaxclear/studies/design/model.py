"""What answers for the responses while a design is sought: the problem itself where it answers at
once, else a polynomial surface through its runs."""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.integrators import Outcome
from jaxclear.studies.base import AbstractProblem, SampleResult
from jaxclear.studies.surface.fitting import fitted
from jaxclear.studies.surface.polynomials import Polynomials, products

__all__ = ["AbstractModel", "Direct", "Surface", "surface_through"]


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

    problem: AbstractProblem

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
    """The surface through runs, and its leave-one-out R2 [1] of each response. `values` (runs,
    variables), `responses` (runs, responses)."""
    names = problem.response_names
    found = SampleResult(
        dict(zip(names, responses.T, strict=True)),
        jnp.full(len(values), int(Outcome.REACHED)),
        jnp.zeros(len(values)),
    )
    surface = fitted(problem, values, found)
    rows = jnp.stack([surface.coefficients[name] for name in names])
    return Surface(surface.polynomials, surface.powers, rows, names), surface.quality
