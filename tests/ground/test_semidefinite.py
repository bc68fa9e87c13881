"""Least squares with semidefinite matrices of known rank, and definite systems, against NumPy."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxclear.ground.factorisation import (
    dense_array,
    factor,
    factor_of_rank,
    is_written_out,
    solve,
    solve_least,
)
from jaxclear.native.rows import operations_of

# The condition of the matrices drawn here is below 1e4.
ROUNDING = 1e-9


@partial(jax.jit, static_argnums=2)
def solved(matrix, right, rank):
    factors = factor_of_rank([list(row) for row in jnp.asarray(matrix)], rank)
    return jnp.stack(solve_least(factors, tuple(jnp.asarray(right))))


def drawn(size, rank, seed=0):
    random = np.random.default_rng(seed)
    root = random.normal(size=(size, rank))
    return root @ root.T, root @ random.normal(size=rank)


@pytest.mark.parametrize(("size", "rank"), [(4, 3), (5, 2), (5, 0), (3, 3), (20, 2)])
def test_solution_is_the_least_of_all(size, rank):
    matrix, right = drawn(size, rank)
    wanted = np.linalg.pinv(matrix, rcond=1e-10) @ right
    found = solved(matrix, right, rank)
    np.testing.assert_allclose(found, wanted, atol=ROUNDING * (1 + np.abs(wanted).max()))


def test_rows_that_contradict_each_other_are_met_in_the_mean():
    """Of A a = b with two equal rows that want 1 and 3 each gets 2."""
    row = np.array([[1.0, 2.0]])
    jacobian = np.concatenate([row, row])
    multipliers = solved(jacobian @ jacobian.T, jnp.array([1.0, 3.0]), 1)
    np.testing.assert_allclose(jacobian @ (jacobian.T @ multipliers), [2.0, 2.0], rtol=1e-12)


def test_lost_rank_gives_finite_numbers():
    """Where the matrix says less than its rank, it is solved in what it says."""
    found = solved(np.diag([1.0, 0.0, 0.0]), jnp.array([2.0, 0.0, 0.0]), 2)
    np.testing.assert_allclose(found, [2.0, 0.0, 0.0], atol=1e-12)


def test_derivative_is_that_of_the_pseudo_inverse():
    """Along changes that keep the rank: S(t) = A(t) A(t)^T."""
    random = np.random.default_rng(1)
    root, change = random.normal(size=(2, 5, 3))
    load = random.normal(size=3)

    def at(t):
        moved = jnp.asarray(root) + t * jnp.asarray(change)
        return solved(moved @ moved.T, moved @ load, 3)

    step = 1e-6
    wanted = (at(step) - at(-step)) / (2 * step)
    found = jax.jacfwd(at)(0.0)
    np.testing.assert_allclose(found, wanted, atol=1e-6 * np.abs(wanted).max())


@pytest.mark.parametrize(("size", "width", "written"), [(40, 40, True), (41, 41, False)])
def test_what_is_written_out_depends_on_the_products_that_it_takes(size, width, written):
    rows = [[1.0 if abs(i - j) < width else 0 for j in range(size)] for i in range(size)]
    assert is_written_out(rows) is written


def test_a_long_chain_is_written_out_and_a_wheel_numbered_from_its_hub_is_not():
    chain = [[1.0 if abs(i - j) < 6 else 0 for j in range(200)] for i in range(200)]
    hub = [[1.0 if i == j or 0 in (i, j) else 0 for j in range(200)] for i in range(200)]
    assert is_written_out(chain) and not is_written_out(hub)


@pytest.mark.parametrize("size", [5, 41])
def test_both_ways_solve_the_system(size):
    """Written out, and by LAPACK where that would be long."""
    matrix, right = drawn(size, size)
    matrix = matrix + np.eye(size)

    @jax.jit
    def solution(matrix, right):
        return jnp.stack(solve(factor([list(row) for row in matrix]), tuple(right)))

    found = solution(matrix, right)
    np.testing.assert_allclose(found, np.linalg.solve(matrix, right), rtol=1e-9, atol=1e-12)


def test_constants_of_a_wide_array_are_no_operations():
    """Of each that is put into place by itself XLA makes a piece of a program."""

    def rows(x):
        entries = {(i, i): float(i % 3 - 1) for i in range(50)}
        return dense_array(entries | {(i, i + 5): x[i] for i in range(4)}, (50, 60))

    x = np.array([2.0, 3.0, 5.0, 7.0])
    wanted = np.zeros((50, 60))
    wanted[range(50), range(50)] = np.arange(50) % 3 - 1
    wanted[range(4), np.arange(4) + 5] = x
    np.testing.assert_array_equal(jax.jit(rows)(x), wanted)
    assert operations_of(jax.make_jaxpr(rows)(x).jaxpr) < 50
