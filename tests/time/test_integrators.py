"""Every integrator on one bounce-and-slide: explicit and implicit adaptive solvers and fixed steps must agree, with the order
that each method promises."""

import diffrax
import numpy as np
import optimistix
import pytest
from falling_journal import touching_journal

import jaxclear as jc

NEWTON = optimistix.Newton(rtol=1e-6, atol=1e-8)


def simulate(integrator):
    return jc.simulate(touching_journal(), 0.05, save=26, integrator=integrator, start_concentric=False)


@pytest.fixture(scope="module")
def reference():
    return simulate(jc.integrator.Adaptive(diffrax.Dopri8(), 1e-11, 1e-13))


@pytest.mark.parametrize(
    "integrator",
    [
        jc.integrator.Adaptive(),
        jc.integrator.Adaptive(diffrax.Kvaerno5(root_finder=NEWTON), 1e-6, 1e-9),
        jc.integrator.FixedStep(2e-6),
        jc.integrator.FixedStep(2e-7, "heun"),
        jc.integrator.FixedStep(steps_per_save=1000),
    ],
    ids=["Tsit5", "Kvaerno5", "rk4", "heun", "steps per save"],
)
def test_integrators_agree(integrator, reference):
    run = simulate(integrator)
    com = [np.asarray(r.body("journal").com) for r in (run, reference)]
    # Each bounce passes on a share of the error of the one before; a thousandth of the clearance is left room.
    np.testing.assert_allclose(*com, atol=1e-6)
    np.testing.assert_allclose(run.worn_volume("B", "bearing")[-1], reference.worn_volume("B", "bearing")[-1], rtol=1e-3)


@pytest.mark.parametrize(("method", "order", "steps"), [("euler", 1, 400), ("heun", 2, 200), ("rk4", 4, 50)])
def test_fixed_steps_converge_with_their_order(method, order, steps):
    """A pendulum's swing: no contact, so nothing but the method makes the error."""
    rig = jc.Mechanism(
        {"rod": jc.Body(1.0, 0.1, (1.0, 0.0))},
        {"pivot": jc.Connection(jc.joint.Revolute(), "ground", "rod")},
        {"gravity": jc.load.Gravity()},
        start={"pivot": 0.3},
    )
    exact = jc.simulate(rig, 1.0, save=2, integrator=jc.integrator.Adaptive(diffrax.Dopri8(), 1e-13, 1e-13)).states[-1, 0]
    errors = [
        abs(float(jc.simulate(rig, 1.0, save=2, integrator=jc.integrator.FixedStep(1.0 / n, method)).states[-1, 0] - exact))
        for n in (steps, 2 * steps)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.15)


def test_steps_too_long_for_a_memory_are_refused_by_name():
    with pytest.raises(ValueError, match='joint "B": its contact law remembers the impact speed with memory_time'):
        jc.simulate(touching_journal(), 0.05, integrator=jc.integrator.FixedStep(1e-3))


def test_a_run_that_ends_early_says_when_and_why():
    few = jc.integrator.Adaptive(most_steps=5)
    with pytest.raises(jc.SimulationError, match=r"ended early, after 0 s\. The allowed number of steps") as caught:
        jc.simulate(touching_journal(), 0.05, save=3, integrator=few)
    assert caught.value.trajectory.states.shape[0] == 3
    assert not jc.simulate(touching_journal(), 0.05, save=3, integrator=few, throw=False).succeeded


def test_saving_times_may_be_given():
    run = jc.simulate(touching_journal(), 0.02, save=[0.005, 0.01])
    np.testing.assert_allclose(run.time, [0.0, 0.005, 0.01, 0.02])


def test_dataset_carries_units_and_names():
    data = jc.simulate(touching_journal(), 0.02, save=5, balance=True).to_dataset()
    assert data["journal.com"].attrs["units"] == "m" and data["B.normal_force"].dims == ("time", "B.contact")
    assert float(abs(data["energy.error"]).max()) < 1e-9 and data.attrs["result"].startswith("The run reached")
