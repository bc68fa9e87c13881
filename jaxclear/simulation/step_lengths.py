"""Whether steps can be as long as they were asked for: none goes beyond a saving time, so saving
often shortens them, which costs time and hides what the asked length would do. And whether there
are so many that no run would end.
"""

import warnings
from typing import Any

import jax
import numpy as np

from jaxclear.ground.quantity import concrete, public_name
from jaxclear.integrators.base import AbstractIntegrator

# Share by which saving may add to the steps before it is said.
LITTLE = 0.01
# More steps than any run takes: at 200 ns each, a kernel's fastest, two days.
MOST_STEPS = 1e12
# Steps between saving times whose number is fixed are listed before the run [8 bytes each].
MOST_LISTED = 1e8
# Steps to the end of a run below which the time grows at each of them: past it, rounding takes
# them.
MOST_TOLD_APART = 1e15
# Frames between the warning and the caller of `simulate`.
DEPTH = 3


def check_steps(integrator: AbstractIntegrator | None, times: Any) -> None:
    """Raises `ValueError` where there are more steps than any run takes. Warns where steps that
    were asked for are longer than the intervals between the saving `times` [s] and are shortened to
    them; says nothing where a number is not known."""
    if integrator is None:
        return
    _check_work(integrator, times)
    step = concrete(integrator.asked_step())
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


def _check_work(integrator: AbstractIntegrator, times: Any) -> None:
    """Raises `ValueError` where there are more steps up to the last of the saving `times` [s] than
    any machine goes through, or steps so short that the time does not grow."""
    name = public_name(type(integrator))
    listed = integrator.steps_between_saves
    if listed is not None and listed > MOST_LISTED:
        raise ValueError(
            f"{name} has steps_per_save = {listed}; beyond {MOST_LISTED:.0e} give a step and let "
            "their number follow."
        )
    step, shortest = concrete(integrator.asked_step()), concrete(integrator.shortest_step())
    if step is None or shortest is None or isinstance(times, jax.core.Tracer):
        return
    duration = float(times[-1])
    if duration / step > MOST_STEPS:
        raise ValueError(
            f"{name}(step={step:.6g}) takes {duration / step:.1g} steps to {duration:.6g} s, which "
            f"no machine goes through; for at most {MOST_STEPS:.0e} give a step of at least "
            f"{duration / MOST_STEPS:.1g} s."
        )
    if duration / shortest > MOST_TOLD_APART:
        raise ValueError(
            f"{name} has steps of {shortest:.6g} s in contact, which the time of a run to "
            f"{duration:.6g} s does not resolve; give fewer contact_steps."
        )
