"""Friction and wear of ideal joints in a step of percussions: set-valued, by the reactions of the
same step; the impulse of an impact's reaction counts as that of any other.

Nothing here is evaluated in a mechanism without such joints.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxclear.components.clearance import carried_load
from jaxclear.formulations.contact_rows import (
    MiddleOfStep,
    lightness,
    split,
)
from jaxclear.formulations.delassus import DelassusOperator
from jaxclear.formulations.joint_friction import passive_of
from jaxclear.formulations.joint_reports import rigid_reports
from jaxclear.formulations.model import Model
from jaxclear.formulations.permanent_friction import UNMOVED
from jaxclear.formulations.permanent_reactions import (
    Answer,
    Reaction,
    answer_to,
    placed,
    slips_of,
    touching,
    with_friction,
)
from jaxclear.formulations.rubbing_search import JointInStep, Search, as_reactions, searched
from jaxclear.formulations.state_rate import Passive, link_accelerations
from jaxclear.formulations.unilateral import (
    MoreauJeanSettings,
    Percussions,
    UnilateralContact,
    demands,
    first_guess,
    in_own_directions,
)
from jaxclear.ground import sparse as sp
from jaxclear.multibody.forces import add_action_and_reaction
from jaxclear.multibody.state import unpack_motion


class Rubbed(NamedTuple):
    """What joints that touch all the time do in a step, as means over it: friction of every
    component [N], reactions."""

    friction: list
    reactions: tuple[Reaction, ...]


class RubbedOver(NamedTuple):
    """What follows from it: wear and losses, friction of every component [N], and the components of
    the joints' forces that the state counts [N, N m]."""

    passive: Passive
    friction: list
    forces: list


def joints_in_step(model: Model, middle: MiddleOfStep) -> list[JointInStep]:
    """The joints that touch all the time, as a step begins with them."""
    system, motions = model.system, middle.free_motion.forces.motions
    found = []
    for held in touching(system):
        slips, arm, law = slips_of(system, motions, held, middle.predicted), held.joint.arm, None
        begun = tuple(sp.mul(arm, slip.at(middle.v)) for slip in slips)
        if held.joint.friction is not None:
            law = held.joint.friction.coulomb()
        share = None if law is None else held.joint.friction_ratio(law.bound(sp.norm(begun)))
        moved = () if share is None or held.driven else slips
        rows = [{j: sp.mul(arm, entry) for j, entry in slip.row.items()} for slip in moved]
        found.append(JointInStep(held, slips, rows, begun, share))
    return found


def percussions_and_friction(
    model: Model,
    middle: MiddleOfStep,
    contacts: list[UnilateralContact],
    joints: list[JointInStep],
    delassus: DelassusOperator,
    last: list,
    h: Any,
    settings: MoreauJeanSettings,
) -> tuple[Percussions, Rubbed]:
    """Percussions of a step of length h [s], and what joints that touch all the time do; searched
    from the `last` ones: percussions of contacts in their own directions, then friction of every
    component of every joint."""
    respond = _reactions(model, middle, contacts, joints, delassus)
    own = sum(1 + len(contact.shares) for contact in contacts)
    rubs = split(last[own:], [joint.held.joint.components for joint in joints])
    kept = [x for joint, part in zip(joints, rubs, strict=True) if joint.rows for x in part]
    start = [*first_guess(contacts, last[:own]), *([sp.stack(kept)] if kept else [])]
    flat, residual = [], 0.0
    if start:
        search = _search(middle, contacts, joints, delassus, h, settings)
        found, residual = searched(search, respond, jnp.concatenate(start), settings)
        flat = [found[i] for i in range(len(delassus.rows))]
    touching_at = sum(len(contact.rows) for contact in contacts)
    by_contact = in_own_directions(contacts, flat[:touching_at])
    met = as_reactions(respond(sp.stack([x / h for x in flat]) if flat else jnp.zeros(0)))
    rubbed = Rubbed(_friction(joints, met, [x / h for x in flat[touching_at:]]), met)
    return Percussions(by_contact, *_caused(delassus, flat), residual), rubbed


def rubbed_over(
    model: Model, middle: MiddleOfStep, joints: list[JointInStep], rubbed: Rubbed, mean: list
) -> RubbedOver:
    """What follows from what joints do in a step of these mean speeds."""
    system, forces, friction = model.system, middle.free_motion.forces, rubbed.friction
    q = unpack_motion(system, [*middle.halfway, *middle.predicted])[0]
    slips = [x for joint in joints for x in joint.sliding(mean)]
    answer = Answer((), (), rubbed.reactions)
    passive = passive_of(model, forces, q, answer, friction, slips)
    each = zip(rubbed.reactions, placed(touching(system)), passive.pressing, strict=True)
    acting = [[*met.force, *met.torque, *friction[own], pressed] for met, own, pressed in each]
    return RubbedOver(passive._replace(pressing=()), friction, [x for own in acting for x in own])


def _caused(delassus: DelassusOperator, flat: list) -> tuple[list, tuple]:
    """Accelerations and closure multipliers that forces (or impulses) along all rows add."""
    if flat:
        return delassus.under(flat)
    return [0] * len(delassus.free), (0,) * len(delassus.multipliers)


def _friction(joints: list[JointInStep], met: tuple[Reaction, ...], moved: list) -> list:
    """Friction [N] of every component of every joint; `moved`: of those that it moves. A joint that
    a drive moves is rubbed as its load asks."""
    own = iter(split(moved, [len(joint.rows) for joint in joints]))
    out: list[Any] = []
    for joint, reaction, part in zip(joints, met, own, strict=True):
        if joint.share is None:
            out += [0.0] * joint.held.joint.components
        elif joint.rows:
            out += part
        else:
            load = joint.share * carried_load(joint.ends(reaction))
            out += [-load * jnp.sign(x) for x in joint.begun]
    return out


def _reactions(
    model: Model,
    middle: MiddleOfStep,
    contacts: list[UnilateralContact],
    joints: list[JointInStep],
    delassus: DelassusOperator,
) -> Callable[[Array], Array]:
    """From forces along the rows [N] to the numbers of the reactions of all joints that touch:
    linear, so unit forces tell it once a step."""
    system, now, held = model.system, middle.free_motion, touching(model.system)
    q = unpack_motion(system, [*middle.halfway, *middle.predicted])[0]
    counts = [sum(len(contact.rows) for contact in contacts), *(len(j.rows) for j in joints)]

    def under(forces):
        flat = [forces[i] for i in range(sum(counts))]
        pushed, *rubs = split(flat, counts)
        reports = rigid_reports(
            system, now.poses, now.contacts, in_own_directions(contacts, list(pushed))
        )
        wrenches = list(now.forces.wrenches)
        for name, report in reports.items():
            place = system.bearings[name].closure, now.poses[name]
            add_action_and_reaction(wrenches, *place, report.force, report.torque)
        none = [(0,) * joint.held.joint.components for joint in joints]
        friction = [x for own, zero in zip(rubs, none, strict=True) for x in own or zero]
        acting = with_friction(system, now.forces._replace(wrenches=tuple(wrenches)), friction)
        total, multipliers = (
            [sp.add(x, y) for x, y in zip(free, caused, strict=True)]
            for free, caused in zip(
                (delassus.free, delassus.multipliers), _caused(delassus, flat), strict=True
            )
        )
        solution = link_accelerations(system, total, tuple(multipliers))
        found = answer_to(system, acting, q, held, solution).reactions
        return sp.stack([x for reaction in found for part in reaction for x in part])

    count = sum(counts)
    if not count:
        return under
    without, push = jax.linearize(under, jnp.zeros(count))
    units = [push(jnp.zeros(count).at[k].set(1.0)) for k in range(count)]
    return lambda forces: without + sum(forces[k] * unit for k, unit in enumerate(units))


def _search(
    middle: MiddleOfStep,
    contacts: list[UnilateralContact],
    joints: list[JointInStep],
    delassus: DelassusOperator,
    h: Any,
    settings: MoreauJeanSettings,
) -> Search:
    """What a step's search starts from."""
    numbers = [k for k, joint in enumerate(joints) if joint.rows]
    asked = demands(middle, contacts, delassus.free, h, settings) if contacts else None
    end = [x + h * a for x, a in zip(middle.v, delassus.free, strict=True)]
    free = [x for k in numbers for x in joints[k].sliding(end)]
    diagonal = middle.free_motion.diagonal
    # A joint that drives move slides whatever friction does (only rounding, of either sign,
    # answers): there it is full.
    softest = [
        UNMOVED * sp.total([lightness(row, diagonal) for row in joints[k].rows]) for k in numbers
    ]
    rubbing = [joints[k] for k in numbers]
    return Search(rubbing, numbers, asked, delassus.matrix(), free, softest, h)
