"""A question about a mechanism: which numbers vary and how, how it is run, and which responses are wanted.

Studies see a `Problem`, never a joint. The whole path from varied numbers to responses is one pure function, `evaluate`, that
maps over samples and differentiates.
"""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.scene.initial import assemble_arrays
from jaxclear.scene.mechanism import Mechanism
from jaxclear.studies.distribution import AbstractDistribution, TruncatedNormal
from jaxclear.time.integrator import AbstractIntegrator, FixedStep
from jaxclear.time.response import unit_of
from jaxclear.time.simulate import check_run, run, saving_times


class Variable(eqx.Module):
    """A number of the mechanism that varies: `where(mechanism)` returns its leaf, or several leaves that vary together.

    `distribution` is centred on the leaf's own value; `tolerance=t` stands for a normal distribution with three standard
    deviations in t, cut off at +-t.
    """

    where: Callable[[Mechanism], Any] = eqx.field(static=True)
    distribution: AbstractDistribution

    def __init__(self, where: Callable, distribution: AbstractDistribution | None = None, *, tolerance: float | None = None):
        if (distribution is None) == (tolerance is None):
            raise ValueError("a variable takes a distribution or a tolerance, one of the two.")
        self.where = where
        self.distribution = TruncatedNormal(tolerance / 3, tolerance) if distribution is None else distribution


class Outcome(eqx.Module):
    """Responses of one sample by name, and how its run ended (index into `integrator.OUTCOMES`, and time [s])."""

    responses: dict[str, Array]
    outcome: Array
    ended: Array


class Problem(eqx.Module):
    """A mechanism, the numbers in it that vary, how it is run, and the responses wanted of a run.

    `response`: a function of a trajectory returning a number, or several by name. `integrator`: `FixedStep()` by default, because
    equal work for every sample is what batches and derivatives want. `save`: saving times, as in `simulate`.
    """

    mechanism: Mechanism
    response: dict[str, Callable]
    variables: dict[str, Variable]
    duration: Array
    integrator: AbstractIntegrator
    save: Any = eqx.field(static=True)
    # JAX sorts the keys of a dictionary; the order in which variables were given is kept here.
    names: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        mechanism: Mechanism,
        response: Callable | Mapping[str, Callable],
        variables: Mapping[str, Variable],
        *,
        duration: float,
        integrator: AbstractIntegrator | None = None,
        save: int = 201,
    ):
        self.mechanism = mechanism
        self.response = dict(response) if isinstance(response, Mapping) else {"response": response}
        self.variables = dict(variables)
        self.duration = jnp.asarray(duration, float)
        self.integrator = FixedStep() if integrator is None else integrator
        check_run(mechanism, self.integrator)
        self.save = save
        self.names = tuple(self.variables)
        for name, variable in self.variables.items():
            target = variable.where(mechanism)
            leaves = target if isinstance(target, (tuple, list)) else [target]
            if not leaves or not all(eqx.is_array(leaf) and jnp.ndim(leaf) == 0 for leaf in leaves):
                raise ValueError(
                    f'variable "{name}" must point at numbers of the mechanism; where(mechanism) gives '
                    f"{variable.where(mechanism)!r}."
                )

    def _leaves(self, variable):
        return jax.tree.leaves(variable.where(self.mechanism))

    def nominal(self) -> Float[Array, " variables"]:
        """Nominal value of each variable."""
        return jnp.stack([self._leaves(self.variables[name])[0] for name in self.names])

    def units(self) -> dict[str, str]:
        """Unit of each response."""
        return {name: unit_of(response) for name, response in self.response.items()}

    def with_values(self, values: Float[Array, " variables"]) -> Mechanism:
        """The mechanism with its variables set. Leaves that vary together move by the same amount."""
        mechanism = self.mechanism
        for name, value in zip(self.names, values, strict=True):
            variable = self.variables[name]
            old = self._leaves(variable)
            new = [leaf + (value - old[0]) for leaf in old]
            mechanism = eqx.tree_at(lambda m, v=variable: jax.tree.leaves(v.where(m)), mechanism, new)
        return mechanism

    def evaluate(self, values: Float[Array, " variables"]) -> Outcome:
        """Assemble, run and take the responses for one set of values; pure."""
        mechanism = self.with_values(values)
        start = assemble_arrays(mechanism)
        times = jnp.linspace(0.0, self.duration, self.save) if np.ndim(self.save) == 0 else None
        if times is None:
            times = saving_times(float(self.duration), self.save)
        trajectory = run(mechanism, start.coordinates, start.speeds, times, self.integrator)
        responses = {name: response(trajectory) for name, response in self.response.items()}
        closed = jnp.all(jnp.stack([jnp.max(jnp.abs(r), initial=0.0) < 1e-6 for r in start.residuals.values()] or [True]))
        return Outcome(responses, jnp.where(closed, trajectory.outcome, UNASSEMBLED), trajectory.ended)


# Outcome of a sample whose dimensions do not let the mechanism close; beside those of an integrator.
UNASSEMBLED = -1
