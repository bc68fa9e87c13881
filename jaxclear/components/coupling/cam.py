"""A cam that lifts a follower, which may leave it."""

from collections.abc import Callable

import jax.numpy as jnp

from jaxclear.components.coupling.base import coordinate_field
from jaxclear.components.coupling.force import AbstractForceCoupling, check_needed
from jaxclear.components.function_of_angle import check_function_of_angle, value_and_slope
from jaxclear.components.load_base import CoordinateEffect
from jaxclear.ground.numerics import smooth_sign
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.transmission import one_sided


class Cam(AbstractForceCoupling):
    r"""A cam lifts a follower by its `profile` y of the cam's turn :math:`\varphi`, and the
    follower may leave it: where its coordinate q is below y the surfaces press on each other by

    .. math:: N = k\delta + d\dot\delta,\quad \delta = y(\varphi) - q \ge 0,

    the damper bounded by the spring. N lifts the follower, and turns the cam by :math:`-N
    y'(\varphi)`. The profile is a function of an angle [rad] that repeats itself every turn and
    gives a lift [m] (an angle of a follower that swings); as data a `TimeTable` that is repeated,
    its times the angles.

    `friction` is that of a flat face that slides on the cam: it touches at a distance `base_radius`
    + q from the cam's axis, along the follower's way, so that it brakes the cam by :math:`\mu N
    (r_0 + q) \tanh(v / v_0)` at the sliding speed :math:`v = (r_0 + q)\dot\varphi`; its guide
    carries the rest. Rollers have none.

    Args:
        cam: name of the joint that turns the cam.
        follower: name of the joint of the follower.
        profile: function of the cam's angle [rad], the same after each turn, that returns the lift
            [m; rad of a follower that swings]; or a `TimeTable` that is repeated, its times the
            angles.
        stiffness: contact stiffness, along the follower [N/m; N m/rad of one that swings], > 0;
            required.
        damping: contact damping [N s/m; N m s/rad of one that swings], >= 0; none by default.
        friction: friction coefficient of a flat face [1], >= 0; none by default. Needs base_radius.
        base_radius: distance r_0 of the face from the cam's axis at lift 0 [m], > 0; needed with
            friction.
        transition_speed: sliding speed at which three quarters of friction act [m/s], > 0.

    Raises:
        ValueError: if the stiffness is missing, if one of friction and base_radius is given without
            the other, or if the profile is no such function.

    Source: Norton 2020, Design of Machinery, 6th ed., chapters 8 and 15.
    """

    cam: str = coordinate_field()
    follower: str = coordinate_field()
    profile: Callable
    stiffness: Scalar = quantity(None, "N/m", above=0, kw_only=True)
    damping: Scalar | None = quantity(None, "N s/m", at_least=0, kw_only=True)
    friction: Scalar | None = quantity(None, "1", at_least=0, kw_only=True)
    base_radius: Scalar | None = quantity(None, "m", above=0, kw_only=True)
    transition_speed: Scalar = quantity(1e-3, "m/s", above=0, kw_only=True)

    def __check_init__(self):
        check_needed(self, "stiffness")
        check_function_of_angle(self, "profile")
        if (self.friction is None) != (self.base_radius is None):
            raise ValueError(
                "coupling.Cam needs friction and base_radius together: friction brakes by its "
                "lever."
            )

    def coordinates(self):
        return self.cam, self.follower

    def states(self):
        return ()

    def effect(self, time, positions, speeds, states):
        lift, slope = value_and_slope(self.profile, positions[0])
        rate = slope * speeds[0] - speeds[1]
        force, stored, loss = one_sided(lift - positions[1], rate, self.stiffness, self.damping)
        torque = -slope * force
        if self.friction is not None:
            lever = self.base_radius + positions[1]
            slip = lever * speeds[0]
            rub = self.friction * force * smooth_sign(jnp.asarray(slip), self.transition_speed)
            torque, loss = torque - lever * rub, loss + rub * slip
        return CoordinateEffect((torque, force), (), stored, loss, 0)

    def transmitted(self, effect):
        return effect.forces[1]

    def along(self):
        return self.follower
