"""Mechanisms, states of them, and what three steps of an integrator make of these: by an earlier
version as recorded, and now.

`python -m tests.rigs.recorded_steps` records anew; do that only where a change of numbers is meant.
"""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from jaxclear.formulations.base import model_of
from jaxclear.integrators.base import Interval

RECORD = Path(__file__).parents[1] / "refdata/recorded_steps.json"
INTEGRATORS = {
    "FixedStep": (jc.integrator.FixedStep(1e-5), 1e-5),
    "ImplicitStep": (jc.integrator.ImplicitStep(1e-4), 1e-4),
    "MoreauJean": (jc.integrator.MoreauJean(1e-4), 1e-4),
    "NonColliding": (jc.integrator.NonColliding(1e-3), 1e-3),
}
EXPLICIT, RIGID = ("FixedStep", "ImplicitStep"), ("MoreauJean",)


def rubbing_crank(compliant: bool = True) -> jc.Mechanism:
    """A slider-crank with a loose pin; its crank pin rubs, and its slider, which has a stop."""
    if compliant:
        law = jc.contact.CarvalhoMartins(stiffness=1e8, restitution=0.6)
        friction = jc.friction.ThreeZone(mu_static=0.15, mu_kinetic=0.12)
        stop = {"stiffness": 2e5, "damping": 40.0}
    else:
        law, stop = jc.contact.Rigid(restitution=0.4), {"restitution": 0.6}
        friction = jc.friction.Coulomb(mu_kinetic=0.12, mu_static=0.15)
    pin = jc.joint.PlainBearing(friction, radius=5e-3, length=8e-3)
    sizes = {"bearing_radius": 10e-3, "clearance": 0.2e-3}
    loose = jc.clearance.PlanarJournalBearing(law, friction, **sizes)
    return jc.Mechanism(
        {
            "crank": jc.Body(0.3, 1e-4, (0.025, 0.0)),
            "rod": jc.Body(0.2, 2.5e-4, (0.06, 0.0)),
            "slider": jc.Body(0.14, 1e-4),
        },
        {
            "O": jc.Connection(jc.joint.Revolute(), "ground", "crank"),
            "A": jc.Connection(pin, "crank", "rod", at=(0.05, 0.0)),
            "B": jc.Connection(loose, "rod", "slider", at=(0.12, 0.0)),
            "G": jc.Connection(jc.joint.Prismatic(), "ground", "slider", axis="x"),
        },
        {
            "gravity": jc.load.Gravity((0.0, -9.81)),
            "stop": jc.load.JointStop("G", lower=0.155, **stop),
            "dry": jc.load.JointFriction("G", 0.3),
        },
        start={"O": 0.5},
        speeds={"O": 20.0},
        guess={"G": 0.161},
    )


def socket_pendulum() -> jc.Mechanism:
    """A bob that a loose ball holds by bristles, with a ball joint that rubs behind it."""
    lugre = jc.friction.LuGre(mu_static=0.2, mu_kinetic=0.1, stribeck_speed=1e-2, presliding=1e-5)
    law = jc.contact.Gonthier(stiffness=1e8, restitution=0.7)
    socket = jc.clearance.BallSocket(law, lugre, socket_radius=10e-3, clearance=0.1e-3)
    smooth = jc.friction.ThreeZone(mu_static=0.15, mu_kinetic=0.12)
    ball = jc.joint.BallJoint(smooth, radius=5e-3)
    rod = lambda mass: jc.Body(mass, (2e-3, 3e-3, 4e-3), com=(0.1, 0.0, 0.0))
    return jc.Mechanism(
        {"rod": rod(1.0), "bob": rod(0.5)},
        {
            "S": jc.Connection(socket, "ground", "rod"),
            "T": jc.Connection(ball, "rod", "bob", at=(0.2, 0.0, 0.0)),
        },
        {"gravity": jc.load.Gravity((0.0, 0.0, -9.81))},
        speeds={"rod": (0.0, 0.0, 0.0, 5.0, 1.0, 2.0), "T": (3.0, 2.0, 1.0)},
    )


def geared_masses(rigid: bool = False) -> jc.Mechanism:
    """A motor that turns a load through a gear with play; its flanks are rigid, or give."""
    play = jc.clearance.Backlash(2e-3, restitution=0.4 if rigid else None)
    gives = {} if rigid else {"stiffness": 500.0, "damping": 0.5}
    gear = jc.coupling.Gear(jc.coupling.Motor(1e-3), "L", 3.0, play=play, **gives)
    return jc.Mechanism(
        {"load": jc.Body(1.0, 0.05, (0.02, 0.0))},
        {"L": jc.Connection(jc.joint.Revolute(), "ground", "load")},
        {
            "motor": jc.load.JointTorque("G.motor", lambda t: 2.0 * jnp.sin(40.0 * t)),
            "gravity": jc.load.Gravity((0.0, -9.81)),
            "dry": jc.load.JointFriction("L", 0.1),
        },
        couplings={"G": gear},
    )


# By name: the mechanism, the integrators that step it, and for how long [s] it has run before.
MECHANISMS = {
    "antenna": (lambda: jc.scenes.antenna(), ("NonColliding",), 0.2),
    # By ImplicitStep its motors with holding friction part at rounding.
    "arm": (lambda: jc.scenes.arm("play"), ("FixedStep",), 0.02),
    "flap": (lambda: jc.scenes.flap(), ("ImplicitStep", "NonColliding"), 0.02),
    "four-bar": (lambda: jc.scenes.four_bar(), (*EXPLICIT, "NonColliding"), 0.02),
    "guide": (lambda: jc.scenes.guide(), ("NonColliding",), 0.2),
    "3RSR": (lambda: jc.scenes.parallel_3rsr(), ("FixedStep",), 0.02),
    "slider-crank": (lambda: jc.scenes.slider_crank(), (*EXPLICIT, *RIGID, "NonColliding"), 0.02),
    "rubbing crank": (rubbing_crank, EXPLICIT, 0.02),
    "rubbing crank, rigid": (lambda: rubbing_crank(False), RIGID, 0.02),
    "socket pendulum": (socket_pendulum, ("FixedStep",), 0.02),
    "geared masses": (geared_masses, EXPLICIT, 0.2),
    "geared masses, rigid": (lambda: geared_masses(True), RIGID, 0.2),
}
CASES = [(name, rung) for name, (_, rungs, _) in MECHANISMS.items() for rung in rungs]
# These have cheap programs.
FAST = [("slider-crank", "FixedStep"), ("geared masses", "ImplicitStep")]
STATES, STEPS = 3, 3


def stored_states(name: str, rung: str) -> tuple[np.ndarray, np.ndarray]:
    """(times [s], states) of a run."""
    build, _, duration = MECHANISMS[name]
    how = {"integrator": INTEGRATORS[rung][0], "verify": False, "balance": True}
    run = jc.simulate(build(), duration, save=2 * STATES + 1, **how)
    every = slice(2, None, 2)
    return np.asarray(run.time)[every], np.asarray(run.states)[every]


def stepping(name: str, rung: str, discrete: bool = True):
    """The state after three steps, as a function of (time [s], state)."""
    integrator, step = INTEGRATORS[rung]
    mechanism = integrator.formulation.modelled(MECHANISMS[name][0]())
    model = model_of(mechanism, integrator.formulation, balance=True)
    model = model.seeing({})
    object.__setattr__(model, "discrete", discrete)

    def advance(time, state):
        interval = Interval(time, time + STEPS * step, jnp.ones_like(state), jnp.asarray(True))
        warm_start = integrator.first_warm_start(model, time, state)
        return integrator.advance(model, interval, state, warm_start).state

    return advance


def stepped(name: str, rung: str, times, states, discrete: bool = True) -> tuple[list, list]:
    """(states after three steps, their derivatives along a fixed direction)."""
    advance = stepping(name, rung, discrete)
    direction = 1e-3 * np.cos(1.0 + np.arange(len(states[0])))
    along = lambda time, state: jax.jvp(lambda y: advance(time, y), (state,), (direction,))
    found = [jax.jit(along)(*own) for own in zip(times, states, strict=True)]
    return [np.asarray(end) for end, _ in found], [np.asarray(way) for _, way in found]


def record() -> dict:
    """What is to be found again, by case."""
    found = {}
    for name, rung in CASES:
        times, states = stored_states(name, rung)
        ends, slopes = stepped(name, rung, times, states)
        numbers = {"time": times, "state": states, "end": ends, "slope": slopes}
        found[f"{name} by {rung}"] = {key: np.asarray(x).tolist() for key, x in numbers.items()}
    return found


if __name__ == "__main__":
    RECORD.write_text(json.dumps(record(), indent=1) + "\n")
