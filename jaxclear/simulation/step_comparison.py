r"""Whether a derivative depends on the steps of its run.

Derivatives through impacts of rigid contact are off by a share of the step, and one whose parts
nearly cancel by more of itself, which no figure of the steps shows. So they are taken of runs in
other steps as well, by the same program side by side: of an error in proportion to the step,
:math:`t_{rh} - t_h` is :math:`r - 1` times that of :math:`t_h`. Two other steps are asked, as where
in a step impacts fall is chance. A derivative is nan where either tells an error beyond `TRUSTED`
of it.

None of this is in a program of which no derivative is asked.
Source: Richardson 1911, Phil. Trans. R. Soc. A 210, 307, doi:10.1098/rsta.1911.0009.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground.quantity import Scalar
from jaxclear.ground.tangents import pushed
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.integrators.stepping import SLIVER
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.derivatives import refusal

# The lengths of the other steps beside that of the run.
LONGER = 1.5, 2.0
# And where saving intervals have fewer than so many steps, which cannot be as many times longer.
SHORTER, FEWEST = (1 / 2, 1 / 3), 4
# Share of a derivative by which the other steps may tell it to be off.
TRUSTED = 0.01
# Derivatives that are so small a share of the largest in the run are rounding.
ROUNDING = 1e-12


def is_compared(mechanism: Mechanism, integrator: AbstractIntegrator) -> bool:
    """Whether derivatives of runs of a mechanism, as its formulation sees it, are taken in other
    steps as well."""
    opens = bool(mechanism.topology.clearances)
    return integrator.first_order_slopes and opens and not refusal(mechanism, integrator)


def in_other_steps(integrator: Any, share: Any) -> Any:
    """The integrator in steps that share as long (None: as they are)."""
    return integrator if share is None else integrator.with_finer_steps(share)


def compared(function: Callable, judged: Callable, steps: Callable) -> Callable:
    """As `function(None, *arguments)`, with derivatives `judged(ways, ratios)` from those of
    `function(share, *arguments)` in steps that are this share of the usual ones.

    `judged`: of derivatives of the answer, of the run itself in front and behind it those in other
    steps, and how long these are beside its own; `steps(*arguments)`: (a step's length [s], the
    times [s] at which one ends)."""

    def known(*arguments: Any) -> Any:
        arrays, rest = eqx.partition(arguments, eqx.is_array)
        kept: list[Any] = []

        def gone(share: Any, arrays: Any) -> tuple[Any, Any]:
            found = function(share, *eqx.combine(arrays, rest))
            found, others = eqx.partition(found, eqx.is_array)
            kept.append(others)
            return eqx.partition(found, eqx.is_inexact_array)

        @jax.custom_jvp
        def own(arrays):
            return gone(None, arrays)

        def moving(numbers, tangents):
            shares, ratios = _shares(*steps(*eqx.combine(numbers[0], rest)))

            def one(share):
                (out, left), (ways, _) = pushed(lambda arrays: gone(share, arrays), *both)
                return out, left, ways

            both = numbers, tangents
            out, left, ways = jax.vmap(one)(shares)
            found, left = jax.tree.map(lambda each: each[0], (out, left))
            still = jax.tree.map(lambda each: np.zeros(each.shape, jax.dtypes.float0), left)
            return (found, left), (judged(ways, ratios), still)

        own.defjvp(moving, symbolic_zeros=True)
        return eqx.combine(*own(arrays), kept[0])

    return known


def _shares(step: Scalar, times: Float[Array, " saves"]) -> tuple[Array, Array]:
    """(1 and the shares of a step [s] that others are, how long they are beside it in the mean):
    steps end at all these times [s], so they are not as long as they are asked for."""
    count = lambda step: jnp.maximum(jnp.ceil(jnp.diff(times) / step * (1 - SLIVER)), 1.0)
    own = count(step)
    others = jnp.where(jnp.min(own) >= FEWEST, jnp.asarray(LONGER), jnp.asarray(SHORTER))
    ratios = jnp.sum(own) / jnp.sum(jax.vmap(lambda share: count(share * step))(others), axis=1)
    return jnp.concatenate([jnp.ones(1), others]), ratios


def where_alike(ways: Array, ratios: Array, scale: Array, largest: Scalar) -> Array:
    """Derivatives of the run itself, the first of `ways`, nan where those in other steps tell that
    they are off by too large a share of this `scale`, unless all are rounding beside the `largest`
    of the run."""
    own, others = ways[0], ways[1:]
    ratios = jnp.expand_dims(ratios, tuple(range(1, others.ndim)))
    off = jnp.max(abs(others - own) / abs(ratios - 1), axis=0)
    nothing = jnp.max(abs(ways), axis=0) <= ROUNDING * largest
    return jnp.where((off <= TRUSTED * scale) | nothing, own, jnp.nan)


def run_where_alike(ways: Trajectory, ratios: Array) -> Trajectory:
    """Derivatives of a run; of its states those are nan that steps decide: at the end beside their
    own size, at an instant before beside the largest that the derivative of this number has been,
    as on its way it may pass through nothing."""
    states = ways.history.states
    size = abs(states[0])
    scale = jax.lax.cummax(size, axis=0).at[-1].set(size[-1])
    told = where_alike(states, ratios, scale, jnp.max(abs(states)))
    own = jax.tree.map(lambda each: each[0], ways)
    return eqx.tree_at(lambda run: run.history.states, own, told)
