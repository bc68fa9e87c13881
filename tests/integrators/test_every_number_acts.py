"""No integrator leaves out a number of a load without a word: each changes the run, but for those
whose class says that they belong to other steps."""

import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.cells import slow_but

STEPS = {
    "Adaptive": jc.integrator.Adaptive(),
    "FixedStep": jc.integrator.FixedStep(5e-4),
    "ImplicitStep": jc.integrator.ImplicitStep(5e-4),
    "MoreauJean": jc.integrator.MoreauJean(5e-4),
    "NonColliding": jc.integrator.NonColliding(5e-4),
}
BODIES = ("block", "striker", "free", "holder", "wheel")
LOADS = {
    "Gravity": jc.load.Gravity((1.0, -9.81)),
    "Force": jc.load.Force(jc.Marker("wheel", (0.03, 0.05)), (3.0, 0.5)),
    "Torque": jc.load.Torque(jc.Marker("wheel"), 0.4),
    "MotorTorque": jc.load.MotorTorque(jc.Marker("ground"), jc.Marker("wheel"), 0.3),
    "Spring": jc.load.Spring(
        jc.Marker("ground", (0.0, 0.5)), jc.Marker("block", (0.1, 0.0)), 30.0, 0.4, 2.0
    ),
    "JointSpring": jc.load.JointSpring("S", 25.0, 0.1, 1.5),
    "JointTorque": jc.load.JointTorque("H", 0.7),
    "RotorInertia": jc.load.RotorInertia("A", 0.1),
    "JointStop": jc.load.JointStop("T", -0.05, 0.1, stiffness=2e4, restitution=0.6),
    "JointStop of a damper": jc.load.JointStop(
        "W", -0.02, 0.05, stiffness=500.0, damping=3.0, depth=0.01
    ),
    "JointFriction": jc.load.JointFriction("H", 4.0),
    "JointFriction of the speed": jc.load.JointFriction("S", 0.5, 0.3),
    "Pressed": jc.load.JointFriction("W", jc.load.Pressed("JointSpring", 0.05)),
    "Servo": jc.load.Servo("S", 0.2, kp=20.0, ki=5.0, kd=1.0, torque_limit=2.0),
}
# By the class that says so: what steps with percussions and set-valued friction do not take.
RIGID = ("MoreauJean", "NonColliding")
SAID = {
    ("JointFriction", "presliding"): RIGID,
    ("JointFriction", "settling_time"): RIGID,
    ("Pressed", "presliding"): RIGID,
    ("Pressed", "settling_time"): RIGID,
    # A function of the speed has no bristle.
    ("JointFriction of the speed", "presliding"): tuple(STEPS),
    ("JointFriction of the speed", "settling_time"): tuple(STEPS),
    # One with a restitution is rigid there.
    ("JointStop", "stiffness"): RIGID,
}


def rig():
    """A block, one that strikes its stops, one that runs into soft ones, one that friction holds,
    and a wheel."""
    slides = dict(zip("STWH", BODIES, strict=False))
    joints = {
        name: jc.Connection(jc.joint.Prismatic(), "ground", body, axis="x")
        for name, body in slides.items()
    }
    joints["A"] = jc.Connection(jc.joint.Revolute(), "ground", "wheel")
    return jc.Mechanism(
        {name: jc.Body(1.0 + 0.3 * k, 0.05, (0.02, 0.01)) for k, name in enumerate(BODIES)},
        joints,
        LOADS,
        speeds={"S": 0.5, "T": 1.5, "W": -1.0, "H": 0.28, "A": 2.0},
    )


def test_every_load_is_looked_at():
    named = (getattr(jc.load, name) for name in jc.load.__all__)
    finals = {
        own.__name__
        for own in named
        if inspect.isclass(own) and issubclass(own, jc.load.AbstractLoad)
        if not own.__name__.startswith("Abstract")
    }
    assert finals == {type(load).__name__ for load in LOADS.values()}


@pytest.mark.parametrize("name", slow_but(("Adaptive", "MoreauJean"), STEPS))
def test_every_number_of_every_load_changes_a_run(name):
    mechanism = rig()
    count = len(jax.tree.leaves(mechanism.loads))

    def end(loads):
        run = jc.simulate(
            eqx.tree_at(lambda own: own.loads, mechanism, loads),
            0.4,
            save=np.linspace(0.0, 0.4, 9),
            integrator=STEPS[name],
            verify=False,
        )
        return np.concatenate([np.ravel(run.speed(joint)) for joint in "STWHA"])

    leaves, structure = jax.tree_util.tree_flatten_with_path(mechanism.loads)
    before = end(mechanism.loads)
    idle = set()
    for k, (path, leaf) in enumerate(leaves):
        values = [value for _, value in leaves]
        values[k] = jnp.asarray(leaf) * 1.02 + 1e-5
        if np.array_equal(before, end(jax.tree.unflatten(structure, values))):
            keys = [str(getattr(key, "key", getattr(key, "name", ""))) for key in path]
            idle.add((keys[0], keys[-1]))
    assert count == len(leaves)
    assert idle - {place for place, steps in SAID.items() if name in steps} == set()
