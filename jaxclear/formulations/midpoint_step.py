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

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.formulations import contact_rows, laws_over_step
from jaxclear.formulations.contact_rows import MiddleOfStep, TimeStep, by_joint
from jaxclear.formulations.contacts_over_step import (
    ContactOverStep,
    Step,
    damped,
    forces_at_start,
    memories_after,
    passive_rates_over,
)
from jaxclear.formulations.delassus import ContactSolution, LinearLaws, implicit_contact
from jaxclear.formulations.films_over_step import (
    AXES,
    films_of,
    films_over_step,
    per_film,
    solve_with_films,
    velocity_lag,
    without_films,
)
from jaxclear.formulations.impact_speed import taken_in_flight
from jaxclear.formulations.laws_over_step import Averaging, PastSlip
from jaxclear.formulations.model import Model
from jaxclear.formulations.permanent_reactions import Reaction
from jaxclear.formulations.rubbing_over_step import joints_over_step
from jaxclear.formulations.shafts_over_step import shafts_over_step
from jaxclear.formulations.state_rate import drift
from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import map_grouped, map_many
from jaxclear.ground.grouping import MANY, unstacked
from jaxclear.ground.numerics import positive_part, safe_divide, safe_sqrt
from jaxclear.multibody.kinematics import JacobianRow, along
from jaxclear.multibody.state import components, unpack_memories, unpack_motion
from jaxclear.multibody.system import rubbing_joints
from jaxclear.multibody.transmissions import within_gaps

# Weight of the depth of closed contacts against staying put, where coordinates are corrected.
STIFFNESS = 100.0
# Added to the inverse of an effective mass [1/kg], so that a contact which nothing can move has
# one.
LEAST_LIGHTNESS = 1e-12


class RowRead(NamedTuple):
    """A row of a Jacobian with what some vectors are where it has entries."""

    entries: tuple
    read: tuple[tuple, ...]

    def along(self, which: int) -> Any:
        """The row times one of the vectors."""
        return sp.dot(self.entries, self.read[which])

    def lightness(self, which: int) -> Any:
        """As `contact_rows.lightness`, the diagonal being one of the vectors."""
        pairs = zip(self.entries, self.read[which], strict=True)
        return sp.total(entry * entry / mass for entry, mass in pairs)


def read_by(row: JacobianRow, *vectors: Sequence[Any]) -> RowRead:
    """A row with the entries of vectors that it reads."""
    return RowRead(tuple(row.values()), tuple(tuple(vector[j] for j in row) for vector in vectors))


class WarmStart(NamedTuple):
    """What a step hands on to the next: free accelerations without contact, what contact adds, the
    last indentations, of each sliding direction of each contact friction and slip, the reactions of
    ideal joints that rub, the mean velocity [m/s] of the journal in each film, its `surplus` where
    there are contacts, and the normal forces [N] at its start where some contact damps.
    """

    smooth: list
    contact: list
    depths: list
    slips: list[tuple[PastSlip, ...]]
    reactions: tuple[Reaction, ...]
    films: list[tuple]
    surplus: list
    forces: list


def blank_start(model: Model) -> WarmStart:
    """That of a step before which nothing is known."""
    system, still = model.system, [0.0] * model.layout.speeds
    counts = [n - 1 for b in system.bearings.values() for n in components(system, b)]
    none = [0.0] * len(counts)
    return WarmStart(
        smooth=still,
        contact=still,
        depths=none,
        slips=[(PastSlip(0.0, 0.0, 0.0),) * count for count in counts],
        reactions=(Reaction((0.0,) * 3, (0.0,) * 3),) * len(rubbing_joints(system)),
        films=[(0.0,) * AXES] * len(films_of(system)),
        surplus=still if counts else [],
        forces=none if damped(system) else [],
    )


def step(
    model: Model, time_step: TimeStep, entries: list, last: WarmStart, bias: Any, iterations: int
) -> tuple[list, WarmStart]:
    """Entries of the state after the step, and what it hands on; `last` is what it was handed,
    `bias` that of the mean forces towards the step's end, `iterations` those of Newton's method on
    the contact laws."""
    h = time_step.length
    averaging, model = Averaging(h, bias), without_films(model)
    accelerations = sp.each(lambda a, b: a + b, last.smooth, last.contact)
    middle = contact_rows.middle_of_step(model, time_step, entries, accelerations)
    shafts, free_motion = shafts_over_step(
        model, middle.free_motion, middle.change_to(middle.v), averaging
    )
    middle = middle._replace(free_motion=free_motion)
    joints = joints_over_step(model, middle, last.reactions, averaging)
    films = films_over_step(model.system, middle, last.films, time_step.start, averaging)
    further = [
        rate.row for each in (joints, shafts, films) for other in each for rate in other.rates
    ]
    equations = implicit_contact(middle.free_motion, further)
    contacts = _contacts_at_start(model, averaging, middle, equations.free, entries, last)
    step = Step(model, time_step, averaging, middle, contacts, equations, joints, shafts, films)
    solution = _iterate(step, last.contact, iterations)
    free, caused = equations.free, solution.accelerations
    halfway = lambda x, k, c: x + 0.5 * h * (k + (1 + bias) * c)
    mean = sp.each(halfway, middle.v, free, caused)
    q = middle.end(model, mean, h)
    v = sp.each(lambda x, k, c: x + h * (k + c), middle.v, free, caused)
    q, depths = _settle(step, solution, q, v)
    slid = [
        laws_over_step.at_end(contact.slips, contact.braking, rates[1:])
        for contact, rates in zip(contacts, step.per_contact(solution.rates), strict=True)
    ]
    after = [*q, *v, *memories_after(step, solution)]
    passive, reactions = passive_rates_over(step, solution, slid, mean)
    after += [x + h * rate for x, rate in zip(entries[len(after) :], passive, strict=True)]
    after = within_gaps(model.system, model.layout, after)
    past = [
        laws_over_step.handed_on(contact.slips, end, forces[1:])
        for contact, end, forces in zip(
            contacts, slid, step.per_contact(solution.forces), strict=True
        )
    ]
    faster = [h * along(contact.point.rates[0].row, last.surplus) for contact in contacts]
    pressed = forces_at_start(model.system, contacts, faster)
    faster = surplus(bias, free, caused) if contacts else []
    means = per_film(films, solution.rates)
    means = [film.mean_velocity(rates) for film, rates in zip(films, means, strict=True)]
    if films:
        fast = [x + h * more for x, more in zip(v, faster, strict=True)]
        rows = len(solution.rates)
        lag = velocity_lag(model.system, films, (time_step.end, q, fast), means, equations, rows)
        faster = [sp.add(x, more / h) for x, more in zip(faster, lag, strict=True)]
    return after, WarmStart(free, caused, depths, past, reactions, means, faster, pressed)


def surplus(bias: Any, free: list, caused: list) -> list:
    """By how much faster than its speeds places go at the end of a step, for each second of it:
    b k_c / 2 of what contact `caused`, but of no more than it has to hold of the `free`
    accelerations: an impact's speeds are what they are. Of what rests on a contact it is, times the
    step, all of its speed, of opposite sign, to which a law would answer with damping."""
    many = len(free) >= MANY
    square = lambda vector: jnp.sum(sp.stack(vector) ** 2) if many else sum(k * k for k in vector)
    squares = [square(vector) for vector in (free, caused)]
    share = jnp.minimum(1.0, safe_sqrt(safe_divide(*squares)))
    return sp.each(lambda k: 0.5 * bias * share * k, caused)


def _contacts_at_start(
    model: Model,
    averaging: Averaging,
    middle: MiddleOfStep,
    free: list,
    entries: list,
    last: WarmStart,
) -> list[ContactOverStep]:
    """The contacts with which a step begins; `free`: accelerations without contact."""
    back = middle.change_to(middle.v)
    half, diagonal = 0.5 * averaging.length, middle.free_motion.diagonal
    memories = unpack_memories(model.layout, entries)
    remembered = [memory for joint in memories.values() for memory in joint]

    def one(averaging, laws, indentation, rate, rows, depth, memory, now, past):
        normal, *across = rows
        approach = sp.add(rate, normal.along(0))
        if memory.impact_speed is not None:
            gain = half * normal.along(1)
            flight = depth, indentation, approach, gain
            speed = taken_in_flight(memory.impact_speed, flight, averaging.length)
            memory = memory._replace(impact_speed=speed)
        mass = 1.0 / (normal.lightness(2) + LEAST_LIGHTNESS)
        braking = laws_over_step.braking(
            laws,
            *averaging,
            depth + averaging.length * positive_part(approach),
            [row.lightness(2) for row in across],
        )
        sliding = laws_over_step.at_start(now, past, depth)
        return depth, approach, mass, memory, braking, sliding

    points = middle.free_motion.contacts
    slips = [tuple(rate.at(back) for rate in point.acting[1:]) for point in points]
    calls = [
        (
            averaging,
            *(point.laws, point.gap_function.indentation, point.rates[0].value),
            tuple(read_by(rate.row, back, free, diagonal) for rate in point.acting),
            *rest,
        )
        for point, *rest in zip(points, last.depths, remembered, slips, last.slips, strict=True)
    ]
    result = map_many(one, calls)
    return [ContactOverStep(point, *rest) for point, rest in zip(points, result, strict=True)]


def _first_rates(step: Step, last: list) -> tuple[list, list, list]:
    """Rates of the rows without contact, those from which the iteration sets out, and the forces
    that belong to these.

    A contact that is closed at the start sets out from the forces of the step before, one that is
    open from where an impact would end.
    """
    free = step.equations.free
    unmoved: list[Any] = []
    first: list[Any] = []
    forces: list[Any] = []

    def one(averaging, laws, depth, approach, mass, braking, slips, rows):
        closed, (normal, *across) = depth > 0, rows
        reached = approach + 0.5 * averaging.length * normal.along(0)
        free_depth = depth + averaging.length * reached
        deepest = laws_over_step.deepest(laws, mass, approach, free_depth)
        carried_on = reached + averaging.reach * normal.along(1)
        initial = jnp.where(closed, carried_on, (deepest - depth) / averaging.length)
        result = [(reached, initial, 0.0)]
        for slip, row in zip(slips, across, strict=True):
            rate = laws_over_step.unhindered(slip, braking, row.along(0))
            traction = jnp.where(closed, slip.traction, 0.0)
            result.append((rate, jnp.where(closed, slip.current, rate), traction))
        return tuple(result)

    calls = [
        (
            *(step.averaging, contact.point.laws, contact.depth, contact.approach),
            *(contact.mass, contact.braking, contact.slips),
            tuple(read_by(rate.row, free, last) for rate in contact.point.acting),
        )
        for contact in step.contacts
    ]
    for rows in map_many(one, calls):
        for rate, initial, force in rows:
            unmoved.append(rate)
            first.append(initial)
            forces.append(force)
    back = step.middle.change_to(step.middle.v)
    for rate, (reach, time) in ((r, other.reaches) for other in step.others for r in other.rates):
        unmoved.append(sp.add(rate.at(back), time * along(rate.row, free)))
        first.append(sp.add(unmoved[-1], reach * along(rate.row, last)))
        forces.append(0.0)
    if step.films:
        films = zip(step.films, per_film(step.films, unmoved), strict=True)
        first = first[: -AXES * len(step.films)]
        first += [rate for film, free_rates in films for rate in film.first_rates(free_rates)]
    return unmoved, first, forces


def _iterate(step: Step, last: list, iterations: int) -> ContactSolution:
    """Newton on the normal forces; friction is solved for at each contact by itself, then the
    contacts move each other. A loop: written out it runs 20 % faster, but its derivatives take six
    times as long to compile.
    """
    unmoved, rates, forces = _first_rates(step, last)
    equations, reaches = step.equations, step.reaches()
    if not rates:
        return equations.solve([], [], LinearLaws([], [], []))
    size = len(unmoved)

    def improve(solution, turn):
        rates, forces = map(unstacked, solution[:2])
        tangents = [
            (*film.tangent(film_rates, turn == 0), film_rates)
            for film, film_rates in zip(step.films, per_film(step.films, rates), strict=True)
        ]
        laws = _linear_laws(step, rates, forces)
        better = solve_with_films(equations, reaches, unmoved, laws, tangents)
        return ContactSolution(*map(sp.stack, better)), None

    counts = (size, size, len(equations.free), len(equations.multipliers))
    blank = ContactSolution(*map(jnp.zeros, counts))
    blank = blank._replace(rates=sp.stack(rates), forces=sp.stack(forces))
    turns = jnp.arange(iterations) if step.films else None
    solution = jax.lax.scan(improve, blank, turns, length=iterations)[0]
    return ContactSolution(*map(unstacked, solution))


def _linear_laws(step: Step, rates: list, forces: list) -> LinearLaws:
    """The laws of all contacts about given rates and forces; alike joints are traced once."""

    def tangents(laws, memories, averaging, *each):
        return tuple(
            laws_over_step.tangent(law, memory, averaging, *rest)
            for law, memory, *rest in zip(laws, memories, *each, strict=True)
        )

    system = step.model.system
    parts = zip(
        by_joint(system, [contact.point.laws for contact in step.contacts]),
        by_joint(system, [contact.memory for contact in step.contacts]),
        by_joint(system, [contact.depth for contact in step.contacts]),
        by_joint(system, step.per_contact(rates)),
        by_joint(system, step.per_contact(forces)),
        by_joint(system, [contact.braking for contact in step.contacts]),
        strict=True,
    )
    calls = [(laws, memory, step.averaging, *rest) for laws, memory, *rest in parts]
    result = [tangent for joint in map_grouped(tangents, calls) for tangent in joint]
    forces = [force for pushes, _ in result for force in pushes]
    dampings = [damping for _, falls in result for damping in falls]
    laws = LinearLaws(forces, dampings, list(rates[: len(forces)]))
    for other, speeds in zip(step.others, step.per_other(rates), strict=True):
        laws = LinearLaws(*([*a, *b] for a, b in zip(laws, other.linear(speeds), strict=True)))
    return laws


def _settle(step: Step, solution: ContactSolution, q: list, v: list) -> tuple[list, list]:
    """Coordinates moved, speeds kept, so that closed contacts are as deep as the forces have worked
    for; and these depths.

    Where the gap is curved or worn within a step, the true indentation differs from the one that
    the rates lead to. To let the contact force act on the difference would be energy from nowhere.
    """
    if not step.contacts:
        return q, []
    system = step.model.system
    motion = unpack_motion(system, [*q, *v])
    true_depths = contact_rows.indentations(step.model, step.time_step.end, *motion)
    led = _depths_worked_for(step, solution)
    unmoved, weights = [], []
    for contact, true, assumed in zip(step.contacts, true_depths, led, strict=True):
        others = [0.0] * (contact.point.active - 1)
        closed = (true > 0) | (assumed > 0)
        weights += [jnp.where(closed, STIFFNESS * contact.mass, 0.0), *others]
        unmoved += [true - assumed, *others]
    further = [0.0 for other in step.others for _ in other.rates]
    unmoved, weights = unmoved + further, weights + further
    nothing = [0.0] * len(unmoved)
    ones = [1.0] * len(unmoved)
    shift = step.equations.solve(ones, unmoved, LinearLaws(nothing, weights, nothing))
    depths = []
    for assumed, change in zip(led, step.per_contact(shift.rates), strict=True):
        moved = assumed + change[0]
        depths.append(jnp.where(moved > 0, jnp.minimum(positive_part(assumed), moved), moved))
    return drift(system, q, q, shift.accelerations, 1.0), depths


def _depths_worked_for(step: Step, solution: ContactSolution) -> list:
    """Indentations at the end of the step: where the rates lead, but no deeper than the forces have
    worked for. (An unfinished iteration ends with less than the law's force at the depth it
    reaches.)"""
    rates, forces = step.per_contact(solution.rates), step.per_contact(solution.forces)

    def one(averaging, laws, memory, depth, rate, force):
        law = laws_over_step.mean_force(laws, memory, averaging, depth, rate)
        share = jnp.clip(safe_divide(-force, law), 0.0, 1.0)
        low, end = positive_part(depth), depth + averaging.length * rate
        return jnp.where(end > low, low + share * (end - low), end)

    each = zip(step.contacts, rates, forces, strict=True)
    return map_many(
        one,
        [
            (step.averaging, contact.point.laws, contact.memory, contact.depth, rate[0], force[0])
            for contact, rate, force in each
        ],
    )
