"""The state of a simulation as one flat array, and where everything sits in it.

Sections in order: coordinates, speeds, memories of contact laws, angles that are followed over
whole turns (of joints outside the tree with torsion springs), states of loads and of the flanks of
play, worn volumes with their volume-weighted locations, impulses (of joints whose forces are no
functions of the state), energies. One array, because a compiled loop pays for every leaf it
carries. What a scene lacks has no entries.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from jaxclear.components.clearance import ContactCandidate, ContactLaws
from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import by_form
from jaxclear.ground.numerics import safe_divide
from jaxclear.multibody.contact_point import PointState, memory_template
from jaxclear.multibody.system import (
    SLIP,
    Bearing,
    System,
    coordinate_loads,
    flanks_that_wear,
    rubbing_joints,
)

# An offset [m] at which nothing is structurally zero but by the scene.
PROBE = (0.3e-3, 0.1e-3, 0.2e-3)
ENERGIES = ("input", "contact_work", "contact_loss", "friction_loss", "damping_loss")


@dataclass(frozen=True)
class WearSlot:
    """Where the worn volume of one contact on one surface sits; `averaged` are the features that
    vary in time.
    """

    bearing: str
    surface: str
    contact: int
    start: int
    averaged: tuple[int, ...]
    constants: tuple[tuple[int, float], ...]

    @property
    def feature_count(self) -> int:
        return len(self.averaged) + len(self.constants)

    def loss(self, before: Array, after: Array) -> tuple[Array, Array]:
        """(volume [m3] that the contact lost between two states, location features as means over
        it); nothing lost has zeros for those that vary."""
        entries = slice(self.start, self.start + 1 + len(self.averaged))
        change = after[entries] - before[entries]
        features: list[Any] = [0.0] * self.feature_count
        for place, i in enumerate(self.averaged):
            features[i] = safe_divide(change[1 + place], change[0])
        for i, value in self.constants:
            features[i] = value
        return change[0], sp.stack(features)


@dataclass(frozen=True)
class Layout:
    """Static description of the state array. `states`: (load or coupling, state); `plays`:
    couplings whose play has flanks, two possible contacts each, behind those of the joints."""

    coordinates: int
    speeds: int
    memories: tuple[tuple[str, tuple[tuple[bool, int], ...]], ...]
    angles: tuple[str, ...]
    wear: tuple[WearSlot, ...]
    impulses: tuple[tuple[str, int], ...]
    energies: tuple[str, ...]
    size: int
    states: tuple[tuple[str, str], ...] = field(default=())
    plays: tuple[str, ...] = field(default=())

    @property
    def contacts(self) -> int:
        """How many contacts are possible."""
        return self.joint_contacts + 2 * len(self.plays)

    @property
    def joint_contacts(self) -> int:
        """How many of them are contacts of joints."""
        return sum(len(kinds) for _, kinds in self.memories)

    @property
    def memory_start(self) -> int:
        return self.coordinates + self.speeds

    @property
    def remembered(self) -> slice:
        """What a motion goes on with beside coordinates and speeds."""
        return slice(self.memory_start, self.state_start + len(self.states))

    @property
    def memory_count(self) -> int:
        return sum(
            remembers + bristles for _, kinds in self.memories for remembers, bristles in kinds
        )

    @property
    def angle_start(self) -> int:
        return self.memory_start + self.memory_count

    @property
    def state_start(self) -> int:
        return self.angle_start + len(self.angles)

    @property
    def energy_start(self) -> int:
        return self.size - len(self.energies)

    @property
    def impulse_start(self) -> int:
        return self.energy_start - sum(count for _, count in self.impulses)

    def impulses_of(self, name: str) -> slice:
        """Which of all impulses are those of a joint."""
        start = 0
        for joint, count in self.impulses:
            if joint == name:
                return slice(start, start + count)
            start += count
        raise KeyError(name)


@by_form
def lay_out(
    system: System, balance: bool = False, impulses: tuple[tuple[str, int], ...] = ()
) -> Layout:
    """The layout of a system's state array.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        balance: whether energies are integrated that close the energy balance.
        impulses: (joint, number of components) of impulses [N s, N m s] since the start.
    """
    topology = system.topology
    memories, wear = [], []
    position = topology.coordinate_count + topology.speed_count
    samples = {}
    for name, bearing in system.bearings.items():
        offset, axes, overlaps, contact_candidates = probe_joint(system, bearing)
        kinds = []
        for laws, candidate in zip(bearing.contact_laws, contact_candidates, strict=True):
            template = memory_template(laws, candidate)
            kinds.append((template.impact_speed is not None, len(template.bristles)))
        memories.append((name, tuple(kinds)))
        position += sum(remembers + bristles for remembers, bristles in kinds)
        samples[name] = (bearing, offset, axes, overlaps)
    angles = tuple(name for name, part in system.measured.items() if part.followed)
    states = tuple(
        (name, state.name) for name, load in coordinate_loads(system) for state in load.states()
    )
    states += tuple((name, x) for name, part in system.transmissions.items() for x in part.states())
    plays = tuple(name for name, part in system.transmissions.items() if part.coupling.play)
    position += len(angles) + len(states)
    for name, surface, k, features in _iterate_wear_slots(system, samples):
        constants = {i: f for i, f in enumerate(features) if isinstance(f, (int, float))}
        averaged = tuple(i for i in range(len(features)) if i not in constants)
        values = tuple((i, float(f)) for i, f in constants.items())
        wear.append(WearSlot(name, surface, k, position, averaged, values))
        position += 1 + len(averaged)
    energies = ENERGIES if balance else ()
    size = position + sum(count for _, count in impulses) + len(energies)
    return Layout(
        topology.coordinate_count,
        topology.speed_count,
        tuple(memories),
        angles,
        tuple(wear),
        impulses,
        energies,
        size,
        states,
        plays,
    )


def _iterate_wear_slots(system: System, samples: dict[str, tuple]) -> list[tuple]:
    """(joint, surface, contact, location) of every contact whose wear is mapped, the joints with
    clearance as `samples` show them."""
    result = []
    for name, (bearing, offset, axes, overlaps) in samples.items():
        for surface in bearing.joint.maps():
            for k, laws in enumerate(bearing.contact_laws):
                if laws.wears:
                    place = bearing.joint.features(surface, offset, axes, overlaps, k)
                    result.append((name, surface, k, place))
    for name, rubbing in rubbing_joints(system).items():
        offset, axes = tuple(map(jnp.asarray, PROBE)), _home_axes(rubbing.gap_axes)
        for surface in rubbing.maps():
            result += [
                (name, surface, k, rubbing.wear_place(surface, offset, axes, k, jnp.zeros(())))
                for k in rubbing.wearing_contacts()
            ]
    for name, play in flanks_that_wear(system).items():
        result += [(name, flank, k, (0.0,)) for k, flank in enumerate(play.maps())]
    return result


def probe_joint(system: System, bearing: Bearing) -> tuple:
    """(offset, axes, indentations, contact candidates) of a clearance joint somewhere: for what
    does not depend on the place.
    """
    planar = _is_planar(system)
    offset = tuple(jnp.asarray(x) for x in PROBE[:2]) + (
        (0,) if planar else (jnp.asarray(PROBE[2]),)
    )
    axes = _home_axes(bearing.joint.axes)
    overlaps = bearing.joint.indentations(offset, axes, {})
    return offset, axes, overlaps, bearing.joint.contact_candidates(offset, axes, overlaps)


def _home_axes(axes: tuple[int, ...]) -> tuple:
    """Axes of a journal where they are those of the bearing."""
    return tuple(tuple(jnp.asarray(float(x)) for x in sp.IDENTITY[k]) for k in axes)


def component_count(laws: ContactLaws, candidate: ContactCandidate) -> int:
    """Components of a contact's force: a normal one, and one per slip direction where it rubs."""
    return 1 + (0 if laws.friction is None else len(candidate.tangents))


def contact_components(system: System) -> tuple[tuple[str, int], ...]:
    """By clearance joint, how many components its contacts' forces have."""
    return tuple(
        (name, sum(components(system, bearing))) for name, bearing in system.bearings.items()
    )


@by_form
def components(system: System, bearing: Bearing) -> tuple[int, ...]:
    """By contact of a clearance joint, how many components its force has."""
    return tuple(map(component_count, bearing.contact_laws, probe_joint(system, bearing)[3]))


def _is_planar(system):
    return all(
        not link.joint.columns(link.joint.home) or _is_planar_link(link) for link in system.links
    ) and bool(system.links)


def _is_planar_link(link):
    return all(
        sp.is_zero(c.linear[2]) and sp.is_zero(c.angular[0]) and sp.is_zero(c.angular[1])
        for c in link.joint.columns(link.joint.home)
    )


def unpack_motion(system: System, entries: Any) -> tuple[tuple, tuple]:
    """Coordinates and speeds of each link as tuples of scalars, from the entries of a state."""
    topology = system.topology
    shift = topology.coordinate_count
    q = tuple(
        tuple(entries[i] for i in range(b.coordinates.start, b.coordinates.stop))
        for b in topology.branches
    )
    v = tuple(
        tuple(entries[shift + i] for i in range(b.speeds.start, b.speeds.stop))
        for b in topology.branches
    )
    return q, v


def unpack_memories(layout: Layout, entries: Any) -> dict[str, tuple[PointState, ...]]:
    """Memory of each possible contact, by clearance joint."""
    position, memories = layout.memory_start, {}
    for name, kinds in layout.memories:
        points = []
        for remembers, bristles in kinds:
            speed = entries[position] if remembers else None
            position += remembers
            points.append(PointState(speed, tuple(entries[position + i] for i in range(bristles))))
            position += bristles
        memories[name] = tuple(points)
    return memories


def pack_memories(layout: Layout, memories: dict[str, tuple[PointState, ...]]) -> list:
    """Inverse of `unpack_memories`."""
    entries = []
    for name, _ in layout.memories:
        for point in memories[name]:
            entries.extend([] if point.impact_speed is None else [point.impact_speed])
            entries.extend(point.bristles)
    return entries


NONE: Mapping[str, Any] = MappingProxyType({})


class Followed(NamedTuple):
    """What the state follows beside the motion: `angles` [rad] over whole turns, by joint; `states`
    of loads and of flanks, by load or coupling; and how the flanks of every play count, 1 as
    touching, 0 as apart (`shares`, by coupling; none: as their places have it)."""

    angles: Mapping[str, Any] = NONE
    states: Mapping[str, tuple] = NONE
    shares: Mapping[str, tuple] = NONE


def unpack_followed(layout: Layout, entries: Any, shares: Any = None) -> Followed:
    """Angles, load states and flanks that the state integrates beside the motion.

    Args:
        layout: where they sit.
        entries: of a state, an array or a list of scalars.
        shares: 1 for touching and 0 for apart, for the two flanks of each play in turn; None:
            as their
            positions have it.
    """
    angles = {name: entries[layout.angle_start + i] for i, name in enumerate(layout.angles)}
    states: dict[str, tuple] = {}
    for i, (owner, _) in enumerate(layout.states):
        states[owner] = (*states.get(owner, ()), entries[layout.state_start + i])
    report = {}
    if shares is not None:
        report = {n: (shares[2 * i], shares[2 * i + 1]) for i, n in enumerate(layout.plays)}
    return Followed(angles, states, report)


def state_bounds(system: System, layout: Layout) -> dict[int, Any]:
    """The size at which states stand still, by their place in the state, of those that have one:
    deflections of friction that holds."""
    most: list[Any] = [x.saturation for _, load in coordinate_loads(system) for x in load.states()]
    for part in system.transmissions.values():
        fixed = part.coupling.thread if part.driving is None else part.driving.loses
        yields = None if fixed is None else fixed.presliding
        most += [yields if name == SLIP else None for name in part.states()]
    return {layout.state_start + i: each for i, each in enumerate(most) if each is not None}


def within_bounds(system: System, layout: Layout, state: Any) -> Any:
    """The state at the end of a step, with load states clipped to their bounds.

    The derivative of an entry at its bound is 0.

    Args:
        system: with the loads that bound their states.
        layout: where these states sit.
        state: shape (n,).
    """
    for place, most in state_bounds(system, layout).items():
        state = state.at[place].set(jnp.clip(state[place], -most, most))
    return state


def impact_speed_places(layout: Layout) -> tuple[int | None, ...]:
    """Where the impact speed of each possible contact sits in the state; None for a law that does
    not remember it.
    """
    position, places = layout.memory_start, []
    for _, kinds in layout.memories:
        for remembers, bristles in kinds:
            places.append(position if remembers else None)
            position += remembers + bristles
    return tuple(places)


def bristle_places(layout: Layout) -> list[int]:
    """Where the deflections of bristles sit in the state."""
    position = layout.memory_start
    places: list[int] = []
    for _, kinds in layout.memories:
        for remembers, bristles in kinds:
            position += remembers
            places += range(position, position + bristles)
            position += bristles
    return places


def names(system: System, layout: Layout) -> list[str]:
    """A name for each entry of the state."""
    topology, out = system.topology, []
    for branch in topology.branches:
        out += [f"{branch.name}.q{i}" for i in range(branch.coordinate_count)]
    for branch in topology.branches:
        out += [f"{branch.name}.v{i}" for i in range(branch.speed_count)]
    for name, kinds in layout.memories:
        for k, (remembers, bristles) in enumerate(kinds):
            out += [f"{name}.impact_speed{k}"] * remembers + [
                f"{name}.bristle{k}_{i}" for i in range(bristles)
            ]
    out += [f"{name}.angle" for name in layout.angles]
    out += [f"{owner}.{name}" for owner, name in layout.states]
    for slot in layout.wear:
        label = f"{slot.bearing}.{slot.surface}.volume{slot.contact}"
        out += [label] + [f"{label}.location{i}" for i in slot.averaged]
    out += [f"{name}.impulse{i}" for name, count in layout.impulses for i in range(count)]
    return out + list(layout.energies)
