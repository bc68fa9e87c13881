"""One step of a whole mechanism whose clearance joints are rigid: theta method for the motion,
percussions for the contacts.

The equations are evaluated once, half a step ahead along the speeds; contacts that the step would
close are asked for Newton's law of impact and Coulomb's law of friction at the velocities of its
end. What overlaps then, and would not part within a step by itself, is moved apart: projection in
the metric of the masses. Source: Moreau 1988, in Nonsmooth Mechanics and Applications, 1; Jean
1999, Comput. Methods Appl. Mech. Eng. 177, 235; Acary & Brogliato 2008, Numerical Methods for
Nonsmooth Dynamical Systems, ch. 10.
"""

from itertools import islice
from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxclear.complementarity import percussion
from jaxclear.formulations import contact_rows, contact_solve
from jaxclear.formulations.compliant import by_joint, contact_laws_of, drift
from jaxclear.formulations.contact_rows import (
    ContactJacobianRow,
    ContactPoint,
    FreeMotion,
    TimeStep,
    along,
)
from jaxclear.formulations.state_rate import passive_rates
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part, safe_divide, safe_sqrt
from jaxclear.laws.contact import Rigid
from jaxclear.laws.friction import AbstractSetValuedFriction
from jaxclear.laws.restitution import restitution
from jaxclear.multibody import contact_point, kinematics
from jaxclear.multibody.contact_point import PointState, Response
from jaxclear.multibody.dynamics import Solution
from jaxclear.multibody.forces import applied_forces
from jaxclear.multibody.loops import Baumgarte
from jaxclear.multibody.state import Layout, component_count, unpack_motion
from jaxclear.multibody.system import System

# Indentation [m] below which a contact's extent is read as at this one: wear of a rigid contact
# needs some.
TOUCHING = 1e-9


class MoreauJeanSettings(NamedTuple):
    """How a step is made: weight `theta` of its end in the mean speed, share `gamma` of the step
    after which a contact counts as closed, most sweeps over the contacts and the residual at which
    they end, whether overlaps are moved apart."""

    theta: Any
    gamma: Any
    most_sweeps: Any
    tolerance: Any
    project: bool


class Side(NamedTuple):
    """A contact as percussions see it: rows of the opening speed and of two or fewer slips, their
    values at the middle speeds, and for each direction of the joint's own slip its shares in these
    slips."""

    rows: list[ContactJacobianRow]
    values: list
    shares: list[list]
    restitution: Any
    friction: AbstractSetValuedFriction | None


def step(
    system: System,
    layout: Layout,
    stabilisation: Baumgarte | None,
    worn: dict,
    time_step: TimeStep,
    entries: list,
    last: list,
    settings: MoreauJeanSettings,
) -> tuple[list, list]:
    """Entries of the state after the step, and what the next is handed as `last`: the free
    accelerations, the percussions in the state's order, then the largest residual of the contact
    laws so far."""
    h = time_step.length
    q, v = entries[: layout.coordinates], entries[layout.coordinates : layout.memory_start]
    accelerations, before = last[: len(v)], last[len(v) : -1]
    middle = [x + 0.5 * h * a for x, a in zip(v, accelerations, strict=True)]
    halfway = drift(system, q, q, v, 0.5 * h)
    motion = unpack_motion(system, [*halfway, *middle])
    free_motion = contact_rows.free_motion(
        system, stabilisation, worn, time_step.start + 0.5 * h, *motion
    )
    sides = _sides(system, free_motion)
    found = contact_solve.answer(free_motion, [row for side in sides for row in side.rows])
    push = (
        _impacts(free_motion, sides, found, v, middle, before, h, settings)
        if sides
        else _Push([], [0] * len(v), (), 0.0)
    )
    after = [x + h * k + p for x, k, p in zip(v, found.free, push.changes, strict=True)]
    mean = [settings.theta * b + (1 - settings.theta) * a for a, b in zip(v, after, strict=True)]
    moved = drift(system, q, drift(system, q, halfway, mean, 0.5 * h), mean, h)
    change = [sp.sub(a, b) for a, b in zip(mean, middle, strict=True)]
    settled = _Settled(moved, [0] * len(v), 0)
    if settings.project and sides:
        settled = _settle(
            system, worn, time_step, moved, after, middle, free_motion.right, sides, found, settings
        )
    state = [
        *settled.coordinates,
        *after,
        *entries[layout.memory_start : layout.memory_start + layout.memory_count],
    ]
    travelled = [sp.add(x, sp.mul(1 / h, m)) for x, m in zip(mean, settled.moved, strict=True)]
    average = unpack_motion(system, [*halfway, *travelled])
    passive = _passive(
        system, layout, free_motion, push, settled.energy, found, change, average, time_step
    )
    return [
        *state,
        *(x + change for x, change in zip(entries[len(state) :], passive, strict=True)),
    ], [
        *found.free,
        *(part for own in push.percussions for part in own),
        jnp.maximum(last[-1], push.residual),
    ]


class _Push(NamedTuple):
    """Percussions per contact (normal, then along the joint's own slip directions), changes of
    speeds, closure impulses, and the residual of the contact laws relative to the largest
    velocity."""

    percussions: list
    changes: list
    multipliers: tuple
    residual: Any


class _Settled(NamedTuple):
    """After projection: coordinates, by how much they were moved (in terms of speeds), energy that
    this put in [J].
    """

    coordinates: list
    moved: list
    energy: Any


def _sides(system: System, free_motion: FreeMotion) -> list[Side]:
    sides = []
    for place, pairing in zip(free_motion.contacts, contact_laws_of(system), strict=True):
        law = None if pairing.friction is None else pairing.friction.coulomb()
        slips = [] if law is None else _slips(place)
        rows = [{j: sp.neg(entry) for j, entry in place.rows[0].items()}]
        values, shares = [sp.neg(place.rates[0])], []
        for weights in slips:
            rows.append(_combined(place.rows[1:], weights))
            values.append(sp.dot(weights, place.rates[1:]))
        for k in range(0 if law is None else len(place.rows) - 1):
            shares.append([weights[k] for weights in slips])
        sides.append(Side(rows, values, shares, restitution(pairing.contact), law))
    return sides


def _slips(place: ContactPoint) -> list[tuple]:
    """Weights of the joint's slip directions in each direction that percussions use: those that can
    move; of a whole basis the two across the normal."""
    count = len(place.rows) - 1
    if count < 3:
        return [tuple(int(i == k) for i in range(count)) for k in range(count) if place.rows[1 + k]]
    normal = tuple(jnp.asarray(x, float) for x in place.gap_function.touch.normal)
    steep = jnp.abs(normal[0]) > 0.7
    aside = (jnp.where(steep, 0.0, 1.0), jnp.where(steep, 1.0, 0.0), 0)
    first = sp.cross(normal, aside)
    first = sp.scale(safe_divide(1.0, safe_sqrt(sp.dot(first, first))), first)
    return [first, sp.cross(normal, first)]


def _combined(rows: tuple[ContactJacobianRow, ...], weights: tuple) -> ContactJacobianRow:
    out: ContactJacobianRow = {}
    for row, weight in zip(rows, weights, strict=True):
        for j, entry in row.items():
            out[j] = sp.add(out.get(j, 0), sp.mul(weight, entry))
    return {j: entry for j, entry in out.items() if not sp.is_zero(entry)}


def _impacts(free_motion: FreeMotion, sides, found, v, middle, last, h, settings) -> _Push:
    """Percussions of the step, searched from the `last` ones."""
    rows = [row for side in sides for row in side.rows]
    matrix = [
        sp.stack([along(row, accelerations) for accelerations, _ in found.answers]) for row in rows
    ]
    start = [sp.sub(a, b) for a, b in zip(v, middle, strict=True)]
    free = [sp.add(s, h * k) for s, k in zip(start, found.free, strict=True)]
    # At the step's start all speeds of each contact, at its end as if nothing touched.
    before, unhindered = (
        [
            [
                sp.add(value, along(row, change))
                for value, row in zip(side.values, side.rows, strict=True)
            ]
            for side in sides
        ]
        for change in (start, free)
    )
    opening = sp.stack([speeds[0] for speeds in before])
    depths = (
        sp.stack([contact.gap_function.indentation for contact in free_motion.contacts])
        + (0.5 - settings.gamma) * h * opening
    )
    if settings.project:
        # A resting contact that rounding has opened falls shut within the step: it has not opened.
        pressed = positive_part(opening - sp.stack([speeds[0] for speeds in unhindered]))
        depths = depths + jnp.where(
            jnp.abs(opening) < pressed, 0.5 * h * settings.gamma**2 * pressed, 0.0
        )
    bounds = [
        0 if side.friction is None else side.friction.bound(_size(b[1:]))
        for side, b in zip(sides, before, strict=True)
    ]
    sizes = [len(side.rows) for side in sides]
    solved = percussion.impact(
        _split(matrix, sizes),
        [sp.stack(speeds) for speeds in unhindered],
        opening,
        depths >= 0,
        sp.stack([side.restitution for side in sides]),
        sp.stack(bounds),
        _guesses(sides, last),
        most_sweeps=settings.most_sweeps,
        tolerance=settings.tolerance,
    )
    flat = [solved.percussion[i] for i in range(len(rows))]
    changes, multipliers = (
        [
            sp.dot(flat, column)
            for column in zip(*[answer[part] for answer in found.answers], strict=True)
        ]
        for part in (0, 1)
    )
    own = []
    for side, (normal, *tangents) in zip(sides, _split(flat, sizes), strict=True):
        own.append((normal, *[sp.dot(weights, tangents) for weights in side.shares]))
    return _Push(own, changes, tuple(multipliers), solved.residual)


def _guesses(sides: list[Side], last: list) -> list:
    """From components in the state's order to those of percussions, contact by contact."""
    out = []
    for side, (normal, *own) in zip(
        sides, _split(last, [1 + len(side.shares) for side in sides]), strict=True
    ):
        slips = [
            sp.dot([share[k] for share in side.shares], own) for k in range(len(side.rows) - 1)
        ]
        out.append(sp.stack([normal, *slips]))
    return out


def _split(flat: list, sizes: list[int]) -> list[list]:
    """The parts of a list, one after the other."""
    rest = iter(flat)
    return [list(islice(rest, size)) for size in sizes]


def _size(slips: list) -> Any:
    return safe_sqrt(sp.total(sp.mul(slip, slip) for slip in slips) + 0.0)


def _settle(system, worn, time_step, q, v, middle, forces, sides, found, settings) -> _Settled:
    """Contacts overlap by no more than they would leave or fall in a step: one at rest stays closed
    whatever rounding and the turning of its normal do, and what strikes and rebounds undoes its
    overlap itself; moving it would give it energy."""
    h = time_step.length
    depths = contact_rows.depths(
        system, worn, time_step.start + h, *unpack_motion(system, [*q, *v])
    )
    answers = _split(list(found.answers), [len(side.rows) for side in sides])
    normals = [(side.rows[0], own[0][0]) for side, own in zip(sides, answers, strict=True)]
    change = [sp.sub(a, b) for a, b in zip(v, middle, strict=True)]
    opening = sp.stack(
        [
            sp.add(side.values[0], along(row, change))
            for side, (row, _) in zip(sides, normals, strict=True)
        ]
    )
    # What a contact gains in closing speed within a step if nothing holds it.
    pressed = h * sp.stack([positive_part(sp.neg(along(row, found.free))) for row, _ in normals])
    none = jnp.zeros(len(sides))
    shifts = percussion.impact(
        [[sp.stack([along(row, answer) for _, answer in normals])] for row, _ in normals],
        [(h * (pressed[i] + jnp.abs(opening[i])) - depth)[None] for i, depth in enumerate(depths)],
        none,
        none == 0,
        none,
        none,
        most_sweeps=settings.most_sweeps,
        tolerance=settings.tolerance,
    ).percussion
    columns = zip(*[answer for _, answer in normals], strict=True)
    moved = [sp.dot([shifts[i] for i in range(len(sides))], column) for column in columns]
    return _Settled(drift(system, q, q, moved, 1.0), moved, sp.neg(sp.dot(forces, moved)))


def _passive(system, layout, free_motion, push, settling, found, change, mean, time_step) -> list:
    """Changes of what only follows the motion: worn volumes, impulses, energies."""
    h = time_step.length
    impulses = [part for own in push.percussions for part in own]
    if not layout.wear and not layout.energies:
        return impulses
    forces = [tuple(sp.mul(1 / h, part) for part in own) for own in push.percussions]
    reports = reports_of(system, free_motion.poses, free_motion.contacts, forces, change)
    acting = free_motion.forces._replace(reports=reports)
    if layout.energies:
        # Loads work along the mean speeds: those of the middle know nothing of the impulses against
        # which the loads press.
        middle = time_step.start + 0.5 * h
        acting = applied_forces(
            system, kinematics.link_motions(system, *mean, middle), reports, *mean, middle
        )
    total = [sp.add(k, sp.mul(1 / h, c)) for k, c in zip(found.free, push.changes, strict=True)]
    multipliers = tuple(
        sp.add(a, sp.mul(1 / h, b))
        for a, b in zip(found.multipliers, push.multipliers, strict=True)
    )
    solution = Solution(
        tuple(tuple(total[b.speeds]) for b in system.topology.branches), multipliers
    )
    rates = [sp.mul(h, rate) for rate in passive_rates(system, layout, acting, solution)]
    worn = len(rates) - len(layout.energies)
    for name in ("contact_work", "contact_loss") if layout.energies else ():
        place = worn + layout.energies.index(name)
        rates[place] = sp.sub(rates[place], settling)
    return [*rates[:worn], *impulses, *rates[worn:]]


def reports_of(
    system: System,
    poses: dict,
    contacts: tuple[ContactPoint, ...],
    forces: list[tuple],
    change: list,
) -> dict:
    """Reports of the clearance joints for given forces (normal, then friction along each slip
    direction), at the contacts' rates with the speeds changed by `change`."""
    reports = {}
    parts = by_joint(system, list(zip(contacts, forces, strict=True)))
    for (name, bearing), own in zip(system.bearings.items(), parts, strict=True):
        gap_functions = tuple(
            contact.gap_function._replace(
                indentation=jnp.maximum(contact.gap_function.indentation, TOUCHING)
            )
            for contact, _ in own
        )
        contact_laws = tuple(pairing._replace(contact=Rigid()) for pairing in bearing.contact_laws)
        speeds, responses = [], []
        for contact, force in own:
            rate, *slip = (
                sp.add(r, along(row, change))
                for r, row in zip(contact.rates, contact.rows, strict=True)
            )
            speeds.append((rate, tuple(slip)))
            memory = PointState(None, ())
            responses.append(
                Response(force[0], contact_point.slip_speed(tuple(slip)), force[1:], memory)
            )
        report = contact_point.assemble(
            bearing.joint, contact_laws, poses[name], gap_functions, speeds, responses
        )
        points = tuple(
            point._replace(indentation=contact.gap_function.indentation)
            for point, (contact, _) in zip(report.points, own, strict=True)
        )
        reports[name] = report._replace(points=points)
    return reports


def reports_at(system: System, motions: tuple, worn: dict, components: list) -> dict:
    """Reports of the clearance joints at an instant, for given components of their contacts'
    forces, in the state's order.
    """
    poses, contacts = contact_rows.contact_points(system, motions, worn)
    counts = [
        component_count(pairing, p.gap_function.touch)
        for p, pairing in zip(contacts, contact_laws_of(system), strict=True)
    ]
    forces = [tuple(own) for own in _split(components, counts)]
    return reports_of(system, poses, contacts, forces, [0] * system.topology.speed_count)
