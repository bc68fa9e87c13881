r"""Unilateral contacts of a time step: percussions by Newton's law of impact and Coulomb's cones,
and what overlaps moved apart.

Local velocities $u = G v$ of a contact: the opening speed $u_N = \dot g_N$, then the slips $u_T$.
Over a step $u^{+} = W p + u_{free}$ with Delassus' operator $W = G M^{-1} G^T$ and percussions $p$
[N s]. A contact whose gap is forecast to be closed, $g_N + \gamma h u_N^{-} \le 0$, obeys

$$0 \le u_N^{+} + e\,u_N^{-} \perp p_N \ge 0, \qquad |p_T| \le \mu p_N,$$

with $-p_T$ along $u_T^{+}$ and $|p_T| = \mu p_N$ where it slides.

Source: Moreau 1988, in Nonsmooth Mechanics and Applications, 1,
doi:10.1007/978-3-7091-2624-0_1; Jean 1999, Comput. Methods Appl. Mech. Eng. 177, 235,
doi:10.1016/S0045-7825(98)00383-1; Acary & Brogliato 2008, Numerical Methods for Nonsmooth Dynamical
Systems, ch. 10, doi:10.1007/978-3-540-75392-6.
"""

from itertools import groupby
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.complementarity import FrictionContact, ProjectedGaussSeidel
from jaxclear.complementarity.contact_states import laws_missed, with_derivatives
from jaxclear.formulations import contact_rows
from jaxclear.formulations.contact_rows import (
    ContactPoint,
    MiddleOfStep,
    TimeStep,
    split,
)
from jaxclear.formulations.delassus import DelassusOperator
from jaxclear.formulations.loads_over_step import LoadsInStep, beyond_stops
from jaxclear.formulations.model import Model
from jaxclear.formulations.state_rate import drift
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part, safe_divide, safe_sqrt
from jaxclear.laws.friction import AbstractSetValuedFriction
from jaxclear.multibody.kinematics import along
from jaxclear.multibody.rows import LinearRate, combine_rates
from jaxclear.multibody.state import unpack_motion

# Share of a step by which contacts of a joint may touch apart and count as touching at once: far
# above rounding.
SIMULTANEOUS = 1e-6


def put_off(strikes: Any, depths: Any, closing: Any, h: Any, joints: list[int]) -> Any:
    """Which contacts that strike in a step wait for the next: all but the first of a joint.

    Args:
        strikes: which contacts strike.
        depths: indentations in the middle of the step [m].
        closing: their rates [m/s].
        h: length of the step [s].
        joints: number of contacts of each joint.
    """
    since = jnp.where(strikes, safe_divide(depths, closing), -jnp.inf)
    each = split([since[i] for i in range(sum(joints))], joints)
    first = [jnp.max(jnp.stack(times)) for times in each]
    firsts = [one for one, count in zip(first, joints, strict=True) for _ in range(count)]
    return strikes & (since < sp.stack(firsts) - SIMULTANEOUS * h)


class MoreauJeanSettings(NamedTuple):
    """How a step is made: weight `theta` of its end in the mean speed, share `gamma` of the step
    after which a contact counts as closed, most sweeps over the contacts and the residual at which
    they end, whether overlaps are moved apart.

    Where derivatives are taken: `gentle`, whether what strikes is left out, and nothing is moved
    apart; `striking`, whether something strikes in this step, whose overlap moves with it."""

    theta: Any
    gamma: Any
    max_sweeps: Any
    tolerance: Any
    project: bool
    gentle: bool = False
    striking: Any = None

    def solver(self) -> ProjectedGaussSeidel:
        """What finds the percussions."""
        return ProjectedGaussSeidel(self.tolerance, self.max_sweeps)


class Spring(NamedTuple):
    """What presses in the place of a percussion where steps follow it (`acts`): its `force` [N]."""

    acts: Any
    force: Any


class UnilateralContact(NamedTuple):
    """A contact as percussions see it: its local velocities (opening, then two or fewer slips), for
    each direction of the joint's own slip its shares in these slips, its laws, its joint, its
    normal percussion in the step before, and its indentation [m] in the middle; of a side of a stop
    what gives way there (None: it is rigid)."""

    velocities: list[LinearRate]
    shares: list[list]
    restitution: Any
    friction: AbstractSetValuedFriction | None
    joint: str
    last: Any
    depth: Any
    spring: Spring | None = None

    def velocities_at(self, change: list) -> list:
        """Local velocities where the speeds are changed from the predicted ones."""
        return [velocity.at(change) for velocity in self.velocities]


class Percussions(NamedTuple):
    """What contacts do in a step: percussions per contact (normal, then along the joint's own slip
    directions), changes of the speeds, closure impulses, and the residual of the contact laws
    relative to the largest velocity."""

    by_contact: list[tuple]
    changes: list
    multipliers: tuple
    residual: Any


def unilateral_contacts(
    points: tuple[ContactPoint, ...], joints: list[str], last: list
) -> list[UnilateralContact]:
    """Every possible contact as percussions see it.

    Args:
        points: contacts in the middle of the step.
        joints: name of the joint of each.
        last: percussions of the step before, in the state's order.
    """
    contacts, first = [], 0
    for point, joint in zip(points, joints, strict=True):
        friction = None if point.laws.friction is None else point.laws.friction.coulomb()
        slips = [] if friction is None else _slip_directions(point)
        velocities = [point.rates[0].times(-1)]
        velocities += [combine_rates(weights, point.rates[1:]) for weights in slips]
        slip_count = 0 if friction is None else len(point.rates) - 1
        shares = [[weights[k] for weights in slips] for k in range(slip_count)]
        law = point.laws.contact
        laws = law.restitution, friction
        percussion, depth = last[first], point.gap_function.indentation
        contacts.append(UnilateralContact(velocities, shares, *laws, joint, percussion, depth))
        first += 1 + slip_count
    return contacts


def stops_as_contacts(loads: LoadsInStep, last: list) -> list[UnilateralContact]:
    """The sides of stops as contacts without friction, each by itself; `last`: their percussions in
    the step before. Of their laws nothing is told yet."""
    return [
        UnilateralContact(
            [one.opening],
            [],
            0.0 if one.side.stop.restitution is None else one.side.stop.restitution,
            None,
            f"{one.name} {k}",
            last[k],
            one.beyond,
        )
        for k, one in enumerate(loads.stops)
    ]


def with_laws_of_stops(
    contacts: list[UnilateralContact], loads: LoadsInStep, delassus: DelassusOperator, h: Any
) -> list[UnilateralContact]:
    """The contacts with the laws of stops, which depend on the inertia along their rows.

    The inertia tells whether the step resolves their spring, and what they give back where it does
    not.

    Args:
        contacts: of which sides of stops are the last.
        loads: the stops.
        delassus: operator from impulses to velocities along all rows.
        h: length of the step [s].
    """
    result = list(contacts)
    first = sum(len(contact.velocities) for contact in contacts) - len(loads.stops)
    for k, one in enumerate(loads.stops):
        if one.side.stop.restitution is not None:
            continue
        place = len(contacts) - len(loads.stops) + k
        light = along(delassus.rows[first + k], delassus.responses[first + k][0])
        spring = Spring(one.followed(light, h), one.spring())
        result[place] = result[place]._replace(restitution=one.restitution(light), spring=spring)
    return result


def _slip_directions(point: ContactPoint) -> list[tuple]:
    """Weights of the joint's slip directions in each direction that percussions use: those that can
    move; of a whole basis the two across the normal."""
    rows = point.rows[1:]
    count = len(rows)
    if count < 3:
        return [tuple(int(i == k) for i in range(count)) for k in range(count) if rows[k]]
    normal = tuple(jnp.asarray(x, float) for x in point.gap_function.candidate.normal)
    steep = jnp.abs(normal[0]) > 0.7
    aside = (jnp.where(steep, 0.0, 1.0), jnp.where(steep, 1.0, 0.0), 0)
    first = sp.cross(normal, aside)
    first = sp.scale(safe_divide(1.0, safe_sqrt(sp.dot(first, first))), first)
    return [first, sp.cross(normal, first)]


class ContactDemands(NamedTuple):
    """What the contacts ask of the velocities at a step's end: `lifted`, those without percussions
    and what the law of impact adds to them, `mu` and how many rows each contact has, which of them
    count as closed; of a gentle step which of them are left out, as they strike, and which are in
    flight: faster than loads press them within a step, and not about to be carried by a contact."""

    lifted: list
    mu: list
    sizes: tuple[int, ...]
    closed: Any
    strikes: Any = None
    flying: Any = None


def demands(
    middle: MiddleOfStep,
    contacts: list[UnilateralContact],
    free: list,
    h: Any,
    settings: MoreauJeanSettings,
) -> ContactDemands:
    """Velocities by Newton's law of impact, friction bounds and closed contacts of a step.

    Args:
        middle: of the step.
        contacts: as percussions see them.
        free: accelerations without contact.
        h: length of the step [s].
        settings: of the solver.
    """
    # u-: at the step's start; u_free: at its end as if nothing touched.
    start = middle.change_to(middle.v)
    ahead = [sp.add(s, h * k) for s, k in zip(start, free, strict=True)]
    before = [contact.velocities_at(start) for contact in contacts]
    unhindered = [contact.velocities_at(ahead) for contact in contacts]
    opening = sp.stack([velocities[0] for velocities in before])
    size = lambda slips: safe_sqrt(sp.total(sp.mul(slip, slip) for slip in slips) + 0.0)
    mu = [
        0 if contact.friction is None else contact.friction.bound(size(velocities[1:]))
        for contact, velocities in zip(contacts, before, strict=True)
    ]
    sizes = tuple(len(contact.velocities) for contact in contacts)
    lifted = []
    for contact, (normal, *slips), (u, *_) in zip(contacts, unhindered, before, strict=True):
        lifted += [normal + contact.restitution * u, *slips]
    depths = sp.stack([contact.depth for contact in contacts])
    pressed = positive_part(opening - sp.stack([normal for normal, *_ in unhindered]))
    # Closed is g_N + gamma h u_N <= 0, the gap being known half a step ahead.
    ahead_of = depths + (0.5 - settings.gamma) * h * opening
    if settings.project:
        # A resting contact that rounding has opened falls shut within the step: it has not opened.
        fallen = 0.5 * h * settings.gamma**2 * pressed
        ahead_of = ahead_of + jnp.where(jnp.abs(opening) < pressed, fallen, 0.0)
    closed = ahead_of >= 0
    joints = [len(list(group)) for _, group in groupby(contact.joint for contact in contacts)]
    if max(joints) == 1 and not settings.gentle:
        return ContactDemands(lifted, mu, sizes, closed)
    # What had a percussion in the step before does not strike, nor what loads press shut.
    unloaded = sp.stack([contact.last for contact in contacts]) <= 0
    strikes = closed & unloaded & (-opening > pressed)
    if max(joints) > 1:
        waiting = put_off(strikes, depths, -opening, h, joints)
        strikes, closed = strikes & ~waiting, closed & ~waiting
    if settings.gentle:
        flying = (abs(opening) > pressed) & (unloaded | (opening > 0))
        return ContactDemands(lifted, mu, sizes, closed & ~strikes, strikes, flying)
    return ContactDemands(lifted, mu, sizes, closed)


def in_joint_directions(contacts: list[UnilateralContact], flat: list) -> list[tuple]:
    """By contact its percussions, those across the normal along the joint's own slip directions."""
    return [
        (normal, *[sp.dot(shares, slips) for shares in contact.shares])
        for contact, (normal, *slips) in zip(
            contacts, split(flat, [len(contact.velocities) for contact in contacts]), strict=True
        )
    ]


def first_guess(contacts: list[UnilateralContact], last: list) -> list:
    """From components in the state's order to those of percussions, contact by contact."""
    counts = [1 + len(contact.shares) for contact in contacts]
    out = []
    for contact, (normal, *across) in zip(contacts, split(last, counts), strict=True):
        slips = [
            sp.dot([shares[k] for shares in contact.shares], across)
            for k in range(len(contact.velocities) - 1)
        ]
        out.append(sp.stack([normal, *slips]))
    return out


def _stops_beyond(
    model: Model, time: Any, end: list, middle: MiddleOfStep, stops: list[UnilateralContact]
) -> list:
    """How far coordinates are beyond their stops [rad, m] at the end of a step; 0 where these give
    way."""
    if not stops:
        return []
    depths = beyond_stops(model, time, end, middle.free_motion.forces.followed)
    each = [(x, stop.spring) for x, stop in zip(depths, stops, strict=True)]
    return [x if spring is None else jnp.where(spring.acts, 0.0, x) for x, spring in each]


class Projected(NamedTuple):
    """After projection: coordinates, by how much they were moved (in terms of speeds), energy that
    this put in [J], and what its search missed, relative to the
    largest gap or overlap [1].
    """

    coordinates: list
    moved: list
    energy: Any
    residual: Any = 0.0


def project(
    model: Model,
    time_step: TimeStep,
    middle: MiddleOfStep,
    contacts: list[UnilateralContact],
    delassus: DelassusOperator,
    end: tuple[list, list],
    settings: MoreauJeanSettings,
) -> Projected:
    """Coordinates at a step's end, moved apart where contacts overlap, in the metric of the masses.

    An overlap by no more than contacts leave or fall in a step stays: a contact at rest remains
    closed whatever rounding and the turning of its normal do, and what strikes and rebounds undoes
    its overlap itself; moving it would give it energy.

    Args:
        model: of the run.
        time_step: start and length [s].
        middle: of the step.
        contacts: as percussions see them.
        delassus: operator from impulses to velocities along all rows.
        end: coordinates and speeds at the end of the step.
        settings: of the solver.
    """
    (q, v), h = end, time_step.length
    motion = unpack_motion(model.system, [*q, *v])
    depths = contact_rows.indentations(model, time_step.end, *motion)
    depths += _stops_beyond(model, time_step.end, [*q, *v], middle, contacts[len(depths) :])
    responses = split(delassus.responses, [len(contact.velocities) for contact in contacts])
    normals = DelassusOperator(
        [contact.velocities[0].row for contact in contacts],
        delassus.free,
        delassus.multipliers,
        [response[0] for response in responses],
    )
    change = middle.change_to(v)
    opening = sp.stack([contact.velocities[0].at(change) for contact in contacts])
    # What a contact gains in closing speed within a step if nothing holds it.
    pressed = h * sp.stack(
        [positive_part(sp.neg(along(row, delassus.free))) for row in normals.rows]
    )
    required = zip(pressed, opening, depths, strict=True)
    problem = FrictionContact(
        [sp.stack(line) for line in normals.matrix()],
        jnp.stack([h * (most + jnp.abs(u)) - depth for most, u, depth in required]),
        jnp.zeros(len(contacts)),
    )
    shifts, residual, _ = settings.solver().iterate(problem)
    shifts = with_derivatives(lambda shifts: laws_missed(problem, shifts), shifts)
    if settings.striking is not None:
        shifts = jnp.where(settings.striking, jax.lax.stop_gradient(shifts), shifts)
    moved, _ = normals.under([shifts[i] for i in range(len(contacts))])
    energy = sp.neg(sp.dot(middle.free_motion.right, moved))
    return Projected(drift(model.system, q, q, moved, 1.0), moved, energy, residual)
