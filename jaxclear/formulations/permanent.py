r"""Joints that always touch: ideal joints, whose reactions rub in the gap.

The equations are evaluated once a step, half a step ahead. Reactions $R$ and the sliding speeds $s$
at the step's end are linear in the friction $T$ of the joints, $s = s_0 + W T$; Coulomb's law asks
$T \in [-B, B]$, $B$ = grip(mu) times the sum of the forces $R$ splits into, $T = B$ against
sliding, $s = 0$ in between. This is a horizontal complementarity problem where the directions of
the carried forces are known (a guide); a journal's turn with $T$ and are iterated upon with it.
Coordinates move by exponentials of the mean speeds, so rotations stay on their group.
"""

import dataclasses
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.body import Connection
from jaxclear.components.clearance import AbstractClearance
from jaxclear.components.joint import AbstractJoint, AbstractRubbingJoint
from jaxclear.formulations.base import AbstractFormulation, check_lossless, check_unworn
from jaxclear.formulations.contact_rows import TimeStep
from jaxclear.formulations.joint_friction import (
    NonCollidingSettings,
    friction_losses,
    moved_to_stops,
    regularised_friction,
    set_valued_friction,
    with_rows_of_loads,
)
from jaxclear.formulations.loads_over_step import (
    beyond_stops,
    check_solved_loads,
    load_components,
    loads_in_step,
    with_loads,
    with_solved_loads,
)
from jaxclear.formulations.model import Model, State
from jaxclear.formulations.permanent_reactions import (
    check_unique,
    friction_response,
    joint_part,
    placed,
    sliding_rates,
    touching,
    with_friction,
)
from jaxclear.formulations.permanent_report import (
    forces_of_impulses,
    joint_components,
    moved_in_films,
    pressing,
    report_of_means,
)
from jaxclear.formulations.permanent_wear import (
    Centres,
    centres_of,
    count_of_centres,
    ends_that_wear,
    wear_rates,
)
from jaxclear.formulations.rigid import check_friction
from jaxclear.formulations.state_rate import Passive, link_accelerations, passive_rates
from jaxclear.ground import sparse as sp
from jaxclear.multibody import kinematics
from jaxclear.multibody.forces import applied_forces
from jaxclear.multibody.mechanism import Mechanism, rebuilt
from jaxclear.multibody.state import unpack_followed, unpack_motion
from jaxclear.multibody.system import System, prepare


def fit(mechanism: Mechanism) -> Mechanism:
    """The mechanism with every clearance joint replaced by the joint that it is while it always
    touches, and every play of couplings seated.

    Starts and speeds are kept: they may name joints and bodies whatever holds them. Raises
    `ValueError` where a joint has no such form.
    """
    mechanism = _with_seated_plays(mechanism)
    if not mechanism.topology.clearances:
        return mechanism
    connections = {}
    for name, connection in mechanism.connections.items():
        joint = connection.joint
        if name in mechanism.topology.clearances:
            joint = permanent_joint(name, joint)
        connections[name] = Connection(joint, connection.parent, connection.child)
    return rebuilt(mechanism, connections=connections)


def _with_seated_plays(mechanism: Mechanism) -> Mechanism:
    couplings: dict[str, Any] = {}
    for name, original in mechanism.couplings.items():
        play: Any = original.play
        if play is not None and not play.in_contact:
            coupling: Any = original
            play = dataclasses.replace(play, in_contact=True)
            couplings[name] = dataclasses.replace(coupling, play=play)
    if not couplings:
        return mechanism
    return rebuilt(mechanism, couplings=mechanism.couplings | couplings)


def permanent_joint(name: str, joint: AbstractClearance) -> AbstractJoint:
    """The joint as which the clearance joint `name` moves while it always touches. Raises
    `ValueError` where none is known.
    """
    try:
        form = joint.permanent_form()
    except ValueError as error:
        raise ValueError(f'joint "{name}" {error}') from None
    if any(laws.contact.reach is not None for laws in joint.contact_laws()):
        raise ValueError(
            f'joint "{name}" has asperities, which carry no load where the reaction moves the '
            "journal; take integrator.ImplicitStep, Adaptive or FixedStep, or the contact law of "
            "smooth parts."
        )
    if joint.maps() and not isinstance(form, AbstractRubbingJoint):
        raise ValueError(
            f'joint "{name}" is a {type(joint).__name__} that wears, whose form in permanent '
            f"contact, {type(form).__name__}, tells of no wear; leave its wear out, or take a "
            "compliant integrator such as ImplicitStep."
        )
    return form


class PermanentContact(AbstractFormulation):
    """Clearance joints taken as always in contact: the motion of the ideal mechanism, with
    reactions carried in the gap.

    Args:
        regularised: whether friction laws are taken as the functions of the sliding speed that they
            are; else friction is set-valued, as Coulomb's.
    """

    regularised: bool = eqx.field(static=True, default=False)
    forces_are_means: ClassVar = True

    @property
    def rubs_as_coulombs(self):
        return not self.regularised

    def check(self, mechanism, integrator):
        check_friction(mechanism, integrator)
        check_solved_loads(mechanism, integrator, seated=True)
        for name, coupling in mechanism.couplings.items():
            if coupling.play is not None:
                check_unworn(name, coupling, integrator)
                check_lossless(name, coupling, f"{integrator} seats it")

    def modelled(self, mechanism):
        return fit(mechanism)

    def prepared(self, system):
        return with_solved_loads(system)

    def impulses(self, system):
        return joint_components(system) + load_components(system)

    def normal_impulses(self, system, name):
        (count,) = (count for joint, count in self.impulses(system) if joint == name)
        return (count - 1,)

    def contact_joints(self, mechanism):
        return tuple(pair.name for pair in touching(prepare(mechanism)))

    def forces(self, instant):
        return forces_of_impulses(instant, {})

    def contact(self, instant, name):
        return report_of_means(instant, name)

    def warm_start(self, model: Model) -> Float[Array, " h"]:
        """Warm start of the first step: no accelerations, no centres of joints that wear.

        Args:
            model: the mechanism, a `Model`.

        Returns:
            numbers for `step`, an array.
        """
        check_unique(model.system)
        return jnp.zeros(model.layout.speeds + 3 * count_of_centres(model.system) + 1)

    def step(
        self,
        model: Model,
        time_step: TimeStep,
        state: State,
        last: Float[Array, " h"],
        settings: NonCollidingSettings,
    ) -> tuple[State, Float[Array, " h"]]:
        """Take one step.

        Args:
            model: the mechanism, a `Model`.
            time_step: the step, a `TimeStep`.
            state: the state at its beginning, an array (n,).
            last: what the step before has returned, an array: the accelerations over it, the
                centres in their gaps of what wears, then the largest change of friction, relative
                to its bound, with which a search has ended so far.
            settings: settings of the search for friction, a `NonCollidingSettings`.

        Returns:
            the state at the end, an array (n,), and the same numbers of this step, an array.
        """
        system, layout, h = model.system, model.layout, time_step.length
        entries = model.entries(state)
        q, v = entries[: layout.coordinates], entries[layout.coordinates : layout.memory_start]
        middle = [x + 0.5 * h * last[i] for i, x in enumerate(v)]
        halfway = displace(system, q, v, 0.5 * h)
        motion = unpack_motion(system, [*halfway, *middle])
        motions = kinematics.link_motions(system, *motion, time_step.middle)
        followed = unpack_followed(layout, entries)
        forces = applied_forces(system, motions, {}, time_step.middle, followed)
        joints = touching(system)
        slips = [sliding_rates(system, motions, one) for one in joints]
        loads = loads_in_step(system, motions, time_step.middle, followed)
        response = friction_response(model, forces, motion[0], loads)
        before = [x - m for x, m in zip(v, middle, strict=True)]
        free = response.without.accelerations
        ahead = [x + h * free[j] for j, x in enumerate(before)]
        mass = sp.total(link.mass for link in system.links)
        if self.regularised:
            speeds = [[slip.value for slip in joint] for joint in slips]
            problem = regularised_friction(joints, speeds, response)
        else:
            problem = set_valued_friction(joints, slips, before, ahead, h, mass, response)
        if loads.rates:
            problem = with_rows_of_loads(problem, loads, response, before, ahead, h, mass)
        friction, misfit, _ = settings.solver().iterate(problem)
        answer = response.at(friction)
        after = [x + h * answer.accelerations[j] for j, x in enumerate(v)]
        mean = [0.5 * (a + b) for a, b in zip(v, after, strict=True)]
        change = [x - m for x, m in zip(mean, middle, strict=True)]
        sliding = [slip.at(change) for joint in slips for slip in joint]
        ends = ends_that_wear(system, answer, friction)
        centres = centres_of(system, ends)
        centre_rates = _velocities_of_centres(centres, last[len(v) : -1], h)
        worn = wear_rates(model, motions, motion[0], ends, sliding, centre_rates)
        means: list = []
        for one, reaction, place in zip(joints, answer.reactions, placed(joints), strict=True):
            pressed = pressing(one, reaction, joint_part(friction, place))
            means += [*reaction.force, *reaction.torque, *friction[place], pressed]
        end, acting = displace(system, q, mean, h), with_friction(system, forces, friction)
        if loads.rates:
            first = len(friction) - len(loads.rates)
            forces_of_loads = [friction[first + k] for k in range(len(loads.rates))]
            by_load = loads.by_load(system, forces_of_loads)
            means, acting = [*means, *by_load.values()], with_loads(system, acting, by_load)
            beyond = beyond_stops(model, time_step.end, [*end, *after], followed)
            shift, taken = moved_to_stops(loads, beyond, response, forces_of_loads, h)
            end = displace(system, end, shift, 1.0)
        solution = link_accelerations(system, answer.accelerations, answer.multipliers)
        passive = Passive(worn, *friction_losses(joints, friction, sliding))
        rates = passive_rates(system, layout, acting, solution, passive, means)
        gained = [h * rate for rate in rates]
        if loads.rates and layout.energies:
            loss = taken + h * loads.loss(forces_of_loads, change)
            gained[layout.energies.index("damping_loss") - len(layout.energies)] += loss
        end = [*end, *after]
        end += [x + g for x, g in zip(entries[len(end) :], gained, strict=True)]
        for index, value in moved_in_films(model, motions, followed, answer.reactions, h).items():
            end[index] = value
        residual = jnp.maximum(last[-1], misfit)
        handed = [answer.accelerations[j] for j in range(len(v))]
        handed += [x for joint in centres.values() for centre in joint for x in centre]
        return sp.stack(end), sp.stack([*handed, residual])


def displace(system: System, q: list, speeds: list, h: Any) -> list:
    """Coordinates after constant speeds, by the joints' exponential maps.

    Args:
        system: with the joints.
        q: coordinates, scalars.
        speeds: scalars.
        h: time [s].
    """
    out: list[Any] = []
    for link, place, v in zip(system.links, *unpack_motion(system, [*q, *speeds]), strict=True):
        if place:
            out.extend(link.joint.moved(place, tuple(h * x for x in v)))
    return out


def _velocities_of_centres(centres: Centres, before: Any, h: Any) -> Centres:
    """How fast the centres have moved since a step before [m/s], where they were known then."""
    rates: Centres = {}
    start = 0
    for name, points in centres.items():
        rates[name] = []
        for centre in points:
            previous = tuple(before[start + i] for i in range(3))
            start += 3
            there = sp.norm(previous) > 0
            travel = sp.minus(centre, previous)
            rates[name].append(tuple(jnp.where(there, x / h, 0.0) for x in travel))
    return rates
