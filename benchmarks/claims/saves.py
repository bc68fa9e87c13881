"""What saving often costs: a run with 1920 saving times over the same run with 4, by rung, alone
and in a batch: of the slider-crank, whose surfaces do not wear or do, and of the spatial four-bar,
whose map has 144 times 320 cells. `--json benchmarks/results/saves.json` keeps rows of earlier
calls beside those measured now.

Fixed steps fit both intervals, so that both runs take the same steps. Those that follow an error
end at every saving time, and there are more of them: their number stands beside the time. Where
surfaces wear they are worn at every saving time, or at the most so often as they say.
"""

import dataclasses
import functools
from collections.abc import Callable

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, report, side_by_side, sign, stored_rows
from jaxclear.commands.four_bar import CELLS
from jaxclear.native import explain
from jaxclear.native.compiled import AROUND_A_KERNEL, QUICK
from jaxclear.simulation.initial_state import beginning
from jaxclear.simulation.loop import run
from jaxclear.simulation.simulate import is_all_kernel
from jaxclear.results.state_history import State

RUNGS = {
    "FixedStep(2e-5)": jc.integrator.FixedStep(2e-5),
    "FixedStep(2e-5, 'semi_implicit')": jc.integrator.FixedStep(2e-5, "semi_implicit"),
    "ImplicitStep(2e-5)": jc.integrator.ImplicitStep(2e-5),
    "MoreauJean(2e-5)": jc.integrator.MoreauJean(2e-5),
    "NonColliding(2e-5)": jc.integrator.NonColliding(2e-5),
    "Adaptive()": jc.integrator.Adaptive(),
}
UPDATES = 500


def rarely(build: Callable[[], jc.Mechanism]) -> jc.Mechanism:
    """A scene whose surfaces wear at the most so often in a run."""
    worn = lambda each: isinstance(each, jc.Wearing)
    rarer = lambda each: dataclasses.replace(each, updates=UPDATES) if worn(each) else each
    return jax.tree.map(rarer, build(), is_leaf=worn)


SLIDER = functools.partial(jc.scenes.slider_crank, wear=True)
FOUR_BAR = functools.partial(jc.scenes.four_bar, "spatial", cells=CELLS)
SCENES = {
    "slider-crank": jc.scenes.slider_crank,
    "slider-crank that wears": SLIDER,
    f"slider-crank that wears, {UPDATES} updates": functools.partial(rarely, SLIDER),
    "four-bar that wears": FOUR_BAR,
    f"four-bar that wears, {UPDATES} updates": functools.partial(rarely, FOUR_BAR),
}
OFTEN, SELDOM, BATCH = 1920, 4, 64
# Steps between two of the many saving times. 3 saving intervals fit 1919 of them but for one step,
# which changes nothing that is measured.
STEPS = 3
STEP = 2e-5


def program(scene: str, integrator: Any, saves: int, batch: int) -> Any:
    """The compiled run, from consistent coordinates to all of its numbers, and what it is given."""
    rig = integrator.formulation.modelled(SCENES[scene]())
    rig, start, past = beginning(rig, integrator.formulation, State())[:3]
    times = jnp.linspace(0.0, (OFTEN - 1) * STEPS * STEP, saves)
    arrays, rest = eqx.partition((rig, integrator, past), eqx.is_array)

    def function(arrays, speeds):
        rig, integrator, past = eqx.combine(arrays, rest)
        found = run(rig, start.coordinates, speeds, times, integrator, past=past)
        told = found.states, found.invariants, found.stats, found.outcome, found.worn
        return eqx.filter(told, eqx.is_array)

    speeds = start.speeds
    if batch:
        speeds = speeds * (1 + 1e-3 * np.random.default_rng(0).normal(size=(batch, 1)))
        function = jax.vmap(function, (None, 0))
    options = QUICK if is_all_kernel(rig, integrator) else AROUND_A_KERNEL
    compiled = jax.jit(function).lower(arrays, speeds).compile(compiler_options=options)
    return lambda: compiled(arrays, speeds)


def measured(scene: str, name: str, batch: int, repeats: int) -> dict[str, Any]:
    """One row."""
    cases = {str(saves): program(scene, RUNGS[name], saves, batch) for saves in (OFTEN, SELDOM)}
    stats = {saves: case()[2] for saves, case in cases.items()}
    taken = {saves: float(np.mean(of.accepted_steps)) for saves, of in stats.items()}
    told = {explain(int(np.max(of.verdict))) for of in stats.values()}
    cpu = {saves: spent[1] for saves, spent in side_by_side(cases, repeats).items()}
    many, few = str(OFTEN), str(SELDOM)
    return {
        "scene": scene,
        "rung": name,
        "samples": max(batch, 1),
        f"{few} saves [ms]": 1e3 * cpu[few],
        f"{many} saves [ms]": 1e3 * cpu[many],
        "ratio": cpu[many] / cpu[few],
        "ratio of steps": taken[many] / taken[few],
        "loops": " ".join(sorted(told)),
    }


def main() -> None:
    options = arguments(
        __doc__,
        scene={"choices": list(SCENES), "nargs": "*", "default": list(SCENES), "help": "which"},
        rung={"choices": list(RUNGS), "nargs": "*", "default": list(RUNGS), "help": "which ones"},
        batch={"type": int, "nargs": "*", "default": [0, BATCH], "help": "0: a run alone"},
    )
    for scene in options.scene:
        title = f"{OFTEN} saving times over {SELDOM}, CPU time: {scene}"
        for name in options.rung[:1] if options.quick else options.rung:
            for batch in (0,) if options.quick else options.batch:
                row = measured(scene, name, batch, 3 if options.quick else 7)
                same = lambda old: (old["rung"], old["samples"]) == (row["rung"], row["samples"])
                rows = [old for old in stored_rows(title, options) if not same(old)] + [row]
                report(title, rows, options)
                sign("benchmarks.claims.saves", options.json, [title])


if __name__ == "__main__":
    main()
