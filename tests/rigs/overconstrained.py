"""Linkages that move although their joints are more than their freedoms would need: parallel
cranks, and rings of skew hinges, whose links are given by the distance and the twist from one hinge
to the next (Denavit and Hartenberg)."""

import numpy as np

import jaxclear as jc

GRAVITY = 9.81
# Parallel cranks: their length, how far apart they stand, masses.
LENGTH, APART, CRANK, COUPLER = 0.1, 0.15, 0.3, 0.8


def parallel_cranks(count=3, longer=0.0, spatial=False, start=None, crank=None, **kwargs):
    """Cranks of one length on the ground that carry a coupler; `longer`: by how much the second one
    is."""
    beyond = (0.0,) if spatial else ()
    solid = lambda size: (size, size, size) if spatial else size
    crank = jc.joint.Revolute() if crank is None else crank
    bodies = {
        f"crank {i}": jc.Body(CRANK, solid(1e-3), (0.5 * LENGTH, 0.0, *beyond))
        for i in range(count)
    }
    centre = (0.5 * APART * (count - 1) + 0.02, 0.01, *beyond)
    bodies["coupler"] = jc.Body(COUPLER, solid(5e-3), centre)
    connections = {}
    for i in range(count):
        place = (APART * i, 0.0, *beyond)
        hinge = crank if i == 0 else jc.joint.Revolute()
        connections[f"foot {i}"] = jc.Connection(hinge, "ground", f"crank {i}", at=place)
        tip = (LENGTH + longer * (i == 1), 0.0, *beyond)
        held = jc.Marker("coupler", place)
        connections[f"top {i}"] = jc.Connection(
            jc.joint.Revolute(), jc.Marker(f"crank {i}", tip), held
        )
    loads = {"gravity": jc.load.Gravity((0.0, -GRAVITY, *beyond))}
    return jc.Mechanism(bodies, connections, loads, start=start, **kwargs)


def ring(distances, twists, first=None, **kwargs):
    """Links joined in a ring by revolute joints "1", "2", ... whose angles are those of Denavit and
    Hartenberg; the ground is the first link, joint "0" closes the ring."""
    count = len(distances)
    link = jc.Body(0.5, (1e-3, 2e-3, 2e-3), (0.05, 0.0, 0.0))
    names = ["ground", *(f"link {i}" for i in range(1, count))]
    connections = {}
    for i, (distance, twist) in enumerate(zip(distances, twists, strict=True)):
        far = jc.Marker(
            names[i],
            (distance, 0.0, 0.0),
            quaternion=(np.cos(twist / 2), np.sin(twist / 2), 0.0, 0.0),
        )
        hinge = jc.joint.Revolute() if i or first is None else first
        near = jc.Marker(names[(i + 1) % count], (0.0, 0.0, 0.0))
        connections[str((i + 1) % count)] = jc.Connection(hinge, far, near)
    loads = {"gravity": jc.load.Gravity((0.0, 0.0, -GRAVITY))}
    return jc.Mechanism(dict.fromkeys(names[1:], link), connections, loads, **kwargs)
