"""What a wear life costs at which error: on loads that fall with wear, whose depth has a closed
form, beside the fixed factor of the papers; lives of a million cycles of the four-bar and of the
3RSR, judged by one with a tighter tolerance; and whether the error told of chaotic motion is that
by which lives from other starts differ.

Cycles are all that were simulated, those in which the machine settles included. CPU seconds of a
warm program; "first time": with compiling.
"""

import math
import time
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, report, sign
from tests.rigs.wearing_ring import ClosedForm, problem, wearing_ring

# Depth [m] at which the force has fallen to about a half, by law.
LAWS = {"exponential": (False, 5e-6), "square root": (True, 1e-5)}
TOLERANCES = (0.2, 1e-2, 3e-3, 1e-3, 3e-4)
JUMPS = (4, 16, 64, 256)
# Errors at which costs are compared.
AT = (1e-2, 1e-3)
FOUR_BAR_TOLERANCES, TIGHT = (5e-2, 2e-2, 1e-2), 2e-3
# Period and steps [s] of the 3RSR.
PARALLEL = {"quiet": (1.0, 5e-5), "rattling": (0.3, 2e-5)}
# Cycles a rate at the most: by default, and as many as run side by side.
MOST = {"quiet": (12,), "rattling": (12, 48)}
WEAR_COEFFICIENT, MILLION, STARTS = 2e-5, 1e6, 12


def timed(*args: Any, **kwargs: Any) -> tuple[Any, float]:
    """A life, and its CPU seconds after it has been compiled."""
    begun = time.process_time()
    life = jc.wear_life(*args, **kwargs)
    return life, time.process_time() - begun


def closed_form_rows(laws: dict) -> list[dict[str, Any]]:
    """A row for each scheme and each of its settings."""
    rows = []
    for name, (hyperbolic, depth) in laws.items():
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


def cost_rows(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Cycles that each scheme needs for an error: of the pair the cheapest setting that keeps it,
    of the fixed factor (first order) between its settings."""
    found = []
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


def parallel(period: float, step: float) -> jc.Problem:
    """A cycle of the 3RSR."""
    rig = jc.scenes.parallel_3rsr(period=period)
    responses = {"mean force": jc.response.MeanContactForce("S1")}
    integrator = jc.integrator.ImplicitStep(step, rebound=1.0)
    return jc.Problem(rig, responses, {}, duration=period, integrator=integrator)


def parallel_rows() -> list[dict[str, Any]]:
    """Lives of a million cycles, quiet and rattling, at 2 %."""
    return [
        _parallel_row(name, parallel(*given), most)
        for name, given in PARALLEL.items()
        for most in MOST[name]
    ]


def _parallel_row(name: str, asked: jc.Problem, most: int) -> dict[str, Any]:
    jax.clear_caches()
    given = {"accuracy": 2e-2, "most": most}
    _, first = timed(asked, cycles=MILLION, **given)
    life, spent = timed(asked, cycles=MILLION, **given)
    return {
        "motion": name,
        "period [s]": float(asked.duration),
        "cycles a rate, at most": most,
        "cycles": life.simulated,
        "largest depth [um]": 1e6 * float(life.over_life("depth")[-1]),
        "error told [%]": 100 * life.error,
        "of the volume [%]": 100 * float(life.errors_of_volume[-1]),
        "a cycle by its saves, at most [%]": 100 * float(life.by_saves.max()),
        "CPU [s]": spent,
        "first time [s]": first,
    }


def million_rows() -> list[dict[str, Any]]:
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


def chaotic_rows() -> list[dict[str, Any]]:
    """Lives of a slider-crank that rattles, from starts that lie some cycles apart: by how much
    their volumes scatter, and what each tells."""
    return [_chaotic_row(most) for most in MOST["rattling"]]


def _chaotic_row(most: int) -> dict[str, Any]:
    rig, period = jc.scenes.slider_crank(wear=True), 2 * math.pi / 50
    state, volumes, told, cycles = None, [], [], []
    for _ in range(STARTS):
        settled = jc.settled(rig, period, cycles=5, state=state)
        state = settled.state
        life = jc.wear_life(
            jc.Problem(
                rig, {"force": jc.response.MeanContactForce("B")}, {}, duration=period, state=state
            ),
            cycles=MILLION,
            accuracy=2e-2,
            most=most,
        )
        volumes.append(float(life.over_life("volume")[-1]))
        told.append(float(life.errors_of_volume[-1]))
        cycles.append(life.simulated)
    scatter = np.std(volumes, ddof=1) / np.mean(volumes)
    return {
        "cycles a rate, at most": most,
        "lives": STARTS,
        "cycles each, mean": float(np.mean(cycles)),
        "scatter of volume, 1.96 sigma [%]": 196 * float(scatter),
        "error told, mean [%]": 100 * float(np.mean(told)),
        "within what they tell": int(
            sum(abs(v / np.mean(volumes) - 1) <= t for v, t in zip(volumes, told, strict=True))
        ),
    }


def main() -> None:
    more = {"only": {"default": "", "help": "only tables whose title holds this"}}
    options = arguments(__doc__, **more)
    laws = {"exponential": LAWS["exponential"]} if options.quick else LAWS
    if not options.only:
        rows = closed_form_rows(laws)
        report("A load that falls with wear: error and cost", rows, options)
        report("Cycles for an error", cost_rows(rows), options)
        measured = ["A load that falls with wear: error and cost", "Cycles for an error"]
    else:
        measured = []
    lives = {
        "A million cycles of the planar four-bar": million_rows,
        "A million cycles of the 3RSR": parallel_rows,
        "Lives of a slider-crank that rattles": chaotic_rows,
    }
    for title, rows_of in lives.items():
        if options.only in title and not options.quick:
            report(title, rows_of(), options)
            measured.append(title)
    sign("benchmarks.claims.wear_life", options.json, measured)


if __name__ == "__main__":
    main()
