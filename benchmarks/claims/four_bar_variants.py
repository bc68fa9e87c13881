"""The four-bar of paper 001 as the benchmarks take it apart: which joint at B, with or without
friction and wear.

Crank 0.1 m (driven), coupler 0.4 m, follower 0.3 m on a ball joint, ground 0.3 m; inertias are
those of slender rods.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from jaxclear.formulations.compliant import CompliantContact
from jaxclear.formulations.model import Model
from jaxclear.laws.stiffness import HertzStiffness
from jaxclear.multibody import constraints, kinematics
from jaxclear.multibody.state import Layout, lay_out, unpack_motion
from jaxclear.multibody.system import System, prepare, readings
from jaxclear.simulation.wear import unworn

CLEARANCE = 2e-4


class Variant(NamedTuple):
    """One scene of the family; `kind` is the joint at B: ideal, or with planar or spatial
    clearance.
    """

    kind: str
    friction: bool
    wear: bool

    @property
    def name(self) -> str:
        return "+".join([self.kind] + ["friction"] * self.friction + ["wear"] * self.wear)


VARIANTS = (
    Variant("ideal", False, False),
    *(
        Variant(kind, friction, wear)
        for kind in ("planar", "spatial")
        for friction in (False, True)
        for wear in (False, True)
    ),
)
FULL, RUBBING = Variant("spatial", True, True), Variant("spatial", True, False)


def bearing(variant: Variant, clearance: Any = CLEARANCE) -> Any:
    """The joint at B."""
    if variant.kind == "ideal":
        return jc.joint.Revolute()
    steel = jc.material.Material(206.8e9, 0.29)
    contact = jc.contact.LankaraniNikravesh(stiffness=HertzStiffness(steel, steel))
    friction = jc.friction.ThreeZone() if variant.friction else None
    wear = jc.Wearing(jc.wear.Archard(wear_coefficient=2e-2)) if variant.wear else None
    planar = variant.kind == "planar"
    kind = jc.clearance.PlanarJournalBearing if planar else jc.clearance.JournalBearing
    return kind(contact, friction, clearance=clearance, length=0.03, bearing_wear=wear)


def rod(mass: float, length: float, planar: bool) -> jc.Body:
    """A slender rod along x from its own origin, with a small inertia about its own axis."""
    across = mass * length**2 / 12
    return jc.Body(mass, across if planar else (1e-4, across, across), (length / 2, 0.0))


def build(variant: Variant = FULL, clearance: Any = CLEARANCE) -> jc.Mechanism:
    """The mechanism of a variant."""
    flat = variant.kind != "spatial"
    foot = jc.joint.Revolute() if flat else jc.joint.Spherical()
    return jc.Mechanism(
        bodies={
            "crank": rod(0.46, 0.1, True),
            "coupler": rod(1.44, 0.4, True),
            "follower": rod(1.63, 0.3, flat),
        },
        connections={
            "O": jc.Connection(jc.joint.Revolute(jc.drive.ConstantSpeed(10.0)), "ground", "crank"),
            "A": jc.Connection(jc.joint.Revolute(), "crank", "coupler", at=(0.1, 0.0)),
            "B": jc.Connection(
                bearing(variant, clearance),
                "coupler",
                jc.Marker("follower", (0.3, 0.0)),
                at=(0.4, 0.0),
            ),
            "D": jc.Connection(foot, "ground", "follower", at=(0.3, 0.0)),
        },
        loads={"gravity": jc.load.Gravity()},
        guess={"A": 0.8, "D": 1.3 if flat else (0.0, 0.0, 1.3)},
    )


def without(mechanism: jc.Mechanism, feature: str) -> jc.Mechanism:
    """The mechanism with a feature of joint B taken out afterwards: must equal the one that never
    had it.
    """
    field = {"friction": "friction", "wear": "bearing_wear"}[feature]
    return eqx.tree_at(lambda m: getattr(m.connections["B"].joint, field), mechanism, None)


def with_clearance(mechanism: jc.Mechanism, clearance: Any) -> jc.Mechanism:
    """The mechanism with another clearance, which may be traced."""
    return eqx.tree_at(lambda m: m.connections["B"].joint.clearance, mechanism, clearance)


def parts(mechanism: jc.Mechanism) -> tuple[System, Layout, dict]:
    """System, layout and readings of new surfaces."""
    system = prepare(mechanism)
    return system, lay_out(system), readings(system, unworn(system))


class Field(eqx.Module):
    """The rate of the state as a function of time and state."""

    model: Model

    def __call__(self, time, state):
        # What checks ask for beside it is left out.
        return CompliantContact().rate(self.model, time, state)[0][: self.model.layout.size]


def field_of(mechanism: jc.Mechanism, read: dict | None = None) -> Field:
    """The rate of the state as `simulate` integrates it; surfaces are new unless `read` gives
    them."""
    system, layout, new = parts(mechanism)
    return Field(Model(system, new if read is None else read, mechanism.baumgarte, layout))


def start_of(mechanism: jc.Mechanism) -> jax.Array:
    """The state in which `simulate` starts."""
    start, (_, layout, _) = jc.assemble(mechanism), parts(mechanism)
    return jnp.concatenate(
        [start.coordinates, start.speeds, jnp.zeros(layout.size - layout.memory_start)]
    )


def constraint_rows(mechanism: jc.Mechanism) -> int:
    """Rows that close loops, those that the structure satisfies left out."""
    system, *_ = parts(mechanism)
    q, v = unpack_motion(system, list(start_of(mechanism)))
    motions = kinematics.link_motions(system, q, v, 0.0)
    return sum(
        len(constraints.constraint_rows(system, motions, closure).moving)
        for closure in system.closures
    )


def samples(mechanism: jc.Mechanism, count: int, seed: int = 0) -> np.ndarray:
    """States near the assembled start at time zero, the journal off centre by about a clearance: in
    and out of contact.
    """
    rng = np.random.default_rng(seed)
    layout = parts(mechanism)[1]
    states = np.tile(np.asarray(start_of(mechanism)), (count, 1))
    motion = layout.memory_start
    off = (
        rng.normal(size=(count, layout.coordinates)) * rng.uniform(0.5, 2.0, (count, 1)) * CLEARANCE
    )
    states[:, : layout.coordinates] += off
    states[:, layout.coordinates : motion] += rng.normal(size=(count, layout.speeds))
    states[:, motion:] = np.abs(rng.normal(size=(count, layout.size - motion)))
    return states
