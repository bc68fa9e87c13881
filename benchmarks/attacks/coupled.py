"""Drives whose couplings, plays, stops and servos switch, their numbers drawn at random.

All turn an arm that gravity pulls, by a torque that swings; each adds one element to it.
"""

from typing import Any

import jax.numpy as jnp

import jaxclear as jc
from benchmarks.attacks.bearings import Build, Case, Laws
from benchmarks.attacks.numbers import Draw

GRAVITY = 9.81


def _drive(n: Draw, **parts: dict[str, Any]) -> Case:
    """The arm at its hinge "A" with what an element adds; the torque swings it by some radians."""
    mass, length = n.log(0.3, 3.0, 1.0), n.log(0.05, 0.5, 0.2)
    inertia = mass * length**2 / 12
    # Torque that lifts the arm, and time in which it falls.
    lifting, falling = 0.5 * mass * GRAVITY * length, (length / GRAVITY) ** 0.5
    size, rate, phase = lifting * n.log(0.3, 3.0, 1.0), n.log(0.5, 5.0, 2.0) / falling, n.flat(0, 3)
    arm = jc.Body(mass, inertia, (0.5 * length, 0.0))
    swinging = jc.load.JointTorque("A", lambda t: size * jnp.sin(rate * t + phase))
    bodies, joints, loads, couplings = (
        parts.get(kind, {}) for kind in ("bodies", "joints", "loads", "couplings")
    )
    rig = jc.Mechanism(
        {"arm": arm} | {name: body(mass, length) for name, body in bodies.items()},
        {"A": jc.Connection(jc.joint.Revolute(), "ground", "arm")} | joints,
        {"gravity": jc.load.Gravity((0.0, -GRAVITY)), "torque": swinging}
        | {name: load(lifting) for name, load in loads.items()},
        couplings={name: own(lifting) for name, own in couplings.items()},
        start={"A": n.flat(-2.5, -0.6, -1.2)},
    )
    return Case(rig, n.flat(1.0, 3.0, 2.0) * falling)


def _wheel(n: Draw) -> dict[str, Any]:
    share = n.log(0.02, 2.0, 0.3)
    return {
        "bodies": {"wheel": lambda mass, length: jc.Body(mass, share * mass * length**2)},
        "joints": {"W": jc.Connection(jc.joint.Revolute(), "ground", "wheel", at=(0.3, 0.0))},
    }


def _slide(n: Draw) -> dict[str, Any]:
    share = n.log(0.05, 2.0, 0.5)
    return {
        "bodies": {"slide": lambda mass, length: jc.Body(share * mass, 1e-3)},
        "joints": {"S": jc.Connection(jc.joint.Prismatic(), "ground", "slide", axis="x")},
    }


def _gives(n: Draw, lifting: float, radius: float = 1.0) -> dict[str, float]:
    """Stiffness and damping of an element that gives some hundredth of a radian."""
    stiffness = lifting * n.log(30.0, 3e3, 300.0) / radius**2
    return {"stiffness": stiffness, "damping": stiffness * n.log(1e-4, 1e-2, 1e-3)}


def gear_with_play(n: Draw, laws: Laws) -> Case:
    """A motor behind teeth that have play and give."""
    ratio, play = n.log(3.0, 50.0, 10.0), n.log(1e-4, 2e-2, 3e-3)
    motor = jc.coupling.Motor(n.log(1e-6, 1e-4, 1e-5))
    return _drive(
        n,
        couplings={
            "gear": lambda lifting: jc.coupling.Gear(
                motor, "A", ratio, play=jc.clearance.Backlash(play), **_gives(n, lifting)
            )
        },
    )


def gear_with_losses(n: Draw, laws: Laws) -> Case:
    """A motor behind a gear that brakes more backwards."""
    ratio, forwards = n.log(3.0, 50.0, 20.0), n.flat(0.6, 0.95, 0.8)
    efficiency = jc.coupling.Efficiency(forwards, n.flat(0.3, 0.9) * forwards)
    motor = jc.coupling.Motor(n.log(1e-6, 1e-4, 1e-5))
    return _drive(
        n,
        couplings={
            "gear": lambda lifting: jc.coupling.Gear(
                motor, "A", ratio, efficiency=efficiency, **_gives(n, lifting)
            )
        },
    )


def belt_to_wheel(n: Draw, laws: Laws) -> Case:
    """A belt that stretches, with its pretension."""
    radius, other = n.log(0.01, 0.1, 0.03), n.log(0.01, 0.1, 0.05)
    return _drive(
        n,
        couplings={
            "belt": lambda lifting: jc.coupling.Belt(
                "A", "W", radius, other, pretension=lifting / radius, **_gives(n, lifting, radius)
            )
        },
        **_wheel(n),
    )


def rack_with_play(n: Draw, laws: Laws) -> Case:
    """A pinion that moves a slide through play."""
    radius = n.log(0.01, 0.1, 0.03)
    play = jc.clearance.Backlash(radius * n.log(1e-4, 2e-2, 3e-3))
    return _drive(
        n,
        couplings={
            "rack": lambda lifting: jc.coupling.Rack(
                "A", "S", radius, play=play, **_gives(n, lifting, radius)
            )
        },
        **_slide(n),
    )


def rope_that_slackens(n: Draw, laws: Laws) -> Case:
    """A rope over the arm's drum to a slide on a spring."""
    radius = n.log(0.01, 0.1, 0.03)
    slide = _slide(n)
    return _drive(
        n,
        loads={
            "spring": lambda lifting: jc.load.JointSpring(
                "S", 3 * lifting / radius**2, damping=1e-2 * lifting / radius**2
            )
        },
        couplings={
            "rope": lambda lifting: jc.coupling.Rope(
                ("A", "S"), (radius, 1.0), **_gives(n, lifting, radius)
            )
        },
        **slide,
    )


def freewheel(n: Draw, laws: Laws) -> Case:
    """A one-way clutch to a wheel."""
    return _drive(
        n,
        couplings={"clutch": lambda lifting: jc.coupling.OneWay("A", "W", **_gives(n, lifting))},
        **_wheel(n),
    )


def cam_that_lifts_off(n: Draw, laws: Laws) -> Case:
    """A follower on a spring, on a cam that turns with the arm."""
    lobe, lobes, share = n.log(2e-3, 1e-2, 4e-3), round(n.flat(2.0, 8.0, 5.0)), n.log(0.3, 3.0, 1.0)
    slide = _slide(n)
    rate = lambda lifting: share * lifting / (lobes * lobe) / lobe
    return _drive(
        n,
        loads={
            "spring": lambda lifting: jc.load.JointSpring(
                "S", rate(lifting), rest=-lobe, damping=1e-3 * rate(lifting)
            )
        },
        couplings={
            "cam": lambda lifting: jc.coupling.Cam(
                "A",
                "S",
                lambda angle: lobe * (1 - jnp.cos(lobes * angle)),
                stiffness=300 * rate(lifting),
                damping=0.1 * rate(lifting),
            )
        },
        **slide,
    )


def stop_that_damps(n: Draw, laws: Laws) -> Case:
    """A stop that gives and damps, at both ends."""
    low, high = n.flat(-3.2, -2.6, -2.8), n.flat(-0.5, 0.5, 0.0)
    return _drive(
        n, loads={"stop": lambda lifting: jc.load.JointStop("A", low, high, **_gives(n, lifting))}
    )


def stop_that_bounces(n: Draw, laws: Laws) -> Case:
    """A stop by its restitution."""
    low, high, bounce = n.flat(-3.2, -2.6, -2.8), n.flat(-0.5, 0.5, 0.0), n.flat(0.2, 0.9, 0.6)
    return _drive(
        n,
        loads={
            "stop": lambda lifting: jc.load.JointStop(
                "A", low, high, stiffness=lifting * n.log(1e2, 1e4, 1e3), restitution=bounce
            )
        },
    )


def dry_friction(n: Draw, laws: Laws) -> Case:
    """Dry friction in the hinge, by its default bristle."""
    share = n.flat(0.05, 0.6, 0.2)
    return _drive(
        n, loads={"friction": lambda lifting: jc.load.JointFriction("A", share * lifting)}
    )


def servo_at_its_limit(n: Draw, laws: Laws) -> Case:
    """A servo that holds a swinging angle as far as its torque goes."""
    size, rate, limit = n.flat(0.2, 1.0, 0.5), n.log(3.0, 30.0, 8.0), n.flat(1.2, 4.0, 2.0)
    return _drive(
        n,
        loads={
            "servo": lambda lifting: jc.load.Servo(
                "A",
                lambda t: -1.2 + size * jnp.sin(rate * t),
                20 * lifting,
                kd=lifting,
                torque_limit=limit * lifting,
            )
        },
    )


def servo_that_samples(n: Draw, laws: Laws) -> Case:
    """The same with an integral part, by a controller that looks every few milliseconds."""
    period, delay = n.log(1e-3, 1e-2, 2e-3), int(n.flat(0.0, 2.9, 1.0))
    return _drive(
        n,
        loads={
            "servo": lambda lifting: jc.load.Servo(
                "A",
                lambda t: -1.0 + 0.2 * jnp.sin(5 * t),
                10 * lifting,
                ki=10 * lifting,
                kd=0.5 * lifting,
                torque_limit=3 * lifting,
                period=period,
                delay=delay,
            )
        },
    )


COUPLED: tuple[Build, ...] = (
    gear_with_play,
    gear_with_losses,
    belt_to_wheel,
    rack_with_play,
    rope_that_slackens,
    freewheel,
    cam_that_lifts_off,
    stop_that_damps,
    stop_that_bounces,
    dry_friction,
    servo_at_its_limit,
    servo_that_samples,
)
