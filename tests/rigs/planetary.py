"""A planetary set in the plane: sun, ring and carrier on the ground, one planet on the carrier."""

import jaxclear as jc

SUN, PLANET = 0.03, 0.015
RING = SUN + 2 * PLANET


def planetary(couplings: dict) -> jc.Mechanism:
    """The set under torques at sun and carrier, tied by these couplings; joints S, R, C and P."""
    turn = jc.joint.Revolute()
    held = {"S": "sun", "R": "ring", "C": "carrier"}
    return jc.Mechanism(
        {
            "sun": jc.Body(0.2, 1e-4),
            "ring": jc.Body(0.4, 4e-4),
            "carrier": jc.Body(0.3, 3e-4),
            "planet": jc.Body(0.1, 2e-5),
        },
        {name: jc.Connection(turn, "ground", body) for name, body in held.items()}
        | {
            "P": jc.Connection(turn, jc.Marker("carrier", (SUN + PLANET, 0.0)), jc.Marker("planet"))
        },
        {"m": jc.load.JointTorque("S", 1.0), "l": jc.load.JointTorque("C", -0.5)},
        couplings=couplings,
    )
