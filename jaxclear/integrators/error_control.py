"""Steps under error control in a loop of our own: the method is the user's diffrax solver's, the
lengths are his controller's, both stepped by hand; steps take impact speeds, and end where contacts
close and part.

`diffrax.diffeqsolve` does more than our runs need in every step (saved rows, dense output,
checkpoints of its stages), and a stage of an explicit method costs it as much as the equations of a
small mechanism. What this loop does not cover is its business still: implicit solvers, and those
that step in a way of their own.

An error-controlled run does not follow the approach speed, and is as smooth within its steps as the
solver wants it: from the two ends of a step the speed at a touch follows
(`formulations.impact_speed`). A touch that begins and ends within one step, unseen at either end,
is seen halfway, by the solver's own interpolation.
"""

import functools
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.formulations.impact_speed import ContactMotion, Passage, end_at_passage
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.outcome import Unknown
from jaxclear.ground.quantity import Scalar, constant
from jaxclear.ground.tangents import apply_if, pushed
from jaxclear.integrators.events import no_peaks, noted, nothing, peaks, risen, since
from jaxclear.integrators.saltation import Equations, Start, closed
from jaxclear.native import while_loop
from jaxclear.native.writer import LONGEST_IN_REGISTERS

# Up to so many equations of a rate all stages are written out: a loop over them costs more.
FEW_EQUATIONS = 500
# A step has been cut that has less than this share of its length: no rounding decides it.
CUT = 0.999
# What a solver must leave as diffrax has it, to be stepped by its tableau alone.
OURS = ("step", "init", "func")
# A step that would leave less than so many roundings to the end of an interval ends there.
ROUNDINGS = 100 * float(np.finfo(float).eps)


class AbstractAround:
    """What diffrax asks of a solver that is stepped by another one's steps, in front of diffrax's
    classes: the orders and terms of `solver`, and how it looks between its steps and finds its
    stages."""

    solver: Any
    interpolation_cls: Any = property(lambda self: self.solver.interpolation_cls)

    @property
    def term_structure(self):
        return self.solver.term_structure

    @property
    def scan_kind(self):
        """How an explicit solver goes through its stages; diffrax asks."""
        return self.solver.scan_kind

    @property
    def root_finder(self):
        """How an implicit solver finds its stages; diffrax asks."""
        return self.solver.root_finder

    def order(self, terms):
        return self.solver.order(terms)

    def error_order(self, terms):
        return self.solver.error_order(terms)

    def func(self, terms, t0, y0, args):
        return self.solver.func(terms, t0, y0, args)


class Stages(AbstractAround, diffrax.AbstractAdaptiveSolver, diffrax.AbstractWrappedSolver):
    """`solver`, an explicit Runge-Kutta method, by its tableau. Its stages are a loop, so that the
    equations stand in the program once; or `written_out`, where weights that are 0 cost nothing.

    Its state between steps: the slope at which the next one begins, where the last stage was that;
    of the loop the number of the stage that it begins with, and the last slope.
    """

    solver: diffrax.AbstractERK  # type: ignore[misc]
    written_out: bool = eqx.field(static=True)

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

    def init(self, terms, t0, t1, y0, args):
        if not self.written_out:
            return jnp.zeros((), int), jnp.zeros_like(y0)
        return terms.vf(t0, y0, args) if self.solver.tableau.fsal else None

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        table, h = self.solver.tableau, t1 - t0
        rate = lambda node, y: terms.vf(t0 + node * h, y, args)
        go = _written_out if self.written_out else _in_turn
        slopes, stages = go(table, rate, h, y0, solver_state)
        y1 = y0 + h * _weighed(table.b_sol, slopes)
        error = h * _weighed(table.b_error, slopes)
        dense = {"y0": y0, "y1": y1, "k": h * slopes}
        return y1, error, dense, stages, diffrax.RESULTS.successful


def _in_turn(table, rate, h, y0, before):
    """Slopes of all stages of a step h [s], and the state between steps."""
    count, (begin, slope) = table.num_stages, before
    nodes, matrix = (jnp.asarray(each) for each in _rows(table))

    # The last of the slopes is the newest.
    def stage(carry):
        i, slopes = carry
        slope = rate(nodes[i], y0 + h * jnp.sum(matrix[i][:, None] * slopes, 0))
        return i + 1, jnp.concatenate([slopes[1:], slope[None]])

    slopes = jnp.concatenate([jnp.zeros((count - 1, len(slope))), slope[None]])
    _, slopes = jax.lax.while_loop(lambda carry: carry[0] < count, stage, (begin, slopes))
    return slopes, (jnp.full((), int(table.fsal)), slopes[-1])


def _written_out(table, rate, h, y0, first):
    """The same."""
    slopes = [rate(0.0, y0) if first is None else first]
    for node, row in zip(table.c, table.a_lower, strict=True):
        slopes.append(rate(node, y0 + h * _weighed(row, slopes)))
    return jnp.stack(slopes), slopes[-1] if table.fsal else None


def _weighed(weights, slopes):
    """Sum of the slopes by their weights."""
    parts = [float(w) * slope for w, slope in zip(weights, slopes, strict=True) if w != 0]
    return functools.reduce(operator.add, parts, jnp.zeros_like(slopes[0]))


def _rows(table: diffrax.ButcherTableau) -> tuple[np.ndarray, np.ndarray]:
    """The node of every stage, and its weights of the slopes before it, behind zeros for those that
    are not there yet; more rows than stages, so that a kernel reads them from memory instead of
    choosing among them."""
    count = table.num_stages
    weights = np.zeros((max(count, 1 + LONGEST_IN_REGISTERS // count), count))
    for i, row in enumerate(table.a_lower, 1):
        weights[i, count - len(row) :] = row
    nodes = np.zeros(LONGEST_IN_REGISTERS + 1)
    nodes[1:count] = table.c
    return nodes, weights


def stepped_by_hand(solver: Any, equations: int = 0) -> diffrax.AbstractSolver | None:
    """What `solve` steps by in the place of a solver, where a rate takes so many equations of a
    program; None where that is not for it."""
    if not isinstance(solver, diffrax.AbstractERK):
        return None
    is_explicit = any(
        getattr(type(solver), name) is not getattr(diffrax.AbstractERK, name) for name in OURS
    )
    if is_explicit or not isinstance(solver.tableau, diffrax.ButcherTableau):
        return None
    return Stages(solver, equations <= FEW_EQUATIONS)


class Solved(NamedTuple):
    """Where `solve` ended: time [s], state, what its solver keeps between steps, steps accepted
    and rejected, whether a step would have been too small, and how long the next step may be
    [s] (of diffrax's loop: as long as the mean)."""

    time: Scalar
    state: Any
    kept: Any
    accepted: Any
    rejected: Any
    too_small: Any
    wish: Scalar


class _Turn(NamedTuple):
    """`start` and `stop` [s] of the step to try, and the length [s] it would have if the interval
    did not end."""

    start: Any
    stop: Any
    state: Any
    kept: Any
    control: Any
    accepted: Any
    rejected: Any
    fine: Any
    wish: Any


def solve(
    term: diffrax.AbstractTerm,
    solver: Any,
    controller: Any,
    span: tuple[Scalar, Scalar, Scalar],
    state: Any,
    args: Any,
    most: int,
    ended: Callable = lambda state, _: state,
    ends: tuple[int, int] = (0, 0),
) -> Solved:
    """As `diffrax.diffeqsolve`, the same steps to rounding; nan where it does not reach the end.

    A derivative is that of a solution in steps of its own, which are short enough for it too
    (`_WithDerivatives`): where a spring sets in within a step that resolves the motion, or at rest,
    those of the motion are too long. The length of steps is not differentiated.

    Args:
        term: right side.
        solver, controller: of diffrax.
        span: start, end and first step [s].
        state: at the start, shape (n,).
        args: of the right side.
        most: largest number of steps tried.
        ended: `ended(state, args)`: the state that is kept after each step.
        ends: ends of the coordinates and of the speeds in a state.
    """
    numbers, rest = eqx.partition((solver, constant(controller)), eqx.is_array)
    solving = _Solving(term, rest, most, ended, ends)

    def moving(numbers, tangents):
        solved = solving.motion(*numbers)
        return solved, solving.derivatives(solved, numbers, tangents)

    solved = jax.custom_jvp(solving.motion)
    solved.defjvp(moving, symbolic_zeros=True)
    return solved(numbers, span, state, args)


class _Solving(NamedTuple):
    """What `solve` does with numbers (those of its solver and controller, span, state, args);
    `rest`: of solver and controller, what is no number."""

    term: Any
    rest: Any
    most: int
    ended: Callable
    ends: tuple[int, int]

    def motion(self, numbers, span, state, args) -> Solved:
        """The solution."""
        end, first = span[1], self._first_turn(numbers, span, state, args)
        solver, controller = eqx.combine(numbers, self.rest)
        order = solver.error_order(self.term)

        def turn(now):
            candidate, y, after, error = self._tried(solver, now, args)
            tried = constant((now.start, now.stop, now.state, candidate, args, error))
            adapted = controller.adapt_step_size(*tried, order, now.control)
            return _after(now, y, after, adapted, end)

        last = while_loop(lambda now: self._continues(now, end), turn, first)
        steps = last.accepted, last.rejected
        return Solved(last.start, last.state, last.kept, *steps, ~last.fine, last.wish)

    def derivatives(self, solved, numbers, tangents) -> Solved:
        """The derivative of the solution `solved`, from those of the numbers."""
        solving, (_, end, _), _, args = numbers
        of_solving, (_, d_end, _), _, of_args = tangents
        solver, controller = eqx.combine(solving, self.rest)
        controller, order = _WithDerivatives(controller, self.ends), solver.error_order(self.term)
        first, d_turn = pushed(self._first_turn, numbers, tangents)

        def turn(carry):
            now, d_turn = carry
            moving, fixed = eqx.partition(_parts(now), eqx.is_inexact_array)
            go = lambda moving: now._replace(**eqx.combine(moving, fixed))

            def tried(solving, args, moving):
                return self._tried(eqx.combine(solving, self.rest)[0], go(moving), args)

            inputs = (solving, args, moving), (of_solving, of_args, d_turn)
            (candidate, y, after, error), (_, *of_step) = pushed(tried, *inputs)
            d_y, d_after, d_error = of_step
            off = d_turn["state"], d_y, d_error
            adapted = controller.adapt(now, candidate, error, off, order)
            after, constants = eqx.partition(after, eqx.is_inexact_array)

            def choose(moving, y, after, end):
                return _after(go(moving), y, eqx.combine(after, constants), adapted, end)

            inputs = (moving, y, after, end), (d_turn, d_y, _floating(d_after), d_end)
            now, d_turn = pushed(choose, *inputs)
            return now, _floating(_parts(d_turn))

        first = first, _floating(_parts(d_turn))
        last, d_turn = while_loop(lambda carry: self._continues(carry[0], end), turn, first)
        state = jnp.where(last.start < end, Unknown.UNRESOLVED.number, d_turn["state"])
        still = jax.tree.map(_no_tangent, solved)
        saved = eqx.combine(d_turn["kept"], still.kept)
        return still._replace(time=d_turn["start"], state=state, kept=saved)

    def _first_turn(self, numbers, span, state, args) -> _Turn:
        solver, controller = eqx.combine(numbers, self.rest)
        begin, end, first = span
        start, order = constant((begin, end, state, first, args)), solver.error_order(self.term)
        until, control = controller.init(self.term, *start, solver.func, order)
        wish = until - constant(begin)
        until = _clipped(begin, until, end, True)
        saved = solver.init(self.term, begin, until, state, args)
        none = jnp.zeros((), int)
        return _Turn(begin, until, state, saved, control, none, none, jnp.asarray(True), wish)

    def _tried(self, solver, now, args):
        """(state by the solver, as it has ended, what the solver keeps, error) behind a step."""
        at = now.start, now.stop, now.state
        y, error, _, after, _ = solver.step(self.term, *at, args, now.kept, False)
        error = jax.tree.map(lambda each: jnp.where(jnp.isnan(each), jnp.inf, each), error)
        return y, self.ended(y, args), after, error

    def _continues(self, now, end):
        return (now.start < end) & now.fine & (now.accepted + now.rejected < self.most)


def _parts(turn: _Turn) -> dict[str, Any]:
    """What of a turn has derivatives."""
    return {name: getattr(turn, name) for name in ("start", "stop", "state", "kept")}


def _floating(tangents: Any) -> Any:
    """The tangents of numbers that may move."""
    return eqx.filter(tangents, lambda each: each.dtype != jax.dtypes.float0)


def _no_tangent(number: Any) -> Any:
    number = jnp.asarray(number)
    floating = jnp.issubdtype(number.dtype, jnp.inexact)
    return jnp.zeros_like(number) if floating else np.zeros(number.shape, jax.dtypes.float0)


# Steps shorter than so many of the shortest are not made shorter for a derivative, half of whose
# digits are right then: as it sets in its error is as large as itself, however short the step.
FOR_DERIVATIVES = 1e7


class _WithDerivatives(NamedTuple):
    """`controller` of a motion and a derivative of it: of its coordinates and speeds, which have
    such `ends`, by the same relative error, beside the largest of their kind."""

    controller: Any
    ends: tuple[int, int]

    def adapt(self, now, y, error, d_in, order):
        """What the controller says of a step with its derivatives: `d_in` of (the state at its
        start, at its end, the error)."""
        inner, (before, after, off) = self.controller, d_in
        by_touches = isinstance(error, Judged)
        off, fixed = (off.error, error.error) if by_touches else (off, error)
        sizes, largest = (
            jnp.maximum(abs(before), abs(after)),
            lambda x: jnp.max(abs(x), initial=0.0),
        )
        kinds = slice(0, self.ends[0]), slice(*self.ends)
        shares = [safe_divide(largest(off[kind]), largest(sizes[kind])) for kind in kinds]
        share = jnp.maximum(*shares) / inner.rtol
        long = now.stop - now.start > FOR_DERIVATIVES * inner.dtmin
        share = jnp.where(jnp.isfinite(share) & long, share, 0.0)
        # As if the motion were as far off.
        allowed = inner.atol + inner.rtol * jnp.maximum(abs(now.state), abs(y))
        larger = jnp.maximum(abs(fixed), share * allowed)
        error = error._replace(error=larger) if by_touches else larger
        at = now.start, now.stop, now.state, y
        return inner.adapt_step_size(*constant((*at, None, error)), order, now.control)


def _after(now, y, after, adapted, end):
    """What follows a step that was tried: as it ended, if the controller keeps it."""
    keep, start, stop, _, control, result = adapted
    # A step that the end of the interval has cut says nothing against a longer one.
    cut = keep & (now.stop - now.start < CUT * now.wish)
    wish = jnp.where(cut, jnp.maximum(stop - start, now.wish), stop - start)
    # Saving times may move, and with them what a step begins with.
    start = jnp.minimum(jnp.where(keep, now.stop, now.start), end)
    choose = lambda new, old: jax.tree.map(lambda a, b: jnp.where(keep, a, b), new, old)
    return _Turn(
        start,
        _clipped(start, stop, end, keep),
        choose(y, now.state),
        choose(after, now.kept),
        control,
        now.accepted + keep,
        now.rejected + ~keep,
        result == diffrax.RESULTS.successful,
        wish,
    )


def _clipped(start, stop, end, keep):
    """The end of the next step, not beyond that of the interval: there after a step that was kept,
    halfway after one that was not."""
    beyond = stop > end - ROUNDINGS * jnp.abs(end)
    return jnp.where(beyond, jnp.where(keep, end, start + 0.5 * (end - start)), stop)


class Judged(NamedTuple):
    """What a step tells its controller: its error, and what the contacts did in it."""

    error: Any
    passage: Passage


class EndingAtTouches(diffrax.AbstractAdaptiveStepSizeController):
    """`controller`, but a step in which a contact closes or parts, and goes more than `beyond` [m]
    beyond its wall, is tried again, to end where it does: an error estimate hardly sees where
    between its stages a force begins.

    Its solver is `TakingImpactSpeeds`.
    """

    controller: diffrax.PIDController
    beyond: Scalar

    @property  # type: ignore[misc]
    def rtol(self):
        return self.controller.rtol

    @property  # type: ignore[misc]
    def atol(self):
        return self.controller.atol

    @property  # type: ignore[misc]
    def norm(self):
        return self.controller.norm

    @property
    def dtmin(self):
        return self.controller.dtmin

    def wrap(self, direction):
        return EndingAtTouches(self.controller.wrap(direction), self.beyond)

    def init(self, *arguments):
        return self.controller.init(*arguments)

    def adapt_step_size(
        self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
    ):
        keep, start, stop, jump, state, result = self.controller.adapt_step_size(
            t0, t1, y0, y1_candidate, args, y_error.error, error_order, controller_state
        )
        least, length = self.controller.dtmin, t1 - t0
        # Where time does not tell the two ends apart the step is as good as any.
        share = end_at_passage(*y_error.passage, length, self.beyond, least)
        again = (share < 1) & (keep | (share * length < stop - t0))
        choose = lambda yes, no: jax.tree.map(lambda a, b: jnp.where(again, a, b), yes, no)
        return (
            keep & ~again,
            choose(t0, start),
            choose(t0 + share * length, stop),
            jump,
            choose(controller_state, state),
            diffrax.RESULTS.where(again, diffrax.RESULTS.successful, result),
        )


class StandingAtBounds(
    AbstractAround, diffrax.AbstractAdaptiveSolver, diffrax.AbstractWrappedSolver
):
    """`solver`, and after each of its steps what stands still at a bound there: `bounded(state,
    args)`. A loop of our own does that itself (`solve`)."""

    solver: diffrax.AbstractSolver  # type: ignore[misc]
    bounded: Callable

    def init(self, terms, t0, t1, y0, args):
        return self.solver.init(terms, t0, t1, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        y1, *others = self.solver.step(terms, t0, t1, y0, args, solver_state, made_jump)
        return self.bounded(y1, args), *others


class FollowingCouplings(
    AbstractAround, diffrax.AbstractAdaptiveSolver, diffrax.AbstractWrappedSolver
):
    """`solver`, and `largest(time, state, args, before)`: the largest that couplings have
    transmitted where its steps end, and before."""

    solver: diffrax.AbstractSolver  # type: ignore[misc]
    largest: Callable

    def init(self, terms, t0, t1, y0, args):
        return self.solver.init(terms, t0, t1, y0, args), self.largest(t0, y0, args, None)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        inner, before = solver_state
        y1, *others, inner, result = self.solver.step(terms, t0, t1, y0, args, inner, made_jump)
        return y1, *others, (inner, self.largest(t1, y1, args, before)), result


class TakingImpactSpeeds(
    AbstractAround, diffrax.AbstractAdaptiveSolver, diffrax.AbstractWrappedSolver
):
    """`solver`, and after each of its steps the impact speeds of contacts that have closed or
    parted. Its controller is `EndingAtTouches`.

    `motion`: of the model (`saltation.motion_of`). `remember(state, before, after, length, args)`:
    the state with its impact speeds set. `damped`: whether some contact damps. Args are (arrays of
    the model, None), those of `solver` may tell which contacts count as closed. `derived`: how
    derivatives go through touches (None: they do not), `growth`: by how much they have grown
    (`derivative_error.trusted`), `so_far`: the peaks of the run (None: not followed). Its state
    between steps ends with the `Peaks` of every contact so far: the motion of the contacts is known
    at both ends of a step, so that peaks of a run cost it next to nothing; with `events`, so many,
    of a saving
    interval (`events`); and with the growth.
    """

    solver: diffrax.AbstractSolver  # type: ignore[misc]
    remember: Callable
    motion: Any = None  # a Motion
    derived: Equations | None = None
    growth: Any = None
    so_far: Any = None  # Peaks
    damped: bool = eqx.field(static=True, default=False)
    events: int = eqx.field(static=True, default=0)

    def init(self, terms, t0, t1, y0, args):
        contacts = self.motion.contacts(args[0], t0, y0)
        events = nothing(contacts, self.events) if self.events else None
        inner = self.solver.init(terms, t0, t1, y0, args)
        peaks = no_peaks(contacts.depths, self.damped)
        peaks = since(self.so_far, self._risen(peaks, y0, args, contacts))
        return inner, contacts, peaks, events, self.growth

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        inner, before, peaks, events, growth = solver_state
        contacts = ContactMotion(*constant(before))
        start = Start(args[0], t0, y0, constant(t1 - t0), contacts)
        times, y, inner, shift, aux = self._start(start, t1, inner, args)
        y1, error, dense, inner, result = self.solver.step(terms, *times, y, aux, inner, made_jump)
        after: Any = constant(self.motion.contacts(args[0], t1, y1))
        # Flanks of play by how they count since the step began.
        end_motion = after
        if self.motion.sided:
            end_motion = constant(self.motion.contacts(args[0], t1, y1, start.shares))
        length, half = t1 - t0, 0.5 * (t0 + t1)
        path = self.interpolation_cls(t0=t0, t1=t1, **constant(dense))
        middle = self.motion.contacts(args[0], half, path.evaluate(half), start.shares)
        passage = Passage(*constant((before, middle, end_motion)))
        remembering = self.remember(y1, before, after, length, args)
        if events is not None:
            events = noted(events, *constant((t0, length, before, end_motion)))
        derived = remembering, growth, events
        end = start._replace(time=t1, state=y1)
        y1, inner, growth, events = self._ended(end, inner, shift, derived)
        if self.derived is not None and self.motion.layout.plays:
            slope = lambda: terms.vf(t1, y1, (args[0], closed(after)))
            inner = _renewed(inner, start.shares != closed(after), slope)
        peaks = self._peaks((t0, y0), (t1, y1), args, (contacts, after), peaks)
        state_after = inner, after, peaks, events, growth
        return y1, Judged(error, passage), dense, state_after, result

    def _peaks(self, start, end, args, motions, largest):
        """The peaks after a step."""
        if self.derived is None:
            return self._risen(largest, end[1], args, motions[1])
        so_far = constant(self.so_far)
        return peaks(self.motion, args[0], (start, end), motions, largest, so_far)

    def _risen(self, largest, y, args, contacts):
        """The peaks with the contacts at an instant."""
        forces = self.motion.pressing(args[0], y, contacts) if self.damped else None
        peaks = risen(largest, contacts.depths, forces)
        return peaks if self.derived else constant(peaks)

    def _start(self, start, stop, inner, args):
        """(times, state, state of the solver, shift, args) of its step, as derivatives want it."""
        if self.derived is None:
            return (start.time, stop), start.state, inner, None, args
        slopes, others = eqx.partition(inner, eqx.is_inexact_array)
        y, slopes, shift = self.derived.shifted(start, slopes)
        times = start.time + shift, stop + shift
        return times, y, eqx.combine(slopes, others), shift, (args[0], start.shares)

    def _ended(self, end, inner, shift, values):
        """(state, state of the solver, growth, events) with derivatives behind touches and
        releases, from the `values` (state, growth, events, error) before."""
        if self.derived is None:
            return values[0], inner, *values[1:]
        slopes, others = eqx.partition(inner, eqx.is_inexact_array)
        y, slopes, *rest = self.derived.jumped(end, slopes, shift, *values)
        return y, eqx.combine(slopes, others), *rest


def _renewed(inner: Any, changed: Any, slope: Callable) -> Any:
    """What a solver keeps between steps, where flanks have `changed`: with the slope as they count
    from there on."""
    slopes, others = eqx.partition(inner, eqx.is_inexact_array)
    fresh = lambda slopes: jax.tree.map(lambda _: slope(), slopes)
    return eqx.combine(apply_if(jnp.any(changed), fresh, slopes), others)
