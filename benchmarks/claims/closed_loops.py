"""What it costs a step to close loops anew behind it, and how far they are open without; what it
costs a run to look for singular positions, and how many it finds.

The same mechanism by the same steps, its loops held by Baumgarte's terms and by projection: alone
and as 16 samples of a batch. Mechanisms have no contacts, so that a step is as cheap as steps get.
Samples of a batch look for no singular positions.
"""

import time

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, by_turns, report, sign
from jaxclear.simulation.simulate import run
from jaxclear.simulation.singular_positions import singular_positions

SAMPLES = 16
STEPS = {
    "ImplicitStep, 1e-4 s": jc.integrator.ImplicitStep(1e-4),
    "MoreauJean, 1e-4 s": jc.integrator.MoreauJean(1e-4),
    "NonColliding, 1e-4 s": jc.integrator.NonColliding(1e-4),
    "FixedStep heun, 1e-4 s": jc.integrator.FixedStep(1e-4, "heun"),
    "FixedStep rk4, 1e-4 s": jc.integrator.FixedStep(1e-4),
}


def held(rig: jc.Mechanism, stabilisation: Any) -> jc.Mechanism:
    parts = rig.bodies, rig.connections, rig.loads
    return jc.Mechanism(*parts, **rig.given, stabilisation=stabilisation)


RIGS = {
    "four-bar": lambda: jc.scenes.four_bar("ideal"),
    "slider-crank": lambda: jc.scenes.slider_crank("ideal"),
    "3-RSR": lambda: jc.scenes.parallel_3rsr("ideal"),
}


def runner(rig: jc.Mechanism, step: Any, duration: float, samples: int | None) -> tuple:
    """(a run compiled, or so many at once; how far its loops are open at most [m])."""
    start, times = jc.assemble(rig), jnp.linspace(0.0, duration, 3)

    def once(coordinates):
        found = run(rig, coordinates, start.speeds, times, step)
        return found.states, [jnp.max(part) for part in found.drift().values()]

    if samples is None:
        compiled, given = jax.jit(once), start.coordinates
    else:
        compiled, given = jax.jit(jax.vmap(once)), jnp.tile(start.coordinates, (samples, 1))
    opened = max(float(np.max(part)) for part in compiled(given)[1])
    return lambda: compiled(given), opened


def row(rig: str, name: str, duration: float, seconds: float) -> dict[str, Any]:
    """By how much a step costs more, alone and in a batch."""
    found: dict[str, Any] = {"mechanism": rig, "integrator": name}
    for where, samples in (("alone", None), ("in a batch", SAMPLES)):
        cases, opened = {}, {}
        for label, how in (("pulled", jc.Baumgarte()), ("closed", jc.Projection())):
            cases[label], opened[label] = runner(
                held(RIGS[rig](), how), STEPS[name], duration, samples
            )
        spent, ratios, _ = by_turns(cases, "pulled", seconds)
        count = duration / float(STEPS[name].step) * (samples or 1)
        found |= {
            f"a step {where} [us]": 1e6 * spent / count,
            f"closed, {where}": ratios["closed"],
        }
    return found | {"open by [m]": opened["pulled"], "closed: open by [m]": opened["closed"]}


def driven_piston(amplitude: float) -> jc.Mechanism:
    """A slider-crank whose piston is driven to and fro by so much [m]; 0.05 is its full stroke."""
    whole = jc.scenes.slider_crank("ideal")
    push = jc.drive.Harmonic(amplitude, 2.0, offset=0.12)
    ends = jc.Marker("ground", axis="x"), jc.Marker("slider", axis="x")
    own = {
        "O": jc.Connection(jc.joint.Revolute(), "ground", "crank"),
        "G": jc.Connection(jc.joint.Prismatic(drive=push), *ends),
    }
    return jc.Mechanism(whole.bodies, whole.connections | own, whole.loads, guess={"O": 1.2})


LOOKED_AT = {
    "four-bar, crank driven": RIGS["four-bar"],
    "slider-crank, crank driven": RIGS["slider-crank"],
    "3-RSR": RIGS["3-RSR"],
    "slider-crank, piston driven, 0.9 of its stroke": lambda: driven_piston(0.045),
    "slider-crank, piston driven, its full stroke": lambda: driven_piston(0.05),
}


def look(name: str, saves: int) -> dict[str, Any]:
    """What the look takes beside the run itself, first (with compiling) and afterwards."""
    rig = LOOKED_AT[name]()

    def simulated():
        return jc.simulate(rig, 1.0, save=saves, verify=False)

    jax.clear_caches()
    begun = time.process_time()
    found = simulated()
    first = time.process_time() - begun
    jax.clear_caches()
    begun = time.process_time()
    singular_positions(found)
    looked = time.process_time() - begun
    cases = {"run": simulated, "look": lambda: len(singular_positions(found))}
    spent, ratios, _ = by_turns(cases, "run", 1.0)
    return {
        "mechanism": name,
        "saved states": saves,
        "found": len(found.singular_positions),
        "first run [s]": first,
        "first look of it": looked / first,
        "later runs [ms]": 1e3 * spent,
        "later looks of it": ratios["look"],
    }


def main() -> None:
    asked = arguments(__doc__)
    duration, seconds = (0.2, 0.5) if asked.quick else (2.0, 4.0)
    rigs = ("four-bar",) if asked.quick else RIGS
    rows = [row(rig, name, duration, seconds) for rig in rigs for name in STEPS]
    report("closing loops behind a step", rows, asked)
    names = list(LOOKED_AT)[-2:] if asked.quick else LOOKED_AT
    report("singular positions", [look(name, 501) for name in names], asked)
    sign("benchmarks.claims.closed_loops", asked.json)


if __name__ == "__main__":
    main()
