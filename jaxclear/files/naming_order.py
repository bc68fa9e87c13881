"""In which order the names of a mechanism are written. JAX sorts the keys of dictionaries when it
changes a number, and the spanning tree grows by the order of the names: they are written so that
it grows as it is.
"""

import dataclasses

from jaxclear.components.body import Body, Connection
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.topology import grow

__all__ = ["bodies_in_order", "connections_in_order"]


def _grows_alike(mechanism: Mechanism) -> bool:
    known = dataclasses.replace(mechanism.topology, redundancy=None)
    return grow(mechanism.bodies, mechanism.connections) == known


def bodies_in_order(mechanism: Mechanism) -> dict[str, Body]:
    """The bodies, as given or in the order of the tree."""
    if _grows_alike(mechanism):
        return mechanism.bodies
    return {branch.body: mechanism.bodies[branch.body] for branch in mechanism.topology.branches}


def connections_in_order(mechanism: Mechanism) -> dict[str, Connection]:
    """The connections, as given or in the order of tree, loops and clearances."""
    if _grows_alike(mechanism):
        return mechanism.connections
    topology = mechanism.topology
    held = [branch.connection for branch in topology.branches if branch.connection is not None]
    return {n: mechanism.connections[n] for n in (*held, *topology.loops, *topology.clearances)}
