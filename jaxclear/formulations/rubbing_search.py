r"""The search for percussions and friction of a step, in which joints that touch all the time are
contacts under loads that follow from the reactions.

Impulses of friction $T$ obey Coulomb's law at the velocities of the step's end, $|T| \le r N$ with
$r$ the joint's share for its coefficient and $N$ the load that it carries, over the step. To the
solver a joint is one more contact, pressed by an impulse $N$ that nothing in its problem moves;
what it finds gives the reactions, these the next loads (and of a ball the plane of its friction),
until they stay.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxclear.complementarity import FrictionContact
from jaxclear.complementarity.joint_friction import across
from jaxclear.components.clearance import CarryingEnd, carried_load
from jaxclear.formulations.contact_rows import ContactJacobianRow, split
from jaxclear.formulations.permanent_reactions import REACTION, PermanentJoint, Reaction, Slip
from jaxclear.formulations.unilateral import ContactDemands, MoreauJeanSettings
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide


class JointInStep(NamedTuple):
    """A joint that touches all the time, in a step: how it slides (`slips` by component), the rows
    [of the sliding speed by the speeds] of those components in which friction moves it, how fast it
    slides as the step begins [m/s], and friction's largest share of its load (None without)."""

    held: PermanentJoint
    slips: tuple[Slip, ...]
    rows: list[ContactJacobianRow]
    begun: tuple
    share: Any

    def sliding(self, speeds: list) -> list:
        """Components of the sliding speed [m/s] at these speeds."""
        return [sp.mul(self.held.joint.arm, slip.at(speeds)) for slip in self.slips]

    def ends(self, reaction: Reaction) -> tuple[CarryingEnd, ...]:
        """Where it carries a reaction."""
        count = self.held.joint.components
        return self.held.joint.carrying_ends(*reaction, 0.0 if count == 1 else (0.0,) * count)


class Search(NamedTuple):
    """What a search starts from: the joints that friction moves, with their numbers among all that
    touch; what the contacts ask (None without); Delassus' matrix by contact rows and sliding
    components, speeds of the latter at the step's end without friction; by joint the least that
    friction is taken to move it [1/kg]; the step's length [s]."""

    joints: list[JointInStep]
    numbers: list[int]
    asked: ContactDemands | None
    matrix: list[list]
    free: list
    softest: list
    h: Any

    @property
    def first(self) -> int:
        """How many rows the contacts have."""
        return 0 if self.asked is None else sum(self.asked.sizes)


def as_reactions(numbers: Array) -> tuple[Reaction, ...]:
    """The reactions of all joints that touch, from their numbers."""
    flat = [numbers[i] for i in range(len(numbers))]
    parts = split(flat, [REACTION] * (len(flat) // REACTION))
    return tuple(Reaction(part[:3], part[3:]) for part in parts)


def searched(
    search: Search, respond: Callable, start: Array, settings: MoreauJeanSettings
) -> tuple[Array, Any]:
    """(impulses along all rows [N s], residual of the laws relative to the largest velocity)."""
    h = search.h

    def improve(carry):
        z, numbers, _, sweeps = carry
        met = as_reactions(numbers)
        problem, guess, back = _problem(search, met, z)
        found = settings.solver().iterate(problem, guess, sweep=True)
        z = back(found.z)
        numbers = respond(z / h)
        left = jnp.maximum(found.residual, _unsettled(search, met, as_reactions(numbers), problem))
        return z, numbers, left, sweeps + jnp.maximum(found.sweeps, 1)

    def unfinished(carry):
        _, _, left, sweeps = carry
        return (left > settings.tolerance) & (sweeps < settings.most_sweeps)

    first = (start, respond(start / h), jnp.asarray(jnp.inf), jnp.zeros((), int))
    if not search.joints:
        z, _, left, _ = improve(first)
    else:
        z, _, left, _ = jax.lax.while_loop(unfinished, improve, first)
    return z, left


class Loaded(NamedTuple):
    """A joint under its load in a turn of the search: impulse of the load [N s], axes of its
    friction among its components (of a ball two across the force), and the first of these among
    all rows."""

    joint: JointInStep
    load: Any
    axes: tuple[tuple, ...]
    place: int
    softest: Any

    def unknowns(self) -> list[dict]:
        """By unknown of the solver the rows along which it acts, with their weights: none for the
        load."""
        return [{}, *({self.place + i: x for i, x in enumerate(axis)} for axis in self.axes)]


def _loaded(search: Search, met: tuple[Reaction, ...]) -> list[Loaded]:
    """The joints that friction moves under these reactions."""
    found, place = [], search.first
    each = zip(search.joints, search.numbers, search.softest, strict=True)
    for joint, number, softest in each:
        load, force = search.h * carried_load(joint.ends(met[number])), met[number].force
        axes: tuple = ((1,),)
        if len(joint.rows) > 1:
            size = sp.norm(force)
            axes = across(tuple(safe_divide(x, size) for x in force))
        found.append(Loaded(joint, load, axes, place, softest))
        place += len(joint.rows)
    return found


def _problem(
    search: Search, met: tuple[Reaction, ...], z: Array
) -> tuple[FrictionContact, Array, Callable]:
    """(the problem with the joints under these reactions, where to start in its unknowns, how
    impulses along all rows follow from these)."""
    first, asked, joints = search.first, search.asked, _loaded(search, met)
    unknowns: list[dict] = [{i: 1} for i in range(first)]
    for own in joints:
        unknowns += own.unknowns()
    rows = [[_between(search.matrix, a, b) for b in unknowns] for a in unknowns]
    lifted, mu, sizes, closed = ([], [], (), ()) if asked is None else asked[:4]
    lifted, mu, guess, k = [*lifted], [*mu], [z[i] for i in range(first)], first
    for own in joints:
        count = len(own.axes)
        place = range(own.place, own.place + len(own.joint.rows))
        for i in range(k + 1, k + 1 + count):
            rows[i][i] = jnp.maximum(rows[i][i], own.softest)
        rows[k][k] = sp.total(rows[i][i] for i in range(k + 1, k + 1 + count))
        free = [search.free[i - first] for i in place]
        lifted += [-rows[k][k] * own.load, *(sp.dot(axis, free) for axis in own.axes)]
        guess += [own.load, *(sp.dot(axis, [z[i] for i in place]) for axis in own.axes)]
        mu, sizes, k = [*mu, own.joint.share], (*sizes, 1 + count), k + 1 + count
    active = jnp.concatenate([jnp.asarray(closed, bool), jnp.ones(len(joints), bool)])
    problem = FrictionContact(
        [sp.stack(row) for row in rows], sp.stack(lifted), sp.stack(mu), sizes, active
    )

    def back(found):
        out: list[Any] = [0] * len(search.matrix)
        for i, weights in enumerate(unknowns):
            for j, weight in weights.items():
                out[j] = sp.add(out[j], sp.mul(weight, found[i]))
        return sp.stack(out)

    return problem, sp.stack(guess), back


def _between(matrix: list[list], a: dict, b: dict) -> Any:
    """How the rate along one combination of rows answers a unit force along another."""
    return sp.total(sp.mul(sp.mul(x, y), matrix[i][j]) for i, x in a.items() for j, y in b.items())


def _unsettled(
    search: Search, met: tuple[Reaction, ...], now: tuple[Reaction, ...], problem: FrictionContact
) -> Any:
    """What a turn's change of the carried forces does to the sliding speeds by friction, at the
    most, relative to the largest velocity."""
    largest, k = jnp.max(jnp.abs(problem.free_velocity)), search.first
    moved: list[Any] = []
    for joint, number in zip(search.joints, search.numbers, strict=True):
        ends = zip(joint.ends(met[number]), joint.ends(now[number]), strict=True)
        change = sp.total(sp.norm(sp.minus(b.force, a.force)) for a, b in ends)
        moved.append(search.h * joint.share * change * problem.delassus[k][k])
        k += 1 + (1 if len(joint.rows) == 1 else 2)
    return jnp.max(sp.stack([*moved, 0.0])) / jnp.where(largest > 0, largest, 1.0)
