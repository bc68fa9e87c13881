"""What one evaluation of the rate costs: jaxclear beside the same mechanism written by hand in JAX
and in numba.

The four-bar with a spatial clearance joint and friction; first all three must agree. Alone means
inside a compiled loop, so calling the program does not count; a batch shares every number but the
clearance.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.by_hand import four_bar as by_hand
from benchmarks.claims.four_bar_variants import (
    CLEARANCE,
    RUBBING,
    build,
    field_of,
    samples,
    with_clearance,
)
from benchmarks.measure import arguments, report, side_by_side, sign

# The states lie around the assembled start, which is consistent at time zero.
TIME = 1e-6


class Case(NamedTuple):
    """One batch, in the forms in which each program wants it."""

    states: np.ndarray
    clearances: np.ndarray
    stiffnesses: np.ndarray
    parameters: by_hand.Parameters
    mechanism: Any


def case(count: int, seed: int = 0) -> Case:
    """States in and out of contact, clearances from 0.05 to 0.25 mm."""
    mechanism = build(RUBBING)
    clearances = np.linspace(0.25, 1.25, count) * CLEARANCE
    stiffness = jax.vmap(
        lambda c: by_hand.parameters(field_of(with_clearance(mechanism, c)).model.system).stiffness
    )
    numbers = by_hand.parameters(field_of(mechanism).model.system)
    return Case(
        samples(mechanism, count, seed),
        clearances,
        np.asarray(stiffness(clearances)),
        numbers,
        mechanism,
    )


def prepared(case: Case) -> tuple[Any, Any, Any]:
    """(numbers, their batch axes, everything else) of the fields; what the clearance does not
    change is shared.
    """

    def field(clearance):
        return field_of(with_clearance(case.mechanism, clearance))

    every = jax.vmap(lambda c: eqx.filter(field(c), eqx.is_array))(jnp.asarray(case.clearances))
    flat, structure = jax.tree.flatten(every)
    flags = [0 if np.any(np.asarray(x) != np.asarray(x)[0]) else None for x in flat]
    numbers = [x if flag == 0 else x[0] for x, flag in zip(flat, flags, strict=True)]
    rest = eqx.partition(field(case.clearances[0]), eqx.is_array)[1]
    return jax.tree.unflatten(structure, numbers), jax.tree.unflatten(structure, flags), rest


def programs(case: Case) -> dict[str, Callable]:
    """Each a function without arguments returning the rates of the whole batch: JAX a row a rate,
    numba a row a sample.
    """
    numbers, axes, rest = prepared(case)

    @jax.jit
    def engine(time, numbers, rows):
        one = jax.vmap(
            lambda n, state: eqx.combine(n, rest)(time, state), in_axes=(axes, 1), out_axes=1
        )
        return one(numbers, rows)

    hand = jax.jit(by_hand.jax_batch(by_hand.jax_rate()))
    shared = case.parameters._replace(
        clearance=jnp.asarray(case.clearances), stiffness=jnp.asarray(case.stiffnesses)
    )
    rows = jnp.asarray(case.states.T)
    plain = by_hand.Parameters(*map(float, case.parameters))
    out = np.zeros_like(case.states)
    one_thread, two_threads = by_hand.numba_batch(), by_hand.numba_batch(parallel=True)

    def compiled_by_numba(batch):
        batch(TIME, case.states, plain, case.clearances, case.stiffnesses, out)
        return out

    return {
        "jaxclear": lambda: engine(TIME, numbers, rows),
        "JAX by hand": lambda: hand(TIME, rows, shared),
        "numba": lambda: compiled_by_numba(one_thread),
        "numba, all cores": lambda: compiled_by_numba(two_threads),
    }


def disagreement(case: Case) -> dict[str, float]:
    """Largest difference of each program from jaxclear, each rate measured by its own largest value
    over the samples.
    """
    count = len(case.clearances)
    rates = {name: np.array(program()) for name, program in programs(case).items()}
    rates = {name: rate if rate.shape[0] == count else rate.T for name, rate in rates.items()}
    largest = np.abs(rates["jaxclear"]).max(axis=0)
    scale = np.where(largest > 0, largest, 1.0)
    return {
        name: float((np.abs(rate - rates["jaxclear"]) / scale).max())
        for name, rate in rates.items()
    }


def alone(case: Case, steps: int) -> dict[str, Callable]:
    """Explicit Euler steps of vanishing length from one state: a loop of evaluations, one after the
    other.
    """
    numbers, rest = eqx.partition(field_of(case.mechanism), eqx.is_array)
    hand = by_hand.jax_rate()
    state = jnp.asarray(case.states[0])
    tiny = 1e-12

    @jax.jit
    def engine(numbers, state):
        field = eqx.combine(numbers, rest)
        return jax.lax.fori_loop(0, steps, lambda i, y: y + tiny * field(i * tiny, y), state)

    @jax.jit
    def written(parameters, state):
        def step(i, y):
            return y + tiny * jnp.stack(hand(i * tiny, y, parameters))

        return jax.lax.fori_loop(0, steps, step, state)

    plain = by_hand.Parameters(*map(float, case.parameters))
    loop = by_hand.numba_euler()
    return {
        "jaxclear": lambda: engine(numbers, state),
        "JAX by hand": lambda: written(case.parameters, state),
        "numba": lambda: loop(steps, tiny, case.states[0].copy(), plain),
    }


def rows(
    label: str, programs: dict[str, Callable], evaluations: int, repeats: int
) -> list[dict[str, Any]]:
    times = side_by_side(programs, repeats)
    mark = times["JAX by hand"][0]
    return [
        {
            "program": name,
            "how": label,
            "wall [ns]": wall / evaluations * 1e9,
            "CPU [ns]": cpu / evaluations * 1e9,
            "wall / JAX by hand": wall / mark,
        }
        for name, (wall, cpu) in times.items()
    ]


def main() -> None:
    options = arguments(__doc__)
    batch = case(1024)
    difference = disagreement(batch)
    report(
        "evaluation: agreement",
        [{"program": n, "difference": d} for n, d in difference.items()],
        options,
    )
    repeats, steps = (5, 2000) if options.quick else (40, 20000)
    table = rows("batch of 1024", programs(batch), 1024, repeats) + rows(
        "alone", alone(batch, steps), steps, repeats
    )
    report("evaluation: one rate of the four-bar", table, options)
    sign("benchmarks.by_hand.evaluation", options.json)


if __name__ == "__main__":
    main()
