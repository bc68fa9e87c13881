"""One implicit step of a whole mechanism: midpoint rule for what is smooth, mean forces over the
step for what touches.

The equations are evaluated once, at the middle to which speeds and last accelerations lead; from
there the contact laws alone are iterated upon a fixed number of times. v1 - v0 = h (k + k_c), k_c
caused by contact; coordinates follow from the speeds (v0 + v1)/2 + bias h k_c / 2. A contact force
does over the step the work that its law says, or takes more energy out, so no step is too long for
it; loads that oscillate by themselves must be resolved.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.components.clearance import ContactLaws
from jaxclear.formulations import contact_rows, contact_solve
from jaxclear.formulations.contact_rows import FreeMotion, TimeStep, along
from jaxclear.formulations.contact_solve import ContactSolution
from jaxclear.formulations.state_rate import coordinate_rates, passive_rates
from jaxclear.ground import sparse as sp
from jaxclear.ground.grouping import map_alike
from jaxclear.ground.numerics import positive_part, safe_divide
from jaxclear.multibody import contact_point
from jaxclear.multibody.contact_point import PointState, Response
from jaxclear.multibody.dynamics import Solution
from jaxclear.multibody.forces import applied_forces
from jaxclear.multibody.loops import Baumgarte
from jaxclear.multibody.state import Layout, pack_memories, unpack_memories, unpack_motion
from jaxclear.multibody.system import System

# Weight of the depth of closed contacts against staying put, where coordinates are corrected.
STIFFNESS = 100.0
# Added to the inverse of an effective mass [1/kg], so that a contact which nothing can move has
# one.
LEAST_LIGHTNESS = 1e-12


class Laws(NamedTuple):
    """Contacts over a step: indentations and their rates at its start, effective masses, memories
    in it, its span.
    """

    depths: list
    approach: list
    masses: list
    memories: dict[str, tuple[PointState, ...]]
    time_step: TimeStep


class WarmStart(NamedTuple):
    """What a step hands on to the next: free accelerations without contact, what contact adds, and
    the last indentations.
    """

    smooth: list
    contact: list
    depths: list


def step(
    system: System,
    layout: Layout,
    stabilisation: Baumgarte | None,
    worn: dict,
    time_step: TimeStep,
    entries: list,
    last: WarmStart,
    iterations: int,
    captured: bool,
) -> tuple[list, WarmStart]:
    """Entries of the state after the step, and what it hands on; `last` is what it was handed."""
    h = time_step.length
    q, v = entries[: layout.coordinates], entries[layout.coordinates : layout.memory_start]
    middle = [x + 0.5 * h * (a + b) for x, a, b in zip(v, last.smooth, last.contact, strict=True)]
    halfway = drift(system, q, q, v, 0.5 * h)
    motion = unpack_motion(system, [*halfway, *middle])
    free_motion = contact_rows.free_motion(
        system, stabilisation, worn, time_step.start + 0.5 * h, *motion
    )
    laws = _contacts_at_start(
        system, layout, time_step, captured, free_motion, entries, middle, last.depths
    )
    split = contact_solve.prepare(free_motion)
    missing = [x + 0.5 * h * k - m for x, k, m in zip(v, split.free, middle, strict=True)]
    push = _iterate(system, free_motion, laws, split, missing, last.contact, iterations)
    mean = [
        x + 0.5 * h * (k + (1 + time_step.bias) * c)
        for x, k, c in zip(v, split.free, push.accelerations, strict=True)
    ]
    q = drift(system, q, drift(system, q, halfway, mean, 0.5 * h), mean, h)
    v = [x + h * (k + c) for x, k, c in zip(v, split.free, push.accelerations, strict=True)]
    q, depths = _settle(system, worn, free_motion, laws, split, push, q, v)
    after = [*q, *v, *pack_memories(layout, _memories_after(system, free_motion, laws, push))]
    passive = _passive(system, layout, free_motion, laws, motion, mean, middle, split, push)
    after += [x + h * rate for x, rate in zip(entries[len(after) :], passive, strict=True)]
    return after, WarmStart(split.free, push.accelerations, depths)


def _settle(system, worn, free_motion, laws, split, push, q, v) -> tuple[list, list]:
    """Coordinates moved, speeds kept, so that closed contacts are as deep as the forces have worked
    for; and these depths.

    Where the gap is curved or worn within a step, the true indentation differs from the one that
    the rates lead to. To let the contact force act on the difference would be energy from nowhere.
    """
    if not free_motion.contacts:
        return q, []
    time_step = laws.time_step
    found = contact_rows.depths(
        system, worn, time_step.start + time_step.length, *unpack_motion(system, [*q, *v])
    )
    led = _depths_worked_for(system, free_motion, laws, push)
    unmoved, weights = [], []
    for contact, mass, true, assumed in zip(
        free_motion.contacts, laws.masses, found, led, strict=True
    ):
        weights += [
            jnp.where((true > 0) | (assumed > 0), STIFFNESS * mass, 0.0),
            *[0.0] * (contact.active - 1),
        ]
        unmoved += [true - assumed, *[0.0] * (contact.active - 1)]
    nothing = [0.0] * len(unmoved)
    shift = split.push(1.0, unmoved, nothing, weights, nothing)
    depths = []
    for assumed, left in zip(led, _by_contact(free_motion, shift.rates), strict=True):
        moved = assumed + left[0]
        depths.append(jnp.where(moved > 0, jnp.minimum(positive_part(assumed), moved), moved))
    return drift(system, q, q, shift.accelerations, 1.0), depths


def drift(system, start, at, speeds, h) -> list:
    """Coordinates after `h`, their rates taken `at` some coordinates."""
    rates = coordinate_rates(system, *unpack_motion(system, [*at, *speeds]))
    return [x + h * rate for x, rate in zip(start, rates, strict=True)]


def _depths_worked_for(system, free_motion, laws, push) -> list:
    """Indentations at the end of the step: where the rates lead, but no deeper than the forces have
    worked for. (An unfinished iteration ends with less than the law's force at the depth it
    reaches.)"""
    memories = [memory for bearing in laws.memories.values() for memory in bearing]
    rates, forces = (_by_contact(free_motion, part) for part in (push.rates, push.forces))
    out = []
    for pairing, memory, depth, rate, force in zip(
        contact_laws_of(system), memories, laws.depths, rates, forces, strict=True
    ):
        law = contact_rows.mean_force(pairing, memory, laws.time_step, depth, rate[0])
        share = jnp.clip(safe_divide(-force[0], law), 0.0, 1.0)
        low, end = positive_part(depth), depth + laws.time_step.length * rate[0]
        out.append(jnp.where(end > low, low + share * (end - low), end))
    return out


def contact_laws_of(system: System) -> list[ContactLaws]:
    """Laws of every possible contact, in the order of the state."""
    return [pairing for bearing in system.bearings.values() for pairing in bearing.contact_laws]


def by_joint(system, values) -> list[tuple]:
    """One value per contact, as one tuple per clearance joint."""
    values, out = list(values), []
    for bearing in system.bearings.values():
        count = len(bearing.contact_laws)
        out.append(tuple(values[:count]))
        values = values[count:]
    return out


def _by_contact(free_motion: FreeMotion, values) -> list[tuple]:
    """One value per row with a force, as one tuple per contact."""
    values, out = list(values), []
    for contact in free_motion.contacts:
        out.append(tuple(values[: contact.active]))
        values = values[contact.active :]
    return out


def _contacts_at_start(
    system, layout, time_step, captured, free_motion, entries, middle, depths
) -> Laws:
    """Remembered speeds with which the step begins."""
    v = entries[layout.coordinates : layout.memory_start]
    back = [sp.sub(x, m) for x, m in zip(v, middle, strict=True)]
    approach = [
        sp.add(contact.rates[0], along(contact.rows[0], back)) for contact in free_motion.contacts
    ]
    memories = unpack_memories(layout, entries)
    for (name, bearing), *own in zip(
        system.bearings.items(), by_joint(system, depths), by_joint(system, approach), strict=True
    ):
        each = zip(bearing.contact_laws, memories[name], *own, strict=True)
        memories[name] = tuple(
            m._replace(
                impact_speed=contact_rows.approached(p, m.impact_speed, time_step, captured, d, r)
            )
            for p, m, d, r in each
        )
    masses = []
    for contact in free_motion.contacts:
        lightness = sp.total(
            entry * entry / free_motion.diagonal[j] for j, entry in contact.rows[0].items()
        )
        masses.append(1.0 / (lightness + LEAST_LIGHTNESS))
    return Laws(depths, approach, masses, memories, time_step)


def _iterate(system, free_motion, laws, split, missing, last, iterations) -> ContactSolution:
    """Newton on the normal forces, secants on friction. A contact that is closed at the start sets
    out from the forces of the step before, one that is open from where an impact would end. A loop:
    written out it runs 20 % faster, but its derivatives take six times as long to compile.
    """

    def tangents(contact_laws, memory, time_step, depths, rates):
        each = zip(contact_laws, memory, depths, rates, strict=True)
        return tuple(contact_rows.tangent(p, m, time_step, d, r) for p, m, d, r in each)

    reach = 0.5 * (1 + laws.time_step.bias) * laws.time_step.length
    unmoved, rates = [], []
    parts = zip(
        free_motion.contacts,
        laws.depths,
        laws.approach,
        laws.masses,
        contact_laws_of(system),
        strict=True,
    )
    for contact, depth, approach, mass, pairing in parts:
        active = contact.rows[: contact.active]
        free = [
            sp.add(rate, along(row, missing))
            for rate, row in zip(contact.rates, active, strict=False)
        ]
        held = [
            jnp.where(depth > 0, f + reach * along(row, last), f)
            for f, row in zip(free, active, strict=True)
        ]
        deepest = contact_rows.deepest(
            pairing, mass, approach, depth + laws.time_step.length * free[0]
        )
        held[0] = jnp.where(depth > 0, held[0], (deepest - depth) / laws.time_step.length)
        unmoved += free
        rates.append(tuple(held))
    if not rates:
        return split.push(reach, [], [], [], [])

    def improve(push, _):
        own = _by_contact(free_motion, [push.rates[i] for i in range(len(unmoved))])
        parts = zip(
            system.bearings.items(),
            by_joint(system, laws.depths),
            by_joint(system, own),
            strict=True,
        )
        calls = [
            (b.contact_laws, laws.memories[name], laws.time_step, d, r) for (name, b), d, r in parts
        ]
        found = [tangent for joint in map_alike(tangents, calls) for tangent in joint]
        forces, dampings = ([x for tangent in found for x in tangent[part]] for part in (0, 1))
        better = split.push(
            reach, unmoved, forces, dampings, [rate for part in own for rate in part]
        )
        return ContactSolution(*map(sp.stack, better)), None

    size = len(unmoved)
    counts = (size, size, len(split.free), len(split.multipliers))
    blank = ContactSolution(*map(jnp.zeros, counts))._replace(
        rates=sp.stack([rate for own in rates for rate in own])
    )
    push = jax.lax.scan(improve, blank, length=iterations)[0]
    return ContactSolution(
        *([part[i] for i in range(count)] for part, count in zip(push, counts, strict=True))
    )


def _memories_after(system, free_motion, laws, push) -> dict[str, tuple[PointState, ...]]:
    rates, forces = (_by_contact(free_motion, part) for part in (push.rates, push.forces))
    out = {}
    for (name, bearing), *own in zip(
        system.bearings.items(), by_joint(system, rates), by_joint(system, forces), strict=True
    ):
        each = zip(bearing.contact_laws, laws.memories[name], *own, strict=True)
        out[name] = tuple(
            m._replace(
                bristles=contact_rows.bristles_after(p, m.bristles, laws.time_step, r, -f[0])
            )
            for p, m, r, f in each
        )
    return out


def _passive(system, layout, free_motion, laws, motion, mean, middle, split, push) -> list:
    """Rates of what only follows the motion, with the forces that the step was made with."""
    if not layout.wear and not layout.energies:
        return []
    reports = _reports(
        system, free_motion, laws, [sp.sub(a, b) for a, b in zip(mean, middle, strict=True)], push
    )
    forces = free_motion.forces._replace(reports=reports)
    if layout.energies:
        forces = applied_forces(
            system,
            free_motion.forces.motions,
            reports,
            *motion,
            laws.time_step.start + 0.5 * laws.time_step.length,
        )
    total = [sp.add(k, c) for k, c in zip(split.free, push.accelerations, strict=True)]
    multipliers = tuple(
        sp.add(a, b) for a, b in zip(split.multipliers, push.multipliers, strict=True)
    )
    solution = Solution(
        tuple(tuple(total[b.speeds]) for b in system.topology.branches), multipliers
    )
    return passive_rates(system, layout, forces, solution)


def _reports(system, free_motion, laws, change, push) -> dict:
    """Reports of the clearance joints over the step: mean forces and rates, and the mean
    indentation while in contact.
    """
    parts = []
    found = zip(
        free_motion.contacts,
        laws.depths,
        _by_contact(free_motion, push.rates),
        _by_contact(free_motion, push.forces),
        strict=True,
    )
    for contact, depth, rates, forces in found:
        idle = zip(contact.rows[contact.active :], contact.rates[contact.active :], strict=True)
        rates += tuple(sp.add(rate, along(row, change)) for row, rate in idle)
        end = depth + laws.time_step.length * rates[0]
        gap_function = contact.gap_function._replace(
            indentation=0.5 * (positive_part(depth) + positive_part(end))
        )
        parts.append((gap_function, (rates[0], rates[1:]), positive_part(-forces[0]), forces[1:]))
    reports = {}
    for (name, bearing), own in zip(system.bearings.items(), by_joint(system, parts), strict=True):
        gap_functions, speeds, normals, tractions = zip(*own, strict=True)
        responses = tuple(
            Response(n, contact_point.slip_speed(slip), t, PointState(None, memory.bristles))
            for n, (_, slip), t, memory in zip(
                normals, speeds, tractions, laws.memories[name], strict=True
            )
        )
        reports[name] = contact_point.assemble(
            bearing.joint,
            bearing.contact_laws,
            free_motion.poses[name],
            gap_functions,
            speeds,
            responses,
        )
    return reports
