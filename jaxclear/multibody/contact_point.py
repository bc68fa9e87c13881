"""One clearance joint at one instant: from relative motion to forces, rates of the laws' memories
and lost material.

Normal forces act along the gradient of the indentation with respect to the relative displacement,
so normal power is exactly -F_n d(delta)/dt, worn and tilted surfaces included. Friction acts at the
point of contact, against the relative velocity of the two material points there.

A contact may be told whether it counts as closed (`integrators.saltation`). Where a surface asks
for it (`Wearing.worn_radius`) laws are fitted anew to the radii at the contact: a bearing or socket
worn by h has R + h there, a journal or ball R - h, and the clearance grows by both. Source: Hou,
Deng & Zeng 2021, J. Cent. South Univ. 28, 712, doi:10.1007/s11771-021-4640-y.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.components.clearance import AbstractClearance, ContactCandidate, ContactLaws
from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import share_trace
from jaxclear.ground.numerics import rounded_norm, safe_sqrt
from jaxclear.ground.pose import Pose
from jaxclear.laws.friction.base import AbstractForceFriction
from jaxclear.laws.stiffness import AbstractFit, Shape, fitted
from jaxclear.multibody.loops import Relative

# A force [N] beside which no other is anything, by which a contact that counts as closed presses.
LEAST_FORCE = 1e-30


def _weigh_force(share: Any, force: Any) -> Any:
    """A force of a contact of which a share acts; None: as it is."""
    return force if share is None else share * force


def _friction_forces(
    law: AbstractForceFriction, normal: Any, state: "PointState", slip: tuple, speed: Any
) -> tuple[tuple, tuple]:
    """(tractions, rates of the bristles) of a contact; of one of which a share acts, bristles of
    the rest straighten."""
    if state.share is None:
        return law.tractions(normal, state.bristles, slip, speed)
    pressed = jnp.where(normal > 0, normal, LEAST_FORCE + normal)
    tractions, closed = law.tractions(pressed, state.bristles, slip, speed)
    _, open_rates = law.tractions(jnp.zeros_like(pressed), state.bristles, slip, speed)
    rates = (a + state.share * (b - a) for a, b in zip(open_rates, closed, strict=True))
    return tractions, tuple(rates)


def fitted_laws(joint: AbstractClearance) -> tuple[ContactLaws, ...]:
    """Laws of each possible contact of a joint as its unworn shape has them; with those before
    fitting where a surface counts with its worn radius."""
    follows = any(wearing.worn_radius for _, wearing in joint.maps().values())
    return tuple(
        laws._replace(
            contact=fitted(laws.contact, laws.shape),
            unfitted=laws.contact if follows and laws.wears else None,
        )
        for laws in joint.contact_laws()
    )


def check_followed(joint: AbstractClearance) -> None:
    """Raises `ValueError`, with a sentence that goes behind the joint's name, where a surface
    counts with its worn radius and no contact law there takes a number from the radii."""
    follows = [name for name, (_, wearing) in joint.maps().items() if wearing.worn_radius]
    fits = (
        isinstance(node, AbstractFit) and _needs_radii(node, laws.shape)
        for laws in joint.contact_laws()
        if laws.wears
        for node in jax.tree.leaves(laws.contact, is_leaf=lambda x: isinstance(x, AbstractFit))
    )
    if follows and not any(fits):
        raise ValueError(
            f"the wear of its {follows[0]} has worn_radius=True, but no number of its contact law "
            "follows from the radii, so nothing would change; give the law such a number "
            "(stiffness=jaxclear.stiffness.HertzStiffness(...), say) or leave worn_radius out."
        )


def _needs_radii(fit: AbstractFit, shape: Shape) -> bool:
    """Whether a number follows from the radii: not from the materials or the length alone."""
    value = lambda inner, outer: fit.value(Shape(inner, outer, shape.length))
    program = jax.make_jaxpr(value)(shape.inner_radius, shape.outer_radius).jaxpr
    used = [x for equation in program.eqns for x in equation.invars] + program.outvars
    return any(x is radius for x in used for radius in program.invars)


def laws_now(
    joint: AbstractClearance,
    laws: tuple[ContactLaws, ...],
    offset: sp.Vec,
    axes: tuple[sp.Vec, ...],
    worn: dict[str, Any],
) -> tuple[ContactLaws, ...]:
    """The laws at each possible contact, refitted to worn radii where these count.

    Args:
        joint: clearance joint; its maps say whether the worn radius counts.
        laws: at each possible contact, fitted to the unworn shape.
        offset: journal's marker in the bearing's frame [m].
        axes: journal's axes on which the gap depends, unit vectors in the bearing's axes.
        worn: depth maps [m] by surface.
    """
    counted = [name for name, (_, w) in joint.maps().items() if w.worn_radius and name in worn]
    if not counted:
        return laws
    unworn = joint.indentations(offset, axes, {})
    outer: list[Any] = [0.0] * len(laws)
    inner: list[Any] = [0.0] * len(laws)
    for name in counted:
        of_part = inner if name in joint.inner_surfaces() else outer
        there = joint.indentations(offset, axes, {name: worn[name]})
        for k, (before, after) in enumerate(zip(unworn, there, strict=True)):
            of_part[k] = of_part[k] + before - after
    result = []
    for law, outer_loss, inner_loss in zip(laws, outer, inner, strict=True):
        if law.unfitted is not None:
            shape = law.shape
            radii = shape.inner_radius - inner_loss, shape.outer_radius + outer_loss
            law = law._replace(contact=fitted(law.unfitted, Shape(*radii, shape.length)))
        result.append(law)
    return tuple(result)


# Slip speeds are rounded here [m/s]: far below any transition speed, only so that the direction of
# slip exists at rest.
SLIP_ROUNDING = 1e-14


class PointState(NamedTuple):
    """What one possible contact remembers: speed of first touch [m/s], 0 while apart, and bristle
    deflections [m], where its laws do. `share`: whether it counts as closed (`saltation`; None:
    as its indentation has it).
    """

    impact_speed: Any
    bristles: tuple
    share: Any = None


class PointReport(NamedTuple):
    """One possible contact at an instant, SI units; slip and traction along its sliding
    directions; `elastic_force`: the part of the normal force that is stored, by the law as worn.
    """

    indentation: Any
    rate: Any
    normal_force: Any
    slip_speed: Any
    traction: Any
    place: sp.Vec
    elastic_force: Any


class JointReport(NamedTuple):
    """A clearance joint at an instant: wrench on the journal about its marker in the bearing's
    axes, rates and powers.
    """

    force: sp.Vec
    torque: sp.Vec
    memory_rates: tuple[PointState, ...]
    wear_rates: dict[str, tuple]
    contact_power: Any
    contact_loss: Any
    friction_loss: Any
    points: tuple[PointReport, ...]


def memory_template(laws: ContactLaws, candidate: ContactCandidate) -> PointState:
    """Initial memory of a contact: nothing remembered, straight bristles; `None` and () where a law
    has no memory.
    """
    law = laws.friction
    bristles = () if law is None else (0.0,) * (law.bristles * len(candidate.tangents))
    return PointState(0.0 if laws.contact.remembers_impact_speed else None, bristles)


class GapFunction(NamedTuple):
    """Geometry of one possible contact: its overlap [m], the overlap's gradient by the offset [1]
    and by each axis [m], and where it is.
    """

    indentation: Any
    slope: sp.Vec
    axis_slopes: tuple[sp.Vec, ...]
    candidate: ContactCandidate


class ActingContact(NamedTuple):
    """A contact with the forces that act in it: normal [N], pushing apart, of which a part is
    `elastic`, and friction [N] on the journal along each sliding direction, at its rates (of the
    indentation, then of slip); what its laws remember, or its rates; where they are not those of
    the slip and the gap, the speed [m/s] with which it wears and the indentation [m] at which its
    extent is read."""

    laws: ContactLaws
    gap_function: GapFunction
    rates: tuple
    normal: Any
    tractions: tuple
    elastic: Any
    memory: PointState = PointState(None, ())
    slid: Any = None
    pressed: Any = None


def evaluate(
    joint: AbstractClearance,
    contact_laws: tuple[ContactLaws, ...],
    relative: Relative,
    memory: tuple[PointState, ...],
    worn: dict[str, Any],
) -> JointReport:
    """Forces, memory rates and wear rates of a clearance joint at one instant.

    Args:
        joint: geometry of the clearance.
        contact_laws: one for each possible contact, fitted to the shape as made.
        relative: motion of the journal as seen from the bearing, in its axes.
        memory: impact speed and bristles of each possible contact.
        worn: depth maps [m] by surface that feed back into the gap.
    """
    pose, velocity, spin = relative
    gap_functions, acting = gap_function(joint, pose, worn), []
    contact_laws = laws_at(joint, contact_laws, pose, worn)
    for laws, contact, state in zip(contact_laws, gap_functions, memory, strict=True):
        rate, slip = contact_speeds(joint, pose, contact, velocity, spin)
        impact_speed = impact_speed_now(state.impact_speed, rate)
        normal = laws.contact.normal_force(contact.indentation, rate, impact_speed)
        normal = _weigh_force(state.share, normal)
        speed, tractions, bristle_rates = slip_speed(slip), (), ()
        if laws.friction is not None:
            tractions, bristle_rates = _friction_forces(laws.friction, normal, state, slip, speed)
        elastic = _weigh_force(state.share, laws.contact.elastic_force(contact.indentation))
        # Steps set the impact speed where a contact closes; it has no rate.
        standing = None if state.impact_speed is None else 0.0
        remembered, rates = PointState(standing, bristle_rates), (rate, *slip)
        acting.append(
            ActingContact(
                laws, contact, rates, normal, tuple(tractions), elastic, remembered, speed
            )
        )
    return assemble(joint, pose, acting)


def impact_speed_now(remembered: Any, rate: Any) -> Any:
    """Impact speed [m/s] that a law is given: the remembered one, or, in the step in which the
    contact closes, the rate of the moment."""
    if remembered is None:
        return None
    return jnp.where(remembered > 0, remembered, jnp.abs(rate))


@share_trace
def gap_function(
    joint: AbstractClearance, pose: Pose, worn: dict[str, Any]
) -> tuple[GapFunction, ...]:
    """Geometry of every possible contact of a joint: overlap, its gradients, place.

    Args:
        joint: geometry of the clearance.
        pose: journal's marker in the bearing's frame.
        worn: depth maps [m] by surface; empty: new surfaces.
    """
    offset, axes = pose.translation, _axes_of_gap(joint, pose)
    indentations, gradients = _indentations_with_gradients(joint, offset, axes, worn)
    candidates = joint.contact_candidates(offset, axes, indentations)
    result = []
    for overlap, (slope, turns), candidate in zip(indentations, gradients, candidates, strict=True):
        result.append(GapFunction(overlap, slope, turns, candidate))
    return tuple(result)


def laws_at(
    joint: AbstractClearance, fitted: tuple[ContactLaws, ...], pose: Pose, worn: dict[str, Any]
) -> tuple[ContactLaws, ...]:
    """The laws of every possible contact of a joint, refitted to its worn radii.

    Args:
        joint: geometry of the clearance.
        fitted: the laws fitted to the shape as made.
        pose: journal's marker in the bearing's frame.
        worn: depth maps [m] by surface.
    """
    return laws_now(joint, fitted, pose.translation, _axes_of_gap(joint, pose), worn)


def depths(joint: AbstractClearance, pose: Pose, worn: dict[str, Any]) -> tuple:
    """Indentation of every possible contact of a joint [m], negative where open.

    Args:
        joint: geometry of the clearance.
        pose: journal's marker in the bearing's frame.
        worn: depth maps [m] by surface; empty: new surfaces.
    """
    return joint.indentations(pose.translation, _axes_of_gap(joint, pose), worn)


def point_motions(joint: AbstractClearance, relative: Relative, worn: dict) -> tuple:
    """(indentation [m], its rate [m/s], components of slip [m/s]) of every possible contact.

    Args:
        joint: geometry of the clearance.
        relative: motion of the journal as seen from the bearing, in its axes.
        worn: depth maps [m] by surface; empty: new surfaces.
    """
    pose, velocity, spin = relative
    contacts = gap_function(joint, pose, worn)
    return tuple(
        (contact.indentation, *contact_speeds(joint, pose, contact, velocity, spin))
        for contact in contacts
    )


def contact_speeds(
    joint: AbstractClearance, pose: Pose, contact: GapFunction, velocity: sp.Vec, spin: sp.Vec
) -> tuple[Any, tuple]:
    """(rate of the indentation, components of slip) [m/s], linear in velocity and spin.

    With twists of unit speeds it also gives the rows of the contact's Jacobian.

    Args:
        joint: geometry of the clearance.
        pose: journal's marker in the bearing's frame.
        contact: gradients and place of the contact at this pose.
        velocity: of the journal's marker as seen from the bearing, in its axes [m/s].
        spin: relative angular velocity in the bearing's axes [rad/s].
    """
    rate = sp.dot(contact.slope, velocity)
    for axis, turn in zip(_axes_of_gap(joint, pose), contact.axis_slopes, strict=True):
        rate = sp.add(rate, sp.dot(turn, sp.cross(spin, axis)))
    # Velocity of the journal's material point in contact, seen from the bearing.
    arm = sp.minus(contact.candidate.place, pose.translation)
    across = contact.candidate.tangential(sp.plus(velocity, sp.cross(spin, arm)))
    return rate, tuple(sp.dot(across, tangent) for tangent in contact.candidate.tangents)


def slip_speed(slip: tuple) -> Any:
    """Sliding speed [m/s] from its components."""
    return rounded_norm(*[s for s in slip if not sp.is_zero(s)], width=SLIP_ROUNDING)


def assemble(
    joint: AbstractClearance, pose: Pose, contacts: Sequence[ActingContact]
) -> JointReport:
    """A clearance joint's report: the sum of its contacts' wrenches, powers and wear rates.

    Args:
        joint: geometry of the clearance.
        pose: journal's marker in the bearing's frame.
        contacts: every possible contact with its forces.
    """
    offset, axes = pose.translation, _axes_of_gap(joint, pose)
    force, torque, powers = sp.ZERO, sp.ZERO, list[tuple]()
    reports: list[PointReport] = []
    for laws, contact, (rate, *slip), normal, tractions, elastic, memory, slid, _ in contacts:
        candidate, traction = contact.candidate, sp.ZERO
        # Without friction there are no tractions.
        for size, tangent in zip(tractions, candidate.tangents, strict=False):
            traction = sp.plus(traction, sp.scale(size, tangent))
        if memory.bristles:
            traction = candidate.tangential(traction)
        force = sp.plus(force, sp.scale(-normal, contact.slope), traction)
        torques = []
        for axis, turn in zip(axes, contact.axis_slopes, strict=True):
            torques.append(sp.scale(-normal, sp.cross(axis, turn)))
        arm = sp.minus(candidate.place, offset)
        torque = sp.plus(torque, *torques, sp.cross(arm, traction))
        drag = 0.0 if laws.friction is None else safe_sqrt(sp.dot(traction, traction))
        loss = sp.neg(sp.dot(tractions, slip)) if tractions else 0
        powers.append((normal * rate, (normal - elastic) * rate, loss))
        felt = (normal, slip_speed(tuple(slip)) if slid is None else slid, drag)
        reports.append(PointReport(contact.indentation, rate, *felt, candidate.place, elastic))
    wear_rates = _wear_rates(joint, offset, axes, contacts, reports)
    sums = [sp.total(parts) for parts in zip(*powers, strict=True)]
    rates = tuple(contact.memory for contact in contacts)
    contact_power, contact_loss, friction_loss = sums
    return JointReport(
        force, torque, rates, wear_rates, contact_power, contact_loss, friction_loss, tuple(reports)
    )


def _axes_of_gap(joint, pose):
    """Those axes of the journal's marker on which the gap depends, in the bearing's axes."""
    return tuple(sp.transpose(pose.rotation)[k] for k in joint.axes)


def _indentations_with_gradients(joint, offset, axes, worn):
    """Indentations and, for each, its gradient by the offset and by each axis, with structural
    zeros kept.
    """
    leaves, structure = jax.tree.flatten((offset, axes))
    varying = [i for i, leaf in enumerate(leaves) if not isinstance(leaf, int)]

    def overlaps(arrays):
        filled = list(leaves)
        for i, array in zip(varying, arrays, strict=True):
            filled[i] = array
        return joint.indentations(*jax.tree.unflatten(structure, filled), worn)

    arrays = [leaves[i] for i in varying]
    # All are gone through once, then backwards from each.
    values, changes = jax.linearize(overlaps, arrays)
    gradients = []
    for k in range(len(values)):
        backwards = jax.linear_transpose(lambda moved, k=k: changes(moved)[k], arrays)
        (gradient,) = backwards(jnp.ones_like(values[k]))
        slopes = [0] * len(leaves)
        for i, slope in zip(varying, gradient, strict=True):
            slopes[i] = slope
        gradients.append(jax.tree.unflatten(structure, slopes))
    return values, gradients


def _wear_rates(joint, offset, axes, contacts, reports):
    """For each surface and each contact that wears it: (volume rate, location features)."""
    indentations = tuple(
        c.gap_function.indentation if c.pressed is None else c.pressed for c in contacts
    )
    rates = {}
    for surface, (_, wearing) in joint.maps().items():
        entries = []
        for k, (contact, report) in enumerate(zip(contacts, reports, strict=True)):
            if contact.laws.wears:
                volume = wearing.law.volume_rate(
                    report.normal_force, report.slip_speed, report.traction
                )
                features = joint.features(surface, offset, axes, indentations, k)
                entries.append((wearing.acceleration * volume, features))
        rates[surface] = tuple(entries)
    return rates
