"""What widths or sizes a workshop has: grades of ISO 286, or a list of one's own.

A design first takes any width in their range, and then the best of those that there are.
"""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import numpy as np

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.ground.arguments import check_name
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity, vector
from jaxclear.ground.wording import described

__all__ = ["ISO286", "AbstractCatalogue", "Sizes"]
__getattr__, __dir__ = nothing_else("jaxclear.catalogue", __all__)

MILLI, MICRO = 1e-3, 1e-6
# Largest size [mm] of each step of nominal sizes, and its standard tolerances IT5 to IT10 [um];
# each fifth grade above is ten times as wide. ISO 286-1:2010, table 1.
STANDARD = {
    3.0: (4, 6, 10, 14, 25, 40),
    6.0: (5, 8, 12, 18, 30, 48),
    10.0: (6, 9, 15, 22, 36, 58),
    18.0: (8, 11, 18, 27, 43, 70),
    30.0: (9, 13, 21, 33, 52, 84),
    50.0: (11, 16, 25, 39, 62, 100),
    80.0: (13, 19, 30, 46, 74, 120),
    120.0: (15, 22, 35, 54, 87, 140),
    180.0: (18, 25, 40, 63, 100, 160),
    250.0: (20, 29, 46, 72, 115, 185),
    315.0: (23, 32, 52, 81, 130, 210),
    400.0: (25, 36, 57, 89, 140, 230),
    500.0: (27, 40, 63, 97, 155, 250),
}
# The one step whose IT11 and IT16 the table does not give as ten and a hundred times its IT6 [um].
EXCEPTION, OF_EXCEPTION = 6.0, {11: 75, 16: 750}
FINEST, COARSEST, DECADE = 5, 18, 5
# A size that is the end of a step but for rounding belongs to it.
ROUNDING = 1e-9


class AbstractCatalogue(AbstractQuantified):
    """Numbers of which one can be chosen."""

    @abstractmethod
    def numbers(self) -> tuple[float, ...]:
        """All numbers, increasing."""

    @abstractmethod
    def label(self, number: float) -> str:
        """Designation of a number.

        Args:
            number: one of the numbers.

        Returns:
            The text.
        """


class Sizes(AbstractCatalogue):
    """A list of sizes, in the unit of what is chosen.

    Args:
        sizes: the numbers, in the varied number's unit.
    """

    sizes: tuple = vector(unit="(in the varied number's unit)", meaning="what there is")

    def numbers(self):
        return tuple(sorted(float(size) for size in self.sizes))

    def label(self, number):
        return f"{number:.6g}"


class ISO286(AbstractCatalogue):
    """Standard tolerances of ISO 286 for a nominal size: half of the width of each grade.

    Widths follow from the tolerance unit $i = 0.45 D^{1/3} + 0.001 D$ [um, mm], rounded by the
    standard.

    Args:
        size: nominal size of the feature [m], > 0 and <= 0.5.
        grades: numbers of grades from 5 to 18; 5 to 13 by default.

    Raises:
        ValueError: if a grade is no such number.

    Source: ISO 286-1:2010, table 1, sizes up to 500 mm, IT5 to IT18.
    """

    size: Scalar = quantity(unit="m", meaning="nominal size of the feature", above=0, at_most=0.5)
    grades: tuple[int, ...] = eqx.field(static=True)

    def __init__(self, size: float, grades: Any = range(FINEST, 14)):
        self.size = size
        whole = isinstance(grades, (tuple, list, range)) and len(grades) > 0
        if not whole or not all(isinstance(grade, int) for grade in grades):
            raise ValueError(
                f"grades of catalogue.ISO286 are {described(grades)}; they must be whole numbers, "
                f"such as range(6, 10)."
            )
        for grade in grades:
            names = [f"IT{one}" for one in range(FINEST, COARSEST + 1)]
            check_name("grade of catalogue.ISO286", f"IT{grade}", names)
        self.grades = tuple(sorted(set(grades)))

    def numbers(self):
        return tuple(0.5 * MICRO * standard_width(self.size, grade) for grade in self.grades)

    def label(self, number):
        grade = self.grades[int(np.argmin(np.abs(np.subtract(self.numbers(), number))))]
        return f"IT{grade}"


def standard_width(size: float, grade: int) -> float:
    """Width [um] of a grade for a nominal size [m]."""
    step = next(end for end in STANDARD if float(size) / MILLI <= end * (1 + ROUNDING))
    if step == EXCEPTION and grade in OF_EXCEPTION:
        return float(OF_EXCEPTION[grade])
    # IT11 is ten times IT6; IT5, the finest, is nobody's tenth.
    tens, place = divmod(max(grade - FINEST - 1, 0), DECADE)
    place += grade > FINEST
    return float(STANDARD[step][place] * 10**tens)
