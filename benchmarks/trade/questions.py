"""Every scene as a problem: what varies, how long it runs, and all that is asked of it.

Friction losses are those of the saved instants (force times sliding speed), so that every
formulation can tell them; reactions stand in for contact forces where joints are ideal.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

import jaxclear as jc
from jaxclear.ground.numerics import safe_sqrt
from jaxclear.results.response import AbstractResponse
from jaxclear.scenes.antenna import BASE, TIP
from jaxclear.scenes.parallel_3rsr import QUIET, RATTLING

SAVES = 201
# Bounds of the number that varies, as a share of it.
TOLERANCE = 1e-2


class FrictionLoss(AbstractResponse):
    """Energy that friction takes in a clearance joint over the run [J], from the saved instants."""

    joint: str = eqx.field(static=True)
    unit: str = eqx.field(static=True, default="J", kw_only=True)

    def drawn_from(self) -> str:
        return "wear"

    def __call__(self, run: jc.Trajectory) -> Any:
        contact = run.contact(self.joint)
        power = jnp.sum(contact.traction * contact.slip_speed, axis=-1)
        return jnp.sum(0.5 * (power[1:] + power[:-1]) * jnp.diff(run.time))


class MeanReaction(AbstractResponse):
    """Mean force in a connection over the saved instants [N]."""

    connection: str = eqx.field(static=True)
    unit: str = eqx.field(static=True, default="N", kw_only=True)

    def drawn_from(self) -> str:
        return "forces"

    def __call__(self, run: jc.Trajectory) -> Any:
        return jnp.mean(_size(run.reaction(self.connection).force))


class PeakReaction(AbstractResponse):
    """Largest force in a connection at the saved instants [N]."""

    connection: str = eqx.field(static=True)
    unit: str = eqx.field(static=True, default="N", kw_only=True)

    def drawn_from(self) -> str:
        return "peak forces"

    def __call__(self, run: jc.Trajectory) -> Any:
        return jnp.max(_size(run.reaction(self.connection).force))


def _size(force: Any) -> Any:
    return safe_sqrt(jnp.sum(force * force, axis=-1))


class Question(NamedTuple):
    """A problem, the rungs that its scene cannot be run on, and the shortest step [s] tried."""

    problem: jc.Problem
    without: tuple[str, ...] = ()
    shortest: float = 1e-6


def _forces(joint: str) -> dict[str, Callable]:
    return {
        "mean force": jc.response.MeanContactForce(joint),
        "peak force": jc.response.PeakContactForce(joint),
        "friction loss": FrictionLoss(joint),
    }


def _worn(joint: str, surface: str = "bearing") -> dict[str, Callable]:
    return {
        "worn volume": jc.response.WornVolume(joint, surface),
        "worn depth": jc.response.PeakWornDepth(joint, surface),
    }


def _reactions(connection: str) -> dict[str, Callable]:
    return {"mean force": MeanReaction(connection), "peak force": PeakReaction(connection)}


def _away(body: str, ideal: jc.Mechanism, duration: float) -> dict[str, Callable]:
    """Distance of a body from where it is in the ideal mechanism."""
    path = jc.simulate(ideal, duration, save=SAVES).body(body).com
    return {"position error": jc.response.PositionError(body, path)}


# Made once for each name: what varies is part of a compiled program by its identity.
@functools.cache
def _clearance(*joints: str) -> dict[str, jc.Variable]:
    return {
        "clearance": jc.Variable(
            lambda rig: [rig.connections[name].joint.clearance for name in joints],
            tolerance=TOLERANCE * 1e-4,
        )
    }


@functools.cache
def _mass(body: str) -> dict[str, jc.Variable]:
    return {"mass": jc.Variable(lambda rig: rig.bodies[body].mass, tolerance=TOLERANCE * 0.1)}


def slider_crank(speed: float = 50.0, clearance: float = 0.1e-3, share: float = 0.5) -> Question:
    """The scene with wear, half a turn."""
    duration = share * 6.28 / speed
    rig = jc.scenes.slider_crank(clearance=clearance, crank_speed=speed, wear=True)
    ideal = jc.scenes.slider_crank("ideal", crank_speed=speed)
    asked = _forces("B") | _worn("B") | _away("slider", ideal, duration)
    problem = jc.Problem(rig, asked, _clearance("B"), duration=duration, save=SAVES)
    return Question(problem, ("NonColliding",))


def four_bar(
    kind: str, speed: float = 10.0, clearance: float = 0.2e-3, share: float = 1.0
) -> Question:
    """The scene, its first part, in which impacts are strong and then fade."""
    duration = share * 2.0 / speed
    rig = jc.scenes.four_bar(kind, clearance, crank_speed=speed, cells=(72, 20))
    ideal = jc.scenes.four_bar("ideal", crank_speed=speed)
    asked = _forces("B") | _worn("B")
    if kind == "planar":
        asked |= _away("follower", ideal, duration)
    problem = jc.Problem(rig, asked, _clearance("B"), duration=duration, save=SAVES)
    return Question(problem, ("NonColliding",))


def guide(speed: float = 5.0, clearance: float = 0.1e-3, share: float = 1.0) -> Question:
    """The scene with smooth friction (the paper's own transition speed makes explicit steps
    absurdly short)."""
    duration = share * 0.5 / speed
    rub = jc.friction.CoulombTanh(mu_kinetic=0.1, transition_speed=1e-2)
    rig = jc.scenes.guide(clearance=clearance, crank_speed=speed, friction=rub)
    ideal = jc.scenes.guide("ideal", crank_speed=speed)
    asked = _forces("P") | _away("guide", ideal, duration)
    return Question(jc.Problem(rig, asked, _clearance("P"), duration=duration, save=SAVES))


def antenna(clearance: float = 0.2e-3, duration: float = 0.1) -> Question:
    """The scene with friction that is a function of the speed, at the start of its manoeuvre."""
    rig = jc.scenes.antenna("spatial", clearance, friction="regularised")
    asked = {"pointing": jc.response.PointingAngle(TIP, BASE)} | _forces("J1")
    problem = jc.Problem(rig, asked, _clearance("J1", "J2"), duration=duration, save=SAVES)
    return Question(problem, ("MoreauJean", "FixedStep, contact_steps"))


def flap(clearance: float = 0.1e-3, share: float = 1.0) -> Question:
    """The scene until all four journals have met their bearings. Its dampers are stiff: explicit
    steps follow them at 1e-8 s. `AdamsImpact` tells rigid contact no restitution. Nearly all that
    friction takes is taken between the saved instants, so it is not asked."""
    duration = share * 0.03
    rig, ideal = jc.scenes.flap(clearance=clearance), jc.scenes.flap("ideal")
    asked = _forces("J1") | _away("rod 2", ideal, duration)
    del asked["friction loss"]
    asked["mean force, J4"] = jc.response.MeanContactForce("J4")
    problem = jc.Problem(
        rig, asked, _clearance("J1", "J2", "J3", "J4"), duration=duration, save=SAVES
    )
    return Question(problem, ("MoreauJean",), 1e-7)


def parallel_3rsr(period: float, duration: float, clearance: float = 0.5e-3) -> Question:
    """The scene with wear, part of a cycle: the ball falls through its play and bounces."""
    rig = jc.scenes.parallel_3rsr("one", clearance, period=period)
    ideal = jc.scenes.parallel_3rsr("ideal", period=period)
    asked = _forces("S1") | _worn("S1", "socket") | _away("platform", ideal, duration)
    return Question(jc.Problem(rig, asked, _clearance("S1"), duration=duration, save=SAVES))


def ideal(rig: jc.Mechanism, joint: str, body: str, place: Any, duration: float) -> Question:
    """A scene without clearance: reactions in a joint and a last coordinate, by a body's mass."""
    asked = _reactions(joint) | {"place": place}
    return Question(jc.Problem(rig, asked, _mass(body), duration=duration, save=SAVES))


Place = jc.response.FinalCoordinate
SCENES: dict[str, Callable[[], Question]] = {
    "slider-crank": slider_crank,
    "slider-crank, ideal": lambda: ideal(
        jc.scenes.slider_crank("ideal"), "B", "rod", Place("G", unit="m"), 0.12
    ),
    "four-bar, planar": lambda: four_bar("planar"),
    "four-bar, spatial": lambda: four_bar("spatial"),
    "four-bar, ideal": lambda: ideal(
        jc.scenes.four_bar("ideal"), "B", "coupler", Place("D"), 0.628
    ),
    "guide": guide,
    "guide, ideal": lambda: ideal(
        jc.scenes.guide("ideal", crank_speed=5.0), "P", "slider", Place("C"), 1.256
    ),
    "antenna": antenna,
    "antenna, ideal": lambda: ideal(jc.scenes.antenna("ideal"), "J1", "link1", Place("J2"), 1.0),
    "flap": flap,
    "flap, ideal": lambda: ideal(jc.scenes.flap("ideal"), "J1", "rod 1", Place("O2"), 0.2),
    "3RSR, quiet": lambda: parallel_3rsr(QUIET, 0.25 * QUIET),
    "3RSR, rattling": lambda: parallel_3rsr(RATTLING, RATTLING / 3),
    "3RSR, ideal": lambda: ideal(
        jc.scenes.parallel_3rsr("ideal", period=QUIET), "S1", "rod 1", Place("B1"), QUIET
    ),
}
