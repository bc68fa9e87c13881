"""Mechanisms that hang in joints with clearance, their numbers drawn at random."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx

import jaxclear as jc
from benchmarks.attacks.laws import Maker
from benchmarks.attacks.numbers import Draw


class Laws(NamedTuple):
    """What acts in the joints of a mechanism; None: absent."""

    contact: Maker
    friction: Maker | None
    wear: Maker | None


class Case(NamedTuple):
    """A mechanism, how long it runs [s], whether its journals start concentric, the mechanism
    in the form in which references take it, where that is another, and whether its journals start
    pressed into their bearings by what they carry."""

    mechanism: jc.Mechanism
    duration: float
    concentric: bool = True
    reference: jc.Mechanism | None = None
    seated: bool = False


Build = Callable[[Draw, Laws], Case]
SHORT, LONG = 0.01, 0.05


def _given(maker: Maker | None, n: Draw) -> Any:
    return None if maker is None else maker(n)


def _wearing(laws: Laws, n: Draw, cells: tuple[int, int]) -> jc.Wearing | None:
    return None if laws.wear is None else jc.Wearing(laws.wear(n), cells)


def _clearance(n: Draw) -> float:
    return n.log(1e-5, 5e-4, 1e-4)


def _duration(n: Draw) -> float:
    return n.log(SHORT, LONG, 0.02)


def planar(n: Draw, laws: Laws) -> jc.clearance.PlanarJournalBearing:
    """A planar bearing of 2 to 50 mm."""
    return jc.clearance.PlanarJournalBearing(
        laws.contact(n),
        _given(laws.friction, n),
        bearing_radius=n.log(2e-3, 50e-3, 10e-3),
        clearance=_clearance(n),
        length=n.log(5e-3, 50e-3, 20e-3),
        bearing_wear=_wearing(laws, n, (24, 1)),
    )


def spatial(n: Draw, laws: Laws) -> jc.clearance.JournalBearing:
    """A bearing with collars whose journal can tilt."""
    contact, friction = laws.contact(n), _given(laws.friction, n)
    radius = n.log(5e-3, 30e-3, 10e-3)
    return jc.clearance.JournalBearing(
        contact,
        friction,
        bearing_radius=radius,
        clearance=_clearance(n),
        length=n.log(10e-3, 50e-3, 20e-3),
        flange=jc.clearance.Flange(
            contact, friction, radius=1.4 * radius, clearance=n.log(5e-5, 1e-3, 2e-4)
        ),
        bearing_wear=_wearing(laws, n, (24, 4)),
    )


def socket(n: Draw, laws: Laws) -> jc.clearance.BallSocket:
    """A ball in its socket."""
    return jc.clearance.BallSocket(
        laws.contact(n),
        _given(laws.friction, n),
        socket_radius=n.log(5e-3, 30e-3, 10e-3),
        clearance=_clearance(n),
        socket_wear=_wearing(laws, n, (16, 8)),
    )


def corners(n: Draw, laws: Laws) -> jc.clearance.SliderGuide:
    """A slider in its guide. It does not wear."""
    return jc.clearance.SliderGuide(
        laws.contact(n),
        _given(laws.friction, n),
        width=n.log(10e-3, 50e-3, 20e-3),
        length=n.log(20e-3, 100e-3, 40e-3),
        clearance=_clearance(n),
    )


def loaded_bearing(n: Draw, laws: Laws) -> Case:
    """A journal that turns in its bearing, pressed down by 1 to 5000 N: falls, bounces, rubs."""
    mass, load = n.log(0.1, 10.0, 1.0), n.log(1.0, 5000.0, 500.0)
    rig = jc.Mechanism(
        {"journal": jc.Body(mass, mass * n.log(1e-4, 1e-2, 1e-3))},
        {"B": jc.Connection(planar(n, laws), "ground", "journal")},
        {"load": jc.load.Force(jc.Marker("journal"), (n.flat(-0.3, 0.3) * load, -load))},
        speeds={"journal": (0.0, 0.0, n.sign() * n.log(1.0, 300.0, 20.0))},
    )
    return Case(rig, _duration(n))


def creeping_bearing(n: Draw, laws: Laws) -> Case:
    """A pressed journal under a torque that its friction can hold, or hardly: it creeps."""
    mass, load = n.log(0.1, 10.0, 1.0), n.log(10.0, 5000.0, 500.0)
    bearing = planar(n, laws)
    torque = load * float(bearing.bearing_radius) * n.log(1e-3, 0.3, 0.03)
    rig = jc.Mechanism(
        {"journal": jc.Body(mass, mass * n.log(1e-4, 1e-2, 1e-3))},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {
            "load": jc.load.Force(jc.Marker("journal"), (0.0, -load)),
            "torque": jc.load.Torque(jc.Marker("journal"), torque),
        },
    )
    return Case(rig, _duration(n))


def thrown_journal(n: Draw, laws: Laws) -> Case:
    """A journal thrown against its wall, under gravity alone."""
    mass, speed = n.log(0.1, 10.0, 1.0), n.log(0.01, 5.0, 0.5)
    bearing = planar(n, laws)
    rig = jc.Mechanism(
        {"journal": jc.Body(mass, mass * n.log(1e-4, 1e-2, 1e-3))},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {"gravity": jc.load.Gravity()},
        speeds={"journal": (n.flat(-0.5, 0.5, 0.1) * speed, -speed, n.flat(-50.0, 50.0, 5.0))},
    )
    # Four flights across the gap, so that paths can still be told.
    return Case(rig, 8 * float(bearing.clearance) / speed, concentric=False)


def pendulum(n: Draw, laws: Laws) -> Case:
    """An arm that swings on a bearing."""
    length, mass = n.log(0.05, 1.0, 0.3), n.log(0.1, 10.0, 1.0)
    rig = jc.Mechanism(
        {"arm": jc.Body(mass, mass * length**2 / 12, (0.5 * length, 0.0))},
        {"B": jc.Connection(planar(n, laws), "ground", "arm")},
        {"gravity": jc.load.Gravity()},
        start={"arm": (0.0, 0.0, n.flat(-1.5, 1.5, -0.5))},
    )
    return Case(rig, n.log(0.02, 0.1, 0.05))


def double_pendulum(n: Draw, laws: Laws) -> Case:
    """Two arms on two bearings, hanging from the ground."""
    length, masses = n.log(0.1, 0.5, 0.3), (n.log(0.3, 3.0, 1.0), n.log(0.3, 3.0, 1.0))
    angle = n.flat(-1.5, 0.0, -1.0)
    bodies = {
        name: jc.Body(mass, mass * length**2 / 12, (0.5 * length, 0.0))
        for name, mass in zip(("upper", "lower"), masses, strict=True)
    }
    joint = planar(n, laws)
    rig = jc.Mechanism(
        bodies,
        {
            "B": jc.Connection(joint, "ground", "upper"),
            "C": jc.Connection(joint, "upper", "lower", at=(length, 0.0)),
        },
        {"gravity": jc.load.Gravity()},
        start={"upper": (0.0, 0.0, angle)},
        guess={"lower": (0.0, -length, angle)},
    )
    return Case(rig, n.log(0.02, 0.06, 0.04))


def slider_crank(n: Draw, laws: Laws) -> Case:
    """The scene, from crawling to 5000 rpm."""
    speed = n.log(5.0, 520.0, 50.0)
    rig = jc.scenes.slider_crank(crank_speed=speed)
    return Case(_with(rig, {"B": planar(n, laws)}), min(LONG, n.flat(0.5, 2.0, 1.0) / speed))


def slider_crank_of_two(n: Draw, laws: Laws) -> Case:
    """A slider-crank with clearance at both ends of its rod, ramped up."""
    speed, joint = n.log(5.0, 300.0, 50.0), planar(n, laws)
    drive = jc.drive.RampUp(speed, n.log(0.01, 0.1, 0.05))
    scene = jc.scenes.slider_crank(drive=drive)
    ends = {name: jc.Connection(joint, c.parent, c.child) for name, c in _ends(scene).items()}
    connections = scene.connections | ends
    rig = jc.Mechanism(
        scene.bodies, connections, scene.loads, start={"G": 0.17, "rod": (0.05, 0.0, 0.0)}
    )
    return Case(rig, _duration(n))


def _ends(scene: jc.Mechanism) -> dict[str, jc.Connection]:
    return {name: scene.connections[name] for name in ("A", "B")}


def torque_crank(n: Draw, laws: Laws) -> Case:
    """A slider-crank whose free crank is pushed by a torque against a spring at the slider."""
    scene = jc.scenes.slider_crank(drive=jc.drive.ConstantSpeed(1.0))
    free = jc.Connection(jc.joint.Revolute(), "ground", "crank")
    angle = n.flat(0.3, 1.2, 0.6)
    rig = jc.Mechanism(
        scene.bodies,
        scene.connections | {"O": free, "B": _at(scene, "B", planar(n, laws))},
        dict(scene.loads)
        | {
            "torque": jc.load.JointTorque("O", n.log(0.1, 20.0, 2.0)),
            "spring": jc.load.JointSpring(
                "G", n.log(1e2, 1e5, 1e3), rest=0.15, damping=n.log(1.0, 1e2, 10.0)
            ),
        },
        start={"O": angle},
        guess={"A": -1.4 * angle, "G": 0.15},
    )
    return Case(rig, _duration(n))


def four_bar(n: Draw, laws: Laws) -> Case:
    """The planar four-bar with other laws."""
    speed = n.log(5.0, 200.0, 20.0)
    rig = jc.scenes.four_bar("planar", crank_speed=speed)
    return Case(_with(rig, {"B": planar(n, laws)}), min(LONG, n.flat(0.3, 1.0, 0.5) / speed))


def four_bar_in_space(n: Draw, laws: Laws) -> Case:
    """The spatial four-bar with other laws."""
    speed = n.log(5.0, 100.0, 10.0)
    rig = jc.scenes.four_bar("spatial", crank_speed=speed)
    return Case(_with(rig, {"B": spatial(n, laws)}), min(0.03, n.flat(0.1, 0.5, 0.3) / speed))


def rotating_guide(n: Draw, laws: Laws) -> Case:
    """The scene of the slider in a rotating guide."""
    speed = n.log(2.0, 50.0, 5.0)
    rig = jc.scenes.guide(crank_speed=speed, friction=None)
    return Case(_with(rig, {"P": corners(n, laws)}), _duration(n))


def pushed_slider(n: Draw, laws: Laws) -> Case:
    """A slider in a fixed guide along x, pushed off its middle."""
    mass, load = n.log(0.1, 10.0, 1.0), n.log(1.0, 2000.0, 100.0)
    at = jc.Marker("slider", (0.0, n.flat(-0.02, 0.02, 0.01)))
    rig = jc.Mechanism(
        {"slider": jc.Body(mass, mass * n.log(1e-4, 1e-2, 1e-3))},
        {
            "G": jc.Connection(
                corners(n, laws), jc.Marker("ground", axis="x"), jc.Marker("slider", axis="x")
            )
        },
        {
            "gravity": jc.load.Gravity(),
            "push": jc.load.Force(at, (load, n.flat(-0.5, 0.5, 0.2) * load)),
        },
    )
    return Case(rig, _duration(n))


def _massive(n: Draw, com: tuple[float, float, float]) -> jc.Body:
    mass, size = n.log(0.1, 10.0, 1.0), n.log(1e-4, 1e-2, 1e-3)
    return jc.Body(mass, (mass * size, 1.5 * mass * size, 1.2 * mass * size), com)


def ball_in_socket(n: Draw, laws: Laws) -> Case:
    """A body that spins in a socket, pressed against it."""
    load = n.log(1.0, 5000.0, 300.0)
    spin = n.log(1.0, 100.0, 10.0)
    rig = jc.Mechanism(
        {"ball": _massive(n, (0.0, 0.0, n.flat(-0.05, 0.05, 0.02)))},
        {"B": jc.Connection(socket(n, laws), "ground", "ball")},
        {"load": jc.load.Force(jc.Marker("ball"), (0.1 * load, -load, 0.2 * load))},
        speeds={"ball": (0.0, 0.0, 0.0, 0.3 * spin, 0.1 * spin, spin)},
    )
    return Case(rig, _duration(n))


def ball_pendulum(n: Draw, laws: Laws) -> Case:
    """A body that hangs from a socket and swings out of plane."""
    rig = jc.Mechanism(
        {"bob": _massive(n, (n.log(0.05, 0.5, 0.2), 0.0, 0.0))},
        {"B": jc.Connection(socket(n, laws), "ground", "bob")},
        {"gravity": jc.load.Gravity((0.0, n.flat(-9.81, 0.0, -5.0), -9.81))},
    )
    return Case(rig, _duration(n))


def rotor(n: Draw, laws: Laws) -> Case:
    """A rotor in one bearing with collars, loaded beside its middle."""
    load, spin = n.log(1.0, 2000.0, 100.0), n.log(1.0, 300.0, 30.0)
    at = jc.Marker("rotor", (0.0, 0.0, n.flat(-0.02, 0.02, 0.01)))
    rig = jc.Mechanism(
        {"rotor": _massive(n, (0.0, 0.0, n.flat(-0.01, 0.01, 0.005)))},
        {"B": jc.Connection(spatial(n, laws), "ground", "rotor")},
        {"load": jc.load.Force(at, (0.1 * load, -load, 0.1 * load))},
        speeds={"rotor": (0.0, 0.0, 0.0, 0.0, 0.0, spin)},
    )
    return Case(rig, n.log(0.005, 0.02, 0.01))


def _with(rig: jc.Mechanism, joints: dict[str, Any]) -> jc.Mechanism:
    """The mechanism with other joints of the same kind."""
    for name, joint in joints.items():
        rig = eqx.tree_at(lambda m, name=name: m.connections[name].joint, rig, joint)
    return rig


def _at(rig: jc.Mechanism, name: str, joint: Any) -> jc.Connection:
    old = rig.connections[name]
    return jc.Connection(joint, old.parent, old.child)
