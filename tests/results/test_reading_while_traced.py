"""What is read from a run inside a derivative or `jax.vmap`: numbers that follow it, texts of the
run itself, or a sentence of ours, never an error of JAX's about tracers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.ground.outcome import explain_nan

LAW = jc.contact.CarvalhoMartins(stiffness=1e8, restitution=0.8)


def rig(speed):
    """A slider-crank with a loose pin, whose crank drives a wheel behind play."""
    turn = jc.joint.Revolute
    loose = jc.clearance.PlanarJournalBearing(LAW, bearing_radius=10e-3, clearance=0.2e-3)
    bodies = {
        "crank": jc.Body(0.3, 1e-4, (0.02, 0.0)),
        "rod": jc.Body(0.2, 2e-4, (0.06, 0.0)),
        "slider": jc.Body(0.3, 1e-4),
        "wheel": jc.Body(0.5, 1e-3),
    }
    connections = {
        "O": jc.Connection(turn(), "ground", "crank"),
        "A": jc.Connection(turn(), "crank", "rod", at=(0.05, 0.0)),
        "B": jc.Connection(loose, "rod", "slider", at=(0.12, 0.0)),
        "G": jc.Connection(
            jc.joint.Prismatic(), jc.Marker("ground", axis="x"), jc.Marker("slider", axis="x")
        ),
        "W": jc.Connection(turn(), jc.Marker("ground", (0.0, 0.1)), jc.Marker("wheel")),
    }
    mesh = jc.coupling.Gear("O", "W", 2.0, play=1e-3, stiffness=1e4, damping=1.0)
    return jc.Mechanism(
        bodies,
        connections,
        {"brake": jc.load.JointSpring("W", damping=0.1)},
        couplings={"mesh": mesh},
        speeds={"O": speed},
        guess={"G": 0.17},
    )


def run(speed):
    saving = jc.Saving(4, events=2)
    return jc.simulate(rig(speed), 2e-3, save=saving, balance=True, throw=False)


READ = {
    "body": lambda run: [run.body("rod").com, run.body("rod").spin, run.body("rod").acceleration],
    "quaternion": lambda run: run.body("rod").quaternion,
    "marker": lambda run: [
        getattr(run.marker("rod", (0.1, 0.0)), part) for part in ("velocity", "specific_force")
    ],
    "contact": lambda run: run.contact("B").normal_force,
    "contact table": lambda run: run.contact("B").table(),
    "impulse": lambda run: run.contact_impulse("B"),
    "modes": lambda run: run.modes("B"),
    "combined modes": lambda run: run.combined_modes(),
    "events": lambda run: run.events(),
    "switchings": lambda run: run.switchings("mesh"),
    "reaction": lambda run: [run.reaction("G").force, run.reaction("A").torque],
    "transmitted": lambda run: run.transmitted("mesh"),
    "coupling": lambda run: [run.coupling("mesh").twist, run.coupling("mesh").loss],
    "coordinates": lambda run: [run.coordinate("O"), run.speed("G")],
    "drift": lambda run: run.drift(),
    "energies": lambda run: run.energy_balance().kinetic,
    "data": lambda run: run.to_dataset(),
    "state": lambda run: run.state(),
    "estimate": lambda run: run.estimate(lambda own: own.coordinate("O")[-1]).value,
    "peak": jc.response.PeakContactForce("B"),
    "mean": jc.response.MeanContactForce("B"),
    "result": lambda run: run.result,
    "warnings": lambda run: run.warnings,
    "print": str,
    "print of parts": lambda run: [
        str(part)
        for part in (run.stats, run.extremes, run.invariants, run.verification, run.body("rod"))
    ],
    "checks": lambda run: run.invariants.table(),
    "vtk": lambda run: run.to_vtk("/nowhere"),
}
WITHIN = {
    "jvp": lambda function: jax.eval_shape(lambda x: jax.jvp(function, (x,), (1.0,))[0], 5.0),
    "vmap": lambda function: jax.eval_shape(jax.vmap(function), jnp.array([5.0, 6.0])),
}


ARRAYS = {
    *("body", "quaternion", "marker", "contact", "impulse", "reaction", "transmitted", "coupling"),
    *("coordinates", "energies", "state", "estimate", "peak", "mean"),
}
TEXTS = {"result", "warnings", "print", "print of parts", "checks", "drift"}


@pytest.mark.parametrize("within", WITHIN)
def test_what_is_read_of_a_run_that_is_traced_is_a_number_or_a_sentence(within):
    refused = {}

    def everything(speed):
        own, numbers = run(speed), {}
        for name, read in READ.items():
            try:
                found = read(own)
            except ValueError as error:
                refused[name] = str(error)
            else:
                numbers[name] = [x for x in jax.tree.leaves(found) if isinstance(x, jax.Array)]
        return numbers

    numbers = WITHIN[within](everything)
    assert {name for name, own in numbers.items() if own} == ARRAYS
    assert set(refused) <= set(READ) - ARRAYS
    assert all("being traced" in sentence for sentence in refused.values())


@pytest.mark.slow
def test_texts_of_a_run_that_is_differentiated_are_those_of_the_run():
    found = {}

    def end(speed):
        own = run(speed)
        found.update({name: READ[name](own) for name in TEXTS})
        return own.time[-1]

    jax.jvp(end, (5.0,), (1.0,))
    assert found["result"].startswith("The run reached its end")


def test_a_quaternion_follows_the_turn_of_its_body():
    """About z by an angle a it is (cos a/2, 0, 0, sin a/2), on whichever side of its largest entry
    that is."""
    hinge = {"A": jc.Connection(jc.joint.Revolute(), "ground", "a")}

    def quaternion(angle):
        rig = jc.Mechanism({"a": jc.Body(1.0, 0.1)}, hinge, start={"A": angle})
        return jc.simulate(rig, 1e-3, save=2, throw=False).body("a").quaternion[0]

    angles = np.array([0.4, 2.0, -2.5])
    both = jax.jit(jax.vmap(lambda a: jax.jvp(quaternion, (a,), (1.0,))))
    cos, sin, none = np.cos(angles / 2), np.sin(angles / 2), 0 * angles
    value, slope = both(jnp.asarray(angles))
    np.testing.assert_allclose(value, np.stack([cos, none, none, sin], axis=1), atol=1e-12)
    np.testing.assert_allclose(slope, 0.5 * np.stack([-sin, none, none, cos], axis=1), atol=1e-12)


def beyond_reach(rod, **kwargs):
    """A crank that drives a slider off its line, farther than its rod reaches."""
    turn = jc.joint.Revolute
    rail = jc.Marker("ground", (0.0, 0.15), axis="x"), jc.Marker("slider", axis="x")
    return jc.simulate(
        jc.Mechanism(
            {
                "crank": jc.Body(0.3, 1e-4, (0.05, 0.0)),
                "rod": jc.Body(0.2, 1e-4, (0.1, 0.0)),
                "slider": jc.Body(0.2, 1e-4),
            },
            {
                "O": jc.Connection(turn(jc.drive.ConstantSpeed(10.0)), "ground", "crank"),
                "A": jc.Connection(turn(), "crank", "rod", at=(0.1, 0.0)),
                "B": jc.Connection(turn(), jc.Marker("rod", (rod, 0.0)), jc.Marker("slider")),
                "G": jc.Connection(jc.joint.Prismatic(), *rail),
            },
            guess={"G": 0.3},
        ),
        1.0,
        save=11,
        **kwargs,
    )


@pytest.mark.slow
@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.grad])
def test_a_run_that_ends_early_has_no_derivative_beyond_and_says_why(derivative):
    said = []

    def slid(rod, row):
        run = beyond_reach(rod, throw=False)
        said.append((run.result, str(run)))
        return run.coordinate("G")[row]

    slope = derivative(lambda rod: slid(rod, -1))(0.2)
    assert np.isnan(slope) and "its result says why" in explain_nan(slope)
    assert all("dead point" in text for texts in said for text in texts)
    assert np.isfinite(derivative(lambda rod: slid(rod, 1))(0.2))
    with pytest.raises(jc.SimulationError, match="dead point"):
        derivative(lambda rod: beyond_reach(rod).coordinate("G")[-1])(0.2)
