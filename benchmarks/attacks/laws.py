"""A law of each family with numbers drawn at random: contact, friction, wear.

Ranges are those of machines: metals and plastics, dry and greased. Every member of the families is
here; `members` holds the list that a test compares with them.
"""

from collections.abc import Callable
from typing import Any

import jaxclear as jc
from benchmarks.attacks.numbers import Draw

Maker = Callable[[Draw], Any]
# Laws of cylinders take the modulus of the pair, laws of balls and points a stiffness.
CYLINDERS = ("Johnson", "TwoSidedJohnson", "Radzimovsky", "Goldsmith", "Liu", "BaiZhao")
OF_MODULUS = (*CYLINDERS, "BallInSocket", "ModifiedFlores")
OF_STIFFNESS = (
    "Hertz",
    "HuntCrossley",
    "LankaraniNikravesh",
    "HerbertMcWhannell",
    "Flores",
    "HuGuo",
    "ZhiyingQishao",
    "CarvalhoMartins",
    "Gonthier",
)


def _restitution(n: Draw) -> float:
    return n.flat(0.2, 0.98, 0.9)


def _modulus(name: str) -> Maker:
    law = getattr(jc.contact, name)
    return lambda n: law(modulus=n.log(2e9, 2e11, 1.1e11), restitution=_restitution(n))


def _stiffness(name: str) -> Maker:
    law = getattr(jc.contact, name)
    return lambda n: law(stiffness=n.log(1e7, 1e11, 1e10), restitution=_restitution(n))


CONTACTS: dict[str, Maker] = (
    {name: _stiffness(name) for name in OF_STIFFNESS}
    | {name: _modulus(name) for name in OF_MODULUS}
    | {
        "Linear": lambda n: jc.contact.Linear(
            stiffness=n.log(1e6, 1e9, 1e8), restitution=_restitution(n)
        ),
        "MarhefkaOrin": lambda n: jc.contact.MarhefkaOrin(
            stiffness=n.log(1e7, 1e11, 1e10), loss_per_speed=n.flat(0.05, 0.5, 0.2)
        ),
        "KelvinVoigt": lambda n: jc.contact.KelvinVoigt(
            stiffness=n.log(1e6, 1e9, 1e8), damping=n.log(10.0, 1e4, 1e3)
        ),
        "AdamsImpact": lambda n: jc.contact.AdamsImpact(
            stiffness=n.log(1e8, 1e10, 1e9), damping=n.log(10.0, 1e4, 1e3)
        ),
    }
)


def _two_coefficients(n: Draw) -> dict[str, float]:
    kinetic = n.log(0.01, 0.5, 0.1)
    return {"mu_kinetic": kinetic, "mu_static": kinetic * n.flat(1.0, 2.0, 1.5)}


def _two_speeds(n: Draw, low: str, high: str, usual: tuple[float, float]) -> dict[str, float]:
    slow = n.log(1e-4, 1e-1, usual[0])
    return {low: slow, high: slow * n.log(3.0, 100.0, usual[1] / usual[0])}


FRICTIONS: dict[str, Maker] = {
    "CoulombTanh": lambda n: jc.friction.CoulombTanh(
        mu_kinetic=n.log(0.01, 0.5, 0.1), transition_speed=n.log(1e-4, 1e-1, 1e-3)
    ),
    "Ambrosio": lambda n: jc.friction.Ambrosio(
        mu_kinetic=n.log(0.01, 0.5, 0.1),
        **_two_speeds(n, "inner_speed", "outer_speed", (1e-4, 1e-3)),
    ),
    "ThreeZone": lambda n: jc.friction.ThreeZone(
        **_two_coefficients(n), **_two_speeds(n, "static_speed", "kinetic_speed", (1e-3, 1e-2))
    ),
    "AdamsStep": lambda n: jc.friction.AdamsStep(
        **_two_coefficients(n), **_two_speeds(n, "static_speed", "kinetic_speed", (1e-4, 1e-2))
    ),
    "Threlfall": lambda n: jc.friction.Threlfall(
        mu_kinetic=n.log(0.01, 0.5, 0.1), transition_speed=n.log(1e-4, 1e-1, 1e-3)
    ),
    "BengisuAkay": lambda n: jc.friction.BengisuAkay(
        **_two_coefficients(n), peak_speed=n.log(1e-4, 1e-1, 1e-3), decay=n.log(10.0, 1e4, 1e3)
    ),
    "Stribeck": lambda n: jc.friction.Stribeck(
        **_two_coefficients(n), **_two_speeds(n, "transition_speed", "stribeck_speed", (1e-4, 1e-2))
    ),
    "Dahl": lambda n: jc.friction.Dahl(
        mu_kinetic=n.log(0.01, 0.5, 0.1), presliding=n.log(1e-7, 1e-4, 1e-6)
    ),
    "LuGre": lambda n: jc.friction.LuGre(
        **_two_coefficients(n),
        stribeck_speed=n.log(1e-3, 1e-1, 1e-2),
        presliding=n.log(1e-7, 1e-4, 1e-6),
        settling_time=n.log(1e-5, 1e-3, 1e-4),
    ),
}

WEARS: dict[str, Maker] = {
    "Archard": lambda n: jc.wear.Archard(
        wear_coefficient=n.log(1e-6, 1e-3, 1e-4), hardness=n.log(1e8, 5e9, 2e9)
    ),
    "Fouvry": lambda n: jc.wear.Fouvry(energy_wear_coefficient=n.log(1e-15, 1e-12, 2e-14)),
}


def members() -> dict[str, set[str]]:
    """Names of the laws that are drawn, by family."""
    return {"contact": set(CONTACTS), "friction": set(FRICTIONS), "wear": set(WEARS)}
