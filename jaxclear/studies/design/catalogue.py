"""What widths or sizes a workshop has: grades of ISO 286, or a list of one's own.

A design first takes any width in their range, and then the best of those that there are.
"""

import re
from abc import abstractmethod
from typing import Any

import equinox as eqx
import numpy as np

from jaxclear.ground.argument_errors import nothing_else
from jaxclear.ground.arguments import check_name
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity, vector
from jaxclear.ground.wording import described
from jaxclear.studies.tolerance import iso286

__all__ = ["ISO286", "AbstractCatalogue", "Fits", "Sizes"]
__getattr__, __dir__ = nothing_else("jaxclear.catalogue", __all__)

MILLI, MICRO = 1e-3, 1e-6
FINEST, COARSEST = 5, 18
# Grades of one letter of the hole, and of one of the shaft.
FITS = re.compile(r"([A-Z]{1,2})(\d+)(?:\.\.\1(\d+))?/([a-z]{1,2})(\d+)(?:\.\.\4(\d+))?")


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
        is_list = isinstance(grades, (tuple, list, range)) and len(grades) > 0
        if not is_list or not all(isinstance(grade, int) for grade in grades):
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


class Fits(AbstractQuantified):
    """Classes of hole and shaft among which a fit of a drawing is chosen (`choose` of `design`).

    Mean sizes and limits of both parts are those of the class, whatever its grade.

    Args:
        classes: ranges of grades of the hole and of the shaft, such as "H6..H8/g5..g7", a text; a
            single class, as in "H7/g5..g7", stays as it is on the drawing.

    Raises:
        ValueError: if the text is no such ranges, or one of them is empty.
    """

    classes: str = eqx.field(static=True)
    holes: tuple[str, ...] = eqx.field(static=True)
    shafts: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, classes: str):
        match = FITS.fullmatch(classes.replace(" ", "")) if isinstance(classes, str) else None
        parts = match.groups() if match else ("", "1", "0") * 2
        self.classes = classes
        self.holes, self.shafts = (
            tuple(f"{letter}{grade}" for grade in range(int(first), int(last or first) + 1))
            for letter, first, last in (parts[:3], parts[3:])
        )
        if not self.holes or not self.shafts:
            raise ValueError(
                f"catalogue.Fits has no fit in {described(classes)}; write grades of one letter of "
                'the hole and one of the shaft, the finer first, such as "H6..H8/g5..g7".'
            )


def standard_width(size: float, grade: int) -> float:
    """Width [um] of a grade for a nominal size [m]."""
    return iso286.width(float(size) / MILLI, grade)
