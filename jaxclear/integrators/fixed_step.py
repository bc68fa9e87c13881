"""Explicit steps of a fixed length: the same work for every sample, so the choice for batches and
for derivatives.

One loop of few small arrays, the stages a loop within it: on a CPU it becomes one kernel
(`jaxclear.native`). Where contacts get short steps of their own, each sample of a batch keeps its
own time.
"""

import functools
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.formulations.compliant import CompliantContact
from jaxclear.formulations.impact_speed import has_bristles, put_right
from jaxclear.formulations.loop_closing import closed
from jaxclear.formulations.model import Model
from jaxclear.ground.arguments import check_name
from jaxclear.ground.grouping import packed, unpacked
from jaxclear.ground.quantity import (
    Scalar,
    concrete,
    constant,
    count,
    quantity,
)
from jaxclear.integrators import munthe_kaas
from jaxclear.integrators.base import (
    FIRST_ORDER,
    FLANKS,
    RUNGE_KUTTA,
    SLIVER,
    STUDIES,
    AbstractIntegrator,
    arrived,
    counted,
    divide,
    resolved,
    take_up,
    with_step_times,
)
from jaxclear.integrators.events import among, no_peaks, risen, since, watch_from, watched
from jaxclear.integrators.munthe_kaas import state_group
from jaxclear.integrators.saltation import NODES, WEIGHTS
from jaxclear.integrators.variational import (
    BESIDE,
    THROUGH,
    derived_steps,
    not_resolved,
    so_far,
    trusted_steps,
)
from jaxclear.native import while_loop

# The method on the group of the coordinates.
ON_GROUP = "munthe_kaas4"
# Nodes and weights of explicit Runge-Kutta methods; of those that are not on the group each stage
# starts from the slope of the one before.
STAGES: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "semi_implicit": ((0.0,), (1.0,)),
    "heun": ((0.0, 1.0), (0.5, 0.5)),
    "rk4": (NODES, WEIGHTS),
    ON_GROUP: munthe_kaas.stages(4),
}
ORDERS = {"semi_implicit": 1, "heun": 2, "rk4": 4, ON_GROUP: 4}


def near_contacts(contacts: Any, last: Any, longest: Any) -> Any:
    """Which contacts are closed, have parted within the last step, or may close soon.

    They may by their closing speed, and by how that has grown since the last step began: a load
    ends a short flight however slowly it begins.

    Args:
        contacts: their motion now.
        last: their motion at the start of the last step, and its length [s]; None: unknown.
        longest: time in which they may close [s].
    """
    coming = jnp.maximum(contacts.rates, 0.0) * longest
    near = (contacts.depths >= 0) | (contacts.depths + coming > 0)
    if last is None:
        return near
    before, length = last
    growth = jnp.maximum(contacts.rates - before.rates, 0.0) / length
    falling = contacts.depths + (contacts.rates + 0.5 * growth * longest) * longest
    return near | (before.depths >= 0) | (falling > 0)


def chosen_length(longest: Any, rest: tuple | None) -> Callable[[Any, Any], Any]:
    """How the length [s] of a step follows from contacts; `rest`: what is left of the time and the
    shortest step, which it is where a contact is near. None: all are the longest."""

    def length(contacts, last):
        if rest is None:
            return longest
        remaining, shortest = rest
        near = jnp.any(near_contacts(contacts, last, longest))
        h = jnp.where(near, shortest, longest)
        return jnp.where(h > remaining * (1 - SLIVER), remaining, h)

    return length


def explicit_step(
    formulation: Any, method: str, model: Model, clock: tuple, y: Any, last: Any
) -> tuple:
    """One explicit step: its length [s], the state at its end, and what it hands on.

    Stages behind the first are a loop, so the equations stand in the program twice however many
    stages.

    Args:
        formulation: rate of the state.
        method: name of the method.
        model: of the run.
        clock: start and largest length of the step [s], and settings of its choice by contacts.
        y: state at its start, shape (n,).
        last: contacts at the start of the last step and its length; None: contacts are not
            looked at.
    """
    time, h, rest = clock
    looks = last is not None or rest is not None
    if method != ON_GROUP:
        slope, contacts = formulation.rate(model, time, y)
    elif looks:
        contacts = formulation.contacts(model, time, y)
    if looks:
        h = chosen_length(h, rest)(contacts, last)
    if last is not None:
        # Impact speeds of contacts that have closed in the last step, and deflections of bristles
        # for their time in contact.
        motions, length = (last[0], contacts), last[1]
        if formulation.remembers(model):
            y = formulation.remember(model, y, *motions, length)
        if has_bristles(model):
            y = put_right(formulation, model, (time, y), motions, (length, STAGES[method]))
        last = contacts, h
    rate = lambda time, y: formulation.rate(model, time, y)[0]
    if method == ON_GROUP:
        return h, munthe_kaas.fixed_step(state_group(model), rate, time, h, y), last
    nodes, weights = (jnp.asarray(part) for part in STAGES[method])
    end = y + (h * weights[0]) * slope
    if method == "semi_implicit":
        return h, _kicked(formulation, model, (time, h), y, end), last

    def further(carry, stage):
        end, slope = carry
        node = nodes[stage] * h
        slope = rate(time + node, y + node * slope)
        return (end + (h * weights[stage]) * slope, slope), None

    stages = np.arange(1, len(STAGES[method][0]))
    return h, jax.lax.scan(further, (end, slope), stages)[0][0], last


def _kicked(formulation: Any, model: Model, clock: tuple, y: Any, end: Any) -> Any:
    """The end of a semi-implicit step, whose places move by the speeds at its end, with the
    energies of the balance where they are asked for."""
    h, n = clock[1], model.layout.coordinates
    rates = formulation.coordinate_rates(model, jnp.concatenate([y[:n], end[n:]]))
    after = jnp.concatenate([y[:n] + h * rates, end[n:]])
    if not model.layout.energies:
        return after
    m, first = model.layout.memory_start, model.layout.energy_start + 1
    powers = formulation.energy_rates(model, clock[0], y, 0.5 * (y[n:m] + after[n:m]))
    return jnp.concatenate([after[:first], y[first:] + h * powers])


# Step [s] of studies that ask for no other.
USUAL_STEP = 2e-5


class FixedStep(AbstractIntegrator):
    """Explicit Runge-Kutta with equal steps: the same cost for every sample, so the choice for
    batches.

    Steps are shortened a little to meet the saving times. No error control: halve `step` to see the
    error. Stable up to about 1.6 / omega (rk4), half of that ("semi_implicit") and a quarter
    ("heun"), omega = sqrt(contact stiffness / mass), of the order of 1e4 rad/s in a steel bearing
    (measured on a pressed journal for K from 1e10 N/m^1.5 on; in softer contacts a step must not
    cross the clearance).

    Impact speeds are those at the touch within a step, to the third power of the step; a force that
    begins as the 3/2th power of the indentation limits the order of a run through impacts to 5/2.

    Derivatives are those of the discrete run: where contacts open and close, by "rk4" without
    `steps_per_save` those of the motion (`saltation`; within 1e-3 through six bounces of Hertzian
    laws in steps of 20 us). So are those of "heun" and "semi_implicit" without `steps_per_save` and
    `contact_steps`: of the motion, which is integrated beside the run (`variational`), nan where
    that differs from it by 3 % of the narrowest gap. Else they are not those of the motion
    (`jaxclear.sensitivity` compares methods). Without `steps_per_save` they are nan too where steps
    twice as long show that they are off by a hundredth (`jaxclear.explain_nan`).

    Args:
        step: largest step [s], > 0.
        method: name of the method: "rk4"; "heun", whose energy grows slowly; "semi_implicit"
            (symplectic Euler: order 1, one evaluation a step, no drift of the energy); or
            "munthe_kaas4" (order 4), which keeps rotations on their group, see `MuntheKaas`.
        steps_per_save: number of steps between two saving times, >= 1, in place of `step`:
            reverse-mode derivatives (`jax.grad`) then go backwards through the steps, which pays
            off for hundreds of numbers, but not through friction in ideal joints. None by default.
        contact_steps: number of short steps in contact for one long step in free flight [1], >= 1:
            a step is divided that starts in contact, or would end there at the present closing
            speed and acceleration, so bounces are resolved at a fraction of the cost. None: no
            division.

    Raises:
        ValueError: for an unknown method, or contact_steps together with steps_per_save.
    """

    pathwise: ClassVar = True
    projects: ClassVar = True
    notes_events: ClassVar = True
    step: Scalar = quantity(USUAL_STEP, "s", above=0)
    method: str = eqx.field(static=True, default="rk4")
    steps_per_save: int | None = count(None, kw_only=True)
    contact_steps: Scalar | None = quantity(None, "1", at_least=1, kw_only=True)

    def __check_init__(self):
        check_name("fixed-step method", self.method, STAGES)
        if self.contact_steps is not None and self.steps_per_save is not None:
            raise ValueError(
                "integrator.FixedStep takes contact_steps or steps_per_save, not both: short steps "
                "in contact make the number of steps depend on the motion."
            )

    def requested_step(self):
        return self.step if self.steps_per_save is None else None

    def evaluations(self, mechanism):
        return len(STAGES[self.method][0])

    def shortest_step(self):
        step = self.requested_step()
        return step if step is None or self.contact_steps is None else step / self.contact_steps

    @property
    def steps_between_saves(self):
        return self.steps_per_save

    @property
    def promise(self):
        if ORDERS[self.method] < 2:
            return FIRST_ORDER
        step = concrete(self.step)
        usual = self.method == "rk4" and step is not None and step <= USUAL_STEP
        return STUDIES if usual else RUNGE_KUTTA

    @property
    def first_order_slopes(self):
        return ORDERS[self.method] == 1

    def with_finer_steps(self, share):
        if self.steps_per_save is not None:
            return None
        return with_step_times(self, share)

    @property
    def opens_loops(self):
        # Those of order 4 open loops by 1e-13 m in steps of 0.1 ms (the four-bar in 20 s).
        return ORDERS[self.method] < max(ORDERS.values())

    @property
    def formulation(self):
        return CompliantContact()

    def first_warm_start(self, model, start, state):
        """Contacts at the start of the last step, its length [s], and the motion beside the run.

        A touch in the last step is found where the next begins. Each is None where it is not
        needed: without contacts, and where derivatives are those of the steps.

        Args:
            model: of the run.
            start: of the run [s].
            state: array at the start, shape (n,).
        """
        if not model.layout.contacts:
            return None, None
        contacts = self.formulation.contacts(model, start, state)
        beside, damped = None, self.formulation.damped(model)
        if self._derivative(model) == BESIDE:
            beside = not_resolved(model.layout.size, len(contacts.depths), damped)
        return (contacts, jnp.ones(())), beside

    def _derivative(self, model):
        """How derivatives go through contacts; None where they are those of the steps."""
        if not self.through_contacts or not model.layout.contacts or model.discrete:
            return None
        return THROUGH if self.method == "rk4" else BESIDE

    @property
    def through_contacts(self):
        same_step = self.method != ON_GROUP and self.contact_steps is None
        return self.steps_per_save is None and (self.method == "rk4" or same_step)

    def beyond_flanks(self, mechanism):
        # Other methods than rk4 integrate the motion too, and measure it by the gaps of joints.
        return self.beyond_touches(mechanism) if self.method == "rk4" else FLANKS

    def _stepped(self, model, so_far):
        """A step behind these peaks, of ((time [s], longest length [s], rest), state, last,
        peaks)."""
        of_model, rest = packed(model)
        of_others, others = eqx.partition((self, constant(so_far)), eqx.is_array)
        kind = self._derivative(model)

        def plain(arrays, clock, y, last, peaks):
            model, (part, _) = unpacked(arrays[0], rest), eqx.combine(arrays[1:], others)
            h, end, now = explicit_step(part.formulation, part.method, model, clock, y, last[0])
            # Loops of the motion are closed behind its touches.
            if kind == BESIDE:
                end = closed(model, clock[0] + h, end, h)
            if peaks is not None:
                forces = peaks.forces
                if forces is not None:
                    forces = part.formulation.normal_forces(model, end, now[0])
                peaks = risen(peaks, now[0].depths, forces)
            return h, end, (now, last[1]), peaks

        length = lambda clock, *look_at: chosen_length(*clock[1:])(*look_at)
        step = derived_steps(kind, self.formulation, rest, plain, length)
        return functools.partial(step, (of_model, *of_others))

    def advance(self, model, interval, state, warm_start):
        steps, longest = divide(interval, self.step, self.steps_per_save)
        step, kind = self._stepped(model, interval.peaks), self._derivative(model)
        watch, peaks = watch_from(model, interval.start, state), None
        if kind == BESIDE:
            warm_start = so_far(warm_start)
        if warm_start[0] is not None:
            peaks = no_peaks(warm_start[0][0].depths, self.formulation.damped(model))
            peaks = peaks if kind is None else since(interval.peaks, peaks)
        stop, pace = interval.stop, self.contact_steps
        shortest = None if pace is None else resolved(longest / pace, interval)

        def turn(carry):
            """Where contacts get short steps every sample goes at its own pace."""
            index, time, start, last, peaks, watch = carry
            rest = None if pace is None else (stop - time, shortest)
            begin = interval.start + index * longest if pace is None else time
            h, y, last, peaks = step((begin, longest, rest), start, last, peaks)
            time = begin + h
            if pace is not None:
                # The step that was cut to what was left ends exactly at the end.
                time = jnp.where(h == stop - begin, stop, time)
            if kind != BESIDE:
                y = closed(model, time, y, h)
            return index + 1, time, y, last, peaks, watched(watch, model, begin, h, start, y)

        first = jnp.zeros((), int), interval.start, state, warm_start, peaks, watch
        if self.steps_per_save is None:
            unfinished = lambda carry: carry[0] < steps if pace is None else carry[1] < stop
            resumed = interval.under_way is not None
            first = take_up(first, interval.under_way)
            carry = while_loop(unfinished, turn, first, resumed=resumed)
            under_way = (unfinished(carry), carry) if resumed else None
            steps, _, end, last, peaks, watch = carry
        else:
            scanned = lambda index, carry: turn((index, *carry))[1:]
            _, end, last, peaks, watch = counted(scanned, self.steps_per_save, first[1:])
            under_way = None
        if peaks is not None and kind is None:
            # With the derivatives of those of the run.
            peaks = among(interval.peaks, peaks)
        end, peaks, watch = trusted_steps(kind, end, peaks, watch, last)
        return arrived(end, steps, last, peaks, watch)._replace(under_way=under_way)
