"""Runs verified as users' are by default, of every joint, coupling and joint with clearance beside
every other: side by side in one mechanism, in a plane and in space, and each by itself."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.native import has_kernels
from tests.rigs import clearance_joints

pytestmark = [
    pytest.mark.verified,
    pytest.mark.skipif(not has_kernels(), reason="XLA alone takes minutes to compile them"),
]
RUB = jc.friction.CoulombTanh(mu_kinetic=0.1, transition_speed=1e-2)
turn, slide = jc.joint.Revolute, jc.joint.Prismatic
# In a plane, and in space: a joint between the ground and a body.
PLANAR = {
    "turn": turn(),
    "driven": turn(drive=jc.drive.ConstantSpeed(5.0)),
    "slide": slide(),
    "fixed": jc.joint.Fixed(),
    "planar": jc.joint.Planar(),
    "plain": jc.joint.PlainBearing(RUB, radius=5e-3),
    "loaded plain": jc.joint.PlainBearing(RUB, radius=5e-3, load=100.0),
    "slideway": jc.joint.Slideway(RUB, length=0.04, width=0.02),
}
SPATIAL = {
    "turn": turn(),
    "slide": slide(),
    "cylindrical": jc.joint.Cylindrical(),
    "universal": jc.joint.Universal(),
    "spherical": jc.joint.Spherical(),
    "free": jc.joint.Free(),
    "ball": jc.joint.BallJoint(RUB, radius=5e-3),
}
SOFT = {"stiffness": 1e4, "damping": 1.0}
# Between wheels "a" and "b" and a rack "r", which slides along x.
COUPLINGS = {
    "gear": jc.coupling.Gear("a", "b", 2.0, play=1e-3, **SOFT),
    "motor": jc.coupling.Gear(jc.coupling.Motor(1e-4), "a", 5.0, **SOFT),
    "belt": jc.coupling.Belt("a", "b", 0.04, 0.02, pretension=10.0, **SOFT),
    "rack": jc.coupling.Rack("a", "r", 0.03, **SOFT),
    "ratio": jc.coupling.Ratio("b", "r", 20.0, **SOFT),
    "hold": jc.coupling.Latch("b", 0.0, play=1e-3, **SOFT),
    "cam": jc.coupling.Cam("b", "r", lambda q: 1e-3 * jnp.sin(q), **SOFT),
    "one way": jc.coupling.OneWay("a", "b", **SOFT),
    "rope": jc.coupling.Rope(("a", "b"), (0.01, -0.01), **SOFT),
    "rigid": jc.coupling.Ratio("c", "a", 3.0),
}
FLAT = tuple(name for name in clearance_joints.JOINTS if name.startswith("planar"))
ROUND = tuple(name for name in clearance_joints.JOINTS if name not in FLAT)


def side_by_side(kinds, loose, flat):
    """Bodies in a row, each on a joint of its own with the ground."""
    joints = kinds | {name: clearance_joints.JOINTS[name](clearance_joints.USUAL) for name in loose}
    inertia = 1e-3 if flat else (1e-3, 2e-3, 1.5e-3)
    com = (0.02, 0.01) if flat else (0.02, 0.01, 0.03)
    connections = {}
    for k, (name, joint) in enumerate(joints.items()):
        at = (0.1 * k, 0.0) if flat else (0.1 * k, 0.0, 0.0)
        connections[f"on {name}"] = jc.Connection(joint, jc.Marker("ground", at), jc.Marker(name))
    gravity = jc.load.Gravity((0.0, -9.81) if flat else (1.0, -9.81, 0.3))
    bodies = {name: jc.Body(1.0, inertia, com) for name in joints}
    return jc.Mechanism(bodies, connections, {"gravity": gravity})


def coupled():
    """Wheels, a rack and a loose body, with all couplings at once."""
    rack = jc.Marker("ground", (0.0, 0.03), axis="x"), jc.Marker("r", axis="x")
    loose = clearance_joints.JOINTS["planar"](clearance_joints.USUAL)
    connections = {
        "a": jc.Connection(PLANAR["plain"], "ground", "wheel a"),
        "b": jc.Connection(turn(), jc.Marker("ground", (0.12, 0.0)), "wheel b"),
        "c": jc.Connection(turn(), jc.Marker("ground", (0.24, 0.0)), "wheel c"),
        "r": jc.Connection(slide(), *rack),
        "l": jc.Connection(loose, "ground", "loose"),
    }
    bodies = {each: jc.Body(1.0, 1e-3) for each in ("wheel a", "wheel b", "wheel c", "r", "loose")}
    loads = {"pull": jc.load.JointTorque("a", 1.0), "gravity": jc.load.Gravity((0.0, -9.81))}
    return jc.Mechanism(bodies, connections, loads, couplings=COUPLINGS)


def answers(mechanism):
    """The names of the standard answers of a short run, each with an error."""
    run = jc.simulate(mechanism, 1e-4, save=3)
    assert run.succeeded and all(np.isfinite(told.error) for told in run.verification.entries)
    assert str(run)
    return {told.name for told in run.verification.entries}


def test_joints_of_a_plane_beside_each_other():
    names = answers(side_by_side(PLANAR, FLAT, True))
    rub = ("plain", "loaded plain", "slideway")
    assert {f'mean contact force, "on {name}"' for name in (*rub, *FLAT)} <= names
    # Between saving times the force of a joint that never opens is not followed.
    peaks = {name for name in names if name.startswith("peak contact force")}
    assert peaks == {f'peak contact force, "on {name}"' for name in FLAT}


@pytest.mark.slow
def test_couplings_beside_joints_and_each_other():
    assert 'peak contact force, "l"' in answers(coupled())


def test_what_stands_still_is_judged_beside_its_size():
    """A shaft 0.1 m across that a push moves by less than the absolute tolerance, 1e-9 rad."""
    spring = jc.load.JointSpring("on wheel", 500.0)
    rig = jc.Mechanism(
        {"wheel": jc.Body(10.0, 0.1, (0.1, 0.0))},
        {"on wheel": jc.Connection(turn(), "ground", "wheel")},
        {"spring": spring, "push": jc.load.JointTorque("on wheel", 1e-7)},
    )
    run = jc.simulate(rig, 0.5, save=11)
    assert abs(float(run.coordinate("on wheel")[-1])) < 1e-9 and not run.warnings


@pytest.mark.slow
@pytest.mark.parametrize("loose", ROUND)
def test_joints_in_space_beside_each_other(loose):
    assert f'peak contact force, "on {loose}"' in answers(side_by_side(SPATIAL, (loose,), False))


BY_THEMSELVES = {name: ({name: joint}, True) for name, joint in PLANAR.items()}
BY_THEMSELVES |= {f"{name} in space": ({name: own}, False) for name, own in SPATIAL.items()}


@pytest.mark.slow
@pytest.mark.parametrize("name", BY_THEMSELVES)
def test_a_joint_by_itself(name):
    kinds, flat = BY_THEMSELVES[name]
    answers(side_by_side(kinds, (), flat))
