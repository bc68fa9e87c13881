"""Whether steps can be as long as they were asked for: none goes beyond a saving time, so saving
often shortens them, which costs time and hides what the asked length would do.
"""

import warnings
from typing import Any

import jax
import numpy as np

from jaxclear.ground.quantity import concrete, public_name
from jaxclear.integrators.base import AbstractIntegrator

# Share by which saving may add to the steps before it is said.
LITTLE = 0.01
# Frames between the warning and the caller of `simulate`.
DEPTH = 3


def warn_of_shortened_steps(integrator: AbstractIntegrator | None, times: Any) -> None:
    """Warns where steps that were asked for are longer than the intervals between the saving
    `times` [s] and are shortened to them; says nothing where a number is not known."""
    step = None if integrator is None else concrete(integrator.asked_step())
    if step is None or isinstance(times, jax.core.Tracer):
        return
    intervals = np.diff(np.asarray(times))
    taken = np.where(intervals < step, 1.0, intervals / step).sum()
    more = taken * step / intervals.sum()
    if intervals.min() < step and more > 1 + LITTLE:
        name = public_name(type(integrator))
        warnings.warn(
            f"{name}(step={step:.6g}) asks for longer steps than the shortest saving interval of "
            f"{intervals.min():.6g} s: steps end at every saving time, so they are shortened, and "
            f"{more:.3g} times as many are taken. Save less often, or give the step that is meant.",
            UserWarning,
            stacklevel=DEPTH,
        )
