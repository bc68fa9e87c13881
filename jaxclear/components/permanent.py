"""Clearance joints that are always in contact: the joint they turn into, and where in the gap its
reaction is carried.

The clearance is small beside everything else, so the motion is that of the ideal joint; the gap
only decides which points carry, and these rub. Reactions are those on the child about its marker,
in the parent marker's axes. Friction is counted into the reaction's resultant: at angle phi =
atan(mu) to the normal, a resultant R on a journal rubs with sin(phi) |R|. Source: antenna paper
(000), section 3; for the guide Luo, Qi & Kong, paper 004.
"""

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.clearance import (
    AbstractClearance,
    BallSocket,
    JournalBearing,
    PlanarJournalBearing,
    SliderGuide,
    norm,
)
from jaxclear.components.joint import AbstractJoint, Prismatic, Revolute, Spherical
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part, safe_divide, safe_sqrt
from jaxclear.laws.friction import AbstractFrictionLaw

# How a joint's reaction is carried, as `situation` numbers it.
SITUATIONS = (
    "no contact",
    "one point",
    "two points on opposite sides",
    "a line (points on one side)",
)
# An end that carries less than this share of the other carries nothing.
IDLE = 1e-9


class CarryingEnd(NamedTuple):
    """One end of the gap that may carry: force on the child there across the sliding direction [N],
    friction's part of it included where it has one; displacement of that end within the gap [m];
    and the clearance joint's contacts there, as (index, normal force, friction, place)."""

    force: sp.Vec
    shift: sp.Vec
    contacts: tuple[tuple[int, Any, Any, sp.Vec], ...]


class AbstractPermanentJoint(AbstractJoint):
    """An ideal joint of one coordinate with the gap of a clearance joint that always touches. Slip
    is `arm` times the speed.
    """

    gap: eqx.AbstractVar[AbstractClearance]

    @property
    @abstractmethod
    def friction(self) -> AbstractFrictionLaw | None:
        """The law of friction between the parts."""

    @property
    @abstractmethod
    def arm(self) -> Any:
        """Sliding speed [m/s] per unit of the joint's speed, and generalised force per unit of
        friction.
        """

    @abstractmethod
    def along(self, velocity: sp.Vec, spin: sp.Vec) -> Any:
        """The joint's speed, from the child's relative velocity and spin in the parent marker's
        axes.
        """

    @abstractmethod
    def push(self, friction: Any) -> tuple[sp.Vec, sp.Vec]:
        """Force and torque of friction [N] on the child about its marker, in the parent marker's
        axes.
        """

    @abstractmethod
    def carried(self, force: sp.Vec, torque: sp.Vec, ratio: Any) -> tuple[CarryingEnd, ...]:
        """Where a reaction is carried; `ratio`: (signed) friction over the sum of the carried
        forces' sizes.
        """

    @abstractmethod
    def grip(self, mu: Any) -> Any:
        """Largest friction over the sum of the sizes of the carried forces, for a coefficient of
        friction.
        """


class PermanentRevolute(AbstractPermanentJoint):
    """A journal that turns in its bearing and always touches: planar at one point, spatial at
    either end.

    The two ends share force and moment; on opposite sides they are two points, on one side a line.
    Axial force is carried by the collars and rubs without a torque.
    """

    home: ClassVar = Revolute.home
    units: ClassVar = Revolute.units
    rows: ClassVar = Revolute.rows
    reversible: ClassVar = True
    gap: PlanarJournalBearing | JournalBearing

    @property
    def friction(self):
        return self.gap.friction

    @property
    def arm(self):
        return self.gap.bearing_radius

    def motion(self, q):
        return Revolute().motion(q)

    def columns(self, q):
        return Revolute().columns(q)

    def rate(self, q, v):
        return v

    def bias(self, q, v):
        return None

    def along(self, velocity, spin):
        return spin[2]

    def push(self, friction):
        return sp.ZERO, (0, 0, self.arm * friction)

    def carried(self, force, torque, ratio):
        if isinstance(self.gap, PlanarJournalBearing):
            return (self._end(0, (force[0], force[1], 0), 0, ratio),)
        # About y a torque pairs forces along x, about x the opposite ones along y.
        pair = (sp.mul(1 / self.gap.length, torque[1]), sp.mul(-1 / self.gap.length, torque[0]))
        ends = []
        for k, side in enumerate((-1, 1)):
            own = tuple(
                sp.add(sp.mul(0.5, f), sp.mul(side, p))
                for f, p in zip(force[:2], pair, strict=True)
            )
            ends.append(self._end(k, (*own, 0), sp.mul(0.5 * side, self.gap.length), ratio))
        return tuple(ends)

    def _end(self, index, force, height, ratio):
        """force = -N n + T t with t a quarter turn ahead of n, the direction in which the journal
        leans; T = ratio |force|.
        """
        size = norm(force)
        normal = safe_sqrt(1 - ratio * ratio) * size
        x, y = (safe_divide(part, size * size) for part in force[:2])
        friction = ratio * size
        lean = (friction * y - normal * x, -normal * y - friction * x)
        place = (*sp.scale(self.gap.bearing_radius, lean), height)
        return CarryingEnd(
            force, (*sp.scale(self.gap.clearance, lean), 0), ((index, normal, friction, place),)
        )

    def grip(self, mu):
        return mu / safe_sqrt(1 + mu * mu)


class PermanentPrismatic(AbstractPermanentJoint):
    """A slider that always touches its guide, with two of its four corners."""

    home: ClassVar = Prismatic.home
    units: ClassVar = Prismatic.units
    rows: ClassVar = Prismatic.rows
    reversible: ClassVar = True
    gap: SliderGuide

    @property
    def friction(self):
        return self.gap.friction

    @property
    def arm(self):
        return 1

    def motion(self, q):
        return Prismatic().motion(q)

    def columns(self, q):
        return Prismatic().columns(q)

    def rate(self, q, v):
        return v

    def bias(self, q, v):
        return None

    def along(self, velocity, spin):
        return velocity[2]

    def push(self, friction):
        return (0, 0, friction), sp.ZERO

    def carried(self, force, torque, ratio):
        # Friction at half the width from the axis adds to the moment: torque = l/2 (front - back) +
        # w/2 ratio (front + back).
        moment = sp.sub(torque[1], sp.mul(0.5 * self.gap.width * ratio, force[0]))
        pair = sp.mul(1 / self.gap.length, moment)
        ends = []
        for front, along in enumerate((-1, 1)):
            own = sp.add(sp.mul(0.5, force[0]), sp.mul(along, pair))
            contacts = []
            for side in (0, 1):
                # The wall on one side pushes towards the other.
                across = 0.5 * (2 * side - 1) * self.gap.width
                place = (across, 0, sp.mul(0.5 * along, self.gap.length))
                normal = positive_part(own if side == 0 else sp.neg(own))
                contacts.append((2 * side + front, normal, sp.mul(ratio, normal), place))
            ends.append(
                CarryingEnd(
                    (own, 0, 0), (-jnp.sign(own) * self.gap.clearance, 0, 0), tuple(contacts)
                )
            )
        return tuple(ends)

    def grip(self, mu):
        return mu


def load_of(ends: tuple[CarryingEnd, ...]) -> Any:
    """Sum of the sizes of the carried forces [N], of which friction is a share."""
    return sp.total(norm(end.force) for end in ends)


def situation(ends: tuple[CarryingEnd, ...]) -> Any:
    """Index into `SITUATIONS`."""
    sizes = [norm(end.force) for end in ends]
    carries = [size > IDLE * sp.total(sizes) for size in sizes]
    if len(ends) == 1:
        return carries[0].astype(int)
    opposite = sp.dot(ends[0].force, ends[1].force) < 0
    return jnp.where(
        carries[0] & carries[1], jnp.where(opposite, 2, 3), (carries[0] | carries[1]).astype(int)
    )


def permanent_joint(name: str, joint: AbstractClearance) -> AbstractJoint:
    """The joint that is always in contact, for the clearance joint `name`. Raises `ValueError`
    where none is known.
    """
    if joint.maps():
        raise ValueError(
            f'joint "{name}" wears, which integrator.NonColliding does not follow; leave its wear '
            "out, or take a compliant "
            "integrator such as ImplicitStep."
        )
    if isinstance(joint, (PlanarJournalBearing, JournalBearing)):
        return PermanentRevolute(joint)
    if isinstance(joint, SliderGuide):
        return PermanentPrismatic(joint)
    if isinstance(joint, BallSocket) and joint.friction is None:
        return Spherical()
    raise ValueError(
        f'joint "{name}" is a {type(joint).__name__}{"" if not isinstance(joint, BallSocket) else " with friction"}, for which '
        "integrator.NonColliding has no formulation; it knows journal bearings, guides, and balls "
        "without friction."
    )
