"""Cells of tables of tests that the fast suite leaves out."""

import pytest


def slow(*cells):
    """These are slow tests."""
    many = (cell if isinstance(cell, tuple) else (cell,) for cell in cells)
    return [pytest.param(*own, marks=pytest.mark.slow) for own in many]


def slow_but(fast, cells):
    """All but the `fast` ones are slow tests."""
    return [cell if cell in fast else slow(cell)[0] for cell in cells]
