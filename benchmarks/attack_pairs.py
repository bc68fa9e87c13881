"""A drive in which two things switch at once: is any derivative wrong without a sentence?

    python -m benchmarks.attack_pairs [--quick] [--json FILE] [--only NAME ...] [--rung NAME ...]
        [--minutes N]

A motor turns an arm through a gear that gives, under a torque that swings; to it are added two of:
play in the gear (by three laws of its flanks), its efficiency, a stop, a freewheel to a flywheel, a
cam whose follower lifts off, dry friction, a servo at its torque limit. Of each pair the slopes of
the root mean square of the arm's angle by a number of either of the two and by the arm's inertia,
as `jax.jacfwd(problem.evaluate)` gives them, beside extrapolated central differences of a tight
`Adaptive` and of one ten times looser (`benchmarks.attack_slopes`, where the verdicts are
explained).
"""

import functools
import itertools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.attack_slopes import MINUTES, Row, differences, judged, run_attack, told
from benchmarks.measure import arguments

DURATION, SAVES = 0.6, 121
# By how much of itself a slope may be off.
LIMIT = 0.01
# Bounds of the two references.
TOLERANCES = (1e-11, 1e-10)
RUNGS: dict[str, Any] = {
    "Adaptive": jc.integrator.Adaptive(),
    "Adaptive(rtol=1e-10)": jc.integrator.Adaptive(rtol=1e-10, atol=1e-12),
    "FixedStep(2e-5)": jc.integrator.FixedStep(2e-5),
}
LAWS = (jc.flank.Nordin, jc.flank.Stop, jc.flank.ElastoBacklash)


# What a feature adds to the drive: by field of a mechanism, and as arguments of its "gear".
Parts = dict[str, dict[str, Any]]


def _cam_parts() -> Parts:
    rate, preload = 400.0, 4.0
    return {
        "bodies": {"follower": jc.Body(0.15, 1e-4)},
        "connections": {"F": jc.Connection(jc.joint.Prismatic(), "ground", "follower", axis="y")},
        "loads": {
            "return spring": jc.load.JointSpring("F", rate, rest=-preload / rate, damping=0.5)
        },
        "couplings": {
            "cam": jc.coupling.Cam(
                "A", "F", lambda a: 4e-3 * (1 - jnp.cos(12 * a)), stiffness=1e5, damping=20.0
            )
        },
    }


# Each feature's parts by a number that only tells variants apart, and the number that is varied.
FEATURES: dict[str, tuple[Callable[[int], Parts], Callable[[jc.Mechanism], Any]]] = {
    "play": (
        lambda k: {"gear": {"play": jc.clearance.Backlash(6e-3, law=LAWS[k % len(LAWS)]())}},
        lambda rig: rig.couplings["gear"].play.play,
    ),
    "efficiency": (
        lambda _: {"gear": {"efficiency": jc.coupling.Efficiency(0.7, 0.5, presliding=3e-3)}},
        lambda rig: rig.couplings["gear"].efficiency.forwards,
    ),
    "stop": (
        lambda _: {
            "loads": {"stop": jc.load.JointStop("A", None, 0.06, stiffness=800.0, damping=2.0)}
        },
        lambda rig: rig.loads["stop"].upper,
    ),
    "one-way": (
        lambda _: {
            "bodies": {"flywheel": jc.Body(1.0, 0.08)},
            "connections": {"W": jc.Connection(jc.joint.Revolute(), "ground", "flywheel")},
            "couplings": {"freewheel": jc.coupling.OneWay("A", "W", stiffness=500.0, damping=1.0)},
        },
        lambda rig: rig.bodies["flywheel"].inertia,
    ),
    "cam": (lambda _: _cam_parts(), lambda rig: rig.bodies["follower"].mass),
    "dry friction": (
        lambda _: {"loads": {"friction": jc.load.JointFriction("A", 1.2, presliding=1e-3)}},
        lambda rig: rig.loads["friction"].torque,
    ),
    "servo limit": (
        lambda _: {
            "loads": {
                "servo": jc.load.Servo(
                    "A", lambda t: 0.3 * jnp.sin(9.0 * t), 60.0, kd=2.0, torque_limit=3.0
                )
            }
        },
        lambda rig: rig.loads["servo"].torque_limit,
    ),
}


def drive(first: str, second: str, variant: int) -> jc.Mechanism:
    """The drive with two features."""
    parts = [FEATURES[name][0](variant) for name in (first, second)]
    merged = lambda kind: {key: x for own in parts for key, x in own.get(kind, {}).items()}
    motor = jc.coupling.Motor(5e-4)
    gear = jc.coupling.Gear(motor, "A", 20.0, stiffness=900.0, damping=1.5, **merged("gear"))
    swinging = lambda t: 0.25 * jnp.sin(12.0 * t) + 0.05 * jnp.sin(31.0 * t)
    return jc.Mechanism(
        {"arm": jc.Body(1.5, 0.2, (0.08, 0.0)), **merged("bodies")},
        {"A": jc.Connection(jc.joint.Revolute(), "ground", "arm"), **merged("connections")},
        {
            "gravity": jc.load.Gravity((0.0, -9.81)),
            "torque": jc.load.JointTorque("gear.motor", swinging),
            **merged("loads"),
        },
        couplings={"gear": gear, **merged("couplings")},
    )


def _response(run: jc.Trajectory) -> Any:
    return jnp.sqrt(jnp.mean(run.coordinate("A") ** 2))


def problem(first: str, second: str, variant: int, integrator: Any) -> jc.Problem:
    """What is asked of a pair."""
    rig = drive(first, second, variant)
    places = {name: FEATURES[name][1] for name in (first, second)}
    places["inertia"] = lambda rig: rig.bodies["arm"].inertia
    sizes = {name: abs(float(np.max(np.abs(place(rig))))) for name, place in places.items()}
    variables = {
        name: jc.Variable(place, tolerance=1e-3 * sizes[name]) for name, place in places.items()
    }
    return jc.Problem(
        rig, _response, variables, duration=DURATION, integrator=integrator, save=SAVES
    )


def attack(pair: tuple[str, str], number: int, rungs: dict[str, Any]) -> list[Row]:
    """All slopes of one pair."""
    asked = {rung: problem(*pair, number, integrator) for rung, integrator in rungs.items()}
    known = differences(problem(*pair, number, RUNGS["Adaptive"]), TOLERANCES)
    assert not isinstance(known, str), known
    where = number, " and ".join(pair)
    return [
        row
        for rung, own in asked.items()
        for row in judged((*where, rung), own.names, known, told(lambda own=own: own), LIMIT)
    ]


def pairs() -> list[tuple[str, str]]:
    """All pairs of features."""
    return list(itertools.combinations(FEATURES, 2))


def main() -> None:
    given = arguments(
        str(__doc__),
        only={"nargs": "*", "choices": list(FEATURES), "help": "pairs with all of them"},
        rung={"nargs": "*", "choices": list(RUNGS), "default": list(RUNGS)},
        minutes=MINUTES,
    )
    chosen = [(k, p) for k, p in enumerate(pairs()) if set(given.only or ()) <= set(p)]
    chosen = chosen[:: len(chosen) // 3] if given.quick else chosen
    rungs = {name: RUNGS[name] for name in given.rung}
    cases = (functools.partial(attack, pair, number, rungs) for number, pair in chosen)
    run_attack("benchmarks.attack_pairs", cases, given)


if __name__ == "__main__":
    main()
