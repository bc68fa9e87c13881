r"""Which share of a lost volume each cell of a worn surface gives: its own pressure's.

Where the rigid outlines of the parts, worn as they are, would overlap by u, the pressure goes with
:math:`\sqrt u`. On a surface without wear this is Hertz's pressure, of lines as of points; the
depth of the overlap is half the indentation, which gives Hertz's contact area for points, and for
lines to about a quarter of its width. On a worn surface the pressure spreads as the wall conforms.
Source: Hertz 1882, doi:10.1515/crll.1882.92.156; virtual interpenetration for other shapes as in
Piotrowski & Kik 2008, Vehicle Syst. Dyn. 46, 27.

The pressure is that after the loss, so a loss brings the wall at most to the shape of the part that
has cut it: no loss, however large, digs waves. Where a contact is narrower than a cell, the loss is
that of a contact as wide as the cell.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground.numerics import power, safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar

# Steps of Newton's method for the level of the part; what is left changes shapes, not volumes.
STEPS = 3
# Half of the least width [cells] of a contact.
LEAST_WIDTH = 0.5
# Width of a kink, relative to the clearance, where nothing else rounds it.
SHARPEST = 1e-9


class Elasticity(NamedTuple):
    """What the load of a contact overlaps on a wall without wear: `depth` [m], and the integrals of
    the overlap [m3] and of its root [m2.5] over the contact."""

    depth: Scalar
    overlap: Scalar
    root: Scalar


class Patch(NamedTuple):
    """Cells and the part that wears them: the part at eccentricity e [m] overlaps a cell by
    e `cosine` - `room`.

    `rounding`: half the change of the overlap across a cell [m]; `area` of a cell of each row
    [m2]; `share` of the pressure there that is this contact's; `start`: an eccentricity [m] near
    the solution and at or above it.
    """

    cosine: Float[Array, "..."]
    room: Float[Array, "around along"]
    rounding: Float[Array, "..."]
    area: Float[Array, " along"]
    share: Float[Array, " along"] | Scalar
    start: Scalar
    elasticity: Elasticity


def depth_lost(volume: Scalar, patch: Patch) -> tuple[Float[Array, "around along"], Scalar]:
    r"""(depth [m] that each cell loses, `volume` [m3] in all; eccentricity [m] of the part): in
    proportion to its pressure after the loss, :math:`\Delta h = (V/S) w\sqrt{u - \Delta h}` with u
    the overlap before it, w the contact's share and S the integral of w times the root.
    """
    load = patch.elasticity
    wanted = volume + load.overlap

    widest, sharpness = 2.0 * patch.rounding, 0.5 / patch.rounding

    def overlaps(level):
        """(mean over each cell of the overlap, where there is one; share of the cell where there
        is)."""
        middle = level * patch.cosine - patch.room
        inside = jnp.clip(middle + patch.rounding, 0.0, widest)
        share = inside * sharpness
        return 0.5 * inside * share + jnp.maximum(middle - patch.rounding, 0.0), share

    def total(cells):
        # A product with a vector is several times faster than a sum.
        return jnp.sum(cells @ patch.area)

    def closer(level):
        overlap, share = overlaps(level)
        return level + safe_divide(wanted - total(overlap), total(patch.cosine * share))

    # The overlap of all cells is convex in the level: from above, every step stays above.
    level = patch.start
    for _ in range(STEPS):
        level = closer(level)
    overlap = overlaps(level)[0]
    own = patch.share * volume
    root = safe_sqrt(own * own + 4.0 * load.root * load.root * overlap)
    pressure = safe_divide(patch.share * overlap, own + root)
    return volume * safe_divide(1.0, total(pressure)) * pressure, level


def line_contact(
    depth: Scalar, radius: Scalar, clearance: Scalar, length: Scalar, half_arc: Scalar
) -> Elasticity:
    """A journal that overlaps its bearing so deep along so long a line [m], while the line goes
    through an arc."""
    half_width = safe_sqrt(2.0 * depth / clearance)
    area = radius * length
    overlap = 4 / 3 * area * depth * (half_width + 1.5 * half_arc)
    root = 0.5 * jnp.pi * area * safe_sqrt(depth) * (half_width + 4 / jnp.pi * half_arc)
    return Elasticity(depth, overlap, root)


def point_contact(depth: Scalar, radius: Scalar, clearance: Scalar, half_arc: Scalar) -> Elasticity:
    """A ball that overlaps its socket so deep [m], while the point goes through an arc."""
    half_width = safe_sqrt(2.0 * depth / clearance)
    area = radius * radius * half_width
    overlap = area * depth * (0.5 * jnp.pi * half_width + 8 / 3 * half_arc)
    root = area * safe_sqrt(depth) * (2 / 3 * jnp.pi * half_width + jnp.pi * half_arc)
    return Elasticity(depth, overlap, root)


def line_sunk(
    volume: Scalar, radius: Scalar, clearance: Scalar, length: Scalar, fall: Scalar
) -> Scalar:
    """How deep [m] a journal sinks into an unworn bearing that overlaps it by a volume [m3], or a
    little less; `fall` of the overlap over the length [m]."""
    parallel = volume / (4 / 3 * radius * length * safe_sqrt(2.0 / clearance))
    return jnp.maximum(jnp.cbrt(parallel) ** 2, power(2.5 * fall * parallel, jnp.asarray(0.4)))


def point_sunk(volume: Scalar, radius: Scalar, clearance: Scalar) -> Scalar:
    """How deep [m] a ball sinks into an unworn socket that overlaps it by a volume [m3]."""
    return safe_sqrt(volume * clearance / jnp.pi) / radius


def least_depth(cell: Scalar, clearance: Scalar) -> Scalar:
    """Overlap [m] of a contact that is as wide as a cell, of so large an angle [rad]."""
    return 0.5 * clearance * (LEAST_WIDTH * cell) ** 2


def arc(length: Scalar) -> Scalar:
    """Half the arc a [rad] over which unit vectors are spread evenly whose mean has this length,
    sin(a)/a; within 1 %."""
    missing = 1.0 - length
    square = missing * (6.0 + missing * (1.8 + missing * (jnp.pi**2 - 7.8)))
    return safe_sqrt(square)
