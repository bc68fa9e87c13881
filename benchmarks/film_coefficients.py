"""Makes the numbers of `jaxclear.film` from solutions of Reynolds' equation in two dimensions.

`python -m benchmarks.film_coefficients solve` fills build/films.npz (about 10 minutes of one
processor), `python -m benchmarks.film_coefficients fit` writes jaxclear/laws/film/coefficients.csv,
`python -m benchmarks.film_coefficients check` prints how far these are from other solutions.

Lengths along the film are in radii, heights in clearances, pressure in 12 mu R^2/c^3 times the
speed: -div(H^3 grad P) = cos(theta - alpha), H = 1 - eps cos(theta), theta from the thinnest place,
P = 0 at the ends |zeta| = L/D; the journal closes in the direction alpha. "half" takes the positive
part of P (Guembel), "reynolds" solves P >= 0 as an obstacle (Swift and Stieber's boundary).
Finite volumes, second order; two grids are extrapolated.
"""

import csv
import sys
from pathlib import Path

import numpy as np
import scipy.sparse as sparse
from numpy.polynomial.chebyshev import chebvander
from scipy.sparse.linalg import splu, spsolve

ROOT = Path(__file__).parents[1]
SOLUTIONS = ROOT / "build" / "films.npz"
NUMBERS = ROOT / "jaxclear" / "laws" / "film" / "coefficients.csv"
GRIDS = ((96, 12), (192, 24))
# Roots sqrt(1 - eps^2), L/D and directions in the natural plane at which films are solved. Near the
# centre cavitation changes fast: two more rows there.
NARROWEST = 0.03
ROOTS = np.sort([*(1 - (1 - NARROWEST) * np.sin(np.pi * np.arange(13) / 24) ** 2), 0.9982, 0.9915])
SLENDERNESS = np.geomspace(0.08, 5.0, 11)
DIRECTIONS = np.linspace(0.0, np.pi, 17)
# As jaxclear/laws/film/impedance.py evaluates them.
OFFSET = 2.5
HARMONICS = {"half": ((0, 1, 2, 4, 6), (1, 2, 4, 6, 8))}
HARMONICS["reynolds"] = ((0, 1, 2, 3, 4, 6), (1, 2, 3, 4, 5, 6, 8))
LOW_DEGREE, HIGH_DEGREE, HIGH = 7, 5, 3


def full_film_scales(eps, slenderness):
    """Damping of the full film along and across the line of centres: of a short and of a long
    bearing, in series."""
    gap = 1 - eps**2
    short = 2 / 3 * np.pi * slenderness**3 * np.array([(1 + 2 * eps**2) / gap**2.5, gap**-1.5])
    long = 2 * np.pi * slenderness * np.array([gap**-1.5, 2 / (2 + eps**2) * gap**-0.5])
    return short * long / (short + long)


class Grid:
    """Reynolds' equation of one eccentricity and slenderness on half the length of a bearing."""

    def __init__(self, eps, slenderness, around, along):
        squeeze = ((1 - eps) / (1 + eps)) ** 0.4
        edges = np.linspace(-np.pi, np.pi, around + 1)
        centres = 0.5 * (edges[1:] + edges[:-1])
        finer = lambda s: 2 * np.arctan2(squeeze * np.sin(s / 2), np.cos(s / 2))
        edges, centres = finer(edges), finer(centres)
        levels = np.linspace(0.0, 1.0, along + 1)
        if slenderness > 2 * np.sqrt(1 - eps):  # a layer at the end, as thick as the film is long
            levels = np.tanh(2.0 * levels) / np.tanh(2.0)
        levels = slenderness * levels
        middles = 0.5 * (levels[1:] + levels[:-1])
        width, height = np.diff(edges), np.diff(levels)
        cube = lambda angle: (1 - eps * np.cos(angle)) ** 3
        turn = np.roll(centres, -1) - centres
        turn[-1] += 2 * np.pi
        flow_around = np.outer(cube(edges[1:]) / turn, height)
        rises = np.append(np.diff(middles), levels[-1] - middles[-1])
        flow_along = np.outer(cube(centres) * width, 1 / rises)
        index = np.arange(around * along).reshape(around, along)
        links = [(index, np.roll(index, -1, 0), flow_around)]
        links.append((index[:, :-1], index[:, 1:], flow_along[:, :-1]))
        size = around * along
        diagonal = np.zeros(size)
        diagonal[index[:, -1]] += flow_along[:, -1]
        rows, columns, values = [], [], []
        for a, b, flow in links:
            a, b, flow = a.ravel(), b.ravel(), flow.ravel()
            np.add.at(diagonal, a, flow)
            np.add.at(diagonal, b, flow)
            rows += [a, b]
            columns += [b, a]
            values += [-flow, -flow]
        rows, columns = (
            np.concatenate([*rows, np.arange(size)]),
            np.concatenate([*columns, np.arange(size)]),
        )
        values = np.concatenate([*values, diagonal])
        self.matrix = sparse.csc_matrix((values, (rows, columns)), (size, size))
        self.shape = around, along
        # Integrals of cos and sin over each cell, exact.
        parts = np.diff(np.sin(edges)), -np.diff(np.cos(edges))
        self.directions = np.array([np.outer(part, height).ravel() for part in parts])
        self.full = splu(self.matrix).solve(self.directions.T).T

    def load(self, pressure):
        """Load along and across the line of centres, of both halves of the length."""
        return 2 * self.directions @ pressure

    def half_film(self, along):
        """Load of the positive part of the full film's pressure, of cells that a boundary cuts
        that of their part."""
        pressure = (along @ self.full).reshape(self.shape)
        low = 0.5 * (pressure + np.roll(pressure, 1, 0))
        high = 0.5 * (pressure + np.roll(pressure, -1, 0))
        ends = np.stack([low, pressure, high])
        a, b = ends[:-1], ends[1:]
        cut = 0.5 * np.maximum(a, b) ** 2 / np.maximum(np.abs(a - b), 1e-30)
        whole = 0.5 * np.maximum(a + b, 0.0)
        positive = 0.5 * np.where(a * b < 0, cut, whole).sum(0)
        positive = np.where(low * high < 0, positive, np.maximum(pressure, 0.0))
        return self.load(positive.ravel())

    def reynolds_film(self, along, active=None):
        """Load of the film whose pressure is nowhere negative, and where it is a film."""
        source = along @ self.directions
        active = along @ self.full > 0 if active is None else active
        for _ in range(60):
            pressure, wet = np.zeros(len(source)), np.flatnonzero(active)
            if len(wet):
                pressure[wet] = spsolve(self.matrix[wet][:, wet], source[wet])
            excess = self.matrix @ pressure - source
            now = np.where(active, pressure > 0, excess < -1e-14 * np.abs(source).max())
            if (now == active).all():
                break
            active = now
        return self.load(pressure), active


def solve_point(eps, slenderness, directions=DIRECTIONS, grids=GRIDS):
    """(full film's damping, loads of the half film and of Reynolds' film by direction)."""
    scales = full_film_scales(eps, slenderness)
    alphas = np.arctan2(
        np.sin(directions) / scales[1] ** 0.5, np.cos(directions) / scales[0] ** 0.5
    )
    results = []
    for around, along in grids:
        grid, active = Grid(eps, slenderness, around, along), None
        half, reynolds = [], []
        for alpha in alphas:
            unit = np.array([np.cos(alpha), np.sin(alpha)])
            half.append(grid.half_film(unit))
            load, active = grid.reynolds_film(unit, active)
            reynolds.append(load)
        full = np.diag(2 * grid.directions @ grid.full.T)
        results.append((full, np.array(half), np.array(reynolds)))
    return [fine + (fine - coarse) / 3 for coarse, fine in zip(*results, strict=True)]


def solve():
    """Solves all films of the table."""
    shape = len(ROOTS), len(SLENDERNESS), len(DIRECTIONS), 2
    half, reynolds = np.zeros(shape), np.zeros(shape)
    for i, root in enumerate(ROOTS):
        for j, slenderness in enumerate(SLENDERNESS):
            _, half[i, j], reynolds[i, j] = solve_point(np.sqrt(1 - root**2), slenderness)
        print(i, root, flush=True)
    SOLUTIONS.parent.mkdir(exist_ok=True)
    np.savez(SOLUTIONS, half=half, reynolds=reynolds)


def terms_at(roots, slenderness, degree):
    """Products of Chebyshev polynomials in t and z, one after the other."""
    z = slenderness / (slenderness + OFFSET * roots)
    in_t, in_z = (chebvander(2 * x - 1, degree) for x in (roots, z))
    return (in_t[..., :, None] * in_z[..., None, :]).reshape(*np.shape(z), -1)


def harmonics_of(loads, roots, slenderness):
    """Cosine and sine harmonics of the films' loads in their natural plane, and what closing keeps
    where they open."""
    scales = full_film_scales(np.sqrt(np.maximum(1 - roots**2, 0)), slenderness)
    alphas = np.arctan2(
        np.sin(DIRECTIONS) / scales[1][..., None] ** 0.5,
        np.cos(DIRECTIONS) / scales[0][..., None] ** 0.5,
    )
    rho = np.sqrt(
        scales[0][..., None] * np.cos(alphas) ** 2 + scales[1][..., None] * np.sin(alphas) ** 2
    )
    closing, across = (loads[..., i] / rho / scales[i][..., None] ** 0.5 for i in (0, 1))
    weights = np.full(len(DIRECTIONS), 2 / (len(DIRECTIONS) - 1))
    weights[[0, -1]] /= 2
    k = np.arange(9)
    cosines = closing @ (weights[:, None] * np.cos(np.outer(DIRECTIONS, k)))
    sines = across @ (weights[:, None] * np.sin(np.outer(DIRECTIONS, k)))
    return cosines, sines, -closing[..., -1]


def fit():
    """Writes the numbers, and prints how far they are from films that the table does not hold."""
    roots, slenderness = np.meshgrid(ROOTS, SLENDERNESS, indexing="ij")
    eps, table, lines = np.sqrt(1 - roots**2), np.load(SOLUTIONS), []
    degree_of = lambda k: LOW_DEGREE if k < HIGH else HIGH_DEGREE

    def least_squares(value, factor, degree):
        terms = terms_at(roots, slenderness, degree)
        matrix = (factor[..., None] * terms).reshape(value.size, -1)
        numbers = np.linalg.lstsq(matrix, value.ravel(), rcond=1e-11)[0]
        return numbers, terms @ numbers

    for film, (closing, across) in HARMONICS.items():
        cosines, sines, opening = harmonics_of(table[film], roots, slenderness)
        parity = lambda k: eps if k % 2 == 0 else eps**2 if k > 1 else np.ones_like(eps)
        first = None
        for k in (k for k in closing if k):
            numbers, value = least_squares(cosines[..., k], parity(k), degree_of(k))
            first = value if k == 1 else first
            lines.append([film, "closing", k, *numbers])
        kept = np.maximum(opening, 0) - first * roots**3
        numbers, _ = least_squares(kept, eps * roots**3, LOW_DEGREE)
        lines.append([film, "opening", 0, *numbers])
        for k in across:
            value = sines[..., k] - first if k == 1 else sines[..., k]
            factor = eps**2 if k == 1 else parity(k)
            lines.append([film, "across", k, *least_squares(value, factor, degree_of(k))[0]])
    with NUMBERS.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(
            [*line[:3], *(f"{x:.9g}" for x in line[3:])] for line in lines
        )


def check(points=40):
    """Prints how far the package's films are from films that the table does not hold."""
    from jaxclear import film

    random, errors = np.random.default_rng(3), {"half": [], "reynolds": []}
    for k in range(points):
        eps = random.random() if k % 2 else 1 - 10 ** (-2.7 * random.random())
        slenderness = np.exp(random.uniform(np.log(0.1), np.log(4.0)))
        directions = random.uniform(0, np.pi, 2)
        scales = full_film_scales(eps, slenderness)
        _, *loads = solve_point(eps, slenderness, directions, ((160, 20), (320, 40)))
        for law, load in zip((film.HalfFilm(), film.Reynolds()), loads, strict=True):
            for direction, solution in zip(directions, load, strict=True):
                unit = np.array([np.cos(direction), np.sin(direction)]) / scales**0.5
                unit /= np.hypot(*unit)
                error = np.array(law.force(eps, *unit, slenderness)) - solution
                size = np.hypot(*solution) if direction < 2.4 else np.hypot(*(scales**0.5))
                errors["half" if law.__class__ is film.HalfFilm else "reynolds"].append(
                    np.hypot(*error) / size
                )
    for name, values in errors.items():
        print(name, "median, 95 %, largest error", np.quantile(values, [0.5, 0.95, 1.0]))


if __name__ == "__main__":
    {"solve": solve, "fit": fit, "check": check}[sys.argv[1]]()
