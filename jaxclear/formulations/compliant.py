"""Compliant contact: forces follow from the state, so the state has a rate.

Explicit integrators ask for the rate and see the contacts; the implicit one asks for whole steps
(`midpoint_step`). Possible contacts are numbered through all clearance joints, in the order of the
state.
"""

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxclear.components.clearance import ContactLaws
from jaxclear.formulations import midpoint_step, state_rate, work_over_step
from jaxclear.formulations.base import AbstractFormulation, ContactReport, clearance_contact
from jaxclear.formulations.contact_rows import TimeStep
from jaxclear.formulations.midpoint_step import ImplicitSettings, WarmStart
from jaxclear.formulations.model import Instant, Model, State
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part
from jaxclear.ground.quantity import concrete
from jaxclear.multibody import dynamics, kinematics
from jaxclear.multibody.forces import applied_forces, contact_reports
from jaxclear.multibody.state import (
    impact_speed_places,
    pack_memories,
    unpack_memories,
    unpack_motion,
)

# Steps per time constant of a law's memory below which an explicit method lets it explode (2 for
# Euler and Heun, 2.8 for rk4).
MEMORY_STEPS = 2.0
Depths = Float[Array, " contacts"]


class CompliantContact(AbstractFormulation):
    """Contact forces are functions of indentation, its rate, and what the laws remember.

    `captured`: remembered impact speeds stand still, because the integrator sets them where
    contacts close.
    """

    forces_are_means: ClassVar = False
    captured: bool = eqx.field(static=True, default=False)

    def check(self, mechanism, integrator, step):
        for name in mechanism.topology.clearances:
            for laws in mechanism.connections[name].joint.contact_laws():
                _check_laws(name, laws)
                _check_memory(name, laws, concrete(step))

    def seen(self, mechanism):
        return mechanism

    def impulses(self, system):
        return ()

    def contact_joints(self, mechanism):
        return mechanism.topology.clearances

    def forces(self, instant: Instant):
        model = instant.model
        memories = unpack_memories(model.layout, instant.entries)
        reports = contact_reports(model.system, instant.motions, memories, model.worn)
        return instant.forces(reports)

    def contact(self, instant: Instant, name: str) -> ContactReport:
        return clearance_contact(instant, self.forces(instant).reports[name], name)

    def rate(self, model: Model, time: Any, state: State) -> tuple[State, Depths, Depths]:
        """Rate of the state, and of every possible contact the indentation [m] and its rate [m/s],
        from one evaluation.
        """
        system, layout, entries = model.system, model.layout, model.entries(state)
        q, v = unpack_motion(system, entries)
        motions = kinematics.link_motions(system, q, v, time)
        reports = contact_reports(system, motions, unpack_memories(layout, entries), model.worn)
        forces = applied_forces(system, motions, reports, q, v, time)
        solution = dynamics.forward_dynamics(system, forces, model.stabilisation)
        rates = [
            *state_rate.coordinate_rates(system, q, v),
            *(a for accelerations in solution.accelerations for a in accelerations),
            *pack_memories(layout, {name: report.memory_rates for name, report in reports.items()}),
            *state_rate.passive_rates(system, layout, forces, solution),
        ]
        if self.captured:
            for place in impact_speed_places(layout):
                if place is not None:
                    rates[place] = 0
        return sp.stack(rates), *_depths(reports)

    def contacts(self, model: Model, time: Any, state: State) -> tuple[Depths, Depths]:
        """Indentation [m] and its rate [m/s] of every possible contact."""
        entries = model.entries(state)
        motions = kinematics.link_motions(model.system, *unpack_motion(model.system, entries), time)
        memories = unpack_memories(model.layout, entries)
        return _depths(contact_reports(model.system, motions, memories, model.worn))

    def coordinate_rates(self, model: Model, state: State) -> Float[Array, " q"]:
        """Rates of the coordinates alone: they follow from coordinates and speeds."""
        motion = unpack_motion(model.system, model.entries(state))
        return sp.stack(state_rate.coordinate_rates(model.system, *motion))

    def energy_rates(self, model: Model, time: Any, state: State, mean: Any) -> Float[Array, " e"]:
        """Rates of the energies of the balance but its input, for the forces at a state and the
        mean speeds of the step that begins there."""
        speeds = [mean[i] for i in range(model.layout.speeds)]
        return sp.stack(work_over_step.energy_rates(model, time, model.entries(state), speeds))

    def remembers(self, model: Model) -> bool:
        """True where some contact remembers its impact speed."""
        return any(place is not None for place in impact_speed_places(model.layout))

    def remember(
        self, model: Model, state: State, wanted: Bool[Array, " contacts"], approach: Depths
    ) -> State:
        """The state with the remembered impact speed set to max(approach, 0) [m/s] at those
        contacts that are `wanted`.
        """
        entries = model.entries(state)
        for i, place in enumerate(impact_speed_places(model.layout)):
            if place is not None:
                entries[place] = jnp.where(wanted[i], positive_part(approach[i]), entries[place])
        return sp.stack(entries)

    def warm_start(self, model: Model, time: Any, state: State) -> Float[Array, " h"]:
        """What the first implicit step is handed: no accelerations, and the contacts as they
        are."""
        speeds = jnp.zeros(2 * model.layout.speeds)
        return jnp.concatenate([speeds, self.contacts(model, time, state)[0]])

    def implicit_step(
        self,
        model: Model,
        time_step: TimeStep,
        state: State,
        warm_start: Float[Array, " h"],
        bias: Any,
        newton_iterations: int,
    ) -> tuple[State, Float[Array, " h"]]:
        """The state after an implicit step, and what it hands on to the next."""
        count = model.layout.speeds
        numbers = [warm_start[i] for i in range(len(warm_start))]
        last = WarmStart(numbers[:count], numbers[count : 2 * count], numbers[2 * count :])
        settings = ImplicitSettings(bias, newton_iterations, self.captured)
        after, now = midpoint_step.step(model, time_step, model.entries(state), last, settings)
        return sp.stack(after), sp.stack([*now.smooth, *now.contact, *now.depths])


def _depths(reports: dict) -> tuple[Depths, Depths]:
    points = [point for report in reports.values() for point in report.points]
    depths = sp.stack([point.indentation for point in points])
    return depths, sp.stack([point.rate for point in points])


def _check_laws(name: str, laws: ContactLaws) -> None:
    """Raises `ValueError` for laws that are no functions of the state."""
    if not laws.contact.compliant:
        raise ValueError(
            f'joint "{name}" has contact.{type(laws.contact).__name__}, which has no force law: '
            "take integrator.MoreauJean, or a compliant law such as contact.CarvalhoMartins."
        )
    friction = laws.friction
    if friction is not None and friction.set_valued:
        raise ValueError(
            f'joint "{name}" has set-valued friction {type(friction).__name__}, which has no '
            "force law: take integrator.MoreauJean or NonColliding, or a regularised law such as "
            "friction.ThreeZone or friction.LuGre."
        )


def _check_memory(name: str, laws: ContactLaws, step: float | None) -> None:
    """Raises `ValueError` where explicit steps [s] are too long for the memory of a law."""
    memory = concrete(laws.contact.memory_time)
    if step is not None and memory is not None and step > MEMORY_STEPS * memory:
        raise ValueError(
            f'steps of {step:.6g} s are too long for joint "{name}": its contact law remembers '
            f"the impact speed with memory_time {memory} s and would explode; take steps below "
            f"{MEMORY_STEPS * memory:.3g} s, a longer memory_time, or capture_impacts=True."
        )
