"""jaxclear on the slider-crank of `peers.rig`, as one program among others. A further integrator is
a line more in `JAXCLEAR`.
"""

import functools
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.peers import rig
from benchmarks.peers.rig import Answer, Batch, Program
from jaxclear.integrators import Outcome
from jaxclear.studies.store.batch import evaluate_all

# Samples a chunk of adaptive runs, which wait for the slowest of their chunk.
FEW = 16


class Entry(NamedTuple):
    """One way to run jaxclear: law of `rig.LAWS`, settings [s, or relative tolerance] from coarse
    to fine, the integrator of a setting, samples a chunk in a batch (None: as jaxclear chooses)."""

    law: str
    ladder: tuple[float, ...]
    integrator: Callable[[float], Any]
    adaptive: bool = False
    chunk: int | None = None


STEPS, TOLERANCES = (
    tuple(rig.TURN / rig.GRID / k for k in rig.steps_ladder(3e-6, 2e-8)),
    rig.tolerance_ladder(1e-5, 1e-11),
)


def _fixed(step):
    return jc.integrator.FixedStep(step)


def _adaptive(rtol):
    return jc.integrator.Adaptive(rtol=rtol, atol=rig.ATOL_SHARE * rtol)


JAXCLEAR = {
    "jaxclear FixedStep rk4": Entry("captured", STEPS, _fixed),
    "jaxclear Adaptive": Entry("captured", TOLERANCES, _adaptive, True, FEW),
}


PEAK = jc.response.PeakContactForce("B")


def _simulate(mechanism: jc.Mechanism, question: rig.Question, integrator: Any) -> jc.Trajectory:
    saves = question.saves + 1
    return jc.simulate(
        mechanism, question.duration, integrator=integrator, save=saves, verify=False
    )


def _problem(question: rig.Question, integrator: Any) -> jc.Problem:
    clearance = lambda m: m.connections["B"].joint.clearance
    return jc.Problem(
        rig.mechanism(),
        {"peak": PEAK, "place": jc.response.FinalCoordinate("G", unit="m")},
        {"clearance": jc.Variable(clearance, tolerance=0.1e-3)},
        duration=question.duration,
        integrator=integrator,
        save=question.saves + 1,
    )


def calls(question: rig.Question, rtol: float) -> dict[str, Callable[[], Any]]:
    """What a user calls for one run under error control, by its name."""
    mechanism, integrator = rig.mechanism(), _adaptive(rtol)
    problem = _problem(question, integrator)
    nominal = problem.nominal()
    run = functools.partial(_simulate, mechanism, question, integrator)

    def read():
        found = run()
        return np.asarray(found.coordinate("G")), float(PEAK(found))

    return {
        "simulate(verify=False)": run,
        "simulate(verify=False), places and peak read": read,
        "Problem.evaluate": lambda: problem.evaluate(nominal),
    }


def program(name: str, entry: Entry, question: rig.Question) -> Program:
    """jaxclear as a program among others."""
    mechanism = rig.mechanism()
    problem = cache(lambda setting: _problem(question, entry.integrator(setting)))

    def alone(setting):
        run = _simulate(mechanism, question, entry.integrator(setting))
        places, peak = np.asarray(run.coordinate("G"))[1:], float(PEAK(run))
        return Answer(places, peak, int(run.accepted_steps + run.rejected_steps))

    def batch(setting, clearances):
        found = evaluate_all(problem(setting), jnp.asarray(clearances)[:, None], chunk=entry.chunk)
        rows = np.stack([found.responses["peak"], found.responses["place"]], axis=1)
        return np.where(found.outcome[:, None] == Outcome.REACHED, rows, np.nan)

    how = "evaluate_all" if entry.chunk is None else f"evaluate_all, chunks of {entry.chunk}"
    return Program(name, entry.law, entry.ladder, alone, Batch(batch, how), entry.adaptive)


def programs(question: rig.Question) -> list[Program]:
    """All entries."""
    return [program(name, entry, question) for name, entry in JAXCLEAR.items()]
