"""When a derivative through impacts is to be trusted, and a nan that says why where it is not.

A loop carries zeros beside the state, whose derivatives tell how much touches move: impacts make
derivatives grow, and with them what errors of the motion make of them.
None of this is in a program of which no derivative is asked.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxclear.ground.outcome import Unknown
from jaxclear.ground.quantity import Scalar, constant
from jaxclear.ground.tangents import derived, moved

# What a second derivative through contacts is told.
NO_SECOND = (
    "a second derivative through contacts that open and close is not known: take differences of "
    "first derivatives (jax.jvp, jax.jacfwd, jax.grad)."
)
# Beside a run the motion is differentiated as long as its places are no farther from the run's than
# this share of the narrowest gap: contacts are then pressed in the same directions.
PARTED = 0.03
# So many numbers tell how derivatives through impacts of rigid contact go: how many impacts moved,
# by how much [s] the first few of them and all of them did at most, whether one has none, to which
# share of the gap a place was off at most, to which share of the fastest impact approach speeds
# were, in all, and that [m/s].
IMPACT_FIGURES = 7
# Derivatives through impacts of rigid contact have grown too much where these shares, times their
# growth, are beyond this. Slopes whose parts nearly cancel are off by more of themselves, which
# slopes in other steps tell (`simulation.derivatives`): with this and that none of 3672 told in
# steps of 1 to 20 us, of 25 mechanisms, was off by a fiftieth; without that 184 of 4306 were.
TRUSTED_IMPACTS = 1e-2


def trusted(result: Any, growth: Array, limit: Scalar) -> Any:
    """The result of a run, with a derivative that is nan where touches move too much.

    Args:
        result: pytree of arrays.
        growth: zeros, whose derivatives are the number of touches that moved, and by how much
            [s] the
            first few and all of them did at most.
        limit: largest ratio of the last two that is trusted [1].
    """

    grown = lambda growth, limit: growth[2] <= limit * growth[1]
    return _where(grown, Unknown.GROWN, result, growth, limit)


def trusted_impacts(result: Any, growth: Array) -> Any:
    """What was found of a run; its derivative is nan where errors of the motion, grown as impacts
    make them grow, decide it, and where an impact is not known to have one."""

    def fine(growth):
        _, first, most, _, place, speeds, _ = [growth[i] for i in range(IMPACT_FIGURES)]
        return (place + speeds) * most <= TRUSTED_IMPACTS * first

    result = _where(fine, Unknown.GROWN, result, growth)
    return _where(lambda growth: growth[3] <= 0, Unknown.AT_ONCE, result, growth)


def while_together(result: Any, parted: Scalar) -> Any:
    """What was found of a run; its derivative is nan where the motion of which it is the derivative
    has `parted` from the run itself by too large a share of the gap."""
    return _where(lambda parted: parted <= PARTED, Unknown.PARTED, result, parted)


def _where(fine: Callable, why: Unknown, result: Any, growth: Array, *numbers: Scalar) -> Any:
    """What was found; its derivative is nan, and says why, but where `fine(derivative of growth,
    *numbers)`."""

    def judged(numbers, tangents):
        (_, _, *numbers), (d_result, growth, *_) = numbers, tangents
        trusted = fine(moved(growth), *numbers)
        return jax.tree.map(lambda each: jnp.where(trusted, moved(each), why.number), d_result)

    return derived(lambda result, *_: result, judged)(result, growth, *map(constant, numbers))


def without_derivative(numbers: Any) -> Any:
    """The numbers; their derivative is nan wherever it is asked for."""
    unknown = lambda tangent: jnp.full_like(moved(tangent), Unknown.NOT_FOLLOWED.number)
    rule = lambda numbers, tangents: jax.tree.map(unknown, tangents[0])
    return derived(lambda numbers: numbers, rule)(numbers)
