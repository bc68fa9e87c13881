"""Numbers never compile again: every leaf of a rich mechanism is changed, and the program is traced
once.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.multibody.assembly import assemble_arrays
from jaxclear.simulation.simulate import run
from tests.rigs.full_loop import full_loop


def leaves_of(mechanism):
    flat, _ = jax.tree_util.tree_flatten_with_path(mechanism)
    return [(jax.tree_util.keystr(path), leaf) for path, leaf in flat]


SETTINGS = jc.integrator.Adaptive(rtol=1e-4, atol=1e-6, largest_step=1e-3, max_steps=50)


def counted(integrator):
    """A short run as `simulate` makes it, that refuses to be traced twice."""

    def whole(mechanism, duration, integrator):
        start = assemble_arrays(mechanism)
        return run(
            mechanism, start.coordinates, start.speeds, jnp.linspace(0.0, duration, 3), integrator
        ).states

    return eqx.filter_jit(eqx.debug.assert_max_traces(whole, max_traces=1))


def test_every_number_of_a_mechanism_varies_without_tracing_again():
    go, mechanism = counted(SETTINGS), full_loop()
    leaves, structure = jax.tree.flatten(mechanism)
    names = [name for name, _ in leaves_of(mechanism)]
    assert len(leaves) > 60
    plain = go(mechanism, jnp.asarray(1e-5), SETTINGS)
    assert np.all(np.isfinite(plain))
    for index, name in enumerate(names):
        changed = list(leaves)
        changed[index] = leaves[index] * 1.01 + 1e-6
        assert np.all(
            np.isfinite(go(jax.tree.unflatten(structure, changed), jnp.asarray(1e-5), SETTINGS))
        ), name


@pytest.mark.slow
def test_duration_tolerances_and_steps_vary_without_tracing_again():
    go, mechanism = counted(SETTINGS), full_loop()
    for duration in (1e-5, 2e-5):
        for changes in ({}, {"rtol": 1e-3}, {"atol": 1e-5}, {"largest_step": 2e-3}):
            settings = jc.integrator.Adaptive(
                **({"rtol": 1e-4, "atol": 1e-6, "largest_step": 1e-3, "max_steps": 50} | changes)
            )
            go(mechanism, jnp.asarray(duration), settings)
    go = counted(jc.integrator.FixedStep())
    for step in (1e-6, 2e-6):
        go(mechanism, jnp.asarray(1e-5), jc.integrator.FixedStep(step=step))


def compilations(action):
    """How many programs an action compiles."""
    seen = []
    listener = lambda name, seconds, **_: (
        seen.append(name) if name == "/jax/core/compile/backend_compile_duration" else None
    )
    jax.monitoring.register_event_duration_secs_listener(listener)
    try:
        action()
    finally:
        jax.monitoring.unregister_event_duration_listener(listener)
    return len(seen)


def test_simulate_itself_compiles_once():
    def go(speed, duration, rtol):
        integrator = jc.integrator.Adaptive(rtol=rtol, atol=1e-6, max_steps=50)
        jc.simulate(full_loop(speed), duration, save=3, integrator=integrator, throw=False)

    assert compilations(lambda: go(10.0, 1e-5, 1e-4)) > 0
    assert compilations(lambda: [go(speed, 1e-5, 1e-4) for speed in (11.0, 12.0)]) == 0
    assert compilations(lambda: go(10.0, 2e-5, 1e-3)) == 0


@pytest.mark.slow
def test_a_slot_that_vanishes_does_compile():
    """The counter counts: leaving friction out is another program."""
    go, mechanism = counted(SETTINGS), full_loop()
    go(mechanism, jnp.asarray(1e-5), SETTINGS)
    smooth = eqx.tree_at(lambda m: m.connections["C"].joint.friction, mechanism, None)
    with pytest.raises(RuntimeError, match="traced"):
        go(smooth, jnp.asarray(1e-5), SETTINGS)
