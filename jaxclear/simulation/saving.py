"""What a run keeps: states at saving times, and touches and releases of contacts in between."""

from dataclasses import dataclass, field
from typing import Any

from jaxclear.ground.arguments import check_count
from jaxclear.integrators.base import AbstractIntegrator

__all__ = ["Saving", "as_saving", "checked_saving"]


@dataclass(frozen=True)
class Saving:
    """What a run keeps: `at` is a number of equally spaced saving times, or the times [s];
    `events`: how many touches and releases of each contact are kept between two of them, for
    `run.events()`. Steps that know how touches move (`integrator.Adaptive`,
    `FixedStep` by "rk4") give their instants derivatives."""

    at: Any = 501
    events: int = field(default=0, metadata={"at_least": 0})

    def __post_init__(self) -> None:
        check_count("events of Saving", self.events, at_least=0)


def as_saving(save: Any) -> Saving:
    """What `save` asks for: a number of saving times, the times [s], or a `Saving`."""
    return save if isinstance(save, Saving) else Saving(save)


def checked_saving(save: Any, integrator: AbstractIntegrator) -> Saving:
    """What `save` asks for. Raises `ValueError` for events of an integrator that notes none."""
    saving = as_saving(save)
    if saving.events and not integrator.notes_events:
        raise ValueError(
            f"integrator.{type(integrator).__name__} notes no touches and releases: its contacts "
            "close and open within steps. Leave events out, or take a compliant integrator such as "
            "Adaptive."
        )
    return saving
