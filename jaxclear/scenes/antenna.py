"""Dual-axis antenna pointing mechanism on a free-floating satellite, with clearance and dry
friction in both revolute joints.

Source: Li, Lyu & Ding 2022, Chin. J. Aeronaut., no. 8, "Dynamics modeling and error analysis for
antenna pointing mechanisms with frictional spatial revolute joints on SE(3)"; its tables of
geometry, inertia and simulation parameters are lost. Taken from a near relative, Bai & Zhao 2020,
Int. J. Aerospace Eng., 8846177, table 2: shafts of 0.5 m, bearing 50 mm long with radius 10 mm,
journal 54 mm, flange radius 14 mm, radial and axial clearance 0.2 mm, mu_s 0.15, mu_d 0.1, v_s 0.1
m/s, v_d 1 m/s, restitution 0.9, driving torques of 10 and 4 N m.

Assumed, because no source says: the satellite is a cylinder of 100 kg, radius 0.5 m, height 1 m (a
small satellite), joint 1 in the middle of its top, turning about its axis; link 1 is a tube of 4 kg
and 30 mm radius of gyration rising along that axis; link 2 is a tube of 2 kg across it, with a dish
of 6 kg (a disk of 0.25 m radius) at its end, so that the torques turn it by some tenths of a radian
to a radian in a second; joint 2 turns about an axis across both links, and link 2 lies beside link
1, 20 mm along that axis (two links cannot share a plane at a pin), which is what loads joint 1
about its own axis when joint 2 moves. The drives' argument is printed damaged: 2 pi t is assumed.
The step drive is assumed too: joint 1 is pushed, braked and released while joint 2 is driven by a
constant torque, so that joint 1 has to hold against what joint 2 does to it. Collars rub without a
torque (the paper's assumption), so they have no friction here.
"""

from typing import Any

import jax.numpy as jnp

from jaxclear.components import clearance as clearances
from jaxclear.components.body import Body, Connection, Marker
from jaxclear.components.function_of_time import AbstractFunctionOfTime
from jaxclear.components.joint import Free, Revolute
from jaxclear.components.load import MotorTorque
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_name, check_number
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.contact import CarvalhoMartins
from jaxclear.laws.friction import AbstractFrictionLaw, Coulomb, ThreeZone
from jaxclear.laws.material import steel
from jaxclear.laws.stiffness import HertzStiffness
from jaxclear.multibody.mechanism import Mechanism

LINK_1, LINK_2 = 0.5, 0.5
BEARING_RADIUS, BEARING_LENGTH, JOURNAL_LENGTH, FLANGE_RADIUS = 10e-3, 50e-3, 54e-3, 14e-3
AXIAL_CLEARANCE = 0.2e-3
MU_KINETIC, MU_STATIC, STATIC_SPEED, KINETIC_SPEED, RESTITUTION = 0.1, 0.15, 0.1, 1.0, 0.9
TORQUES = (10.0, 4.0)
# Step drive [s]: joint 1 pushed up to PUSH, braked up to BRAKE; joint 2 driven up to HOLD.
PUSH, BRAKE, HOLD = 0.2, 0.38, 2.5
SATELLITE_MASS, SATELLITE_RADIUS, SATELLITE_HEIGHT = 100.0, 0.5, 1.0
TUBE_1, GYRATION, TUBE_2, DISH, DISH_RADIUS = 4.0, 30e-3, 2.0, 6.0, 0.25
OFFSET = 20e-3
KINDS = ("spatial", "planar", "ideal")
FRICTIONS = ("set_valued", "regularised")
DRIVES = ("periodic", "step")
JOINTS = ("J1", "J2")
BASE = "satellite"


def __getattr__(name: str) -> Marker:
    """`TIP`: the tip of the antenna, whose boresight runs along link 2. It holds arrays, and
    importing builds none: the first starts JAX's device, whose settings are still the user's."""
    if name == "TIP":
        return Marker("link2", (OFFSET, LINK_2, 0.0), axis="y")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


class PeriodicTorque(AbstractFunctionOfTime):
    """amplitude sin(2 pi frequency t)."""

    amplitude: Scalar = quantity(unit="N m", meaning="amplitude of the driving torque")
    frequency: Scalar = quantity(1.0, "Hz", "frequency of the driving torque")

    def __call__(self, time: Scalar) -> Scalar:
        return self.amplitude * jnp.sin(2 * jnp.pi * self.frequency * time)


class StepTorque(AbstractFunctionOfTime):
    """`amplitude` up to `push`, its opposite up to `brake`, then none; switched at once. Steps
    should end at these instants.
    """

    amplitude: Scalar = quantity(unit="N m", meaning="driving torque")
    push: Scalar = quantity(unit="s", meaning="end of the push", at_least=0)
    brake: Scalar | None = quantity(None, "s", "end of the braking (None: no braking)", at_least=0)

    def __call__(self, time: Scalar) -> Scalar:
        pushed = jnp.where(time < self.push, self.amplitude, 0.0)
        if self.brake is None:
            return pushed
        return jnp.where((time >= self.push) & (time < self.brake), -self.amplitude, pushed)


def driving_torques(drive: str | tuple) -> tuple[Any, Any]:
    """Torque [N m] of each joint's motor: "periodic", "step", or two of one's own, numbers or
    functions of time.
    """
    if isinstance(drive, tuple) and len(drive) == 2:
        return drive
    check_name("drive of the antenna (beside two torques)", drive, DRIVES)
    if drive == "periodic":
        first, second = TORQUES
        return PeriodicTorque(first), PeriodicTorque(second)
    return StepTorque(TORQUES[0], PUSH, BRAKE), StepTorque(TORQUES[1], HOLD)


def friction_law(friction: Any) -> AbstractFrictionLaw | None:
    """Coulomb's law ("set_valued"), the three-zone law of Bai & Zhao ("regularised"), a law of
    one's own, or None.
    """
    if friction is None or isinstance(friction, AbstractFrictionLaw):
        return friction
    check_name("friction of the antenna (beside a law, and None)", friction, FRICTIONS)
    if friction == "set_valued":
        return Coulomb(mu_kinetic=MU_KINETIC, mu_static=MU_STATIC)
    return ThreeZone(
        mu_static=MU_STATIC,
        mu_kinetic=MU_KINETIC,
        static_speed=STATIC_SPEED,
        kinetic_speed=KINETIC_SPEED,
    )


def bearing(kind: str, clearance: Any, rub: AbstractFrictionLaw | None) -> Any:
    """A joint of the antenna.

    Args:
        kind: "spatial" (FSRJ) or "planar" (FPRJ) with clearance, or "ideal".
        clearance: radial [m].
        rub: friction law; None: frictionless.
    """
    check_name("kind", kind, KINDS, " of antenna")
    if kind == "ideal":
        return Revolute()
    contact = CarvalhoMartins(stiffness=HertzStiffness(steel(), steel()), restitution=RESTITUTION)
    shared = {
        "contact": contact,
        "friction": rub,
        "bearing_radius": BEARING_RADIUS,
        "clearance": clearance,
        "length": BEARING_LENGTH,
    }
    if kind == "planar":
        return clearances.PlanarJournalBearing(**shared)
    flange = clearances.Flange(contact=contact, radius=FLANGE_RADIUS, clearance=AXIAL_CLEARANCE)
    return clearances.JournalBearing(**shared, journal_length=JOURNAL_LENGTH, flange=flange)


def _make_bodies(offset: float) -> dict[str, Body]:
    across = SATELLITE_MASS * (3 * SATELLITE_RADIUS**2 + SATELLITE_HEIGHT**2) / 12
    rod = TUBE_1 * LINK_1**2 / 12
    mass = TUBE_2 + DISH
    centre = (0.5 * TUBE_2 + DISH) * LINK_2 / mass
    swing = TUBE_2 * LINK_2**2 / 3 + DISH * (LINK_2**2 + DISH_RADIUS**2 / 4) - mass * centre**2
    return {
        "satellite": Body(
            SATELLITE_MASS, (across, across, SATELLITE_MASS * SATELLITE_RADIUS**2 / 2)
        ),
        "link1": Body(TUBE_1, (rod, rod, TUBE_1 * GYRATION**2), (0.0, 0.0, 0.5 * LINK_1)),
        "link2": Body(
            mass,
            (swing, DISH * DISH_RADIUS**2 / 2 + TUBE_2 * GYRATION**2, swing),
            (offset, centre, 0.0),
        ),
    }


@answering
def antenna(
    kind: str = "spatial",
    clearance: float = 0.2e-3,
    *,
    drive: str | tuple = "periodic",
    friction: Any = "set_valued",
    offset: float = OFFSET,
) -> Mechanism:
    """The antenna pointing mechanism on its satellite: links 1 and 2, joints "J1" and "J2".

    Everything starts at rest, link 2 level.

    Args:
        kind: kind of both joints, a text: "spatial", "planar" or "ideal". The planar kind leaves a
            journal free to tilt and slide unless its joint always touches: take it with
            `integrator.NonColliding` only.
        clearance: radial clearance [m], > 0.
        drive: torques of both motors: "periodic", "step", or a tuple of two [N m], numbers or
            functions of time [s].
        friction: "set_valued" (Coulomb, for `NonColliding` and `MoreauJean`), "regularised" (three
            zones, for compliant integrators too), a friction law, or None.
        offset: distance of link 2 from link 1 along the axis of J2 [m].

    Returns:
        the mechanism.

    Raises:
        ValueError: for an unknown word, or a clearance that is not positive.
    """
    check_number("clearance of antenna", clearance, "m", above=0)
    check_number("offset of antenna", offset, "m")
    # One each, so that a study may vary the clearances of either.
    joints = {name: bearing(kind, clearance, friction_law(friction)) for name in JOINTS}
    places = {
        "J1": (Marker("satellite", (0.0, 0.0, 0.5 * SATELLITE_HEIGHT)), Marker("link1")),
        "J2": (Marker("link1", (0.0, 0.0, LINK_1), axis="x"), Marker("link2", axis="x")),
    }
    torques = zip(JOINTS, driving_torques(drive), strict=True)
    base = {"base": Connection(Free(), "ground", "satellite")}
    top = 0.5 * SATELLITE_HEIGHT
    # Held by contacts alone, bodies start by place.
    guess = {} if kind == "ideal" else {"link1": (0.0, 0.0, top), "link2": (0.0, 0.0, top + LINK_1)}
    return Mechanism(
        bodies=_make_bodies(offset),
        connections=base | {name: Connection(joints[name], *ends) for name, ends in places.items()},
        loads={f"motor {name}": MotorTorque(*places[name], torque) for name, torque in torques},
        guess=guess,
    )
