"""What a joint with clearance says of itself: where its parts may touch, by which laws, what wears,
and what joint it is while it always touches. Forces are the laws' business.

Everything is written in the frame of the bearing (socket, guide), whose marker is the connection's
parent; the child carries the journal (ball, slider). `offset` goes from the bearing's centre to the
journal's [m], `axes` are those axes of the journal's marker on which the gap depends. Indentations
are positive in contact. Normals, rates and moments follow from the indentations by differentiation,
so contact forces do exactly the work that the indentation tells.

Clearance joints that are always in contact: ideal joints that know where in the gap their
reaction is carried.

The clearance is small beside everything else, so the motion is that of the ideal joint; the gap
only decides which points carry, and these rub (`joint.base`). Source: Li, Lyu & Ding 2022, Chin.
J. Aeronaut., no. 8, "Dynamics modeling and error analysis for antenna pointing mechanisms with
frictional spatial revolute joints on SE(3)", section 3.
"""

from abc import abstractmethod
from math import inf
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.joint import AbstractJoint, AbstractVectorJoint
from jaxclear.components.joint.base import AbstractRubbingJoint, CarryingEnd
from jaxclear.components.wear_map import AbstractWearMap, Wearing
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.quantity import AbstractQuantified, Scalar, concrete
from jaxclear.laws.contact.base import indentation_under
from jaxclear.laws.stiffness import Shape, fitted


class ContactCandidate(NamedTuple):
    """One possible contact: its place in the bearing's frame [m], the direction of its normal, and
    the directions in which it may slide: one, two, or the three axes of the bearing (no pole then
    disturbs what bristles remember; the part along the normal is removed).
    """

    place: sp.Vec
    normal: sp.Vec
    tangents: tuple[sp.Vec, ...]

    def tangential(self, vector: sp.Vec) -> sp.Vec:
        """The part of a vector across the normal, where the sliding directions include it."""
        if len(self.tangents) < 3:
            return vector
        return sp.minus(vector, sp.scale(sp.dot(vector, self.normal), self.normal))


class ContactLaws(NamedTuple):
    """The laws at one possible contact, the shape from which stiffnesses are fitted, and whether
    its wear is mapped; `unfitted`: the contact law before fitting, which the engine keeps where a
    surface counts with its worn radius."""

    contact: Any  # an AbstractNormalLaw; each formulation asks it for its own part
    friction: Any  # an AbstractFrictionLaw, likewise, or None
    shape: Shape
    wears: bool
    unfitted: Any = None

    def indentation_under(self, force: Scalar) -> Scalar:
        """How deep [m] a normal force [N, at least 0] presses the contact, by its law."""
        return indentation_under(fitted(self.contact, self.shape), force)


class AbstractClearance(AbstractQuantified):
    """A joint with clearance. `ideal_rows` close the joint it turns into as the clearance vanishes.

    A joint that can wear adds `maps` and `features`, one that can stay in contact `permanent_form`.
    """

    ideal_rows: eqx.AbstractClassVar[tuple[str, ...]]

    @property
    @abstractmethod
    def axes(self) -> tuple[int, ...]:
        """Axes of the journal's marker that the gap depends on."""

    @abstractmethod
    def contact_laws(self) -> tuple[ContactLaws, ...]:
        """Laws of each possible contact."""

    def contact_names(self) -> tuple[str, ...]:
        """What each possible contact is called; numbers unless overridden."""
        count = len(self.contact_laws())
        return ("contact",) if count == 1 else tuple(f"contact {i}" for i in range(count))

    def left(self, along: Any) -> Any:
        """How much of the outer part the inner one has left that lies `along` [m] the joint's axis,
        beside the outer one's length [1]; None where something holds it along the axis, or it has
        none to slide along."""
        return None

    @abstractmethod
    def indentations(
        self, offset: sp.Vec, axes: tuple[sp.Vec, ...], worn: dict[str, Any]
    ) -> tuple[Scalar, ...]:
        """Overlap at each possible contact [m]. `worn` holds readings of depth maps by surface;
        empty where nothing wears.
        """

    @abstractmethod
    def contact_candidates(
        self, offset: sp.Vec, axes: tuple[sp.Vec, ...], indentations: tuple
    ) -> tuple[ContactCandidate, ...]:
        """Place and sliding directions of each possible contact."""

    def maps(self) -> dict[str, tuple[AbstractWearMap, Wearing]]:
        """Wear map and law of each surface that wears, by the surface's name; none unless
        overridden."""
        return {}

    def inner_surfaces(self) -> tuple[str, ...]:
        """Those surfaces that are the inner part's (journal, ball, slider); none unless
        overridden."""
        return ()

    def features(
        self, surface: str, offset: sp.Vec, axes: tuple, indentations: tuple, index: int
    ) -> tuple:
        """Location of contact `index` on a surface that wears, as its map reads it."""
        raise NotImplementedError(f"a {type(self).__name__} has no wear map for its {surface}.")

    def permanent_form(self) -> AbstractJoint:
        """The ideal joint as which this one moves while it always touches; one whose friction is
        followed is an `AbstractPermanentJoint`.

        Raises `ValueError`, with a sentence that goes behind the joint's name, where there is none.
        """
        raise ValueError(
            f"is a {type(self).__name__}, which has no form in permanent contact; take an "
            "integrator that lets parts separate, such as ImplicitStep or MoreauJean."
        )

    def seat(self, force: sp.Vec, torque: sp.Vec) -> tuple[sp.Vec, tuple]:
        """Where a reaction presses the journal without friction: the offset of its centre from the
        bearing's [m], and the slope (dx/dz, dy/dz) of its axis. `force` [N] and `torque` [N m] act
        on the journal about its centre, in the bearing's axes; in the middle where there are none.

        Raises `ValueError`, with a sentence that goes behind the joint's name, where none is known.
        """
        raise ValueError(
            f"is a {type(self).__name__}, of which it is not known where a load presses it; a "
            "joint of one's own tells it by its method `seat`."
        )

    def grown(self, outer: Scalar, inner: Scalar) -> "AbstractClearance":
        """The joint with the outer part (bearing, socket, guide) and the inner one (journal, ball,
        slider) larger by factors [1], as by heat.

        Raises `ValueError`, with a sentence that goes behind the joint's name, where it is not
        known.
        """
        raise ValueError(
            f"is a {type(self).__name__}, of which it is not known how it grows with its parts; a "
            "joint of one's own tells it by its method `grown`."
        )

    def check_plane(self, heights: tuple[float, float, float]) -> None:
        """Raises `ValueError`, with a sentence that goes behind the joint's name, where this joint
        finds no contact in the plane. `heights`: how far the bearing's three unit axes rise out of
        the plane in which both parts move; nothing is refused unless overridden."""

    def coordinate_form(self) -> AbstractJoint:
        """The ideal joint whose coordinates and speeds are told of this one: how far it has turned,
        where it has slid.

        Raises `ValueError`, with a sentence that goes behind the joint's name, where there is none.
        """
        try:
            return self.permanent_form()
        except ValueError:
            raise ValueError(
                f"is a {type(self).__name__}, which has no coordinates of its own; name a body or "
                "another joint."
            ) from None


def check_clearance(joint: Any, outer: str) -> None:
    """Raises `ValueError` unless the clearance [m] is smaller than the part around it, the field
    `outer` [m]; numbers that are being traced were checked before."""
    size, clearance = concrete(getattr(joint, outer)), concrete(joint.clearance)
    if size is not None and clearance is not None and 0 < size <= clearance < inf:
        raise ValueError(
            f"a {type(joint).__name__} has {outer} {size:g} m; it must be larger than the "
            f"clearance, {clearance:g} m."
        )


def direction(vector: sp.Vec, dimensions: int) -> tuple:
    """Unit vector of the first components, zero at zero length."""
    inverse = safe_divide(1.0, sp.norm(vector[:dimensions]))
    return tuple(sp.mul(inverse, component) for component in vector[:dimensions])


# How a joint's reaction is carried, as `situation` numbers it.
SITUATIONS = (
    "no contact",
    "one point",
    "two points on opposite sides",
    "a line (points on one side)",
)
# An end that carries less than this share of the other carries nothing.
IDLE = 1e-9


class AbstractPermanentJoint(AbstractRubbingJoint, AbstractVectorJoint):
    """An ideal joint of one coordinate with the gap of a clearance joint that always touches.

    It moves as `ideal` does.
    """

    gap: eqx.AbstractVar[AbstractClearance]

    @property
    @abstractmethod
    def ideal(self) -> AbstractJoint:
        """The joint as which it moves."""

    def maps(self) -> dict:
        """Wear map and law of each surface that wears, as of the joint with clearance."""
        return self.gap.maps()

    @property
    def gap_axes(self):
        return self.gap.axes

    def wearing_contacts(self):
        return tuple(k for k, laws in enumerate(self.gap.contact_laws()) if laws.wears)

    def wear_place(self, surface, offset, axes, contact, indentation):
        depths = (indentation,) * len(self.gap.contact_laws())
        return self.gap.features(surface, offset, axes, depths, contact)

    def indentation(self, contact, force):
        return self.gap.contact_laws()[contact].indentation_under(force)

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


def situation(ends: tuple[CarryingEnd, ...]) -> Any:
    """Index into `SITUATIONS`."""
    sizes = [sp.norm(end.force) for end in ends]
    carries = [size > IDLE * sp.total(sizes) for size in sizes]
    if len(ends) == 1:
        return carries[0].astype(int)
    opposite = sp.dot(ends[0].force, ends[1].force) < 0
    return jnp.where(
        carries[0] & carries[1], jnp.where(opposite, 2, 3), (carries[0] | carries[1]).astype(int)
    )
