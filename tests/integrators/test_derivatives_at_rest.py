"""A motion at rest lets steps grow beyond what a stiff spring lets stand; its derivative, which is
at rest nowhere, has an error control of its own, and is right or no number."""

import functools

import jax
import numpy as np
import pytest
from scipy.linalg import expm

import jaxclear as jc
from tests.rigs.cells import slow_but

LOAD = 10.0
DAMPING = 20.0


def derivative(stiffness, away, integrator=None, end=1.0, **settings):
    """Of the place of a mass of 1 kg on a spring [m] at the end, by the load on it [N], where
    it begins so far away [m] from its rest."""
    integrator = integrator or jc.integrator.Adaptive(**settings)

    def place(load):
        rig = jc.Mechanism(
            {"mass": jc.Body(1.0, 1e-3)},
            {"G": jc.Connection(jc.joint.Prismatic(), "ground", "mass", axis="x")},
            {
                "spring": jc.load.JointSpring("G", stiffness=stiffness, damping=DAMPING),
                "load": jc.load.Force(jc.Marker("mass"), (load, 0.0)),
            },
            start={"G": LOAD / stiffness + away},
        )
        run = jc.simulate(rig, end, save=3, integrator=integrator)
        return run.coordinate("G")[-1]

    return float(jax.jvp(place, (LOAD,), (1.0,))[1])


def closed_form(stiffness, end=1.0):
    motion = expm(end * np.array([[0.0, 1.0], [-stiffness, -DAMPING]]))
    return (1.0 - motion[0, 0]) / stiffness


@pytest.mark.slow
def test_at_rest_it_is_no_number_where_the_motion_alone_controls_steps():
    found = derivative(1e4, 0.0, solver=jc.integrator.MuntheKaas(4))
    assert jc.explain_nan(found).startswith("In steps of another length")


@pytest.mark.parametrize("stiffness", [1e4, 1e6])
def test_it_is_right_at_rest_and_beside_it(stiffness):
    """By the steps of the motion alone it grew from 1e-5 to 1e57."""
    wanted = closed_form(stiffness)
    for away in (0.0, 1e-6):
        assert derivative(stiffness, away) == pytest.approx(wanted, rel=1e-3)
    short = 0.2 / np.sqrt(stiffness)
    assert derivative(stiffness, 0.0, largest_step=short) == pytest.approx(wanted, rel=1e-3)


RUNGS = {
    "rk4": jc.integrator.FixedStep,
    "semi-implicit": functools.partial(jc.integrator.FixedStep, method="semi_implicit"),
    "heun": functools.partial(jc.integrator.FixedStep, method="heun"),
    "group": functools.partial(jc.integrator.FixedStep, method="munthe_kaas4"),
    "short in contact": functools.partial(jc.integrator.FixedStep, contact_steps=4),
    "implicit": jc.integrator.ImplicitStep,
    "rigid": jc.integrator.MoreauJean,
    "permanent": jc.integrator.NonColliding,
}
FAST = "rk4", "rigid"
EACH = slow_but(FAST, RUNGS)


@pytest.mark.parametrize("name", EACH)
def test_of_steps_too_long_for_a_spring_it_is_no_number(name):
    """The mass stays where it is, exactly: beyond the limit of their stability (2.83 / omega by
    rk4, 2 / omega in the middle) derivatives grew from 1 to 1e7 and 1e88 in 100 steps."""
    step, omega = 1e-3, 300.0
    wanted = closed_form(omega**2, 0.1)
    short = derivative(omega**2, 0.0, RUNGS[name](0.005 / omega), 0.1)
    assert short == pytest.approx(wanted, rel=1e-2)
    for angle in (2.9, 4.0):
        found = derivative((angle / step) ** 2, 0.0, RUNGS[name](step), 0.1)
        assert jc.explain_nan(found).startswith("In steps of another length")


def resting(angle, steps):
    """(by which share of its indentation a journal that rests on its bearing moves, the derivative
    of the indentation by the load, times the stiffness), after so many steps in each of which its
    contact vibrates by this angle [rad]."""
    step = 1e-4
    stiffness = (angle / step) ** 2

    def depth(load):
        law = jc.contact.KelvinVoigt(stiffness=stiffness, damping=0.0)
        bearing = jc.clearance.PlanarJournalBearing(law, clearance=1e-3)
        rig = jc.Mechanism(
            {"journal": jc.Body(1.0, 1e-4)},
            {"B": jc.Connection(bearing, "ground", "journal")},
            {"load": jc.load.Force(jc.Marker("journal"), (0.0, -load))},
            start={"journal": (0.0, -1e-3 - LOAD / stiffness, 0.0)},
        )
        how = {"integrator": jc.integrator.FixedStep(step), "state": jc.State(concentric=False)}
        run = jc.simulate(rig, steps * step, save=2, throw=False, **how)
        return -1e-3 - run.body("journal").com[-1, 1]

    place, slope = jax.jvp(depth, (LOAD,), (1.0,))
    return float(place) * stiffness / LOAD - 1.0, float(slope) * stiffness


@pytest.mark.slow
def test_of_steps_too_long_for_a_contact_it_is_no_number():
    """A journal that rests without damping has 1 - cos(omega t)."""
    assert resting(0.2, 100)[1] == pytest.approx(1 - np.cos(20.0), rel=1e-3)
    moved, slope = resting(2.9, 100)
    assert abs(moved) < 1e-3 and np.isnan(slope)
