"""What a coupling costs in a Runge-Kutta step, beside the same motion without it: the wheel's
inertia reflected on the pinion's shaft, the shafts left free.

A gear pair, a planetary set of one planet, and a screw press; compiled loops, start-up and
compilation apart. `drift`: largest residual of the couplings over the run.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

import jaxclear as jc
from benchmarks.measure import arguments, report, side_by_side, sign
from jaxclear.simulation.simulate import run
from tests.rigs.planetary import PLANET, RING, SUN, planetary

STEP, SAVES = 1e-4, 11
TURN = jc.joint.Revolute()
R_A, R_B, J_A, J_B = 0.02, 0.06, 1e-4, 2e-3
TEETH = 0.35


def shafts(couplings: dict, alone: bool = False) -> jc.Mechanism:
    """A pinion and a wheel under torques; alone, the pinion with the wheel's inertia."""
    bodies = {"pinion": jc.Body(0.3, J_A), "wheel": jc.Body(1.0, J_B)}
    connections = {
        "A": jc.Connection(TURN, "ground", "pinion"),
        "B": jc.Connection(TURN, jc.Marker("ground", (R_A + R_B, 0.0)), jc.Marker("wheel")),
    }
    loads: dict[str, Any] = {"m": jc.load.JointTorque("A", 0.2)}
    if alone:
        rotor = jc.load.RotorInertia("A", J_B * (R_A / R_B) ** 2)
        return jc.Mechanism(
            {"pinion": bodies["pinion"]}, {"A": connections["A"]}, loads | {"wheel": rotor}
        )
    return jc.Mechanism(bodies, connections, loads, couplings=couplings)


def press(couplings: dict) -> jc.Mechanism:
    """A nut that slides and a spindle that turns."""
    return jc.Mechanism(
        {"spindle": jc.Body(1.0, (2e-4, 2e-4, 3e-4)), "nut": jc.Body(2.0, (1e-3, 1e-3, 1e-3))},
        {
            "turn": jc.Connection(TURN, "ground", "spindle"),
            "slide": jc.Connection(jc.joint.Prismatic(), "ground", "nut"),
            "guide": jc.Connection(jc.joint.Cylindrical(), "spindle", "nut"),
        },
        {"g": jc.load.Gravity((0.0, 0.0, -9.81)), "t": jc.load.JointTorque("turn", 0.05)},
        couplings=couplings,
    )


def cases() -> dict[str, jc.Mechanism]:
    gear, ratio, differential = jc.coupling.Gear, jc.coupling.Ratio, jc.coupling.Differential

    def meshes(angle):
        return {
            "inner": gear("S", "P", PLANET / SUN, pressure_angle=angle),
            "outer": gear("P", "R", RING / PLANET, internal=True, pressure_angle=angle),
        }

    return {
        "gear pair, one shaft with reflected inertia": shafts({}, alone=True),
        "gear pair, two free shafts": shafts({}),
        "gear pair, Ratio": shafts({"mesh": ratio("B", "A", -R_A / R_B)}),
        "gear pair, Gear": shafts({"mesh": gear("A", "B", R_B / R_A)}),
        "gear pair, Gear with involutes": shafts(
            {"mesh": gear("A", "B", R_B / R_A, pressure_angle=TEETH)}
        ),
        "gear pair, Belt": shafts({"mesh": jc.coupling.Belt("A", "B", R_A, R_B)}),
        "planetary set, all free": planetary({}),
        "planetary set, Differential": planetary({"w": differential("R", "S", "C", SUN / RING)}),
        "planetary set, two Gears": planetary(meshes(None)),
        "planetary set, two Gears with involutes": planetary(meshes(TEETH)),
        "screw press, both free": press({}),
        "screw press, Ratio": press({"thread": ratio("slide", "turn", 1e-3)}),
        "screw press, Screw": press({"thread": jc.coupling.Screw("guide", 6.3e-3)}),
    }


def program(mechanism: jc.Mechanism, steps: int) -> tuple[Any, Any]:
    """(a compiled run, its trajectory)."""
    start = jc.assemble(mechanism)
    times = jnp.linspace(0.0, steps * STEP, SAVES)
    compiled = eqx.filter_jit(run)
    integrator = jc.integrator.FixedStep(STEP)
    go = lambda: compiled(mechanism, start.coordinates, start.speeds, times, integrator)
    return (lambda: go().states), go()


def main() -> None:
    options = arguments(__doc__)
    steps = 2000 if options.quick else 20000
    made = {name: program(mechanism, steps) for name, mechanism in cases().items()}
    spent = side_by_side({name: go for name, (go, _) in made.items()})
    rows = [
        {
            "mechanism": name,
            "CPU [ns/step]": spent[name][1] / steps * 1e9,
            "drift": max((float(x.max()) for n, x in found.drift().items()), default=0.0),
        }
        for name, (_, found) in made.items()
    ]
    report("couplings: a Runge-Kutta step with and without", rows, options)
    sign("benchmarks.claims.couplings", options.json)


if __name__ == "__main__":
    main()
