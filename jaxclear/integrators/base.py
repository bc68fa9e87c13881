"""How a state is carried from one saving time to the next: what every integrator is asked, how it
answers, the accuracy that it promises, and what all with fixed steps share.

An integrator holds a formulation, which knows how contact enters the equations of motion, and sees
a `Model` (the mechanism) and an interval. Outcomes are numbers while the program runs and sentences
when a user reads them. What a rung promises is the largest errors with which a run by it says
nothing; they are measured beside references (`benchmarks.attack`), and the book's page on accuracy
shows them.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxclear.formulations.base import AbstractFormulation
from jaxclear.formulations.contact_rows import TimeStep
from jaxclear.formulations.model import Model, State
from jaxclear.ground.quantity import AbstractQuantified, Scalar, on_device, on_host, with_fields
from jaxclear.integrators.checks import Outcome
from jaxclear.integrators.events import Events, Peaks, Watch, watch_from, watched
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.native import while_loop


class Promise(NamedTuple):
    """Largest error [1] of `places` (beside the longest way of a body), of places in `gaps` (beside
    the clearance), of mean and peak contact forces, and of `losses` (friction loss, worn volumes
    and depths), each beside itself; None: not promised."""

    places: float | None
    gaps: float | None
    mean_force: float | None
    peak_force: float | None
    losses: float | None


# What a response is drawn from, and the part of a promise that holds of it.
PART_OF = {
    "motion": "places",
    "places in gaps": "gaps",
    "forces": "mean_force",
    "peak forces": "peak_force",
    "wear": "losses",
    "worn depth": "losses",
}
# A journal that may be anywhere in its gap is off by two clearances, of the hundred by which places
# are measured at least.
IN_GAP = 0.02
REFERENCE = Promise(0.001, 0.02, 0.02, 0.05, 0.02)
LOOSE = Promise(0.005, 0.1, 0.1, 0.2, 0.1)
STUDIES = Promise(0.005, 0.05, 0.02, 0.1, 0.02)
RUNGE_KUTTA = Promise(0.005, 0.05, 0.05, 0.2, 0.05)
FIRST_ORDER = Promise(IN_GAP, None, 0.1, 0.3, 0.1)
IMPLICIT = Promise(IN_GAP, None, 0.1, 0.5, 0.1)
RIGID = Promise(IN_GAP, None, 0.1, None, 0.1)
PERMANENT = Promise(IN_GAP, None, 0.05, None, 0.05)


class Interval(NamedTuple):
    """From one saving time to the next.

    Args:
        start: its start [s].
        stop: its end [s].
        error_weights: weight of each entry's error for an error control [1], an array (n,); 0 where
            an entry only follows the others.
        running: whether the run goes on; where it has ended before, the outcome is ignored and an
            integrator may save the work.
        peaks: largest indentations [m] and forces [N] of the run so far, for their derivatives;
            None: not recorded.
        under_way: whether steps of this interval are under way, and what their loop carries; ():
            none are; None: the interval is gone through at once.
    """

    start: Scalar
    stop: Scalar
    error_weights: Float[Array, " n"]
    running: Bool[Array, ""]
    peaks: Peaks | None = None
    under_way: Any = None


class Advance(NamedTuple):
    """Outcome of one interval.

    Args:
        state: state at its end, an array (n,).
        accepted: number of accepted steps.
        rejected: number of rejected steps.
        warm_start: what helps the next interval to start, a tree of arrays.
        outcome: code of an `integrator.Outcome`.
        peaks: largest indentation [m] and force [N] of every possible contact in the interval;
            None: not recorded.
        events: touches and releases, where the model asks for them, else None.
        transmitted: the largest that each coupling of `forces.transmitting` has transmitted in its
            steps [N m, N]; None: not recorded.
        under_way: a tuple that the same interval takes again, whose end is not reached where the
            first of it is true; None: the end is reached.
    """

    state: State
    accepted: Int[Array, ""]
    rejected: Int[Array, ""]
    warm_start: Any
    outcome: Int[Array, ""]
    peaks: Peaks | None = None
    events: Events | None = None
    transmitted: Any = None
    under_way: Any = None


# What derivatives do not know where couplings have play.
FLANKS = "how the instants move at which flanks meet"


class AbstractIntegrator(AbstractQuantified):
    """Carries a state over an interval.

    Class attributes of a member: `pathwise`, whether forward-mode derivatives through its steps are
    those of the discrete run (where contacts open and close, not those of the motion); `projects`,
    whether loops can be closed anew after its steps.
    """

    pathwise: eqx.AbstractClassVar[bool]
    projects: eqx.AbstractClassVar[bool]
    breaks = None

    @property
    @abstractmethod
    def formulation(self) -> AbstractFormulation:
        """How contact enters the equations."""

    @abstractmethod
    def first_warm_start(self, model: Model, start: Scalar, state: State) -> Any:
        """Warm start of the first interval.

        Args:
            model: the mechanism, a `Model`.
            start: time at the start [s].
            state: state at the start, an array (n,).

        Returns:
            a tree of arrays, as `Advance.warm_start`.
        """

    @abstractmethod
    def advance(self, model: Model, interval: Interval, state: State, warm_start: Any) -> Advance:
        """Carry the state to the end of an interval.

        Args:
            model: the mechanism, a `Model`.
            interval: the interval, an `Interval`.
            state: state at its start, an array (n,).
            warm_start: what the last interval has returned, a tree of arrays.

        Returns:
            the outcome, an `Advance`.
        """

    def check_derivatives(
        self,
        model: Model,
        times: Float[Array, " saves"],
        states: Float[Array, "saves n"],
        end: State,
        warm_start: Any,
    ) -> Float[Array, "saves n"]:
        """States of a run at its saving times, their derivatives nan where only the state in which
        the run has ended shows that they are not known.

        Args:
            model: the mechanism, a `Model`.
            times: saving times [s], an array (saves,).
            states: the states, an array (saves, n).
            end: state at the end, an array (n,).
            warm_start: what the last interval has returned, a tree of arrays.

        Returns:
            the states, an array (saves, n).
        """
        return states

    def law_residual(self, model: Model, warm_start: Any) -> Scalar | None:
        """By how much steps have missed the laws of contact and friction that they solve.

        Args:
            model: the mechanism, a `Model`.
            warm_start: what the last interval has returned, a tree of arrays.

        Returns:
            the largest residual of all steps, relative to the largest velocity, or to the bound of
            the friction [1]; None where steps solve for nothing.
        """
        return None

    @property
    def opens_loops(self) -> bool:
        """Whether its steps open loops by more than rounding, so that it closes them anew after
        each where a mechanism does not say how its loops are held."""
        return False

    def requested_step(self) -> Scalar | None:
        """The longest step [s] that was asked for; None where nobody asked for one."""
        return None

    def evaluations(self, mechanism: Mechanism) -> int:
        """Number of evaluations of the forces in one step, as far as the integrator knows.

        Args:
            mechanism: the mechanism.
        """
        return 1

    def shortest_step(self) -> Scalar | None:
        """The shortest step [s] that these numbers lead to, saving times aside."""
        return self.requested_step()

    @property
    def through_contacts(self) -> bool:
        """Whether forward-mode derivatives through its steps are those of the motion where contacts
        open and close too."""
        return False

    def beyond_touches(self, mechanism: Mechanism) -> str:
        """What its derivatives do not include of the contacts of a mechanism.

        Args:
            mechanism: the mechanism.

        Returns:
            a text; "" where derivatives are those of the motion.
        """
        return "" if self.through_contacts else "how the instants of touch move"

    def beyond_flanks(self, mechanism: Mechanism) -> str:
        """What its derivatives do not include of the flanks of couplings with play.

        Args:
            mechanism: the mechanism.

        Returns:
            a text; "" where derivatives are those of the motion.
        """
        return FLANKS

    @property
    def first_order_slopes(self) -> bool:
        """Whether its derivatives are off in proportion to the step, not to its square or less:
        those of steps that have a length are compared with those in other steps."""
        return False

    @property
    def notes_events(self) -> bool:
        """Whether it notes touches and releases of contacts."""
        return False

    @property
    def steps_between_saves(self) -> int | None:
        """Their number, where it is fixed."""
        return None

    @property
    def in_kernels(self) -> bool:
        """Whether its steps can be machine code, as far as it knows."""
        return True

    def with_finer_steps(self, share: Scalar) -> "AbstractIntegrator | None":
        """The integrator with finer steps, for a companion run.

        Args:
            share: factor of the length of its steps [1]; where it finds their length itself,
                tolerances get tighter by its fourth power.

        Returns:
            the integrator; None where steps are counted, or as fine as numbers allow.
        """
        return None

    def counting_in(self, gap: Any, arm: Any) -> "AbstractIntegrator":
        """The integrator with the tolerances that count for a mechanism; unchanged unless
        overridden.

        Args:
            gap: narrowest gap [m].
            arm: longest arm [m].

        Returns:
            the integrator.
        """
        return self

    @property
    def remedy(self) -> str:
        """What makes the errors of a run by it smaller."""
        return "take shorter steps"

    def with_max_step(self, step: Scalar) -> "AbstractIntegrator":
        """The integrator with a bound on its steps, where it finds their length itself.

        Args:
            step: largest step [s].

        Returns:
            the integrator.
        """
        return self

    @property
    def promise(self) -> Promise:
        """The largest errors with which a run by it says nothing of its numbers."""
        return IMPLICIT


# Share of a step by which rounding may miss the end of an interval.
SLIVER = 1e-9
# More steps than any run takes: at 200 ns each, a kernel's fastest, two days.
MOST_STEPS = 1e12


def with_step_times(integrator: Any, share: Scalar) -> Any:
    """An integrator with a `step` of this share of its own [1]."""
    return with_fields(integrator, step=on_device(share * on_host(integrator.step)))


def divide(interval: Interval, step: Any, fixed: int | None = None) -> tuple[Any, Any]:
    """(number of equal steps, their length [s]).

    Where the number is more than any run takes (a step of 0, which only a traced number can be
    here), one step of nan.

    Args:
        interval: start and stop [s].
        step: largest length [s].
        fixed: number of steps; None: the fewest that are no longer than `step`.
    """
    start, stop = interval.start, interval.stop
    count = jnp.maximum(jnp.ceil((stop - start) / step * (1 - SLIVER)), 1.0)
    count = count if fixed is None else jnp.asarray(float(fixed))
    valid = count <= MOST_STEPS
    return jnp.where(valid, count, 1.0).astype(int), (stop - start) / jnp.where(
        valid, count, jnp.nan
    )


def resolved(step: Any, interval: Interval) -> Any:
    """A step [s], nan where it is so short that the time at the end of an interval does not grow by
    it: a loop that waits for the end would wait for ever."""
    return jnp.where(interval.stop + step > interval.stop, step, jnp.nan)


def take_up(first: Any, under_way: Any) -> Any:
    """What a loop over the steps of an interval carries at its start: `first`, or what it carried
    where it is under way (as of `Interval`).

    Samples of a batch that wear surfaces reach the ends of their intervals after different numbers
    of steps; half of them do not wait for the others.
    """
    if not under_way:
        return first
    goes_on, carry = under_way
    return jax.tree.map(lambda old, new: jnp.where(goes_on, old, new), carry, first)


def march(
    one: Callable[[Any, Any, Any], tuple], steps: Any, state: Any, warm_start: Any
) -> tuple[Any, Any]:
    """State and warm start after steps, in one loop.

    Args:
        one: (index, state, warm start) -> (state, warm start).
        steps: their number.
        state, warm_start: before the first step.
    """
    turn = lambda carry: (carry[0] + 1, *one(*carry))
    _, state, warm_start = while_loop(
        lambda carry: carry[0] < steps, turn, (jnp.zeros((), int), state, warm_start)
    )
    return state, warm_start


def counted(one: Callable[[Any, Any], Any], steps: int, first: Any) -> Any:
    """What is carried after a fixed number of turns, in a loop that suits reverse mode.

    It stores what a turn is given within one interval at a time, and for the others only their
    beginnings, and computes all once more.

    Args:
        one: (index, carry) -> carry.
        steps: number of turns.
        first: carry before the first turn.
    """
    turn = jax.checkpoint(lambda carry, index: (one(index, carry), None), prevent_cse=False)
    through = lambda first: jax.lax.scan(turn, first, jnp.arange(steps))[0]
    return jax.checkpoint(through, prevent_cse=False)(first)


def arrived(
    end: Any, steps: Any, warm_start: Any, peaks: Peaks | None = None, watch: Watch | None = None
) -> Advance:
    """Result of an interval whose steps are never rejected.

    Args:
        end: state at its end, shape (n,).
        steps: their number.
        warm_start: for the next interval.
        peaks: largest depths and forces so far; None: not followed.
        watch: events and transmitted forces; None: not followed.
    """
    outcome = jnp.where(jnp.all(jnp.isfinite(end)), Outcome.REACHED, Outcome.NOT_FINITE)
    extras = () if watch is None else (watch.events, watch.transmitted)
    return Advance(end, steps, jnp.zeros_like(steps), warm_start, outcome, peaks, *extras)


def searching_steps(
    model: Model, interval: Interval, longest: Any, step: Callable, carry: tuple, loose: float
) -> Advance:
    """Result of equal steps, each of which iterates on percussions or friction.

    Args:
        model: of the run.
        interval: start and stop [s].
        longest: largest length of a step [s].
        step: (time step, state, last) -> (state, last).
        carry: state and warm start; the last entry of the latter's first array is the largest
            residual.
        loose: residual beyond which the laws count as not satisfied.
    """
    steps, h = divide(interval, longest)

    def one(index, state, carried):
        (last, watch), time = carried, interval.start + index * h
        end, last = step(TimeStep(time, h), state, last)
        return end, (last, watched(watch, model, time, h, state, end))

    state, warm_start = carry
    watch = watch_from(model, interval.start, state)
    state, (warm_start, watch) = march(one, steps, state, (warm_start, watch))
    answer = arrived(state, steps, warm_start, None, watch)
    residual = jax.tree.leaves(warm_start)[0][-1]
    failed = (answer.outcome == Outcome.REACHED) & (residual > loose)
    return answer._replace(outcome=jnp.where(failed, Outcome.LAWS_NOT_SATISFIED, answer.outcome))
