"""What one complementarity problem costs: each solver alone in a compiled loop and in a batch of
1024, beside Lemke in numba.

Random symmetric positive definite matrices H H^T + 0.1 with normal entries, as contacts without
friction have; and spatial contacts with friction. `solved` is the share whose natural residual,
computed anew in numpy, is at most 1e-10 (InteriorPoint: with kappa = 1e-14). quantecon's
`lcp_lemke` joins in where it is installed. CPU time of all threads; start-up and compilation are
not counted.
"""

import importlib.util

import equinox as eqx
import jax
import jax.numpy as jnp
import numba
import numpy as np

import jaxclear  # noqa: F401  float64, and the compiler option
from benchmarks.measure import arguments, report, side_by_side, sign
from jaxclear.complementarity import (
    LCP,
    FrictionContact,
    InteriorPoint,
    ProjectedGaussSeidel,
)
from tests.rigs.lemke import Lemke

SOLVERS = {"Lemke": Lemke, "InteriorPoint(1e-14)": lambda: InteriorPoint(1e-14)}
CLOSE = 1e-10


def problems(n: int, count: int):
    """Random (M, q), stacked."""
    rng = np.random.default_rng(n)
    half = rng.normal(size=(count, n, n))
    return half @ half.transpose(0, 2, 1) + 0.1 * np.eye(n), rng.normal(size=(count, n))


def contacts(count: int, of_each: int):
    """Random (W, b, mu) of spatial contacts, stacked."""
    rng = np.random.default_rng(count)
    half = rng.normal(size=(of_each, 3 * count, 3 * count))
    return (
        half @ half.transpose(0, 2, 1),
        rng.normal(size=(of_each, 3 * count)),
        rng.uniform(0.1, 0.5, (of_each, count)),
    )


@numba.njit(cache=True)
def numba_lemke(matrix, offset, most):
    """z of one LCP by Lemke's method on a full tableau; ties go to the first row. Zero where the
    path ends on a ray.
    """
    n = offset.size
    z = np.zeros(n)
    if offset.min() >= 0:
        return z
    tableau = np.zeros((n, 2 * n + 2))
    for i in range(n):
        tableau[i, i] = 1.0
        tableau[i, n : 2 * n] = -matrix[i]
        tableau[i, 2 * n] = -1.0
        tableau[i, 2 * n + 1] = offset[i]
    basis = np.arange(n)
    row, entering = np.argmin(offset), 2 * n
    for _ in range(most):
        leaving = basis[row]
        divisor = tableau[row, entering]
        for j in range(2 * n + 2):
            tableau[row, j] /= divisor
        for i in range(n):
            factor = tableau[i, entering]
            if i != row and factor != 0:
                for j in range(2 * n + 2):
                    tableau[i, j] -= factor * tableau[row, j]
        basis[row] = entering
        if leaving == 2 * n:
            break
        entering = leaving + n if leaving < n else leaving - n
        row, best = -1, np.inf
        for i in range(n):
            if tableau[i, entering] > 1e-11:
                ratio = tableau[i, 2 * n + 1] / tableau[i, entering]
                if ratio < best:
                    row, best = i, ratio
        if row < 0:
            return z
    for i in range(n):
        if n <= basis[i] < 2 * n:
            z[basis[i] - n] = tableau[i, 2 * n + 1]
    return z


@numba.njit(cache=True)
def numba_loop(matrices, offsets):
    found = np.empty_like(offsets)
    for i in range(offsets.shape[0]):
        found[i] = numba_lemke(matrices[i], offsets[i], 1000)
    return found


def registry_loop(matrices, offsets):
    """quantecon's Lemke (compiled by numba), called from Python problem by problem."""
    from quantecon.optimize import lcp_lemke

    return np.stack(
        [lcp_lemke(matrix, offset).z for matrix, offset in zip(matrices, offsets, strict=True)]
    )


def share_solved(matrices, offsets, z) -> float:
    z = np.asarray(z)
    w = np.einsum("bij,bj->bi", matrices, z) + offsets
    return float(np.mean(np.abs(np.minimum(z, w)).max(1) <= CLOSE))


def lcp_rows(n: int, alone: int, batch: int, repeats: int):
    matrices, offsets = problems(n, batch)
    few = jnp.asarray(matrices[:alone]), jnp.asarray(offsets[:alone])
    many = jnp.asarray(matrices), jnp.asarray(offsets)
    cases, counts, found = {}, {}, {}
    for name, make in SOLVERS.items():
        solver = make()
        one_by_one = eqx.filter_jit(
            lambda m, q, s=solver: jax.lax.map(lambda p: s.solve(LCP(*p)).z, (m, q))
        )
        together = eqx.filter_jit(jax.vmap(lambda m, q, s=solver: s.solve(LCP(m, q)).z))
        cases[name, "alone"] = lambda f=one_by_one: f(*few)
        cases[name, "batch"] = lambda f=together: f(*many)
    cases["numba Lemke", "alone"] = lambda: numba_loop(matrices, offsets)
    if importlib.util.find_spec("quantecon"):
        cases["quantecon lcp_lemke", "alone"] = lambda: registry_loop(
            matrices[:alone], offsets[:alone]
        )
    for key, case in cases.items():
        found[key] = np.asarray(case())
        counts[key] = len(found[key])
    times = side_by_side(cases, repeats)
    rows = []
    for name in dict.fromkeys(key[0] for key in cases):
        row = {"n": n, "solver": name}
        for how in ("alone", "batch"):
            key = (name, how)
            row[f"{how} [us]"] = times[key][1] / counts[key] * 1e6 if key in times else "-"
        last = found.get((name, "batch"), found[name, "alone"])
        row["solved"] = share_solved(matrices[: len(last)], offsets[: len(last)], last)
        rows.append(row)
    return rows


def contact_rows(count: int, alone: int, batch: int, repeats: int):
    """Spatial friction, at most 200 sweeps."""
    data = contacts(count, batch)
    few, many = (tuple(jnp.asarray(part[:size]) for part in data) for size in (alone, batch))
    solver = ProjectedGaussSeidel(max_sweeps=200)
    solve = lambda *p: solver.solve(FrictionContact(*p)).residual
    one_by_one = eqx.filter_jit(lambda *p: jax.lax.map(lambda q: solve(*q), p))
    together = eqx.filter_jit(jax.vmap(solve))
    cases = {"alone": lambda: one_by_one(*few), "batch": lambda: together(*many)}
    times = side_by_side(cases, repeats)
    residual = np.asarray(together(*many))
    return [
        {
            "contacts": count,
            "solver": "ProjectedGaussSeidel",
            "alone [us]": times["alone"][1] / alone * 1e6,
            "batch [us]": times["batch"][1] / batch * 1e6,
            "solved": float(np.mean(residual <= CLOSE)),
        }
    ]


def main() -> None:
    options = arguments(__doc__)
    alone, batch, repeats = (64, 256, 2) if options.quick else (256, 1024, 5)
    sizes, counts = ((8,), (2,)) if options.quick else ((2, 4, 8, 16, 24), (1, 2, 4, 8))
    rows = [row for n in sizes for row in lcp_rows(n, alone, batch, repeats)]
    report("complementarity: CPU time of one LCP", rows, options)
    rows = [row for count in counts for row in contact_rows(count, alone, batch, repeats)]
    report("complementarity: CPU time of spatial contacts with friction", rows, options)
    sign("benchmarks.claims.complementarity", options.json)


if __name__ == "__main__":
    main()
