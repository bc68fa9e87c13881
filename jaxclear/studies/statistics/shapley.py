"""What each variable contributes to the variance of a response, dependent or not:
`jaxclear.shapley_effects`.

Where variables depend on each other, a variance has no shares of single ones. Shapley's value gives
each the mean of what it adds to the variance explained, over all orders in which the variables may
become known; the effects are not negative and sum to 1. What a set of variables explains is the
covariance of two samples that share these and are drawn anew in the others, given these.

Source: Owen 2014, SIAM/ASA J. Uncertain. Quantif. 2, 245, doi:10.1137/130936233; orders drawn by
chance: Song, Nelson & Staum 2016, SIAM/ASA J. Uncertain. Quantif. 4, 1060, doi:10.1137/15M1048070.
"""

import itertools
import math
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_flags
from jaxclear.ground.printing import failed_samples_sentence
from jaxclear.integrators import Outcome
from jaxclear.studies.answer import RESPONSE, VARIABLE, AbstractAnswer, Stated, with_interval
from jaxclear.studies.infinite_responses import refuse_infinite
from jaxclear.studies.inputs import Inputs
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_warnings import sentences_among
from jaxclear.studies.sampling import check_sampled, groups
from jaxclear.studies.scrambling import scores_by_scrambling
from jaxclear.studies.statistics.scrambled import Statistic, student
from jaxclear.studies.statistics.sobol_indices import (
    leading,
    open_share,
    open_shares,
    refuse_part_of_spread,
)
from jaxclear.studies.store.batch import evaluate_all
from jaxclear.studies.store.store import stored
from jaxclear.studies.surface.response_surface import ResponseSurface

SCRAMBLINGS = 16
# All sets of so many variables are gone through; of more, orders drawn by chance, so many in all.
MOST_VARIABLES, ORDERS = 8, 64
# Evaluations of a surface at once.
TOGETHER = 1024

# A variable, which are known before it, and how often among all orders [1].
Step = tuple[int, frozenset[int], float]


class ShapleyEffects(AbstractAnswer):
    """`effects` [1] by (response, variable), each with its 95 % interval; those of a response sum
    to 1, of a surface to the share of the variance that it explains. `runs` of the problem (of its
    surface, where one was given) and how many samples `failed`; `remark` says what a surface leaves
    out, `warnings` of what runs warn."""

    problem: Problem
    effects: dict[tuple[str, str], Statistic]
    runs: int = eqx.field(static=True)
    failed: int = eqx.field(static=True)
    remark: str = eqx.field(static=True, default="")
    warnings: tuple[str, ...] = eqx.field(static=True, default=())

    def sentence(self) -> str:
        """Which variables contribute most to the variance of each response, what a surface leaves
        out, and how many samples failed."""
        led = leading(self.effects, "Shapley effect")
        return " ".join(
            filter(None, [led, self.remark, failed_samples_sentence(self.failed, "sample")])
        )

    def _stated(self):
        named = {"error_name": "error (95 %)"}
        columns = with_interval("effect", (RESPONSE, VARIABLE), self.effects)
        columns["effect"] = columns["effect"]._replace(**named)
        numbers = {"runs": self.runs, "failed": self.failed, "remark": self.remark}
        return Stated("Shapley effects", columns, self.problem, self.warnings, numbers)


@answering
@stored("a study of Shapley effects")
def shapley_effects(
    of: Problem | ResponseSurface,
    samples: int = 1024,
    *,
    seed: int = 0,
    store: str | Path | None = None,
    progress_bar: bool = False,
) -> ShapleyEffects:
    """Shapley effects of every variable on every response, for independent and dependent variables.

    It takes `samples` runs for each set of variables: 2^variables sets for up to 8 of them, about
    65 times the number of variables beyond, where orders are drawn at random. For a mechanism use
    its surface.

    Args:
        of: the problem, or its `ResponseSurface`.
        samples: number of samples; 1024 by default.
        seed: seed of the random numbers; 0 by default.
        store: folder that keeps the runs; None (default) for none.
        progress_bar: whether to show the progress; False by default.

    Returns:
        The `ShapleyEffects`.

    Raises:
        ValueError: if an argument is wrong.
    """
    surface = of if isinstance(of, ResponseSurface) else None
    problem: Any = of if surface is None else surface.problem
    check_sampled(problem, samples, seed)
    check_count("samples of shapley_effects", samples, at_least=2 * SCRAMBLINGS)
    check_flags("shapley_effects", progress_bar=progress_bar)
    group, together = np.sort(groups(samples, SCRAMBLINGS)), tuple(problem.groups.values())
    count = len(together)
    steps = _all_steps(count) if count <= MOST_VARIABLES else _some_steps(count, seed)
    every = {subset | {variable} for variable, subset, _ in steps}
    sets = sorted(every, key=lambda subset: (len(subset), sorted(subset)))
    columns = [sorted(i for one in subset for i in together[one]) for subset in sets]
    values = _samples(problem.inputs, columns, group, seed)
    if surface is None:
        result = evaluate_all(problem, values, progress_bar=progress_bar, label="Shapley effects")
        reached = np.asarray(result.outcome) == Outcome.REACHED
        responses = result.responses
        refuse_infinite(problem, responses, "variance")
        warnings = sentences_among(problem, result.checks, reached)
    else:
        points = np.asarray(surface.values)
        inside = jnp.clip(values, points.min(axis=0), points.max(axis=0))
        refuse_part_of_spread(surface, np.mean(np.asarray(inside != values), axis=0))
        responses, clipped = (_on_surface(surface.bare(), at) for at in (values, inside))
        reached, warnings = np.ones(len(values), bool), surface.warnings
    good = np.all(reached.reshape(len(sets), -1), axis=0)
    effects: dict[Any, Any] = {}
    for name in problem.response_names:
        variable_effects = _effects(responses[name], good, sets, steps, group, count)
        if surface is not None:
            beyond = _effects(clipped[name], good, sets, steps, group, count)
            open_, explained = open_share(surface, name, float(np.var(responses[name])))
            variable_effects = [
                _with_open(one, abs(one.value - other.value), open_, explained)
                for one, other in zip(variable_effects, beyond, strict=True)
            ]
        each = zip(problem.variable_names, variable_effects, strict=True)
        effects |= {(name, variable): one for variable, one in each}
    drawn = np.asarray(values)[np.tile(good, len(sets))] if surface is None else surface.values
    little = open_shares(problem, drawn, effects)
    remark, failed = _remark(surface), int((~good).sum())
    return ShapleyEffects(problem, effects, len(values), failed, remark, (*warnings, *little))


def _all_steps(count: int) -> list[Step]:
    """Steps through all sets, each as often as it occurs among all orders."""
    return [
        (variable, frozenset(subset), 1 / (count * math.comb(count - 1, size)))
        for size in range(count)
        for subset in itertools.combinations(range(count), size)
        for variable in sorted(set(range(count)) - set(subset))
    ]


def _some_steps(count: int, seed: int) -> list[Step]:
    """Steps of orders drawn by chance, each with its reverse."""
    rng = np.random.default_rng((seed, ORDERS))
    some = [rng.permutation(count).tolist() for _ in range(ORDERS // 2)]
    return [
        (variable, frozenset(order[:place]), 1 / ORDERS)
        for half in some
        for order in (half, half[::-1])
        for place, variable in enumerate(order)
    ]


def _samples(inputs: Inputs, sets: list[list[int]], group: np.ndarray, seed: int) -> Any:
    """Values (sets * samples, variables): for each set a sample that shares its variables with the
    last one, which shares all, and is drawn anew in the others, given these."""
    count = len(inputs.names)
    normal = scores_by_scrambling(np.bincount(group), 2 * count, seed)
    matrix = np.eye(count) if inputs.independent else np.asarray(inputs.correlation)
    scores = normal[:, :count] @ np.linalg.cholesky(matrix).T
    rows = []
    for subset in sets:
        one, rest = subset, [i for i in range(count) if i not in subset]
        drawn = scores.copy()
        if rest:
            follow = matrix[np.ix_(rest, one)] @ np.linalg.inv(matrix[np.ix_(one, one)])
            conditional = matrix[np.ix_(rest, rest)] - follow @ matrix[np.ix_(one, rest)]
            anew = normal[:, count + np.array(rest)] @ np.linalg.cholesky(conditional).T
            drawn[:, rest] = scores[:, one] @ follow.T + anew
        rows.append(drawn)
    return inputs.of_scores(np.concatenate(rows))


def _with_open(effect: Statistic, beyond: float, open_: float, explained: float) -> Statistic:
    """An effect of the variance that a surface explains as one of the whole, of which a share is
    `open_`; `beyond`: by how much what the surface supposes beyond its runs moves it."""
    half = explained * (effect.error + beyond) + open_
    value = explained * effect.value
    return Statistic(value, value - half, value + half)


def _effects(responses, good, sets, steps, group, count) -> list[Statistic]:
    """Effect of each variable from responses (sets * samples,), the last set being all variables;
    `good` (samples,) are those whose runs reached their end."""
    rows, group = np.asarray(responses).reshape(len(sets), -1)[:, good], group[good]
    away = rows - rows[-1].mean()
    parts: dict[frozenset[int], np.ndarray] = {frozenset(): np.zeros(SCRAMBLINGS)}
    for subset, gain in zip(sets, away, strict=True):
        sums = np.bincount(group, gain * away[-1], SCRAMBLINGS)
        parts[subset] = sums / np.maximum(np.bincount(group, minlength=SCRAMBLINGS), 1)
    variance = float(parts[sets[-1]].mean())
    if variance <= 0:
        return [Statistic(0.0, 0.0, 0.0)] * count
    effects = []
    for i in range(count):
        gains = np.array([w * (parts[k | {v}] - parts[k]) for v, k, w in steps if v == i])
        gain = gains.sum(axis=0)
        value = float(gain.mean() / variance)
        # A ratio of means, by its linear part.
        spread = (gain - value * parts[sets[-1]]).var(ddof=1) / SCRAMBLINGS
        if count > MOST_VARIABLES:
            # Orders come in pairs, which chance has drawn.
            pairs = gains.mean(axis=1).reshape(-1, 2).sum(axis=1)
            spread += len(pairs) * pairs.var(ddof=1)
        half = float(student(SCRAMBLINGS) * np.sqrt(spread) / variance)
        effects.append(Statistic(value, value - half, value + half))
    return effects


@eqx.filter_jit
def _on_surface(surface, values):
    return jax.lax.map(surface, values, batch_size=TOGETHER)


def _remark(surface: ResponseSurface | None) -> str:
    """Which responses a surface does not stand for."""
    if surface is None:
        return ""
    rough = [name for name in surface.problem.response_names if not surface.trusted(name)]
    return " ".join(
        f'"{name}": the surface has a leave-one-out R2 of {surface.quality[name]:.2f}; its effects '
        "are those of what it explains."
        for name in rough
    )
