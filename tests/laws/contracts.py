"""What every law must satisfy, as functions that raise AssertionError: hand them an instance of
your own law.

`contact_contract(law)`, `friction_contract(law)`, `wear_contract(law)`; the checks one by one are
in CONTACT_CHECKS, SLIP_CHECKS, BRISTLE_CHECKS and WEAR_CHECKS.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from jaxclear.laws.stiffness import fitted
from tests.laws.law_family import assert_finite_derivatives, assert_unit_free, evaluate, grid, shape

# Published dampings are first-order in 1 - e; the coarsest member (Lankarani-Nikravesh) is 0.013
# off at e = 0.9.
RESTITUTION_SLACK = 4e-3

# ---- contact ----


def normal_force(law, indentation, rate, impact_speed):
    return law.normal_force(indentation, rate, impact_speed)


def contact_is_zero_when_open(law):
    assert np.all(
        evaluate(law.normal_force, grid([0, -1e-300, -1e-9, -1e-3, -1], [-10, 0, 10], [0, 0.1]))
        == 0
    )


def contact_never_pulls(law):
    force = evaluate(
        law.normal_force,
        grid(np.logspace(-14, -3, 23), [-1e2, -1, -1e-3, 0, 1e-3, 1, 1e2], [0, 1e-3, 1]),
    )
    assert np.all(np.isfinite(force)) and np.all(force >= 0)
    assert np.all(evaluate(law.normal_force, grid([1e-9, 1e-6, 1e-4], [0, 1e-3], [0.1])) > 0)


def contact_is_continuous_at_touch(law):
    force = evaluate(law.normal_force, grid([1e-18, 1e-6], [-0.1, 0, 0.1], [0.1])).reshape(2, 3)
    assert np.all(force[0] <= 1e-6 * force[1].max())


def contact_has_finite_derivatives(law):
    depths = [0, 1e-300, 1e-100, 1e-14, -1e-6, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3]
    assert_finite_derivatives(normal_force, law, grid(depths, [-0.1, 0, 0.1], [0, 1e-3, 0.1]))


def contact_stiffness_is_the_slope(law):
    depths = jnp.asarray([1e-8, 1e-6, 3e-5])
    step = 1e-5 * depths
    if law.reach is not None:
        # The first asperities press by differences of numbers rounded to 1e-16.
        depths = depths + 0.9 * law.reach
    slope = evaluate(jax.grad(law.elastic_force), depths[:, None])
    above, below = (
        evaluate(law.elastic_force, (depths + sign * step)[:, None]) for sign in (1, -1)
    )
    difference = (above - below) / (2 * step)
    # second differences of step 1e-5 on forces rounded to 1e-16
    np.testing.assert_allclose(slope, difference, rtol=1e-8)
    assert np.all(slope > 0)


def contact_elastic_part_is_the_force_at_rest(law):
    for depth in (-1e-6, 0.0, 1e-9, 1e-5, 1e-3):
        np.testing.assert_allclose(
            law.elastic_force(depth), law.normal_force(depth, 0.0, 0.1), rtol=1e-14
        )


def contact_dissipates_over_a_cycle(law):
    """Closed paths in the indentation, some leaving contact: the work done on the contact is never
    negative."""
    phase = np.linspace(0, 2 * np.pi, 4001)
    for deepest in (1e-7, 1e-5, 2e-4):
        for speed in (1e-3, 0.1, 1.0):
            for depth, slope in (
                (0.5 - 0.5 * np.cos(phase), 0.5 * np.sin(phase)),
                (
                    0.4 + 0.3 * np.sin(phase) + 0.5 * np.sin(3 * phase + 1),
                    0.3 * np.cos(phase) + 1.5 * np.cos(3 * phase + 1),
                ),
            ):
                rows = np.stack([deepest * depth, speed * slope, np.full_like(phase, speed)], 1)
                force = evaluate(law.normal_force, rows)
                work = np.trapezoid(force * slope, phase)
                # trapezoidal sum of a function with corners at touch: relative error of the order
                # of the step squared
                assert work >= -1e-4 * np.trapezoid(force * np.abs(slope), phase), (
                    deepest,
                    speed,
                    work,
                )


def rebound(law, speed=0.1, mass=1.0):
    """Speed ratio after one impact of a free mass, integrated by scipy's DOP853, independently of
    JAX's solvers."""
    force = jax.jit(lambda depth, rate: law.normal_force(depth, rate, jnp.asarray(speed)))

    def right_hand_side(_, state):
        return [state[1], -float(force(state[0], state[1])) / mass]

    def leaves(_, state):
        return state[0]

    leaves.terminal, leaves.direction = True, -1
    path = solve_ivp(
        right_hand_side,
        (0, 10.0),
        [0.0, speed],
        "DOP853",
        first_step=1e-9,
        rtol=1e-8,
        atol=1e-15,
        events=leaves,
    )
    return -path.y_events[0][0][1] / speed


def contact_recovers_restitution(law):
    if law.restitution is None:
        return
    if not eqx.is_array(law.restitution):
        assert law.restitution == 1 and abs(rebound(law) - 1) < 1e-6
        return
    nominal = 0.9
    error = abs(
        rebound(eqx.tree_at(lambda law: law.restitution, law, jnp.asarray(nominal))) - nominal
    )
    assert error <= (1 - nominal) ** 2 + RESTITUTION_SLACK, error
    elastic = eqx.tree_at(lambda law: law.restitution, law, jnp.asarray(1.0))
    np.testing.assert_allclose(
        elastic.normal_force(1e-6, 0.1, 0.1), elastic.elastic_force(1e-6), rtol=1e-12
    )


def contact_is_unit_free(law):
    rows = [(1e-6, 0.05, 0.1), (1e-6, -0.05, 0.1), (2e-8, 0.01, 0.0), (2e-4, -0.02, 0.3)]
    assert_unit_free(law, normal_force, rows, ("m", "m/s", "m/s"), "N")


CONTACT_CHECKS = (
    contact_is_zero_when_open,
    contact_never_pulls,
    contact_is_continuous_at_touch,
    contact_has_finite_derivatives,
    contact_stiffness_is_the_slope,
    contact_elastic_part_is_the_force_at_rest,
    contact_dissipates_over_a_cycle,
    contact_recovers_restitution,
    contact_is_unit_free,
)


def contact_contract(law):
    """Zero when open, never pulls, continuous, differentiable, dissipative, restitution recovered,
    free of units."""
    for check in CONTACT_CHECKS:
        check(fitted(law, shape()))


# ---- friction ----


def largest_coefficient(law):
    return max(
        float(getattr(law, name))
        for name in ("mu_static", "mu_kinetic")
        if getattr(law, name, None) is not None
    )


def speeds_of(law):
    """The law's own transition speeds: where its pieces meet."""
    named = [field.name for field in dataclasses.fields(law) if field.metadata["unit"] == "m/s"]
    return [float(getattr(law, name)) for name in named]


def slip_coefficient(law, slip_speed):
    return law.coefficient(slip_speed)


def slip_is_zero_at_rest(law):
    assert float(law.coefficient(jnp.asarray(0.0))) == 0


def slip_never_gives_energy_and_is_bounded(law):
    speeds = np.concatenate([[0], np.logspace(-14, 2, 400)])
    coefficient = evaluate(law.coefficient, speeds[:, None])
    viscous = getattr(law, "viscous", None)
    bound = largest_coefficient(law) + (0 if viscous is None else float(viscous) * speeds)
    assert np.all(coefficient >= 0) and np.all(coefficient <= bound * (1 + 1e-12))
    assert np.all(coefficient[speeds > 1e-2] > 0)


def slip_is_continuous(law):
    for speed in (*speeds_of(law), 0.0, 1.0):
        near = np.array([speed * (1 - 1e-9), speed, speed * (1 + 1e-9) + 1e-16])
        # twice the largest slope that a piece over its own transition speed can have
        assert np.ptp(evaluate(law.coefficient, near[:, None])) <= 1e-7 * largest_coefficient(
            law
        ), speed


def slip_has_finite_derivatives(law):
    speeds = [0, 1e-300, 1e-14, *speeds_of(law), 1.0, 1e3]
    assert_finite_derivatives(slip_coefficient, law, grid(speeds))


def slip_slope_at_rest_is_finite(law):
    step = 1e-6 * min(speeds_of(law))
    np.testing.assert_allclose(
        float(law.coefficient(jnp.asarray(step))) / step, jax.grad(law.coefficient)(0.0), rtol=1e-4
    )


def slip_is_unit_free(law):
    rows = [(0.3 * speed,) for speed in speeds_of(law)] + [(2.0,)]
    assert_unit_free(law, slip_coefficient, rows, ("m/s",), "1")


SLIP_CHECKS = (
    slip_is_zero_at_rest,
    slip_never_gives_energy_and_is_bounded,
    slip_is_continuous,
    slip_has_finite_derivatives,
    slip_slope_at_rest_is_finite,
    slip_is_unit_free,
)


def bristle_force(law, deflection, slip):
    return law.coefficient(deflection, law.deflection_rate(deflection, slip, jnp.abs(slip)), slip)


def slide(law, slip, step):
    """Deflection and coefficient at the start of each Runge-Kutta step under a prescribed slip
    (sampled at half steps), from rest."""

    def rate(deflection, slip):
        return law.deflection_rate(deflection, slip, jnp.abs(slip))

    def advance(z, slips):
        first, middle, last = slips
        k1 = rate(z, first)
        k2 = rate(z + step / 2 * k1, middle)
        k3 = rate(z + step / 2 * k2, middle)
        k4 = rate(z + step * k3, last)
        return z + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4), (z, bristle_force(law, z, first))

    return map(np.asarray, jax.lax.scan(advance, 0.0, (slip[:-2:2], slip[1:-1:2], slip[2::2]))[1])


def bristle_is_zero_at_rest(law):
    assert float(bristle_force(law, jnp.asarray(0.0), jnp.asarray(0.0))) == 0


def to_and_fro(amplitude):
    """A slip [m/s] of four random waves, and a step [s] in which it goes a tenth of the yield
    deflection."""
    rng = np.random.default_rng(0)
    time = np.arange(8001) / 2
    waves = [
        rng.normal() * np.sin(rng.uniform(1e-3, 3e-2) * time + rng.uniform(0, 6)) for _ in range(4)
    ]
    return amplitude * sum(waves), 1e-7 / amplitude


def bristle_never_gives_energy_and_its_springs_are_bounded(law):
    for amplitude in (1e-4, 1e-2, 1.0):
        slip, step = to_and_fro(amplitude)
        deflection, coefficient = slide(law, jnp.asarray(slip), step)
        work = np.cumsum(coefficient * slip[:-2:2])
        # quadrature and Runge-Kutta error of steps of a tenth of the yield deflection
        assert np.all(work >= -1e-3 * np.abs(coefficient * slip[:-2:2]).sum())
        springs = evaluate(lambda z: law.coefficient(z, 0.0, 0.0), deflection[:, None])
        assert np.all(np.abs(springs) <= largest_coefficient(law) * (1 + 1e-6))


def bristle_is_bounded_while_slip_turns_round_slowly(law):
    """In faster motion the bristles' own damping adds to it for a moment."""
    viscous = getattr(law, "viscous", None)
    for amplitude in (1e-4, 1e-2):
        slip, step = to_and_fro(amplitude)
        _, coefficient = slide(law, jnp.asarray(slip), step)
        dragged = 0 if viscous is None else float(viscous) * np.abs(slip).max()
        assert np.all(np.abs(coefficient) <= largest_coefficient(law) * (1 + 1e-6) + dragged)


def bristle_opposes_steady_sliding(law):
    for speed in (-1.0, -1e-3, 1e-3, 1.0):
        _, coefficient = slide(law, jnp.full(4001, speed), 1e-7 / abs(speed))
        final = coefficient[-1]
        viscous = getattr(law, "viscous", None)
        assert final * speed > 0
        assert abs(final) <= largest_coefficient(law) * (1 + 1e-6) + (
            0 if viscous is None else float(viscous) * abs(speed)
        )


def bristle_has_finite_derivatives(law):
    def rate(law, deflection, slip, slip_speed):
        return law.deflection_rate(deflection, slip, slip_speed)

    def coefficient(law, deflection, deflection_rate, slip):
        return law.coefficient(deflection, deflection_rate, slip)

    assert_finite_derivatives(rate, law, grid([0, 1e-6, -1e-9], [-1, 0, 1e-9, 1], [0, 1, 10]))
    assert_finite_derivatives(
        coefficient, law, grid([0, 1e-6, -1e-9], [-1, 0, 1], [-10, 0, 1e-9, 1])
    )


def bristle_is_unit_free(law):
    rows = [(2e-7, 1e-3), (-5e-7, 0.1)]
    assert_unit_free(law, bristle_force, rows, ("m", "m/s"), "1")


BRISTLE_CHECKS = (
    bristle_is_zero_at_rest,
    bristle_never_gives_energy_and_its_springs_are_bounded,
    bristle_is_bounded_while_slip_turns_round_slowly,
    bristle_opposes_steady_sliding,
    bristle_has_finite_derivatives,
    bristle_is_unit_free,
)


def friction_contract(law):
    """Zero at rest, opposing, bounded, continuous, differentiable, free of units; a set-valued law
    only declares itself."""
    if law.set_valued:
        assert law.coulomb() is law and largest_coefficient(law) >= 0
        return
    for check in BRISTLE_CHECKS if law.bristles else SLIP_CHECKS:
        check(law)


# ---- wear ----


def volume_rate(law, normal_force, slip_speed, traction):
    return law.volume_rate(normal_force, slip_speed, traction)


def wear_needs_load_and_sliding(law):
    assert np.all(
        evaluate(law.volume_rate, [[0.0, 1.0, 0.0], [100.0, 0.0, 10.0], [0.0, 0.0, 0.0]]) == 0
    )
    assert float(law.volume_rate(100.0, 0.1, 10.0)) > 0


def wear_never_heals_and_grows_with_its_causes(law):
    rows = grid([0, 1, 1e5], [0, 1e-9, 10], [0, 1e-3, 1e5])
    rate = evaluate(law.volume_rate, rows)
    assert np.all(rate >= 0)
    assert np.all(evaluate(law.volume_rate, 2 * rows) >= rate)


def wear_has_finite_derivatives(law):
    assert_finite_derivatives(volume_rate, law, grid([0, 1, 1e6], [0, 1e-12, 10], [0, 1, 1e6]))


def wear_is_unit_free(law):
    assert_unit_free(law, volume_rate, [(100.0, 0.1, 12.0)], ("N", "m/s", "N"), "m^3/s")


WEAR_CHECKS = (
    wear_needs_load_and_sliding,
    wear_never_heals_and_grows_with_its_causes,
    wear_has_finite_derivatives,
    wear_is_unit_free,
)


def wear_contract(law):
    """No load or no sliding, no wear; never negative, growing with load and speed, differentiable,
    free of units."""
    for check in WEAR_CHECKS:
        check(law)
