"""A mechanism as its drawing tolerances it: `jaxclear.Drawing` turns lines of a drawing into the
mechanism at mean sizes, its variables, and a table.

Sizes are set first, then zones in the order of their datums; a zone that is wider for a feature
away from its most material reads the size that this part has.
"""

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxclear.components.body import Connection, Marker
from jaxclear.ground.arguments import check_name, expect
from jaxclear.ground.printing import in_a_line
from jaxclear.ground.quantity import AbstractQuantified
from jaxclear.ground.table import as_table
from jaxclear.ground.wording import described
from jaxclear.multibody.mechanism import Mechanism, rebuilt
from jaxclear.multibody.topology import all_planar
from jaxclear.studies.distribution import (
    AbstractDistribution,
    AbstractJointDistribution,
    Independent,
)
from jaxclear.studies.distribution.joint import marginals_of
from jaxclear.studies.experiment import AbstractVariable
from jaxclear.studies.tolerance import iso286
from jaxclear.studies.tolerance.fit import (
    HOLE,
    MILLI,
    SHAFT,
    AbstractTolerance,
    Capability,
    Fit,
)
from jaxclear.studies.tolerance.zones import AbstractZone, Size, write_out_frame
from jaxclear.studies.variable import AbstractMechanismVariable, Variable

GENERAL = re.compile(r"\s*ISO\s*2768(?:-1)?\s*-?\s*([fmcv])\s*")


class Bonus(eqx.Module):
    """What a feature adds to a zone: by how far its size is from the limit of most, or least,
    material [m]."""

    joint: str = eqx.field(static=True)
    side: str = eqx.field(static=True)
    sign: int = eqx.field(static=True)
    limit: float

    def __call__(self, mechanism: Mechanism) -> Any:
        joint: Any = mechanism.connections[self.joint].joint
        size = joint.diameters()[(HOLE, SHAFT).index(self.side)]
        return jnp.maximum(self.sign * (size - self.limit), 0.0)


class ZoneVariable(AbstractMechanismVariable):
    """Where in its zone a marker is: one or several numbers [m, rad] about the zone's middle."""

    zone: AbstractZone
    distribution: AbstractDistribution | AbstractJointDistribution
    plane: bool = eqx.field(static=True)
    bonus: Bonus | None = None
    # The marker that the zone is measured from, and its nominal place.
    datum: str | None = eqx.field(static=True, default=None)
    datum_at: tuple | None = None

    def leaves(self, mechanism):
        return []

    def nominal_in(self, subject):
        return jnp.zeros(len(self.parts)) if self.parts else jnp.asarray(0.0)

    def unit_in(self, subject):
        return self.zone.unit

    def put(self, name, subject, value):
        return subject

    def followed(self, subject, value):
        if self.bonus is not None:
            value = value * (1.0 + self.bonus(subject) / self.zone.size)
        marker = self.zone.moved(marker_at(subject, self.zone.marker), value, self.plane)
        if self.datum is not None and marker.at is not None:
            there = marker_at(subject, self.datum).at
            moved = zip(marker.at, there, self.datum_at or (), strict=False)
            place = tuple(x + (new - old) for x, new, old in moved)
            marker = eqx.tree_at(lambda x: x.at, marker, place)
        return eqx.tree_at(lambda x: marker_at(x, self.zone.marker), subject, marker)

    def check(self, name, mechanism):
        marker_at(mechanism, self.zone.marker, name)

    def identity(self, name, subject):
        return {f'zone of "{name}"': (self.zone, self.bonus, self.datum, self.datum_at)}


class Line(NamedTuple):
    """A line of a drawing: what it is on, what it says, its variable, and lower and upper limit of
    each of its features."""

    feature: str
    specification: str
    variable: AbstractVariable
    limits: list[Any]


class Drawing(AbstractQuantified):
    """A mechanism at mean sizes, with what its drawing leaves open as variables.

    `mechanism` and `variables` are those of a `jaxclear.Problem`, and `table()` what an engineer
    recognises. Every line has one row in each table and one share of each variance.

    Args:
        mechanism: the `Mechanism` at nominal sizes.
        lines: lines of the drawing by name: a `jaxclear.fit` (or its text) under the name of a
            joint with clearance, members of `jaxclear.tolerance` under names of your own.
        general: general tolerance, such as "ISO 2768-m", of each `Size` without one; None
            (default) for none.

    Raises:
        ValueError: if a line names what there is not, contradicts another one, or says what the
            mechanism does not feel.
    """

    mechanism: Mechanism
    variables: dict[str, Any]
    lines: dict[str, Line]
    names: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        mechanism: Mechanism,
        lines: Mapping[str, AbstractTolerance | str],
        *,
        general: str | None = None,
    ):
        expect(mechanism, Mechanism, "mechanism of a Drawing", "a jaxclear.Mechanism")
        expect(lines, Mapping, "lines of a Drawing", "a dictionary from names")
        if general is not None and not GENERAL.fullmatch(str(general)):
            wrong = f"general of a Drawing is {described(general)}"
            raise ValueError(f'{wrong}; it must be a class of ISO 2768-1, such as "ISO 2768-m".')
        entries = {name: Fit(one) if isinstance(one, str) else one for name, one in lines.items()}
        for name, one in entries.items():
            which = 'a fit such as "20 H7/g6", or one of jaxclear.tolerance'
            expect(one, AbstractTolerance, f'line "{name}" of a Drawing', which)
        fits = {name: one for name, one in entries.items() if isinstance(one, Fit)}
        zones = {name: one for name, one in entries.items() if isinstance(one, AbstractZone)}
        all_lines: dict[str, Line] = {}
        for name, one in fits.items():
            check_name("joint", name, mechanism.topology.clearances, " with clearance")
            one.check_clearance(name)
            sizes = one.sizes(name)
            sizes.check(name, mechanism)
            mechanism = sizes.put(name, mechanism, sizes.means)
            ends = [
                (one.size + limits[0], one.size + limits[1])
                for limits in (one.hole_limits, one.shaft_limits)
            ]
            all_lines[name] = Line(f"joint {name}", one.specification, sizes, ends)
        plane = all_planar(mechanism.bodies)
        for name, zone in zones.items():
            mechanism = _prepare_marker(mechanism, name, zone, plane)
        for name in _sort_by_datum(zones):
            all_lines[name] = _zone_line(mechanism, name, zones, fits, plane)
        for name, one in entries.items():
            if isinstance(one, Size):
                all_lines[name] = _size_line(mechanism, name, one, general)
        self.mechanism, self.lines, self.names = mechanism, all_lines, tuple(all_lines)
        self.variables = {name: line.variable for name, line in all_lines.items()}

    def table(self) -> Any:
        """The drawing as a pandas table: a row for each feature, with its limits and how parts
        scatter between them."""
        rows = []
        for name in self.names:
            feature, specification, variable, limits = self.lines[name]
            law = variable.distribution
            members = law.members if isinstance(law, Independent) else (law,)
            members = members if len(members) == len(limits) else (law,)
            labels = variable.parts if len(variable.parts) == len(limits) else [""]
            for label, member, ends in zip(labels, members, limits, strict=True):
                row: dict[str, Any] = {"line": name, "feature": f"{feature} {label}".strip()}
                row |= {"specification": specification}
                row |= {"lower": float(ends[0]), "upper": float(ends[1])}
                row |= {"unit": variable.unit_in(self.mechanism), "distribution": in_a_line(member)}
                rows.append(row)
        return as_table(rows)

    def _summary(self):
        return str(self.table())


def marker_at(mechanism: Mechanism, on: str, owner: str = "") -> Marker:
    """The marker at a joint's side.

    Args:
        mechanism: with the joints.
        on: such as "A.parent".
        owner: line of a drawing in the message; "": the joint is known to exist.

    Raises:
        ValueError: there is no such joint.
    """
    joint, _, side = on.rpartition(".")
    if owner:
        check_name(f'joint of line "{owner}"', joint, mechanism.connections, " in this mechanism")
    return getattr(mechanism.connections[joint], side)


def _prepare_marker(mechanism: Mechanism, name: str, zone: AbstractZone, plane: bool) -> Mechanism:
    """The mechanism whose marker has the numbers that a zone moves."""
    marker = marker_at(mechanism, zone.marker, name)
    if plane and zone.leaves_plane(marker):
        raise ValueError(
            f'zone "{name}" ({zone.specification}) moves {zone.marker} out of the plane, '
            'which a planar mechanism does not feel; give a Position there a width along "x" of '
            "the marker's frame, and a direction to an axis in the plane, or take bodies in space."
        )
    joint, _, side = zone.marker.rpartition(".")
    c = mechanism.connections[joint]
    ends = {"parent": c.parent, "child": c.child} | {side: write_out_frame(marker, zone, plane)}
    changed = dict(mechanism.connections.items()) | {joint: Connection(c.joint, **ends)}
    return rebuilt(mechanism, connections=changed)


def _sort_by_datum(zones: dict[str, AbstractZone]) -> list[str]:
    """The names of zones, each behind that which moves its datum."""
    order: list[str] = []
    while len(order) < len(zones):
        rest = [name for name in zones if name not in order]
        free = [name for name in rest if not {*_zones_moving_datum(zones, zones[name])} & {*rest}]
        if not free:
            raise ValueError(
                f'the datums of the zones "{rest[0]}" and others go round in a circle; one of them '
                "must be measured from a marker that no zone moves, or from the body."
            )
        order += free
    return order


def _zones_moving_datum(zones: dict[str, AbstractZone], zone: AbstractZone) -> list[str]:
    """The names of the zones that move the datum of one."""
    if zone.datum is None:
        return []
    datum = zones[zone.datum].marker if zone.datum in zones else zone.datum
    return [name for name, zone in zones.items() if zone.marker == datum]


def _zone_line(
    mechanism: Mechanism, name: str, zones: dict[str, AbstractZone], fits: dict, plane: bool
) -> Line:
    zone, datum, at = zones[name], None, None
    marker = marker_at(mechanism, zone.marker)
    if zone.datum is not None:
        datum = zones[zone.datum].marker if zone.datum in zones else zone.datum
        joint, _, side = datum.rpartition(".")
        if joint not in mechanism.connections or side not in ("parent", "child"):
            raise ValueError(
                f'the datum of zone "{name}" is {described(zone.datum)}; it must be a line of this '
                'drawing, or a joint and its side, such as "A.parent".'
            )
        there = marker_at(mechanism, datum)
        if there.body != marker.body:
            raise ValueError(
                f'zone "{name}" is on "{marker.body}" and its datum {datum} on "{there.body}"; '
                "no chain of dimensions leads from one body to another: take a datum on "
                f'"{marker.body}", and give the other body a line of its own.'
            )
        at = None if there.at is None or datum == zone.marker else there.at
        datum = None if at is None else datum
    bonus = _make_bonus(name, zone, fits)
    law = zone.law(plane)
    variable = ZoneVariable(zone, law, plane, bonus, datum, at)
    widths = marginals_of(law)[: len(zone.size) if isinstance(zone.size, tuple) else 1]
    ends = [tuple(width.quantile(jnp.array([0.0, 1.0]))) for width in widths]
    return Line(f"{marker.body} at {zone.marker}", zone.specification, variable, ends)


def _make_bonus(name: str, zone: AbstractZone, fits: dict[str, Fit]) -> Bonus | None:
    """What a size adds to a zone."""
    text = zone.at_mmc or zone.at_lmc
    if text is None:
        return None
    joint, _, side = text.rpartition(" ")
    if text in fits:
        joint = text
        side = SHAFT if zone.marker == f"{text}.child" else HOLE
    if joint not in fits or side not in (HOLE, SHAFT):
        raise ValueError(
            f'zone "{name}" is at the material condition of {described(text)}, which has no size '
            f"on this drawing; give that joint a fit (there is {', '.join(fits) or 'none'}), and "
            'name it, or its "hole" or "shaft".'
        )
    fit = fits[joint]
    limits = fit.hole_limits if side == HOLE else fit.shaft_limits
    # Most material: the smallest hole, the largest shaft.
    smallest = (side == HOLE) == (zone.at_mmc is not None)
    return Bonus(joint, side, 1 if smallest else -1, fit.size + limits[0 if smallest else 1])


def _size_line(mechanism: Mechanism, name: str, line: Size, general: str | None) -> Line:
    value = Variable(line.where, tolerance=1.0).nominal_in(mechanism)
    size = abs(float(value)) / MILLI
    half, text = line.tolerance, ""
    if half is None:
        match = GENERAL.fullmatch(general or "")
        if match is None:
            raise ValueError(
                f'size "{name}" has no tolerance, and the drawing says general = '
                f'{described(general)}; give one of them, such as general="ISO 2768-m".'
            )
        half, text = MILLI * iso286.general(size, match[1]), f" ISO 2768-{match[1]}"
    process = line.process or Capability()
    if process.cpk is not None:
        raise ValueError(
            f'the process of size "{name}" has a cpk; a length has no side of most material to '
            "which its mean would lie: leave it out, or vary the number by a Variable."
        )
    _, law = process.spread(2.0 * half, 0)
    text = f"{size:.6g} ±{float(half) / MILLI:g}{text}"
    ends = [(value - half, value + half)]
    return Line("length", text, Variable(line.where, law), ends)
