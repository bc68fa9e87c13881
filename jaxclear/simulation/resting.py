"""Where journals rest that do not lie each as its own reaction presses it, because the loops
through them do not let them: all together at the least of one potential, without friction.

The potential is the elastic energy of the contacts less the work of the reactions that the joints
have while all of them touch (d'Alembert: that is the work of loads and inertia forces). Newton's
method on the coordinates, held back (Levenberg) until its steps lessen the potential.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import compiled_quickly
from jaxclear.multibody import contact_point, kinematics
from jaxclear.multibody.assembly import ready
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.reach import narrowest_gap
from jaxclear.multibody.start_equations import (
    GIVEN,
    LOOP,
    Ask,
    ask,
    motions_at,
    nearer,
    position_blocks,
    retract,
    speed_scales,
    stacked,
)

# Steps after which a rest that has not been found counts as none; forces that are left at one,
# beside the largest reaction.
MOST_STEPS, LEFT = 400, 1e-6
# By which a step that lessens the potential is held back less, and one that does not more.
LESS, MORE = 0.3, 4.0
# Points of Gauss and Legendre's rule between touch and an indentation: after t^2 for the share of
# it, powers of a half are polynomials.
POINTS = 8
# Steps that close the loops anew.
CLOSING = 4


class Pressed(NamedTuple):
    """Reaction on a journal about its marker, in the bearing's axes: force [N], torque [N m]."""

    force: np.ndarray
    torque: np.ndarray


class Ground(NamedTuple):
    """Potential [J] at coordinates, its gradient and Hessian in the scaled speeds, and the rows
    that hold the loops there."""

    value: Array
    slope: Float[Array, " v"]
    bend: Float[Array, "v v"]
    rows: Float[Array, "rows v"]


def resting(mechanism: Mechanism, pressed: dict[str, Pressed], worn: dict) -> Array | None:
    """Coordinates at which the journals rest under these reactions; None where none were found.
    `worn`: readings of worn surfaces, by joint."""
    known, start = ready(mechanism)[:2]
    asked = ask(known, False)
    arm = float(asked.arm)
    largest = max(float(np.linalg.norm(own.force)) for own in pressed.values())
    if largest == 0.0:
        return start.coordinates
    at = lambda q: _ground(known, q, pressed, worn)
    moved = lambda q, step: _moved(known, q, step)
    q, held_back = start.coordinates, largest * arm**2 / float(narrowest_gap(asked.system))
    now = at(q)
    for _ in range(MOST_STEPS):
        free = _free(np.asarray(now.rows))
        slope, bend = free.T @ np.asarray(now.slope), free.T @ np.asarray(now.bend) @ free
        if np.abs(slope).max(initial=0.0) < LEFT * largest * arm:
            return q
        sizes, ways = np.linalg.eigh(bend)
        # Where the potential bends down, as far as where it bends up.
        step = -free @ (ways @ ((ways.T @ slope) / (np.abs(sizes) + held_back)))
        there = moved(q, jnp.asarray(step))
        then = at(there)
        if float(then.value) < float(now.value):
            q, now, held_back = there, then, LESS * held_back
        else:
            held_back *= MORE
    return None


def _free(rows: np.ndarray) -> np.ndarray:
    """Directions (v, n) in which no row changes."""
    if not len(rows):
        return np.eye(rows.shape[1])
    _, sizes, ways = np.linalg.svd(rows)
    rank = int((sizes > 1e-9 * sizes.max(initial=0.0)).sum())
    return ways[rank:].T


@compiled_quickly
def _ground(mechanism: Mechanism, q: Array, pressed: dict[str, Pressed], worn: dict) -> Ground:
    asked = ask(mechanism, False)
    scales = speed_scales(asked)
    energy = lambda step: _potential(asked, retract(asked.system, q, scales * step), pressed, worn)
    none = jnp.zeros(asked.system.topology.speed_count)
    value, slope = jax.value_and_grad(energy)(none)
    rows = stacked(asked, _held(asked, q))[0] * scales
    return Ground(value, slope, jax.hessian(energy)(none), rows)


def _held(asked: Ask, q: Array) -> list:
    return [block for block in position_blocks(asked, q, 0.0) if block.kind in (LOOP, GIVEN)]


@compiled_quickly
def _moved(mechanism: Mechanism, q: Array, step: Array) -> Array:
    """Coordinates after a step in the scaled speeds, loops closed."""
    asked = ask(mechanism, False)
    q = retract(asked.system, q, speed_scales(asked) * step)
    if not _held(asked, q):
        return q
    close = lambda q, _: (nearer(asked, q, _held(asked, q)), None)
    return jax.lax.scan(close, q, length=CLOSING)[0]


def _potential(asked: Ask, q: Array, pressed: dict[str, Pressed], worn: dict) -> Array:
    still = jnp.zeros(asked.system.topology.speed_count)
    motions = motions_at(asked, q, still, 0.0)[2]
    total: Any = 0.0
    for name, bearing in asked.system.bearings.items():
        pose = kinematics.relative_motion(bearing.closure, motions)[1]
        readings = worn.get(name, {})
        depths = contact_point.depths(bearing.joint, pose, readings)
        contact_laws = contact_point.laws_at(bearing.joint, bearing.contact_laws, pose, readings)
        # Forces are those of the laws as they are there, not of how these change from place to
        # place.
        contact_laws = jax.lax.stop_gradient(contact_laws)
        for laws, depth in zip(contact_laws, depths, strict=True):
            total = total + _stored(laws.contact.elastic_force, depth)
        force, torque = pressed[name]
        axis = sp.transpose(pose.rotation)[2]
        # A lean towards x is a turn about y, one towards y a turn back about x.
        leant = sp.sub(sp.mul(torque[1], axis[0]), sp.mul(torque[0], axis[1]))
        total = total + sp.add(sp.dot(tuple(force), pose.translation), leant)
    return total


def _stored(force: Any, depth: Any) -> Array:
    """Energy [J] of an elastic force at an indentation [m]."""
    points, weights = np.polynomial.legendre.leggauss(POINTS)
    t = jnp.asarray(0.5 * (points + 1))
    deep = jnp.where(depth > 0, depth, 0.0)
    return jnp.sum(jnp.asarray(weights) * t * deep * jax.vmap(force)(deep * t * t))
