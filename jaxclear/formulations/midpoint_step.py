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

from jaxclear.formulations import contact_rows
from jaxclear.formulations.contact_rows import (
    MiddleOfStep,
    TimeStep,
    by_joint,
    has_damping,
    joint_reports,
    split,
)
from jaxclear.formulations.delassus import (
    ContactSolution,
    ImplicitContact,
    LinearLaws,
    implicit_contact,
)
from jaxclear.formulations.films_over_step import (
    AXES,
    FilmOverStep,
    film_losses,
    films_of,
    films_over_step,
    solve_with_films,
    velocity_lag,
    with_films,
    without_films,
)
from jaxclear.formulations.laws_over_step import (
    Averaging,
    ContactOverStep,
    Outset,
    PastSlip,
    RowAtStart,
    SpringOverStep,
    contact_at_start,
    mean_rates,
    springs_over_step,
)
from jaxclear.formulations.model import Model
from jaxclear.formulations.permanent_reactions import Reaction
from jaxclear.formulations.rubbing_over_step import JointOverStep, joints_over_step, rubbed
from jaxclear.formulations.state_rate import (
    Passive,
    drift,
    followed_rates,
    link_accelerations,
    passive_rates,
)
from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import map_grouped, map_many
from jaxclear.ground.grouping import LARGEST_UNROLLED, MANY, unstacked
from jaxclear.ground.numerics import positive_part, safe_divide, safe_sqrt
from jaxclear.multibody import kinematics
from jaxclear.multibody.contact_point import (
    ActingContact,
    PointState,
    slip_speed,
)
from jaxclear.multibody.damped_stops import forces_at
from jaxclear.multibody.kinematics import along
from jaxclear.multibody.rows import LinearRate
from jaxclear.multibody.state import components, pack_memories, unpack_memories, unpack_motion
from jaxclear.multibody.system import rubbing_joints
from jaxclear.multibody.transmissions import within_gaps

# Weight of the depth of closed contacts against staying put, where coordinates are corrected.
STIFFNESS = 100.0


class RowRead(NamedTuple):
    """A row of a Jacobian with its rate, and what some vectors are where it has entries: the
    speeds' change to the start, accelerations without contact and by that of the step before, the
    diagonal of the mass matrix. Rows of other speeds are alike."""

    rate: Any
    entries: tuple
    vectors: tuple[tuple, ...]

    def at_start(self) -> RowAtStart:
        """The row as the step begins."""
        back, free, last = (sp.dot(self.entries, vector) for vector in self.vectors[:3])
        pairs = zip(self.entries, self.vectors[3], strict=True)
        lightness = sp.total(entry * entry / mass for entry, mass in pairs)
        return RowAtStart(sp.add(self.rate, back), free, last, lightness)


def read_rows(rates: Sequence[LinearRate], vectors: tuple) -> tuple[RowRead, ...]:
    """Rates with the entries of vectors that their rows read."""
    return tuple(
        RowRead(
            rate.value,
            tuple(rate.row.values()),
            tuple(tuple(v[j] for j in rate.row) for v in vectors),
        )
        for rate in rates
    )


class WarmStart(NamedTuple):
    """What a step hands on to the next: free accelerations without contact, what contact adds, the
    last indentations, of each sliding direction of each contact friction and slip, the reactions of
    ideal joints that rub, the mean velocity [m/s] of the journal in each film, its `surplus` where
    there are contacts, and the normal forces [N] at its start where some contact damps.
    """

    smooth: Any
    contact: Any
    depths: Any
    slips: Any
    reactions: Any
    films: Any
    surplus: Any
    forces: Any

    def packed(self) -> "WarmStart":
        """The same, each part an array, as steps hand it on."""
        return WarmStart(*(sp.stack(jax.tree.leaves(part)) for part in self))

    def unpacked(self, form: "WarmStart") -> "WarmStart":
        """The same in numbers, of the `form` that they have in a step."""
        pairs = zip(map(jax.tree.structure, form), self, strict=True)
        least = LARGEST_UNROLLED
        return WarmStart(*(jax.tree.unflatten(k, unstacked(part, least)) for k, part in pairs))


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
        forces=none if has_damping(system) else [],
    )


class PerKind(NamedTuple):
    """Values of the laws over a step, one a law, by the kind of the law."""

    contacts: tuple
    joints: tuple
    springs: tuple
    films: tuple


class Step(NamedTuple):
    """All that a step starts from; rows of contacts come first, then those of `others`."""

    model: Model
    time_step: TimeStep
    averaging: Averaging
    middle: MiddleOfStep
    equations: ImplicitContact
    contacts: list[ContactOverStep]
    joints: tuple[JointOverStep, ...]
    springs: tuple[SpringOverStep, ...]
    films: tuple[FilmOverStep, ...]

    @property
    def others(self) -> tuple[Any, ...]:
        """Ideal joints that rub, couplings with stiffness, films."""
        return (*self.joints, *self.springs, *self.films)

    @property
    def laws(self) -> tuple[Any, ...]:
        """All laws over the step, in the order of their rows."""
        return (*self.contacts, *self.others)

    @property
    def reaches(self) -> list:
        """Change of each row's rate by the acceleration that the rows add to it [s]."""
        return [reach for law in self.laws for reach, _ in law.reaches]

    def per_law(self, values: Any) -> PerKind:
        """One value per row, as one tuple for each of the laws."""
        by_law = split(values, [len(law.reaches) for law in self.laws])
        kinds = self.contacts, self.joints, self.springs, self.films
        return PerKind(*split(by_law, [len(kind) for kind in kinds]))


def step(
    model: Model, time_step: TimeStep, entries: list, last: WarmStart, bias: Any, iterations: int
) -> tuple[list, WarmStart, list]:
    """One implicit step: entries of the state after it, and its warm start for the next.

    Args:
        model: of the run.
        time_step: start and length [s].
        entries: of the state before it.
        last: warm start of the step before.
        bias: of mean forces towards the step's end [1].
        iterations: of Newton's method on the contact laws.
    """
    h = time_step.length
    averaging, model = Averaging(h, bias), without_films(model)
    accelerations = sp.each(lambda a, b: a + b, last.smooth, last.contact)
    middle = contact_rows.middle_of_step(model, time_step, entries, accelerations)
    springs, free_motion = springs_over_step(
        model, middle.free_motion, middle.change_to(middle.v), averaging
    )
    middle = middle._replace(free_motion=free_motion)
    joints = joints_over_step(model, middle, last.reactions, averaging)
    films = films_over_step(model.system, middle, last.films, time_step.start, averaging)
    others: tuple = (*joints, *springs, *films)
    further = [rate.row for law in others for rate in law.rates]
    equations = implicit_contact(middle.free_motion, further)
    step = Step(model, time_step, averaging, middle, equations, [], joints, springs, films)
    step, outset = _set_out(step, entries, last)
    solution = _iterate(step, outset, iterations)
    free, caused = equations.free, solution.accelerations
    halfway = lambda x, k, c: x + 0.5 * h * (k + (1 + bias) * c)
    mean = sp.each(halfway, middle.v, free, caused)
    q = middle.end(model, mean, h)
    v = sp.each(lambda x, k, c: x + h * (k + c), middle.v, free, caused)
    rates, forces = map(step.per_law, solution[:2])
    q, depths = _settle(step, rates, forces, q, v)
    memories = [
        law.memory_after(moved, -force[0])
        for law, moved, force in zip(step.contacts, rates.contacts, forces.contacts, strict=True)
    ]
    by_bearing = dict(zip(model.system.bearings, by_joint(model.system, memories), strict=True))
    after = [*q, *v, *pack_memories(model.layout, by_bearing)]
    sliding = zip(step.contacts, rates.contacts, strict=True)
    slid = [law.slips_at_end(moved) for law, moved in sliding]
    passive, reactions = _passive_rates(step, solution, rates, forces, slid, mean)
    after += [x + h * rate for x, rate in zip(entries[len(after) :], passive, strict=True)]
    after = within_gaps(model.system, model.layout, after)
    past = [
        tuple(
            PastSlip(traction, slip, slip + start.turn)
            for start, slip, traction in zip(law.slips, end, force[1:], strict=True)
        )
        for law, end, force in zip(step.contacts, slid, forces.contacts, strict=True)
    ]
    motion = []
    if last.forces:
        pairs = zip(step.contacts, middle.free_motion.contacts, strict=True)
        moving = [x.approach + h * along(y.rates[0].row, last.surplus) for x, y in pairs]
        motion = list(zip([law.depth for law in step.contacts], moving, strict=True))
    faster = surplus(bias, free, caused) if step.contacts else []
    means = [film.mean_velocity(moved) for film, moved in zip(films, rates.films, strict=True)]
    if films:
        fast = [x + h * more for x, more in zip(v, faster, strict=True)]
        rows = len(solution.rates)
        lag = velocity_lag(model.system, films, (time_step.end, q, fast), means, equations, rows)
        faster = [sp.add(x, more / h) for x, more in zip(faster, lag, strict=True)]
    return after, WarmStart(free, caused, depths, past, reactions, means, faster, []), motion


def surplus(bias: Any, free: list, caused: list) -> list:
    """By how much faster than their speeds places move at a step's end, per second of the step.

    It is b k_c / 2, with k_c bounded by the free accelerations, as speeds in an impact are what
    they are. For what rests on a contact it is, times the step, all of the speed, with opposite
    sign, to which a law would respond with damping.

    Args:
        bias: b, of mean forces towards the step's end [1].
        free: accelerations without contact.
        caused: k_c, accelerations by contact.
    """
    many = len(free) >= MANY
    square = lambda vector: jnp.sum(sp.stack(vector) ** 2) if many else sum(k * k for k in vector)
    squares = [square(vector) for vector in (free, caused)]
    share = jnp.minimum(1.0, safe_sqrt(safe_divide(*squares)))
    return sp.each(lambda k: 0.5 * bias * share * k, caused)


def _set_out(step: Step, entries: list, last: WarmStart) -> tuple[Step, Outset]:
    """The step with its contacts, and from where its laws set out."""
    middle, averaging = step.middle, step.averaging
    points = middle.free_motion.contacts
    back, diagonal = middle.change_to(middle.v), middle.free_motion.diagonal
    vectors = back, step.equations.free, last.contact, diagonal
    memories = unpack_memories(step.model.layout, entries)
    remembered = [memory for joint in memories.values() for memory in joint]

    def one(averaging, laws, indentation, rows, *past):
        rows = [row.at_start() for row in rows]
        return contact_at_start(averaging, laws, indentation, rows, *past)

    calls = [
        (
            *(averaging, point.laws, point.gap_function.indentation),
            *(read_rows(point.acting, vectors), *past),
        )
        for point, *past in zip(points, last.depths, remembered, last.slips, strict=True)
    ]
    result = map_many(one, calls)
    contacts = [
        ContactOverStep(averaging, point.laws, *values)
        for point, (values, _) in zip(points, result, strict=True)
    ]
    outsets = [outset for _, outset in result]
    for law in step.others:
        rows = [row.at_start() for row in read_rows(law.rates, vectors)]
        outsets.append(law.outset(*mean_rates(rows, law.reaches)))
    together = (tuple(x for outset in outsets for x in outset[part]) for part in range(3))
    return step._replace(contacts=contacts), Outset(*together)


def _iterate(step: Step, outset: Outset, iterations: int) -> ContactSolution:
    """Newton on the normal forces; friction is solved for at each contact by itself, then the
    contacts move each other. A loop: written out it runs 20 % faster, but its derivatives take six
    times as long to compile.
    """
    equations, reaches, unmoved = step.equations, step.reaches, list(outset.unmoved)
    if not unmoved:
        return equations.solve([], [], LinearLaws([], [], []))

    def improve(solution, turn):
        rates, forces = map(unstacked, solution[:2])
        films = zip(step.films, step.per_law(rates).films, strict=True)
        tangents = [(*film.tangent(moved, turn == 0), moved) for film, moved in films]
        laws = _linear_laws(step, rates, forces)
        better = solve_with_films(equations, reaches, unmoved, laws, tangents)
        return ContactSolution(*map(sp.stack, better)), None

    counts = len(equations.free), len(equations.multipliers)
    first = map(sp.stack, outset[1:])
    blank = ContactSolution(*first, *map(jnp.zeros, counts))
    turns = jnp.arange(iterations) if step.films else None
    solution = jax.lax.scan(improve, blank, turns, length=iterations)[0]
    return ContactSolution(*map(unstacked, solution))


def _linear_laws(step: Step, rates: list, forces: list) -> LinearLaws:
    """The laws about given rates and forces; alike joints are traced once."""

    def linear(laws, rates, forces):
        return tuple(law.linear(*about) for law, *about in zip(laws, rates, forces, strict=True))

    by_kind = step.per_law(rates), step.per_law(forces)
    contacts = step.contacts, *(values.contacts for values in by_kind)
    calls = list(zip(*(by_joint(step.model.system, each) for each in contacts), strict=True))
    result = [each for joint in map_grouped(linear, calls) for each in joint]
    result += linear(step.others, *(sum(values[1:], ()) for values in by_kind))
    return LinearLaws(*([x for laws in result for x in laws[part]] for part in range(3)))


def _settle(step: Step, rates: PerKind, forces: PerKind, q: list, v: list) -> tuple[list, list]:
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
    led = map_many(
        lambda law, rate, force: law.depth_worked_for(rate, force),
        [
            (law, rate[0], force[0])
            for law, rate, force in zip(step.contacts, rates.contacts, forces.contacts, strict=True)
        ],
    )
    unmoved, weights = [], []
    for contact, true, assumed in zip(step.contacts, true_depths, led, strict=True):
        others = [0.0] * (len(contact.reaches) - 1)
        closed = (true > 0) | (assumed > 0)
        weights += [jnp.where(closed, STIFFNESS * contact.mass, 0.0), *others]
        unmoved += [true - assumed, *others]
    nothing = [0.0] * len(step.reaches)
    further = nothing[len(unmoved) :]
    unmoved, weights = unmoved + further, weights + further
    ones = [1.0] * len(unmoved)
    shift = step.equations.solve(ones, unmoved, LinearLaws(nothing, weights, nothing))
    depths = []
    for assumed, change in zip(led, step.per_law(shift.rates).contacts, strict=True):
        moved = assumed + change[0]
        depths.append(jnp.where(moved > 0, jnp.minimum(positive_part(assumed), moved), moved))
    return drift(system, q, q, shift.accelerations, 1.0), depths


def _passive_rates(
    step: Step, solution: ContactSolution, rates: PerKind, forces: PerKind, ends: list, mean: list
) -> tuple[list, tuple[Reaction, ...]]:
    """(rates of what only follows the motion, with the forces that the step was made with;
    reactions of ideal joints that rub). `ends`: slips at its end along the directions in its
    middle; `mean`: speeds over it."""
    model, free_motion = step.model, step.middle.free_motion
    layout, system = model.layout, model.system
    # Of all that the speeds gain by contact, so also where an iteration ends with a pull.
    normal = [-part[0] for part in forces.contacts]
    pressing = [sp.total(part) for part in by_joint(system, normal)]
    if not (layout.wear or layout.energies or step.joints or step.films):
        return [*followed_rates(system, layout, free_motion.forces), *pressing], ()
    change = step.middle.change_to(mean)
    acting = _acting_contacts(step, rates, forces, ends, change)
    reports = joint_reports(system, free_motion.poses, acting)
    applied = free_motion.forces._replace(reports=reports)
    if layout.energies or step.joints or step.films:
        motions = free_motion.forces.motions
        time, followed = step.time_step.middle, applied.followed
        if step.films:
            # Speeds at its start alternate about those that stiff films determine.
            motion = unpack_motion(system, [*step.middle.halfway, *mean])
            motions = kinematics.link_motions(system, *motion, time)
        applied = forces_at(system, motions, reports, time, followed)
        applied = with_films(applied, step.films, forces.films, rates.films)
        pressing += film_losses(system, applied)
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
        pairs = zip(step.joints, forces.joints, strict=True)
        rubs = [x for joint, part in pairs for x in joint.friction(part, change)]
        # The accelerations contain the joints' friction, so the power of a drive asks for it too.
        rubbing = applied, step.middle, total, rubs, change
        passive, reactions, applied = rubbed(model, step.joints, *rubbing)
    return passive_rates(system, layout, applied, total, passive, pressing), reactions


def _acting_contacts(
    step: Step, rates: PerKind, forces: PerKind, ends: list, change: list
) -> list[ActingContact]:
    """The contacts with mean forces and rates over the step, and the mean indentation while in
    contact; `ends`: slips at the end; `change`: from the predicted speeds to the mean ones, which
    tell how a contact without friction slides.
    """
    acting = []
    points = step.middle.free_motion.contacts
    for point, law, slid, (rate, *_), (normal, *tractions) in zip(
        points, step.contacts, ends, rates.contacts, forces.contacts, strict=True
    ):
        pairs, normal = zip(law.slips, slid, strict=True), positive_part(-normal)
        # Along the directions as they turn.
        slip, speed = [0.5 * (s.current + end + s.turn) for s, end in pairs], None
        if law.braking is not None:
            # Where friction has stopped it within the step, only as long as it took.
            size = slip_speed(tuple(slip))
            speed = slip_speed(tuple(tractions))
            speed = size * law.laws.friction.acting_share(normal, speed, size)
        slip += [rate.at(change) for rate in point.rates[point.active :]]
        end = law.depth + step.averaging.length * rate
        depth = 0.5 * (positive_part(law.depth) + positive_part(end))
        elastic = law.laws.contact.elastic_force(depth)
        values = law.laws, point.gap_function, (rate, *slip), normal, tuple(tractions), elastic
        memory = PointState(None, law.memory.bristles)
        acting.append(ActingContact(*values, memory, speed, depth))
    return acting
