"""Flap actuation system: actuator, rod 1, lever arm 1, rod 2, and lever arm 2 with its shaft, held
together by four revolute joints with clearance, one behind the other.

Source: Wan, Liu, Ma & Tong, "Investigation on Dynamic Interaction of Multiple Clearance Joints for
Flap Actuation System", tables 1 and 2. From the paper: bearing diameter 15 mm, radial clearance
0.1 mm, the actuator's output of 10 mm at 4 Hz, moduli and densities, Adams' IMPACT with exponent
1.5, d_max 0.01 mm and c_max of one percent of the stiffness, Adams' STEP friction with mu_s = mu_d
= 0.01, v_s 0.1 mm/s, v_d 10 mm/s. Misprints that are corrected: see `contact.AdamsImpact`,
`friction.AdamsStep` and `stiffness.HertzStiffness`.

The frame's origin is joint J1 at rest; the actuator moves along x, and both lever arms stand
upright on their pivots then. J1 joins actuator and rod 1, J2 rod 1 and lever arm 1, J3 lever arm 1
and rod 2, J4 rod 2 and lever arm 2.

Assumed, because the paper's text does not say: rods of 150 and 200 mm with a section of 20 mm by
10 mm; lever arms of 60 mm of the same section, J3 at `lever_ratio` times the distance of J2 from
the pivot; shaft and inertia plate together 0.13 kg m2 (as a plate of steel of 0.3 m by 0.2 m by
21 mm about its long edge); pins of the same steel as the bearing houses; "one percent of the
stiffness" in Adams' units, N and mm; the actuator moves as 5 mm (1 - cos 2 pi 4 t), from rest, as
a servo does (a sine would begin at 0.13 m/s, and the play be taken up within a millisecond); no
gravity (the paper names none, and no direction), pivots without friction.
"""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp

from jaxclear.components.body import Body, Connection, Marker
from jaxclear.components.clearance import PlanarJournalBearing
from jaxclear.components.drive import AbstractDrive, Harmonic
from jaxclear.components.joint import Prismatic, Revolute
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_number
from jaxclear.laws.contact import AdamsImpact
from jaxclear.laws.friction import AdamsStep
from jaxclear.laws.material import Material
from jaxclear.laws.stiffness import HertzStiffness, Shape
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.scenes.slack import slack_joints

JOINTS = ("J1", "J2", "J3", "J4")
KINDS = {"planar": JOINTS, "ideal": ()}
BEARING_RADIUS, BEARING_LENGTH = 7.5e-3, 20e-3
FIRST_ROD, SECOND_ROD, ARM = 0.15, 0.2, 0.06
# Density times section [kg/m]: of steel and of the light alloy.
STEEL_BAR, ALLOY_BAR = 7890 * 20e-3 * 10e-3, 2700 * 20e-3 * 10e-3
SHAFT_INERTIA = 0.13
STROKE, FREQUENCY = 10e-3, 4.0
FULL_DAMPING_DEPTH = 0.01e-3
MU = 0.01
STICTION_SPEED, FRICTION_SPEED = 0.1e-3, 10e-3
# c_max [N s/mm] over K [N/mm^1.5].
DAMPING_SHARE = 0.01


def house_steel() -> Material:
    """Steel of actuator, rod 1 and bearing houses (table 1)."""
    return Material(209e9, 0.269)


def bearing(clearance: Any) -> PlanarJournalBearing:
    """A joint of the paper with a radial clearance [m]."""
    fit = HertzStiffness(house_steel(), house_steel())
    stiffness = fit.value(Shape(BEARING_RADIUS - clearance, BEARING_RADIUS))
    # From N/m^1.5 to N/mm^1.5, a share of it, and from N s/mm to N s/m.
    damping = DAMPING_SHARE * (stiffness / 1e3**1.5) * 1e3
    return PlanarJournalBearing(
        AdamsImpact(stiffness=stiffness, damping=damping, full_damping_depth=FULL_DAMPING_DEPTH),
        AdamsStep(
            mu_static=MU, mu_kinetic=MU, static_speed=STICTION_SPEED, kinetic_speed=FRICTION_SPEED
        ),
        bearing_radius=BEARING_RADIUS,
        clearance=clearance,
        length=BEARING_LENGTH,
    )


def _make_bar(mass_per_length: float, length: float) -> Body:
    """A bar from its marker's origin along x."""
    mass = mass_per_length * length
    return Body(mass, mass * length**2 / 12, (0.5 * length, 0.0))


def _make_lever() -> Body:
    """An arm that stands on its pivot."""
    mass = ALLOY_BAR * ARM
    return Body(mass, mass * ARM**2 / 12, (0.0, 0.5 * ARM))


def _make_bodies() -> dict[str, Body]:
    return {
        "actuator": Body(1.0, 1e-3),
        "rod 1": _make_bar(STEEL_BAR, FIRST_ROD),
        "lever 1": _make_lever(),
        "rod 2": _make_bar(ALLOY_BAR, SECOND_ROD),
        "shaft": Body(ALLOY_BAR * ARM, SHAFT_INERTIA),
    }


@answering
def flap(
    kind: str | Sequence[str] = "planar",
    clearance: float = 0.1e-3,
    *,
    lever_ratio: float = 1.0,
    drive: AbstractDrive | None = None,
) -> Mechanism:
    """The flap actuation mechanism of the paper, with joints "J1" to "J4".

    Args:
        kind: "planar", all four joints with clearance; "ideal", none; or a list of the names, of J1
            to J4, of those that have it, the others being ideal.
        clearance: radial clearance [m], > 0.
        lever_ratio: distance of J3 from the pivot of lever arm 1 over that of J2 [1], > 0.
        drive: motion of the actuator along x [m], one of `jaxclear.drive`; None: the paper's.

    Returns:
        the mechanism.

    Raises:
        ValueError: for an unknown word or name, or a number out of its range.
    """
    slack = slack_joints("flap", kind, KINDS, JOINTS)
    check_number("clearance of flap", clearance, "m", above=0)
    check_number("lever_ratio of flap", lever_ratio, above=0)
    if drive is None:
        drive = Harmonic(-0.5 * STROKE, FREQUENCY, 0.5 * jnp.pi, 0.5 * STROKE)
    joints = {name: bearing(clearance) if name in slack else Revolute() for name in JOINTS}
    height, second = (lever_ratio - 1) * ARM, FIRST_ROD + SECOND_ROD
    return Mechanism(
        bodies=_make_bodies(),
        connections={
            "P": Connection(
                Prismatic(drive=drive), Marker("ground", axis="x"), Marker("actuator", axis="x")
            ),
            "O1": Connection(Revolute(), "ground", "lever 1", at=(FIRST_ROD, -ARM)),
            "O2": Connection(Revolute(), "ground", "shaft", at=(second, height - ARM)),
            "J1": Connection(joints["J1"], "actuator", "rod 1"),
            "J2": Connection(
                joints["J2"], Marker("rod 1", (FIRST_ROD, 0.0)), Marker("lever 1", (0.0, ARM))
            ),
            "J3": Connection(
                joints["J3"], Marker("lever 1", (0.0, lever_ratio * ARM)), Marker("rod 2")
            ),
            "J4": Connection(
                joints["J4"], Marker("rod 2", (SECOND_ROD, 0.0)), Marker("shaft", (0.0, ARM))
            ),
        },
        guess={"rod 2": (FIRST_ROD, height, 0.0)} if {"J3", "J4"} <= set(slack) else {},
    )
