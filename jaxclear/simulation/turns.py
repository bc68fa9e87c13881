"""One turn of a run's loop, from a saving time to the next or through a part of a window: what it
hands on, and what it leaves.

Worn surfaces enter the gap as they were at the last saving time, and are updated at every saving
time.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from jaxclear.formulations.model import Model, State
from jaxclear.integrators.base import AbstractIntegrator, Interval
from jaxclear.integrators.checks import Check
from jaxclear.integrators.events import Events
from jaxclear.integrators.outcome import Outcome
from jaxclear.multibody import closure_coordinates
from jaxclear.native import scan
from jaxclear.simulation import progress
from jaxclear.simulation.error_weights import error_weights
from jaxclear.simulation.spot_checks import Turns
from jaxclear.simulation.tally import Tally, figures_of_a_look, followed, peaks_so_far
from jaxclear.simulation.wear import (
    Losses,
    Worn,
    left_its_surface,
    losses,
    worn_at_once,
    worn_where_lost,
)


class Carry(NamedTuple):
    """What a run hands from turn to turn; `worn` are its worn surfaces (none where they are not to
    wear on), `read` these as gaps read them, `ended` [s] is the last saving time that it reached,
    `steps` those accepted and rejected so far."""

    state: State
    worn: Worn
    read: Worn
    warm_start: Any
    outcome: Int[Array, ""]
    ended: Float[Array, ""]
    steps: tuple[Int[Array, ""], Int[Array, ""]]
    tally: Tally


class Left(NamedTuple):
    """What a turn leaves, and what is left of all: states and worn surfaces as its gaps saw them,
    its events, and the figures that go with a look at its end (these two packed)."""

    saved: tuple[State, Worn]
    noted: Array
    figures: Array


def turns_of(
    model: Model,
    integrator: AbstractIntegrator,
    report: bool,
    begun: tuple[State, Worn, Any],
    whole: bool,
) -> tuple[Callable, dict[Check, Any], Callable]:
    """(a turn as it stands in the loop, traced once however often it stands there; the shapes of
    its figures; how what turns have left is unpacked, known once it has been traced), of a run that
    has `begun` with a state, worn surfaces and a warm start. `whole`: all of it is one kernel, and
    surfaces are worn between turns."""
    arrays, rest = eqx.partition((model, integrator), eqx.is_array)
    unpack: list[Callable] = []

    @jax.jit
    def advance(arrays, read, ahead, state, warm_start):
        model, integrator = eqx.combine(arrays, rest)
        return integrator.advance(dataclasses.replace(model, worn=read), ahead, state, warm_start)

    @jax.jit
    def one(arrays, start, now, turn):
        model = eqx.combine(arrays, rest)[0]

        def motion(now, read):
            going = functools.partial(advance, arrays, read)
            now, lost, found = _motion(model, going, start, now, turn)
            # A loop of XLA pays for every array that its turns leave.
            packed, unpacked = zip(*map(_packed, found), strict=True)
            unpack.append(unpacked)
            return now, (lost, *packed)

        if whole:
            now, (_, *packed) = motion(now, now.read)
            return now, Left((now.state, now.read), *packed)
        return _and_worn(model, motion, now, integrator.steps_between_saves is not None)

    def turn(now, span):
        if report:
            jax.debug.callback(progress.advance, span.progress)
        return one(arrays, state, now, span)

    def apart(left):
        parts = zip(unpack[0], (left.noted, left.figures), strict=True)
        return [jax.vmap(own)(packed) for own, packed in parts]

    number, how = jnp.zeros(()), (error_weights(model), jnp.ones((), bool))
    ahead = Interval(number, number, *how, number, peaks_so_far({}, model))
    state, read, warm_start = begun
    done = jax.eval_shape(advance, arrays, read, ahead, state, warm_start)
    return turn, done.figures or {}, apart


def _packed(found: Any) -> tuple[Array, Callable]:
    some = bool(jax.tree.leaves(found))
    return ravel_pytree(found) if some else (jnp.zeros(0), lambda _: found)


def _and_worn(model: Model, motion: Callable, now: Carry, counted: bool) -> tuple[Carry, Left]:
    """A turn's `motion`, and behind it surfaces worn by XLA; of a `counted` number of steps."""
    worn, read = now.worn, now.read
    through = _as_a_kernel if read and not counted else _as_it_is
    now, (lost, *packed) = through(motion, now._replace(worn={}, read={}), read)
    after = read
    if worn:
        wear = worn_at_once if counted else worn_where_lost
        worn, after = wear(model.system, worn, read, lost)
    return now._replace(worn=worn, read=after), Left((now.state, read), *packed)


def _as_it_is(motion: Callable, now: Carry, read: Any) -> tuple:
    return motion(now, read)


def _as_a_kernel(motion: Callable, now: Carry, read: Any) -> tuple:
    """A turn's motion as a kernel of its own, between whose calls surfaces wear: XLA would start
    each of its operations on a few numbers by itself."""
    now, left = scan(lambda now, _: motion(now, read), now, np.zeros(1))
    return now, jax.tree.map(lambda each: each[0], left)


def _motion(
    model: Model, advance: Callable, start: State, now: Carry, turn: Turns
) -> tuple[Carry, Losses, tuple[Events | None, dict[Check, Array]]]:
    """One turn of the loop of a run that began with the state `start`, but for its worn surfaces:
    what it hands on, what these lose, and what it leaves."""
    running = (now.outcome == Outcome.REACHED).astype(bool)
    peaks = peaks_so_far(now.tally.worst, model)
    ahead = Interval(turn.start, turn.stop, error_weights(model), running, turn.share, peaks)
    result = advance(ahead, now.state, now.warm_start)
    sound = jnp.all(jnp.isfinite(result.state))
    reached = closure_coordinates.anchored(model.system, model.layout, turn.stop, result.state)
    state = jnp.where(running & sound, reached, now.state)
    lost = losses(model.layout, now.state, state)
    # What is not held to a tolerance (worn volumes, energies) can be lost while the steps still
    # succeed.
    failed = ~sound & (result.outcome == Outcome.REACHED)
    found = jnp.where(failed, Outcome.NOT_FINITE, result.outcome)
    gone = left_its_surface(model.system, model.layout, result.state)
    if gone is not False:
        found = jnp.where(gone, Outcome.OFF_THE_WALLS, found)
    outcome = jnp.where(running, found, now.outcome)
    # Of a shadow, by which the run does not get on, nothing counts.
    own = running & (turn.progress > 0)
    ended = jnp.where(own & (outcome == Outcome.REACHED), turn.stop, now.ended)
    taken = jax.tree.map(
        lambda before, more: before + jnp.where(own, more, 0),
        now.steps,
        (result.accepted, result.rejected),
    )
    figures, path = result.figures or {}, (start, now.state, state)
    tally = followed(now.tally, model.layout, figures, own, turn.stop, path)
    after = Carry(state, now.worn, now.read, result.warm_start, outcome, ended, taken, tally)
    return after, lost, (result.events, figures_of_a_look(figures, running))
