"""A question about a mechanism: which numbers vary and how, how it is run, and which responses are
wanted.

Studies see a `Problem`, never a joint. The whole path from varied numbers to responses is one pure
function, `evaluate`, that maps over samples and differentiates.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.errors.observables import GAPS
from jaxclear.errors.verification import refine_times, replica
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.printing import part_in_words
from jaxclear.ground.quantity import on_device, with_quantities
from jaxclear.integrators import AbstractIntegrator, FixedStep, MoreauJean, Outcome
from jaxclear.integrators.base import PART_OF, STUDIES, Promise
from jaxclear.integrators.checks import Checks
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
from jaxclear.multibody.mechanism import Mechanism, loosened, with_redundancy
from jaxclear.multibody.reach import narrowest_gap, rooms
from jaxclear.multibody.state import lay_out
from jaxclear.multibody.system import longest_arm, prepare, wear_maps
from jaxclear.multibody.topology import Redundancy
from jaxclear.native import has_kernels
from jaxclear.native.compiled import compiled_for_kernels
from jaxclear.results.response import concerned, needs_of, unit_of
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
    until_the_end,
    where_alike,
)
from jaxclear.simulation.initial_state import Past, past_of, state_of
from jaxclear.simulation.load_steps import LoadSteps, checked_by, load_steps
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
from jaxclear.studies.base import SampleResult, how_it_ended
from jaxclear.studies.chosen_integrator import allowed, checked_asked, chosen_integrator, unasked
from jaxclear.studies.mechanism_problem import (
    AbstractMechanismProblem,
    Thinned,
    check_answers,
    in_range,
    responses_of,
    wanted_of,
)
from jaxclear.studies.store.batch import LEAST_CHUNK, sample_of_chunk
from jaxclear.studies.variable import AbstractMechanismVariable

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


class Problem(AbstractMechanismProblem):
    """A mechanism, the numbers in it that vary, how it is run, and the responses wanted of a run.

    `response`: a function of a trajectory returning a number, or several by name; those of
    `jaxclear.response` have units, a plain function gets one by its `FromFunction`. `duration` [s].
    `integrator`: by default steps of a fixed length, because equal work for every sample is what
    batches and derivatives want: `FixedStep()`, or an `ImplicitStep` where friction would answer
    faster than such steps resolve, or `Adaptive` where ideal joints rub, and where contacts want
    more than 200 000 steps what `accuracy=0.02` chooses; `why_integrator` says so.
    `accuracy` in its place: the integrator is chosen by runs of the nominal sample, for the least
    work; 0.01 for 1 % of each response there, or {"response": number in its unit}.
    `save`: saving times or a `Saving`, as in `simulate`; `shares` [1] are the times, as shares of
    the duration. `state`: where its runs begin, as in `simulate`. `correlation` [1] of the
    variables' normal scores: {("first", "second"): 0.5}, or
    a matrix. Raises `ValueError` with a sentence for what cannot be asked.
    """

    mechanism: Mechanism
    response: dict[str, Callable]
    variables: dict[str, AbstractMechanismVariable]
    duration: Array
    shares: Float[Array, " saves"]
    integrator: AbstractIntegrator
    state: State
    past: Past
    # Of worn surfaces in a saving interval.
    updates: Array
    correlation: Float[Array, "variables variables"] | None
    # JAX sorts the keys of a dictionary; the order in which things were given is kept here.
    names: tuple[str, ...] = eqx.field(static=True)
    response_names: tuple[str, ...] = eqx.field(static=True)
    variable_units: tuple[str, ...] = eqx.field(static=True)
    # Coordinates given for the start that the loops determine: they move with what varies.
    determined: tuple[str, ...] = eqx.field(static=True)
    why_integrator: str = eqx.field(static=True)
    # The accuracy that its runs were chosen for: a share of each response, or numbers by name.
    accuracy: float | tuple[tuple[str, float], ...] | None = eqx.field(static=True)
    # Whether the integrator is the usual one of studies, for which nobody asked.
    unasked: bool = eqx.field(static=True)
    # Redundant rows of loops, which all samples share.
    redundancy: Redundancy | None = eqx.field(static=True)
    # The mode of the nominal mechanism, which samples keep.
    mode: Nominal | None
    # Touches and releases of each contact that are kept between two saving times.
    events: int = eqx.field(static=True)

    def __init__(
        self,
        mechanism: Mechanism,
        response: Callable | Mapping[str, Callable],
        variables: Mapping[str, AbstractMechanismVariable],
        *,
        duration: float,
        integrator: AbstractIntegrator | None = None,
        accuracy: Any = None,
        save: Any = 201,
        state: State | None = None,
        correlation: Any = None,
    ):
        check_double_precision()
        mechanism = with_quantities(mechanism)
        wanted = wanted_of(mechanism, response, variables, correlation, "Problem", "a trajectory")
        self.mechanism = mechanism
        self.response, self.variables, self.variable_units, self.correlation = wanted
        self.names, self.response_names = tuple(self.variables), tuple(self.response)
        asked = as_saving(save)
        times = on_device(saving_times(check_duration(duration), asked.at))
        self.state = state_of(state)
        self._check_answers(integrator, times, asked.events)
        given = mechanism, self.response, times[-1]
        chosen: Any = (integrator, "", None)
        if accuracy is not None:
            check_one_of_two("a Problem", integrator)
            share = checked_asked(accuracy, self.response)
            found = chosen_integrator(*given, share, How(asked, state))
            chosen = found.integrator, found.why, share
        elif integrator is None:
            chosen = unasked(*given, How(asked, state))
        self.integrator, self.why_integrator, self.accuracy = chosen
        self.unasked = integrator is None and self.accuracy is None
        self.events = checked_saving(asked, self.integrator).events
        self.duration, self.shares = times[-1], times / times[-1]
        check_run(mechanism, self.integrator)
        check_steps(integrator, times)
        seen = self.integrator.formulation.seen(mechanism)
        self.past = past_of(seen, self.integrator.formulation, self.state)
        self.updates = jnp.asarray(1)
        self.integrator = self._load_steps().integrator
        motion = self.state.motion
        if motion is None:
            known = sampled(seen, self.state.concentric, self.past.worn)
        else:
            known = Sampled((), motion.redundancy, None)
        self.determined, self.redundancy, self.mode = known

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
        seen = usual.formulation.seen(self.mechanism)
        check_answers(self.response, lambda: sketched(seen, usual.formulation, times, events))

    def with_integrator(self, integrator: AbstractIntegrator) -> "Problem":
        """The same question of runs by another integrator."""
        found = Problem(
            self.mechanism,
            self.response,
            self.variables,
            duration=float(self.duration),
            integrator=integrator,
            save=Saving(len(self.shares), self.events),
            state=self.state,
            correlation=self.correlation,
        )
        # Times given, as they are: their shares times the duration may be off by rounding.
        return eqx.tree_at(lambda problem: problem.shares, found, self.shares)

    def with_values(self, values: Float[Array, " variables"]) -> Mechanism:
        """The mechanism with its variables set. Leaves that vary together move by the same
        amount. Coordinates of the start that the loops determine become guesses."""
        return loosened(self._varied(values), self.determined)

    def seen(self, values: Float[Array, " variables"]) -> Mechanism:
        """The mechanism of one set of values as it is simulated."""
        seen = self.integrator.formulation.seen(self.with_values(values))
        return with_redundancy(seen, self.redundancy)

    def started(
        self, values: Float[Array, " variables"], discrete: bool = False
    ) -> tuple[Mechanism, Start, Trajectory]:
        """The mechanism of one set of values as it is simulated, its start, and its run; pure.
        `discrete`: derivatives are those of the steps."""
        mechanism = self.seen(values)
        times, motion = self.state.begins + self.shares * self.duration, self.state.motion
        if motion is None:
            rough = self._beginning(mechanism)
            start = assemble_arrays(
                mechanism, self.state.concentric, rough=rough, worn=self.past.worn
            )
        else:
            start = carried_on(mechanism, *motion.moving)
        extras = Extras(events=self.events, discrete=discrete)
        given = mechanism, *start[:2], times, self.integrator, extras, self.past
        found = until_the_end(run(*given, self.updates))
        return mechanism, start, found

    def _beginning(self, mechanism: Mechanism) -> tuple[Array, Array] | None:
        """Coordinates and speeds from which the start of a sample is sought; None for its own
        guess."""
        known = self.mode
        if known is None or known.coordinates is None or not known.fits(mechanism):
            return None
        return known.coordinates, guess(mechanism)[1]

    def keeps_mode(self, mechanism: Mechanism, start: Start) -> Any:
        """Whether a sample is assembled in the nominal mode, as far as it is known; pure."""
        return True if self.mode is None else self.mode.keeps(mechanism, start)

    def evaluate(
        self, values: Float[Array, " variables"], *, discrete_derivatives: bool = False
    ) -> SampleResult:
        """Assemble, run and take the responses for one set of values; pure.

        JAX may map, compile and differentiate it. A derivative through contacts that open and close
        is not that of the motion, and raises `ValueError`; with `discrete_derivatives` it is passed
        on, as the derivative of the discrete run. Other derivatives are compared with those in
        steps of other lengths or at a tighter tolerance, and nan where these tell an error beyond a
        hundredth; `jaxclear.why_unknown` says why.
        """
        check_double_precision()
        self.check_values(values)
        return _answers_alone(self, jnp.asarray(values), discrete_derivatives)

    def sample_memory(self) -> int:
        """Saved states and worn surfaces [bytes]."""
        system = prepare(self.mechanism)
        layout = lay_out(system)
        cells = sum(
            math.prod(m.cells) for own in wear_maps(system).values() for m, _ in own.values()
        )
        return 8 * (len(self.shares) * (HISTORY_FACTOR * layout.size) + 8 * cells)

    def most_together(self) -> int:
        most = LARGEST_CHUNK.get(jax.default_backend())
        if most is None:
            return LARGEST_BY_KERNELS if has_kernels() else LARGEST_ELSEWHERE
        near = max(NEAR_A_CORE // max(self.sample_memory(), 1), LEAST_CHUNK)
        return min(most, 1 << (near.bit_length() - 1))

    def idle(self) -> "Problem":
        """Runs of no length."""
        return eqx.tree_at(lambda problem: problem.duration, self, jnp.zeros(()))

    def rerun(self, values, index, chunk) -> Trajectory:
        """The run of one sample, bit for bit as it ran in its chunk."""
        return diagnosed(sample_of_chunk(self._simulated, values, index, chunk))

    def _simulated(self, values: Float[Array, " variables"]) -> Trajectory:
        """The run of one set of values; pure."""
        return self.started(values)[2]

    def _load_steps(self) -> LoadSteps:
        times = self.state.begins + self.shares * self.duration
        return load_steps(self.mechanism, self.integrator, times)

    def discretised(self):
        return True

    def replica(self, share=0.5):
        """Runs in finer steps, whose surfaces wear more often; where steps between saving times are
        counted there are more of these, and responses see runs at those that were asked for."""
        times = self.state.begins + self.shares * self.duration
        seen, counting = prepare(self.seen(self.nominal())), self.integrator
        if seen.bearings:
            counting = counting.counting_in(narrowest_gap(seen), longest_arm(seen))
        how = replica(counting, times, share)
        if how is None:
            return None
        places = lambda own: (own.integrator, own.updates)
        found = eqx.tree_at(places, self, (how.integrator, jnp.asarray(how.updates)))
        if how.every == 1:
            return found
        responses = {name: Thinned(own, how.every) for name, own in self.response.items()}
        shares = jnp.asarray(refine_times(self.shares, how.every))
        return eqx.tree_at(lambda own: (own.response, own.shares), found, (responses, shares))

    def promised(self, response, size):
        if self.accuracy is None:
            promise = STUDIES if self.unasked else self.integrator.promise
            return _promised_of(self.mechanism, promise, self.response[response], size)
        return allowed(self.accuracy, response, size)

    def remedy(self, response):
        return self.integrator.remedy

    def doubts(self):
        return checked_by(self._load_steps().passed, Checks()).warnings

    def ending(self, outcome, ended):
        how = Outcome(outcome)
        if how == Outcome.REACHED or not how.began:
            return how_it_ended(how)
        return f"the run ended after {ended:.6g} s. {how.sentence}"

    def asked_how(self):
        lasts, saves = f"{float(self.duration):.6g} s", len(self.shares)
        return f"over {lasts}, {saves} saved instants, by {part_in_words(self.integrator)}"

    def remark(self):
        return self.why_integrator

    def concerned(self, response, concerns):
        return concerned(self.response[response], concerns)

    def pathwise_limits(self):
        seen = self.integrator.formulation.seen(self.mechanism)
        if self.integrator.through_contacts and not self.integrator.pathwise:
            doubt = "nothing controls the error of derivatives"
            return refusal(seen, self.integrator), doubt
        if not self.integrator.pathwise:
            return (
                "derivatives of finished runs of this integrator are wrong near contact; use "
                "integrator.Adaptive with an explicit solver, or one with fixed steps."
            ), ""
        return "", refusal(seen, self.integrator, discrete=True)

    def parts(self):
        told = ("mechanism", "response", "duration", "shares", "integrator", "state")
        return self._told(*told)


def _answers(problem: Problem, values: Float[Array, " variables"], discrete: bool) -> SampleResult:
    """Responses of a `Problem` for one set of values; `discrete`: derivatives of the discrete run
    are wanted, where the integrator has them."""
    integrator = problem.integrator
    own = discrete and integrator.pathwise
    seen = integrator.formulation.seen(problem.mechanism)
    if not own and is_compared(seen, integrator):
        known = compared(_answered, _finer, _alike, _steps, order_of(integrator))
        return backwards(integrator)(known, problem, values)
    started = lambda problem, values: problem.started(values, own)
    mechanism, start, run = backwards(integrator)(started, problem, values)
    return _taken(problem, mechanism, start, guarded(run, integrator, discrete))


# Called by itself it is one program; a loop of a user's, as SciPy's are, asks thousands of times.
_answers_alone = compiled_for_kernels(_answers)


def _taken(problem: Problem, mechanism: Any, start: Any, run: Trajectory) -> SampleResult:
    possible = in_range(mechanism)
    sound = is_sound(mechanism, start)
    kept = problem.keeps_mode(mechanism, start)
    outcome = jnp.where(kept, diagnosed_outcome(run), Outcome.OTHER_MODE)
    outcome = jnp.where(sound, outcome, Outcome.UNASSEMBLED)
    outcome = jnp.where(possible, outcome, Outcome.OUT_OF_RANGE)
    return SampleResult(responses_of(problem, run), outcome, run.ended, run.invariants)


def _answered(problem: Problem, values: Array) -> SampleResult:
    return _taken(problem, *problem.started(values))


def _finer(share: Any, problem: Problem, values: Array) -> tuple[Any, Array]:
    """The same in other steps."""
    steps = in_other_steps(problem.integrator, share, problem.shares * problem.duration)
    return eqx.tree_at(lambda known: known.integrator, problem, steps), values


def _steps(problem: Problem, _: Any) -> tuple[Any, Any]:
    return problem.integrator.asked_step(), problem.shares * problem.duration


def _alike(found: SampleResult, ways: SampleResult, ratios: Array, least: Any) -> SampleResult:
    """Derivatives of what is answered; those of responses are nan where steps decide them."""
    told = {
        name: where_alike(way, ratios, abs(way[0]), least * abs(found.responses[name]))
        for name, way in ways.responses.items()
    }
    moves = jax.tree.map(lambda each: each[0], ways)
    return SampleResult(told, moves.outcome, moves.ended, moves.checks)


def _promised_of(
    mechanism: Mechanism, promise: Promise, response: Any, size: float
) -> float | None:
    """Largest error of a response of this `size`, in its unit, within a promise; None where that
    says nothing of what the response is drawn from. Places are promised beside the
    ways of bodies, of which the response may be a small rest: beside the longest arm of a body and
    a hundred times the widest gap at least, and angles beside 1 rad."""
    part = PART_OF.get(needs_of(response))
    share = None if part is None else promise._asdict()[part]
    if share is None:
        return None
    way = _way(mechanism, unit_of(response, mechanism)) if part == "places" else 0.0
    return share * max(size, way)


def _way(mechanism: Mechanism, unit: str) -> float:
    """Of what goes by a unit the least way that places are measured beside."""
    if unit != "m":
        return 1.0 if unit == "rad" else 0.0
    system = prepare(mechanism)
    widest = float(np.max(np.asarray(rooms(system)), initial=0.0)) if system.bearings else 0.0
    return max(float(longest_arm(system)), GAPS * widest)
