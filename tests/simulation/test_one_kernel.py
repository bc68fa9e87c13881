"""A run is one kernel, from its start to its last saving time, on every rung; its numbers
are those of a run whose saving intervals are kernels each by itself."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.multibody.assembly import assemble_arrays
from jaxclear.native import kernel, loop
from jaxclear.simulation import loop as simulation
from jaxclear.simulation import wear
from jaxclear.simulation.saving import saving_times
from tests.rigs.cells import slow_but

pytestmark = pytest.mark.usefixtures("optimised_kernels")
RUNGS = {
    "fixed": jc.integrator.FixedStep(2e-5),
    "fixed, semi-implicit": jc.integrator.FixedStep(2e-5, "semi_implicit"),
    "fixed, short steps in contact": jc.integrator.FixedStep(1e-4, contact_steps=5.0),
    "on groups": jc.integrator.FixedStep(2e-5, "munthe_kaas4"),
    "implicit": jc.integrator.ImplicitStep(),
    "Moreau-Jean": jc.integrator.MoreauJean(),
    "non-colliding": jc.integrator.NonColliding(),
    "adaptive": jc.integrator.Adaptive(),
}
# Over some ten impacts rounding grows little.
ROUNDING = 1e-9
QUICK = ("adaptive",)


def told(rung, saves=jc.Saving(7), scene=jc.scenes.slider_crank):
    """States at the saving times, figures and events of a run, and its kernels."""
    integrator, built, build = RUNGS[rung], [], kernel.build
    rig = integrator.formulation.modelled(scene())
    times = saving_times(0.02, saves.at)

    def whole():
        start = assemble_arrays(rig)
        extras = simulation.Extras(events=saves.events)
        run = simulation.run(rig, start.coordinates, start.speeds, times, integrator, extras)
        figures = {check.name: figure.worst for check, figure in run.invariants.figures.items()}
        return run.states, figures, run.noted, run.accepted_steps, run.ended, run.outcome

    def watched(program, *rest):
        built.append(program)
        return build(program, *rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop.kernels, "build", watched)
        found = jax.device_get(jax.jit(whole)())
    return found, [program for program in built if not program.single_turn]


@pytest.mark.parametrize("rung", slow_but(QUICK, RUNGS))
def test_a_run_is_one_kernel_and_keeps_its_numbers(rung, monkeypatch):
    events = 3 if RUNGS[rung].notes_events else 0
    saving = jc.Saving(7, events=events)
    found, kernels = told(rung, saving)
    monkeypatch.setattr(simulation, "_fits_one_kernel", lambda *_: False)
    wanted, by_save = told(rung, saving)
    # One that leaves its rows; before, one without rows for every saving interval. Another goes
    # through the looks, at every saving time here.
    runs, by_save = ([p for p in those if p.length != saving.at] for those in (kernels, by_save))
    assert [bool(program.length) for program in runs] == [True]
    assert by_save and not any(program.length for program in by_save)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        assert one.shape == other.shape
        allowed = ROUNDING * (1e-9 + np.max(np.abs(other), initial=0.0))
        np.testing.assert_allclose(one, other, rtol=ROUNDING, atol=allowed)


@pytest.mark.slow
def test_what_is_saved_twice_as_often_is_saved_the_same():
    """Steps that fit both saving intervals: every second row is the other's, but for the rounding
    of their times, which impacts enlarge."""
    (coarse, *_), _ = told("implicit", jc.Saving(jnp.linspace(0.0, 0.02, 101)))
    (fine, *_), _ = told("implicit", jc.Saving(jnp.linspace(0.0, 0.02, 201)))
    np.testing.assert_allclose(fine[::2], coarse, rtol=1e-6, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("rung", ["fixed", "implicit", "Moreau-Jean", "non-colliding"])
def test_slopes_through_the_one_kernel_are_those_by_saving_interval(rung, monkeypatch):
    integrator = RUNGS[rung]
    rig = integrator.formulation.modelled(jc.scenes.slider_crank())
    times = saving_times(0.005, 7)

    def states(mass):
        other = eqx.tree_at(lambda m: m.bodies["rod"].mass, rig, mass)
        start = assemble_arrays(other)
        at = other, start.coordinates, start.speeds, times, integrator
        return simulation.run(*at, simulation.Extras(discrete=True)).states

    slopes = lambda: jax.jit(jax.jacfwd(states))(jnp.asarray(0.2))
    found = slopes()
    monkeypatch.setattr(simulation, "_fits_one_kernel", lambda *_: False)
    wanted = slopes()
    # From where impacts decide them, derivatives of rigid contact are nan.
    assert np.all(np.isfinite(found[1])) and np.max(np.abs(found[1])) > 0
    assert rung == "Moreau-Jean" or np.all(np.isfinite(found))
    np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=1e-9 * np.nanmax(np.abs(wanted)))


def worn(rung, mass):
    """States and worn depths of a run of seven saving times, for a rod of some mass: surfaces are
    updated six times, which are the saving times."""
    integrator = RUNGS[rung]
    rig = jc.scenes.slider_crank(wear=jc.Wearing(jc.wear.Archard(), updates=6))
    other = integrator.formulation.modelled(eqx.tree_at(lambda m: m.bodies["rod"].mass, rig, mass))
    start = assemble_arrays(other)
    times = saving_times(0.01, 7)
    at = other, start.coordinates, start.speeds, times, integrator
    run = simulation.run(*at, simulation.Extras(discrete=True))
    return run.states, run.worn


@pytest.mark.slow(sample=False)
@pytest.mark.parametrize("rung", ["fixed", "implicit", "Moreau-Jean"])
def test_surfaces_wear_within_the_one_kernel(rung, monkeypatch):
    """Its numbers, their slopes, and both of a batch are those of a run that XLA goes through from
    save to save, with every surface worn at every saving time."""
    built, build = [], kernel.build
    monkeypatch.setattr(
        loop.kernels, "build", lambda program, *rest: built.append(program) or build(program, *rest)
    )

    def told():
        masses = jnp.array([0.2, 0.21, 0.19])
        alone = lambda mass: worn(rung, mass)
        slopes = jax.jit(jax.vmap(jax.jacfwd(lambda m: alone(m[0] + m[1]))))
        pairs = jnp.stack([masses, jnp.zeros(3)], axis=1)
        values = jax.jit(alone)(masses[0]), jax.jit(jax.vmap(alone))(masses)
        # Of rigid contact that wears they are refused.
        return values if rung == "Moreau-Jean" else (*values, slopes(pairs))

    found = told()
    # Turns of six saving intervals; what the last one wears.
    assert {program.length for program in built if program.long} == {6, 1}
    monkeypatch.setattr(simulation, "_fits_one_kernel", lambda *_: False)
    monkeypatch.setattr(simulation, "_as_a_kernel", lambda motion: motion)
    monkeypatch.setattr(simulation, "wear_changed", wear.wear_all)
    wanted = told()
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        assert one.shape == other.shape and np.all(np.isfinite(one))
        allowed = 1e-7 * np.max(np.abs(other), initial=0.0)
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=allowed)
