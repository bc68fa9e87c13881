"""How fast slip turns round in contacts whose friction is largest near rest.

Where slip passes zero within a step, no step ends at the speeds at which friction is largest, and
none tells whether it would have held: a slider-crank's journal stuck for a twentieth of its run,
and steps up to ten times as long as it takes to cross these speeds wore off 15 % too much, all
alike. So who looks at a run again has to look that closely.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxclear.formulations.model import Instant
from jaxclear.ground.compiling import AROUND_A_KERNEL, compiled_quickly
from jaxclear.results.state_history import StateHistory, over_time
from jaxclear.results.trajectory import Trajectory

# Speeds [m/s] at which coefficients of friction are compared, and by how much of itself the largest
# has to be above that at high speeds.
SPEEDS, LARGER = np.logspace(-7, 2, 181), 0.05


def slip_at_peak(friction: Any) -> float | None:
    """The speed [m/s] from which on a law's coefficient is halfway down from its largest to that at
    high speeds; None where it does not fall, and of laws whose bristles have to bend first."""
    if friction is None or friction.set_valued or friction.bristles:
        return None
    numbers, law = jax.tree.flatten(friction)
    if any(np.ndim(number) for number in numbers):
        return _peak_of(friction)
    return _known_peak(law, *map(float, numbers))


@functools.lru_cache(maxsize=64)
def _known_peak(law: Any, *numbers: float) -> float | None:
    """Of a law with these numbers: runs of a mechanism ask again and again."""
    return _peak_of(jax.tree.unflatten(law, map(jnp.asarray, numbers)))


def _peak_of(friction: Any) -> float | None:
    found = np.asarray(_coefficients(friction, SPEEDS))
    largest, at_last = found.max(), found[-1]
    if not largest > (1 + LARGER) * at_last:
        return None
    return float(SPEEDS[found > 0.5 * (largest + at_last)].max())


_coefficients = compiled_quickly(lambda law, speeds: jax.vmap(law.steady_coefficient)(speeds))


def shortest_crossing(run: Trajectory) -> float:
    """The shortest time [s] in which a touching contact's slip goes through the speeds at which its
    friction is largest, as the saved instants tell; infinite where none does."""
    if run.formulation.forces_are_means:
        return np.inf
    joints = run.mechanism.topology.clearances
    laws = [own for name in joints for own in run.mechanism.connections[name].joint.contact_laws()]
    peaks = [slip_at_peak(own.friction) for own in laws]
    if all(peak is None for peak in peaks):
        return np.inf
    slips, forces = (np.asarray(each) for each in _slips(run.history))
    lengths = np.diff(np.asarray(run.time))[:, None]
    longer = np.maximum(lengths[:-1], lengths[1:])
    before, here, after = slips[:-2], slips[1:-1], slips[2:]
    rates = (before + after) / (lengths[:-1] + lengths[1:])
    passes = (here <= before) & (here <= after) & (here <= rates * longer)
    touching = (forces[:-2] > 0) & (forces[1:-1] > 0) & (forces[2:] > 0)
    fastest = np.max(rates, axis=0, where=passes & touching, initial=0.0)
    crossings = [
        peak / rate
        for peak, rate in zip(peaks, fastest, strict=True)
        if peak is not None and rate > 0
    ]
    return min(crossings, default=np.inf)


def _slips_and_forces(history: StateHistory) -> tuple[Array, Array]:
    """Slip [m/s] and normal force [N] of every contact at the saving times (time, contacts)."""

    def at(now: Instant) -> tuple[tuple, tuple]:
        reports = history.formulation.forces(now).reports
        points = [reports[name].points for name in history.mechanism.topology.clearances]
        own = [point for each in points for point in each]
        return tuple(p.slip_speed for p in own), tuple(p.normal_force for p in own)

    slips, forces = over_time(history, at)
    return jnp.stack(slips, axis=1), jnp.stack(forces, axis=1)


_slips = compiled_quickly(_slips_and_forces, AROUND_A_KERNEL)
