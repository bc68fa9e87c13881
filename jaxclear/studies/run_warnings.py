"""Which runs of a study carry a warning, of what, and which responses that concerns.

A run whose own checks found a figure beyond its limit has reached its end, but not every number of
it is to be trusted. It is counted like a failed one; whether it counts for a response depends on
what the response is drawn from.
"""

from collections.abc import Sequence

import numpy as np

from jaxclear.ground.wording import listed
from jaxclear.integrators.checks import Check, Checks
from jaxclear.studies.problem import Problem

# More than this share of runs in doubt, and what rests on them is in doubt too.
FEW_WARNED = 0.05


def codes_of(checks: Checks, runs: int) -> np.ndarray:
    """Of what each run warns, (runs,): the sum of 2^n over the numbers n of the checks."""
    codes = np.zeros(runs, np.int64)
    for check, beyond in checks.beyond().items():
        codes |= np.where(np.asarray(beyond), np.int64(1) << int(check), 0)
    return codes


def any_warning(checks: Checks, runs: int) -> np.ndarray:
    """Whether each run carries a warning, (runs,)."""
    return codes_of(checks, runs) != 0


def warns_about(problem: Problem, response: str, checks: Checks, runs: int) -> np.ndarray:
    """Whether each run has a warning that concerns a response, shape (runs,).

    Args:
        problem: says what the response depends on.
        response: its name.
        checks: of all runs.
        runs: their number.
    """
    return concerning(problem, response, codes_of(checks, runs)) != 0


def concerning(problem: Problem, response: str, codes: np.ndarray) -> np.ndarray:
    """The parts of the runs' codes that concern a response, shape (runs,).

    Args:
        problem: says what the response depends on.
        response: its name.
        codes: bits of the warnings of each run, shape (runs,).
    """
    parts = problem.description.responses[response].depends_on
    checks = [check for check in Check if check.concerns in parts]
    return codes & np.int64(sum(1 << int(check) for check in checks))


def concern(
    problem: Problem, response: str, checks: Checks, among: np.ndarray
) -> tuple[float, str]:
    """Share of runs whose warnings concern a response, and a sentence for it; "" without.

    Args:
        problem: says what the response depends on.
        response: its name.
        checks: of all runs.
        among: mask or indices of the runs that count.
    """
    codes = concerning(problem, response, codes_of(checks, len(among)))[among]
    return _share_of_warned(codes), _warning_sentence(codes)


def warned_share(problem: Problem, response: str, codes: np.ndarray) -> float:
    """Share of runs whose warnings concern a response [1].

    Args:
        problem: says what the response depends on.
        response: its name.
        codes: bits of the warnings of each run, shape (runs,).
    """
    return _share_of_warned(concerning(problem, response, codes))


def sentences(
    problem: Problem, codes: np.ndarray, responses: Sequence[str] | None = None
) -> tuple[str, ...]:
    """Sentences on how many runs warn of what concerns responses; equal ones are joined.

    Args:
        problem: says what the responses depend on.
        codes: bits of the warnings of each run that counts, shape (runs,).
        responses: names; None: all.
    """
    by_sentence: dict[str, list[str]] = {}
    names = problem.response_names
    for name in names if responses is None else [n for n in names if n in responses]:
        sentence = _warning_sentence(concerning(problem, name, codes))
        if sentence:
            by_sentence.setdefault(sentence, []).append(name)
    return tuple(f"{listed(names)}: {sentence}" for sentence, names in by_sentence.items())


def sentences_among(problem: Problem, checks: Checks, among: np.ndarray) -> tuple[str, ...]:
    """`sentences` for the checks of all runs.

    Args:
        problem: says what the responses depend on.
        checks: of all runs.
        among: mask of the runs that count, shape (runs,).
    """
    return sentences(problem, codes_of(checks, len(among))[among])


def _share_of_warned(codes: np.ndarray) -> float:
    return float(np.mean(codes != 0)) if len(codes) else 0.0


def _warning_sentence(codes: np.ndarray) -> str:
    kinds = by_kind(codes)
    return f"{np.sum(codes != 0)} of {len(codes)} runs warn ({in_words(kinds)})." if kinds else ""


def counted(checks: Checks, among: np.ndarray) -> dict[Check, int]:
    """How many of the runs `among` (runs,) warn of what, most frequent first."""
    return by_kind(codes_of(checks, len(among))[among])


def by_kind(codes: np.ndarray) -> dict[Check, int]:
    """How many runs warn of what, most frequent first, of the codes (runs,) of all."""
    counts = {check: int(np.sum(codes >> int(check) & 1)) for check in Check}
    order = sorted(counts, key=lambda check: -counts[check])
    return {check: counts[check] for check in order if counts[check]}


def in_words(counts: dict[Check, int]) -> str:
    """ "friction step in 12, loop drift in 3"."""
    return ", ".join(f"{check.label} in {count}" for check, count in counts.items())
