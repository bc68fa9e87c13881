"""What the engine traces and what it costs to compile, for every variant of the four-bar.

Equations are counted in one evaluation of the rate after dead code is gone, nested programs
included. Compile times are also given as a ratio to a fixed reference function compiled in the same
process; `equations_budget.json` bounds both.
"""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Jaxpr
from jax.interpreters import partial_eval

import jaxclear as jc
from benchmarks.claims.four_bar_variants import (
    VARIANTS,
    build,
    constraint_rows,
    field_of,
    parts,
    start_of,
    without,
)
from benchmarks.measure import run_tables, seconds_to_compile
from jaxclear.scenes.four_bar import KINDS, four_bar

BUDGET = Path(__file__).with_name("equations_budget.json")
# Equations of the reference function; its compile time is the unit in which the budget is written.
REFERENCE_LENGTH = 400


def traced(mechanism: jc.Mechanism) -> tuple[Any, tuple]:
    """The rate as a function of (numbers, time, state), and its arguments."""
    numbers, rest = eqx.partition(field_of(mechanism), eqx.is_array)
    return (lambda n, time, state: eqx.combine(n, rest)(time, state)), (
        numbers,
        0.0,
        start_of(mechanism),
    )


def primitives(function: Any, args: tuple) -> Counter:
    """How often each primitive stands in the traced program without dead code; wrappers count as
    what they wrap.
    """
    jaxpr = jax.make_jaxpr(function)(*args).jaxpr
    return _count(partial_eval.dce_jaxpr(jaxpr, [True] * len(jaxpr.outvars))[0])


def _count(jaxpr: Jaxpr) -> Counter:
    counts: Counter = Counter()
    for equation in jaxpr.eqns:
        inner = [x for x in jax.tree.leaves(equation.params) if isinstance(x, (Jaxpr, ClosedJaxpr))]
        for program in inner:
            counts += _count(getattr(program, "jaxpr", program))
        if not inner:
            counts[equation.primitive.name] += 1
    return counts


def rate_primitives(mechanism: jc.Mechanism) -> Counter:
    return primitives(*traced(mechanism))


def reference(x: jax.Array) -> jax.Array:
    """A fixed chain of scalar operations, alike in kind to an evaluation of the rate."""
    a, b = x[0], x[1]
    for i in range(REFERENCE_LENGTH // 8):
        a, b = jnp.sin(a) * b + float(i), jnp.sqrt(b * b + 1.0) / (a * a + 2.0)
    return jnp.stack([a, b])


def reference_seconds() -> float:
    return min(seconds_to_compile(reference, jnp.ones(2))[1] for _ in range(3))


def measure(mechanism: jc.Mechanism, unit: float) -> dict[str, Any]:
    """One row of the table."""
    layout = parts(mechanism)[1]
    function, args = traced(mechanism)
    seconds = seconds_to_compile(function, *args)[1]
    return {
        "coordinates": layout.coordinates,
        "speeds": layout.speeds,
        "state": layout.size,
        "rows": constraint_rows(mechanism),
        "equations": sum(primitives(function, args).values()),
        "compile ratio": seconds / unit,
    }


def over_budget(rows: list[dict[str, Any]]) -> list[str]:
    """A sentence for every figure above its budget."""
    budget = json.loads(BUDGET.read_text())["variants"]
    return [
        f"{row['variant']}: {key} is {row[key]:.4g}, the budget {budget[row['variant']][key]:.4g}"
        for row in rows
        for key in ("equations", "compile ratio")
        if row[key] > budget[row["variant"]][key]
    ]


def variant_rows() -> list[dict[str, Any]]:
    measure(build(VARIANTS[0]), 1.0)  # what is compiled first pays for starting the compiler
    unit = reference_seconds()
    rows = [{"variant": v.name} | measure(build(v), unit) for v in VARIANTS]
    return rows + [
        {"variant": f"scenes.four_bar {kind}"} | measure(four_bar(kind), unit) for kind in KINDS
    ]


def absence_rows() -> list[dict[str, Any]]:
    """Equations where a feature was never given, and where it was given and taken out."""
    rows = []
    for variant in VARIANTS:
        for feature in ("friction", "wear"):
            if getattr(variant, feature):
                poorer = variant._replace(**{feature: False})
                removed = without(build(variant), feature)
                rows.append(
                    {
                        "variant": variant.name,
                        "without": feature,
                        "with it": sum(rate_primitives(build(variant)).values()),
                        "never given": sum(rate_primitives(build(poorer)).values()),
                        "taken out": sum(rate_primitives(removed).values()),
                    }
                )
    return rows


def budgeted_rows(_: Any) -> list[dict[str, Any]]:
    rows = variant_rows()
    print("\n".join(over_budget(rows)) or "\nwithin the budget")
    return rows


if __name__ == "__main__":
    run_tables({"equations: variants of the four-bar": budgeted_rows})
