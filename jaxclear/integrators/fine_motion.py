r"""Derivatives of steps that do not resolve contacts: those of the motion beside them.

A step that damps a contact, or goes through it at once, cannot tell how a number moves what is
behind: its own derivative converges slowly, or to nothing. But where runs are to be differentiated
the motion itself can go beside the steps, in parts of these that are as short as contacts ask for
and end at touches and releases (`motion_parts`). Derivatives are those of that motion, at its
places. How far the run has parted from it is known at every step: where that is too far the
derivative is not the run's, and nan (`trust.beside`); the motion goes no further then. Where loops
are closed anew after every step, those of the motion are too, and the step itself ends closed: what
closes the run's says nothing of the motion.

The motion is a derivative of zeros, which a loop carries: so none of it is in a program of which no
derivative is asked.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array

from jaxclear.formulations import closing
from jaxclear.formulations.compliant import CompliantContact
from jaxclear.ground.quantity import Scalar
from jaxclear.ground.tangents import derived, derived_once, moved, pushed, zeros_with
from jaxclear.integrators.mid_step import moves
from jaxclear.integrators.motion_parts import followed
from jaxclear.integrators.peaks import Peaks, nothing_met
from jaxclear.integrators.saltation import closed, motion_of
from jaxclear.integrators.stepping import SLIVER
from jaxclear.integrators.trust import NO_SECOND, PARTED, beside, unknown_way
from jaxclear.multibody.reach import gaps_passed


class Beside(NamedTuple):
    """Zeros. Their derivatives are, of the motion beside a run: how far its state is `away` from
    the run's, how far its places have `parted` from these at most [1] of the narrowest gap, and the
    `peaks` of each contact."""

    away: Array
    parted: Scalar
    peaks: Peaks


def nothing_beside(size: int, contacts: int, damped: bool) -> Beside:
    """Where a run begins, of which the state has this size, and some contact is `damped`."""
    return Beside(jnp.zeros(size), jnp.zeros(()), nothing_met(jnp.zeros(contacts), damped))


def beside_steps(formulation: CompliantContact, rest: Any, plain: Callable) -> Callable:
    """A step with the derivative of the motion beside it, as a function of (arrays, clock, state,
    last, met, beside).

    `plain(arrays, clock, y, last, met)`: the state at its end, what it leaves to the next, and the
    peaks until then. `arrays`: of the model, and of all else; `clock`: its start and length [s];
    `rest`: of the model."""
    motion = motion_of(formulation, rest)

    def remember(arrays, y, contacts, length):
        """Contacts that are apart forget their impact speeds; those that begin closed have one."""
        if not formulation.remembers(rest):
            return y
        model = eqx.combine(arrays, rest)
        return formulation.remember(model, y, contacts, contacts, length)

    def close(arrays, time, length, y):
        return closing.closed(eqx.combine(arrays, rest), time, y, length)

    def step(arrays, clock, y, last, met, beside):
        end, *found = plain(arrays, clock, y, last, met)
        return end, *found, zeros_with(end[0], beside)

    @jax.custom_jvp
    def known(*numbers):
        return step(*numbers)

    def moving(numbers, tangents):
        arrays, clock, y, *_ = numbers
        way, clock_way, state, _, met_way, beside = tangents
        found = step(*numbers)
        end, now, *_ = found
        beside, met_way = jax.tree.map(moved, (beside, met_way))
        longer = moved(clock_way[1]) if moves(clock_way) else None
        ways = way[0], (clock_way[0], longer), moved(state)
        begun = y + beside.away
        own = remember, close if rest.projects else None
        ended = _parted(motion, own, (arrays[0], clock, begun), ways, met_way, beside)
        there, gone, higher, beside = ended
        away = there - end
        share = gaps_passed(eqx.combine(arrays[0], rest).system, away)
        beside = beside._replace(away=away, parted=jnp.maximum(beside.parted, share))
        return found, (gone, jax.tree.map(jnp.zeros_like, now), higher, beside)

    known.defjvp(moving, symbolic_zeros=True)
    return known


def so_far(beside: Beside) -> Beside:
    """What is known where a saving interval begins."""
    zeros = lambda beside: jax.tree.map(lambda each: zeros_with(each, each), beside)
    same = lambda numbers, tangents: jax.tree.map(moved, tangents[0])
    return derived(zeros, same)(beside)


def trusted_beside(end: Any, met: Any, watch: Any, known: Beside) -> tuple:
    """All that was found of a run, where the derivative of the motion beside it can be trusted;
    events have none."""
    end, met = derived_once(NO_SECOND, beside((end, met), known.parted))
    return end, met, unknown_way(watch) if watch is not None else None


def _parted(
    motion: Any, own: tuple, here: tuple, ways: tuple, higher: Any, beside: Beside
) -> tuple:
    """(state, its derivative, that of the peaks, what is known) behind a step from
    `here` (arrays, clock, state); `own`: how its impact speeds are remembered, and its loops closed
    (None: they are not). Where run and motion have parted nothing goes on."""
    remember, close = own
    arrays, (time, whole), y = here
    way, (time_way, longer), state = ways
    moving = longer is not None
    rates = lambda at, y: motion.rates(arrays, closed(motion.contacts(arrays, at, y)), at, y)
    if moving:
        state = state - moved(time_way) * rates(time, y)
    aware = lambda y, contacts: remember(arrays, y, contacts, whole)
    together = beside.parted <= PARTED
    known = together, y, (beside.peaks, higher)
    part = followed(motion, aware, (arrays, time, whole), (way, state), known)
    y, state, (highest, higher) = part.y, part.way, part.peaks
    if close is not None:
        at = time + whole
        still = SymbolicZero.from_primal_value(at)
        y, state = pushed(close, (arrays, at, whole, y), (way, still, still, state))
    if moving:
        state = state + (moved(time_way) + longer) * rates(time + whole, y)
    ended = part.done >= whole * (1 - SLIVER)
    parted = jnp.where(ended, beside.parted, jnp.inf)
    beside = Beside(beside.away, parted, highest)
    return y, state, higher, beside
