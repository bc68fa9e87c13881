"""From a mechanism with clearance joints to the one whose clearance joints are always in
contact."""

from jaxclear.components.body import Connection
from jaxclear.components.clearance import AbstractClearance
from jaxclear.components.joint import AbstractJoint, AbstractRubbingJoint
from jaxclear.multibody.mechanism import Mechanism, rebuilt


def fit(mechanism: Mechanism) -> Mechanism:
    """The mechanism with every clearance joint replaced by the joint that it is while it always
    touches.

    Starts and speeds are kept: they may name joints and bodies whatever holds them. Raises
    `ValueError` where a joint has no such form.
    """
    if not mechanism.topology.clearances:
        return mechanism
    connections = {}
    for name, connection in mechanism.connections.items():
        joint = connection.joint
        if name in mechanism.topology.clearances:
            joint = permanent_joint(name, joint)
        connections[name] = Connection(joint, connection.parent, connection.child)
    return rebuilt(mechanism, connections=connections)


def permanent_joint(name: str, joint: AbstractClearance) -> AbstractJoint:
    """The joint as which the clearance joint `name` moves while it always touches. Raises
    `ValueError` where none is known.
    """
    try:
        form = joint.permanent_form()
    except ValueError as error:
        raise ValueError(f'joint "{name}" {error}') from None
    if joint.maps() and not isinstance(form, AbstractRubbingJoint):
        raise ValueError(
            f'joint "{name}" is a {type(joint).__name__} that wears, whose form in permanent '
            f"contact, {type(form).__name__}, tells of no wear; leave its wear out, or take a "
            "compliant integrator such as ImplicitStep."
        )
    return form
