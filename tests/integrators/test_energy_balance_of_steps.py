"""The energy balance of explicit steps: what a run says it stored and lost, it did."""

import numpy as np
import pytest

import jaxclear as jc


def balance(step):
    integrator = jc.integrator.FixedStep(step, "semi_implicit")
    rig = jc.scenes.slider_crank()
    return jc.simulate(rig, 0.05, save=11, integrator=integrator, balance=True).energy_balance()


@pytest.fixture(scope="module")
def balances():
    return {step: balance(step) for step in (2e-5, 1e-5)}


def test_balance_of_semi_implicit_steps_closes_at_their_order(balances):
    """It was open by 0.0096 J of 0.58 J at 1e-5 s, all of it said to be stored in the contact."""
    errors = {step: float(np.abs(found.error).max()) for step, found in balances.items()}
    start = float(balances[1e-5].kinetic[0])
    assert errors[1e-5] < 1e-3 * start
    assert errors[2e-5] / errors[1e-5] == pytest.approx(2.0, abs=0.4)


def test_an_open_contact_stores_nothing(balances):
    """Spring energy is back when the journal has left its bearing."""
    for step, found in balances.items():
        assert float(np.abs(found.contact_stored).max()) < 1e-3 * float(found.kinetic[0]), step
