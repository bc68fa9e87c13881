"""Explicit steps of a fixed length: the same work for every sample, so the choice for batches and
for derivatives.

One loop of few small arrays, the stages a loop within it: on a CPU it becomes one kernel
(`jaxclear.native`). Where contacts get short steps of their own, each sample of a batch keeps its
own time.
"""

import functools
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.formulations.closing import closed
from jaxclear.formulations.compliant import CompliantContact
from jaxclear.ground.quantity import Scalar, count, quantity
from jaxclear.ground.tangents import derived_once
from jaxclear.ground.wording import unknown
from jaxclear.integrators import munthe_kaas, vibration
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.integrators.checks import Check
from jaxclear.integrators.deepest import largest
from jaxclear.integrators.events import watch_from, watched
from jaxclear.integrators.explicit_methods import (
    ANGLES,
    CHAINS,
    ON_GROUPS,
    ORDERS,
    STABLE_DAMPING,
    chosen_length,
)
from jaxclear.integrators.mid_step import through_touches
from jaxclear.integrators.state_group import state_group
from jaxclear.integrators.stepping import (
    arrived,
    contacts_met,
    counted,
    divide,
    resolved,
)
from jaxclear.integrators.trust import GROWTH, NO_SECOND, trusted_steps, unknown_way
from jaxclear.native import while_loop


class FixedStep(AbstractIntegrator):
    """Explicit Runge-Kutta with equal steps: the same cost for every sample, so the choice for
    batches.

    Steps are shortened a little to meet the saving times. No error control: halve `step` to see the
    error. Stable up to about 1.6 / omega (rk4), half of that ("semi_implicit") and a quarter
    ("heun"), omega = sqrt(contact stiffness / mass), of the order of 1e4 rad/s in a steel bearing
    (benchmarks/claims/stability.py, for K from 1e10 N/m^1.5 on; in softer contacts a step must not
    cross the clearance). "semi_implicit" is symplectic Euler: order 1, one evaluation a step, no
    drift of the energy; "euler" gains energy, "heun" slowly. "munthe_kaas1" to "munthe_kaas4"
    (order 1 to 4) keep rotations on their group; see `MuntheKaas`. `contact_steps` divides a step
    that starts in contact, or would end there at the present closing speed and acceleration, into
    that many; free flight keeps the long step, so bounces are resolved at a fraction of the cost.
    `steps_per_save` fixes the number of steps between saving times instead: reverse-mode
    derivatives (`jax.grad`) then go backwards through the steps, which pays off for hundreds of
    numbers, but not through friction in ideal joints. Impact speeds
    are those at the touch within a step, to the third power of the step; a force that begins as the
    3/2th power of the indentation limits the order of a run through impacts to 5/2. Derivatives are
    those of the discrete run: where contacts open and close, by "rk4" without `steps_per_save`
    those of the motion (`mid_step`; within 1e-3 through six bounces of Hertzian laws in steps of
    20 us), nan where impacts have made them grow beyond what steps determine or a contact is over
    in a few steps; else not those of the motion (`jaxclear.sensitivity` compares methods).
    """

    pathwise: ClassVar = True
    projects: ClassVar = True
    step: Scalar = quantity(2e-5, "s", "largest step", above=0)
    method: str = eqx.field(static=True, default="rk4")
    steps_per_save: int | None = count(None, "steps between two saving times", kw_only=True)
    contact_steps: Scalar | None = quantity(
        None,
        "1",
        "short steps in contact to one long step in free flight",
        at_least=1,
        kw_only=True,
    )

    def __check_init__(self):
        if self.method not in CHAINS and self.method not in ON_GROUPS:
            raise ValueError(unknown("fixed-step method", self.method, [*CHAINS, *ON_GROUPS]))
        if self.contact_steps is not None and self.steps_per_save is not None:
            raise ValueError(
                "integrator.FixedStep takes contact_steps or steps_per_save, not both: short steps "
                "in contact make the number of steps depend on the motion."
            )

    def asked_step(self):
        return self.step if self.steps_per_save is None else None

    def shortest_step(self):
        step = self.asked_step()
        return step if step is None or self.contact_steps is None else step / self.contact_steps

    @property
    def steps_between_saves(self):
        return self.steps_per_save

    @property
    def notes_events(self):
        return True

    @property
    def places_in_gaps(self):
        return ORDERS[self.method] > 1

    @property
    def usual_step(self):
        return self.asked_step()

    def with_finer_steps(self, share):
        if self.steps_per_save is not None:
            return None
        return eqx.tree_at(lambda own: own.step, self, share * self.step)

    @property
    def formulation(self):
        return CompliantContact()

    def first_warm_start(self, model, start, state):
        """The contacts at the start of the last step, and its length [s]: a touch in it is found
        where the next step begins; None where nothing looks at contacts. How derivatives grow, and
        vibrate."""
        seen = self.method not in ON_GROUPS or self.formulation.remembers(model)
        if not (seen and any(kinds for _, kinds in model.layout.memories)):
            return None, None, None, vibration.nothing(model, self)
        growth = jnp.zeros(GROWTH) if self._derived(model) else None
        contacts = self.formulation.contacts(model, start, state)
        return contacts, jnp.ones(()), growth, vibration.nothing(model, self)

    def _derived(self, model):
        return self.through_contacts and model.system.bearings and not model.discrete

    @property
    def through_contacts(self):
        return self.method == "rk4" and self.steps_per_save is None

    def _stepped(self, model):
        """A step, as a function of ((time [s], lengths...), state, last)."""
        arrays, rest = eqx.partition((model, self), eqx.is_array)

        def plain(arrays, clock, y, last):
            (model, own), (time, longest, left) = eqx.combine(arrays, rest), clock
            return own._step(model, time, chosen_length(longest, left), longest, y, last)

        length = lambda clock, *seen: chosen_length(*clock[1:])(*seen)
        through = through_touches(self.formulation, rest[0], plain, length)

        def step(clock, y, last):
            contacts, length, growth, vibrates = last
            before = None if contacts is None else (contacts, length)
            if self._derived(model):
                h, end, now, growth = through(arrays, clock, y, before, growth)
            else:
                h, end, now = plain(arrays, clock, y, before)
            vibrates = vibration.followed(model, ANGLES[self.method], vibrates, (y, end), h)
            return h, end, (*(now or (None, None)), growth, vibrates)

        return step

    def _met(self, model, met, last, now):
        """What was met of the contacts, from their motion at the starts of two steps."""
        found = None if met is None else contacts_met(met, last[0].depths, now[0].depths)
        if met is None or not self._derived(model):
            return found
        return found[0], largest(met[1], last[0], now[0], last[1])

    def _trusted(self, model, end, last, met, watch):
        """All that was found, where its derivative can be trusted; rates at events have none."""
        end, met, watch = vibration.resolved((end, met, watch), last[3])
        if not self._derived(model):
            return end, met, watch
        if watch is not None:
            rates = unknown_way(watch.events.rates)
            watch = watch._replace(events=watch.events._replace(rates=rates))
        return derived_once(NO_SECOND, trusted_steps((end, met, watch), last[2]))

    def advance(self, model, interval, state, warm_start):
        steps, h = divide(interval, self.step, self.steps_per_save)
        if self.contact_steps is not None:
            return self._steps_that_meet_contacts(model, interval, h, state, warm_start)

        step = self._stepped(model)

        def turn(carry):
            index, y, last, met, watch = carry
            time = interval.start + index * h
            _, y, now = step((time, h, None), y, last)
            y = closed(model, time + h, y)
            watch = watched(watch, model, time, h, y)
            return index + 1, y, now, self._met(model, met, last, now), watch

        watch = watch_from(model, interval.start, state)
        first = (jnp.zeros((), int), state, warm_start, _nothing_met(warm_start), watch)
        if self.steps_per_save is None:
            _, end, last, met, watch = while_loop(lambda carry: carry[0] < steps, turn, first)
        else:
            scanned = lambda index, carry: turn((index, *carry))[1:]
            end, last, met, watch = counted(scanned, self.steps_per_save, first[1:])
        end, met, watch = self._trusted(model, end, last, met, watch)
        return arrived(end, steps, last, met, self._judged(h), Check.IMPACT_STEP, watch)

    def _steps_that_meet_contacts(self, model, interval, longest, state, warm_start):
        """Every sample at its own pace."""
        stop, step = interval.stop, self._stepped(model)
        shortest = resolved(longest / self.contact_steps, interval)

        def one(carry):
            time, steps, y, last, met, watch = carry
            h, y, now = step((time, longest, (stop - time, shortest)), y, last)
            # The step that was cut to what was left ends exactly at the end.
            begin, time = time, jnp.where(h == stop - time, stop, time + h)
            y = closed(model, time, y)
            watch = watched(watch, model, begin, h, y)
            return time, steps + 1, y, now, self._met(model, met, last, now), watch

        met = _nothing_met(warm_start)
        watch = watch_from(model, interval.start, state)
        first = (interval.start, jnp.zeros((), int), state, warm_start, met, watch)
        _, steps, end, last, met, watch = while_loop(lambda carry: carry[0] < stop, one, first)
        judged = self._judged(shortest)
        end, met, watch = self._trusted(model, end, last, met, watch)
        return arrived(end, steps, last, met, judged, Check.IMPACT_STEP, watch)

    def _judged(self, h):
        """What checks of friction and damping judge steps in contact of this length [s] by."""
        stable = STABLE_DAMPING[ORDERS[self.method]]
        return {Check.FRICTION_STEP: h, Check.DAMPER_STEP: h / stable}

    def _step(self, model, time, length, h, y, last):
        """The length and the end of a step, and what it leaves to the next. `length(contacts,
        last)` chooses it [s] by the contacts at its start and what the last step left; `h` is the
        longest. Stages are a loop: the equations stand in the program once.
        """
        if self.method in ON_GROUPS:
            return self._step_on_group(model, time, length, h, y, last)
        stages = np.arange(len(CHAINS[self.method][0]))
        stage = functools.partial(self._stage, model, time, length)
        (h, y, _, _, last), _ = jax.lax.scan(stage, (h, y, y, jnp.zeros_like(y), last), stages)
        return h, y, last

    def _stage(self, model, time, length, carry, stage):
        """One stage of a step; its first one decides the step's `length` from the contacts it sees,
        and sets impact speeds of contacts that have closed in the last one."""
        h, y, total, slope, last = carry
        nodes, weights = (jnp.asarray(part) for part in CHAINS[self.method])
        slope, contacts = self.formulation.rate(
            model, time + nodes[stage] * h, y + (h * nodes[stage]) * slope
        )
        opens = stage == 0
        h = jnp.where(opens, length(contacts, last), h)
        if last is not None:
            if self.formulation.remembers(model):
                aware = self.formulation.remember(model, y, last[0], contacts, last[1])
                y, total = jnp.where(opens, aware, y), jnp.where(opens, aware, total)
            last = jax.tree.map(lambda a, b: jnp.where(opens, a, b), (contacts, h), last)
        total = total + (h * weights[stage]) * slope
        if self.method == "semi_implicit":
            n = model.layout.coordinates
            kicked = jnp.concatenate([y[:n], total[n:]])
            rates = self.formulation.coordinate_rates(model, kicked)
            total = jnp.concatenate([y[:n] + h * rates, total[n:]])
            total = self._with_energies(model, time, h, y, total)
        y = jnp.where(stage == len(CHAINS[self.method][0]) - 1, total, y)
        return (h, y, total, slope, last), None

    def _with_energies(self, model, time, h, y, after):
        """The energies of the balance after a semi-implicit step, where they are asked for."""
        layout = model.layout
        if not layout.energies:
            return after
        n, m, first = layout.coordinates, layout.memory_start, layout.energy_start + 1
        powers = self.formulation.energy_rates(model, time, y, 0.5 * (y[n:m] + after[n:m]))
        return jnp.concatenate([after[:first], y[first:] + h * powers])

    def _step_on_group(self, model, time, length, h, y, last):
        """As `_step`; the contacts are looked at beforehand, where something depends on them."""
        if last is not None or self.contact_steps is not None:
            contacts = self.formulation.contacts(model, time, y)
            h = length(contacts, last)
            if last is not None:
                y = self.formulation.remember(model, y, last[0], contacts, last[1])
                last = contacts, h

        def rate(time, y):
            return self.formulation.rate(model, time, y)[0]

        order = ON_GROUPS[self.method]
        return h, munthe_kaas.fixed_step(state_group(model), rate, order, time, h, y), last


def _nothing_met(last: Any) -> Any:
    """What was met before the first step; None where nothing looks at contacts."""
    return None if last[0] is None else (jnp.zeros_like(last[0].depths),) * 2
