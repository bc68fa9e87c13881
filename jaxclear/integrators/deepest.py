"""The deepest indentation of every contact in a run, as its steps follow it, and its derivative.

Steps know the contacts at both their ends, and the deepest of these is kept. The derivative is that
of the deepest point of the path: there the rate is 0, so that it does not hang on when that is, and
of the end of a step it would be off by the step's length times that of the rate. Between the ends
of the step in which a contact turns, derivatives follow Hermite's cubic, as the indentation does.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxclear.formulations.impact_speed import ContactMotion, bends, cubic, summit
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.quantity import constant
from jaxclear.ground.tangents import derived, moved, moving_with, pushed, where_wanted


def deepest(
    contacts: Callable, arrays: Any, ends: tuple, motions: tuple[Any, Any], known: Any
) -> Any:
    """The largest indentations [m] after a step, `known` until its start. `contacts(arrays, time,
    state)`: their motion; `ends`: (time [s], state) at the start and at the end; `motions`: those
    of the contacts there, whose own derivatives do not count."""

    def larger(arrays, start, end, motions, known):
        return moving_with(end[1][0], jnp.maximum(motions[1].depths, known))

    def moving(numbers, tangents):
        arrays, start, end, (before, after), known = numbers
        way, *ways, _, so_far = tangents
        # A contact that turns here has been deepest before, at the end of this step or nowhere.
        turns = (before.rates > 0) & (after.rates <= 0)
        turns = turns & (jnp.maximum(before.depths, after.depths) >= known)
        deeper = turns | (after.depths > known)

        def ahead(so_far):
            times = start[0], end[0]
            length = times[1] - times[0]
            scaled = lambda motion: length * motion.rates
            path = before.depths, after.depths, scaled(before), scaled(after)
            found = [
                pushed(contacts, (arrays, *point), (way, *each))[1]
                for point, each in zip((start, end), ways, strict=True)
            ]
            moves = [moved(each[0]) for each in ways]
            found = _at_fixed_times(found, (before, after), moves, bends(path), length)
            share = jnp.where(turns, summit(path), 1.0)
            moves = *(each.depths for each in found), *map(scaled, found)
            return jnp.where(deeper, cubic(moves, share)[0], so_far)

        return where_wanted(jnp.any(deeper), ahead, moved(so_far))

    return derived(larger, moving)(arrays, *ends, motions, known)


def largest(known: Any, before: ContactMotion, after: ContactMotion, length: Any) -> Any:
    """The same where the motion of the contacts at both ends of a step of this length [s] has
    derivatives of its own."""

    def moving(numbers, tangents):
        (known, before, after, length), ways = numbers, jax.tree.map(moved, tuple(tangents))
        turns = (before.rates > 0) & (after.rates <= 0)
        turns = turns & (jnp.maximum(before.depths, after.depths) >= known)
        path, moves = (
            (one.depths, other.depths, length * one.rates, length * other.rates)
            for one, other in ((before, after), ways[1:3])
        )
        share = jnp.where(turns, summit(path), 1.0)
        return jnp.where(turns | (after.depths > known), cubic(moves, share)[0], ways[0])

    deeper = lambda known, _, after, __: jnp.where(after.depths > known, after.depths, known)
    return derived(deeper, moving)(known, before, after, constant(length))


def _at_fixed_times(found: list, motions: Any, moves: Any, bent: Any, length: Any) -> list:
    """Derivatives of contacts at instants that do not move, from those at ends of a step that
    `moves` tell of."""
    gains = [safe_divide(each, length * length) for each in bent]
    return [
        ContactMotion(own.depths - move * now.rates, own.rates - move * gain)
        for own, now, move, gain in zip(found, motions, moves, gains, strict=True)
    ]
