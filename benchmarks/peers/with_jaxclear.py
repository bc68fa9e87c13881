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
from jaxclear.studies.batch import evaluate_all

# jaxclear saves this often within a saving interval of the others, and looks this often between two
# of its own: forces are wanted every 2 us or so, and what lies between two saved states follows
# from their speeds.
FINER_SAVES, LOOKS = 4, 6
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


def peak_force(trajectory: jc.Trajectory) -> jax.Array:
    """Largest contact force, between the saved states too: coordinates by Hermite's cubic, their
    speeds by its derivative.
    """
    t, states = trajectory.time, trajectory.states
    n = trajectory.mechanism.topology.coordinate_count
    h = (t[1:] - t[:-1])[:, None, None]
    before, after = states[:-1, None], states[1:, None]
    s = jnp.linspace(0.0, 1.0, LOOKS, endpoint=False)[None, :, None]
    q0, q1, v0, v1 = before[..., :n], after[..., :n], before[..., n : 2 * n], after[..., n : 2 * n]
    slope = (q1 - q0) / h
    bend, twist = 3 * slope - 2 * v0 - v1, v0 + v1 - 2 * slope
    q = q0 + h * s * (v0 + s * (bend + s * twist))
    v = v0 + s * (2 * bend + 3 * s * twist)
    rest = jnp.broadcast_to(after[..., 2 * n :], (*q.shape[:2], states.shape[1] - 2 * n))
    fine = jnp.concatenate([q, v, rest], axis=-1).reshape(-1, states.shape[1])
    times = (t[:-1, None] + (t[1:] - t[:-1])[:, None] * s[0, :, 0]).reshape(-1)
    closer = eqx.tree_at(lambda r: (r.time, r.states), trajectory, (times, fine))
    return jnp.max(closer.contact("B").normal_force)


@eqx.filter_jit
def _run(mechanism, coordinates, speeds, times, integrator):
    found = run(mechanism, coordinates, speeds, times, integrator)
    places = found.coordinate("G")[FINER_SAVES::FINER_SAVES, 0]
    return places, peak_force(found), found.accepted_steps + found.rejected_steps


def program(name: str, entry: Entry, question: rig.Question) -> Program:
    """jaxclear as a program among others."""
    mechanism = rig.mechanism()
    start = jc.assemble(mechanism)
    times = jnp.linspace(0.0, question.duration, question.saves * FINER_SAVES + 1)

    def alone(setting):
        found = _run(mechanism, start.coordinates, start.speeds, times, entry.integrator(setting))
        places, peak, steps = jax.block_until_ready(found)
        return Answer(np.asarray(places), float(peak), int(steps))

    @cache
    def problem(setting):
        return jc.Problem(
            mechanism,
            {"peak": peak_force, "place": jc.response.FinalCoordinate("G", unit="m")},
            {
                "clearance": jc.Variable(
                    lambda m: m.connections["B"].joint.clearance, tolerance=0.1e-3
                )
            },
            duration=question.duration,
            integrator=entry.integrator(setting),
            save=question.saves * FINER_SAVES + 1,
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
