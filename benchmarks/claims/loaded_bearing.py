"""What a journal pressed into its bearing loses to friction, and wears, on every rung, beside runs
of Adaptive at two tolerances; and whether a run that is off says so.

Laws of friction, loads, radii, and whether the journal creeps (set down at rest under a load that
swings) or slides at first. A run is right within 2 %; otherwise it ends early, or says so by a
warning that concerns wear, or is silently wrong. Where nothing is lost (the journal has not touched
yet), there is nothing to judge.
"""

import itertools
from typing import Any

import jaxclear as jc
from benchmarks.measure import arguments, report
from jaxclear.studies.usual_integrator import usual_integrator
from tests.rigs.loaded_bearing import loaded_bearing, losses

DURATION, SAVES = 0.01, 41
TIGHTER, TIGHT = (
    jc.integrator.Adaptive(rtol=1e-9, atol=1e-13),
    jc.integrator.Adaptive(rtol=1e-8, atol=1e-12),
)
# Right up to this share; below the least loss [J] the journal has not rubbed.
WITHIN, LEAST = 0.02, 1e-12
LAWS = (
    "Stribeck",
    "CoulombTanh",
    "ThreeZone",
    "AdamsStep",
    "Ambrosio",
    "Threlfall",
    "BengisuAkay",
    "Dahl",
    "LuGre",
)
LOADS, RADII, STIFFNESSES = (
    (1.0, 5.0, 20.0, 100.0, 500.0, 1000.0, 5000.0),
    (2e-3, 5e-3, 10e-3, 50e-3),
    (1e9, 1e11),
)
QUICK_LAWS, QUICK_LOADS, QUICK_RADII, QUICK_STIFFNESSES = (
    ("Stribeck", "Dahl"),
    (1.0, 20.0, 500.0, 5000.0),
    (2e-3, 10e-3, 50e-3),
    (1e9,),
)
ENDED, RIGHT, SAID, SILENT, UNSURE, NOTHING = (
    "ended early",
    "within 2 %",
    "said so",
    "silently wrong",
    "reference unsure",
    "nothing lost",
)


def rungs(rig: jc.Mechanism) -> dict[str, Any]:
    """What a study takes by itself, and the rungs as they come."""
    return {
        "usual in a study": usual_integrator(rig, DURATION)[0],
        "FixedStep()": jc.integrator.FixedStep(),
        "ImplicitStep()": jc.integrator.ImplicitStep(),
        "Adaptive()": jc.integrator.Adaptive(),
    }


def run_of(rig: jc.Mechanism, integrator: Any) -> Any:
    return jc.simulate(rig, DURATION, integrator=integrator, save=SAVES, balance=True, throw=False)


def off(found: Any, exact: Any) -> float:
    """How far friction loss or worn volume are off, the worse of the two."""
    return max(abs(a / b - 1) for a, b in zip(found[:2], exact[:2], strict=True))


def verdict(run: Any, exact: Any) -> tuple[str, float]:
    """The class of a run, and how far it is off."""
    if not run.succeeded:
        return ENDED, float("nan")
    error = off(losses(run), exact)
    if error <= WITHIN:
        return RIGHT, error
    return (SAID if warns(run) else SILENT), error


def warns(run: Any) -> bool:
    """Whether a run says that friction loss or wear is off."""
    return "losses" in run.verification.beyond


def cases(quick: bool) -> list[tuple]:
    """(law, load [N], radius [m], stiffness, sliding)."""
    if quick:
        parts: tuple = (QUICK_LAWS, QUICK_LOADS, QUICK_RADII, QUICK_STIFFNESSES)
    else:
        parts = (LAWS, LOADS, RADII, STIFFNESSES)
    return list(itertools.product(*parts, (False, True)))


def rows_of(case: tuple) -> list[dict[str, Any]]:
    """A row for each rung of a case."""
    law, load, radius, stiffness, sliding = case
    rig = loaded_bearing(
        load, getattr(jc.friction, law)(), radius=radius, stiffness=stiffness, sliding=sliding
    )
    exact, beside = (losses(run_of(rig, tight)) for tight in (TIGHTER, TIGHT))
    told = {
        "law": law,
        "load [N]": load,
        "radius [mm]": 1e3 * radius,
        "K [N/m^1.5]": stiffness,
        "journal": "slides" if sliding else "creeps",
    }
    rows = []
    for name, integrator in rungs(rig).items():
        run = run_of(rig, integrator)
        if exact[0] < LEAST:
            kind, error = NOTHING, 0.0
        elif off(beside, exact) > 0.5 * WITHIN:
            kind, error = UNSURE, off(losses(run), exact)
        else:
            kind, error = verdict(run, exact)
        rows.append(told | {"rung": name, "off by": error, "class": kind, "warns": warns(run)})
    return rows


def counted(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """By rung how many runs are of which class, and how many right ones warn of friction."""
    out = []
    for name in dict.fromkeys(row["rung"] for row in rows):
        own = [row for row in rows if row["rung"] == name]
        kinds = {
            kind: sum(row["class"] == kind for row in own)
            for kind in (RIGHT, SAID, ENDED, SILENT, UNSURE, NOTHING)
        }
        needless = sum(row["class"] == RIGHT and row["warns"] for row in own)
        silent = [row["off by"] for row in own if row["class"] == SILENT]
        out.append(
            {"rung": name}
            | kinds
            | {"right, yet warn": needless, "worst silent": max(silent, default=0.0)}
        )
    return out


def main() -> None:
    options = arguments(__doc__)
    rows = [row for case in cases(options.quick) for row in rows_of(case)]
    silent = [row for row in rows if row["class"] == SILENT]
    if silent:
        report("loaded bearings: silently wrong", silent, options)
    report("loaded bearings: classes by rung", counted(rows), options)


if __name__ == "__main__":
    main()
