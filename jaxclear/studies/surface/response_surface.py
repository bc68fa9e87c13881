"""Polynomials that stand for responses, and how far they can be trusted."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.ground.arguments import check_name
from jaxclear.studies.answer import (
    DATASET,
    RESPONSE,
    TABLE,
    VARIABLE,
    AbstractAnswer,
    Column,
    Stated,
)
from jaxclear.studies.problem import Problem
from jaxclear.studies.surface.polynomials import Polynomials, products

# Below this leave-one-out R2 a surface does not stand for runs.
TRUSTED = 0.9


class ResponseSurface(AbstractAnswer):
    """Polynomials in the variables that stand for responses: `surface(values)` takes one set of
    values (variables,) and gives the responses by name; JAX maps and differentiates it.

    `quality` [1] is the leave-one-out R2 of each response, `degrees` its degree. `values` (runs,
    variables) and `responses` (runs,) are the runs behind it, `predictions` (runs,) what the others
    say of each; `failed` counts runs that did not reach their end and are not in it. `unreached`
    says what the sample that it was fitted to lacks of what was asked for, `warnings` of what its
    runs warn.
    """

    problem: Problem
    polynomials: Polynomials
    powers: Int[Array, "terms variables"]
    coefficients: dict[str, Float[Array, " terms"]]
    quality: dict[str, float]
    degrees: dict[str, int]
    values: np.ndarray
    responses: dict[str, np.ndarray]
    predictions: dict[str, np.ndarray]
    failed: int
    unreached: str = eqx.field(static=True, default="")
    warnings: tuple[str, ...] = eqx.field(static=True, default=())

    def __call__(self, values: Float[Array, " variables"]) -> dict[str, Array]:
        """The responses by name at one set of values; differentiable."""
        terms = products(self.polynomials, self.powers, jnp.asarray(values))
        return {name: terms @ self.coefficients[name] for name in self.problem.response_names}

    def bare(self) -> "ResponseSurface":
        """The same surface without its runs, so that a compiled program serves all refits."""
        numbers = self.polynomials, self.powers, self.coefficients
        return ResponseSurface(self.problem, *numbers, {}, {}, np.zeros((0, 0)), {}, {}, 0)

    def trusted(self, response: str) -> bool:
        """Whether the surface may stand for runs of a response."""
        check_name("response", response, self.quality, " of this surface")
        return self.quality[response] >= TRUSTED

    def error(self, response: str) -> float:
        """Root mean square of the leave-one-out errors, in the response's unit."""
        check_name("response", response, self.quality, " of this surface")
        missed = self.responses[response] - self.predictions[response]
        return float(np.sqrt(np.mean(missed**2)))

    def sentence(self) -> str:
        """From how many runs, how good for each response, and where to sample instead."""
        text = f"Surface of {len(self.problem.names)} variables from {len(self.values)} runs"
        text += f" ({self.failed} more failed and are left out)." if self.failed else "."
        for name in self.problem.response_names:
            text += f' "{name}": degree {self.degrees[name]}, leave-one-out R2 '
            # 0.99996 is not 1.
            text += f"{np.floor(1e4 * self.quality[name]) / 1e4:.4f}"
            low = f", below {TRUSTED}: the surface does not stand for runs; sample instead."
            text += "." if self.trusted(name) else low
        return f"{text} {self.unreached}".rstrip()

    def _stated(self):
        problem, over = self.problem, (RESPONSE,)
        names, units = problem.response_names, problem.units()
        read = lambda function: {name: function(name) for name in names}
        columns = {
            "unit": Column(over, read(units.get)),
            "degree": Column(over, self.degrees),
            "leave-one-out R2": Column(over, self.quality, "1", only=TABLE),
            "leave-one-out error": Column(over, read(self.error)),
            "stands for runs": Column(over, read(self.trusted)),
            "quality": Column(over, self.quality, "1", "leave-one-out R2", only=DATASET),
        }
        for i, (name, unit) in enumerate(zip(problem.names, problem.variable_units, strict=True)):
            columns[name] = Column(("run",), self.values[:, i], unit, kind=VARIABLE)
        label = "what the other runs say of it"
        for name in names:
            values, others = self.responses[name], self.predictions[name]
            columns[name] = Column(("run",), values, units[name], kind=RESPONSE)
            columns[f"{name} predicted"] = Column(("run",), others, units[name], label)
        coefficients = np.array([np.asarray(self.coefficients[name]) for name in names])
        columns["coefficient"] = Column((RESPONSE, "term"), coefficients)
        columns["power"] = Column(("term", VARIABLE), np.asarray(self.powers), "1")
        columns[VARIABLE] = Column((VARIABLE,), list(problem.names))
        numbers = {"failed": self.failed}
        return Stated("response surface", columns, problem, self.warnings, numbers)
