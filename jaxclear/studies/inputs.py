"""The joint distribution of what varies: standard normal numbers become values, and values standard
normal numbers.

Each variable follows its own distribution; how they depend on each other is a Gaussian copula: the
variables' normal scores are correlated, and each score gives its variable's deviation.
Studies draw, search and differentiate in independent standard normal numbers.

Source: Nataf's model: Der Kiureghian & Liu 1986, J. Eng. Mech. 112, 85,
doi:10.1061/(ASCE)0733-9399(1986)112:1(85).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground import array_functions as xp
from jaxclear.ground.arguments import check_name, check_number
from jaxclear.ground.array_functions import on_host
from jaxclear.ground.quantity import is_traced
from jaxclear.ground.wording import described
from jaxclear.studies.distribution import AbstractDistribution, AbstractJointDistribution
from jaxclear.studies.distribution.joint import marginals_of

# Correlation matrices whose smallest eigenvalue is below this make numbers of each other.
LEAST_EIGENVALUE = 1e-10


class Inputs(eqx.Module):
    """Joint distribution of a problem's variables, in the order of `names`.

    `nominal` (variables,) and `widths` (variables,) [1], factors by which all deviations of a
    variable are wider than its distribution says (1 as it is), are arrays that JAX may
    differentiate by. `correlation` (variables, variables) [1] is that of the normal scores, None
    where all are independent; `root` [1] is lower triangular, root root^T = correlation, and
    `inverse_root` [1] its inverse. `joints` are distributions of several numbers, each with the
    place of its first; `distributions` has the marginals of these numbers.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    distributions: tuple[AbstractDistribution, ...]
    nominal: Float[Array, " variables"]
    widths: Float[Array, " variables"]
    correlation: Float[Array, "variables variables"] | None
    root: Float[Array, "variables variables"] | None
    inverse_root: Float[Array, "variables variables"] | None
    joints: tuple[tuple[int, AbstractJointDistribution], ...] = ()

    @property
    def independent(self) -> bool:
        """Whether no two variables are correlated."""
        return self.correlation is None

    def values(
        self, normal: Float[Array | np.ndarray, "... variables"]
    ) -> Float[Array, "... variables"]:
        """Values of the variables from independent standard normal numbers [1]."""
        return self.of_scores(self.scores(normal))

    def normal(
        self, values: Float[Array | np.ndarray, "... variables"]
    ) -> Float[Array, "... variables"]:
        """Independent standard normal numbers [1] that give these values; for a discrete variable
        the middle of what gives its value."""
        deviations = (values - self.nominal) / self.widths
        scores = self._map_distributions(deviations, "score", "scores")
        return scores if self.inverse_root is None else scores @ self.inverse_root.T

    def scores(
        self, normal: Float[Array | np.ndarray, "... variables"]
    ) -> Float[Array | np.ndarray, "... variables"]:
        """Correlated standard normal scores [1] from independent ones."""
        return normal if self.root is None else normal @ self.root.T

    def of_scores(
        self, scores: Float[Array | np.ndarray, "... variables"]
    ) -> Float[Array, "... variables"]:
        """Values of the variables from their own scores [1]."""
        return self.nominal + self.widths * self._map_distributions(scores, "of_score", "of_scores")

    def _map_distributions(self, numbers: Any, alone: str, together: str) -> Any:
        """What methods of these names make of numbers (..., variables): one of the distribution of
        a single number, one of that of several."""
        parts: dict[int, Any] = {}
        for first, joint_law in self.joints:
            some = getattr(joint_law, together)(numbers[..., first : first + len(joint_law.parts)])
            parts |= {first + i: some[..., i] for i in range(len(joint_law.parts))}
        for i, distribution in enumerate(self.distributions):
            if i not in parts:
                parts[i] = getattr(distribution, alone)(numbers[..., i])
        return xp.stack([parts[i] for i in range(len(parts))], axis=-1)

    def deviations(self) -> Float[Array, " variables"]:
        """Standard deviation of each variable [its unit]."""
        return self.widths * xp.stack([d.deviation() for d in self.distributions])


def joint(
    names: Sequence[str],
    distributions: Sequence[AbstractDistribution | AbstractJointDistribution],
    nominal: Any,
    correlation: Float[Array, "variables variables"] | None = None,
) -> Inputs:
    """The joint distribution of numbers.

    Args:
        names: of the numbers.
        distributions: each of one number, or of several in a row.
        nominal: values, shape (variables,).
        correlation: of the scores; None: independent.
    """
    alone, joints = list[AbstractDistribution](), list[Any]()
    for law in distributions:
        several = isinstance(law, AbstractJointDistribution)
        joints += [(len(alone), on_host(law))] if several else []
        alone += marginals_of(law)
    root = inverse = None
    if correlation is not None:
        library = jnp if is_traced(correlation) else np
        root = library.linalg.cholesky(correlation)
        inverse = library.linalg.inv(root)
    widths, matrices = np.ones(len(names)), (correlation, root, inverse)
    numbers: Any = on_host((tuple(alone), jnp.asarray(nominal), widths, *matrices))
    # Places stay whole numbers of Python, which programs are compiled for.
    return Inputs(tuple(names), *(*numbers, tuple(joints)))


def correlation_matrix(
    correlation: Any, names: Sequence[str]
) -> Float[Array, "variables variables"] | None:
    """Correlation matrix of the variables' normal scores from what a user gives: None, a matrix in
    the order of the variables, or {("first", "second"): coefficient}. Raises `ValueError` with a
    sentence for names that there are not, and for what no variables can have."""
    if correlation is None:
        return None
    count = len(names)
    matrix = np.eye(count)
    if isinstance(correlation, Mapping):
        for pair, value in correlation.items():
            if not isinstance(pair, tuple) or len(pair) != 2 or pair[0] == pair[1]:
                raise ValueError(
                    f"correlation of a Problem has the key {described(pair)}; it must be a pair of "
                    "two variables' names."
                )
            for name in pair:
                check_name("variable", name, names, " in this problem")
            label = f'correlation of "{pair[0]}" and "{pair[1]}"'
            check_number(label, value, above=-1, below=1)
            i, j = (list(names).index(name) for name in pair)
            matrix[i, j] = matrix[j, i] = float(value)
    else:
        matrix = _check_correlation(correlation, count)
    if np.linalg.eigvalsh(matrix)[0] < LEAST_EIGENVALUE:
        raise ValueError(
            "correlation of a Problem is one that no numbers can have: its matrix is not positive "
            "definite. Weaken a coefficient, or let one variable set several numbers."
        )
    return None if np.array_equal(matrix, np.eye(count)) else jnp.asarray(matrix)


def _check_correlation(values: Any, count: int) -> np.ndarray:
    """A matrix as given, if it is one of correlations."""
    try:
        matrix = np.asarray(values, float)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    symmetric = matrix.shape == (count, count) and np.allclose(matrix, matrix.T)
    if not symmetric or not np.allclose(np.diag(matrix), 1.0):
        raise ValueError(
            f"correlation of a Problem is {described(values)}; it must be a symmetric matrix with "
            f"ones on its diagonal, {count} by {count}, or a dictionary from pairs of names."
        )
    return matrix
