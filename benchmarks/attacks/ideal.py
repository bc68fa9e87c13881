"""Mechanisms without clearance, their numbers drawn at random: chains, loops, springs, spins."""

import math

import jaxclear as jc
from benchmarks.attacks.bearings import Case, Laws
from benchmarks.attacks.numbers import Draw

LINKS = 5


def _chain(n: Draw, stiffness: float | None, damping: float | None) -> Case:
    """Links that hang in a row; stiff springs or dampers in the hinges."""
    length, mass = n.log(0.02, 0.3, 0.1), n.log(0.01, 3.0, 0.1)
    names = [f"link {k}" for k in range(LINKS)]
    bodies = {name: jc.Body(mass, mass * length**2 / 12, (0.5 * length, 0.0)) for name in names}
    hinges = {"hinge 0": jc.Connection(jc.joint.Revolute(), "ground", "link 0")}
    for k in range(1, LINKS):
        hinges[f"hinge {k}"] = jc.Connection(
            jc.joint.Revolute(), names[k - 1], names[k], at=(length, 0.0)
        )
    # In units of what gravity does to a link.
    scale = mass * 9.81 * length
    loads: dict[str, jc.load.AbstractLoad] = {
        f"spring {name}": jc.load.JointSpring(
            name,
            None if stiffness is None else scale * stiffness,
            damping=None if damping is None else 0.1 * scale * damping,
        )
        for name in hinges
    }
    loads["gravity"] = jc.load.Gravity()
    start = {"hinge 0": n.flat(-1.5, 1.5, -0.5)}
    speeds = {"hinge 0": n.flat(-5.0, 5.0, 2.0)}
    rig = jc.Mechanism(bodies, hinges, loads, start=start, speeds=speeds)
    return Case(rig, n.log(0.02, 0.1, 0.05))


def damped_chain(n: Draw, laws: Laws) -> Case:
    """Dampers from soft to far stiffer than any step."""
    return _chain(n, None, n.log(1.0, 1e4, 1e2))


def sprung_chain(n: Draw, laws: Laws) -> Case:
    """Springs from soft to stiff."""
    return _chain(n, n.log(1.0, 1e5, 1e2), n.log(1e-2, 10.0, 0.1))


def bob_on_spring(n: Draw, laws: Laws) -> Case:
    """A body between springs, one of them stiff."""
    mass = n.log(0.01, 10.0, 1.0)
    anchors = {"near": (0.1, 0.0), "far": (-0.2, 0.1)}
    stiff = {"near": n.log(1e2, 1e7, 1e4), "far": n.log(10.0, 1e3, 100.0)}
    loads: dict[str, jc.load.AbstractLoad] = {
        name: jc.load.Spring(
            jc.Marker("ground", place),
            jc.Marker("bob", (0.01, 0.02)),
            stiff[name],
            free_length=n.flat(0.05, 0.15, 0.1),
            damping=n.log(0.1, 1e4, 10.0),
        )
        for name, place in anchors.items()
    }
    loads["gravity"] = jc.load.Gravity()
    rig = jc.Mechanism(
        {"bob": jc.Body(mass, mass * n.log(1e-5, 1e-2, 1e-3))},
        {"plane": jc.Connection(jc.joint.Planar(), "ground", "bob")},
        loads,
    )
    return Case(rig, n.log(0.02, 0.1, 0.05))


def ideal_slider_crank(n: Draw, laws: Laws) -> Case:
    """The scene with an ideal joint, up to 9000 rpm."""
    speed = n.log(10.0, 950.0, 100.0)
    return Case(jc.scenes.slider_crank("ideal", crank_speed=speed), n.flat(1.0, 6.0, 3.0) / speed)


def projected_slider_crank(n: Draw, laws: Laws) -> Case:
    """The same, its loop closed by projection."""
    case = ideal_slider_crank(n, laws)
    scene = case.mechanism
    rig = jc.Mechanism(
        scene.bodies,
        scene.connections,
        scene.loads,
        start={"G": 0.17},
        stabilisation=jc.Projection(),
    )
    return Case(rig, case.duration, reference=scene)


def ideal_four_bar(n: Draw, laws: Laws) -> Case:
    """The ideal four-bar."""
    speed = n.log(5.0, 500.0, 50.0)
    return Case(jc.scenes.four_bar("ideal", crank_speed=speed), n.flat(0.5, 3.0, 1.0) / speed)


def free_slider_crank(n: Draw, laws: Laws) -> Case:
    """An ideal slider-crank whose free crank is driven by a torque."""
    scene = jc.scenes.slider_crank("ideal")
    free = jc.Connection(jc.joint.Revolute(), "ground", "crank")
    angle = n.flat(0.3, 1.2, 0.6)
    rig = jc.Mechanism(
        scene.bodies,
        scene.connections | {"O": free},
        dict(scene.loads) | {"torque": jc.load.JointTorque("O", n.log(0.1, 20.0, 2.0))},
        start={"O": angle},
        guess={"A": -1.4 * angle, "G": 0.15},
    )
    return Case(rig, n.log(0.01, 0.05, 0.02))


def tumbling_body(n: Draw, laws: Laws) -> Case:
    """A free body that spins about its middle axis."""
    spin = n.log(1.0, 1000.0, 50.0)
    rig = jc.Mechanism(
        {"body": jc.Body(n.log(0.1, 10.0, 1.0), (1e-3, 2e-3, 2.5e-3), (0.01, 0.02, 0.0))},
        {"free": jc.Connection(jc.joint.Free(), "ground", "body")},
        {"gravity": jc.load.Gravity((0.0, 0.0, -9.81))},
        speeds={"free": (0.3, 0.1, 0.0, 0.01 * spin, spin, 0.02 * spin)},
    )
    return Case(rig, min(0.1, 4 * math.pi / spin))


def spatial_chain(n: Draw, laws: Laws) -> Case:
    """Ball joint, universal joint and cylindrical joint in a row, swinging in space."""
    length, mass = n.log(0.05, 0.5, 0.2), n.log(0.1, 5.0, 1.0)
    inertia = tuple(mass * length**2 * share for share in (0.02, 0.08, 0.09))
    bodies = {name: jc.Body(mass, inertia, (0.5 * length, 0.0, 0.01)) for name in ("a", "b", "c")}
    at = (length, 0.0, 0.0)
    rig = jc.Mechanism(
        bodies,
        {
            "ball": jc.Connection(jc.joint.Spherical(), "ground", "a"),
            "cross": jc.Connection(jc.joint.Universal(), "a", "b", at=at),
            "slide": jc.Connection(jc.joint.Cylindrical(), "b", "c", at=at, axis="y"),
        },
        {"gravity": jc.load.Gravity((0.0, -3.0, -9.81))},
        speeds={"ball": (n.flat(-5.0, 5.0, 1.0), n.flat(-5.0, 5.0, 2.0), n.flat(-20.0, 20.0, 5.0))},
    )
    return Case(rig, n.log(0.02, 0.1, 0.05))


def shaken_slide(n: Draw, laws: Laws) -> Case:
    """A slide shaken by a harmonic drive, with a pendulum on it."""
    length = n.log(0.05, 0.5, 0.2)
    shaking = jc.drive.Harmonic(n.log(1e-3, 5e-2, 1e-2), n.log(5.0, 500.0, 50.0))
    rig = jc.Mechanism(
        {"slide": jc.Body(1.0, 1e-3), "arm": jc.Body(0.5, 1e-3, (0.5 * length, 0.0))},
        {
            "S": jc.Connection(
                jc.joint.Prismatic(drive=shaking),
                jc.Marker("ground", axis="x"),
                jc.Marker("slide", axis="x"),
            ),
            "H": jc.Connection(jc.joint.Revolute(), "slide", "arm"),
        },
        {"gravity": jc.load.Gravity()},
        start={"H": n.flat(-1.5, 1.5, -1.0)},
    )
    return Case(rig, n.log(0.02, 0.1, 0.05))
