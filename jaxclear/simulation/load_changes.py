"""When functions change, also where that is between any samples: every sign that a function of
arguments takes on its way to its value, every answer of a comparison and every whole number is
looked at, and where one changes between two samples, that is halved down to rounding.

A push from `t > a` to `t < b` is found however short it is; so is a bell about an instant, since
what is squared in it changes its sign there.
"""

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal

# What rounds to whole numbers that are not stored as such.
ROUNDED = ("floor", "ceil", "round", "sign")
# So many signs of a function are looked at; so many changes are located, by about so many looks at
# a time, and so many at most count.
MOST_SIGNS, MOST_LOCATED, POINTS, MOST_CHANGES = 256, 2**10, 2**13, 64
# Around an instant of change a function is looked at this often on each side, each time at half the
# distance.
HALVINGS = 24
# A change counts by which a function departs from what samples say for this share of its integral.
SHARE = 1e-3


def with_signs(function: Callable, *arguments: Any) -> tuple[Any, jax.Array]:
    """The value of a function, and the signs and whole numbers on the way to it."""
    closed, form = jax.make_jaxpr(function, return_shape=True)(*arguments)
    signs: list[Any] = [jnp.zeros(1)]
    values = _evaluated(closed, jax.tree.leaves(arguments), signs)
    value = jax.tree.unflatten(jax.tree.structure(form), values)
    return value, jnp.concatenate([jnp.ravel(x).astype(float) for x in signs])[:MOST_SIGNS]


def _evaluated(closed: ClosedJaxpr, arguments: Any, signs: list) -> list:
    """The outputs of a program; the list of signs is added to."""
    program, entering = closed.jaxpr, [*closed.consts, *arguments]
    known = dict(zip([*program.constvars, *program.invars], entering, strict=True))
    read = lambda x: x.val if isinstance(x, Literal) else known[x]
    for equation in program.eqns:
        values, name = [read(x) for x in equation.invars], equation.primitive.name
        inner = equation.params.get("jaxpr", equation.params.get("call_jaxpr"))
        if isinstance(inner, ClosedJaxpr) and len(inner.jaxpr.invars) == len(values):
            found = _evaluated(inner, values, signs)
        else:
            ends = {"constvars": [], "invars": equation.invars, "outvars": equation.outvars}
            invars = [x for x in equation.invars if not isinstance(x, Literal)]
            alone = program.replace(eqns=[equation], **(ends | {"invars": invars}))
            found = jax.core.eval_jaxpr(alone, [], *(known[x] for x in invars))
            signs += [jnp.floor(values[0] / values[1])] if name == "rem" else []
            whole = lambda x, name=name: name in ROUNDED or not jnp.issubdtype(x.dtype, float)
            signs += [x if whole(x) else x > 0 for x in found]
        known |= dict(zip(equation.outvars, found, strict=True))
    return [read(x) for x in program.outvars]


Sampled = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def changes_between(sampled: Sampled, times: np.ndarray) -> Iterator[tuple[float, float, list]]:
    """(share of what a function gives, how long it lasts [s], instants [s]) of each change that
    samples at equally spaced `times` [s] do not tell. `sampled(times)`: its values and signs, one
    row a time."""
    values, signs = sampled(times)
    spacing = times[1] - times[0]
    away = spacing * 0.5 ** np.arange(HALVINGS)
    # Then down to rounding, and also what else begins and ends between samples there.
    for within in (away[-1], 0.0):
        low, high = _located(sampled, times, signs, within)
        if not len(low):
            return
        looks = np.concatenate([low - away[:, None], [low], [high], high + away[::-1, None]])
        looks = np.clip(looks, times[0], times[-1])
        found = sampled(looks.ravel())[0].reshape(*looks.shape, -1)
        part = ((looks - looks[0]) / (looks[-1] - looks[0]))[..., None]
        off = np.abs(found - (1 - part) * found[0] - part * found[-1])
        missed = np.sum(0.5 * (off[1:] + off[:-1]) * np.diff(looks, axis=0)[..., None], axis=0)
        total = np.sum(np.abs(values), axis=0) * spacing + missed.max(axis=0)
        shares = missed / np.where(total > 0, total, np.inf)
        largest = shares.max(axis=1)
        times = np.unique(looks[:, largest > SHARE])
        if not len(times):
            return
        signs = sampled(times)[1]
    for k in np.argsort(-largest)[: min(MOST_CHANGES, np.sum(largest > SHARE))]:
        column = shares[k].argmax()
        yield shares[k, column], missed[k, column] / off[:, k, column].max(), looks[:, k].tolist()


def _located(sampled: Sampled, times: np.ndarray, signs: np.ndarray, within: float) -> tuple:
    """The last instants [s] before some sign changes between two `times` [s], and the first after,
    no farther apart than this [s], or rounding."""
    differ = signs[1:] != signs[:-1]
    place = np.nonzero(np.any(differ, axis=1))[0][:MOST_LOCATED]
    which, rows = np.argmax(differ[place], axis=1), np.arange(len(place))
    low, high, before = times[place], times[place + 1], signs[place, which]
    parts, last = POINTS // max(len(place), 1) + 1, None
    while np.any((high - low > within) & (np.nextafter(low, high) < high)) and last != list(low):
        last = list(low)
        inside = low + (high - low) * np.arange(1, parts)[:, None] / parts
        ends = np.concatenate([low[None], np.clip(inside, low, high), high[None]])
        now = sampled(ends[1:-1].ravel())[1].reshape(*inside.shape, -1)[:, rows, which]
        first = np.argmax(np.append(now != before, np.ones((1, len(rows)), bool), axis=0), axis=0)
        low, high = ends[first, rows], ends[first + 1, rows]
    return low, high
