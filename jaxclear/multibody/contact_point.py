"""One clearance joint at one instant: from relative motion to forces, rates of the laws' memories
and lost material.

Normal forces act along the gradient of the indentation with respect to the relative displacement,
so normal power is exactly -F_n d(delta)/dt, worn and tilted surfaces included. Friction acts at the
point of contact, against the relative velocity of the two material points there.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.components.clearance import AbstractClearance, ContactCandidate, ContactLaws
from jaxclear.ground import sparse as sp
from jaxclear.ground.grouping import traced_once
from jaxclear.ground.numerics import rounded_norm, safe_sqrt
from jaxclear.ground.pose import Pose
from jaxclear.multibody.counted_laws import laws_as_counted
from jaxclear.multibody.loops import Relative
from jaxclear.multibody.worn_laws import laws_now

# Slip speeds are rounded here [m/s]: far below any transition speed, only so that the direction of
# slip exists at rest.
SLIP_ROUNDING = 1e-14


class PointState(NamedTuple):
    """What one possible contact remembers: speed of first touch [m/s], 0 while apart, and bristle
    deflections [m], where its laws do. `share`: whether it counts as closed (`counted_laws`; None:
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


class Response(NamedTuple):
    """What the laws answer at one contact: normal force [N], sliding speed [m/s], friction [N]
    along each sliding direction, rates of the memory."""

    normal: Any
    slip_speed: Any
    tractions: tuple
    memory_rates: PointState


def evaluate(
    joint: AbstractClearance,
    contact_laws: tuple[ContactLaws, ...],
    relative: Relative,
    memory: tuple[PointState, ...],
    worn: dict[str, Any],
) -> JointReport:
    """Forces of a clearance joint; `worn` are the depth maps that feed back into the gap."""
    pose, velocity, spin = relative
    gap_functions = gap_function(joint, pose, worn)
    shares = tuple(state.share for state in memory)
    contact_laws = laws_as_counted(laws_at(joint, contact_laws, pose, worn), shares)
    speeds, responses = [], []
    for laws, contact, state in zip(contact_laws, gap_functions, memory, strict=True):
        rate, slip = contact_speeds(joint, pose, contact, velocity, spin)
        impact_speed = impact_speed_now(state.impact_speed, rate)
        normal = laws.contact.normal_force(contact.indentation, rate, impact_speed)
        speed, tractions, bristle_rates = slip_speed(slip), (), ()
        if laws.friction is not None:
            tractions, bristle_rates = laws.friction.tractions(normal, state.bristles, slip, speed)
        # Steps set the impact speed where a contact closes; it has no rate.
        standing = None if state.impact_speed is None else 0.0
        speeds.append((rate, slip))
        responses.append(Response(normal, speed, tractions, PointState(standing, bristle_rates)))
    return assemble(joint, contact_laws, pose, gap_functions, tuple(speeds), tuple(responses))


def impact_speed_now(remembered: Any, rate: Any) -> Any:
    """Impact speed [m/s] that a law is given: the remembered one, or, in the step in which the
    contact closes, the rate of the moment."""
    if remembered is None:
        return None
    return jnp.where(remembered > 0, remembered, jnp.abs(rate))


@traced_once
def gap_function(
    joint: AbstractClearance, pose: Pose, worn: dict[str, Any]
) -> tuple[GapFunction, ...]:
    """Geometry of every possible contact of a joint."""
    offset, axes = pose.translation, _axes(joint, pose)
    indentations, gradients = _indentations(joint, offset, axes, worn)
    candidates = joint.contact_candidates(offset, axes, indentations)
    found = []
    for overlap, (slope, turns), candidate in zip(indentations, gradients, candidates, strict=True):
        found.append(GapFunction(overlap, slope, turns, candidate))
    return tuple(found)


def laws_at(
    joint: AbstractClearance, fitted: tuple[ContactLaws, ...], pose: Pose, worn: dict[str, Any]
) -> tuple[ContactLaws, ...]:
    """Laws of every possible contact of a joint, from those of its shape as made."""
    return laws_now(joint, fitted, pose.translation, _axes(joint, pose), worn)


def depths(joint: AbstractClearance, pose: Pose, worn: dict[str, Any]) -> tuple:
    """Indentation of every possible contact of a joint [m]."""
    return joint.indentations(pose.translation, _axes(joint, pose), worn)


def indentation_rates(joint: AbstractClearance, relative: Relative, worn: dict) -> tuple:
    """(indentation [m], its rate [m/s]) of every possible contact of a joint."""
    pose, velocity, spin = relative
    contacts = gap_function(joint, pose, worn)
    return tuple(
        (contact.indentation, contact_speeds(joint, pose, contact, velocity, spin)[0])
        for contact in contacts
    )


def contact_speeds(
    joint: AbstractClearance, pose: Pose, contact: GapFunction, velocity: sp.Vec, spin: sp.Vec
) -> tuple[Any, tuple]:
    """(rate of the indentation, components of slip) for a relative velocity and spin: linear in
    both, so it also gives the rows of the contact's Jacobian from the twists of unit speeds."""
    rate = sp.dot(contact.slope, velocity)
    for axis, turn in zip(_axes(joint, pose), contact.axis_slopes, strict=True):
        rate = sp.add(rate, sp.dot(turn, sp.cross(spin, axis)))
    # Velocity of the journal's material point in contact, seen from the bearing.
    arm = sp.minus(contact.candidate.place, pose.translation)
    across = contact.candidate.tangential(sp.plus(velocity, sp.cross(spin, arm)))
    return rate, tuple(sp.dot(across, tangent) for tangent in contact.candidate.tangents)


def slip_speed(slip: tuple) -> Any:
    """Sliding speed [m/s] from its components."""
    return rounded_norm(*[s for s in slip if not sp.is_zero(s)], width=SLIP_ROUNDING)


def assemble(
    joint: AbstractClearance,
    contact_laws: tuple[ContactLaws, ...],
    pose: Pose,
    gap_functions: tuple[GapFunction, ...],
    speeds: tuple[tuple[Any, tuple], ...],
    responses: tuple[Response, ...],
) -> JointReport:
    """The joint's report from the geometry, the speeds and the laws' responses at each contact."""
    offset, axes = pose.translation, _axes(joint, pose)
    force, torque, powers, reports = sp.ZERO, sp.ZERO, [], []
    each = zip(contact_laws, gap_functions, speeds, responses, strict=True)
    for laws, contact, (rate, slip), response in each:
        normal, candidate = response.normal, contact.candidate
        traction = sp.ZERO
        # Without friction there are no tractions.
        for size, tangent in zip(response.tractions, candidate.tangents, strict=False):
            traction = sp.plus(traction, sp.scale(size, tangent))
        if response.memory_rates.bristles:
            traction = candidate.tangential(traction)
        force = sp.plus(force, sp.scale(-normal, contact.slope), traction)
        torques = []
        for axis, turn in zip(axes, contact.axis_slopes, strict=True):
            torques.append(sp.scale(-normal, sp.cross(axis, turn)))
        arm = sp.minus(candidate.place, offset)
        torque = sp.plus(torque, *torques, sp.cross(arm, traction))
        elastic = laws.contact.elastic_force(contact.indentation)
        drag = 0.0 if laws.friction is None else safe_sqrt(sp.dot(traction, traction))
        loss = sp.neg(sp.dot(response.tractions, slip)) if response.tractions else 0
        powers.append((normal * rate, (normal - elastic) * rate, loss))
        felt = (normal, response.slip_speed, drag)
        reports.append(PointReport(contact.indentation, rate, *felt, candidate.place, elastic))
    indentations = tuple(contact.indentation for contact in gap_functions)
    wear_rates = _wear_rates(joint, contact_laws, offset, axes, indentations, reports)
    sums = [sp.total(parts) for parts in zip(*powers, strict=True)]
    rates = tuple(response.memory_rates for response in responses)
    contact_power, contact_loss, friction_loss = sums
    return JointReport(
        force,
        torque,
        rates,
        wear_rates,
        contact_power,
        contact_loss,
        friction_loss,
        tuple(reports),
    )


def _axes(joint, pose):
    """Those axes of the journal's marker on which the gap depends, in the bearing's axes."""
    return tuple(sp.transpose(pose.rotation)[k] for k in joint.axes)


def _indentations(joint, offset, axes, worn):
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
        (found,) = backwards(jnp.ones_like(values[k]))
        slopes = [0] * len(leaves)
        for i, slope in zip(varying, found, strict=True):
            slopes[i] = slope
        gradients.append(jax.tree.unflatten(structure, slopes))
    return values, gradients


def _wear_rates(joint, contact_laws, offset, axes, indentations, reports):
    """For each surface and each contact that wears it: (volume rate, location features)."""
    rates = {}
    for surface, (_, wearing) in joint.maps().items():
        entries = []
        for k, (laws, report) in enumerate(zip(contact_laws, reports, strict=True)):
            if laws.wears:
                volume = wearing.law.volume_rate(
                    report.normal_force, report.slip_speed, report.traction
                )
                features = joint.features(surface, offset, axes, indentations, k)
                entries.append((wearing.acceleration * volume, features))
        rates[surface] = tuple(entries)
    return rates
