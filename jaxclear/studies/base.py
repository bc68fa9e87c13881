"""What a study sees: numbers that vary, responses wanted, and one pure function from those to
these.

A study asks an `AbstractProblem` and never what lies behind it: a mechanism that runs in time
(`Problem`), one that is put together at positions, or any function of dimensions
(`FunctionProblem`). What differs between these, each says of itself.
"""

from abc import abstractmethod
from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground.printing import in_a_line, number_in_words
from jaxclear.ground.quantity import AbstractQuantified
from jaxclear.ground.wording import described, listed, public_name
from jaxclear.integrators import Outcome
from jaxclear.integrators.checks import Checks
from jaxclear.studies.distribution import AbstractDistribution, TruncatedNormal
from jaxclear.studies.inputs import Inputs, joint


class SampleResult(eqx.Module):
    """Responses of one sample by name, how it ended (`integrator.Outcome`), when [s] (0 where there
    is no time), and its own `checks`, whose figures beyond their limits are warnings."""

    responses: dict[str, Array]
    outcome: Array
    ended: Array
    checks: Checks = eqx.field(default_factory=Checks)

    def reached_responses(self) -> dict[str, np.ndarray]:
        """Of samples (samples,) the responses by name, nan in those whose run did not reach its
        end."""
        reached = np.asarray(self.outcome) == Outcome.REACHED
        return {name: np.where(reached, own, np.nan) for name, own in self.responses.items()}


class AbstractVariable(AbstractQuantified):
    """A number that varies about its nominal value, and its distribution about it."""

    distribution: eqx.AbstractVar[AbstractDistribution]


def one_distribution(
    owner: str, distribution: AbstractDistribution | None, tolerance: Any
) -> AbstractDistribution:
    """The distribution given, or that of a tolerance t (a number above 0): normal with three
    standard deviations in t, cut off at +-t. Raises `ValueError` for both or neither."""
    if distribution is not None and tolerance is None:
        return distribution
    if tolerance is not None and distribution is None:
        return TruncatedNormal(tolerance / 3, bound=tolerance)
    raise ValueError(
        f"a {owner} takes a distribution or a tolerance; give one of the two, not both or neither."
    )


class AbstractProblem(AbstractQuantified):
    """Numbers that vary, in the order of `names`, and the responses wanted of them, in the order of
    `response_names`. `correlation` (variables, variables) [1] of the variables' normal scores is
    None where all are independent."""

    variables: eqx.AbstractVar[dict[str, Any]]
    names: eqx.AbstractVar[tuple[str, ...]]
    response_names: eqx.AbstractVar[tuple[str, ...]]
    variable_units: eqx.AbstractVar[tuple[str, ...]]
    correlation: eqx.AbstractVar[Any]

    def __hash__(self) -> int:
        # By identity, not by its arrays: `jax.jit(problem.evaluate)` looks up its programs by it.
        return id(self)

    def _shown(self):
        """How it is asked, the responses and the variables with their units."""
        units, nominal = self.units(), self.nominal()
        lines = [f"{public_name(type(self))} {self.asked_how()}".rstrip(), "responses"]
        lines += [f"  {name} [{units[name]}]" for name in self.response_names]
        lines += ["variables"] if self.names else []
        for name, unit, value in zip(self.names, self.variable_units, nominal, strict=True):
            spread = in_a_line(self.variables[name].distribution)
            own = "" if unit == "1" else f" {unit}"
            lines.append(f"  {name} {number_in_words(value)}{own}, {spread}")
        return "\n".join(lines if self.correlation is None else [*lines, "correlated"])

    def asked_how(self) -> str:
        """What is done with a sample, such as "over 0.25 s"; "" for nothing to tell."""
        return ""

    @property
    def inputs(self) -> Inputs:
        """The joint distribution of the variables: `values(normal)` from independent standard
        normal numbers, and `normal(values)`."""
        own = [self.variables[name].distribution for name in self.names]
        return joint(self.names, own, self.nominal(), self.correlation)

    @abstractmethod
    def nominal(self) -> Float[Array, " variables"]:
        """Nominal value of each variable."""

    @abstractmethod
    def units(self) -> dict[str, str]:
        """Unit of each response."""

    @abstractmethod
    def evaluate(
        self, values: Float[Array, " variables"], *, discrete_derivatives: bool = False
    ) -> SampleResult:
        """The responses for one set of values; pure. JAX may map, compile and differentiate it.

        A derivative that is not that of the responses raises `ValueError`; `discrete_derivatives`
        passes on what the steps of a run have for one.
        """

    def check_values(self, values: Any) -> None:
        """Raises `ValueError` where these are not one number for each variable."""
        shape = getattr(values, "shape", None)
        if shape is None and isinstance(values, (list, tuple)):
            shape = (len(values),)
        if shape != (len(self.names),):
            names = f", {listed(self.names)}" if self.names else ""
            raise ValueError(
                f"evaluate takes an array of {len(self.names)} values, one for each variable in "
                f"order{names}; it is given {described(values)}."
            )

    def endless(self, response: str) -> str:
        """What it says of a sample that a response is infinite, where that is an answer, as that
        "it is not reached within 1e6 cycles"; "" where such a sample has failed."""
        return ""

    def told_up_to(self, response: str) -> float:
        """The largest value of a response that is told; what is more is infinite."""
        return float("inf")

    @abstractmethod
    def sample_memory(self) -> int:
        """Memory [bytes] that one sample takes while it is computed, roughly."""

    @abstractmethod
    def most_together(self) -> int:
        """Samples that are best computed together, at the most."""

    def at_once(self) -> bool:
        """Whether a sample costs no more than what would be fitted to stand in for it."""
        return False

    def compiled(self) -> bool:
        """Whether a sample is one compiled program; else each is computed by itself, by `evaluate`
        with numbers."""
        return True

    def idle(self) -> "AbstractProblem":
        """The same compiled program on as little work as possible."""
        return self

    @abstractmethod
    def rerun(self, values: Float[Array, " variables"], index: int, chunk: int) -> Any:
        """All there is to be seen of sample `index` of a study in chunks of this size."""

    @abstractmethod
    def ending(self, outcome: int, ended: float) -> str:
        """How a sample ended, as the rest of a sentence that begins with its values."""

    def discretised(self) -> bool:
        """Whether its numbers are off by something that could be refined, as steps of a run."""
        return False

    def replica(self, share: float = 0.5) -> "AbstractProblem | None":
        """The same question with all that discretises it refined, steps to a `share` [1] of their
        length; None where nothing is discretised, or it cannot be refined. Of the same structure
        wherever that is enough: a study then runs it by its own compiled program."""
        return None

    def promised(self, response: str, size: float) -> float | None:
        """The largest error of its mean with which a response of this `size` (root mean square)
        counts as right, in its unit; None where nothing is promised."""
        return None

    def doubts(self) -> tuple[str, ...]:
        """A sentence for what is off in all samples alike, and known before any is run."""
        return ()

    def remedy(self, response: str) -> str:
        """What brings the numerical error of a response down."""
        return "refine its steps"

    def remark(self) -> str:
        """What a user should know of how the samples were computed; "" for nothing."""
        return ""

    def concerned(self, response: str, concerns: str) -> bool:
        """Whether a warning that `concerns` a part of a sample concerns a response."""
        return True

    def pathwise_limits(self) -> tuple[str, str]:
        """Why derivatives through a sample are refused, and what is in doubt about them; "" for
        nothing."""
        return "", ""

    @abstractmethod
    def parts(self) -> dict[str, Any]:
        """All that tells this problem from another of its kind, by name, but for the
        distributions."""


def check_names_differ(responses: Iterable[str], variables: Iterable[str]) -> None:
    """Raises `ValueError` where one name stands for a variable and a response."""
    for name in set(responses) & set(variables):
        raise ValueError(f'"{name}" names a variable and a response; give them different names.')


def how_it_ended(outcome: Any) -> str:
    """The sentence of an outcome, as the rest of a sentence."""
    said = Outcome(int(outcome)).sentence
    return f"{said[0].lower()}{said[1:]}"


def stacked(numbers: list[Any]) -> Float[Array, " numbers"]:
    """Numbers in a row, of which there may be none."""
    return jnp.stack(numbers) if numbers else jnp.zeros(0)
