"""What is done with a sample: a run, positions, a function, a life, or an experiment of one's own.

A study sees a `Problem`, which knows what varies, and never asks what lies behind it. What differs
between kinds of experiments each says of itself, in five methods: `evaluate`, `refine`, `cost`,
`describe` and `detail`.
"""

import dataclasses
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground.quantity import AbstractQuantified
from jaxclear.integrators import Outcome
from jaxclear.integrators.checks import Check, Checks
from jaxclear.native import stoppable
from jaxclear.studies.distribution import (
    AbstractDistribution,
    AbstractJointDistribution,
    TruncatedNormal,
)

# Samples come in multiples of these, copies of the last one where there are fewer.
LANES = 8
# All parts of a run that its warnings may concern.
PARTS = frozenset(check.concerns for check in Check)


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
        return {name: np.where(reached, values, np.nan) for name, values in self.responses.items()}


class AbstractVariable(AbstractQuantified):
    """A number that varies about its nominal value, and its distribution about it; by an
    `AbstractJointDistribution` several numbers, (parts,), that act together under one name. What it
    is a number of is the `subject` of an experiment: a mechanism, or a dictionary of numbers."""

    distribution: eqx.AbstractVar[AbstractDistribution | AbstractJointDistribution]

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the numbers of a variable of several; () for one number."""
        distribution = self.distribution
        return distribution.parts if isinstance(distribution, AbstractJointDistribution) else ()

    @abstractmethod
    def nominal_in(self, subject: Any) -> Any:
        """Its nominal value.

        Args:
            subject: the mechanism, or a dictionary of numbers.
        """

    @abstractmethod
    def unit_in(self, subject: Any) -> str:
        """Its unit.

        Args:
            subject: the mechanism, or a dictionary of numbers.
        """

    @abstractmethod
    def put(self, name: str, subject: Any, value: Any) -> Any:
        """The subject with its numbers set.

        Args:
            name: of the variable, a text.
            subject: the mechanism, or a dictionary of numbers.
            value: of the variable [its unit].
        """

    @abstractmethod
    def identity(self, name: str, subject: Any) -> dict[str, Any]:
        """All that tells it from another, but for its distribution.

        Args:
            name: of the variable, a text.
            subject: the mechanism, or a dictionary of numbers.
        """

    def followed(self, subject: Any, value: Any) -> Any:
        """The subject, all of whose variables are set, with what follows from this one.

        Args:
            subject: the mechanism, or a dictionary of numbers.
            value: of the variable [its unit].
        """
        return subject


class AbstractFreeVariable(AbstractVariable):
    """A variable that is no number of the subject, and so has a nominal value and a unit itself."""

    nominal: eqx.AbstractVar[Any]
    unit: eqx.AbstractVar[str]

    def nominal_in(self, subject):
        return self.nominal

    def unit_in(self, subject):
        return self.unit

    def put(self, name, subject, value):
        return subject


class Setting(eqx.Module):
    """Values of a problem's variables: `setting(subject)` is a mechanism with them, or a dictionary
    of numbers."""

    names: tuple[str, ...] = eqx.field(static=True)
    variables: tuple[AbstractVariable, ...]
    values: Float[Array, " variables"]

    def __call__(self, subject: Any) -> Any:
        """The subject with all variables set, and what follows from them; pure."""
        numbers, each = list(self.values), list[Any]()
        for name, variable in zip(self.names, self.variables, strict=True):
            count = len(variable.parts)
            value = jnp.stack(numbers[:count]) if count else numbers[0]
            numbers = numbers[max(count, 1) :]
            each.append((name, variable, value))
        for name, variable, value in each:
            subject = variable.put(name, subject, value)
        for _, variable, value in each:
            subject = variable.followed(subject, value)
        return subject


# Samples of a batch where each costs next to nothing.
NEGLIGIBLE = 1024


class Cost(NamedTuple):
    """What a sample costs.

    Args:
        memory: that it takes while it is computed, roughly [bytes].
        batch: the largest number of samples that are best computed together, a count.
        compiled: an option, whether it is one compiled program; else each is computed by itself,
            with numbers.
        cheap: an option, whether it costs no more than what would be fitted to stand in for it.
        idle: the experiment of the same program on as little work as possible; None where it is so
            little.
    """

    memory: int
    batch: int
    compiled: bool = True
    cheap: bool = False
    idle: "AbstractExperiment | None" = None

    @property
    def is_negligible(self) -> bool:
        """Whether so many are best computed together that its own slopes are searched, those of
        thousands of samples at once; of others a surface takes fewer samples."""
        return self.cheap and self.batch >= NEGLIGIBLE


class ResponseInfo(NamedTuple):
    """What is known of a response.

    Args:
        unit: a text.
        depends_on: names of the parts of a run whose warnings concern it.
        promise: the largest error of its mean that counts as right, in its unit and as a share of
            its root mean square [1], of which the larger counts; None where nothing is promised.
        remedy: a text, what brings that error down.
        infinite: a text, what it says of a sample that the response is infinite, as that "it is not
            reached within 1e6 cycles"; "" where such a sample has failed.
        horizon: the largest value that is told [its unit]; what is more is infinite.
    """

    unit: str = "1"
    depends_on: frozenset[str] = PARTS
    promise: tuple[float, float] | None = None
    remedy: str = "refine its steps"
    infinite: str = ""
    horizon: float = float("inf")

    def tolerance(self, size: float) -> float | None:
        """The largest error of its mean with which a response of this `size` (root mean square)
        counts as right, in its unit; None where nothing is promised.

        Args:
            size: in the unit of the response [its unit].
        """
        return None if self.promise is None else max(self.promise[0], self.promise[1] * size)


def how_it_ended(outcome: Any) -> str:
    """The sentence of an outcome, as the rest of a sentence."""
    sentence = Outcome(int(outcome)).sentence
    return f"{sentence[0].lower()}{sentence[1:]}"


class Description(NamedTuple):
    """What is known of an experiment before any sample is computed.

    Args:
        title: a text, what is done with a sample.
        responses: what is known of each response, by name, in their order.
        endings: texts by `Outcome`, how such a sample ended, as the rest of a sentence that begins
            with its values, `{ended}` for when; the sentence of the outcome where there is none.
        discretised: an option, whether its numbers are off by something that could be refined, as
            steps of a run.
        warnings: a text for what is off in all samples alike.
        remark: a text, what a user should know of how samples are computed.
        derivative: two texts, why derivatives through a sample are refused, and what is in doubt
            about them; "" for nothing.
    """

    title: str
    responses: Mapping[str, ResponseInfo]
    endings: Mapping[Outcome, str] = {}
    discretised: bool = False
    warnings: tuple[str, ...] = ()
    remark: str = ""
    derivative: tuple[str, str] = ("", "")

    def ending(self, outcome: Any, ended: Any) -> str:
        """How a sample ended, as the rest of a sentence that begins with its values.

        Args:
            outcome: of the sample, an `Outcome` or its number.
            ended: when it ended [s, or cycles].
        """
        code = Outcome(int(outcome))
        return self.endings.get(code, how_it_ended(code)).format(ended=float(ended))


def derived(**how: Any) -> Any:
    """A field that follows from others: it does not tell one experiment from another."""
    return eqx.field(metadata={"derived": True}, **how)


class AbstractExperiment(AbstractQuantified):
    """What is done with a sample, and the responses wanted of it. Fields but for `derived` ones
    tell it from another of its kind."""

    response_names: eqx.AbstractVar[tuple[str, ...]]

    @property
    def subject(self) -> Any:
        """What variables set numbers of: a mechanism; by default an empty dictionary, into which
        each puts its own by name."""
        return {}

    def with_values(self, setting: Setting) -> Any:
        """The subject with its variables set.

        Args:
            setting: values of the variables.
        """
        return setting(self.subject)

    @abstractmethod
    def evaluate(self, setting: Setting, *, discrete_derivatives: bool = False) -> SampleResult:
        """The responses for one setting; pure where `cost().compiled`: JAX may map, compile and
        differentiate it. A derivative that is not that of the responses raises `ValueError`.

        Args:
            setting: values of the variables; `setting(subject)` is the subject with them.
            discrete_derivatives: an option, whether what the steps of a run have for a derivative
                is passed on.
        """

    @abstractmethod
    def cost(self) -> Cost:
        """What a sample costs."""

    @abstractmethod
    def describe(self) -> Description:
        """What is known before any sample is computed."""

    def refine(self, share: float = 0.5) -> "AbstractExperiment | None":
        """The same with all that discretises it refined; None where nothing is discretised, or it
        cannot be refined. Of the same structure wherever that is enough: a study then runs it by
        its own compiled program.

        Args:
            share: of the length of steps [1], between 0 and 1.
        """
        return None

    def on_wider_cells(self) -> "AbstractExperiment | None":
        """The same on cells of worn surfaces twice as wide; None where no response reads them."""
        return None

    def errors_of_cells(self, result: SampleResult, wider: SampleResult) -> dict[str, Array]:
        """By response that reads cells how much it is too large by them, (samples,), in its unit.

        Args:
            result: result of samples.
            wider: result of the same on wider cells.
        """
        return {}

    def detail(self, setting: Setting, index: int, chunk: int) -> Any:
        """All there is to be seen of one sample of a study.

        Args:
            setting: values of its variables.
            index: of the sample in its study, an integer.
            chunk: samples that are computed together there, a count.
        """
        return self.evaluate(setting)

    def parts(self) -> dict[str, Any]:
        """All that tells it from another of its kind, by name."""
        names = [f.name for f in dataclasses.fields(self) if not f.metadata.get("derived")]
        return {name: getattr(self, name) for name in names}


def one_distribution(owner: str, distribution: Any, tolerance: Any) -> Any:
    """The given distribution, or that of a tolerance t: normal with 3 standard deviations in t.

    The normal one is cut off at +-t.

    Args:
        owner: class in the message.
        distribution: of the deviation; None: by tolerance.
        tolerance: t, in the unit of the number, > 0; None: by distribution.

    Raises:
        ValueError: both or neither is given.
    """
    if distribution is not None and tolerance is None:
        return distribution
    if tolerance is not None and distribution is None:
        return TruncatedNormal(tolerance / 3, bound=tolerance)
    raise ValueError(
        f"a {owner} takes a distribution or a tolerance; give one of the two, not both or neither."
    )


def check_names_differ(responses: Iterable[str], variables: Iterable[str]) -> None:
    """Raises `ValueError` where one name stands for a variable and a response."""
    for name in set(responses) & set(variables):
        raise ValueError(f'"{name}" names a variable and a response; give them different names.')


@eqx.filter_jit
def _mapped(function: Callable[[Any], Any], setting: Any, values: Any) -> Any:
    setting_of = lambda row: eqx.tree_at(lambda one: one.values, setting, row)
    return jax.vmap(lambda row: function(setting_of(row)))(values)


def sample_of_chunk(
    function: Callable[[Setting], Any], setting: Setting, index: int, chunk: int
) -> Any:
    """What a function gives for one sample of a study in chunks, bit for bit as it was there.

    The sample is computed in the same lane of the same kernel, between copies of itself.

    Args:
        function: of a setting, a method of an experiment.
        setting: values of the sample.
        index: of the sample in the study.
        chunk: samples of a chunk.
    """
    with stoppable():
        results = _mapped(function, setting, jnp.tile(setting.values, (chunk, 1)))
        return jax.tree.map(lambda leaf: leaf[index % chunk], jax.block_until_ready(results))
