r"""What journal bearings have in common: how they share a reaction, the revolute joint that they
are while they always touch, and a bore that is not round.

A bore that is not round: its radius in Fourier form, and where a journal touches it.

:math:`R(\varphi) = R_B + r(\varphi)`, :math:`r = \sum_k a_k \cos k\varphi + b_k \sin k\varphi`, in
the bearing's axes, small beside the radius. A journal at e then overlaps the wall by the largest of
:math:`e \cdot n(\varphi) - c - r(\varphi)`; it touches at one angle, whatever e, while
:math:`c + r + r'' > 0` (r is then the support function of the places that the journal's centre may
take). Two lobes are an oval, three a bore bent by its chuck.
Source: Whitehouse 2011, Handbook of Surface and Nanometrology, 2nd ed., ch. 2 (roundness in Fourier
form).
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.clearance.base import AbstractClearance, AbstractPermanentJoint, direction
from jaxclear.components.cylinder_map import CylinderMap
from jaxclear.components.joint import Revolute
from jaxclear.components.joint.base import CarryingEnd, pressed_end
from jaxclear.components.journal_film import MobileJournal
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_sqrt
from jaxclear.ground.quantity import AbstractQuantified, Scalar, concrete, count, quantity
from jaxclear.laws.contact import AbstractNormalLaw
from jaxclear.laws.friction import AbstractFrictionLaw

# Turns of Newton's method on the angle; each squares what is left.
TURNS = 5


class Lobes(AbstractQuantified):
    """One harmonic of a bore's radius: `cosine` cos(k phi) + `sine` sin(k phi), k = `number`.

    Two lobes are an oval, three a trefoil. Peak to valley the bore is out of round by twice the
    amplitude.

    Args:
        number: lobes around the bore, a count, >= 2.
        cosine: deviation of the radius, cosine part [m].
        sine: deviation of the radius, sine part [m].
    """

    number: int = count(2, at_least=2)
    cosine: Scalar = quantity(0.0, "m", kw_only=True)
    sine: Scalar = quantity(0.0, "m", kw_only=True)


def radius_deviation(lobes: Sequence[Lobes], x: Any, y: Any) -> tuple[Any, Any, Any]:
    """Deviation of a bore's radius from a circle and its derivatives by the angle, r, r', r'' [m].

    Args:
        lobes: harmonics of the bore's form.
        x, y: unit vector of the direction, in the bearing's axes.
    """
    value, slope, bend = 0.0, 0.0, 0.0
    for part in lobes:
        k = part.number
        c, s = _rotate(x, y, k)
        wave = part.cosine * c + part.sine * s
        value, bend = value + wave, bend - k * k * wave
        slope = slope + k * (part.sine * c - part.cosine * s)
    return value, slope, bend


def _rotate(x: Any, y: Any, times: int) -> tuple[Any, Any]:
    """The direction at so many times the angle of (x, y), by squares: binary digits count."""
    c, s = x, y
    for digit in f"{times:b}"[1:]:
        c, s = c * c - s * s, 2 * (c * s)
        if digit == "1":
            c, s = c * x - s * y, s * x + c * y
    return c, s


def find_touch(lobes: Sequence[Lobes], clearance: Any, offset: sp.Vec) -> tuple[Any, Any, Any]:
    """Direction (x, y) in which a journal is nearest to the wall of a lobed bore, and its overlap.

    The overlap [m] is exact where the journal touches, and negative where it does not.

    Args:
        lobes: harmonics of the bore's form.
        clearance: mean radial clearance [m].
        offset: journal's centre in the bearing's frame [m].
    """
    x, y = direction(offset, 2)
    for _ in range(TURNS):
        value, slope, bend = radius_deviation(lobes, x, y)
        along = offset[0] * x + offset[1] * y
        across = offset[1] * x - offset[0] * y
        # What is farther in than the wall is treated as if it touched: there is no angle to find.
        step = (across - slope) / (jnp.maximum(along, clearance + value) + bend)
        size = 1 / jnp.sqrt(1 + step * step)
        x, y = size * (x - step * y), size * (y + step * x)
    value = radius_deviation(lobes, x, y)[0]
    return x, y, offset[0] * x + offset[1] * y - clearance - value


def leaned(lobes: Sequence[Lobes], clearance: Any, lean: sp.Vec) -> sp.Vec:
    """Position [m] of a journal that is pressed against a lobed bore.

    Args:
        lobes: harmonics of the bore's form.
        clearance: mean radial clearance [m].
        lean: direction of the wall's normal, of length 1 (or 0: no load).
    """
    x, y = lean[:2]
    value, slope, _ = radius_deviation(lobes, x, y)
    out = clearance + value
    return (out * x - slope * y, out * y + slope * x, 0)


def check_roundness(joint: Any) -> None:
    """Raises `ValueError` unless the journal touches the bore at one angle only, for sure."""
    lobes = joint.roundness
    if lobes is None:
        return
    plain = isinstance(lobes, tuple) and all(isinstance(x, Lobes) for x in lobes)
    if not plain or not lobes:
        raise ValueError(
            f"a {type(joint).__name__} has a roundness that is no tuple of "
            "jaxclear.clearance.Lobes; give a tuple of them, or None for a round bore."
        )
    clearance = concrete(joint.clearance)
    sizes: list[Any] = [(x.number, concrete(x.cosine), concrete(x.sine)) for x in lobes]
    if clearance is None or any(None in size for size in sizes):
        return
    bent = sum((k * k - 1) * (a * a + b * b) ** 0.5 for k, a, b in sizes)
    if bent >= clearance:
        raise ValueError(
            f"a {type(joint).__name__} has lobes so high for a clearance of {clearance:g} m that "
            "the journal may touch two of them at once: the sum of (number^2 - 1) x amplitude is "
            f"{bent:.3g} m and must stay below the clearance."
        )


class AbstractJournalBearing(AbstractClearance):
    """A journal in a bearing, both along z."""

    contact: eqx.AbstractVar[AbstractNormalLaw]
    friction: eqx.AbstractVar[AbstractFrictionLaw | None]
    bearing_radius: eqx.AbstractVar[Scalar]
    clearance: eqx.AbstractVar[Scalar]
    length: eqx.AbstractVar[Scalar]
    roundness: eqx.AbstractVar[tuple[Lobes, ...] | None]
    surfaces: ClassVar = ("bearing", "journal")

    def wall(self, surface: str, cells: tuple[int, int], coarseness: Scalar) -> CylinderMap:
        """Map of the bearing or the journal.

        Args:
            surface: name of the surface.
            cells: cells around and along, 2 counts.
            coarseness: number of cells side by side that are one [1].

        Returns:
            the map, a `CylinderMap`.
        """
        inside = self.bearing_radius - self.clearance
        radius = self.bearing_radius if surface == "bearing" else inside
        return CylinderMap(cells, radius, self.length, self.clearance, coarseness=coarseness)

    def touch(self, offset: sp.Vec) -> tuple[Any, Any, Any]:
        """Where a journal is nearest to the bore.

        Args:
            offset: vector from the bearing's centre to the journal's [m].

        Returns:
            direction (x, y) of that place [1], and the overlap there [m].
        """
        if self.roundness is None:
            return (*direction(offset, 2), sp.norm(offset[:2]) - self.clearance)
        return find_touch(self.roundness, self.clearance, offset)

    def leaned(self, lean: sp.Vec) -> sp.Vec:
        """Where a journal lies that is pressed in a direction.

        Args:
            lean: direction [1], of length 1, or 0 for the middle.

        Returns:
            offset of the journal [m], 3 components.
        """
        if self.roundness is None:
            return (*sp.scale(self.clearance, lean[:2]), 0)
        return leaned(self.roundness, self.clearance, lean)

    def grown(self, outer, inner):
        bore = outer * self.bearing_radius
        gap = bore - inner * (self.bearing_radius - self.clearance)
        sizes = lambda joint: (joint.bearing_radius, joint.clearance, joint.length)
        joint = eqx.tree_at(sizes, self, (bore, gap, outer * self.length))
        return joint.grown_along(self.length, outer, inner)

    def diameters(self):
        return 2.0 * self.bearing_radius, 2.0 * (self.bearing_radius - self.clearance)

    def with_diameters(self, outer, inner):
        sizes = 0.5 * outer, 0.5 * (outer - inner)
        return eqx.tree_at(lambda joint: (joint.bearing_radius, joint.clearance), self, sizes)

    def grown_along(self, length: Scalar, outer: Scalar, inner: Scalar) -> "AbstractJournalBearing":
        """The joint with larger sizes along its axis; nothing else changes unless overridden.

        Args:
            length: length of the bearing before [m].
            outer: factor of the bearing's sizes [1].
            inner: factor of the journal's sizes [1].

        Returns:
            the joint with these sizes.
        """
        return self

    @abstractmethod
    def end_forces(self, force: sp.Vec, torque: sp.Vec) -> tuple[tuple[sp.Vec, Any], ...]:
        """How a reaction is shared by the ends that carry it.

        Args:
            force: force on the journal [N], in the bearing's axes.
            torque: torque on the journal about its centre [N m], in the bearing's axes.

        Returns:
            force across the axis [N] and height along the bearing [m] of each end, a tuple of
            pairs.
        """

    def permanent_form(self):
        return PermanentRevolute(self)

    def seat(self, force, torque):
        # Each end lies where the wall pushes back, on the far side.
        ends = [
            (self.leaned(tuple(sp.neg(x) for x in direction(force, 2)))[:2], height)
            for force, height in self.end_forces(force, torque)
        ]
        (first, low), (last, high) = ends[0], ends[-1]
        if len(ends) == 1 or all(map(sp.is_zero, torque[:2])):
            return (*first, self.axial_seat(force[2], (0, 0))), (0, 0)
        slope = sp.scale(1 / sp.sub(high, low), tuple(map(sp.sub, last, first)))
        middle = sp.scale(0.5, tuple(map(sp.add, first, last)))
        return (*middle, self.axial_seat(force[2], slope)), slope

    def axial_seat(self, force: Any, slope: tuple) -> Any:
        """Where along the bearing a force presses the journal; 0, unless overridden, because
        nothing stops it.

        Args:
            force: force along the axis on the journal [N].
            slope: slope (dx/dz, dy/dz) of the journal's axis [1].

        Returns:
            the place [m].
        """
        return 0


class PermanentRevolute(AbstractPermanentJoint):
    """A journal that turns in its bearing and always touches: planar at one point, spatial at
    either end.

    The two ends share force and moment; on opposite sides they are two points, on one side a line.
    Axial force is carried by the collars and rubs without a torque.

    Args:
        gap: the joint with clearance, a `JournalBearing` or `PlanarJournalBearing`.
    """

    home: ClassVar = Revolute.home
    units: ClassVar = Revolute.units
    rows: ClassVar = Revolute.rows
    reversal: ClassVar = Revolute.reversal
    gap: AbstractJournalBearing

    @property
    def ideal(self):
        return Revolute()

    @property
    def friction(self):
        # A journal on its film does not touch.
        return None if self.gap.gap_load("") is not None else self.gap.friction

    def gap_load(self, name):
        film = self.gap.gap_load(name)
        return None if film is None else MobileJournal(name, film)

    @property
    def clearance(self) -> Scalar:
        """Radial clearance of the gap [m]."""
        return self.gap.clearance

    @property
    def arm(self):
        return self.gap.bearing_radius - self.gap.clearance

    @property
    def has_moving_centre(self):
        return True

    def friction_wrench(self, friction):
        return sp.ZERO, (0, 0, self.arm * friction)

    def carrying_ends(self, force, torque, ratio):
        ends = self.gap.end_forces(force, torque)
        size = (self.gap.bearing_radius, self.gap.clearance)
        carrying = tuple(
            pressed_end(k, f, height, ratio, *size) for k, (f, height) in enumerate(ends)
        )
        if self.gap.roundness is not None:
            leans = [direction(end.offset, 2) for end in carrying]
            pairs = zip(carrying, leans, strict=True)
            carrying = tuple(end._replace(offset=self.gap.leaned(lean)) for end, lean in pairs)
        along = self.gap.axial_seat(force[2], _slope_between_ends(carrying))
        if sp.is_zero(along):
            return carrying
        return tuple(end._replace(offset=(*end.offset[:2], along)) for end in carrying)

    def friction_ratio(self, mu):
        return mu / safe_sqrt(1 + mu * mu)


def _slope_between_ends(ends: tuple[CarryingEnd, ...]) -> tuple:
    """Slope (dx/dz, dy/dz) of a journal that lies so at its ends."""
    first, last = ends[0], ends[-1]
    if len(ends) == 1:
        return (0, 0)
    inverse = 1 / sp.sub(last.height, first.height)
    return tuple(sp.mul(inverse, sp.sub(last.offset[i], first.offset[i])) for i in (0, 1))
