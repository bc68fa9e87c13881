"""What derivatives cost: a run with k slopes over the run alone, by rung, alone and in a batch; the
gradient in reverse mode; and how much longer the program with slopes compiles. `--json
benchmarks/results/slopes.json` keeps it: the slider-crank by `FixedStep`, explicit and
semi-implicit, and by `ImplicitStep`. Other scenes and rungs are measured where they are asked for.

The response is a sum of coordinates at the end: it costs nothing, so the ratio is the loop's.
`Adaptive` gives no derivatives through contacts: it is given the mechanism with an ideal joint. The
friction of the antenna's joints is three zones for compliant rungs, Coulomb's for the others.
"""

import json
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import about, arguments, report, seconds_to_compile, side_by_side

STEP, SAVES, DURATION = 2e-5, 21, 0.1
RUNGS = {
    "FixedStep(2e-5)": jc.integrator.FixedStep(STEP),
    "FixedStep(2e-5, 'semi_implicit')": jc.integrator.FixedStep(STEP, "semi_implicit"),
    "ImplicitStep(1e-4)": jc.integrator.ImplicitStep(1e-4),
    "NonColliding(1e-4)": jc.integrator.NonColliding(1e-4),
    "MoreauJean(1e-4)": jc.integrator.MoreauJean(1e-4),
    "Adaptive()": jc.integrator.Adaptive(),
    "FixedStep(steps_per_save=250)": jc.integrator.FixedStep(steps_per_save=250),
}
SCENES = {
    "slider-crank": jc.scenes.slider_crank,
    "four-bar": jc.scenes.four_bar,
    "antenna": jc.scenes.antenna,
}
# Rungs whose contacts are rigid.
RIGID = (jc.integrator.NonColliding, jc.integrator.MoreauJean)
SLOPES = (1, 2, 4, 16)
BATCH = 64
REVERSE = "reverse"


def problem(scene: str, integrator: jc.integrator.AbstractIntegrator, duration: float) -> Any:
    """A scene, the clearance of its joint and the masses of its links varied."""
    follows = integrator.usual_step == 0.0
    rig = SCENES[scene]("ideal") if follows else SCENES[scene]()
    if scene == "antenna" and not (follows or isinstance(integrator, RIGID)):
        rig = jc.scenes.antenna(friction="regularised")
    variables = {
        joint: jc.Variable(lambda m, n=joint: m.connections[n].joint.clearance, tolerance=1e-5)
        for joint in rig.topology.clearances
    }
    for name in rig.bodies:
        variables[name] = jc.Variable(lambda m, n=name: m.bodies[n].mass, tolerance=1e-3)
    end = lambda run: jnp.sum(run.history.states[-1][:4])
    return jc.Problem(rig, end, variables, duration=duration, integrator=integrator, save=SAVES)


def with_slopes(asked: jc.Problem, count: int | str) -> Callable[..., Any]:
    """(response, its slopes along `count` directions) by values; by values alone for 0; with its
    gradient for `REVERSE`."""
    value = np.asarray(asked.nominal())
    numbers, rest = eqx.partition(asked, eqx.is_array)

    def function(numbers, values):
        answer = lambda v: (
            eqx.combine(numbers, rest).evaluate(v, discrete_derivatives=True).responses["response"]
        )
        if count == 0:
            return answer(values)
        if count == REVERSE:
            return jax.value_and_grad(answer)(values)
        directions = np.random.default_rng(0).normal(size=(count, len(value))) * value
        push = lambda way: jax.jvp(answer, (values,), (way,))
        return jax.vmap(push, out_axes=(None, 0))(jnp.asarray(directions))

    return lambda values: (function, numbers, values)


def measured(
    scene: str, name: str, asked: jc.Problem, counts: tuple[Any, ...], batch: int
) -> dict[str, Any]:
    """One row: ratios of run and compilation, alone (`batch` 0) or in a batch."""
    value = asked.nominal()
    spread = 1 + 1e-3 * np.random.default_rng(1).normal(size=(batch, len(value)))
    values = value if batch == 0 else value * jnp.asarray(spread)
    programs, compiled = {}, {}
    for count in (0, *counts):
        function, numbers, given = with_slopes(asked, count)(values)
        each = jax.vmap(function, (None, 0)) if batch else function
        try:
            programs[count], compiled[count] = seconds_to_compile(each, numbers, given)
        except ValueError as refused:
            # No gradient in reverse mode goes through surfaces that wear.
            assert count == REVERSE, refused
    cases = {
        str(count): (lambda p=program: p(numbers, values)) for count, program in programs.items()
    }
    cpu = {name: spent[1] for name, spent in side_by_side(cases).items()}
    row: dict[str, Any] = {"scene": scene, "rung": name, "samples": max(batch, 1)}
    row["value [ms]"] = 1e3 * cpu["0"]
    for count in (*SLOPES, REVERSE):
        label = count if count == REVERSE else f"+{count}"
        row[label] = cpu[str(count)] / cpu["0"] if str(count) in cpu else None
    row["variables of reverse"] = len(value)
    row["compile, value [s]"] = compiled[0]
    row["compile, +1 over it"] = compiled[1] / compiled[0] if 1 in compiled else None
    return row


def main() -> None:
    options = arguments(
        __doc__,
        scene={"choices": list(SCENES), "default": "slider-crank", "help": "which mechanism"},
        rung={"choices": list(RUNGS), "nargs": "*", "default": list(RUNGS), "help": "which ones"},
    )
    duration = DURATION / 4 if options.quick else DURATION
    for name in options.rung[:1] if options.quick else options.rung:
        integrator = RUNGS[name]
        counted = integrator.steps_between_saves is not None
        asked = problem(options.scene, integrator, duration)
        alone = (REVERSE,) if counted else SLOPES[:1] if options.quick else (*SLOPES, REVERSE)
        rows = [measured(options.scene, name, asked, alone, 0)]
        if not (options.quick or counted):
            rows.append(measured(options.scene, name, asked, SLOPES[:3], BATCH))
        report(f"slopes over the value, CPU time: {options.scene}, {name}", rows, options)
        if options.json is not None:
            known = json.loads(options.json.read_text())
            told = {"about": about("benchmarks.claims.slopes", options.json)}
            options.json.write_text(json.dumps(known | told, indent=1) + "\n")


if __name__ == "__main__":
    main()
