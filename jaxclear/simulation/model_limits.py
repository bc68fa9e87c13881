"""What the model of a formulation leaves out, told from a run's saved states.

Of joints that always touch: the model puts the inner part where its force presses it, at once,
while a body takes time for the way and lags where its force turns fast (`gap_motion`); rows of a
loop that no motion changes carry nothing in the joint that closes it, though contacts would share
what they can (`sharing_of_forces`); what collars carry is the reaction along the axis, which rubs
and wears nothing, and without collars nothing but the model holds a journal there (`pressed`). And
of friction that is taken as Coulomb's by the coefficients of another law: they are one where a
joint slides fast and long, and others where it sticks, slides slowly, or its bristles yield
(`coulomb_friction`).
"""

from collections.abc import Callable, Iterable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.body import GROUND
from jaxclear.formulations.base import AbstractFormulation, ContactReport
from jaxclear.formulations.model import Instant, Model
from jaxclear.formulations.permanent_reactions import Reaction, reactions_without_motion, touching
from jaxclear.ground import factorisation
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.system import System
from jaxclear.simulation.error_weights import settling_length

# A joint that rubs less than this share of what the one that rubs most does is judged beside that.
NEGLIGIBLE = 0.01
# Beside the sum of the squares that rows add to forces: what keeps rows apart that add the same.
DAMPING = 1e-9


def in_gaps(model: Model) -> dict[str, Any]:
    """The gap of each joint that always touches and has one."""
    gaps = {one.name: getattr(one.joint, "gap", None) for one in touching(model.system)}
    return {name: gap for name, gap in gaps.items() if gap is not None}


def gap_placements(
    reports: dict[str, ContactReport], now: Instant, mechanism: Mechanism
) -> Float[Array, "13 joints"]:
    """Positions and forces in joints at a look, from which `gap_motion` is computed.

    Rows of each joint: the bearing's rotation in the ground (9), and as means since the last look
    the
    inner part's offset in its gap, in the bearing's axes [m] (3), and the sum of normal forces [N].

    Args:
        reports: contact reports of these joints.
        now: instant of the look.
        mechanism: with the bearings' markers.
    """
    columns = []
    for name, report in reports.items():
        marker = mechanism.connections[name].parent
        turn = marker.pose().rotation
        index = now.model.system.topology.index(marker.body)
        if index is not None:
            frame = now.model.system.links[index].frame
            turn = sp.product(now.motions[index].pose.after(frame).rotation, turn)
        rotation = [x for row in turn for x in row]
        columns.append(sp.stack((*rotation, *report.offset, jnp.sum(report.normal_force))))
    return jnp.stack(columns, axis=1)


def lighter_masses(names: Iterable[str], mechanism: Mechanism) -> Float[Array, " joints"]:
    """The lighter of the bodies that each of these joints connects [kg]."""

    def lighter(name: str) -> Any:
        connection = mechanism.connections[name]
        bodies = (connection.parent.body, connection.child.body)
        return jnp.min(jnp.stack([mechanism.bodies[b].mass for b in bodies if b != GROUND]))

    return jnp.stack([jnp.asarray(lighter(name), float) for name in names])


def gap_motion(
    looks: Float[Array, "looks 13 joints"],
    times: Float[Array, " looks"],
    heavy: Float[Array, " joints"],
) -> Float[Array, " joints"]:
    """Inertia force of the journal's motion in its gap over the contact force, by joint [1].

    Where a force turns round between two looks parts separate, which `Trajectory.switchings` tells,
    and nothing is counted.

    Args:
        looks: rows of `gap_placements`, look after look.
        times: of the looks [s].
        heavy: mass of the lighter body at each joint [kg].
    """
    if len(looks) < 4:
        return jnp.zeros(len(heavy))
    # Halfway between two looks, for which means stand.
    turns = 0.5 * (looks[1:, :9] + looks[:-1, :9]).reshape(-1, 3, 3, len(heavy))
    places = jnp.einsum("labj,lbj->laj", turns, looks[1:, 9:12])
    times, forces = 0.5 * (times[1:] + times[:-1]), looks[2:-1, 12]
    lengths = jnp.diff(times)[:, None, None]
    speeds = jnp.diff(places, axis=0) / lengths
    between = 0.5 * (lengths[1:] + lengths[:-1])
    moved = heavy * jnp.linalg.norm(jnp.diff(speeds, axis=0) / between, axis=1)
    stays = jnp.sum(places[1:] * places[:-1], axis=1) > 0
    counted = jnp.where(stays[1:] & stays[:-1], moved, 0.0)
    width = between[:, 0]
    return safe_divide(jnp.sum(width * counted, axis=0), jnp.sum(width * forces, axis=0))


def sharing_of_forces(
    now: Instant, report: Callable[[str], ContactReport], mechanism: Mechanism
) -> Float[Array, "2 joints"] | None:
    """How unique the forces on the ends of joints that always touch are; None where they are.

    Rows: the sum of the forces on the ends [N]; their change in the distribution whose sum of
    squares is
    least, as between equal contacts of rigid bodies.

    Args:
        now: instant of the look.
        report: function from a joint's name to its contact report.
        mechanism: whose redundant rows carry forces without motion.
    """
    joints = touching(now.model.system)
    rows = reactions_without_motion_of(now, mechanism) if joints else []
    if not rows:
        return None
    reports = [report(one.name) for one in joints]
    acting = [Reaction(tuple(one.force), tuple(one.torque)) for one in reports]
    forces = [_on_ends(one, forces_of) for one, forces_of in zip(joints, acting, strict=True)]
    added = [
        [
            _on_ends(one, _add_reactions(forces_of, extra)) - force
            for one, forces_of, extra, force in zip(joints, acting, row, forces, strict=True)
        ]
        for row in rows
    ]
    share = _least_squares_shares(forces, added)
    columns = []
    for k, force in enumerate(forces):
        others = force + sum(x * row[k] for x, row in zip(share, added, strict=True))
        sizes, changed = _sizes_of_forces(force), _sizes_of_forces(others)
        columns.append(jnp.stack([jnp.sum(sizes), jnp.sum(abs(changed - sizes))]))
    return jnp.stack(columns, axis=1)


def reactions_without_motion_of(now: Instant, mechanism: Mechanism) -> list[tuple[Reaction, ...]]:
    """For each row of a loop that no motion changes: what a force 1 in it adds to the reactions of
    the joints that always touch [N, N m]."""
    system = now.model.system
    in_space = any(len(body.inertia) > 1 for body in mechanism.bodies.values())
    return reactions_without_motion(system, now.motions, now.q, touching(system), in_space)


def _on_ends(one: Any, reaction: Reaction) -> Float[Array, "ends 3"]:
    """The forces on a joint's ends [N] by its reaction alone, which are linear in it."""
    none = 0.0 if one.joint.components == 1 else (0.0,) * one.joint.components
    return jnp.stack([sp.stack(end.force) for end in one.joint.carrying_ends(*reaction, none)])


def _add_reactions(a: Reaction, b: Reaction) -> Reaction:
    return Reaction(sp.plus(a.force, b.force), sp.plus(a.torque, b.torque))


def _sizes_of_forces(forces: Float[Array, "ends 3"]) -> Float[Array, " ends"]:
    return jnp.stack([sp.norm(tuple(force)) for force in forces])


def _least_squares_shares(forces: list[Array], added: list[list[Array]]) -> tuple:
    """How much of each row [N, N m] makes the sum of squares of the forces least."""
    flat = [jnp.concatenate([part.ravel() for part in row]) for row in added]
    acting = jnp.concatenate([part.ravel() for part in forces])
    damping = DAMPING * sum(row @ row for row in flat) + jnp.finfo(float).tiny
    matrix = [[a @ b + (damping if a is b else 0.0) for b in flat] for a in flat]
    return factorisation.solve(factorisation.factor(matrix), tuple(-(a @ acting) for a in flat))


def indeterminate_forces(looks: Float[Array, "looks 2 joints"]) -> Float[Array, " joints"]:
    """By joint how much its forces would be others, beside those of the joint that carries most."""
    carried, others = jnp.sum(looks, axis=0)
    return safe_divide(others, jnp.max(carried, initial=0.0))


def collared_bearings(model: Model) -> tuple[str, ...]:
    """The bearings with collars that always touch."""
    gaps = in_gaps(model)
    return tuple(name for name, gap in gaps.items() if getattr(gap, "flange", None) is not None)


def uncollared_bearings(model: Model) -> tuple[str, ...]:
    """The bearings without collars that always touch."""
    return tuple(name for name, gap in in_gaps(model).items() if gap.overhang(0.0) is not None)


def is_held_by_others(now: Instant, mechanism: Mechanism, names: tuple[str, ...]) -> list[bool]:
    """Whether a joint's force along its axis is not unique, as other joints may carry it.

    Args:
        now: instant of the look.
        mechanism: with redundant rows.
        names: joints, in the order of the result.
    """
    redundancy, joints = now.model.system.topology.redundancy, touching(now.model.system)
    open_ = set() if redundancy is None else {*redundancy.joints}
    for reactions in reactions_without_motion_of(now, mechanism):
        pairs = zip(joints, reactions, strict=True)
        open_ |= {one.name for one, reaction in pairs if not sp.is_zero(reaction.force[2])}
    return [name in open_ for name in names]


def sliding_bearings(system: System) -> tuple[str, ...]:
    """The bearings without collars whose journals move in their gaps."""
    gaps = {name: one.joint for name, one in system.bearings.items()}
    return tuple(name for name, gap in gaps.items() if gap.overhang(0.0) is not None)


def pressed(reports: list[ContactReport], counted: Iterable[bool]) -> Float[Array, "2 joints"]:
    """Of joints that are told of at a look: force along the axis, if that is counted, and that of
    its contacts [N]."""
    forces = [report.force[2] if c else 0.0 for report, c in zip(reports, counted, strict=True)]
    along = [abs(jnp.asarray(force, float)) for force in forces]
    return jnp.stack([jnp.stack(along), jnp.stack([jnp.sum(r.normal_force) for r in reports])])


def share_along(looks: Float[Array, "looks 2 joints"]) -> Float[Array, " joints"]:
    """By joint the share of all its forces that acts along its axis."""
    along, across = jnp.sum(looks, axis=0)
    return safe_divide(along, along + across)


def contact_loss(system: System, reports: dict[str, ContactReport]) -> Float[Array, " joints"]:
    """By joint how much of its bearing a journal has left at a look, in lengths of the bearing."""
    gaps = [system.bearings[name].joint for name in reports]
    shares = [
        gap.overhang(report.offset[2]) for gap, report in zip(gaps, reports.values(), strict=True)
    ]
    return jnp.stack([jnp.asarray(share, float) for share in shares])


def laws_of_others(model: Model, formulation: AbstractFormulation) -> dict[str, Any]:
    """By joint the friction law that is taken as Coulomb's and is another."""
    if not formulation.rubs_as_coulombs:
        return {}
    laws = {
        name: law.friction
        for name, bearing in model.system.bearings.items()
        for law in bearing.contact_laws
        if law.friction is not None
    }
    laws |= {joint.name: joint.joint.friction for joint in touching(model.system)}
    return {name: law for name, law in laws.items() if law is not None and not law.set_valued}


def power_by_coulomb(
    laws: dict[str, Any], report: Callable[[str], ContactReport]
) -> Float[Array, "3 joints"]:
    """Of each joint, of which a `report` tells at a look: the power [W] that Coulomb's law and its
    own take, the larger of both, and how far they are apart; and what its bristles take until they
    yield under the friction of this instant [J]."""
    columns = []
    for name, law in laws.items():
        reported = report(name)
        contacts = zip(reported.normal_force, reported.traction, reported.slip_speed, strict=True)
        powers = [_of_contact(law, *numbers) for numbers in contacts]
        columns.append(jnp.stack([sum(part) for part in zip(*powers, strict=True)]))
    return jnp.stack(columns, axis=1)


def _of_contact(law: Any, normal: Any, drag: Any, slip: Any) -> tuple[Any, Any, Any]:
    """The same of one contact, from normal force [N], friction [N] and slip [m/s]."""
    creep, settled = 0.0, 0.0
    if law.bristles:
        settled = drag * settling_length(law)
    else:
        # As the law begins, through rest: the slip at which its friction holds the contact.
        creep = safe_divide(drag, normal * law.largest_slope(0.0))
    slides = slip > creep
    fast = jnp.where(slides, slip, 1.0)
    coulombs = jnp.where(slides, normal * law.coulomb().bound(fast), drag) * slip
    loss = jnp.where(slides, normal * law.steady_coefficient(fast) * slip, drag * creep)
    return jnp.maximum(coulombs, loss), abs(coulombs - loss), settled


def coulomb_friction(
    looks: Float[Array, "looks 3 joints"], times: Float[Array, " looks"]
) -> Float[Array, " joints"]:
    """By joint the share of its friction loss that its own law takes and Coulomb's does not, or the
    other way round, from what was told by `power_by_coulomb` at looks at these times [s]."""
    power, other_loss, settled = (looks[:, k] for k in range(3))
    widths = jnp.diff(times)[:, None]
    over_run = lambda rate: jnp.sum(0.5 * widths * (rate[1:] + rate[:-1]), axis=0)
    yielded = settled[0] + jnp.sum(abs(jnp.diff(settled, axis=0)), axis=0)
    total, other = over_run(power) + yielded, over_run(other_loss) + yielded
    return safe_divide(other, jnp.maximum(total, NEGLIGIBLE * jnp.max(total, initial=0.0)))
