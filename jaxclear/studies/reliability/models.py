"""What the searches and samplings ask: margins of limits at standard normal numbers, from runs or
from a surface.

Runs are counted, with those that did not reach their end: where nobody knows whether a part fails,
it counts as failing, and is told.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground.printing import with_text_repr
from jaxclear.studies.experiment import SampleResult
from jaxclear.studies.infinite_responses import successes
from jaxclear.studies.limit_state import AbstractLimitState
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_warnings import codes_of, sentences
from jaxclear.studies.sampling import all_values, value_slopes
from jaxclear.studies.statistics.scrambled import student
from jaxclear.studies.store.batch import chunk_size, evaluate_all
from jaxclear.studies.surface.response_surface import ResponseSurface

# Runs that are computed together, so that all rounds share one compiled program.
ROUND = 256


class AbstractModel(ABC):
    """Margins of the limits in z, the standard normal numbers behind the variables."""

    @abstractmethod
    def margins(self, normal: np.ndarray) -> np.ndarray:
        """Margins (samples, limits) at `normal` (samples, variables); nan where a run failed."""

    @abstractmethod
    def slopes(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Margins (samples, limits) and their slopes (samples, limits, variables)."""


@dataclass
class RunModel(AbstractModel):
    """Margins by runs of a problem. `runs` counts them, one with slopes as one for each variable
    more; `failed` those that did not reach their end; `codes` (those that did,): of what they
    warn."""

    problem: Problem
    limit: AbstractLimitState
    progress_bar: bool = False
    label: str = "runs"
    runs: int = 0
    failed: int = 0
    codes: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))

    def responses(self, normal: np.ndarray) -> tuple[np.ndarray, SampleResult]:
        """Values (samples, variables) and what their runs give."""
        values = all_values(self.problem, normal)
        result = evaluate_all(
            self.problem,
            jnp.asarray(values),
            chunk=chunk_size(self.problem, ROUND),
            progress_bar=self.progress_bar,
            label=self.label,
        )
        self.runs += len(normal)
        return values, result

    def margins(self, normal):
        return self.of(self.responses(normal)[1])

    def slopes(self, normal):
        values = jnp.asarray(all_values(self.problem, normal))
        runs: Any = evaluate_all(
            self.problem, values, function=_with_slopes, chunk=len(normal), label="surface"
        )
        gradients, result = runs
        self.runs += len(normal) * (1 + normal.shape[1])
        through = value_slopes(self.problem, normal)
        steep = [
            _sign_of_margin(part) * np.einsum("kv,kvz->kz", gradients[part.response], through)
            for part in self.limit.limits()
        ]
        return self.of(result), np.stack(steep, axis=1)

    def of(self, result: SampleResult) -> np.ndarray:
        """Margins (samples, limits) of runs, infinite where a response is and that is an answer;
        nan where one did not reach its end."""
        y = {name: np.asarray(r, float) for name, r in result.responses.items()}
        margins = np.stack([np.asarray(limit.margin(y)) for limit in self.limit.limits()], axis=1)
        limited = {limit.response: y[limit.response] for limit in self.limit.limits()}
        good, _ = successes(self.problem, result.outcome, limited)
        self.failed += int((~good).sum())
        self.codes = np.concatenate([self.codes, codes_of(result.checks, len(good))[good]])
        return np.where(good[:, None], margins, np.nan)

    def warnings(self) -> tuple[str, ...]:
        """How many runs warn of what concerns the limited responses."""
        limited = [part.response for part in self.limit.limits()]
        return sentences(self.problem, self.codes, limited)


@dataclass(frozen=True)
class SurfaceModel(AbstractModel):
    """Margins by a surface; costs no run."""

    surface: ResponseSurface
    limit: AbstractLimitState

    @property
    def problem(self) -> Problem:
        return self.surface.problem

    def margins(self, normal):
        return np.asarray(
            _surface_margins(self.surface.bare(), self.limit.limits(), jnp.asarray(normal))
        )

    def slopes(self, normal):
        both = _surface_slopes(self.surface.bare(), self.limit.limits(), jnp.asarray(normal))
        return np.asarray(both[0]), np.asarray(both[1])


@eqx.filter_jit
def _with_slopes(problem: Problem, values: Float[Array, "samples variables"]):
    """Slopes of the responses of a chunk of samples, (samples, variables), and the outcomes."""

    def one(row):
        def responses(at):
            result = problem.evaluate(at)
            return result.responses, result

        return jax.jacfwd(responses, has_aux=True)(row)

    return jax.vmap(one)(values)


def _sign_of_margin(limit: Any) -> float:
    """How a margin moves with its response."""
    return float(limit.margin({limit.response: 1.0}) - limit.margin({limit.response: 0.0}))


def _margins_function(surface, limits):
    def margins(z):
        responses = surface(surface.problem.inputs.values(z))
        return jnp.stack([limit.margin(responses) for limit in limits])

    return margins


@eqx.filter_jit
def _surface_margins(surface, limits, normal):
    return jax.lax.map(_margins_function(surface, limits), normal, batch_size=1024)


@eqx.filter_jit
def _surface_slopes(surface, limits, normal):
    margins = _margins_function(surface, limits)
    return jax.vmap(lambda z: (margins(z), jax.jacfwd(margins)(z)))(normal)


@with_text_repr
class Probability(NamedTuple):
    """Probability of failing [1] by one method. `variation` is its coefficient of variation, the
    standard error over the value; nan where a method does not know its own error. It is that of
    `blocks` independent estimates, which cost `runs`; `failed` of these did not reach their end and
    count as failing, with a share `unknown` [1] of the probability. `refusal` says why a method has
    no answer."""

    value: float
    variation: float = np.nan
    runs: int = 0
    failed: int = 0
    unknown: float = 0.0
    blocks: int = 0
    refusal: str = ""

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval, (low, high); nan where the error is not known."""
        if not np.isfinite(self.variation) or self.blocks < 2:
            return np.nan, np.nan
        width = student(self.blocks) * self.variation * self.value
        return max(self.value - width, 0.0), min(self.value + width, 1.0)

    def __str__(self) -> str:
        if self.refusal:
            return f"no answer: {self.refusal}"
        low, high = self.interval
        ends = f", 95 %: {low:.3g} to {high:.3g}" if np.isfinite(low) else ", its error not known"
        return f"{self.value:.3g} ({self.runs} runs{ends})"


def refused(why: str, runs: int = 0, failed: int = 0) -> Probability:
    """A probability without a value, with the reason.

    Args:
        why: sentence for the user.
        runs, failed: numbers of runs, and of those that failed.
    """
    return Probability(np.nan, runs=runs, failed=failed, refusal=why)
