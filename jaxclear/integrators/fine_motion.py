r"""Derivatives of steps that do not resolve contacts: those of the motion beside them.

A step that damps a contact, or goes through it at once, cannot tell how a number moves what is
behind: its own derivative converges slowly, or to nothing. But where runs are to be differentiated
the motion itself can go beside the steps, in parts of these that are as short as contacts ask for,
each taken apart at touches and releases (`mid_step`). Derivatives are those of that motion, at its
places. How far the run has parted from it is known at every step: where that is too far the
derivative is not the run's, and nan (`trust.beside`).

The motion is a derivative of zeros, which a loop carries: so none of it is in a program of which no
derivative is asked.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxclear.formulations.compliant import CompliantContact
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar
from jaxclear.ground.tangents import derived, moved, pushed
from jaxclear.integrators import saltation
from jaxclear.integrators.deepest import deepest as deeper_of
from jaxclear.integrators.mid_step import Now, gone_on, judged, moves, taken_apart
from jaxclear.integrators.trust import GROWTH, LOST
from jaxclear.multibody.reach import gaps_passed

# A part of a step goes no further than by this angle of a contact's vibration [rad], and in it
# friction brakes no more than this share of a slip.
ANGLE, BRAKED = 0.02, 0.2
# A step has no more parts.
MOST_PARTS = 64.0


class Beside(NamedTuple):
    """Zeros. Their derivatives are, of the motion beside a run: the `growth` of derivatives
    (`trust`), how far its state is `away` from the run's, how far its places have `parted` from
    these at most [1] of the narrowest gap, and the `deepest` indentation of each contact [m]."""

    growth: Array
    away: Array
    parted: Scalar
    deepest: Array


def nothing_beside(size: int, contacts: int) -> Beside:
    """Where a run begins, of which the state has this size."""
    return Beside(jnp.zeros(GROWTH), jnp.zeros(size), jnp.zeros(()), jnp.zeros(contacts))


def beside_steps(formulation: CompliantContact, rest: Any, plain: Callable) -> Callable:
    """A step with the derivative of the motion beside it, as a function of (arrays, clock, state,
    last, met, beside).

    `plain(arrays, clock, y, last, met)`: the state at its end, what it leaves to the next, and (the
    largest rise of each indentation in a step, the largest indentation) until then. `arrays`: of
    the model, and of all else; `clock`: its start and length [s]; `rest`: of the model."""
    motion = saltation.motion_of(formulation, rest)

    def remember(arrays, y, contacts, length):
        """Contacts that are apart forget their impact speeds; those that begin closed have one."""
        if not formulation.remembers(rest):
            return y
        model = eqx.combine(arrays, rest)
        return formulation.remember(model, y, contacts, contacts, length)

    def step(arrays, clock, y, last, met, beside):
        end, *found = plain(arrays, clock, y, last, met)
        return end, *found, jax.tree.map(functools.partial(_zeros, end[0]), beside)

    @jax.custom_jvp
    def known(*numbers):
        return step(*numbers)

    def moving(numbers, tangents):
        arrays, clock, y, *_ = numbers
        way, clock_way, state, _, met_way, beside = tangents
        found = step(*numbers)
        end, now, (rise, _), _ = found
        beside, met_way = Beside(*map(moved, beside)), jax.tree.map(moved, met_way)
        longer = moved(clock_way[1]) if moves(clock_way) else None
        ways = way[0], (clock_way[0], longer), moved(state)
        begun = y + beside.away
        ended = _parted(motion, remember, (arrays[0], clock, begun), ways, met_way[1], beside)
        there, gone, deeper, beside = ended
        away = there - end
        share = gaps_passed(eqx.combine(arrays[0], rest).system, away)
        beside = beside._replace(away=away, parted=jnp.maximum(beside.parted, share))
        still = jax.tree.map(jnp.zeros_like, (now, rise))
        return found, (gone, still[0], (still[1], deeper), beside)

    known.defjvp(moving, symbolic_zeros=True)
    return known


def _zeros(number: Any, like: Array) -> Array:
    """Zeros that move with a number (`moving_with`), as a compiler sees too: they cost nothing."""
    never = (number > 0) & (number < 0)
    return jnp.broadcast_to(jnp.where(never, number, 0.0), like.shape)


def so_far(beside: Beside) -> Beside:
    """What is known where a saving interval begins, in which no indentation is the deepest yet."""
    zeros = lambda beside: jax.tree.map(lambda each: _zeros(each, each), beside)
    same = lambda numbers, tangents: jax.tree.map(moved, tangents[0])
    known = derived(zeros, same)(beside)
    return known._replace(deepest=jnp.zeros_like(known.deepest))


def _parted(
    motion: Any, remember: Callable, here: tuple, ways: tuple, deeper: Any, beside: Beside
) -> tuple:
    """(state, its derivative, that of the largest indentations, what is known) behind a step from
    `here` (arrays, clock, state), in parts."""
    arrays, (time, whole), y = here
    way, (time_way, longer), state = ways
    count, lost = _parts(motion, *here)
    h = whole / count

    def turn(carry):
        i, y, state, growth, deepest = carry
        at, times = time + i * h, (jnp.zeros(()), None)
        if longer is not None:
            times = moved(time_way) + i / count * longer, longer / count
        contacts = motion.contacts(arrays, at, y)
        y = remember(arrays, y, contacts, h)
        begun = Now(arrays, at, y, h, contacts)
        end = gone_on(motion, arrays, None, at, h, y)
        apart = taken_apart(motion, begun, end, (way, times, state), growth, always=True)
        growth = judged(motion, begun, jnp.ones(()), apart, apart.end)
        later = times[0] if longer is None else times[0] + times[1]
        ends = (at, y), (at + h, apart.end)
        motions = begun.contacts, motion.contacts(arrays, *ends[1])
        larger = lambda arrays, *now: deeper_of(motion.contacts, arrays, now[:2], motions, now[2])
        ways = way, (times[0], state), (later, apart.way), deepest[1]
        deepest = pushed(larger, (arrays, *ends, deepest[0]), ways)
        return i + 1, apart.end, apart.way, growth, deepest

    first = jnp.zeros((), int), y, state, beside.growth, (beside.deepest, deeper)
    found = jax.lax.while_loop(lambda carry: carry[0] < count, turn, first)
    _, y, state, growth, (deepest, deeper) = found
    growth = growth.at[LOST].set(jnp.maximum(growth[LOST], lost))
    return y, state, deeper, beside._replace(growth=growth, deepest=deepest)


def _parts(motion: Any, arrays: Any, clock: tuple, y: Any) -> tuple[Any, Any]:
    """Into how many equal parts a step is divided, and 1 where as many as there may be do not
    follow the contacts, otherwise 0. They are looked at where the step begins and where it would
    end without them."""
    time, h = clock
    apart = jnp.zeros_like(motion.contacts(arrays, time, y).depths)
    ahead = y + h * motion.rates(arrays, apart, time, y)
    n, m = motion.layout.coordinates, motion.layout.memory_start
    entries = np.arange(motion.layout.size)
    places, moves = entries < n, (entries >= n) & (entries < m)

    def pace(carry):
        i, (time, y), fastest = carry
        acting = saltation.closed(motion.contacts(arrays, time, y))
        pushes = jax.jvp(lambda own: motion.rates(arrays, own, time, y), (apart,), (acting,))[1]
        along = lambda way: jax.jvp(lambda y: motion.rates(arrays, acting, time, y), (y,), (way,))
        resisted = along(jnp.where(moves, pushes, 0.0))[1]
        returned = along(jnp.where(places, resisted, 0.0))[1]
        size = lambda way: safe_sqrt(jnp.sum(jnp.where(moves, way * way, 0.0)))
        damped = safe_divide(size(resisted), size(pushes))
        vibrating = safe_sqrt(safe_divide(size(returned), size(pushes)))
        wanted = jnp.maximum(vibrating / ANGLE, damped / BRAKED)
        pace = jnp.stack([wanted, jnp.maximum(vibrating, 0.5 * damped)])
        return i + 1, (time + h, ahead), jnp.maximum(fastest, pace)

    ends = (time, y), (time + h, ahead)
    near = jnp.max(jnp.stack([motion.contacts(arrays, *now).depths for now in ends])) >= 0
    first = jnp.zeros((), int), ends[0], jnp.zeros(2)
    looks = jnp.where(near, len(ends), 0)
    fastest = jax.lax.while_loop(lambda carry: carry[0] < looks, pace, first)[2]
    parts = jnp.clip(jnp.ceil(h * fastest[0]), 1.0, MOST_PARTS)
    return parts, jnp.where(h * fastest[1] > parts, 1.0, 0.0)
