"""Accelerations under linear contact laws: every way to solve for them gives the solution of the
equations written as arrays.
"""

import numpy as np
import pytest

from jaxclear.formulations import delassus
from jaxclear.formulations.contact_rows import ContactPoint, FreeMotion
from jaxclear.multibody.constraints import ClosureEquations
from jaxclear.multibody.rows import LinearRate

LIMBS = (2, 3)


def equations(rows, closures, seed=1):
    """Random equations of motion of two subtrees, with contact rows and closure rows."""
    random = np.random.default_rng(seed)
    masses = []
    for size in LIMBS:
        root = random.normal(size=(size, size))
        masses.append(root @ root.T + size * np.eye(size))
    size = sum(LIMBS)
    jacobian, held = random.normal(size=(rows, size)), random.normal(size=(closures, size))
    as_rows = lambda matrix: [dict(enumerate(row)) for row in matrix]
    rates = [LinearRate(0.0, row) for row in as_rows(jacobian)]
    contacts = tuple(ContactPoint(None, None, (rate,), 1) for rate in rates)
    right, wanted = random.normal(size=size), random.normal(size=closures)
    apart = FreeMotion(
        None,
        [list(map(list, m)) for m in masses],
        tuple(right),
        ClosureEquations(as_rows(held), list(wanted), (None,) * len(wanted), None),
        {},
        contacts,
    )
    mass = np.zeros((size, size))
    mass[:2, :2], mass[2:, 2:] = masses
    return apart, (mass, jacobian, held, right, wanted), random


def solved(mass, jacobian, held, right, wanted, reach, unmoved, forces, dampings, about):
    """Accelerations with and without contact, from the whole system at once; each row has a
    reach."""
    count = len(wanted)
    weights = dampings * reach
    stiff = mass + jacobian.T @ (weights[:, None] * jacobian)
    pushed = right + jacobian.T @ (forces + dampings * (about - unmoved))

    def whole(matrix, load):
        system = np.block([[matrix, held.T], [held, np.zeros((count, count))]])
        return np.linalg.solve(system, np.concatenate([load, wanted]))[: len(right)]

    free = whole(mass, right)
    # What contact adds is measured from the free motion: rates = unmoved + reach J (k - free).
    return free, whole(stiff, pushed + jacobian.T @ (weights * (jacobian @ free)))


@pytest.mark.parametrize(
    ("rows", "closures", "many"),
    [(6, 0, 65), (6, 0, 5), (2, 0, 65), (6, 2, 65), (2, 1, 65), (2, 0, 1), (6, 2, 2)],
    ids=str,
)
def test_every_way_gives_the_solution_of_the_whole_system(rows, closures, many, monkeypatch):
    monkeypatch.setattr(delassus, "MANY", many)
    apart, arrays, random = equations(rows, closures)
    unmoved, forces, about = random.normal(size=(3, rows))
    dampings = random.uniform(0.0, 1e3, rows) * (np.arange(rows) != 1)
    free_equations = delassus.implicit_contact(apart)
    laws = delassus.LinearLaws(*map(list, (forces, dampings, about)))
    reach = random.uniform(0.05, 0.2, rows)
    found = free_equations.solve(list(reach), list(unmoved), laws)
    free, total = solved(*arrays, reach, unmoved, forces, dampings, about)
    np.testing.assert_allclose(np.array(free_equations.free), free, rtol=1e-10)
    np.testing.assert_allclose(np.array(found.accelerations), total - free, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        np.array(found.rates), unmoved + reach * (arrays[1] @ (total - free)), atol=1e-10
    )
    law = forces + dampings * (about - np.array(found.rates))
    # sqrt(D) and back: forces of hundreds of newtons to rounding.
    np.testing.assert_allclose(np.array(found.forces), law, atol=1e-8)
