r"""Couplings of bodies: wheels, belts, racks and threads, whose force acts where they mesh."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.clearance.backlash import Backlash
from jaxclear.components.coupling.base import (
    AbstractBodyCoupling,
    CoordinateTerm,
    Motor,
    damping_field,
    end_field,
    play_field,
    stiffness_field,
)
from jaxclear.components.coupling.losses import Efficiency, Thread, efficiency_field
from jaxclear.components.function_of_angle import check_function_of_angle
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import direction_angle, safe_sqrt
from jaxclear.ground.pose import Pose
from jaxclear.ground.quantity import Scalar, concrete, quantity
from jaxclear.laws.transmission import helix_of_thread


class Gear(AbstractBodyCoupling):
    r"""Two gear wheels on parallel axes: a turns `ratio` times for one turn of b, the other way.

    It acts on the bodies at the pitch point, so that bearings, with clearance or without, carry its
    force. Pitch radii follow from the distance of the axes at home and the ratio, :math:`r_b =
    i\,r_a`. With a pressure angle :math:`\alpha` the teeth are involutes: they touch on a common
    tangent of the base circles, of radii :math:`r \cos\alpha`, also where the axes have moved, and
    a torque T on a loads its bearing by :math:`T / (r_a \cos\alpha)`. Without it the force is
    across the line of centres. Turns are counted by a joint of the tree; where none of the two is
    in it, and bodies move in space, only speeds are tied. Play is seen at b.

    With a `Motor` as an end it acts on the coordinate of the other alone, as a `Ratio` does, and a
    turns `ratio` times for one turn of b, the same way.

    Args:
        a, b: names of the joints that carry the wheels; one of them may be a `Motor`.
        ratio: turns of a for one of b: teeth of b over teeth of a [1], > 0.
        pressure_angle: pressure angle [rad], > -1 and < 1; none by default. Its sign picks the
            flank that carries: where `transmitted` is positive (it turns a forwards) a positive
            angle presses the wheels apart, where it is negative a negative one.
        internal: whether one wheel lies within the other, a flag; both then turn the same way.
        transmission_error: function of the turn of b from home [rad], the same after each turn (or
            a `TimeTable` that is repeated, its times the angles), whose value [rad] is added to
            `ratio` times that turn; none by default.
        efficiency: an `Efficiency`, or the share of the power that comes out forwards [1], > 0 and
            <= 1; no losses by default.
        play: play, a `clearance.Backlash`, or its width alone [rad; m for a sliding joint]; none by
            default.
        stiffness: stiffness [N m/rad; N/m for a sliding joint], > 0; none by default.
        damping: viscous damping [N m s/rad; N s/m for a sliding joint], >= 0; none by default.

    Raises:
        ValueError: if the transmission error is no such function.

    Source: Litvin & Fuentes 2004, Gear Geometry and Applied Theory, chapter 10,
    doi:10.1017/CBO9780511547126.
    """

    a: str | Motor = end_field()
    b: str | Motor = end_field()
    ratio: Scalar = quantity(unit="1", above=0)
    pressure_angle: Scalar | None = quantity(None, "rad", above=-1, below=1, kw_only=True)
    internal: bool = eqx.field(static=True, default=False, kw_only=True)
    transmission_error: Callable | None = eqx.field(default=None, kw_only=True)
    efficiency: Efficiency | None = efficiency_field()
    play: Backlash | None = play_field()
    stiffness: Scalar | None = stiffness_field()
    damping: Scalar | None = damping_field()

    def __check_init__(self):
        check_function_of_angle(self, "transmission_error")
        if concrete(self.pressure_angle) == 0:
            raise ValueError(
                "coupling.Gear has pressure_angle = 0; leave it out, and the force is across the "
                "line of centres."
            )
        if self.motor is not None and self.transmission_error is not None and not self.gives:
            raise ValueError(
                "coupling.Gear has a coupling.Motor and a transmission_error, and neither "
                "stiffness nor play; give its stiffness, behind which the error is felt."
            )
        if self.motor is not None and self.pressure_angle is not None:
            raise ValueError(
                "coupling.Gear has a coupling.Motor and a pressure_angle; a motor has no body that "
                "teeth could press on. Leave the angle out, or give the wheel a body and a joint."
            )

    def joints(self):
        return joint_ends(self.a, self.b)

    def moves(self):
        return ("rad",), ("rad",)

    def angles(self, pose):
        return _angles_to_centres(pose)

    def radii(self, drawn):
        share = jnp.abs(self.ratio - 1) if self.internal else self.ratio + 1
        radius = _distance(drawn) / share
        if self.pressure_angle is not None:
            radius = radius * jnp.cos(self.pressure_angle)
        side = _side(drawn) * (-1.0 if self.internal else 1.0)
        return radius, side * self.ratio * radius

    def rest(self, pose, drawn):
        if self.transmission_error is None:
            return self._involute_correction(pose, drawn)
        angle = self.angles(pose)[1] - self.angles(drawn)[1]
        error = self.transmission_error(angle) * self.radii(drawn)[1] / self.ratio
        return sp.add(self._involute_correction(pose, drawn), error)

    def _involute_correction(self, pose, drawn):
        """What involutes add where the axes have moved."""
        if self.pressure_angle is None:
            return 0
        base = jnp.cos(self.pressure_angle) * _distance(drawn)
        distance = jnp.maximum(_distance(pose), base)
        # The common tangent less its arcs: base times the involute function of the angle between
        # tangent and centres. There is none where the base circles cut each other.
        share = jnp.minimum(base / distance, NO_TANGENT)
        tangent = distance * jnp.sqrt(1 - share * share)
        sign = -1.0 if self.internal else 1.0
        return sign * jnp.sign(self.pressure_angle) * (tangent - base * jnp.arccos(share))

    def terms(self):
        return CoordinateTerm(self.b, 1), CoordinateTerm(self.a, -1 / self.ratio)

    def play_radius(self, drawn):
        return self.radii(drawn)[1]

    def play_joint(self):
        return self.joints()[1]

    def check(self, drawn):
        _check_parallel(drawn)
        if self.internal and concrete(self.ratio) == 1:
            raise ValueError("is internal and has ratio = 1; wheels of one size have one axis.")


class Belt(AbstractBodyCoupling):
    r"""A belt or a chain over two pulleys on parallel axes: :math:`r_a` turns of b for :math:`r_b`
    of a, the same way round, or the other way where it is crossed.

    It acts on the bodies by the difference of its two strands' forces. Together the strands pull by
    :math:`\max(2 F_0, |T| / r_a)` for a torque T at a (of a chain the tight one alone): reactions
    of ideal joints have that too; what moves does not feel it (a journal in its gap, an arm that
    tightens the belt: give it as a load). Strands do not slip. Without stiffness they do not
    stretch. With a `Motor` as an end it acts on the coordinate of the other alone.

    Args:
        a, b: names of the joints that carry the pulleys; one of them may be a `Motor`.
        radius_a: radius of pulley a [m], > 0.
        radius_b: radius of pulley b [m], > 0.
        crossed: whether the belt is crossed, a flag; the pulleys then turn opposite ways.
        pretension: pull F_0 of each strand at rest [N], >= 0; needs stiffness. A strand then pulls
            and does not push: beyond a torque of 2 r_a F_0 at a the slack one gives up its share,
            and half the stiffness is left. None, as of a chain that is taut both ways: both go on.
        play: play, a `clearance.Backlash`, or its width alone, seen at a [rad]; none by default.
        stiffness: stiffness of both strands together, seen at a [N m/rad; N/m for a sliding joint],
            > 0; none by default.
        damping: viscous damping, seen at a [N m s/rad; N s/m for a sliding joint], >= 0; none by
            default.

    Raises:
        ValueError: for a pretension without stiffness, or with play.
    """

    a: str | Motor = end_field()
    b: str | Motor = end_field()
    radius_a: Scalar = quantity(unit="m", above=0)
    radius_b: Scalar = quantity(unit="m", above=0)
    crossed: bool = eqx.field(static=True, default=False, kw_only=True)
    pretension: Scalar | None = quantity(None, "N", at_least=0, kw_only=True)
    play: Backlash | None = play_field()
    stiffness: Scalar | None = stiffness_field()
    damping: Scalar | None = damping_field()

    def __check_init__(self):
        if self.pretension is not None and (self.stiffness is None or self.play is not None):
            raise ValueError(
                "coupling.Belt has pretension, and needs stiffness, by which its strands stretch, "
                "and no play beside it."
            )

    def slack_twist(self):
        if self.pretension is None:
            return None
        return 2 * self.pretension * self.radius_a / self.stiffness

    def joints(self):
        return joint_ends(self.a, self.b)

    def moves(self):
        return ("rad",), ("rad",)

    def angles(self, pose):
        return _angles_to_centres(pose)

    def radii(self, drawn):
        side = _side(drawn) * (1.0 if self.crossed else -1.0)
        return self.radius_a, side * self.radius_b

    def rest(self, pose, drawn):
        return 0

    def pull_of_centres(self, force, pose):
        rest = 0.0 if self.pretension is None else 2 * self.pretension
        step = self.radius_a + (1.0 if self.crossed else -1.0) * self.radius_b
        sine = jnp.minimum(jnp.abs(step) / _distance(pose), NO_TANGENT)
        return jnp.maximum(rest, jnp.abs(force)) * jnp.sqrt(1 - sine * sine)

    def terms(self):
        side = -1.0 if self.crossed else 1.0
        return (
            CoordinateTerm(self.a, 1),
            CoordinateTerm(self.b, -side * self.radius_b / self.radius_a),
        )

    def check(self, drawn):
        _check_parallel(drawn)


class Rack(AbstractBodyCoupling):
    """A pinion that rolls on a rack, which slides along the z axis of its marker.

    It acts on the bodies at the pitch point, by the pinion's radius from its axis, on the side
    where the rack's marker lies at home (where that is on the axis, on the side of z × the rack's
    direction). A `Motor` as pinion pushes the rack's coordinate alone, forwards as it turns
    forwards.

    Args:
        pinion: name of the joint that carries the pinion, or a `Motor`.
        rack: name of the joint that carries the rack.
        radius: pitch radius of the pinion [m], > 0.
        pressure_angle: pressure angle [rad], > -1 and < 1, by which the force leans against the
            rack's direction; none by default. Its sign picks the flank: where `transmitted` is
            positive (it pushes the rack along its z axis) a positive angle presses both apart.
        efficiency: an `Efficiency`, or the share of the power that comes out forwards [1], > 0 and
            <= 1; no losses by default.
        play: play, a `clearance.Backlash`, or its width alone, seen at the pinion [rad]; none by
            default.
        stiffness: stiffness, seen at the pinion [N m/rad; N/m for a sliding joint], > 0; none by
            default.
        damping: viscous damping, seen at the pinion [N m s/rad; N s/m for a sliding joint], >= 0;
            none by default.
    """

    pinion: str | Motor = end_field()
    rack: str = eqx.field(static=True)
    radius: Scalar = quantity(unit="m", above=0)
    pressure_angle: Scalar | None = quantity(None, "rad", above=-1, below=1, kw_only=True)
    efficiency: Efficiency | None = efficiency_field()
    play: Backlash | None = play_field()
    stiffness: Scalar | None = stiffness_field()
    damping: Scalar | None = damping_field()

    def joints(self):
        return joint_ends(self.pinion, self.rack)

    def moves(self):
        return ("rad",), ("m",)

    def angles(self, pose):
        x, y = (row[2] for row in pose.rotation[:2])
        return (angle_of(y, x),)

    def radii(self, drawn):
        return (-self._side(drawn) * self._cosine() * self.radius,)

    def rest(self, pose, drawn):
        along, across = self._place(pose)
        if self.pressure_angle is None:
            return along
        lean = self._side(drawn) * jnp.sin(self.pressure_angle)
        return self._cosine() * along + lean * across

    def terms(self):
        return CoordinateTerm(self.pinion, 1), CoordinateTerm(self.rack, -1 / self.radius)

    def check(self, drawn):
        if abs(float(drawn.rotation[2][2])) > PARALLEL:
            raise ValueError(
                "has a rack whose direction, the z axis of its marker, does not lie across the "
                "pinion's axis."
            )

    def check_rolling(self, drawn):
        if abs(float(self._place(drawn)[1])) < PARALLEL * float(self.radius):
            raise ValueError(
                f'rolls on what joint "{self.rack}" slides along, and both markers of that joint '
                "lie on the wheel's axis, so that it is not known on which side. Put them where "
                "the wheel touches: at (0, -radius) of the ground and of the cart, say."
            )

    def _cosine(self):
        return 1.0 if self.pressure_angle is None else jnp.cos(self.pressure_angle)

    def _place(self, pose):
        """Of the rack's marker along its direction and across it, as the pinion's axis sees it."""
        x, y = (row[2] for row in pose.rotation[:2])
        px, py, _ = pose.translation
        along = sp.add(sp.mul(px, x), sp.mul(py, y))
        return along, sp.sub(sp.mul(py, x), sp.mul(px, y))

    def _side(self, drawn):
        return jnp.where(jnp.asarray(self._place(drawn)[1], float) < 0, -1.0, 1.0)


# Ten times that of the coarsest ball screws.
USUAL_LEAD = (-1.0, 1.0, "is it in mm? A lead is in m for one turn.")


class Screw(AbstractBodyCoupling):
    r"""The two parts of a joint on one thread: for one turn of the child about z it advances by the
    lead along z.

    The joint guides both, and lets them turn and slide (`joint.Cylindrical`, one with clearance);
    the thread acts on the bodies along its axis and about it.

    With friction :math:`\mu` the flanks rub along the helix of the mean diameter d by :math:`\mu
    N`, N their normal force, and at rest they hold: friction is a spring with a damper. A nut under
    a load F is turned by :math:`\frac{F d}{2}\frac{l \pm \pi\mu d \sec\alpha}{\pi d \mp \mu l
    \sec\alpha}` against it and with it, and stays where it is where :math:`\pi\mu d \sec\alpha >
    l`. A collar's friction is a `load.JointFriction`.

    Args:
        joint: name of the joint whose two parts are on the thread.
        lead: advance along z for one turn [m], not 0; negative for a left-hand thread.
        friction: friction coefficient of the flanks [1], >= 0; none by default. Needs diameter and
            stiffness.
        diameter: mean diameter of the thread [m], > 0; needed with friction.
        flank_angle: angle alpha of the flank in the section across the thread [rad], >= 0 and <
            1.2: half the thread's angle.
        presliding: deflection along the helix at which friction is full [m], > 0.
        settling_time: damping time of friction that holds [s], >= 0.
        play: play, a `clearance.Backlash`, or its width alone [m]; none by default.
        stiffness: stiffness along the axis [N m/rad; N/m for a sliding joint, as here], > 0; none
            by default.
        damping: viscous damping along the axis [N m s/rad; N s/m for a sliding joint, as here], >=
            0; none by default.

    Raises:
        ValueError: if the lead is 0, or one of friction and diameter is given without the other.

    Source: Budynas & Nisbett 2020, Shigley's Mechanical Engineering Design, 11th ed., equations 8-1
    to 8-5; Prandtl 1928, Z. angew. Math. Mech. 8, 85 (friction that holds).
    """

    joint: str = eqx.field(static=True)
    lead: Scalar = quantity(unit="m", usual=USUAL_LEAD)
    friction: Scalar | None = quantity(None, "1", at_least=0, kw_only=True)
    diameter: Scalar | None = quantity(None, "m", above=0, kw_only=True)
    flank_angle: Scalar = quantity(0.0, "rad", at_least=0, below=1.2, kw_only=True)
    presliding: Scalar = quantity(1e-5, "m", above=0, kw_only=True)
    settling_time: Scalar = quantity(1e-3, "s", at_least=0, kw_only=True)
    play: Backlash | None = play_field()
    stiffness: Scalar | None = stiffness_field()
    damping: Scalar | None = damping_field()

    def __check_init__(self):
        if concrete(self.lead) == 0:
            raise ValueError("coupling.Screw has lead = 0; a thread advances as it turns.")
        if (self.friction is None) != (self.diameter is None):
            raise ValueError(
                "coupling.Screw needs friction and diameter together: friction acts at the mean "
                "diameter of the thread."
            )

    def joints(self):
        return (self.joint,)

    def moves(self):
        return (("rad", "m"),)

    def angles(self, pose):
        return (angle_of(pose.rotation[1][0], pose.rotation[0][0]),)

    def radii(self, drawn):
        return (-self.lead / (2 * jnp.pi),)

    def rest(self, pose, drawn):
        return pose.translation[2]

    def play_radius(self, drawn):
        return 1

    @property
    def has_linear_play(self):
        return True

    @property
    def thread(self):
        if self.friction is None:
            return None
        turns = helix_of_thread(self.lead, self.diameter, self.flank_angle)
        return Thread(turns, self.friction, self.presliding, self.settling_time)

    def check(self, drawn):
        """Any two markers may be on one thread."""


# The largest cosine of the angle between a common tangent and the line of centres: beyond it base
# circles touch, and the tangent has no direction.
NO_TANGENT = 1 - 1e-9
# Of axes that are to be parallel, or across each other: rounding.
PARALLEL = 1e-6


def joint_ends(*ends: Any) -> tuple[str, ...]:
    """Those of the ends that are joints."""
    return tuple(one for one in ends if isinstance(one, str))


def angle_of(sine: Any, cosine: Any) -> Any:
    """Angle [rad] from numbers in proportion to its sine and cosine, which may be structural."""
    return direction_angle(jnp.asarray(cosine, float), jnp.asarray(sine, float))


def _angles_to_centres(pose: Pose) -> tuple:
    """How far each of two wheels has turned against the line of their centres [rad], each about its
    own axis."""
    x, y, _ = pose.translation
    cx, cy, _ = sp.apply_transposed(pose.rotation, pose.translation)
    return -angle_of(y, x), -angle_of(cy, cx)


def _distance(pose: Pose) -> Any:
    """Distance of two parallel axes [m]."""
    x, y, _ = pose.translation
    return safe_sqrt(jnp.asarray(sp.add(sp.mul(x, x), sp.mul(y, y)), float))


def _side(pose: Pose) -> Any:
    """1 where two axes point the same way, -1 where opposite ways."""
    return jnp.where(jnp.asarray(pose.rotation[2][2], float) < 0, -1.0, 1.0)


def _check_parallel(drawn: Pose) -> None:
    if 1 - abs(float(drawn.rotation[2][2])) > PARALLEL:
        raise ValueError("has wheels whose axes, the z axes of their markers, are not parallel.")
    if float(_distance(drawn)) == 0:
        raise ValueError("has wheels on one axis; they mesh with some distance between their axes.")
