"""What play in the drives of an arm costs: a step beside one without play, compiling, the place of
the tip for its cost, and its slope by all plays at once.

A planar arm of N links, each joint driven by a motor of 2e-5 kg m^2 behind a gear of ratio 100.
Without play the motor's inertia is the joint's own; with play its angle, and the shaft's far end in
the gap, are states beside the arm's. CPU times: of the whole process, so that a loaded machine
counts less.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import report, sign

# Beyond 18 links XLA factorises the mass matrix, and compiles the step for minutes.
LINKS, QUICK_LINKS = (1, 3, 7, 15, 30), (1, 3)
PLAY, STEP, STEPS, REPEATS = 6e-4, 2e-5, 400_000, 5
TIP_STEPS = (1000, 2000, 4000, 8000)
EXACT = jc.integrator.Adaptive(rtol=1e-12, atol=1e-13)


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="arms of up to three links")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here")
    return parser.parse_args()


def arm(links: int, plays: Any = None) -> jc.Mechanism:
    """The arm; `plays` [rad] of its gears, None without."""
    bodies, joints, loads, couplings = {}, {}, {}, {}
    for i in range(links):
        name, link = f"J{i}", f"link{i}"
        bodies[link] = jc.Body(2.0 / (i + 1), 0.02 / (i + 1), (0.15, 0.0))
        inner = jc.Marker("ground") if i == 0 else jc.Marker(f"link{i - 1}", (0.3, 0.0))
        joints[name] = jc.Connection(jc.joint.Revolute(), inner, jc.Marker(link))
        more = {}
        if plays is not None:
            more = {"play": jc.clearance.Backlash(plays[i]), "stiffness": 2e4, "damping": 15.0}
        motor = jc.coupling.Motor(2e-5)
        couplings[name] = jc.coupling.Gear(motor, name, 100.0, **more)
        loads[f"servo{i}"] = jc.load.JointSpring(f"{name}.motor", stiffness=4e-3, damping=4e-4)
        loads[f"torque{i}"] = jc.load.JointTorque(
            f"{name}.motor", lambda t, i=i: 1e-2 * jnp.sin((3 + i) * t)
        )
    return jc.Mechanism(bodies, joints, loads, couplings=couplings)


def cpu(run: Callable[[], Any]) -> float:
    """CPU time [s] of a call."""
    begun = time.process_time()
    jax.block_until_ready(jax.tree.leaves(run()))
    return time.process_time() - begun


def step_cost(links: int) -> dict[str, float]:
    """CPU time of the first, short run, and of a step [ns], without play and with: the least of
    some rounds in which both take turns."""
    step, steps = jc.integrator.FixedStep(STEP), STEPS // links**2
    rigs = {"without": arm(links), "with play": arm(links, (PLAY,) * links)}
    run = lambda name, count: cpu(
        lambda: jc.simulate(rigs[name], count * STEP, save=3, integrator=step, verify=False)
    )
    row: dict[str, float] = {"links": links}
    row |= {f"first run [s], {name}": run(name, 50) for name in rigs}
    rounds = [
        {(name, count): run(name, count) for name in rigs for count in (50, steps)}
        for _ in range(REPEATS)
    ]
    least = {which: min(each[which] for each in rounds) for which in rounds[0]}
    for name in rigs:
        row[f"a step [ns], {name}"] = 1e9 * (least[name, steps] - least[name, 50]) / (steps - 50)
    return row | {"ratio": row["a step [ns], with play"] / row["a step [ns], without"]}


def tip(run: Any, links: int) -> np.ndarray:
    """Places of the arm's tip over time [m]."""
    body = run.body(f"link{links - 1}")
    return np.asarray(body.com)[:, :2] + 0.15 * np.asarray(body.rotation)[:, :2, 0]


def tip_error(links: int, duration: float = 1.0) -> list[dict[str, float]]:
    """How far the tip is off beside what the play does to it, by the number of steps."""
    loose, tight = arm(links, (PLAY,) * links), arm(links)
    exact, ideal = (
        tip(jc.simulate(rig, duration, save=101, integrator=EXACT, verify=False), links)
        for rig in (loose, tight)
    )
    effect = np.max(np.abs(exact - ideal))
    rows = []
    for count in TIP_STEPS:
        step = jc.integrator.FixedStep(duration / count)
        run = lambda step=step: jc.simulate(
            loose, duration, save=101, integrator=step, verify=False
        )
        off = np.max(np.abs(tip(run(), links) - exact))
        rows.append(
            {
                "links": links,
                "steps": count,
                "off beside the play's effect": float(off / effect),
                "a run [s]": min(cpu(run) for _ in range(REPEATS)),
            }
        )
    return rows


def slope(links: int) -> dict[str, float]:
    """Of the tip's height at the end by all plays: one derivative beside one run, and how far it is
    from differences."""

    def height(plays):
        run = jc.simulate(arm(links, plays), 0.5, save=3, throw=False, verify=False)
        angles = sum(run.coordinate(f"J{i}")[-1] for i in range(links))
        return jnp.sin(angles)

    plays = jnp.full(links, PLAY)
    gradient = jax.jit(jax.jacfwd(height))
    one = jax.jit(height)
    first = cpu(lambda: gradient(plays))
    cpu(lambda: one(plays))
    each = {
        "one run [s]": min(cpu(lambda: one(plays)) for _ in range(REPEATS)),
        "derivative [s]": min(cpu(lambda: gradient(plays)) for _ in range(REPEATS)),
    }
    shift = 1e-7
    found = np.asarray(gradient(plays))
    moved = [
        (one(plays.at[i].add(shift)) - one(plays.at[i].add(-shift))) / (2 * shift)
        for i in range(links)
    ]
    off = float(np.max(np.abs(found - np.asarray(moved))) / np.max(np.abs(found)))
    return {"links": links, "first [s]": first, **each, "off from differences": off}


def main() -> None:
    asked = options()
    links = QUICK_LINKS if asked.quick else LINKS
    costs = [step_cost(count) for count in links]
    report("drives: a Runge-Kutta step with play and without", costs, asked)
    tips = [row for count in links[:2] for row in tip_error(count)]
    report("drives: the place of the tip for its cost", tips, asked)
    slopes = [slope(count) for count in links[:2]]
    report("drives: slope of the tip by all plays", slopes, asked)
    sign("benchmarks.claims.drives", asked.json)


if __name__ == "__main__":
    main()
