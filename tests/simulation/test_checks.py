"""A run judges itself: what is wrong is said or ends, what is right is not accused."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators import Outcome
from jaxclear.integrators.checks import Check
from jaxclear.simulation.simulate import run
from tests.rigs.four_bars import four_bar

RPM = 2 * np.pi / 60
TORN = {
    "implicit": (jc.integrator.ImplicitStep(1e-3), 5000),
    "semi-implicit": (jc.integrator.FixedStep(1e-3, "semi_implicit"), 9000),
}


def ideal(rpm, stabilisation=None):
    rig = jc.scenes.slider_crank("ideal", crank_speed=rpm * RPM)
    if stabilisation is None:
        return rig
    parts = (rig.bodies, rig.connections, rig.loads)
    return jc.Mechanism(*parts, guess=rig.guess, stabilisation=stabilisation)


@pytest.mark.parametrize("name", TORN)
def test_a_torn_loop_ends_the_run(name):
    """The loop was open by 40 mm, and by 2.3 km, under "The run reached its end."."""
    integrator, rpm = TORN[name]
    with pytest.raises(jc.SimulationError, match="A loop came open"):
        jc.simulate(ideal(rpm, jc.Baumgarte()), 0.05, save=51, integrator=integrator)


@pytest.mark.slow
def test_a_drifting_loop_carries_a_sentence_and_a_projected_one_none():
    """The loop was open by 7 mm where projection holds it to 2e-8 m."""
    how = {"save": 21, "integrator": jc.integrator.NonColliding(1e-3), "throw": False}
    said = jc.simulate(ideal(2000, jc.Baumgarte()), 0.02, **how).result
    assert "with warnings" in said or "A loop came open" in said
    projected = jc.simulate(ideal(2000), 0.02, **how)
    beyond = {check for check, worst, *_ in projected.invariants.rows() if worst > check.limit}
    assert projected.succeeded and Check.LOOP_DRIFT not in beyond


def test_checks_stand_in_a_table_with_the_joint_and_the_limit():
    found = jc.simulate(ideal(500), 0.002, save=3, integrator=jc.integrator.ImplicitStep())
    assert found.warnings == () and found.result == "The run reached its end."
    table = found.invariants.table()
    drift = table[table.check == "loop drift"].iloc[0]
    assert drift.joint == "B" and drift.within and drift.concerns == "motion"
    # Beside the crank, the shortest part of the loop.
    assert drift.figure == pytest.approx(float(found.drift()["B"].max()) / 0.05, rel=1e-9)
    assert str(found).startswith(found.result)


@pytest.mark.parametrize("rung", [jc.integrator.ImplicitStep, jc.integrator.NonColliding])
def test_a_short_crank_that_comes_off_is_said(rung):
    """The loop of a crank of 50 mm was open by 0.08 mm without a word, judged beside the rod."""
    run = jc.simulate(ideal(2000, jc.Baumgarte()), 0.02, save=21, integrator=rung(2.5e-4))
    opened = float(run.drift()["B"].max())
    assert 0.05 * Check.LOOP_DRIFT.limit < opened < 0.12 * Check.LOOP_DRIFT.limit
    (said,) = run.warnings
    assert said.startswith('The loop closed by joint "B" is open by 0.0016 of its shortest part')


@pytest.mark.slow
def test_a_run_that_grew_without_bound_says_what_was_beyond_its_limit_before():
    """Where it became infinite it said nothing of why."""
    rig = jc.scenes.slider_crank(crank_speed=500 * RPM)
    integrator = jc.integrator.FixedStep(2e-4)
    ended = jc.simulate(rig, 0.05, save=51, integrator=integrator, throw=False)
    (warning,) = ended.warnings
    assert not ended.succeeded and warning.startswith('The indentation in joint "B" reaches')
    infinite = eqx.tree_at(lambda run: run.outcome, ended, jnp.asarray(int(Outcome.NOT_FINITE)))
    assert infinite.result.endswith(f"{Outcome.NOT_FINITE.sentence} {warning}")


@pytest.mark.slow
def test_a_batch_keeps_the_figures_of_every_sample():
    """A torn sample ends by itself."""
    integrator = jc.integrator.ImplicitStep(1e-3)
    start, times = jc.assemble(ideal(1 / RPM)), jnp.linspace(0.0, 0.01, 3)

    def one(speed):
        faster = ideal(speed / RPM, jc.Baumgarte())
        return run(faster, start.coordinates, speed * start.speeds, times, integrator)

    found = jax.vmap(one)(jnp.array([1.0, 500.0]))
    beyond = np.any(list(found.invariants.beyond().values()), axis=0)
    assert beyond.tolist() == [False, True]
    assert found.outcome.tolist() == [0, Outcome.LOOP_OPEN] and found.ended[1] == times[1]
    np.testing.assert_array_equal(found.states[1, 1], found.states[1, 2])


@pytest.mark.parametrize("integrator", [jc.integrator.Adaptive(), jc.integrator.FixedStep(1e-4)])
def test_what_rests_without_loads_gains_no_energy(integrator):
    """Loops that are closed to rounding move by rounding, which is no energy."""
    links = {"crank": 0.05, "rod": 0.12, "rocker": 0.1}
    rig = four_bar(links, 0.13, jc.Body(0.3, 1e-4), start={"O": 0.6})
    run = jc.simulate(rig, 0.1, save=11, integrator=integrator)
    assert run.succeeded and not run.warnings
