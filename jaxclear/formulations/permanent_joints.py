"""From a mechanism with clearance joints to the one whose clearance joints are always in
contact."""

import jax.numpy as jnp
import jaxlie

from jaxclear.components.body import Connection
from jaxclear.components.clearance import AbstractClearance
from jaxclear.components.permanent import AbstractPermanentJoint, PermanentRevolute, permanent_joint
from jaxclear.ground import sparse as sp
from jaxclear.multibody import assembly, kinematics
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
        held = permanent_joint(name, joint) if isinstance(joint, AbstractClearance) else joint
        connections[name] = Connection(held, connection.parent, connection.child)
    branches = {
        branch.connection or branch.body: branch
        for branch in grow(mechanism.bodies, connections).branches
    }
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


def _carried_over(mechanism: Mechanism, branches: list[Branch]) -> dict[str, tuple[tuple, tuple]]:
    """Coordinates and speeds, by connection, of what were clearance joints, from the mechanism's
    concentric start.
    """
    found = assembly.assembled(mechanism, True)
    system = prepare(mechanism)
    motions = kinematics.link_motions(
        system, *unpack_motion(system, [*found.coordinates, *found.speeds]), 0.0
    )
    out: dict[str, tuple[tuple, tuple]] = {}
    for branch in branches:
        bearing = system.bearings[branch.connection]
        _, pose, relative = kinematics.relative_motion(bearing.closure, motions)
        joint = permanent_joint(branch.connection, bearing.joint)
        if not isinstance(joint, AbstractPermanentJoint):
            out[branch.connection] = _ball(pose.rotation, relative.spin, branch.reversed)
            continue
        place = pose.translation[2]
        if isinstance(joint, PermanentRevolute):
            place = jnp.arctan2(*(jnp.asarray(pose.rotation[i][0], float) for i in (1, 0)))
        out[branch.connection] = (place,), (joint.along(relative.velocity, relative.spin),)
    return {
        name: tuple(tuple(jnp.asarray(x, float) for x in part) for part in pair)
        for name, pair in out.items()
    }


def _ball(rotation: sp.Mat, spin: sp.Vec, turned: bool) -> tuple[tuple, tuple]:
    """Quaternion and speeds of a ball, whose axes are those of the tree's outer side; `turned`:
    that is the parent's.
    """
    matrix, spin = jnp.stack([sp.stack(row) for row in rotation]), sp.stack(spin)
    matrix, speeds = (matrix.T, -spin) if turned else (matrix, matrix.T @ spin)
    return tuple(jaxlie.SO3.from_matrix(matrix).wxyz), tuple(speeds)
