"""A rope that slips over its pulley, beside Euler's and Eytelwein's equation."""

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.cells import slow, slow_but

MU, WRAP, GRAVITY = 0.25, np.pi, 9.81
GRIP = np.exp(MU * WRAP)
STEPS = {
    "adaptive": jc.integrator.Adaptive(),
    "fixed": jc.integrator.FixedStep(2e-4),
    "implicit": jc.integrator.ImplicitStep(2e-4),
    "rigid": jc.integrator.MoreauJean(2e-4),
    "permanent": jc.integrator.NonColliding(2e-4),
}


STIFFNESS = 2e5


def hung(heavy, light=1.0, friction=MU):
    """Two weights on a rope over a pulley that stands still, which hang or fall from the start."""
    grip = min(heavy / light, float(np.exp(friction * WRAP)))
    falls = GRAVITY * (heavy - grip * light) / (heavy + grip * light)
    pulls = heavy * (GRAVITY - falls), light * (GRAVITY + falls)
    rope = jc.coupling.Capstan(
        "A",
        b="B",
        friction=friction,
        wrap=WRAP,
        radius_a=-1.0,
        radius_b=-1.0,
        stiffness=STIFFNESS,
        pretension=pulls[1],
    )
    slide, ends = jc.joint.Prismatic(), {"A": "heavy", "B": "light"}
    return jc.Mechanism(
        {"heavy": jc.Body(heavy, 1e-3), "light": jc.Body(light, 1e-3)},
        {n: jc.Connection(slide, "ground", body, axis="y") for n, body in ends.items()},
        {"gravity": jc.load.Gravity((0.0, -GRAVITY))},
        couplings={"rope": rope},
        start={"A": -(pulls[0] - pulls[1]) / STIFFNESS},
    )


def fallen(rig, integrator, duration=0.5):
    run = jc.simulate(rig, duration, integrator=integrator, save=3, verify=False, throw=False)
    places = run.coordinate("A").ravel()
    return places[0] - places[-1]


@pytest.mark.parametrize("kind", slow_but(("adaptive", "rigid"), STEPS))
def test_a_weight_falls_by_what_the_pulley_does_not_hold(kind):
    """a = g (m - e^(mu theta) m') / (m + e^(mu theta) m')."""
    heavy = 4.0
    a = GRAVITY * (heavy - GRIP) / (heavy + GRIP)
    assert abs(float(fallen(hung(heavy), STEPS[kind])) / (0.5 * a * 0.25) - 1) < 5e-3


@pytest.mark.parametrize("kind", ["rigid", *slow("adaptive"), *slow("permanent")])
def test_a_weight_that_is_light_enough_hangs(kind):
    rig = hung(0.95 * GRIP)
    first, last = (float(fallen(rig, STEPS[kind], end)) for end in (0.5, 1.0))
    assert max(abs(first), abs(last)) < 1e-8


def test_the_way_changes_with_friction_as_its_closed_form():
    heavy, end = 4.0, 0.5
    rig = hung(heavy)

    def way(friction):
        other = eqx.tree_at(lambda own: own.couplings["rope"].friction, rig, friction)
        return fallen(other, jc.integrator.FixedStep(1e-4))

    slope = float(jax.jvp(way, (MU,), (1.0,))[1])
    exact = -0.5 * end**2 * GRAVITY * 2 * heavy * GRIP * WRAP / (heavy + GRIP) ** 2
    assert abs(slope / exact - 1) < 2e-2


def winch(speed):
    """A rope from the ground round a driven pulley to a weight of 20 N on a damper."""
    drive = jc.drive.ConstantSpeed(speed)
    rope = jc.coupling.Capstan(
        pulley="P", b="B", friction=MU, wrap=WRAP, radius=0.1, stiffness=1e5, pretension=20.0
    )
    return jc.Mechanism(
        {"pulley": jc.Body(1.0, 1e-3), "weight": jc.Body(0.5, 1e-3)},
        {
            "P": jc.Connection(jc.joint.Revolute(drive=drive), "ground", "pulley"),
            "B": jc.Connection(jc.joint.Prismatic(), "ground", "weight", axis="x"),
        },
        {"pull": jc.load.JointTorque("B", 20.0), "damper": jc.load.JointSpring("B", damping=100.0)},
        couplings={"rope": rope},
    )


@pytest.mark.parametrize("kind", slow_but(("implicit", "permanent"), STEPS))
def test_a_pulley_drags_its_rope_by_the_capstan_equation_both_ways(kind):
    for speed, more in ((2.0, 20.0 * (GRIP - 1)), (-2.0, -20.0 * (1 - 1 / GRIP))):
        run = jc.simulate(
            winch(speed), 0.5, integrator=STEPS[kind], save=11, balance=True, verify=False
        )
        assert abs(float(run.transmitted("rope")[-1]) / more - 1) < 1e-3
        balance = run.energy_balance()
        # The slip that lags behind its bound is counted at its bound.
        assert abs(np.asarray(balance.error)).max() < 0.02 * abs(
            np.asarray(balance.damping_loss)[-1]
        )
