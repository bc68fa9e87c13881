"""Shares of the variance of a polynomial surface, exact under the law of independent variables.

A product of polynomials of single variables is changed to products that are orthonormal under the
variables' own distributions; squares of its coefficients are then shares of the variance.

Source: Sudret 2008, Reliab. Eng. Syst. Saf. 93, 964, doi:10.1016/j.ress.2007.04.002, eq. 36 and 41.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.studies.distribution.base import LARGEST_SCORE
from jaxclear.studies.inputs import Inputs
from jaxclear.studies.surface.polynomials import Polynomials

# Scores at which the law of a variable is summed up: of smooth functions the trapezoidal rule is
# exact to rounding, of single sizes to a share of 1e-4.
SCORES = 20_001


class Variances(NamedTuple):
    """Of a surface: `mean`, `variance`, and which parts of it a variable has alone (`first`) or
    with others (`total`), (variables,); the response's unit or its square."""

    mean: float
    variance: float
    first: np.ndarray
    total: np.ndarray


class Expansion(NamedTuple):
    """How coefficients (terms,) of products of polynomials, of `powers` (terms, variables), become
    those of products that are orthonormal: by `change` (terms, terms). `outside` (variables,) is
    the share [1] of parts that lie beyond the values between which the polynomials are known."""

    powers: np.ndarray
    change: np.ndarray
    outside: np.ndarray

    @classmethod
    def of(
        cls,
        polynomials: Polynomials,
        powers: np.ndarray,
        inputs: Inputs,
        known: np.ndarray,
        held: bool = False,
    ) -> "Expansion":
        """Under the law of independent variables. `known` (values, variables) are those at which
        there were runs; `held`: beyond the outermost of them polynomials stay as they are there."""
        scores = np.linspace(-LARGEST_SCORE, LARGEST_SCORE, SCORES)
        weights = np.exp(-0.5 * scores**2)
        weights /= weights.sum()
        every = np.broadcast_to(scores[:, None], (SCORES, powers.shape[1]))
        values = np.asarray(inputs.of_scores(jnp.asarray(every)))
        inside = np.clip(values, known.min(axis=0), known.max(axis=0))
        at = np.asarray(jax.vmap(polynomials)(jnp.asarray(inside if held else values)))
        change = np.ones((len(powers), len(powers)))
        for i in range(powers.shape[1]):
            own = at[:, : powers[:, i].max() + 1, i]
            # p = lower q, with q orthonormal: moments of p are lower lower^T.
            upper: Any = np.linalg.qr(np.sqrt(weights)[:, None] * own, mode="r")
            lower = upper.T
            lower = lower * np.where(np.diag(lower) < 0, -1.0, 1.0)
            change *= lower[np.ix_(powers[:, i], powers[:, i])]
        return cls(powers, change.T, weights @ (inside != values))

    def variances(self, coefficients: np.ndarray) -> Variances:
        """Of the surface with these coefficients (terms,)."""
        own = self.change @ coefficients
        squares, there = own**2, self.powers > 0
        constant = ~there.any(axis=1)
        alone = there & (there.sum(axis=1) == 1)[:, None]
        return Variances(
            float(own[constant].sum()),
            float(squares[~constant].sum()),
            squares @ alone,
            squares @ there,
        )
