"""What derivatives cost: a run with k slopes over the run alone, by rung, alone and in a batch; the
gradient in reverse mode; and how much longer the program with slopes compiles.

Ratios are medians over turns of one process, in which the programs follow each other: others load
the machine. The response is a sum of coordinates at the end: it costs nothing, so the ratio is the
loop's. Of `ImplicitStep` discrete slopes are measured, which are known in every scene, and in the
bouncing journal those of the motion. Slopes are compared with those in other steps or at another
tolerance, which is counted in; where they are nan at the end is said, and costs as much.
"""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import by_turns, run_tables, seconds_to_compile
from jaxclear.ground.printing import as_typed

SAVES, DURATION, BATCH = 21, 0.1, 64
I = jc.integrator  # noqa: E741


def bouncing() -> jc.Mechanism:
    """A journal that bounces in its bearing without rubbing, some six times in a run."""
    contact = jc.contact.Flores(stiffness=1e9, restitution=0.8)
    bearing = jc.clearance.PlanarJournalBearing(contact, clearance=1e-3)
    return jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {"gravity": jc.load.Gravity((0.0, -9.81))},
        speeds={"journal": (0.0, -0.05, 0.0)},
    )


SLOPES, REVERSE = (1, 4), "reverse"
# Scene, mechanism, integrator, and whether slopes are those of the steps.
CASES: tuple[tuple[str, Callable[[], jc.Mechanism], Any, bool], ...] = (
    ("slider-crank", jc.scenes.slider_crank, I.FixedStep(2e-5), False),
    ("slider-crank", jc.scenes.slider_crank, I.Adaptive(), False),
    ("slider-crank", jc.scenes.slider_crank, I.ImplicitStep(1e-4), True),
    ("slider-crank", jc.scenes.slider_crank, I.NonColliding(1e-4), False),
    ("slider-crank", jc.scenes.slider_crank, I.MoreauJean(1e-4), False),
    ("bouncing journal", bouncing, I.ImplicitStep(1e-4, rebound=1.0), False),
)


def problem(
    rig: jc.Mechanism, integrator: jc.integrator.AbstractIntegrator, duration: float
) -> jc.Problem:
    """A scene, the clearance of its joint and the masses of its links varied."""
    variables = {
        joint: jc.Variable(lambda m, n=joint: m.connections[n].joint.clearance, tolerance=1e-5)
        for joint in rig.topology.clearances
    }
    for name in rig.bodies:
        variables[name] = jc.Variable(lambda m, n=name: m.bodies[n].mass, tolerance=1e-3)
    end = lambda run: jnp.sum(run.history.states[-1][:4])
    return jc.Problem(rig, end, variables, duration=duration, integrator=integrator, save=SAVES)


def with_slopes(
    asked: jc.Problem, count: int | str, discrete: bool
) -> tuple[Callable[..., Any], Any]:
    """(response, its slopes along `count` directions) by numbers and values, and these numbers; by
    values alone for 0; with its gradient for `REVERSE`."""
    value = np.asarray(asked.nominal())
    numbers, rest = eqx.partition(asked, eqx.is_array)

    def function(numbers, values):
        whole = eqx.combine(numbers, rest)
        answer = lambda v: whole.evaluate(v, discrete_derivatives=discrete).responses["response"]
        if count == 0:
            return answer(values)
        if count == REVERSE:
            return jax.value_and_grad(answer)(values)
        directions = np.random.default_rng(0).normal(size=(count, len(value))) * value
        push = lambda way: jax.jvp(answer, (values,), (way,))
        return jax.vmap(push, out_axes=(None, 0))(jnp.asarray(directions))

    return function, numbers


def measured(
    asked: jc.Problem, counts: tuple[Any, ...], batch: int, discrete: bool
) -> dict[str, Any]:
    """Ratios of run and compilation, alone (`batch` 0) or in a batch."""
    value = asked.nominal()
    spread = 1 + 1e-3 * np.random.default_rng(1).normal(size=(max(batch, 1), len(value)))
    values = value * jnp.asarray(spread) if batch else value
    cases, compiling = {}, {}
    for count in (0, *counts):
        function, numbers = with_slopes(asked, count, discrete)
        each = jax.vmap(function, (None, 0)) if batch else function
        program, compiling[count] = seconds_to_compile(each, numbers, values)
        cases[count] = functools.partial(program, numbers, values)
    cpu, ratios, turns = by_turns(cases, 0, 2.0)
    row = {"samples": max(batch, 1), "value [ms]": 1e3 * cpu}
    row |= {f"+{count}": ratios.get(count) for count in SLOPES}
    row |= {REVERSE: ratios.get(REVERSE), "variables of reverse": len(value)}
    row["compile, value [s]"] = compiling[0]
    for count, label in ((1, "+1"), (REVERSE, REVERSE)):
        row[f"compile, {label} over it"] = compiling.get(count, np.nan) / compiling[0]
    known = bool(np.all(np.isfinite(cases[1]()[1])))
    return row | {"slopes known": known, "turns": turns}


def rows_of(options: Any) -> list[dict[str, Any]]:
    """A row for each case alone, and in a batch."""
    rows = []
    for scene, build, integrator, discrete in CASES[:1] if options.quick else CASES:
        asked = problem(build(), integrator, DURATION / 4 if options.quick else DURATION)
        for batch, counts in ((0, (*SLOPES, REVERSE)), (BATCH, SLOPES)):
            found = measured(asked, counts, batch, discrete)
            name = as_typed(integrator) + (", discrete" if discrete else "")
            rows.append({"scene": scene, "integrator": name} | found)
            print(rows[-1], flush=True)
        jax.clear_caches()
    return rows


if __name__ == "__main__":
    run_tables({"slopes over the value, CPU time": rows_of})
