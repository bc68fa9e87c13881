"""Peaks of what couplings transmit are those of all steps: a shaft that runs into a spring."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear import Scalar, quantity

J, STIFFNESS, SPEED = 0.02, 2e3, 5.0
# J w'' = -k w from w = 0 on: k w has its peak after a quarter of a period
PEAK, PERIOD = SPEED * np.sqrt(STIFFNESS * J), 2 * np.pi * np.sqrt(J / STIFFNESS)
HELD = jc.joint.Revolute(jc.drive.ConstantPosition(0.0))


class Spring(jc.coupling.AbstractForceCoupling):
    """A torque in proportion to how far one shaft is ahead of the other, of a stranger."""

    spring: Scalar = quantity(unit="N m/rad", meaning="torque by angle", above=0)
    a: str = eqx.field(static=True, default="A")
    b: str = eqx.field(static=True, default="B")

    def coordinates(self):
        return self.a, self.b

    def states(self):
        return ()

    def effect(self, time, positions, speeds, states):
        ahead = positions[0] - positions[1]
        torque = self.spring * ahead
        return jc.load.CoordinateEffect((-torque, torque), (), 0.5 * torque * ahead, 0, 0)

    def reads_position(self):
        return True

    def transmitted(self, effect):
        return effect.forces[1]

    def along(self):
        return self.b


COUPLINGS = {
    "one way": lambda k: jc.coupling.OneWay("A", "B", stiffness=k, damping=1e-6),
    "stiff": lambda k: jc.coupling.Ratio("A", "B", 1.0, stiffness=k),
    "own": Spring,
}
INTEGRATORS = {
    "adaptive": jc.integrator.Adaptive(largest_step=PERIOD / 200),
    "fixed": jc.integrator.FixedStep(PERIOD / 200),
    "chosen": jc.integrator.FixedStep(PERIOD / 50, contact_steps=4),
    "euler": jc.integrator.FixedStep(PERIOD / 200, "semi_implicit"),
    "implicit": jc.integrator.ImplicitStep(PERIOD / 200),
    "rigid": jc.integrator.MoreauJean(PERIOD / 200),
    "permanent": jc.integrator.NonColliding(PERIOD / 200),
}


def shafts(kind, stiffness=STIFFNESS):
    return jc.Mechanism(
        {"a": jc.Body(0.3, J), "b": jc.Body(0.3, J)},
        {
            "A": jc.Connection(HELD, "ground", "a"),
            "B": jc.Connection(jc.joint.Revolute(), "ground", "b"),
        },
        couplings={"c": COUPLINGS[kind](stiffness)},
        speeds={"B": -SPEED},
    )


def peak(kind, integrator, stiffness=STIFFNESS):
    """Saved where nothing is transmitted: at the start, and half a period later."""
    options = {"save": 2, "integrator": integrator, "verify": False, "throw": False}
    run = jc.simulate(shafts(kind, stiffness), 0.5 * PERIOD, **options)
    return jc.response.PeakTransmitted("c")(run)


@pytest.mark.parametrize(
    ("kind", "rung"),
    [
        *(("own", rung) for rung in ("chosen", "rigid", "permanent")),
        *(pytest.param("own", rung, marks=pytest.mark.slow) for rung in ("adaptive", "euler")),
        ("one way", "adaptive"),
        ("stiff", "implicit"),
    ],
)
def test_a_peak_between_saving_times_is_found(kind, rung):
    # steps end within half a step of it, and of first order are off by one
    assert float(peak(kind, INTEGRATORS[rung])) == pytest.approx(PEAK, rel=0.02)


def test_its_derivative_and_a_batch():
    fine = jc.integrator.FixedStep(PERIOD / 2000)
    slope = jax.jacfwd(lambda k: peak("own", fine, k))(STIFFNESS)
    assert float(slope) == pytest.approx(0.5 * PEAK / STIFFNESS, rel=5e-3)
    # of steps in which the force turns by 5 % it is off by more than 1 %
    coarse = jax.jacfwd(lambda k: peak("own", INTEGRATORS["fixed"], k))(STIFFNESS)
    assert np.isnan(coarse)
    stiffnesses = jnp.array([STIFFNESS, 1.1 * STIFFNESS])
    both = jax.vmap(lambda k: peak("own", fine, k))(stiffnesses)
    np.testing.assert_allclose(both, SPEED * np.sqrt(J * np.asarray(stiffnesses)), rtol=1e-3)


def test_a_run_prints_it_and_its_error():
    options = {"save": 2, "integrator": INTEGRATORS["fixed"], "verify": True}
    run = jc.simulate(shafts("one way"), 0.5 * PERIOD, **options)
    rows = run.verification.table()
    row = rows[rows.iloc[:, 0].str.startswith("peak transmitted")].iloc[0]
    assert float(row["value"]) == pytest.approx(PEAK, rel=1e-3)
    assert run.extremes.couplings == ("c",) and "transmitted" in str(run.extremes)
