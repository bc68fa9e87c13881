"""How much of its speed an impact keeps: what the contact law prescribes, or its numbers tell."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import concrete
from jaxclear.integrators.checks import Check
from jaxclear.integrators.figures import Checks
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.system import System, prepare

# Depths of an impact at which its loss is added up, by Gauss and Legendre.
DEPTHS = 8
# Restitution from which on what an impact is off by never dies out.
ELASTIC = 0.99


def restitution_of(mechanism: Mechanism, checks: Checks) -> float:
    """Largest restitution of the contacts of a mechanism; of laws that prescribe none, that of
    their deepest impact so far as `checks` tell it. 0 where none is known."""
    joints = {name: mechanism.connections[name].joint for name in mechanism.topology.clearances}
    laws = [own.contact for joint in joints.values() for own in joint.contact_laws()]
    told = [1.0 if law.lossless else concrete(law.restitution) for law in laws]
    found = [float(each) for each in told if each is not None]
    if None in told and Check.INDENTATION in checks.figures:
        found += _of_deepest(prepare(mechanism), checks)
    return max(found, default=0.0)


def _of_deepest(system: System, checks: Checks) -> list[float]:
    """Restitution of impacts as deep as the deepest, of every contact whose law prescribes none."""
    shares = checks.figures[Check.INDENTATION].worst
    shares = np.max(np.asarray(shares).reshape(-1, shares.shape[-1]), axis=0)
    contacts = [
        (own.contact, radius)
        for bearing in system.bearings.values()
        for own, radius in zip(bearing.contact_laws, bearing.radii, strict=True)
    ]
    mass = sum(float(link.mass) for link in system.links)
    return [
        restitution_at(law, float(share * radius), mass)
        for (law, radius), share in zip(contacts, shares, strict=True)
        if law.restitution is None and 0 < share < np.inf
    ]


def restitution_at(law: Any, depth: float, mass: float) -> float:
    """Restitution [1] of an impact of that mass [kg] which goes so deep [m]: what dampers take on
    the way in and out beside what the spring stores, at speeds as if they took nothing. A mass
    larger than that which strikes makes the speed less, and the restitution larger."""
    nodes, weights = np.polynomial.legendre.leggauss(DEPTHS)
    places, lengths = depth * 0.5 * (1 + nodes), depth * 0.5 * weights
    elastic = law.elastic_force(places)
    upto = 0.5 * places[:, None] * (1 + nodes)
    stored = np.sum(law.elastic_force(upto) * 0.5 * weights, axis=1) * places
    whole = float(np.sum(elastic * lengths))
    impact = (2 * whole / mass) ** 0.5
    speed = impact * safe_sqrt(jnp.clip(1 - safe_divide(stored, whole), 0.0, 1.0))
    ways = [law.normal_force(places, way * speed, impact) for way in (1, -1)]
    lost = float(jnp.sum((ways[0] - ways[1]) * lengths))
    return float(safe_sqrt(jnp.maximum(safe_divide(whole - 0.5 * lost, whole + 0.5 * lost), 0.0)))
