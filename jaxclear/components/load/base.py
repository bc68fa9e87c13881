"""What all loads have in common, and what springs with dampers have."""

from typing import Any

from jaxclear.ground.quantity import AbstractQuantified


class AbstractLoad(AbstractQuantified):
    """A load on bodies, or on the coordinate of a joint."""

    def springs_back(self) -> bool:
        """Whether what it acts on may swing by it, as by a spring; it may unless overridden."""
        return True


def check_acts(spring: Any) -> None:
    """Raises `ValueError` for a spring that is neither one nor a damper."""
    if spring.stiffness is None and spring.damping is None:
        name = type(spring).__name__
        raise ValueError(f"load.{name} needs stiffness or damping, or both; it has neither.")
