"""Contacts of one joint that strike within a step: which of them is struck in it, and which wait.

Corners that strike one after the other, however soon, take another impact than two that strike at
once, in which each holds the body where the other would turn it. Steps that do not tell them apart
would be off by a third in what friction takes, and halving them would not show it.
"""

from typing import Any

import jax.numpy as jnp

from jaxclear.formulations.contact_rows import split
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide

# Share of a step by which contacts of a joint may touch apart and count as touching at once: far
# above rounding.
AT_ONCE = 1e-6


def put_off(strikes: Any, depths: Any, closing: Any, h: Any, joints: list[int]) -> Any:
    """Which of the contacts that strike in a step of length h [s] wait for the next: all of a joint
    but the first to touch.

    `depths`, `closing`: their indentations [m] and their rates [m/s] in the middle of the step;
    `joints`: how many contacts each joint has.
    """
    since = jnp.where(strikes, safe_divide(depths, closing), -jnp.inf)
    each = split([since[i] for i in range(sum(joints))], joints)
    first = [jnp.max(jnp.stack(own)) for own in each]
    firsts = [one for one, count in zip(first, joints, strict=True) for _ in range(count)]
    return strikes & (since < sp.stack(firsts) - AT_ONCE * h)
