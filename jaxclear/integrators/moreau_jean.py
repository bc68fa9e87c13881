r"""Steps through rigid contact: no stiffness to resolve, impacts in one step, friction that sticks;
and their derivatives through impacts, which steps capture without locating them.

A step in which a contact strikes takes its percussion wherever in the step that falls; the instant
:math:`t^*` at which the gap closes moves with whatever a derivative is by, and the step does not
know it. Its derivative here does: it is taken at times that move with the gap,

.. math:: dt^* = -\frac{d\delta}{\dot\delta}, \qquad
    dy_{k+1} = D\,(dy_k + f^- dt^*) - f^+ dt^*,

with the indentation :math:`\delta` halfway through the step, the derivative :math:`D` of the
discrete step, whose percussions keep their states (open, sticking, sliding), and the rates
:math:`f^-` and :math:`f^+` before and behind it of a motion in which nothing strikes. A step
without an impact has its own derivative.

The motion itself goes the same way: that an impact is taken up to a step late is a difference in
the motion, which grows with every impact. It is carried along, and tells to which share of the gap
places are off, and to which share approach speeds are: as much are derivatives off
(`derivative_error`).

At the end of a run an impact may be due that the run has not taken yet, or have been taken that is
not due yet. Its derivative is then that of another motion, which runs in longer steps may share,
and is not known (`judge_end`).

None of this is in a program of which no derivative is asked. Source: as `saltation`.
"""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array

from jaxclear.formulations.contact_rows import TimeStep
from jaxclear.formulations.loads_over_step import may_strike
from jaxclear.formulations.loop_closing import closed
from jaxclear.formulations.model import Model, State
from jaxclear.formulations.rigid import RigidContact, Strikes
from jaxclear.formulations.unilateral import MoreauJeanSettings
from jaxclear.ground.grouping import packed, unpacked
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.outcome import Unknown
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.ground.tangents import (
    allow_first_derivative,
    apply_if,
    derived,
    moved,
    moving_with,
    pushed,
)
from jaxclear.integrators.base import (
    RIGID,
    AbstractIntegrator,
    Interval,
    divide,
    searching_steps,
    with_step_times,
)
from jaxclear.integrators.derivative_error import IMPACT_FIGURES, NO_SECOND, trusted_impacts
from jaxclear.integrators.saltation import FIRST
from jaxclear.multibody.length_scales import gaps_crossed
from jaxclear.native import one_row

# Contacts that strike in one step do so at once where their instants move alike, to this share.
SIMULTANEOUS = 1e-6
# An instant moves where the gap does by more than rounding beside the state.
ROUNDING = 1e-12


class Moves(NamedTuple):
    """What is carried beside the motion: `figures` of `derivative_error`, and by how much the
    `state` and what a step hands to the next (`last`) are off, which is the same for all
    derivatives of a run. Zeros but for their derivatives."""

    figures: Array
    state: State
    last: Array


def nothing_moved(state: State, last: Array) -> Moves:
    """Before the first step."""
    return Moves(jnp.zeros(IMPACT_FIGURES), jnp.zeros_like(state), jnp.zeros_like(last))


class _Steps(NamedTuple):
    """Functions of (arrays, (time [s], length [s]), state, last): `step`, with a first argument of
    settings; `strikes`; and `rates` of the state where nothing strikes. `model(arrays)`."""

    step: Callable
    strikes: Callable
    rates: Callable
    model: Callable


class _Tangent(NamedTuple):
    """A derivative at the start of a step: of arrays, of time and length, of state and of `last`;
    `late`: by what indentation it is off there all the same."""

    arrays: Any
    clock: Any
    state: Any
    last: Any
    late: Any = 0.0


def through_impacts(step: Callable, formulation: RigidContact, rest: Any) -> Callable:
    """A step with its derivative, as a function of (arrays, clock, state, last, growth).

    `arrays` are those of model and settings, `clock` is time and length [s], `growth` a `Moves`.

    Args:
        step: `step(model, settings, time step, state, last)`: (state, last).
        formulation: of the run.
        rest: what is left of model and settings without their arrays.
    """

    def step_by(how, arrays, clock, y, last):
        model, settings = unpacked(arrays, rest)
        return step(model, settings._replace(**how), TimeStep(*clock), y, last)

    def rates(arrays, clock, y, last):
        return (step_by({"gentle": True}, arrays, clock, y, last)[0] - y) / clock[1]

    strikes = _strikes(formulation, rest)
    steps = _Steps(step_by, strikes, rates, lambda arrays: unpacked(arrays, rest)[0])

    @jax.custom_jvp
    def rule(*numbers):
        *here, growth = numbers
        end, now_end = step_by({}, *here)
        return end, now_end, moving_with(end[0], growth)

    def moving(numbers, tangents):
        *here, growth = numbers
        (end, now_end), d_step, grown = _moved(steps, tuple(here), tangents)
        return (end, now_end, moving_with(end[0], growth)), (*d_step, grown)

    rule.defjvp(moving, symbolic_zeros=True)
    return rule


def _strikes(formulation: RigidContact, rest: Any) -> Callable:
    """`Strikes` as a function of (arrays, clock, state, last), as of `through_impacts`."""

    def strikes(arrays, clock, y, last):
        model, settings = unpacked(arrays, rest)
        return formulation.strikes(model, TimeStep(*clock), y, last, settings)

    return strikes


def _moved(steps: _Steps, here: tuple, tangents: Any) -> tuple[tuple, tuple, Moves]:
    """((state, last) behind a step, their derivatives, what is carried along)."""
    arrays, (time, h), *_ = here
    *d_here, grown = tangents
    strikes = steps.strikes(*here)
    needed = jnp.any(strikes.which)
    figures, off, off_last = map(moved, grown)
    still = jax.tree.map(SymbolicZero.from_primal_value, (arrays, (time, h)))
    d_arr, d_clock = still
    d_in = _Tangent(*d_here), _Tangent(d_arr, d_clock, off, off_last, strikes.depths)

    def before(carry):
        states, _, figures = carry
        flow = steps.rates(*here)
        along = _along(steps, here, flow)
        delays = [_shift(steps, here, d, strikes, along) for d in d_in]
        late = abs(delays[0].shift)
        late = jnp.where(late * delays[0].speed > ROUNDING * jnp.max(abs(states[0])), late, 0.0)
        states = [state + one.shift * flow for state, one in zip(states, delays, strict=True)]
        return tuple(states), tuple(one.shift for one in delays), _grown(figures, late, *delays)

    none = jnp.zeros(())
    carry = (moved(d_in[0].state), off), (none, none), figures
    states, shifts, figures = apply_if(needed, before, carry)
    striking = lambda *numbers: steps.step({"striking": needed}, *numbers)
    pairs = []
    for d, state, shift in zip(d_in, states, shifts, strict=True):
        clock = moved(d.clock[0]) + shift, d.clock[1]
        values, d_end = pushed(striking, here, (d.arrays, clock, state, d.last))
        pairs.append(d_end)
    (end, now_end), (d_end, off) = values, pairs

    def behind(carry):
        (state, off), figures = carry
        flow = steps.rates(arrays, (time + h, h), end, now_end)
        off = off - shifts[1] * flow
        return (state - shifts[0] * flow, off), _placed(figures, steps.model(arrays), off)

    (state, ends), figures = apply_if(needed, behind, ((d_end[0], off[0]), figures))
    return (end, now_end), (state, d_end[1]), Moves(figures, ends, off[1])


def judge_end(
    formulation: RigidContact, rest: Any, now: tuple, growth: Moves, figures: Array
) -> Array:
    """Rows of figures at saving times; the last one's derivative is nan where a strike is
    uncertain.

    That is where a contact in flight overlaps by less than the error of the run.

    Args:
        formulation: of the run.
        rest: what is left of model and settings without their arrays.
        now: arrays, (time, length of a step) [s], state and what the last step hands on.
        growth: how much touches move.
        figures: shape (times, n).
    """

    strikes = _strikes(formulation, rest)

    def evaluate(arrays, clock, y, last, *off):
        def strikes_at(*here):
            strikes_now = strikes(arrays, clock, *here)
            return (strikes_now.depths, strikes_now.rates), strikes_now.flying

        (depths, rates), (deeper, _), flying = jax.jvp(strikes_at, (y, last), off, has_aux=True)
        return jnp.any(flying & (depths - 0.5 * clock[1] * rates + deeper >= 0))

    def judged(numbers, tangents):
        _, growth, d_in = tangents
        unsure, d_in = one_row(evaluate, *numbers[0], *map(moved, growth[1:])), moved(d_in)
        return d_in.at[-1].set(jnp.where(unsure, Unknown.AT_ONCE.number, d_in[-1]))

    return derived(lambda now, growth, figures: figures, judged)(now, growth, figures)


class _Shift(NamedTuple):
    """By how much later (its derivative) what strikes in a step does so, whether all of it does,
    by how much faster [m/s]; and how fast it is [m/s]."""

    shift: Scalar
    same: Any
    faster: Scalar
    speed: Scalar


def _along(steps: _Steps, here: tuple, flow: Any) -> tuple:
    """Rates of indentations and of their rates halfway through a step, where the state at its start
    goes on."""
    arrays, (time, h), y, last = here
    depths = lambda time, y: steps.strikes(arrays, (time, h), y, last)[1:3]
    return jax.jvp(depths, (time, y), (jnp.ones_like(time), flow))[1]


def _shift(steps: _Steps, here: tuple, d: _Tangent, hits: Strikes, along: tuple) -> _Shift:
    depths = lambda *numbers: steps.strikes(*numbers)[1:3]
    deeper, faster = pushed(depths, here, (d.arrays, d.clock, d.state, d.last))[1]
    late = jnp.where(hits.which, -safe_divide(deeper + d.late, along[0]), 0.0)
    shift = jnp.sum(late) / jnp.sum(jnp.where(hits.which, 1.0, 0.0))
    spread = jnp.max(jnp.where(hits.which, abs(late - shift), 0.0))
    both = jnp.stack([abs(faster + shift * along[1]), hits.rates])
    faster, speed = jnp.max(jnp.where(hits.which, both, 0.0), 1)
    return _Shift(shift, spread <= SIMULTANEOUS * abs(shift), faster, speed)


def _grown(figures: Array, late: Scalar, shift: _Shift, error: _Shift) -> Array:
    """The figures before an impact that moves so, and is off by so much."""
    count, first, most, unknown, place, speeds, speed = [figures[i] for i in range(IMPACT_FIGURES)]
    count = count + jnp.where(late > 0, 1.0, 0.0)
    first = jnp.where(count <= FIRST, jnp.maximum(first, late), first)
    unknown = jnp.where(shift.same, unknown, 1.0)
    most = jnp.maximum(most, late)
    speed = jnp.maximum(speed, error.speed)
    return jnp.stack([count, first, most, unknown, place, speeds + error.faster / speed, speed])


def _placed(figures: Array, model: Model, off: Any) -> Array:
    """The figures behind an impact, where the state is off by so much."""
    return figures.at[4].set(jnp.maximum(figures[4], gaps_crossed(model.system, off)))


# Residual of the contact laws, relative to the largest velocity, beyond which they are not met.
LOOSE = 0.1


class MoreauJean(AbstractIntegrator):
    """Event-capturing steps with unilateral contact and set-valued Coulomb friction: no stiffness,
    and joints truly stick.

    Clearance joints are the same as for compliant contact, one word changed; of a contact law only
    its coefficient of restitution is taken (`contact.Rigid` has nothing else), and where surfaces
    wear how wide it lets the mean force of a step press, of a regularised friction law its
    coefficients; a run says how much of friction's loss changes by that (`Check.COULOMB_FRICTION`).

    Newton's law of impact applies to a contact whose gap closes within a share `gamma` of a step;
    impacts are not located, so their instants have an error of a step, and order is 1. Of contacts
    of one joint that strike within a step the first to touch does, the others in the next ones:
    struck at once they would share an impact that they do not. Loads are taken at the middle
    (explicitly): step < 2 / omega of springs.

    Steps must be short: no body may cross its clearance within one (step^2 x acceleration <
    clearance, for light bodies above all), and with a restitution near 1 turning bodies gain energy
    unless step x spin is well below 1 - restitution.

    Stops (`load.JointStop`) and flanks of play (`clearance.Backlash`) that have a restitution are
    rigid, stops that steps do not follow too; dry friction (`load.JointFriction`) sticks. Ideal
    joints that rub do so by the reaction of the same step, an impact's impulse included, and stick
    as contacts do; of their friction laws too the coefficients are taken. Forces are impulses:
    `Trajectory.contact` gives the means over each saving interval.

    First derivatives through contacts are those of the motion, as far as the steps resolve it
    (`through_impacts`): they are off by as much as places are relative to the gap, nan where
    impacts have made that grow to a hundredth, where those in other steps show that they are off by
    more, where contacts strike in one step that would not move alike, or where a run ends before it
    takes an impact that is due: they want steps of a microsecond. Not where surfaces wear:
    `jaxclear.sensitivity` is the way there.

    Args:
        step: largest step [s], > 0.
        theta: weight of a step's end in its mean speed [1], >= 0 and <= 1; 1/2 conserves the energy
            of smooth motion.
        gamma: share of a step within which a gap must close to count as closed [1], >= 0.
        max_sweeps: largest number of sweeps over the contacts, or steps of Newton's method for all,
            in a step [1], >= 1; where they end before `tolerance` a run says by how much the laws
            are missed (`Check.LAW_RESIDUAL`), and ends where that is far.
        tolerance: residual of the contact laws relative to the largest velocity at which sweeps end
            [1], > 0.
        project: whether to move apart what overlaps by more than it would part or fall in a step,
            so that a contact that strikes overlaps by at most a step of its speed, one at rest by a
            step's fall; without it, as in the scheme's sources, resting contacts creep inwards.

    Source: Moreau 1988, in Nonsmooth Mechanics and Applications, 1; Jean 1999, Comput. Methods
    Appl. Mech. Eng. 177, 235.
    """

    pathwise: ClassVar = False
    projects: ClassVar = True
    promise: ClassVar = RIGID
    through_contacts: ClassVar = True
    first_order_slopes: ClassVar = True
    opens_loops: ClassVar = True
    step: Scalar = quantity(1e-4, "s", above=0)
    theta: Scalar = quantity(0.5, "1", at_least=0, at_most=1, kw_only=True)
    gamma: Scalar = quantity(0.5, "1", at_least=0, kw_only=True)
    max_sweeps: Scalar = quantity(200.0, "1", at_least=1, kw_only=True)
    tolerance: Scalar = quantity(1e-12, "1", above=0, kw_only=True)
    project: bool = eqx.field(static=True, default=True, kw_only=True)

    def with_finer_steps(self, share):
        return with_step_times(self, share)

    @property
    def formulation(self):
        return RigidContact()

    def requested_step(self):
        return self.step

    def beyond_touches(self, mechanism):
        joints = [mechanism.connections[name].joint for name in mechanism.topology.clearances]
        worn = any(joint.maps() for joint in joints)
        return "how surfaces that wear move with impacts" if worn else ""

    def beyond_flanks(self, mechanism):
        plays = (c.play for c in mechanism.couplings.values() if c.play is not None)
        rigid = all(play.restitution is not None for play in plays)
        return "" if rigid else "how the instants move at which flanks meet that are not rigid"

    def first_warm_start(self, model, start, state):
        warm_start = self.formulation.warm_start(model)
        moves = nothing_moved(state, warm_start) if may_strike(model.system) else None
        return warm_start, moves

    def law_residual(self, model, warm_start):
        return warm_start[0][-1] if self.formulation.impulses(model.system) else None

    @property
    def _settings(self):
        return MoreauJeanSettings(
            self.theta, self.gamma, self.max_sweeps, self.tolerance, self.project
        )

    def check_derivatives(self, model, times, states, end, warm_start):
        if not may_strike(model.system):
            return states
        last, moves = warm_start
        _, h = divide(Interval(times[-2], times[-1], end, True), self.step)
        arrays, rest = packed((model, self._settings))
        now = arrays, (times[-1], h), end, last
        return judge_end(self.formulation, rest, now, moves, states)

    def advance(self, model, interval, state, warm_start):
        settings = self._settings

        def step(model, settings, time_step, state, last):
            end, last = self.formulation.step(model, time_step, state, last, settings)
            return closed(model, time_step.end, end, time_step.length), last

        arrays, rest = packed((model, settings))
        step_fn = through_impacts(step, self.formulation, rest)

        def followed(time_step, state, last):
            last, moves = last
            if moves is None:
                end, last = step(model, settings, time_step, state, last)
            else:
                end, last, moves = step_fn(arrays, tuple(time_step), state, last, moves)
            return end, (last, moves)

        answer = searching_steps(model, interval, self.step, followed, (state, warm_start), LOOSE)
        if not may_strike(model.system):
            return answer
        state = trusted_impacts(answer.state, answer.warm_start[1].figures)
        return answer._replace(state=allow_first_derivative(NO_SECOND, state))
