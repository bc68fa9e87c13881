r"""Rigid contact: bodies do not overlap, forces are percussions over time steps.

Moreau's time stepping with the theta method: the equations are evaluated once, half a step ahead
along the speeds, $M (v^{k+1} - v^k) = h f + G^T p$, percussions $p$ by the laws of impact and
friction at the velocities of the step's end (`unilateral`), $q^{k+1} = q^k + h\,\dot q(\theta
v^{k+1} + (1 - \theta) v^k)$; what overlaps then, and would not part within a step by itself, is
moved apart. Source: Moreau 1988, in Nonsmooth Mechanics and Applications, 1,
doi:10.1007/978-3-7091-2624-0_1; Acary & Brogliato 2008, Numerical Methods for Nonsmooth Dynamical
Systems, ch. 10, doi:10.1007/978-3-540-75392-6.
"""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.formulations.base import AbstractFormulation, check_play, clearance_contact
from jaxclear.formulations.contact_rows import (
    MiddleOfStep,
    TimeStep,
    middle_of_step,
    reports_of_means,
    rigid_reports,
)
from jaxclear.formulations.delassus import DelassusOperator, delassus_operator
from jaxclear.formulations.loads_over_step import (
    LoadsInStep,
    check_solved_loads,
    load_components,
    loads_in_step,
    solved_loads,
    with_loads,
    with_rigid_flanks,
    with_solved_loads,
)
from jaxclear.formulations.model import Model, State
from jaxclear.formulations.permanent_reactions import check_unique, touching, with_friction
from jaxclear.formulations.permanent_report import (
    forces_of_impulses,
    joint_components,
    report_of_means,
)
from jaxclear.formulations.rubbing_percussions import (
    joints_in_step,
    percussions_and_friction,
    rubbed_over,
    springs_of,
)
from jaxclear.formulations.state_rate import (
    Passive,
    link_accelerations,
    passive_rates,
)
from jaxclear.formulations.unilateral import (
    MoreauJeanSettings,
    Percussions,
    Projected,
    demands,
    project,
    stops_as_contacts,
    unilateral_contacts,
    with_laws_of_stops,
)
from jaxclear.ground import sparse as sp
from jaxclear.multibody import kinematics
from jaxclear.multibody.forces import applied_forces
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.state import components, contact_components, unpack_motion
from jaxclear.multibody.topology import rubbing_in


class Strikes(NamedTuple):
    """Which contacts strike in a step, all indentations [m] and their rates [m/s] halfway, and
    which contacts are in flight where it begins."""

    which: Any
    depths: Any
    rates: Any
    flying: Any


class RigidContact(AbstractFormulation):
    """Unilateral contact with Newton's law of impact and set-valued Coulomb friction.

    Of a contact law only its coefficient of restitution is taken, of a friction law its
    coefficients.
    """

    forces_are_means: ClassVar = True

    @property
    def rubs_as_coulombs(self):
        return True

    def check(self, mechanism, integrator):
        check_friction(mechanism, integrator)
        check_play(mechanism, integrator, rigid=True)
        check_solved_loads(mechanism, integrator, seated=False)
        for name in mechanism.topology.clearances:
            if mechanism.connections[name].joint.gap_load(name) is not None:
                raise ValueError(
                    f'joint "{name}" has a film, which {integrator} does not follow; take '
                    "integrator.ImplicitStep, Adaptive, FixedStep or NonColliding, or leave the "
                    "film out."
                )
            for laws in mechanism.connections[name].joint.contact_laws():
                if laws.contact.restitution is None:
                    raise ValueError(
                        f'joint "{name}" has a contact law whose restitution depends on mass and '
                        "speed; "
                        f"for {integrator} give contact.Rigid(restitution=...)."
                    )

    def modelled(self, mechanism):
        return mechanism

    def prepared(self, system):
        return with_rigid_flanks(with_solved_loads(system))

    def impulses(self, system):
        return contact_components(system) + joint_components(system) + load_components(system)

    def normal_impulses(self, system, name):
        if name not in system.bearings:
            return (dict(joint_components(system))[name] - 1,)
        counts = components(system, system.bearings[name])
        return tuple(sum(counts[:k]) for k in range(len(counts)))

    def contact_joints(self, mechanism):
        return (*mechanism.topology.clearances, *rubbing_in(mechanism.connections))

    def forces(self, instant):
        return forces_of_impulses(instant, reports_of_means(instant))

    def contact(self, instant, name):
        if name in instant.model.system.bearings:
            return clearance_contact(instant, self.forces(instant), name)
        return report_of_means(instant, name)

    def warm_start(self, model: Model) -> Float[Array, " h"]:
        """Warm start of the first step: no accelerations, no percussions, no friction.

        Args:
            model: the mechanism, a `Model`.

        Returns:
            numbers for `step`, an array.
        """
        system = model.system
        check_unique(system)
        count = sum(size for _, size in contact_components(system))
        count += sum(one.joint.components for one in touching(system))
        count += sum(len(load.sides) + load.rubs for load in solved_loads(system).values())
        return jnp.zeros(model.layout.speeds + count + 1)

    def strikes(
        self,
        model: Model,
        time_step: TimeStep,
        state: State,
        last: Float[Array, " h"],
        settings: MoreauJeanSettings,
    ) -> Strikes:
        """What strikes in a step that begins as `step` does.

        Args:
            model: the mechanism, a `Model`.
            time_step: the step, a `TimeStep`.
            state: the state at its beginning, an array (n,).
            last: what the step before has returned, an array.
            settings: settings of the step, a `MoreauJeanSettings`.

        Returns:
            which contacts strike, their depths [m], closing speeds [m/s] and which are in flight, a
            `Strikes`.
        """
        _, _, middle, contacts, _ = _set_up(model, time_step, state, last)
        free = delassus_operator(middle.free_motion, []).free
        gentle = settings._replace(gentle=True)
        required = demands(middle, contacts, free, time_step.length, gentle)
        return Strikes(
            required.strikes,
            sp.stack([contact.depth for contact in contacts]),
            sp.stack([sp.neg(contact.velocities[0].value) for contact in contacts]),
            required.flying,
        )

    def step(
        self,
        model: Model,
        time_step: TimeStep,
        state: State,
        last: Float[Array, " h"],
        settings: MoreauJeanSettings,
    ) -> tuple[State, Float[Array, " h"]]:
        """Take one step.

        Args:
            model: the mechanism, a `Model`.
            time_step: the step, a `TimeStep`.
            state: the state at its beginning, an array (n,).
            last: what the step before has returned, an array: the free accelerations, the
                percussions in the state's order, then the largest residual of the contact laws so
                far.
            settings: settings of the step, a `MoreauJeanSettings`.

        Returns:
            the state at the end, an array (n,), and the same numbers of this step, an array.
        """
        h, count = time_step.length, model.layout.speeds
        entries, handed, middle, contacts, loads = _set_up(model, time_step, state, last)
        joints = joints_in_step(model, middle)
        rates = [rate for contact in contacts for rate in contact.velocities]
        rates += [rate for joint in joints for rate in joint.moved]
        rows = [rate.row for rate in (*rates, *(rub.sliding for rub in loads.rubs))]
        delassus, previous = delassus_operator(middle.free_motion, rows), handed[count:-1]
        contacts = with_laws_of_stops(contacts, loads, delassus, h)
        impact, rubbed = percussions_and_friction(
            model, middle, contacts, joints, loads, delassus, previous, h, settings
        )
        v = [x + h * k + p for x, k, p in zip(middle.v, delassus.free, impact.changes, strict=True)]
        mean = [
            settings.theta * b + (1 - settings.theta) * a for a, b in zip(middle.v, v, strict=True)
        ]
        end = Projected(middle.end(model, mean, h), [0] * count, 0)
        if settings.project and contacts and not settings.gentle:
            before = (end.coordinates, v)
            end = project(model, time_step, middle, contacts, delassus, before, settings)
        # What compliant laws would remember; nothing reads it here.
        remembered = model.layout.memory_start + model.layout.memory_count
        after = [*end.coordinates, *v, *entries[model.layout.memory_start : remembered]]
        over = rubbed_over(model, middle, joints, rubbed, mean)
        stops = impact.by_contact[len(impact.by_contact) - len(loads.stops) :]
        forces = [*(sp.mul(1 / h, row[0]) for row in stops), *rubbed.loads]
        by_loads = loads.by_load(model.system, forces), loads.loss(forces, middle.change_to(mean))
        passive = _passive(
            model, time_step, middle, delassus, impact, mean, end, rubbed.friction, over, by_loads
        )
        after += [x + change for x, change in zip(entries[len(after) :], passive, strict=True)]
        flat = [part for row in impact.by_contact for part in row]
        flat += [h * x for x in (*rubbed.friction, *rubbed.loads)]
        residual = jnp.maximum(handed[-1], jnp.maximum(impact.residual, end.residual))
        ahead = _with_springs(contacts, delassus, impact, h)
        return sp.stack(after), sp.stack([*ahead, *flat, residual])


def _set_up(model: Model, time_step: TimeStep, state: State, last: Float[Array, " h"]) -> tuple:
    """(entries of the state, what the last step has handed on, the middle of the step, contacts
    there, sides of stops behind them, and the loads whose force the step finds)."""
    entries, handed = model.entries(state), [last[i] for i in range(len(last))]
    count = model.layout.speeds
    middle = middle_of_step(model, time_step, entries, handed[:count])
    names = [name for name, b in model.system.bearings.items() for _ in b.contact_laws]
    contacts = unilateral_contacts(middle.free_motion.contacts, names, handed[count:-1])
    loads = LoadsInStep((), ())
    if solved_loads(model.system):
        forces = middle.free_motion.forces
        at = forces.motions, time_step.middle, forces.followed
        loads = loads_in_step(model.system, *at)
        first = count + sum(size for _, size in contact_components(model.system))
        contacts += stops_as_contacts(loads, handed[first:])
    return entries, handed, middle, contacts, loads


def _with_springs(contacts: list, delassus: DelassusOperator, impact: Percussions, h: Any) -> list:
    """The accelerations by what acts all the time: without percussions, with the stops that give
    way in the step."""
    result = list(delassus.free)
    for row, number, spring in springs_of(contacts):
        force = jnp.where(spring.acts, impact.by_contact[number][0] / h, 0.0)
        moved = delassus.responses[row][0]
        result = [sp.add(x, sp.mul(force, a)) for x, a in zip(result, moved, strict=True)]
    return result


class FrictionUnknown(ValueError):
    """A friction law names no Coulomb's law that it stands for."""


def check_friction(mechanism: Mechanism, integrator: str) -> None:
    """Raises `FrictionUnknown` for friction that does not say which coefficients it regularises."""
    laws = [
        (name, law.friction)
        for name in mechanism.topology.clearances
        for law in mechanism.connections[name].joint.contact_laws()
    ]
    laws += [(name, joint.friction) for name, joint in rubbing_in(mechanism.connections).items()]
    for name, law in laws:
        if law is not None and law.coulomb() is None:
            raise FrictionUnknown(
                f'joint "{name}" has friction {type(law).__name__}, of which {integrator} does not '
                "know the coefficients; give friction.Coulomb(mu_kinetic=..., mu_static=...), or "
                f"return that from {type(law).__name__}.coulomb."
            )


def _passive(
    model: Model,
    time_step: TimeStep,
    middle: MiddleOfStep,
    delassus: DelassusOperator,
    impact: Percussions,
    mean: list,
    end: Projected,
    friction: list,
    rubbed: tuple[Passive, list],
    by_loads: tuple[dict[str, Any], Any],
) -> list:
    """Changes of what only follows the motion: angles, worn volumes, impulses, energies; by
    `friction` of joints, what is `rubbed` by it, and `by_loads`, the forces [N m, N] by load that
    the step solves for with the power [W] that they take."""
    system, layout, h = model.system, model.layout, time_step.length
    free_motion = middle.free_motion
    by_contact = impact.by_contact[: len(free_motion.contacts)]
    forces = [tuple(sp.mul(1 / h, part) for part in contact) for contact in by_contact]
    pressing = [part for contact in forces for part in contact]
    passive, by_joint = rubbed
    by_load, loss = by_loads
    pressing += [*by_joint, *by_load.values()]
    acting = free_motion.forces
    if layout.wear or layout.energies:
        change = middle.change_to(mean)
        reports = rigid_reports(system, free_motion.poses, free_motion.contacts, forces, change)
        acting = acting._replace(reports=reports)
    if layout.energies:
        # Loads work along the mean speeds: those of the middle know nothing of the impulses against
        # which the loads press.
        travelled = [sp.add(x, sp.mul(1 / h, m)) for x, m in zip(mean, end.moved, strict=True)]
        motion = unpack_motion(system, [*middle.halfway, *travelled])
        motions = kinematics.link_motions(system, *motion, time_step.middle)
        followed = free_motion.forces.followed
        acting = applied_forces(system, motions, reports, time_step.middle, followed)
        acting = with_loads(system, with_friction(system, acting, friction), by_load)
    total = _add_rates(delassus.free, impact.changes, h)
    multipliers = tuple(_add_rates(delassus.multipliers, impact.multipliers, h))
    solution = link_accelerations(system, total, multipliers)
    rates = passive_rates(system, layout, acting, solution, passive, pressing)
    rates = [sp.mul(h, rate) for rate in rates]
    first = len(rates) - len(layout.energies)
    for name in ("contact_work", "contact_loss") if layout.energies else ():
        place = first + layout.energies.index(name)
        rates[place] = sp.sub(rates[place], end.energy)
    if layout.energies:
        place = first + layout.energies.index("damping_loss")
        rates[place] = sp.add(rates[place], sp.mul(h, loss))
    return rates


def _add_rates(free: Any, impulses: Any, h: Any) -> list:
    """What acts all the time and what impulses amount to over a step h [s]."""
    return [sp.add(k, sp.mul(1 / h, p)) for k, p in zip(free, impulses, strict=True)]
