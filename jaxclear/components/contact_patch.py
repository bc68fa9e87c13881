r"""Which share of a lost volume each cell of a worn surface gives: its own pressure's.

Where the rigid outlines of the parts, worn as they are, would overlap by u, the pressure goes with
:math:`\sqrt u`. On a surface without wear this is Hertz's pressure, of lines as of points; the
depth of the overlap is half the indentation, which gives Hertz's contact area for points, and for
lines to about a quarter of its width. On a worn surface the pressure spreads as the wall conforms.
Source: Hertz 1882, doi:10.1515/crll.1882.92.156; virtual interpenetration for other shapes as in
Piotrowski & Kik 2008, Vehicle Syst. Dyn. 46, 27.

A contact that moves while it wears leaves to each cell the mean of its pressures there over the arc
of its way: the arc convolved with the contact's width. Arcs that follow upon each other add up to
the whole, however many they are.

The pressure is that after the loss, so a loss brings the wall at most to the shape of the part that
has cut it: no loss, however large, digs waves. Where a contact is narrower than two cells, the loss
is that of a contact as wide as these.
"""

from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground.numerics import arc_sine, positive_part, power, safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar

# The level of a part is sought by Newton's method until the overlap is within this share of that
# wanted; so many steps, that one and those after it, then bring it, and its derivatives, to
# rounding. Volumes grow with a power of 1 to 2.5 of how deep a part sinks, so a step loses at least
# 2/5 of what is too much: from anywhere these are enough.
NEAR, LAST_STEPS, MOST_STEPS = 0.03, 3, 60
# Half of the least width [cells] of a contact: narrower ones jump from cell to cell.
LEAST_WIDTH = 1.0
# Width of a kink, relative to the clearance, where nothing else rounds it.
SHARPEST = 1e-9
# Share of its own pressure that is added to the mean over the way, so that some cell has one.
LEAST_SHARE = 1e-6


class Elasticity(NamedTuple):
    """What the load of a contact overlaps on a wall without wear: `depth` [m], and the integrals of
    the overlap [m3] over all of its way and of its root [m2.5] over the contact."""

    depth: Scalar
    overlap: Scalar
    root: Scalar


class Overlapping(Protocol):
    """How a part overlaps cells: its slope by the level is `cosine` times the share `at` that."""

    @property
    def cosine(self) -> Any: ...

    def at(self, level: Scalar) -> tuple[Array, Array]:
        """(mean over each cell of the overlap [m], where there is one; share of the cell where
        there is) at an eccentricity [m]."""


class Outline(NamedTuple):
    """How a part at eccentricity e [m] overlaps cells: by e `cosine` - `room`; `rounding`: half the
    change of that across a cell [m]."""

    cosine: Float[Array, "..."] | Scalar
    room: Float[Array, "around along"]
    rounding: Float[Array, "..."] | Scalar

    def at(self, level: Scalar) -> tuple[Array, Array]:
        """(mean over each cell of the overlap [m], where there is one; share of the cell where
        there is) at an eccentricity [m]."""
        middle = level * self.cosine - self.room
        inside = jnp.clip(middle + self.rounding, 0.0, 2.0 * self.rounding)
        share = inside * (0.5 / self.rounding)
        return 0.5 * inside * share + jnp.maximum(middle - self.rounding, 0.0), share


class Way(NamedTuple):
    """The arc that a contact goes through: cells lie `along` it [rad, 0 to pi] from its middle, and
    overlap as `nearest` says when the contact comes closest; `half` the arc [rad], with the width
    of a cell; `room` between the parts [m], centred, on the worn wall."""

    along: Float[Array, "..."]
    nearest: Outline
    half: Array
    room: Float[Array, "around along"]


class Patch(NamedTuple):
    """Cells and the part that wears them: the `outline` of all that it overlaps on its `way`.

    `area` of a cell of each row [m2]; `share` of the pressure there that is this contact's;
    `start`: an eccentricity [m] near the solution and at or above it.
    """

    outline: Overlapping
    way: Way
    area: Float[Array, " along"]
    share: Float[Array, " along"] | Scalar
    start: Scalar
    elasticity: Elasticity

    def overlapped(self, level: Scalar) -> tuple[Array, Array]:
        """(mean over each cell of the overlap [m], its slope by the level) at an eccentricity
        [m]."""
        overlap, share = self.outline.at(level)
        return overlap, self.outline.cosine * share

    def pressures(self, volume: Scalar, level: Scalar) -> Float[Array, "around along"]:
        """As `pressures`."""
        return pressures(volume, self, level)


class Cells(Protocol):
    """Cells and the part that wears them."""

    @property
    def area(self) -> Any:
        """Of a cell of each row [m2]."""

    @property
    def start(self) -> Scalar:
        """A level of the part [m] near the solution and at or above it."""

    @property
    def elasticity(self) -> Elasticity:
        """What its load overlaps before anything is lost."""

    def overlapped(self, level: Scalar) -> tuple[Array, Array]:
        """(mean over each cell of the overlap [m], its slope by the level) at a level [m]."""

    def pressures(self, volume: Scalar, level: Scalar) -> Array:
        """What each cell loses beside the others of a volume [m3], where the part that wears them
        has come to a level [m]."""


def depth_lost(volume: Scalar, patch: Cells) -> tuple[Float[Array, "around along"], Scalar]:
    r"""(depth [m] that each cell loses, `volume` [m3] in all; eccentricity [m] of the part): in
    proportion to its mean pressure after the loss, :math:`\Delta h = (V/S) w m\sqrt{u - \Delta h}`
    with u the largest overlap on the way before it, w the contact's share, m the mean of the roots
    over the way beside the largest and S the integral of w times the root of a contact.
    """

    def total(cells):
        # A product with a vector is several times faster than a sum.
        return jnp.sum(cells @ patch.area)

    def closer(volume, patch, level):
        overlap, slope = patch.overlapped(level)
        return next_level(level, volume + patch.elasticity.overlap, total(overlap), total(slope))

    # Held as they are: a loop that ends by itself has no derivative in reverse mode.
    held = jax.lax.stop_gradient((volume, patch))

    def turn(now):
        count, _, level = now
        return count + 1, *closer(*held, level)

    first = jnp.zeros((), int), jnp.zeros((), bool), held[1].start
    level = jax.lax.while_loop(lambda now: ~now[1] & (now[0] < MOST_STEPS), turn, first)[2]
    for _ in range(LAST_STEPS - 1):
        _, level = closer(volume, patch, level)
    pressure = patch.pressures(volume, level)
    return volume * safe_divide(1.0, total(pressure)) * pressure, level


def next_level(
    level: Scalar, wanted: Scalar, overlap: Scalar, slope: Scalar
) -> tuple[Array, Scalar]:
    """(whether an overlap [m3] at a level is near that wanted, the next level [m]); `slope` of the
    overlap [m2]. The overlap of all cells is convex in the level, so that there is one solution,
    and from above it every step stays above."""
    missing = wanted - overlap
    return jnp.abs(missing) <= NEAR * wanted, level + safe_divide(missing, slope)


def pressures(volume: Scalar, patch: Patch, level: Scalar) -> Float[Array, "around along"]:
    """What each cell loses beside the others, where the part that wears them has come to a level
    [m]."""
    overlap = patch.outline.at(level)[0]
    mean = patch.share * (_mean_root(patch.way, level) + LEAST_SHARE * safe_sqrt(overlap))
    own, whole = volume * mean, 2.0 * patch.elasticity.root * overlap
    return safe_divide(mean * overlap, own + safe_sqrt(own * own + whole * whole))


def _mean_root(way: Way, level: Scalar) -> Float[Array, "around along"]:
    """Mean over the way, and over each cell, of the root of the overlap [m0.5]: as the contact
    passes a cell, the overlap there is a parabola of the angle between both."""
    overlap = way.nearest.at(level)[0]
    # An overlap e - room that falls as e cos does vanishes where 1 - cos is this.
    fallen = overlap / (overlap + way.room)
    half_width = 2.0 * arc_sine(safe_sqrt(0.5 * fallen))
    ends = way.along + way.half, way.along - way.half, way.along + way.half - 2.0 * jnp.pi
    first, last, around = (_segment(safe_divide(end, half_width)) for end in ends)
    swept = first - last + around + 0.25 * jnp.pi
    return safe_sqrt(overlap) * half_width * swept / (2.0 * way.half)


@jax.custom_jvp
def _segment(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """Integral of sqrt(1 - t^2) from 0 to x, which lies within -1 and 1 or is taken so."""
    x = jnp.clip(x, -1.0, 1.0)
    return 0.5 * (x * safe_sqrt(1.0 - x * x) + arc_sine(x))


@_segment.defjvp
def _segment_jvp(primals, tangents):
    (x,), (x_dot,) = primals, tangents
    return _segment(x), safe_sqrt(1.0 - x * x) * x_dot


def line_contact(
    depth: Scalar, radius: Scalar, clearance: Scalar, length: Scalar, half_arc: Scalar
) -> Elasticity:
    """A journal that overlaps its bearing so deep along so long a line [m], while the line goes
    through an arc."""
    half_width = safe_sqrt(2.0 * depth / clearance)
    area = radius * length
    overlap = 4 / 3 * area * depth * (half_width + 1.5 * half_arc)
    root = 0.5 * jnp.pi * area * safe_sqrt(depth) * half_width
    return Elasticity(depth, overlap, root)


def point_contact(depth: Scalar, radius: Scalar, clearance: Scalar, half_arc: Scalar) -> Elasticity:
    """A ball that overlaps its socket so deep [m], while the point goes through an arc."""
    half_width = safe_sqrt(2.0 * depth / clearance)
    area = radius * radius * half_width
    overlap = area * depth * (0.5 * jnp.pi * half_width + 8 / 3 * half_arc)
    root = 2 / 3 * jnp.pi * area * safe_sqrt(depth) * half_width
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


def square_width(indentation: Scalar, cell: Scalar, clearance: Scalar) -> Scalar:
    """Square of half the width [rad2] of a contact of some indentation [m], which is two cells wide
    at least (`cell`: angle of one [rad]); the outlines overlap by half the indentation there."""
    return positive_part(indentation) / clearance + (LEAST_WIDTH * cell) ** 2


def depth_of(square: Scalar, cell: Scalar, clearance: Scalar) -> Scalar:
    """Overlap [m] of a contact whose half width [rad] has this square; 0 stands for none."""
    return 0.5 * clearance * jnp.maximum(square, (LEAST_WIDTH * cell) ** 2)


def arc_with_cell(half_arc: Scalar, cell: Array | float) -> Array:
    """Half of an arc [rad] over which, and over cells of this angle [rad], a mean is taken: as two
    spreads add up."""
    return jnp.sqrt(half_arc * half_arc + 0.25 * cell * cell)


def arc(length: Scalar) -> Scalar:
    """Half the arc a [rad] over which unit vectors are spread evenly whose mean has this length,
    sin(a)/a; within 1 %."""
    missing = 1.0 - length
    square = missing * (6.0 + missing * (1.8 + missing * (jnp.pi**2 - 7.8)))
    return safe_sqrt(square)
