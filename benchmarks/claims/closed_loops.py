"""What it costs a step to close loops anew behind it, and how far they are open without.

The same mechanism by the same steps, its loops held by Baumgarte's terms and by projection: alone
and as 16 samples of a batch. Mechanisms have no contacts, so that a step is as cheap as steps get.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, by_turns, report, sign
from jaxclear.simulation.simulate import run

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


def main() -> None:
    asked = arguments(__doc__)
    duration, seconds = (0.2, 0.5) if asked.quick else (2.0, 4.0)
    rigs = ("four-bar",) if asked.quick else RIGS
    rows = [row(rig, name, duration, seconds) for rig in rigs for name in STEPS]
    report("closing loops behind a step", rows, asked)
    sign("benchmarks.claims.closed_loops", asked.json)


if __name__ == "__main__":
    main()
