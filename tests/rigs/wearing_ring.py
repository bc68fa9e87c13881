"""A journal pressed against the wall of a ring that turns: every cell of the wall wears alike, so
the depth over a life has a closed form.

A slide presses the journal outwards. As the wall wears its force falls with its way x beyond the
clearance, as F0 (1 - a x), which gives an exponential law, or as F0 / (1 + a x), which gives a law
of square roots; x is the depth and the compliance of the contact, F / K."""

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq

import jaxclear as jc
from jaxclear.components.load import AbstractCoordinateLoad
from tests.rigs.worn_scar import crescent

TURN, CELLS, SAVES = 0.05, 36, 37
RADIUS, CLEARANCE, LENGTH = 10e-3, 0.1e-3, 20e-3
STIFFNESS, FORCE = 1e8, 100.0
WEAR, HARDNESS = 1e-5, 2e9
# Of the force [1/m].
SLOPE = 1e5


class Falling(AbstractCoordinateLoad):
    """A force [N] that falls with the way [m] beyond the clearance. All cases are numbers: one
    program serves them."""

    connection: str = eqx.field(static=True)
    slope: jc.Scalar = jc.quantity(SLOPE, "1/m", "share of the force that is lost per way")
    hyperbolic: jc.Scalar = jc.quantity(0.0, "1", "0 for F0 (1 - a x), 1 for F0 / (1 + a x)")
    damping: jc.Scalar = jc.quantity(2e3, "N s/m", "damping of the slide")
    first: jc.Scalar = jc.quantity(FORCE, "N", "force where nothing is worn")
    breaks: jc.Scalar = jc.quantity(1.0, "m", "way beyond which there is no force, only nan")

    def force(self, time, position, speed):
        way = position - CLEARANCE
        # Only beyond touch, so that it has no pole.
        falling = 1 / (1 + self.slope * jc.numerics.positive_part(way))
        share = (1 - self.hyperbolic) * (1 - self.slope * way) + self.hyperbolic * falling
        force = self.first * jnp.where(way > self.breaks, jnp.nan, share)
        lost = self.damping * speed
        return force - lost, 0, lost * speed, force * speed


def wearing_ring(slope=SLOPE, hyperbolic=False, breaks=1.0, worn=("bearing",), cells=CELLS):
    """The mechanism; `slope` [1/m], 0 for a constant force, below zero for one that grows with the
    way, as that of an unbalance does. `worn`: of the ring (bearing), and of the journal, into which
    it cuts a crescent."""
    wearing = jc.Wearing(jc.wear.Archard(wear_coefficient=WEAR, hardness=HARDNESS), (cells, 1))
    joint = jc.clearance.PlanarJournalBearing(
        jc.contact.KelvinVoigt(stiffness=STIFFNESS, damping=1e4, onset_depth=1e-8),
        bearing_radius=RADIUS,
        clearance=CLEARANCE,
        length=LENGTH,
        **{f"{surface}_wear": wearing for surface in worn},
    )
    turning = jc.joint.Revolute(drive=jc.drive.ConstantSpeed(2 * math.pi / TURN))
    slide = jc.Connection(
        jc.joint.Prismatic(), jc.Marker("ground", axis="x"), jc.Marker("slide", axis="x")
    )
    return jc.Mechanism(
        {"ring": jc.Body(1.0, 1e-3), "slide": jc.Body(1.0, 1e-3)},
        {
            "O": jc.Connection(turning, "ground", "ring"),
            "G": slide,
            "B": jc.Connection(joint, "ring", "slide"),
        },
        {"press": Falling("G", slope, float(hyperbolic), breaks=breaks)},
        start={"G": CLEARANCE + FORCE / STIFFNESS},
    )


# One program serves all problems whose variables are these.
VARIABLES = {
    "hardness": jc.Variable(
        lambda rig: rig.connections["B"].joint.bearing_wear.law.hardness, tolerance=2e8
    ),
    "load": jc.Variable(lambda rig: rig.loads["press"].first, tolerance=5.0),
}


def problem(rig, **kwargs):
    """The responses of one turn, by steps that resolve the contact."""
    responses = {"force": jc.response.MeanContactForce("B")}
    varied = dict(VARIABLES)
    if rig.connections["B"].joint.bearing_wear is None:
        del varied["hardness"]
    else:
        responses["peak depth"] = jc.response.PeakWornDepth("B")
    integrator = jc.integrator.FixedStep(5e-5)
    return jc.Problem(
        rig, responses, varied, duration=TURN, save=SAVES, integrator=integrator, **kwargs
    )


class ClosedForm(NamedTuple):
    """Depth [m] and force [N] after so many turns."""

    slope: float = SLOPE
    hyperbolic: bool = False

    def force_at(self, depth: float) -> float:
        """Of the slide at rest: F K = K F0 (1 - a (h + F/K)) or F (1 + a (h + F/K)) = F0."""
        a, k = self.slope, STIFFNESS
        if not self.hyperbolic:
            return FORCE * (1 - a * depth) / (1 + FORCE * a / k)
        b = 1 + a * depth
        return (-b + math.sqrt(b * b + 4 * a * FORCE / k)) / (2 * a / k)

    def rate(self, depth: float) -> float:
        """Depth a turn: the contact lies half its indentation beyond the bearing's radius."""
        force = self.force_at(depth)
        return WEAR / HARDNESS * force / LENGTH * (1 + 0.5 * force / STIFFNESS / RADIUS)

    def turns(self, depth: float) -> float:
        """Turns until a depth: the integral over forces of -(dh/dF) / rate. The last factor of
        `rate`, 5e-5 from 1, is taken at its mean."""
        first, last = self.force_at(0.0), self.force_at(depth)
        a, k = self.slope, STIFFNESS
        if not self.hyperbolic:
            integral = (1 / (FORCE * a) + 1 / k) * math.log(first / last)
        else:
            integral = FORCE / (2 * a) * (1 / last**2 - 1 / first**2) + math.log(first / last) / k
        mean = 1 + 0.25 * (first + last) / STIFFNESS / RADIUS
        return integral * HARDNESS * LENGTH / WEAR / mean

    def turns_of_crescent(self, depth: float) -> float:
        """Turns until a crescent in the journal is so deep, where that alone wears."""
        radius, step = RADIUS - CLEARANCE, 1e-4 * depth

        def rate(x):
            """Turns a metre."""
            volumes = (crescent(max(x + s, 0.0), CLEARANCE, radius) for s in (step, -step))
            force, slope = self.force_at(x), np.subtract(*volumes) / (x + step - max(x - step, 0.0))
            slid = 2 * math.pi * (RADIUS + 0.5 * force / STIFFNESS)
            return slope / (WEAR / HARDNESS * force * slid)

        return quad(rate, 0.0, depth)[0]

    def depth(self, turns: float) -> float:
        """Depth after so many turns."""
        deepest = 0.999 / self.slope if not self.hyperbolic else 1e3 / self.slope
        return brentq(lambda h: self.turns(h) - turns, 0.0, deepest, xtol=1e-16)


def uniform(depths) -> float:
    """How far the depths of the cells are from their mean, as a share of it."""
    depths = np.asarray(depths)
    return float(np.ptp(depths) / depths.mean())
