"""A mechanism that runs in time, as an experiment of studies.

The whole path from varied numbers to responses is one pure function, `evaluate`, that maps over
samples and differentiates.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.errors.estimates import factor_by_order
from jaxclear.errors.observables import GAPS
from jaxclear.errors.verification import refine_times, replica
from jaxclear.ground.compiling import by_form
from jaxclear.ground.printing import part_in_words
from jaxclear.ground.quantity import is_traced, on_device, on_host, with_fields
from jaxclear.integrators import AbstractIntegrator, FixedStep, MoreauJean, Outcome
from jaxclear.integrators.base import PART_OF, STUDIES, Promise
from jaxclear.integrators.checks import Check, Checks
from jaxclear.multibody.assembly import (
    Sampled,
    Start,
    assemble_arrays,
    carried_on,
    guess,
    is_sound,
    sampled,
)
from jaxclear.multibody.assembly_modes import Nominal
from jaxclear.multibody.length_scales import narrowest_gap, rooms
from jaxclear.multibody.mechanism import Mechanism, loosened, with_redundancy
from jaxclear.multibody.state import lay_out
from jaxclear.multibody.system import longest_arm, prepare, wear_maps, wearing_in
from jaxclear.multibody.topology import Redundancy
from jaxclear.native import has_kernels
from jaxclear.native.compiled import compiled_for_kernels, compiled_quickly
from jaxclear.results.response import depends_on, needs_of, unit_of
from jaxclear.results.state_history import State
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.derivatives import (
    backwards,
    compared,
    guarded,
    in_other_steps,
    is_compared,
    order_of,
    refusal,
    refuse_steps,
    until_the_end,
)
from jaxclear.simulation.initial_state import Past, past_of, state_of
from jaxclear.simulation.load_steps import (
    LoadSteps,
    checked_by,
    felt_along,
    load_steps,
    own_loads,
    run_felt,
)
from jaxclear.simulation.loop import Extras, sketched
from jaxclear.simulation.saving import Saving, as_saving, check_steps, checked_saving
from jaxclear.simulation.simulate import (
    How,
    check_duration,
    check_one_of_two,
    check_run,
    run,
    saving_times,
)
from jaxclear.simulation.singular_positions import diagnosed, diagnosed_outcome
from jaxclear.simulation.wear import with_coarser_cells
from jaxclear.studies.chosen_integrator import (
    allowed,
    chosen_integrator,
    required_accuracy,
    unasked,
)
from jaxclear.studies.experiment import (
    LANES,
    PARTS,
    AbstractExperiment,
    Cost,
    Description,
    ResponseInfo,
    SampleResult,
    Setting,
    derived,
    sample_of_chunk,
)
from jaxclear.studies.responses import Thinned, answers, check_answers, in_range

# Histories that a response may build from the saved states, in multiples of these.
HISTORY_FACTOR = 12
# A call of a compiled program costs some tenth of a millisecond, whatever it is given: the time per
# sample falls up to chunks of about this length. It rises again where one takes more memory [bytes]
# than stays near a core (benchmarks/claims/fixed_costs.py). An accelerator wants many at once.
LARGEST_CHUNK = {"cpu": 1024}
NEAR_A_CORE = 1 << 26
LARGEST_ELSEWHERE = 4096
# Threads of kernels that fill a large GPU some times.
LARGEST_BY_KERNELS = 1 << 17


class RunExperiment(AbstractExperiment):
    """A mechanism that runs in time, how it runs, and the responses wanted of a run (`Problem`)."""

    mechanism: Mechanism
    response: dict[str, Callable]
    duration: Array
    shares: Float[Array, " saves"]
    integrator: AbstractIntegrator
    state: State
    past: Past = derived()
    # Of worn surfaces in a saving interval.
    updates: Array = derived()
    # JAX sorts the keys of a dictionary; the order in which things were given is kept here.
    response_names: tuple[str, ...] = derived(static=True)
    # Coordinates given for the start that the loops determine: they move with what varies.
    determined: tuple[str, ...] = derived(static=True)
    why_integrator: str = derived(static=True)
    # The accuracy that its runs were chosen for: a share of each response, or numbers by name.
    accuracy: float | tuple[tuple[str, float], ...] | None = derived(static=True)
    # Whether the integrator is the usual one of studies, for which nobody asked.
    unasked: bool = derived(static=True)
    # Redundant rows of loops, which all samples share.
    redundancy: Redundancy | None = derived(static=True)
    # The mode of the nominal mechanism, which samples keep.
    mode: Nominal | None = derived()
    # Touches and releases of each contact that are kept between two saving times.
    events: int = derived(static=True)
    # Whether each sample is looked at for what loads of the user's own do within less than a step,
    # as the nominal one does some.
    looks_along: bool = derived(static=True)

    def __init__(
        self,
        mechanism: Mechanism,
        response: dict[str, Callable],
        duration: float,
        integrator: AbstractIntegrator | None,
        accuracy: Any = None,
        save: Any = 201,
        state: State | None = None,
    ):
        self.mechanism, self.response = mechanism, response
        self.response_names = tuple(response)
        saving = as_saving(save)
        times = saving_times(check_duration(duration), saving.at)
        self.state = state_of(state)
        self._check_answers(integrator, on_device(times), saving.events)
        arguments = mechanism, self.response, times[-1]
        chosen: Any = (integrator, "", None)
        if accuracy is not None:
            check_one_of_two("a Problem", integrator)
            share = required_accuracy(accuracy, self.response)
            choice = chosen_integrator(*arguments, share, How(saving, state))
            chosen = choice.integrator, choice.why, share
        elif integrator is None:
            chosen = unasked(*arguments, How(saving, state))
        self.integrator, self.why_integrator, self.accuracy = chosen
        self.unasked = integrator is None and self.accuracy is None
        self.events = checked_saving(saving, self.integrator).events
        # In the order in which XLA divides.
        self.duration, self.shares = on_device(times[-1]), on_device(times * (1 / times[-1]))
        check_run(mechanism, self.integrator)
        check_steps(integrator, times)
        modelled = self.integrator.formulation.modelled(mechanism)
        self.past = past_of(modelled, self.integrator.formulation, self.state)
        self.updates = on_device(1)
        self.integrator = self._load_steps().integrator
        motion = self.state.motion
        if motion is None:
            sampled_mode = sampled(modelled, self.state.concentric, self.past.worn)
        else:
            sampled_mode = Sampled((), motion.redundancy, None)
        self.determined, self.redundancy, self.mode = sampled_mode
        self.looks_along = False
        if own_loads(mechanism):
            run = _run_nominal(self)
            steps = felt_along(run, self.integrator)
            shares = checked_by(steps.passed, Checks())
            self.looks_along = is_traced(run) or bool(
                steps.integrator is not self.integrator or shares.warnings
            )

    def _check_answers(
        self, integrator: AbstractIntegrator | None, times: Array, events: int
    ) -> None:
        """Raises `ValueError` where a response of the nominal sample is not one number."""
        usual = FixedStep() if integrator is None else integrator
        try:
            check_run(self.mechanism, usual)
        except ValueError:
            # Without an integrator one is chosen yet, for rigid contact and dry friction too.
            if integrator is not None:
                raise
            usual = MoreauJean()
            check_run(self.mechanism, usual)
        modelled = usual.formulation.modelled(self.mechanism)
        check_answers(self.response, lambda: sketched(modelled, usual.formulation, times, events))

    @property
    def subject(self):
        return self.mechanism

    def with_integrator(self, integrator: AbstractIntegrator) -> "RunExperiment":
        """The same runs by another integrator."""
        save = Saving(len(self.shares), self.events)
        arguments = self.mechanism, self.response, float(self.duration), integrator
        experiment = RunExperiment(*arguments, save=save, state=self.state)
        # Times given, as they are: their shares times the duration may be off by rounding.
        return eqx.tree_at(lambda run: run.shares, experiment, self.shares)

    def with_values(self, setting):
        """The mechanism with its variables set. Leaves that vary together move by the same
        amount. Coordinates of the start that the loops determine become guesses."""
        return loosened(setting(self.mechanism), self.determined)

    def model(self, setting: Setting) -> Mechanism:
        """The mechanism of one setting as it is simulated."""
        modelled = self.integrator.formulation.modelled(self.with_values(setting))
        return with_redundancy(modelled, self.redundancy)

    def started(
        self, setting: Setting, discrete: bool = False
    ) -> tuple[Mechanism, Start, Trajectory]:
        """The mechanism of one setting as it is simulated, its start, and its run; pure.
        `discrete`: derivatives are those of the steps."""
        mechanism = self.model(setting)
        motion = self.state.motion
        if motion is None:
            rough = self._rough_start(mechanism)
            start = assemble_arrays(
                mechanism, self.state.concentric, rough=rough, worn=self.past.worn
            )
        else:
            start = carried_on(mechanism, *motion.moving)
        extras = Extras(events=self.events, discrete=discrete)
        arguments = mechanism, *start[:2], self._times()
        make_run = lambda steps: run(*arguments, steps, extras, self.past, self.updates)
        trajectory = make_run(self.integrator)
        if self.looks_along:
            trajectory, _ = run_felt(trajectory, self.integrator, {}, make_run)
        return mechanism, start, until_the_end(trajectory)

    def _times(self) -> Array:
        """Saving times [s]."""
        start, shares, duration = on_host((self.state.start_time, self.shares, self.duration))
        return start + shares * duration

    def _rough_start(self, mechanism: Mechanism) -> tuple[Array, Array] | None:
        """Coordinates and speeds from which the start of a sample is sought; None for its own
        guess."""
        mode = self.mode
        if mode is None or mode.coordinates is None or not mode.fits(mechanism):
            return None
        return mode.coordinates, guess(mechanism)[1]

    def keeps_mode(self, mechanism: Mechanism, start: Start) -> Any:
        """Whether a sample is assembled in the nominal mode, as far as it is known; pure."""
        return True if self.mode is None else self.mode.keeps(mechanism, start)

    def evaluate(self, setting, *, discrete_derivatives=False):
        return _answers_alone(self, setting, discrete_derivatives)

    def refine(self, share=0.5):
        """Runs in finer steps, whose surfaces wear more often; where steps between saving times are
        counted there are more of these, and responses see runs at those that were asked for."""
        mechanism = with_redundancy(
            self.integrator.formulation.modelled(loosened(self.mechanism, self.determined)),
            self.redundancy,
        )
        counting = self.integrator
        if mechanism.topology.clearances:
            counting = counting.counting_in(*_lengths(mechanism)[:2])
        how = replica(counting, self._times(), share)
        if how is None:
            return None
        updates = on_device(how.updates)
        experiment = with_fields(self, integrator=how.integrator, updates=updates)
        if how.every == 1:
            return experiment
        responses = {name: Thinned(f, how.every) for name, f in self.response.items()}
        shares = jnp.asarray(refine_times(self.shares, how.every))
        return eqx.tree_at(lambda e: (e.response, e.shares), experiment, (responses, shares))

    def cost(self):
        # Saved states and worn surfaces.
        size, cells = _state_and_cell_counts(self.mechanism)
        states = len(self.shares) * (HISTORY_FACTOR * size)
        memory = 8 * (states + 8 * cells)
        batch = LARGEST_CHUNK.get(jax.default_backend())
        if batch is None:
            batch = LARGEST_BY_KERNELS if has_kernels() else LARGEST_ELSEWHERE
        else:
            near = max(NEAR_A_CORE // max(memory, 1), LANES)
            batch = min(batch, 1 << (near.bit_length() - 1))
        # Runs of no length.
        idle = with_fields(self, duration=on_device(0.0))
        return Cost(memory, batch, idle=idle)

    def describe(self):
        lasts, saves = f"{float(self.duration):.6g} s", len(self.shares)
        how = f"over {lasts}, {saves} saved instants, by {part_in_words(self.integrator)}"
        early = {
            outcome: f"the run ended after {{ended:.6g}} s. {outcome.sentence}"
            for outcome in Outcome
            if outcome.began and outcome != Outcome.REACHED
        }
        return Description(
            f"Problem {how}",
            {name: self._response_info(name) for name in self.response_names},
            early,
            True,
            checked_by(self._load_steps().passed, Checks()).warnings,
            self.why_integrator,
            self._limits_of_derivatives(),
        )

    def _response_info(self, name: str) -> ResponseInfo:
        response = self.response[name]
        unit = unit_of(response, self.mechanism)
        concerns = frozenset(part for part in PARTS if depends_on(response, part))
        if self.accuracy is not None:
            promise = allowed(self.accuracy, name)
        else:
            promises = STUDIES if self.unasked else self.integrator.promise
            promise = _promise_of(self.mechanism, promises, response, unit)
        by_cells = self._surfaces and needs_of(response) == "worn depth"
        remedy = f"{'more cells, or ' if by_cells else ''}{self.integrator.remedy}"
        return ResponseInfo(unit, concerns, promise, remedy)

    def on_wider_cells(self):
        if not self._reading_cells:
            return None
        return with_fields(self, mechanism=with_coarser_cells(self.mechanism, 2.0))

    def errors_of_cells(self, result, wider):
        narrow = np.max(result.checks.figures[Check.WEAR_BY_CELLS].worst, axis=-1)
        factor = factor_by_order(any(surface.flat for surface in self._surfaces), narrow)
        fine, coarse = result.reached_responses(), wider.reached_responses()
        return {name: factor * (coarse[name] - fine[name]) for name in self._reading_cells}

    @property
    def _surfaces(self) -> list:
        """Worn surfaces with cells that a loss is shared among."""
        maps = [m for j in wearing_in(self.mechanism).values() for m, _ in j.maps().values()]
        return [surface for surface in maps if math.prod(surface.cells) > 1]

    @property
    def _reading_cells(self) -> list[str]:
        """Names of the responses that read depths of such cells."""
        if not self._surfaces:
            return []
        return [name for name, f in self.response.items() if self._reads_depths(f)]

    def _reads_depths(self, response: Callable) -> bool:
        if needs_of(response) != "anything":
            return needs_of(response) == "worn depth"
        formulation = self.integrator.formulation
        model = formulation.modelled(self.mechanism)
        run = lambda: sketched(model, formulation, self._times(), self.events)
        read = lambda worn: response(dataclasses.replace(run(), worn=worn))
        program = jax.make_jaxpr(read)(jax.eval_shape(lambda: run().worn)).jaxpr
        used = {id(x) for eqn in program.eqns for x in eqn.invars} | set(map(id, program.outvars))
        return not used.isdisjoint(map(id, program.invars))

    def _limits_of_derivatives(self) -> tuple[str, str]:
        modelled = self.integrator.formulation.modelled(self.mechanism)
        if self.integrator.through_contacts and not self.integrator.pathwise:
            doubt = "nothing controls the error of derivatives"
            return refusal(modelled, self.integrator), doubt
        if not self.integrator.pathwise:
            return (
                "derivatives of finished runs of this integrator are wrong near contact; use "
                "integrator.Adaptive with an explicit solver, or one with fixed steps."
            ), ""
        return "", refusal(modelled, self.integrator, discrete=True)

    def detail(self, setting, index, chunk) -> Trajectory:
        """The run of one sample, bit for bit as it ran in its chunk.

        Args:
            setting: values of the sample.
            index: of the sample in its study.
            chunk: samples of a chunk of the study.
        """
        return diagnosed(sample_of_chunk(self._simulate_setting, setting, index, chunk))

    def _simulate_setting(self, setting: Setting) -> Trajectory:
        """The run of one setting; pure."""
        return self.started(setting)[2]

    def _load_steps(self) -> LoadSteps:
        return load_steps(self.mechanism, self.integrator, self._times())


@by_form
def _state_and_cell_counts(mechanism: Mechanism) -> tuple[int, int]:
    """How many numbers a state of a mechanism has, and how many cells its surfaces that wear."""
    system = prepare(mechanism)
    maps = [surface for maps in wear_maps(system).values() for surface, _ in maps.values()]
    return lay_out(system).size, sum(math.prod(surface.cells) for surface in maps)


@compiled_quickly
def _lengths(mechanism: Mechanism) -> tuple[Array, Array, Array]:
    """The narrowest gap, the longest arm and the widest room of a mechanism [m]."""
    system = prepare(mechanism)
    widest = jnp.max(rooms(system), initial=0.0) if system.bearings else jnp.zeros(())
    return narrowest_gap(system), longest_arm(system), widest


@compiled_for_kernels
def _run_nominal(experiment: RunExperiment) -> Trajectory:
    """The run of the mechanism as it is."""
    return experiment.started(Setting((), (), jnp.zeros(0)))[2]


def _answers(experiment: RunExperiment, setting: Setting, discrete: bool) -> SampleResult:
    """Responses of a run for one setting; `discrete`: derivatives of the discrete run
    are wanted, where the integrator has them."""
    integrator = experiment.integrator
    has_pathwise = discrete and integrator.pathwise
    modelled = integrator.formulation.modelled(experiment.mechanism)
    if not has_pathwise and is_compared(modelled, integrator):
        peaks = {k for k, one in experiment.response.items() if needs_of(one) == "peak forces"}
        guard = functools.partial(_guard, peaks)
        evaluate = compared(_answer_setting, _finer, guard, _steps, order_of(modelled, integrator))
        return backwards(integrator)(evaluate, experiment, setting)
    started = lambda experiment, setting: experiment.started(setting, has_pathwise)
    mechanism, start, run = backwards(integrator)(started, experiment, setting)
    return _taken(experiment, mechanism, start, guarded(run, integrator, discrete))


# Called by itself it is one program; a loop of a user's, as SciPy's are, asks thousands of times.
_answers_alone = compiled_for_kernels(_answers)


def _taken(experiment: RunExperiment, mechanism: Any, start: Any, run: Trajectory) -> SampleResult:
    possible = in_range(mechanism)
    sound = is_sound(mechanism, start)
    keeps_mode = experiment.keeps_mode(mechanism, start)
    outcome = jnp.where(keeps_mode, diagnosed_outcome(run), Outcome.OTHER_MODE)
    outcome = jnp.where(sound, outcome, Outcome.UNASSEMBLED)
    outcome = jnp.where(possible, outcome, Outcome.OUT_OF_RANGE)
    return SampleResult(answers(experiment.response, run), outcome, run.ended, run.invariants)


def _answer_setting(experiment: RunExperiment, setting: Setting) -> SampleResult:
    return _taken(experiment, *experiment.started(setting))


def _finer(share: Any, experiment: RunExperiment, setting: Setting) -> tuple[Any, Setting]:
    """The same in other steps."""
    steps = in_other_steps(experiment.integrator, share, experiment.shares * experiment.duration)
    return eqx.tree_at(lambda tree: tree.integrator, experiment, steps), setting


def _steps(experiment: RunExperiment, _: Any) -> tuple[Any, Any]:
    return experiment.integrator.requested_step(), experiment.shares * experiment.duration


def _guard(peaks, result, tangents, ratios, least, shares) -> SampleResult:
    """Derivatives of what is answered; those of responses are nan where steps decide them.
    `peaks`: names of responses that lie between steps."""

    def judge(name, tangent):
        share = max(shares) if name in peaks else shares[0]
        smallest = share * least * abs(result.responses[name])
        return refuse_steps(tangent, ratios, abs(tangent[0]), smallest)

    moves = jax.tree.map(lambda each: each[0], tangents)
    responses = {name: judge(name, tangent) for name, tangent in tangents.responses.items()}
    return SampleResult(responses, moves.outcome, moves.ended, moves.checks)


def _promise_of(
    mechanism: Mechanism, promise: Promise, response: Any, unit: str
) -> tuple[float, float] | None:
    """Largest error of a response within a promise, in its unit and as a share of its size; None
    where that says nothing of what the response is drawn from. Places are promised relative to the
    ways of bodies, of which the response may be a small rest: relative to the longest arm of a body
    and a hundred times the widest gap at least, and angles relative to 1 rad."""
    part = PART_OF.get(needs_of(response))
    share = None if part is None else promise._asdict()[part]
    if share is None:
        return None
    return share * (_length_scale(mechanism, unit) if part == "places" else 0.0), share


def _length_scale(mechanism: Mechanism, unit: str) -> float:
    """Of what goes by a unit the least way that places are measured beside."""
    if unit != "m":
        return 1.0 if unit == "rad" else 0.0
    _, arm, widest = map(float, _lengths(mechanism))
    return max(arm, GAPS * widest)
