"""What diffrax asks of a solver that is stepped by another one's steps."""

from typing import Any


class AbstractAround:
    """In front of diffrax's classes: of the orders and terms of `solver`."""

    solver: Any

    @property
    def term_structure(self):
        return self.solver.term_structure

    def order(self, terms):
        return self.solver.order(terms)

    def error_order(self, terms):
        return self.solver.error_order(terms)
