r"""How fast contacts answer, known before a run: from laws, loads and masses at the start.

A contact pressed by the force $F$ answers an indentation at the rate $\sqrt{k/m_n}$, $k$ the slope
of its elastic force; its damper at $c/m_n$; its friction, at rest, at $F \mu'/m_t$, $\mu'$ the
largest slope of the coefficient of friction over the slip. $1/m$ is the diagonal of Delassus'
operator, $J M^{-1} J^T$. An explicit step must resolve each of them. The force is that of the
impact with which the load at the start, taken over the times of a run, closes the clearance; the
damper's is the load itself, because dampers are the harder the slower an impact.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.components.clearance import ContactLaws
from jaxclear.formulations import delassus
from jaxclear.formulations.base import model_of
from jaxclear.formulations.compliant import CompliantContact
from jaxclear.formulations.contact_rows import free_motion, row_rates, split
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.multibody import contact_point, kinematics
from jaxclear.multibody.assembly import Start, ready
from jaxclear.multibody.closure_coordinates import angles_at_start
from jaxclear.multibody.kinematics import along
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.state import Followed, unpack_motion
from jaxclear.native.compiled import compiled_quickly

# Instants of a run at which its loads are looked at.
INSTANTS = 9
# Displacements [m] along which a contact is sought, and indentations [m] up to which its force is.
REACHES = np.logspace(-8, -1, 71)
DEPTHS = np.logspace(-10, -2, 161)
# Lightness [1/kg] of a contact that nothing can move.
LEAST_LIGHTNESS = 1e-12


class ContactRates(NamedTuple):
    """Rates of a clearance joint's hardest pressed contact: `contact` [rad/s] (that of its bristles
    where they are stiffer), `damping` [1/s] and `friction` [1/s], under the `force` [N] that closes
    the clearance."""

    force: Any
    contact: Any
    damping: Any
    friction: Any


class _Pressed(NamedTuple):
    """Of each contact of a joint, or of one: acceleration [m/s^2] that presses it and inverse of
    the mass [1/kg] along its normal and across; and how far [m] the joint must close."""

    acceleration: Any
    lightness: Any
    across: Any
    travel: Any


def contact_rates(mechanism: Mechanism, duration: float, step: float) -> dict[str, ContactRates]:
    """Rates of every clearance joint with a compliant law, estimated before a run.

    Args:
        mechanism: with numbers; it is assembled.
        duration: of the run [s].
        step: length over which friction with memory is taken [s].
    """
    # A drive takes its link to where the others, which stay at their start, cannot follow.
    times = np.zeros(1) if mechanism.driven else np.linspace(0.0, duration, INSTANTS)
    rates = _rates_of_joints(*ready(mechanism)[:2], times, np.asarray(step))
    return {name: ContactRates(*map(float, joint_rates)) for name, joint_rates in rates.items()}


def _contact_rates_of(laws: ContactLaws, pressed: _Pressed, step: Any) -> ContactRates:
    """Rates of a contact that is `pressed` through its clearance."""
    depths, lightness = jnp.asarray(DEPTHS), pressed.lightness
    forces = jax.vmap(laws.contact.elastic_force)(depths)
    work = jnp.cumsum(0.5 * (forces[1:] + forces[:-1]) * np.diff(DEPTHS))
    load = safe_divide(pressed.acceleration, lightness)
    resting = depths[jnp.minimum(jnp.searchsorted(forces, load), len(DEPTHS) - 1)]
    is_stopped = work >= load * (pressed.travel + depths[1:])
    deepest = jnp.minimum(1 + jnp.argmax(is_stopped), len(DEPTHS) - 2)
    deepest = jnp.where(jnp.any(is_stopped), deepest, len(DEPTHS) - 1)
    force, depth = forces[deepest], depths[deepest]
    stiffness = jax.grad(laws.contact.elastic_force)(depth)
    damping = jax.grad(laws.contact.normal_force, argnums=1)(resting, 0.0, 0.0)
    slope, spring = 0.0, 0.0
    if laws.friction is not None and not laws.friction.set_valued:
        slope, double = (laws.friction.largest_slope(n * step) for n in (1, 2))
        # Bristles are springs: their force over a step grows with half its length.
        spring = force * (double - slope) * 2 / step
    contact = jnp.sqrt(jnp.maximum(stiffness * lightness, spring * pressed.across))
    rates = force, contact, damping * lightness, force * slope * pressed.across
    is_pressed = (pressed.acceleration > 0) & (lightness > 0)
    return ContactRates(*(jnp.where(is_pressed, rate, 0.0) for rate in rates))


@compiled_quickly
def _rates_of_joints(
    mechanism: Mechanism, start: Start, times: Any, step: Any
) -> dict[str, ContactRates]:
    """By clearance joint the rates of the contact that is pressed hardest at the start, under the
    loads of each of these times."""
    model = model_of(mechanism, CompliantContact())
    q, v = unpack_motion(model.system, [*start.coordinates, *start.speeds])
    bearings = model.system.bearings

    def at(time):
        motions = kinematics.link_motions(model.system, q, v, time)
        angles = angles_at_start(mechanism, model.system, model.layout.angles, motions)
        now = free_motion(model, time, q, v, Followed(angles))
        free = delassus.delassus_operator(now, []).free
        return {
            name: _press_joint(bearing, model.system, motions, now, free)
            for name, bearing in bearings.items()
        }

    result = {}
    for name, pressed in jax.vmap(at)(times).items():
        loads = pressed.acceleration / jnp.maximum(pressed.lightness, LEAST_LIGHTNESS)
        *parts, travel = (part[jnp.argmax(jnp.max(loads, axis=1))] for part in pressed)
        rates = [
            _contact_rates_of(laws, _Pressed(*[*(part[k] for part in parts), travel]), step)
            for k, laws in enumerate(bearings[name].contact_laws)
            if laws.contact.compliant
        ]
        if rates:
            by_contact = ContactRates(*map(jnp.stack, zip(*rates, strict=True)))
            hardest = jnp.argmax(by_contact.force)
            result[name] = ContactRates(*(rate[hardest] for rate in by_contact))
    return result


def _press_joint(bearing, system, motions, now, free) -> _Pressed:
    """A joint moved until it touches, in the direction in which it is pressed."""
    relative = kinematics.relative_motion(bearing.closure, motions)[2]
    rows = kinematics.relative_jacobian(
        system, motions, bearing.closure, relative.pose, lambda pose, velocity, spin: velocity
    )
    pushed = [along(row, free) for row in rows]
    size = safe_sqrt(sp.total(sp.mul(x, x) for x in pushed))
    planar = sp.is_zero(relative.pose.translation[2])

    def moved(distance):
        shift = tuple(
            0 if planar and k == 2 else safe_divide(distance * x, size)
            for k, x in enumerate(pushed)
        )
        return relative.pose._replace(translation=sp.plus(relative.pose.translation, shift))

    overlaps = jax.vmap(lambda d: sp.stack(contact_point.depths(bearing.joint, moved(d), {})))(
        jnp.asarray(REACHES)
    )
    travel = jnp.asarray(REACHES)[jnp.argmax(jnp.max(overlaps, 1) > 0)]
    pose = moved(travel)
    gaps = contact_point.gap_function(bearing.joint, pose, {})
    rates = lambda *moving: row_rates(bearing.joint, gaps, *moving)
    rows = kinematics.relative_jacobian(system, motions, bearing.closure, pose, rates)
    operator = delassus.delassus_operator(now, rows)
    directions = [len(gap.candidate.tangents) for gap in gaps]
    lightness, across = zip(*operator.lightness(directions), strict=True)
    normals = [row for row, *_ in split(rows, [1 + count for count in directions])]
    pressing = [
        jnp.where(gap.indentation > 0, along(row, free), 0.0)
        for gap, row in zip(gaps, normals, strict=True)
    ]
    return _Pressed(sp.stack(pressing), sp.stack(lightness), sp.stack(across), travel)
