"""Couplings that are no equation: forces between coordinates, with states where they need some."""

from abc import abstractmethod
from typing import Any, ClassVar

from jaxclear.components.coupling.base import AbstractCoupling
from jaxclear.components.load_base import AbstractStateLoad, CoordinateEffect


class AbstractForceCoupling(AbstractCoupling, AbstractStateLoad):
    """Forces on the coordinates of joints that turn or slide, or of motors, by what they all do and
    by states of its own: a load, as `load.AbstractStateLoad` has it, that belongs to the drive
    train. It may act on joints that are driven, whose drives bring its power."""

    switches: ClassVar = True

    @abstractmethod
    def transmitted(self, effect: CoordinateEffect) -> Any:
        """What the coupling transmits, as `run.transmitted` reports it.

        Args:
            effect: what it does at an instant, a `CoordinateEffect`.

        Returns:
            the torque or force [N m, N].
        """

    @abstractmethod
    def along(self) -> str | None:
        """The coordinate in whose unit of force that is; None for N."""

    def joints(self):
        return tuple(name for name in self.coordinates() if not name.endswith(".motor"))

    @property
    def gives(self):
        # Its force is its own, and no spring's along the gradient of an equation.
        return False


def check_needed(coupling: Any, *fields: str) -> None:
    """Raises `ValueError` for a coupling whose fields, which have defaults where others do without
    them, are None."""
    for field in fields:
        if getattr(coupling, field) is None:
            raise ValueError(
                f"coupling.{type(coupling).__name__} needs {field}: what it transmits is a force "
                "of a spring."
            )
