"""Accelerations that contacts cause, for laws that are linear in the rates of their rows, in the
fewest unknowns.

M k = J^T p, p = forces - dampings (rates - about), rates = unmoved + reach J k, closure rows C k =
0. Two ways to one solution, chosen while tracing: in the free speeds, (M + reach J^T D J) k = J^T
p(unmoved), where they are no more than the rows; otherwise in the rows, (1 + reach sqrt(D) G
sqrt(D)) z = sqrt(D) (about - ...), G = J M^-1 J^T within the closures.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.scipy.linalg as jsl

from jaxclear.formulations.contact_rows import ContactJacobianRow, FreeMotion, along
from jaxclear.ground import factorisation
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_sqrt


class ContactSolution(NamedTuple):
    """A solution: rates of the contact rows, forces along them, the accelerations and closure
    multipliers these cause.
    """

    rates: list
    forces: list
    accelerations: list
    multipliers: tuple


class Split(NamedTuple):
    """Free accelerations and closure multipliers without contact, and `push(reach, unmoved, forces,
    dampings, about)`, which gives what contact adds."""

    free: list
    multipliers: tuple
    push: Callable[..., ContactSolution]


class DelassusOperator(NamedTuple):
    """Free accelerations and closure multipliers without contact, and those that a unit force along
    each of some rows adds.
    """

    free: list
    multipliers: tuple
    answers: list[tuple]


def answer(free_motion: FreeMotion, rows: list[ContactJacobianRow]) -> DelassusOperator:
    """How the mechanism of an instant moves without contact, and how it answers forces along the
    rows.
    """
    respond, constrain = _inverse(free_motion)
    free, multipliers = constrain(respond(free_motion.right), free_motion.wanted)
    return DelassusOperator(
        free,
        multipliers,
        _unit_answers(respond, constrain, rows, len(free_motion.right), len(multipliers)),
    )


def _unit_answers(respond, constrain, rows, size, closures) -> list[tuple]:
    return [
        constrain(respond([row.get(j, 0) for j in range(size)]), [0] * closures) for row in rows
    ]


def prepare(free_motion: FreeMotion) -> Split:
    """The equations of an instant, solved without contact and ready to be solved with it."""
    rows = [row for contact in free_motion.contacts for row in contact.rows[: contact.active]]
    size = len(free_motion.right)
    respond, constrain = _inverse(free_motion)
    free, multipliers = constrain(respond(free_motion.right), free_motion.wanted)
    if not rows:
        return Split(
            free,
            multipliers,
            lambda reach, *_: ContactSolution([], [], [0] * size, (0,) * len(multipliers)),
        )
    if free_motion.closure_rows or len(rows) < size:
        answers = _unit_answers(respond, constrain, rows, size, len(multipliers))
        return Split(free, multipliers, _in_rows(rows, answers))
    mass = _whole(free_motion.masses)
    way = _in_speeds if size <= factorisation.LARGEST_WRITTEN_OUT else _in_many_speeds
    return Split(free, multipliers, way(mass, rows))


def by_subtrees(masses: list) -> Callable:
    """Accelerations under generalised forces, by the mass matrix of each subtree; structurally zero
    where no force acts.
    """
    factors = [factorisation.factor(mass) if mass else None for mass in masses]

    def respond(forces):
        out, start = [], 0
        for mass, factor in zip(masses, factors, strict=True):
            part = tuple(forces[start : start + len(mass)])
            out += part if all(map(sp.is_zero, part)) else factorisation.solve(factor, part)
            start += len(mass)
        return out

    return respond


def _inverse(free_motion: FreeMotion) -> tuple[Callable, Callable]:
    """(accelerations under generalised forces, the same corrected to what the closures want with
    its multipliers).
    """
    respond = by_subtrees(free_motion.masses)
    closures, size = free_motion.closure_rows, len(free_motion.right)
    carried = [respond([row.get(j, 0) for j in range(size)]) for row in closures]
    held = (
        factorisation.factor([[along(row, other) for other in carried] for row in closures])
        if closures
        else None
    )

    def constrain(accelerations, wanted):
        if not closures:
            return accelerations, ()
        lacking = tuple(
            sp.sub(w, along(row, accelerations)) for w, row in zip(wanted, closures, strict=True)
        )
        multipliers = factorisation.solve(held, lacking)
        pulls = [sp.dot(multipliers, column) for column in zip(*carried, strict=True)]
        return [sp.add(a, p) for a, p in zip(accelerations, pulls, strict=True)], multipliers

    return respond, constrain


def _whole(masses: list) -> list[list]:
    """Mass matrices of the subtrees as one."""
    size = sum(len(mass) for mass in masses)
    out: list[list[Any]] = [[0] * size for _ in range(size)]
    start = 0
    for mass in masses:
        for i, row in enumerate(mass):
            out[start + i][start : start + len(mass)] = row
        start += len(mass)
    return out


def _moved(forces, dampings, about, rates) -> list:
    """Forces of the linear laws at given rates."""
    return [
        sp.add(f, sp.mul(d, sp.sub(a, r)))
        for f, d, a, r in zip(forces, dampings, about, rates, strict=True)
    ]


def _in_speeds(mass: list, rows: list[ContactJacobianRow]) -> Callable:
    """Scalars throughout."""
    size = len(mass)
    # Products of each row with itself, the lower half: they do not change while the laws are
    # iterated upon.
    squares = [{(i, j): sp.mul(row[i], row[j]) for i in row for j in row if j <= i} for row in rows]

    def push(reach, unmoved, forces, dampings, about):
        matrix, right = [list(line) for line in mass], [0] * size
        for square, damping in zip(squares, dampings, strict=True):
            weight = reach * damping
            for (i, j), entry in square.items():
                matrix[i][j] = sp.add(matrix[i][j], sp.mul(entry, weight))
        for row, force in zip(rows, _moved(forces, dampings, about, unmoved), strict=True):
            for j, entry in row.items():
                right[j] = sp.add(right[j], sp.mul(entry, force))
        found = list(factorisation.solve(factorisation.factor(matrix), tuple(right)))
        rates = [
            sp.add(u, sp.mul(along(row, found), reach))
            for u, row in zip(unmoved, rows, strict=True)
        ]
        return ContactSolution(rates, _moved(forces, dampings, about, rates), found, ())

    return push


def _in_many_speeds(mass: list, rows: list[ContactJacobianRow]) -> Callable:
    """The same as arrays."""
    mass = factorisation.to_array(tuple(map(tuple, mass)))
    jacobian = factorisation.to_array(
        tuple(tuple(row.get(j, 0) for j in range(len(mass))) for row in rows)
    )

    def push(reach, unmoved, forces, dampings, about):
        unmoved, forces, dampings, about = (
            sp.stack(part) for part in (unmoved, forces, dampings, about)
        )
        factor = jsl.cho_factor(mass + (reach * jacobian.T * dampings) @ jacobian, lower=True)
        found = jsl.cho_solve(factor, jacobian.T @ (forces + dampings * (about - unmoved)))
        rates = unmoved + reach * (jacobian @ found)
        return ContactSolution(
            list(rates), list(forces + dampings * (about - rates)), list(found), ()
        )

    return push


def _in_rows(rows: list[ContactJacobianRow], answers: list[tuple]) -> Callable:
    """`answers` are each row's accelerations and multipliers under a unit force along it."""
    gains = [[along(row, answer) for answer, _ in answers] for row in rows]

    def push(reach, unmoved, forces, dampings, about):
        roots = [safe_sqrt(damping) for damping in dampings]
        matrix = [
            [
                sp.add(sp.mul(gain, reach * a * b), int(i == j))
                for j, (gain, b) in enumerate(zip(line, roots, strict=True))
            ]
            for i, (line, a) in enumerate(zip(gains, roots, strict=True))
        ]
        held = [
            sp.add(u, sp.mul(reach, sp.dot(line, forces)))
            for u, line in zip(unmoved, gains, strict=True)
        ]
        right = tuple(root * sp.sub(a, u) for root, a, u in zip(roots, about, held, strict=True))
        shares = factorisation.solve(factorisation.factor(matrix), right)
        final = [
            sp.add(f, root * share) for f, root, share in zip(forces, roots, shares, strict=True)
        ]
        rates = [
            sp.add(u, sp.mul(reach, sp.dot(line, final)))
            for u, line in zip(unmoved, gains, strict=True)
        ]
        accelerations, multipliers = (
            tuple(
                sp.dot(final, column)
                for column in zip(*[answer[i] for answer in answers], strict=True)
            )
            for i in (0, 1)
        )
        return ContactSolution(rates, final, list(accelerations), multipliers)

    return push
