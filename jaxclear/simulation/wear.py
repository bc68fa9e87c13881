"""Depth maps of worn surfaces: new ones, and what a saving interval takes off."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array

from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide
from jaxclear.multibody.state import Layout
from jaxclear.multibody.system import System

Worn = dict[str, dict[str, Array]]


def unworn(system: System) -> Worn:
    """Depth maps of new surfaces, by joint and surface."""
    return {
        name: {
            surface: jnp.zeros(wear_map.cells)
            for surface, (wear_map, _) in bearing.joint.maps().items()
        }
        for name, bearing in system.bearings.items()
        if bearing.joint.maps()
    }


def deposit(system: System, layout: Layout, worn: Worn, before: Array, after: Array) -> Worn:
    """Depth maps after what was lost between two states."""
    worn = {name: dict(surfaces) for name, surfaces in worn.items()}
    for slot in layout.wear:
        wear_map = system.bearings[slot.bearing].joint.maps()[slot.surface][0]
        entries = slice(slot.start, slot.start + 1 + len(slot.averaged))
        change = after[entries] - before[entries]
        features: list[Any] = [0.0] * slot.feature_count
        for place, i in enumerate(slot.averaged):
            features[i] = safe_divide(change[1 + place], change[0])
        for i, value in slot.constants:
            features[i] = value
        old = worn[slot.bearing][slot.surface]
        worn[slot.bearing][slot.surface] = wear_map.deposit(
            old, change[:1], sp.stack(features)[None]
        )
    return worn
