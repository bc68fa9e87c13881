"""The explicit methods of `FixedStep`, and which contacts ask for its short steps."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

from jaxclear.integrators import munthe_kaas
from jaxclear.integrators.stepping import SLIVER
from jaxclear.integrators.vibration import FOLLOWED, SYMMETRIC

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
# Rate of damping times the step up to which a method is stable, by its order: where |1 + z + ... +
# z^p / p!| passes 1 on the negative axis.
STABLE_DAMPING = {1: 2.0, 2: 2.0, 3: 2.513, 4: 2.785}
ORDERS = {"euler": 1, "semi_implicit": 1, "heun": 2, "rk4": 4} | ON_GROUPS
# Angle of a vibration up to which a method follows it in a step [rad] (`vibration`).
ANGLES = {name: FOLLOWED[order] for name, order in ORDERS.items()} | {"semi_implicit": SYMMETRIC}


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
