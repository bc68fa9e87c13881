"""Linear complementarity: every solver against enumeration of active sets, contrived and published
problems, and differences.

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
from scipy.optimize import linprog

import jaxclear  # noqa: F401  float64
from jaxclear.complementarity import LCP, HorizontalLCP, InteriorPoint, Outcome
from tests.rigs.lemke import Lemke

REFERENCE = json.loads((Path(__file__).parents[1] / "refdata" / "complementarity.json").read_text())
PUBLISHED = {
    name: (np.array(p["matrix"], float), np.array(p["offset"], float))
    for name, p in REFERENCE["lcp"].items()
}
SIZE, BATCH = 24, 64
LEMKE = Lemke()
SOLVERS = {"Lemke": LEMKE, "InteriorPoint": InteriorPoint(1e-6)}
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


def solve_all(solver, problems):
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


def p_matrix(rng, n, kind):
    """Positive definite (symmetric or not), row-dominant, or triangular: all with positive
    principal minors.
    """
    entries = rng.normal(size=(n, n))
    if kind == "symmetric":
        return entries @ entries.T + 0.1 * np.eye(n)
    if kind == "positive definite":
        skew = rng.normal(size=(n, n))
        return entries @ entries.T / n + 0.1 * np.eye(n) + skew - skew.T
    if kind == "dominant":
        return entries + np.diag(
            np.abs(entries).sum(1) - np.diag(entries) + np.abs(np.diag(entries)) + 0.01
        )
    return np.triu(entries, 1) + np.diag(rng.uniform(0.5, 2.0, n))


def random_offset(rng, matrix, corners):
    """Normal entries, or those of a solution in whole numbers with many corners z_i = w_i = 0."""
    n = len(matrix)
    if not corners:
        return rng.normal(size=n)
    z = rng.integers(0, 4, n) * (rng.random(n) < 0.5)
    return rng.integers(0, 4, n) * (rng.random(n) < 0.5) * (z == 0) - matrix @ z


def random_problems(seed, kinds, corners):
    rng = np.random.default_rng(seed)
    matrices = [p_matrix(rng, rng.integers(1, SIZE + 1), rng.choice(kinds)) for _ in range(BATCH)]
    return [(matrix, random_offset(rng, matrix, corners)) for matrix in matrices]


KINDS = ("symmetric", "positive definite", "dominant", "triangular")


@settings(max_examples=6, deadline=None)
@given(seed=SEEDS, corners=st.booleans())
def test_p_matrices_have_one_solution_and_it_is_found(seed, corners):
    problems = random_problems(seed, KINDS, corners)
    for (matrix, offset), (z, outcome, _) in zip(problems, solve_all(LEMKE, problems), strict=True):
        assert outcome == Outcome.SOLVED and z.min() >= -1e-15
        assert natural_residual(matrix, offset, z) <= CLOSE
        if len(offset) <= 6:
            # corners make neighbouring active sets equal up to rounding times the condition of the
            # matrix (1e4)
            np.testing.assert_allclose(
                z, by_enumeration(matrix, offset)[0], atol=1e-8 * (1 + np.abs(z).max())
            )


@settings(max_examples=6, deadline=None)
@given(seed=SEEDS)
def test_ties_never_make_lemke_cycle(seed):
    """Small whole numbers of any sign, rows repeated: nearly every ratio test is a tie."""
    rng = np.random.default_rng(seed)
    problems = []
    for _ in range(BATCH):
        n = rng.integers(3, 9)
        matrix, offset = (
            rng.integers(-2, 3, (n, n)).astype(float),
            -rng.integers(0, 2, n).astype(float),
        )
        matrix[1], offset[1] = matrix[0], offset[0]
        problems.append((matrix, offset))
    for (matrix, offset), (z, outcome, _) in zip(problems, solve_all(LEMKE, problems), strict=True):
        assert outcome in (Outcome.SOLVED, Outcome.RAY)
        assert outcome == Outcome.RAY or natural_residual(matrix, offset, z) <= CLOSE


def first_row_rule_cycles(matrix, offset):
    """Whether Lemke's method comes back to a basis when the first row of a tie leaves."""
    n = len(offset)
    tableau = np.hstack([np.eye(n), -matrix, -np.ones((n, 1)), offset[:, None]])
    basis, seen, row, entering = list(range(n)), set(), int(np.argmin(offset)), 2 * n
    while True:
        tableau[row] /= tableau[row, entering]
        for i in set(range(n)) - {row}:
            tableau[i] -= tableau[i, entering] * tableau[row]
        left, basis[row] = basis[row], entering
        entering = (left + n) % (2 * n)
        if left == 2 * n or (frozenset(basis), entering) in seen:
            return left != 2 * n
        seen.add((frozenset(basis), entering))
        column = tableau[:, entering]
        row = int(
            np.argmin([tableau[i, -1] / column[i] if column[i] > 0 else np.inf for i in range(n)])
        )


def test_a_p_matrix_on_which_the_first_row_rule_cycles():
    matrix, offset = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 2.0], [2.0, 0.0, 1.0]]), -np.ones(3)
    assert first_row_rule_cycles(matrix, offset)
    z, outcome, _ = solve_all(LEMKE, [(matrix, offset)])[0]
    assert outcome == Outcome.SOLVED
    np.testing.assert_allclose(z, 1 / 3, rtol=1e-15)


def murty(n):
    """Exponentially many pivots for Lemke's method: Murty 1988, Linear Complementarity, chapter
    6."""
    return np.triu(np.full((n, n), 2.0), 1) + np.eye(n), 2.0 ** np.arange(1, n + 1) - 2.0 ** (n + 1)


def test_murtys_example_takes_all_its_pivots_or_says_so():
    sizes = (2, 4, 6, 8, 10)
    for n, (z, outcome, pivots) in zip(
        sizes, solve_all(LEMKE, [murty(n) for n in sizes]), strict=True
    ):
        # 100 + 20 SIZE pivots are allowed
        assert (outcome, pivots) == (
            (Outcome.SOLVED, 2**n) if 2**n <= 580 else (Outcome.LIMIT, 580)
        ), n
        assert outcome == Outcome.LIMIT or np.array_equal(z, [0.0] * (n - 1) + [2.0**n])


@settings(max_examples=3, deadline=None)
@given(seed=SEEDS)
def test_lemke_decides_every_positive_semidefinite_problem(seed):
    """A ray where linear programming finds no z >= 0 with M z + q >= 0, and a solution where it
    does.
    """
    rng = np.random.default_rng(seed)
    problems = []
    for _ in range(BATCH):
        n = rng.integers(2, 11)
        half = rng.integers(-2, 3, (n, max(1, n // 3)))
        problems.append(((half @ half.T).astype(float), rng.integers(-1, 4, n).astype(float)))
    for (matrix, offset), (z, outcome, _) in zip(problems, solve_all(LEMKE, problems), strict=True):
        possible = linprog(np.zeros(len(offset)), A_ub=-matrix, b_ub=offset).status == 0
        assert outcome == (Outcome.SOLVED if possible else Outcome.RAY)
        assert not possible or natural_residual(matrix, offset, z) <= CLOSE


# Rays told though there is a solution, or none is there.
NO_SOLUTION = {name for name, problem in REFERENCE["lcp"].items() if problem["solutions"] == 0}


def test_problems_of_siconos():
    found = dict(zip(PUBLISHED, solve_all(LEMKE, list(PUBLISHED.values())), strict=True))
    unsolved = {name for name, (_, outcome, _) in found.items() if outcome != Outcome.SOLVED}
    assert unsolved == {"bimatrix game"} | NO_SOLUTION
    assert {int(found[name][1]) for name in unsolved} == {Outcome.RAY}
    for name in set(PUBLISHED) - unsolved:
        assert natural_residual(*PUBLISHED[name], found[name][0]) <= CLOSE, name


@settings(max_examples=4, deadline=None)
@given(seed=SEEDS, corners=st.booleans())
def test_interior_point_keeps_its_product(seed, corners):
    problems = random_problems(seed, KINDS[:3], corners)
    for (matrix, offset), (z, outcome, _) in zip(
        problems, solve_all(SOLVERS["InteriorPoint"], problems), strict=True
    ):
        assert outcome == Outcome.SOLVED and z.min() > 0
        # w = M z + q cancels: rounding of entries near 1e2 beside products of 1e-6
        np.testing.assert_allclose(
            z * (matrix @ z + offset), 1e-6, atol=1e-12 * (1 + np.abs(z).max() ** 2)
        )


# ---- derivatives ----

CORNER = np.array(
    [[2.0, 1.0, 0.0, 0.0], [1.0, 2.0, 0.5, 0.0], [0.0, 0.5, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
ONES = np.ones(4)


def data_of(solver, matrix, offset):
    """Everything a solution depends on."""
    return (matrix, offset, solver.kappa) if isinstance(solver, InteriorPoint) else (matrix, offset)


def outputs(solver, data):
    """(z, w), or zeros where there is no solution."""
    matrix, offset, *kappa = data
    solver = eqx.tree_at(lambda s: s.kappa, solver, kappa[0]) if kappa else solver
    solution = solver.solve(LCP(matrix, offset))
    return jnp.where(solution.solved, jnp.append(solution.z, solution.w), 0.0)


@eqx.filter_jit
def differentiate(solver, data, way, weight):
    """Value, first and second derivative along a way, and the reverse derivatives of weight @
    value, of one problem alone.
    """
    at = lambda h: outputs(solver, jax.tree.map(lambda x, d: x + h * d, data, way))
    along = lambda h: jax.jvp(at, (h,), (jnp.ones(()),))
    (value, slope), (_, curvature) = jax.jvp(along, (jnp.zeros(()),), (jnp.ones(()),))
    return value, slope, curvature, jax.vjp(lambda data: outputs(solver, data), data)[1](weight)[0]


def derivatives(solver, data, way=None, weight=None):
    data = tuple(map(jnp.asarray, data))
    way = jax.tree.map(jnp.zeros_like, data) if way is None else tuple(map(jnp.asarray, way))
    found = differentiate(
        solver, data, way, jnp.zeros(8) if weight is None else jnp.asarray(weight)
    )
    return jax.tree.map(np.asarray, found)


def moved(data, way, step):
    return tuple(x + step * d for x, d in zip(data, way, strict=True))


@pytest.mark.parametrize("name", SOLVERS)
def test_derivatives_forward_in_reverse_and_by_differences(name):
    """With respect to all entries of M and q (and kappa) at once; one problem by itself is the same
    as in a batch.
    """
    rng, solver, step = np.random.default_rng(5), SOLVERS[name], 1e-5
    if name == "InteriorPoint":
        solver = InteriorPoint(1e-2)
    data = data_of(solver, p_matrix(rng, 4, "symmetric"), np.array([-1.0, 0.7, -0.4, 0.9]))
    way, weight = (
        [rng.normal(size=np.shape(x)) * np.maximum(np.abs(x), 1e-2) for x in data],
        rng.normal(size=8),
    )
    value, slope, curvature, bars = derivatives(solver, data, way, weight)
    above, below = (derivatives(solver, moved(data, way, sign * step), way) for sign in (1, -1))
    assert 0 < np.sum(value[:4] > value[4:]) < 4
    # central differences of step 1e-5: 1e-10 from the step, 1e-11 from rounding
    np.testing.assert_allclose(slope, (above[0] - below[0]) / (2 * step), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(curvature, (above[1] - below[1]) / (2 * step), rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(
        sum(np.sum(b * d) for b, d in zip(bars, way, strict=True)), slope @ weight, rtol=1e-12
    )
    # the same steps, summed in another order
    np.testing.assert_allclose(value[:4], solve_all(solver, [data[:2]])[0][0], atol=1e-13)


def test_derivative_at_a_corner_is_one_sided():
    """z_1 = w_1 = 0: more q_1 opens the corner, and the derivative is that of staying at z_1 =
    0."""
    data = (CORNER, np.array([-0.5, -1.0, 1.0, 1.0]))
    way, step = (np.zeros((4, 4)), np.array([1.0, -0.5, 0.0, 0.0])), 1e-6
    value, slope, _, bars = derivatives(LEMKE, data, way, np.ones(8))
    np.testing.assert_allclose(value[[0, 4]], 0.0, atol=1e-15)
    np.testing.assert_allclose(
        slope, (derivatives(LEMKE, moved(data, way, step))[0] - value) / step, atol=1e-8
    )
    np.testing.assert_allclose(np.sum(bars[1] * way[1]), np.sum(slope), rtol=1e-12)


@pytest.mark.parametrize("name", SOLVERS)
def test_what_is_not_finite_gives_no_derivative_but_zero(name):
    nonsense = CORNER + np.array([0.0, np.nan, 0.0, 0.0])
    value, _, _, bars = derivatives(
        SOLVERS[name], data_of(SOLVERS[name], nonsense, -ONES), weight=np.ones(8)
    )
    assert not value.any() and not any(np.any(bar) for bar in bars)


@pytest.mark.parametrize("corner, order", [(False, 1.0), (True, 0.5)])
def test_relaxation_goes_to_the_exact_solution(corner, order):
    """The error falls as kappa, and as its root where some z_i = w_i = 0."""
    offset = np.array([-0.5 if corner else -0.2, -1.0, 1.0, 1.0])
    exact = derivatives(LEMKE, (CORNER, offset))[0][:4]
    kappas = 10.0 ** -np.arange(4.0, 12.0)
    error = [
        np.abs(derivatives(SOLVERS["InteriorPoint"], (CORNER, offset, k))[0][:4] - exact).max()
        for k in kappas
    ]
    observed = np.polyfit(np.log(kappas), np.log(error), 1)[0]
    assert abs(observed - order) < 0.02


# ---- batches, units, forms, words ----


@pytest.mark.parametrize("name", SOLVERS)
def test_a_failing_member_leaves_its_batch_alone(name):
    rng = np.random.default_rng(1)
    problems = [(p_matrix(rng, SIZE, "symmetric"), rng.normal(size=SIZE)) for _ in range(8)]
    kept = solve_all(SOLVERS[name], problems)
    nonsense = p_matrix(rng, 3, "symmetric") * np.array([1.0, np.nan, np.inf])
    broken = [
        (nonsense, -np.ones(3)),
        *problems,
        PUBLISHED["isolated solution, perturbed"],
        (-np.eye(2), -np.ones(2)),
    ]
    found = solve_all(SOLVERS[name], broken)
    assert found[0][1] == Outcome.NOT_FINITE and np.array_equal(found[0][0], np.zeros(3))
    assert Outcome.SOLVED not in (found[-1][1], found[-2][1])
    assert all(np.all(np.isfinite(z)) for z, _, _ in found)
    for before, now in zip(kept, found[1:-2], strict=True):
        assert np.array_equal(before[0], now[0]) and before[1:] == now[1:]


def test_units_do_not_matter():
    """A matrix in units 2^-30 and an offset in 2^40 of the first: the same steps and the same
    digits.
    """
    rng = np.random.default_rng(2)
    problems = [(p_matrix(rng, n, "symmetric"), rng.normal(size=n)) for n in range(1, SIZE)]
    found = solve_all(LEMKE, problems)
    scaled = solve_all(
        LEMKE, [(2.0**-30 * matrix, 2.0**40 * offset) for matrix, offset in problems]
    )
    for (z, _, steps), (other, outcome, same) in zip(found, scaled, strict=True):
        # not padded alike: the added rows keep their units
        assert outcome == Outcome.SOLVED and same == steps
        np.testing.assert_allclose(2.0**-70 * other, z, rtol=1e-10, atol=1e-13)


FORMS = {
    "horizontal": lambda f: f,
    "lcp": lambda f: f.to_lcp(),
}


@pytest.mark.parametrize("form", FORMS)
def test_all_forms_have_the_same_solution(form):
    rng = np.random.default_rng(7)
    base, left = p_matrix(rng, 4, "positive definite"), rng.normal(size=(4, 4))
    offset = np.array([-1.0, 0.5, -0.3, 0.8])
    problem = FORMS[form](HorizontalLCP(left, left @ base, left @ offset))
    lcp = problem.to_lcp()
    z, w = problem.from_lcp(solve_all(LEMKE, [(lcp.matrix, lcp.offset)])[0][0])
    np.testing.assert_allclose(z, by_enumeration(base, offset)[0], atol=1e-12)
    assert float(problem.residual(z, w)) <= 1e-12


def test_a_singular_horizontal_problem_is_told():
    lcp = HorizontalLCP(np.zeros((2, 2)), np.eye(2), [-1.0, -2.0]).to_lcp()
    assert solve_all(LEMKE, [(lcp.matrix, lcp.offset)])[0][1] == Outcome.NOT_FINITE


def test_sentences():
    batch = in_a_batch(LEMKE, *padded([murty(10), PUBLISHED["isolated solution, perturbed"]]))
    limit, ray, solved = (jax.tree.map(lambda x, i=i: x[i], batch) for i in range(3))
    assert [one.sentence() for one in (solved, ray, limit)] == [
        i.sentence for i in (Outcome.SOLVED, Outcome.RAY, Outcome.LIMIT)
    ]
    assert [bool(one.solved) for one in (solved, ray, limit)] == [True, False, False]
    counts = zip((62, 1, 1), (Outcome.SOLVED, Outcome.RAY, Outcome.LIMIT), strict=True)
    assert batch.sentence() == " ".join(f"{count} of 64: {code.sentence}" for count, code in counts)


REFUSED = {
    "has shape (2, 3)": lambda: LCP(np.ones((2, 3)), np.ones(2)),
    "Build and solve batches": lambda: LCP(np.ones((5, 2, 2)), np.ones((5, 2))),
    "is empty": lambda: LCP(np.ones((0, 0)), np.ones(0)),
    "must be an array of numbers": lambda: LCP("one", [1.0]),
    "w_matrix of a HorizontalLCP": lambda: HorizontalLCP(
        np.ones((1, 2)), np.ones((2, 2)), np.ones(2)
    ),
    "Lemke has most_pivots = 0": lambda: Lemke(most_pivots=0),
    "InteriorPoint has max_steps = 1.5": lambda: InteriorPoint(max_steps=1.5),
    "InteriorPoint has kappa = 0; it must be above 0": lambda: InteriorPoint(0.0),
}


@pytest.mark.parametrize("words", REFUSED)
def test_bad_shapes_and_settings_are_refused_before_tracing(words):
    with pytest.raises(ValueError) as refusal:
        REFUSED[words]()
    assert words in str(refusal.value)
