"""Zones of a drawing: where a marker's place or axis may lie.

A zone moves the marker that it is on, in the marker's own frame: z along the axis, as the joint
there has it. Each part of a zone is as likely as another.

Source: ISO 1101:2017 (zones), ISO 2692:2021 (most and least material).
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxclear.components.body import Marker
from jaxclear.ground import sparse as sp
from jaxclear.ground.arguments import check_name
from jaxclear.ground.pose import quaternion_from_rotation
from jaxclear.ground.quantity import Scalar, as_vector, quantity
from jaxclear.ground.wording import described
from jaxclear.studies.distribution import Ball, Independent, Uniform
from jaxclear.studies.tolerance.fit import MILLI, AbstractTolerance, Capability

ENDS = ("parent", "child")
ACROSS = ("x", "y")
# A direction is out of the plane where its part across it is more than rounding.
ROUNDING = 1e-9


WIDTHS = "one width [m], or one for each of two directions"


def _widths(value: Any) -> Any:
    several = value is None or isinstance(value, (tuple, list))
    return as_vector(value if several else (value,))


class AbstractZone(AbstractTolerance):
    """A zone of a marker's place or axis."""

    marker: eqx.AbstractVar[str]
    datum: eqx.AbstractVar[str | None]
    at_mmc: eqx.AbstractVar[str | None]
    at_lmc: eqx.AbstractVar[str | None]

    unit: eqx.AbstractClassVar[str]

    def check_lines(self) -> None:
        """Raises `ValueError` where a zone is on no marker, or has both material conditions."""
        if not isinstance(self.marker, str) or self.marker.rpartition(".")[2] not in ENDS:
            raise ValueError(
                f"the marker of a zone is {described(self.marker)}; write a joint and its side, "
                'such as "A.parent" or "A.child".'
            )
        names = [name for name in (self.at_mmc, self.at_lmc) if name is not None]
        if len(names) > 1 or (names and isinstance(self.size, tuple)):
            raise ValueError(
                "a zone is given at_mmc and at_lmc, or one of them beside two widths; it has one "
                "of the two, and one size that grows."
            )

    @property
    @abstractmethod
    def size(self) -> Any:
        """Width or diameter of the zone [m]."""

    @abstractmethod
    def law(self, plane: bool) -> Any:
        """Distribution of the numbers of a zone.

        Args:
            plane: whether the mechanism is planar.
        """

    @abstractmethod
    def moved(self, marker: Marker, value: Any, plane: bool) -> Marker:
        """The marker at a place in the zone.

        Args:
            marker: the `Marker` in the middle of the zone.
            value: the numbers of the zone [m, rad], one or several.
            plane: whether the mechanism is planar.
        """

    @abstractmethod
    def leaves_plane(self, marker: Marker) -> bool:
        """Whether a planar mechanism does not feel all that the zone leaves open.

        Args:
            marker: the `Marker`.
        """

    def _symbol_text(self, symbol: str) -> str:
        sizes = self.size if isinstance(self.size, tuple) else (self.size,)
        symbol = f"{type(self).__name__.lower()} {symbol}"
        text = f"{symbol}{' x '.join(f'{float(size) / MILLI:g}' for size in sizes)}"
        text += f" at MMC of {self.at_mmc}" if self.at_mmc else ""
        text += f" at LMC of {self.at_lmc}" if self.at_lmc else ""
        return f"{text} to {self.datum}" if self.datum else text


class AbstractPlaceZone(AbstractZone):
    """A zone of a place, with the arguments of a `Position`."""

    unit = "m"
    diameter: Scalar | None = quantity(None, "m", above=0)
    marker: str = eqx.field(static=True, kw_only=True)
    width: Any = quantity(
        None, "m", above=0, converter=_widths, counts=(1, 2), wanted=WIDTHS, kw_only=True
    )
    along: str = eqx.field(static=True, default="x", kw_only=True)
    spherical: bool = eqx.field(static=True, default=False, kw_only=True)
    length: Scalar | None = quantity(None, "m", above=0, kw_only=True)
    datum: str | None = eqx.field(static=True, default=None, kw_only=True)
    at_mmc: str | None = eqx.field(static=True, default=None, kw_only=True)
    at_lmc: str | None = eqx.field(static=True, default=None, kw_only=True)

    @property
    def specification(self):
        return self._symbol_text("S⌀" if self.spherical else "" if self.width else "⌀")

    def __check_init__(self):
        self.check_lines()
        if (self.diameter is None) == (self.width is None):
            raise ValueError(
                f"a {type(self).__name__} takes a diameter or a width; give one of the two [m]."
            )
        check_name("along of a zone", self.along, ACROSS)
        if self.width is not None and (self.spherical or self.length is not None):
            raise ValueError(
                f"a {type(self).__name__} between planes is neither spherical nor over a length; "
                "give its diameter in place of its width."
            )

    @property
    def size(self):
        if self.diameter is not None:
            return self.diameter
        return self.width if len(self.width) > 1 else self.width[0]

    def law(self, plane):
        if self.width is not None:
            laws = [Uniform(0.5 * width) for width in self.width]
            return laws[0] if len(laws) == 1 else Independent(ACROSS, laws)
        ball = Ball(0.5 * self.diameter, 3 if self.spherical else 2)
        if self.length is None:
            return ball
        return Independent(("near x", "near y", "far x", "far y"), (ball, ball))

    @property
    def _axes(self) -> tuple[int, ...]:
        """Axes of the marker's frame along which the zone moves it."""
        if self.width is not None and len(self.width) == 1:
            return (ACROSS.index(self.along),)
        return (0, 1, 2) if self.spherical else (0, 1)

    def leaves_plane(self, marker):
        across = [marker.pose().rotation[2][i] for i in self._axes]
        moves = any(not sp.is_zero(part) and abs(float(part)) > ROUNDING for part in across)
        return moves or self.length is not None

    def moved(self, marker, value, plane):
        numbers = list(jnp.atleast_1d(value))
        if self.length is not None:
            near, far = numbers[:2], numbers[2:]
            lean = [(b - a) / self.length for a, b in zip(near, far, strict=True)]
            marker = leaned(marker, *lean)
            numbers = [0.5 * (a + b) for a, b in zip(near, far, strict=True)]
        shift = [0.0, 0.0, 0.0]
        for i, number in zip(self._axes, numbers, strict=True):
            shift[i] = number
        away = sp.apply(marker.pose().rotation, tuple(shift))
        at = marker.at if len(marker.at) == 2 and plane else (*marker.at, 0.0)[:3]
        place = tuple(jnp.asarray(old + new) for old, new in zip(at, away, strict=False))
        return eqx.tree_at(lambda tree: tree.at, marker, place)


class Position(AbstractPlaceZone):
    """A place within a disc, a cylinder, a ball, or between planes.

    Args:
        diameter: diameter of a round zone [m], > 0; None (default) where a width is given.
        marker: the marker, joint and side as a text, such as "A.parent".
        width: distance of two planes across the marker's axis [m], > 0, or a sequence of two for
            both directions; None (default) for a round zone.
        along: name of the axis of the marker's frame along which a single width counts: "x"
            (default) or "y". Of an axis in the plane of a mechanism "x" lies in that plane.
        spherical: whether the zone is a ball and moves along the axis too; False by default.
        length: length of the bore within a cylindrical zone [m], > 0, whose axis then leans too,
            with both ends within the cylinder; None (default): its middle only moves.
        datum: the marker, or the line of the drawing, that the place is measured from, which may
            itself vary; None (default) for the body's own frame.
        at_mmc: name of the fit whose feature widens the zone by how far it is from its most
            material: "B", or "B hole", "B shaft"; None (default) for none.
        at_lmc: as `at_mmc`, from its least material; None (default) for none.

    Raises:
        ValueError: if arguments are missing or contradict each other.
    """


class Coaxiality(AbstractPlaceZone):
    """An axis within a cylinder about the axis of a datum.

    Args:
        diameter: diameter of a round zone [m], > 0; None (default) where a width is given.
        marker: the marker, joint and side as a text, such as "A.parent".
        width: distance of two planes across the marker's axis [m], > 0, or a sequence of two for
            both directions; None (default) for a round zone.
        along: name of the axis of the marker's frame along which a single width counts: "x"
            (default) or "y". Of an axis in the plane of a mechanism "x" lies in that plane.
        spherical: whether the zone is a ball and moves along the axis too; False by default.
        length: length of the bore within a cylindrical zone [m], > 0, whose axis then leans too,
            with both ends within the cylinder; None (default): its middle only moves.
        datum: name of the marker, or of the line of the drawing, whose axis it is measured from.
        at_mmc: name of the fit whose feature widens the zone by how far it is from its most
            material: "B", or "B hole", "B shaft"; None (default) for none.
        at_lmc: as `at_mmc`, from its least material; None (default) for none.

    Raises:
        ValueError: if arguments are missing or contradict each other.
    """

    def __check_init__(self):
        if self.datum is None or self.diameter is None or self.spherical:
            raise ValueError(
                "a Coaxiality is round and has a datum; give it a diameter and the marker whose "
                "axis it is measured from."
            )


class AbstractLean(AbstractZone):
    """A zone of a direction, with the arguments of an `Angularity`."""

    unit = "rad"
    width: Scalar = quantity(unit="m", above=0)
    marker: str = eqx.field(static=True, kw_only=True)
    over: Scalar = quantity(unit="m", above=0, kw_only=True)
    along: str | None = eqx.field(static=True, default=None, kw_only=True)
    datum: str | None = eqx.field(static=True, default=None, kw_only=True)
    at_mmc: str | None = eqx.field(static=True, default=None, kw_only=True)
    at_lmc: str | None = eqx.field(static=True, default=None, kw_only=True)

    def __check_init__(self):
        self.check_lines()
        if self.along is not None:
            check_name("along of a zone", self.along, ACROSS)

    @property
    def size(self):
        return self.width

    @property
    def specification(self):
        return f"{self._symbol_text('' if self.along else '⌀')} over {float(self.over) / MILLI:g}"

    def law(self, plane):
        angle = self.width / self.over
        return Uniform(angle) if plane or self.along is not None else Ball(angle)

    def leaves_plane(self, marker):
        x, y, _ = sp.apply(marker.pose().rotation, (0, 0, 1))
        return all(sp.is_zero(part) or abs(float(part)) < ROUNDING for part in (x, y))

    def moved(self, marker, value, plane):
        if plane:
            return eqx.tree_at(lambda tree: tree.angle, marker, marker.angle + value)
        lean = (
            list(value) if self.along is None else [value * (self.along == axis) for axis in ACROSS]
        )
        return leaned(marker, *lean)


class Angularity(AbstractLean):
    """An axis or a plane at an angle to a datum, within a zone over its length.

    In a planar mechanism it turns the marker within the plane, in space its axis leans any way, or
    towards one axis of its frame.

    Args:
        width: diameter of the zone, or distance of its planes [m], > 0.
        marker: the marker, joint and side as a text, such as "G.parent".
        over: length of the feature over which the zone holds [m], > 0.
        along: name of the axis of the marker's frame, "x" or "y", towards which it leans; None
            (default) for any, within a cylinder.
        datum: the marker, or the line of the drawing, that the direction is measured from; None
            (default) for the body's own frame.
        at_mmc: name of the fit whose feature widens the zone by how far it is from its most
            material: "B", or "B hole", "B shaft"; None (default) for none.
        at_lmc: as `at_mmc`, from its least material; None (default) for none.

    Raises:
        ValueError: if arguments contradict each other.
    """


class Parallelism(AbstractLean):
    """An axis or a plane parallel to a datum, within a zone over its length.

    In a planar mechanism it turns the marker within the plane, in space its axis leans any way, or
    towards one axis of its frame.

    Args:
        width: diameter of the zone, or distance of its planes [m], > 0.
        marker: the marker, joint and side as a text, such as "G.parent".
        over: length of the feature over which the zone holds [m], > 0.
        along: name of the axis of the marker's frame, "x" or "y", towards which it leans; None
            (default) for any, within a cylinder.
        datum: the marker, or the line of the drawing, that the direction is measured from; None
            (default) for the body's own frame.
        at_mmc: name of the fit whose feature widens the zone by how far it is from its most
            material: "B", or "B hole", "B shaft"; None (default) for none.
        at_lmc: as `at_mmc`, from its least material; None (default) for none.

    Raises:
        ValueError: if arguments contradict each other.
    """


class Perpendicularity(AbstractLean):
    """An axis or a plane square to a datum, within a zone over its length.

    In a planar mechanism it turns the marker within the plane, in space its axis leans any way, or
    towards one axis of its frame.

    Args:
        width: diameter of the zone, or distance of its planes [m], > 0.
        marker: the marker, joint and side as a text, such as "G.parent".
        over: length of the feature over which the zone holds [m], > 0.
        along: name of the axis of the marker's frame, "x" or "y", towards which it leans; None
            (default) for any, within a cylinder.
        datum: the marker, or the line of the drawing, that the direction is measured from; None
            (default) for the body's own frame.
        at_mmc: name of the fit whose feature widens the zone by how far it is from its most
            material: "B", or "B hole", "B shaft"; None (default) for none.
        at_lmc: as `at_mmc`, from its least material; None (default) for none.

    Raises:
        ValueError: if arguments contradict each other.
    """


class Size(AbstractTolerance):
    """A length, or any other number of a mechanism, between limits about its nominal value.

    Args:
        where: function of a `Mechanism` that returns the number, as of a `Variable`.
        tolerance: half width of the limits [its unit], > 0; None (default) for the general
            tolerance of the drawing.
        process: how parts scatter between the limits, a `Capability`; None (default) for inspected
            parts. A profile, a band for a surface, is a `Size` that is "uniform".
    """

    where: Callable = eqx.field(static=True)
    tolerance: Scalar | None = quantity(None, "(its unit)", above=0)
    process: Capability | None = None


def leaned(marker: Marker, x: Any, y: Any) -> Marker:
    """A marker with a quaternion whose axis leans towards the x and the y axis of its frame [rad].

    Args:
        marker: the `Marker`.
        x: lean towards the x axis [rad].
        y: lean towards the y axis [rad].

    Returns:
        The new `Marker`.
    """
    w, a, b, c = marker.quaternion or (1.0, 0.0, 0.0, 0.0)
    # Times (1, -y/2, x/2, 0): a turn about the axis across the lean, to third order.
    p, q = -0.5 * y, 0.5 * x
    rotated = (w - a * p - b * q, a + w * p - c * q, b + w * q + c * p, c + a * q - b * p)
    return eqx.tree_at(lambda tree: tree.quaternion, marker, tuple(map(jnp.asarray, rotated)))


def write_out_frame(marker: Marker, zone: AbstractZone, plane: bool) -> Marker:
    """The marker with numbers in place of a named axis and an absent origin, where a zone moves
    them.

    Args:
        marker: the `Marker`.
        zone: the `AbstractZone`.
        plane: whether the mechanism is planar.

    Returns:
        The `Marker`, the same frame.
    """
    at: Any = marker.at
    axis: Any = marker.named_axis if marker.axis is None else marker.axis
    turn: dict[str, Any] = {"quaternion": marker.quaternion, "angle": marker.angle}
    if zone.unit == "m" and (at is None or (len(at) == 2 and not plane)):
        at = (*(at or (0.0, 0.0)), *([] if plane else [0.0]))[: 2 if plane else 3]
    if zone.unit == "rad" and plane and marker.angle is None:
        turn["angle"] = 0.0
    if not plane and (zone.unit == "rad" or getattr(zone, "length", None) is not None):
        rotation = np.array([[float(value) for value in row] for row in marker.pose().rotation])
        turn, axis = {"quaternion": tuple(quaternion_from_rotation(jnp.asarray(rotation)))}, None
    return Marker(marker.body, at, "z" if turn["quaternion"] is not None else axis, **turn)
