"""From a mechanism to a trajectory: the start is assembled, then the state is carried from one
saving time to the next (`loop`).
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.errors.accuracy import Bounds, bounds_of_run
from jaxclear.errors.choice import (
    Again,
    Chosen,
    Question,
    choose_setting,
    is_usual_cheap,
    keeps_accuracy,
    rungs_of,
)
from jaxclear.errors.estimates import HALF, Verified
from jaxclear.errors.verification import Replica, verify_run
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_flags, check_number, expect
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.quantity import is_traced, on_host, with_numbers_alone, with_quantities
from jaxclear.ground.recent_results import Key, Latest, Value
from jaxclear.ground.warning import count_warnings
from jaxclear.integrators.adaptive import Adaptive
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.integrators.checks import Outcome
from jaxclear.multibody.mechanism import Mechanism, check_mechanism, stabilised_as_needed
from jaxclear.multibody.system import wearing_in
from jaxclear.native import forwards_only, has_kernels, stoppable
from jaxclear.native.compiled import AROUND_A_KERNEL, compiled_for_kernels, compiled_quickly
from jaxclear.results.state_history import State
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation import progress
from jaxclear.simulation.derivatives import (
    backwards,
    compared,
    guarded,
    in_other_steps,
    is_compared,
    order_of,
    refuse_run,
    until_the_end,
)
from jaxclear.simulation.initial_state import Beginning, beginning, state_of
from jaxclear.simulation.load_steps import LoadSteps, load_steps, run_felt
from jaxclear.simulation.loop import Extras, run
from jaxclear.simulation.not_finite import message_of_the_end
from jaxclear.simulation.sampling import check_instants
from jaxclear.simulation.saving import Saving, as_saving, check_steps, checked_saving, saving_times
from jaxclear.simulation.singular_positions import diagnosed
from jaxclear.simulation.wear import with_coarser_cells


class SimulationError(RuntimeError):
    """A run that ended early.

    Args:
        sentence: text that says where and why.
        trajectory: what was computed, a `Trajectory`.
    """

    def __init__(self, sentence: str, trajectory: Trajectory):
        # Both are the exception's arguments: it crosses to another process as it is.
        super().__init__(sentence, trajectory)
        self.trajectory = trajectory

    def __str__(self) -> str:
        return self.args[0]


# What a derivative in reverse mode is told where the run is neither pushed forwards nor one kernel.
NOT_BACKWARDS = (
    "a derivative in reverse mode (jax.grad, jax.vjp, jax.jacrev, jax.hessian) does not go through "
    "a run that shows its progress: leave progress_bar out, or take forward mode (jax.jvp, "
    "jax.jacfwd; jax.jacfwd of it for second derivatives)."
)
# A mechanism with more coordinates than these may be too long for a kernel.
FEW_COORDINATES = 32


def _run_differentiable(mechanism, coordinates, speeds, times, integrator, extras, past, updates):
    """A run that can be differentiated forwards and, where it shows no progress, backwards."""
    inputs = mechanism, coordinates, speeds, times, integrator, extras, past, updates
    runner: Any = run
    if is_compared(mechanism, integrator):
        finer = lambda share, *args: (*args[:4], in_other_steps(args[4], share, args[3]), *args[5:])
        steps = lambda *args: (args[4].requested_step(), args[3])
        runner = compared(run, finer, refuse_run, steps, order_of(mechanism, integrator))
    result = backwards(integrator)(runner, *inputs)
    visible = extras.report and integrator.steps_between_saves is None
    return forwards_only(NOT_BACKWARDS, result) if visible else result


# What was simulated lately, by its arrays: those of JAX nobody changes.
_KEYS: Latest[Key] = Latest(16)
# Where runs from a mechanism's own start began, and in which steps, but for what was warned of;
# which forms of mechanisms suit their integrators.
_INITIAL: Latest[Beginning] = Latest(16)
_STEPS: Latest[LoadSteps] = Latest(16)
_SUITS: Latest[bool] = Latest(64)

_run = compiled_quickly(_run_differentiable, AROUND_A_KERNEL)
_run_soon = compiled_for_kernels(_run_differentiable)


def check_run(mechanism: Mechanism, integrator: AbstractIntegrator) -> None:
    """Whether a mechanism suits an integrator and its formulation. Raises `ValueError` with a
    sentence."""
    expect(mechanism, Mechanism, "what is simulated", "a jaxclear.Mechanism")
    expected = "one of jaxclear.integrator, such as Adaptive()"
    expect(integrator, AbstractIntegrator, "the integrator", expected)
    key = None if is_traced(mechanism.couplings) else _form_of_mechanism(mechanism, integrator)
    if key is None or _SUITS.get(key) is None:
        _check_suited(mechanism, integrator)
        if key is not None:
            _SUITS.keep(key, True)


def _form_of_mechanism(mechanism: Mechanism, integrator: AbstractIntegrator) -> Key:
    """All by which a mechanism suits an integrator: of numbers those of couplings alone."""
    leaves, structure = jax.tree.flatten((mechanism, integrator))
    return Key(structure, [x for x in leaves if not eqx.is_array(x)], mechanism.couplings)


def _check_suited(mechanism: Mechanism, integrator: AbstractIntegrator) -> None:
    name = f"integrator.{type(integrator).__name__}"
    check_mechanism(mechanism, "what is simulated")
    mechanism = on_host(mechanism)
    joints = stabilised_as_needed(mechanism, integrator.opens_loops)
    if joints.projects and not integrator.projects:
        raise ValueError(
            f'the loop through joint "{mechanism.topology.loops[0]}" is to be closed by '
            f"projection, which {name} "
            "would take for an error; give stabilisation=jaxclear.Baumgarte(), or take an "
            "integrator with fixed steps."
        )
    integrator.formulation.check(mechanism, name)
    check_instants(mechanism, integrator)


def check_duration(duration: Any) -> Any:
    """The duration, if it is a positive number of seconds. Raises `ValueError`."""
    check_number("the duration", duration, "s", above=0)
    return duration


def _check_end(trajectory: Trajectory) -> None:
    """Raises `SimulationError` for a run that ended early, `ValueError` for one that is traced."""
    if isinstance(trajectory.outcome, jax.core.Tracer):
        raise ValueError(
            "simulate is being traced (by jax.jit, vmap or a derivative) and cannot raise: give "
            "throw=False and look at `outcome`, or map jaxclear.Problem.evaluate."
        )
    if not trajectory.succeeded:
        raise SimulationError(message_of_the_end(trajectory), trajectory)


def is_all_kernel(mechanism: Mechanism, integrator: AbstractIntegrator, loud: bool = False) -> bool:
    """Whether nearly all work of a run is in its kernels, so that XLA need not optimise the rest.

    Args:
        mechanism: few coordinates suit.
        integrator: whether its steps are in kernels.
        loud: whether the run reports its progress, which leaves the kernels.
    """
    # A motor has an equation of its own, whatever the others do.
    branches = (branch for branch in mechanism.topology.branches if not branch.motor)
    small = sum(branch.coordinate_count for branch in branches) <= FEW_COORDINATES
    ready = has_kernels() and integrator.in_kernels
    return small and ready and not loud and integrator.steps_between_saves is None


class How(NamedTuple):
    """How a mechanism is run: `save`, `state`, `balance`, `progress_bar` and `verify` as of
    `simulate`."""

    save: Any
    state: State | None = None
    balance: bool = False
    progress_bar: bool = False
    verify: bool | None = False


@answering
def simulate(
    mechanism: Mechanism,
    duration: float,
    *,
    integrator: AbstractIntegrator | None = None,
    accuracy: Any = None,
    save: Any = 501,
    state: State | None = None,
    balance: bool = False,
    progress_bar: bool = False,
    throw: bool = True,
    verify: bool | None = None,
) -> Trajectory:
    """Simulate a mechanism from its own start or from a given state.

    Changing numbers, duration or tolerances does not compile again; changing the number of saving
    times does.

    Args:
        mechanism: the mechanism.
        duration: length of the run [s], > 0.
        integrator: one of `jaxclear.integrator`; by default `Adaptive()`.
        accuracy: instead of `integrator`, which is then `Adaptive()`, or where that takes long or
            is not as accurate, chosen by trial runs for the least work: relative accuracy of
            positions, mean forces and losses [1], such as 0.01; or absolute accuracies by the name
            of a quantity of `print(run)`, or by response, in its unit, a dict.
        save: number of equally spaced saving times, >= 2; or the times [s]; or a `Saving`, which
            keeps touches and releases too. Worn surfaces are updated as contacts move, and at
            these times.
        state: state in which the run begins instead of the mechanism's start, such as `run.state()`
            of another run; saving times, worn volumes and energies count from there.
        balance: whether to integrate the energies that `Trajectory.energy_balance` needs.
        progress_bar: whether to show a progress bar.
        throw: whether to raise `SimulationError` for a run that ends early; without it the result
            says why.
        verify: whether to repeat the run with finer steps, for the errors of its numbers
            (`estimate`, `print`); by default up to 100 000 steps or with an `accuracy`, and not
            where the run is traced.

    Returns:
        states, contacts and reactions over time, a `Trajectory`.

    Raises:
        ValueError: if an argument is wrong, if the mechanism cannot start, or for a derivative
            through contacts that open and close (see `jaxclear.sensitivity`).
        SimulationError: if the run ends early, unless `throw=False`.
    """
    how = How(save, state, balance, progress_bar, verify)
    _check_options(duration, how, throw)
    if accuracy is not None:
        check_one_of_two("simulate", integrator)
        bounds, how = bounds_of_run(accuracy), how._replace(verify=verify is not False)
        trajectory = _simulate_to_accuracy(mechanism, duration, how, bounds)
    else:
        integrator = _usual_integrator() if integrator is None else integrator
        trajectory = _simulate_once(mechanism, duration, integrator, how)
    if throw:
        _check_end(trajectory)
    return trajectory


@functools.cache
def _usual_integrator() -> AbstractIntegrator:
    """Built once: it has many checks."""
    with jax.ensure_compile_time_eval():
        return Adaptive()


def _check_options(duration: Any, how: How, throw: bool) -> None:
    """Raises where something is not what a run may be asked."""
    check_double_precision()
    check_duration(duration)
    check_flags("simulate", balance=how.balance, progress_bar=how.progress_bar, throw=throw)
    if how.verify is not None:
        check_flags("simulate", verify=how.verify)
    # Not every version of JAX names its settings to type checkers.
    settings: Any = jax.config
    if settings.jax_disable_jit:
        raise ValueError(
            "simulate compiles its loop, and jax.disable_jit is on; look into a law or a joint by "
            "calling it alone."
        )


def _make_key(mechanism: Mechanism, integrator: AbstractIntegrator) -> Key:
    """A mechanism and an integrator, their quantities arrays, as a key; of the same arrays as
    lately it is the same one, which knows all that is derived from it."""
    key = Key(mechanism, integrator)
    arrays = tuple(map(id, key.leaves))
    earlier = _KEYS.get(arrays)
    # It holds its arrays, so no others are at their addresses.
    if earlier is not None and key.structure == earlier.structure:
        return earlier
    converted = with_quantities(key.arguments)
    if converted is not key.arguments:
        return Key(*converted)
    if all(isinstance(leaf, jax.Array) for leaf in key.leaves) and not is_traced(key.leaves):
        _KEYS.keep(arrays, key)
    return key


def _get_or_compute(latest: Latest[Value], key: Any, find: Callable[[], Value]) -> Value:
    """What was found lately under a key, or what is found now (None: nobody may find it again).
    What warns is looked for each time."""
    cached = None if key is None else latest.get(key)
    if cached is not None:
        return cached
    before, value = count_warnings(), find()
    if key is not None and count_warnings() == before:
        latest.keep(key, value)
    return value


def _simulate_once(
    mechanism: Mechanism,
    duration: float,
    integrator: AbstractIntegrator,
    how: How,
    bounds: Bounds | None = None,
) -> Trajectory:
    """A run, however it ended. `bounds`: its accuracy (None: what the integrator promises)."""
    given = _make_key(mechanism, integrator)
    mechanism, integrator = given.arguments
    # By which the beginning of a run from a mechanism's own start is found again, if it can be.
    can_begin = isinstance(mechanism, Mechanism) and isinstance(integrator, AbstractIntegrator)
    key = given if can_begin and how.state is None and not is_traced(given.leaves) else None
    if key is None or _INITIAL.get(key) is None:
        check_run(mechanism, integrator)
    saving = checked_saving(how.save, integrator)
    times = saving_times(duration, saving.at)
    saved = on_host(0.0 if key is not None else state_of(how.state).start_time) + on_host(times)

    def steps() -> LoadSteps:
        check_steps(integrator, times)
        return load_steps(mechanism, integrator, saved)

    def start_state() -> Beginning:
        formulation = integrator.formulation
        return beginning(formulation.modelled(mechanism), formulation, state_of(how.state))

    of_times = None if key is None or is_traced(times) else (key, np.asarray(times).tobytes())
    step_limits = _get_or_compute(_STEPS, of_times, steps)
    mechanism, start, past, doubt, sound = _get_or_compute(_INITIAL, key, start_state)
    integrator, shares = step_limits
    total = 1.0
    if how.progress_bar and how.verify is not False:
        total += 1 / HALF + bool(wearing_in(mechanism))
    with progress.bar(how.progress_bar, "simulating", total) as part:
        extras = Extras(how.balance, how.progress_bar, saving.events)
        kernel = is_all_kernel(mechanism, integrator, how.progress_bar)
        runs = _run_soon if kernel else _run

        def again(one: Replica, moved: float = 0.0) -> Trajectory:
            coordinates = on_host(start.coordinates) + moved if moved else start.coordinates
            wearing = with_coarser_cells(mechanism, one.coarseness)
            inputs = wearing, coordinates, start.speeds, on_host(one.times)
            more = one.integrator, extras, past, np.asarray(one.updates)
            with part(one.work):
                result = runs(*inputs, *more)
                # All of a program is there when some of it is.
                jax.block_until_ready(result.outcome)
                return result

        with stoppable():
            make_run = lambda steps: again(Replica(steps, saved))
            run = again(Replica(integrator, saved))
            run, integrator = run_felt(run, integrator, shares, make_run)
            run = until_the_end(diagnosed(guarded(run, integrator)))
            if is_traced(sound):
                outcome = jnp.where(sound, run.outcome, Outcome.UNASSEMBLED)
                ended = jnp.where(sound, run.ended, saved[0])
                run = dataclasses.replace(run, outcome=outcome, ended=ended)
        run = verify_run(run, integrator, again, how.verify, bounds)
        if is_traced(run.outcome):
            run = with_numbers_alone(run)
    return dataclasses.replace(run, assembly_warnings=(doubt,)) if doubt else run


# Whether a run by `Adaptive()` takes less than a choice, by the form of a mechanism and its times.
_USUAL_IS_CHEAP: Latest[bool] = Latest(64)
USUAL = "Run with integrator.Adaptive(): choosing another would take longer."


def _simulate_to_accuracy(
    mechanism: Mechanism, duration: float, how: How, bounds: Bounds
) -> Trajectory:
    """A run that keeps an accuracy: the usual one, where its companions find it to and a choice
    would take longer; otherwise that of least work."""
    question = _make_question(mechanism, duration, how, bounds.observe, bounds.compare)
    usual, again = Adaptive(), repeated(mechanism, duration, how)

    def is_cheap() -> bool:
        try:
            check_run(mechanism, usual)
        except ValueError:
            return False
        return is_usual_cheap(mechanism, again, question)

    def is_accurate(run: Trajectory) -> bool:
        if not isinstance(run.verification, Verified) or not run.verification.beyond:
            return isinstance(run.verification, Verified)
        # What updates and cells of worn surfaces leave no integrator mends.
        finer = usual.with_finer_steps(HALF)
        return bool(wearing_in(mechanism)) and keeps_accuracy(run, again(finer, 1.0), question)

    key = _form_of_mechanism(mechanism, usual), question.times.tobytes()
    if how.verify and _get_or_compute(_USUAL_IS_CHEAP, key, is_cheap):
        run = _simulate_once(mechanism, duration, usual, how, bounds._replace(why=USUAL))
        if is_accurate(run):
            return run
    choice = chosen_for(mechanism, duration, bounds.observe, bounds.compare, how)
    stated = bounds._replace(why=choice.why)
    return _simulate_once(mechanism, duration, choice.integrator, how, stated)


def check_one_of_two(owner: str, integrator: Any) -> None:
    """Raises `ValueError` where an integrator is given beside an accuracy."""
    if integrator is not None:
        raise ValueError(
            f"{owner} is given an integrator and an accuracy, by which one is chosen; give one of "
            "the two."
        )


def chosen_for(
    mechanism: Mechanism,
    duration: float,
    observe: Callable[[Trajectory], Any],
    compare: Callable[[Trajectory, Any, Any], dict[str, float]],
    how: How,
) -> Chosen:
    """The integrator that keeps an accuracy at the least work, chosen by runs.

    Args:
        mechanism: of the run.
        duration: of the run [s].
        observe: function from a run to what is compared of it.
        compare: function of a run and two observations: how far these are apart, as multiples
            of what
            is allowed, by name.
        how: settings of `simulate`.
    """
    question = _make_question(mechanism, duration, how, observe, compare)
    rungs = rungs_of(mechanism, question.times, lambda integrator: check_run(mechanism, integrator))
    return choose_setting(rungs, repeated(mechanism, duration, how), question)


def _make_question(mechanism: Any, duration: Any, how: How, observe: Any, compare: Any) -> Question:
    """What is compared of runs that choose. Raises `ValueError` for what is traced."""
    expect(mechanism, Mechanism, "what is simulated", "a jaxclear.Mechanism")
    if is_traced((mechanism, duration, how.state)):
        raise ValueError(
            "accuracy= chooses an integrator by runs, and numbers of the mechanism are traced (by "
            "jax.jit, vmap or grad): give integrator=, such as one that was chosen before."
        )
    times = np.asarray(saving_times(duration, as_saving(how.save).at))
    return Question(observe, compare, times)


def repeated(mechanism: Mechanism, duration: float, how: How) -> Again:
    """A function that repeats a run with any integrator over a share of its duration.

    Args:
        mechanism: of the run.
        duration: of the whole run [s].
        how: settings of `simulate`; the repetition is not verified and shows no progress.
    """
    saving = as_saving(how.save)
    times = np.asarray(saving_times(duration, saving.at))

    def again(integrator: AbstractIntegrator, share: float) -> Trajectory:
        at = Saving(share * times, saving.events)
        quiet = how._replace(save=at, progress_bar=False, verify=False)
        return _simulate_once(mechanism, share * duration, integrator, quiet)

    return again
