"""What a run pays for telling its error: CPU time of a verified run beside one with `verify=False`;
what a sample of a batch pays for the checks that stay; and a call of `simulate` of no length.

Checks cannot be left out by users; here they are taken out by hand.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import run_tables, side_by_side
from jaxclear.errors.verification import Verified
from jaxclear.native.compiled import AROUND_A_KERNEL, compiled_quickly
from jaxclear.simulation import loop
from jaxclear.simulation.saving import saving_times

I = jc.integrator  # noqa: E741
wearing = lambda: jc.scenes.slider_crank(wear=True)
ideal = lambda: jc.scenes.slider_crank("ideal")
# Mechanism, integrator, duration [s].
CASES: dict[str, tuple[Callable[[], Any], Any, float]] = {
    "slider-crank, Adaptive": (jc.scenes.slider_crank, I.Adaptive(), 0.25),
    "slider-crank, FixedStep": (jc.scenes.slider_crank, I.FixedStep(), 0.1),
    "slider-crank that wears, FixedStep": (wearing, I.FixedStep(), 0.1),
    "slider-crank, ImplicitStep(1e-5)": (jc.scenes.slider_crank, I.ImplicitStep(1e-5), 0.25),
    "slider-crank, MoreauJean(2e-5)": (jc.scenes.slider_crank, I.MoreauJean(2e-5), 0.25),
    "four-bar, Adaptive": (jc.scenes.four_bar, I.Adaptive(), 0.25),
    "four-bar, ImplicitStep(2e-5)": (jc.scenes.four_bar, I.ImplicitStep(2e-5), 0.25),
    "ideal slider-crank, Adaptive": (ideal, I.Adaptive(), 0.5),
}
QUICK = ("slider-crank, FixedStep", "ideal slider-crank, Adaptive")
SAVES, BATCH = 201, 64
# The least of as many runs counts as take so many CPU seconds.
ENOUGH = 2.0
# Sample k starts with speeds of 1 + k SPREAD of the nominal ones: no two have the same motion.
SPREAD = 1e-6
# Seconds of a run of next to no length.
NO_LENGTH = 1e-9


def beside(calls: dict[str, Callable[[], Any]], quick: bool) -> dict[str, float]:
    """Least CPU seconds of each call, all compiled before."""
    once = side_by_side(calls, 2)
    longest = max(spent[1] for spent in once.values())
    repeats = 3 if quick else max(3, int(ENOUGH / longest))
    return {name: spent[1] for name, spent in side_by_side(calls, repeats).items()}


def verified_row(case: str, quick: bool) -> dict[str, Any]:
    """A verified run beside one without replicas."""
    build, integrator, duration = CASES[case]
    rig, given = build(), {"integrator": integrator, "save": SAVES}
    call = lambda verify: jc.simulate(rig, duration, **given, verify=verify)
    run = call(True)
    told = run.verification
    spent = beside(
        {"with": lambda: call(True).states, "without": lambda: call(False).states}, quick
    )
    return {
        "scene and rung": case,
        "steps": int(run.accepted_steps),
        "replicas": len(told.replicas) if isinstance(told, Verified) else 0,
        "verified [ms]": round(1e3 * spent["with"], 3),
        "verify=False [ms]": round(1e3 * spent["without"], 3),
        "ratio": round(spent["with"] / spent["without"], 2),
    }


@contextmanager
def unchecked() -> Iterator[None]:
    """Programs that are traced in here have no checks."""
    whole, loop.judged = loop.judged, lambda run, *_: run
    try:
        yield
    finally:
        loop.judged = whole


def batch_row(case: str, quick: bool) -> dict[str, Any]:
    """A sample of a batch with its checks and without."""
    build, integrator, duration = CASES[case]
    times = saving_times(duration, SAVES)
    rig = integrator.formulation.modelled(build())
    start = jc.assemble(rig)
    shares = 1 + SPREAD * jnp.arange(BATCH)[:, None]

    def program() -> Callable[[], Any]:
        def runs(rig, speeds, integrator, times):
            run = lambda v: loop.run(rig, start.coordinates, v, times, integrator)
            return jax.vmap(run)(speeds)

        whole = compiled_quickly(runs, AROUND_A_KERNEL)
        call = lambda: whole(rig, shares * start.speeds, integrator, times)
        jax.block_until_ready(call())
        return call

    checked = program()
    with unchecked():
        bare = program()
    np.testing.assert_array_equal(checked().states, bare().states)
    spent = beside({"with": checked, "without": bare}, quick)
    return {
        "scene and rung": case,
        "with its checks [ms a sample]": round(1e3 * spent["with"] / BATCH, 4),
        "without [ms a sample]": round(1e3 * spent["without"] / BATCH, 4),
        "ratio": round(spent["with"] / spent["without"], 3),
    }


def call_row(quick: bool) -> dict[str, Any]:
    """A call of `simulate` of next to no length, beside a compiled identity of its states."""
    rig = jc.scenes.slider_crank()
    given = {"integrator": I.FixedStep(), "save": 3, "verify": False}
    simulated = lambda: jc.simulate(rig, NO_LENGTH, **given).states
    states, same = simulated(), jax.jit(lambda states: states + 0.0)
    spent = beside({"call": simulated, "identity": lambda: same(states)}, quick)
    return {
        "call": "simulate of no length, verify=False",
        "CPU [ms]": round(1e3 * spent["call"], 3),
        "over an identity": round(spent["call"] / spent["identity"], 1),
    }


TABLES = {
    "CPU time of a verified run": lambda options: [
        verified_row(case, options.quick) for case in (QUICK if options.quick else CASES)
    ],
    "CPU time of a batch with checks": lambda options: [
        batch_row(case, options.quick) for case in (QUICK if options.quick else CASES)
    ],
    "CPU time of a call": lambda options: [call_row(options.quick)],
}

if __name__ == "__main__":
    run_tables(TABLES)
