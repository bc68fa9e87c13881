"""The same run with everything that discretises it refined: steps of a share of their length, or
tolerances tighter by its fourth power, and more saving times where these decide: worn surfaces are
updated at them, and counted steps lie between them.

A run takes steps that end at its saving times, and may be far shorter than was asked: a finer one
has that share of the steps that were taken.
"""

import dataclasses
import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground.quantity import Scalar
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.integrators.stepping import SLIVER
from jaxclear.results.trajectory import Trajectory

__all__ = ["finer", "parts_of_intervals", "saved_oftener", "step_taken", "thinned"]


def step_taken(times: Float[Array, " saves"], asked: Scalar) -> Scalar:
    """The shortest step [s] that is taken between saving times [s] where one of at most `asked` [s]
    is: where intervals differ, none is compared with itself."""
    intervals = jnp.diff(times)
    return jnp.min(intervals / jnp.ceil(intervals / asked * (1 - SLIVER)))


def finer(
    integrator: AbstractIntegrator, times: Float[Array, " saves"], share: float
) -> AbstractIntegrator | None:
    """The integrator with steps of a `share` [1] of those that it takes between saving times [s],
    or tighter tolerances; itself where steps are counted, which more saving times shorten. None
    where it has none such."""
    if integrator.steps_between_saves is not None:
        return integrator
    asked = integrator.asked_step()
    if asked is None:
        return integrator.with_finer_steps(share)
    return integrator.with_finer_steps(share * step_taken(times, asked) / asked)


def parts_of_intervals(integrator: AbstractIntegrator, wears: bool, share: float) -> int:
    """How many saving intervals a finer run has in the place of one."""
    decide = wears or integrator.steps_between_saves is not None
    return math.ceil(1 / share) if decide else 1


def saved_oftener(times: Float[Array, " saves"], parts: int) -> Float[Array, " more"]:
    """Times with every interval between them cut into so many equal parts."""
    inside = times[:-1, None] + jnp.diff(times)[:, None] * jnp.arange(parts) / parts
    return jnp.append(inside.ravel(), times[-1])


def thinned(run: Trajectory, parts: int) -> Trajectory:
    """A run as if it had been saved at the ends of so many intervals only: forces that are means
    over intervals are so over these. Touches and releases that it noted are left out."""
    if parts == 1:
        return run
    history = run.history
    kept = dataclasses.replace(
        history,
        time=history.time[::parts],
        states=history.states[::parts],
        read=jax.tree.map(lambda depths: depths[::parts], history.read),
    )
    return dataclasses.replace(run, history=kept, noted=None)
