"""Slip that turns round within a step, in contacts whose friction is largest near rest."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators import Check
from jaxclear.simulation.slip_reversals import shortest_crossing, slip_at_peak
from tests.rigs.attacked import run_of


def test_laws_whose_friction_falls_from_a_peak_tell_where():
    """AdamsStep falls from mu_s at v_s to mu_d at v_d by a cubic, halfway in the middle."""
    friction = jc.friction.AdamsStep(
        mu_static=0.2, mu_kinetic=0.1, static_speed=1e-3, kinetic_speed=3e-3
    )
    assert slip_at_peak(friction) == pytest.approx(2e-3, rel=0.13)
    even = jc.friction.AdamsStep(mu_static=0.1, mu_kinetic=0.1)
    assert slip_at_peak(even) is None and slip_at_peak(jc.friction.CoulombTanh()) is None
    assert slip_at_peak(jc.friction.LuGre()) is None and slip_at_peak(None) is None


class Tabulated(eqx.Module):
    """What is asked of a law, by a table of coefficients."""

    coefficients: jax.Array
    set_valued: ClassVar[bool] = False
    bristles: ClassVar[int] = 0

    def steady_coefficient(self, slip_speed):
        return jnp.interp(slip_speed, jnp.array([0.0, 1e-3, 2e-3]), self.coefficients)


def test_a_law_with_arrays_of_its_own_tells_too():
    assert slip_at_peak(Tabulated(jnp.array([0.2, 0.2, 0.1]))) == pytest.approx(1.5e-3, rel=0.13)
    assert slip_at_peak(Tabulated(jnp.array([0.1, 0.2, 0.2]))) is None


def pressed(friction):
    """A journal too heavy to be moved by friction, in a bearing whose ring turns ever slower, at
    rest after 0.01 s, and back."""
    bearing = jc.clearance.PlanarJournalBearing(
        jc.contact.Hertz(stiffness=1e9), friction, bearing_radius=0.01, clearance=1e-4
    )
    turning = jc.joint.Revolute(drive=jc.drive.Speed(lambda t: 1.0 - 100.0 * t))
    return jc.Mechanism(
        {"ring": jc.Body(1.0, 1e-4), "journal": jc.Body(100.0, 10.0)},
        {
            "T": jc.Connection(turning, "ground", "ring"),
            "B": jc.Connection(bearing, "ring", "journal"),
        },
        {"load": jc.load.Force(jc.Marker("journal"), (0.0, -100.0))},
    )


@pytest.mark.slow
def test_slip_that_turns_round_is_as_fast_as_the_parts_are_turned():
    """At a radius of 0.01 m by 100 rad/s^2: slip by 1 m/s^2."""
    friction = jc.friction.Stribeck(mu_static=0.1, mu_kinetic=0.05)
    rig = pressed(friction)
    run = jc.simulate(rig, 0.02, state=jc.seated(rig), save=201)
    assert slip_at_peak(friction) / shortest_crossing(run) == pytest.approx(1.0, rel=0.15)


@pytest.mark.parametrize(
    "integrator",
    [
        jc.integrator.FixedStep(2e-5),
        pytest.param(jc.integrator.ImplicitStep(1.1569e-5, rebound=1), marks=pytest.mark.slow),
        pytest.param(jc.integrator.Adaptive(rtol=1.6e-5, atol=1.6e-7), marks=pytest.mark.slow),
    ],
)
def test_friction_that_would_have_held_between_two_steps_is_said(integrator):
    """A slider-crank's journal sticks for a twentieth of its run. Steps in which its slip passes
    zero wear off 15 % too much, steps a quarter as long do too."""
    run = run_of(14, 53, integrator)
    assert float(run.worn_volume("B", "bearing")[-1]) > 1.1 * 3.866e-16
    worst = run.checks.figures[Check.HALVED_WEAR].worst
    assert float(np.max(worst)) > Check.HALVED_WEAR.limit
