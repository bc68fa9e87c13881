r"""Couplings: one equation between the motions of joints or bodies, held by one multiplier.

A coupling of coordinates, $\sum_i r_i q_i = c$, acts on the coordinates of joints as a torque or a
force does and loads no bearing (`Ratio`, `Differential`). A coupling of bodies is a residual of the
relative pose of two markers, one on each, so that its force acts where they mesh and the bearings,
with clearance or without, carry it (`Gear`, `Rack`, `Belt`, `Screw`); the gradient of the residual
is the line of action.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.function_of_angle import check_function_of_angle
from jaxclear.ground import sparse as sp
from jaxclear.ground.argument_errors import nothing_else
from jaxclear.ground.numerics import direction_angle, safe_sqrt
from jaxclear.ground.pose import Pose
from jaxclear.ground.quantity import AbstractQuantified, Scalar, concrete, quantity

__all__ = [
    "AbstractBodyCoupling",
    "AbstractCoordinateCoupling",
    "AbstractCoupling",
    "Belt",
    "CoordinateTerm",
    "Differential",
    "Gear",
    "Rack",
    "Ratio",
    "Screw",
]
__getattr__, __dir__ = nothing_else("jaxclear.coupling", __all__)


class AbstractCoupling(AbstractQuantified):
    """One equation between the motions of joints or bodies."""

    @abstractmethod
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that it speaks of, each once."""


class CoordinateTerm(NamedTuple):
    """The coordinate of a `joint`, times a `factor`."""

    joint: str
    factor: Any


class AbstractCoordinateCoupling(AbstractCoupling):
    """A sum of coordinates of joints that is constant.

    Each joint has one coordinate, of turning or sliding, and is ideal or has clearance; at most
    one angle may be of a joint outside the tree, where whole turns are not counted. It acts on the
    coordinates as a torque [N m] or force [N] does and loads no bearing: prefer a coupling of
    bodies where bearing loads matter.
    """

    @abstractmethod
    def terms(self) -> tuple[CoordinateTerm, ...]:
        """The coordinates with their factors; the first is that in whose unit the sum is."""

    @abstractmethod
    def total(self) -> Any:
        """What the sum is, in the unit of the first coordinate; None for 0."""

    def joints(self):
        return tuple(term.joint for term in self.terms())


class Ratio(AbstractCoordinateCoupling):
    r"""One joint's coordinate follows another's: $q_f = r\,q_l + c$.

    The `mimic` of URDF and the joint equality of MuJoCo (of degree 1). Loads no bearing: what it
    transmits acts along the two coordinates alone. Between coordinates of one unit r is a plain
    number; of a slide that follows a turn it is in m/rad.
    """

    follower: str = eqx.field(static=True)
    leader: str = eqx.field(static=True)
    ratio: Scalar = quantity(unit="1", meaning="change of the follower for one of the leader")
    offset: Scalar | None = quantity(
        None, "rad", "follower's coordinate where the leader's is 0 (m for a sliding joint)"
    )

    def terms(self):
        return (CoordinateTerm(self.follower, 1), CoordinateTerm(self.leader, -self.ratio))

    def total(self):
        return self.offset


class Differential(AbstractCoordinateCoupling):
    r"""Two outputs and a carrier: $q_a + i\,q_b = (1 + i)\,q_c$ (Willis).

    With i = 1 the bevel differential of an axle, whose outputs a and b turn as fast as the carrier
    c on an average; with i teeth of the ring over those of the sun a planetary set of sun a, ring b
    and carrier c. Its wheels share their load evenly and leave none in the bearings. All turns are
    seen from one body. Source: Willis 1841, Principles of Mechanism; Müller 1982, Epicyclic Drive
    Trains, chapter 2.
    """

    a: str = eqx.field(static=True)
    b: str = eqx.field(static=True)
    carrier: str = eqx.field(static=True)
    ratio: Scalar = quantity(1.0, "1", "turns of a for one of b, the carrier held", above=0)

    def terms(self):
        return (
            CoordinateTerm(self.a, 1),
            CoordinateTerm(self.b, self.ratio),
            CoordinateTerm(self.carrier, -(1 + self.ratio)),
        )

    def total(self):
        return None


class AbstractBodyCoupling(AbstractCoupling):
    """One residual [m] of the relative pose of two markers: of what two joints carry, or of the two
    of one joint.

    A joint, by its name, stands for what it carries: its child at the child's marker, or its parent
    at the parent's where the child is the ground. Where all joints are at home the parts mesh.
    """

    def moves(self) -> tuple[tuple[str, ...], ...]:
        """Units of what each joint must leave free that is not fixed: "rad" a turn, "m" a slide;
        joints may be any unless overridden."""
        return ((),) * len(self.joints())

    @abstractmethod
    def angles(self, pose: Pose) -> tuple:
        """The angles [rad] that the residual reads off the pose of the second marker in the first;
        they are known but for whole turns."""

    @abstractmethod
    def radii(self, drawn: Pose) -> tuple:
        """How the residual changes with each of the angles [m]; `drawn`: the pose at home."""

    @abstractmethod
    def rest(self, pose: Pose, drawn: Pose) -> Any:
        """What the residual is beside radii times angles [m]; a constant in it does not count."""

    @abstractmethod
    def check(self, drawn: Pose) -> None:
        """Raises `ValueError`, with a sentence that goes behind the coupling's name, where markers
        whose pose at home is `drawn`, in numbers, cannot mesh."""


class Gear(AbstractBodyCoupling):
    r"""Two gear wheels on parallel axes: a turns `ratio` times for one turn of b, the other way.

    It acts on the bodies at the pitch point, so that bearings, with clearance or without, carry its
    force. Pitch radii follow from the distance of the axes at home and the ratio, :math:`r_b = i\,
    r_a`. With a `pressure_angle` :math:`\alpha` the teeth are involutes: they touch on a common
    tangent of the base circles, of radii :math:`r \cos\alpha`, also where the axes have moved, and
    a torque T on a loads its bearing by :math:`T / (r_a \cos\alpha)`. One equation holds one flank,
    which the sign of the angle picks: where `transmitted` is positive (it turns a forwards) a
    positive angle presses wheels apart, where it is negative a negative one. Without the angle the
    force is across the line of centres. `internal`: one wheel lies within the other, and both turn
    the same way. Turns are counted by a joint of the tree; where none of the two is in it, and
    bodies move in space, only speeds are tied. A `transmission_error` e, a function of the turn of
    b [rad] from home that repeats itself every turn (a `TimeTable` that is repeated, its times the
    angles), is added [rad] to `ratio` times that turn.

    Source: Litvin & Fuentes 2004, Gear Geometry and Applied Theory, chapter 10,
    doi:10.1017/CBO9780511547126.
    """

    a: str = eqx.field(static=True)
    b: str = eqx.field(static=True)
    ratio: Scalar = quantity(unit="1", meaning="turns of a for one of b: teeth of b by a", above=0)
    pressure_angle: Scalar | None = quantity(
        None, "rad", "pressure angle; its sign picks the flank", above=-1, below=1, kw_only=True
    )
    internal: bool = eqx.field(static=True, default=False, kw_only=True)
    transmission_error: Callable | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self):
        check_function_of_angle(self, "transmission_error")
        if concrete(self.pressure_angle) == 0:
            raise ValueError(
                "coupling.Gear has pressure_angle = 0; leave it out, and the force is across the "
                "line of centres."
            )

    def joints(self):
        return self.a, self.b

    def moves(self):
        return ("rad",), ("rad",)

    def angles(self, pose):
        return _seen_along_centres(pose)

    def radii(self, drawn):
        share = jnp.abs(self.ratio - 1) if self.internal else self.ratio + 1
        radius = _distance(drawn) / share
        if self.pressure_angle is not None:
            radius = radius * jnp.cos(self.pressure_angle)
        side = _alike(drawn) * (-1.0 if self.internal else 1.0)
        return radius, side * self.ratio * radius

    def rest(self, pose, drawn):
        if self.transmission_error is None:
            return self._tangent(pose, drawn)
        turned = self.angles(pose)[1] - self.angles(drawn)[1]
        error = self.transmission_error(turned) * self.radii(drawn)[1] / self.ratio
        return sp.add(self._tangent(pose, drawn), error)

    def _tangent(self, pose, drawn):
        """What involutes add where the axes have moved."""
        if self.pressure_angle is None:
            return 0
        base = jnp.cos(self.pressure_angle) * _distance(drawn)
        distance = jnp.maximum(_distance(pose), base)
        # The common tangent less its arcs: base times the involute function of the angle between
        # tangent and centres. There is none where the base circles cut each other.
        share = jnp.minimum(base / distance, NO_TANGENT)
        tangent = distance * jnp.sqrt(1 - share * share)
        apart = -1.0 if self.internal else 1.0
        return apart * jnp.sign(self.pressure_angle) * (tangent - base * jnp.arccos(share))

    def check(self, drawn):
        _check_parallel(drawn)
        if self.internal and concrete(self.ratio) == 1:
            raise ValueError("is internal and has ratio = 1; wheels of one size have one axis.")


class Belt(AbstractBodyCoupling):
    r"""A belt or a chain over two pulleys on parallel axes: :math:`r_a` turns of b for
    :math:`r_b` of a, the same way round, or the other way where it is `crossed`.

    It acts on the bodies by the difference of its two strands' forces along them, of half each, so
    that pulleys of one size do not load their bearings by it; the pretension, which does, is a load
    of your own. Strands do not stretch and do not slip.
    """

    a: str = eqx.field(static=True)
    b: str = eqx.field(static=True)
    radius_a: Scalar = quantity(unit="m", meaning="radius of pulley a", above=0)
    radius_b: Scalar = quantity(unit="m", meaning="radius of pulley b", above=0)
    crossed: bool = eqx.field(static=True, default=False, kw_only=True)

    def joints(self):
        return self.a, self.b

    def moves(self):
        return ("rad",), ("rad",)

    def angles(self, pose):
        return _seen_along_centres(pose)

    def radii(self, drawn):
        side = _alike(drawn) * (1.0 if self.crossed else -1.0)
        return self.radius_a, side * self.radius_b

    def rest(self, pose, drawn):
        return 0

    def check(self, drawn):
        _check_parallel(drawn)


class Rack(AbstractBodyCoupling):
    r"""A pinion that rolls on a rack, which slides along the z axis of its marker.

    It acts on the bodies at the pitch point, by the pinion's `radius` from its axis, on the side
    where the rack's marker lies at home (where that is on the axis, on the side of z × the rack's
    direction). With a `pressure_angle` :math:`\alpha`, whose sign picks the flank, the force leans
    by it against the rack's direction; where `transmitted` is positive (it pushes the rack along
    its z axis) a positive angle presses both apart.
    """

    pinion: str = eqx.field(static=True)
    rack: str = eqx.field(static=True)
    radius: Scalar = quantity(unit="m", meaning="pitch radius of the pinion", above=0)
    pressure_angle: Scalar | None = quantity(
        None, "rad", "pressure angle; its sign picks the flank", above=-1, below=1, kw_only=True
    )

    def joints(self):
        return self.pinion, self.rack

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

    def check(self, drawn):
        if abs(float(drawn.rotation[2][2])) > PARALLEL:
            raise ValueError(
                "has a rack whose direction, the z axis of its marker, does not lie across the "
                "pinion's axis."
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
    `lead` along z; a negative lead is a left-hand thread.

    The joint guides both, and lets them turn and slide (`joint.Cylindrical`, one with clearance);
    the thread acts on the bodies along its axis and about it.
    """

    joint: str = eqx.field(static=True)
    lead: Scalar = quantity(unit="m", meaning="advance for one turn", usual=USUAL_LEAD)

    def __check_init__(self):
        if concrete(self.lead) == 0:
            raise ValueError("coupling.Screw has lead = 0; a thread advances as it turns.")

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

    def check(self, drawn):
        """Any two markers may be on one thread."""


# The largest cosine of the angle between a common tangent and the line of centres: beyond it base
# circles touch, and the tangent has no direction.
NO_TANGENT = 1 - 1e-9
# Of axes that are to be parallel, or across each other: rounding.
PARALLEL = 1e-6


def angle_of(sine: Any, cosine: Any) -> Any:
    """Angle [rad] from numbers in proportion to its sine and cosine, which may be structural."""
    return direction_angle(jnp.asarray(cosine, float), jnp.asarray(sine, float))


def _seen_along_centres(pose: Pose) -> tuple:
    """How far each of two wheels has turned against the line of their centres [rad], each about its
    own axis."""
    x, y, _ = pose.translation
    own_x, own_y, _ = sp.apply_transposed(pose.rotation, pose.translation)
    return -angle_of(y, x), -angle_of(own_y, own_x)


def _distance(pose: Pose) -> Any:
    """Distance of two parallel axes [m]."""
    x, y, _ = pose.translation
    return safe_sqrt(jnp.asarray(sp.add(sp.mul(x, x), sp.mul(y, y)), float))


def _alike(pose: Pose) -> Any:
    """1 where two axes point the same way, -1 where opposite ways."""
    return jnp.where(jnp.asarray(pose.rotation[2][2], float) < 0, -1.0, 1.0)


def _check_parallel(drawn: Pose) -> None:
    if 1 - abs(float(drawn.rotation[2][2])) > PARALLEL:
        raise ValueError("has wheels whose axes, the z axes of their markers, are not parallel.")
    if float(_distance(drawn)) == 0:
        raise ValueError("has wheels on one axis; they mesh with some distance between their axes.")
