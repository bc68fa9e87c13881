"""Drives that let go and press again, beside their equations by SciPy's DOP853."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxclear as jc

TURN, SLIDE = jc.joint.Revolute(), jc.joint.Prismatic()
JA, JB, MASS = 0.02, 0.05, 0.8
END, SAVES = 0.6, 61
PULL, FAST, LOAD = 3.0, 25.0, 0.4
# Steps of the oracle, which end at no kink: those of its tolerance are longer.
KINKS = 2e-4


def one_sided(stretch, rate, k, d):
    """A spring that pulls one way and a damper bounded by it."""
    spring = k * max(stretch, 0.0)
    return spring + np.clip(d * rate, -spring, spring)


def train(second, coupling, distance=0.0, **given):
    """Two bodies on the ground, the first pulled to and fro, the second loaded."""
    joint, body = (
        (TURN, jc.Body(MASS, (JB,) * 3)) if second == "turns" else (SLIDE, jc.Body(MASS, JB))
    )
    at = jc.Marker("ground", (distance, 0.0, 0.0), axis="z" if second == "turns" else "y")
    end = jc.Marker("b", axis="z" if second == "turns" else "y")
    loads = {
        "pull": jc.load.JointTorque("A", lambda t: PULL * jnp.sin(FAST * t)),
        "load": jc.load.JointTorque("B", -LOAD),
    }
    return jc.Mechanism(
        {"a": jc.Body(0.3, (JA,) * 3), "b": body},
        {"A": jc.Connection(TURN, "ground", "a"), "B": jc.Connection(joint, at, end)},
        loads,
        couplings={"c": coupling},
        **given,
    )


def moved(forces, inertia, start=(0.0, 0.0), states=0):
    """(place of a, place of b) over time, by `forces(a, va, b, vb, *states)`: those on both, and
    rates of the states."""

    def rate(t, y):
        a, va, b, vb, *own = y
        on_a, on_b, rates = forces(a, va, b, vb, *own)
        pull = PULL * np.sin(FAST * t)
        return [va, (pull + on_a) / JA, vb, (on_b - LOAD) / inertia, *rates]

    y = [0.0, start[0], 0.0, start[1], *[0.0] * states]
    times = np.linspace(0.0, END, SAVES)
    given = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13, "max_step": KINKS}
    return solve_ivp(rate, (0.0, END), y, t_eval=times, **given).y[[0, 2]]


def freewheel(ratio=1.5, k=400.0, d=1.0):
    def forces(a, va, b, vb, wound):
        rate = max(va - ratio * vb, -k / d * wound)
        force = k * wound + d * rate
        return -force, ratio * force, (rate,)

    own = jc.coupling.OneWay("A", "B", ratio, stiffness=k, damping=d)
    return train("turns", own), moved(forces, JB, states=1)


def slack_rope(radius=0.05, k=3e3, d=4.0, tight=5.0):
    def forces(a, va, b, vb):
        pull = one_sided(radius * a - b + tight / k, radius * va - vb, k, d)
        return -radius * pull, pull, ()

    own = jc.coupling.Rope(("A", "B"), (radius, -1.0), stiffness=k, damping=d, pretension=tight)
    return train("slides", own), moved(forces, MASS)


def slack_belt(radius_a=0.03, radius_b=0.06, k=60.0, d=0.05, tight=20.0):
    slack = 2 * tight * radius_a / k

    def forces(a, va, b, vb):
        twist, rate = a - radius_b / radius_a * b, va - radius_b / radius_a * vb
        torque = one_sided(slack + twist, rate, k / 2, d / 2)
        torque -= one_sided(slack - twist, -rate, k / 2, d / 2)
        return -torque, torque * radius_b / radius_a, ()

    own = jc.coupling.Belt("A", "B", radius_a, radius_b, stiffness=k, damping=d, pretension=tight)
    return train("turns", own, 0.2), moved(forces, JB)


def loose_rack(radius=0.04, k=900.0, d=0.8, play=2e-3):
    def forces(a, va, b, vb):
        twist, rate = a - b / radius, va - vb / radius
        torque = max(0.0, k * (twist - play / 2) + d * rate) if twist > play / 2 else 0.0
        if twist < -play / 2:
            torque = min(0.0, k * (twist + play / 2) + d * rate)
        return -torque, torque / radius, ()

    loose = jc.clearance.Backlash(play, law=jc.flank.Stop())
    own = jc.coupling.Rack("A", "B", radius, play=loose, stiffness=k, damping=d)
    return train("slides", own, radius), moved(forces, MASS)


def jumping_cam(lift=4e-3, k=4e4, d=20.0):
    def forces(a, va, b, vb):
        slope = lift * np.sin(a)
        force = one_sided(lift * (1 - np.cos(a)) - b, slope * va - vb, k, d)
        return -slope * force, force, ()

    own = jc.coupling.Cam(
        "A", "B", lambda angle: lift * (1 - jnp.cos(angle)), stiffness=k, damping=d
    )
    return train("slides", own, speeds={"A": 40.0}), moved(forces, MASS, (40.0, 0.0))


STEPS = {
    "adaptive": (jc.integrator.Adaptive(rtol=1e-9, atol=1e-11), 1e-6),
    "fixed": (jc.integrator.FixedStep(2e-5), 1e-4),
    "implicit": (jc.integrator.ImplicitStep(2e-5), 2e-4),
}
CASES = [freewheel, slack_rope, slack_belt, loose_rack, jumping_cam]
QUICK = {(freewheel, "adaptive"), (slack_rope, "implicit"), (slack_belt, "fixed")}
QUICK |= {(loose_rack, "adaptive"), (jumping_cam, "implicit")}


@pytest.mark.parametrize(
    ("case", "steps"),
    [
        pytest.param(*pair, marks=() if pair in QUICK else pytest.mark.slow)
        for pair in itertools.product(CASES, STEPS)
    ],
)
def test_what_lets_go_moves_as_its_equations(case, steps):
    (rig, known), (integrator, off) = case(), STEPS[steps]
    run = jc.simulate(rig, END, save=SAVES, integrator=integrator, verify=False)
    found = np.stack([run.coordinate("A"), run.coordinate("B")])
    size = np.max(np.abs(known), axis=1, keepdims=True)
    assert np.max(np.abs(found - known) / size) < off
