r"""Contact laws over a step: the normal force that does the work of the law, friction made linear,
and what the laws remember.

Forces along a contact's rows are functions of the rows' mean rates over the step, $p = p_0 - D
(\dot r - \dot r_0)$ about given rates $\dot r_0$. The normal force is the mean of the law over the
indentations passed through, so that it does the work of the law (a discrete gradient): Gonzalez
1996, J. Nonlinear Sci. 6, 449, doi:10.1007/BF02440162; for contact Laursen & Chawla 1997, Int. J.
Numer. Methods Eng. 40, 863.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.components.clearance import ContactLaws
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part, safe_divide, safe_sqrt
from jaxclear.laws.friction.base import Unhindered
from jaxclear.multibody import contact_point
from jaxclear.multibody.contact_point import PointState, slip_speed


class Braking(NamedTuple):
    """When a contact's friction is taken: after the share `theta` [1] of the step, `reach` [s]
    after its start; and the slip that a unit of friction takes away by then (`yielding`
    [m/(N s)])."""

    theta: Any
    reach: Any
    yielding: Any


class SlipAtStart(NamedTuple):
    """Slip [m/s] in one sliding direction as a step begins: along the direction in the middle of
    the step (`along`), along the direction at the start (`current`), and by how much more the slip
    at the end of the step will be along the direction there than along the one in the middle
    (`turn`); `traction` [N]: that of the step before."""

    along: Any
    current: Any
    turn: Any
    traction: Any


class PastSlip(NamedTuple):
    """What a step hands on of one sliding direction: friction [N], and the slip at its end along
    the direction in its middle (`along`) and along the one at its end (`current`)."""

    traction: Any
    along: Any
    current: Any


def braking(laws: ContactLaws, h: Any, bias: Any, depth: Any, lightnesses: list) -> Braking | None:
    """When friction is taken in a step of length `h` [s], in a contact that is to become about
    `depth` deep, and in which unit forces along the sliding directions cause accelerations of about
    `lightnesses` [1/kg]. None without friction."""
    if laws.friction is None or not lightnesses:
        return None
    lightness = sp.total(lightnesses) / len(lightnesses)
    strength = laws.contact.elastic_force(depth) * laws.friction.largest_slope(h)
    braked = h * lightness * strength
    theta = taken_after(bias, braked)
    return Braking(theta, theta * h, theta * h * lightness)


def taken_after(bias: Any, braked: Any) -> Any:
    """The share of a step after which friction is taken that would brake, at its steepest, so much
    of a slip in it [1]."""
    return jnp.maximum(0.5 * (1 + bias), 1 - 1 / jnp.maximum(braked, 1.0))


def at_start(now: tuple, past: tuple, depth: Any) -> tuple[SlipAtStart, ...]:
    """The slip of a contact of indentation `depth` [m] as a step begins; `now`: along the
    directions in the middle of the step.

    From the middle of the last step to that of this one a direction has turned; until the end of
    this one it turns half as far again.
    """
    out = []
    for slip, last in zip(now, past, strict=True):
        turn = jnp.where(depth > 0, 0.5 * sp.sub(slip, last.along), 0.0)
        current = jnp.where(depth > 0, last.current, slip)
        out.append(SlipAtStart(slip, current, turn, last.traction))
    return tuple(out)


def unhindered(slip: SlipAtStart, braking: Braking, acceleration: Any) -> Any:
    """Slip [m/s] at the instant at which friction is taken, without contact: `acceleration`
    [m/s^2]."""
    turning = (2 * braking.theta - 1) * slip.turn
    return slip.along + turning + braking.reach * acceleration


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
    return tuple(0.5 * (s.current + slip + s.turn) for s, slip in zip(start, end, strict=True))


def wearing_speed(laws: ContactLaws, slip: tuple, normal: Any, tractions: tuple) -> Any:
    """Speed [m/s] that times the step is the distance over which a contact has rubbed, with mean
    slip `slip`: where friction has stopped it within the step, only as long as it took."""
    speed = slip_speed(slip)
    return speed * laws.friction.acting_share(normal, slip_speed(tractions), speed)


class Averaging(NamedTuple):
    """How forces are averaged over a step: its length [s], and its bias: 0 averages contact forces
    over the step, 1 takes them at its end (in between the theta method's 2 theta - 1).
    """

    length: Any
    bias: Any

    @property
    def reach(self) -> Any:
        """Change of a mean rate by the acceleration that contact adds [s]."""
        return 0.5 * (1 + self.bias) * self.length

    @property
    def reaches(self) -> tuple[Any, Any]:
        """That, and the same of an acceleration without contact [s]."""
        return self.reach, 0.5 * self.length


def mean_force(
    laws: ContactLaws, memory: PointState, averaging: Averaging, depth: Any, rate: Any
) -> Any:
    """Normal force that, over the step from the indentation `depth` on, does the work of the law
    along the way.

    The mean of the law over the indentations passed through, by Radau's rule (right end and a third
    before the left), times the share of the way in contact; moved towards the force at the end by
    `averaging.bias`, which can only take energy out.
    """
    end = depth + averaging.length * rate
    low, high = positive_part(depth), positive_part(end)
    inside = (depth > 0) & (end > 0)
    share = jnp.where(inside, 1.0, safe_divide(high - low, end - depth))
    early, late = (
        laws.contact.normal_force(d, rate, memory.impact_speed)
        for d in (low + (high - low) / 3, high)
    )
    return share * (late + 3 / 4 * (1 - averaging.bias) * (early - late))


def deepest(laws: ContactLaws, mass: Any, approach: Any, free: Any) -> Any:
    """About the indentation at which a mass that arrives with speed `approach` comes to rest, if
    less than the `free` one to which it would go unhindered: where Newton's iteration does well to
    set out."""
    work = laws.contact.elastic_force(free) * positive_part(free)
    # Hertz: m v^2 / 2 = F(d) d / (5/2), so d / free = (5/4 m v^2 / work)^(2/5); by square roots, to
    # the power 3/8.
    quarter = safe_sqrt(safe_sqrt(safe_divide(5 / 4 * mass * positive_part(approach) ** 2, work)))
    return jnp.where(work > 0, free * jnp.minimum(quarter * safe_sqrt(quarter), 1.0), free)


def tangent(
    laws: ContactLaws,
    memory: PointState,
    averaging: Averaging,
    depth: Any,
    rates: tuple,
    last: tuple,
    braking: Braking | None,
) -> tuple[tuple, tuple]:
    """The laws of a contact about mean rates of its rows over a step from the indentation `depth`
    on; `last`: the forces that go with these rates.

    (Force along each row, and how it falls with that row's rate [N s/m].)

    The normal force is linear in its own row (Newton); what friction is, its law says.
    """
    force, slope = jax.value_and_grad(
        lambda rate: mean_force(laws, memory, averaging, depth, rate)
    )(jnp.asarray(rates[0], float))
    forces, dampings = [-force], [positive_part(slope)]
    if laws.friction is not None and braking is not None:
        slip = rates[1:]
        free = tuple(
            s - braking.yielding * traction for s, traction in zip(slip, last[1:], strict=True)
        )
        unhindered = Unhindered(contact_point.slip_speed(free), braking.yielding)
        rubbing, resisting = laws.friction.linearised(
            force,
            memory.bristles,
            slip,
            contact_point.slip_speed(slip),
            unhindered,
            averaging.length,
            averaging.bias,
        )
        forces, dampings = forces + rubbing, dampings + resisting
    return tuple(forces), tuple(dampings)


def bristles_after(
    laws: ContactLaws, bristles: tuple, averaging: Averaging, rates: tuple, normal: Any
) -> tuple:
    """Deflections at the end of a step; those of an open contact straighten."""
    if not bristles:
        return ()
    slip = rates[1:]
    speed = contact_point.slip_speed(slip)
    return laws.friction.bristles_after(
        normal, bristles, slip, speed, averaging.length, averaging.bias
    )
