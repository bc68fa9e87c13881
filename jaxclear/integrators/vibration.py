r"""Whether steps of a given length follow the vibrations of a derivative.

A motion at rest on a contact or a stiff spring stays there, whatever the step. Its derivative is at
rest nowhere: in steps too long for the stiffness it vibrates as they have it, or grows at each of
them. Between two steps of length h a derivative changes by :math:`h\,w` of the places and
:math:`-h\,\omega^2\,u` of the speeds, whatever the method: u and w are its places and speeds in
between. So what speeds change by in a step, times the step, beside what places change by is
:math:`h\omega`, of all that moves; of what a derivative grows by, the more so.

None of this is in a program of which no derivative is asked.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.formulations.model import Model
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.quantity import Scalar, constant
from jaxclear.ground.tangents import derived, moved, zeros_with
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.multibody.state import Layout

# An angle by which a vibration goes on in a step [rad], from which on a method of that order is off
# by more than half a hundredth of it in each, x^(p + 1) / (p + 1)!; and one that is symmetric in
# time, such as the midpoint rule and symplectic Euler, by x^3 / 24.
FOLLOWED = {1: 0.1, 2: 0.31, 3: 0.59, 4: 0.9}
SYMMETRIC = 0.5
# So much of what was before counts on at each step: a vibration is at all its phases within some.
KEPT = 0.9
# A vibration matters where a step moves speeds so that they would go this share of the largest that
# a derivative has been; or where it grows.
VISIBLE = 0.01
# Not so many steps one behind the other: an impact, or what sets in, takes a few.
IN_A_ROW = 12
# A derivative of places and speeds this share as large as that of what a run sums up is rounding:
# a drive, not friction, says where the mechanism is.
ROUNDING = 1e-12

# Of a derivative: sums of squares of its changes of speeds, times the step, and of places; the
# largest that the first has been; the largest derivative; how many steps up to now have not
# followed it, one behind the other, and how many at the most.
FIGURES = 6
Vibration = Float[Array, f"{FIGURES}"]


def nothing(model: Model, integrator: AbstractIntegrator) -> Vibration | None:
    """At the start of a run: zeros, of which only derivatives are ever anything else. None where
    derivatives are those of discrete steps, or go backwards through steps that are counted."""
    counted = integrator.steps_between_saves is not None
    return None if counted or model.discrete or not model.layout.size else jnp.zeros(FIGURES)


def followed(
    model: Model,
    angle: float,
    known: Vibration | None,
    states: tuple[Array, Array],
    length: Scalar,
) -> Vibration | None:
    """What is known behind a step of this length [s] between two states; `angle`: by how much of a
    vibration the method follows it [rad]."""
    if known is None:
        return None

    def gone_on(numbers, tangents):
        known, before, after = (moved(each) for each in (tangents[0], *tangents[1]))
        return further(model.layout, angle, known, (before, after), numbers[2])

    same = lambda known, states, _: zeros_with(states[1][0], known)
    return derived(same, gone_on)(known, states, constant(length))


def further(
    layout: Layout,
    angle: float,
    known: Vibration,
    ways: tuple[Array, Array],
    length: Scalar,
    share: Any = 1.0,
) -> Vibration:
    """What is known of a derivative behind a part of this length [s], and `share` of a step, at
    whose start and end it has these values; `angle`: as of `followed`, in a part."""
    n, m = layout.coordinates, layout.memory_start
    before, after = ways
    places, speeds = after[:n] - before[:n], length * (after[n:m] - before[n:m])
    turned, gone, most, largest, row, longest = [known[i] for i in range(FIGURES)]
    turned = KEPT**share * turned + safe_divide(jnp.sum(speeds * speeds), share)
    gone = KEPT**share * gone + safe_divide(jnp.sum(places * places), share)
    ahead = safe_divide(length, share) * after[n:m]
    largest = jnp.maximum(largest, jnp.max(abs(jnp.concatenate([after[:n], ahead])), initial=0.0))
    matters = (turned > most) | (turned > VISIBLE * VISIBLE * largest * largest)
    matters &= largest > ROUNDING * jnp.max(abs(after[m:]), initial=0.0)
    row = jnp.where(matters & (turned > angle * angle * gone), row + share, 0.0)
    most, longest = jnp.maximum(most, turned), jnp.maximum(longest, row)
    return jnp.stack([turned, gone, most, largest, row, longest])


def resolved(found: Any, known: Vibration | None) -> Any:
    """What was found of a run; its derivative is nan where steps have not followed it."""
    if known is None:
        return found

    def judged(_, tangents):
        found, known = tangents
        fine = moved(known)[-1] < IN_A_ROW
        return jax.tree.map(lambda each: jnp.where(fine, moved(each), jnp.nan), found)

    return derived(lambda found, known: found, judged)(found, known)
