"""Joints with clearance: where the parts touch. Gaps, directions and arms only; forces are the
laws' business.

Everything is written in the frame of the bearing (socket, guide), whose marker is the connection's
parent; the child carries the journal (ball, slider). `offset` goes from the bearing's centre to the
journal's, `axes` are those axes of the journal's marker on which the gap depends. Indentations are
positive in contact. Normals, rates and moments follow from the indentations by differentiation, so
contact forces do exactly the work that the indentation tells. A class defined elsewhere is a full
member: it needs `axes`, `ideal_rows`, `shape`, `points` and `indentations`.
"""

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

import equinox as eqx

from jaxclear.components.wear_map import AbstractWearMap, CylinderMap, SphereMap, Wearing
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part, safe_divide, safe_sqrt
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.laws.contact import AbstractNormalLaw
from jaxclear.laws.friction import AbstractFrictionLaw
from jaxclear.laws.stiffness import Shape


def norm(vector) -> Any:
    """Length of a sparse vector, with zero derivative at zero length."""
    squares = sp.dot(vector, vector)
    return 0 if sp.is_zero(squares) else safe_sqrt(squares)


class ContactCandidate(NamedTuple):
    """One possible contact: its place in the bearing's frame [m] and the directions in which it may
    slide.
    """

    place: sp.Vec
    normal: sp.Vec
    tangents: tuple[sp.Vec, ...]


class ContactLaws(NamedTuple):
    """The laws at one possible contact, and whether its wear is mapped."""

    contact: AbstractNormalLaw
    friction: AbstractFrictionLaw | None
    shape: Shape
    wears: bool


class AbstractClearance(AbstractQuantified):
    """A joint with clearance. `ideal_rows` close the joint it turns into as the clearance
    vanishes."""

    ideal_rows: eqx.AbstractClassVar[tuple[str, ...]]
    axes: eqx.AbstractVar[tuple[int, ...]]

    @abstractmethod
    def contact_laws(self) -> tuple[ContactLaws, ...]:
        """Laws of each possible contact."""

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

    @abstractmethod
    def maps(self) -> dict[str, tuple[AbstractWearMap, Wearing]]:
        """Wear map and law of each surface that wears, by the surface's name."""

    @abstractmethod
    def features(
        self, surface: str, offset: sp.Vec, axes: tuple, indentations: tuple, index: int
    ) -> tuple:
        """Location of contact `index` on a surface that wears, as its map reads it."""


class PlanarJournalBearing(AbstractClearance):
    """Journal in a bearing, both axes parallel: one contact, in the plane of the bearing.

    delta = |e| - c. Prefer `JournalBearing` where the journal's axis can tilt or slide along the
    bearing.
    """

    ideal_rows: ClassVar = ("x", "y")
    contact: AbstractNormalLaw
    friction: AbstractFrictionLaw | None = None
    bearing_radius: Scalar = quantity(10e-3, "m", "radius of the bearing's hole", above=0)
    clearance: Scalar = quantity(
        0.1e-3, "m", "radial clearance, bearing radius - journal radius", above=0
    )
    length: Scalar = quantity(20e-3, "m", "length of the bearing", above=0)
    wear: Wearing | None = None

    @property
    def axes(self) -> tuple[int, ...]:
        return ()

    def contact_laws(self):
        shape = Shape(self.bearing_radius - self.clearance, self.bearing_radius, self.length)
        return (ContactLaws(self.contact, self.friction, shape, True),)

    def indentations(self, offset, axes, worn):
        depth = 0
        if "bearing" in worn:
            depth = self.maps()["bearing"][0].depth_at_end(
                worn["bearing"], offset[0], offset[1], -1
            )
        return (sp.sub(norm(offset[:2]) - self.clearance, depth),)

    def contact_candidates(self, offset, axes, indentations):
        x, y = _direction(offset)
        reach = self.bearing_radius + 0.5 * indentations[0]
        return (ContactCandidate((reach * x, reach * y, 0), (x, y, 0), ((-y, x, 0),)),)

    def maps(self):
        if self.wear is None:
            return {}
        # The whole length carries alike: one row of cells, whatever the number along.
        return {
            "bearing": (
                CylinderMap((self.wear.cells[0], 1), self.bearing_radius, self.length),
                self.wear,
            )
        }

    def features(self, surface, offset, axes, indentations, index):
        return (*_direction(offset), 1.0, -1.0)


class Flange(AbstractQuantified):
    """Collars on the journal that stop it along the bearing: the rim point nearest the bearing's
    face may touch it.

    A stiffness fitted from materials takes the radii of journal and bore, for want of better; give
    a number where the axial stiffness matters.
    """

    contact: AbstractNormalLaw
    friction: AbstractFrictionLaw | None = None
    radius: Scalar = quantity(14e-3, "m", "outer radius of the collar", above=0)
    clearance: Scalar = quantity(
        0.2e-3, "m", "axial clearance at each collar, journal centred", above=0
    )


class JournalBearing(AbstractClearance):
    """Journal in a bearing, the axis free to tilt: contact at both end planes of the bearing, axial
    stop at the collars.

    At z_k = -L/2, L/2 the journal's axis pierces the plane at c_k, and delta_k = |c_k| - c + r_J (t
    . n_k)^2 / 2, n_k = c_k / |c_k|, t the slope of the journal's axis; the last term is the ellipse
    of a tilted cylinder to second order. No contact, one point, two opposite points and line
    contact (both ends on one side, sharing the load) all follow. The contact law acts at each end:
    a law for a line contact needs half of the length. The journal must reach through the bearing;
    without `flange` nothing holds it along the axis.
    """

    ideal_rows: ClassVar = ("x", "y", "z", "x.z", "y.z")
    contact: AbstractNormalLaw
    friction: AbstractFrictionLaw | None = None
    bearing_radius: Scalar = quantity(10e-3, "m", "radius of the bearing's hole", above=0)
    clearance: Scalar = quantity(
        0.1e-3, "m", "radial clearance, bearing radius - journal radius", above=0
    )
    length: Scalar = quantity(20e-3, "m", "length of the bearing", above=0)
    journal_length: Scalar | None = quantity(
        None, "m", "length of the journal, at least that of the bearing; checked only"
    )
    flange: Flange | None = None
    bearing_wear: Wearing | None = None
    journal_wear: Wearing | None = None

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
        return (
            contact_laws
            + (ContactLaws(self.flange.contact, self.flange.friction, half, False),) * 2
        )

    def end_centres(self, offset, axes) -> tuple[sp.Vec, sp.Vec]:
        """Points where the journal's axis pierces the bearing's lower and upper end plane."""
        slope = _slope(axes[0])
        centres = []
        for height in (-0.5 * self.length, 0.5 * self.length):
            rise = sp.sub(height, offset[2])
            centres.append(
                (
                    sp.add(offset[0], sp.mul(rise, slope[0])),
                    sp.add(offset[1], sp.mul(rise, slope[1])),
                    height,
                )
            )
        return tuple(centres)

    def indentations(self, offset, axes, worn):
        slope = _slope(axes[0])
        overlaps = []
        for end, centre in zip((-1, 1), self.end_centres(offset, axes), strict=True):
            x, y = _direction(centre)
            lean = sp.add(sp.mul(slope[0], x), sp.mul(slope[1], y))
            overlap = norm(centre[:2]) - self.clearance
            if not sp.is_zero(lean):
                overlap = overlap + 0.5 * self.journal_radius * lean * lean
            for surface in worn:
                place = (x, y) if surface == "bearing" else _seen_by(axes[1], x, y)
                overlap = overlap - self.maps()[surface][0].depth_at_end(worn[surface], *place, end)
            overlaps.append(overlap)
        if self.flange is not None:
            overlaps.extend(overlap for overlap, _ in self._flange_contacts(offset, axes))
        return tuple(overlaps)

    def _flange_contacts(self, offset, axes):
        """(indentation, place) of the collars at the lower and upper face."""
        axis = axes[0]
        sideways = safe_sqrt(sp.dot(axis[:2], axis[:2]))
        reach = 0.5 * self.length + self.flange.clearance
        for end in (-1, 1):
            centre = sp.plus(offset, sp.scale(end * reach, axis))
            # The rim's direction of steepest descent to the face; straight down the slope of the
            # tilted collar.
            along = [safe_divide(end * axis[2] * axis[i], sideways) for i in (0, 1)]
            place = sp.plus(
                centre, sp.scale(self.flange.radius, (along[0], along[1], -end * sideways))
            )
            yield 0.5 * self.length - end * place[2], place

    def contact_candidates(self, offset, axes, indentations):
        contact_candidates = []
        for centre, indentation in zip(
            self.end_centres(offset, axes), indentations[:2], strict=True
        ):
            x, y = _direction(centre)
            reach = self.bearing_radius + 0.5 * indentation
            contact_candidates.append(
                ContactCandidate(
                    (reach * x, reach * y, centre[2]), (x, y, 0), ((-y, x, 0), (0, 0, 1))
                )
            )
        if self.flange is not None:
            for end, (_, place) in zip((-1, 1), self._flange_contacts(offset, axes), strict=True):
                contact_candidates.append(
                    ContactCandidate(place, (0, 0, -end), ((1, 0, 0), (0, 1, 0)))
                )
        return tuple(contact_candidates)

    def maps(self):
        surfaces = {}
        if self.bearing_wear is not None:
            cylinder = CylinderMap(self.bearing_wear.cells, self.bearing_radius, self.length)
            surfaces["bearing"] = (cylinder, self.bearing_wear)
        if self.journal_wear is not None:
            cylinder = CylinderMap(self.journal_wear.cells, self.journal_radius, self.length)
            surfaces["journal"] = (cylinder, self.journal_wear)
        return surfaces

    def features(self, surface, offset, axes, indentations, index):
        centres = self.end_centres(offset, axes)
        x, y = _direction(centres[index])
        # Overlap of the other end on this side of the wall: the line through both tells over what
        # length they touch.
        other = centres[1 - index]
        opposite = sp.add(sp.mul(other[0], x), sp.mul(other[1], y)) - self.clearance
        here = indentations[index]
        share = safe_divide(here, here + positive_part(-opposite))
        place = (x, y) if surface == "bearing" else _seen_by(axes[1], x, y)
        return (*place, self.length * share, float(2 * index - 1))


class BallSocket(AbstractClearance):
    """Ball in a hollow socket: one contact. delta = |e| - c."""

    ideal_rows: ClassVar = ("x", "y", "z")
    contact: AbstractNormalLaw
    friction: AbstractFrictionLaw | None = None
    socket_radius: Scalar = quantity(10e-3, "m", "radius of the socket", above=0)
    clearance: Scalar = quantity(
        0.1e-3, "m", "radial clearance, socket radius - ball radius", above=0
    )
    socket_wear: Wearing | None = None

    @property
    def axes(self) -> tuple[int, ...]:
        return ()

    def contact_laws(self):
        shape = Shape(self.socket_radius - self.clearance, self.socket_radius, None)
        return (ContactLaws(self.contact, self.friction, shape, True),)

    def indentations(self, offset, axes, worn):
        overlap = norm(offset) - self.clearance
        if "socket" in worn:
            overlap = overlap - self.maps()["socket"][0].depth_towards(worn["socket"], *offset)
        return (overlap,)

    def contact_candidates(self, offset, axes, indentations):
        normal = _direction(offset, 3)
        # Cartesian directions: the engine removes the normal part, and no pole disturbs a bristle's
        # memory.
        return (
            ContactCandidate(
                sp.scale(self.socket_radius + 0.5 * indentations[0], normal), normal, sp.IDENTITY
            ),
        )

    def maps(self):
        if self.socket_wear is None:
            return {}
        return {"socket": (SphereMap(self.socket_wear.cells, self.socket_radius), self.socket_wear)}

    def features(self, surface, offset, axes, indentations, index):
        return _direction(offset, 3)


class SliderGuide(AbstractClearance):
    """Slider in a straight guide along z, gaps along x: each of the slider's four corners may touch
    a wall.

    delta = +-(x of the corner) - (w/2 + c) with w the slider's width; corners (+, -) x (front,
    back).
    """

    ideal_rows: ClassVar = ("x", "x.z")
    contact: AbstractNormalLaw
    friction: AbstractFrictionLaw | None = None
    width: Scalar = quantity(20e-3, "m", "width of the slider, across the guide", above=0)
    length: Scalar = quantity(40e-3, "m", "length of the slider, along the guide", above=0)
    clearance: Scalar = quantity(0.1e-3, "m", "gap on each side of a centred slider", above=0)
    corner_radius: Scalar = quantity(
        5e-3, "m", "rounding of a corner, for the stiffness only", above=0
    )

    @property
    def axes(self) -> tuple[int, ...]:
        return (0, 2)

    def contact_laws(self):
        # A rounded corner on a flat wall: the wall's radius is infinite, written as a very large
        # hole.
        shape = Shape(self.corner_radius, 1e6 * self.corner_radius, None)
        return (ContactLaws(self.contact, self.friction, shape, False),) * 4

    def _corners(self, offset, axes):
        across, along = axes
        for side in (-1, 1):
            for front in (-1, 1):
                arm = sp.plus(
                    sp.scale(side * 0.5 * self.width, across),
                    sp.scale(front * 0.5 * self.length, along),
                )
                yield side, sp.plus(offset, arm)

    def indentations(self, offset, axes, worn):
        half = 0.5 * self.width + self.clearance
        return tuple(side * corner[0] - half for side, corner in self._corners(offset, axes))

    def contact_candidates(self, offset, axes, indentations):
        return tuple(
            ContactCandidate(corner, (side, 0, 0), ((0, 0, 1),))
            for side, corner in self._corners(offset, axes)
        )

    def maps(self):
        return {}

    def features(self, surface, offset, axes, indentations, index):
        raise NotImplementedError("a guide has no wear map")


def _direction(vector, dimensions: int = 2) -> tuple:
    """Unit vector of the first components, zero at zero length."""
    inverse = safe_divide(1.0, norm(vector[:dimensions]))
    return tuple(sp.mul(inverse, component) for component in vector[:dimensions])


def _slope(axis) -> tuple:
    """Slope (dx/dz, dy/dz) of the journal's axis."""
    if isinstance(axis[2], int):
        return axis[:2]
    inverse = 1.0 / axis[2]
    return tuple(sp.mul(inverse, component) for component in axis[:2])


def _seen_by(journal_x, x, y) -> tuple:
    """A direction of the bearing's plane in the axes of the (turned) journal."""
    length = norm(journal_x[:2])
    cosine, sine = safe_divide(journal_x[0], length), safe_divide(journal_x[1], length)
    return (cosine * x + sine * y, cosine * y - sine * x)
