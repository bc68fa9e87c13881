"""Steps chosen by error control, on diffrax's solvers: the reference, and the fastest way to run
one simulation.
"""

import functools
from typing import Any, ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.formulations.compliant import CompliantContact
from jaxclear.ground.grouping import bare, packed, unpacked
from jaxclear.ground.quantity import (
    Scalar,
    concrete,
    constant,
    count,
    is_traced,
    on_device,
    on_host,
    quantity,
)
from jaxclear.ground.tangents import allow_first_derivative
from jaxclear.integrators.base import LOOSE, REFERENCE, AbstractIntegrator, Advance
from jaxclear.integrators.checks import Outcome
from jaxclear.integrators.derivative_error import NO_SECOND, trusted
from jaxclear.integrators.error_control import (
    EndingAtTouches,
    FollowingCouplings,
    Solved,
    StandingAtBounds,
    TakingImpactSpeeds,
    solve,
    stepped_by_hand,
)
from jaxclear.integrators.events import transmitted
from jaxclear.integrators.munthe_kaas import GroupTerm, MuntheKaas, state_group
from jaxclear.integrators.saltation import equations, motion_of
from jaxclear.multibody.forces import transmitting
from jaxclear.multibody.length_scales import narrowest_gap
from jaxclear.multibody.state import within_bounds
from jaxclear.multibody.system import longest_arm
from jaxclear.native import size_of, with_fast_loops

# Share of the time at which a step is given up: four roundings, below which time stands still.
SMALLEST_STEP = 4 * float(np.finfo(float).eps)
# Evaluations of forces in a step of Dormand and Prince's kind: the last is the next one's first.
USUAL_STAGES = 6
# Power of a step's share by which tolerances follow: of the order of the usual solvers.
FINER_TOLERANCE = 4
# Relative error beyond which no tolerance counts where joints have clearance: impacts make errors
# grow, and looser runs lost a journal's place in its gap for a few percent of time
# (benchmarks/attack.py).
LOOSEST = 3e-7
# The same as a place, beside the narrowest gap: what it allows a body must be little in the gap, or
# where it touches is lost (the same runs, gaps of 16 to 100 um).
LOOSEST_IN_GAP = 4e-4
# A step that ends at a touch ends so near, beside what the tolerance leaves a coordinate, lest
# landing makes errors: at most a share of the narrowest gap, at least rounding beside all arms.
LANDING, LANDING_IN_GAP = 0.1, 1e-4
ROUNDING = 1e-12
# Bounds that could be only so much tighter are as tight as they can be.
ROUNDED_OFF = 0.5
# Derivatives have grown too much where a place within the tolerance, grown as they have, is more
# than this beside the narrowest gap: beyond, they were off by a tenth and more, within by less than
# a hundredth (slider-cranks with and without friction, rtol 1e-7 beside 1e-12; 3 at 5000 rpm).
TRUSTED = 8e-4


def _as_times(values: Any) -> Any:
    return None if values is None else jnp.array(values, float)


class Adaptive(AbstractIntegrator):
    """A diffrax solver under error control: cost follows difficulty.

    Use as reference and for single runs. Local error per step below rtol |y| + atol in every
    coordinate and speed, less in short bristles; worn volumes and energies follow the motion. Where
    joints have clearance both tolerances count as at rtol 3e-7 at the loosest (4e-4 of the
    narrowest gap beside the longest arm, where that is less): impacts make errors grow, and looser
    runs save next to no time. A step in which a contact closes or parts is repeated to end there;
    steps end at saving times too, so saving more often than steps are long costs as many more, and
    none is so long that it would pass over what a load or drive does as a function of time: where
    one changes between looks is found in it, and steps end there. `breaks`: more times [s] at which
    they end.

    Solvers that are no explicit tableau run in diffrax's loop, and hand on the mean of their steps.
    In a batch all samples wait for the slowest.

    A derivative is solved for together with the motion, in steps that are short enough for it too.
    First derivatives through contacts are those of the motion (within 1.2 % at the usual tolerance,
    measured through up to seven impacts; 3 % in a slider-crank at 5000 rpm): steps end at touches
    and releases, and know how these move (`saltation`). They are nan where impacts have made them
    grow so much that the tolerance no longer determines them. All are those at a sixteenth of the
    tolerance, and nan where those at the tolerance itself differ by more than a hundredth. With a
    tighter `rtol` they go further. Through contacts not with implicit solvers and `MuntheKaas` (it
    keeps rotations on their group), where `jaxclear.sensitivity` is the way.

    Stiff scenes (large friction over tiny transition speeds) may prefer
    diffrax.Kvaerno5(root_finder=optimistix.Newton(rtol=1e-6, atol=1e-8)); of stiff couplings beside
    light motors, and friction that holds, each vibration is resolved: `ImplicitStep` need not.

    Args:
        solver: a solver of diffrax, such as `diffrax.Tsit5()` (default) or `MuntheKaas`.
        rtol: relative local error of coordinates and speeds [1], >= 0 and < 1.
        atol: absolute local error of coordinates [m, rad] and speeds [m/s, rad/s], > 0.
        largest_step: largest step [s], > 0; no bound by default.
        max_steps: largest number of steps between saving times or wear updates, >= 1.
        breaks: further times at which steps end [s], an array; none by default.
    """

    pathwise: ClassVar = False
    projects: ClassVar = False
    remedy: ClassVar = "tighten rtol"
    notes_events: ClassVar = True
    solver: diffrax.AbstractSolver = eqx.field(
        default_factory=diffrax.Tsit5,
        metadata={"wanted": "a solver of diffrax, such as diffrax.Tsit5()"},
    )
    rtol: Scalar = quantity(1e-7, "1", at_least=0, below=1, kw_only=True)
    atol: Scalar = quantity(1e-9, "1", above=0, kw_only=True)
    largest_step: Scalar | None = quantity(None, "s", above=0, kw_only=True)
    max_steps: int = count(200_000, kw_only=True)
    breaks: Any = eqx.field(default=None, kw_only=True, converter=_as_times)

    @property
    def promise(self):
        rtol = concrete(self.rtol)
        return REFERENCE if rtol is not None and rtol <= LOOSEST else LOOSE

    def with_finer_steps(self, share):
        rtol, atol = on_host((self.rtol, self.atol))
        of: Any = jnp if is_traced((share, rtol, atol)) else np
        finer = share**FINER_TOLERANCE * LOOSEST / of.maximum(rtol, LOOSEST)
        finer = of.where(share < 1, of.minimum(1.0, of.maximum(finer, ROUNDING / rtol)), 1.0)
        if not is_traced(finer) and finer > ROUNDED_OFF:
            return None
        sizes = on_device(finer * rtol), on_device(finer * atol)
        a = eqx.tree_at(lambda a: (a.rtol, a.atol), self, sizes)
        return a if self.largest_step is None else a.with_max_step(share * self.largest_step)

    def counting_in(self, gap, arm):
        loosest = jnp.minimum(LOOSEST, LOOSEST_IN_GAP * (gap / arm))
        finer = loosest / jnp.maximum(self.rtol, loosest)
        sizes = lambda a: (a.rtol, a.atol)
        return eqx.tree_at(sizes, self, (self.rtol * finer, self.atol * finer))

    def with_max_step(self, step):
        step = step if self.largest_step is None else jnp.minimum(step, self.largest_step)
        return eqx.tree_at(lambda a: a.largest_step, self, step, is_leaf=lambda x: x is None)

    def evaluations(self, mechanism):
        """Those of the solver's stages, of which the last may be the next step's first."""
        if not isinstance(self.solver, diffrax.AbstractERK):
            return USUAL_STAGES
        return self.solver.tableau.num_stages - self.solver.tableau.fsal

    @property
    def in_kernels(self):
        return not isinstance(self.solver, diffrax.AbstractImplicitSolver)

    @property
    def through_contacts(self):
        return stepped_by_hand(self.solver) is not None

    def beyond_flanks(self, mechanism):
        return self.beyond_touches(mechanism)

    @property
    def formulation(self):
        return CompliantContact()

    def first_warm_start(self, model, start, state):
        """The bound of the step length [s] (0: unknown); and where contacts may close, touch moves.

        Args:
            model: of the run.
            start: of the run [s].
            state: array at the start, shape (n,).
        """
        through = model.layout.contacts and self.through_contacts
        return jnp.zeros(()), jnp.zeros(3) if through else None

    def advance(self, model, interval, state, warm_start):
        interval = interval._replace(
            stop=jnp.where(interval.running, interval.stop, interval.start)
        )
        arrays, rest = packed(model)

        def solve(*numbers):
            return self._solve(rest, *numbers)

        if stepped_by_hand(self.solver) is None:
            solve = with_fast_loops(solve)
        return solve(arrays, interval, state, warm_start)

    def _controller(self, model, interval):
        """The error control of an interval, which ends steps where contacts close and part."""
        longest = jnp.inf if self.largest_step is None else self.largest_step
        counting, system = self, model.system
        if model.layout.contacts:
            counting = self.counting_in(_narrowest(system), longest_arm(system))
        control = diffrax.PIDController(
            rtol=counting.rtol,
            atol=counting.atol,
            # diffrax reports a failed implicit stage as an infinite error of all entries: 0 times
            # infinity must not enter.
            # What it closes over must be leaves: implicit solvers differentiate with the norm.
            norm=jax.tree_util.Partial(_largest, interval.error_weights),
            dtmin=SMALLEST_STEP * jnp.maximum(jnp.abs(interval.start), jnp.abs(interval.stop)),
            dtmax=longest,
            force_dtmin=False,
        )
        if not model.layout.contacts:
            return control
        beyond = jnp.minimum(LANDING * control.atol, LANDING_IN_GAP * _narrowest(model.system))
        rounding = ROUNDING * longest_arm(model.system)
        return EndingAtTouches(control, jnp.maximum(beyond, rounding))

    def _term(self, model, rates):
        """The equations as diffrax asks for them."""
        term = diffrax.ODETerm(lambda time, y, args: rates(*args, jnp.asarray(time, float), y))
        if not isinstance(self.solver, MuntheKaas):
            return term
        group, field_of = state_group(model), term.vector_field
        return GroupTerm(lambda time, y, args: group.rates(y, field_of(time, y, args)), group)

    def _solver(self, rest, size, derivative, growth, so_far):
        """The solver, which looks at contacts where there are any: laws may ask for impact speeds,
        and without them it would step over touches. `size`: so many equations of a program are in a
        rate; `so_far`: the peaks of the run."""
        formulation, through = self.formulation, self.through_contacts
        solver = stepped_by_hand(self.solver, size)
        if solver is None:
            solver = self.solver
            if bare(rest).layout.states:
                solver = StandingAtBounds(solver, functools.partial(_bounded, rest))
        if not bare(rest).layout.contacts:
            return _following(solver, rest)

        def remember(y, before, after, length, args):
            return formulation.remember(unpacked(args[0], rest), y, before, after, length)

        motion, derived = motion_of(formulation, rest), derivative if through else None
        looks = formulation.damped(bare(rest)), bare(rest).events
        solver = TakingImpactSpeeds(solver, remember, motion, derived, growth, so_far, *looks)
        return _following(solver, rest)

    def _solve(self, rest, arrays, interval, state, warm_start) -> Advance:
        formulation, (start, stop), (step, growth) = self.formulation, interval[:2], warm_start
        length = stop - start
        usual = jnp.where(step > 0, jnp.minimum(step, length), length)

        # Traced once, however often diffrax asks. Flanks of play count within a step as they were
        # at its start (`shares`).
        @jax.jit
        def plain(arrays, time, y, shares=None):
            flank_shares = shares if shares is None else shares[bare(rest).layout.joint_contacts :]
            return formulation.rate(unpacked(arrays, rest), time, y, None, flank_shares)[0]

        model = unpacked(arrays, rest)
        size = size_of(jax.make_jaxpr(plain)(arrays, start, state))
        derivative = equations(formulation, rest, plain)
        through = bare(rest).layout.contacts and self.through_contacts
        rates = derivative.rates if through else lambda arrays, _, *now: plain(arrays, *now)
        controller = self._controller(model, interval)
        first = jnp.where(step > 0, usual, 1e-2 * length)
        end, failed = self._solved(
            self._term(model, rates),
            self._solver(rest, size, derivative, growth, interval.peaks),
            controller,
            (start, stop, first),
            state,
            (arrays, None),
            functools.partial(_bounded, rest),
            (bare(rest).layout.coordinates, bare(rest).layout.memory_start),
        )
        # A remainder of rounding, shorter than the smallest step, has been taken.
        reached = (failed == Outcome.REACHED) | (end.time >= stop)
        outcome = jnp.where(reached, Outcome.REACHED, failed)
        peaks, events, usual, kept, sent = None, None, end.wish, end.kept, None
        if transmitting(bare(rest).system):
            kept, sent = kept
        if bare(rest).layout.contacts:
            _, _, peaks, events, growth = kept
            # As long as a flight it may go through a wall: rounding then decides what follows.
            usual = (end.time - start) / jnp.maximum(end.accepted, 1)
        usual = constant(usual)
        steps = end.accepted, end.rejected
        state = end.state
        if through:
            instants = () if events is None else events[:2]
            most = _most_growth(model, controller)
            moving = trusted((state, peaks, instants, sent), growth, most)
            state, peaks, instants, sent = allow_first_derivative(NO_SECOND, moving)
            if events is not None:
                events = events._replace(times=instants[0], rates=instants[1])
        return Advance(state, *steps, (usual, growth), outcome, peaks, events, sent)

    def _solved(self, term, solver, controller, span, state, args, ended, ends):
        """Where a solver ends, and why where that is before the end; of its own steps each is
        `ended(state, args)`. `ends`: of the coordinates and of the speeds in a state."""
        if stepped_by_hand(self.solver) is not None:
            options = term, solver, controller, span, state, args, self.max_steps, ended, ends
            solved = solve(*options)
            short = jnp.where(solved.time < span[1], Outcome.TOO_MANY_STEPS, Outcome.REACHED)
            return solved, jnp.where(solved.too_small, Outcome.STEP_TOO_SMALL, short)
        start, stop, first = span
        solution = diffrax.diffeqsolve(
            term,
            solver,
            start,
            stop,
            first,
            state,
            args=args,
            stepsize_controller=controller,
            saveat=diffrax.SaveAt(t1=True, solver_state=solver is not self.solver),
            max_steps=self.max_steps,
            adjoint=diffrax.ForwardMode(),
            throw=False,
        )
        results, counts = diffrax.RESULTS, solution.stats
        steps = counts["num_accepted_steps"], counts["num_rejected_steps"]
        too_many = solution.result == results.max_steps_reached
        fine = solution.result == results.successful
        failed = jnp.where(too_many, Outcome.TOO_MANY_STEPS, Outcome.STEP_TOO_SMALL)
        typical = (solution.ts[-1] - start) / jnp.maximum(steps[0], 1)
        ended = solution.ts[-1], solution.ys[-1], solution.solver_state
        solved = Solved(*ended, *steps, ~fine, typical)
        return solved, jnp.where(fine, Outcome.REACHED, failed)


def _following(solver, rest):
    """The solver, which follows what couplings of a model transmit where there are such."""
    couplings = len(transmitting(bare(rest).system))

    def largest(time, state, args, before):
        before = jnp.zeros(couplings) if before is None else before
        return transmitted(unpacked(args[0], rest), time, _bounded(rest, state, args), before)

    return FollowingCouplings(solver, largest) if couplings else solver


def _bounded(rest, state, args):
    """The state of a model, of which this is the `rest` beside arrays, within its bounds."""
    model = unpacked(args[0], rest)
    return within_bounds(model.system, model.layout, state)


def _most_growth(model, controller):
    """By how much derivatives may grow from the first touches on: what a tolerance leaves of a
    place is then a share of the gap by which they change, of the longest arm where none is."""
    arm = longest_arm(model.system)
    place = controller.rtol * arm + controller.atol
    return TRUSTED * jnp.minimum(_narrowest(model.system), arm) / place


def _narrowest(system):
    """The narrowest gap [m] of joints; infinite where only couplings have play."""
    return narrowest_gap(system) if system.bearings else jnp.inf


def _largest(weights, error):
    """The largest weighed error."""
    return jnp.max(jnp.where(weights > 0, jnp.abs(weights * error), 0.0), initial=0.0)
