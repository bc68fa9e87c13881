"""Values of a problem's variables from standard normal numbers.

Every study of rare parts works in standard normal numbers: there, how far a part is from the
middle is how rare it is, whatever the distributions.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy

from jaxclear.studies.base import AbstractProblem
from jaxclear.studies.scrambling import scrambled_shares

# Standard normal numbers further out than this do not occur.
FURTHEST = 37.0


@eqx.filter_jit
def _values(problem, normal):
    return jax.vmap(problem.inputs.values)(normal)


def all_values(problem: AbstractProblem, normal: np.ndarray) -> np.ndarray:
    """Values (samples, variables) that standard normal numbers (samples, variables) stand for."""
    return np.array(_values(problem, jnp.asarray(normal)))


def scrambled_normal(count: int, variables: int, rng: np.random.Generator) -> np.ndarray:
    """Standard normal numbers (count, variables): one scrambling."""
    shares = scrambled_shares(count, variables, rng)
    tiny = np.finfo(float).eps
    return np.clip(scipy.special.ndtri(np.clip(shares, tiny, 1 - tiny)), -FURTHEST, FURTHEST)


@eqx.filter_jit
def _value_slopes(problem, normal):
    return jax.vmap(jax.jacfwd(problem.inputs.values))(normal)


def value_slopes(problem: AbstractProblem, normal: np.ndarray) -> np.ndarray:
    """How the values move with the standard normal numbers, (samples, variables, variables)."""
    return np.asarray(_value_slopes(problem, jnp.asarray(normal)))
