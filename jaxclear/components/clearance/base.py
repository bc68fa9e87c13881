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
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.joint import AbstractJoint
from jaxclear.components.joint.base import AbstractLikeIdeal, AbstractRubbingJoint, CarryingEnd
from jaxclear.components.load_base import AbstractJointLoad
from jaxclear.components.wear_map import AbstractWearMap, Wearing
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.quantity import AbstractQuantified, Scalar, concrete
from jaxclear.laws.contact.base import indentation_under
from jaxclear.laws.stiffness import Shape, fitted


class ContactCandidate(NamedTuple):
    """One possible contact of a joint.

    Args:
        place: place in the bearing's frame [m], 3 components.
        normal: direction of the normal [1], 3 components.
        tangents: directions in which the contact may slide [1], a tuple: one, two, or the three
            axes of the bearing (so that no pole disturbs what bristles remember; the part along the
            normal is removed).
    """

    place: sp.Vec
    normal: sp.Vec
    tangents: tuple[sp.Vec, ...]

    def tangential(self, vector: sp.Vec) -> sp.Vec:
        """The part of a vector across the normal, where the sliding directions are the three axes;
        else the vector itself.

        Args:
            vector: any vector, 3 components.

        Returns:
            a vector of 3 components.
        """
        if len(self.tangents) < 3:
            return vector
        return sp.minus(vector, sp.scale(sp.dot(vector, self.normal), self.normal))


class ContactLaws(NamedTuple):
    """The laws at one possible contact.

    Args:
        contact: contact law, an `AbstractNormalLaw`.
        friction: friction law, an `AbstractFrictionLaw`, or None.
        shape: geometry from which stiffnesses are fitted, a `Shape`.
        wears: whether the wear of this contact is mapped.
        unfitted: the contact law before fitting, where a surface counts with its worn radius; else
            None.
    """

    contact: Any  # an AbstractNormalLaw; each formulation asks it for its own part
    friction: Any  # an AbstractFrictionLaw, likewise, or None
    shape: Shape
    wears: bool
    unfitted: Any = None

    def indentation_under(self, force: Scalar) -> Scalar:
        """How deep a normal force presses the contact, by the elastic part of its law.

        Args:
            force: normal force [N], >= 0.

        Returns:
            the indentation [m].
        """
        return indentation_under(fitted(self.contact, self.shape), force)


class AbstractClearance(AbstractQuantified):
    """A joint with clearance.

    A joint that can wear names its `surfaces`, has of each a field of that name with `_wear` behind
    it, and adds `wear_map` and `features`; one that can stay in contact adds `permanent_form`.
    Class attributes of a member: `ideal_rows`, the constraint rows of the joint that it becomes as
    the clearance vanishes; `surfaces`, what may wear, the outer part's first, then the inner's.
    """

    ideal_rows: eqx.AbstractClassVar[tuple[str, ...]]
    surfaces: ClassVar[tuple[str, ...]] = ()

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

    def overhang(self, along: Any) -> Any:
        """How far the inner part has left the outer one along the joint's axis.

        Args:
            along: displacement of the inner part along the axis [m].

        Returns:
            the length that has left over the outer part's length [1]; None, as unless overridden,
            where something stops it along the axis.
        """
        return None

    @abstractmethod
    def indentations(
        self, offset: sp.Vec, axes: tuple[sp.Vec, ...], worn: dict[str, Any]
    ) -> tuple[Scalar, ...]:
        """Overlap at each possible contact.

        Args:
            offset: vector from the bearing's centre to the journal's [m], in the bearing's frame.
            axes: those axes of the journal's marker that `axes` names, in the bearing's frame, a
                tuple of vectors.
            worn: readings of depth maps by the surface's name, a dict; empty where nothing wears.

        Returns:
            indentations [m], positive in contact, a tuple; of a law with a `reach` from that on.
        """

    @abstractmethod
    def contact_candidates(
        self, offset: sp.Vec, axes: tuple[sp.Vec, ...], indentations: tuple
    ) -> tuple[ContactCandidate, ...]:
        """Place and sliding directions of each possible contact.

        Args:
            offset: vector from the bearing's centre to the journal's [m], in the bearing's frame.
            axes: those axes of the journal's marker that `axes` names, a tuple of vectors.
            indentations: overlap at each contact [m], a tuple.

        Returns:
            a tuple of `ContactCandidate`.
        """

    def maps(self) -> dict[str, tuple[AbstractWearMap, Wearing]]:
        """Wear map and law of each surface that wears, by the surface's name."""
        wearing = {name: getattr(self, f"{name}_wear") for name in self.surfaces}
        return {name: (self.wear_map(name, w), w) for name, w in wearing.items() if w is not None}

    def wear_map(self, surface: str, wearing: Wearing) -> AbstractWearMap:
        """Map of one of the `surfaces`.

        Args:
            surface: name of the surface.
            wearing: how it wears, a `Wearing`.

        Returns:
            the map, an `AbstractWearMap`.
        """
        raise NotImplementedError(f"a {type(self).__name__} has no wear map for its {surface}.")

    def inner_surfaces(self) -> tuple[str, ...]:
        """Those surfaces that are the inner part's (journal, ball, slider)."""
        return self.surfaces[1:]

    def features(
        self, surface: str, offset: sp.Vec, axes: tuple, indentations: tuple, index: int
    ) -> tuple:
        """Location of a contact on a surface that wears, as its map reads it.

        Args:
            surface: name of the surface.
            offset: vector from the bearing's centre to the journal's [m], in the bearing's frame.
            axes: those axes of the journal's marker that `axes` names, a tuple of vectors.
            indentations: overlap at each contact [m], a tuple.
            index: index of the contact.

        Returns:
            location features, a tuple.
        """
        raise NotImplementedError(f"a {type(self).__name__} has no wear map for its {surface}.")

    def gap_load(self, name: str) -> AbstractJointLoad | None:
        """The load that fills the gap, a film for example; None unless overridden.

        Args:
            name: name of the joint.
        """
        return None

    def permanent_form(self) -> AbstractJoint:
        """The ideal joint as which this one moves while it always touches; one with friction is an
        `AbstractPermanentJoint`.

        Raises:
            ValueError: with a sentence that goes behind the joint's name, if there is none.
        """
        raise ValueError(
            f"is a {type(self).__name__}, which has no form in permanent contact; take an "
            "integrator that lets parts separate, such as ImplicitStep or MoreauJean."
        )

    def seat(self, force: sp.Vec, torque: sp.Vec) -> tuple[sp.Vec, tuple]:
        """Where a reaction presses the journal without friction; in the middle without a reaction.

        Args:
            force: force on the journal [N], in the bearing's axes.
            torque: torque on the journal about its centre [N m], in the bearing's axes.

        Returns:
            offset of the journal's centre from the bearing's [m], and slope (dx/dz, dy/dz) of its
            axis [1].

        Raises:
            ValueError: with a sentence that goes behind the joint's name, if the joint does not say
                where.
        """
        raise ValueError(
            f"is a {type(self).__name__}, of which it is not known where a load presses it; a "
            "joint of one's own tells it by its method `seat`."
        )

    def grown(self, outer: Scalar, inner: Scalar) -> "AbstractClearance":
        """The joint with larger parts, as by heat.

        Args:
            outer: factor of the sizes of the outer part (bearing, socket, guide) [1].
            inner: factor of the sizes of the inner part (journal, ball, slider) [1].

        Returns:
            the joint with these sizes.

        Raises:
            ValueError: with a sentence that goes behind the joint's name, if the joint does not say
                how it grows.
        """
        raise ValueError(
            f"is a {type(self).__name__}, of which it is not known how it grows with its parts; a "
            "joint of one's own tells it by its method `grown`."
        )

    def diameters(self) -> tuple[Scalar, Scalar]:
        """Size of the outer and of the inner part across the gap [m].

        Raises:
            ValueError: with a sentence that goes behind the joint's name, if the joint has no such
                sizes.
        """
        raise ValueError(
            f"is a {type(self).__name__}, which has no hole and no shaft; a joint of one's own "
            "tells its sizes by its methods `diameters` and `with_diameters`."
        )

    def with_diameters(self, outer: Scalar, inner: Scalar) -> "AbstractClearance":
        """The joint with other sizes across the gap.

        Args:
            outer: size of the outer part (bearing, socket, guide) [m].
            inner: size of the inner part (journal, ball, slider) [m].

        Returns:
            the joint with these sizes.
        """
        raise NotImplementedError(f"a {type(self).__name__} has no hole and no shaft.")

    def check_plane(self, heights: tuple[float, float, float]) -> None:
        """Refuse a joint that finds no contact in the plane; nothing is refused unless overridden.

        Args:
            heights: components of the bearing's three unit axes across the plane in which both
                parts move [1], a tuple.

        Raises:
            ValueError: with a sentence that goes behind the joint's name.
        """

    def coordinate_form(self) -> AbstractJoint:
        """The ideal joint whose coordinates and speeds are reported for this one: how far it has
        turned, where it has slid.

        Raises:
            ValueError: with a sentence that goes behind the joint's name, if there is none.
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


class AbstractPermanentJoint(AbstractRubbingJoint, AbstractLikeIdeal):
    """An ideal joint of one coordinate with the gap of a clearance joint that always touches.

    It moves as `ideal` does.
    """

    gap: eqx.AbstractVar[AbstractClearance]

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


def situation(ends: tuple[CarryingEnd, ...]) -> Any:
    """How a joint's reaction is carried.

    Args:
        ends: ends of the joint, a tuple of one or two `CarryingEnd`.

    Returns:
        an index into `SITUATIONS`: no contact, one point, two points on opposite sides, or a line.
    """
    sizes = [sp.norm(end.force) for end in ends]
    carries = [size > IDLE * sp.total(sizes) for size in sizes]
    if len(ends) == 1:
        return carries[0].astype(int)
    opposite = sp.dot(ends[0].force, ends[1].force) < 0
    return jnp.where(
        carries[0] & carries[1], jnp.where(opposite, 2, 3), (carries[0] | carries[1]).astype(int)
    )
