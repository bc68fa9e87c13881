"""The mechanism on which jaxclear and other programs run side by side: a slider-crank with a
worn-out rod-slider joint.

Crank driven at constant speed, rod, slider; the slider carries the journal, the rod the bearing. No
gravity: at this speed it is a thousandth of the crank pin's acceleration. Start: crank along the
guide, journal concentric and at rest in the bearing.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

import jaxclear as jc

CRANK, ROD, ROD_MASS, ROD_INERTIA, SLIDER_MASS = 0.05, 0.12, 0.21, 2.5e-4, 0.14
SPEED = 5000 * 2 * math.pi / 60
TURN = 2 * math.pi / SPEED
CLEARANCE, RADIUS, YOUNG, POISSON, RESTITUTION, MU = 0.5e-3, 10e-3, 207e9, 0.3, 0.9, 0.03
# Saving times a turn at which places are compared.
GRID = 240
# An error-controlled program holds coordinates and speeds to rtol |y| + ATOL_SHARE rtol.
ATOL_SHARE = 1e-2

# Accuracy asked: a fiftieth of a percent of the slider's stroke would be 20 um; 1 um is 0.2 % of
# the clearance, so the path of the journal in its bearing is still right. A peak force to 1 % is
# more than any stiffness is known to.
PLACE_ACCURACY, FORCE_ACCURACY = 1e-6, 1e-2
# References are solved to this tolerance, and once more by another method to the second.
REFERENCE_RTOL, SECOND_RTOL = 1e-12, 1e-10


class Question(NamedTuple):
    """How long, and how many saving times."""

    duration: float
    saves: int

    @property
    def interval(self) -> float:
        return self.duration / self.saves

    @property
    def times(self) -> np.ndarray:
        """Saving times after the first."""
        return np.linspace(0.0, self.duration, self.saves + 1)[1:]


def question(turns: float) -> Question:
    """A run of so many turns of the crank."""
    return Question(turns * TURN, round(turns * GRID))


class Answer(NamedTuple):
    """What every program returns: the slider's place [m] at the saving times after the first, the
    peak force [N], steps taken.
    """

    places: np.ndarray
    peak: float
    steps: int


class Batch(NamedTuple):
    """A program's way to run many clearances, at most `most`: `go(setting, clearances)`, which does
    `share(setting)` of a run.

    It returns a row for every sample: peak force [N] (NaN: the sample failed), the slider's last
    place [m], and CPU time spent in another process [s], if any.
    """

    go: Callable[[float, np.ndarray], np.ndarray]
    how: str
    share: Callable[[float], float] = lambda setting: 1.0
    most: int = 1 << 30


@dataclass(frozen=True)
class Program:
    """One program: `run(setting)`, the setting a number of steps per saving interval, or a relative
    tolerance.

    `settings` from coarse to fine. `law`: which of `LAWS` it solves.
    """

    name: str
    law: str
    settings: tuple[float, ...]
    run: Callable[[float], Answer]
    batch: Batch | None = None
    adaptive: bool = False


class Numbers(NamedTuple):
    """What a hand-written program needs, SI units. `inertia`: of the rod about the crank pin;
    `pull`: product of the rod's mass, half its length and the crank pin's acceleration; `damping`:
    0.75 (1 - e^2)."""

    crank: float
    rod: float
    slider: float
    inertia: float
    pull: float
    speed: float
    radius: float
    modulus: float
    damping: float
    slowest: float
    mu: float
    inner: float
    outer: float


def stiffness(clearance: float) -> float:
    """Hertz's stiffness of a ball in a socket with these radii, both of steel [N/m^1.5]."""
    modulus = YOUNG / (1 - POISSON**2) / 2
    return 4 / 3 * modulus * math.sqrt((RADIUS - clearance) * RADIUS / clearance)


def mechanism(clearance: float = CLEARANCE) -> jc.Mechanism:
    """The rig in jaxclear: the scene at this speed, without gravity."""
    steel = jc.Material(YOUNG, POISSON)
    contact = jc.contact.LankaraniNikravesh(
        stiffness=jc.stiffness.HertzStiffness(steel, steel), restitution=RESTITUTION
    )
    return jc.scenes.slider_crank(
        clearance=clearance, contact=contact, crank_speed=SPEED, gravity=None
    )


def numbers() -> Numbers:
    """The same rig as plain numbers, its laws' defaults taken from jaxclear."""
    contact, friction = jc.contact.LankaraniNikravesh(), jc.friction.Ambrosio()
    return Numbers(
        crank=CRANK,
        rod=ROD,
        slider=SLIDER_MASS,
        inertia=ROD_INERTIA + ROD_MASS * (ROD / 2) ** 2,
        pull=ROD_MASS * ROD / 2 * CRANK * SPEED**2,
        speed=SPEED,
        radius=RADIUS,
        modulus=YOUNG / (1 - POISSON**2) / 2,
        damping=0.75 * (1 - RESTITUTION**2),
        slowest=float(contact.slowest_impact),
        mu=MU,
        inner=float(friction.inner_speed),
        outer=float(friction.outer_speed),
    )


# What differs between the programs' laws: where friction starts.
LAWS: dict[str, Numbers] = {
    "captured": numbers(),
    "captured, friction from 0": numbers()._replace(inner=0.0),
}


def steps_ladder(coarse: float, fine: float) -> tuple[float, ...]:
    """Steps per saving interval, growing by the square root of two, for steps between `coarse` and
    `fine` [s].
    """
    interval = TURN / GRID
    count = math.ceil(2 * math.log2(coarse / fine))
    return tuple(float(round(interval / coarse * 2 ** (i / 2))) for i in range(count + 1))


def tolerance_ladder(loose: float, tight: float) -> tuple[float, ...]:
    """Relative tolerances, two a decade."""
    count = round(2 * math.log10(loose / tight))
    return tuple(loose * 10 ** (-i / 2) for i in range(count + 1))
