r"""What a transmission does with the stretch of its line of action: a freewheel, a strand that
pulls and does not push, and what teeth and threads lose by rubbing. Scalars in, scalars out.

`stretch` and `rate` are the residual of a coupling and its rate, by which its force works; a
positive `force` acts against a positive stretch. Energies in J, powers in W where the stretch is in
m or rad.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxclear.ground.numerics import positive_part


class Pull(NamedTuple):
    """The `force` [N, N m] against a stretch, the energy `stored` [J] in it and the power
    `dissipated` [W]."""

    force: Any
    stored: Any
    dissipated: Any


def bounded_damper(spring: Any, damper: Any) -> Any:
    """The force of a damper beside a spring that pushes one way, no larger than the spring's: the
    sum begins at 0 where the spring does, and never pulls.

    Source: Modelica Standard Library 4.0.0, Mechanics.Rotational.Components.ElastoBacklash.
    """
    return jnp.clip(damper, -spring, spring)


def one_sided(stretch: Any, rate: Any, stiffness: Any, damping: Any) -> Pull:
    """A spring that acts on one side of 0, with a parallel damper bounded by the spring's force.

    Args:
        stretch: of the spring [rad, m]; it acts where this is positive.
        rate: of the stretch [rad/s, m/s].
        stiffness: [N m/rad, N/m].
        damping: [N m s/rad, N s/m]; None: no damper.
    """
    beyond = positive_part(jnp.asarray(stretch, float))
    spring = stiffness * beyond
    stored = 0.5 * spring * beyond
    if damping is None:
        return Pull(spring, stored, 0)
    damper = bounded_damper(spring, damping * rate)
    return Pull(spring + damper, stored, damper * rate)


def freewheel_pull(twist: Any, rate: Any, stiffness: Any, damping: Any) -> tuple[Pull, Any]:
    r"""Pull of a freewheel, a spring and damper whose end slips backwards, and its rate of twist.

    With the twist :math:`\theta` of the spring, :math:`F = k\theta + d\dot\theta \ge 0`, the end
    slips at :math:`\dot s - \dot\theta \le 0`, and only where F = 0: :math:`\dot\theta =
    \max(\dot s, -(k/d)\,\theta)`. While it locks the twist follows the stretch: it holds a load
    without creep. Power :math:`d\,\dot\theta^2` is lost.

    Args:
        twist: :math:`\theta` [rad, m].
        rate: :math:`\dot s`, of the stretch between both ends [rad/s, m/s].
        stiffness, damping: k [N m/rad, N/m] and d [N m s/rad, N s/m], > 0.

    Source: the shaft with damping behind a gap of Nordin, Galić & Gutman 1997, Int. J. Adapt.
    Control Signal Process. 11, 49, with one flank.
    """
    wound = jnp.maximum(rate, -stiffness / damping * twist)
    force = stiffness * twist + damping * wound
    stored = 0.5 * stiffness * twist * twist
    return Pull(force, stored, damping * wound * wound), wound


class Helix(NamedTuple):
    """A thread at its mean diameter: the share of slip along the helix that goes along the axis
    [1], what a turn about it counts [m], and the `normal` force of its flanks for a unit of their
    force along the axis [1]."""

    axial: Any
    lever: Any
    normal: Any


def helix_of_thread(lead: Any, diameter: Any, flank_angle: Any) -> Helix:
    r"""The helix of a thread: its slope, radius and normal force.

    With :math:`\tan\lambda = l / (\pi d)` the normal force of a flank that pushes F along the axis
    and :math:`F l / 2\pi` about it is :math:`N = F / (\cos\lambda \cos\alpha)`; friction
    :math:`\mu N` acts along the helix. Raising and lowering follow: :math:`T = \frac{F
    d}{2}\,\frac{l \pm \pi \mu d \sec\alpha}{\pi d \mp \mu l \sec\alpha}`.

    Args:
        lead: l, travel in one turn [m].
        diameter: mean diameter d [m].
        flank_angle: :math:`\alpha`, of the flanks in the section across the thread [rad].

    Source: Budynas & Nisbett 2020, Shigley's Mechanical Engineering Design, 11th ed., equations
    8-1, 8-2 and 8-5.
    """
    slope = lead / (jnp.pi * diameter)
    cosine = 1 / jnp.sqrt(1 + slope * slope)
    return Helix(slope * cosine, 0.5 * diameter * cosine, 1 / (cosine * jnp.cos(flank_angle)))


def holding(deflection: Any, slip: Any, yields: Any, settling: Any) -> tuple[Any, Any]:
    """Friction that holds: an elastic, perfectly plastic spring, damped while it holds.

    It does not creep, and sliding fast it is no stiffer than at rest.

    Args:
        deflection: of the spring [rad, m].
        slip: rate of sliding [rad/s, m/s].
        yields: deflection at which the spring yields [rad, m].
        settling: time constant of the damping [s].

    Returns:
        The share of the largest friction that acts, -1 to 1 along the slip; the rate of the
        deflection.

    Source: Prandtl 1928, Z. angew. Math. Mech. 8, 85, doi:10.1002/zamm.19280080202 (an elastic,
    perfectly plastic element).
    """
    beyond = (jnp.abs(deflection) >= yields) & (deflection * slip > 0)
    rate = jnp.where(beyond, 0.0, slip)
    return jnp.clip((deflection + settling * rate) / yields, -1.0, 1.0), rate


def loss(force: Any, share: Any, efficiency: Any, backwards: Any) -> Any:
    r"""Friction [N, N m] against the motion of the driving end of a transmission.

    In full :math:`|F|(1/\eta - 1)` where power goes forwards, :math:`|F|(1 - \eta_b)` where it
    comes back. What comes out is :math:`\eta` times what goes in; one that locks itself has
    :math:`\eta_b < 0`.

    Args:
        force: F, by which the transmission pushes back on that end, positive against a positive
            motion.
        share: of the friction that acts [1], -1 to 1.
        efficiency: :math:`\eta` forwards [1].
        backwards: :math:`\eta_b` [1], below 0 for a self-locking transmission.

    Source: Pelchen, Schweiger & Otter 2002, Modeling and simulating the efficiency of gearboxes and
    of planetary gearboxes, Proc. 2nd Int. Modelica Conference, 257.
    """
    full = jnp.where(force * share > 0, 1 / efficiency - 1, 1 - backwards)
    return jnp.abs(force) * full * share
