"""What a wear life costs at which error: on closed forms, and on loads that fall with wear also
beside the fixed factor of the papers; lives of a million cycles of the four-bar,
judged by one with a tighter tolerance; and whether the error told of chaotic motion is that
by which lives from other starts differ.

Cycles are all that were simulated, those in which the machine settles included. CPU seconds of a
warm program; "first time": with compiling.
"""

import math
import time
from functools import cache
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import run_tables
from tests.rigs.wearing_ring import FORCE, SLOPE, STIFFNESS, ClosedForm, problem, wearing_ring
from tests.rigs.worn_scar import crescent, lost, scar

# Depth [m] at which the force has fallen to about a half, by law.
LAWS = {"exponential": (False, 5e-6), "square root": (True, 1e-5)}
TOLERANCES = (0.2, 1e-2, 3e-3, 1e-3, 3e-4)
JUMPS = (4, 16, 64, 256)
# Errors at which costs are compared.
AT = (1e-2, 1e-3)
FOUR_BAR_TOLERANCES, TIGHT = (5e-2, 2e-2, 1e-2), 2e-3
# Cycles a rate at the most: by default, and as many as run side by side.
MOST = (12, 48)
WEAR_COEFFICIENT, MILLION, STARTS = 2e-5, 1e6, 12
# Radial clearances [m] of a bushing that wears 127 um deep; jumps of a life for comparison.
BUSHINGS, BUSHED, FINE = (100e-6, 50e-6, 25e-6), 127e-6, 150


def timed(*args: Any, **kwargs: Any) -> tuple[Any, float]:
    """A life, and its CPU seconds after it has been compiled."""
    begun = time.process_time()
    life = jc.wear_life(*args, **kwargs)
    return life, time.process_time() - begun


class Form(NamedTuple):
    """A problem with a closed form, the `turns` until a `depth` [m] (nan: only its volume has one);
    `even`: all cells wear alike, so that cells decide nothing."""

    problem: jc.Problem
    turns: float
    depth: float
    even: bool = True


def forms() -> dict[str, Form]:
    """Closed forms by name."""
    falling, root, growing, flat = (
        ClosedForm(**own) for own in ({}, {"hyperbolic": True}, {"slope": -SLOPE}, {"slope": 0.0})
    )
    ring = lambda **own: problem(wearing_ring(**own))
    found = {
        "load falls, exponential": Form(ring(), falling.turns(5e-6), 5e-6),
        "load falls, square root": Form(ring(hyperbolic=True), root.turns(1e-5), 1e-5),
        "load grows, unbalance": Form(ring(slope=-SLOPE), growing.turns(5e-6), 5e-6),
        "constant load": Form(ring(slope=0.0), 2e-5 / flat.rate(0.0), 2e-5),
        "crescent, spring relaxes": Form(
            ring(worn=("journal",), cells=288), falling.turns_of_crescent(5e-6), 5e-6, False
        ),
    }
    for clearance in BUSHINGS:
        turns = crescent(BUSHED, clearance) / lost(clearance)
        name = f"bushing, {1e6 * clearance:.0f} um clearance"
        found[name] = Form(scar(clearance, 36), turns, BUSHED, False)
    # The journal, which turns, wears evenly by as much and leaves the bearing more clearance.
    both = crescent(60e-6, BUSHINGS[1]) / lost(BUSHINGS[1])
    found["bushing, both wear"] = Form(scar(BUSHINGS[1], 36, journal=True), both, math.nan, False)
    return found


def form_rows(_: Any) -> list[dict[str, Any]]:
    """A row for each closed form, at 1 %: how far the deepest cell is from it. The true error is
    that where cells wear alike; of a crescent, whose depth hangs on their number, it is how far all
    cells are from a life by many small steps on the same ones."""
    rows = []
    for name, form in forms().items():
        life = jc.wear_life(form.problem, cycles=form.turns)
        deepest = life.at_end("depth") / form.depth - 1
        true = abs(deepest)
        if not form.even:
            true = _off(life, _extrapolated(form))
        rows.append(
            {
                "closed form": name,
                "cycles": life.simulated,
                "steps taken back": life.rejected,
                "deepest, off closed form [%]": None if math.isnan(deepest) else 100 * deepest,
                "true error [%]": 100 * true,
                "error told [%]": 100 * life.error,
                "told / true": life.error / true,
                "volume told [%]": 100 * float(life.errors_of_volume[-1]),
            }
        )
    return rows


def _extrapolated(form: Form) -> dict[tuple[str, str], np.ndarray]:
    """Depths [m] by surface of lives by jumps of a fixed length, which are of first order: twice
    those of `FINE` jumps less those of half as many."""
    fine, coarse = (
        jc.wear_life(form.problem, cycles=form.turns, jump=form.turns / count).worn()
        for count in (FINE, FINE / 2)
    )
    return {
        (joint, surface): 2 * np.asarray(depth) - np.asarray(coarse[joint][surface])
        for joint, surfaces in fine.items()
        for surface, depth in surfaces.items()
    }


def _off(life: Any, exact: dict[tuple[str, str], np.ndarray]) -> float:
    """Root mean square over the cells, of the worst surface, as a share of that of their depth."""
    shares = []
    for (joint, surface), depth in exact.items():
        off = np.asarray(life.worn()[joint][surface]) - depth
        shares.append(math.sqrt(np.mean(off**2) / np.mean(depth**2)))
    return max(shares)


def derivative_rows(_: Any) -> list[dict[str, Any]]:
    """Derivatives of lives beside those of their closed forms."""
    law, limit = ClosedForm(), 4e-6
    life = jc.wear_life(problem(wearing_ring()), cycles=1.2 * law.turns(limit))
    stiff = 1 / (1 + FORCE * SLOPE / STIFFNESS)
    exact = {"hardness": law.turns(limit) / 2e9, "load": -law.turns(limit) / FORCE * stiff}
    found = {
        f"load falls: life by {name}": (own, exact[name])
        for name, own in jc.wear_life_derivatives(life, "depth", limit).items()
    }
    clearance, step = BUSHINGS[1], 1e-7
    worn = jc.wear_life(scar(clearance, 288), cycles=1e4)
    limit = 0.7 * worn.at_end("depth")
    own = jc.wear_life_derivatives(worn, "depth", limit)["clearance"]
    turns = [crescent(limit, c) / lost(c) for c in (clearance + step, clearance - step)]
    found["bushing: life by clearance"] = own, (turns[0] - turns[1]) / (2 * step)
    return [
        {
            "derivative": name,
            "off [%]": 100 * abs(own.value / wanted - 1),
            "error told [%]": 100 * own.error / abs(wanted),
        }
        for name, (own, wanted) in found.items()
    ]


@cache
def closed_form_rows(quick: bool) -> list[dict[str, Any]]:
    """A row for each scheme and each of its settings."""
    rows = []
    for name, (hyperbolic, depth) in list(LAWS.items())[: 1 if quick else None]:
        asked = problem(wearing_ring(hyperbolic=hyperbolic))
        turns = ClosedForm(hyperbolic=hyperbolic).turns(depth)
        jc.wear_life(asked, cycles=1)
        schemes = [("3(2) pair", f"tolerance {x:g}", {"accuracy": x}) for x in TOLERANCES]
        schemes += [("fixed factor", f"{n} jumps", {"jump": turns / n}) for n in JUMPS]
        for scheme, setting, given in schemes:
            life, spent = timed(asked, cycles=turns, **given)
            true = abs(float(life.over_life("depth")[-1]) / depth - 1)
            rows.append(
                {
                    "law": name,
                    "scheme": scheme,
                    "setting": setting,
                    "cycles": life.simulated,
                    "error [%]": 100 * true,
                    "error told [%]": 100 * life.error,
                    "told / true": life.error / true,
                    "CPU [s]": spent,
                }
            )
    return rows


def cost_rows(options: Any) -> list[dict[str, Any]]:
    """Cycles that each scheme needs for an error: of the pair the cheapest setting that keeps it,
    of the fixed factor (first order) between its settings."""
    rows, found = closed_form_rows(options.quick), []
    for law in dict.fromkeys(row["law"] for row in rows):
        for error in AT:
            own = {"law": law, "error [%]": 100 * error}
            mine = [row for row in rows if row["law"] == law]
            pair = [r for r in mine if r["scheme"] == "3(2) pair" and r["error [%]"] <= 100 * error]
            own["3(2) pair"] = min(row["cycles"] for row in pair)
            fixed = [r for r in mine if r["scheme"] == "fixed factor"]
            errors = np.log([row["error [%]"] for row in fixed])[::-1]
            cycles = np.log([row["cycles"] for row in fixed])[::-1]
            between = math.exp(float(np.interp(math.log(100 * error), errors, cycles)))
            own["fixed factor"] = round(between)
            found.append(own | {"ratio": between / own["3(2) pair"]})
    return found


def four_bar() -> jc.Problem:
    """A turn of the planar four-bar, its bearing of lubricated steel."""
    rig = eqx.tree_at(
        lambda rig: rig.connections["B"].joint.bearing_wear.law.wear_coefficient,
        jc.scenes.four_bar("planar", cells=(72, 1)),
        jnp.asarray(WEAR_COEFFICIENT),
    )
    responses = {"mean force": jc.response.MeanContactForce("B")}
    integrator = jc.integrator.FixedStep(8e-6)
    return jc.Problem(rig, responses, {}, duration=2 * math.pi / 10, integrator=integrator)


def million_rows(_: Any) -> list[dict[str, Any]]:
    """Lives of a million cycles by tolerance, beside the tight one: all cells of the map."""
    asked = four_bar()
    jc.wear_life(asked, cycles=1)
    tight, spent = timed(asked, cycles=MILLION, accuracy=TIGHT)
    exact = np.asarray(tight.worn()["B"]["bearing"])
    once = MILLION * np.asarray(tight.stages[0].settled.wear["B"]["bearing"])
    rows = [_million("carried on from one cycle", 2, once, None, exact, 0.0)]
    for tolerance in FOUR_BAR_TOLERANCES:
        life, took = timed(asked, cycles=MILLION, accuracy=tolerance)
        depth = np.asarray(life.worn()["B"]["bearing"])
        rows.append(
            _million(f"tolerance {tolerance:g}", life.simulated, depth, life.error, exact, took)
        )
    last = _million(f"tolerance {TIGHT:g}", tight.simulated, exact, tight.error, exact, spent)
    return [*rows, last | {"off [%]": 0.0}]


def _million(
    name: str, cycles: int, depth: np.ndarray, told: float | None, exact: np.ndarray, spent: float
) -> dict[str, Any]:
    off = np.sqrt(np.mean((depth - exact) ** 2) / np.mean(exact**2))
    return {
        "life": name,
        "cycles": cycles,
        "largest depth [um]": 1e6 * float(depth.max()),
        "off [%]": 100 * float(off),
        "error told [%]": None if told is None else 100 * told,
        "CPU [s]": spent,
    }


def chaotic_rows(_: Any) -> list[dict[str, Any]]:
    """Lives of a slider-crank that rattles, from starts that lie some cycles apart: by how much
    their volumes scatter, and what each tells."""
    return [_chaotic_row(most) for most in MOST]


def _chaotic_row(most: int) -> dict[str, Any]:
    rig, period = jc.scenes.slider_crank(wear=True), 2 * math.pi / 50
    state, volumes, told, cycles = None, [], [], []
    depths: list[np.ndarray] = []
    of_depth: list[float] = []
    for _ in range(STARTS):
        settled = jc.steady_cycle(rig, period, cycles=5, state=state)
        state = settled.state
        life = jc.wear_life(
            jc.Problem(
                rig, {"force": jc.response.MeanContactForce("B")}, {}, duration=period, state=state
            ),
            cycles=MILLION,
            accuracy=2e-2,
            max_cycles=most,
        )
        volumes.append(float(life.over_life("volume")[-1]))
        told.append(float(life.errors_of_volume[-1]))
        depths.append(np.asarray(life.worn()["B"]["bearing"]))
        of_depth.append(life.error)
        cycles.append(life.simulated)
    scatter = np.std(volumes, ddof=1) / np.mean(volumes)
    mean = np.mean(depths, axis=0)
    apart = np.sqrt(np.mean(np.square(depths - mean)) / np.mean(mean**2) * STARTS / (STARTS - 1))
    return {
        "cycles a rate, at most": most,
        "lives": STARTS,
        "cycles each, mean": float(np.mean(cycles)),
        "scatter of volume, 1.96 sigma [%]": 196 * float(scatter),
        "error told, mean [%]": 100 * float(np.mean(told)),
        "scatter of depths, 1.96 sigma [%]": 196 * float(apart),
        "error of depth told, mean [%]": 100 * float(np.mean(of_depth)),
        "within what they tell": int(
            sum(abs(v / np.mean(volumes) - 1) <= t for v, t in zip(volumes, told, strict=True))
        ),
    }


TABLES = {
    "Closed forms at 1 %": form_rows,
    "Derivatives of lives beside closed forms": derivative_rows,
    "A load that falls with wear: error and cost": lambda o: closed_form_rows(o.quick),
    "Cycles for an error": cost_rows,
    "A million cycles of the planar four-bar": million_rows,
    "Lives of a slider-crank that rattles": chaotic_rows,
}

if __name__ == "__main__":
    run_tables(TABLES)
