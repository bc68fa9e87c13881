"""jaxclear on the slider-crank of `peers.rig`, as one program among others. A further integrator is
a line more in `JAXCLEAR`.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.peers import rig
from benchmarks.peers.rig import Answer, Batch, Program
from jaxclear.integrators import Outcome
from jaxclear.simulation.simulate import run
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


@eqx.filter_jit
def _run(mechanism, coordinates, speeds, times, integrator):
    found = run(mechanism, coordinates, speeds, times, integrator)
    places = found.coordinate("G")[1:]
    return places, PEAK(found), found.accepted_steps + found.rejected_steps


def program(name: str, entry: Entry, question: rig.Question) -> Program:
    """jaxclear as a program among others."""
    mechanism = rig.mechanism()
    start = jc.assemble(mechanism)
    times = jnp.linspace(0.0, question.duration, question.saves + 1)

    def alone(setting):
        found = _run(mechanism, start.coordinates, start.speeds, times, entry.integrator(setting))
        places, peak, steps = jax.block_until_ready(found)
        return Answer(np.asarray(places), float(peak), int(steps))

    @cache
    def problem(setting):
        return jc.Problem(
            mechanism,
            {"peak": PEAK, "place": jc.response.FinalCoordinate("G", unit="m")},
            {
                "clearance": jc.Variable(
                    lambda m: m.connections["B"].joint.clearance, tolerance=0.1e-3
                )
            },
            duration=question.duration,
            integrator=entry.integrator(setting),
            save=question.saves + 1,
        )

    def batch(setting, clearances):
        found = evaluate_all(problem(setting), jnp.asarray(clearances)[:, None], chunk=entry.chunk)
        rows = np.stack([found.responses["peak"], found.responses["place"]], axis=1)
        return np.where(found.outcome[:, None] == Outcome.REACHED, rows, np.nan)

    how = "evaluate_all" if entry.chunk is None else f"evaluate_all, chunks of {entry.chunk}"
    return Program(name, entry.law, entry.ladder, alone, Batch(batch, how), entry.adaptive)


def programs(question: rig.Question) -> list[Program]:
    """All entries."""
    return [program(name, entry, question) for name, entry in JAXCLEAR.items()]
