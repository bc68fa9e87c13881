"""Percussions of a step, with the friction and wear of ideal joints: set-valued, by the reactions
of the same step; the impulse of an impact's reaction counts as that of any other.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxclear.complementarity import FrictionContact
from jaxclear.complementarity.contact_states import (
    CORNER,
    REGULAR,
    laws_missed,
    with_derivatives,
)
from jaxclear.complementarity.friction_cone import alart_curnier
from jaxclear.complementarity.joint_friction import across
from jaxclear.components.clearance import CarryingEnd, carried_load
from jaxclear.formulations.contact_rows import (
    MiddleOfStep,
    lightness,
    rigid_reports,
    split,
)
from jaxclear.formulations.delassus import DelassusOperator
from jaxclear.formulations.joint_friction import UNMOVED, passive_of
from jaxclear.formulations.loads_over_step import LoadsInStep, RubInStep, with_loads
from jaxclear.formulations.model import Model
from jaxclear.formulations.permanent_reactions import (
    REACTION,
    Answer,
    PermanentJoint,
    Reaction,
    answer_to,
    placed,
    sliding_rates,
    touching,
    with_friction,
)
from jaxclear.formulations.state_rate import Passive, link_accelerations
from jaxclear.formulations.unilateral import (
    ContactDemands,
    MoreauJeanSettings,
    Percussions,
    Spring,
    UnilateralContact,
    demands,
    first_guess,
    in_joint_directions,
)
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide
from jaxclear.multibody.forces import contact_rows, with_rows
from jaxclear.multibody.rows import LinearRate
from jaxclear.multibody.state import unpack_motion


class JointInStep(NamedTuple):
    """A joint that touches all the time, in a step: how it slides (`slips` by component), how fast
    it does as the step begins [m/s], and friction's largest share of its load (None without)."""

    pair: PermanentJoint
    slips: tuple[LinearRate, ...]
    speeds: tuple
    share: Any

    @property
    def moved(self) -> tuple[LinearRate, ...]:
        """The components in which friction moves it."""
        return () if self.share is None or self.pair.driven else self.slips

    def ends(self, reaction: Reaction) -> tuple[CarryingEnd, ...]:
        """Where it carries a reaction."""
        count = self.pair.joint.components
        return self.pair.joint.carrying_ends(*reaction, 0.0 if count == 1 else (0.0,) * count)


class Search(NamedTuple):
    """What a search starts from: the joints that friction moves, with their numbers among all that
    touch; what the contacts ask (None without); Delassus' matrix by contact rows and sliding
    components, speeds of the latter at the step's end without friction; by joint the
    least that friction is taken to move it [1/kg]; the step's length [s]; the least by load that
    rubs; these loads, whose rows are the last; (row, number, spring) of sides of stops that may
    give way."""

    joints: list[JointInStep]
    numbers: list[int]
    required: ContactDemands | None
    matrix: list[list]
    free: list
    softest: list
    h: Any
    softest_of_loads: list
    rubs: tuple[RubInStep, ...] = ()
    springs: tuple[tuple[int, int, Spring], ...] = ()

    @property
    def first(self) -> int:
        """How many rows the contacts have."""
        return 0 if self.required is None else sum(self.required.sizes)


def as_reactions(numbers: Array) -> tuple[Reaction, ...]:
    """The reactions of all joints that touch, from their numbers."""
    flat = [numbers[i] for i in range(len(numbers))]
    parts = split(flat, [REACTION] * (len(flat) // REACTION))
    return tuple(Reaction(part[:3], part[3:]) for part in parts)


def searched(
    search: Search, respond: Callable, start: Array, settings: MoreauJeanSettings
) -> tuple[Array, Any]:
    """(impulses along all rows [N s], residual of the laws relative to the largest velocity), with
    the derivatives of a solution of the laws.

    Args:
        search: contacts, joints and loads of the step.
        respond: function from mean forces [N] to the joints' reactions.
        start: impulses at which the iteration begins [N s].
        settings: of the solver.
    """
    reactions_at = lambda z: as_reactions(respond(z / search.h))

    # Slips of joints of a loop that stick agree as well as the loop is closed, and sweeps pass that
    # difference on without end: a turn takes as many as there may be turns.
    most = jnp.sqrt(settings.max_sweeps) if search.joints else settings.max_sweeps
    solver = settings._replace(max_sweeps=most).solver()

    def improve(carry):
        z, old, _, sweeps = carry
        problem, guess, back = _problem(search, old, z)
        out = solver.iterate(problem, guess, sweep=bool(search.joints))
        z = back(out.z)
        now = reactions_at(z)
        residual = jnp.maximum(out.residual, _residual(search, old, now, problem))
        return z, now, residual, sweeps + jnp.maximum(out.sweeps, 1)

    def unfinished(carry):
        _, _, residual, sweeps = carry
        return (residual > settings.tolerance) & (sweeps < settings.max_sweeps)

    first = (start, reactions_at(start), jnp.asarray(jnp.inf), jnp.zeros((), int))
    z, _, residual, _ = (
        jax.lax.while_loop(unfinished, improve, first) if search.joints else improve(first)
    )
    return with_derivatives(lambda z: _missed(search, respond, z), z), residual


def _missed(search: Search, respond: Callable, z: Array) -> Array:
    """What impulses along all rows miss of the laws with the reactions to them; of a ball's
    friction also its part along the force that it carries."""
    reactions = as_reactions(respond(z / search.h))
    problem, guess, _ = _problem(search, reactions, z)
    missed = laws_missed(problem, guess)
    result, k = [missed[i] for i in range(search.first)], search.first
    for joint in _loaded(search, reactions):
        # In units of its own: a drive may move it, so that friction answers by rounding alone.
        at = range(k + 1, k + 1 + len(joint.axes))
        friction = sp.stack([guess[i] for i in at])
        slip = sp.stack([problem.delassus[i] @ guess + problem.free_velocity[i] for i in at])
        s = slip / problem.delassus[k + 1][k + 1]
        s = s + REGULAR * (friction - jax.lax.stop_gradient(friction))
        under = jnp.append(joint.load, friction), jnp.append(0.0, s)
        law = alart_curnier(*under, joint.share, CORNER * joint.share * joint.load)
        parts = [law[1 + i] for i in range(len(at))]
        k += 1 + len(parts)
        if joint.rows > 1:
            axes = (*joint.axes, sp.cross(*joint.axes))
            along_force = sp.dot(axes[-1], [z[joint.place + i] for i in range(joint.rows)])
            parts = [sp.dot([*parts, along_force], part) for part in zip(*axes, strict=True)]
        result += parts
    return sp.stack(result)


class Loaded(NamedTuple):
    """A joint under its load in a turn of the search: how many rows it has, friction's share of its
    load, impulse of the load [N s], axes of its friction among its components (of a ball two across
    the force), and the first of these among all rows."""

    rows: int
    share: Any
    load: Any
    axes: tuple[tuple, ...]
    place: int
    softest: Any

    def unknowns(self) -> list[dict]:
        """By unknown of the solver the rows along which it acts, with their weights: none for the
        load."""
        return [{}, *({self.place + i: x for i, x in enumerate(axis)} for axis in self.axes)]


def _loaded(search: Search, reactions: tuple[Reaction, ...]) -> list[Loaded]:
    """The joints that friction moves under these reactions."""
    loaded, place = [], search.first
    # Behind the joints' numbers are those of loads.
    for joint, number, softest in zip(search.joints, search.numbers, search.softest, strict=True):
        reaction = reactions[number]
        load, force = search.h * carried_load(joint.ends(reaction)), reaction.force
        axes: tuple = ((1,),)
        if len(joint.moved) > 1:
            size = sp.norm(force)
            axes = across(tuple(safe_divide(x, size) for x in force))
        loaded.append(Loaded(len(joint.moved), joint.share, load, axes, place, softest))
        place += len(joint.moved)
    for k, (rub, softest) in enumerate(zip(search.rubs, search.softest_of_loads, strict=True)):
        loaded.append(Loaded(1, 1.0, search.h * rub.bound, ((1,),), place + k, softest))
    return loaded


def _problem(
    search: Search, reactions: tuple[Reaction, ...], z: Array
) -> tuple[FrictionContact, Array, Callable]:
    """(the problem with the joints under these reactions, where to start in its unknowns, how
    impulses along all rows follow from these)."""
    first, required, joints = search.first, search.required, _loaded(search, reactions)
    unknowns: list[dict] = [{i: 1} for i in range(first)]
    for joint in joints:
        unknowns += joint.unknowns()
    # How the rate along one combination of rows answers a unit force along another.
    answer = lambda a, b: sp.total(
        sp.mul(sp.mul(x, y), search.matrix[i][j]) for i, x in a.items() for j, y in b.items()
    )
    rows = [[answer(a, b) for b in unknowns] for a in unknowns]
    lifted, mu, sizes, closed = ([], [], (), ()) if required is None else required[:4]
    lifted, mu, guess, k = [*lifted], [*mu], [z[i] for i in range(first)], first
    for joint in joints:
        count = len(joint.axes)
        place = range(joint.place, joint.place + joint.rows)
        for i in range(k + 1, k + 1 + count):
            rows[i][i] = jnp.maximum(rows[i][i], joint.softest)
        rows[k][k] = sp.total(rows[i][i] for i in range(k + 1, k + 1 + count))
        free = [search.free[i - first] for i in place]
        lifted += [-rows[k][k] * joint.load, *(sp.dot(axis, free) for axis in joint.axes)]
        guess += [joint.load, *(sp.dot(axis, [z[i] for i in place]) for axis in joint.axes)]
        mu, sizes, k = [*mu, joint.share], (*sizes, 1 + count), k + 1 + count
    active = jnp.asarray(closed, bool)
    if joints:
        active = jnp.concatenate([active, jnp.ones(len(joints), bool)])
    for i, contact, spring in search.springs:
        # The row of a percussion that is known: only itself, moved to where it is 0.
        alone = [rows[i][i] if j == i else 0.0 for j in range(len(rows))]
        target = -rows[i][i] * search.h * spring.force
        rows[i] = [jnp.where(spring.acts, a, b) for a, b in zip(alone, rows[i], strict=True)]
        lifted[i] = jnp.where(spring.acts, target, lifted[i])
        active = active.at[contact].set(active[contact] | spring.acts)
    problem = FrictionContact(
        [sp.stack(row) for row in rows], sp.stack(lifted), sp.stack(mu), sizes, active
    )

    def back(solution):
        out: list[Any] = [0] * len(search.matrix)
        for i, weights in enumerate(unknowns):
            for j, weight in weights.items():
                out[j] = sp.add(out[j], sp.mul(weight, solution[i]))
        return sp.stack(out)

    return problem, sp.stack(guess), back


def _residual(
    search: Search, old: tuple[Reaction, ...], now: tuple[Reaction, ...], problem: FrictionContact
) -> Any:
    """What a turn's change of the carried forces does to the sliding speeds by friction, at the
    most, relative to the largest velocity."""
    largest, k = jnp.max(jnp.abs(problem.free_velocity)), search.first
    moved: list[Any] = []
    for joint, number, softest in zip(search.joints, search.numbers, search.softest, strict=True):
        ends = zip(joint.ends(old[number]), joint.ends(now[number]), strict=True)
        change = sp.total(sp.norm(sp.minus(b.force, a.force)) for a, b in ends)
        answer = problem.delassus[k][k]
        velocity = search.h * joint.share * change * answer
        # Friction that moves nothing loads the other joints all the same.
        load = carried_load(joint.ends(now[number]))
        relative = largest * safe_divide(change, load)
        moved.append(jnp.where(answer > len(joint.moved[:2]) * softest, velocity, relative))
        k += 1 + (1 if len(joint.moved) == 1 else 2)
    return jnp.max(sp.stack([*moved, 0.0])) / jnp.where(largest > 0, largest, 1.0)


class Rubbed(NamedTuple):
    """What joints that touch all the time do in a step, as means over it: friction of every
    component [N], reactions; and loads that rub [N m, N]."""

    friction: list
    reactions: tuple[Reaction, ...]
    loads: list


def joints_in_step(model: Model, middle: MiddleOfStep) -> list[JointInStep]:
    """The joints that touch all the time, as a step begins with them."""
    system, motions = model.system, middle.free_motion.forces.motions
    result, back = [], middle.change_to(middle.v)
    for pair in touching(system):
        slips, law = sliding_rates(system, motions, pair), None
        speeds = tuple(slip.at(back) for slip in slips)
        if pair.joint.friction is not None:
            law = pair.joint.friction.coulomb()
        share = None if law is None else pair.joint.friction_ratio(law.bound(sp.norm(speeds)))
        result.append(JointInStep(pair, slips, speeds, share))
    return result


def percussions_and_friction(
    model: Model,
    middle: MiddleOfStep,
    contacts: list[UnilateralContact],
    joints: list[JointInStep],
    loads: LoadsInStep,
    delassus: DelassusOperator,
    last: list,
    h: Any,
    settings: MoreauJeanSettings,
) -> tuple[Percussions, Rubbed]:
    """Percussions of contacts in a step, with friction of joints and loads.

    Args:
        model: of the run.
        middle: of the step.
        contacts: as percussions see them.
        joints: that always touch.
        loads: stops and dry friction.
        delassus: operator from impulses to velocities along all rows.
        last: percussions of contacts, friction of joints and of loads in the step before.
        h: length of the step [s].
        settings: of the solver.
    """
    respond = _reactions(model, middle, contacts, joints, loads, delassus)
    count = sum(1 + len(contact.shares) for contact in contacts)
    counts = [*(joint.pair.joint.components for joint in joints), len(loads.rubs)]
    *rubs, before = split(last[count:], counts)
    previous = [x for joint, part in zip(joints, rubs, strict=True) if joint.moved for x in part]
    previous += before
    start = [*first_guess(contacts, last[:count]), *([sp.stack(previous)] if previous else [])]
    flat, residual = [], 0.0
    if start:
        search = _search(middle, contacts, joints, loads, delassus, h, settings)
        impulses, residual = searched(search, respond, jnp.concatenate(start), settings)
        flat = [impulses[i] for i in range(len(delassus.rows))]
    touching_at = sum(len(contact.velocities) for contact in contacts)
    by_contact = in_joint_directions(contacts, flat[:touching_at])
    reactions = as_reactions(respond(sp.stack([x / h for x in flat]) if flat else jnp.zeros(0)))
    moved = [x / h for x in flat[touching_at:]]
    free = len(moved) - len(loads.rubs)
    rubbed = Rubbed(_friction(joints, reactions, moved[:free]), reactions, moved[free:])
    return Percussions(by_contact, *_caused(delassus, flat), residual), rubbed


def springs_of(contacts: list[UnilateralContact]) -> tuple[tuple[int, int, Spring], ...]:
    """(row, number, spring) of the contacts that may give way."""
    result, row = [], 0
    for k, contact in enumerate(contacts):
        if contact.spring is not None:
            result.append((row, k, contact.spring))
        row += len(contact.velocities)
    return tuple(result)


def rubbed_over(
    model: Model, middle: MiddleOfStep, joints: list[JointInStep], rubbed: Rubbed, mean: list
) -> tuple[Passive, list]:
    """Wear and losses of joints in a step, and components of their forces that the state counts.

    Args:
        model: of the run.
        middle: of the step.
        joints: that always touch.
        rubbed: their reactions and friction.
        mean: mean speeds over the step.
    """
    system, forces, friction = model.system, middle.free_motion.forces, rubbed.friction
    q = unpack_motion(system, [*middle.halfway, *middle.predicted])[0]
    change = middle.change_to(mean)
    slips = [slip.at(change) for joint in joints for slip in joint.slips]
    answer = Answer((), (), rubbed.reactions)
    passive = passive_of(model, forces, q, answer, friction, slips)
    each = zip(rubbed.reactions, placed(touching(system)), passive.pressing, strict=True)
    acting = [[*r.force, *r.torque, *friction[part], pressed] for r, part, pressed in each]
    return passive._replace(pressing=()), [x for part in acting for x in part]


def _caused(delassus: DelassusOperator, flat: list) -> tuple[list, tuple]:
    """Accelerations and closure multipliers that forces (or impulses) along all rows add."""
    if flat:
        return delassus.under(flat)
    return [0] * len(delassus.free), (0,) * len(delassus.multipliers)


def _friction(joints: list[JointInStep], reactions: tuple[Reaction, ...], moved: list) -> list:
    """Friction [N] of every component of every joint; `moved`: of those that it moves. A joint that
    a drive moves is rubbed as its load asks."""
    parts = iter(split(moved, [len(joint.moved) for joint in joints]))
    out: list[Any] = []
    for joint, reaction, part in zip(joints, reactions, parts, strict=True):
        if joint.share is None:
            out += [0.0] * joint.pair.joint.components
        elif joint.moved:
            out += part
        else:
            load = joint.share * carried_load(joint.ends(reaction))
            out += [-load * jnp.sign(x) for x in joint.speeds]
    return out


def _reactions(
    model: Model,
    middle: MiddleOfStep,
    contacts: list[UnilateralContact],
    joints: list[JointInStep],
    loads: LoadsInStep,
    delassus: DelassusOperator,
) -> Callable[[Array], Array]:
    """From forces along the rows [N] to the numbers of the reactions of all joints that touch:
    linear, so unit forces tell it once a step."""
    if not joints:
        return lambda forces: jnp.zeros(0)
    system, now, all_joints = model.system, middle.free_motion, touching(model.system)
    q = unpack_motion(system, [*middle.halfway, *middle.predicted])[0]
    counts = [sum(len(contact.velocities) for contact in contacts), *(len(j.moved) for j in joints)]
    counts.append(len(loads.rubs))

    def under(forces):
        flat = [forces[i] for i in range(sum(counts))]
        pushed, *rubs, further = split(flat, counts)
        by_contact = in_joint_directions(contacts, list(pushed))
        by_contact, stops = by_contact[: len(now.contacts)], by_contact[len(now.contacts) :]
        reports = rigid_reports(system, now.poses, now.contacts, by_contact)
        acting = with_rows(now.forces, contact_rows(system, now.poses, reports))
        none = [(0,) * joint.pair.joint.components for joint in joints]
        friction = [x for part, zero in zip(rubs, none, strict=True) for x in part or zero]
        acting = with_friction(system, acting, friction)
        sums = loads.by_load(system, [*(part[0] for part in stops), *further])
        acting = with_loads(system, acting, sums)
        total, multipliers = (
            [sp.add(x, y) for x, y in zip(free, caused, strict=True)]
            for free, caused in zip(
                (delassus.free, delassus.multipliers), _caused(delassus, flat), strict=True
            )
        )
        solution = link_accelerations(system, total, tuple(multipliers))
        reactions = answer_to(system, acting, q, all_joints, solution).reactions
        return sp.stack([x for reaction in reactions for part in reaction for x in part])

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
    loads: LoadsInStep,
    delassus: DelassusOperator,
    h: Any,
    settings: MoreauJeanSettings,
) -> Search:
    """What a step's search starts from."""
    numbers = [k for k, joint in enumerate(joints) if joint.moved]
    required = demands(middle, contacts, delassus.free, h, settings) if contacts else None
    ahead = middle.change_to([x + h * a for x, a in zip(middle.v, delassus.free, strict=True)])
    free = [rate.at(ahead) for k in numbers for rate in joints[k].moved]
    free += [rub.sliding.at(ahead) for rub in loads.rubs]
    diagonal = middle.free_motion.diagonal
    # A joint that drives move slides whatever friction does (only rounding, of either sign,
    # answers): there it is full. In a dead centre none moves.
    least = lambda rates: UNMOVED * sp.total([lightness(r.row, diagonal) for r in rates])
    softest = [least(joints[k].moved) for k in numbers]
    of_loads = [least((rub.sliding,)) for rub in loads.rubs]
    rest = delassus.matrix(), free, softest, h, of_loads, loads.rubs, springs_of(contacts)
    return Search([joints[k] for k in numbers], numbers, required, *rest)
