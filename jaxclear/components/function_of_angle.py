"""What a cam and a gear's error ask of a function of an angle: it takes an angle [rad], traced by
JAX, returns one number, and repeats itself every turn. Looked at once, when the part is built.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.ground.quantity import is_traced
from jaxclear.ground.warning import call_user, shape_of
from jaxclear.ground.wording import described, public_name

TURN = 2 * np.pi
# Angles [rad] at which a turn further on is looked at, and by how much, beside how far the function
# goes, it may be off.
LOOKS, REPEATED = np.arange(12) * TURN / 12, 1e-6


def check_function_of_angle(part: Any, field: str) -> None:
    """Raises `ValueError` for a function in a field of a part that fails at an angle, returns other
    than one number, or is another a turn further on; None passes."""
    function = getattr(part, field)
    if function is None:
        return
    owner = f"{public_name(type(part))} has {field} = {described(function)}"
    rule = "it must take an angle [rad] and return one number, the same again after a turn"
    if not callable(function):
        raise ValueError(f"{owner}; {rule}.")
    answer = lambda at: call_user(f"{owner}, which", function, at, requirement=f"I{rule[1:]}.")
    value = shape_of(
        lambda at: jax.tree.map(jnp.asarray, answer(at)), jax.ShapeDtypeStruct((), jnp.float64)
    )
    if [leaf.shape for leaf in jax.tree.leaves(value)] != [()]:
        raise ValueError(f"{owner}, which returns something else; {rule}.")
    if is_traced(function):
        return
    turns = [np.asarray(jax.vmap(function)(jnp.asarray(LOOKS + k * TURN)), float) for k in (0, 1)]
    difference, size = np.abs(turns[1] - turns[0]), max(np.ptp(turns[0]), np.abs(turns[0]).max())
    if not np.all(np.isfinite(turns)):
        raise ValueError(f"{owner}, which is not finite everywhere; {rule}.")
    if difference.max() > REPEATED * size:
        place = int(np.argmax(difference))
        raise ValueError(
            f"{owner}, which is {turns[0][place]:.6g} at {LOOKS[place]:.4g} rad and "
            f"{turns[1][place]:.6g} a turn further on; {rule}."
        )


def value_and_slope(function: Any, angle: Any) -> tuple[Any, Any]:
    """What a function gives at an angle [rad], and its derivative."""
    angle = jnp.asarray(angle, float)
    number = lambda at: jnp.asarray(function(at), float)
    return jax.jvp(number, (angle,), (jnp.ones_like(angle),))
