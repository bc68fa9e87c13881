"""From a mechanism to a trajectory: the start is assembled, then the state is carried from one
saving time to the next (`loop`).
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import check_flags, check_number, expect
from jaxclear.ground.compiling import AROUND_A_KERNEL, compiled_quickly
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.wording import described
from jaxclear.integrators.adaptive import Adaptive
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.native import has_kernels, stoppable
from jaxclear.results.saved_state import State
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation import progress
from jaxclear.simulation.beginning import beginning
from jaxclear.simulation.bristles import told_of_bristles
from jaxclear.simulation.by_kernels import compiled_for_kernels
from jaxclear.simulation.dead_point import diagnosed
from jaxclear.simulation.derivatives import backwards, guarded
from jaxclear.simulation.load_steps import judged_by, load_steps
from jaxclear.simulation.loop import Extras, run
from jaxclear.simulation.saving import checked_saving
from jaxclear.simulation.second_look import looked_at_again
from jaxclear.simulation.step_comparison import (
    compared,
    in_other_steps,
    is_compared,
    order_of,
    run_where_alike,
)
from jaxclear.simulation.step_lengths import check_steps
from jaxclear.simulation.wear import worn_faster


class SimulationError(RuntimeError):
    """A run that ended early; the sentence says where and why. `trajectory` holds what was
    computed.
    """

    def __init__(self, sentence: str, trajectory: Trajectory):
        # Both are the exception's arguments: it crosses to another process as it is.
        super().__init__(sentence, trajectory)
        self.trajectory = trajectory

    def __str__(self) -> str:
        return self.args[0]


# A mechanism with more coordinates than these may be too long for a kernel.
FEW_COORDINATES = 32


def _both_ways(mechanism, coordinates, speeds, times, integrator, extras, past):
    """A run that can be differentiated forwards and backwards."""
    given = mechanism, coordinates, speeds, times, past
    if not is_compared(mechanism, integrator):
        whole = lambda *moving: run(*moving[:4], integrator, extras, moving[4])
        return backwards(whole, integrator, *given)

    def in_steps(share, integrator, *moving):
        return run(*moving[:4], in_other_steps(integrator, share), extras, moving[4])

    steps = lambda integrator, *moving: (integrator.asked_step(), moving[3])
    known = compared(in_steps, run_where_alike, steps, order_of(integrator))
    return backwards(known, integrator, integrator, *given)


_run = compiled_quickly(_both_ways, AROUND_A_KERNEL)
_run_soon = compiled_for_kernels(_both_ways)


def saving_times(duration: Any, save: Any) -> Array:
    """Times to save at: a number of equally spaced ones, or the given ones with 0 in front if it is
    missing.
    """
    if not isinstance(save, (list, tuple)) and not getattr(save, "ndim", 0):
        whole = isinstance(save, (int, float, np.number)) and not isinstance(save, bool)
        if not whole or not 2 <= save < np.inf or int(save) != save:
            raise ValueError(
                f"save={described(save)}: it must be a whole number of saving times, at least 2, "
                "or the times themselves."
            )
        return jnp.linspace(0.0, jnp.asarray(duration, float), int(save))
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
    return jnp.asarray(times if times[-1] == duration else np.concatenate([times, [duration]]))


def check_run(mechanism: Mechanism, integrator: AbstractIntegrator) -> None:
    """Whether a mechanism suits an integrator and its formulation. Raises `ValueError` with a
    sentence."""
    expect(mechanism, Mechanism, "what is simulated", "a jaxclear.Mechanism")
    wanted = "one of jaxclear.integrator, such as Adaptive()"
    expect(integrator, AbstractIntegrator, "the integrator", wanted)
    name = f"integrator.{type(integrator).__name__}"
    if mechanism.projects and not integrator.projects:
        raise ValueError(
            f'the loop through joint "{mechanism.topology.loops[0]}" is to be closed by '
            f"projection, which {name} "
            "would take for an error; give stabilisation=jaxclear.Baumgarte(), or take an "
            "integrator with fixed steps."
        )
    integrator.formulation.check(mechanism, name)


def check_duration(duration: Any) -> Any:
    """The duration, if it is a positive number of seconds. Raises `ValueError`."""
    check_number("the duration", duration, "s", above=0)
    return duration


def _check_compiling() -> None:
    # Not every version of JAX names its settings to type checkers.
    settings: Any = jax.config
    if settings.jax_disable_jit:
        raise ValueError(
            "simulate compiles its loop, and jax.disable_jit is on; look into a law or a joint by "
            "calling it alone."
        )


def _check_end(trajectory: Trajectory) -> None:
    """Raises `SimulationError` for a run that ended early, `ValueError` for one that is traced."""
    if isinstance(trajectory.outcome, jax.core.Tracer):
        raise ValueError(
            "simulate is being traced (by jax.jit, vmap or a derivative) and cannot raise: give "
            "throw=False and look at `outcome`, or map jaxclear.Problem.evaluate."
        )
    if not trajectory.succeeded:
        raise SimulationError(told_of_bristles(trajectory), trajectory)


def is_all_kernel(mechanism: Mechanism, integrator: AbstractIntegrator, told: bool = False) -> bool:
    """Whether next to all work of a run is that of its kernels, if it has any and its progress is
    not `told`: then XLA need not optimise the rest, of however many cells worn surfaces are."""
    small = mechanism.topology.coordinate_count <= FEW_COORDINATES
    ready = has_kernels() and integrator.in_kernels
    return small and ready and not told and integrator.steps_between_saves is None


@answering
def simulate(
    mechanism: Mechanism,
    duration: float,
    *,
    integrator: AbstractIntegrator | None = None,
    save: Any = 501,
    state: State | None = None,
    balance: bool = False,
    progress_bar: bool = False,
    throw: bool = True,
) -> Trajectory:
    """Simulate a mechanism for `duration` [s] from its own start.

    `save`: number of equally spaced saving times, or the times [s], or a `Saving`, which keeps
    touches and releases too; worn surfaces are updated at these times. `integrator`:
    `jaxclear.integrator.Adaptive()` by default. `state`: where the run begins instead, such as
    `run.state()` of another one; saving times, worn volumes and energies count from there.
    `balance`: also integrate the energies that `Trajectory.energy_balance` needs. Changing numbers,
    duration or tolerances does not compile again; changing the number of saving times does. Raises
    `ValueError` for a mechanism that cannot start and for a derivative through contacts that open
    and close (see `jaxclear.sensitivity`), and, unless `throw=False`, `SimulationError` with a
    sentence for a run that ends early.
    """
    check_double_precision()
    check_duration(duration)
    check_flags("simulate", balance=balance, progress_bar=progress_bar, throw=throw)
    _check_compiling()
    integrator = Adaptive() if integrator is None else integrator
    check_run(mechanism, integrator)
    saving = checked_saving(save, integrator)
    times = saving_times(duration, saving.at)
    check_steps(integrator, times)
    mechanism = integrator.formulation.seen(mechanism)
    mechanism, start, begins, past = beginning(mechanism, integrator.formulation, state)
    saved = begins + times
    integrator, passed = load_steps(mechanism, integrator, saved)
    with stoppable(), progress.bar(progress_bar, "simulating"):
        extras = Extras(balance, progress_bar, saving.events)
        runs = _run_soon if is_all_kernel(mechanism, integrator, progress_bar) else _run
        begun = lambda worn: (worn_faster(mechanism, worn), start.coordinates, start.speeds)
        again = lambda own, worn=1.0, at=saved: runs(*begun(worn), at, own, extras, past)
        trajectory = diagnosed(guarded(jax.block_until_ready(again(integrator)), integrator))
        trajectory = judged_by(passed, looked_at_again(trajectory, integrator, again))
    if throw:
        _check_end(trajectory)
    return trajectory
