"""What one Runge-Kutta step costs: one run alone (fixed and adaptive steps), and batches over
clearance on one or more threads.

Batches are `jax.vmap` of the pure core of `simulate`, cut into chunks; beside them the loop in
numba. Compiled loops leave Python free, so chunks run side by side in threads. Start-up and
compilation are not counted.
"""

import os
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.by_hand import four_bar as by_hand
from benchmarks.by_hand.evaluation import case
from benchmarks.claims.four_bar_variants import RUBBING, build, start_of, with_clearance
from benchmarks.measure import arguments, report, side_by_side, sign
from jaxclear.simulation.simulate import run

SAVES = 11
STEP = 2e-5


def alone(steps: int):
    """Programs for one run of `steps` fixed steps, and the number of steps of each."""
    mechanism = build(RUBBING)
    start = jc.assemble(mechanism)
    times = jnp.linspace(0.0, steps * STEP, SAVES)
    programs, counts = {}, {}
    for integrator in (jc.integrator.FixedStep(STEP), jc.integrator.Adaptive()):
        compiled = eqx.filter_jit(run)
        program = lambda f=compiled, i=integrator: f(
            mechanism, start.coordinates, start.speeds, times, i
        )
        name = f"{type(integrator).__name__}, alone"
        programs[name] = lambda p=program: p().states
        found = program()
        counts[name] = int(found.accepted_steps) + int(found.rejected_steps)
    return programs, counts


def batches(samples: int, steps: int, chunks: tuple[int, ...]):
    """Programs for `samples` runs of `steps` fixed steps, by chunk size and threads."""
    mechanism = build(RUBBING)
    numbers, rest = eqx.partition(mechanism, eqx.is_array)
    start = jc.assemble(mechanism)
    times = jnp.linspace(0.0, steps * STEP, SAVES)
    clearances = jnp.linspace(0.5e-4, 2.5e-4, samples)

    @jax.jit
    def chunk_of(numbers, q, v, some):
        def one(clearance):
            moved = with_clearance(eqx.combine(numbers, rest), clearance)
            return run(moved, q, v, times, jc.integrator.FixedStep(STEP)).states

        return jax.vmap(one)(some)

    def go(chunk, threads):
        pieces = clearances.reshape(-1, chunk)
        with ThreadPoolExecutor(threads) as pool:
            work = lambda c: jax.block_until_ready(
                chunk_of(numbers, start.coordinates, start.speeds, c)
            )
            return list(pool.map(work, pieces))

    programs = {}
    for chunk in chunks:
        for threads in sorted({1, os.cpu_count() or 1}):
            if chunk * threads <= samples:
                programs[f"batch, chunks of {chunk}, {threads} threads"] = (
                    lambda c=chunk, t=threads: go(c, t)
                )
    setting = case(samples)
    plain = by_hand.Parameters(*map(float, setting.parameters))
    # Numba's hand version has no direction at zero offset: its journals start 1 um off centre.
    first = np.array(start_of(mechanism))
    first[0] += 1e-6
    for threads, loop in (
        (1, by_hand.numba_runge_kutta()),
        (os.cpu_count(), by_hand.numba_runge_kutta(True)),
    ):

        def numba_run(loop=loop):
            states = np.tile(first, (samples, 1))
            loop(steps, STEP, states, plain, np.asarray(clearances), setting.stiffnesses)
            return states

        programs[f"numba, {threads} threads"] = numba_run
    return programs


def main() -> None:
    options = arguments(__doc__)
    programs, counts = alone(1000 if options.quick else 10000)
    rows = [
        {"program": name, "steps": counts[name], "CPU [ns/step]": cpu / counts[name] * 1e9}
        for name, (_, cpu) in side_by_side(programs).items()
    ]
    samples, steps = (64, 500) if options.quick else (256, 500)
    found = side_by_side(
        batches(samples, steps, (16, 64) if options.quick else (16, 64, 128, 256)), 3
    )
    rows += [
        {"program": name, "steps": samples * steps, "CPU [ns/step]": cpu / samples / steps * 1e9}
        for name, (_, cpu) in found.items()
    ]
    report("steps: Runge-Kutta of the four-bar, ns per step and sample", rows, options)
    sign("benchmarks.claims.steps", options.json)


if __name__ == "__main__":
    main()
