"""A planetary set in the plane: sun, ring and carrier on the ground, one planet on the carrier."""

import numpy as np

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


def planetary_accelerations() -> np.ndarray:
    """Of sun and carrier [rad/s^2] in closed form, by the kinetic energy of the two freedoms."""

    def energy(s, c):
        p = -SUN / PLANET * (s - c)
        b = c + PLANET / RING * p
        turned = 1e-4 * s**2 + 4e-4 * b**2 + 3e-4 * c**2
        return 0.5 * (turned + 0.1 * (SUN + PLANET) ** 2 * c**2 + 2e-5 * (c + p) ** 2)

    mixed = energy(1, 1) - energy(1, 0) - energy(0, 1)
    matrix = np.array([[2 * energy(1, 0), mixed], [mixed, 2 * energy(0, 1)]])
    return np.linalg.solve(matrix, [1.0, -0.5])
