"""The robot arm with play in its reducers: what a run, its slopes by all plays and the choice of
three reducers cost, and how far the choice is from the best of all 35.

Errors of the tip are those where the arm rests, beside the arm of the same elasticity without play.
Wall times of a first call hold its compilation.
"""

import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np

from benchmarks.measure import arguments, report, side_by_side, sign
from jaxclear.commands.arm import (
    BOUGHT,
    REDUCED,
    STANDARD,
    tip_problem,
    designed,
    every_choice,
    named,
    simulated,
    slopes,
)
from jaxclear.scenes.arm import ARCMIN, JOINTS, arm

PLAYS = (0.5 * ARCMIN, REDUCED, 2 * ARCMIN, STANDARD)
MILLI = 1e3


def seconds(call: Callable[[], Any]) -> tuple[Any, float]:
    """What a call returns, and its wall time [s]."""
    begun = time.perf_counter()
    return jax.block_until_ready(call()), time.perf_counter() - begun


def main() -> None:
    options = arguments(__doc__)
    repeats = 1 if options.quick else 5
    problem = tip_problem(STANDARD, simulated(arm("play", 0.0), verify=False))
    error = eqx.filter_jit(lambda plays: problem.evaluate(plays).responses["tip error"])
    sizes = {f"{play / ARCMIN:g} arcmin": np.full(len(JOINTS), play) for play in PLAYS}
    nominal = problem.nominal()
    _, first = seconds(lambda: error(nominal))
    by_play = lambda: slopes(problem)["slope [mm/arcmin]"].to_numpy()
    _, first_slope = seconds(by_play)
    derived = eqx.filter_jit(
        jax.jacfwd(lambda plays: problem.evaluate(plays).responses["tip error"])
    )
    found, first_derived = seconds(lambda: derived(nominal))
    off = np.max(np.abs(MILLI * ARCMIN * np.asarray(found) / by_play() - 1))
    ways = {"slopes": by_play, "derivatives": lambda: derived(nominal)}
    spent = side_by_side({"run": lambda: error(nominal)} | ways, repeats)
    rows = [
        {"play of all seven": name, "tip error [mm]": MILLI * float(error(own))}
        for name, own in sizes.items()
    ]
    report("arm: what play does to the tip", rows, options)
    rows = [
        {
            "asked": "a run",
            "first call, wall [s]": first,
            "CPU [s]": spent["run"][1],
            "of a run": 1.0,
        },
        {
            "asked": "slopes by all seven plays, 14 runs",
            "first call, wall [s]": first_slope,
            "CPU [s]": spent["slopes"][1],
            "of a run": spent["slopes"][1] / spent["run"][1],
        },
        {
            "asked": f"their derivatives, {100 * off:.1f} % beside these",
            "first call, wall [s]": first_derived,
            "CPU [s]": spent["derivatives"][1],
            "of a run": spent["derivatives"][1] / spent["run"][1],
        },
    ]
    report("arm: a run and its slopes", rows, options)
    table, enumerated = seconds(lambda: every_choice(problem))
    best, two = (table.query(f"bought == {many}").iloc[0] for many in (BOUGHT, BOUGHT - 1))
    limit = 0.5 * (best["tip error [mm]"] + two["tip error [mm]"]) / MILLI
    design, taken = seconds(lambda: designed(problem, limit))
    plays = np.array([design.nominal[name] for name in JOINTS])
    found = MILLI * float(error(plays))
    rows = [
        {
            "which reducers": "jaxclear.design",
            "reduced play in": named(plays < 2 * REDUCED),
            "tip error [mm]": found,
            "beside the best three [%]": 100 * (found / best["tip error [mm]"] - 1),
            "wall [s]": taken,
        },
        {
            "which reducers": "enumeration of all 128",
            "reduced play in": best["reduced play in"],
            "tip error [mm]": best["tip error [mm]"],
            "beside the best three [%]": 0.0,
            "wall [s]": enumerated,
        },
    ]
    report("arm: which three of seven reducers have reduced play", rows, options)
    sign("benchmarks.claims.arm", options.json)


if __name__ == "__main__":
    main()
