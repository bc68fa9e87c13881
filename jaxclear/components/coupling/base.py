r"""Couplings: one equation between the motions of joints or bodies, held by one multiplier, or with
play and stiffness by a force.

A coupling of coordinates, $\sum_i r_i q_i = c$, acts on the coordinates of joints as a torque or a
force does and loads no bearing (`Ratio`, `Differential`). A coupling of bodies is a residual of the
relative pose of two markers, one on each, so that its force acts where they mesh and the bearings,
with clearance or without, carry it (`Gear`, `Rack`, `Belt`, `Screw`); the gradient of the residual
is the line of action.

With `play` or `stiffness` the equation holds no more: what is left of it, the twist s, drives a
torque along the same gradient. s is seen at the slow side b of a `Gear`, at the follower of a
`Ratio`, at the first coordinate elsewhere, along the axis of a `Screw`.
"""

import dataclasses
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax

from jaxclear.components.clearance.backlash import Backlash
from jaxclear.components.coupling.losses import Efficiency, Thread
from jaxclear.ground.pose import Pose
from jaxclear.ground.quantity import AbstractQuantified, Scalar, as_number, quantity


class Motor(AbstractQuantified):
    """The rotor of a motor, as an end of a coupling: it has an inertia and no body.

    Its angle is that against its housing, one more coordinate of the mechanism, which goes by the
    coupling's name and ".motor"; loads act on it by that name. It does not turn with the arm that
    carries it: gyroscopic torques are left out, as is its mass. Without play and stiffness its
    inertia times the ratio squared is the joint's own (`load.RotorInertia`).

    Args:
        inertia: inertia of the rotor and of what turns with it [kg m^2], > 0.
    """

    inertia: Scalar = quantity(unit="kg m^2", above=0)


@jax.tree_util.register_static
class JointName(str):
    """The name of a joint where a motor may stand, too: no leaf of a tree."""

    __slots__ = ()


def _as_end(value: Any) -> Any:
    return JointName(value) if type(value) is str else value


def end_field() -> Any:
    """Field of an end of a coupling: the name of a joint, or a `Motor`."""
    return eqx.field(converter=_as_end)


def as_name(value: Any) -> Any:
    """The name of a coordinate; raises `ValueError` for a `Motor`."""
    if isinstance(value, Motor):
        raise ValueError(
            "a coupling.Motor is an end of coupling.Gear, Rack, Belt or Ratio alone; give the "
            "rotor a body and a joint of its own, whose name is then this end. (A motor behind a "
            'coupling with play or stiffness goes by the name of that one and ".motor".)'
        )
    return value


def coordinate_field() -> Any:
    """Field of an end of a coupling that is no `Motor`: the name of a coordinate."""
    return eqx.field(static=True, converter=as_name)


def as_backlash(value: Any) -> Any:
    """A `Backlash` of the default law from a number, its play; anything else as it is."""
    if value is None or isinstance(value, eqx.Module):
        return value
    return Backlash(as_number(value))


def play_field() -> Any:
    """Field of the play of a coupling: a `clearance.Backlash`, or its play alone."""
    return eqx.field(default=None, converter=as_backlash, kw_only=True)


def stiffness_field() -> Any:
    """Field of the stiffness of what transmits, seen where its play is."""
    return quantity(None, "N m/rad", sliding="N/m", above=0, kw_only=True)


def damping_field() -> Any:
    """Field of the damping of what transmits, seen where its play is."""
    return quantity(None, "N m s/rad", sliding="N s/m", at_least=0, kw_only=True)


class AbstractCoupling(AbstractQuantified):
    """One equation between the motions of joints or bodies; with play or stiffness a torque along
    its gradient."""

    @property
    def play(self) -> Backlash | None:
        """The play; None unless a class has a field of this name (`play_field`)."""
        return None

    @property
    def stiffness(self) -> Scalar | None:
        """The stiffness [N m/rad, N/m]; None unless a class has this field (`stiffness_field`)."""
        return None

    @property
    def damping(self) -> Scalar | None:
        """The damping [N m s/rad, N s/m]; None unless a class has this field (`damping_field`)."""
        return None

    @property
    def efficiency(self) -> Efficiency | None:
        """What of the power comes out; None unless a class has this field (`efficiency_field`)."""
        return None

    @property
    def transmission_error(self) -> Callable | None:
        """What is added to `ratio` times the turn of b [rad]; None unless a class has this
        field."""
        return None

    def slack_twist(self) -> Any:
        """The twist at which one strand goes slack; None, as unless overridden: none does."""
        return None

    @property
    def thread(self) -> Thread | None:
        """Its thread, if it rubs; None unless a class has one."""
        return None

    @property
    def switches(self) -> bool:
        """Whether what it transmits bends or jumps as it moves, other than at its flanks."""
        return self.efficiency is not None or self.thread is not None

    @abstractmethod
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that it speaks of, each once."""

    @property
    def gives(self) -> bool:
        """Whether it is a force element: it has play, whose flanks do not always press, or
        stiffness."""
        if self.play is not None:
            return not self.play.in_contact
        return self.stiffness is not None

    @property
    def motor(self) -> Motor | None:
        """The motor among its ends; None where all are joints."""
        values = (getattr(self, field.name) for field in dataclasses.fields(self))
        return next((value for value in values if isinstance(value, Motor)), None)

    def __check_init__(self):
        name = type(self).__name__
        values = [getattr(self, field.name) for field in dataclasses.fields(self)]
        if sum(isinstance(value, Motor) for value in values) > 1:
            raise ValueError(
                f"coupling.{name} has a coupling.Motor on more than one of its ends; one end at "
                "least is a joint, which moves the mechanism."
            )
        if self.damping is not None and self.play is None and self.stiffness is None:
            raise ValueError(
                f"coupling.{name} has damping and neither stiffness nor play; a rigid one does not "
                "twist. Give its stiffness too, or put a damper on a joint (load.JointSpring)."
            )
        loses = "efficiency" if self.efficiency is not None else "friction"
        rigid = self.play is None and self.stiffness is None
        if (self.efficiency is not None or self.thread is not None) and rigid:
            raise ValueError(
                f"coupling.{name} has {loses} and neither stiffness nor play: what it loses "
                "follows from the force of its flank. Give its stiffness."
            )


class CoordinateTerm(NamedTuple):
    """One term of a sum of coordinates.

    Args:
        joint: name of the joint, or a `Motor`.
        factor: factor of its coordinate [unit of the sum per unit of the coordinate].
    """

    joint: Any
    factor: Any


class AbstractCoordinateCoupling(AbstractCoupling):
    """A sum of coordinates of joints that is constant; play is along the first, whose factor is 1.

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
        return tuple(term.joint for term in self.terms() if not isinstance(term.joint, Motor))


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
        """Angles that the residual reads off a pose; they are known except for whole turns.

        Args:
            pose: pose of the second marker in the first.

        Returns:
            angles [rad], a tuple.
        """

    @abstractmethod
    def radii(self, drawn: Pose) -> tuple:
        """How the residual changes with each of the angles.

        Args:
            drawn: pose of the second marker in the first where all joints are at home.

        Returns:
            radii [m], a tuple.
        """

    @abstractmethod
    def rest(self, pose: Pose, drawn: Pose) -> Any:
        """The residual without radii times angles; a constant in it does not count.

        Args:
            pose: pose of the second marker in the first.
            drawn: that pose where all joints are at home.

        Returns:
            the length [m].
        """

    @abstractmethod
    def check(self, drawn: Pose) -> None:
        """Refuse markers that cannot mesh.

        Args:
            drawn: pose of the second marker in the first where all joints are at home, in numbers.

        Raises:
            ValueError: with a sentence that goes behind the coupling's name.
        """

    def check_rolling(self, drawn: Pose) -> None:
        """Refuse a part that cannot roll on what its carrier moves along; nothing is refused unless
        overridden.

        Args:
            drawn: pose of the second marker in the first where all joints are at home, in numbers.

        Raises:
            ValueError: with a sentence that goes behind the coupling's name.
        """

    def pull_of_centres(self, force: Any, pose: Pose) -> Any:
        """Force that draws the origins of both markers together and does not move the residual.

        Args:
            force: force along the residual [N].
            pose: pose of the second marker in the first.

        Returns:
            the force [N]; None, as unless overridden, where there is none.
        """
        return None

    def terms(self) -> tuple[CoordinateTerm, ...]:
        """The same as a sum of coordinates, where an end is a `Motor`; the first is that along
        which play is seen, and has factor 1."""
        raise ValueError(f"coupling.{type(self).__name__} takes no coupling.Motor.")

    def total(self) -> Any:
        """What that sum is; None for 0."""
        return None

    def play_radius(self, drawn: Pose) -> Any:
        """What a residual is divided by to be in the unit of play: along the first coordinate
        unless overridden.

        Args:
            drawn: pose of the second marker in the first where all joints are at home.

        Returns:
            the radius [m]; 1 where play is a length.
        """
        return self.radii(drawn)[0]

    def play_joint(self) -> str:
        """The joint along which play is seen: the first unless overridden."""
        return self.joints()[0]

    @property
    def has_linear_play(self) -> bool:
        """Whether play is a length [m]; an angle [rad] unless overridden."""
        return False
