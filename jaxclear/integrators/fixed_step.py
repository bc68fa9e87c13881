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
from jaxclear.ground.wording import unknown
from jaxclear.integrators import munthe_kaas
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.integrators.checks import Check
from jaxclear.integrators.events import watch_from, watched
from jaxclear.integrators.state_group import state_group
from jaxclear.integrators.stepping import (
    SLIVER,
    arrived,
    contacts_met,
    counted,
    divide,
    resolved,
)
from jaxclear.native import while_loop

# Explicit Runge-Kutta methods in which each stage starts from the slope of the one before: (nodes,
# weights).
CHAINS: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "euler": ((0.0,), (1.0,)),
    "semi_implicit": ((0.0,), (1.0,)),
    "heun": ((0.0, 1.0), (0.5, 0.5)),
    "rk4": ((0.0, 0.5, 0.5, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)),
}
# Methods on the group of the coordinates, by their order.
ON_GROUPS = {f"munthe_kaas{order}": order for order in munthe_kaas.TABLEAUS}
# Rate of damping times the step up to which a method is stable, by its order: where |1 + z + ... +
# z^p / p!| passes 1 on the negative axis.
STABLE_DAMPING = {1: 2.0, 2: 2.0, 3: 2.513, 4: 2.785}
ORDERS = {"euler": 1, "semi_implicit": 1, "heun": 2, "rk4": 4} | ON_GROUPS


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
    those of the discrete run: where contacts open and close, not those of the motion
    (`jaxclear.sensitivity` compares methods).
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
        where the next step begins. None where nothing looks at contacts."""
        seen = self.method not in ON_GROUPS or self.formulation.remembers(model)
        if not (seen and any(kinds for _, kinds in model.layout.memories)):
            return None
        return self.formulation.contacts(model, start, state), jnp.ones(())

    def advance(self, model, interval, state, warm_start):
        steps, h = divide(interval, self.step, self.steps_per_save)
        if self.contact_steps is not None:
            return self._steps_that_meet_contacts(model, interval, h, state, warm_start)

        def turn(carry):
            index, y, last, met, watch = carry
            time = interval.start + index * h
            _, y, now = self._step(model, time, lambda *_: h, h, y, last)
            y = closed(model, time + h, y)
            watch = watched(watch, model, time, h, y)
            return index + 1, y, now, _met(met, last, now), watch

        watch = watch_from(model, interval.start, state)
        first = (jnp.zeros((), int), state, warm_start, _nothing_met(warm_start), watch)
        if self.steps_per_save is None:
            _, end, last, met, watch = while_loop(lambda carry: carry[0] < steps, turn, first)
        else:
            scanned = lambda index, carry: turn((index, *carry))[1:]
            end, last, met, watch = counted(scanned, self.steps_per_save, first[1:])
        return arrived(end, steps, last, met, self._judged(h), Check.IMPACT_STEP, watch)

    def _steps_that_meet_contacts(self, model, interval, longest, state, warm_start):
        """Every sample at its own pace."""
        stop = interval.stop
        shortest = resolved(longest / self.contact_steps, interval)

        def choose(left):
            def length(contacts, last):
                near = jnp.any(_near(contacts, last, longest))
                h = jnp.where(near, shortest, longest)
                return jnp.where(h > left * (1 - SLIVER), left, h)

            return length

        def one(carry):
            time, steps, y, last, met, watch = carry
            h, y, now = self._step(model, time, choose(stop - time), longest, y, last)
            # The step that was cut to what was left ends exactly at the end.
            begin, time = time, jnp.where(h == stop - time, stop, time + h)
            y = closed(model, time, y)
            watch = watched(watch, model, begin, h, y)
            return time, steps + 1, y, now, _met(met, last, now), watch

        met = _nothing_met(warm_start)
        watch = watch_from(model, interval.start, state)
        first = (interval.start, jnp.zeros((), int), state, warm_start, met, watch)
        _, steps, end, last, met, watch = while_loop(lambda carry: carry[0] < stop, one, first)
        judged = self._judged(shortest)
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


def _met(met: Any, last: Any, now: Any) -> Any:
    """What was met of the contacts, from their motion at the starts of two steps."""
    if met is None:
        return None
    return contacts_met(met, last[0].depths, now[0].depths)


def _nothing_met(last: Any) -> Any:
    """What was met before the first step; None where nothing looks at contacts."""
    return None if last is None else (jnp.zeros_like(last[0].depths),) * 2


def _near(contacts: Any, last: Any, longest: Any) -> Any:
    """Whether each contact is closed, has parted within the last step, or would close within the
    `longest` [s]: by its closing speed, and by how that has grown since the last step began (a load
    ends a short flight however slowly it begins)."""
    coming = jnp.maximum(contacts.rates, 0.0) * longest
    near = (contacts.depths >= 0) | (contacts.depths + coming > 0)
    if last is None:
        return near
    before, length = last
    growth = jnp.maximum(contacts.rates - before.rates, 0.0) / length
    falling = contacts.depths + (contacts.rates + 0.5 * growth * longest) * longest
    return near | (before.depths >= 0) | (falling > 0)
