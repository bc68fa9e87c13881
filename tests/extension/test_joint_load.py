"""Loads of a stranger in a joint: a film in the gap of a bearing, a seal with a detent."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear import Scalar, quantity
from tests.rigs.cells import slow, slow_but

MASS, GRAVITY, STIFFNESS, DAMPING, TIME = 0.2, 9.81, 4e3, 8.0, 0.05


class Film(jc.load.AbstractJointLoad):
    """Carries its journal by a force in proportion to offset and velocity."""

    connection: str = eqx.field(static=True)
    stiffness: Scalar = quantity(unit="N/m", meaning="force by offset", at_least=0)
    damping: Scalar = quantity(unit="N s/m", meaning="force by velocity", at_least=0)

    def act(self, time, motion, states):
        (x, y, _), (u, v, _) = motion.pose.translation, motion.velocity
        k, d = self.stiffness, self.damping
        force = (-k * x - d * u, -k * y - d * v, 0.0)
        stored = 0.5 * k * (x * x + y * y)
        return jc.load.JointEffect(force, stored=stored, dissipated=d * (u * u + v * v))


def journal(damping=DAMPING, clearance=5e-3):
    """A journal that a film holds against gravity, off the wall where its clearance is large."""
    law = jc.contact.LankaraniNikravesh(restitution=0.9, stiffness=1e8)
    gap = jc.clearance.PlanarJournalBearing(law, clearance=clearance)
    loads = {"g": jc.load.Gravity((0.0, -GRAVITY)), "film": Film("B", STIFFNESS, damping)}
    bodies = {"shaft": jc.Body(MASS, 1e-5)}
    return jc.Mechanism(bodies, {"B": jc.Connection(gap, "ground", "shaft")}, loads)


def sinks(time, damping=DAMPING):
    """Height of a mass that falls into a spring and damper, and its speed."""
    rate = 0.5 * damping / MASS
    turn = np.sqrt(STIFFNESS / MASS - rate**2)
    depth, decay = MASS * GRAVITY / STIFFNESS, np.exp(-rate * time)
    height = -depth * (1 - decay * (np.cos(turn * time) + rate / turn * np.sin(turn * time)))
    return height, -depth * decay * (rate**2 + turn**2) / turn * np.sin(turn * time)


INTEGRATORS = {
    "adaptive": (jc.integrator.Adaptive(rtol=1e-8, atol=1e-11), 1e-6),
    "fixed": (jc.integrator.FixedStep(1e-4), 1e-6),
    "implicit": (jc.integrator.ImplicitStep(1e-4), 1e-3),
    "rigid": (jc.integrator.MoreauJean(1e-5), 3e-3),
}


@pytest.mark.parametrize("rung", slow_but(("fixed", "implicit"), INTEGRATORS))
def test_a_film_carries_its_journal_and_every_report_contains_it(rung):
    integrator, near = INTEGRATORS[rung]
    run = jc.simulate(journal(), TIME, save=11, balance=True, integrator=integrator, verify=False)
    height, speed = sinks(np.asarray(run.time))
    carried = -STIFFNESS * height - DAMPING * speed
    within, places = {"rtol": 0, "atol": near * MASS * GRAVITY}, run.body("shaft").com[:, 1]
    np.testing.assert_allclose(places * STIFFNESS, height * STIFFNESS, **within)
    for force in (run.contact("B").force, run.reaction("B").force, run.reaction("film").force):
        np.testing.assert_allclose(force[:, 1], carried, **within)
    balance = run.energy_balance()
    np.testing.assert_allclose(balance.error, 0.0, atol=10 * near * balance.potential.ptp())
    assert balance.damping_loss[-1] > 0.2 * -balance.potential[-1]


def test_a_batch_and_a_derivative_by_a_number_of_the_film():
    def end(damping):
        fixed = jc.integrator.FixedStep(1e-4)
        options = {"save": 2, "integrator": fixed, "verify": False, "throw": False}
        return jc.simulate(journal(damping), TIME, **options).body("shaft").com[-1, 1]

    ends = [sinks(TIME, damping)[0] for damping in (DAMPING, DAMPING - 1e-3, DAMPING + 1e-3)]
    both = jax.jit(jax.vmap(end))(jnp.array([DAMPING, DAMPING - 1e-3]))
    np.testing.assert_allclose(both, ends[:2], rtol=1e-5)
    slope = (ends[2] - ends[1]) / 2e-3
    assert float(jax.jit(jax.jacfwd(end))(DAMPING)) == pytest.approx(slope, rel=1e-5)


def test_film_and_contact_are_added_up():
    """At rest on the wall the film carries what its offset gives, the wall the rest."""
    gap = 1e-4
    run = jc.simulate(journal(200.0, gap), 0.3, save=2, integrator=jc.integrator.ImplicitStep(1e-4))
    # a damper is taken at speeds that the step predicts: of its order
    contact, weight = run.contact("B"), MASS * GRAVITY
    film = -STIFFNESS * contact.offset[-1, 1]
    assert 0.1 * weight < film < 0.9 * weight
    assert float(contact.normal_force[-1, 0]) == pytest.approx(float(weight - film), rel=2e-3)
    for force in (contact.force, run.reaction("B").force):
        assert float(force[-1, 1]) == pytest.approx(weight, rel=2e-3)


class Drag(jc.load.AbstractJointLoad):
    """A torque in proportion to the speed of a joint about its axis."""

    connection: str = eqx.field(static=True)
    viscous: Scalar = quantity(unit="N m s/rad", meaning="torque by speed", at_least=0)

    def act(self, time, motion, states):
        return jc.load.JointEffect((0, 0, 0), (0, 0, -self.viscous * motion.spin[2]))


TURN, LENGTH = jc.joint.Revolute(), 0.3


@pytest.mark.parametrize("loop", [*slow(False), True])
def test_a_drag_in_an_ideal_joint_is_in_its_reaction(loop):
    """Of a joint that the tree carries, or that closes a parallelogram's loop."""
    crank = jc.joint.Revolute(jc.drive.ConstantSpeed(3.0))
    joints = {
        "O": jc.Connection(crank, "ground", "crank"),
        "A": jc.Connection(TURN, "crank", "rod", at=(0.0, 0.1)),
    }
    bodies = {"crank": jc.Body(0.1, 1e-4), "rod": jc.Body(0.2, 1e-3)}
    if loop:
        bodies["rocker"] = jc.Body(0.1, 1e-4)
        joints["D"] = jc.Connection(TURN, "ground", "rocker", at=(LENGTH, 0.0))
        ends = jc.Marker("rod", (LENGTH, 0.0)), jc.Marker("rocker", (0.0, 0.1))
        joints["B"] = jc.Connection(TURN, *ends)
    drag, speeds = Drag("B" if loop else "A", 0.02), None if loop else {"A": -3.0}
    rig = jc.Mechanism(bodies, joints, {"drag": drag}, speeds=speeds)
    run = jc.simulate(rig, 0.1, save=3, balance=True)
    spin = 3.0 if loop else np.asarray(run.speed("A"))
    for name in (drag.connection, "drag"):
        np.testing.assert_allclose(run.reaction(name).torque[:, 2], -0.02 * spin, rtol=1e-6)
    balance = run.energy_balance()
    np.testing.assert_allclose(balance.error, 0.0, atol=1e-7)
    if loop:
        assert float(balance.damping_loss[-1]) == pytest.approx(0.02 * 9.0 * 0.1, rel=1e-6)


def test_a_drag_in_a_joint_that_always_touches_is_in_its_contact():
    spin = jc.Mechanism(
        {"shaft": jc.Body(MASS, 1e-3)},
        {"B": jc.Connection(jc.joint.PlainBearing(radius=0.01), "ground", "shaft")},
        {"drag": Drag("B", 0.02)},
        speeds={"B": 3.0},
    )
    run = jc.simulate(spin, 0.05, save=3, integrator=jc.integrator.NonColliding(1e-3), verify=False)
    turning = np.asarray(run.speed("B"))
    assert 0 < turning[-1] < turning[0]
    for torque in (run.contact("B").torque, run.reaction("B").torque):
        np.testing.assert_allclose(torque[1:, 2], -0.02 * turning[1:], rtol=1e-9)


class Mistaken(Drag):
    """Returns a force alone."""

    def act(self, time, motion, states):
        return (0.0, 0.0, 0.0)


def test_what_cannot_be_is_said():
    rig = journal()
    for load, sentence in (
        (Mistaken("B", 1.0), r'load "film", its act\(time, motion, states\), returns'),
        (Drag("C", 1.0), 'joint "C" for load "film" to act in'),
    ):
        with pytest.raises(ValueError, match=sentence):
            jc.Mechanism(rig.bodies, rig.connections, {"film": load})
