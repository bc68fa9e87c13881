r"""3RSR parallel mechanism: three legs, each of a driven rod and a transmission rod, carry a
platform; ball joints between the rods, one of which has clearance and wears.

Source: Hou, Deng & Zeng 2021, J. Cent. South Univ. 28, 712, "Dynamics modelling and properties
analysis of 3RSR parallel mechanism considering spherical joint clearance and wear",
doi:10.1007/s11771-021-4640-y. From the paper: six revolute and three ball joints, of which S1 has
0.5 mm of clearance; drive angles from 45 to 75 degrees; steel (its grade 45); modified Flores
contact; Ambrósio's friction; Archard's wear with coefficient 1.736e-4 and hardness 2.17 GPa on a
map of 12 x 12 cells of the socket.

Assumed, because the paper's tables 1 and 2 and its equation 33 are lost: joints of fixed and moving
platform on circles of 150 mm; rods of 200 mm and 0.4 kg, round, 16 mm thick; a platform of 5 kg (a
disk of 150 mm radius); a socket of 15 mm radius, on the drive rod; 210 GPa and 0.3 for the steel;
restitution 0.9; friction 0.05 with tolerance speeds of 1 and 10 mm/s; gravity against the
platform's rise; and all three drives alike, 60 deg - 15 deg cos(2 pi t / T), from rest.

The period T is lost too, and decides the regime. The paper draws force peaks at 2.3 and 3.3 s, so
it is taken as 4 s, where the ball stays in touch once it has fallen through its play, as it does at
1 s; at 0.3 s the platform is thrown, and the joint rattles.

With circles and rods alike the moving platform is the mirror image of the fixed one in the plane
through the three balls; moved by drives that are alike it rises and falls, level, at
:math:`2 L\sin\theta`.
"""

from collections.abc import Sequence
from math import cos, pi, radians, sin, sqrt
from typing import Any

import jax.numpy as jnp

from jaxclear.components.body import Body, Connection, Marker
from jaxclear.components.clearance import BallSocket
from jaxclear.components.drive import AbstractDrive, Harmonic
from jaxclear.components.joint import Revolute, Spherical
from jaxclear.components.load import Gravity
from jaxclear.components.wear_map import Wearing
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_flags, check_number, expect
from jaxclear.laws.contact import ModifiedFlores
from jaxclear.laws.friction import Ambrosio
from jaxclear.laws.material import Material
from jaxclear.laws.stiffness import CombinedModulus
from jaxclear.laws.wear import Archard
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.scenes.slack import slack_joints

LEGS = (1, 2, 3)
BALLS = ("S1", "S2", "S3")
KINDS = {"one": BALLS[:1], "all": BALLS, "ideal": ()}
# Circle of the joints on both platforms, length and radius of the rods, radius of the sockets [m].
CIRCLE, ROD, ROD_RADIUS, SOCKET_RADIUS = 0.15, 0.2, 8e-3, 15e-3
ROD_MASS, PLATFORM_MASS, GRAVITY = 0.4, 5.0, 9.81
# Drive angles [rad].
LOWEST, HIGHEST = radians(45.0), radians(75.0)
# Periods [s]: of the paper, one that is quiet too, and one at which the joint rattles.
PAPER, QUIET, RATTLING = 4.0, 1.0, 0.3
RESTITUTION, MU, INNER_SPEED, OUTER_SPEED = 0.9, 0.05, 1e-3, 10e-3
WEAR_COEFFICIENT, HARDNESS = 1.736e-4, 2.17e9


def socket(
    clearance: Any,
    *,
    friction: bool = True,
    wear: bool = True,
    cells: tuple = (12, 12),
    worn_radius: bool = False,
) -> BallSocket:
    """A ball joint of the paper with clearance.

    Args:
        clearance: radial [m].
        friction: whether it rubs.
        wear: whether the socket wears.
        cells: of the wear map, in azimuth and elevation.
        worn_radius: whether contact laws use the worn radius.
    """
    steel = Material(210e9, 0.3)
    rub = Ambrosio(mu_kinetic=MU, inner_speed=INNER_SPEED, outer_speed=OUTER_SPEED)
    law = Archard(wear_coefficient=WEAR_COEFFICIENT, hardness=HARDNESS)
    return BallSocket(
        ModifiedFlores(modulus=CombinedModulus(steel, steel), restitution=RESTITUTION),
        rub if friction else None,
        socket_radius=SOCKET_RADIUS,
        clearance=clearance,
        socket_wear=Wearing(law, cells, worn_radius=worn_radius) if wear else None,
    )


def usual_drive(period: Any) -> Harmonic:
    """From the lowest drive angle to the highest and back, from rest."""
    middle, half = 0.5 * (LOWEST + HIGHEST), 0.5 * (HIGHEST - LOWEST)
    return Harmonic(half, 1 / period, -0.5 * jnp.pi, middle)


def _make_bodies() -> dict[str, Body]:
    across = ROD_MASS * (ROD**2 / 12 + ROD_RADIUS**2 / 4)
    rod = Body(ROD_MASS, (0.5 * ROD_MASS * ROD_RADIUS**2, across, across), (0.5 * ROD, 0.0, 0.0))
    disk = 0.25 * PLATFORM_MASS * CIRCLE**2
    return (
        {f"drive {leg}": rod for leg in LEGS}
        | {"platform": Body(PLATFORM_MASS, (disk, disk, 2 * disk))}
        | {f"rod {leg}": rod for leg in LEGS}
    )


def foot(body: str, leg: int) -> Marker:
    """Where a leg stands on a platform: x outwards, y up, z the axis of its revolute joint."""
    turn = 2 * pi * (leg - 1) / 3
    c, s = cos(0.5 * turn) / sqrt(2), sin(0.5 * turn) / sqrt(2)
    return Marker(body, (CIRCLE * cos(turn), CIRCLE * sin(turn), 0.0), quaternion=(c, c, s, s))


def _connections(balls: dict[str, Any], drives: Sequence[AbstractDrive]) -> dict[str, Connection]:
    connections = {}
    for leg, drive in zip(LEGS, drives, strict=True):
        revolute = Revolute(drive=drive)
        connections[f"A{leg}"] = Connection(revolute, foot("ground", leg), Marker(f"drive {leg}"))
    for leg, (name, ball) in zip(LEGS, balls.items(), strict=True):
        ends = Marker(f"drive {leg}", (ROD, 0.0, 0.0)), Marker(f"rod {leg}", (ROD, 0.0, 0.0))
        connections[name] = Connection(ball, *ends)
    for leg in LEGS:
        connections[f"B{leg}"] = Connection(Revolute(), foot("platform", leg), Marker(f"rod {leg}"))
    return connections


@answering
def parallel_3rsr(
    kind: str | Sequence[str] = "one",
    clearance: float = 0.5e-3,
    *,
    period: float = PAPER,
    drives: Sequence[AbstractDrive] | None = None,
    friction: bool = True,
    wear: bool = True,
    cells: tuple[int, int] = (12, 12),
    worn_radius: bool = False,
) -> Mechanism:
    """The 3RSR parallel mechanism of the paper.

    Legs are numbered: drive rods "drive 1" ... stand on the ground at A1 ..., transmission rods
    "rod 1" ... hang from the "platform" at B1 ..., balls "S1" ... join them.

    Args:
        kind: "one", ball joint S1 with clearance; "all", each of S1 to S3; "ideal", none; or a list
            of the names of those that have it.
        clearance: radial clearance [m], > 0.
        period: period of the drives [s], > 0.
        drives: drives of the joints A1 to A3 [rad], a list of three of `jaxclear.drive`; None: the
            paper's.
        friction: whether joints with clearance have friction.
        wear: whether their sockets wear.
        cells: number of cells of the wear map, in azimuth and elevation.
        worn_radius: whether the contact is as stiff as the socket's radius and clearance are where
            it is worn, as in the paper; else as they were made.

    Returns:
        the mechanism.

    Raises:
        ValueError: for an unknown word or name, a number out of its range, or other than three
            drives.
    """
    slack = slack_joints("parallel_3rsr", kind, KINDS, BALLS)
    check_number("clearance of parallel_3rsr", clearance, "m", above=0)
    check_number("period of parallel_3rsr", period, "s", above=0)
    check_flags("parallel_3rsr", friction=friction, wear=wear, worn_radius=worn_radius)
    drives = (usual_drive(period),) * 3 if drives is None else drives
    expect(drives, (tuple, list), "drives of parallel_3rsr", "three, of A1, A2 and A3")
    if len(drives) != len(LEGS):
        raise ValueError(f"drives of parallel_3rsr are {len(drives)}; they must be three.")
    loose = socket(clearance, friction=friction, wear=wear, cells=cells, worn_radius=worn_radius)
    balls = {name: loose if name in slack else Spherical() for name in BALLS}
    connections = _connections(balls, drives)
    # The legs bend outwards. Told of joints that carry coordinates, so that assembly is short.
    guess: dict[str, Any] = {f"B{leg}": -LOWEST for leg in LEGS}
    first = next((name for name in BALLS if name not in slack), None)
    if first is None:
        guess["platform"] = (0.0, 0.0, 2 * ROD * sin(LOWEST))
    else:
        guess[first] = (0.0, 0.0, -2 * LOWEST)
    return Mechanism(
        _make_bodies(), connections, {"gravity": Gravity((0.0, 0.0, -GRAVITY))}, guess=guess
    )
