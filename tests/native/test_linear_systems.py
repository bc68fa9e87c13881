"""Systems that are factorised in loops: kernels, XLA and their derivatives against NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear  # noqa: F401  (float64)
from jaxclear.ground.elimination import Pattern, solved, tables_of
from jaxclear.native import as_kernel, explain, verdict
from jaxclear.native.linear_systems import MOST_FACTORISED
from jaxclear.native.verdicts import KERNELS

# Diagonally dominant: their conditions are below 100.
ROUNDING = 1e-13
FILLED = {
    "full": lambda i, j: True,
    "chain": lambda i, j: i - j < 4,
    "wheel": lambda i, j: j == 0,
    "scattered": lambda i, j: (7 * i + 3 * j) % 5 == 0,
}


def pattern_of(kind, size):
    lower = [(i, j) for i in range(size) for j in range(i + 1)]
    return Pattern(size, tuple((i, j) for i, j in lower if i == j or FILLED[kind](i, j)))


def drawn(pattern, seed=0):
    """Entries of a matrix, the matrix, and a right-hand side."""
    random, size = np.random.default_rng(seed), pattern.size
    entries = random.normal(size=len(pattern.places))
    matrix = np.zeros((size, size))
    for place, entry in zip(pattern.places, entries, strict=True):
        matrix[place] = matrix[place[::-1]] = entry
    matrix[np.diag_indices(size)] = 1 + np.abs(matrix).sum(axis=0)
    entries = np.array([matrix[place] for place in pattern.places])
    return entries, matrix, random.normal(size=size)


@pytest.mark.parametrize(
    ("kind", "size"),
    [("full", 1), ("full", 2), *((kind, 7) for kind in FILLED), ("chain", 70), ("scattered", 70)],
)
def test_kernels_solve_as_numpy_does(kind, size):
    """Alone and in a batch; two right-hand sides share the factors."""
    pattern = pattern_of(kind, size)
    draws = [drawn(pattern, seed) for seed in range(3)]

    def both(entries, right):
        return tuple(solved(pattern, entries, None, b) for b in (right, 2 * right + 1))

    def one(entries, right):
        found = as_kernel(both, entries, right)
        return found, verdict(found[0][0])

    def near(found, draw):
        _, matrix, right = draw
        for mine, b in zip(found, (right, 2 * right + 1), strict=True):
            np.testing.assert_allclose(mine, np.linalg.solve(matrix, b), rtol=0, atol=ROUNDING)

    found, told = jax.jit(one)(*draws[0][::2])
    assert explain(told) == KERNELS
    near(found, draws[0])
    near(jax.jit(both)(*draws[0][::2]), draws[0])
    batch = (np.stack(part) for part in zip(*(draw[::2] for draw in draws), strict=True))
    found, told = jax.jit(jax.vmap(one))(*batch)
    assert explain(jnp.max(told)) == KERNELS
    for k, draw in enumerate(draws):
        near([each[k] for each in found], draw)


def test_a_row_that_follows_from_others_has_no_unknown():
    """x0 + x1 = 2 twice, the second row left out."""
    pattern = Pattern(2, ((0, 0), (1, 0), (1, 1)))
    least = jnp.array([-jnp.inf, 1e-10])
    found = as_kernel(lambda b: solved(pattern, jnp.ones(3), least, b), jnp.array([2.0, 2.0]))
    np.testing.assert_allclose(found, [2.0, 0.0], rtol=0, atol=0)


def test_slopes_are_those_of_the_solution():
    """x' = -M^-1 M' x, forwards through the loop of a kernel and backwards through XLA."""
    pattern = pattern_of("chain", 9)
    entries, matrix, right = drawn(pattern)
    rows, columns = np.array(pattern.places).T
    change = np.zeros_like(matrix)
    change[rows, columns] = change[columns, rows] = np.cos(np.arange(len(entries)))
    solution = np.linalg.solve(matrix, right)
    wanted = -np.linalg.solve(matrix, change @ solution)

    def at(t, run=as_kernel):
        moved = jnp.asarray(entries) + t * jnp.asarray(change[rows, columns])
        return run(lambda given: solved(pattern, given, None, right), moved)

    np.testing.assert_allclose(jax.jacfwd(at)(0.0), wanted, rtol=0, atol=ROUNDING)
    backwards = jax.jacrev(lambda t: at(t, lambda f, x: f(x)))(0.0)
    np.testing.assert_allclose(backwards, wanted, rtol=0, atol=ROUNDING)
    ways = jax.vmap(lambda s: jax.jvp(at, (0.0,), (s,))[1])(jnp.arange(3.0))
    np.testing.assert_allclose(ways[2], 2 * wanted, rtol=0, atol=ROUNDING)


def test_a_wheel_numbered_from_its_hub_keeps_its_zeros():
    """Only numbered from its rim it does."""
    tables = tables_of(pattern_of("wheel", 50))
    assert tables.numbers == 2 * 50 - 1
    assert tables.unknown[0] >= 48


def test_more_systems_than_stay_factorised():
    """Those that were pushed out are factorised anew."""
    pattern = pattern_of("full", 3)
    draws = [drawn(pattern, seed) for seed in range(MOST_FACTORISED + 3)]
    given = np.stack([entries for entries, _, _ in draws])
    right = draws[0][2]

    def all_twice(given):
        return [solved(pattern, entries, None, right) for _ in range(2) for entries in given]

    found = jax.jit(lambda given: as_kernel(all_twice, given))(given)
    for (_, matrix, _), *twice in zip(draws, found[: len(draws)], found[len(draws) :], strict=True):
        for each in twice:
            np.testing.assert_allclose(each, np.linalg.solve(matrix, right), rtol=0, atol=ROUNDING)
