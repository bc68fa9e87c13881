r"""One implicit step with compliant contact: midpoint rule for what is smooth, mean forces over the
step for what touches.

The equations are evaluated once, at the middle to which speeds and last accelerations lead; from
there the contact laws alone are iterated upon a fixed number of times. $v_1 - v_0 = h (k + k_c)$,
$k_c$ caused by contact; coordinates follow from the speeds $(v_0 + v_1)/2 + b h k_c / 2$, $b$ the
bias. A contact force does over the step the work that its law says, or takes more energy out, so no
step is too long for it; loads that oscillate by themselves must be resolved. Source: Gonzalez 1996,
J. Nonlinear Sci. 6, 449, doi:10.1007/BF02440162; with dissipation Armero & Petocz 1998, Comput.
Methods Appl. Mech. Eng. 158, 269.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.formulations import contact_rows, law_tangent
from jaxclear.formulations.contact_rows import (
    ContactPoint,
    MiddleOfStep,
    TimeStep,
    by_joint,
)
from jaxclear.formulations.contacts_over_step import (
    ContactOverStep,
    Step,
    memories_after,
    passive_rates_over,
)
from jaxclear.formulations.delassus import (
    ContactSolution,
    LinearLaws,
    implicit_contact,
)
from jaxclear.formulations.impact_speed import Flight, taken_in_flight
from jaxclear.formulations.law_tangent import Averaging
from jaxclear.formulations.model import Model
from jaxclear.formulations.state_rate import drift
from jaxclear.ground import sparse as sp
from jaxclear.ground.grouping import map_alike
from jaxclear.ground.numerics import positive_part, safe_divide
from jaxclear.multibody.kinematics import along
from jaxclear.multibody.state import unpack_memories, unpack_motion

# Weight of the depth of closed contacts against staying put, where coordinates are corrected.
STIFFNESS = 100.0
# Added to the inverse of an effective mass [1/kg], so that a contact which nothing can move has
# one.
LEAST_LIGHTNESS = 1e-12


class ImplicitSettings(NamedTuple):
    """How a step is made: bias of the mean forces towards the step's end, Newton iterations on the
    contact laws."""

    bias: Any
    newton_iterations: int


class WarmStart(NamedTuple):
    """What a step hands on to the next: free accelerations without contact, what contact adds, and
    the last indentations.
    """

    smooth: list
    contact: list
    depths: list


def step(
    model: Model, time_step: TimeStep, entries: list, last: WarmStart, settings: ImplicitSettings
) -> tuple[list, WarmStart]:
    """Entries of the state after the step, and what it hands on; `last` is what it was handed."""
    h = time_step.length
    averaging = Averaging(h, settings.bias)
    accelerations = [a + b for a, b in zip(last.smooth, last.contact, strict=True)]
    middle = contact_rows.middle_of_step(model, time_step, entries, accelerations)
    equations = implicit_contact(middle.free_motion)
    contacts = _contacts_at_start(model, averaging, middle, equations.free, entries, last.depths)
    whole = Step(model, time_step, averaging, middle, contacts, equations)
    solution = _iterate(whole, last.contact, settings.newton_iterations)
    free, caused = equations.free, solution.accelerations
    mean = [
        x + 0.5 * h * (k + (1 + settings.bias) * c)
        for x, k, c in zip(middle.v, free, caused, strict=True)
    ]
    q = middle.end(model, mean, h)
    v = [x + h * (k + c) for x, k, c in zip(middle.v, free, caused, strict=True)]
    q, depths = _settle(whole, solution, q, v)
    after = [*q, *v, *memories_after(whole, solution)]
    passive = passive_rates_over(whole, solution, mean)
    after += [x + h * rate for x, rate in zip(entries[len(after) :], passive, strict=True)]
    return after, WarmStart(free, caused, depths)


def _contacts_at_start(
    model: Model,
    averaging: Averaging,
    middle: MiddleOfStep,
    free: list,
    entries: list,
    depths: list,
) -> list[ContactOverStep]:
    """The contacts with which a step begins; `depths`: their indentations, `free`: accelerations
    without contact."""
    back = middle.change_to(middle.v)
    half = 0.5 * averaging.length
    memories = unpack_memories(model.layout, entries)
    remembered = [memory for joint in memories.values() for memory in joint]
    contacts = []
    for point, depth, memory in zip(middle.free_motion.contacts, depths, remembered, strict=True):
        approach = sp.add(point.rates[0], along(point.rows[0], back))
        if memory.impact_speed is not None:
            gain = half * along(point.rows[0], free)
            flight = Flight(depth, point.gap_function.indentation, approach, gain)
            speed = taken_in_flight(memory.impact_speed, flight, averaging.length)
            memory = memory._replace(impact_speed=speed)
        mass = 1.0 / (_lightness(point, middle.free_motion.diagonal) + LEAST_LIGHTNESS)
        contacts.append(ContactOverStep(point, depth, approach, mass, memory))
    return contacts


def _lightness(point: ContactPoint, diagonal: list) -> Any:
    """About the inverse of the mass that a contact stops [1/kg]."""
    row = point.rows[0]
    return sp.total(entry * entry / diagonal[j] for j, entry in row.items())


def _first_rates(whole: Step, last: list) -> tuple[list, list]:
    """Rates of the rows without contact, and those from which the iteration sets out.

    A contact that is closed at the start sets out from the forces of the step before (`last`: the
    accelerations that they caused), one that is open from where an impact would end.
    """
    h, reach = whole.averaging.length, whole.averaging.reach
    middle = whole.middle
    free_mean = [x + 0.5 * h * k for x, k in zip(middle.v, whole.equations.free, strict=True)]
    missing = middle.change_to(free_mean)
    unmoved, first = [], []
    for point, depth, approach, mass, _ in whole.contacts:
        for k, row in enumerate(point.rows[: point.active]):
            free = sp.add(point.rates[k], along(row, missing))
            rate = jnp.where(depth > 0, free + reach * along(row, last), free)
            if k == 0:
                deepest = law_tangent.deepest(point.laws, mass, approach, depth + h * free)
                rate = jnp.where(depth > 0, rate, (deepest - depth) / h)
            unmoved.append(free)
            first.append(rate)
    return unmoved, first


def _iterate(whole: Step, last: list, iterations: int) -> ContactSolution:
    """Newton on the normal forces, secants on friction. A loop: written out it runs 20 % faster,
    but its derivatives take six times as long to compile.
    """
    unmoved, rates = _first_rates(whole, last)
    equations, reach = whole.equations, whole.averaging.reach
    if not rates:
        return equations.solve(reach, [], LinearLaws([], [], []))

    def improve(solution, _):
        own = [solution.rates[i] for i in range(len(unmoved))]
        better = equations.solve(reach, unmoved, _linear_laws(whole, own))
        return ContactSolution(*map(sp.stack, better)), None

    size = len(unmoved)
    counts = (size, size, len(equations.free), len(equations.multipliers))
    blank = ContactSolution(*map(jnp.zeros, counts))._replace(rates=sp.stack(rates))
    solution = jax.lax.scan(improve, blank, length=iterations)[0]
    return ContactSolution(
        *([part[i] for i in range(count)] for part, count in zip(solution, counts, strict=True))
    )


def _linear_laws(whole: Step, rates: list) -> LinearLaws:
    """The laws of all contacts about given rates; alike joints are traced once."""

    def tangents(laws, memories, averaging, depths, rates):
        each = zip(laws, memories, depths, rates, strict=True)
        return tuple(law_tangent.tangent(p, m, averaging, d, r) for p, m, d, r in each)

    system = whole.model.system
    parts = zip(
        system.bearings.values(),
        by_joint(system, [contact.memory for contact in whole.contacts]),
        by_joint(system, [contact.depth for contact in whole.contacts]),
        by_joint(system, whole.per_contact(rates)),
        strict=True,
    )
    calls = [(b.contact_laws, m, whole.averaging, d, r) for b, m, d, r in parts]
    found = [tangent for joint in map_alike(tangents, calls) for tangent in joint]
    forces = [force for tangent in found for force in tangent.forces]
    dampings = [damping for tangent in found for damping in tangent.dampings]
    return LinearLaws(forces, dampings, rates)


def _settle(whole: Step, solution: ContactSolution, q: list, v: list) -> tuple[list, list]:
    """Coordinates moved, speeds kept, so that closed contacts are as deep as the forces have worked
    for; and these depths.

    Where the gap is curved or worn within a step, the true indentation differs from the one that
    the rates lead to. To let the contact force act on the difference would be energy from nowhere.
    """
    if not whole.contacts:
        return q, []
    system = whole.model.system
    motion = unpack_motion(system, [*q, *v])
    found = contact_rows.indentations(whole.model, whole.time_step.end, *motion)
    led = _depths_worked_for(whole, solution)
    unmoved, weights = [], []
    for contact, true, assumed in zip(whole.contacts, found, led, strict=True):
        others = [0.0] * (contact.point.active - 1)
        closed = (true > 0) | (assumed > 0)
        weights += [jnp.where(closed, STIFFNESS * contact.mass, 0.0), *others]
        unmoved += [true - assumed, *others]
    nothing = [0.0] * len(unmoved)
    shift = whole.equations.solve(1.0, unmoved, LinearLaws(nothing, weights, nothing))
    depths = []
    for assumed, left in zip(led, whole.per_contact(shift.rates), strict=True):
        moved = assumed + left[0]
        depths.append(jnp.where(moved > 0, jnp.minimum(positive_part(assumed), moved), moved))
    return drift(system, q, q, shift.accelerations, 1.0), depths


def _depths_worked_for(whole: Step, solution: ContactSolution) -> list:
    """Indentations at the end of the step: where the rates lead, but no deeper than the forces have
    worked for. (An unfinished iteration ends with less than the law's force at the depth it
    reaches.)"""
    rates, forces = whole.per_contact(solution.rates), whole.per_contact(solution.forces)
    out = []
    for contact, rate, force in zip(whole.contacts, rates, forces, strict=True):
        law = law_tangent.mean_force(
            contact.point.laws, contact.memory, whole.averaging, contact.depth, rate[0]
        )
        share = jnp.clip(safe_divide(-force[0], law), 0.0, 1.0)
        low, end = positive_part(contact.depth), contact.depth + whole.averaging.length * rate[0]
        out.append(jnp.where(end > low, low + share * (end - low), end))
    return out
