"""Mechanisms of several spatial loops: chains of hinges whose tips are held, and shafts that double
Cardan shafts join beside each other."""

import numpy as np

import jaxclear as jc

LINKS = [(0.2, 0.0, 0.0), (0.1, 0.15, 0.05), (0.0, 0.2, -0.05), (-0.1, 0.1, 0.1), (0.1, 0.0, 0.15)]
# Where the tips are drawn, and how far they are from there.
TIP, OFF = np.sum(LINKS, axis=0), np.array([0.02, -0.03, 0.01])
AXES = [(np.sin(i), np.cos(i), 0.3 * i) for i in range(5)]
# Distance of two parallel shafts [m]; where the first Cardan shaft begins and ends along them, and
# how far the next ones are shifted.
DISTANCE, ENDS, SHIFTS = 0.1, (0.1, 0.5), (-0.1, 0.12)
SPEED, BRAKE = 10.0, 5.0


def hinge_loops(count, loads=None):
    """So many chains of five skew hinges, whose tips are held by ball joints."""
    bodies, connections = {}, {}
    for k in range(count):
        before, at = "ground", (0.0, 0.4 * k, 0.0)
        for i, (axis, link) in enumerate(zip(AXES, LINKS, strict=True)):
            name = f"link {k} {i}"
            bodies[name] = jc.Body(1.0, (1e-3, 2e-3, 3e-3), link)
            ends = jc.Marker(before, at, axis=axis), jc.Marker(name, (0.0, 0.0, 0.0), axis=axis)
            connections[f"hinge {k} {i}"] = jc.Connection(jc.joint.Revolute(), *ends)
            before, at = name, link
        tip = jc.Marker("ground", tuple(TIP + OFF + (0.0, 0.4 * k, 0.0))), jc.Marker(before, at)
        connections[f"ball {k}"] = jc.Connection(jc.joint.Spherical(), *tip)
    return jc.Mechanism(bodies, connections, loads or {})


def double_cardan(branches=2):
    """Shafts along z, joined by so many double Cardan shafts beside each other: the output turns as
    the input does."""
    hinge = jc.joint.Revolute(drive=jc.drive.ConstantSpeed(SPEED))
    bodies = {name: jc.Body(1.0, (1e-3, 1e-3, 1e-3)) for name in ("in", "out")}
    connections = {
        "inlet": jc.Connection(hinge, "ground", "in"),
        "outlet": jc.Connection(jc.joint.Revolute(), "ground", "out", at=(DISTANCE, 0, 0)),
    }
    guess = {}
    for k in range(branches):
        name = f"branch {k}"
        low, high = (end + k * shift for end, shift in zip(ENDS, SHIFTS, strict=True))
        length, slope = np.hypot(DISTANCE, high - low), np.arctan2(DISTANCE, high - low)
        bodies[name] = jc.Body(0.1, (1e-5, 1e-5, 1e-6), (0, 0, length / 2))
        for end, at, place in (("in", low, 0.0), ("out", high, length)):
            markers = jc.Marker(end, (0, 0, at)), jc.Marker(name, (0, 0, place))
            connections[f"{name} {end}"] = jc.Connection(jc.joint.Universal(), *markers)
        guess[f"{name} in"] = (0.0, slope)
    # Branches grow from the input; their far ends close loops.
    order = sorted(connections, key=lambda name: name.endswith(" out"))
    loads = {"brake": jc.load.JointTorque("outlet", -BRAKE)}
    return jc.Mechanism(bodies, {n: connections[n] for n in order}, loads, guess=guess)
