"""Steps under error control in a loop of our own are those of `diffrax.diffeqsolve`; deflections of
bristles are held to the tolerance as places are.
"""

import diffrax
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from benchmarks.attacks.structures import structures
from jaxclear.integrators import error_control
from jaxclear.integrators.error_control import stepped_by_hand
from tests.rigs.attacked import run_of
from tests.rigs.falling_journal import touching_journal


class Tsit5ByDiffrax(diffrax.Tsit5):
    """A step of its own: diffrax's loop runs it."""

    def step(self, *arguments):
        return super().step(*arguments)


def simulate(solver):
    integrator = jc.integrator.Adaptive(solver, rtol=1e-9, atol=1e-11)
    return jc.simulate(
        touching_journal(), 0.02, save=6, integrator=integrator, state=jc.State(concentric=False)
    )


@pytest.fixture(scope="module")
def by_diffrax():
    return simulate(Tsit5ByDiffrax())


@pytest.mark.parametrize("few", [0, 10_000], ids=["stages in turn", "written out"])
def test_runs_are_those_of_the_loop_of_diffrax(few, by_diffrax, monkeypatch):
    monkeypatch.setattr(error_control, "FEW_EQUATIONS", few)
    # Of a class by itself: a program that was compiled for the other kind is not its.
    own = type("Own", (diffrax.Tsit5,), {})()
    assert stepped_by_hand(own, 300).written_out == (few > 300)
    assert stepped_by_hand(Tsit5ByDiffrax(), 300) is None
    run = simulate(own)
    np.testing.assert_allclose(run.states, by_diffrax.states, rtol=1e-6, atol=1e-8)
    # What an interval hands on to the next differs, no more.
    assert 0.8 < run.accepted_steps / by_diffrax.accepted_steps < 1.1


def van_der_pol(t, y, args):
    return jnp.stack([y[1], 20.0 * (1 - y[0] ** 2) * y[1] - y[0]])


@pytest.mark.parametrize("equations", [0, 10_000], ids=["written out", "stages in turn"])
@pytest.mark.parametrize("method", [diffrax.Bosh3, diffrax.Tsit5, diffrax.Heun])
def test_own_loop_takes_the_steps_of_diffrax(method, equations):
    controller = diffrax.PIDController(rtol=1e-5, atol=1e-7, dtmax=1.0)
    term, first = diffrax.ODETerm(van_der_pol), jnp.array([2.0, 0.0])
    wanted = diffrax.diffeqsolve(
        term, method(), 0.0, 20.0, 0.01, first, stepsize_controller=controller, max_steps=None
    )
    solver = stepped_by_hand(method(), equations)
    found = error_control.solve(term, solver, controller, (0.0, 20.0, 0.01), first, None, 10**6)
    assert found.accepted == wanted.stats["num_accepted_steps"] > 100
    assert found.rejected == wanted.stats["num_rejected_steps"]
    np.testing.assert_allclose(found.state, wanted.ys[-1], rtol=1e-6)


def test_a_step_that_the_end_of_an_interval_has_cut_is_handed_on_as_long_as_it_might_be():
    found = decay(lambda t: -1.0, diffrax.Tsit5(), (0.0, 0.1001, 0.1))
    assert found.accepted == 2 and found.wish >= 0.1
    run = jc.simulate(jc.scenes.slider_crank("ideal"), 0.05, save=501)
    assert run.accepted_steps <= 505


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


class Begun(diffrax.Tsit5):
    """What it keeps between steps is its own."""

    def init(self, *arguments):
        return super().init(*arguments)


@pytest.mark.parametrize("solver", [diffrax.Kvaerno5(), diffrax.KenCarp4(), Begun()])
def test_solvers_that_a_tableau_does_not_tell_are_for_diffrax(solver):
    assert stepped_by_hand(solver) is None


TIGHT = jc.integrator.Adaptive(rtol=1e-10, atol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("presliding", [9e-6, 1e-7])
def test_wear_of_bristles_that_swing_is_right_at_the_default_tolerance(presliding):
    """A journal hops and creeps on bristles whose force changes its sign: Fouvry's wear takes the
    size of its power, so that it tells what they are off by. A run of few steps between its saving
    times, 2 % off where a tolerance a hundred times looser held the bristles."""
    case = structures()[9].case(1)
    yields = lambda rig: rig.connections["B"].joint.friction.presliding
    rig = eqx.tree_at(yields, case.mechanism, jnp.asarray(presliding))
    found, wanted = (
        jc.simulate(rig, case.duration, save=201, integrator=integrator)
        for integrator in (jc.integrator.Adaptive(), TIGHT)
    )
    volumes = [float(jc.response.WornVolume("B")(run)) for run in (found, wanted)]
    np.testing.assert_allclose(volumes[0], volumes[1], rtol=4e-3)


@pytest.mark.parametrize("draw", [27, 30])
def test_bristles_that_settle_within_little_are_held_to_a_share_of_that(draw):
    """A journal rests under a torque that its friction holds: its bristles, which settle within
    0.15 and 0.23 um, are bent by a hundredth of that, and what their swinging wears was 4 and 2.4 %
    off where an error in them counted as one in a place. Structure 5 of the attack."""
    volume = jc.response.WornVolume("B")
    found, wanted = (float(volume(run_of(5, draw, each))) for each in (None, TIGHT))
    np.testing.assert_allclose(found, wanted, rtol=4e-3)
