"""The cheapest tolerances and clearances of two machines from one command: the antenna's four
clearances against its pointing error, the four-bar's clearance and links against worn depth and
follower error at once.

Writes figures (PNG), tables (CSV) and stores into a folder, from which an interrupted design
goes on, and prints what it found.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import jaxclear as jc
from jaxclear import plot
from jaxclear.commands.four_bar import PLACES
from jaxclear.commands.study import StudyFolder
from jaxclear.scenes.antenna import BASE, JOINTS, TIP, antenna
from jaxclear.scenes.four_bar import four_bar

# Clearances may be no smaller than this [m] in the worst case: room for oil and heat; assumed.
LEAST_CLEARANCE = 10e-6
# Costs are b/t (Chase & Greenwood 1988), with b [cost x m] assumed: a bore that is tight to 10 um
# costs 2 to 3, a link as long 0.5 to 1. Bounds [m] of tolerances and clearances are assumed too.
RADIAL, AXIAL, BORE, LINK = (2e-5, 3e-5), 1e-5, 2e-5, (0.5e-5, 1e-5, 1e-5, 1e-5)
TOLERANCES, CLEARANCES = (2e-6, 50e-6), (12e-6, 200e-6)
# Limits: boresight [rad], worn depth of a turn [m] and follower error [m].
POINTING, DEPTH, FOLLOWER = 1.5e-3, 27.7e-9, 64.5e-6
POINTING_STEP, POINTING_SAVES = 1e-3, 101
# Surfaces are updated at the saving times: with 800 a turn worn depths hang on them by 2 %, with
# 1600 by 0.7 %, at a tenth more of the time.
WEAR_SAVES = 1601
TURN = 2 * math.pi / 10.0
# Bounds of the first limit at which the front is drawn, as shares of it.
FRONT = (0.85, 0.92, 1.0, 1.1, 1.25)


class DesignQuestion(NamedTuple):
    """What `jaxclear.design` is asked: the problem, cost, limits, and what may be chosen."""

    problem: jc.Problem
    cost: dict[str, Any]
    limits: list[Any]
    choices: dict[str, Any]

    def designed(self, **options: Any) -> Any:
        """The design."""
        return jc.design(self.problem, self.cost, self.limits, **self.choices, **options)


def antenna_question() -> DesignQuestion:
    """Radial and axial clearance of both joints, and their tolerances, against the boresight's
    error over a period of the drive, mean and three deviations."""
    places: dict[str, Callable] = {}
    for name in JOINTS:
        places[f"{name} radial"] = lambda rig, name=name: rig.connections[name].joint.clearance
        places[f"{name} axial"] = lambda rig, name=name: (
            rig.connections[name].joint.flange.clearance
        )
    problem = jc.Problem(
        antenna("spatial", 100e-6),
        {"pointing error": jc.response.PointingAngle(TIP, BASE)},
        {name: jc.Variable(where, tolerance=10e-6) for name, where in places.items()},
        duration=1.0,
        save=POINTING_SAVES,
        integrator=jc.integrator.NonColliding(POINTING_STEP),
    )
    scales = (RADIAL[0], AXIAL, RADIAL[1], AXIAL)
    cost = {n: jc.cost.Reciprocal(b) for n, b in zip(places, scales, strict=True)}
    limits: list[Any] = [
        jc.limit.MeanAndDeviation("pointing error", at_most=POINTING, deviations=3)
    ]
    limits += [jc.limit.WorstCase(name, at_least=LEAST_CLEARANCE) for name in places]
    choices = {
        "tolerance": dict.fromkeys(places, TOLERANCES),
        "nominal": dict.fromkeys(places, CLEARANCES),
    }
    return DesignQuestion(problem, cost, limits, choices)


def four_bar_question() -> DesignQuestion:
    """The clearance of the coupler's bearing with its tolerance, and the tolerances of four links,
    against worn depth and follower error after a turn, mean and two deviations of both. Contact is
    compliant, so that depth comes from forces."""
    ideal = jc.simulate(four_bar("ideal"), TURN, save=WEAR_SAVES).body("follower").com
    problem = jc.Problem(
        four_bar("planar", 100e-6),
        {
            "worn depth": jc.response.PeakWornDepth("B"),
            "follower error": jc.response.PositionError("follower", ideal, axes=(0, 1)),
        },
        {name: jc.Variable(where, tolerance=20e-6) for name, where in PLACES.items()},
        duration=TURN,
        save=WEAR_SAVES,
    )
    cost = {n: jc.cost.Reciprocal(b) for n, b in zip(PLACES, (BORE, *LINK), strict=True)}
    limits = [
        jc.limit.MeanAndDeviation("worn depth", at_most=DEPTH, deviations=2),
        jc.limit.MeanAndDeviation("follower error", at_most=FOLLOWER, deviations=2),
        jc.limit.WorstCase("clearance", at_least=LEAST_CLEARANCE),
    ]
    choices = {"tolerance": dict.fromkeys(PLACES, TOLERANCES), "nominal": {"clearance": CLEARANCES}}
    return DesignQuestion(problem, cost, limits, choices)


QUESTIONS = {"antenna": antenna_question, "four-bar": four_bar_question}


def study(scene: str, folder: Path, accuracy: float = 5e-3, show: bool = True) -> None:
    """Designs the tolerances of a scene and writes tables and figures.

    Args:
        scene: one of `QUESTIONS`.
        folder: for the files.
        accuracy: share of its bound by which a limit may be exceeded [1].
        show: whether progress bars are shown.
    """
    files = StudyFolder(folder, f"{scene}_")
    question = QUESTIONS[scene]()
    options = {"settings": jc.DesignSettings(allowed_excess=accuracy), "progress_bar": show}
    best = question.designed(store=folder / f"{scene}_store", **options)
    print(f"{scene}\n{best}\n", flush=True)
    tables = {"design": best.table(), "limits": best.limit_table(), "history": best.history()}
    files.write_tables(**tables)
    for name in ("limits", "history"):
        print(f"{tables[name]}\n")
    bounds = [share * float(question.limits[0].bound()) for share in FRONT]
    front = jc.pareto_front(
        question.problem, question.cost, question.limits, bounds, **question.choices, **options
    )
    for bound, one in zip(bounds, front, strict=True):
        verdict = "holds" if one.holds else "does not hold"
        print(f"{question.limits[0].words()} {bound:.4g}: cost {one.cost:.4g}, {verdict}")
    files.write_figures(design=plot.design(best), front=plot.pareto_front(front))
    spared = np.ptp([one.cost for one in front])
    print(f"\nBetween the ends of the front lies {spared:.3g} of cost. {files.sentence()}")
