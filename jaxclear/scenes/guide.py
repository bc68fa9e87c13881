"""Crank, slider and rotating guide (quick-return mechanism) with clearance and dry friction between
slider and guide.

Source: Luo, Qi & Kong, "Non-colliding contact analysis with friction in the planar prismatic
joint", tables 1 and 2. From the paper: lengths, masses and moments of inertia of crank, slider
and guide, v_s = 0.0001 m/s of the regularised friction.

The frame's origin is the crank's pivot O; the guide turns about C at (-GROUND_DISTANCE, 0); the
crank's end carries the slider (joint A), which slides in the guide (joint P). Its coordinate is its
place along the guide from where it starts.

Read off the paper's moments of inertia: 3.28292083 = m (l^2/3 + w^2/12) for a crank of width w =
0.1 m, so it is about the crank's pivot, at its end; 0.06500833 = m (l^2 + w^2)/12 for a slider of
width 0.1 m, so it is about the slider's centre, and its width is 0.1 m. The guide's 32.5078317 is
possible neither about its middle (no body of 1.6 m has a radius of gyration of 0.88 m) nor about
its end (at least m l^2/3 = 35.7); about a point 0.75 m from the middle, that is 0.05 m from the
end, it leaves m (l^2 + (0.106 m)^2)/12 about the middle. So it is taken about the guide's pivot,
0.05 m from its end.

Assumed, because the paper's text does not say: centres of mass half-way along each body; the pin in
the slider's centre; pivots 0.8 m apart (the slider stays 0.2 to 1.4 m from C and so within the
guide); crank speed 5 rad/s (inertia forces about as large as weights, so that the slider changes
sides within a turn); gravity in the plane, along -y (the default of Adams, with which the paper
compares); friction 0.1 (dry steel on steel); gap 0.1 mm on each side (a loose sliding fit of this
size); corners rounded with 5 mm and a restitution of 0.8, which only runs with impacts feel.
Masses are those of bars 0.1 m wide and 0.1 m broad of a density of 7801 kg/m3, so the faces that
wear are 0.1 m broad; both parts are as hard, with the wear coefficient that Archard has by default.
"""

from typing import Any

import jax.numpy as jnp

from jaxclear.components.body import Body, Connection, Marker
from jaxclear.components.clearance import SliderGuide
from jaxclear.components.drive import AbstractDrive, ConstantSpeed
from jaxclear.components.joint import Prismatic, Revolute
from jaxclear.components.load import AbstractLoad, Gravity, JointTorque
from jaxclear.components.wear_map import Wearing
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_name, check_number
from jaxclear.laws.contact import CarvalhoMartins
from jaxclear.laws.friction import AbstractFrictionLaw, Coulomb, CoulombTanh
from jaxclear.laws.material import steel
from jaxclear.laws.stiffness import HertzStiffness
from jaxclear.laws.wear import Archard
from jaxclear.multibody.mechanism import Mechanism

CRANK, SLIDER, WIDTH, GUIDE_LENGTH = 0.5, 0.2, 0.1, 1.6
CRANK_MASS, SLIDER_MASS, GUIDE_MASS = 39.005, 15.602, 41.850
# About the crank's pivot, the slider's centre and the guide's pivot.
CRANK_INERTIA, SLIDER_INERTIA, GUIDE_INERTIA = 3.28292083, 0.06500833, 32.5078317
# From the guide's pivot to its middle.
GUIDE_ARM = 0.5 * GUIDE_LENGTH - 0.05
BREADTH = 0.1
GROUND_DISTANCE = 0.8
CRANK_SPEED = 5.0
GRAVITY = 9.81
MU = 0.1
# v_s of the paper's regularised friction.
REGULARISING_SPEED = 1e-4
# Radius of the slider's rounded corners [m].
CORNER_RADIUS = 5e-3
# Along the guide where it wears: a centimetre each.
CELLS = (4, 160)
WALLS = {"breadth": BREADTH, "guide_length": GUIDE_LENGTH}
KINDS = ("guide", "wearing", "ideal")
FRICTIONS = ("set_valued", "regularised")


def friction_law(friction: Any) -> AbstractFrictionLaw | None:
    """Coulomb's law ("set_valued"), its regularisation with v_s ("regularised"), a law of one's
    own, or None.
    """
    if friction is None or isinstance(friction, AbstractFrictionLaw):
        return friction
    check_name("friction of the guide (beside a law, and None)", friction, FRICTIONS)
    if friction == "set_valued":
        return Coulomb(mu_kinetic=MU)
    return CoulombTanh(mu_kinetic=MU, transition_speed=REGULARISING_SPEED)


def slider_joint(
    kind: str, clearance: Any, friction: AbstractFrictionLaw | None, middle: Any
) -> Any:
    """The joint of slider and guide.

    Args:
        kind: "guide" with a gap, "wearing" with a gap and both parts wearing, or "ideal".
        clearance: gap on each side [m].
        friction: law of the contacts; None: frictionless.
        middle: of the guide, along it from where the slider starts [m].
    """
    check_name("kind", kind, KINDS, " of guide")
    if kind == "ideal":
        return Prismatic()
    walls: dict[str, Any] = {}
    if kind == "wearing":
        wear = Wearing(Archard(), CELLS)
        walls = WALLS | {"guide_middle": middle, "guide_wear": wear, "slider_wear": wear}
    return SliderGuide(
        contact=CarvalhoMartins(stiffness=HertzStiffness(steel(), steel()), restitution=0.8),
        friction=friction,
        width=WIDTH,
        length=SLIDER,
        clearance=clearance,
        corner_radius=CORNER_RADIUS,
        **walls,
    )


def _make_bodies() -> dict[str, Body]:
    half = 0.5 * CRANK
    return {
        "crank": Body(CRANK_MASS, CRANK_INERTIA - CRANK_MASS * half**2, (half, 0.0)),
        "slider": Body(SLIDER_MASS, SLIDER_INERTIA),
        "guide": Body(GUIDE_MASS, GUIDE_INERTIA - GUIDE_MASS * GUIDE_ARM**2, (GUIDE_ARM, 0.0)),
    }


def _from_pivot_to_crank(crank_angle: Any) -> tuple[Any, Any]:
    """Distance [m] and direction [rad] from C to the crank's end."""
    along, across = GROUND_DISTANCE + CRANK * jnp.cos(crank_angle), CRANK * jnp.sin(crank_angle)
    return jnp.hypot(along, across), jnp.arctan2(across, along)


def _make_loads(gravity: Any, torque: Any) -> dict[str, AbstractLoad]:
    """Weights under a `gravity` [m/s2], and the crank's `torque` [N m]; None for none."""
    loads: dict[str, AbstractLoad] = {}
    if gravity is not None:
        check_number("gravity of guide", gravity, "m/s^2")
        loads["gravity"] = Gravity((0.0, -gravity))
    if torque is not None:
        loads["torque"] = JointTorque("O", torque)
    return loads


@answering
def guide(
    kind: str = "guide",
    clearance: float = 0.1e-3,
    *,
    friction: Any = "set_valued",
    drive: AbstractDrive | str | None = "constant",
    crank_angle: float = 0.0,
    crank_speed: float = CRANK_SPEED,
    torque: Any | None = None,
    gravity: float | None = GRAVITY,
) -> Mechanism:
    """The mechanism of the paper whose joint "P" between guide and slider has clearance.

    Args:
        kind: kind of joint P, a text: "guide" with clearance, "wearing" as this with both parts
            wearing, or "ideal".
        clearance: gap on each side of the centred slider [m], > 0.
        friction: "set_valued" (for `NonColliding` and `MoreauJean`), "regularised" (for compliant
            integrators; `NonColliding` takes its coefficients), a friction law, or None.
        drive: drive of the crank: "constant" from `crank_angle` with `crank_speed`; or one of
            `jaxclear.drive` that starts at `crank_angle`; or None: a free crank that starts so,
            under `torque`.
        crank_angle: angle of the crank at the start [rad].
        crank_speed: speed of the crank, at the start or throughout [rad/s].
        torque: torque on a free crank [N m], a number or a function of time [s]; none by default.
        gravity: acceleration of free fall along -y [m/s^2]; None: absent.

    Returns:
        the mechanism.

    Raises:
        ValueError: for an unknown word, a clearance that is not positive, or a torque on a driven
            crank.
    """
    check_number("clearance of guide", clearance, "m", above=0)
    check_number("crank_angle of guide", crank_angle, "rad")
    reach, tilt = _from_pivot_to_crank(crank_angle)
    joint = slider_joint(kind, clearance, friction_law(friction), GUIDE_ARM - reach)
    if isinstance(drive, str):
        check_name("drive of guide (beside a drive of your own, and None)", drive, ["constant"])
        drive = ConstantSpeed(crank_speed, crank_angle)
    if drive is not None and torque is not None:
        raise ValueError(
            "the crank of the guide is driven and under a torque; give drive=None for the torque "
            "to move it."
        )
    return Mechanism(
        bodies=_make_bodies(),
        connections={
            "O": Connection(Revolute(drive=drive), "ground", "crank"),
            "C": Connection(Revolute(), "ground", "guide", at=(-GROUND_DISTANCE, 0.0)),
            "A": Connection(Revolute(), "crank", "slider", at=(CRANK, 0.0)),
            "P": Connection(joint, Marker("guide", (reach, 0.0), "x"), Marker("slider", axis="x")),
        },
        loads=_make_loads(gravity, torque),
        start={} if drive else {"O": crank_angle},
        speeds={} if drive else {"O": crank_speed},
        guess={"C": tilt, "A": tilt - crank_angle},
    )
