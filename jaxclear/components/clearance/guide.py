"""Slider in a straight guide: contact at its corners; while it always touches, two of them carry.

Source of the permanent form: Luo, Qi & Kong, "Non-colliding contact analysis with friction in the
planar prismatic joint".
"""

from math import inf
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.clearance.base import (
    AbstractClearance,
    AbstractPermanentJoint,
    ContactCandidate,
    ContactLaws,
    check_clearance,
)
from jaxclear.components.joint import Prismatic
from jaxclear.components.joint.base import CarriedContact, CarryingEnd
from jaxclear.components.wall_map import WallMap
from jaxclear.components.wear_map import Wearing
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part
from jaxclear.ground.quantity import Scalar, concrete, quantity
from jaxclear.laws.contact import AbstractNormalLaw
from jaxclear.laws.friction import AbstractFrictionLaw
from jaxclear.laws.stiffness import Shape

# Radius of the hole that stands for a flat wall, relative to that of the corner in it.
FLAT = 1e6
# Height of a unit axis above the plane, beyond which it is not meant to lie in it.
ACROSS = 1e-6


class SliderGuide(AbstractClearance):
    r"""Slider in a straight guide along z, gaps along x: each of its four corners may touch a wall.

    :math:`\delta = \pm x - (w/2 + c)` with x of the corner and w the slider's width; corners (-, +)
    x (back, front). A run in which the slider leaves walls that wear ends and says so. A face loses
    where it overlaps the worn wall on the line between its corners: all along where it lies flat,
    at a corner where it is tilted.

    Args:
        contact: contact law, one of `jaxclear.contact`.
        friction: friction law, one of `jaxclear.friction`; none by default.
        width: width of the slider, across the guide [m], > 0.
        length: length of the slider, along the guide [m], > 0.
        clearance: gap on each side of a centred slider [m], > 0.
        corner_radius: rounding of a corner, for the stiffness only [m], > 0.
        guide_wear: wear of the guide's walls, a `Wearing`, of whose cells the number along counts;
            none by default.
        slider_wear: wear of the slider's faces, a `Wearing`, of whose cells the number along
            counts; none by default.
        breadth: breadth of the faces that wear, along y [m], > 0; needed with wear.
        guide_length: length of the walls that wear, along the guide [m], > 0; needed where the
            guide wears.
        guide_middle: place of these walls' middle along the guide [m]; None: its marker.

    Raises:
        ValueError: if the clearance is not below the width; for wear without the sizes that it
            needs, or with `worn_radius`.
    """

    ideal_rows: ClassVar = ("x", "x.z")
    surfaces: ClassVar = ("guide", "slider")
    contact: AbstractNormalLaw
    friction: AbstractFrictionLaw | None = None
    width: Scalar = quantity(20e-3, "m", above=0, kw_only=True)
    length: Scalar = quantity(40e-3, "m", above=0, kw_only=True)
    clearance: Scalar = quantity(0.1e-3, "m", above=0, kw_only=True)
    corner_radius: Scalar = quantity(5e-3, "m", above=0, kw_only=True)
    guide_wear: Wearing | None = eqx.field(default=None, kw_only=True)
    slider_wear: Wearing | None = eqx.field(default=None, kw_only=True)
    breadth: Scalar | None = quantity(None, "m", above=0, kw_only=True)
    guide_length: Scalar | None = quantity(None, "m", above=0, kw_only=True)
    guide_middle: Scalar | None = quantity(None, "m", kw_only=True)

    def __check_init__(self):
        check_clearance(self, "width")
        _check_wear(self)

    @property
    def axes(self) -> tuple[int, ...]:
        return (0, 2)

    def contact_laws(self):
        shape = Shape(self.corner_radius, FLAT * self.corner_radius, None)
        return (ContactLaws(self.contact, self.friction, shape, True),) * 4

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
        half, maps = 0.5 * self.width + self.clearance, self.maps() if worn else {}
        overlaps = []
        for k, (side, corner) in enumerate(self._corners(offset, axes)):
            overlap, (wall, front) = side * corner[0] - half, divmod(k, 2)
            if "guide" in worn:
                overlap = overlap - maps["guide"][0].depth_at(worn["guide"], wall, corner[2])
            if "slider" in worn:
                end = 2 * front - 1
                overlap = overlap - maps["slider"][0].depth_at_end(worn["slider"], wall, end)
            overlaps.append(overlap)
        return tuple(overlaps)

    def contact_candidates(self, offset, axes, indentations):
        return tuple(
            ContactCandidate(corner, (side, 0, 0), ((0, 0, 1),))
            for side, corner in self._corners(offset, axes)
        )

    def wear_map(self, surface, wearing):
        middle, half = jnp.zeros(()), 0.5 * self.width
        length, distance = self.length, half
        if surface == "guide":
            length, distance = self.guide_length, half + self.clearance
            middle = middle if self.guide_middle is None else self.guide_middle
        sizes = length, middle, self.length, self.breadth, self.clearance, distance
        return WallMap((2, wearing.cells[1]), *sizes, coarseness=wearing.coarseness)

    def features(self, surface, offset, axes, indentations, index):
        corners = tuple(self._corners(offset, axes))
        # Corners of one side follow upon each other.
        (side, here), (_, other) = corners[index], corners[index ^ 1]
        wall, front = divmod(index, 2)
        end, fall = 2 * front - 1, side * (here[0] - other[0])
        place: tuple[Any, Any] = 0.0, 0.0
        if surface == "guide":
            walls, _ = self.maps()["guide"]
            middle = here[2] - walls.middle - 0.5 * end * self.length
            # Beyond the walls nothing is known: the run ends, and says why.
            middle = jnp.where(walls.within(here[2]), middle, jnp.nan)
            place = middle, middle * middle
        return (*place, fall, positive_part(indentations[index]), float(wall), float(end))

    def check_plane(self, heights):
        if max(abs(heights[0]), abs(heights[2])) > ACROSS:
            raise ValueError(
                "is a SliderGuide whose axis (z of its marker) and gaps (x) must lie in the plane "
                'in which its parts move: give the connection, or both markers, axis="x", "-x", '
                '"y" or "-y", or another direction as its two numbers in the plane.'
            )

    def grown(self, outer, inner):
        width = inner * self.width
        gap = outer * (0.5 * self.width + self.clearance) - 0.5 * width
        sizes = lambda j: (j.width, j.clearance, j.length)
        joint = eqx.tree_at(sizes, self, (width, gap, inner * self.length))
        for name, factor in (("breadth", inner), ("guide_length", outer), ("guide_middle", outer)):
            size = getattr(self, name)
            if size is not None:
                joint = eqx.tree_at(lambda j, name=name: getattr(j, name), joint, factor * size)
        return joint

    def diameters(self):
        return self.width + 2.0 * self.clearance, self.width

    def with_diameters(self, outer, inner):
        sizes = inner, 0.5 * (outer - inner)
        return eqx.tree_at(lambda joint: (joint.width, joint.clearance), self, sizes)

    def seat(self, force, torque):
        first, last = self.permanent_form().carrying_ends(force, torque, 0.0)
        slope = sp.mul(1 / self.length, sp.sub(last.offset[0], first.offset[0]))
        return (sp.mul(0.5, sp.add(first.offset[0], last.offset[0])), 0, 0), (slope, 0)

    def permanent_form(self):
        return PermanentPrismatic(self)


def _check_wear(joint: SliderGuide) -> None:
    """Raises `ValueError` where a guide wears and does not tell where, or asks for a radius of flat
    walls."""
    wearing = {"guide_wear": joint.guide_wear, "slider_wear": joint.slider_wear}
    wears = {name: w for name, w in wearing.items() if w is not None}
    for name, w in wears.items():
        if w.worn_radius:
            raise ValueError(
                f"the {name} of a SliderGuide has worn_radius=True, but flat walls have no radius; "
                "leave worn_radius out."
            )
    missing = [] if joint.breadth is not None or not wears else ["breadth"]
    if joint.guide_wear is not None and joint.guide_length is None:
        missing.append("guide_length")
    if missing:
        raise ValueError(
            f"a SliderGuide with {' and '.join(wears)} has no {' and no '.join(missing)}; give the "
            "breadth of the faces and, where the guide wears, the length of its walls [m], over "
            "which the slider travels about guide_middle."
        )
    walls, face = concrete(joint.guide_length), concrete(joint.length)
    if walls is not None and face is not None and 0 < walls < face < inf:
        raise ValueError(
            f"a SliderGuide has a slider of length {face:g} m on walls of guide_length {walls:g} "
            "m; they must be as long as the slider and its travel."
        )


class PermanentPrismatic(AbstractPermanentJoint):
    """A slider that always touches its guide, with two of its four corners.

    Args:
        gap: the joint with clearance, a `SliderGuide`.
    """

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
            end = sp.add(sp.mul(0.5, force[0]), sp.mul(along, pair))
            height = sp.mul(0.5 * along, self.gap.length)
            contacts = []
            for side in (0, 1):
                # The wall on one side pushes towards the other.
                place = (0.5 * (2 * side - 1) * self.gap.width, 0, height)
                normal = positive_part(end if side == 0 else sp.neg(end))
                contacts.append(
                    CarriedContact(2 * side + front, normal, sp.mul(ratio, normal), place)
                )
            offset = (-jnp.sign(end) * self.gap.clearance, 0, 0)
            ends.append(CarryingEnd(height, (end, 0, 0), offset, tuple(contacts)))
        return tuple(ends)

    def friction_ratio(self, mu):
        return mu
