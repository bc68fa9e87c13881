"""Why a run is not finite, where that can be told: loads of the user's own class that give no
number, and bristles that explicit steps do not resolve, whose deflection settles within a
micrometre of sliding and grows without bound where a step slides farther; and what takes more steps
than are allowed: springs of couplings and of friction that holds.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.components.load_base import AbstractStateLoad
from jaxclear.formulations.contact_rows import free_motion
from jaxclear.formulations.delassus import delassus_operator
from jaxclear.formulations.model import Instant
from jaxclear.ground import sparse as sp
from jaxclear.ground.quantity import constant
from jaxclear.ground.wording import listed, public_name
from jaxclear.integrators.checks import Outcome
from jaxclear.multibody.forces import effect_of, load_rows
from jaxclear.multibody.kinematics import along
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.system import body_loads, coordinate_loads, films_in
from jaxclear.multibody.topology import moves_along
from jaxclear.multibody.transmissions import twist_direction
from jaxclear.multibody.validation import is_users
from jaxclear.results.state_history import StateHistory, over_time
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.error_weights import settling_length

# Longest explicit step beside the time in which a deflection settles: where Runge-Kutta steps of
# order 4 are stable.
STABLE = 2.78
# Longest explicit step times the angular frequency of a vibration that it follows (Hairer, Lubich &
# Wanner 2006, Geometric Numerical Integration, section I.5.1).
EXPLICIT = 2.0


def message_of_the_end(trajectory: Trajectory) -> str:
    """Why a run of one mechanism ended, with a sentence more where it is known why its state is not
    finite."""
    trajectory = constant(trajectory)
    if int(trajectory.outcome) == Outcome.TOO_MANY_STEPS:
        return f"{trajectory.result} {_of_springs(trajectory.mechanism)}".rstrip()
    if int(trajectory.outcome) not in (Outcome.NOT_FINITE, Outcome.STEP_TOO_SMALL):
        return trajectory.result
    why = _of_loads(trajectory.history)
    if not why and int(trajectory.outcome) == Outcome.NOT_FINITE:
        why = _of_bristles(trajectory.mechanism)
        why = why or _of_controllers(trajectory.mechanism) or _of_films(trajectory.mechanism)
        why = why or _of_stiff_couplings(trajectory)
    return f"{trajectory.result} {why}".rstrip()


def _of_controllers(mechanism: Mechanism) -> str:
    names = [name for name, load in coordinate_loads(mechanism) if load.sampled_every() is not None]
    if not names:
        return ""
    return (
        f"{listed(names)} act at sampled instants: gains that are stable without a period may not "
        "be so with it. Lower the gains, or the period or delay."
    )


def _of_bristles(mechanism: Mechanism) -> str:
    lengths = {}
    for name in mechanism.topology.clearances:
        for laws in mechanism.connections[name].joint.contact_laws():
            law = laws.friction
            if law is not None and law.bristles:
                lengths[name, public_name(type(law))] = float(settling_length(law))
    if not lengths:
        return ""
    (name, law), length = min(lengths.items(), key=lambda item: item[1])
    return (
        f'Joint "{name}" has {law}, whose deflections settle within '
        f"{length:.2g} m of sliding, at 1 m/s at a rate of {1 / length:.2g} 1/s: explicit steps of "
        f"at most {STABLE * length:.2g} s resolve that, and integrator.ImplicitStep needs not."
    )


def _of_films(mechanism: Mechanism) -> str:
    joints = [load.connection for load in films_in(mechanism).values()]
    if not joints:
        return ""
    return (
        f"The film of {listed(joints)} damps the journal faster than explicit steps of this length "
        "resolve; integrator.ImplicitStep needs no shorter ones."
    )


def _of_stiff_couplings(trajectory: Trajectory) -> str:
    """The coupling whose spring vibrates the fastest where the run begins, if explicit steps as
    long as those of the run do not follow it."""
    history, steps = trajectory.history, int(trajectory.accepted_steps)
    later = np.asarray(history.time)[np.asarray(history.time) > float(trajectory.ended)]
    trains = history.model().system.transmissions
    if not trains or not steps or not later.size:
        return ""

    def squares(now: Instant) -> dict[str, Any]:
        system = now.model.system
        free = free_motion(now.model, now.time, now.q, now.v, now.followed)
        out: dict[str, Any] = {}
        for name, train in system.transmissions.items():
            row = twist_direction(now.motions, train).linear_rate(system, now.motions).row
            (answer,) = delassus_operator(free, [row]).responses
            light = along(row, answer[0]) / (train.scale * train.scale)
            out[name] = train.coupling.stiffness * light
        return out

    fastest = {name: float(each[0]) ** 0.5 for name, each in over_time(history, squares).items()}
    name, omega = max(fastest.items(), key=lambda item: item[1])
    step = float(later[0] - history.time[0]) / steps
    if not step * omega > EXPLICIT:
        return ""
    coupling: Any = trajectory.mechanism.couplings[name]
    unit = "N/m" if moves_along(trajectory.mechanism, coupling) else "N m/rad"
    return (
        f'Coupling "{name}" has a stiffness of {float(coupling.stiffness):.3g} {unit}, with which '
        f"its two sides vibrate at {omega:.3g} rad/s: explicit steps are to be shorter than "
        f"{EXPLICIT / omega:.2g} s (2/omega; those of the run were {step:.2g} s), and "
        "integrator.ImplicitStep needs no such. Take shorter steps, or leave the stiffness out "
        "where it does not count."
    )


def _of_springs(mechanism: Mechanism) -> str:
    """What of a drive explicit steps are to resolve, however slowly the mechanism moves."""
    couplings = [n for n, one in mechanism.couplings.items() if one.stiffness is not None]
    frictions = [
        name
        for name, load in mechanism.loads.items()
        if isinstance(load, AbstractStateLoad)
        and any(x.saturation is not None for x in load.states())
    ]
    if not couplings and not frictions:
        return ""
    holds = " There friction that holds creeps." if frictions else ""
    return (
        f"Steps under error control are as short as the springs of {listed(couplings + frictions)} "
        "vibrate, whatever the motion; integrator.ImplicitStep takes steps of the length that you "
        f"give it.{holds} Or raise max_steps."
    )


def _of_loads(history: StateHistory) -> str:
    """A load of the user's own class that is no number at a saved state, or where the last ones
    lead in a saving interval."""
    if not any(is_users(load) for load in history.mechanism.loads.values()):
        return ""

    def loads_at(now: Instant) -> dict[str, Any]:
        system = now.model.system
        out: dict[str, Any] = {}
        for name, load in body_loads(system):
            if is_users(load):
                effect = effect_of(system, name, load, now.motions, now.time)
                out[name] = sp.total(x for each in effect.actions for x in (*each[1], *each[2]))
        for name, resisting in coordinate_loads(system):
            if is_users(resisting):
                acts, _ = load_rows(system, now.motions, name, now.time, now.followed)
                out[name] = sp.total(jax.tree.leaves(acts.forces))
        return {name: jnp.asarray(x, float) for name, x in out.items()}

    histories = [history]
    layout, length = history.layout(), jnp.max(jnp.diff(history.time))
    count = layout.coordinates
    if layout.memory_start == 2 * count:
        speeds = history.states[:, count : 2 * count]
        ahead = history.states.at[:, :count].add(length * speeds)
        histories.append(dataclasses.replace(history, states=ahead))
    for each in histories:
        for name, values in over_time(each, loads_at).items():
            if not np.all(np.isfinite(values)):
                return f'What load "{name}" gives is not finite; it must be wherever the run leads.'
    return ""
