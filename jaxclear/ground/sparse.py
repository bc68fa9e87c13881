"""Vectors and matrices of three, written as tuples of scalars in which 0, 1 and -1 are known before
tracing.

A component that the scene leaves out (the third coordinate of a planar part, the off-diagonal terms
of a rotation about z) is the Python integer 0, and products with it vanish while JAX traces. One
spatial formulation therefore compiles to the planar equations for a planar mechanism, and to mixed
ones where only some parts move in space. A `Vec` is a tuple of 3 scalars, a `Mat` a tuple of 3
rows; a scalar is the integer 0, 1 or -1 or a float64 array.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from jaxclear.ground.grouping import MANY, stacked, unstacked
from jaxclear.ground.numerics import safe_sqrt

# Of three each: a type checker does not count what a loop builds.
Vec = tuple[Any, ...]
Mat = tuple[Vec, ...]

ZERO: Vec = (0, 0, 0)
IDENTITY: Mat = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def is_zero(x: Any) -> bool:
    """True where the scalar is structurally (not merely numerically) zero."""
    return isinstance(x, int) and x == 0


def mul(a: Any, b: Any) -> Any:
    """a b, with 0, 1 and -1 folded."""
    if isinstance(a, int) and isinstance(b, int):
        return a * b
    if isinstance(b, int):
        a, b = b, a
    if isinstance(a, int):
        return 0 if a == 0 else b if a == 1 else -b if a == -1 else float(a) * b
    return lax.mul(a, b) if _is_traced_pair(a, b) else a * b


def add(a: Any, b: Any) -> Any:
    """a + b, with 0 folded."""
    if is_zero(a):
        return b
    if is_zero(b):
        return a
    return lax.add(a, b) if _is_traced_pair(a, b) else a + b


def neg(a: Any) -> Any:
    """-a."""
    return -a


def sub(a: Any, b: Any) -> Any:
    """a - b, with 0 folded."""
    if is_zero(b):
        return a
    if is_zero(a):
        return -b
    return lax.sub(a, b) if _is_traced_pair(a, b) else a - b


def _is_traced_pair(a: Any, b: Any) -> bool:
    """Whether both are being traced as numbers of one type and shape: JAX's operators, which look
    for what is not, trace half as fast."""
    traced = isinstance(a, jax.core.Tracer) and isinstance(b, jax.core.Tracer)
    return traced and jax.typeof(a) == jax.typeof(b)


def total(terms: Any) -> Any:
    """Sum of any number of scalars."""
    out = 0
    for term in terms:
        out = add(out, term)
    return out


def dot(a, b) -> Any:
    """Inner product of two sequences of equal length."""
    return total(mul(x, y) for x, y in zip(a, b, strict=True))


def norm(vector: Any) -> Any:
    """Length of a vector, with zero derivative at zero length."""
    squares = dot(vector, vector)
    return 0 if is_zero(squares) else safe_sqrt(squares)


def plus(*vectors: Vec) -> Vec:
    """Sum of vectors."""
    return tuple(total(components) for components in zip(*vectors, strict=True))


def minus(a: Vec, b: Vec) -> Vec:
    """a - b."""
    return tuple(sub(x, y) for x, y in zip(a, b, strict=True))


def scale(s: Any, a: Vec) -> Vec:
    """s a."""
    return tuple(mul(s, x) for x in a)


def cross(a: Vec, b: Vec) -> Vec:
    """a x b."""
    return (
        sub(mul(a[1], b[2]), mul(a[2], b[1])),
        sub(mul(a[2], b[0]), mul(a[0], b[2])),
        sub(mul(a[0], b[1]), mul(a[1], b[0])),
    )


def transpose(m: Mat) -> Mat:
    """The transposed matrix."""
    return tuple(zip(*m, strict=True))


def apply(m: Mat, a: Vec) -> Vec:
    """m a."""
    return tuple(dot(row, a) for row in m)


def apply_transposed(m: Mat, a: Vec) -> Vec:
    """m^T a."""
    return apply(transpose(m), a)


def product(a: Mat, b: Mat) -> Mat:
    """The matrix product a b."""
    columns = transpose(b)
    return tuple(tuple(dot(row, column) for column in columns) for row in a)


def outer(a: Vec, b: Vec) -> Mat:
    """a b^T."""
    return tuple(tuple(mul(x, y) for y in b) for x in a)


def plus_matrix(*matrices: Mat) -> Mat:
    """Sum of matrices."""
    return tuple(plus(*rows) for rows in zip(*matrices, strict=True))


def congruence(r: Mat, symmetric: Mat) -> Mat:
    """r s r^T for a symmetric s."""
    return product(product(r, symmetric), transpose(r))


def shift_inertia(inertia: Mat, mass: Any, moment: Vec, offset: Vec) -> Mat:
    """Inertia about O' of a body whose inertia about O is given, with parallel axes.

    I' = I + (m p.p + 2 p.h) 1 - m p p^T - p h^T - h p^T.

    Args:
        inertia: I about O [kg m2].
        mass: m of the body [kg].
        moment: h, mass times the vector from O to the centre of mass [kg m].
        offset: p, vector from O' to O [m].
    """
    diagonal = add(mul(mass, dot(offset, offset)), mul(2, dot(offset, moment)))
    cross_terms = plus_matrix(
        outer(offset, scale(mass, offset)), outer(offset, moment), outer(moment, offset)
    )
    return tuple(
        tuple(
            add(
                inertia[i][j],
                sub(diagonal, cross_terms[i][j]) if i == j else neg(cross_terms[i][j]),
            )
            for j in range(3)
        )
        for i in range(3)
    )


def vec3(values: Any) -> Vec:
    """Three components from a tuple of 2 or 3 scalars or `None`; what is not given is structurally
    0.
    """
    if values is None:
        return ZERO
    return (*values, *(0,) * (3 - len(values)))


def each(function: Any, *lists: Any) -> list:
    """[function(x, ...) for x, ... in the lists side by side], of many numbers as arrays: for
    arithmetic that is the same for numbers and arrays."""
    if len(lists[0]) < MANY:
        return [function(*numbers) for numbers in zip(*lists, strict=True)]
    return unstacked(function(*map(stack, lists)))


def dense(tree: Any) -> Any:
    """The same tree with structural integers turned into float64 arrays (for results that leave the
    traced core).
    """
    return jax.tree.map(lambda x: jnp.asarray(x, float) if isinstance(x, int) else x, tree)


def stack(scalars: Any) -> jax.Array:
    """Scalars, structural ones included, stacked to one float64 array on a new first axis."""
    if len(scalars) >= MANY and all(
        isinstance(x, jax.core.Tracer) and x.shape == () for x in scalars
    ):
        return stacked(scalars)
    return (
        jnp.stack(jnp.broadcast_arrays(*[jnp.asarray(x, float) for x in scalars]))
        if scalars
        else jnp.zeros((0,))
    )
