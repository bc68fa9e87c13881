"""What couplings with play or stiffness, and motors without a body, tell of a run: twist, torque,
which flank presses."""

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.components.clearance.backlash import middle_of
from jaxclear.components.coupling import AbstractForceCoupling
from jaxclear.components.load_base import acts_on_coordinates
from jaxclear.formulations.loads_over_step import forces_of_means, impulse_of
from jaxclear.formulations.model import Instant
from jaxclear.ground import sparse as sp
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.table import as_table
from jaxclear.multibody import constraints
from jaxclear.multibody.forces import force_of, load_rows, pressing_of
from jaxclear.multibody.system import coordinate_loads, scale_of
from jaxclear.multibody.topology import motor_name
from jaxclear.native.compiled import compiled_quickly
from jaxclear.results.histories import (
    AbstractHistory,
    drive_history,
    is_unique,
    measured_field,
    solve_instant,
)
from jaxclear.results.state_history import StateHistory, check_name, over_time


class CouplingHistory(AbstractHistory):
    """A coupling with play or stiffness over time, where its play is measured.

    Units are those of a coupling that turns; for one that slides m, m/s and N.

    Args:
        twist: lost motion and wind-up together [rad], shape (time,).
        rate: rate of the twist [rad/s], shape (time,).
        torque: torque that acts against the twist [N m], shape (time,).
        loss: power lost in it [W], shape (time,).
        flank: 1 while the upper flank presses (where the twist is largest), -1 while the lower one
            does, 0 in the gap or without play, shape (time,).
    """

    twist: Float[Array, " time"] = measured_field("rad")
    rate: Float[Array, " time"] = measured_field("rad/s")
    torque: Float[Array, " time"] = measured_field("N m")
    loss: Float[Array, " time"] = measured_field("W")
    flank: Int[Array, " time"] = measured_field("1")


@answering
def coupling(history: StateHistory, name: str) -> CouplingHistory:
    """A coupling with play or stiffness over time."""
    history.check_single()
    every = history.mechanism.couplings
    valid = [n for n, c in every.items() if c.gives or c.play is not None]
    check_name(name, valid, "coupling with play or stiffness")
    return _coupling_history(history, name) if every[name].gives else _seated_history(history, name)


def _seated_history(history: StateHistory, name: str) -> CouplingHistory:
    """A coupling whose flanks always press: its twist is half the play to the side that what it
    transmits asks for, and what its stiffness winds up."""
    coupling: Any = history.mechanism.couplings[name]
    torque = -transmitted(history, name)
    if name in history.mechanism.topology.couplings:
        torque = torque * scale_of(history.mechanism, coupling)
    play, none = coupling.play, jnp.zeros_like(torque)
    flank = jnp.sign(torque)
    twist = middle_of(play) + 0.5 * play.play * flank
    twist = twist if coupling.stiffness is None else twist + torque / coupling.stiffness
    return CouplingHistory(twist, none, torque, none, flank.astype(int))


def flank_switchings(history: StateHistory, name: str) -> Any:
    """Instants at which another flank of a coupling begins to press, as a pandas table (time [s],
    from, to), read off a straight line between saving times."""
    history.check_single()
    torque, time = np.asarray(coupling(history, name).torque), np.asarray(history.time)
    flanks = ("lower flank", "upper flank")
    rows = []
    for i in range(1, len(time)):
        before, after = torque[i - 1], torque[i]
        if before * after < 0:
            instant = time[i - 1] + (time[i] - time[i - 1]) * before / (before - after)
            rows.append((instant, flanks[int(before > 0)], flanks[int(after > 0)]))
    return as_table(rows, columns=["time [s]", "from", "to"])


@compiled_quickly
def _coupling_history(history, name):
    def one(now: Instant):
        force = history.formulation.forces(now).pressing[name]
        flank = jnp.zeros(())
        if force.torques:
            upper, lower = force.torques
            flank = jnp.where(upper > 0, 1.0, 0.0) - jnp.where(lower > 0, 1.0, 0.0)
        values = force.twist.value, force.twist.rate, force.torque, force.dissipated, flank
        return tuple(jnp.asarray(each, float) for each in values)

    *numbers, flank = over_time(history, one)
    return CouplingHistory(*numbers, flank.astype(int))


def transmitted(history: StateHistory, name: str) -> Float[Array, " time"]:
    """What a coupling transmits, or a drive or a load on a coordinate gives, over time [N m, N]."""
    mechanism = history.mechanism
    loads = [n for n, load in mechanism.loads.items() if acts_on_coordinates(load)]
    valid = (*mechanism.couplings, *mechanism.driven, *loads)
    check_name(name, valid, "coupling, driven joint or load on a coordinate")
    if name in loads and name not in (*mechanism.couplings, *mechanism.driven):
        return _force_of_load(history, name)
    if name not in mechanism.couplings:
        return drive_history(history, name)
    is_unique(history, name, f'what coupling "{name}" transmits')
    return _transmitted_over_time(history, name)


@compiled_quickly
def _force_of_load(history: StateHistory, name: str) -> Float[Array, " time"]:
    """What a load gives along its first coordinate [N m, N]; one whose force steps find as its mean
    over each saving interval."""

    def one(now: Instant):
        force = force_of(now.model.system, now.motions, name, now.time, now.followed)
        return force + forces_of_means(now).get(impulse_of(name), 0.0)

    return over_time(history, one)


@compiled_quickly
def _transmitted_over_time(history: StateHistory, name: str) -> Float[Array, " time"]:
    return over_time(history, lambda now: sent_at(history, now, (name,))[0])


def sent_at(history: StateHistory, now: Instant, names: tuple[str, ...]) -> tuple[Array, ...]:
    """Torque or force that couplings transmit at an instant [N m, N].

    It is the multiplier of a rigid coupling, the force on the first coordinate of a flexible one,
    and for a motor that turns with a joint what it gives that joint.

    Args:
        history: states of the run.
        now: instant at which they are read.
        names: couplings, in the order of the result.
    """
    pressed = functools.cache(lambda: _pressing_at(history, now))
    solution = functools.cache(lambda: solve_instant(history, now))
    rows = functools.cache(lambda: _multiplier_by_closure(now, solution()[2]))

    def one(name):
        coupling = history.mechanism.couplings[name]
        if name in history.mechanism.topology.couplings:
            return rows()[name]
        if isinstance(coupling, AbstractForceCoupling):
            return force_of(now.model.system, now.motions, name, now.time, now.followed)
        return (
            -pressed()[name].torque if coupling.gives else _geared(history, now, name, solution())
        )

    return tuple(jnp.asarray(one(name), float) for name in names)


def _pressing_at(history: StateHistory, now: Instant) -> dict[str, Any]:
    """What couplings with play or stiffness do; of rigid flanks means over saving intervals."""
    if history.formulation.forces_are_means:
        return history.formulation.forces(now).pressing
    return pressing_of(now.model.system, now.motions, now.followed)


def _multiplier_by_closure(now: Instant, solution: Any) -> dict[str, Any]:
    """The multiplier of the first row of every closure, by what closes the loop."""
    system = now.model.system
    every = constraints.multipliers_by_closure(system, now.motions, solution.multipliers)
    names = system.topology.loops
    return {name: r.get(0, 0.0) for name, (_, r) in zip(names, every, strict=True)}


def _geared(history: StateHistory, now: Instant, name: str, parts: tuple) -> Any:
    """The torque on the joint: what loads on the motor leave of its inertia; `parts` as
    `solve_instant` has it."""
    system, _, solution = parts
    motor = motor_name(name)
    geared_motor = system.geared[motor]
    branch = system.topology.branch_of(geared_motor.joint)
    index = system.topology.branches.index(branch)
    faster = geared_motor.ratio * solution.accelerations[index][0]
    coupling: Any = history.mechanism.couplings[name]
    force = -coupling.motor.inertia * faster
    for label, load in coordinate_loads(system):
        if motor in load.coordinates():
            acts, _ = load_rows(system, now.motions, label, now.time, now.followed)
            force = sp.add(force, acts.forces[load.coordinates().index(motor)])
    return jnp.asarray(geared_motor.ratio * force, float)
