"""Touches and releases of contacts, noted as a run steps over them: instants of the run, not of its
saving times.

A contact touches where its indentation rises through 0 and is released where it falls through it.
Between the ends of a step the indentation follows Hermite's cubic through the depths and rates
there. So many events of each contact as are asked for are kept between two saving times; all are
counted.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.formulations.compliant import CompliantContact
from jaxclear.formulations.impact_speed import ContactMotion, cubic, passage, passed
from jaxclear.formulations.model import Model, State
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.quantity import constant


class Events(NamedTuple):
    """Events of each contact in a saving interval: `times` [s], `rates` of the indentation there
    [m/s] (positive: touch), and how many there were, kept or not."""

    times: Float[Array, "*intervals contacts most"]
    rates: Float[Array, "*intervals contacts most"]
    counts: Float[Array, "*intervals contacts"]


class Watch(NamedTuple):
    """How the contacts moved at the end of the last step, and the events until then."""

    motion: ContactMotion
    events: Events


def watch_from(model: Model, time: Any, state: State) -> Watch | None:
    """The watch at the start of a saving interval; None where no events are asked for."""
    if not model.events:
        return None
    motion = contact_motion(model, time, state)
    return Watch(motion, nothing(motion, model.events))


def nothing(motion: ContactMotion, most: int) -> Events:
    """No events yet."""
    none = jnp.zeros_like(motion.depths)
    blank = jnp.zeros((len(none), most))
    return Events(blank, blank, none)


def contact_motion(model: Model, time: Any, state: State) -> ContactMotion:
    """How contacts move."""
    return CompliantContact().contacts(model, time, state)


def watched(watch: Watch | None, model: Model, time: Any, length: Any, after: State) -> Any:
    """The watch after a step from a `time` [s] of a `length` [s]."""
    if watch is None:
        return None
    motion = contact_motion(model, time + length, after)
    return Watch(motion, noted(watch.events, time, length, watch.motion, motion))


def noted(
    events: Events, time: Any, length: Any, before: ContactMotion, after: ContactMotion
) -> Events:
    """The events, and those of a step from a `time` [s] of a `length` [s]."""
    closed = before.depths >= 0
    happened = closed != (after.depths >= 0)
    path = (before.depths, after.depths, length * before.rates, length * after.rates)

    share = passed(path, passage(constant(path), 0.0, jnp.ones_like(before.depths)))
    rate = safe_divide(cubic(path, share)[1], length)
    places = jnp.arange(events.times.shape[1], dtype=float)
    here = (places == events.counts[:, None]) & happened[:, None]
    return Events(
        jnp.where(here, (time + share * length)[:, None], events.times),
        jnp.where(here, rate[:, None], events.rates),
        events.counts + jnp.where(happened, 1.0, 0.0),
    )


def together(before: Events, more: Events) -> Events:
    """The events of two parts of a saving interval, of each contact the first ones."""
    places = jnp.arange(before.times.shape[1], dtype=float)
    behind = places - before.counts[:, None]
    moved = behind[:, :, None] == places

    def both(old: Array, new: Array) -> Array:
        found = jnp.sum(jnp.where(moved, new[:, None, :], 0.0), axis=2)
        return jnp.where(behind >= 0, found, old)

    times, rates = both(before.times, more.times), both(before.rates, more.rates)
    return Events(times, rates, before.counts + more.counts)
