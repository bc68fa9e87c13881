"""Bristles that explicit steps do not resolve: a deflection that settles within a micrometre of
sliding grows without bound where a step slides farther, and the run is not a number.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxclear.ground.quantity import Scalar
from jaxclear.ground.wording import public_name
from jaxclear.integrators.outcome import Outcome
from jaxclear.results.trajectory import Trajectory

# Longest explicit step beside the time in which a deflection settles: where Runge-Kutta steps of
# order 4 are stable.
STABLE = 2.78


def told_of_bristles(trajectory: Trajectory) -> str:
    """Why a run of one mechanism ended, with a sentence more where explicit steps went on until the
    bristles of a friction law were no numbers."""
    if int(trajectory.outcome) != Outcome.NOT_FINITE:
        return trajectory.result
    mechanism = trajectory.history.mechanism
    lengths = {}
    for name in mechanism.topology.clearances:
        for laws in mechanism.connections[name].joint.contact_laws():
            law = laws.friction
            if law is not None and law.bristles:
                lengths[name, public_name(type(law))] = float(settling_length(law))
    if not lengths:
        return trajectory.result
    (name, law), length = min(lengths.items(), key=lambda item: item[1])
    return (
        f'{trajectory.result} Joint "{name}" has {law}, whose deflections settle within '
        f"{length:.2g} m of sliding, at 1 m/s at a rate of {1 / length:.2g} 1/s: explicit steps of "
        f"at most {STABLE * length:.2g} s resolve that, and integrator.ImplicitStep needs not."
    )


def settling_length(law: Any) -> Scalar:
    """Sliding [m] within which a deflection settles, at 1 m/s."""
    rate = jax.grad(lambda z: law.tractions(1.0, (z,), (1.0,), 1.0)[1][0])(0.0)
    return 1 / jnp.maximum(-rate, 1e-300)
