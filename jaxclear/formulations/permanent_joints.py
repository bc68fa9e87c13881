"""From a mechanism with clearance joints to the one whose clearance joints are always in
contact."""

import jax.numpy as jnp

from jaxclear.components.body import Connection
from jaxclear.components.clearance import AbstractClearance
from jaxclear.components.joint import AbstractJoint
from jaxclear.multibody import assembly, kinematics
from jaxclear.multibody.loops import reverse
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.state import unpack_motion
from jaxclear.multibody.system import prepare
from jaxclear.multibody.topology import Branch, grow


def fit(mechanism: Mechanism) -> Mechanism:
    """The mechanism with every clearance joint replaced by the joint that it is while it always
    touches.

    Starts and speeds of bodies that floated between clearance joints become those of the joints
    that hold them now, as they follow once journals are concentric; those of joints that now close
    a loop are dropped, these follow. Raises `ValueError` where a joint has no such form.
    """
    if not mechanism.topology.clearances:
        return mechanism
    connections = {}
    for name, connection in mechanism.connections.items():
        joint = connection.joint
        if name in mechanism.topology.clearances:
            joint = permanent_joint(name, joint)
        connections[name] = Connection(joint, connection.parent, connection.child)
    branches = {branch.name: branch for branch in grow(mechanism.bodies, connections).branches}
    start, speeds = (
        {n: g for n, g in given.items() if n in branches}
        for given in (mechanism.start, mechanism.speeds)
    )
    floating = {b.body for b in mechanism.topology.branches if b.connection is None}
    if floating & {*mechanism.start, *mechanism.speeds}:
        taken = [
            branch for name, branch in branches.items() if name in mechanism.topology.clearances
        ]
        for name, (coordinates, rates) in _carried_over(mechanism, taken).items():
            start[name], speeds[name] = coordinates, rates
    return Mechanism(
        mechanism.bodies,
        connections,
        mechanism.loads,
        start=start,
        speeds=speeds,
        stabilisation=mechanism.stabilisation,
    )


def _carried_over(mechanism: Mechanism, branches: list[Branch]) -> dict[str, tuple[tuple, ...]]:
    """Coordinates and speeds, by connection, of what were clearance joints, from the mechanism's
    concentric start.
    """
    found = assembly.assembled(mechanism, True)
    system = prepare(mechanism)
    motions = kinematics.link_motions(
        system, *unpack_motion(system, [*found.coordinates, *found.speeds]), 0.0
    )
    out: dict[str, tuple[tuple, ...]] = {}
    for branch in branches:
        bearing = system.bearings[branch.name]
        relative = kinematics.relative_motion(bearing.closure, motions)[2]
        joint = permanent_joint(branch.name, bearing.joint)
        if branch.reversed:
            relative = reverse(relative, joint.reversal)
        parts = (joint.coordinates_at(relative.pose), joint.speeds_at(*relative))
        out[branch.name] = tuple(tuple(jnp.asarray(x, float) for x in p) for p in parts)
    return out


def permanent_joint(name: str, joint: AbstractClearance) -> AbstractJoint:
    """The joint as which the clearance joint `name` moves while it always touches. Raises
    `ValueError` where none is known.
    """
    if joint.maps():
        raise ValueError(
            f'joint "{name}" wears, which integrator.NonColliding does not follow; leave its wear '
            "out, or take a compliant integrator such as ImplicitStep."
        )
    try:
        return joint.permanent_form()
    except ValueError as error:
        raise ValueError(f'joint "{name}" {error}') from None
