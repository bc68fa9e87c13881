"""Four-bar mechanism with three-dimensional clearance and wear in the joint between coupler and
follower.

Source: "Dynamic Behavior of Four-bar Mechanism with Three-dimensional Clearance and Wear", tables I
and II. From the paper: lengths, masses, crank speed, Young's modulus, Poisson ratio, bearing radius
and length, journal length, restitution, the wear coefficient 2e-2 (there chosen to accelerate
wear), Lankarani-Nikravesh contact, three-zone friction, Archard wear, ball joint at the follower's
foot.

The paper lists journal radii 10 ... 9.6 mm in a bearing of 10 mm, calls them clearances of 0 ...
0.2 mm and draws the journal's centre in a circle of 0.2 mm radius. That fits if the listed radii
are diameters halved wrongly; `clearance` here is the RADIAL clearance, that is the radius of the
drawn circle, and the bearing radius stays 10 mm.

Assumed, because the paper does not say: slender links (inertia m l^2/12, radius of gyration 8 mm
about their own axis) with the centre of mass half-way; friction 0.15 / 0.1 with transition speeds
0.1 and 1 m/s (values of Bai & Zhao 2020, table 2, for a steel joint of the same size); hardness
2.17 GPa (the steel of the 3RSR paper); gravity in the plane; and the follower lying beside the
coupler, 20 mm along the bearing's axis (two links cannot share a plane at a pin), which is what
loads the two ends of the bearing differently; collars of 14 mm radius that leave the journal of 32
mm its 1 mm of axial play at each side of the bearing of 30 mm (without them a journal tilting
within 0.2 mm would walk out of it).
"""

from typing import Any

from jaxclear.components import clearance as clearances
from jaxclear.components.body import Body, Connection, Marker
from jaxclear.components.drive import ConstantSpeed
from jaxclear.components.joint import Revolute, Spherical
from jaxclear.components.load import Gravity
from jaxclear.components.wear_map import Wearing
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_flags, check_name, check_number
from jaxclear.laws.contact import LankaraniNikravesh
from jaxclear.laws.friction import ThreeZone
from jaxclear.laws.material import steel
from jaxclear.laws.stiffness import HertzStiffness
from jaxclear.laws.wear import Archard
from jaxclear.multibody.mechanism import Mechanism

# Radial clearances of the paper [m]; the first is the ideal joint.
CLEARANCES = (0.0, 0.05e-3, 0.1e-3, 0.15e-3, 0.2e-3)
# Lengths of the links, and their radius of gyration about their own axis [m].
CRANK, COUPLER, FOLLOWER, GROUND = 0.1, 0.4, 0.3, 0.3
GYRATION = 8e-3
FOLLOWER_OFFSET = 20e-3
AXIAL_CLEARANCE = 1e-3
# Bearing and journal [m].
BEARING_RADIUS, BEARING_LENGTH, JOURNAL_LENGTH, COLLAR_RADIUS = 10e-3, 30e-3, 32e-3, 14e-3
# Cells of the bearing's map. In the plane depths are a third too small on 72, 4 % on these. That of
# a tilted journal takes 144 x 320, which short runs in a batch pay for.
CELLS = {"spatial": (72, 20), "planar": (288, 1)}
KINDS = (*CELLS, "ideal")


def bearing(
    kind: str,
    clearance: Any,
    *,
    friction: bool = True,
    wear: bool = True,
    cells: tuple[int, int] | None = None,
) -> Any:
    """The joint between coupler and follower.

    Args:
        kind: "spatial" or "planar" clearance, or "ideal".
        clearance: radial [m].
        friction: whether it rubs.
        wear: whether the bearing wears.
        cells: of the wear map, around and along; None: by kind.
    """
    if kind == "ideal":
        return Revolute()
    contact = LankaraniNikravesh(stiffness=HertzStiffness(steel(), steel()), restitution=0.9)
    rub = None
    if friction:
        rub = ThreeZone(mu_static=0.15, mu_kinetic=0.1, static_speed=0.1, kinetic_speed=1.0)
    law = None
    if wear:
        cells = CELLS[kind] if cells is None else cells
        law = Wearing(Archard(wear_coefficient=2e-2, hardness=2.17e9), cells)
    if kind == "planar":
        return clearances.PlanarJournalBearing(
            contact=contact,
            friction=rub,
            bearing_radius=BEARING_RADIUS,
            clearance=clearance,
            length=BEARING_LENGTH,
            bearing_wear=law,
        )
    return clearances.JournalBearing(
        contact=contact,
        friction=rub,
        bearing_radius=BEARING_RADIUS,
        clearance=clearance,
        length=BEARING_LENGTH,
        journal_length=JOURNAL_LENGTH,
        flange=clearances.Flange(
            contact=contact, friction=rub, radius=COLLAR_RADIUS, clearance=AXIAL_CLEARANCE
        ),
        bearing_wear=law,
    )


def _make_link(mass: float, length: float, offset: float | None = None) -> Body:
    swing = mass * length**2 / 12
    if offset is None:
        return Body(mass, swing, (0.5 * length, 0.0))
    spin = mass * GYRATION**2
    return Body(mass, (spin, swing, swing), (0.5 * length, 0.0))


@answering
def four_bar(
    kind: str = "spatial",
    clearance: float = 0.2e-3,
    *,
    crank_speed: float = 10.0,
    friction: bool = True,
    wear: bool = True,
    cells: tuple[int, int] | None = None,
    follower_offset: float = FOLLOWER_OFFSET,
) -> Mechanism:
    """The four-bar mechanism of the paper, with joint "B" between coupler and follower.

    Args:
        kind: kind of joint B, a text: "spatial", "planar" or "ideal".
        clearance: radial clearance [m], > 0.
        crank_speed: speed of the crank [rad/s].
        friction: whether the joint has friction.
        wear: whether the joint wears.
        cells: number of cells of the wear map around and along the bearing; None: 72 by 20 in
            space, 288 around in the plane. How deep it wears in space takes 144 by 320.
        follower_offset: distance between the planes of coupler and follower [m] (spatial only).

    Returns:
        the mechanism.

    Raises:
        ValueError: for an unknown word, or a clearance that is not positive.
    """
    check_name("kind", kind, KINDS, " of four_bar")
    check_number("clearance of four_bar", clearance, "m", above=0)
    check_number("follower_offset of four_bar", follower_offset, "m")
    check_flags("four_bar", friction=friction, wear=wear)
    joint = bearing(kind, clearance, friction=friction, wear=wear, cells=cells)
    spatial = kind == "spatial"
    foot = (GROUND, 0.0, follower_offset) if spatial else (GROUND, 0.0)
    tip = (FOLLOWER, 0.0, -follower_offset) if spatial else (FOLLOWER, 0.0)
    return Mechanism(
        bodies={
            "crank": _make_link(0.46, CRANK),
            "coupler": _make_link(1.44, COUPLER),
            "follower": _make_link(1.63, FOLLOWER, follower_offset if spatial else None),
        },
        connections={
            "O": Connection(Revolute(drive=ConstantSpeed(crank_speed)), "ground", "crank"),
            "A": Connection(Revolute(), "crank", "coupler", at=(CRANK, 0.0)),
            "B": Connection(joint, Marker("coupler", (COUPLER, 0.0)), Marker("follower", tip)),
            "D": Connection(Spherical() if spatial else Revolute(), "ground", "follower", at=foot),
        },
        loads={"gravity": Gravity((0.0, -9.81))},
        guess={"A": 0.81, "D": 1.32},
    )
