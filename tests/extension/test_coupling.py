"""A coupling of a stranger."""

import equinox as eqx
import numpy as np

import jaxclear as jc
from jaxclear import Scalar, quantity

TURN = jc.joint.Revolute()


class PlanetMesh(jc.coupling.AbstractCoordinateCoupling):
    """A wheel and a planet, whose turns are seen from one carrier: r (q_wheel - q_carrier) = -s
    q_planet, with the planet's joint on the carrier. A negative radius is that of a ring."""

    wheel: str = eqx.field(static=True)
    carrier: str = eqx.field(static=True)
    planet: str = eqx.field(static=True)
    wheel_radius: Scalar = quantity(unit="m", meaning="pitch radius of the wheel")
    planet_radius: Scalar = quantity(unit="m", meaning="pitch radius of the planet", above=0)

    def terms(self):
        term, radius = jc.coupling.CoordinateTerm, self.wheel_radius
        return (
            term(self.wheel, radius),
            term(self.carrier, -radius),
            term(self.planet, self.planet_radius),
        )

    def total(self):
        return None


def test_a_held_ring_makes_the_carrier_turn_slower():
    sun, planet = 0.03, 0.015
    ring = sun + 2 * planet
    driven = jc.joint.Revolute(jc.drive.ConstantSpeed(9.0))
    rig = jc.Mechanism(
        {"sun": jc.Body(0.2, 1e-4), "ring": jc.Body(0.4, 4e-4)}
        | {"carrier": jc.Body(0.3, 3e-4), "planet": jc.Body(0.1, 2e-5)},
        {
            "S": jc.Connection(driven, "ground", "sun"),
            "R": jc.Connection(jc.joint.Revolute(jc.drive.ConstantPosition(0.0)), "ground", "ring"),
            "C": jc.Connection(TURN, "ground", "carrier"),
            "P": jc.Connection(TURN, jc.Marker("carrier", (0.045, 0.0)), jc.Marker("planet")),
        },
        couplings={
            "inner": PlanetMesh("S", "C", "P", sun, planet),
            "outer": PlanetMesh("R", "C", "P", -ring, planet),
        },
    )
    run = jc.simulate(rig, 1.0, save=3, integrator=jc.integrator.FixedStep(1e-2))
    # Willis: the carrier turns sun / (sun + ring) times as fast; constant speeds, so rounding
    wanted = 9.0 * np.asarray(run.time) * sun / (sun + ring)
    turned = np.asarray(run.coordinate("C"))
    np.testing.assert_allclose(turned - turned[0], wanted, rtol=1e-10, atol=1e-10)
