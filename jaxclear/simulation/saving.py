"""What a run keeps: states at saving times, and touches and releases of contacts in between."""

import math
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground.arguments import check_count
from jaxclear.ground.quantity import concrete, is_traced, on_host
from jaxclear.ground.warning import warn
from jaxclear.ground.wording import described, public_name
from jaxclear.integrators.base import MOST_STEPS, AbstractIntegrator


@dataclass(frozen=True)
class Saving:
    """What a run keeps.

    Steps that know how touches move (`integrator.Adaptive`, `FixedStep` by "rk4") give the instants
    of events derivatives.

    Args:
        at: number of equally spaced saving times, >= 2, or the times [s].
        events: number of touches and releases of each contact that are kept between two saving
            times, for `run.events()`, >= 0.
    """

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


# Share by which saving may add to the steps before it is said.
LITTLE = 0.01
# Steps between saving times whose number is fixed are listed before the run [8 bytes each].
MOST_LISTED = 1e8
# Steps to the end of a run below which the time grows at each of them: past it, rounding takes
# them.
LARGEST_DISTINCT = 1e15


def saving_times(duration: Any, save: Any) -> Any:
    """Times to save at: a number of equally spaced ones, or the given ones with 0 in front if it is
    missing. NumPy's, unless the duration is traced.
    """
    if not isinstance(save, (list, tuple)) and not getattr(save, "ndim", 0):
        is_count = isinstance(save, (int, float, np.number)) and not isinstance(save, bool)
        if not is_count or not 2 <= save < np.inf or int(save) != save:
            raise ValueError(
                f"save={described(save)}: it must be a whole number of saving times, at least 2, "
                "or the times themselves."
            )
        return _equally_spaced(duration, int(save))
    try:
        times = np.asarray(save, float)
    except (TypeError, ValueError):
        raise ValueError(f"save={described(save)}: the times to save at must be numbers.") from None
    rising = times.ndim == 1 and times.size > 0 and np.all(np.diff(times) > 0)
    if not (rising and times[0] >= 0 and times[-1] <= float(duration)):
        raise ValueError(
            "the times to save at must increase from 0 or later to at most the duration."
        )
    times = times if times[0] == 0 else np.concatenate([[0.0], times])
    return times if times[-1] == duration else np.concatenate([times, [duration]])


def _equally_spaced(duration: Any, count: int) -> Any:
    if is_traced(duration):
        return jnp.linspace(0.0, jnp.asarray(duration, float), count)
    # In the order in which XLA multiplies.
    last = np.asarray(duration, float)
    return np.append(last * (1 / (count - 1)) * np.arange(count - 1), last)


def check_steps(integrator: AbstractIntegrator | None, times: Any) -> None:
    """Raises `ValueError` where there are more steps than any run takes. Warns where steps that
    were asked for are longer than the intervals between the saving `times` [s] and are shortened to
    them; says nothing where a number is not known."""
    if integrator is None:
        return
    integrator = on_host(integrator)
    _check_work(integrator, times)
    step = concrete(integrator.requested_step())
    if step is None or isinstance(times, jax.core.Tracer):
        return
    intervals = np.diff(np.asarray(times))
    taken = np.where(intervals < step, 1.0, intervals / step).sum()
    more = taken * step / intervals.sum()
    if intervals.min() < step and more > 1 + LITTLE:
        name = public_name(type(integrator))
        warn(
            f"{name}(step={step:.6g}) asks for longer steps than the shortest saving interval of "
            f"{intervals.min():.6g} s: steps end at every saving time, so they are shortened, and "
            f"{more:.3g} times as many are taken. Save less often, or give the step that is meant."
        )


def with_few_enough_steps(
    integrator: AbstractIntegrator, times: Float[Array, " saves"]
) -> AbstractIntegrator:
    """The integrator, its step nan where a number that only the compiled program knows asks for
    more steps up to the last of the saving times [s] than any run takes: what it ends with is then
    no number, where it would go on for ever."""
    step = integrator.requested_step()
    if step is None or concrete(step) is not None:
        return integrator
    few = times[-1] - times[0] <= MOST_STEPS * step
    finer = integrator.with_finer_steps(jnp.where(few, 1.0, jnp.nan))
    return integrator if finer is None else finer


def _check_work(integrator: AbstractIntegrator, times: Any) -> None:
    """Raises `ValueError` where there are more steps up to the last of the saving `times` [s] than
    any machine goes through, or steps so short that the time does not grow."""
    kind = type(integrator)
    listed = integrator.steps_between_saves
    if listed is not None and listed > MOST_LISTED:
        raise ValueError(
            f"{public_name(kind)} has steps_per_save = {listed}; beyond {MOST_LISTED:.0e} give a "
            "step and let their number follow."
        )
    step, shortest = concrete(integrator.requested_step()), concrete(integrator.shortest_step())
    if step is None or shortest is None or isinstance(times, jax.core.Tracer):
        return
    duration = float(np.asarray(times)[-1])
    # A number put into a built integrator may be 0.
    steps, shortest_steps = (duration / h if h > 0 else math.inf for h in (step, shortest))
    if steps > MOST_STEPS:
        raise ValueError(
            f"{public_name(kind)}(step={step:.6g}) takes {steps:.1g} steps to {duration:.6g} s, "
            f"which no machine goes through; for at most {MOST_STEPS:.0e} give a step of at least "
            f"{duration / MOST_STEPS:.1g} s."
        )
    if shortest_steps > LARGEST_DISTINCT:
        raise ValueError(
            f"{public_name(kind)} has steps of {shortest:.6g} s in contact, which the time of a "
            f"run to {duration:.6g} s does not resolve; give fewer contact_steps."
        )
