"""Where a sample fails: a response beyond a threshold, or several such limits together.

A margin is positive where a limit holds and negative where it is broken. Whatever the limits are
put together from, a system fails by one of its cut sets: limits that are broken at once.
"""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.ground.arguments import expect
from jaxclear.ground.printing import as_written
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.ground.wording import described, unknown

__all__ = ["Above", "AbstractLimitState", "Below", "Parallel", "Series"]
__getattr__, __dir__ = nothing_else("jaxclear.limit_state", __all__)

UNIT = "(in the response's unit)"
# More cut sets than this no search goes through.
MOST_CUTS = 1000


class AbstractLimitState(AbstractQuantified):
    """A condition on responses under which a sample fails.

    A margin is positive where a limit holds and negative where it is exceeded.
    """

    @abstractmethod
    def limits(self) -> tuple[Any, ...]:
        """The limits on single responses."""

    @abstractmethod
    def cut_sets(self) -> tuple[frozenset[int], ...]:
        """Sets of indices of `limits` whose limits, exceeded together, make the system fail."""

    @abstractmethod
    def words(self) -> str:
        """What fails, such as "follower error above 0.00019"."""

    def margins(self, responses: dict[str, Array]) -> Float[Array, " limits"]:
        """Margins of all limits.

        Args:
            responses: responses by name, a dictionary.

        Returns:
            Margin of each limit in its response's unit, shape (limits,), negative where it is
            exceeded.
        """
        return jnp.stack([limit.margin(responses) for limit in self.limits()])


class AbstractThreshold(AbstractLimitState):
    """A limit on one response."""

    response: eqx.AbstractVar[str]

    def __check_init__(self):
        expect(self.response, str, "response of a limit", "the name of a response")

    def limits(self):
        return (self,)

    def cut_sets(self):
        return (frozenset({0}),)


class Above(AbstractThreshold):
    """Failure where a response is above a threshold.

    Args:
        response: name of the response.
        threshold: largest value that does not fail, in the response's unit.
    """

    response: str = eqx.field(static=True)
    threshold: Scalar = quantity(unit=UNIT)

    def margin(self, responses):
        """Threshold minus response.

        Args:
            responses: responses by name, a dictionary.

        Returns:
            The margin in the response's unit.
        """
        return self.threshold - responses[self.response]

    def words(self):
        return f"{self.response} above {as_written(self.threshold)}"


class Below(AbstractThreshold):
    """Failure where a response is below a threshold.

    Args:
        response: name of the response.
        threshold: smallest value that does not fail, in the response's unit.
    """

    response: str = eqx.field(static=True)
    threshold: Scalar = quantity(unit=UNIT)

    def margin(self, responses):
        """Response minus threshold.

        Args:
            responses: responses by name, a dictionary.

        Returns:
            The margin in the response's unit.
        """
        return responses[self.response] - self.threshold

    def words(self):
        return f"{self.response} below {as_written(self.threshold)}"


class Series(AbstractLimitState):
    """A system that fails where any of its parts fails, like a chain.

    Args:
        parts: the parts, each an `AbstractLimitState`.

    Raises:
        ValueError: if there are none, or one is something else.
    """

    parts: tuple[AbstractLimitState, ...]

    def __init__(self, *parts: AbstractLimitState):
        self.parts = _check_parts("Series", parts)

    def limits(self):
        return _all_limits(self.parts)

    def cut_sets(self):
        return _minimal_cuts([cut for cuts in _renumber_cuts(self.parts) for cut in cuts])

    def words(self):
        return " or ".join(_words_in_brackets(part) for part in self.parts)


class Parallel(AbstractLimitState):
    """A system that fails only where all of its parts fail, like a rope of many strands.

    Args:
        parts: the parts, each an `AbstractLimitState`.

    Raises:
        ValueError: if there are none, or one is something else.
    """

    parts: tuple[AbstractLimitState, ...]

    def __init__(self, *parts: AbstractLimitState):
        self.parts = _check_parts("Parallel", parts)

    def limits(self):
        return _all_limits(self.parts)

    def cut_sets(self):
        cuts: list[frozenset[int]] = [frozenset()]
        for part_cuts in _renumber_cuts(self.parts):
            cuts = list(_minimal_cuts([one | cut for one in cuts for cut in part_cuts]))
            if len(cuts) > MOST_CUTS:
                raise ValueError(
                    f"this system fails in more than {MOST_CUTS} ways; put fewer parts together."
                )
        return tuple(cuts)

    def words(self):
        return " and ".join(_words_in_brackets(part) for part in self.parts)


def system_margin(margins: np.ndarray, cuts: tuple[frozenset[int], ...]) -> np.ndarray:
    """Margin (samples,) of a system from those of its limits (samples, limits) in one scale."""
    return np.min([margins[:, sorted(cut)].max(axis=1) for cut in cuts], axis=0)


def check_limit(limit: Any, response_names: tuple[str, ...], owner: str) -> None:
    """Raises `ValueError` for what is no limit state, or one on an unknown response.

    Args:
        limit: to be checked.
        response_names: of the problem.
        owner: function in the message.
    """
    expect(
        limit,
        AbstractLimitState,
        f"limit of {owner}",
        'a limit state, such as jaxclear.limit_state.Above("name of a response", threshold)',
    )
    for part in limit.limits():
        if part.response not in response_names:
            raise ValueError(unknown("response", part.response, response_names, " in this problem"))


def _check_parts(kind: str, parts: tuple[Any, ...]) -> tuple[Any, ...]:
    if not parts:
        raise ValueError(f"{kind} has no parts; give it limits, such as Above(...), one or more.")
    for part in parts:
        if not isinstance(part, AbstractLimitState):
            raise ValueError(
                f"a part of {kind} is {described(part)}; it must be a limit state, such as "
                'jaxclear.limit_state.Above("name of a response", threshold).'
            )
    return parts


def _all_limits(parts: tuple[Any, ...]) -> tuple[Any, ...]:
    return tuple(limit for part in parts for limit in part.limits())


def _renumber_cuts(parts: tuple[Any, ...]) -> list[tuple[frozenset[int], ...]]:
    """The cut sets of each part, in the places that its limits have among those of all."""
    numbered, first = [], 0
    for part in parts:
        numbered.append(tuple(frozenset(i + first for i in cut) for cut in part.cut_sets()))
        first += len(part.limits())
    return numbered


def _minimal_cuts(cuts: list[frozenset[int]]) -> tuple[frozenset[int], ...]:
    """The cut sets that hold no other one."""
    single = list(dict.fromkeys(cuts))
    return tuple(cut for cut in single if not any(other < cut for other in single))


def _words_in_brackets(part: Any) -> str:
    return part.words() if len(part.limits()) == 1 else f"({part.words()})"
