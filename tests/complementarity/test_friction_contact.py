"""Contacts with Coulomb friction: the law itself, published problems, the planar law posed as an
LCP, and derivatives.

Problems are padded to three contacts (those added are open and apart) and solved in batches of one
size.
"""

import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxclear  # noqa: F401  float64
from jaxclear.complementarity import (
    LCP,
    FrictionContact,
    InteriorPoint,
    Outcome,
    ProjectedGaussSeidel,
    projected_gauss_seidel,
)
from tests.rigs.lemke import lemke

REFERENCE = json.loads((Path(__file__).parents[1] / "refdata" / "complementarity.json").read_text())
PUBLISHED = {
    name: (
        p["dimension"],
        np.array(p["delassus"], float),
        np.array(p["free_velocity"], float),
        np.array(p["mu"]),
    )
    for name, p in REFERENCE["friction"].items()
}
CLOSE = REFERENCE["tolerance"]
CONTACTS, BATCH = 3, 32
SWEEPS = ProjectedGaussSeidel(max_sweeps=500)
SEEDS = st.integers(0, 2**32 - 1)


@eqx.filter_jit
def in_a_batch(solver, *data):
    return jax.vmap(lambda *one: solver.solve(FrictionContact(*one)))(*data)


@eqx.filter_jit
def solved(solver, problem):
    """One problem, compiled as a whole."""
    return solver.solve(problem)


def solve_all(problems, dimension, solver=SWEEPS):
    """(r, v, outcome, sweeps) of up to BATCH problems (W, b, mu); r and v contact by contact."""
    size = dimension * CONTACTS
    matrices, offsets, mus = (
        np.tile(np.eye(size), (BATCH, 1, 1)),
        np.ones((BATCH, size)),
        np.ones((BATCH, CONTACTS)),
    )
    for i, (matrix, offset, mu) in enumerate(problems):
        n = len(offset)
        matrices[i, :n, :n], offsets[i, :n], mus[i, : len(mu)] = matrix, offset, mu
    found = jax.tree.map(
        np.asarray, in_a_batch(solver, *map(jnp.asarray, (matrices, offsets, mus)))
    )
    return [
        (
            *(x[i, : len(p[1])].reshape(-1, dimension) for x in (found.z, found.w)),
            found.outcome[i],
            found.iterations[i],
        )
        for i, p in enumerate(problems)
    ]


def assert_coulomb(problem, r, v, close=CLOSE):
    """Signorini's condition, the cone, and the largest dissipation, from W, b, mu and r alone; v is
    W r + b.
    """
    matrix, offset, mu = problem
    np.testing.assert_allclose(v.ravel(), matrix @ r.ravel() + offset, atol=close)
    normal, tangent, slip = r[:, 0], r[:, 1:], v[:, 1:]
    assert np.abs(np.minimum(normal, v[:, 0])).max() <= close
    assert np.all(np.linalg.norm(tangent, axis=1) <= mu * normal + close)
    # never gives energy: power -mu r_n |v_t|, the least there is in the cone
    power = np.sum(tangent * slip, 1)
    np.testing.assert_allclose(
        power, -mu * normal * np.linalg.norm(slip, axis=1), atol=close * (1 + np.abs(slip).max())
    )


def random_contacts(rng, dimension, bodies_move=True):
    """A Delassus matrix H H^T of one to three contacts; with fewer freedoms than rows where
    `bodies_move` is False.
    """
    c = rng.integers(1, CONTACTS + 1)
    rows = dimension * c
    freedoms = rows if bodies_move else max(dimension, rows // 2)
    half = rng.normal(size=(rows, freedoms))
    return half @ half.T, half @ rng.normal(size=freedoms), rng.uniform(0.0, 0.6, c)


@pytest.mark.parametrize("name", PUBLISHED)
def test_problems_of_siconos(name):
    dimension, *problem = PUBLISHED[name]
    r, v, outcome, _ = solve_all([problem], dimension)[0]
    assert outcome == Outcome.SOLVED
    assert_coulomb(problem, r, v)
    # De Saxce's natural map with a projection of its own
    mu = problem[2]
    lifted = r - v
    lifted[:, 0] -= mu * np.linalg.norm(v[:, 1:], axis=1)
    size = np.linalg.norm(lifted[:, 1:], axis=1)
    for contact, point, length, coefficient in zip(r, lifted, size, mu, strict=True):
        if length > coefficient * point[0]:
            height = max(point[0] + coefficient * length, 0.0) / (1 + coefficient**2)
            point = height * np.append(1.0, coefficient * point[1:] / length)
        assert np.abs(contact - point).max() <= CLOSE


@pytest.mark.parametrize("dimension", [2, 3])
@settings(max_examples=8, deadline=None)
@given(seed=SEEDS)
def test_coulombs_law_holds_at_every_contact(dimension, seed):
    rng = np.random.default_rng(seed)
    problems = [random_contacts(rng, dimension) for _ in range(BATCH)]
    for problem, (r, v, outcome, _) in zip(problems, solve_all(problems, dimension), strict=True):
        assert outcome == Outcome.SOLVED
        assert_coulomb(problem, r, v)


@pytest.mark.parametrize("dimension", [2, 3])
def test_redundant_contacts_are_solved_or_told(dimension):
    """Half as many freedoms as rows: reactions are not unique, and no method is known to converge
    always.
    """
    rng = np.random.default_rng(0)
    problems = [random_contacts(rng, dimension, bodies_move=False) for _ in range(BATCH)]
    found = solve_all(problems, dimension)
    solved = [outcome == Outcome.SOLVED for _, _, outcome, _ in found]
    assert np.mean(solved) >= 0.9
    for problem, (r, v, outcome, _) in zip(problems, found, strict=True):
        if outcome == Outcome.SOLVED:
            assert_coulomb(problem, r, v)
        assert outcome in (Outcome.SOLVED, Outcome.LIMIT)


@pytest.mark.parametrize(
    "push, state",
    [((-1.0, 0.2, 0.1), "stick"), ((-1.0, 3.0, 4.0), "slide"), ((1.0, 3.0, 4.0), "open")],
)
def test_a_particle_on_a_plane(push, state):
    """Mass 2, mu 1/2: r = -m v in a stick, mu m v_n against the slip in a slide."""
    problem = (np.eye(3) / 2, np.array(push), np.array([0.5]))
    r, _, _, _ = solve_all([problem], 3)[0]
    expected = {"stick": (2.0, -0.4, -0.2), "slide": (2.0, -0.6, -0.8), "open": (0.0, 0.0, 0.0)}[
        state
    ]
    np.testing.assert_allclose(r[0], expected, atol=1e-15)


def test_turning_the_tangents_turns_the_solution():
    rng = np.random.default_rng(3)
    problem = random_contacts(rng, 3)
    c = len(problem[2])
    turn = np.zeros((3 * c, 3 * c))
    for i, angle in enumerate(rng.uniform(0, 6, c)):
        cosine, sine = np.cos(angle), np.sin(angle)
        turn[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = [
            [1, 0, 0],
            [0, cosine, -sine],
            [0, sine, cosine],
        ]
    plain, turned = solve_all(
        [problem, (turn @ problem[0] @ turn.T, turn @ problem[1], problem[2])], 3
    )
    np.testing.assert_allclose(turned[0].ravel(), turn @ plain[0].ravel(), atol=1e-12)


def test_without_friction_it_is_the_lcp_of_the_normals():
    rng = np.random.default_rng(4)
    matrix, offset, mu = random_contacts(rng, 3)
    r, _, _, _ = solve_all([(matrix, offset, 0 * mu)], 3)[0]
    assert not np.any(r[:, 1:])
    assert np.abs(np.minimum(r[:, 0], matrix[::3, ::3] @ r[:, 0] + offset[::3])).max() <= 1e-12


@settings(max_examples=1, deadline=None)
@given(seed=SEEDS)
def test_planar_friction_by_sweeps_and_by_pivoting(seed):
    """Unique where coefficients are small beside the coupling of W: there, both agree."""
    rng = np.random.default_rng(seed)
    problems = [(w, b, 0.3 * mu) for w, b, mu in (random_contacts(rng, 2) for _ in range(BATCH))]
    problems = [(w + np.trace(w) / len(w) * np.eye(len(w)), b, mu) for w, b, mu in problems]
    for problem, (r, _, outcome, _) in zip(problems, solve_all(problems, 2), strict=True):
        other = lemke(FrictionContact(*problem))
        assert outcome == Outcome.SOLVED
        assert_coulomb(problem, *(x.reshape(-1, 2) for x in (other.z, other.w)))
        np.testing.assert_allclose(r.ravel(), other.z, atol=1e-11)


def test_contacts_of_unlike_sizes_and_pivoting_find_the_same():
    """One contact without friction and one with, beside the LCP of both."""
    rng = np.random.default_rng(0)
    half = rng.normal(size=(3, 3))
    matrix, offset = half @ half.T + np.eye(3), rng.normal(size=3)
    for more in (((np.zeros(3)),), (np.full(2, 0.1), (1, 2))):
        problem = FrictionContact(matrix, offset, *more)
        one, other = solved(SWEEPS, problem), lemke(problem)
        assert one.solved
        np.testing.assert_allclose(one.z, other.z, atol=1e-11)
        np.testing.assert_allclose(one.w, other.w, atol=1e-11)


@pytest.mark.parametrize("eliminated", [24, 0])
def test_a_step_finds_what_solve_finds(monkeypatch, eliminated):
    """With the written-out elimination, and by sweeps alone, as beyond so many unknowns."""
    monkeypatch.setattr(projected_gauss_seidel, "LARGEST_ELIMINATED", eliminated)
    rng = np.random.default_rng(6)
    half, offset = rng.normal(size=(4, 4)), rng.normal(size=4)
    problem = FrictionContact(half @ half.T / 4 + np.eye(4), offset, np.full(2, 0.3))
    found = solve_all([(jnp.stack(problem.delassus), offset, problem.mu)], 2)[0]
    iterate = eqx.filter_jit(lambda start: SWEEPS.iterate(problem, start))
    step = iterate(jnp.zeros(4))
    again = iterate(step.z)
    assert found[2] == Outcome.SOLVED and step.residual < 1e-12
    np.testing.assert_allclose(step.z, found[0].ravel(), atol=1e-11)
    # a good start ends at once
    assert int(step.sweeps) > 0 and int(again.sweeps) == 0
    np.testing.assert_allclose(again.z, step.z, rtol=1e-14)


def test_a_contact_that_may_not_act_does_nothing():
    """The others are solved as if it were not there, whatever its own numbers."""
    rng = np.random.default_rng(2)
    half = rng.normal(size=(2, 2))
    matrix, offset, mu = half @ half.T, half @ [-1.0, 0.5], np.full(1, 0.3)
    whole = np.block(
        [[1e6 * np.eye(2), np.ones((2, len(offset)))], [np.ones((len(offset), 2)), matrix]]
    )
    more = (whole, np.append([-1e3, 1.0], offset), np.append(0.5, mu))
    active = np.append(False, np.ones(len(mu), bool))
    found = solved(SWEEPS, FrictionContact(*more, active=jnp.asarray(active)))
    alone = solved(SWEEPS, FrictionContact(matrix, offset, mu))
    assert found.solved and not np.any(found.z[:2])
    np.testing.assert_allclose(found.z[2:], alone.z, rtol=1e-12, atol=1e-14)
    assert float(found.residual) < 1e-10


def test_a_contact_without_a_normal_leaves_nothing_unsolved():
    """As of concentric parts that are moved apart, where what it answers may be -0."""
    problem = FrictionContact(np.diag([1.0, -0.0]), np.array([-1.0, 0.1]), np.zeros(2))
    step = SWEEPS.iterate(problem)
    np.testing.assert_allclose(step.z, [1.0, 0.0], atol=1e-12)
    assert float(step.residual) < 1e-12


@pytest.mark.parametrize("restitution", [0.0, 0.6, 1.0])
def test_two_balls_exchange_momentum_as_newton_says(restitution):
    """Free velocities with e v_n before added: closing 3 m/s, opening 3 e m/s; P = (1 + e) m1 m2 /
    (m1 + m2) v."""
    masses, closing = np.array([2.0, 3.0]), -3.0
    delassus = np.sum(1 / masses)
    wanted = [closing + restitution * closing]
    found = SWEEPS.solve(FrictionContact([[delassus]], wanted, [0.0]))
    np.testing.assert_allclose(found.z, -(1 + restitution) * closing / delassus, rtol=1e-15)
    assert int(found.iterations) == 1


# ---- derivatives ----


def outputs(solver, data):
    solution = solver.solve(FrictionContact(*data))
    return jnp.where(solution.solved, jnp.append(solution.z, solution.w), 0.0)


@eqx.filter_jit
def differentiate(solver, data, way, weight):
    """Value and derivative along a way, and the reverse derivatives of weight @ value."""
    value, linear = jax.linearize(lambda data: outputs(solver, data), data)
    return value, linear(way), jax.linear_transpose(linear, data)(weight)[0]


def three_states(dimension):
    """Four coupled contacts: one sticks, two slide, one is open."""
    rng = np.random.default_rng(11)
    rows = dimension * 4
    half = 0.1 * rng.normal(size=(rows, rows)) + np.eye(rows)
    offset = 0.1 * rng.normal(size=(4, dimension))
    offset[:, :2] += [[-1.0, 0.0], [-1.0, 2.0], [-1.0, -3.0], [2.0, 1.0]]
    return half @ half.T, offset.ravel(), np.array([0.8, 0.2, 0.3, 0.5])


@pytest.mark.parametrize(
    "solver, dimension",
    [
        (SWEEPS, 3),
        pytest.param(SWEEPS, 2, marks=pytest.mark.slow),
        (InteriorPoint(1e-3), 2),
    ],
    ids=["cones", "planar cones", "relaxed"],
)
def test_derivatives_forward_in_reverse_and_by_differences(solver, dimension):
    """With respect to all of W, b and mu at once."""
    rng, step = np.random.default_rng(12), 1e-6
    data = three_states(dimension)
    way, weight = tuple(rng.normal(size=x.shape) for x in data), rng.normal(size=2 * len(data[1]))
    value, slope, bars = differentiate(solver, data, way, weight)
    above, below = (
        differentiate(
            solver, tuple(x + sign * step * d for x, d in zip(data, way, strict=True)), way, weight
        )[0]
        for sign in (1, -1)
    )
    if isinstance(solver, ProjectedGaussSeidel):
        r, v = np.asarray(value).reshape(2, 4, dimension)
        slips = np.linalg.norm(v[:, 1:], axis=1) > 1e-12
        assert [*(r[:, 0] > 0)] == [True, True, True, False] and [*slips] == [
            False,
            True,
            True,
            True,
        ]
    # central differences of step 1e-6: 1e-10 from rounding
    np.testing.assert_allclose(slope, (above - below) / (2 * step), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(
        sum(np.sum(b * d) for b, d in zip(bars, way, strict=True)), slope @ weight, rtol=1e-11
    )


def test_derivatives_of_redundant_contacts_move_the_velocities_right():
    """Four contacts of a body with six freedoms: reactions are not unique, velocities are."""
    rng, step = np.random.default_rng(13), 1e-6
    half, speeds, mu = rng.normal(size=(12, 6)), rng.normal(size=6), np.full(4, 0.4)
    half *= -np.sign((half @ speeds)[:, None])
    data = lambda h: (jnp.asarray(half @ half.T), jnp.asarray(half @ (speeds + h)), jnp.asarray(mu))
    way = (np.zeros((12, 12)), half @ np.ones(6), np.zeros(4))
    value, slope, _ = differentiate(SWEEPS, data(0.0), way, np.ones(24))
    assert np.any(np.asarray(value)[:12] > 0)
    above, below = (
        np.asarray(differentiate(SWEEPS, data(sign * step), way, np.ones(24))[0])
        for sign in (1, -1)
    )
    np.testing.assert_allclose(
        slope[12:], ((above - below) / (2 * step))[12:], rtol=1e-6, atol=1e-7
    )


@pytest.mark.parametrize("sign, slope", [(1.0, 0.0), (-1.0, 1.0)])
def test_between_two_states_the_derivative_is_one_sided(sign, slope):
    """A contact that just touches stays open: dr = 0, right where it departs; where it is pressed,
    differences say r = -b.
    """
    data = lambda h: (np.eye(12), np.append(h, np.ones(11)), np.full(4, 0.5))
    way = (np.zeros((12, 12)), np.append(sign, np.zeros(11)), np.zeros(4))
    value, found, _ = differentiate(SWEEPS, data(0.0), way, np.ones(24))
    assert not np.any(np.asarray(value)[:12]) and not np.any(np.asarray(found)[:12])
    np.testing.assert_allclose(
        differentiate(SWEEPS, data(sign * 1e-3), way, np.ones(24))[0][0] / 1e-3, slope, rtol=1e-12
    )


# ---- what is refused or told ----


def test_a_failing_member_leaves_its_batch_alone():
    rng = np.random.default_rng(1)
    problems = [random_contacts(rng, 3) for _ in range(4)]
    nonsense = (np.full((3, 3), np.nan), np.ones(3), np.ones(1))
    negative = (np.eye(3), -np.ones(3), -np.ones(1))
    kept, found = solve_all(problems, 3), solve_all([*problems, nonsense, negative], 3)
    for before, now in zip(kept, found, strict=False):
        assert all(np.array_equal(a, b) for a, b in zip(before, now, strict=True))
    assert [outcome for _, _, outcome, _ in found[4:]] == [Outcome.NOT_FINITE, Outcome.NOT_FINITE]
    assert not np.any(found[4][0]) and not np.any(found[5][0])


@pytest.mark.parametrize(
    "words, build",
    {
        "rows, or as many": lambda: FrictionContact(np.eye(5), np.ones(5), np.ones(2)),
        "delassus of a FrictionContact": lambda: FrictionContact(np.eye(2), np.ones(3), np.ones(1)),
        "row 0 of delassus": lambda: FrictionContact(np.ones((2, 3)), np.ones(2), np.ones(1)),
        "directions \\(1, 1\\) say": lambda: FrictionContact(
            np.eye(3), np.ones(3), np.ones(2), (1, 1)
        ),
        "may be negative": lambda: FrictionContact(np.eye(3), np.ones(3), [-0.1]),
        "ProjectedGaussSeidel": lambda: InteriorPoint().solve(
            FrictionContact(np.eye(3), np.ones(3), [0.1])
        ),
        "for linear problems take InteriorPoint": lambda: SWEEPS.solve(LCP(np.eye(3), np.ones(3))),
        "max_sweeps = 0; it must be above 0": lambda: ProjectedGaussSeidel(max_sweeps=0),
    }.items(),
)
def test_bad_problems_are_refused_before_tracing(words, build):
    with pytest.raises(ValueError, match=f"(?i){words}"):
        build()


@pytest.mark.parametrize("dimension", [2, 3])
def test_an_open_contact_without_friction_is_solved(dimension):
    """Its cone is a half-line, which a pull does not belong to."""
    free = np.zeros(dimension)
    free[0] = 1.0
    found = ProjectedGaussSeidel().solve(FrictionContact(np.eye(dimension), free, np.zeros(1)))
    assert bool(found.solved) and not np.any(found.z)
    assert str(found) == found.sentence()


def test_solvers_take_problems():
    with pytest.raises(ValueError, match="a solver is given a ndarray; it takes a problem"):
        InteriorPoint().solve(np.eye(2))


# A shaft in a bearing at two ends, with a collar: masses [kg] and inertias [kg m^2] of three bodies
# in a row, half lengths, radii and arms [m].
MASSES, INERTIAS = (100.0, 4.0, 8.0), (12.0, 0.05, 0.3)
HALF, RADIUS, COLLAR, ARM = 0.025, 0.01, 0.014, 0.5
BEARING = (3, 3, 1)


def bearings(rng):
    """W, b, mu of two spatial bearings in a row, each with two ends that rub and a collar: seven
    forces act in each on six freedoms, and reactions are not unique."""
    rows, coordinates = [], 6 * len(MASSES)
    for joint, axis in enumerate((2, 0)):
        a, b, c = np.roll(np.eye(3), -axis - 1, axis=0)[[0, 1, 2]]
        for sign in (1.0, -1.0, None):
            turn = rng.uniform(0, 2 * np.pi)
            out = np.cos(turn) * a + np.sin(turn) * b
            if sign is None:
                place, forces = COLLAR * out + HALF * c, [c]
            else:
                place, forces = RADIUS * out + sign * HALF * c, [-out, c, np.cross(c, out)]
            for force in forces:
                row = np.zeros(coordinates)
                for body, side in ((joint, -1.0), (joint + 1, 1.0)):
                    arm = place + side * ARM * np.eye(3)[2]
                    row[6 * body : 6 * body + 6] = side * np.append(force, np.cross(arm, force))
                rows.append(row)
    inverse = 1 / np.repeat(np.stack([MASSES, INERTIAS], 1).ravel(), 3)
    jacobian, speeds = np.array(rows), 1e-2 * rng.normal(size=coordinates)
    return jacobian * inverse @ jacobian.T, jacobian @ speeds, np.repeat([0.1], 6)


@pytest.mark.slow
def test_bearings_whose_reactions_are_not_unique_are_solved():
    """Where an undamped Newton's method finds nothing in 6 of 128 and sweeps hardly move."""
    rng = np.random.default_rng(0)
    problems = [bearings(rng) for _ in range(128)]
    solve = lambda *one: ProjectedGaussSeidel().solve(FrictionContact(*one, directions=BEARING * 2))
    data = [jnp.asarray(np.stack(part)) for part in zip(*problems, strict=True)]
    found = eqx.filter_jit(jax.vmap(solve))(*data)
    assert np.all(found.outcome == Outcome.SOLVED) and np.max(found.iterations) < 100
