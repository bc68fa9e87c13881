"""Slender flexible bodies: rigid pieces between hinges with springs in the middle of elements.

Hinges in the middle of elements, and not between them, make clamped, pinned and free ends right
alike. Source: Wittbrodt, Adamiec-Wojcik & Wojciech 2006, Dynamics of Flexible Multibody Systems:
Rigid Finite Element Method, ch. 2, doi:10.1007/978-3-540-32352-9.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.components.body import Body, Connection, Marker
from jaxclear.components.joint import Prismatic, Revolute
from jaxclear.components.load_base import AbstractStateLoad, CoordinateEffect
from jaxclear.ground import sparse as sp
from jaxclear.ground.quantity import (
    AbstractQuantified,
    Scalar,
    concrete,
    count,
    quantity,
    with_fields,
)
from jaxclear.ground.wording import described
from jaxclear.laws.material import Material
from jaxclear.laws.section import AbstractSection, AbstractShape

# By which share of an element hinges of several kinds lie apart in it, so that there is a piece
# with mass between them; the order alternates, which keeps order two.
SPACING = 0.125
HINGES = {
    "bend_z": ("bend", Revolute(), "z"),
    "bend_y": ("bend across", Revolute(), "y"),
    "twist": ("twist", Revolute(), "x"),
    "stretch": ("stretch", Prismatic(), "x"),
}


class Hinge(NamedTuple):
    """A hinge of a beam: name of its joint, field of `Rigidity` that holds it, place [m]."""

    joint: str
    kind: str
    place: float


class Beam(AbstractQuantified):
    """A slender flexible body, which stands in the place of a `Body` in a mechanism. It lies along
    x of its frame, from 0 to its length; markers may be anywhere on it.

    It becomes rigid pieces between hinges: "rod" begins at its start, "rod 2" and so on follow.
    Large deflections are right; shear is left out. Frequencies, deflections and loads of buckling
    are right to order two in 1 / segments. Section, material and density are numbers that may vary;
    the length is not, as it decides on which piece a marker lies (vary the markers).

    Args:
        length: length [m], > 0.
        section: part of `jaxclear.section`.
        material: a `Material`; needed unless the section is `section.Properties`.
        density: density [kg/m^3], > 0; needed with the material.
        segments: number of elements, >= 2; 8 by default. Steps that resolve the springs
            shorten with their square: `integrator.ImplicitStep` need not resolve them.
        damping: ratio to the critical damping of the first bending mode of the beam on pins at both
            ends [-], >= 0; damping is proportional to stiffness, so that of other modes is
            proportional to their frequency. None by default: no damping.
        space: whether it bends in two planes and twists; False by default: it bends about z alone.
        stretches: whether it stretches as well; False by default.

    Raises:
        ValueError: for a shape without material and density, and for properties that lack the
            stiffness which `space` or `stretches` asks for.
    """

    length: float = eqx.field(static=True, converter=lambda value: concrete(value) or value)
    section: AbstractSection
    material: Material | None = None
    density: Scalar | None = quantity(None, "kg/m^3", "density", above=0)
    segments: int = count(8, "number of elements", at_least=2)
    damping: Scalar | None = quantity(
        None, "1", "damping ratio of the first bending mode on pins", at_least=0
    )
    space: bool = eqx.field(static=True, default=False)
    stretches: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        if not isinstance(self.length, float) or not 0 < self.length < np.inf:
            raise ValueError(
                f"a Beam has length = {described(self.length)}; it must be a number above 0 [m]."
            )
        shape = isinstance(self.section, AbstractShape)
        if shape and (self.material is None or self.density is None):
            raise ValueError(
                "a Beam with a shape as its section needs a material and a density [kg/m^3], such "
                "as material=jaxclear.material.steel(), density=7850."
            )
        needs = ["GJ", "turning_inertia"] * self.space + ["EA"] * self.stretches
        missing = [n for n in needs if not shape and getattr(self.section, n, 1) is None]
        if missing:
            raise ValueError(
                f"a Beam that bends in space or stretches needs {' and '.join(missing)} of its "
                "section.Properties."
            )

    @property
    def _kinds(self) -> tuple[str, ...]:
        in_space = ("bend_y", "twist", "bend_z") if self.space else ("bend_z",)
        return ("stretch",) * self.stretches + in_space

    def hinges(self, name: str) -> tuple[Hinge, ...]:
        """The hinges from start to end.

        Args:
            name: name of the beam.
        """
        hinges, element = [], self.length / self.segments
        for i in range(self.segments):
            side = -1 if i % 2 else 1
            for j, kind in list(enumerate(self._kinds, -(len(self._kinds) // 2)))[::side]:
                place = element * (i + 0.5 + SPACING * side * j)
                hinges.append(Hinge(f"{name} {HINGES[kind][0]} {i + 1}", kind, place))
        return tuple(hinges)

    def ends(self) -> list[float]:
        """Where pieces begin and end along the beam [m]."""
        return [0.0, *(hinge.place for hinge in self.hinges("")), self.length]

    def piece(self, index: int) -> Body:
        """A rigid piece, whose frame lies at its start.

        Args:
            index: which one, an integer from 0.
        """
        start, end = self.ends()[index : index + 2]
        size = end - start
        mass, about_y, about_z = self.section.inertia(self.density)
        slender = mass * size**3 / 12
        across = (about_y * size + slender, about_z * size + slender)
        inertia = ((about_y + about_z) * size, *across) if self.space else across[1]
        return Body(mass * size, inertia, (0.5 * size, 0.0))

    def pieces(self, name: str) -> dict[str, "Piece"]:
        """All pieces but the first.

        Args:
            name: name of the beam.
        """
        places = self.ends()[:-1]
        return {piece_name(name, i): Piece(name, i, at) for i, at in enumerate(places) if i}

    # What is asked of it as of the body that its first piece is.
    mass = property(lambda self: self.piece(0).mass)
    inertia = property(lambda self: self.piece(0).inertia)
    com = property(lambda self: self.piece(0).com)

    def inertia_matrix(self) -> Any:
        """Of its first piece [kg m^2]."""
        return self.piece(0).inertia_matrix()

    def springs(self) -> dict[str, tuple[Scalar, Scalar]]:
        """By kind of hinge: stiffness [N m/rad, N/m] and damping [N m s/rad, N s/m]."""
        element, rigidity = self.length / self.segments, self.section.rigidity(self.material)
        delay: Any = 0
        if self.damping is not None:
            mass = self.section.inertia(self.density)[0]
            first = (np.pi / self.length) ** 2 * jnp.sqrt(rigidity.bend_z / mass)
            delay = 2 * self.damping / first
        stiffness = {kind: getattr(rigidity, kind) / element for kind in self._kinds}
        return {kind: (k, sp.mul(delay, k)) for kind, k in stiffness.items()}


class Piece(AbstractQuantified):
    """A further rigid piece of a beam: what stands in a mechanism's bodies, without numbers of its
    own; `place` [m]: where it begins on the beam."""

    beam: str = eqx.field(static=True)
    index: int = eqx.field(static=True)
    place: float = eqx.field(static=True)


class _Elasticity(AbstractStateLoad):
    """The springs and dampers in the hinges of a beam, which reads its numbers of the mechanism."""

    name: str = eqx.field(static=True)
    hinges: tuple[Hinge, ...] = eqx.field(static=True)
    springs: dict[str, tuple] | None = None

    def of_bodies(self, bodies: Mapping[str, Any]) -> "_Elasticity":
        """With stiffness and damping of each kind of hinge, by the numbers of its beam."""
        return _Elasticity(self.name, self.hinges, bodies[self.name].springs())

    def coordinates(self):
        return tuple(hinge.joint for hinge in self.hinges)

    def states(self):
        return ()

    def resistance(self):
        return [(self.springs or {})[hinge.kind] for hinge in self.hinges]

    def effect(self, time, positions, speeds, states):
        each = list(zip(self.resistance(), positions, speeds, strict=True))
        forces = tuple(sp.neg(sp.add(k * q, sp.mul(d, v))) for (k, d), q, v in each)
        stored = sum(0.5 * k * q * q for (k, _), q, _ in each)
        loss = sp.total(sp.mul(d, v * v) for (_, d), _, v in each)
        return CoordinateEffect(forces, (), stored, loss, 0)


def beam_of(bodies: dict[str, Any], name: str) -> str:
    """The name of the beam of which a body is a piece; that of the body elsewhere."""
    body = dict.__getitem__(bodies, name)
    return body.beam if isinstance(body, Piece) else name


def whole_bodies(bodies: dict[str, Any]) -> list[str]:
    """The names of bodies, of which beams are one each."""
    return [name for name in bodies if beam_of(bodies, name) == name]


def parts_of_beams(loads: Mapping[str, Any]) -> tuple[str, ...]:
    """The names of hinges of beams and of their elasticity in a mechanism under these loads."""
    elastic = {name: load for name, load in loads.items() if isinstance(load, _Elasticity)}
    return (*elastic, *(joint for load in elastic.values() for joint in load.coordinates()))


def piece_name(beam: str, index: int) -> str:
    """The name of a piece, from 0."""
    return beam if index == 0 else f"{beam} {index + 1}"


def with_pieces(
    bodies: dict[str, Any], connections: dict[str, Any], loads: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Bodies, connections and loads with beams replaced by pieces, hinges and elasticity.

    Markers on beams are put on pieces; parts that exist are kept. Remains of a beam that was
    replaced by another body are removed.

    Args:
        bodies: by name; pieces are inserted beside their `Beam`.
        connections: by name; hinges between pieces are added.
        loads: by name; the elasticity of each beam is added.

    Raises:
        ValueError: a part of the user's has the name of one that the beam makes.
    """
    beams = {n: b for n, b in bodies.items() if isinstance(b, Beam)}
    pieces = {n: b for name, beam in beams.items() for n, b in beam.pieces(name).items()}
    stale = {n: b for n, b in bodies.items() if isinstance(b, Piece) and b != pieces.get(n)}
    if not beams and not stale:
        return bodies, connections, loads
    built = [name for name in beams if f"{name} elasticity" in loads]
    bodies, *joined = without_pieces(bodies, connections, loads, stale)
    connections, loads = (_move(lambda x: on_piece(beams, x, built), parts) for parts in joined)
    for name, beam in beams.items():
        hinges, ends = beam.hinges(name), beam.ends()
        joints = {}
        for i, hinge in enumerate(hinges):
            _, joint, axis = HINGES[hinge.kind]
            parent = Marker(piece_name(name, i), (ends[i + 1] - ends[i], 0.0), axis)
            joints[hinge.joint] = Connection(
                joint, parent, Marker(piece_name(name, i + 1), axis=axis)
            )
        elasticity = {f"{name} elasticity": _Elasticity(name, hinges)}
        made = (bodies, beam.pieces(name)), (connections, joints), (loads, elasticity)
        for parts, new in made:
            for n, b in new.items():
                there: Any = jax.tree.structure(parts.setdefault(n, b))
                if there != jax.tree.structure(b):
                    raise ValueError(
                        f'"{n}" is a part of the beam "{name}", which makes it itself: leave it '
                        "as it is or out, or give yours another name."
                    )
    return bodies, connections, loads


def without_pieces(
    bodies: dict[str, Any], connections: dict[str, Any], loads: dict[str, Any], pieces: dict | None
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Bodies, connections and loads without pieces of beams, their hinges and elasticity.

    Markers on the pieces are put back on the beams.

    Args:
        bodies: by name, with beams and their pieces.
        connections: by name, with hinges.
        loads: by name, with elasticities.
        pieces: which pieces to remove, by name; None: all.
    """
    if pieces is None:
        pieces = {n: body for n, body in dict.items(bodies) if isinstance(body, Piece)}
    beams = {body.beam for body in pieces.values()}

    def on_beam(marker):
        if marker.body not in pieces:
            return marker
        piece, (along, *across) = pieces[marker.body], marker.at or (0.0, 0.0)
        return with_fields(marker, body=piece.beam, at=(along + piece.place, *across))

    def is_part(part):
        if not isinstance(part, Connection):
            return isinstance(part, _Elasticity) and part.name in beams
        ends = part.parent, part.child
        return part.child.body in pieces and len({on_beam(end).body for end in ends}) == 1

    rest = ({n: x for n, x in parts.items() if not is_part(x)} for parts in (connections, loads))
    connections, loads = (_move(on_beam, parts) for parts in rest)
    return {n: x for n, x in dict.items(bodies) if n not in pieces}, connections, loads


def _move(move: Callable[[Marker], Marker], parts: Mapping[str, Any]) -> dict[str, Any]:
    """Parts with every marker moved."""
    one = lambda x: move(x) if isinstance(x, Marker) else x
    leaf = lambda x: isinstance(x, Marker)
    return {n: jax.tree.map(one, part, is_leaf=leaf) for n, part in parts.items()}


def on_piece(bodies: Mapping[str, Any], marker: Marker, built: Sequence[str] = ()) -> Marker:
    """A marker on a beam as one on the piece where it lies; any other marker unchanged.

    Args:
        bodies: by name; beams are looked up here.
        marker: on a body or beam; `at[0]` is the position along the beam [m].
        built: names of beams whose markers are on pieces already; a traced position on these is
            kept.

    Raises:
        ValueError: the marker lies beyond the beam's ends, or its position is traced.
    """
    beam = bodies.get(marker.body)
    if not isinstance(beam, Beam) or marker.at is None:
        return marker
    ends, place = beam.ends(), concrete(marker.at[0])
    if place is None and marker.body in built:
        return marker
    if place is None or not -1e-9 <= place / ends[-1] <= 1 + 1e-9:
        raise ValueError(
            f'a marker on the beam "{marker.body}" lies at x = {marker.at[0]} m; it must be a '
            f"number from 0 to its length {ends[-1]:g} m."
        )
    index = int(np.searchsorted(ends[1:-1], place))
    if not index:
        return marker
    at = (marker.at[0] - ends[index], *marker.at[1:])
    return with_fields(marker, body=piece_name(marker.body, index), at=at)
