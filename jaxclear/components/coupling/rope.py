"""Ropes over pulleys, tendons: they pull, and go slack; and one that slips over its pulley."""

from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.coupling.base import as_name
from jaxclear.components.coupling.force import AbstractForceCoupling, check_needed
from jaxclear.components.load_base import CoordinateEffect, LoadState
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part
from jaxclear.ground.quantity import Scalar, as_vector, quantity, vector
from jaxclear.laws.transmission import one_sided


def _as_names(values: Iterable[str]) -> tuple[str, ...]:
    return tuple(map(as_name, values))


class Rope(AbstractForceCoupling):
    r"""A rope over pulleys on several joints, which pulls and never pushes.

    Its length between its ends is :math:`l_0 + \sum_i r_i q_i`, and it pulls by :math:`F = \max(0,
    F_0 + k \sum_i r_i q_i)` and a damper that is bounded by the spring. It acts on the coordinates
    alone: pulleys load their bearings by what you put there. `load.Spring` is a straight one that
    pushes, too.

    Args:
        over: names of the joints, a tuple.
        radii: lengthening r_i of the rope for a unit of each coordinate [m], a tuple: a radius for
            a joint that turns, a number (1 for one strand, 2 for two) for one that slides; positive
            where the rope gets longer.
        pretension: pull F_0 where all coordinates are 0 [N]; a negative one is slack, of the length
            -F_0/k.
        stiffness: stiffness k [N/m], > 0; required.
        damping: damping [N s/m], >= 0; none by default.

    Raises:
        ValueError: if the stiffness is missing, or the numbers of joints and radii differ.
    """

    over: tuple[str, ...] = eqx.field(static=True, converter=_as_names)
    radii: tuple = vector(unit="m", converter=as_vector)
    pretension: Scalar = quantity(0.0, "N", kw_only=True)
    stiffness: Scalar = quantity(None, "N/m", above=0, kw_only=True)
    damping: Scalar | None = quantity(None, "N s/m", at_least=0, kw_only=True)

    def __check_init__(self):
        check_needed(self, "stiffness")
        if len(self.over) != len(self.radii):
            raise ValueError(
                f"coupling.Rope runs over {len(self.over)} joints and has {len(self.radii)} radii; "
                "each joint needs one."
            )

    def coordinates(self):
        return self.over

    def states(self):
        return ()

    def effect(self, time, positions, speeds, states):
        longer = sp.total(r * q for r, q in zip(self.radii, positions, strict=True))
        rate = sp.total(r * v for r, v in zip(self.radii, speeds, strict=True))
        slack = self.pretension / self.stiffness
        force, stored, loss = one_sided(longer + slack, rate, self.stiffness, self.damping)
        return CoordinateEffect(tuple(-r * force for r in self.radii), (), stored, loss, 0)

    def transmitted(self, effect):
        return -effect.forces[0] / self.radii[0]

    def along(self):
        return None


class Capstan(AbstractForceCoupling):
    r"""A rope that is wrapped round a pulley and slips on it: a winch, a bollard, a band brake.

    Its two spans are springs of equal stiffness. The rope sticks to the pulley while their pulls
    keep :math:`e^{-\mu\theta} \le F_a / F_b \le e^{\mu\theta}`, and slips at the bound (Euler,
    Eytelwein); what it has slipped is a state, which follows its bound within `settling_time`. A
    span pulls and does not push. Where the pulley turns forwards it takes rope out of the span of a
    into that of b. It acts on the coordinates alone and loads no bearing.

    Args:
        a: name of the joint at the end of one span; None: it is tied to the ground.
        pulley: name of the joint of the pulley; None: it stands still. At least two of the three
            are joints.
        b: name of the joint at the other end; None as for a.
        friction: friction coefficient of rope and pulley [1], >= 0; required.
        wrap: angle of contact of rope and pulley [rad], >= 0; whole turns count.
        radius: radius of the pulley [m], > 0 (1 by default, for a pulley that stands still).
        radius_a: lengthening of the span of a for a unit of its coordinate [m]: a radius for a
            joint that turns, 1 or -1 for one that slides.
        radius_b: lengthening of the span of b for a unit of its coordinate [m], as radius_a.
        stiffness: stiffness of each span [N/m], > 0; required.
        pretension: pull of each span where all coordinates are 0 [N]; 0 by default; below 0 slack.
        settling_time: time within which the slip follows its bound [s], > 0. Steps of fixed length
            are no longer.

    Raises:
        ValueError: for fewer than two joints.

    Source: Eytelwein 1808, Handbuch der Statik fester Koerper; Johnson 1985, Contact Mechanics,
    section 8.2, doi:10.1017/CBO9781139171731.
    """

    a: str | None = eqx.field(static=True, default=None, converter=as_name)
    pulley: str | None = eqx.field(static=True, default=None, converter=as_name)
    b: str | None = eqx.field(static=True, default=None, converter=as_name)
    friction: Scalar = quantity(None, "1", at_least=0, kw_only=True)
    wrap: Scalar = quantity(None, "rad", at_least=0, kw_only=True)
    radius: Scalar = quantity(1.0, "m", above=0, kw_only=True)
    radius_a: Scalar = quantity(1.0, "m", kw_only=True)
    radius_b: Scalar = quantity(1.0, "m", kw_only=True)
    stiffness: Scalar = quantity(None, "N/m", above=0, kw_only=True)
    pretension: Scalar = quantity(0.0, "N", kw_only=True)
    settling_time: Scalar = quantity(1e-3, "s", above=0, kw_only=True)

    def __check_init__(self):
        check_needed(self, "friction", "wrap", "stiffness")
        if len(self.coordinates()) < 2:
            raise ValueError(
                "coupling.Capstan ties fewer than two joints; give two of a, pulley and b."
            )

    def coordinates(self):
        return tuple(name for name in (self.a, self.pulley, self.b) if name is not None)

    def states(self):
        return (LoadState("slip", "m"),)

    def _span_extensions(self, values):
        """How much longer the two spans are than at 0 [m], by the values of the coordinates."""
        values = iter(values)
        a, pulley, b = (
            0.0 if name is None else next(values) for name in (self.a, self.pulley, self.b)
        )
        travel = self.radius * pulley
        return self.radius_a * a + travel, self.radius_b * b - travel

    def effect(self, time, positions, speeds, states):
        slack = self.pretension / self.stiffness
        a, b = (jnp.asarray(x + slack, float) for x in self._span_extensions(positions))
        rate_a, rate_b = self._span_extensions(speeds)
        grip = jnp.exp(self.friction * self.wrap)
        # The slip at which the pull of b, then that of a, is the larger one by the bound.
        by_b, by_a = (grip * a - b) / (1 + grip), (a - grip * b) / (1 + grip)
        low, high = jnp.minimum(by_a, by_b), jnp.maximum(by_a, by_b)
        slip = jnp.clip(states[0], low, high)
        stretch_a, stretch_b = positive_part(a - slip), positive_part(b + slip)
        pull_a, pull_b = self.stiffness * stretch_a, self.stiffness * stretch_b
        forwards = jnp.where(states[0] < low, rate_a - grip * rate_b, 0.0)
        backwards = jnp.where(states[0] > high, grip * rate_a - rate_b, 0.0)
        loss = (pull_a - pull_b) * (forwards + backwards) / (1 + grip)
        every = (
            (self.a, -self.radius_a * pull_a),
            (self.pulley, -self.radius * (pull_a - pull_b)),
            (self.b, -self.radius_b * pull_b),
        )
        forces = tuple(force for name, force in every if name is not None)
        stored = 0.5 * (pull_a * stretch_a + pull_b * stretch_b)
        return CoordinateEffect(forces, ((slip - states[0]) / self.settling_time,), stored, loss, 0)

    def transmitted(self, effect: CoordinateEffect) -> Any:
        """By how much a is pulled more than b [N]."""
        forces = dict(zip(self.coordinates(), effect.forces, strict=True))
        if self.pulley is not None:
            return -forces[self.pulley] / self.radius
        return forces[self.b] / self.radius_b - forces[self.a] / self.radius_a

    def along(self):
        return None
