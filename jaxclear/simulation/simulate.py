"""From a mechanism to a trajectory: the start is assembled, then the state is carried from one
saving time to the next.

Worn surfaces enter the gap as they were at the last saving time, and are updated at every saving
time: wear is slow, the motion is fast, and a map that is constant within an interval costs the
equations of motion nothing but its reading.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.formulations.base import Field
from jaxclear.formulations.permanent_joints import fit
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.quantity import concrete
from jaxclear.integrators.adaptive import Adaptive
from jaxclear.integrators.base import (
    COMPLIANT,
    PERMANENT,
    RIGID,
    AbstractIntegrator,
)
from jaxclear.integrators.outcome import Outcome
from jaxclear.laws.contact import Rigid
from jaxclear.laws.restitution import restitution
from jaxclear.multibody.assembly import assemble
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.state import Layout
from jaxclear.multibody.system import System, prepare, readings
from jaxclear.native import verdict
from jaxclear.results.trajectory import Trajectory, layout_of
from jaxclear.simulation import progress

Worn = dict[str, dict[str, Array]]
# Weight of the laws' memories in the error control: they need not be exact, but a step longer than
# their time constant would make them explode (tests/oracles/test_contact_conservation.py has a long
# flight that failed with weight 0).
MEMORY_WEIGHT = 1e-2


class SimulationError(RuntimeError):
    """A run that ended early; the sentence says where and why. `trajectory` holds what was
    computed.
    """

    def __init__(self, sentence: str, trajectory: Trajectory):
        super().__init__(sentence)
        self.trajectory = trajectory


def unworn(system: System) -> Worn:
    """Depth maps of new surfaces, by joint and surface."""
    return {
        name: {
            surface: jnp.zeros(wear_map.cells)
            for surface, (wear_map, _) in bearing.joint.maps().items()
        }
        for name, bearing in system.bearings.items()
        if bearing.joint.maps()
    }


def deposit(system: System, layout: Layout, worn: Worn, before: Array, after: Array) -> Worn:
    """Depth maps after what was lost between two states."""
    worn = {name: dict(surfaces) for name, surfaces in worn.items()}
    for slot in layout.wear:
        wear_map = system.bearings[slot.bearing].joint.maps()[slot.surface][0]
        entries = slice(slot.start, slot.start + 1 + len(slot.averaged))
        change = after[entries] - before[entries]
        features: list[Any] = [0.0] * slot.feature_count
        for place, i in enumerate(slot.averaged):
            features[i] = safe_divide(change[1 + place], change[0])
        for i, value in slot.constants:
            features[i] = value
        old = worn[slot.bearing][slot.surface]
        worn[slot.bearing][slot.surface] = wear_map.deposit(
            old, change[:1], sp.stack(features)[None]
        )
    return worn


def run(
    mechanism: Mechanism,
    coordinates: Array,
    speeds: Array,
    times: Float[Array, " saves"],
    integrator: AbstractIntegrator,
    balance: bool = False,
    report: bool = False,
    worn: Worn | None = None,
) -> Trajectory:
    """The pure core of `simulate`: from consistent coordinates and speeds to a trajectory; maps and
    differentiates.
    """
    system = prepare(mechanism)
    layout = layout_of(system, balance, integrator.formulation)
    state = jnp.concatenate([coordinates, speeds, jnp.zeros(layout.size - layout.memory_start)])
    worn = unworn(system) if worn is None else worn
    rest = layout.size - layout.memory_start - layout.memory_count
    weights = jnp.repeat(
        jnp.array([1.0, MEMORY_WEIGHT, 0.0]),
        np.array([layout.memory_start, layout.memory_count, rest]),
    )

    def interval(carry, span):
        state, worn, warm_start, outcome, ended = carry
        start, stop, share = span
        running = outcome == Outcome.REACHED
        read = readings(system, worn)
        field = Field(system, read, mechanism.baumgarte, layout, projects=mechanism.projects)
        result = integrator.advance(field, start, stop, state, warm_start, weights, running)
        sound = jnp.all(jnp.isfinite(result.state))
        kept = jnp.where(running & sound, result.state, state)
        worn = deposit(system, layout, worn, state, kept)
        if report:
            jax.debug.callback(progress.advance, share)
        # What is not held to a tolerance (memories, worn volumes) can be lost while the steps still
        # succeed.
        found = jnp.where(
            sound | (result.outcome != Outcome.REACHED), result.outcome, Outcome.NOT_FINITE
        )
        outcome = jnp.where(running, found, outcome)
        ended = jnp.where(running & (outcome == Outcome.REACHED), stop, ended)
        counts = (jnp.where(running, result.accepted, 0), jnp.where(running, result.rejected, 0))
        return (kept, worn, result.warm_start, outcome, ended), (kept, read, counts)

    spans = (times[:-1], times[1:], (times[1:] - times[:-1]) / (times[-1] - times[0]))
    begun = Field(
        system, readings(system, worn), mechanism.baumgarte, layout, projects=mechanism.projects
    )
    warm_start = integrator.first_warm_start(begun, times[0], state)
    first = (state, worn, warm_start, jnp.asarray(Outcome.REACHED), times[0])
    (_, worn, _, outcome, ended), (states, read, (accepted, rejected)) = jax.lax.scan(
        interval, first, spans
    )
    states = jnp.concatenate([state[None], states])
    read = jax.tree.map(lambda x: jnp.concatenate([x[:1], x]), read)
    return Trajectory(
        mechanism,
        times,
        states,
        worn,
        read,
        outcome,
        ended,
        accepted.sum(),
        rejected.sum(),
        balance,
        integrator.formulation,
        verdict(outcome),
    )


_run = eqx.filter_jit(run)


def saving_times(duration: Any, save: Any) -> Array:
    """Times to save at: a number of equally spaced ones, or the given ones with 0 in front if it is
    missing.
    """
    if np.ndim(save) == 0:
        if isinstance(save, str) or int(save) != save or save < 2:
            raise ValueError(
                f"save={save!r}: give a whole number of saving times, at least 2, or the times "
                "themselves."
            )
        return jnp.linspace(0.0, jnp.asarray(duration, float), int(save))
    times = np.asarray(save, float)
    rising = times.ndim == 1 and times.size > 0 and np.all(np.diff(times) > 0)
    if not (rising and times[0] >= 0 and times[-1] <= float(duration)):
        raise ValueError(
            "the times to save at must increase from 0 or later to at most the duration."
        )
    times = times if times[0] == 0 else np.concatenate([[0.0], times])
    return jnp.asarray(times if times[-1] == duration else np.concatenate([times, [duration]]))


# Steps per time constant of a law's memory below which an explicit method lets it explode (2 for
# Euler and Heun, 2.8 for rk4).
MEMORY_STEPS = 2.0


def check_run(mechanism: Mechanism, integrator: AbstractIntegrator, times: Any = None) -> None:
    """Laws must suit compliant contact, and explicit steps must resolve their memories; where the
    number of steps between saving times is fixed, `times` tell their length. Raises `ValueError`
    with a sentence."""
    if not isinstance(mechanism, Mechanism):
        raise ValueError(f"what is simulated is {mechanism!r}; it must be a jaxclear.Mechanism.")
    if not isinstance(integrator, AbstractIntegrator):
        raise ValueError(
            f"the integrator is {integrator!r}; it must be one of jaxclear.integrator, such as "
            "Adaptive()."
        )
    known = times is not None and not isinstance(times, jax.core.Tracer)
    step = concrete(integrator.relaxing_step(np.max(np.diff(times)) if known else None))
    if mechanism.projects and isinstance(integrator, Adaptive):
        raise ValueError(
            f'the loop through joint "{mechanism.topology.loops[0]}" is to be closed by '
            "projection, which integrator.Adaptive "
            "would take for an error; give stabilisation=jaxclear.Baumgarte(), or take an "
            "integrator with fixed steps."
        )
    if integrator.formulation != COMPLIANT:
        return check_set_valued(mechanism, integrator)
    for name in mechanism.topology.clearances:
        for pairing in mechanism.connections[name].joint.contact_laws():
            law = pairing.friction
            if isinstance(pairing.contact, Rigid):
                raise ValueError(
                    f'joint "{name}" has contact.Rigid, which has no force law: take '
                    "integrator.MoreauJean, or a compliant law "
                    "such as contact.CarvalhoMartins."
                )
            if law is not None and law.set_valued:
                raise ValueError(
                    f'joint "{name}" has set-valued friction {type(law).__name__}, which has no '
                    "force law: take "
                    "integrator.MoreauJean or NonColliding, or a regularised law such as "
                    "friction.ThreeZone or friction.LuGre."
                )
            memory = (
                concrete(pairing.contact.memory_time)
                if pairing.contact.remembers_impact_speed
                else None
            )
            if step is not None and memory is not None and step > MEMORY_STEPS * memory:
                raise ValueError(
                    f'steps of {step:.6g} s are too long for joint "{name}": its contact law '
                    "remembers the impact speed with "
                    f"memory_time {memory} s and would explode; take steps below "
                    f"{MEMORY_STEPS * memory:.3g} s, a "
                    "longer memory_time, or capture_impacts=True."
                )


def seen_by(mechanism: Mechanism, integrator: AbstractIntegrator) -> Mechanism:
    """The mechanism in the integrator's formulation: fitted, where its clearance joints always
    touch.
    """
    return fit(mechanism) if integrator.formulation == PERMANENT else mechanism


def check_set_valued(mechanism: Mechanism, integrator: AbstractIntegrator) -> None:
    """Laws must say what they are without compliance. Raises `ValueError` with a sentence."""
    name_of = f"integrator.{type(integrator).__name__}"
    for name in mechanism.topology.clearances:
        for pairing in mechanism.connections[name].joint.contact_laws():
            if pairing.friction is not None and pairing.friction.coulomb() is None:
                raise ValueError(
                    f'joint "{name}" has friction {type(pairing.friction).__name__}, of which '
                    f"{name_of} does not know the "
                    "coefficients; give friction.Coulomb(mu_kinetic=..., mu_static=...)."
                )
            if integrator.formulation == RIGID and restitution(pairing.contact) is None:
                raise ValueError(
                    f'joint "{name}" has contact {type(pairing.contact).__name__}, whose '
                    "restitution depends on mass and speed; "
                    f"for {name_of} give contact.Rigid(restitution=...)."
                )


def check_duration(duration: Any) -> Any:
    """The duration, if it is a positive number of seconds. Raises `ValueError`."""
    if not 0 < float(duration) < np.inf:
        raise ValueError(f"the duration is {duration} s; it must be positive and finite.")
    return duration


def simulate(
    mechanism: Mechanism,
    duration: float,
    *,
    integrator: AbstractIntegrator | None = None,
    save: Any = 501,
    start_concentric: bool = True,
    balance: bool = False,
    progress_bar: bool = False,
    throw: bool = True,
) -> Trajectory:
    """Simulate a mechanism for `duration` [s] from its own start.

    `save`: number of equally spaced saving times, or the times [s]; worn surfaces are updated at
    these times. `integrator`: `jaxclear.integrator.Adaptive()` by default. `start_concentric`:
    journals start in the middle of their bearings, moving with them; False leaves the given start
    and speeds as they are but for ideal loops (a journal that is to be thrown needs it). `balance`:
    also integrate the energies that `Trajectory.energy_balance` needs. Changing numbers, duration
    or tolerances does not compile again; changing the number of saving times does. Raises
    `ValueError` for a mechanism that cannot start, and, unless `throw=False`, `SimulationError`
    with a sentence for a run that ends early.
    """
    check_duration(duration)
    integrator = Adaptive() if integrator is None else integrator
    times = saving_times(duration, save)
    check_run(mechanism, integrator, times)
    mechanism = seen_by(mechanism, integrator)
    start = assemble(mechanism, start_concentric)
    with progress.bar(progress_bar, "simulating"):
        trajectory = _run(
            mechanism, start.coordinates, start.speeds, times, integrator, balance, progress_bar
        )
        trajectory = jax.block_until_ready(trajectory)
    if throw and not trajectory.succeeded:
        raise SimulationError(trajectory.result, trajectory)
    return trajectory
