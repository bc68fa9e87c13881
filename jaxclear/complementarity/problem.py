"""What a complementarity problem is, what its solution says of itself, and how a solution moves
with its data.

Linear problems: find z with 0 <= z perp w >= 0 and w = M z + q (LCP), with unknowns of either sign
beside them (mixed), or with N w = M z + q (horizontal). All become an LCP by elimination; solvers
see it scaled to entries near 1, so that no tolerance has a unit. One problem has no batch axis: map
`solve` with `jax.vmap`. Source: Cottle, Pang & Stone 2009, The Linear Complementarity Problem
(SIAM), sections 1.1 and 1.5.
"""

from abc import abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

# Outcomes of a solve; `Solution.sentence()` says them.
OUTCOMES = (
    "The problem is solved to the solver's tolerance.",
    "The path ended on a ray: there is no solution if the matrix is copositive-plus (positive "
    "semidefinite, say); "
    "otherwise this path finds none.",
    "The allowed number of iterations was used up.",
    "No step lowers the residual any further: there is no solution nearby, or the data are too "
    "ill-conditioned.",
    "The data, or what follows from them, are infinite, not a number or out of range.",
)
SOLVED, RAY, LIMIT, STALLED, NOT_FINITE = range(5)

# A scaled solution whose scaled residual is below this counts as exact; sixteen digits less those
# lost in a small system.
EXACT = 1e-12
# Solutions larger than the data (scaled to 1) carry rounding in proportion; beyond this size it is
# not excused.
LARGEST_EXCUSED = 1e4
# Passes that bring the largest entry of every row and column near 1 (Ruiz 2001, RAL-TR-2001-034:
# errors halve each pass).
SCALING_PASSES = 3
# A scaled z_i above w_i by less than this is a corner (z_i = w_i = 0): there, z_i is taken to stay
# zero.
CORNER = 1e-9
# Singular values below this share of the largest are redundancy, not stiffness.
REDUNDANT = 1e-11


def as_floats(value: Any) -> Float[Array, "..."]:
    """A float64 array; `ValueError` for what is no array of numbers."""
    try:
        return jnp.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"expected an array of numbers, got {type(value).__name__}.") from error


def check_shapes(owner: str, expected: dict[str, tuple[Any, tuple[int, ...]]]) -> None:
    """Raises `ValueError` where an array has not the expected shape; for each name (array,
    shape)."""
    for name, (array, shape) in expected.items():
        if jnp.shape(array) != shape:
            raise ValueError(
                f"{name} of {owner} has shape {jnp.shape(array)}; it must be {shape}. Build and "
                "solve batches under jax.vmap."
            )
        if 0 in shape:
            raise ValueError(f"{name} of {owner} is empty: leave out what has no unknowns.")


def natural_residual(z: Float[Array, " n"], w: Float[Array, " n"]) -> Float[Array, ""]:
    """max |min(z, w)|: zero exactly at z >= 0, w >= 0, z w = 0; in the units of the data."""
    return jnp.max(jnp.abs(jnp.minimum(z, w)))


from jaxclear.ground.quantity import AbstractQuantified


class Solution(eqx.Module):
    """What a solver hands back. Where the outcome is not 0, z is the last finite iterate and its
    derivative is zero.
    """

    z: Float[Array, " n"]
    w: Float[Array, " n"]
    residual: Float[Array, ""]
    outcome: Int[Array, ""]
    iterations: Int[Array, ""]

    @property
    def solved(self) -> Bool[Array, ""]:
        """Whether the solver's tolerance was met."""
        return self.outcome == SOLVED

    def __str__(self) -> str:
        return self.sentence()

    def sentence(self) -> str:
        """How the solve ended; for a batch, how many ended how."""
        codes, counts = np.unique(np.asarray(self.outcome), return_counts=True)
        if np.ndim(self.outcome) == 0:
            return OUTCOMES[int(codes[0])]
        return " ".join(
            f"{count} of {counts.sum()}: {OUTCOMES[code]}"
            for code, count in zip(codes, counts, strict=True)
        )


class AbstractProblem(eqx.Module):
    """A complementarity problem: how to pose it as an LCP, and how to read its own unknowns from
    the LCP's.
    """

    @abstractmethod
    def to_lcp(self) -> "LCP":
        """The LCP with the same solutions."""

    @abstractmethod
    def from_lcp(self, z: Float[Array, " n"]) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        """This problem's (z, w) for a solution z of its LCP."""

    @abstractmethod
    def residual(self, z: Float[Array, " m"], w: Float[Array, " m"]) -> Float[Array, ""]:
        """How far (z, w) is from a solution, in the data's units."""


class LCP(AbstractProblem):
    """0 <= z perp w = M z + q >= 0."""

    matrix: Float[Array, "n n"] = eqx.field(converter=as_floats)
    offset: Float[Array, " n"] = eqx.field(converter=as_floats)

    def __check_init__(self):
        n = jnp.size(self.offset)
        check_shapes("an LCP", {"offset": (self.offset, (n,)), "matrix": (self.matrix, (n, n))})

    def to_lcp(self):
        return self

    def from_lcp(self, z):
        return z, self.matrix @ z + self.offset

    def residual(self, z, w):
        return jnp.maximum(
            natural_residual(z, w), jnp.max(jnp.abs(self.matrix @ z + self.offset - w))
        )

    def to_horizontal(self) -> "HorizontalLCP":
        """The same problem as N w = M z + q with N = 1."""
        return HorizontalLCP(jnp.eye(self.offset.shape[0]), self.matrix, self.offset)


class MixedLCP(AbstractProblem):
    """A u + C z + a = 0 with u free, and 0 <= z perp w = D u + B z + b >= 0; A must be regular.

    Unknown accelerations or multipliers u beside contact forces z. `free(z)` gives u.
    """

    free_matrix: Float[Array, "m m"] = eqx.field(converter=as_floats)
    free_to_z: Float[Array, "m n"] = eqx.field(converter=as_floats)
    free_offset: Float[Array, " m"] = eqx.field(converter=as_floats)
    w_to_free: Float[Array, "n m"] = eqx.field(converter=as_floats)
    matrix: Float[Array, "n n"] = eqx.field(converter=as_floats)
    offset: Float[Array, " n"] = eqx.field(converter=as_floats)

    def __check_init__(self):
        m, n = jnp.size(self.free_offset), jnp.size(self.offset)
        expected = {
            "free_offset": (self.free_offset, (m,)),
            "offset": (self.offset, (n,)),
            "free_matrix": (self.free_matrix, (m, m)),
            "free_to_z": (self.free_to_z, (m, n)),
            "w_to_free": (self.w_to_free, (n, m)),
            "matrix": (self.matrix, (n, n)),
        }
        check_shapes("a MixedLCP", expected)

    def free(self, z: Float[Array, " n"]) -> Float[Array, " m"]:
        """The free unknowns u that belong to z."""
        return -jnp.linalg.solve(self.free_matrix, self.free_to_z @ z + self.free_offset)

    def to_lcp(self):
        right = jnp.concatenate([self.free_to_z, self.free_offset[:, None]], 1)
        eliminated = self.w_to_free @ jnp.linalg.solve(self.free_matrix, right)
        return LCP(self.matrix - eliminated[:, :-1], self.offset - eliminated[:, -1])

    def from_lcp(self, z):
        return z, self.w_to_free @ self.free(z) + self.matrix @ z + self.offset

    def residual(self, z, w):
        return jnp.maximum(natural_residual(z, w), jnp.max(jnp.abs(self.from_lcp(z)[1] - w)))


class HorizontalLCP(AbstractProblem):
    """N w = M z + q with 0 <= z perp w >= 0; N must be regular, or take `swapped()` where M is."""

    w_matrix: Float[Array, "n n"] = eqx.field(converter=as_floats)
    z_matrix: Float[Array, "n n"] = eqx.field(converter=as_floats)
    offset: Float[Array, " n"] = eqx.field(converter=as_floats)

    def __check_init__(self):
        n = jnp.size(self.offset)
        expected = {
            "offset": (self.offset, (n,)),
            "w_matrix": (self.w_matrix, (n, n)),
            "z_matrix": (self.z_matrix, (n, n)),
        }
        check_shapes("a HorizontalLCP", expected)

    def to_lcp(self):
        solved = jnp.linalg.solve(
            self.w_matrix, jnp.concatenate([self.z_matrix, self.offset[:, None]], 1)
        )
        return LCP(solved[:, :-1], solved[:, -1])

    def from_lcp(self, z):
        return z, jnp.linalg.solve(self.w_matrix, self.z_matrix @ z + self.offset)

    def residual(self, z, w):
        mismatch = jnp.max(jnp.abs(self.w_matrix @ w - self.z_matrix @ z - self.offset))
        return jnp.maximum(natural_residual(z, w), mismatch)

    def swapped(self) -> "HorizontalLCP":
        """The same problem with z and w in each other's place."""
        return HorizontalLCP(self.z_matrix, self.w_matrix, -self.offset)

    def to_mixed(self) -> MixedLCP:
        """The same problem with w as free unknowns: N u - M z - q = 0 and w = u."""
        n = self.offset.shape[0]
        return MixedLCP(
            self.w_matrix, -self.z_matrix, -self.offset, jnp.eye(n), jnp.zeros((n, n)), jnp.zeros(n)
        )


class Scaled(NamedTuple):
    """An LCP with entries near 1. z = z_scale z', w = w_scale w'; `finite` False: the data were
    not, and stand replaced.
    """

    matrix: Float[Array, "n n"]
    offset: Float[Array, " n"]
    z_scale: Float[Array, " n"]
    w_scale: Float[Array, " n"]
    finite: Bool[Array, ""]


def power_of_two(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """The power of two next above |x|, and 1 at zero: scaling by it rounds nothing, so ties stay
    ties.
    """
    exponent = jnp.frexp(jnp.where(x == 0, 0.5, x))[1]
    return jnp.ldexp(jnp.ones_like(x), exponent)


def scaled(problem: LCP) -> Scaled:
    """The problem in units of its own, without derivatives."""
    matrix, offset = jax.lax.stop_gradient((problem.matrix, problem.offset))
    finite = jnp.all(jnp.isfinite(matrix)) & jnp.all(jnp.isfinite(offset))
    matrix = jnp.where(finite, matrix, jnp.eye(offset.shape[0]))
    rows = columns = jnp.ones_like(offset)
    for _ in range(SCALING_PASSES):
        size = jnp.abs(rows[:, None] * matrix * columns)
        rows = rows / power_of_two(jnp.sqrt(jnp.max(size, 1)))
        columns = columns / power_of_two(jnp.sqrt(jnp.max(size, 0)))
    offset = rows * jnp.where(finite, offset, 0.0)
    size = power_of_two(jnp.max(jnp.abs(offset)))
    return Scaled(
        rows[:, None] * matrix * columns, offset / size, columns * size, size / rows, finite
    )


def excuse(z: Float[Array, "..."]) -> Float[Array, ""]:
    """What a scaled residual is measured by: 1, or the size of a large solution."""
    return jnp.clip(jnp.max(jnp.abs(z)), 1.0, LARGEST_EXCUSED)


def scaled_residual(problem: Scaled, z: Float[Array, " n"]) -> Float[Array, ""]:
    """Natural residual of a scaled problem relative to its data or the size of its solution;
    infinite where z is not finite.
    """
    w = problem.matrix @ z + problem.offset
    return jnp.where(jnp.all(jnp.isfinite(z + w)), natural_residual(z, w) / excuse(z), jnp.inf)


def on_active_set(
    active: Bool[Array, " n"], problem: Scaled, right: Float[Array, " n"], singular: bool = False
):
    """x with (M x)_i = right_i where active and x_i = 0 elsewhere; `singular`: the least of them
    where M says nothing new.
    """
    held = jnp.where(active[:, None], problem.matrix, jnp.eye(right.shape[0]))
    right = jnp.where(active, right, 0.0)
    return (
        jnp.linalg.pinv(held, rtol=REDUNDANT) @ right if singular else jnp.linalg.solve(held, right)
    )


@partial(jax.custom_jvp, nondiff_argnums=(5,))
def follow(z, active, scale, matrix, offset, singular: bool):
    """z unchanged, with the derivatives of the solution that keeps its active set (w_i = 0 there,
    z_i = 0 elsewhere).

    Exact where z + w > 0. At a corner z_i = w_i = 0 it is the derivative of the piece that `active`
    names.
    """
    return z


@follow.defjvp
def _follow_jvp(singular, primals, tangents):
    _, active, (z_scale, w_scale), matrix, offset = primals
    small = Scaled(matrix * z_scale / w_scale[:, None], offset, z_scale, w_scale, active)
    # the solution itself, not its copy without derivatives: then higher derivatives are right too
    out = follow(*primals, singular)
    moved = (tangents[3] @ out + tangents[4]) / w_scale
    return out, z_scale * on_active_set(active, small, -moved, singular)


class PivotingResult(NamedTuple):
    """What an exact algorithm finds for a scaled problem: z, the basic z, index into `OUTCOMES`,
    iterations.
    """

    z: Float[Array, " n"]
    active: Bool[Array, " n"]
    outcome: Int[Array, ""]
    iterations: Int[Array, ""]


def posed(problem: AbstractProblem) -> LCP:
    """The problem as an LCP. Raises `ValueError` for what is no problem."""
    if not isinstance(problem, AbstractProblem):
        kind = type(problem).__name__
        raise ValueError(
            f"a solver is given a {kind}; it takes a problem, such as complementarity.LCP(matrix, "
            "offset)."
        )
    return problem.to_lcp()


def solve_exactly(
    problem: AbstractProblem, algorithm: Callable[[Scaled], PivotingResult], singular: bool
) -> Solution:
    """Pose as an LCP, scale, solve, scale back, attach derivatives, and read the problem's own
    unknowns.
    """
    lcp = posed(problem)
    small = scaled(lcp)
    found = jax.lax.stop_gradient(algorithm(small))
    outcome = jnp.where(small.finite, found.outcome, NOT_FINITE)
    kept = jnp.where(jnp.isfinite(found.z) & small.finite, found.z * small.z_scale, 0.0)
    active = found.active & (outcome == SOLVED)
    z = follow(kept, active, (small.z_scale, small.w_scale), lcp.matrix, lcp.offset, singular)
    own = problem.from_lcp(z)
    return Solution(*own, problem.residual(*own), outcome, found.iterations)


class AbstractSolver(AbstractQuantified):
    """Solves complementarity problems: frozen settings, no state."""

    @abstractmethod
    def solve(self, problem: AbstractProblem) -> Solution:
        """One problem; pure, so it maps, compiles and differentiates. Values that cannot be solved
        end in an outcome.
        """
