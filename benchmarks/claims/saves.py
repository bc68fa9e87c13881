"""What saving often costs: a run of the slider-crank with 1920 saving times over the same run with
4, by rung, alone and in a batch. `--json benchmarks/results/saves.json` keeps it.

Fixed steps fit both intervals, so that both runs take the same steps. Those that follow an error
end at every saving time, and there are more of them: their number stands beside the time.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, report, side_by_side
from jaxclear.ground.compiling import AROUND_A_KERNEL, ONCE
from jaxclear.native import explain
from jaxclear.simulation.beginning import beginning
from jaxclear.simulation.loop import run
from jaxclear.simulation.simulate import is_all_kernel
from jaxclear.results.saved_state import State

RUNGS = {
    "FixedStep(2e-5)": jc.integrator.FixedStep(2e-5),
    "FixedStep(2e-5, 'semi_implicit')": jc.integrator.FixedStep(2e-5, "semi_implicit"),
    "ImplicitStep(2e-5)": jc.integrator.ImplicitStep(2e-5),
    "MoreauJean(2e-5)": jc.integrator.MoreauJean(2e-5),
    "NonColliding(2e-5)": jc.integrator.NonColliding(2e-5),
    "Adaptive()": jc.integrator.Adaptive(),
}
OFTEN, SELDOM, BATCH = 1920, 4, 64
# Steps between two of the many saving times. 3 saving intervals fit 1919 of them but for one step,
# which changes nothing that is measured.
STEPS = 3
STEP = 2e-5


def program(integrator: Any, saves: int, batch: int) -> Any:
    """The compiled run, from consistent coordinates to all of its numbers, and what it is given."""
    rig = integrator.formulation.seen(jc.scenes.slider_crank())
    rig, start, _, past = beginning(rig, integrator.formulation, State())
    times = jnp.linspace(0.0, (OFTEN - 1) * STEPS * STEP, saves)
    arrays, rest = eqx.partition((rig, integrator, past), eqx.is_array)

    def function(arrays, speeds):
        rig, integrator, past = eqx.combine(arrays, rest)
        found = run(rig, start.coordinates, speeds, times, integrator, past=past)
        return eqx.filter((found.states, found.checks, found.stats, found.outcome), eqx.is_array)

    speeds = start.speeds
    if batch:
        speeds = speeds * (1 + 1e-3 * np.random.default_rng(0).normal(size=(batch, 1)))
        function = jax.vmap(function, (None, 0))
    options = ONCE if is_all_kernel(rig, integrator) else AROUND_A_KERNEL
    compiled = jax.jit(function).lower(arrays, speeds).compile(compiler_options=options)
    return lambda: compiled(arrays, speeds)


def measured(name: str, integrator: Any, batch: int, repeats: int) -> dict[str, Any]:
    """One row."""
    cases = {str(saves): program(integrator, saves, batch) for saves in (OFTEN, SELDOM)}
    stats = {saves: case()[2] for saves, case in cases.items()}
    taken = {saves: float(np.mean(of.accepted_steps)) for saves, of in stats.items()}
    told = {explain(int(np.max(of.verdict))) for of in stats.values()}
    cpu = {saves: spent[1] for saves, spent in side_by_side(cases, repeats).items()}
    many, few = str(OFTEN), str(SELDOM)
    return {
        "rung": name,
        "samples": max(batch, 1),
        f"{few} saves [ms]": 1e3 * cpu[few],
        f"{many} saves [ms]": 1e3 * cpu[many],
        "ratio": cpu[many] / cpu[few],
        "ratio of steps": taken[many] / taken[few],
        "loops": " ".join(sorted(told)),
    }


def main() -> None:
    options = arguments(__doc__)
    rungs = dict(list(RUNGS.items())[:1]) if options.quick else RUNGS
    rows = [
        measured(name, integrator, batch, 3 if options.quick else 7)
        for name, integrator in rungs.items()
        for batch in ((0,) if options.quick else (0, BATCH))
    ]
    report(f"{OFTEN} saving times over {SELDOM}, CPU time", rows, options)


if __name__ == "__main__":
    main()
