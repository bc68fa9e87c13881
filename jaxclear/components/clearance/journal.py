"""Journal in a bearing: in the plane one contact, in space one at each end plane of the bearing and
the axial stop of the collars.

Source of the gap of a tilted journal: geometry, to second order in the tilt (tests compare it with
discretised cylinders).

Where the collars of a journal touch the faces of its bearing: on the axis of one that stands
upright, at the rim of one that is tilted.

A flat face would let the contact point, and with it the torque of the axial force, jump from one
side of the rim to the other where the tilt passes through zero. A face that is crowned by less than
a turned one runs out lets it cross within a small tilt; its gap and its contact point go together
(the support function of an ellipsoid and its gradient), so that no energy comes of it.
"""

from collections.abc import Iterator
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.clearance.base import ContactCandidate, ContactLaws, check_clearance
from jaxclear.components.clearance.journal_base import (
    AbstractJournalBearing,
    Lobes,
    check_roundness,
)
from jaxclear.components.joint.base import shared_by_ends
from jaxclear.components.journal_film import JournalFilm
from jaxclear.components.wear_map import Wearing
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part, rounded_norm, safe_divide
from jaxclear.ground.quantity import AbstractQuantified, Scalar, concrete, quantity, with_fields
from jaxclear.laws.contact import AbstractNormalLaw
from jaxclear.laws.film import AbstractFilm
from jaxclear.laws.friction import AbstractFrictionLaw
from jaxclear.laws.stiffness import Shape, fitted

# Height of the crown over the rim, as a share of the axial clearance: 0.2 um at 0.2 mm, where
# faces run out by several um. Up to ten times as much changes no mean force by 1e-3, and halves the
# steps of a journal that stands on its collar.
CROWN = 1e-3


class Flange(AbstractQuantified):
    """Collars on the journal that stop it along the bearing: the point of their face that is
    nearest the bearing's may touch it.

    A face is crowned, an ellipsoid whose height is a thousandth of the axial clearance: an upright
    journal is carried on its axis, and from a tilt of a few times that height over the radius on by
    the collar's rim. A stiffness fitted from materials takes the radii of journal and bore, for
    want of better; give a number where the axial stiffness matters.

    Args:
        contact: contact law, one of `jaxclear.contact`.
        friction: friction law, one of `jaxclear.friction`; none by default.
        radius: outer radius of the collar [m], > 0.
        clearance: axial clearance at each collar with the journal centred [m], > 0.
    """

    contact: AbstractNormalLaw
    friction: AbstractFrictionLaw | None = None
    radius: Scalar = quantity(14e-3, "m", above=0, kw_only=True)
    clearance: Scalar = quantity(0.2e-3, "m", above=0, kw_only=True)

    def contacts(self, offset: tuple, axis: tuple, length: Scalar) -> Iterator[tuple]:
        """Contact of the collars with the lower and the upper face of a bearing.

        Args:
            offset: vector from the bearing's centre to the journal's [m].
            axis: unit vector along the journal's axis [1], in the bearing's frame.
            length: length of the bearing [m].

        Returns:
            an iterator of (indentation [m], place [m]), lower face first.
        """
        crown = self._crown
        square = sp.dot(axis[:2], axis[:2])
        support = self._lowest_point(axis[:2], axis[2])
        across = self.radius * self.radius / support
        reach = 0.5 * length + self.clearance + crown - crown * crown * axis[2] / support
        sideways = (*(sp.mul(axis[2], axis[i]) for i in (0, 1)), sp.mul(-1, square))
        for end in (-1, 1):
            middle = sp.plus(offset, sp.scale(end * reach, axis))
            place = sp.plus(middle, sp.scale(end * across, sideways))
            yield 0.5 * length - end * place[2], place

    def lowered(self, slope: tuple) -> Scalar:
        """How much nearer to the face a collar comes by leaning.

        Args:
            slope: slope (dx/dz, dy/dz) of the journal's axis [1], small.

        Returns:
            the distance [m].
        """
        return self._lowest_point(slope, 1) - self._crown

    @property
    def _crown(self) -> Scalar:
        return CROWN * self.clearance

    def _lowest_point(self, lean: tuple, along) -> Scalar:
        """From the ellipsoid's middle to its lowest point [m]; never 0."""
        leaning = (sp.mul(self.radius, part) for part in lean)
        return rounded_norm(*leaning, width=sp.mul(self._crown, along))


# How far a journal reaches whose length is not given, in lengths of its bearing [1].
REACH = 3.0


def check_film(joint: Any) -> None:
    """Raises `ValueError` for a film in a bearing for which its law is not made."""
    if joint.film is None:
        return
    clearance, reach = concrete(joint.clearance), concrete(joint.contact.reach)
    if clearance is not None and reach is not None and reach >= clearance:
        raise ValueError(
            f"a {type(joint).__name__} has asperities of {reach:g} m in a clearance of "
            f"{clearance:g} m, which they fill; its contact law's roughness must be smaller."
        )
    name = f"a {type(joint).__name__} has film.{type(joint.film).__name__}"
    if joint.roundness is not None:
        raise ValueError(f"{name} and a roundness; films are those of a round bore: leave one out.")
    if joint.bearing_wear is not None or joint.journal_wear is not None:
        raise ValueError(
            f"{name} and surfaces that wear; films are those of a bore as made: leave one out."
        )
    length, radius = concrete(joint.length), concrete(joint.bearing_radius)
    least, most = joint.film.slenderness
    if length is not None and radius is not None and not least <= 0.5 * length / radius <= most:
        raise ValueError(
            f"{name} and a length of {0.5 * length / radius:g} diameters; this film is made for "
            f"{least:g} to {most:g}."
        )


class PlanarJournalBearing(AbstractJournalBearing):
    r"""Journal in a bearing, both axes parallel: one contact, in the plane of the bearing.

    :math:`\delta = |e| - c`. Prefer `JournalBearing` where the journal's axis can tilt or slide
    along the bearing.

    Args:
        contact: contact law, one of `jaxclear.contact`.
        friction: friction law, one of `jaxclear.friction`; none by default.
        bearing_radius: radius of the bearing's hole [m], > 0.
        clearance: radial clearance, bearing radius minus journal radius [m], > 0.
        length: length of the bearing [m], > 0.
        bearing_wear: wear of the bearing, a `Wearing`; none by default.
        journal_wear: wear of the journal, a `Wearing`; none by default.
        roundness: lobes of a bore that is not round, a tuple of `Lobes`; round by default.
        film: film law of a lubricated gap, one of `jaxclear.film`; none by default: dry.

    Raises:
        ValueError: if the clearance is not below the radius, the lobes are so high that the journal
            may touch two at once, or the film is not made for this bearing.
    """

    ideal_rows: ClassVar = ("x", "y")
    contact: AbstractNormalLaw
    friction: AbstractFrictionLaw | None = None
    bearing_radius: Scalar = quantity(10e-3, "m", above=0, kw_only=True)
    clearance: Scalar = quantity(0.1e-3, "m", above=0, kw_only=True)
    length: Scalar = quantity(20e-3, "m", above=0, kw_only=True)
    bearing_wear: Wearing | None = eqx.field(default=None, kw_only=True)
    journal_wear: Wearing | None = eqx.field(default=None, kw_only=True)
    roundness: tuple[Lobes, ...] | None = eqx.field(default=None, kw_only=True)
    film: AbstractFilm | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self):
        check_clearance(self, "bearing_radius")
        check_roundness(self)
        check_film(self)

    def gap_load(self, name):
        if self.film is None:
            return None
        shape = Shape(self.bearing_radius - self.clearance, self.bearing_radius, self.length)
        law, least = fitted(self.film, shape), self.contact.least_film
        if least is not None:
            law = with_fields(law, thinnest=jnp.maximum(law.thinnest, least / self.clearance))
        return JournalFilm(name, law, self.bearing_radius, self.clearance, self.length)

    @property
    def axes(self) -> tuple[int, ...]:
        return () if self.journal_wear is None else (0,)

    def contact_laws(self):
        shape = Shape(self.bearing_radius - self.clearance, self.bearing_radius, self.length)
        return (ContactLaws(self.contact, self.friction, shape, True),)

    def indentations(self, offset, axes, worn):
        x, y, overlap = self.touch(offset)
        if self.contact.reach is not None:
            overlap = overlap + self.contact.reach
        toward = offset[:2] if self.roundness is None else (x, y)
        for surface in worn:
            place = toward if surface == "bearing" else _to_bearing_axes(axes[0], *toward)
            depth = self.maps()[surface][0].depth_at_end(worn[surface], *place, -1)
            overlap = sp.sub(overlap, depth)
        return (overlap,)

    def contact_candidates(self, offset, axes, indentations):
        x, y, _ = self.touch(offset)
        reach = self.bearing_radius + 0.5 * indentations[0]
        return (ContactCandidate((reach * x, reach * y, 0), (x, y, 0), ((-y, x, 0),)),)

    def wear_map(self, surface, wearing):
        # The whole length carries alike: one row of cells, whatever the number along.
        return self.wall(surface, (wearing.cells[0], 1), wearing.coarseness)

    def features(self, surface, offset, axes, indentations, index):
        x, y, _ = self.touch(offset)
        place = (x, y) if surface == "bearing" else _to_bearing_axes(axes[0], x, y)
        return (*place, 0.0, self.maps()[surface][0].narrowness(indentations[0]), 0.0)

    def end_forces(self, force, torque):
        return (((force[0], force[1], 0), 0),)


class JournalBearing(AbstractJournalBearing):
    r"""Journal in a bearing, the axis free to tilt: contact at both end planes of the bearing,
    axial stop at the collars.

    At :math:`z_k = \mp L/2` the journal's axis pierces the plane at :math:`c_k`, and
    :math:`\delta_k = |c_k| - c + r_J (t \cdot n_k)^2 / 2`, :math:`n_k = c_k / |c_k|`, t the slope
    of the journal's axis; the last term is the ellipse of a tilted cylinder. No contact, one point,
    two opposite points and line contact (both ends on one side, sharing the load) all follow. The
    contact law acts at each end: a law for a line contact needs half of the length. The journal
    must reach through the bearing; without `flange` nothing holds it along the axis.

    Args:
        contact: contact law, one of `jaxclear.contact`.
        friction: friction law, one of `jaxclear.friction`; none by default.
        bearing_radius: radius of the bearing's hole [m], > 0.
        clearance: radial clearance, bearing radius minus journal radius [m], > 0.
        length: length of the bearing [m], > 0.
        journal_length: length of the journal [m], > 0, at least that of the bearing; None: it
            reaches through the bearing wherever it goes.
        flange: collars that stop the journal along the axis, a `Flange`; none by default.
        bearing_wear: wear of the bearing, a `Wearing`; none by default.
        journal_wear: wear of the journal, a `Wearing`; none by default.
        roundness: lobes of a bore that is not round, a tuple of `Lobes`; round by default.

    Raises:
        ValueError: if the clearance is not below the radius, the journal is shorter than the
            bearing, the flange is not larger than the hole, or the lobes are so high that the
            journal may touch two at once.
    """

    ideal_rows: ClassVar = ("x", "y", "z", "x.z", "y.z")
    contact: AbstractNormalLaw
    friction: AbstractFrictionLaw | None = None
    bearing_radius: Scalar = quantity(10e-3, "m", above=0, kw_only=True)
    clearance: Scalar = quantity(0.1e-3, "m", above=0, kw_only=True)
    length: Scalar = quantity(20e-3, "m", above=0, kw_only=True)
    journal_length: Scalar | None = quantity(None, "m", above=0, kw_only=True)
    flange: Flange | None = eqx.field(default=None, kw_only=True)
    bearing_wear: Wearing | None = eqx.field(default=None, kw_only=True)
    journal_wear: Wearing | None = eqx.field(default=None, kw_only=True)
    roundness: tuple[Lobes, ...] | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self):
        check_clearance(self, "bearing_radius")
        check_roundness(self)
        length, journal = concrete(self.length), concrete(self.journal_length)
        if length is not None and journal is not None and 0 < journal < length:
            raise ValueError(
                f"a JournalBearing has a journal of length {journal:g} m in a bearing of "
                f"{length:g} m; the journal must reach through the bearing, because contact is "
                "evaluated at the bearing's two end planes."
            )
        hole = concrete(self.bearing_radius)
        collar = None if self.flange is None else concrete(self.flange.radius)
        if hole is not None and collar is not None and collar <= hole:
            raise ValueError(
                f"a JournalBearing has a flange of radius {collar:g} m in a hole of {hole:g} m; it "
                "must be larger than the hole to stop the journal."
            )

    @property
    def axes(self) -> tuple[int, ...]:
        return (2,) if self.journal_wear is None else (2, 0)

    @property
    def journal_radius(self) -> Scalar:
        return self.bearing_radius - self.clearance

    def contact_laws(self):
        half = Shape(self.journal_radius, self.bearing_radius, 0.5 * self.length)
        contact_laws = (ContactLaws(self.contact, self.friction, half, True),) * 2
        if self.flange is None:
            return contact_laws
        collar = ContactLaws(self.flange.contact, self.flange.friction, half, False)
        return (*contact_laws, collar, collar)

    def contact_names(self):
        ends = ("lower end", "upper end")
        return ends if self.flange is None else (*ends, "lower collar", "upper collar")

    def end_centres(self, offset, axes) -> tuple[sp.Vec, ...]:
        """Points where the journal's axis pierces the bearing's lower and upper end plane.

        Args:
            offset: vector from the bearing's centre to the journal's [m].
            axes: axes of the journal's marker, a tuple whose first is along the journal.

        Returns:
            two points [m], in the bearing's frame.
        """
        slope = _slope_of_axis(axes[0])
        centres = []
        for height in (-0.5 * self.length, 0.5 * self.length):
            rise = sp.sub(height, offset[2])
            x, y = (sp.add(offset[i], sp.mul(rise, slope[i])) for i in (0, 1))
            centres.append((x, y, height))
        return tuple(centres)

    def indentations(self, offset, axes, worn):
        slope = _slope_of_axis(axes[0])
        overlaps = []
        for end, centre in zip((-1, 1), self.end_centres(offset, axes), strict=True):
            x, y, overlap = self.touch(centre)
            lean = sp.add(sp.mul(slope[0], x), sp.mul(slope[1], y))
            if not sp.is_zero(lean):
                overlap = overlap + 0.5 * self.journal_radius * lean * lean
            for surface in worn:
                place = (x, y) if surface == "bearing" else _to_bearing_axes(axes[1], x, y)
                overlap = overlap - self.maps()[surface][0].depth_at_end(worn[surface], *place, end)
            overlaps.append(overlap)
        if self.flange is not None:
            overlaps += [overlap for overlap, _ in self._collar_contacts(offset, axes)]
        return tuple(overlaps)

    def _collar_contacts(self, offset, axes):
        return self.flange.contacts(offset, axes[0], self.length)

    def contact_candidates(self, offset, axes, indentations):
        candidates = []
        ends = zip(self.end_centres(offset, axes), indentations[:2], strict=True)
        for centre, indentation in ends:
            x, y, _ = self.touch(centre)
            reach = self.bearing_radius + 0.5 * indentation
            place, tangents = (reach * x, reach * y, centre[2]), ((-y, x, 0), (0, 0, 1))
            candidates.append(ContactCandidate(place, (x, y, 0), tangents))
        if self.flange is not None:
            for end, (_, place) in zip((-1, 1), self._collar_contacts(offset, axes), strict=True):
                candidates.append(ContactCandidate(place, (0, 0, -end), ((1, 0, 0), (0, 1, 0))))
        return tuple(candidates)

    def wear_map(self, surface, wearing):
        return self.wall(surface, wearing.cells, wearing.coarseness)

    def features(self, surface, offset, axes, indentations, index):
        centres = self.end_centres(offset, axes)
        here, other = centres[index], centres[1 - index]
        x, y, _ = self.touch(here)
        fall = sp.add(sp.mul(here[0] - other[0], x), sp.mul(here[1] - other[1], y))
        place = (x, y) if surface == "bearing" else _to_bearing_axes(axes[1], x, y)
        narrowness = self.maps()[surface][0].narrowness(indentations[index])
        return (*place, fall, narrowness, float(2 * index - 1))

    def end_forces(self, force, torque):
        return shared_by_ends(force, torque, self.length)

    def grown_along(self, length, outer, inner):
        joint = self
        if self.journal_length is not None:
            grown = inner * self.journal_length
            joint = eqx.tree_at(lambda joint: joint.journal_length, joint, grown)
        if self.flange is None:
            return joint
        # The collars stand on the journal, half a bearing and the axial clearance from its middle.
        gap = inner * (0.5 * length + self.flange.clearance) - 0.5 * outer * length
        sizes = lambda joint: (joint.flange.clearance, joint.flange.radius)
        return eqx.tree_at(sizes, joint, (gap, inner * self.flange.radius))

    def overhang(self, along):
        if self.flange is not None:
            return None
        journal = REACH * self.length if self.journal_length is None else self.journal_length
        return positive_part(abs(along) - 0.5 * (journal - self.length)) / self.length

    def axial_seat(self, force, slope):
        if self.flange is None or sp.is_zero(force):
            return 0
        # The rim of a tilted collar comes first; the moment that it adds is left out.
        return -jnp.sign(force) * (self.flange.clearance - self.flange.lowered(slope))


def _slope_of_axis(axis) -> tuple:
    """Slope (dx/dz, dy/dz) of the journal's axis."""
    if isinstance(axis[2], int):
        return axis[:2]
    inverse = 1.0 / axis[2]
    return tuple(sp.mul(inverse, component) for component in axis[:2])


def _to_bearing_axes(journal_x, x, y) -> tuple:
    """A direction of the bearing's plane in the axes of the (turned) journal."""
    length = sp.norm(journal_x[:2])
    cosine, sine = safe_divide(journal_x[0], length), safe_divide(journal_x[1], length)
    return (cosine * x + sine * y, cosine * y - sine * x)
