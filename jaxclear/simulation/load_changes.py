"""When functions change, also where that is between any samples: every sign that a function of
arguments takes on its way to its value, and every whole number to which it rounds, is looked at,
and where one changes between two samples, that is halved down to rounding.

A push from `t > a` to `t < b` is found however short it is; so is a bell about an instant, since
what is squared in it changes its sign there.
"""

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

# What compares two numbers, and what rounds to whole ones.
COMPARED = ("lt", "le", "gt", "ge", "eq", "ne", "max", "min")
ROUNDED = ("floor", "ceil", "round", "sign")
# So many signs of a function are looked at, those of comparisons first; so many changes are
# located, by about so many looks at a time.
MOST_SIGNS, MOST_LOCATED, POINTS = 128, 2**10, 2**13
# Around an instant of change a function is looked at this often on each side, each time at half the
# distance.
HALVINGS = 24
# A change counts by which a function departs from what samples say for this share of its integral;
# instants at most.
SHARE, MOST_CHANGES = 1e-3, 512
# Between two looks a function has changed that differs by this share of its largest departure.
DIFFERENT = 0.01


def with_signs(function: Callable, *arguments: Any) -> tuple[Any, jax.Array]:
    """The value of a function, and the signs and whole numbers on the way to it."""
    closed, form = jax.make_jaxpr(function, return_shape=True)(*arguments)
    compared: list[Any] = []
    others: list[Any] = []
    leaves = jax.tree.leaves(arguments)
    values = _evaluated(closed.jaxpr, closed.consts, leaves, compared, others)
    signs = [jnp.zeros(1), *(jnp.ravel(each) for each in [*compared, *others])]
    return jax.tree.unflatten(jax.tree.structure(form), values), jnp.concatenate(signs)[:MOST_SIGNS]


def _evaluated(program: Any, consts: Any, arguments: Any, compared: list, others: list) -> list:
    """The outputs of a program; the lists are added to."""
    known = dict(zip([*program.constvars, *program.invars], [*consts, *arguments], strict=True))
    read = lambda x: x.val if hasattr(x, "val") else known[x]
    for equation in program.eqns:
        values, name = [read(x) for x in equation.invars], equation.primitive.name
        inner = equation.params.get("jaxpr", equation.params.get("call_jaxpr"))
        if hasattr(inner, "consts") and len(inner.jaxpr.invars) == len(values):
            found = _evaluated(inner.jaxpr, inner.consts, values, compared, others)
        else:
            entering = [x for x in equation.invars if not hasattr(x, "val")]
            ends = {"constvars": [], "invars": entering, "outvars": equation.outvars}
            alone = program.replace(eqns=[equation], **ends)
            found = jax.core.eval_jaxpr(alone, [], *(known[x] for x in entering))
        numbers = [x for x in values if jnp.issubdtype(jnp.result_type(x), jnp.floating)]
        if name in COMPARED and len(numbers) == 2:
            compared.append(jnp.where(numbers[0] > numbers[1], 1.0, 0.0))
        elif name == "clamp" and len(numbers) == 3:
            compared += [jnp.where(numbers[1] > each, 1.0, 0.0) for each in numbers[::2]]
        elif name == "rem" and len(numbers) == 2:
            compared.append(jnp.floor(numbers[0] / numbers[1]))
        elif name in ROUNDED:
            compared += [jnp.asarray(x, float) for x in found]
        elif inner is None:
            real = [x for x in found if jnp.issubdtype(jnp.result_type(x), jnp.floating)]
            others += [jnp.where(x > 0, 1.0, 0.0) for x in real]
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
    whole = np.sum(np.abs(values), axis=0) * spacing

    def looked_around(low, high):
        """(times, values, what these depart by from a straight line, its integral, share) there."""
        looks = np.concatenate([low - away[:, None], [low], [high], high + away[::-1, None]])
        looks = np.clip(looks, times[0], times[-1])
        found = sampled(looks.ravel())[0].reshape(*looks.shape, -1)
        part = ((looks - looks[0]) / (looks[-1] - looks[0]))[..., None]
        off = np.abs(found - (1 - part) * found[0] - part * found[-1])
        missed = np.sum(0.5 * (off[1:] + off[:-1]) * np.diff(looks, axis=0)[..., None], axis=0)
        total = whole + missed.max(axis=0, initial=0.0)
        return looks, found, off, missed, missed / np.where(total > 0, total, np.inf)

    low, high = _located(sampled, times, signs, away[-1])
    if not len(low):
        return
    looks, *_, shares = looked_around(low, high)
    counts = np.max(shares, axis=1, initial=0.0) > SHARE
    if not np.any(counts):
        return
    # Down to rounding, and also what else begins and ends between samples there.
    finer = np.unique(looks[:, counts])
    low, high = _located(sampled, finer, sampled(finer)[1], 0.0)
    looks, found, off, missed, shares = looked_around(low, high)
    largest = off.max(axis=0)
    differs = np.any(np.abs(np.diff(found, axis=0)) > DIFFERENT * largest, axis=-1)
    for k in np.argsort(-shares.max(axis=1))[:MOST_CHANGES]:
        if shares[k].max() <= SHARE:
            return
        column = shares[k].argmax()
        instants = [low[k], high[k], *looks[1:][differs[:, k], k], *looks[:-1][differs[:, k], k]]
        yield shares[k, column], missed[k, column] / largest[k, column], instants


def _located(sampled: Sampled, times: np.ndarray, signs: np.ndarray, within: float) -> tuple:
    """The last instants [s] before some sign changes between two `times` [s], and the first after,
    no farther apart than this [s], or rounding."""
    differ = signs[1:] != signs[:-1]
    place = np.nonzero(np.any(differ, axis=1))[0][:MOST_LOCATED]
    which = np.argmax(differ[place], axis=1)
    low, high, before = times[place], times[place + 1], signs[place, which]
    rows, parts = np.arange(len(place)), POINTS // max(len(place), 1) + 1
    while np.any((np.nextafter(low, high) < high) & (high - low > within)):
        inside = low + (high - low) * np.arange(1, parts)[:, None] / parts
        ends = np.concatenate([low[None], np.clip(inside, low, high), high[None]])
        now = sampled(ends[1:-1].ravel())[1].reshape(*inside.shape, -1)[:, rows, which]
        first = np.argmax(np.append(now != before, np.ones((1, len(rows)), bool), axis=0), axis=0)
        last = low, high
        low, high = ends[first, rows], ends[first + 1, rows]
        if np.array_equal(last, (low, high)):
            break
    return low, high
