"""Compliant contact: forces follow from the state, so the state has a rate.

Explicit integrators ask for the rate and see the contacts; the implicit one asks for whole steps
(`midpoint_step`). Possible contacts are numbered through all clearance joints, in the order of the
state.
"""

import itertools
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.clearance import ContactLaws
from jaxclear.components.load import AbstractStateLoad
from jaxclear.formulations import joint_friction, midpoint_step, state_rate
from jaxclear.formulations.base import (
    AbstractFormulation,
    ContactReport,
    check_play,
    clearance_contact,
)
from jaxclear.formulations.contact_rows import (
    TimeStep,
    contact_points,
    follows_depth,
    has_damping,
    laws_of_contacts,
)
from jaxclear.formulations.films_over_step import film_losses, films_of
from jaxclear.formulations.impact_speed import ContactMotion, remembered
from jaxclear.formulations.joint_friction import friction_losses, rubbing
from jaxclear.formulations.laws_over_step import PastSlip
from jaxclear.formulations.midpoint_step import WarmStart
from jaxclear.formulations.model import Instant, Model, State
from jaxclear.formulations.permanent_reactions import sliding_rates, touching
from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import map_grouped
from jaxclear.ground.grouping import unstacked
from jaxclear.multibody import contact_point, kinematics
from jaxclear.multibody.contact_point import impact_speed_now
from jaxclear.multibody.damped_stops import forces_at, with_damping_ratios
from jaxclear.multibody.forces import Forces, contact_reports, pressing_of, relative_motions
from jaxclear.multibody.state import (
    impact_speed_places,
    pack_memories,
    unpack_followed,
    unpack_memories,
    unpack_motion,
)
from jaxclear.multibody.system import rubbing_joints
from jaxclear.multibody.topology import rubbing_in
from jaxclear.multibody.transmissions import Pressing, torque_on_flanks, within_gaps


def _work_rates(model: Model, time: Any, entries: list, mean: list) -> list:
    """Rates [W] of the energies of the balance but its input, in the order of `state.ENERGIES`: of
    the forces at a state's `entries`, over the `mean` speeds of the step that begins there."""
    system, layout = model.system, model.layout
    first, last = layout.coordinates, layout.memory_start
    start, q, _ = _acting_forces(model, time, entries)
    middle = _acting_forces(model, time, [*entries[:first], *mean, *entries[last:]])[0]
    work, loss, rubbed = 0, 0, 0
    # The rows of contacts come first.
    for row, name in zip(start.rows[: len(system.bearings)], system.bearings, strict=True):
        power, pressed, damped = row.direction.rate(middle.motions), 0, 0
        points = zip(start.reports[name].points, middle.reports[name].points, strict=True)
        for initial, moved in points:
            pressed = sp.add(pressed, initial.normal_force * moved.rate)
            damped = sp.add(damped, (initial.normal_force - initial.elastic_force) * moved.rate)
        work, loss = sp.add(work, pressed), sp.add(loss, damped)
        rubbed = sp.sub(rubbed, sp.add(power, pressed))
    joints = touching(system)
    if joints:
        result = rubbing(model, start, q)
        change = sp.each(sp.sub, mean, entries[first:last])
        slips = [
            rate.at(change) for one in joints for rate in sliding_rates(system, start.motions, one)
        ]
        rubbed = sp.add(rubbed, friction_losses(joints, result.friction, slips)[0])
    # What a damper takes is of second degree: the mean is right to the square of the change.
    damping = sp.mul(0.5, sp.add(start.damping_loss, middle.damping_loss))
    return [work, loss, rubbed, damping]


class CompliantContact(AbstractFormulation):
    """Contact forces are functions of indentation, its rate, and what the laws remember; impact
    speeds stand still, because the steps set them where contacts close (`impact_speed`).
    """

    forces_are_means: ClassVar = False

    def check(self, mechanism, integrator):
        joint_friction.check_rubbing(mechanism, integrator)
        for name, load in mechanism.loads.items():
            if isinstance(load, AbstractStateLoad) and not all(
                side.stop.stiffness is not None for side in load.sides()
            ):
                raise ValueError(
                    f'load "{name}" is a JointStop without stiffness, which is rigid: for '
                    f"{integrator} give it one, by which what strikes it with speed v goes "
                    "v sqrt(m / k) deep, or take integrator.MoreauJean or NonColliding."
                )
        check_play(mechanism, integrator, rigid=False)
        for name in mechanism.topology.clearances:
            for laws in mechanism.connections[name].joint.contact_laws():
                _check_laws(name, laws)

    def modelled(self, mechanism):
        return mechanism

    def prepared(self, system):
        return with_damping_ratios(system)

    def impulses(self, system):
        # Of a film the energy that it has taken stands there [J].
        every = (*system.bearings, *films_of(system), *rubbing_joints(system))
        return tuple((name, 1) for name in every)

    def normal_impulses(self, system, name):
        return (0,) if name in dict(self.impulses(system)) else ()

    def contact_joints(self, mechanism):
        return (*mechanism.topology.clearances, *rubbing_in(mechanism.connections))

    def forces(self, instant: Instant):
        forces = _acting_forces(instant.model, instant.time, instant.entries)[0]
        if not rubbing_joints(instant.model.system):
            return forces
        return joint_friction.rubbing(instant.model, forces, instant.q).forces

    def contact(self, instant: Instant, name: str) -> ContactReport:
        forces = _acting_forces(instant.model, instant.time, instant.entries)[0]
        if name in instant.model.system.bearings:
            return clearance_contact(instant, forces, name)
        return joint_friction.contact(instant, forces, name)

    def rate(
        self, model: Model, time: Any, state: State, shares: Any = None, flanks: Any = None
    ) -> tuple[State, ContactMotion]:
        """Rate of the state, and the motion of every possible contact, from one evaluation.

        Args:
            model: the mechanism, a `Model`.
            time: time [s].
            state: the state, an array (n,).
            shares: for every possible contact 1 where it counts as closed and 0 where as open [1],
                an array; None: as its indentation says.
            flanks: the same for the flanks of play alone [1], an array; None: as their positions
                say.

        Returns:
            the rate, an array (n,), and a `ContactMotion`.
        """
        system, layout, entries = model.system, model.layout, model.entries(state)
        if shares is not None:
            flanks = shares[layout.joint_contacts :]
        forces, q, v = _acting_forces(model, time, entries, shares, flanks)
        forces, solution, rubbing = joint_friction.solved(model, forces, q)
        reports = forces.reports
        normal = ([point.normal_force for point in report.points] for report in reports.values())
        pressing = [*map(sp.total, normal), *film_losses(system, forces)]
        rates = [
            *state_rate.coordinate_rates(system, q, v),
            *(a for accelerations in solution.accelerations for a in accelerations),
            *pack_memories(layout, {name: report.memory_rates for name, report in reports.items()}),
            *state_rate.passive_rates(system, layout, forces, solution, rubbing, pressing),
        ]
        points = [point for report in reports.values() for point in report.points]
        moving = [(point.indentation, point.rate) for point in points]
        return sp.stack(rates), _stack_motions([*moving, *_motion_of_flanks(forces.pressing)])

    def contacts(
        self, model: Model, time: Any, state: State, flanks: Any = None, exact: bool = False
    ) -> ContactMotion:
        """Indentation and its rate of every possible contact, from the geometry alone; behind them
        depth and rate [rad, m] of the flanks of play.

        Args:
            model: the mechanism, a `Model`.
            time: time [s].
            state: the state, an array (n,).
            flanks: which flanks count as pressing [1], an array; None: as their positions say.
            exact: whether the rates of flanks that are left by their torque are those of their
                depth, for which the equations of motion are solved.

        Returns:
            a `ContactMotion`.
        """
        motion = lambda time, state: _stack_motions(_row_motions(model, time, state, flanks))
        if exact and any(one.separates_by_torque for one in model.system.transmissions.values()):
            flow = self.rate(model, time, state, None, flanks)[0]
            depths = lambda *now: motion(*now).depths
            return ContactMotion(*jax.jvp(depths, (time, state), (1.0, flow)))
        return motion(time, state)

    def damped(self, model: Model) -> bool:
        """Whether some contact damps, so that its depth does not determine its force; flanks of
        play may.

        Args:
            model: the mechanism, a `Model`.
        """
        return bool(model.layout.plays) or has_damping(model.system)

    def normal_forces(self, model: Model, state: State, motion: ContactMotion) -> Any:
        """Normal force of every possible contact that damps; of flanks of play the torque.

        Args:
            model: the mechanism, a `Model`.
            state: the state, an array (n,).
            motion: indentations and rates, a `ContactMotion`.

        Returns:
            forces [N; N m of flanks], an array.
        """
        system, forces = model.system, list[Any]()
        motions, count = list(zip(*motion, strict=True)), model.layout.joint_contacts
        places = zip(laws_of_contacts(system), impact_speed_places(model.layout), strict=True)
        for (law, place), (depth, rate) in zip(places, motions[:count], strict=True):
            speed = None if place is None else impact_speed_now(state[place], rate)
            damps = not follows_depth(law)
            forces.append(law.contact.normal_force(depth, rate, speed) if damps else 0.0)
        for k, moving in enumerate(motions[count:]):
            train = system.transmissions[model.layout.plays[k // 2]]
            forces.append(torque_on_flanks(train, *moving))
        return jnp.asarray(sp.stack(forces))

    def slips(self, model: Model, time: Any, state: State) -> Float[Array, "contacts 3"]:
        """Sliding velocity of every possible contact along its sliding directions, from the
        geometry alone; 0 where nothing rubs.

        Args:
            model: the mechanism, a `Model`.
            time: time [s].
            state: the state, an array (n,).

        Returns:
            velocities [m/s], an array (contacts, 3).
        """
        rows = _row_motions(model, time, state)
        return jnp.stack([sp.stack([*slip, *sp.ZERO][:3]) for _, _, slip in rows])

    def coordinate_rates(self, model: Model, state: State) -> Float[Array, " q"]:
        """Rates of the coordinates alone, which follow from coordinates and speeds.

        Args:
            model: the mechanism, a `Model`.
            state: the state, an array (n,).

        Returns:
            rates [m/s, rad/s, 1/s], an array (coordinates,).
        """
        motion = unpack_motion(model.system, model.entries(state))
        return sp.stack(state_rate.coordinate_rates(model.system, *motion))

    def energy_rates(self, model: Model, time: Any, state: State, mean: Any) -> Float[Array, " e"]:
        """Rates of the energies of the balance except its input, for a step.

        Args:
            model: the mechanism, a `Model`.
            time: time at the beginning of the step [s].
            state: the state there, an array (n,), whose forces are taken.
            mean: mean speeds of the step [m/s, rad/s], an array.

        Returns:
            powers [W], an array.
        """
        speeds = [mean[i] for i in range(model.layout.speeds)]
        return sp.stack(_work_rates(model, time, model.entries(state), speeds))

    def remembers(self, model: Model) -> bool:
        """Whether some contact remembers its impact speed, or a shaft the end of its gap.

        Args:
            model: the mechanism, a `Model`.
        """
        speeds = any(place is not None for place in impact_speed_places(model.layout))
        return speeds or any(train.has_twist for train in model.system.transmissions.values())

    def remember(
        self, model: Model, state: State, before: ContactMotion, after: ContactMotion, length: Any
    ) -> State:
        """The state at the end of a step with the impact speeds of contacts that have closed or
        parted in it.

        Args:
            model: the mechanism, a `Model`.
            state: the state at the end of the step, an array (n,).
            before: motion of the contacts at its beginning, a `ContactMotion`.
            after: motion of the contacts at its end, a `ContactMotion`.
            length: length of the step [s].

        Returns:
            the state, an array (n,).
        """
        entries, places = model.entries(state), impact_speed_places(model.layout)
        # Of shafts: their far ends do not leave the gap. Derivatives know where they have been met.
        entries = within_gaps(model.system, model.layout, entries)
        if all(place is None for place in places):
            return sp.stack(entries)
        if model.layout.plays:
            count = model.layout.joint_contacts
            before, after = (ContactMotion(*(x[:count] for x in pair)) for pair in (before, after))
        previous = sp.stack([0 if place is None else entries[place] for place in places])
        speeds = remembered(previous, before, after, length)
        for i, place in enumerate(places):
            if place is not None:
                entries[place] = speeds[i]
        return sp.stack(entries)

    def warm_start(self, model: Model, time: Any, state: State) -> WarmStart:
        """Warm start of the first implicit step: no accelerations, and the contacts as they are.

        Args:
            model: the mechanism, a `Model`.
            time: time [s].
            state: the state, an array (n,).

        Returns:
            arrays for `implicit_step`, a `WarmStart`.
        """
        entries = model.entries(state)
        motions = kinematics.link_motions(model.system, *unpack_motion(model.system, entries), time)
        _, points = contact_points(model, motions)
        slips = [
            tuple(PastSlip(0.0, slip.value, slip.value) for slip in point.acting[1:])
            for point in points
        ]
        start = midpoint_step.blank_start(model)._replace(
            depths=[point.gap_function.indentation for point in points], slips=slips
        )
        if rubbing_joints(model.system):
            forces, q, _ = _acting_forces(model, time, entries)
            reactions = joint_friction.rubbing(model, forces, q).answer.reactions
            start = start._replace(reactions=reactions)
        return start.packed()

    def caused_by_contact(self, model: Model, time: Any, state: State) -> tuple:
        """Accelerations without contact, and what contact adds to them, where a run begins.

        Args:
            model: the mechanism, a `Model`.
            time: time [s].
            state: the state, an array (n,).

        Returns:
            two arrays [m/s^2, rad/s^2].
        """
        closed = (self.contacts(model, time, state).depths > 0).astype(float)
        place = slice(model.layout.coordinates, model.layout.memory_start)
        # One program for both.
        at = lambda shares: self.rate(model, time, state, shares)[0][place]
        free, total = jax.lax.map(at, jnp.stack([jnp.zeros_like(closed), closed]))
        return free, total - free

    def implicit_step(
        self,
        model: Model,
        time_step: TimeStep,
        state: State,
        warm_start: WarmStart,
        bias: Any,
        newton_iterations: int,
    ) -> tuple[State, WarmStart]:
        """Take one implicit step.

        Args:
            model: the mechanism, a `Model`.
            time_step: the step, a `TimeStep`.
            state: the state at its beginning, an array (n,).
            warm_start: what the step before has returned, a `WarmStart`.
            bias: share by which mean contact forces lean towards the step's end [1]: 0 the mean, 1
                the end.
            newton_iterations: number of iterations on the contact laws, >= 1.

        Returns:
            the state at the end, an array (n,), and the warm start of the next step, a `WarmStart`.
        """
        last = warm_start.unpacked(midpoint_step.blank_start(model))
        entries, how = model.entries(state), (bias, newton_iterations)
        after, now, motion = midpoint_step.step(model, time_step, entries, last, *how)
        if motion:
            contacts = ContactMotion(*map(sp.stack, zip(*motion, strict=True)))
            now = now._replace(forces=unstacked(self.normal_forces(model, state, contacts)))
        return sp.stack(after), now.packed()


def _row_motions(model: Model, time: Any, state: State, flanks: Any = None) -> list[tuple]:
    """(depth, its rate, components of slip where it rubs) of every possible contact, then of every
    flank, from the geometry alone."""
    system, entries = model.system, model.entries(state)
    motions = kinematics.link_motions(system, *unpack_motion(system, entries), time)
    bearings, relative = system.bearings.items(), relative_motions(system, motions)
    calls = [
        (bearing.joint, motion, model.worn.get(name, {}))
        for (name, bearing), motion in zip(bearings, relative, strict=True)
    ]
    points = [row for joint in map_grouped(contact_point.point_motions, calls) for row in joint]
    rubs = [law.friction is not None for law in laws_of_contacts(system)]
    rows = [(*row[:2], row[2] if rub else ()) for rub, row in zip(rubs, points, strict=True)]
    if model.layout.plays:
        followed = unpack_followed(model.layout, entries, flanks)
        rows += _motion_of_flanks(pressing_of(system, motions, followed))
    return rows


def _motion_of_flanks(pressing: dict[str, Pressing]) -> list:
    """(depth, rate, no slip) of every flank."""
    flanks = (zip(each.depths, each.rates, strict=True) for each in pressing.values())
    return [(*pair, ()) for flank in flanks for pair in flank]


def _acting_forces(
    model: Model, time: Any, entries: list, shares: Any = None, flanks: Any = None
) -> tuple[Forces, tuple, tuple]:
    """(what acts but friction in ideal joints, coordinates and speeds by link)."""
    system, layout = model.system, model.layout
    q, v = unpack_motion(system, entries)
    motions = kinematics.link_motions(system, q, v, time)
    memories = _with_shares(unpack_memories(layout, entries), shares)
    reports = contact_reports(system, motions, memories, model.worn)
    followed = unpack_followed(layout, entries, flanks)
    return forces_at(system, motions, reports, time, followed), q, v


def _with_shares(memories: dict, shares: Any) -> dict:
    """Memories of all contacts with the shares of them that act."""
    if shares is None:
        return memories
    count, result = itertools.count(), {}
    for name, points in memories.items():
        result[name] = tuple(point._replace(share=shares[next(count)]) for point in points)
    return result


def _stack_motions(points: list) -> ContactMotion:
    """The motion of all contacts from (indentation, rate, ...) of each."""
    depths, rates = ([point[i] for point in points] for i in (0, 1))
    return ContactMotion(sp.stack(depths), sp.stack(rates))


def _check_laws(name: str, laws: ContactLaws) -> None:
    """Raises `ValueError` for laws that are no functions of the state."""
    if not laws.contact.compliant:
        raise ValueError(
            f'joint "{name}" has contact.{type(laws.contact).__name__}, which has no force law: '
            "take integrator.MoreauJean (a study: in a jaxclear.Problem), or a compliant law, as "
            "contact.CarvalhoMartins is."
        )
    friction = laws.friction
    if friction is not None and friction.set_valued:
        raise ValueError(
            f'joint "{name}" has set-valued friction {type(friction).__name__}, which has no '
            "force law: take integrator.MoreauJean or NonColliding, or a regularised law such as "
            "friction.ThreeZone or friction.LuGre."
        )
