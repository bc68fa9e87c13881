"""Samples a second of tolerance studies without time, by CPU time: a planar four-bar with clearance
at 36 positions of its crank, its derivative, a stack of ten dimensions; by the samples computed
together.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import run_tables, seconds_to_compile, side_by_side
from jaxclear.studies.store.batch import evaluate_all
from jaxclear.studies.sampling import draw

POSITIONS = 36


def four_bar() -> jc.Problem:
    """Largest error of the follower's angle over a turn of the crank; eight dimensions vary."""
    angles = np.linspace(0.0, 2 * np.pi, POSITIONS, endpoint=False)
    ideal = jc.positions(jc.scenes.four_bar("ideal"), {"O": angles}).coordinate("D")
    places = {
        "clearance": lambda m: m.connections["B"].joint.clearance,
        "crank": lambda m: m.connections["A"].parent.at[0],
        "coupler": lambda m: m.connections["B"].parent.at[0],
        "coupler's hole": lambda m: m.connections["B"].parent.at[1],
        "follower": lambda m: m.connections["B"].child.at[0],
        "ground x": lambda m: m.connections["D"].parent.at[0],
        "ground y": lambda m: m.connections["D"].parent.at[1],
        "coupler's mass": lambda m: m.bodies["coupler"].mass,
    }
    widths = dict.fromkeys(places, 50e-6) | {"coupler's mass": 0.05}
    return jc.PositionProblem(
        jc.scenes.four_bar("planar", 0.2e-3, friction=False, wear=False),
        {"follower error": lambda stands: jnp.max(jnp.abs(stands.coordinate("D") - ideal))},
        {name: jc.Variable(where, tolerance=widths[name]) for name, where in places.items()},
        positions={"O": angles},
    )


def stack() -> jc.Problem:
    """Play that ten parts leave in a housing."""
    parts = {f"part {i}": jc.Dimension(10e-3, tolerance=20e-6) for i in range(9)}
    housing = {"housing": jc.Dimension(90.3e-3, tolerance=80e-6)}
    return jc.FunctionProblem(
        lambda housing, **parts: housing - sum(parts.values()), housing | parts
    )


def rows_of(name: str, problem: Any, chunks: tuple[int, ...], many: int) -> list[dict[str, Any]]:
    """A row for each number of samples computed together."""
    values = jnp.asarray(draw(problem, many, 0))
    run = lambda chunk: lambda: evaluate_all(problem, values, chunk=chunk)
    cpu = {chunk: side_by_side({name: run(chunk)})[name][1] for chunk in chunks}
    row = {"problem": name, "variables": len(problem.names)}
    return [row | {"samples together": c, "samples per CPU s": many / cpu[c]} for c in chunks]


def derivative_rows(problem: jc.Problem, chunk: int) -> list[dict[str, Any]]:
    """Cost of the slope along one direction, beside the value."""
    values = jnp.asarray(draw(problem, chunk, 0))
    direction = jnp.zeros(len(problem.names)).at[0].set(1.0)
    one = lambda v: problem.evaluate(v).responses["follower error"]
    slope = lambda v: jax.jvp(one, (v,), (direction,))[1]
    rows, spent = [], {}
    for what, function in (("value", one), ("slope", slope)):
        compiled, seconds = seconds_to_compile(jax.vmap(function), values)
        spent[what] = (lambda c=compiled: c(values)), seconds
    times = side_by_side({what: run for what, (run, _) in spent.items()})
    for what, (_, seconds) in spent.items():
        cpu = times[what][1]
        rows.append({"of a sample": what, "us CPU": 1e6 * cpu / chunk, "compiled in s": seconds})
    return rows


def rate_rows(options: Any) -> list[dict[str, Any]]:
    """Samples a second of both problems."""
    many = 1 << (12 if options.quick else 15)
    chunks = (256, 1024) if options.quick else (64, 256, 512, 1024, 2048)
    rows = rows_of("four-bar, 36 positions", four_bar(), chunks, many)
    return rows + rows_of("stack of ten", stack(), (1024, 4096, 16384), 1 << 17)


TABLES = {
    "Samples a second of one core": rate_rows,
    "The four-bar and its slope along one variable": lambda _: derivative_rows(four_bar(), 1024),
}

if __name__ == "__main__":
    run_tables(TABLES)
