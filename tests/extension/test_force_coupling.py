"""A coupling of a stranger that is a force between two coordinates."""

import equinox as eqx
import numpy as np
import pytest

import jaxclear as jc
from jaxclear import Scalar, quantity

TURN = jc.joint.Revolute()


class CentrifugalClutch(jc.coupling.AbstractForceCoupling):
    """Shoes of a drum a press outwards by the square of its speed, and drag b along by a torque in
    proportion to that and to the slip."""

    a: str = eqx.field(static=True)
    b: str = eqx.field(static=True)
    grip: Scalar = quantity(unit="N m s^3/rad^3", meaning="torque by speed^2 and slip", above=0)

    def coordinates(self):
        return self.a, self.b

    def states(self):
        return ()

    def effect(self, time, positions, speeds, states):
        slip = speeds[0] - speeds[1]
        torque = self.grip * speeds[0] ** 2 * slip
        return jc.load.CoordinateEffect((-torque, torque), (), 0, torque * slip, 0)

    def reads_position(self):
        return False

    def transmitted(self, effect):
        return effect.forces[1]

    def along(self):
        return self.b


class Mistaken(CentrifugalClutch):
    """Forgets one of the two."""

    def effect(self, time, positions, speeds, states):
        return jc.load.CoordinateEffect((0.0,), (), 0, 0, 0)


def shafts(coupling):
    driven = jc.joint.Revolute(jc.drive.ConstantSpeed(20.0))
    return jc.Mechanism(
        {"a": jc.Body(0.3, 1e-3), "b": jc.Body(1.0, 0.05)},
        {"A": jc.Connection(driven, "ground", "a"), "B": jc.Connection(TURN, "ground", "b")},
        couplings={"clutch": coupling},
    )


def test_a_clutch_drags_its_drum_along():
    run = jc.simulate(shafts(CentrifugalClutch("A", "B", 1e-3)), 0.5, save=51, balance=True)
    wanted = 20.0 * (1 - np.exp(-1e-3 * 400.0 / 0.05 * np.asarray(run.time)))
    np.testing.assert_allclose(run.speed("B"), wanted, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(run.transmitted("clutch"), run.transmitted("A"), rtol=1e-9)
    np.testing.assert_allclose(run.energy_balance().error, 0.0, atol=1e-6)


def test_one_that_answers_something_else_is_told():
    with pytest.raises(ValueError, match='coupling "clutch", its effect'):
        shafts(Mistaken("A", "B", 1e-3))
