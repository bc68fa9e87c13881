r"""How the contacts of a mechanism answer forces: Delassus' operator, and what contact laws that
are linear in the rates of their rows do to the motion.

With $M \dot v = f + J^T p$ and loops closed by $C \dot v = w$, forces $p$ along the rows $J$ change
the accelerations by $M^{-1} J^T p$ (within the closures) and the rows' by $W p$,
$W = J M^{-1} J^T$. Source: Delassus 1917, Annales scientifiques de l'ENS 34, 95,
doi:10.24033/asens.701; Acary & Brogliato 2008, Numerical Methods for Nonsmooth Dynamical Systems,
doi:10.1007/978-3-540-75392-6.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxclear.formulations.contact_rows import FreeMotion
from jaxclear.ground import factorisation
from jaxclear.ground import sparse as sp
from jaxclear.ground.elimination import Pattern, solved
from jaxclear.ground.grouping import MANY, in_memory, looked_up, summed, unstacked
from jaxclear.ground.numerics import safe_sqrt
from jaxclear.multibody.dynamics import constrained_inverse
from jaxclear.multibody.kinematics import JacobianRow, along


class DelassusOperator(NamedTuple):
    """How a mechanism moves without contact, and how it responds to forces along rows.

    Args:
        rows: the rows of the Jacobian, a list.
        free: accelerations without contact [m/s^2, rad/s^2], a list.
        multipliers: multipliers of the closed loops without contact, a tuple.
        responses: what a unit force along each row adds to accelerations and multipliers (columns
            of M^-1 J^T), a list of pairs.
    """

    rows: list[JacobianRow]
    free: list
    multipliers: tuple
    responses: list[tuple[list, tuple]]

    def matrix(self) -> list[list]:
        """Delassus' matrix W = J M^-1 J^T: the response of each row's rate to a unit force along
        each.
        """
        return [[along(row, columns) for columns, _ in self.responses] for row in self.rows]

    def lightness(self, contacts: list) -> list[tuple]:
        """Inverse of the mass that a force along the normal of each contact moves, and the mean
        across: diagonal of W.

        Args:
            contacts: number of sliding directions of each contact, a list; its rows are the normal
                and these.

        Returns:
            pairs of inverse masses [1/kg], a list.
        """
        diagonal = [along(row, self.responses[i][0]) for i, row in enumerate(self.rows)]
        result, first = [], 0
        for directions in contacts:
            across = diagonal[first + 1 : first + 1 + directions]
            result.append((diagonal[first], sp.total(across) / max(directions, 1)))
            first += 1 + directions
        return result

    def under(self, forces: list) -> tuple[list, tuple]:
        """What forces (or impulses) along the rows add to the motion.

        Args:
            forces: forces along the rows [N] (or impulses [N s]), a list.

        Returns:
            accelerations (or changes of speed), and closure multipliers, that they add.
        """
        columns, multipliers = zip(*self.responses, strict=True)
        return (
            [sp.dot(forces, entries) for entries in zip(*columns, strict=True)],
            tuple(sp.dot(forces, entries) for entries in zip(*multipliers, strict=True)),
        )


class LinearLaws(NamedTuple):
    """Forces along the rows as functions of their rates: forces - dampings (rates - about)."""

    forces: Any
    dampings: Any
    about: Any

    def at(self, rates: Any) -> list:
        """The forces at given rates."""
        return [
            sp.add(f, sp.mul(d, sp.sub(a, r)))
            for f, d, a, r in zip(self.forces, self.dampings, self.about, rates, strict=True)
        ]


class ContactSolution(NamedTuple):
    """A solution: rates of the contact rows, forces along them, the accelerations and closure
    multipliers these cause.
    """

    rates: Any
    forces: Any
    accelerations: Any
    multipliers: Any


class Entries:
    """Rows of a Jacobian from array to array: their entries one after the other, with the row and
    the column of each."""

    def __init__(self, rows: Sequence[JacobianRow]):
        self.values = in_memory(sp.stack([entry for row in rows for entry in row.values()]))
        self.rows = np.repeat(np.arange(len(rows)), list(map(len, rows)))
        self.columns = np.array([j for row in rows for j in row])

    def by_column(self, size: int) -> list[list[tuple[int, int]]]:
        """By column (row, place) of its entries."""
        out: list[list[tuple[int, int]]] = [[] for _ in range(size)]
        for k, (i, j) in enumerate(zip(self.rows.tolist(), self.columns.tolist(), strict=True)):
            out[j].append((i, k))
        return out


class ImplicitContact(NamedTuple):
    """Free accelerations and closure multipliers without contact, and `solve(reaches, unmoved,
    laws)`: what contact adds where rates = unmoved + reach J k, k the accelerations it causes, and
    each row has a reach [s] of its own."""

    free: list
    multipliers: tuple
    solve: Callable[[list, list, LinearLaws], ContactSolution]


def delassus_operator(free_motion: FreeMotion, rows: list[JacobianRow]) -> DelassusOperator:
    """The response of a mechanism at an instant to forces along rows.

    Args:
        free_motion: equations of motion with the contacts left out, a `FreeMotion`.
        rows: rows of a Jacobian along which forces act, a list.

    Returns:
        a `DelassusOperator`.
    """
    closures = free_motion.closures
    inverse = constrained_inverse(
        free_motion.masses, closures.rows, closures.kinds, closures.dependence
    )
    respond, constrain = inverse
    (unheld,) = respond([list(free_motion.right)])
    free, multipliers = constrain(unheld, closures.targets)
    size, still = len(free_motion.right), [0] * len(multipliers)
    columns = respond([[row.get(j, 0) for j in range(size)] for row in rows])
    responses = [constrain(column, still) for column in columns]
    return DelassusOperator(rows, free, multipliers, responses)


def implicit_contact(
    free_motion: FreeMotion, further: Sequence[JacobianRow] = ()
) -> ImplicitContact:
    """The equations of an instant, solved without contact and ready to be solved with it; `further`
    rows along which forces act stand behind those of the contacts.

    Two ways to one solution, in the fewest unknowns: in the free speeds, (M + reach J^T D J) k =
    J^T p(unmoved), where these are no more than the rows; otherwise in the rows, (1 + S W S) z =
    sqrt(D / reach) (about - ...), S = sqrt(reach D).
    """
    rows = [rate.row for contact in free_motion.contacts for rate in contact.acting]
    rows += further
    size = len(free_motion.right)
    if rows and not free_motion.closures.rows and len(rows) >= size:
        operator = delassus_operator(free_motion, [])
        mass = _block_diagonal(free_motion.masses)
        direction = _speed_space_solver if size < MANY else _array_speed_space_solver
        return ImplicitContact(operator.free, operator.multipliers, direction(mass, rows))
    operator = delassus_operator(free_motion, rows)
    if rows:
        in_rows = _row_space_solver if len(rows) < MANY else _array_row_space_solver
        return ImplicitContact(operator.free, operator.multipliers, in_rows(operator))
    nothing = ContactSolution([], [], [0] * size, (0,) * len(operator.multipliers))
    return ImplicitContact(operator.free, operator.multipliers, lambda *_: nothing)


def _block_diagonal(masses: list) -> list[list]:
    """Mass matrices of the subtrees as one."""
    size = sum(len(mass) for mass in masses)
    out: list[list[Any]] = [[0] * size for _ in range(size)]
    start = 0
    for mass in masses:
        for i, row in enumerate(mass):
            out[start + i][start : start + len(mass)] = row
        start += len(mass)
    return out


def _speed_space_solver(mass: list, rows: list[JacobianRow]) -> Callable:
    """Scalars throughout."""
    size = len(mass)
    # Products of each row with itself, the lower half: they do not change while the laws are
    # iterated upon.
    squares = [{(i, j): sp.mul(row[i], row[j]) for i in row for j in row if j <= i} for row in rows]

    def solve(reaches, unmoved, laws):
        matrix, right = [list(line) for line in mass], [0] * size
        for square, damping, reach in zip(squares, laws.dampings, reaches, strict=True):
            weight = reach * damping
            for (i, j), entry in square.items():
                matrix[i][j] = sp.add(matrix[i][j], sp.mul(entry, weight))
        for row, force in zip(rows, laws.at(unmoved), strict=True):
            for j, entry in row.items():
                right[j] = sp.add(right[j], sp.mul(entry, force))
        result = list(factorisation.solve(factorisation.factor(matrix), tuple(right)))
        rates = [
            sp.add(u, sp.mul(along(row, result), reach))
            for u, row, reach in zip(unmoved, rows, reaches, strict=True)
        ]
        return ContactSolution(rates, laws.at(rates), result, ())

    return solve


def stacked(values: Sequence[Any]) -> jnp.ndarray:
    """Many numbers as an array in memory."""
    return in_memory(sp.stack(values))


def _array_speed_space_solver(mass: list[list], rows: list[JacobianRow]) -> Callable:
    """The same from array to array."""
    size, entries = len(mass), Entries(rows)
    lower = [(i, j) for i in range(size) for j in range(i + 1) if not sp.is_zero(mass[i][j])]
    part, first, pairs = stacked([mass[i][j] for i, j in lower]), 0, []
    for r, row in enumerate(rows):
        each = list(enumerate(row, first))
        pairs += [(r, a, b, (i, j)) for a, i in each for b, j in each if j <= i]
        first += len(row)
    of_row, rest, right, squared = map(list, zip(*pairs, strict=True))
    number = {place: k for k, place in enumerate(dict.fromkeys([*lower, *squared]))}
    places = np.array([number[place] for place in [*lower, *squared]])
    values = entries.values
    squares = looked_up(values, np.array(rest)) * looked_up(values, np.array(right))
    pattern = Pattern(size, tuple(number))

    def solve(reaches, unmoved, laws):
        unmoved, reach, forces, dampings, about = map(stacked, (unmoved, reaches, *laws))
        weights = looked_up(reach * dampings, np.array(of_row))
        matrix = summed(jnp.concatenate([part, squares * weights]), places, len(number))
        pushed = values * looked_up(forces + dampings * (about - unmoved), entries.rows)
        result = solved(pattern, matrix, None, summed(pushed, entries.columns, size))
        moved = values * looked_up(result, entries.columns)
        rates = unmoved + reach * summed(moved, entries.rows, len(rows))
        final = forces + dampings * (about - rates)
        return ContactSolution(*map(unstacked, (rates, final, result)), ())

    return solve


def _row_space_solver(operator: DelassusOperator) -> Callable:
    """In the forces along the rows, made symmetric by the roots of their dampings and reaches."""
    gains = operator.matrix()
    count = len(gains)

    def moved(unmoved, reaches, forces):
        return [
            sp.add(u, sp.mul(reach, sp.dot(line, forces)))
            for u, line, reach in zip(unmoved, gains, reaches, strict=True)
        ]

    def solve(reaches, unmoved, laws):
        roots = [safe_sqrt(d * reach) for d, reach in zip(laws.dampings, reaches, strict=True)]
        matrix = [
            [sp.add(sp.mul(gains[i][j], roots[i] * roots[j]), int(i == j)) for j in range(count)]
            for i in range(count)
        ]
        fixed = moved(unmoved, reaches, laws.forces)
        right = tuple(
            root / reach * sp.sub(a, u)
            for root, reach, a, u in zip(roots, reaches, laws.about, fixed, strict=True)
        )
        shares = factorisation.solve(factorisation.factor(matrix), right)
        final = [
            sp.add(f, root * share)
            for f, root, share in zip(laws.forces, roots, shares, strict=True)
        ]
        return ContactSolution(moved(unmoved, reaches, final), final, *operator.under(final))

    return solve


def _array_row_space_solver(operator: DelassusOperator) -> Callable:
    """The same from array to array."""
    count, size = len(operator.rows), len(operator.free)
    acting = Entries(operator.rows)
    moved = Entries(
        [
            {j: x for j, x in enumerate(column) if not sp.is_zero(x)}
            for column, _ in operator.responses
        ]
    )
    pairs = [
        (a, b, (i, k))
        for here, there in zip(acting.by_column(size), moved.by_column(size), strict=True)
        for i, a in here
        for k, b in there
        if k <= i
    ]
    pattern = {(i, i): i for i in range(count)}
    for *_, place in pairs:
        pattern.setdefault(place, len(pattern))
    rest, right, places = np.array([(a, b, pattern[place]) for a, b, place in pairs]).T
    products = looked_up(acting.values, rest) * looked_up(moved.values, right)
    gains = summed(products, places, len(pattern))
    lower, upper = np.array(list(pattern)).T
    ones = (lower == upper).astype(float)
    off = np.flatnonzero(lower != upper)
    both = np.concatenate([np.arange(len(lower)), off])
    answering, pushing = np.concatenate([lower, upper[off]]), np.concatenate([upper, lower[off]])

    def answered(unmoved, reach, forces):
        terms = looked_up(gains, both) * looked_up(forces, pushing)
        return unmoved + reach * summed(terms, answering, count)

    def solve(reaches, unmoved, laws):
        unmoved, reach, forces, dampings, about = map(stacked, (unmoved, reaches, *laws))
        roots = safe_sqrt(dampings * reach)
        matrix = gains * looked_up(roots, lower) * looked_up(roots, upper) + ones
        target = roots / reach * (about - answered(unmoved, reach, forces))
        final = forces + roots * solved(Pattern(count, tuple(pattern)), matrix, None, target)
        result = summed(moved.values * looked_up(final, moved.rows), moved.columns, size)
        rates, final, result = map(unstacked, (answered(unmoved, reach, final), final, result))
        multipliers = [entries for _, entries in operator.responses]
        added = tuple(sp.dot(final, part) for part in zip(*multipliers, strict=True))
        return ContactSolution(rates, final, result, added)

    return solve
