"""What couplings with play or stiffness, and motors without a body, tell of a run: twist, torque,
which flank presses."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxclear.components.coupling import AbstractForceCoupling
from jaxclear.formulations.model import Instant
from jaxclear.ground import sparse as sp
from jaxclear.ground.argument_errors import answering
from jaxclear.multibody.forces import seen_coordinates, states_of
from jaxclear.multibody.system import coordinate_loads
from jaxclear.multibody.topology import motor_name
from jaxclear.results.histories import AbstractHistory, driving, measured, of_row, solved
from jaxclear.results.state_history import StateHistory, check_known, over_time


class CouplingHistory(AbstractHistory):
    """A coupling with play or stiffness: its `twist` (lost motion and wind-up together) with its
    `rate`, the `torque` that acts against it, and the power `lost` in it [W], where its play is
    seen (m, m/s, N for a length). `flank`: 1 while the upper one presses, where the twist is
    largest, -1 while the lower one does, 0 in the gap; 0 throughout without play."""

    twist: Float[Array, " time"] = measured("rad")
    rate: Float[Array, " time"] = measured("rad/s")
    torque: Float[Array, " time"] = measured("N m")
    lost: Float[Array, " time"] = measured("W")
    flank: Int[Array, " time"] = measured("1")


@answering
def coupling(history: StateHistory, name: str) -> CouplingHistory:
    """A coupling with play or stiffness over time."""
    history.check_single()
    known = [n for n, own in history.mechanism.couplings.items() if own.gives]
    check_known(name, known, "coupling with play or stiffness")
    return _coupling(history, name)


@eqx.filter_jit
def _coupling(history, name):
    def one(now: Instant):
        own = history.formulation.forces(now).pressing[name]
        flank = jnp.zeros(())
        if own.torques:
            upper, lower = own.torques
            flank = jnp.where(upper > 0, 1.0, 0.0) - jnp.where(lower > 0, 1.0, 0.0)
        told = own.twist.value, own.twist.rate, own.torque, own.dissipated, flank
        return tuple(jnp.asarray(each, float) for each in told)

    *numbers, flank = over_time(history, one)
    return CouplingHistory(*numbers, flank.astype(int))


def transmitted(history: StateHistory, name: str) -> Float[Array, " time"]:
    """What a coupling transmits, or a drive gives, over time [N m, N]."""
    mechanism = history.mechanism
    check_known(name, (*mechanism.couplings, *mechanism.driven), "coupling or driven joint")
    if name not in mechanism.couplings:
        return driving(history, name)
    return (of_row if name in mechanism.topology.couplings else _given)(history, name)


@eqx.filter_jit
def _given(history: StateHistory, name: str) -> Float[Array, " time"]:
    """What a coupling that is no row transmits [N m, N]: of one with play or stiffness that on its
    first coordinate; of a motor that turns with a joint what it gives this."""

    def one(now: Instant):
        own = history.mechanism.couplings[name]
        if isinstance(own, AbstractForceCoupling):
            system = now.model.system
            seen = seen_coordinates(system, now.motions, own, now.followed)
            states = states_of(name, own, now.followed)
            return jnp.asarray(own.transmitted(own.effect(now.time, *seen, states)), float)
        if own.gives:
            return -jnp.asarray(history.formulation.forces(now).pressing[name].torque, float)
        return _geared(history, now, name)

    return over_time(history, one)


def _geared(history: StateHistory, now: Instant, name: str) -> Any:
    """The torque on the joint: what loads on the motor leave of its inertia."""
    system, _, solution = solved(history, now)
    motor = motor_name(name)
    own = system.geared[motor]
    branch = system.topology.branch_of(own.joint)
    index = system.topology.branches.index(branch)
    faster = own.ratio * solution.accelerations[index][0]
    coupling: Any = history.mechanism.couplings[name]
    force = -coupling.motor.inertia * faster
    for label, load in coordinate_loads(system):
        if motor in load.coordinates():
            seen = seen_coordinates(system, now.motions, load, now.followed)
            acts = load.effect(now.time, *seen, states_of(label, load, now.followed))
            force = sp.add(force, acts.forces[load.coordinates().index(motor)])
    return jnp.asarray(own.ratio * force, float)
