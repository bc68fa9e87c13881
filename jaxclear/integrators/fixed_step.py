"""Explicit steps of a fixed length: the same work for every sample, so the choice for batches and
for derivatives.

One loop of few small arrays, the stages a loop within it: on a CPU it becomes one kernel
(`jaxclear.native`). Where contacts get short steps of their own, each sample of a batch keeps its
own time.
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.integrators import munthe_kaas
from jaxclear.integrators.base import COMPLIANT, AbstractIntegrator, check_count
from jaxclear.integrators.stepping import SLIVER, arrived, divide, march
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


class FixedStep(AbstractIntegrator):
    """Explicit Runge-Kutta with equal steps: the same cost for every sample, so the choice for
    batches.

    Steps are shortened a little to meet the saving times. No error control: halve `step` to see the
    error. Stable up to about 1.6 / omega (rk4), half of that ("semi_implicit") and a quarter
    ("heun"), omega = sqrt(contact stiffness / mass), of the order of 1e4 rad/s in a steel bearing
    (benchmarks/claims/stability.py, for K from 1e10 N/m^1.5 on; in softer contacts a step must not cross
    the clearance). "semi_implicit" is symplectic Euler: order 1, one evaluation a step, no drift of
    the energy; "euler" gains energy, "heun" slowly. "munthe_kaas1" to "munthe_kaas4" (order 1 to 4)
    keep rotations on their group; see `MuntheKaas`. `contact_steps` divides a step that starts in
    contact, or would end there at the present closing speed, into that many; free flight keeps the
    long step, so bounces are resolved at a fraction of the cost. `capture_impacts` takes the
    approach speed of the last step that starts open for the impact speed, in place of a state that
    follows it within `memory_time`. `steps_per_save` fixes the number of steps between saving times
    instead: reverse-mode derivatives (`jax.grad`) need it, forward-mode ones do not.
    """

    pathwise: ClassVar = True
    formulation: ClassVar = COMPLIANT
    step: Scalar = quantity(2e-5, "s", "largest step", above=0)
    method: str = eqx.field(static=True, default="rk4")
    steps_per_save: int | None = eqx.field(static=True, default=None)
    contact_steps: Scalar | None = quantity(
        None, "1", "short steps in contact to one long step in free flight", at_least=1
    )
    capture_impacts: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        if self.method not in CHAINS and self.method not in ON_GROUPS:
            raise ValueError(
                f"no fixed-step method {self.method!r}; there are "
                f"{', '.join([*CHAINS, *ON_GROUPS])}."
            )
        check_count(self.steps_per_save, "steps_per_save of integrator.FixedStep")
        if self.contact_steps is not None and self.steps_per_save is not None:
            raise ValueError(
                "integrator.FixedStep takes contact_steps or steps_per_save, not both: short steps "
                "in contact make the number of "
                "steps depend on the motion, and reverse-mode derivatives need it fixed."
            )

    def relaxing_step(self, interval):
        if self.capture_impacts:
            return None
        if self.steps_per_save is not None:
            return None if interval is None else interval / self.steps_per_save
        return self.step

    def first_warm_start(self, field, start, state):
        return ()

    def advance(self, field, start, stop, state, warm_start, weights, running):
        field = field.when_captured() if self.capture_impacts else field
        steps, h = divide(start, stop, self.step, self.steps_per_save)
        if self.contact_steps is None:
            end = self._equal_steps(field, start, h, steps, state)
        else:
            end, steps = self._steps_that_meet_contacts(field, start, stop, h, state)
        return arrived(end, steps, ())

    def _equal_steps(self, field, start, h, steps, state):
        def one(index, y, warm_start):
            y = self._whole_step(field, start + index * h, lambda depth, closing: h, h, y)[1]
            return field.closed(start + (index + 1) * h, y), warm_start

        if self.steps_per_save is None:
            return march(one, steps, state, ())[0]
        turns = jnp.arange(self.steps_per_save)
        return jax.lax.scan(lambda y, index: (one(index, y, ())[0], None), state, turns)[0]

    def _whole_step(self, field, time, length, h, y):
        """The length and the end of a step. Stages are a loop: the equations stand in the program
        once.
        """
        if self.method in ON_GROUPS:
            return self._step_on_group(field, time, length, h, y)
        stages = np.arange(len(CHAINS[self.method][0]))
        carry = (h, y, y, jnp.zeros_like(y))
        (h, y, _, _), _ = jax.lax.scan(
            lambda c, stage: (self._stage(field, stage, time, length, *c), None), carry, stages
        )
        return h, y

    def _step_on_group(self, field, time, length, h, y):
        """As `_whole_step`; the contacts are looked at beforehand, where something depends on
        them."""
        if self.capture_impacts or self.contact_steps is not None:
            depth, closing = field.contacts(time, y)
            h = length(depth, closing)
            y = field.remember(y, depth < 0, closing) if self.capture_impacts else y
        return h, munthe_kaas.fixed_step(field, ON_GROUPS[self.method], time, h, y)

    def _steps_that_meet_contacts(self, field, start, stop, longest, state):
        """Every sample at its own pace."""

        def choose(left):
            def length(depth, closing):
                near = jnp.any((depth >= 0) | (depth + jnp.maximum(closing, 0.0) * longest > 0))
                h = jnp.where(near, longest / self.contact_steps, longest)
                return jnp.where(h > left * (1 - SLIVER), left, h)

            return length

        def one(carry):
            time, steps, y = carry
            h, y = self._whole_step(field, time, choose(stop - time), longest, y)
            # The step that was cut to what was left ends exactly at the end.
            time = jnp.where(h == stop - time, stop, time + h)
            return time, steps + 1, field.closed(time, y)

        _, steps, end = while_loop(
            lambda carry: carry[0] < stop, one, (start, jnp.zeros((), int), state)
        )
        return end, steps

    def _stage(self, field, stage, time, length, h, y, total, slope):
        """One stage of the step from (time, y); its first one decides the step's `length` from the
        contacts it sees.
        """
        nodes, weights = (jnp.asarray(part) for part in CHAINS[self.method])
        slope, depth, closing = field.with_contacts(
            time + nodes[stage] * h, y + (h * nodes[stage]) * slope
        )
        opens = stage == 0
        h = jnp.where(opens, length(depth, closing), h)
        if self.capture_impacts:
            caught = opens & (depth < 0)
            y, total = (field.remember(part, caught, closing) for part in (y, total))
        total = total + (h * weights[stage]) * slope
        if self.method == "semi_implicit":
            n = field.layout.coordinates
            kicked = jnp.concatenate([y[:n], total[n:]])
            total = jnp.concatenate([y[:n] + h * field.coordinate_rates(kicked), total[n:]])
        return h, jnp.where(stage == len(CHAINS[self.method][0]) - 1, total, y), total, slope
