"""The damping of stops that say which share of a speed comes back, where their force is that of a
spring: it follows from the inertia along their coordinate where a run starts.

Nothing here is evaluated in a mechanism without such stops, nor where stops are rigid.
"""

import dataclasses
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.acting import AbstractStateLoad
from jaxclear.formulations.base import AbstractFormulation, model_of
from jaxclear.formulations.contact_rows import ContactJacobianRow
from jaxclear.formulations.loads_over_step import (
    coordinates_of,
    found_over_steps,
    impulse_of,
)
from jaxclear.laws.rebound import damping_ratio_of
from jaxclear.multibody import constraints, dynamics, kinematics, tree
from jaxclear.multibody.constraints import ClosureEquations
from jaxclear.multibody.mechanism import Mechanism, rebuilt
from jaxclear.multibody.state import Followed, unpack_motion
from jaxclear.multibody.system import System


def undamped(load: Any) -> bool:
    """Whether the damping of a load follows from its restitution."""
    if not isinstance(load, AbstractStateLoad):
        return False
    stops = [side.stop for side in load.sides()]
    return any(
        stop.damping is None and None not in (stop.restitution, stop.stiffness) for stop in stops
    )


def with_damped_stops(
    mechanism: Mechanism,
    formulation: AbstractFormulation,
    coordinates: Float[Array, " q"],
    speeds: Float[Array, " v"],
    time: Any,
) -> Mechanism:
    """The mechanism with the damping of its stops, for a run that begins at this motion."""
    names = [name for name, load in mechanism.loads.items() if undamped(load)]
    if not names or formulation.forces_are_means:
        return mechanism
    system = found_over_steps(model_of(mechanism, formulation).system)
    q, v = unpack_motion(system, jnp.concatenate([coordinates, speeds]))
    motions = kinematics.link_motions(system, q, v, time)
    at = coordinates_of(system, motions, time, Followed())
    loads = dict(mechanism.loads)
    for name in names:
        stop: Any = loads[name]
        inertia = 1 / lightness_along(system, motions, at[impulse_of(name)].row, mechanism)
        ratio = damping_ratio_of(stop.restitution)
        damping = 2 * ratio * jnp.sqrt(stop.stiffness * inertia)
        loads[name] = dataclasses.replace(stop, damping=damping)
    return rebuilt(mechanism, loads=loads)


def lightness_along(
    system: System, motions: tuple, row: ContactJacobianRow, mechanism: Mechanism
) -> Any:
    """By how much a unit of force along a row accelerates it, the loops closed."""
    masses: list[Any] = [
        tree.mass_matrix(*kinematics.by_subtree(subtree, system.links, motions))
        for subtree in system.topology.subtrees
    ]
    loops = ClosureEquations([], [], (), None)
    if system.closures:
        loops = constraints.acceleration_equations(system, motions, mechanism.baumgarte)
    respond, constrain = dynamics.constrained_inverse(
        masses, loops.rows, loops.alike, loops.dependence
    )
    size = sum(len(mass) for mass in masses)
    (moved,) = respond([[row.get(j, 0) for j in range(size)]])
    moved, _ = constrain(moved, [0] * len(loops.rows))
    return kinematics.along(row, moved)
