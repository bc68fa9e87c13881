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


def rich(speed=10.0):
    """Clearance, friction with and without memory, wear, every kind of load, a drive, a loop and
    its stabilisation.
    """
    law = jc.contact.CarvalhoMartins(stiffness=1e8, restitution=0.8)
    wear = jc.Wearing(jc.wear.Archard(wear_coefficient=1e-4, hardness=2e9), cells=(12, 1))
    bearing = jc.clearance.PlanarJournalBearing(law, jc.friction.LuGre(), wear=wear)
    marker = jc.Marker("coupler", (0.1, 0.0))
    return jc.Mechanism(
        {name: jc.Body(0.5, 1e-3, (0.1, 0.01)) for name in ("crank", "coupler", "rocker", "blade")},
        {
            "O": jc.Connection(
                jc.joint.Revolute(drive=jc.drive.RampUp(speed, 0.05)), "ground", "crank"
            ),
            "A": jc.Connection(jc.joint.Revolute(), "crank", "coupler", at=(0.1, 0.0)),
            "B": jc.Connection(jc.joint.Revolute(), "coupler", "rocker", at=(0.3, 0.0)),
            "D": jc.Connection(
                jc.joint.Revolute(), "ground", jc.Marker("rocker", (0.25, 0.0)), at=(0.3, 0.0)
            ),
            "C": jc.Connection(bearing, "rocker", jc.Marker("blade", (0.02, 0.0)), at=(0.3, 0.05)),
        },
        {
            "gravity": jc.load.Gravity(),
            "push": jc.load.Force(marker, (1.0, 2.0)),
            "twist": jc.load.Torque(marker, 0.1),
            "spring": jc.load.Spring(jc.Marker("ground", (0.2, 0.4)), marker, 10.0, 0.1, 0.5),
            "hinge": jc.load.JointSpring("A", 1.0, 0.1, 0.01),
            "motor": jc.load.JointTorque("A", 0.02),
        },
        start={"A": -0.5, "D": 0.3},
    )


def leaves_of(mechanism):
    flat, _ = jax.tree_util.tree_flatten_with_path(mechanism)
    return [(jax.tree_util.keystr(path), leaf) for path, leaf in flat]


SETTINGS = jc.integrator.Adaptive(rtol=1e-4, atol=1e-6, largest_step=1e-3, most_steps=50)


def counted(integrator):
    """A short run as `simulate` makes it, that refuses to be traced twice."""

    def whole(mechanism, duration, integrator):
        start = assemble_arrays(mechanism)
        return run(
            mechanism, start.coordinates, start.speeds, jnp.linspace(0.0, duration, 3), integrator
        ).states

    return eqx.filter_jit(eqx.debug.assert_max_traces(whole, max_traces=1))


def test_every_number_of_a_mechanism_varies_without_tracing_again():
    go, mechanism = counted(SETTINGS), rich()
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


def test_duration_tolerances_and_steps_vary_without_tracing_again():
    go, mechanism = counted(SETTINGS), rich()
    for duration in (1e-5, 2e-5):
        for changes in ({}, {"rtol": 1e-3}, {"atol": 1e-5}, {"largest_step": 2e-3}):
            settings = jc.integrator.Adaptive(
                **({"rtol": 1e-4, "atol": 1e-6, "largest_step": 1e-3, "most_steps": 50} | changes)
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
        integrator = jc.integrator.Adaptive(rtol=rtol, atol=1e-6, most_steps=50)
        jc.simulate(rich(speed), duration, save=3, integrator=integrator, throw=False)

    assert compilations(lambda: go(10.0, 1e-5, 1e-4)) > 0
    assert compilations(lambda: [go(speed, 1e-5, 1e-4) for speed in (11.0, 12.0)]) == 0
    assert compilations(lambda: go(10.0, 2e-5, 1e-3)) == 0


def test_a_slot_that_vanishes_does_compile():
    """The counter counts: leaving friction out is another program."""
    go, mechanism = counted(SETTINGS), rich()
    go(mechanism, jnp.asarray(1e-5), SETTINGS)
    smooth = eqx.tree_at(lambda m: m.connections["C"].joint.friction, mechanism, None)
    with pytest.raises(RuntimeError, match="traced"):
        go(smooth, jnp.asarray(1e-5), SETTINGS)
