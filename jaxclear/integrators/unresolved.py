"""Whether steps that resolve a motion resolve its derivative too.

A controller sees the errors of the motion alone. Where that is at rest steps grow beyond what a
stiff spring lets stand, and a derivative, which is at rest nowhere, grows with every one of them:
from 1e-5 to 1e57 in a second. So errors of derivatives are followed along a run: they are the
derivatives of the solver's own error estimate.

None of this is in a program of which no derivative is asked.
"""

from typing import Any

import diffrax
import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground.quantity import Scalar, constant
from jaxclear.ground.tangents import derived, moved, moving_with
from jaxclear.ground.unknown import Unknown
from jaxclear.integrators.trust import MOST_ERROR
from jaxclear.integrators.wrapped import AbstractAround

# All errors of a derivative together may be as large a share of the largest that it has been as
# that of one step may (`trust.MOST_ERROR`); such a step there may be.
# Not so many steps one behind the other: where something sets in, one step may be as coarse.
IN_A_ROW = 3

# Of a derivative: the sum of its errors, the largest that it has been, how many steps up to now had
# too large an error, one behind the other, and how many at the most.
Followed = Float[Array, "4"]


def unfollowed() -> Followed:
    """At the start of a run. Only derivatives of these numbers are ever anything else than 0."""
    return jnp.zeros(4)


def followed(
    ends: tuple[int, int], known: Followed, state: Array, error: Array, length: Scalar
) -> Followed:
    """What is known behind a step of this length [s], whose state is wrong by `error`; `ends` of
    the coordinates and of the speeds in a state."""

    def further(numbers, tangents):
        known, state, error = map(moved, tangents[:3])
        sums, largest, row, most = known
        size, off = (_size(ends, each, numbers[3]) for each in (state, error))
        row = jnp.where(off > MOST_ERROR * size, row + 1.0, 0.0)
        return jnp.stack([sums + off, jnp.maximum(largest, size), row, jnp.maximum(most, row)])

    same = lambda known, state, *_: moving_with(state[0], known)
    return derived(same, further)(known, state, error, constant(length))


def resolved(state: Array, known: Followed) -> Array:
    """The state; its derivative is nan where it was not resolved."""

    def judged(_, tangents):
        state, (sums, largest, _, most) = map(moved, tangents)
        fine = (sums <= MOST_ERROR * largest) & (most < IN_A_ROW)
        return jnp.where(fine, state, Unknown.UNRESOLVED.number)

    return derived(lambda state, known: state, judged)(state, known)


def _size(ends: tuple[int, int], numbers: Array, length: Scalar) -> Scalar:
    """Of a difference: of its places, and of the way that its speeds make in such a step."""
    n, m = ends
    way = jnp.concatenate([numbers[:n], length * numbers[n:m]])
    return jnp.max(abs(way), initial=0.0)


class FollowingErrors(
    AbstractAround, diffrax.AbstractAdaptiveSolver, diffrax.AbstractWrappedSolver
):
    """`solver`, whose state between steps ends with what is `followed` of the errors of
    derivatives, of states with such `ends`."""

    solver: diffrax.AbstractSolver  # type: ignore[misc]
    ends: tuple[int, int] = eqx.field(static=True)
    known: Any = None

    @property
    def interpolation_cls(self):
        return self.solver.interpolation_cls

    def init(self, terms, t0, t1, y0, args):
        return self.solver.init(terms, t0, t1, y0, args), self.known

    def func(self, terms, t0, y0, args):
        return self.solver.func(terms, t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        own, known = solver_state
        y1, error, dense, own, result = self.solver.step(terms, t0, t1, y0, args, own, made_jump)
        known = followed(self.ends, known, y1, error, t1 - t0)
        return y1, error, dense, (own, known), result
