"""The four-bar of paper 001 as the benchmarks take it apart: which joint at B, with or without friction and wear.

Crank 0.1 m (driven), coupler 0.4 m, follower 0.3 m on a ball joint, ground 0.3 m; inertias are those of slender rods.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from jaxclear.laws.stiffness import HertzStiffness
from jaxclear.scene import dynamics
from jaxclear.scene.state import Layout, lay_out
from jaxclear.scene.system import System, prepare, readings
from jaxclear.time.simulate import Field, unworn

KINDS = ("ideal", "planar", "spatial")
CLEARANCE = 2e-4


class Variant(NamedTuple):
    """One scene of the family."""

    kind: str
    friction: bool
    wear: bool

    @property
    def name(self) -> str:
        parts = [self.kind] + ["friction"] * self.friction + ["wear"] * self.wear
        return "+".join(parts)


VARIANTS = (Variant("ideal", False, False),) + tuple(
    Variant(kind, friction, wear) for kind in KINDS[1:] for friction in (False, True) for wear in (False, True)
)
FULL = Variant("spatial", True, True)


def bearing(variant: Variant, clearance: float = CLEARANCE) -> Any:
    """The joint at B."""
    if variant.kind == "ideal":
        return jc.joint.Revolute()
    steel = jc.material.Material(206.8e9, 0.29)
    contact = jc.contact.LankaraniNikravesh(stiffness=HertzStiffness(steel, steel))
    friction = jc.friction.ThreeZone() if variant.friction else None
    wear = jc.Wearing(jc.wear.Archard(wear_coefficient=2e-2)) if variant.wear else None
    if variant.kind == "planar":
        return jc.clearance.PlanarJournalBearing(contact, friction, clearance=clearance, length=0.03, wear=wear)
    return jc.clearance.JournalBearing(contact, friction, clearance=clearance, length=0.03, bearing_wear=wear)


def rod(mass: float, length: float, planar: bool) -> jc.Body:
    """A slender rod along x from its own origin; its thin axis has a small inertia of its own."""
    across = mass * length**2 / 12
    return jc.Body(mass, across if planar else (1e-4, across, across), (length / 2, 0.0))


def build(variant: Variant = FULL, clearance: float = CLEARANCE) -> jc.Mechanism:
    """The mechanism of a variant."""
    flat = variant.kind != "spatial"
    return jc.Mechanism(
        bodies={"crank": rod(0.46, 0.1, True), "coupler": rod(1.44, 0.4, True), "follower": rod(1.63, 0.3, flat)},
        connections={
            "O": jc.Connection(jc.joint.Revolute(jc.drive.ConstantSpeed(10.0)), "ground", "crank"),
            "A": jc.Connection(jc.joint.Revolute(), "crank", "coupler", at=(0.1, 0.0)),
            "B": jc.Connection(bearing(variant, clearance), "coupler", jc.Marker("follower", (0.3, 0.0)), at=(0.4, 0.0)),
            "D": jc.Connection(jc.joint.Revolute() if flat else jc.joint.Spherical(), "ground", "follower", at=(0.3, 0.0)),
        },
        loads={"gravity": jc.load.Gravity()},
        start={"A": 0.8, "D": 1.3 if flat else (0.0, 0.0, 1.3)},
    )


def without(mechanism: jc.Mechanism, *features: str) -> jc.Mechanism:
    """The mechanism with features of joint B taken out afterwards; the oracle for "never given"."""
    fields = {"friction": "friction"} | {"wear": "wear" if hasattr_wear(mechanism) else "bearing_wear"}
    for feature in features:
        mechanism = eqx.tree_at(
            lambda m, field=fields[feature]: getattr(m.connections["B"].joint, field), mechanism, None
        )
    return mechanism


def hasattr_wear(mechanism: jc.Mechanism) -> bool:
    return isinstance(mechanism.connections["B"].joint, jc.clearance.PlanarJournalBearing)


def parts(mechanism: jc.Mechanism) -> tuple[System, Layout, dict]:
    """System, layout and readings of new surfaces."""
    system = prepare(mechanism)
    return system, lay_out(system), readings(system, unworn(system))


def field_of(mechanism: jc.Mechanism) -> Field:
    """The rate of the state as `simulate` integrates it, for surfaces that are new."""
    system, layout, read = parts(mechanism)
    return Field(system, read, mechanism.stabilisation, layout)


def start_of(mechanism: jc.Mechanism) -> jnp.ndarray:
    """The state in which `simulate` starts."""
    start, (_, layout, _) = jc.assemble(mechanism), parts(mechanism)
    return jnp.concatenate([start.coordinates, start.speeds, jnp.zeros(layout.size - layout.memory_start)])


def samples(mechanism: jc.Mechanism, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(times, states) near the assembled start, offsets of the journal up to two clearances: in and out of contact."""
    rng = np.random.default_rng(seed)
    layout = parts(mechanism)[1]
    start = np.asarray(start_of(mechanism))
    states = np.tile(start, (count, 1))
    motion = layout.memory_start
    states[:, : layout.coordinates] += rng.uniform(-1, 1, (count, layout.coordinates)) * 1.2 * CLEARANCE
    states[:, layout.coordinates : motion] += rng.normal(size=(count, layout.speeds))
    states[:, motion:] = np.abs(rng.normal(size=(count, layout.size - motion)))
    times = rng.uniform(-1, 1, count) * 1e-4
    return times, states


__all__ = ["VARIANTS", "FULL", "build", "dynamics", "field_of", "samples", "start_of", "without"]
