"""A motion at rest lets steps grow beyond what a stiff spring lets stand; its derivative, which is
at rest nowhere, is right or no number."""

import jax
import numpy as np
import pytest
from scipy.linalg import expm

import jaxclear as jc

LOAD = 10.0
DAMPING = 20.0


def derivative(stiffness, away, **settings):
    """Of the place of a mass of 1 kg on a spring [m] after a second, by the load on it [N], where
    it begins so far away [m] from its rest."""

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
        run = jc.simulate(rig, 1.0, save=3, integrator=jc.integrator.Adaptive(**settings))
        return run.coordinate("G")[-1].reshape(())

    return float(jax.jvp(place, (LOAD,), (1.0,))[1])


def closed_form(stiffness):
    motion = expm(np.array([[0.0, 1.0], [-stiffness, -DAMPING]]))
    return (1.0 - motion[0, 0]) / stiffness


@pytest.mark.parametrize("stiffness", [1e4, 1e6])
def test_at_rest_it_is_no_number(stiffness):
    assert np.isnan(derivative(stiffness, 0.0))


def test_it_is_none_on_a_group_of_rotations_either():
    assert np.isnan(derivative(1e4, 0.0, solver=jc.integrator.MuntheKaas(4)))


@pytest.mark.parametrize("stiffness", [1e4, 1e6])
def test_where_steps_resolve_it_it_is_right(stiffness):
    wanted = closed_form(stiffness)
    assert derivative(stiffness, 1e-6) == pytest.approx(wanted, rel=1e-3)
    short = 0.2 / np.sqrt(stiffness)
    assert derivative(stiffness, 0.0, largest_step=short) == pytest.approx(wanted, rel=1e-3)
