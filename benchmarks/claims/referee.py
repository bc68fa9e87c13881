"""What a run pays for judging itself: CPU time with its checks beside the same run without any, one
run alone and a sample in a batch; and what a run in doubt pays for its second look.

A run without checks is not offered to users; here its windows, its looks at saved states, the
watch on its contacts and what fewer saving times would wear are taken out by hand, and so is the
second look.
"""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import about, arguments, report, side_by_side
from jaxclear.ground.compiling import AROUND_A_KERNEL, compiled_quickly
from jaxclear.integrators import fixed_step, implicit_step
from jaxclear.simulation import (
    loop,
    referee,
    second_look,
    spot_checks,
    turns,
    wear_by_cells,
    wear_by_saves,
)
from jaxclear.simulation.simulate import saving_times

FIXED, IMPLICIT, ADAPTIVE, PERMANENT = (
    jc.integrator.FixedStep(),
    jc.integrator.ImplicitStep(),
    jc.integrator.Adaptive(),
    jc.integrator.NonColliding(),
)
# Mechanism, integrator, duration [s].
CASES: dict[str, tuple[Callable[[], Any], Any, float]] = {
    "slider-crank, FixedStep": (jc.scenes.slider_crank, FIXED, 0.1),
    "slider-crank, ImplicitStep": (jc.scenes.slider_crank, IMPLICIT, 0.25),
    "slider-crank, Adaptive": (jc.scenes.slider_crank, ADAPTIVE, 0.25),
    "slider-crank, MoreauJean": (jc.scenes.slider_crank, jc.integrator.MoreauJean(), 0.25),
    "four-bar, FixedStep": (jc.scenes.four_bar, FIXED, 0.1),
    "four-bar, ImplicitStep": (jc.scenes.four_bar, IMPLICIT, 0.25),
    "antenna, NonColliding": (jc.scenes.antenna, PERMANENT, 0.5),
    "ideal slider-crank, FixedStep": (lambda: jc.scenes.slider_crank("ideal"), FIXED, 0.1),
    "ideal slider-crank, Adaptive": (lambda: jc.scenes.slider_crank("ideal"), ADAPTIVE, 0.5),
}
# The same, in steps so long that the run is in doubt.
IN_DOUBT: dict[str, tuple[Callable[[], Any], Any, float]] = {
    "slider-crank, FixedStep(2e-5)": (jc.scenes.slider_crank, FIXED, 0.1),
    "slider-crank, ImplicitStep(1e-4)": (jc.scenes.slider_crank, IMPLICIT, 0.25),
    "four-bar, ImplicitStep(1e-4)": (jc.scenes.four_bar, IMPLICIT, 0.25),
}
QUICK = ("slider-crank, FixedStep", "ideal slider-crank, Adaptive")
# As `simulate` and `Problem` save.
SAVES, STUDY_SAVES, BATCH = 501, 201, 64
# The least of as many runs counts as take so many CPU seconds, with checks and without: of twenty
# runs of 2 ms, on a machine with other work on it, their ratio is off by a tenth, and so it is of
# nine batches.
ENOUGH, REPEATS = 2.0, 300
# Sample k starts with speeds of 1 + k SPREAD of the nominal ones: no two have the same motion.
SPREAD = 1e-6


@contextmanager
def unchecked() -> Iterator[None]:
    """Programs that are traced in here have no checks."""
    places: list[tuple[Any, str, Any]] = [
        (spot_checks, "window_starts", lambda count: []),
        (
            referee,
            "_of_saved_states",
            lambda *_: referee.Seen({}, {}, None),
        ),
        (turns, "followed", lambda tally, *_: tally),
        (wear_by_saves, "figures", lambda *_: {}),
        (wear_by_cells, "figures", lambda *_: {}),
        (fixed_step.FixedStep, "_nothing_met", lambda *_: None),
        (implicit_step, "contacts_met", lambda met, *_: met),
    ]
    before = [(place, name, getattr(place, name)) for place, name, _ in places]
    for place, name, nothing in places:
        setattr(place, name, nothing)
    try:
        yield
    finally:
        for place, name, whole in before:
            setattr(place, name, whole)


def program(case: str, saves: int, batch: int | None) -> Callable[[], Any]:
    """A run, or a batch of runs, compiled as things stand."""
    build, integrator, duration = CASES[case]
    times = saving_times(duration, saves)
    rig = integrator.formulation.seen(build())
    start = jc.assemble(rig)

    def runs(rig, speeds, integrator, times):
        run = lambda v: loop.run(rig, start.coordinates, v, times, integrator)
        return run(speeds) if batch is None else jax.vmap(run)(speeds)

    whole = compiled_quickly(runs, AROUND_A_KERNEL)
    shares = jnp.ones(()) if batch is None else 1 + SPREAD * jnp.arange(batch)[:, None]
    call = lambda: whole(rig, shares * start.speeds, integrator, times)
    jax.block_until_ready(call())
    return call


def row(case: str, saves: int, batch: int | None, repeats: int | None) -> dict[str, Any]:
    """Milliseconds of CPU a run with and without its checks; the least of so many `repeats`, or
    (None) of `ENOUGH` seconds."""
    checked = program(case, saves, batch)
    with unchecked():
        bare = program(case, saves, batch)
    np.testing.assert_array_equal(checked().states, bare().states)
    if repeats is None:
        once = side_by_side({"without": bare}, 3)["without"][1]
        repeats = int(0.5 * ENOUGH / once)
    spent = side_by_side({"with": checked, "without": bare}, repeats)
    share = 1e3 / (batch or 1)
    return {
        "scene and rung": case,
        "runs at once": batch or 1,
        "saving times": saves,
        "with [ms a run]": round(spent["with"][1] * share, 4),
        "without [ms a run]": round(spent["without"][1] * share, 4),
        "ratio": round(spent["with"][1] / spent["without"][1], 3),
    }


@contextmanager
def looked_at_once() -> Iterator[None]:
    """Runs in here get no second look."""
    most, second_look.MOST_STEPS = second_look.MOST_STEPS, -1
    try:
        yield
    finally:
        second_look.MOST_STEPS = most


def second_look_row(case: str, repeats: int) -> dict[str, Any]:
    """Milliseconds of CPU of `simulate` with and without the second look, all compiled before."""
    build, integrator, duration = IN_DOUBT[case]
    rig = build()

    def twice() -> Any:
        return jc.simulate(rig, duration, integrator=integrator).states

    def once() -> Any:
        with looked_at_once():
            return twice()

    spent = side_by_side({"with": twice, "without": once}, repeats)
    return {
        "scene and rung": case,
        "steps": int(jc.simulate(rig, duration, integrator=integrator).accepted_steps),
        "with a second look [ms]": round(spent["with"][1] * 1e3, 3),
        "without [ms]": round(spent["without"][1] * 1e3, 3),
        "ratio": round(spent["with"][1] / spent["without"][1], 2),
    }


def main() -> None:
    options = arguments(__doc__)
    rows = []
    for case in QUICK if options.quick else CASES:
        rows.append(row(case, SAVES, None, 5 if options.quick else None))
        rows.append(row(case, STUDY_SAVES, BATCH, 2 if options.quick else None))
    report("CPU time of a run with its checks and without", rows, options)
    doubted = [second_look_row(case, 3 if options.quick else REPEATS // 5) for case in IN_DOUBT]
    report("CPU time of a run in doubt", doubted, options)
    if options.json:
        known = json.loads(options.json.read_text())
        told = {"about": about("benchmarks.claims.referee", options.json)}
        options.json.write_text(json.dumps(known | told, indent=1) + "\n")


if __name__ == "__main__":
    main()
