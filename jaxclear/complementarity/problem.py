r"""What a complementarity problem is, and what its solution says of itself.

Linear problems ask for z with 0 <= z ⟂ w >= 0 (no entry negative, and of each pair z_i, w_i at
least one zero) and w = M z + q (LCP), or N w = M z + q (horizontal LCP). One problem has no batch
axis: map `solve` with `jax.vmap`. Solvers are frozen settings; whether a problem has a solution is
told by an `Outcome`, never by an exception. Source: Cottle, Pang & Stone 2009, The Linear
Complementarity Problem, doi:10.1137/1.9780898719000, sections 1.1 and 1.5.
"""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxclear.ground.outcome import AbstractOutcome
from jaxclear.ground.printing import AbstractShown
from jaxclear.ground.quantity import AbstractQuantified, lenient_converter
from jaxclear.ground.wording import described


class Outcome(AbstractOutcome):
    """How a solve ended. `Outcome(code).sentence` says it; only `SOLVED` (0) is a success."""

    SOLVED = 0, "The problem is solved to the solver's tolerance."
    RAY = (
        1,
        "The path ended on a ray: there is no solution if the matrix is copositive-plus (positive "
        "semidefinite, say); otherwise this path finds none.",
    )
    LIMIT = 2, "The allowed number of iterations was used up."
    STALLED = (
        3,
        "No step lowers the residual any further: there is no solution nearby, or the data are too "
        "ill-conditioned.",
    )
    NOT_FINITE = (
        4,
        "The data, or what follows from them, are infinite, not a number or out of range.",
    )


def as_floats(value: Any) -> Float[Array, "..."]:
    """A float64 array; `ValueError` for what is no array of numbers."""
    try:
        return jnp.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"expected an array of numbers, got {described(value)}.") from error


def check_shapes(owner: str, expected: dict[str, tuple[Any, tuple[int, ...]]]) -> None:
    """Raises `ValueError` where an array has not the expected shape; for each name (array,
    shape)."""
    for name, (array, shape) in expected.items():
        if not isinstance(array, jax.Array):
            raise ValueError(
                f"{name} of {owner} is {described(array)}; it must be an array of numbers."
            )
        if jnp.shape(array) != shape:
            raise ValueError(
                f"{name} of {owner} has shape {jnp.shape(array)}; it must be {shape}. Build and "
                "solve batches under jax.vmap."
            )
        if 0 in shape:
            raise ValueError(f"{name} of {owner} is empty: leave out what has no unknowns.")


def natural_residual(z: Float[Array, " n"], w: Float[Array, " n"]) -> Float[Array, ""]:
    """Largest entry of the natural map, max |min(z, w)|: zero exactly at 0 <= z ⟂ w >= 0.

    Args:
        z, w: arrays (n,) [their units].

    Returns:
        the largest entry.
    """
    return jnp.max(jnp.abs(jnp.minimum(z, w)))


# Solutions larger than the data (scaled to 1) carry rounding in proportion; beyond this size it is
# not excused.
LARGEST_EXCUSED = 1e4


def residual_size(z: Float[Array, "..."]) -> Float[Array, ""]:
    """What a scaled residual is measured by: 1, or the size of a large solution."""
    return jnp.clip(jnp.max(jnp.abs(z)), 1.0, LARGEST_EXCUSED)


class Solution(AbstractShown):
    """What a solver returns.

    Where the outcome is not `SOLVED`, z is the last finite iterate and its derivative is zero.

    Args:
        z: unknowns, an array (n,) [as the problem's z].
        w: what they are complementary to, an array (n,) [as the problem's w].
        residual: how far they are from a solution [the larger of the two units].
        outcome: code of an `Outcome`.
        iterations: iterations taken, a count.
    """

    z: Float[Array, " n"]
    w: Float[Array, " n"]
    residual: Float[Array, ""]
    outcome: Int[Array, ""]
    iterations: Int[Array, ""]

    @property
    def solved(self) -> Bool[Array, ""]:
        """Whether the solver's tolerance was met."""
        return self.outcome == Outcome.SOLVED

    def _summary(self):
        return self.sentence()

    def sentence(self) -> str:
        """How the solve ended; for a batch, how many ended how."""
        codes, counts = np.unique(np.asarray(self.outcome), return_counts=True)
        if np.ndim(self.outcome) == 0:
            return Outcome(int(codes[0])).sentence
        ends = zip(codes, counts, strict=True)
        return " ".join(f"{n} of {counts.sum()}: {Outcome(int(k)).sentence}" for k, n in ends)


class AbstractProblem(AbstractQuantified):
    """A complementarity problem: unknowns z, what they must be complementary to, w."""

    @abstractmethod
    def residual(self, z: Float[Array, " m"], w: Float[Array, " m"]) -> Float[Array, ""]:
        """How far (z, w) is from a solution; zero exactly there.

        Args:
            z: unknowns, an array (m,) [unit of z].
            w: what they are complementary to, an array (m,) [unit of w].

        Returns:
            the residual, in the data's units.
        """


class AbstractLinearProblem(AbstractProblem):
    """A problem with the solutions of an LCP, which `InteriorPoint` solves."""

    @abstractmethod
    def to_lcp(self) -> "LCP":
        """The LCP with the same solutions.

        Raises:
            ValueError: if there is none.
        """

    @abstractmethod
    def from_lcp(self, z: Float[Array, " n"]) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        """This problem's (z, w) for a solution of its LCP.

        Args:
            z: unknowns of the LCP, an array (n,).

        Returns:
            z and w of this problem, two arrays (m,).
        """


class AbstractSolver(AbstractQuantified):
    """Solves complementarity problems: frozen settings, no state."""

    @abstractmethod
    def solve(self, problem: Any) -> Solution:
        """Solve one problem.

        The function is pure, so it maps, compiles and differentiates. Values that cannot be solved
        end in an outcome.

        Args:
            problem: a problem of the solver's kind.

        Returns:
            the `Solution`.

        Raises:
            ValueError: if it is no problem of the solver's kind.
        """


class LCP(AbstractLinearProblem):
    """A linear complementarity problem: w = M z + q with 0 <= z ⟂ w >= 0.

    Args:
        matrix: M, an array (n, n) [unit of w per unit of z].
        offset: q, an array (n,) [unit of w].

    Raises:
        ValueError: if shapes do not fit.
    """

    matrix: Float[Array, "n n"] = eqx.field(converter=lenient_converter(as_floats))
    offset: Float[Array, " n"] = eqx.field(converter=lenient_converter(as_floats))

    def __check_init__(self):
        n = getattr(self.offset, "size", 0)
        check_shapes("an LCP", {"offset": (self.offset, (n,)), "matrix": (self.matrix, (n, n))})

    def to_lcp(self):
        return self

    def from_lcp(self, z):
        return z, self.matrix @ z + self.offset

    def residual(self, z, w):
        mismatch = jnp.max(jnp.abs(self.matrix @ z + self.offset - w))
        return jnp.maximum(natural_residual(z, w), mismatch)


class HorizontalLCP(AbstractLinearProblem):
    """A horizontal complementarity problem: N w = M z + q with 0 <= z ⟂ w >= 0 and a regular N.

    Args:
        w_matrix: N, an array (n, n) [unit of q per unit of w].
        z_matrix: M, an array (n, n) [unit of q per unit of z].
        offset: q, an array (n,) [its own unit].

    Raises:
        ValueError: if shapes do not fit.
    """

    w_matrix: Float[Array, "n n"] = eqx.field(converter=lenient_converter(as_floats))
    z_matrix: Float[Array, "n n"] = eqx.field(converter=lenient_converter(as_floats))
    offset: Float[Array, " n"] = eqx.field(converter=lenient_converter(as_floats))

    def __check_init__(self):
        n = getattr(self.offset, "size", 0)
        expected = {
            "offset": (self.offset, (n,)),
            "w_matrix": (self.w_matrix, (n, n)),
            "z_matrix": (self.z_matrix, (n, n)),
        }
        check_shapes("a HorizontalLCP", expected)

    def to_lcp(self):
        right = jnp.concatenate([self.z_matrix, self.offset[:, None]], 1)
        solved = jnp.linalg.solve(self.w_matrix, right)
        return LCP(solved[:, :-1], solved[:, -1])

    def from_lcp(self, z):
        return z, jnp.linalg.solve(self.w_matrix, self.z_matrix @ z + self.offset)

    def residual(self, z, w):
        mismatch = jnp.max(jnp.abs(self.w_matrix @ w - self.z_matrix @ z - self.offset))
        return jnp.maximum(natural_residual(z, w), mismatch)


def as_linear_problem(problem: AbstractLinearProblem) -> LCP:
    """The problem as an LCP. Raises `ValueError` for what is no linear problem."""
    if not isinstance(problem, AbstractLinearProblem):
        kind = type(problem).__name__
        raise ValueError(
            f"a solver is given a {kind}; it takes a problem, such as complementarity.LCP(matrix, "
            "offset)."
        )
    return problem.to_lcp()
