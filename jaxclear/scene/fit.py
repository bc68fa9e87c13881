"""From a mechanism with clearance joints to the one whose clearance joints are always in contact."""

from jaxclear.components.body import Connection
from jaxclear.components.clearance import AbstractClearance
from jaxclear.components.fitted import AbstractFitted, fitted_joint
from jaxclear.scene.mechanism import Mechanism
from jaxclear.scene.topology import grow


def fit(mechanism: Mechanism) -> Mechanism:
    """The mechanism with every clearance joint replaced by the joint that it is while it always touches.

    Starting values of bodies that floated between clearance joints are dropped: these are held now; so are those of joints that
    now close a loop, which follow. Raises `ValueError` where a joint has no such form, or where one with friction would close
    a loop.
    """
    if not mechanism.topology.clearances:
        return mechanism
    connections = {}
    for name, connection in mechanism.connections.items():
        joint = connection.joint
        held = fitted_joint(name, joint) if isinstance(joint, AbstractClearance) else joint
        connections[name] = Connection(held, connection.parent, connection.child)
    held = {branch.connection or branch.body for branch in grow(mechanism.bodies, connections).branches}
    start, speeds = ({n: g for n, g in given.items() if n in held} for given in (mechanism.start, mechanism.speeds))
    out = Mechanism(
        mechanism.bodies, connections, mechanism.loads, start=start, speeds=speeds, stabilisation=mechanism.stabilisation
    )
    for name in out.topology.loops:
        joint = connections[name].joint
        if isinstance(joint, AbstractFitted) and joint.friction is not None:
            raise ValueError(
                f'joint "{name}" closes a loop of the mechanism, where integrator.NonColliding knows no friction; leave its '
                "friction out, or make another joint of the loop one that closes it (with more freedoms, spherical say)."
            )
    return out
