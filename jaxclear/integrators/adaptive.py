"""Steps chosen by error control, on diffrax's solvers: the reference, and the fastest way to run
one simulation.

Impacts can be captured: the solve then stops where a contact closes, the impact speed is set to the
approach speed at that very instant, and it goes on. A contact counts as closed from HYSTERESIS
above the touch on and as open from as much below, so that an event does not find itself again.
"""

from typing import Any, ClassVar, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix

from jaxclear.formulations.compliant import CompliantContact
from jaxclear.ground.quantity import Scalar, count, quantity
from jaxclear.integrators.base import (
    AbstractIntegrator,
    Advance,
)
from jaxclear.integrators.munthe_kaas import GroupTerm, MuntheKaas
from jaxclear.integrators.outcome import Outcome
from jaxclear.integrators.state_group import state_group
from jaxclear.native import with_fast_loops

# Share of an interval below which a step is given up.
SMALLEST_STEP = 1e-11
# Indentation [m] at which a touch is captured: forces there are far below rounding of any that move
# a body.
HYSTERESIS = 1e-11
# Bisection ends when time [s] and indentation [m] are known to this; if rounding of the time
# prevents it, no harm is done.
EVENT_TOLERANCE = 1e-12


class Adaptive(AbstractIntegrator):
    """A diffrax solver under error control: cost follows difficulty.

    Use as reference and for single runs. Local error per step below rtol |y| + atol in every
    coordinate and speed; memories of laws are held a hundred times looser, worn volumes and
    energies follow the motion. In a batch all samples wait for the slowest. A derivative
    through contacts would be wrong (by 52 % in a measurement) and is refused; see
    `jaxclear.sensitivity`. Stiff
    scenes (large friction over tiny transition speeds) may prefer an implicit solver, best with a
    full Newton iteration: diffrax.Kvaerno5(root_finder=optimistix.Newton(rtol=1e-6, atol=1e-8)).
    `MuntheKaas` keeps rotations on their group.

    `capture_impacts`: every touch is an event, at which laws that remember the impact speed take
    the approach speed of that instant. Restitution is then the law's own whatever its
    `memory_time`, which plays no part; each touch and each release costs a restart. `most_impacts`
    between two saving times. Two contacts that close within one step are told apart.
    """

    pathwise: ClassVar = False
    projects: ClassVar = False
    solver: diffrax.AbstractSolver = eqx.field(
        default_factory=diffrax.Tsit5,
        metadata={"wanted": "a solver of diffrax, such as diffrax.Tsit5()"},
    )
    rtol: Scalar = quantity(
        1e-7,
        "1",
        "relative local error of coordinates and speeds",
        at_least=0,
        below=1,
        kw_only=True,
    )
    atol: Scalar = quantity(
        1e-9,
        "1",
        "absolute local error of coordinates [m, rad] and speeds [m/s, rad/s]",
        above=0,
        kw_only=True,
    )
    largest_step: Scalar | None = quantity(None, "s", "largest step", above=0, kw_only=True)
    most_steps: int = count(200_000, "most steps between two saving times", kw_only=True)
    capture_impacts: bool = eqx.field(static=True, default=False, kw_only=True)
    most_impacts: int = count(1000, "most impacts between two saving times", kw_only=True)

    @property
    def formulation(self):
        return CompliantContact(self.capture_impacts)

    def relaxing_step(self, interval):
        return None

    def first_warm_start(self, model, start, state):
        """A typical step [s]; 0: not known."""
        return jnp.zeros(())

    def advance(self, model, interval, state, warm_start):
        interval = interval._replace(
            stop=jnp.where(interval.running, interval.stop, interval.start)
        )
        if self.capture_impacts and self.formulation.remembers(model):
            return self._through_impacts(model, interval, state, warm_start)
        found = self._solve(model, interval, state, warm_start, None)
        return Advance(
            found.state,
            found.accepted,
            found.rejected,
            found.typical(interval.start),
            found.outcome,
        )

    def _through_impacts(self, model, interval, state, step):
        """Segments between touches and releases."""

        def one(carry):
            begun, state, closed, step, accepted, rejected, impacts, _ = carry
            found = self._solve(model, interval._replace(start=begun), state, step, closed)
            depth, closing = self.formulation.contacts(model, found.time, found.state)
            beyond = _beyond(depth, closed)
            fired = found.stopped & ((beyond > -0.5 * HYSTERESIS) | (beyond == jnp.max(beyond)))
            touched = fired & ~closed
            state = self.formulation.remember(model, found.state, touched, closing)
            impacts = impacts + jnp.any(touched)
            outcome = jnp.where(
                (impacts > self.most_impacts) & (found.outcome == Outcome.REACHED),
                Outcome.TOO_MANY_IMPACTS,
                found.outcome,
            )
            counts = (accepted + found.accepted, rejected + found.rejected, impacts)
            return found.time, state, closed ^ fired, found.typical(begun), *counts, outcome

        def unfinished(carry):
            return (carry[0] < interval.stop) & (carry[-1] == Outcome.REACHED)

        depth, _ = self.formulation.contacts(model, interval.start, state)
        counts = (jnp.zeros((), int),) * 3
        closed = depth > 0.5 * HYSTERESIS
        first = (interval.start, state, closed, step, *counts, jnp.asarray(Outcome.REACHED))
        _, state, _, step, accepted, rejected, _, outcome = jax.lax.while_loop(
            unfinished, one, first
        )
        return Advance(state, accepted, rejected, step, outcome)

    def _solve(self, model, interval, state, step, closed) -> "Segment":
        """One solve, to the interval's end or (where `closed` flags are given) to the first contact
        that closes or opens before.
        """
        arrays, rest = eqx.partition(model, eqx.is_array)

        def solve(*numbers):
            return self._solve_in_jax(rest, *numbers)

        return Segment(*with_fast_loops(solve)(arrays, interval, state, step, closed))

    def _controller(self, interval):
        weights = interval.error_weights
        return diffrax.PIDController(
            rtol=self.rtol,
            atol=self.atol,
            # diffrax reports a failed implicit stage as an infinite error of all entries: 0 times
            # infinity must not enter.
            norm=lambda error: jnp.max(
                jnp.where(weights > 0, jnp.abs(weights * error), 0.0), initial=0.0
            ),
            dtmin=SMALLEST_STEP * jnp.maximum(interval.stop - interval.start, SMALLEST_STEP),
            dtmax=self.largest_step,
            force_dtmin=False,
        )

    def _term(self, model, rates):
        """The equations as diffrax asks for them."""
        term = diffrax.ODETerm(lambda time, y, args: rates(args[0], jnp.asarray(time, float), y))
        if not isinstance(self.solver, MuntheKaas):
            return term
        group, field_of = state_group(model), term.vector_field
        return GroupTerm(lambda time, y, args: group.rates(y, field_of(time, y, args)), group)

    def _solve_in_jax(self, rest, arrays, interval, state, step, closed) -> tuple:
        formulation, (start, stop) = self.formulation, interval[:2]
        length = stop - start

        # Traced once, however often diffrax asks.
        @jax.jit
        def rates(arrays, time, y):
            return formulation.rate(eqx.combine(arrays, rest), time, y)[0]

        # Falls through zero where a contact changes. diffrax 0.7 puts the time left in its place
        # for the samples of a batch without an event, which falls too; a function that rises would
        # lose them (tests/integrators/test_captured_impacts.py).
        def crossing(t, y, args, **_):
            depth, _ = formulation.contacts(eqx.combine(args[0], rest), t, y)
            return -jnp.max(_beyond(depth, args[1]), initial=-1.0)

        finder: Any = optimistix.Bisection(  # type: ignore[call-arg]
            rtol=0.0, atol=EVENT_TOLERANCE, flip=True
        )
        solution = diffrax.diffeqsolve(
            self._term(eqx.combine(arrays, rest), rates),
            self.solver,
            start,
            stop,
            jnp.where(step > 0, jnp.minimum(step, length), 1e-2 * length),
            state,
            args=(arrays, closed),
            stepsize_controller=self._controller(interval),
            saveat=diffrax.SaveAt(t1=True),
            max_steps=self.most_steps,
            event=None if closed is None else diffrax.Event(crossing, finder, direction=False),
            adjoint=diffrax.ForwardMode(),
            throw=False,
        )
        stats, results = solution.stats, diffrax.RESULTS
        stopped = jnp.asarray(False) if closed is None else solution.event_mask
        failed = jnp.where(
            solution.result == results.max_steps_reached,
            Outcome.TOO_MANY_STEPS,
            Outcome.STEP_TOO_SMALL,
        )
        # A remainder of rounding before `stop` is shorter than the smallest step, but it has been
        # taken.
        reached = stopped | (solution.result == results.successful) | (solution.ts[-1] >= stop)
        outcome = jnp.where(reached, Outcome.REACHED, failed)
        time = jnp.where(reached & ~stopped, stop, solution.ts[-1])
        counts = (stats["num_accepted_steps"], stats["num_rejected_steps"])
        return time, solution.ys[-1], *counts, outcome, stopped


class Segment(NamedTuple):
    """Outcome of one solve: where it ended, steps accepted and rejected, `Outcome`,
    whether an event ended it.
    """

    time: Any
    state: Any
    accepted: Any
    rejected: Any
    outcome: Any
    stopped: Any

    def typical(self, start: Scalar) -> Scalar:
        """Mean length of its steps [s]."""
        return (self.time - start) / jnp.maximum(self.accepted, 1)


def _beyond(depth, closed):
    """Distance [m] by which each contact is beyond the threshold at which it changes: positive
    where it has just changed.
    """
    return jnp.where(closed, -HYSTERESIS - depth, depth - HYSTERESIS)
