"""Planar slider-crank whose joint between rod and slider has clearance: the small mechanism of
first runs, tests and benchmarks.

Source: Flores & Ambrosio 2004, Comput. Struct. 82, 1359 (doi:10.1016/j.compstruc.2004.03.031), and
the papers on clearance that take its numbers: lengths, masses, moments of inertia, bearing radius
10 mm, Young's modulus 207 GPa, Poisson ratio 0.3, restitution 0.9, friction 0.03,
Lankarani-Nikravesh contact. There the crank turns at 5000 rpm with a clearance of 0.5 mm and
gravity changes nothing; here, unless told otherwise, at 50 rad/s with 0.2 mm, where weights count.
Assumed: centres of mass half-way along crank and rod.

The crank turns about the origin (joint O); the slider slides along x (joint G, its coordinate the
slider's x). The rod carries the bearing of joint B, the slider the journal. Start: crank and rod
along x, journal concentric.
"""

from typing import Any

from jaxclear.components.body import Body, Connection, Marker
from jaxclear.components.clearance import PlanarJournalBearing
from jaxclear.components.drive import AbstractDrive, ConstantSpeed
from jaxclear.components.joint import Prismatic, Revolute
from jaxclear.components.load import Gravity
from jaxclear.components.wear_map import Wearing
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_name, check_number
from jaxclear.laws.contact import AbstractContactLaw, LankaraniNikravesh
from jaxclear.laws.friction import AbstractFrictionLaw, Ambrosio
from jaxclear.laws.material import Material
from jaxclear.laws.stiffness import HertzStiffness
from jaxclear.laws.wear import Archard
from jaxclear.multibody.mechanism import Mechanism

# Of crank, rod and both in line [m].
CRANK, ROD, REACH = 0.05, 0.12, 0.17
BEARING_RADIUS = 10e-3
KINDS = ("planar", "ideal")


def bearing(
    clearance: Any,
    contact: AbstractContactLaw | None = None,
    friction: AbstractFrictionLaw | bool | None = True,
    wear: Wearing | bool | None = False,
) -> PlanarJournalBearing:
    """The joint between rod and slider.

    Args:
        clearance: radial [m].
        contact: law; None: Lankarani and Nikravesh's for steel.
        friction: law; True: Ambrosio's; None or False: frictionless.
        wear: of the bearing; True: Archard's law; None or False: no wear.
    """
    if contact is None:
        steel = Material(young_modulus=207e9, poisson_ratio=0.3)
        contact = LankaraniNikravesh(stiffness=HertzStiffness(steel, steel), restitution=0.9)
    if isinstance(friction, bool):
        friction = Ambrosio(mu_kinetic=0.03) if friction else None
    if isinstance(wear, bool):
        wear = Wearing(Archard()) if wear else None
    return PlanarJournalBearing(
        contact, friction, bearing_radius=BEARING_RADIUS, clearance=clearance, bearing_wear=wear
    )


@answering
def slider_crank(
    kind: Any = "planar",
    clearance: float = 0.2e-3,
    *,
    contact: AbstractContactLaw | None = None,
    friction: AbstractFrictionLaw | bool | None = True,
    wear: Wearing | bool | None = False,
    crank_speed: float = 50.0,
    drive: AbstractDrive | None = None,
    gravity: float | None = 9.81,
) -> Mechanism:
    """The planar slider-crank, with joint "B" between rod and slider.

    Args:
        kind: "planar" with clearance, "ideal", or a joint of your own.
        clearance: radial clearance [m], > 0.
        contact: contact law of "planar", one of `jaxclear.contact`; None: the scene's own.
        friction: friction law of "planar", one of `jaxclear.friction`; True: the scene's own; False
            or None: no friction.
        wear: wear of "planar", a `Wearing`; True: the scene's own; False or None: no wear.
        crank_speed: speed of the crank [rad/s].
        drive: drive of the crank in place of the constant speed, one of `jaxclear.drive`; none by
            default.
        gravity: acceleration of free fall along -y [m/s^2]; None: absent.

    Returns:
        the mechanism.

    Raises:
        ValueError: for an unknown word, or a clearance that is not positive.
    """
    joint = kind
    if isinstance(kind, str):
        check_name("kind", kind, KINDS, " of slider_crank (beside a joint of your own)")
        check_number("clearance of slider_crank", clearance, "m", above=0)
        planar = kind == "planar"
        joint = bearing(clearance, contact, friction, wear) if planar else Revolute()
    if gravity is not None:
        check_number("gravity of slider_crank", gravity, "m/s^2")
    if drive is None:
        drive = ConstantSpeed(crank_speed)
    return Mechanism(
        bodies={
            "crank": Body(0.3, 1e-4, (0.5 * CRANK, 0.0)),
            "rod": Body(0.21, 2.5e-4, (0.5 * ROD, 0.0)),
            "slider": Body(0.14, 1e-4),
        },
        connections={
            "O": Connection(Revolute(drive=drive), "ground", "crank"),
            "A": Connection(Revolute(), "crank", "rod", at=(CRANK, 0.0)),
            "B": Connection(joint, "rod", "slider", at=(ROD, 0.0)),
            "G": Connection(Prismatic(), Marker("ground", axis="x"), Marker("slider", axis="x")),
        },
        loads={} if gravity is None else {"gravity": Gravity((0.0, -gravity))},
        guess={"G": REACH},
    )
