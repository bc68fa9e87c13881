r"""A robot arm of seven joints, xArm7 of UFACTORY, that picks a part and places it.

Source: `xarm_description/urdf/xarm7.urdf` of example-robot-data 6.0.0 (BSD-3-Clause, from
github.com/xArm-Developer/xarm_ros2): masses, centres, inertias, places and axes of the joints,
their limits, efforts, damping and friction, and the ratio of 100 of all reducers. The file rounds
its quarter turns to 1.5708; here they are exact.

Assumed, because the file does not say: reducers of the sizes 20, 17 and 14 of a strain-wave series
by the joints' effort, of the stiffness K2 of that series (Harmonic Drive AG, Engineering Data AC
Servo Actuators CHA, 1018854, tables 50.1 to 50.4, ratios beyond 50: 25, 14 and 6.1 kN m/rad; lost
motion below 1 arcmin), and damped by a tenth of critical beside their rotor; rotors of 20, 10 and 4
kg mm2; a gripper with its part of 1 kg on the flange, that holds it 60 mm beside the last axis;
friction that reaches three quarters of its torque at 0.1 rad/s; servos of 5 Hz, damped by 0.7, that
are told gravity and the joints' damping along the path. Both flanks of a reducer lie at half its
play.

The last axis goes through the flange, so what the play of joint 7 does is seen beside it alone.
"""

from collections.abc import Sequence
from itertools import pairwise
from math import pi, sqrt
from typing import Any, NamedTuple

import numpy as np

from jaxclear.components.body import Body, Connection, Marker
from jaxclear.components.clearance import Backlash
from jaxclear.components.coupling import Gear, Motor
from jaxclear.components.drive import AbstractDrive, Position
from jaxclear.components.function_of_time import TimeTable
from jaxclear.components.joint import Fixed, Revolute
from jaxclear.components.load import Gravity, JointFriction, JointSpring, Servo
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_flags, check_number
from jaxclear.laws.wear import AbstractWearLaw
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.scenes.slack import slack_joints

JOINTS = tuple(f"joint{k}" for k in range(1, 8))
KINDS = {"play": JOINTS, "ideal": ()}
GRAVITY = 9.81


class Link(NamedTuple):
    """A link in the frame of its joint: `mass` [kg], `com` [m], `inertia` about it [kg m2] (xx, yy,
    zz, xy, xz, yz)."""

    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]


class Hinge(NamedTuple):
    """A joint of the file: place `at` [m] on the link before, `turn` about its x axis in quarters,
    least and largest angle [rad], `effort` [N m], `damping` [N m s/rad]."""

    at: tuple[float, float, float]
    turn: int
    lower: float
    upper: float
    effort: float
    damping: float


LINKS = (
    Link(
        2.382,
        (-0.0002, 0.02905, -0.01233),
        (0.0056905, 0.0049566, 0.003316654, -1.579e-05, 5.125e-06, -0.000873378),
    ),
    Link(
        1.869,
        (0.00022, -0.12856, 0.01735),
        (0.0095989, 0.00382472, 0.007565669, 1.541e-06, 5.56e-06, -0.00317156),
    ),
    Link(
        1.6383,
        (0.0466, -0.02463, -0.00768),
        (0.00310955, 0.00264483, 0.0026624, 0.00030837, -0.00058453, 0.000338893),
    ),
    Link(
        1.7269,
        (0.07047, -0.11575, 0.012),
        (0.005889, 0.00359703, 0.00543244, 0.00137112, 0.00088143, -0.001762155),
    ),
    Link(
        1.3203,
        (-0.00032, 0.01604, -0.026),
        (0.00534665, 0.0049779, 0.0013624, 1.5117e-05, -3.69e-07, -0.00022132),
    ),
    Link(
        1.325,
        (0.06469, 0.03278, 0.02141),
        (0.0014745, 0.0019037, 0.0023652, -0.000488, 0.0002953, 0.00014749),
    ),
    Link(0.17, (0.0, -0.00677, -0.01098), (9.3e-05, 5.87e-05, 0.000132, 0.0, 0.0, -3.6e-06)),
)
TURN = 2 * pi
HINGES = (
    Hinge((0.0, 0.0, 0.267), 0, -TURN, TURN, 50.0, 10.0),
    Hinge((0.0, 0.0, 0.0), -1, -2.059, 2.0944, 50.0, 10.0),
    Hinge((0.0, -0.293, 0.0), 1, -TURN, TURN, 30.0, 5.0),
    Hinge((0.0525, 0.0, 0.0), 1, -0.19198, 3.927, 30.0, 5.0),
    Hinge((0.0775, -0.3425, 0.0), 1, -TURN, TURN, 30.0, 5.0),
    Hinge((0.0, 0.0, 0.0), 1, -1.69297, pi, 20.0, 2.0),
    Hinge((0.076, 0.097, 0.0), -1, -TURN, TURN, 20.0, 2.0),
)
FRICTION, FASTEST = 1.0, 3.14
# Speed at which three quarters of the friction act [rad/s].
CREEP = 0.1


class Size(NamedTuple):
    """A size of reducer: `stiffness` [N m/rad], `damping` [N m s/rad] and `rotor` [kg m2], that of
    its motor and wave generator."""

    stiffness: float
    damping: float
    rotor: float


RATIO, DAMPED = 100.0, 0.1


def _make_size(stiffness: float, rotor: float) -> Size:
    return Size(stiffness, 2 * DAMPED * RATIO * sqrt(stiffness * rotor), rotor)


# Of a size the pitch diameter of its teeth [inch], times ten. As high as 1.3 modules and as wide as
# a third of that diameter, they have a flank of about the square of the pitch radius in all; on it
# they slide by a tenth of their way.
INCH, SLIDING = 0.0254, 0.1
SIZE_OF = dict(zip(JOINTS, (20, 20, 17, 17, 17, 14, 14), strict=True))
SIZES = {20: _make_size(25e3, 20e-6), 17: _make_size(14e3, 10e-6), 14: _make_size(6.1e3, 4e-6)}
REDUCERS = {name: SIZES[size] for name, size in SIZE_OF.items()}
ARCMIN = pi / 180 / 60
PLAY = 1.0 * ARCMIN

# The gripper with its part, a cube, and where it holds it in the flange's frame [m].
TOOL_MASS, TOOL_EDGE, GRIPPER_TIP = 1.0, 80e-3, (60e-3, 0.0, 120e-3)
TOOL_COM = (30e-3, 0.0, 80e-3)


def __getattr__(name: str) -> Marker:
    """`TIP`: where the gripper holds its part. It holds arrays, and importing builds none."""
    if name == "TIP":
        return Marker("tool", GRIPPER_TIP)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


# Angles of the joints [rad] where the part is picked, above that, above its place, and there.
PICKED = (-0.6, 0.25, 0.1, 1.25, -0.1, 1.0, -0.6)
LIFTED = (-0.6, -0.15, 0.1, 1.05, -0.1, 1.2, -0.6)
OVER = (0.6, -0.25, -0.2, 0.85, 0.2, 1.1, 0.4)
PLACED = (0.6, 0.15, -0.2, 1.05, 0.2, 0.9, 0.4)
# Times [s] at which it rests and moves, in turn: it rests first.
REST, SWING, LIFT = 0.2, 0.9, 0.5
# Of the servos [Hz, 1].
BANDWIDTH, DAMPING = 8.0, 0.7
# Between numbers of the tables [s].
TABLE_STEP = 0.02


class JointPath(NamedTuple):
    """What servos follow: `times` [s] and `angles` [rad] (times, joints)."""

    times: np.ndarray
    angles: np.ndarray


def pick_and_place() -> JointPath:
    """From pick to place: rests, and moves between them of the fifth degree, whose speed and
    acceleration begin and end at 0."""
    stops = (PICKED, LIFTED, OVER, PLACED)
    moves = (LIFT, SWING, LIFT)
    times = np.arange(0.0, 4 * REST + sum(moves) + 0.5 * TABLE_STEP, TABLE_STEP)
    angles = np.tile(np.array(PICKED), (len(times), 1))
    begin = REST
    for (before, after), taken in zip(pairwise(stops), moves, strict=True):
        s = np.clip((times - begin) / taken, 0.0, 1.0)
        share = s**3 * (10 - 15 * s + 6 * s * s)
        angles += share[:, None] * (np.array(after) - np.array(before))
        begin += taken + REST
    return JointPath(times, angles)


def _quarter_turn(turn: int) -> np.ndarray:
    return np.array([[1, 0, 0], [0, 1 - abs(turn), -turn], [0, turn, 1 - abs(turn)]], float)


def _about_z(angle: np.ndarray) -> np.ndarray:
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    rows = ((c, -s, zero), (s, c, zero), (zero, zero, zero + 1))
    return np.stack([np.stack(row, -1) for row in rows], -2)


def _axes_and_masses(angles: np.ndarray) -> tuple[list[Any], list[Any]]:
    """Origin and direction of each axis, mass and place of each body, outwards."""
    rotation, place, axes, masses = np.eye(3), np.zeros(3), [], []
    for k, (link, hinge) in enumerate(zip(LINKS, HINGES, strict=True)):
        place = place + rotation @ np.array(hinge.at)
        rotation = rotation @ _quarter_turn(hinge.turn) @ _about_z(angles[..., k])
        axes.append((place, rotation[..., :, 2]))
        masses.append((link.mass, place + rotation @ np.array(link.com)))
    masses.append((TOOL_MASS, place + rotation @ np.array(TOOL_COM)))
    return axes, masses


def gravity_torques(angles: Any, tool_mass: float = TOOL_MASS) -> np.ndarray:
    """Torques [N m] (..., 7) that hold the arm with its tool at `angles` [rad] (..., 7)."""
    axes, masses = _axes_and_masses(np.asarray(angles, float))
    masses[-1] = tool_mass, masses[-1][1]
    torques = []
    for k, (origin, axis) in enumerate(axes):
        arms = sum(mass * (com - origin) for mass, com in masses[k:])
        torques.append(GRAVITY * (axis[..., 0] * arms[..., 1] - axis[..., 1] * arms[..., 0]))
    return np.stack(torques, -1)


def _servo_inertias() -> np.ndarray:
    """What each servo turns where the arm is lifted, bodies as points [kg m2]."""
    axes, masses = _axes_and_masses(np.array(LIFTED))
    rotors = [RATIO**2 * REDUCERS[name].rotor for name in JOINTS]
    return np.array(
        [
            rotor + sum(mass * np.sum(np.cross(axis, com - at) ** 2) for mass, com in masses[k:])
            for k, (rotor, (at, axis)) in enumerate(zip(rotors, axes, strict=True))
        ]
    )


def servos(path: JointPath) -> dict[str, Servo]:
    """A servo for each joint that follows a path, with the torques of gravity, damping and friction
    along it as feedforward."""
    speeds = np.gradient(path.angles, path.times, axis=0)
    feedforward_torques = gravity_torques(path.angles) + FRICTION * np.tanh(speeds / CREEP)
    feedforward_torques += speeds * np.array([hinge.damping for hinge in HINGES])
    rate, loads = 2 * pi * BANDWIDTH, {}
    for k, (name, inertia) in enumerate(zip(JOINTS, _servo_inertias(), strict=True)):
        loads[f"{name} servo"] = Servo(
            name,
            TimeTable(path.times, path.angles[:, k]),
            kp=rate**2 * inertia,
            kd=2 * DAMPING * rate * inertia,
            feedforward=TimeTable(path.times, feedforward_torques[:, k]),
            torque_limit=HINGES[k].effort,
        )
    return loads


def reducer(name: str, play: Any = None, wear: Any = None) -> Gear:
    """The reducer of a joint with its motor: rigid, or elastic with play.

    Args:
        name: of the joint.
        play: from flank to flank [rad]; None: rigid and without play.
        wear: wear law of the flanks; None: no wear.
    """
    size = REDUCERS[name]
    motor = Motor(size.rotor)
    if play is None:
        return Gear(motor, name, RATIO)
    radius = 0.05 * INCH * SIZE_OF[name]
    teeth = {"slide": SLIDING, "area": radius**2, "pitch_radius": radius}
    flanks = Backlash(play) if wear is None else Backlash(play, wear=wear, **teeth)
    return Gear(motor, name, RATIO, play=flanks, stiffness=size.stiffness, damping=size.damping)


def _make_bodies() -> dict[str, Body]:
    cube = TOOL_MASS * TOOL_EDGE**2 / 6
    links = {f"link{k}": Body(one.mass, one.inertia, one.com) for k, one in enumerate(LINKS, 1)}
    return links | {"tool": Body(TOOL_MASS, (cube, cube, cube), TOOL_COM)}


def _make_connections(drives: Sequence[AbstractDrive | None]) -> dict[str, Connection]:
    before, connections = "ground", {}
    for k, (name, hinge, drive) in enumerate(zip(JOINTS, HINGES, drives, strict=True), 1):
        quaternion = (sqrt(0.5), hinge.turn * sqrt(0.5), 0.0, 0.0) if hinge.turn else None
        parent = Marker(before, hinge.at, quaternion=quaternion)
        connections[name] = Connection(Revolute(drive=drive), parent, Marker(f"link{k}"))
        before = f"link{k}"
    return connections | {"flange": Connection(Fixed(), before, "tool")}


@answering
def arm(
    kind: str | Sequence[str] = "ideal",
    play: float | Sequence[float] = PLAY,
    *,
    path: JointPath | None = None,
    driven: bool = False,
    wear: AbstractWearLaw | None = None,
) -> Mechanism:
    """The robot arm xArm7 with its gripper, moving from pick to place.

    Args:
        kind: "ideal", reducers that are rigid and without play; "play", all seven elastic with
            `play`; or a list of the names, of joint1 to joint7, of those that have it, the others
            being ideal.
        play: play of the joint between both flanks [rad], >= 0, one number or seven; 0 leaves the
            elasticity.
        path: path of the joint angles that the servos follow, a `JointPath`; None: that of
            `pick_and_place()`.
        driven: whether joints are driven along the path, without servos: the commanded path.
        wear: law of `jaxclear.wear` by which the flanks of reducers with play lose; None: they do
            not wear. Worn surfaces are "upper" and "lower" of the joint's name.

    Returns:
        the mechanism.

    Raises:
        ValueError: for an unknown word or name, or a play that is negative or not one number or
            seven.
    """
    slack = slack_joints("arm", kind, KINDS, JOINTS)
    check_flags("arm", driven=driven)
    if np.shape(play) not in ((), (len(JOINTS),)):
        raise ValueError(f"play of arm has shape {np.shape(play)}; it must be one number or seven.")
    for one in np.ravel(np.asarray(play, float)):
        check_number("play of arm", float(one), "rad", at_least=0)
    path = pick_and_place() if path is None else path
    loads: dict[str, Any] = {"gravity": Gravity((0.0, 0.0, -GRAVITY))}
    if driven:
        drives = [Position(TimeTable(path.times, angles)) for angles in path.angles.T]
        return Mechanism(_make_bodies(), _make_connections(drives), loads)
    for name, hinge in zip(JOINTS, HINGES, strict=True):
        loads[f"{name} damping"] = JointSpring(name, damping=hinge.damping)
        loads[f"{name} friction"] = JointFriction(name, FRICTION, CREEP)
    plays = dict(zip(JOINTS, np.broadcast_to(np.asarray(play, float), 7), strict=True))
    return Mechanism(
        _make_bodies(),
        _make_connections((None,) * 7),
        loads | servos(path),
        couplings={
            name: reducer(name, plays[name], wear) if name in slack else reducer(name)
            for name in JOINTS
        },
        start=dict(zip(JOINTS, map(float, path.angles[0]), strict=True)),
    )
