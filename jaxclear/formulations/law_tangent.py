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
from jaxclear.formulations.slip_over_step import Braking
from jaxclear.ground.numerics import positive_part, safe_divide, safe_sqrt
from jaxclear.laws.friction.base import Unhindered
from jaxclear.multibody import contact_point
from jaxclear.multibody.contact_point import PointState


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


class Tangent(NamedTuple):
    """A contact's laws about given rates: force along each row, and how it falls with that row's
    rate [N s/m].
    """

    forces: tuple
    dampings: tuple


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
) -> Tangent:
    """The laws of a contact about mean rates of its rows over a step from the indentation `depth`
    on; `last`: the forces that go with these rates.

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
    return Tangent(tuple(forces), tuple(dampings))


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
