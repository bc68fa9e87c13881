"""What a run follows of itself from turn to turn, so that nobody goes through all that was saved
once more: the worst of its figures, and how far it has gone.

A turn's figures are known at its end. Most are told by the worst that was met; those that say what
a saved state is judged by are kept for the states that are looked at.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxclear.formulations.model import Model, State
from jaxclear.ground.quantity import Scalar
from jaxclear.integrators.checks import Check
from jaxclear.integrators.peaks import Peaks, newest
from jaxclear.multibody.state import Layout

Figures = dict[Check, Float[Array, " places"]]
# Lengths of steps [s]: of each saved state that is looked at those of the interval before it.
LENGTHS = (Check.FRICTION_STEP, Check.CREEP_STEP, Check.DAMPER_STEP)
LOOKED_AT = (*LENGTHS, Check.INDENTATION)
# What has derivatives: peaks of forces follow from these.
PEAKS = (Check.INDENTATION, Check.LARGEST_FORCE)


class Compared(NamedTuple):
    """Of a state what windows compare, no more: every turn of a run pays for what is followed.
    Speeds, impulses of contacts (none where forces are means), volumes that are worn off."""

    speeds: Array
    impulses: Array
    volumes: Array


class Tally(NamedTuple):
    """The `worst` of each figure at its places, and `when` [s] the first saving interval with it
    ended; by how much what windows compare has changed from one saving time to the next, all taken
    together (`way`), and how far each coordinate has been from its start (`reach`); the `squares`
    of the speeds at the saving times, added up. None: nobody asks."""

    worst: Figures
    when: Figures
    way: Compared | None
    reach: Float[Array, " coordinates"]
    squares: Float[Array, " speeds"] | None


def compared(layout: Layout, states: Float[Array, "*times n"], impulses: bool = True) -> Compared:
    """What windows compare of such states, with impulses or without."""
    first = layout.impulse_start if impulses else layout.energy_start
    volumes = [states[..., slot.start] for slot in layout.wear]
    return Compared(
        states[..., _speeds(layout)],
        states[..., first : layout.energy_start],
        jnp.stack(volumes, axis=-1) if volumes else states[..., :0],
    )


def nothing_yet(
    shapes: dict[Check, Any], model: Model, state: State, windows: int, means: bool
) -> Tally:
    """Before the first turn, of a run that begins with a state and has so many windows; `shapes`
    are those of its figures; whether forces are `means`."""
    layout = model.layout
    worst = {
        check: jnp.full(each.shape, -jnp.inf)
        for check, each in shapes.items()
        if check not in LENGTHS
    }
    speeds = jax.lax.stop_gradient(state[_speeds(layout)])
    return Tally(
        worst,
        {check: jnp.zeros_like(each) for check, each in worst.items()},
        jax.tree.map(jnp.zeros_like, compared(layout, state, not means)) if windows else None,
        jnp.zeros(layout.coordinates),
        speeds**2 if windows and not model.system.bearings else None,
    )


def followed(
    tally: Tally,
    layout: Layout,
    figures: Figures,
    counts: Bool[Array, ""],
    stop: Scalar,
    states: tuple[State, State, State],
) -> Tally:
    """After a turn that ends at a time [s] with these figures; `states`: those with which the run
    and the turn began, and that at the turn's end. What is no number is worse than any number.
    Whether the turn `counts`: a shadow, and a turn of a run that has ended before, tell nothing. Of
    all that only the `PEAKS` have derivatives, which know what came before."""
    start, before, after = jax.lax.stop_gradient(states)
    worst, when = {}, {}
    for check, known in tally.worst.items():
        each = jax.lax.stop_gradient(figures[check])
        worse = ~(each <= known) & ~jnp.isnan(known) & counts
        if check in PEAKS:
            worst[check] = newest(known, figures[check], counts & ~jnp.isnan(known))
        else:
            worst[check] = jnp.where(worse, each, known)
        when[check] = jnp.where(worse, stop, tally.when[check])
    count, squares = layout.coordinates, tally.squares
    told = lambda numbers: jnp.where(counts, numbers, 0.0)
    return Tally(
        worst,
        when,
        None if tally.way is None else _further(tally.way, layout, after - before, told),
        jnp.maximum(tally.reach, told(abs(after[:count] - start[:count]))),
        None if squares is None else squares + told(after[_speeds(layout)] ** 2),
    )


def peaks_so_far(worst: Figures, model: Model) -> Peaks | None:
    """The largest indentation and force so far of each contact, of these figures."""
    none = jnp.full(model.layout.contacts, -jnp.inf)
    return Peaks(*(worst.get(check, none) for check in PEAKS)) if none.size else None


def _further(way: Compared, layout: Layout, change: State, told: Callable) -> Compared:
    """The way after one more change of the state, of which so much is `told`."""
    changes = compared(layout, change, way.impulses.size > 0)
    return jax.tree.map(lambda known, each: known + told(abs(each)), way, changes)


def figures_of_a_look(figures: Figures, running: Bool[Array, ""]) -> Figures:
    """Those of a turn's figures that go with a look at its end."""
    kept = {check: figures[check] for check in LOOKED_AT if check in figures}
    return jax.lax.stop_gradient(
        {check: jnp.where(running, each, 0.0) for check, each in kept.items()}
    )


def _speeds(layout: Layout) -> slice:
    return slice(layout.coordinates, layout.memory_start)
