"""Steps under error control in a loop of our own are those of `diffrax.diffeqsolve`."""

import diffrax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators import error_control
from jaxclear.integrators.error_control import stepped_by_hand
from tests.rigs.falling_journal import touching_journal


class Tsit5ByDiffrax(diffrax.Tsit5):
    """A step of its own: diffrax's loop runs it."""

    def step(self, *arguments):
        return super().step(*arguments)


class HeunByDiffrax(diffrax.Heun):
    """A step of its own: diffrax's loop runs it."""

    def step(self, *arguments):
        return super().step(*arguments)


def simulate(solver, rig):
    integrator = jc.integrator.Adaptive(solver, rtol=1e-6, atol=1e-8)
    return jc.simulate(rig, 0.02, save=6, integrator=integrator, state=jc.State(concentric=False))


@pytest.fixture(scope="module")
def rig():
    return touching_journal()


@pytest.mark.parametrize("few", [0, 10_000], ids=["stages in turn", "written out"])
@pytest.mark.parametrize(
    ("method", "other"),
    [(diffrax.Tsit5, Tsit5ByDiffrax()), (diffrax.Heun, HeunByDiffrax())],
    ids=["last stage is the next one's first", "not so"],
)
def test_own_loop_takes_the_steps_of_diffrax(method, other, few, rig, monkeypatch):
    # Of a class by itself: a program that was compiled for the other kind is not its.
    own = type("Own", (method,), {})()
    monkeypatch.setattr(error_control, "FEW_EQUATIONS", few)
    assert stepped_by_hand(own, 300).written_out == (few > 300)
    assert stepped_by_hand(other, 300) is None
    ours, theirs = simulate(own, rig), simulate(other, rig)
    assert ours.accepted_steps == theirs.accepted_steps > 40
    assert abs(int(ours.rejected_steps) - int(theirs.rejected_steps)) <= 1
    np.testing.assert_allclose(ours.states, theirs.states, rtol=1e-7, atol=1e-9)


def decay(rate, solver, span=(0.0, 1.0, 0.1), most=1000, **controls):
    """y' = rate y from 1."""
    controller = diffrax.PIDController(**({"rtol": 1e-8, "atol": 1e-10} | controls))
    term = diffrax.ODETerm(lambda t, y, args: rate(t) * y)
    return error_control.solve(
        term, stepped_by_hand(solver), controller, span, jnp.ones(1), None, most
    )


@pytest.mark.parametrize(
    "solver", [diffrax.Bosh3(), diffrax.Tsit5(), diffrax.Dopri5(), diffrax.Dopri8()]
)
def test_own_loop_meets_the_closed_form(solver):
    found = decay(lambda t: -2.0 * t, solver)
    assert found.time == 1.0 and not found.too_small
    np.testing.assert_allclose(found.state, np.exp(-1.0), rtol=3e-8)


def test_own_loop_says_where_it_ended_early():
    found = decay(lambda t: -2.0 * t, diffrax.Tsit5(), most=3)
    assert found.time < 1 and found.accepted + found.rejected == 3 and not found.too_small
    pole = decay(
        lambda t: 1 / (0.5 - t), diffrax.Tsit5(), dtmin=1e-6, force_dtmin=False, most=100_000
    )
    assert pole.too_small and pole.time < 0.51


def test_implicit_solvers_are_for_diffrax():
    assert stepped_by_hand(diffrax.Kvaerno5()) is None
