"""What holds the coordinate of a joint: its stops, and dry friction.

Steps with percussions or set-valued friction find their forces themselves, from `sides` and
`dry_friction`; elsewhere they are springs with a damper.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxclear.components.function_of_time import (
    check_function_of_time,
    number_or_function,
    value_at,
)
from jaxclear.components.load_base import (
    AbstractCoordinateLoad,
    AbstractStateLoad,
    CoordinateEffect,
    LoadState,
    Side,
)
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part, smooth_sign, smooth_step
from jaxclear.ground.quantity import AbstractQuantified, Scalar, concrete, quantity
from jaxclear.laws.transmission import holding, one_sided


def _number_function_or_pressed(value: Any) -> Any:
    return value if isinstance(value, Pressed) else number_or_function(value)


class JointStop(AbstractCoordinateLoad):
    r"""Stops of a joint that turns or slides, ideal or with clearance. What runs into `lower` or
    `upper` comes back with the share `restitution` of its speed.

    In `MoreauJean` and `NonColliding` a stop with a restitution is rigid, and gives it in one step.
    Elsewhere, and without a restitution, it is a spring and a damper that push the coordinate back
    where it is by :math:`\delta` beyond, and never pull:

    .. math:: F = \min(\max(0,\ k\,\delta + d\,\dot\delta),\ 2\,k\,\delta).

    The bound of the damper lets the force begin at 0 however fast the stop is met, so that
    derivatives of a run pass through it, and the share of the speed that comes back hangs on
    :math:`d/\sqrt{k m}` alone. Without a `damping` it follows from the restitution, for the inertia
    m along the coordinate as the mechanism stands. With a `depth` the damper sets in over it
    instead, as a cubic step (Adams' IMPACT with exponent 1): a stop that what strikes goes into
    less deep damps less. A stiff stop needs short steps; `MoreauJean` and `NonColliding` take one
    as rigid that their steps do not resolve.

    Args:
        connection: name of the joint.
        lower: least coordinate [rad; m for a sliding joint]; none by default.
        upper: largest coordinate [rad; m for a sliding joint]; none by default.
        stiffness: stiffness k [N m/rad; N/m for a sliding joint], > 0; none by default.
        damping: damping d [N m s/rad; N s/m for a sliding joint], >= 0; none by default.
        restitution: share of the speed that comes back [1], >= 0 and <= 1; none by default.
        depth: way over which damping sets in [rad; m for a sliding joint], > 0; None: by the
            spring's own force.

    Raises:
        ValueError: if neither lower nor upper is given, or lower is not below upper; if neither
            stiffness nor restitution is given; for a depth without a damping.

    Source: the bounded damper of Modelica's ElastoBacklash2 (Modelica Standard Library 4.0).
    """

    connection: str = eqx.field(static=True)
    lower: Scalar | None = quantity(None, "rad", sliding="m")
    upper: Scalar | None = quantity(None, "rad", sliding="m")
    stiffness: Scalar | None = quantity(None, "N m/rad", sliding="N/m", above=0, kw_only=True)
    damping: Scalar | None = quantity(None, "N m s/rad", sliding="N s/m", at_least=0, kw_only=True)
    restitution: Scalar | None = quantity(None, "1", at_least=0, at_most=1, kw_only=True)
    depth: Scalar | None = quantity(None, "rad", sliding="m", above=0, kw_only=True)

    def __check_init__(self):
        if self.lower is None and self.upper is None:
            raise ValueError("load.JointStop needs lower or upper, or both; it has neither.")
        low, high = concrete(self.lower), concrete(self.upper)
        if low is not None and high is not None and not low < high:
            raise ValueError(
                f"load.JointStop has lower {low:g} and upper {high:g}; lower must be below upper."
            )
        if self.depth is not None and self.damping is None:
            raise ValueError(
                "load.JointStop has a depth, over which its damping sets in, and no damping; give "
                "damping, or leave the depth out."
            )
        if self.stiffness is None and self.restitution is None:
            raise ValueError(
                "load.JointStop needs restitution (rigid in MoreauJean and NonColliding) or "
                "stiffness, or both; it has neither."
            )

    def sides(self):
        ends = (Side(1.0, self.lower, self), Side(-1.0, self.upper, self))
        return tuple(side for side in ends if side.place is not None)

    def force(self, time, position, speed):
        force, stored, dissipated = 0, 0, 0
        for side in self.sides():
            push, spring, loss = self.push(side.beyond(position), -side.sign * speed)
            force, stored = sp.add(force, side.sign * push), sp.add(stored, spring)
            dissipated = sp.add(dissipated, loss)
        return force, stored, dissipated, 0

    def push(self, beyond: Any, rate: Any) -> tuple[Any, Any, Any]:
        """Force of one side of the stop.

        Args:
            beyond: how far the coordinate is beyond the stop [rad; m for a sliding joint].
            rate: its rate [rad/s; m/s for a sliding joint].

        Returns:
            force [N m; N for a sliding joint], stored energy [J], dissipated power [W].

        Raises:
            ValueError: if the stop has no stiffness.
        """
        if self.stiffness is None:
            raise ValueError(
                f'load.JointStop on joint "{self.connection}" has no stiffness: it is rigid, for '
                "integrator.MoreauJean and NonColliding. Give its stiffness too, by which what "
                "strikes it with speed v goes v sqrt(m / k) deep."
            )
        if self.depth is None:
            return one_sided(beyond, rate, self.stiffness, self.damping)
        depth = positive_part(beyond)
        spring = self.stiffness * depth
        stored = 0.5 * spring * depth
        damper = self.damping * rate
        push = positive_part(spring + smooth_step(depth, 0.0, self.depth) * damper)
        # Where the damper would pull the spring goes back without the body, and its energy is lost.
        return push, stored, (push - spring) * rate


# Of a bristle that is not given: its deflection [rad, m], as of asperities (Armstrong-Helouvry,
# Dupont & Canudas de Wit 1994, Automatica 30, 1083, doi:10.1016/0005-1098(94)90209-7), and its
# damping time [s] where no run has settled it.
DEFLECTION, SETTLING = 1e-6, 1e-2
# What a friction takes from a joint that nobody knows before a run [m/s^2, rad/s^2]: as mu = 1 does
# from what its weight presses. And the least speed at which any is full.
UNKNOWN, SLOWEST = 10.0, 1e-9


class Pressed(AbstractQuantified):
    """Friction of a clutch or a brake that a force presses, in proportion to its size.

    Args:
        by: name of a load on the coordinate of a joint, or of a coupling that has play or stiffness
            or is a force (`OneWay`, `Rope`); its force is that of `run.transmitted(by)`.
        factor: friction for a unit of that force [m; 1 where both are of one unit], >= 0: the
            friction coefficient, times the number of faces and their mean radius.
    """

    by: str = eqx.field(static=True)
    factor: Scalar = quantity(unit="m", at_least=0)


class JointFriction(AbstractStateLoad):
    r"""Dry friction of a joint that turns or slides, ideal or with clearance, as a torque
    :math:`\tau` [N m] whatever the joint carries: of a gear or a seal. It holds what is driven by
    less, without creep.

    In `MoreauJean` and `NonColliding` it is set-valued. Elsewhere a bristle holds: a spring with a
    damper that yields at the deflection :math:`z_0` (`presliding`),

    .. math:: F = -\operatorname{clip}(\tau\,(z + t_0\,\dot q)/z_0,\ \pm\tau), \qquad
        \dot z = \dot q \text{ within } \pm z_0,

    so that a joint at rest stands by up to :math:`z_0` beside where it came to rest. Where
    `presliding` and `settling_time` are not given friction comes within 50 us, or within a step
    where steps have a length: :math:`t_0/z_0` is the inverse of the speed that :math:`\tau` takes
    from the joint in that time, for the inertia along its coordinate where a run starts, and
    :math:`z_0` is 1e-6 (rad, m) or what that damps critically; derivatives of `Adaptive` then want
    an `rtol` of 1e-7; where they are nan there too they want a `presliding` of 1e-4.

    With a `transition_speed` :math:`v_0` it is a function of the speed instead,
    :math:`F = -\tau\tanh(\dot q/v_0)`, in every integrator, and creeps under a steady load. The
    friction of a clutch or a brake ends and begins with what presses it: a function of time, of
    which what is below 0 counts as 0, or `Pressed`, the force of another load or coupling.

    Friction by what the joint carries is that of `joint.PlainBearing` and
    `joint.Slideway`. In closed loops what each of several such loads holds at rest is not unique
    (Wojtyra 2017, Multibody Syst. Dyn. 39, 337, doi:10.1007/s11044-016-9535-6): one of the many
    answers is told.

    Args:
        connection: name of the joint.
        torque: friction when it slides, or a function of time [N m; N for a sliding joint], >= 0.
        transition_speed: speed v_0 at which three quarters of the friction act [rad/s; m/s for a
            sliding joint], > 0; None: it holds.
        presliding: deflection z_0 at which the bristle yields [rad; m for a sliding joint], > 0;
            None: from the inertia.
        settling_time: damping time t_0 of the bristle [s], > 0; None: 0.01 beside a presliding,
            else from the inertia.

    Source: Prandtl 1928, Z. angew. Math. Mech. 8, 85, doi:10.1002/zamm.19280080202 (elastic, then
    perfectly plastic: it does not drift as Dahl's and LuGre's bristles do, Dupont et al. 2002, IEEE
    Trans. Autom. Control 47, 787, doi:10.1109/TAC.2002.1000274); tanh: Andersson, Söderberg &
    Björklund 2007, Tribol. Int. 40, 580, doi:10.1016/j.triboint.2005.11.014.
    """

    connection: str = eqx.field(static=True)
    torque: Scalar | Callable | Pressed = quantity(
        unit="N m", sliding="N", converter=_number_function_or_pressed, at_least=0
    )
    transition_speed: Scalar | None = quantity(None, "rad/s", sliding="m/s", above=0)
    presliding: Scalar | None = quantity(None, "rad", sliding="m", above=0, kw_only=True)
    settling_time: Scalar | None = quantity(None, "s", above=0, kw_only=True)

    def coordinates(self):
        return (self.connection,)

    def states(self):
        if self.transition_speed is not None:
            return ()
        return (LoadState("bristle", "rad", saturation=self._yield_deflection),)

    def __check_init__(self):
        check_function_of_time(self, "torque")

    def effect(self, time, positions, speeds, states):
        (speed,), torque = speeds, value_at(self._friction_function, time)
        if self.transition_speed is not None:
            force = -torque * smooth_sign(jnp.asarray(speed, float), self.transition_speed)
            return CoordinateEffect((force,), (), 0, -force * speed, 0)
        share, rate = holding(states[0], speed, self._yield_deflection, self._settling)
        friction = torque * share
        if callable(self.torque):
            # What the bristle stores changes with what presses it: all counts as lost.
            return CoordinateEffect((-friction,), (rate,), 0, friction * speed, 0)
        elastic = jnp.clip(states[0] / self._yield_deflection, -1.0, 1.0)
        stored = 0.5 * torque * self._yield_deflection * elastic * elastic
        wound = jnp.where(jnp.abs(elastic) < 1, torque * elastic * rate, 0.0)
        return CoordinateEffect((-friction,), (rate,), stored, friction * speed - wound, 0)

    def reads_position(self):
        return False

    @property
    def _yield_deflection(self):
        return DEFLECTION if self.presliding is None else self.presliding

    @property
    def _settling(self):
        return SETTLING if self.settling_time is None else self.settling_time

    def needs_inertia(self):
        return self.presliding is None and self.transition_speed is None

    def for_inertia(self, inertia, delay, times):
        most: Any = self.torque
        if callable(most):
            most = jnp.max(jax.vmap(self._friction_at)(times))
        fastest = UNKNOWN if isinstance(most, Pressed) else most / inertia
        speed = jnp.maximum(fastest * delay, SLOWEST)
        if self.settling_time is not None:
            return dataclasses.replace(self, presliding=speed * self.settling_time)
        deflection = jnp.maximum(4 * speed * delay, DEFLECTION)
        return dataclasses.replace(self, presliding=deflection, settling_time=deflection / speed)

    def _friction_at(self, time):
        """Friction at a time, by a function of it."""
        function: Any = self.torque
        return positive_part(jnp.asarray(function(time), float))

    @property
    def _friction_function(self):
        return self._friction_at if callable(self.torque) else self.torque

    def dry_friction(self):
        return self._friction_function if self.transition_speed is None else None

    def pressed_by(self):
        return self.torque.by if isinstance(self.torque, Pressed) else None

    def under(self, force):
        # As a function of time, so that what the bristle stores is none of a number's.
        pressed: Any = self.torque
        torque = pressed.factor * jnp.abs(jnp.asarray(force, float))
        return eqx.tree_at(lambda f: f.torque, self, lambda time: torque)
