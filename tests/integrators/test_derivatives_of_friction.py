"""Derivatives through the instants at which friction comes to hold, breaks away, or takes another
share of what a transmission passes. Its force is continuous there, only the rate of its bristle
jumps, which its bound puts right: beside a closed form, and beside differences of tight runs.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.cells import slow_but

# A slide comes to rest, is held under a ramp that begins then, and breaks away.
MASS, FRICTION, SPEED, RAMP, BEGIN, END = 1.0, 2.0, 0.2, 10.0, 0.15, 0.5
# By steps, what a slope may be off: rigid ones take the instants of rest late by up to a step.
STEPS = {
    "adaptive": (jc.integrator.Adaptive(), 3e-4),
    "rk4": (jc.integrator.FixedStep(2e-5), 5e-4),
    "semi-implicit": (jc.integrator.FixedStep(2e-5, "semi_implicit"), 2e-3),
    "implicit": (jc.integrator.ImplicitStep(1e-4), 3e-4),
    "rigid": (jc.integrator.MoreauJean(1e-4), 4e-3),
    "permanent": (jc.integrator.NonColliding(1e-4), 4e-3),
}


@pytest.mark.parametrize("kind", slow_but(["adaptive"], STEPS))
def test_friction_that_holds_and_breaks_away_has_the_derivatives_of_its_closed_form(kind):
    """q = m v^2 / 2 T + k (t - t_T)^3 / 6 m, the ramp being as large as T at t_T."""
    integrator, within = STEPS[kind]

    def place(numbers):
        mass, friction, speed, ramp = numbers
        rig = jc.Mechanism(
            {"slide": jc.Body(mass, 1e-3)},
            {"G": jc.Connection(jc.joint.Prismatic(), "ground", "slide", axis="x")},
            {
                "dry": jc.load.JointFriction("G", friction),
                "ramp": jc.load.JointTorque("G", lambda t: ramp * jnp.maximum(t - BEGIN, 0.0)),
            },
            speeds={"G": speed},
        )
        how = {"integrator": integrator, "throw": False, "verify": False}
        return jc.simulate(rig, END, save=6, **how).coordinate("G")[-1]

    def exact(numbers):
        mass, friction, speed, ramp = numbers
        since = END - BEGIN - friction / ramp
        return mass * speed**2 / (2 * friction) + ramp * since**3 / (6 * mass)

    numbers = jnp.array([MASS, FRICTION, SPEED, RAMP])
    slopes = jax.jit(jax.jacfwd(place))(numbers)
    np.testing.assert_allclose(slopes, jax.grad(exact)(numbers), rtol=within)


# A motor drives a load forwards and back; by its losses the gear lets the load drive, or locks.
GEARS = {"reverses": (0.8, 0.6, 0.2), "locks itself": (0.45, -0.2, 0.3)}
SHARES = (1e-3, 5e-4)


def turned(numbers, integrator):
    forwards, backwards, torque = numbers
    gear = jc.coupling.Gear(
        jc.coupling.Motor(1e-4),
        "A",
        20.0,
        stiffness=400.0,
        damping=2.0,
        efficiency=jc.coupling.Efficiency(forwards, backwards),
    )
    rig = jc.Mechanism(
        {"arm": jc.Body(1.0, 0.05)},
        {"A": jc.Connection(jc.joint.Revolute(), "ground", "arm")},
        {
            "drive": jc.load.JointTorque("gear.motor", lambda t: torque * jnp.cos(6.0 * t)),
            "load": jc.load.JointTorque("A", -1.0),
        },
        couplings={"gear": gear},
    )
    how = {"integrator": integrator, "throw": False, "verify": False}
    return jc.simulate(rig, 1.0, save=6, **how).coordinate("A")[-1]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["adaptive", "rk4", "implicit"])
@pytest.mark.parametrize("gear", GEARS)
def test_a_gear_whose_load_turns_round_has_the_derivatives_of_its_motion_or_none(gear, kind):
    numbers, tight = jnp.array(GEARS[gear]), jc.integrator.Adaptive(rtol=1e-11, atol=1e-13)
    value = jax.jit(lambda numbers: turned(numbers, tight))

    def difference(share):
        ends = [
            [value(numbers + sign * share * numbers * axis) for axis in np.eye(3)]
            for sign in (1, -1)
        ]
        return np.subtract(*ends) / (2 * share * numbers)

    rough, exact = map(difference, SHARES)
    np.testing.assert_allclose(rough, exact, rtol=1e-3)
    slopes = jax.jit(jax.jacfwd(lambda numbers: turned(numbers, STEPS[kind][0])))(numbers)
    known = ~np.isnan(slopes)
    np.testing.assert_allclose(slopes[known], exact[known], rtol=5e-3)
    assert known.all() or (kind == "implicit" and jc.explain_nan(slopes).startswith("In steps"))
