"""What derivatives cost: a run with k slopes over the run alone, by rung, alone and in a batch, and
how much longer the program with slopes compiles. `--json benchmarks/results/slopes.json` keeps it.

The response is a sum of coordinates at the end: it costs nothing, so the ratio is the loop's.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, report, seconds_to_compile, side_by_side

RUNGS = {
    "FixedStep(2e-5)": jc.integrator.FixedStep(2e-5),
    "FixedStep(2e-5, 'semi_implicit')": jc.integrator.FixedStep(2e-5, "semi_implicit"),
    "ImplicitStep(1e-4)": jc.integrator.ImplicitStep(1e-4),
    "MoreauJean(1e-4)": jc.integrator.MoreauJean(1e-4),
}
SLOPES = (1, 2, 4, 16)
BATCH = 64


def problem(integrator: jc.integrator.AbstractIntegrator, duration: float) -> jc.Problem:
    """The four-bar, its clearance and the masses of its links varied."""
    rig = jc.scenes.four_bar()
    joint = next(n for n in rig.topology.clearances)
    variables = {
        "clearance": jc.Variable(lambda m: m.connections[joint].joint.clearance, tolerance=1e-5)
    }
    for name in rig.bodies:
        variables[name] = jc.Variable(lambda m, n=name: m.bodies[n].mass, tolerance=1e-3)
    end = lambda run: jnp.sum(run.history.states[-1][:4])
    return jc.Problem(rig, end, variables, duration=duration, integrator=integrator, save=21)


def with_slopes(asked: jc.Problem, count: int) -> Callable[..., Any]:
    """(response, its slopes along `count` directions) by values; by values alone for 0."""
    value = np.asarray(asked.nominal())
    random = np.random.default_rng(0)
    directions = jnp.asarray(random.normal(size=(count, len(value))) * value)
    numbers, rest = eqx.partition(asked, eqx.is_array)

    def function(numbers, values):
        answer = lambda v: (
            eqx.combine(numbers, rest).evaluate(v, discrete_derivatives=True).responses["response"]
        )
        if count == 0:
            return answer(values)
        push = lambda way: jax.jvp(answer, (values,), (way,))
        return jax.vmap(push, out_axes=(None, 0))(directions)

    return lambda values: (function, numbers, values)


def measured(name: str, asked: jc.Problem, counts: tuple[int, ...], batch: int) -> dict[str, Any]:
    """One row: ratios of run and compilation, alone (`batch` 0) or in a batch."""
    value = asked.nominal()
    spread = 1 + 1e-3 * np.random.default_rng(1).normal(size=(batch, len(value)))
    values = value if batch == 0 else value * jnp.asarray(spread)
    programs, compiled = {}, {}
    for count in (0, *counts):
        function, numbers, given = with_slopes(asked, count)(values)
        each = jax.vmap(function, (None, 0)) if batch else function
        programs[count], compiled[count] = seconds_to_compile(each, numbers, given)
    cases = {
        str(count): (lambda p=program: p(numbers, values)) for count, program in programs.items()
    }
    cpu = {name: spent[1] for name, spent in side_by_side(cases).items()}
    row: dict[str, Any] = {"rung": name, "samples": max(batch, 1), "value [ms]": 1e3 * cpu["0"]}
    for count in SLOPES:
        row[f"+{count}"] = cpu[str(count)] / cpu["0"] if count in counts else float("nan")
    row["compile, value [s]"] = compiled[0]
    row["compile, +1 over it"] = compiled[1] / compiled[0]
    return row


def main() -> None:
    options = arguments(__doc__)
    duration = 0.05 if options.quick else 0.2
    rungs = dict(list(RUNGS.items())[:1]) if options.quick else RUNGS
    rows = []
    for name, integrator in rungs.items():
        asked = problem(integrator, duration)
        rows.append(measured(name, asked, SLOPES[:1] if options.quick else SLOPES, 0))
        if not options.quick:
            rows.append(measured(name, asked, (1, 4), BATCH))
    report("slopes over the value, CPU time", rows, options)


if __name__ == "__main__":
    main()
