"""Polynomials of several numbers that are orthonormal over a sample, and their shares of variance.

Built from the sample itself they serve any distribution, ranges and parts of a few kinds alike: a
number of which the sample holds m values has no polynomial beyond degree m - 1. Changed to products
that are orthonormal under the variables' own distributions, the squares of their coefficients are
shares of the variance, exact where variables are independent.

Source: Oladyshkin & Nowak 2012, Reliab. Eng. Syst. Saf. 106, 179, doi:10.1016/j.ress.2012.05.002;
shares: Sudret 2008, Reliab. Eng. Syst. Saf. 93, 964, doi:10.1016/j.ress.2007.04.002, eq. 36, 41.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.studies.distribution.base import LARGEST_SCORE
from jaxclear.studies.inputs import Inputs

# A polynomial whose values over the sample are this small beside those before it is none.
NOTHING = 1e-9
# More products than this no fit in memory serves.
MOST_TERMS = 20_000
# Scores at which the law of a variable is summed up: of smooth functions the trapezoidal rule is
# exact to rounding, of single sizes to a share of 1e-4. Of several numbers so many points in all.
SCORES = 20_001
POINTS_TOGETHER = 40_000


class Polynomials(eqx.Module):
    """Polynomials p_0 ... p_degree of each variable by their recurrence in the scaled variable s,

    $$ n_{k+1} p_{k+1} = (s - m_k) p_k - n_k p_{k-1}, \\quad p_0 = 1. $$

    `centre` and `scale` (variables,) in the variables' units, `middles` m and `norms` n (degree,
    variables) [1]; a norm of 0 ends a variable's polynomials.
    """

    centre: Float[Array, " variables"]
    scale: Float[Array, " variables"]
    middles: Float[Array, "degree variables"]
    norms: Float[Array, "degree variables"]

    def __call__(self, values: Float[Array, " variables"]) -> Float[Array, "terms variables"]:
        """The polynomials' values, (degree + 1, variables) [1]; differentiable."""
        s = (values - self.centre) / self.scale
        columns = [jnp.ones_like(s)]
        below, norm = jnp.zeros_like(s), jnp.zeros_like(s)
        for middle, size in zip(self.middles, self.norms, strict=True):
            raised = (s - middle) * columns[-1] - norm * below
            below, norm = columns[-1], size
            columns.append(jnp.where(size > 0, raised / jnp.where(size > 0, size, 1.0), 0.0))
        return jnp.stack(columns)


def orthonormal(values: np.ndarray, degree: int) -> Polynomials:
    """The polynomials that are orthonormal over each column of `values` (samples, variables)."""
    centre, scale = values.mean(axis=0), values.std(axis=0)
    scale = np.where(scale > NOTHING * np.maximum(abs(centre), np.finfo(float).tiny), scale, 0.0)
    s = (values - centre) / np.where(scale > 0, scale, 1.0)
    current, below, norm = np.ones_like(s) * (scale >= 0), np.zeros_like(s), np.zeros(s.shape[1])
    middles, norms = np.zeros((degree, s.shape[1])), np.zeros((degree, s.shape[1]))
    for k in range(degree):
        middles[k] = np.mean(s * current * current, axis=0)
        raised = (s - middles[k]) * current - norm * below
        size = np.sqrt(np.mean(raised * raised, axis=0))
        norms[k] = np.where((size > NOTHING) & (scale > 0), size, 0.0)
        below, norm = current, norms[k]
        current = np.where(norm > 0, raised / np.where(norm > 0, norm, 1.0), 0.0)
    scale = np.where(scale > 0, scale, 1.0)
    return Polynomials(*(jnp.asarray(part) for part in (centre, scale, middles, norms)))


def levels(polynomials: Polynomials) -> np.ndarray:
    """Highest degree that each variable has, (variables,)."""
    return np.cumprod(np.asarray(polynomials.norms) > 0, axis=0).sum(axis=0)


def powers(highest: np.ndarray, degree: int) -> np.ndarray:
    """Degrees (terms, variables) of the products of a total degree of at most `degree`, lowest
    first; no variable is beyond its own `highest` (variables,). Raises `ValueError` where they are
    too many.
    """
    result: list[dict[int, int]] = [{}]
    sums = [0]
    for variable, most in enumerate(highest):
        for place in range(len(result)):
            for power in range(1, int(min(most, degree)) + 1):
                if sums[place] + power <= degree:
                    result.append(result[place] | {variable: power})
                    sums.append(sums[place] + power)
        if len(result) > MOST_TERMS:
            raise ValueError(
                f"degree {degree} in {len(highest)} variables has more than {MOST_TERMS} terms; "
                "take a lower degree."
            )
    table = np.zeros((len(result), len(highest)), int)
    for row, term in zip(table, result, strict=True):
        row[list(term)] = list(term.values())
    return table[np.argsort(sums, kind="stable")]


def products(
    polynomials: Polynomials,
    table: Int[Array, "terms variables"],
    values: Float[Array, " variables"],
) -> Float[Array, " terms"]:
    """Products of polynomials at one set of values; differentiable.

    Args:
        polynomials: of each variable.
        table: degree in each variable, of each product.
        values: of the variables.
    """
    polynomial_values = polynomials(values)
    return jnp.prod(polynomial_values[table, jnp.arange(len(values))], axis=1)


class Expansion(NamedTuple):
    """How coefficients (terms,) of products of polynomials, of `powers` (terms, variables), become
    those of products that are orthonormal: by `change` (terms, terms). `outside` (variables,) is
    the share [1] of parts that lie beyond the values between which the polynomials are known;
    `groups` are the places of the numbers of each variable."""

    powers: np.ndarray
    change: np.ndarray
    outside: np.ndarray
    groups: tuple[range, ...]

    @classmethod
    def of(
        cls,
        polynomials: Polynomials,
        powers: np.ndarray,
        inputs: Inputs,
        points: np.ndarray,
        groups: tuple[range, ...],
        is_clipped: bool = False,
    ) -> "Expansion":
        """Coefficients of orthonormal products under the law of independent variables.

        Args:
            polynomials: of each variable.
            powers: degree in each variable of each product, shape (terms, variables).
            inputs: joint distribution of the variables.
            points: values at which there were runs, shape (values, variables).
            groups: columns of the numbers of each variable.
            is_clipped: whether polynomials are constant beyond the outermost points.
        """
        scores = np.linspace(-LARGEST_SCORE, LARGEST_SCORE, SCORES)
        weights = np.exp(-0.5 * scores**2)
        weights /= weights.sum()
        every = np.broadcast_to(scores[:, None], (SCORES, powers.shape[1]))

        def law(scores):
            values = np.asarray(inputs.of_scores(scores))
            inside = np.clip(values, points.min(axis=0), points.max(axis=0))
            at = np.asarray(jax.vmap(polynomials)(jnp.asarray(inside if is_clipped else values)))
            return inside != values, at

        beyond, at = law(every)
        outside = weights @ beyond
        change = np.ones((len(powers), len(powers)))
        for group in groups:
            group_powers = powers[:, list(group)]
            if len(group) == 1:
                rows, which = at[:, : group_powers.max() + 1, group[0]], group_powers[:, 0]
                shares = weights
            else:
                # All products of the numbers that act together, the lowest first.
                scores, shares = _joint_grid(len(group), list(group), powers.shape[1])
                beyond, there = law(scores)
                outside[list(group)] = shares @ beyond[:, list(group)]
                table = np.unique(group_powers, axis=0)
                table = table[np.argsort(table.sum(axis=1), kind="stable")]
                which = np.argmax((group_powers[:, None] == table).all(axis=2), axis=1)
                rows = np.prod(there[:, table, np.array(group)], axis=2)
            # p = lower q, with q orthonormal: moments of p are lower lower^T.
            upper: Any = np.linalg.qr(np.sqrt(shares)[:, None] * rows, mode="r")
            lower = upper.T
            lower = lower * np.where(np.diag(lower) < 0, -1.0, 1.0)
            change *= lower[np.ix_(which, which)]
        return cls(powers, change.T, outside, groups)

    def variances(self, coefficients: np.ndarray) -> tuple[float, float, Any, Any]:
        """Of the surface with these coefficients (terms,): mean, variance, and which parts of it a
        variable has alone or with others, (groups,); the response's unit or its square."""
        transformed = self.change @ coefficients
        squares = transformed**2
        there = np.stack([self.powers[:, list(g)].any(axis=1) for g in self.groups], axis=1)
        constant = ~there.any(axis=1)
        alone = there & (there.sum(axis=1) == 1)[:, None]
        mean, variance = transformed[constant].sum(), squares[~constant].sum()
        return float(mean), float(variance), squares @ alone, squares @ there


def _joint_grid(count: int, columns: list[int], variables: int) -> tuple[np.ndarray, np.ndarray]:
    """Scores (points, variables), of which those of some columns are on a grid, and the share [1]
    of each point."""
    one = np.linspace(-LARGEST_SCORE, LARGEST_SCORE, round(POINTS_TOGETHER ** (1 / count)) | 1)
    grid = np.stack(np.meshgrid(*[one] * count, indexing="ij"), axis=-1).reshape(-1, count)
    weights = np.exp(-0.5 * np.sum(grid**2, axis=1))
    scores = np.zeros((len(grid), variables))
    scores[:, columns] = grid
    return scores, weights / weights.sum()
