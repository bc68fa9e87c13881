"""Where material is lost: worn depth on a cylinder (theta x z) or a sphere (azimuth x elevation).

Every cell loses what its own pressure takes, which follows from its own gap on the worn surface
(`contact_patch`): on a cylinder also along the tilted journal. Volume is conserved to rounding, and
depth is a smooth function of where and how much. What is lost between two saving times is spread
over the arc that the contact has gone through. Quadratic B-splines read the depth back when the
worn surface enters the gap.
"""

import math
from abc import abstractmethod

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.components.contact_patch import (
    SHARPEST,
    Outline,
    Patch,
    Way,
    arc,
    arc_with_cell,
    depth_lost,
    depth_of,
    line_contact,
    line_sunk,
    square_width,
)
from jaxclear.ground.numerics import TINY_SQUARE, positive_part, safe_divide, safe_sqrt
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.laws.wear import AbstractWearLaw

# Angle [rad] to either side of a contact that is looked at first.
REACH = 0.6


class Wearing(AbstractQuantified):
    """A surface that wears: its law (of this surface alone), and the number of cells around and
    along (azimuth and elevation on a sphere).

    `acceleration` multiplies the worn volume: one simulated cycle standing for many (linear
    extrapolation, as in cycle-jump schemes). `worn_radius`: whether what the contact law takes from
    the geometry, its stiffness say, is that of the radius as worn at the contact, not as made.
    """

    law: AbstractWearLaw
    cells: tuple[int, int] = eqx.field(
        static=True,
        default=(72, 20),
        converter=lambda given: tuple(given) if isinstance(given, list) else given,
        metadata={"wanted": "2 whole numbers: cells around and along"},
    )
    acceleration: Scalar = quantity(1.0, "1", "worn volume per simulated volume", at_least=0)
    worn_radius: bool = eqx.field(static=True, default=False, kw_only=True)

    def __check_init__(self):
        if self.cells[0] < 4 or self.cells[1] < 1:
            raise ValueError(
                f"a wear map must have at least 4 cells around and 1 along, not {self.cells}."
            )


class AbstractWearMap(AbstractQuantified):
    """Geometry of a wear map; the depth itself is an array (cells) [m] kept by the simulation."""

    cells: eqx.AbstractVar[tuple[int, int]]

    @abstractmethod
    def areas(self) -> Float[Array, "around along"]:
        """Area of each cell [m2]."""

    @abstractmethod
    def reading(self, depth):
        """The depth in the form in which the gap reads it; made once for as long as the depth stays
        as it is.
        """

    @abstractmethod
    def deposit(self, depth, volume, features):
        """Depth after losing `volume` (events,) [m3] at `features` (events, n): means of each
        event's location, weighted by what was lost there.
        """

    def directions_of(self, features):
        """Mean direction (..., up to 3) of each event: of length 1 where it was at one place, as
        always unless overridden."""
        return jnp.ones((*features.shape[:-1], 1))

    def covered(self, features):
        """(half the width [rad], share of the surface) that the contact of each event (...)
        covers: all of it unless overridden."""
        whole = jnp.ones(features.shape[:-1])
        return whole, whole


def direction_angle(x: Float[Array, "..."], y: Float[Array, "..."]) -> Float[Array, "..."]:
    """atan2(y, x), and 0 with zero derivative at the origin, where a direction does not exist."""
    somewhere = x * x + y * y > TINY_SQUARE
    return jnp.where(
        somewhere, jnp.arctan2(jnp.where(somewhere, y, 0.0), jnp.where(somewhere, x, 1.0)), 0.0
    )


class CylinderMap(AbstractWearMap):
    """Wall of a bearing or journal: theta from x towards y in [0, 2 pi), z from -length/2 to
    length/2.

    Location features: direction (x, y), by how much the overlap falls towards the other end [m],
    one over half the contact's width (`narrowness`) [1/rad] and the end that carries (-1 or 1; 0:
    the whole length).
    """

    cells: tuple[int, int] = eqx.field(static=True)
    radius: Scalar = quantity(unit="m", meaning="radius of the wall", above=0)
    length: Scalar = quantity(unit="m", meaning="length of the wall", above=0)
    clearance: Scalar = quantity(unit="m", meaning="radial clearance in it", above=0)

    def areas(self) -> Float[Array, "around along"]:
        around, along = self.cells
        return (
            jnp.full(self.cells, 1.0) * (2 * jnp.pi * self.radius / around) * (self.length / along)
        )

    def angles(self) -> Float[Array, " around"]:
        """Direction of the centre of each cell [rad]."""
        return (jnp.arange(self.cells[0]) + 0.5) * (2 * jnp.pi / self.cells[0])

    def _ways(self) -> Float[np.ndarray, "around 2"]:
        """Direction (x, y) of the centre of each cell."""
        angles = (np.arange(self.cells[0]) + 0.5) * (2 * np.pi / self.cells[0])
        return np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def heights(self) -> Float[Array, " along"]:
        """z of the centre of each cell [m]."""
        return self.length * ((jnp.arange(self.cells[1]) + 0.5) / self.cells[1] - 0.5)

    def narrowness(self, indentation: Scalar) -> Scalar:
        """One over half the width [1/rad] of a contact of some indentation [m]. Its mean over a
        loss tells how deep that is in the contact's middle."""
        return 1.0 / jnp.sqrt(square_width(indentation, self._cell, self.clearance))

    def directions_of(self, features):
        return features[..., :2]

    def covered(self, features):
        fall, narrowness, end = (features[..., i] for i in (2, 3, 4))
        half_width = safe_divide(1.0, narrowness)
        overlap = depth_of(half_width**2, self._cell, self.clearance)
        along = safe_divide(overlap, 2.5 * jnp.abs(fall * end) + overlap)
        return half_width, half_width / math.pi * along

    @property
    def _cell(self) -> float:
        return 2 * math.pi / self.cells[0]

    def position(self, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Where a place of the wall [m] lies, in units of cells: around, along."""
        return self._column(x, y), (z / self.length + 0.5) * self.cells[1] - 0.5

    def _column(self, x, y):
        return direction_angle(x, y) * (self.cells[0] / (2 * jnp.pi)) - 0.5

    def deposit(self, depth, volume, features):
        around = self.cells[0]
        reach = math.ceil(REACH * around / (2 * math.pi))

        # A table: XLA would work them out anew for every cell of a column.
        columns = self._ways()

        def wide():
            whole = jax.vmap(self._lost, (None, None, 0, 0))
            return depth + jnp.sum(whole(columns, depth, volume, features)[0], axis=0)

        if 2 * reach + 1 >= around:
            return wide()
        towards = direction_angle(features[:, 0], features[:, 1]) * (around / (2 * jnp.pi))
        first = (jnp.floor(towards).astype(int) - reach) % around
        width = 2 * reach + 1
        twice = jnp.concatenate([depth, depth[:width]])
        near = lambda these, start: jax.lax.dynamic_slice_in_dim(these, start, width)
        ways = jnp.concatenate([columns, columns[:width]])
        lost, fits = jax.vmap(
            lambda start, *event: self._lost(near(ways, start), near(twice, start), *event)
        )(first, volume, features)

        def narrow():
            # Slices: to scatter costs XLA several times as much as the losses themselves.
            gained = jnp.zeros_like(twice)
            for start, own in zip(first, lost, strict=True):
                there = jax.lax.dynamic_slice_in_dim(gained, start, width)
                gained = jax.lax.dynamic_update_slice_in_dim(gained, there + own, start, 0)
            return depth + gained[:around].at[:width].add(gained[around:])

        # A choice of its own for each sample of a batch would be both branches: the wide one, which
        # costs several times as much, is entered where a sample needs it.
        fit = jnp.all(fits)
        rare = lambda: jnp.where(fit, narrow(), wide())
        return jax.lax.cond(eqxi.unvmap_all(fit), narrow, rare)

    def _lost(self, columns, depth, volume, features):
        """(what each cell of these columns, directions (x, y), loses in an event [m], whether no
        other column is reached)."""
        x, y, fall, narrowness, end = features
        around, along = self.cells
        clearance, ends = self.clearance, jnp.abs(end)
        length = safe_sqrt(x * x + y * y)
        half_arc = arc(length)
        towards = (safe_divide(x, length), safe_divide(y, length))
        along_arc, cosine, sine = self._from_arc(columns, *towards, half_arc)
        square = safe_divide(1.0, narrowness * narrowness)
        overlap = depth_of(square, self._cell, clearance)
        # Up to where a tilted journal overlaps. Its two ends have shares, as the line between them
        # tells, that add up to one.
        touching = safe_divide(overlap * self.length, 2.5 * jnp.abs(fall) * ends + overlap)
        load = line_contact(overlap, self.radius, clearance, touching, half_arc)
        load = load._replace(root=load.root * (1.0 - 0.5 * ends * touching / self.length))
        wanted = volume + load.overlap
        sunk = line_sunk(wanted, self.radius, clearance, self.length, jnp.abs(fall) * ends)
        away = 0.5 * ends - end * self.heights() / self.length
        nearest = jnp.argmax(cosine)
        edge = jnp.where(end > 0, depth[nearest, -1], depth[nearest, 0])
        steepest = (0.5 / along) * jnp.abs(fall)
        outline = Outline(
            cosine[:, None],
            clearance + depth + fall * away * cosine[:, None],
            (
                (jnp.pi / around) * clearance * sine
                + steepest * jnp.abs(cosine)
                + SHARPEST * clearance
            )[:, None],
        )
        nearest_to = Outline(1.0, clearance + depth + fall * away, steepest + SHARPEST * clearance)
        half = arc_with_cell(half_arc, self._cell)
        patch = Patch(
            outline,
            Way(along_arc[:, None], nearest_to, half, clearance + depth),
            self.areas()[0],
            1.0 - away,
            clearance + edge + sunk,
            load,
        )
        lost, level = depth_lost(volume, patch)
        deepest = level + positive_part(-fall)
        beyond = jnp.cos(positive_part(REACH - half_arc))
        return lost, (deepest * beyond < clearance) | (volume == 0)

    def _from_arc(self, columns, x, y, half_arc):
        """(angle [rad] between the direction of each column and (x, y); cosine and size of the sine
        of that between it and the arc about (x, y)); without a direction all are in it."""
        cosine = columns[:, 0] * x + columns[:, 1] * y
        sine = jnp.abs(columns[:, 0] * y - columns[:, 1] * x)
        c, s = jnp.cos(half_arc), jnp.sin(half_arc)
        inside = cosine >= c
        return (
            direction_angle(cosine, sine),
            jnp.where(inside, 1.0, cosine * c + sine * s),
            jnp.where(inside, 0.0, sine * c - cosine * s),
        )

    def reading(self, depth):
        """For the lower and upper end: coefficients (around, 3) of the spline 1, f, f^2 around each
        cell, contiguous so that one lookup costs one small slice."""
        rows = []
        inner = min(1, self.cells[1] - 1)
        for edge, inside in ((depth[:, 0], depth[:, inner]), (depth[:, -1], depth[:, -1 - inner])):
            # From the middle of the last cell to its edge.
            edge = edge + 0.5 * positive_part(edge - inside)
            left, right = jnp.roll(edge, 1), jnp.roll(edge, -1)
            rows.append(
                jnp.stack(
                    [
                        0.125 * (left + 6.0 * edge + right),
                        0.5 * (right - left),
                        0.5 * (left + right) - edge,
                    ],
                    -1,
                )
            )
        return tuple(rows)

    def depth_at_end(self, reading: tuple, x: Scalar, y: Scalar, end: int) -> Scalar:
        """Worn depth at the direction (x, y) of the row at the lower (-1) or upper (1) end, in
        metres.
        """
        around = self.cells[0]
        position = self._column(x, y)
        nearest = jnp.round(position)
        f = position - nearest
        constant, slope, curvature = reading[0 if end < 0 else 1][nearest.astype(int) % around]
        return constant + f * (slope + f * curvature)
