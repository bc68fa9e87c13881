"""What derivatives cost: a run with k slopes over the run alone, by rung, alone and in a batch; the
gradient in reverse mode; and how much longer the program with slopes compiles.

Ratios are medians over turns of one process, in which the programs follow each other: others load
the machine. `--json benchmarks/results/slopes.json` keeps rows of earlier calls beside those
measured now. The response is a sum of coordinates at the end: it costs nothing, so the ratio is the
loop's. Of `ImplicitStep` slopes of the motion are measured, and discrete ones. Where run and motion
have parted those of the motion are nan and cost little: in the slider-crank from its first impacts
on, of semi-implicit steps too. In the bouncing journal they are known to the end. Slopes
of all but `Adaptive` are compared with those in other steps, which is counted in. Rungs whose
derivatives through contacts are refused are measured as well: what they cost is that of their
loops. The friction of the antenna's
joints is three zones for compliant rungs, Coulomb's for the others.
"""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, by_turns, report, seconds_to_compile, sign, stored_rows
from jaxclear.simulation.derivatives import backwards, is_compared
from jaxclear.studies.run_experiment import RunExperiment

STEP, SAVES, DURATION = 2e-5, 21, 0.1
RUNGS = {
    "FixedStep(2e-5)": jc.integrator.FixedStep(STEP),
    "FixedStep(2e-5, 'semi_implicit')": jc.integrator.FixedStep(STEP, "semi_implicit"),
    "ImplicitStep(1e-4)": jc.integrator.ImplicitStep(1e-4),
    "ImplicitStep(1e-4), discrete": jc.integrator.ImplicitStep(1e-4),
    "ImplicitStep(1e-4, rebound=1.0)": jc.integrator.ImplicitStep(1e-4, rebound=1.0),
    "NonColliding(1e-4)": jc.integrator.NonColliding(1e-4),
    "MoreauJean(1e-4)": jc.integrator.MoreauJean(1e-4),
    "Adaptive()": jc.integrator.Adaptive(),
    "FixedStep(steps_per_save=250)": jc.integrator.FixedStep(steps_per_save=250),
}


def bouncing() -> jc.Mechanism:
    """A journal that bounces in its bearing without rubbing, some six times in a run: its slopes
    are known to the end."""
    contact = jc.contact.Flores(stiffness=1e9, restitution=0.8)
    bearing = jc.clearance.PlanarJournalBearing(contact, clearance=1e-3)
    return jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {"gravity": jc.load.Gravity((0.0, -9.81))},
        speeds={"journal": (0.0, -0.05, 0.0)},
    )


SCENES = {
    "slider-crank": jc.scenes.slider_crank,
    "four-bar": jc.scenes.four_bar,
    "antenna": jc.scenes.antenna,
    "bouncing journal": bouncing,
}
# Of these rungs the discrete derivative is measured.
DISCRETE = ("ImplicitStep(1e-4), discrete",)
# Rungs whose contacts are rigid.
RIGID = (jc.integrator.NonColliding, jc.integrator.MoreauJean)
SLOPES = (1, 2, 4, 16)
REVERSE = "reverse"


def problem(
    scene: str, integrator: jc.integrator.AbstractIntegrator, duration: float, saves: int = SAVES
) -> Any:
    """A scene, the clearance of its joint and the masses of its links varied."""
    rig = SCENES[scene]()
    if scene == "antenna" and not isinstance(integrator, RIGID):
        rig = jc.scenes.antenna(friction="regularised")
    variables = {
        joint: jc.Variable(lambda m, n=joint: m.connections[n].joint.clearance, tolerance=1e-5)
        for joint in rig.topology.clearances
    }
    for name in rig.bodies:
        variables[name] = jc.Variable(lambda m, n=name: m.bodies[n].mass, tolerance=1e-3)
    end = lambda run: jnp.sum(run.history.states[-1][:4])
    return jc.Problem(rig, end, variables, duration=duration, integrator=integrator, save=saves)


def with_slopes(asked: jc.Problem, count: int | str, discrete: bool) -> Callable[..., Any]:
    """(response, its slopes along `count` directions) by values; by values alone for 0; with its
    gradient for `REVERSE`."""
    value = np.asarray(asked.nominal())
    numbers, rest = eqx.partition(asked, eqx.is_array)
    started = functools.partial(RunExperiment.started, discrete=discrete)

    def function(numbers, values):
        whole = eqx.combine(numbers, rest)

        seen = whole.integrator.formulation.modelled(whole.mechanism)
        checked = is_compared(seen, whole.integrator)

        def answer(v):
            if checked:
                return whole.evaluate(v).responses["response"]
            given = whole.experiment, whole.setting(v)
            _, _, run = backwards(whole.integrator)(started, *given)
            return whole.response["response"](run)

        if count == 0:
            return answer(values)
        if count == REVERSE:
            return jax.value_and_grad(answer)(values)
        directions = np.random.default_rng(0).normal(size=(count, len(value))) * value
        push = lambda way: jax.jvp(answer, (values,), (way,))
        return jax.vmap(push, out_axes=(None, 0))(jnp.asarray(directions))

    return lambda values: (function, numbers, values)


def compiled(
    asked: jc.Problem, count: int | str, batch: int, discrete: bool = False
) -> tuple[Any, float, tuple]:
    """(compiled program of the run with slopes, CPU seconds to compile it, what it is given)."""
    value = asked.nominal()
    spread = 1 + 1e-3 * np.random.default_rng(1).normal(size=(max(batch, 1), len(value)))
    values = value * jnp.asarray(spread) if batch else value
    function, numbers, given = with_slopes(asked, count, discrete)(values)
    each = jax.vmap(function, (None, 0)) if batch else function
    return *seconds_to_compile(each, numbers, given), (numbers, given)


def measured(
    scene: str, name: str, asked: jc.Problem, counts: tuple[Any, ...], batch: int, seconds: float
) -> dict[str, Any]:
    """One row: ratios of run and compilation, alone (`batch` 0) or in a batch."""
    cases, compiling = {}, {}
    for count in (0, *counts):
        program, compiling[count], given = compiled(asked, count, batch, name in DISCRETE)
        cases[str(count)] = lambda p=program, g=given: p(*g)
    cpu, ratios, turns = by_turns(cases, "0", seconds)
    row: dict[str, Any] = {"scene": scene, "rung": name, "samples": max(batch, 1)}
    row["value [ms]"] = 1e3 * cpu
    for count in (*SLOPES, REVERSE):
        row[count if count == REVERSE else f"+{count}"] = ratios.get(str(count))
    row["variables of reverse"] = len(asked.variables)
    row["compile, value [s]"] = compiling[0]
    for count in (1, REVERSE):
        label = f"compile, {count if count == REVERSE else f'+{count}'} over it"
        row[label] = compiling[count] / compiling[0] if count in compiling else None
    row["turns"] = turns
    return row


def joined(known: list[dict[str, Any]], found: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of an earlier call with those of this one: cells measured now count, others stay."""
    rows = {row["samples"]: row for row in known}
    for row in found:
        old = rows.get(row["samples"], {})
        kept = {name: old.get(name) for name, cell in row.items() if cell is None}
        rows[row["samples"]] = row | kept
    names = dict.fromkeys(name for row in [*found, *known] for name in row)
    return [{name: rows[own].get(name) for name in names} for own in sorted(rows)]


def main() -> None:
    options = arguments(
        __doc__,
        scene={"choices": list(SCENES), "default": "slider-crank", "help": "which mechanism"},
        rung={"choices": list(RUNGS), "nargs": "*", "default": list(RUNGS), "help": "which ones"},
        slopes={"type": int, "nargs": "*", "default": list(SLOPES), "help": "how many at once"},
        batch={"type": int, "nargs": "*", "default": [0, 64], "help": "0: a run alone"},
        seconds={"type": float, "default": 20.0, "help": "CPU time of the turns of a row"},
    )
    duration = DURATION / 4 if options.quick else DURATION
    for name in options.rung[:1] if options.quick else options.rung:
        integrator = RUNGS[name]
        counted = integrator.steps_between_saves is not None
        asked = problem(options.scene, integrator, duration)
        title = f"slopes over the value, CPU time: {options.scene}, {name}"
        for batch in options.batch:
            slopes = options.slopes[:1] if options.quick else options.slopes
            counts = (*(() if counted else slopes), *(() if batch else (REVERSE,)))
            if counts:
                row = measured(options.scene, name, asked, counts, batch, options.seconds)
                report(title, joined(stored_rows(title, options), [row]), options)
                sign("benchmarks.claims.slopes", options.json, [title])


if __name__ == "__main__":
    main()
