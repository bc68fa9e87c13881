"""What is asked of a run, as plain numbers, and how far two runs are apart.

Errors are shares of the answer itself; of places, of the longest way that a body has gone (of a
hundred times how far a journal comes from its bearing's centre where that is longer: its clearance
and what the contact gives way); of offsets in a joint, of its clearance; of drift, of the shortest
part of the loop. Forces are those of the joints with clearance, or else the reactions of all
joints.

`told` is what a run itself says of the same answers, by its replicas.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from jaxclear.components.clearance import AbstractClearance
from jaxclear.results.state_history import over_time
from jaxclear.results.verification import Unverified
from jaxclear.simulation.invariants import openings

RESPONSES = (
    "place",
    "offset",
    "mean force",
    "peak force",
    "friction loss",
    "worn volume",
    "worn depth",
    "drift",
)
# Those of them of which a run tells errors, by the names that it gives them.
ANSWERS = {
    "places of bodies": "place",
    "places in the gap": "offset",
    "mean contact force": "mean force",
    "peak contact force": "peak force",
    "friction loss": "friction loss",
    "worn volume": "worn volume",
    "worn depth": "worn depth",
}
# An energy below this share of what the run turns over is no answer that a user would read.
SMALL_ENERGY = 1e-3
# Forces, volumes and depths below these are rounding [N, m3, m].
NO_FORCE, NO_VOLUME, NO_DEPTH = 1e-6, 1e-24, 1e-18
# Bodies that go less far than this many clearances only move within them.
GAPS = 100.0


class Answers(eqx.Module):
    """Places (bodies, time, 3) [m]; offsets (gaps, time, 3) and clearances of the joints along
    each axis (gaps, 3) [m]; mean, peak and least forces by joint [N], and how far the first two, if
    they are of saved instants, differ between every second saving time and the others (2, joints);
    energies lost in friction and turned over [J]; worn volumes and depths by joint; drift [1]."""

    place: Any
    offset: Any
    clearance: Any
    mean_force: Any
    peak_force: Any
    least_force: Any
    unsampled: Any
    friction_loss: Any
    turnover: Any
    volume: Any
    depth: Any
    drift: Any


def surfaces(mechanism: jc.Mechanism) -> tuple[tuple[str, str], ...]:
    """(joint, surface) of everything that wears."""
    kinds = {
        name: connection.joint.maps()
        for name, connection in mechanism.connections.items()
        if name in mechanism.topology.clearances
    }
    return tuple((name, surface) for name, maps in kinds.items() for surface in maps)


def read(run: jc.Trajectory, balance: bool, wears: tuple, every: int = 1) -> Answers:
    """All answers of a run in one program, places and offsets at each `every`th saving time. Where
    that is not 1, and forces are no means, peaks are those of the saved instants alone: what a
    response says of the time between them does not judge itself."""
    # What replicas told is no part of the program.
    bare = dataclasses.replace(run, verification=Unverified())
    return jax.tree.map(np.asarray, _read(bare, balance, wears, every))


@eqx.filter_jit
def _read(run: jc.Trajectory, balance: bool, wears: tuple, every: int) -> Answers:
    rig = run.mechanism
    bodies = [run.body(name) for name in rig.bodies]
    gaps = tuple(run.formulation.contact_joints(rig))
    offset, clearance = jnp.zeros((0, len(run.time), 3)), jnp.zeros((0, 3))
    if gaps:
        contacts = [run.contact(name) for name in gaps]
        forces = jnp.stack([jnp.sum(contact.normal_force, axis=-1) for contact in contacts])
        means = jnp.stack([jc.response.MeanContactForce(name)(run) for name in gaps])
        offset = jnp.stack(
            [
                _across(contact.offset, rig, name)
                for contact, name in zip(contacts, gaps, strict=True)
            ]
        )
        clearance = jnp.stack([_gap(rig, name) for name in gaps])
    else:
        forces = _reactions(run)
        means = jnp.mean(forces, axis=1)
    if run.formulation.forces_are_means:
        forces = forces[:, 1:]
    unsampled, peaks = _between_halves(forces), jnp.max(forces, axis=1)
    if gaps:  # the means are of impulses that the runs carry
        unsampled = unsampled.at[0].set(0.0)
    if gaps and not run.formulation.forces_are_means:
        peaks = jnp.stack([jc.response.PeakContactForce(name)(run) for name in gaps])
        saved = jnp.stack([jnp.max(contact.normal_force) for contact in contacts])
        # Beyond those of the saving times they are of all steps.
        told = unsampled.at[1].set(jnp.where(peaks > saved, 0.0, unsampled[1]))
        peaks, unsampled = (peaks, told) if every == 1 else (saved, unsampled)
    lost, turned = jnp.zeros(()), jnp.zeros(())
    if balance:
        energies = run.energy_balance()
        lost = energies.friction_loss[-1]
        turned = jnp.max(energies.kinetic) + jnp.max(jnp.abs(energies.input))
    loops = bool(run.history.model().system.closures)
    drift = jnp.max(over_time(run.history, openings)) if loops else 0.0
    return Answers(
        jnp.stack([body.com[::every] for body in bodies]),
        offset[:, ::every],
        clearance,
        means,
        peaks,
        jnp.min(forces, axis=1),
        unsampled,
        lost,
        turned,
        jnp.array([run.worn_volume(*one)[-1] for one in wears]),
        jnp.array([jnp.max(run.worn_depth(*one)) for one in wears]),
        jnp.asarray(drift),
    )


def _reactions(run: jc.Trajectory) -> Any:
    """Of every joint, over time."""
    reactions = [run.reaction(name).force for name in run.mechanism.connections]
    return jnp.stack([jnp.sqrt(jnp.sum(force**2, axis=-1)) for force in reactions])


@eqx.filter_jit
def _mean_and_peak(run: jc.Trajectory) -> Any:
    """Of the reactions at the saving times (2, joints)."""
    forces = _reactions(run)
    return jnp.stack([jnp.mean(forces, axis=1), jnp.max(forces, axis=1)])


def told(run: jc.Trajectory) -> dict[str, float]:
    """The largest error that replicas tell of each response, as a share; of no other is any
    told."""
    known = run.verification.table()
    names = known["quantity"].str.split(', "').str[0].map(ANSWERS)
    found = known["relative error"].groupby(names).max().to_dict()
    if len(known) and not run.formulation.contact_joints(run.mechanism):
        forces = run.estimate(_mean_and_peak)
        shares = np.max(forces.error, axis=1) / (np.max(forces.value, axis=1) + NO_FORCE)
        found |= dict(zip(("mean force", "peak force"), shares.tolist(), strict=True))
    return found


def _between_halves(forces: Any) -> Any:
    """Difference of mean and of peak between every second instant and the others: large where
    impacts are shorter than the time between two."""
    halves = [forces[:, start : 2 * (forces.shape[1] // 2) : 2] for start in (0, 1)]
    means, peaks = ([f(half, axis=1) for half in halves] for f in (jnp.mean, jnp.max))
    return jnp.abs(jnp.stack([means[0] - means[1], peaks[0] - peaks[1]]))


def sampling(answers: Answers) -> dict[str, float]:
    """How far forces at the saved instants stand for those between, as a share of themselves."""
    pairs = zip(("mean force", "peak force"), (answers.mean_force, answers.peak_force), strict=True)
    return {
        name: float(np.max(answers.unsampled[k]) / (np.max(value) + NO_FORCE))
        for k, (name, value) in enumerate(pairs)
    }


def _collar(joint: Any) -> Any:
    return getattr(joint, "flange", None)


def _gap(rig: jc.Mechanism, name: str) -> Any:
    """Clearance of a joint along its three axes, also of one that its formulation sees as always
    touching; along a bearing that of its collars."""
    joint = rig.connections[name].joint
    across = joint.clearance if isinstance(joint, AbstractClearance) else joint.gap.clearance
    collar = _collar(joint)
    return jnp.array([across, across, across if collar is None else collar.clearance])


def _across(offset: Any, rig: jc.Mechanism, name: str) -> Any:
    """The offset in those directions that a clearance bounds: not along a guide, nor along a
    bearing without collars."""
    joint = rig.connections[name].joint
    along = isinstance(joint, jc.clearance.BallSocket) or _collar(joint) is not None
    bounded = jnp.array([1.0, 1.0, 1.0 * along])
    if isinstance(joint, jc.clearance.SliderGuide):
        bounded = jnp.array([1.0, 0.0, 0.0])
    return offset * bounded


def apart(one: Answers, other: Answers) -> dict[str, float]:
    """Largest difference in each response, as a share of `other`'s; nan where there is none."""
    ways = [run.place - run.place[:, :1] for run in (one, other)]
    travelled = np.max(np.abs(ways[1]))
    reached = np.linalg.norm(other.offset, axis=-1)
    travelled = max(travelled, GAPS * np.max(other.clearance, initial=np.max(reached, initial=0.0)))
    scale = max(SMALL_ENERGY * float(other.turnover), 1e-15)
    found = {
        "place": _share(*ways, travelled),
        "mean force": _share(one.mean_force, other.mean_force, np.max(other.mean_force) + NO_FORCE),
        "peak force": _share(one.peak_force, other.peak_force, np.max(other.peak_force) + NO_FORCE),
        "drift": float(one.drift) if one.drift > 0 else np.nan,
    }
    if other.clearance.size:
        gaps = other.clearance[:, None, :]
        found["offset"] = _share(one.offset / gaps, other.offset / gaps, 1.0)
    if other.turnover > 0:
        loss = max(float(other.friction_loss), scale)
        found["friction loss"] = _share(one.friction_loss, other.friction_loss, loss)
    if other.volume.size:
        found["worn volume"] = _share(one.volume, other.volume, np.max(other.volume) + NO_VOLUME)
        found["worn depth"] = _share(one.depth, other.depth, np.max(other.depth) + NO_DEPTH)
    return {name: found.get(name, np.nan) for name in RESPONSES}


def _share(one: Any, other: Any, size: Any) -> float:
    worst = float(np.max(np.abs(np.asarray(one) - np.asarray(other))))
    return worst / float(size) if size > 0 else (0.0 if worst == 0 else np.inf)
