"""How a state is carried from one saving time to the next. Each integrator states what it trades.

`Adaptive` (any diffrax solver under error control) is the reference; `FixedStep` (explicit Runge-Kutta) does the same work for
every sample, so it wins in batches, and it is the one to differentiate through.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from jaxclear.ground.quantity import Scalar, concrete, quantity

# Outcomes of an advance; the sentence is the result a run ends with.
OUTCOMES = (
    "The run reached its end.",
    "The step size fell below the smallest allowed: the equations are too stiff or not finite here.",
    "The allowed number of steps between two saved times was used up.",
    "The state became infinite or not a number.",
)
# Share of an interval below which a step is given up.
SMALLEST_STEP = 1e-11
REACHED, TOO_SMALL, TOO_MANY, NOT_FINITE = range(4)


class Advance(NamedTuple):
    """Outcome of one interval: state at its end, steps accepted and rejected, typical step, index into `OUTCOMES`."""

    state: Any
    accepted: Any
    rejected: Any
    step: Any
    outcome: Any


class AbstractIntegrator(eqx.Module):
    """Carries a state over an interval. `pathwise` tells whether forward-mode derivatives through its steps
    are those of the discrete run."""

    pathwise: eqx.AbstractClassVar[bool]

    @abstractmethod
    def advance(
        self, field: Callable, start: Scalar, stop: Scalar, state: Any, step: Scalar, weights: Any, running: Any
    ) -> Advance:
        """From `start` to `stop` [s]; `step` is the typical step of the last interval (0: none yet). `weights` (n,) scale
        each entry's error for the error control; 0 where an entry only follows the others. Where `running` is False the
        run has ended before and the outcome will be ignored: an integrator may then save the work."""


class Adaptive(AbstractIntegrator):
    """A diffrax solver under error control: cost follows difficulty.

    Use as reference and for single runs. Local error per step below rtol |y| + atol in every coordinate and speed; memories
    of laws are held a hundred times looser, worn volumes and energies follow the motion. In a batch all samples wait for
    the slowest. Do not differentiate a finished run near contact (52 % wrong in a measurement); see `jaxclear.sensitivity`.
    Stiff scenes (large friction over tiny transition speeds) may prefer an implicit solver, best with a full Newton iteration:
    diffrax.Kvaerno5(root_finder=optimistix.Newton(rtol=1e-6, atol=1e-8)).
    """

    pathwise: ClassVar = False
    solver: diffrax.AbstractSolver = eqx.field(default_factory=diffrax.Tsit5)
    rtol: Scalar = quantity(1e-7, "1", "relative local error of coordinates and speeds")
    atol: Scalar = quantity(1e-9, "1", "absolute local error of coordinates [m, rad] and speeds [m/s, rad/s]")
    largest_step: Scalar | None = quantity(None, "s", "largest step")
    most_steps: int = eqx.field(static=True, default=200_000)

    def __check_init__(self):
        for name, allowed in (("rtol", "at least 0"), ("atol", "positive")):
            value = concrete(getattr(self, name))
            if value is not None and not (value > 0 or (value == 0 and name == "rtol")):
                raise ValueError(f"the tolerance {name} of integrator.Adaptive is {value}; it must be {allowed}.")

    def advance(self, field, start, stop, state, step, weights, running):
        stop = jnp.where(running, stop, start)
        interval = stop - start
        controller = diffrax.PIDController(
            rtol=self.rtol,
            atol=self.atol,
            # diffrax reports a failed implicit stage as an infinite error of all entries: 0 times infinity must not enter.
            norm=lambda error: jnp.max(jnp.where(weights > 0, jnp.abs(weights * error), 0.0), initial=0.0),
            dtmin=SMALLEST_STEP * jnp.maximum(interval, SMALLEST_STEP),
            dtmax=self.largest_step,
            force_dtmin=False,
        )
        arrays, rest = eqx.partition(field, eqx.is_array)
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda time, y, args: eqx.combine(args, rest)(time, y)),
            self.solver,
            start,
            stop,
            jnp.where(step > 0, jnp.minimum(step, interval), 1e-2 * interval),
            state,
            args=arrays,
            stepsize_controller=controller,
            saveat=diffrax.SaveAt(t1=True),
            max_steps=self.most_steps,
            adjoint=diffrax.ForwardMode(),
            throw=False,
        )
        stats, results = solution.stats, diffrax.RESULTS
        failed = jnp.where(solution.result == results.max_steps_reached, TOO_MANY, TOO_SMALL)
        # A remainder of rounding before `stop` is shorter than the smallest step, but it has been taken.
        reached = (solution.result == results.successful) | (solution.ts[-1] >= stop)
        outcome = jnp.where(reached, REACHED, failed)
        accepted = stats["num_accepted_steps"]
        typical = interval / jnp.maximum(accepted, 1)
        return Advance(solution.ys[-1], accepted, stats["num_rejected_steps"], typical, outcome)


# Explicit Runge-Kutta methods in which each stage starts from the slope of the one before: (nodes, weights).
CHAINS: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "euler": ((0.0,), (1.0,)),
    "heun": ((0.0, 1.0), (0.5, 0.5)),
    "rk4": ((0.0, 0.5, 0.5, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)),
}


class FixedStep(AbstractIntegrator):
    """Explicit Runge-Kutta with equal steps: the same cost for every sample, so the choice for batches.

    Steps are shortened a little to meet the saving times. No error control: halve `step` to see the error. Stable for
    step < 2.8 / omega (rk4), omega = sqrt(contact stiffness / mass), of the order of 1e4 rad/s in a steel bearing.
    `steps_per_save` fixes the number of steps between saving times instead: reverse-mode derivatives (`jax.grad`) need
    it, forward-mode ones do not.
    """

    pathwise: ClassVar = True
    step: Scalar = quantity(2e-5, "s", "largest step")
    method: str = eqx.field(static=True, default="rk4")
    steps_per_save: int | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        if self.method not in CHAINS:
            raise ValueError(f"no fixed-step method {self.method!r}; there are {', '.join(CHAINS)}.")
        if self.steps_per_save is not None and not (isinstance(self.steps_per_save, int) and self.steps_per_save > 0):
            raise ValueError(
                f"steps_per_save of integrator.FixedStep is {self.steps_per_save!r}; it must be a positive whole number."
            )
        step = concrete(self.step)
        if step is not None and not step > 0:
            raise ValueError(f"the step of integrator.FixedStep is {step} s; it must be positive.")

    def advance(self, field, start, stop, state, step, weights, running):
        count = jnp.maximum(jnp.ceil((stop - start) / self.step * (1 - 1e-9)), 1.0)
        count = count if self.steps_per_save is None else jnp.asarray(float(self.steps_per_save))
        h = (stop - start) / count
        nodes, weights = (jnp.asarray(part) for part in CHAINS[self.method])
        stages = len(weights)

        # One stage a turn, not one step: the equations stand in the program once, which a compiler can fuse as a whole.
        def one(index, carry):
            y, total, slope = carry
            stage = index % stages
            time = start + (index // stages + nodes[stage]) * h
            slope = field(time, y + (h * nodes[stage]) * slope)
            total = total + (h * weights[stage]) * slope
            return jnp.where(stage == stages - 1, total, y), total, slope

        steps = count.astype(int)
        first = (state, state, jnp.zeros_like(state))
        if self.steps_per_save is None:
            end = jax.lax.fori_loop(0, stages * steps, one, first)[0]
        else:
            turns = jnp.arange(stages * self.steps_per_save)
            end = jax.lax.scan(lambda carry, turn: (one(turn, carry), None), first, turns)[0][0]
        outcome = jnp.where(jnp.all(jnp.isfinite(end)), REACHED, NOT_FINITE)
        return Advance(end, steps, jnp.zeros_like(steps), h, outcome)
