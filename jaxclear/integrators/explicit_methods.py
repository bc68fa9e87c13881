"""The explicit methods of `FixedStep`, and which contacts ask for its short steps."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.formulations.impact_speed import has_bristles, put_right
from jaxclear.formulations.model import Model
from jaxclear.integrators import munthe_kaas
from jaxclear.integrators.state_group import state_group
from jaxclear.integrators.stepping import SLIVER

# Explicit Runge-Kutta methods in which each stage starts from the slope of the one before: (nodes,
# weights).
CHAINS: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "euler": ((0.0,), (1.0,)),
    "semi_implicit": ((0.0,), (1.0,)),
    "heun": ((0.0, 1.0), (0.5, 0.5)),
    "rk4": ((0.0, 0.5, 0.5, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)),
}
# Methods on the group of the coordinates, by their order.
ON_GROUPS = {f"munthe_kaas{order}": order for order in munthe_kaas.TABLEAUS}
ORDERS = {"euler": 1, "semi_implicit": 1, "heun": 2, "rk4": 4} | ON_GROUPS


def near_contacts(contacts: Any, last: Any, longest: Any) -> Any:
    """Whether each contact is closed, has parted within the last step, or would close within the
    `longest` [s]: by its closing speed, and by how that has grown since the last step began (a load
    ends a short flight however slowly it begins)."""
    coming = jnp.maximum(contacts.rates, 0.0) * longest
    near = (contacts.depths >= 0) | (contacts.depths + coming > 0)
    if last is None:
        return near
    before, length = last
    growth = jnp.maximum(contacts.rates - before.rates, 0.0) / length
    falling = contacts.depths + (contacts.rates + 0.5 * growth * longest) * longest
    return near | (before.depths >= 0) | (falling > 0)


def chosen_length(longest: Any, rest: tuple | None) -> Callable[[Any, Any], Any]:
    """How the length [s] of a step follows from contacts; `rest`: what is left of the time and the
    shortest step, which it is where a contact is near. None: all are the longest."""

    def length(contacts, last):
        if rest is None:
            return longest
        left, shortest = rest
        near = jnp.any(near_contacts(contacts, last, longest))
        h = jnp.where(near, shortest, longest)
        return jnp.where(h > left * (1 - SLIVER), left, h)

    return length


def explicit_step(
    formulation: Any, method: str, model: Model, clock: tuple, y: Any, last: Any
) -> tuple:
    """The length and the end of a step, and what it leaves to the next. `clock`: its start and the
    longest length [s], and of what `chosen_length` chooses it by the contacts at its start and what
    the last step left. Stages behind the first are a loop: however many, the equations stand in the
    program twice, and what only the first decides is not worked out in the others."""
    time, h, rest = clock
    length = chosen_length(h, rest)
    if method in ON_GROUPS:
        looks = last is not None or rest is not None
        return _step_on_group(
            formulation, method, model, (time, h, length if looks else None), y, last
        )
    h, y, slope, last = _first_stage(formulation, method, model, (time, length), y, last)
    nodes, weights = (jnp.asarray(part) for part in CHAINS[method])
    end = y + (h * weights[0]) * slope
    if method == "semi_implicit":
        end = _kicked(formulation, model, (time, h), y, end)

    def further(carry, stage):
        end, slope = carry
        node = nodes[stage] * h
        slope = formulation.rate(model, time + node, y + node * slope)[0]
        return (end + (h * weights[stage]) * slope, slope), None

    stages = np.arange(1, len(CHAINS[method][0]))
    if len(stages):
        end = jax.lax.scan(further, (end, slope), stages)[0][0]
    return h, end, last


def _first_stage(
    formulation: Any, method: str, model: Model, clock: tuple, y: Any, last: Any
) -> tuple:
    """The length [s] of a step that begins at a time, by the contacts there; the state with the
    impact speeds of contacts that have closed in the last one, and with deflections of bristles for
    their time in contact; its rate; what is left to the next step."""
    time, length = clock
    slope, contacts = formulation.rate(model, time, y)
    h = length(contacts, last)
    if last is None:
        return h, y, slope, None
    y = _taken_up(formulation, model, (time, y), (last[0], contacts), (last[1], CHAINS[method]))
    return h, y, slope, (contacts, h)


def _taken_up(formulation: Any, model: Model, now: tuple, motions: tuple, step: tuple) -> Any:
    """The state at a time with the impact speeds of contacts that have closed in the last step, and
    with deflections of bristles for their time in contact. `motions`: the contacts at both its
    ends; `step`: its length [s], and (nodes, weights) of its stages."""
    time, y = now
    if formulation.remembers(model):
        y = formulation.remember(model, y, *motions, step[0])
    if has_bristles(model):
        y = put_right(formulation, model, (time, y), motions, step)
    return y


def _kicked(formulation: Any, model: Model, clock: tuple, y: Any, end: Any) -> Any:
    """The end of a semi-implicit step, whose places move by the speeds at its end."""
    h, n = clock[1], model.layout.coordinates
    rates = formulation.coordinate_rates(model, jnp.concatenate([y[:n], end[n:]]))
    return _with_energies(
        formulation, model, clock, y, jnp.concatenate([y[:n] + h * rates, end[n:]])
    )


def _with_energies(formulation: Any, model: Model, clock: tuple, y: Any, after: Any) -> Any:
    """The energies of the balance after a semi-implicit step, where they are asked for."""
    layout = model.layout
    if not layout.energies:
        return after
    n, m, first = layout.coordinates, layout.memory_start, layout.energy_start + 1
    powers = formulation.energy_rates(model, clock[0], y, 0.5 * (y[n:m] + after[n:m]))
    return jnp.concatenate([after[:first], y[first:] + clock[1] * powers])


def _step_on_group(
    formulation: Any, method: str, model: Model, clock: tuple, y: Any, last: Any
) -> tuple:
    """As `explicit_step`; the contacts are looked at beforehand, where something depends on
    them."""
    time, h, length = clock
    if length is not None:
        contacts = formulation.contacts(model, time, y)
        h = length(contacts, last)
        if last is not None:
            stages = munthe_kaas.stages(ON_GROUPS[method])
            y = _taken_up(formulation, model, (time, y), (last[0], contacts), (last[1], stages))
            last = contacts, h

    def rate(time, y):
        return formulation.rate(model, time, y)[0]

    return h, munthe_kaas.fixed_step(state_group(model), rate, ON_GROUPS[method], time, h, y), last
