"""A hanging chain whose links are joined by journal bearings with clearance: any number of
contacts, nothing else.

No link is held by an ideal joint, so each floats in the plane with its three speeds, and the chain
hangs together by contact forces alone. It is let go straight, away from the vertical, journals
concentric; under its own weight all bearings stay loaded, those above more than those below.
"""

import math

import jaxclear as jc

# Links of steel, 10 mm x 20 mm x 100 mm: length [m], mass [kg].
LENGTH, MASS = 0.1, 0.15
CLEARANCE = 0.1e-3
# Angle from the vertical at which the chain is let go [rad].
LEAN = 0.5


def bearing() -> jc.clearance.PlanarJournalBearing:
    """Each joint of the chain: Lankarani-Nikravesh contact between steel, with friction."""
    steel = jc.Material(young_modulus=207e9, poisson_ratio=0.3)
    contact = jc.contact.LankaraniNikravesh(
        stiffness=jc.stiffness.HertzStiffness(steel, steel), restitution=0.9
    )
    friction = jc.friction.ThreeZone(
        mu_static=0.15, mu_kinetic=0.1, static_speed=0.1, kinetic_speed=1.0
    )
    return jc.clearance.PlanarJournalBearing(
        contact, friction, bearing_radius=10e-3, clearance=CLEARANCE
    )


def chain(joints: int) -> jc.Mechanism:
    """`joints` links, the first hanging from the ground: as many clearance joints, three speeds a
    link.
    """
    names = [f"link {i}" for i in range(1, joints + 1)]
    angle = LEAN - math.pi / 2
    link = jc.Body(MASS, MASS * LENGTH**2 / 12, (LENGTH / 2, 0.0))
    ends = [jc.Marker("ground")] + [jc.Marker(name, (LENGTH, 0.0)) for name in names[:-1]]
    return jc.Mechanism(
        bodies=dict.fromkeys(names, link),
        connections={
            f"joint {i}": jc.Connection(bearing(), ends[i - 1], name)
            for i, name in enumerate(names, 1)
        },
        loads={"gravity": jc.load.Gravity((0.0, -9.81))},
        start={
            name: (i * LENGTH * math.cos(angle), i * LENGTH * math.sin(angle), angle)
            for i, name in enumerate(names)
        },
    )
