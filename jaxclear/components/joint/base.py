r"""Ideal joints as data: how the child's marker moves in the parent's, and which rows close a loop
through the joint.

A joint of a spanning tree contributes coordinates q and speeds v; a joint that closes a loop
contributes constraint rows. Twists are in the child's axes, linear then angular. Row "x" says that
the child's origin stays at x = 0 of the parent's marker, row "x.z" that the parent's x axis stays
perpendicular to the child's z axis; a joint that states no rows gets them from its motion. A joint
from outside derives from `AbstractVectorJoint` where
coordinates are angles and displacements, from `AbstractGroupJoint` where rotations are free.

Joints whose parts rub: how a reaction is carried, and how friction acts on the motion.

Reactions are those on the child about its marker, in the parent marker's axes. Friction is counted
into the reaction's resultant: at angle :math:`\varphi = \arctan\mu` to the normal, a resultant R on
a journal rubs with :math:`\sin\varphi\,|R|`. Source: Li, Lyu & Ding 2022, Chin. J. Aeronaut., no.
8, "Dynamics modeling and error analysis for antenna pointing mechanisms with frictional spatial
revolute joints on SE(3)", section 3.
"""

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.drive import AbstractDrive
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.pose import Pose, Twist
from jaxclear.ground.quantity import AbstractQuantified
from jaxclear.laws.friction import AbstractFrictionLaw

LINEAR = tuple(Twist(axis, sp.ZERO) for axis in sp.IDENTITY)
ANGULAR = tuple(Twist(sp.ZERO, axis) for axis in sp.IDENTITY)


class AbstractJoint(AbstractQuantified):
    """An ideal joint.

    Class attributes of a member: `home`, its coordinates in the drawing; `units`, their units;
    `rows`, its constraint rows where it closes a loop (None: rows follow from what departs from its
    `motion`, in ways that its home tells apart); `reversal`, turn of both markers (columns: new
    axes in the old) with which the joint, read from child to parent, is one of its kind again.
    """

    home: eqx.AbstractClassVar[tuple[float, ...]]
    units: eqx.AbstractClassVar[tuple[str, ...]]
    rows: ClassVar[tuple[str, ...] | None] = None
    reversal: eqx.AbstractClassVar[sp.Mat]

    @abstractmethod
    def motion(self, q: tuple) -> Pose:
        """Pose of the child's marker in the parent's.

        Args:
            q: coordinates of the joint [its units], a tuple.

        Returns:
            the pose.
        """

    @abstractmethod
    def columns(self, q: tuple) -> tuple[Twist, ...]:
        """Twist of the child relative to the parent, in the child's axes, for each unit speed.

        Args:
            q: coordinates of the joint [its units], a tuple.

        Returns:
            a tuple with one `Twist` a speed.
        """

    @abstractmethod
    def rate(self, q: tuple, v: tuple) -> tuple:
        """Rates of the coordinates.

        Args:
            q: coordinates of the joint [its units], a tuple.
            v: speeds of the joint [m/s, rad/s], a tuple.

        Returns:
            dq/dt, a tuple.
        """

    @abstractmethod
    def bias(self, q: tuple, v: tuple) -> Twist | None:
        """Derivative of the columns along the motion, times the speeds.

        Args:
            q: coordinates of the joint [its units], a tuple.
            v: speeds of the joint [m/s, rad/s], a tuple.

        Returns:
            a `Twist` per time; None where the columns are constant.
        """

    @abstractmethod
    def moved(self, q: tuple, increment: tuple) -> tuple:
        """Coordinates after constant speeds for unit time: the exponential map.

        Args:
            q: coordinates at the beginning [the joint's units], a tuple.
            increment: speeds times unit time [m, rad], a tuple.

        Returns:
            coordinates at the end, a tuple.
        """

    @abstractmethod
    def retracted(self, q: tuple, increment: tuple) -> tuple:
        """`moved` to first order in the increment, and on the joint's group.

        Args:
            q: coordinates at the beginning [the joint's units], a tuple.
            increment: speeds times unit time [m, rad], a tuple.

        Returns:
            coordinates at the end, a tuple.
        """

    @abstractmethod
    def bracket(self, a: tuple, b: tuple) -> tuple:
        """Lie bracket of two increments: what a then b moves more than b then a, to second order.

        Args:
            a, b: increments [m, rad], tuples with one entry a speed.

        Returns:
            an increment, a tuple.
        """

    @abstractmethod
    def coordinates_at(self, pose: Pose) -> tuple:
        """Coordinates of a pose that the joint allows: the inverse of `motion`.

        Args:
            pose: pose of the child's marker in the parent's.

        Returns:
            coordinates [the joint's units], a tuple.
        """

    @abstractmethod
    def speeds_at(self, pose: Pose, velocity: sp.Vec, spin: sp.Vec) -> tuple:
        """Speeds at which the child's marker has a relative velocity and spin.

        For a pose that the joint does not allow (a journal that leans) it is the rate of the
        coordinate that `coordinates_at` gives, so that loads on it do its work.

        Args:
            pose: pose of the child's marker in the parent's.
            velocity: relative velocity [m/s], in the parent marker's axes.
            spin: relative angular velocity [rad/s], in the parent marker's axes.

        Returns:
            speeds [m/s, rad/s], a tuple.
        """

    @abstractmethod
    def start(self, values: tuple) -> tuple:
        """All coordinates from those given for a start.

        Args:
            values: coordinates that the user gives [the joint's units], a tuple.

        Returns:
            all coordinates of the joint, a tuple.

        Raises:
            ValueError: with a sentence that goes behind the joint's name, if these do not determine
                them.
        """

    def start_mask(self, values: tuple) -> tuple[bool, ...]:
        """For each speed whether the coordinates that it changes follow from those given for a
        start; all do unless overridden.

        Args:
            values: coordinates that the user gives [the joint's units], a tuple.

        Returns:
            a flag for each speed, a tuple.
        """
        return (True,) * len(self.columns(self.home))


class AbstractVectorJoint(AbstractJoint):
    """A joint whose coordinates are a vector: their rates are the speeds, and motions add up."""

    def rate(self, q, v):
        return v

    def moved(self, q, increment):
        return tuple(a + b for a, b in zip(q, increment, strict=True))

    def retracted(self, q, increment):
        return self.moved(q, increment)

    def bracket(self, a, b):
        return (0,) * len(a)

    def start(self, values):
        return check_complete(self, values)


class AbstractLikeIdeal(AbstractVectorJoint):
    """A joint of one coordinate that moves as its `ideal` does."""

    @property
    @abstractmethod
    def ideal(self) -> AbstractJoint:
        """The joint as which it moves."""

    def motion(self, q):
        return self.ideal.motion(q)

    def columns(self, q):
        return self.ideal.columns(q)

    def bias(self, q, v):
        return self.ideal.bias(q, v)

    def coordinates_at(self, pose):
        return self.ideal.coordinates_at(pose)

    def speeds_at(self, pose, velocity, spin):
        return self.ideal.speeds_at(pose, velocity, spin)


class AbstractDrivenJoint(AbstractVectorJoint):
    """A joint with one coordinate, which a drive may prescribe."""

    drive: eqx.AbstractVar[AbstractDrive | None]


class AbstractGroupJoint(AbstractJoint):
    """A joint whose coordinates are no vector but a group, such as a quaternion or a position with
    a quaternion.

    Integrators on groups (`jaxclear.integrator.MuntheKaas`) move it by increments, constant speeds
    for some time.
    """


def drive_of(joint: Any) -> AbstractDrive | None:
    """The joint's drive, or `None` for a joint that is free or cannot be driven."""
    return joint.drive if isinstance(joint, AbstractDrivenJoint) else None


def check_complete(joint: AbstractJoint, values: tuple) -> tuple:
    """The coordinates given, if there is one for each of the joint's."""
    if len(values) != len(joint.home):
        many = len(joint.home)
        units = f" [{', '.join(joint.units)}]" if many else ""
        raise ValueError(f"needs {many} number{'s' * (many != 1)}{units}, not {len(values)}.")
    return values


def turn_rate(pose: Pose, spin: sp.Vec) -> Any:
    """Rate [rad/s] of the angle about the parent's z axis at which the child's x axis is seen, for
    a relative spin in the parent's axes; that about z where the z axes agree."""
    x, y, lean = (row[0] for row in pose.rotation)
    across = sp.add(sp.mul(x, spin[0]), sp.mul(y, spin[1]))
    if sp.is_zero(lean) or sp.is_zero(across):
        return spin[2]
    flat = sp.add(sp.mul(x, x), sp.mul(y, y))
    return sp.sub(spin[2], sp.mul(lean, safe_divide(across, flat)))


def angle(sine: Any, cosine: Any) -> Any:
    """Angle [rad] from its sine and cosine, which may be structural."""
    return jnp.arctan2(jnp.asarray(sine, float), jnp.asarray(cosine, float))


class CarriedContact(NamedTuple):
    """A contact of the joint while it carries.

    Args:
        number: index of the contact in the joint.
        normal_force: normal force [N].
        friction: friction force with its sign [N].
        place: place in the bearing's frame [m], 3 components.
    """

    number: int
    normal_force: Any
    friction: Any
    place: sp.Vec


class CarryingEnd(NamedTuple):
    """One end of a joint that may carry.

    Args:
        height: height of the end along the bearing [m].
        force: force on the child there, across the sliding direction [N], with the friction's part
            of it, 3 components.
        offset: offset of that end within the gap [m], 3 components.
        contacts: contacts at this end, a tuple of `CarriedContact`.
    """

    height: Any
    force: sp.Vec
    offset: sp.Vec
    contacts: tuple[CarriedContact, ...]


class AbstractRubbingJoint(AbstractJoint):
    """An ideal joint whose parts touch all the time and rub: one of one coordinate, or a ball
    (`AbstractRubbingBall`), whose friction and sliding velocity have three components."""

    @property
    def components(self) -> int:
        """How many components friction has."""
        return 1

    @property
    @abstractmethod
    def friction(self) -> AbstractFrictionLaw | None:
        """The law between the parts."""

    def gap_load(self, name: str) -> Any:
        """The load that fills the gap, a film for example; None unless overridden.

        Args:
            name: name of the joint.
        """
        return None

    @property
    def follows_reaction(self) -> bool:
        """Whether friction follows what the joint carries; it does unless overridden."""
        return True

    @property
    @abstractmethod
    def arm(self) -> Any:
        """Sliding speed [m/s] per unit of the joint's speed, and generalised force per unit of
        friction [N]."""

    @abstractmethod
    def friction_wrench(self, friction: Any) -> tuple[sp.Vec, sp.Vec]:
        """Force and torque of friction on the child about its marker, in the parent marker's axes.

        Args:
            friction: friction force [N]; of a ball its three components.

        Returns:
            force [N] and torque [N m], a tuple.
        """

    @abstractmethod
    def carrying_ends(self, force: sp.Vec, torque: sp.Vec, ratio: Any) -> tuple[CarryingEnd, ...]:
        """Where a reaction is carried.

        Args:
            force: reaction force on the child [N], in the parent marker's axes.
            torque: reaction torque on the child about its marker [N m], in the parent marker's
                axes.
            ratio: friction with its sign over the sum of the sizes of the carried forces [1]; of a
                ball its three components.

        Returns:
            the ends, a tuple of `CarryingEnd`.
        """

    @abstractmethod
    def friction_ratio(self, mu: Any) -> Any:
        """Largest friction over the sum of the sizes of the carried forces.

        Args:
            mu: coefficient of friction [1].

        Returns:
            the ratio [1].
        """

    @abstractmethod
    def maps(self) -> dict:
        """Wear map and law of each surface that wears, by the surface's name."""

    @property
    @abstractmethod
    def gap_axes(self) -> tuple[int, ...]:
        """Axes of the child's marker on which the place of contact depends."""

    @abstractmethod
    def wearing_contacts(self) -> tuple[int, ...]:
        """Numbers of the contacts whose wear is mapped."""

    @abstractmethod
    def wear_place(
        self, surface: str, offset: sp.Vec, axes: tuple, contact: int, indentation: Any
    ) -> tuple:
        """Location of a contact on a surface that wears, as its map reads it.

        Args:
            surface: name of the surface.
            offset: offset of the child within the gap [m], 3 components.
            axes: axes of the child's marker that `gap_axes` names, a tuple.
            contact: index of the contact.
            indentation: indentation of the contact [m].

        Returns:
            location features, a tuple.
        """

    @property
    def has_moving_centre(self) -> bool:
        """Whether the centre of the inner part goes round in a gap with what it carries."""
        return False

    def indentation(self, contact: int, force: Any) -> Any:
        """How deep a normal force presses a contact; 0, unless overridden, because an ideal joint
        has no contact law.

        Args:
            contact: index of the contact.
            force: normal force [N].

        Returns:
            the indentation [m].
        """
        return 0


def check_radius_as_made(joint: Any) -> None:
    """Raises `ValueError` for wear that asks for the worn radius, which nothing in an ideal joint
    reads."""
    if joint.wear is not None and joint.wear.worn_radius:
        raise ValueError(
            f"the wear of a {type(joint).__name__} has worn_radius=True, but an ideal joint has no "
            "contact law that would follow its worn radius, so nothing would change; leave "
            "worn_radius out, or take a joint with clearance."
        )


def carried_load(ends: tuple[CarryingEnd, ...]) -> Any:
    """Sum of the sizes of the carried forces, of which friction is a share.

    Args:
        ends: ends of the joint, a tuple of `CarryingEnd`.

    Returns:
        the sum [N].
    """
    return sp.total(sp.norm(end.force) for end in ends)


def shared_by_ends(force: sp.Vec, torque: sp.Vec, length: Any) -> tuple[tuple[sp.Vec, Any], ...]:
    """(force across the axis [N], height along it [m]) at the two ends of a bearing.

    Args:
        force: on the bearing [N], in its axes (z along).
        torque: about its centre [N m]; the part across the axis is a pair of forces at the ends.
        length: of the bearing [m].
    """
    # About y a torque pairs forces along x, about x the opposite ones along y.
    pair = (sp.mul(1 / length, torque[1]), sp.mul(-1 / length, torque[0]))
    ends = []
    for side in (-1, 1):
        x, y = (sp.add(sp.mul(0.5, force[i]), sp.mul(side, pair[i])) for i in (0, 1))
        ends.append(((x, y, 0), sp.mul(0.5 * side, length)))
    return tuple(ends)


def pressed_end(
    index: int, force: sp.Vec, height: Any, ratio: Any, radius: Any, clearance: Any
) -> CarryingEnd:
    """The end of a journal that carries a force, with the direction in which it leans.

    The force is -N n + T t, with n that direction and t a quarter turn ahead of it; T = ratio
    |force|.

    Args:
        index: of the contact that carries.
        force: across the axis [N].
        height: of the end along the axis [m].
        ratio: friction along t as a share of the force [1], -1 to 1.
        radius: of the journal [m].
        clearance: radial [m].
    """
    size = sp.norm(force)
    normal = safe_sqrt(1 - ratio * ratio) * size
    x, y = (safe_divide(part, size * size) for part in force[:2])
    friction = ratio * size
    lean = (friction * y - normal * x, -normal * y - friction * x)
    place = (*sp.scale(radius, lean), height)
    offset = (*sp.scale(clearance, lean), 0)
    return CarryingEnd(height, force, offset, (CarriedContact(index, normal, friction, place),))


def ball_end(force: sp.Vec, ratio: tuple, radius: Any, clearance: Any) -> CarryingEnd:
    r"""A ball that carries a force with friction, and the direction in which it leans.

    :math:`F = -N n + m \times n`, with m the friction's torque over the radius, so that :math:`n =
    -(N F + m \times F) / |F|^2`.

    Args:
        force: on the ball [N].
        ratio: friction's torque, a vector across the force, over radius times force [1].
        radius: of the ball [m].
        clearance: radial [m].
    """
    size = sp.norm(force)
    share = sp.norm(ratio)
    normal = safe_sqrt(1 - share * share) * size
    along = sp.scale(safe_divide(1.0, size), force)
    moment = sp.plus(sp.scale(safe_divide(normal, size), along), sp.cross(ratio, along))
    towards = tuple(sp.neg(x) for x in moment)
    place = sp.scale(radius, towards)
    contact = CarriedContact(0, normal, share * size, place)
    return CarryingEnd(0, force, sp.scale(clearance, towards), (contact,))
