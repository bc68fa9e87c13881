r"""How contacts slide over an implicit step: at which instant of it friction is taken, and how far
they slide.

Friction that brakes a slip within less than a step is stiff: taken in the middle of the step it
lets the slip ring instead of decay. It is taken as late as that asks for, $\theta = 1 - 1/z$ of the
step, $z$ the share of the slip that it brakes in a step, at which the theta method's amplification
$(1 - (1 - \theta) z)/(1 + \theta z)$ is 0: Hairer & Wanner 1996, Solving Ordinary Differential
Equations II, ch. IV.3, doi:10.1007/978-3-642-05221-7. Slip is measured along the directions in the
middle of the step; a sliding direction turns with the contact's normal, and slip that is to be 0 at
the end is not 0 along the direction in the middle.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxclear.components.clearance import ContactLaws
from jaxclear.formulations.contact_rows import MiddleOfStep
from jaxclear.ground import sparse as sp
from jaxclear.multibody.contact_point import slip_speed
from jaxclear.multibody.kinematics import along


class Braking(NamedTuple):
    """When a contact's friction is taken: after the share `theta` [1] of the step, `reach` [s]
    after its start; and the slip that a unit of friction takes away by then (`yielding`
    [m/(N s)])."""

    theta: Any
    reach: Any
    yielding: Any


class SlipAtStart(NamedTuple):
    """Slip [m/s] in one sliding direction as a step begins: along the direction in the middle of
    the step (`along`), along its own (`own`), and by how much the slip at the end of the step will
    be more along the direction that is then than along the one in the middle (`turn`);
    `traction` [N]: that of the step before."""

    along: Any
    own: Any
    turn: Any
    traction: Any


class PastSlip(NamedTuple):
    """What a step hands on of one sliding direction: friction [N], and the slip at its end along
    the direction in its middle (`along`) and along the one at its end (`own`)."""

    traction: Any
    along: Any
    own: Any


def braking(laws: ContactLaws, h: Any, bias: Any, depth: Any, lightnesses: list) -> Braking | None:
    """When friction is taken in a step of length `h` [s], in a contact that is to become about
    `depth` deep, and in which unit forces along the sliding directions cause accelerations of about
    `lightnesses` [1/kg]. None without friction."""
    if laws.friction is None or not lightnesses:
        return None
    lightness = sp.total(lightnesses) / len(lightnesses)
    strength = laws.contact.elastic_force(depth) * laws.friction.largest_slope(h)
    braked = h * lightness * strength
    theta = jnp.maximum(0.5 * (1 + bias), 1 - 1 / jnp.maximum(braked, 1.0))
    return Braking(theta, theta * h, theta * h * lightness)


def slips(middle: MiddleOfStep, speeds: list) -> list[tuple]:
    """Of each contact, the slip along its sliding directions in the middle of a step, at given
    speeds; () where nothing rubs."""
    change = middle.change_to(speeds)
    return [
        tuple(
            sp.add(rate, along(row, change))
            for rate, row in zip(
                point.rates[1 : point.active], point.rows[1 : point.active], strict=True
            )
        )
        for point in middle.free_motion.contacts
    ]


def at_start(now: tuple, past: tuple, depth: Any) -> tuple[SlipAtStart, ...]:
    """The slip of a contact of indentation `depth` [m] as a step begins; `now`: along the
    directions in the middle of the step.

    From the middle of the last step to that of this one a direction has turned; until the end of
    this one it turns half as far again.
    """
    out = []
    for slip, last in zip(now, past, strict=True):
        turn = jnp.where(depth > 0, 0.5 * sp.sub(slip, last.along), 0.0)
        own = jnp.where(depth > 0, last.own, slip)
        out.append(SlipAtStart(slip, own, turn, last.traction))
    return tuple(out)


def unhindered(slip: SlipAtStart, braking: Braking, acceleration: Any) -> Any:
    """Slip [m/s] at the instant at which friction is taken, without contact: `acceleration`
    [m/s^2]."""
    turned = (2 * braking.theta - 1) * slip.turn
    return slip.along + turned + braking.reach * acceleration


def at_end(start: tuple, braking: Braking | None, taken: tuple) -> tuple:
    """Slip of a contact at the end of a step along the directions in its middle; `taken`: at the
    instant at which friction is taken."""
    if braking is None:
        return ()
    lengthened = 1 / braking.theta
    return tuple(
        s.along + lengthened * (slip - s.along - (2 * braking.theta - 1) * s.turn)
        for s, slip in zip(start, taken, strict=True)
    )


def handed_on(start: tuple, end: tuple, tractions: tuple) -> tuple[PastSlip, ...]:
    """What a step hands on of a contact; `end`: slip at its end along the directions in its
    middle."""
    return tuple(
        PastSlip(traction, slip, slip + s.turn)
        for s, slip, traction in zip(start, end, tractions, strict=True)
    )


def mean_slip(start: tuple, end: tuple) -> tuple:
    """Mean slip of a contact over a step, along its directions as they turn."""
    return tuple(0.5 * (s.own + slip + s.turn) for s, slip in zip(start, end, strict=True))


def wearing_speed(laws: ContactLaws, slip: tuple, normal: Any, tractions: tuple) -> Any:
    """Speed [m/s] that times the step is the distance over which a contact has rubbed, with mean
    slip `slip`: where friction has stopped it within the step, only as long as it took."""
    speed = slip_speed(slip)
    return speed * laws.friction.acting_share(normal, slip_speed(tractions), speed)
