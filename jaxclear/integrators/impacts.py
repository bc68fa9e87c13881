"""A diffrax solver whose steps take impact speeds, and a controller that ends steps where contacts
close and part: an error-controlled run does not follow the approach speed, and is as smooth within
its steps as the solver wants it.

From the two ends of a step the speed at a touch follows (`formulations.impact_speed`). A touch that
begins and ends within one step, unseen at either end, is seen halfway, by the solver's own
interpolation.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from jaxclear.formulations.impact_speed import ContactMotion, Passage, end_at_passage
from jaxclear.ground.quantity import Scalar, constant
from jaxclear.integrators.error_control import AbstractAround
from jaxclear.integrators.events import noted, nothing
from jaxclear.integrators.peaks import nothing_met, peaks, risen, since
from jaxclear.integrators.saltation import Equations, Step


class Judged(NamedTuple):
    """What a step tells its controller: its error, and what the contacts did in it."""

    error: Any
    passed: Passage


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
        share = end_at_passage(*y_error.passed, length, self.beyond, least)
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


class TakingImpactSpeeds(
    AbstractAround, diffrax.AbstractAdaptiveSolver, diffrax.AbstractWrappedSolver
):
    """`solver`, and after each of its steps the impact speeds of contacts that have closed or
    parted. Its controller is `EndingAtTouches`.

    `motion`: of the model (`saltation.motion_of`). `remember(state, before, after, length, args)`:
    the state with its impact speeds set. `damped`: whether some contact damps. Args are (arrays of
    the model, None), those of `solver` may tell which contacts count as closed. `derived`: how
    derivatives go through touches (None: they do not), `growth`: by how much they have grown
    (`trust.trusted`), `so_far`: the peaks of the run (None: not followed). Its state between steps
    ends with the `Peaks` of every contact so far: the motion of the contacts is known at both ends
    of a step, so that peaks of a run cost it next to nothing; with `events`, so many, of a saving
    interval (`integrators.events`); and with the growth.
    """

    solver: diffrax.AbstractSolver  # type: ignore[misc]
    remember: Callable
    motion: Any = None  # a Motion
    derived: Equations | None = None
    growth: Any = None
    so_far: Any = None  # Peaks
    damped: bool = eqx.field(static=True, default=False)
    events: int = eqx.field(static=True, default=0)

    @property
    def interpolation_cls(self):
        return self.solver.interpolation_cls

    @property
    def scan_kind(self):
        """How an explicit solver goes through its stages; diffrax asks."""
        return self.solver.scan_kind

    @property
    def root_finder(self):
        """How an implicit solver finds its stages; diffrax asks."""
        return self.solver.root_finder

    def init(self, terms, t0, t1, y0, args):
        contacts = self.motion.contacts(args[0], t0, y0)
        events = nothing(contacts, self.events) if self.events else None
        own = self.solver.init(terms, t0, t1, y0, args)
        begun = nothing_met(contacts.depths, self.damped)
        begun = since(self.so_far, self._risen(begun, y0, args, contacts))
        return own, contacts, begun, events, self.growth

    def func(self, terms, t0, y0, args):
        return self.solver.func(terms, t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        own, before, known, events, growth = solver_state
        step = Step(args[0], ContactMotion(*constant(before)), constant(t1 - t0))
        times, y, own, shift, given = self._begun(step, (t0, t1), y0, own, args)
        y1, error, dense, own, result = self.solver.step(terms, *times, y, given, own, made_jump)
        after: Any = constant(self.motion.contacts(args[0], t1, y1))
        length, half = t1 - t0, 0.5 * (t0 + t1)
        path = self.interpolation_cls(t0=t0, t1=t1, **constant(dense))
        middle = self.motion.contacts(args[0], half, path.evaluate(half))
        passed = Passage(*constant((before, middle, after)))
        remembering = self.remember(y1, before, after, length, args)
        if events is not None:
            events = noted(events, *constant((t0, length, before, after)))
        told = remembering, growth, events, error
        y1, own, growth, events = self._ended(step, (t1, y1), own, shift, told)
        known = self._peaks((t0, y0), (t1, y1), args, (step.contacts, after), known)
        kept = own, after, known, events, growth
        return y1, Judged(error, passed), dense, kept, result

    def _peaks(self, start, end, args, motions, known):
        """The peaks after a step."""
        if self.derived is None:
            return self._risen(known, end[1], args, motions[1])
        so_far = constant(self.so_far)
        return peaks(self.motion, args[0], (start, end), motions, known, so_far)

    def _risen(self, known, y, args, contacts):
        """The peaks with the contacts at an instant."""
        forces = self.motion.pressing(args[0], y, contacts) if self.damped else None
        found = risen(known, contacts.depths, forces)
        return found if self.derived else constant(found)

    def _begun(self, step, times, y, own, args):
        """(times, state, state of the solver, shift, args) of its step, as derivatives want it."""
        if self.derived is None:
            return times, y, own, None, args
        slopes, others = eqx.partition(own, eqx.is_inexact_array)
        y, slopes, shift = self.derived.shifted(step, (times[0], y), slopes)
        times = tuple(time + shift for time in times)
        return times, y, eqx.combine(slopes, others), shift, (args[0], step.shares)

    def _ended(self, step, end, own, shift, known):
        """(state, state of the solver, growth, events) with derivatives behind touches and
        releases, from (state, growth, events, error) as `known` before."""
        if self.derived is None:
            return known[0], own, *known[1:3]
        slopes, others = eqx.partition(own, eqx.is_inexact_array)
        y, slopes, *rest = self.derived.jumped(step, end, slopes, shift, *known)
        return y, eqx.combine(slopes, others), *rest
