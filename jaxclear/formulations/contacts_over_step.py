"""What an implicit step is made of, and what follows from its solution: memories of the laws, wear
and energies by the mean forces with which the step was made."""

from typing import Any, NamedTuple

from jaxclear.components.clearance import ContactLaws
from jaxclear.formulations import laws_over_step
from jaxclear.formulations.contact_rows import (
    ContactPoint,
    MiddleOfStep,
    TimeStep,
    by_joint,
    joint_reports,
    split,
)
from jaxclear.formulations.delassus import ContactSolution, ImplicitContact
from jaxclear.formulations.films_over_step import FilmOverStep, film_losses, with_films
from jaxclear.formulations.laws_over_step import Averaging, SlipAtStart
from jaxclear.formulations.model import Model
from jaxclear.formulations.permanent_reactions import Reaction
from jaxclear.formulations.rubbing_over_step import JointOverStep, friction, rubbed
from jaxclear.formulations.shafts_over_step import ShaftOverStep
from jaxclear.formulations.state_rate import (
    Passive,
    followed_rates,
    link_accelerations,
    passive_rates,
)
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part
from jaxclear.multibody import kinematics
from jaxclear.multibody.contact_point import ActingContact, PointState, impact_speed_now
from jaxclear.multibody.damped_stops import forces_at
from jaxclear.multibody.state import pack_memories, unpack_motion
from jaxclear.multibody.system import System


class ContactOverStep(NamedTuple):
    """One contact over a step: the point in its middle, indentation and its rate at the start, the
    mass that it stops, what its laws remember, when its friction is taken
    (`Braking`, None without), how it slides."""

    point: ContactPoint
    depth: Any
    approach: Any
    mass: Any
    memory: PointState
    braking: Any
    slips: tuple[SlipAtStart, ...]


class Step(NamedTuple):
    """All that a step starts from; rows of contacts come first, then those of `others`."""

    model: Model
    time_step: TimeStep
    averaging: Averaging
    middle: MiddleOfStep
    contacts: list[ContactOverStep]
    equations: ImplicitContact
    joints: tuple[JointOverStep, ...] = ()
    shafts: tuple[ShaftOverStep, ...] = ()
    films: tuple[FilmOverStep, ...] = ()

    def reaches(self) -> list:
        """Change of each row's rate by the acceleration that contact adds to it [s]."""
        out: list[Any] = []
        for contact in self.contacts:
            others = contact.point.active - 1
            out.append(self.averaging.reach)
            out += [contact.braking.reach] * others if others else []
        return out + [other.reaches[0] for other in self.others for _ in other.rates]

    @property
    def others(self) -> tuple[Any, ...]:
        """Ideal joints that rub, couplings with stiffness, films: of each the `rates` of its rows,
        changes of these by accelerations that contact adds, and by others (`reaches` [s]), and the
        law about mean rates, `linear(rates)`."""
        return (*self.joints, *self.shafts, *self.films)

    def per_other(self, values: Any) -> list[tuple]:
        """One value per row with a force, as one tuple for each of the others."""
        first = sum(contact.point.active for contact in self.contacts)
        return split(values[first:], [len(other.rates) for other in self.others])

    def per_contact(self, values: Any) -> list[tuple]:
        """One value per row with a force, as one tuple per contact."""
        return split(values, [contact.point.active for contact in self.contacts])


def memories_after(step: Step, solution: ContactSolution) -> list:
    """What the laws remember at the end of the step, as entries of the state."""
    rates, forces = step.per_contact(solution.rates), step.per_contact(solution.forces)
    after = []
    for contact, rate, force in zip(step.contacts, rates, forces, strict=True):
        bristles = laws_over_step.bristles_after(
            contact.point.laws, contact.memory.bristles, step.averaging, rate, -force[0]
        )
        after.append(contact.memory._replace(bristles=bristles))
    system = step.model.system
    memories = dict(zip(system.bearings, by_joint(system, after), strict=True))
    return pack_memories(step.model.layout, memories)


def passive_rates_over(
    step: Step, solution: ContactSolution, ends: list, mean: list
) -> tuple[list, tuple[Reaction, ...]]:
    """(rates of what only follows the motion, with the forces that the step was made with;
    reactions of ideal joints that rub). `ends`: slips at its end along the directions in its
    middle; `mean`: speeds over it."""
    model, free_motion = step.model, step.middle.free_motion
    layout, system = model.layout, model.system
    # Of all that the speeds gain by contact, so also where an iteration ends with a pull.
    normal = [-part[0] for part in step.per_contact(solution.forces)]
    pressing = [sp.total(part) for part in by_joint(system, normal)]
    if not (layout.wear or layout.energies or step.joints or step.films):
        return [*followed_rates(system, layout, free_motion.forces), *pressing], ()
    change = step.middle.change_to(mean)
    acting = _acting_contacts(step, solution, ends, change)
    reports = joint_reports(system, free_motion.poses, acting)
    forces = free_motion.forces._replace(reports=reports)
    if layout.energies or step.joints or step.films:
        motion = unpack_motion(system, [*step.middle.halfway, *step.middle.predicted])
        motions = free_motion.forces.motions
        time, followed = step.time_step.middle, forces.followed
        if step.films:
            # Speeds at its start alternate about those that stiff films determine.
            motion = unpack_motion(system, [*step.middle.halfway, *mean])
            motions = kinematics.link_motions(system, *motion, time)
        forces = forces_at(system, motions, reports, *motion, time, followed)
        forces = with_films(forces, step.films, solution)
        pressing += film_losses(system, forces)
    accelerations, multipliers = (
        [sp.add(a, b) for a, b in zip(free, caused, strict=True)]
        for free, caused in (
            (step.equations.free, solution.accelerations),
            (step.equations.multipliers, solution.multipliers),
        )
    )
    total = link_accelerations(system, accelerations, tuple(multipliers))
    passive, reactions = Passive(), tuple[Reaction, ...]()
    if step.joints:
        rubbing = friction(step.joints, step.per_other(solution.forces), change), change
        # The accelerations contain the joints' friction, so the power of a drive asks for it too.
        passive, reactions, forces = rubbed(model, step.joints, forces, step.middle, total, rubbing)
    return passive_rates(system, layout, forces, total, passive, pressing), reactions


def _acting_contacts(
    step: Step, solution: ContactSolution, ends: list, change: list
) -> list[ActingContact]:
    """The contacts with mean forces and rates over the step, and the mean indentation while in
    contact; `ends`: slips at the end; `change`: from the predicted speeds to the mean ones, which
    tell how a contact without friction slides.
    """
    acting = []
    for contact, slid, rates, forces in zip(
        step.contacts,
        ends,
        step.per_contact(solution.rates),
        step.per_contact(solution.forces),
        strict=True,
    ):
        point = contact.point
        slip, speed = laws_over_step.mean_slip(contact.slips, slid), None
        if contact.braking is not None:
            speed = laws_over_step.wearing_speed(
                point.laws, slip, positive_part(-forces[0]), forces[1:]
            )
        slip += tuple(rate.at(change) for rate in point.rates[point.active :])
        end = contact.depth + step.averaging.length * rates[0]
        depth = 0.5 * (positive_part(contact.depth) + positive_part(end))
        forces = positive_part(-forces[0]), forces[1:], point.laws.contact.elastic_force(depth)
        values = point.laws, point.gap_function, (rates[0], *slip), *forces
        memory = PointState(None, contact.memory.bristles)
        acting.append(ActingContact(*values, memory, speed, depth))
    return acting


def follows_depth(laws: ContactLaws) -> bool:
    """Whether a contact presses hardest where it is deepest, or by a law that follows its worn
    radius, which is not known between saving times."""
    return laws.contact.lossless or laws.unfitted is not None


def damped(system: System) -> bool:
    """Whether some contact's largest force is not told by its depth."""
    return not all(map(follows_depth, laws_of_contacts(system)))


def damped_forces(laws: list[ContactLaws], depths: Any, rates: Any, impact_speeds: Any) -> list:
    """Normal force [N] of every possible contact that damps, 0 of the others, from its motion and
    the impact speed that is remembered."""
    forces: list[Any] = []
    for law, depth, rate, speed in zip(laws, depths, rates, impact_speeds, strict=False):
        if follows_depth(law):
            forces.append(0.0)
        else:
            forces.append(law.contact.normal_force(depth, rate, impact_speed_now(speed, rate)))
    return forces


def forces_at_start(system: System, contacts: list[ContactOverStep], faster: list) -> list:
    """The same where an implicit step begins with these contacts, which close faster than their
    speeds tell (`midpoint_step`) [m/s]; none where none damps."""
    if not damped(system):
        return []
    rates = [sp.add(c.approach, more) for c, more in zip(contacts, faster, strict=True)]
    speeds = [contact.memory.impact_speed for contact in contacts]
    laws, depths = [c.point.laws for c in contacts], [c.depth for c in contacts]
    return damped_forces(laws, depths, rates, speeds)


def laws_of_contacts(system: System) -> list[ContactLaws]:
    """Of every possible contact, in the order of the state."""
    return [laws for bearing in system.bearings.values() for laws in bearing.contact_laws]
