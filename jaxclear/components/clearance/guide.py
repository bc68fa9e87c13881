"""Slider in a straight guide: contact at its corners; while it always touches, two of them carry.

Source of the permanent form: Luo, Qi & Kong, "Non-colliding contact analysis with friction in the
planar prismatic joint".
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.clearance.base import (
    AbstractClearance,
    ContactCandidate,
    ContactLaws,
    check_clearance,
)
from jaxclear.components.clearance.permanent import AbstractPermanentJoint
from jaxclear.components.joint import Prismatic
from jaxclear.components.joint.rubbing import CarriedContact, CarryingEnd
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.contact import AbstractNormalLaw
from jaxclear.laws.friction import AbstractFrictionLaw
from jaxclear.laws.stiffness import Shape

# Radius of the hole that stands for a flat wall, relative to that of the corner in it.
FLAT = 1e6
# Height of a unit axis above the plane, beyond which it is not meant to lie in it.
ACROSS = 1e-6


class SliderGuide(AbstractClearance):
    r"""Slider in a straight guide along z, gaps along x: each of the slider's four corners may
    touch a wall.

    :math:`\delta = \pm x - (w/2 + c)` with x of the corner and w the slider's width; corners
    (-, +) x (back, front).
    """

    ideal_rows: ClassVar = ("x", "x.z")
    contact: AbstractNormalLaw
    friction: AbstractFrictionLaw | None = None
    width: Scalar = quantity(
        20e-3, "m", "width of the slider, across the guide", above=0, kw_only=True
    )
    length: Scalar = quantity(
        40e-3, "m", "length of the slider, along the guide", above=0, kw_only=True
    )
    clearance: Scalar = quantity(
        0.1e-3, "m", "gap on each side of a centred slider", above=0, kw_only=True
    )
    corner_radius: Scalar = quantity(
        5e-3, "m", "rounding of a corner, for the stiffness only", above=0, kw_only=True
    )

    def __check_init__(self):
        check_clearance(self, "width")

    @property
    def axes(self) -> tuple[int, ...]:
        return (0, 2)

    def contact_laws(self):
        shape = Shape(self.corner_radius, FLAT * self.corner_radius, None)
        return (ContactLaws(self.contact, self.friction, shape, False),) * 4

    def contact_names(self):
        return ("lower back", "lower front", "upper back", "upper front")

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

    def check_plane(self, heights):
        if max(abs(heights[0]), abs(heights[2])) > ACROSS:
            raise ValueError(
                "is a SliderGuide whose axis (z of its marker) and gaps (x) must lie in the plane "
                'in which its parts move: give the connection, or both markers, axis="x", "-x", '
                '"y" or "-y"; a guide along another direction takes markers with a quaternion.'
            )

    def grown(self, outer, inner):
        width = inner * self.width
        gap = outer * (0.5 * self.width + self.clearance) - 0.5 * width
        sizes = lambda own: (own.width, own.clearance, own.length)
        return eqx.tree_at(sizes, self, (width, gap, inner * self.length))

    def seat(self, force, torque):
        first, last = self.permanent_form().carrying_ends(force, torque, 0.0)
        slope = sp.mul(1 / self.length, sp.sub(last.offset[0], first.offset[0]))
        return (sp.mul(0.5, sp.add(first.offset[0], last.offset[0])), 0, 0), (slope, 0)

    def permanent_form(self):
        return PermanentPrismatic(self)


class PermanentPrismatic(AbstractPermanentJoint):
    """A slider that always touches its guide, with two of its four corners."""

    home: ClassVar = Prismatic.home
    units: ClassVar = Prismatic.units
    rows: ClassVar = Prismatic.rows
    reversal: ClassVar = Prismatic.reversal
    gap: SliderGuide

    @property
    def ideal(self):
        return Prismatic()

    @property
    def friction(self):
        return self.gap.friction

    @property
    def arm(self):
        return 1

    def friction_wrench(self, friction):
        return (0, 0, friction), sp.ZERO

    def carrying_ends(self, force, torque, ratio):
        # Friction at half the width from the axis adds to the moment: torque = l/2 (front - back) +
        # w/2 ratio (front + back).
        moment = sp.sub(torque[1], sp.mul(0.5 * self.gap.width * ratio, force[0]))
        pair = sp.mul(1 / self.gap.length, moment)
        ends = []
        for front, along in enumerate((-1, 1)):
            own = sp.add(sp.mul(0.5, force[0]), sp.mul(along, pair))
            height = sp.mul(0.5 * along, self.gap.length)
            contacts = []
            for side in (0, 1):
                # The wall on one side pushes towards the other.
                place = (0.5 * (2 * side - 1) * self.gap.width, 0, height)
                normal = positive_part(own if side == 0 else sp.neg(own))
                contacts.append(
                    CarriedContact(2 * side + front, normal, sp.mul(ratio, normal), place)
                )
            offset = (-jnp.sign(own) * self.gap.clearance, 0, 0)
            ends.append(CarryingEnd(height, (own, 0, 0), offset, tuple(contacts)))
        return tuple(ends)

    def friction_ratio(self, mu):
        return mu
