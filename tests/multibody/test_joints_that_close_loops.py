"""Any joint anywhere: what closes a loop moves as it does in the tree, whether it states its rows
or gets them from its motion."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.components.joint import AbstractJoint
from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import Twist
from jaxclear.multibody import constraints, kinematics
from jaxclear.multibody.dynamics import forward_dynamics
from jaxclear.multibody.forces import applied_forces
from jaxclear.multibody.pose_rows import DIRECTIONS, closing_rows
from jaxclear.multibody.state import unpack_motion
from jaxclear.multibody.system import prepare
from jaxclear.multibody.topology import _lay_out
from tests.components.test_ideal_joints import JOINTS, built, coordinates, slide
from tests.extension.test_ideal_joint import Screw

FREE = jc.joint.Free()


class ByMotion(AbstractJoint):
    """A joint that moves as another and states no rows."""

    home: ClassVar = (0.0,)
    units: ClassVar = ("rad",)
    reversal: ClassVar = jc.pose.FLIP
    other: AbstractJoint

    def motion(self, q):
        return self.other.motion(q)

    def columns(self, q):
        return self.other.columns(self.other.home if q == self.home else q)

    def rate(self, q, v):
        return self.other.rate(q, v)

    def bias(self, q, v):
        return self.other.bias(q, v)

    def moved(self, q, increment):
        return self.other.moved(q, increment)

    def retracted(self, q, increment):
        return self.other.retracted(q, increment)

    def bracket(self, a, b):
        return self.other.bracket(a, b)

    def coordinates_at(self, pose):
        return self.other.coordinates_at(pose)

    def speeds_at(self, pose, velocity, spin):
        return self.other.speeds_at(pose, velocity, spin)

    def start(self, given):
        return self.other.start(given)


def by_motion(joint, **more):
    """The same joint, of a class of its own that states no rows, or with these members."""
    names = {name: getattr(joint, name) for name in ("home", "units", "reversal")}
    kind = type(
        f"{type(joint).__name__}ByMotion", (ByMotion,), names | {"__module__": __name__} | more
    )
    return kind(joint)


BODIES = {"b": jc.Body(2.0, (3e-3, 5e-3, 4e-3, 4e-4, -3e-4, 2e-4), com=(0.1, -0.05, 0.2))}
ENDS = (jc.Marker("ground", (0.2, 0.1, -0.3), axis="x"), jc.Marker("b", (-0.1, 0.3, 0.1)))


def accelerated(joint, q, v, closing):
    """(residuals, rates, acceleration of the body) with the joint in the tree or closing a loop
    beside one without rows, at coordinates and speeds of the joint."""
    connections = {"J": jc.Connection(joint, *ENDS), "F": jc.Connection(FREE, *ENDS)}
    rig = jc.Mechanism(
        BODIES,
        connections,
        {
            "g": jc.load.Gravity((1.0, -2.0, -9.81)),
            "t": jc.load.Torque(jc.Marker("b"), (0.1, 0.2, 0.3)),
        },
    )
    if closing:
        topology = _lay_out([("b", "F", "ground", False)], ["J"], BODIES, connections)
        object.__setattr__(rig, "topology", topology)
        pose = joint.motion(q)
        twist = slide(joint, q, v)
        q = FREE.coordinates_at(sp.dense(pose))
        v = tuple(twist)
    else:
        assert rig.topology.branches[0].connection == "J"
    system = prepare(rig)
    own_q, own_v = unpack_motion(system, [*q, *v])
    motions = kinematics.link_motions(system, own_q, own_v, 0.0)
    forces = applied_forces(system, motions, {}, 0.0)
    solution = forward_dynamics(system, forces, None)
    found = kinematics.link_accelerations(system, motions, solution.accelerations)[0]
    # In the ground's axes, about the body's centre of mass: alike for both trees.
    link, motion = system.links[0], motions[0]
    centre = sp.scale(1 / link.mass, link.first_moment)
    linear = sp.plus(
        found.linear,
        sp.cross(found.angular, centre),
        sp.cross(motion.twist.angular, Twist(*motion.twist).linear),
        sp.cross(motion.twist.angular, sp.cross(motion.twist.angular, centre)),
    )
    parts = [sp.apply(motion.pose.rotation, part) for part in (linear, found.angular)]
    rows = [constraints.constraint_rows(system, motions, c) for c in system.closures]
    left = [x for own in rows for part in (own.residuals, own.rates) for x in part]
    return sp.stack(left), sp.stack([x for part in parts for x in part])


@pytest.mark.parametrize("kind", [*JOINTS, Screw], ids=lambda kind: kind.__name__)
def test_a_joint_moves_alike_in_the_tree_and_closing_a_loop(kind):
    rng = np.random.default_rng(4)
    joint = kind(0.03) if kind is Screw else built(kind)
    q = tuple(coordinates(kind, rng))
    v = tuple(jnp.asarray(rng.normal(size=len(joint.columns(q)))))
    _, in_tree = accelerated(joint, q, v, False)
    for own in (joint, by_motion(joint)):
        left, closing = accelerated(own, q, v, True)
        # both are exact: rounding, beside rates and accelerations of about 10
        np.testing.assert_allclose(left, np.zeros(len(left)), atol=1e-12)
        np.testing.assert_allclose(closing, in_tree, rtol=1e-9, atol=1e-9)


def test_rows_from_a_motion_are_as_many_as_it_holds():
    for kind in JOINTS:
        joint = built(kind)
        rows = closing_rows(by_motion(joint))
        assert len(rows) + len(joint.columns(joint.home)) == 6
        assert set(rows) <= set(DIRECTIONS)
    assert closing_rows(Screw(0.02)) == closing_rows(Screw(0.5))


# A screw has five rows; a slide that reads a coordinate which is always 0.
HALF = by_motion(Screw(0.1), rows=("x", "y", "x.z", "y.z"))
MISSPELT = by_motion(Screw(0.1), rows=("x", "y", "x.z", "y.z", "w"))
TWICE_FREE = by_motion(jc.joint.Prismatic(), coordinates_at=lambda self, pose: (0.0,))


@pytest.mark.parametrize(
    ("joint", "said"),
    [
        (HALF, "holds 4 of the six freedoms of a body by its rows and leaves 1"),
        (TWICE_FREE, "holds 6 of the six freedoms of a body by its motion at home and leaves 1"),
        (MISSPELT, "states the row 'w'"),
    ],
    ids=["half a joint", "twice free", "misspelt"],
)
def test_rows_and_freedoms_that_do_not_make_six_are_refused(joint, said):
    with pytest.raises(ValueError, match=f'(?s)joint "J".*{said}|{said}.*joint "J"'):
        jc.Mechanism(BODIES, {"J": jc.Connection(joint, "ground", "b")})


def screw_press(pitch):
    """A nut that slides and a spindle that turns, the screw between them closing the loop."""
    return jc.Mechanism(
        {"nut": jc.Body(2.0, (1e-3, 1e-3, 1e-3)), "spindle": jc.Body(1.0, (2e-4, 2e-4, 3e-4))},
        {
            "slide": jc.Connection(jc.joint.Prismatic(), "ground", "nut"),
            "turn": jc.Connection(jc.joint.Revolute(), "ground", "spindle"),
            "thread": jc.Connection(Screw(pitch), "nut", "spindle"),
        },
        {"g": jc.load.Gravity((0.0, 0.0, -9.81)), "t": jc.load.JointTorque("turn", 0.05)},
    )


@pytest.mark.slow
def test_a_screw_that_closes_a_loop_presses_as_its_formula():
    pitch = 0.01
    rig = screw_press(pitch)
    assert rig.topology.loops == ("thread",)
    run = jc.simulate(rig, 0.5, save=6, integrator=jc.integrator.FixedStep(1e-3))
    # z of the spindle in the nut is pitch times its turn there: the nut goes down by it
    turned = (0.05 + 2.0 * 9.81 * pitch) / (3e-4 + 2.0 * pitch**2)
    angle = 0.5 * turned * np.asarray(run.time) ** 2
    # a parabola is exact for the integrator: rounding, over 28 rad
    np.testing.assert_allclose(run.body("nut").com[:, 2], -pitch * angle, rtol=1e-9, atol=1e-12)
    force = 2.0 * (9.81 - pitch * turned)
    np.testing.assert_allclose(run.reaction("thread").force[:, 2], -force, rtol=1e-9)
    np.testing.assert_allclose(run.reaction("thread").torque[:, 2], pitch * force, rtol=1e-9)
    assert "compiled" not in str(run.warnings)


def test_an_exchanged_joint_of_ones_own_keeps_the_rest():
    rig = screw_press(0.01).with_joint("thread", jc.joint.Cylindrical())
    assert isinstance(rig.with_joint("thread", Screw(0.02)).connections["thread"].joint, Screw)


def four_bar(joint):
    at = lambda body, x: jc.Marker(body, (x, 0.0))
    return jc.Mechanism(
        {n: jc.Body(m, i, com=(0.5 * x, 0.0)) for n, m, i, x in LINKS},
        {
            "A": jc.Connection(jc.joint.Revolute(), "ground", at("crank", 0.0)),
            "D": jc.Connection(jc.joint.Revolute(), at("ground", 0.4), at("rocker", 0.0)),
            "B": jc.Connection(jc.joint.Revolute(), at("crank", 0.1), at("coupler", 0.0)),
            "C": jc.Connection(joint, at("coupler", 0.35), at("rocker", 0.25)),
        },
        {"g": jc.load.Gravity((0.0, -9.81))},
        start={"A": 0.6},
        guess={"D": 1.7},
    )


LINKS = (("crank", 1.0, 1e-3, 0.1), ("coupler", 1.5, 2e-2, 0.35), ("rocker", 1.2, 8e-3, 0.25))


@pytest.mark.slow
def test_rows_from_a_motion_stay_in_the_plane():
    revolute = jc.joint.Revolute()
    runs = [
        jc.simulate(
            four_bar(joint), 0.2, save=5, integrator=jc.integrator.FixedStep(2e-4), verify=False
        )
        for joint in (revolute, by_motion(revolute))
    ]
    stated, by_own = (run.body("rocker") for run in runs)
    assert runs[1].mechanism.topology.loops == ("C",)
    # the same rows to first order: drift of a fourth-order method in steps of 0.2 ms
    np.testing.assert_allclose(by_own.com, stated.com, atol=1e-9)
    forces = [run.reaction("C").force for run in runs]
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-7, atol=1e-7)
