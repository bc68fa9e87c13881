"""Figures of runs and studies: `jaxclear.plot`."""

from jaxclear.plot.figures import (
    angular_velocity,
    displacement,
    end_centres,
    journal_ends,
    monte_carlo,
    pointing_budget,
    sensitivity,
    wear_surface,
    wear_unrolled,
    work_precision,
)

__all__ = [
    "angular_velocity",
    "displacement",
    "end_centres",
    "journal_ends",
    "monte_carlo",
    "pointing_budget",
    "sensitivity",
    "wear_surface",
    "wear_unrolled",
    "work_precision",
]
