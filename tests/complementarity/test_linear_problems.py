"""Linear complementarity: the interior point method beside pivoting, published problems, and
differences.

Problems are padded to one size (rows w_i = z_i + 1, solved by z_i = 0) and solved in batches of one
size, so that each solver is compiled once.
"""

import json
from itertools import product
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxclear  # noqa: F401  float64
from jaxclear.complementarity import LCP, HorizontalLCP, InteriorPoint, Outcome, interior_point
from tests.rigs.lemke import lemke, pivoted

REFERENCE = json.loads((Path(__file__).parents[1] / "refdata" / "complementarity.json").read_text())
PUBLISHED = {
    name: (np.array(p["matrix"], float), np.array(p["offset"], float))
    for name, p in REFERENCE["lcp"].items()
}
SIZE, BATCH = 24, 64
SOLVER = InteriorPoint(1e-6)
CLOSE = REFERENCE["tolerance"]
SEEDS = st.integers(0, 2**32 - 1)


@eqx.filter_jit
def in_a_batch(solver, matrices, offsets):
    return jax.vmap(lambda matrix, offset: solver.solve(LCP(matrix, offset)))(matrices, offsets)


def padded(problems):
    matrices, offsets = np.tile(np.eye(SIZE), (BATCH, 1, 1)), np.ones((BATCH, SIZE))
    for i, (matrix, offset) in enumerate(problems):
        n = len(offset)
        matrices[i, :n, :n], offsets[i, :n] = matrix, offset
    return jnp.asarray(matrices), jnp.asarray(offsets)


def solve_all(problems, solver=SOLVER):
    """(z, outcome, iterations) of up to BATCH problems (M, q)."""
    found = jax.tree.map(np.asarray, in_a_batch(solver, *padded(problems)))
    return [
        (found.z[i, : len(q)], found.outcome[i], found.iterations[i])
        for i, (_, q) in enumerate(problems)
    ]


def natural_residual(matrix, offset, z):
    return np.abs(np.minimum(z, matrix @ z + offset)).max()


def by_enumeration(matrix, offset):
    """Solutions with regular active sets."""
    found = []
    for active in product((False, True), repeat=len(offset)):
        a, z = np.array(active), np.zeros(len(offset))
        if a.any():
            if np.linalg.matrix_rank(matrix[np.ix_(a, a)]) < a.sum():
                continue
            z[a] = np.linalg.solve(matrix[np.ix_(a, a)], -offset[a])
        # rounding of small systems with entries of order 1
        if z.min() >= -1e-9 and (matrix @ z + offset).min() >= -1e-9:
            found.append(z)
    return found


def p_matrix(rng, n, kind="symmetric"):
    """Positive definite (symmetric or not) or row-dominant: all with positive principal minors."""
    entries = rng.normal(size=(n, n))
    if kind == "symmetric":
        return entries @ entries.T + 0.1 * np.eye(n)
    if kind == "positive definite":
        skew = rng.normal(size=(n, n))
        return entries @ entries.T / n + 0.1 * np.eye(n) + skew - skew.T
    own = np.diag(entries)
    return entries + np.diag(np.abs(entries).sum(1) - own + np.abs(own) + 0.01)


def random_offset(rng, matrix, corners):
    """Normal entries, or those of a solution in whole numbers with many corners z_i = w_i = 0."""
    n = len(matrix)
    if not corners:
        return rng.normal(size=n)
    z = rng.integers(0, 4, n) * (rng.random(n) < 0.5)
    return rng.integers(0, 4, n) * (rng.random(n) < 0.5) * (z == 0) - matrix @ z


def random_problems(seed, corners):
    rng = np.random.default_rng(seed)
    matrices = [p_matrix(rng, rng.integers(1, SIZE + 1), rng.choice(KINDS)) for _ in range(BATCH)]
    return [(matrix, random_offset(rng, matrix, corners)) for matrix in matrices]


KINDS = ("symmetric", "positive definite", "dominant")


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_problems_by_pivoting(name):
    """The referee of other tests; of two kinds it ends in a ray though a solution is there, or as
    there is none."""
    if name == "bimatrix game" or REFERENCE["lcp"][name]["solutions"] == 0:
        with pytest.raises(ValueError, match="a ray"):
            pivoted(*PUBLISHED[name])
    else:
        assert natural_residual(*PUBLISHED[name], pivoted(*PUBLISHED[name])) <= CLOSE


@settings(max_examples=4, deadline=None)
@given(seed=SEEDS, corners=st.booleans())
def test_interior_point_keeps_its_product(seed, corners):
    problems = random_problems(seed, corners)
    for (matrix, offset), (z, outcome, _) in zip(problems, solve_all(problems), strict=True):
        assert outcome == Outcome.SOLVED and z.min() > 0
        # w = M z + q cancels: rounding of entries near 1e2 beside products of 1e-6
        product, rounding = z * (matrix @ z + offset), 1e-12 * (1 + np.abs(z).max() ** 2)
        np.testing.assert_allclose(product, 1e-6, atol=rounding)


# ---- derivatives ----

CORNER = np.array(
    [[2.0, 1.0, 0.0, 0.0], [1.0, 2.0, 0.5, 0.0], [0.0, 0.5, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


def outputs(data):
    """(z, w), or zeros where there is no solution, of (matrix, offset, kappa)."""
    matrix, offset, kappa = data
    solution = InteriorPoint(kappa).solve(LCP(matrix, offset))
    return jnp.where(solution.solved, jnp.append(solution.z, solution.w), 0.0)


@jax.jit
def differentiate(data, way, weight):
    """Value, first and second derivative along a way, and the reverse derivatives of weight @
    value, of one problem alone."""
    at = lambda h: outputs(jax.tree.map(lambda x, d: x + h * d, data, way))
    along = lambda h: jax.jvp(at, (h,), (1.0,))
    (value, slope), (_, curvature) = jax.jvp(along, (0.0,), (1.0,))
    return value, slope, curvature, jax.vjp(outputs, data)[1](weight)[0]


def test_derivatives_forward_in_reverse_and_by_differences():
    """With respect to all entries of M and q and kappa at once; one problem by itself is the same
    as in a batch."""
    rng, step, kappa = np.random.default_rng(5), 1e-5, 1e-2
    data = (p_matrix(rng, 4), np.array([-1.0, 0.7, -0.4, 0.9]), kappa)
    way = tuple(rng.normal(size=np.shape(x)) * np.maximum(np.abs(x), 1e-2) for x in data)
    weight = rng.normal(size=8)
    moved = lambda h: differentiate(
        tuple(x + h * d for x, d in zip(data, way, strict=True)), way, weight
    )
    value, slope, curvature, bars = moved(0.0)
    above, below = moved(step), moved(-step)
    assert 0 < np.sum(value[:4] > value[4:]) < 4
    # central differences of step 1e-5: 1e-10 from the step, 1e-11 from rounding
    np.testing.assert_allclose(slope, (above[0] - below[0]) / (2 * step), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(curvature, (above[1] - below[1]) / (2 * step), rtol=1e-6, atol=1e-7)
    backwards = sum(np.sum(b * d) for b, d in zip(bars, way, strict=True))
    np.testing.assert_allclose(backwards, slope @ weight, rtol=1e-12)
    # the same steps, summed in another order
    batched = solve_all([data[:2]], InteriorPoint(kappa))[0][0]
    np.testing.assert_allclose(value[:4], batched, atol=1e-13)


def test_what_is_not_finite_gives_no_derivative_but_zero():
    data = (CORNER + np.array([0.0, np.nan, 0.0, 0.0]), -np.ones(4), 1e-6)
    value, _, _, bars = differentiate(data, jax.tree.map(np.zeros_like, data), np.ones(8))
    assert not np.any(value) and not any(np.any(bar) for bar in bars)


@pytest.mark.parametrize("corner, order", [(False, 1.0), (True, 0.5)])
def test_relaxation_goes_to_the_exact_solution(corner, order):
    """The error falls as kappa, and as its root where some z_i = w_i = 0."""
    offset = np.array([-0.5 if corner else -0.2, -1.0, 1.0, 1.0])
    kappas = 10.0 ** -np.arange(4.0, 12.0)
    found = jax.jit(jax.vmap(lambda kappa: outputs((CORNER, offset, kappa))[:4]))(kappas)
    error = np.abs(found - pivoted(CORNER, offset)).max(axis=1)
    observed = np.polyfit(np.log(kappas), np.log(error), 1)[0]
    assert abs(observed - order) < 0.02


# ---- batches, units, forms, words ----


def test_a_failing_member_leaves_its_batch_alone():
    rng = np.random.default_rng(1)
    problems = [(p_matrix(rng, SIZE), rng.normal(size=SIZE)) for _ in range(8)]
    kept = solve_all(problems)
    nonsense = p_matrix(rng, 3) * np.array([1.0, np.nan, np.inf])
    lost = PUBLISHED["isolated solution, perturbed"], (-np.eye(2), -np.ones(2))
    found = solve_all([(nonsense, -np.ones(3)), *problems, *lost])
    assert found[0][1] == Outcome.NOT_FINITE and np.array_equal(found[0][0], np.zeros(3))
    assert Outcome.SOLVED not in (found[-1][1], found[-2][1])
    assert all(np.all(np.isfinite(z)) for z, _, _ in found)
    for before, now in zip(kept, found[1:-2], strict=True):
        assert np.array_equal(before[0], now[0]) and before[1:] == now[1:]


@pytest.mark.parametrize("form", [lambda f: f, lambda f: f.to_lcp()], ids=["horizontal", "lcp"])
def test_all_forms_have_the_same_solution(form):
    rng = np.random.default_rng(7)
    base, left = p_matrix(rng, 4, "positive definite"), rng.normal(size=(4, 4))
    offset = np.array([-1.0, 0.5, -0.3, 0.8])
    found = lemke(form(HorizontalLCP(left, left @ base, left @ offset)))
    np.testing.assert_allclose(found.z, by_enumeration(base, offset)[0], atol=1e-12)
    assert found.residual <= 1e-12


def test_a_singular_horizontal_problem_is_told():
    lcp = HorizontalLCP(np.zeros((2, 2)), np.eye(2), [-1.0, -2.0]).to_lcp()
    assert solve_all([(lcp.matrix, lcp.offset)])[0][1] == Outcome.NOT_FINITE


def test_sentences():
    nonsense = np.full((2, 2), np.nan), np.ones(2)
    batch = in_a_batch(SOLVER, *padded([nonsense, nonsense]))
    lost, solved = (jax.tree.map(lambda x, i=i: x[i], batch) for i in (0, 2))
    outcomes = Outcome.SOLVED, Outcome.NOT_FINITE
    assert [one.sentence() for one in (solved, lost)] == [each.sentence for each in outcomes]
    assert (bool(solved.solved), bool(lost.solved)) == (True, False)
    counts = zip((62, 2), outcomes, strict=True)
    assert batch.sentence() == " ".join(f"{count} of 64: {code.sentence}" for count, code in counts)


REFUSED = {
    "has shape (2, 3)": lambda: LCP(np.ones((2, 3)), np.ones(2)),
    "Build and solve batches": lambda: LCP(np.ones((5, 2, 2)), np.ones((5, 2))),
    "is empty": lambda: LCP(np.ones((0, 0)), np.ones(0)),
    "must be an array of numbers": lambda: LCP("one", [1.0]),
    "w_matrix of a HorizontalLCP": lambda: HorizontalLCP(
        np.ones((1, 2)), np.ones((2, 2)), np.ones(2)
    ),
    "InteriorPoint has max_steps = 1.5": lambda: InteriorPoint(max_steps=1.5),
    "InteriorPoint has kappa = 0; it must be above 0": lambda: InteriorPoint(0.0),
}


@pytest.mark.parametrize("words", REFUSED)
def test_bad_shapes_and_settings_are_refused_before_tracing(words):
    with pytest.raises(ValueError) as refusal:
        REFUSED[words]()
    assert words in str(refusal.value)


def test_a_step_that_cannot_come_near_the_centre_is_the_shortest():
    """So that the next one starts where this one did, but for little."""
    one, aside, still = np.ones(2), np.array([1.0, 1e-9]), np.zeros(2)
    found = interior_point._longest_central_step(one, aside, one, still, still)
    assert found == pytest.approx(interior_point.SHORTENED ** (interior_point.TRIES - 1))
    assert interior_point._longest_central_step(one, one, one, still, still) == 1.0
    # A whole step would take one of them to zero.
    away = np.array([-1.0, 1.0])
    assert 0.5 < interior_point._longest_central_step(one, one, one, away, still) < 0.8
