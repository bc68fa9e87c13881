"""Infinite answers: a life that never reaches its limit is a good one, not a failed one.

Where a problem says so (`ResponseInfo.infinite`), an infinite response counts on its side of
every limit, share and quantile. Means and variances of it there are none: whoever asks for one is
told so, and what serves instead.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxclear.integrators import Outcome
from jaxclear.studies.distribution.discrete import Discrete
from jaxclear.studies.problem import Problem

# What has a share of 3 / n is missing from n samples once in twenty times.
RULE_OF_THREE = 3.0
INSTEAD = "ask for a quantile, or for the share of samples beyond a limit"


def has_answer(problem: Problem, responses: Mapping[str, Any]) -> np.ndarray:
    """Whether each sample (samples,) has an answer in each of the responses: a finite number, or an
    infinite one where that is an answer."""
    parts = [
        ~np.isnan(values) if problem.description.responses[name].infinite else np.isfinite(values)
        for name, values in responses.items()
    ]
    return np.all(parts, axis=0)


def successes(
    problem: Problem, outcome: Any, responses: Mapping[str, Any]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Whether each sample reached its end with an answer, and the responses, nan where not.

    Args:
        problem: says of which responses infinite values are answers.
        outcome: of the samples, shape (samples,).
        responses: by name, shape (samples,).
    """
    good = (np.asarray(outcome) == Outcome.REACHED) & has_answer(problem, responses)
    return good, {name: np.where(good, values, np.nan) for name, values in responses.items()}


def why_unanswered(problem: Problem, outcome: Any, ended: Any) -> str:
    """Why a sample has no answer: how it ended, or that a response is not a number.

    Args:
        problem: words its endings.
        outcome: of the sample.
        ended: time at which it ended [s].
    """
    if outcome == Outcome.REACHED:
        return "a response is not a number."
    return problem.description.ending(outcome, ended)


def infinite_messages(problem: Problem, responses: Mapping[str, Any]) -> list[str]:
    """A sentence for each response that is infinite in some samples."""
    texts = {name: _describe_infinite(problem, name, values) for name, values in responses.items()}
    return [f'"{name}" {words}.' for name, words in texts.items() if words]


def refuse_infinite(
    problem: Problem, responses: Mapping[str, Any], what: str, instead: str = INSTEAD
) -> None:
    """Raises `ValueError` where a response is infinite in a sample and a statistic does not exist.

    Args:
        problem: says what infinite values mean.
        responses: by name, shape (samples,).
        what: the statistic.
        instead: clause that says what would be right.
    """
    for name, values in responses.items():
        words = _describe_infinite(problem, name, values)
        if words:
            raise ValueError(f'"{name}" {words}: there is no {what} of it; {instead}.')


def undrawn_levels(problem: Problem, values: np.ndarray) -> dict[str, str]:
    """Variables of a few levels of which runs (runs, variables) have not seen one, and a sentence
    for each: what such a level does is in no share of a variance."""
    undrawn = {}
    each = zip(problem.marginals.items(), problem.nominal(), strict=True)
    for i, ((name, law), nominal) in enumerate(each):
        if not isinstance(law, Discrete):
            continue
        levels = np.asarray(law.deviations, float)
        weights = np.ones(len(levels)) if law.shares is None else np.asarray(law.shares, float)
        shares = weights / weights.sum()
        nearest = np.argmin(np.abs(values[:, i, None] - float(nominal) - levels), axis=1)
        rare = [k for k in np.flatnonzero(shares) if k not in nearest]
        if rare:
            level, share = float(nominal) + levels[rare[0]], shares[rare[0]]
            level_text = f"{level:.6g} {problem.variable_units[i]}".removesuffix(" 1")
            undrawn[name] = (
                f'No run has "{name}" = {level_text}, which {100 * share:.2g} % of the parts have: '
                f"what that does to the variance is not known. About {RULE_OF_THREE / share:.2g} "
                "samples would meet it."
            )
    return undrawn


def check_within_horizon(problem: Problem, name: str, *limits: Any) -> None:
    """Raises `ValueError` for limits beyond what a response is told up to."""
    info = problem.description.responses[name]
    for limit in limits:
        if limit is not None and float(limit) > info.horizon:
            raise ValueError(
                f'a limit of "{name}" is {float(limit):.6g}, and it is told up to '
                f"{info.horizon:.6g}: beyond that, {info.infinite}. Ask for more of it, or for "
                "a limit that is not beyond."
            )


def replace_infinite(values: np.ndarray, *limits: Any) -> np.ndarray:
    """Values with a finite number, beyond all others and these limits, in place of those that are
    infinite: what only asks on which side of a limit they lie sees no difference."""
    if not np.isinf(values).any():
        return values
    bounds = [float(limit) for limit in limits if limit is not None]
    finite = np.append(values[np.isfinite(values)], bounds)
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    aside = (high - low) or abs(high) or 1.0
    return np.where(np.isinf(values), np.where(values > 0, high + aside, low - aside), values)


def bounded(problem: Problem, name: str, values: np.ndarray, levels: Sequence[Any]) -> np.ndarray:
    """Finite values for a surface, infinite ones replaced.

    They become the horizon up to which a response is computed, or without one a value beyond all
    others and the levels.

    Args:
        problem: with the response's horizon.
        name: of the response.
        values: shape (samples,).
        levels: bounds of limits on the response.
    """
    most = problem.description.responses[name].horizon
    return np.minimum(values, most) if np.isfinite(most) else replace_infinite(values, *levels)


def _describe_infinite(problem: Problem, name: str, values: Any) -> str:
    """In how many samples a response is infinite, and what that says; "" for none."""
    count = int(np.isinf(np.asarray(values, float)).sum())
    why = problem.description.responses[name].infinite
    return f"is infinite in {count} of {np.size(values)} samples ({why})" if count and why else ""
