"""Where the rare parts lie that decide a limit: the worst point at their distance from the middle.

Found by the fixed point of the reliability index, in standard normal numbers, from the steepest
slope on; good enough to draw about, because weights make up for what it misses.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy

from jaxclear.studies.design.model import AbstractModel
from jaxclear.studies.design.question import Question

# Shares above this are seen often enough without.
OFTEN = 0.02
STEPS = 12
# Points closer than this share of their distance are one.
SAME = 0.3


def rare_regions(
    question: Question, place: np.ndarray, model: AbstractModel
) -> tuple[np.ndarray, ...]:
    """Centres (variables,) of the rare regions of all limits; none where nothing rare decides."""
    found: list[np.ndarray] = []
    for number, limit in enumerate(question.limits):
        share = limit.rarest()
        if share >= OFTEN:
            continue
        distance = float(-scipy.stats.norm.ppf(share))
        for side in range(len(limit.sides(jnp.zeros(())))):
            centre = np.asarray(
                _worst(question, (number, side), model, jnp.asarray(place), jnp.asarray(distance))
            )
            new = all(np.linalg.norm(centre - c) > SAME * distance for c in found)
            if new and np.all(np.isfinite(centre)):
                found.append(centre)
    return tuple(found)


@eqx.filter_jit
def _worst(
    question: Question,
    which: tuple[int, int],
    model: AbstractModel,
    place: Any,
    distance: float | Any,
) -> Any:
    """The point at this distance where a limit (its number and side) is nearest to breaking."""
    limit = question.limits[which[0]]

    def bad(normal):
        return limit.sides(question.one(limit, question.values(place, normal), model))[which[1]]

    def outward(slope):
        length = jnp.linalg.norm(slope)
        return distance * slope / jnp.where(length > 0, length, 1.0)

    slope = jax.grad(bad)
    start = outward(slope(jnp.zeros(len(question.freedom.names))))
    return jax.lax.fori_loop(0, STEPS, lambda i, point: outward(slope(point)), start)
