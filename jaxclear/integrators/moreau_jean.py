"""Steps through rigid contact: no stiffness to resolve, impacts in one step, friction that
sticks."""

from typing import ClassVar

import equinox as eqx

from jaxclear.formulations.closing import closed
from jaxclear.formulations.rigid import RigidContact
from jaxclear.formulations.unilateral import MoreauJeanSettings
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.ground.tangents import derived_once
from jaxclear.integrators.base import AbstractIntegrator, Interval
from jaxclear.integrators.mid_impact import known_at_end, nothing_moved, through_impacts
from jaxclear.integrators.promise import RIGID
from jaxclear.integrators.stepping import divide, searching_steps
from jaxclear.integrators.trust import NO_SECOND, trusted_impacts
from jaxclear.multibody.topology import rubbing_in

# Residual of the contact laws, relative to the largest velocity, beyond which they are not met.
LOOSE = 0.1


class MoreauJean(AbstractIntegrator):
    """Event-capturing steps with unilateral contact and set-valued Coulomb friction: no stiffness,
    and joints truly stick.

    Clearance joints are the same as for compliant contact, one word changed; of a contact law only
    its coefficient of restitution is taken (`contact.Rigid` has nothing else), and where surfaces
    wear how wide it lets the mean force of a step press, of a regularised friction law its
    coefficients; a run says how much of friction's loss is another by that
    (`Check.COULOMB_FRICTION`).

    Newton's law of impact applies to a contact whose gap closes within `gamma` of a step; impacts
    are not located, so their instants have an error of a step, and order is 1. Of contacts of one
    joint that strike within a step the first to touch does, the others in the next ones: struck at
    once they would share an impact that they do not.

    Mean speeds weigh the end of the step by `theta`; 1/2 conserves the energy of smooth motion.
    Loads are taken at the middle (explicitly): step < 2 / omega of springs. `project` moves apart
    what overlaps by more than it would part or fall in a step, so a contact that strikes overlaps
    by at most a step of its speed, one at rest by a step's fall; without it, as in the scheme's
    sources, resting contacts creep inwards.

    Steps must be short: no body may cross its clearance within one (step^2 x acceleration <
    clearance, for light bodies above all), and with a restitution near 1 turning bodies gain energy
    unless step x spin is well below 1 - restitution.

    Ideal joints that rub do so by the reaction of the same step, an impact's impulse included, and
    stick as contacts do; of their friction laws too the coefficients are taken.

    Forces are impulses: `Trajectory.contact` gives the means over each saving interval.
    `most_sweeps` over the contacts at most, until the laws hold to `tolerance` of the largest
    velocity; where they end far from that, the run ends and says so.

    First derivatives through contacts are those of the motion, as far as the steps resolve it
    (`mid_impact`): they are off by as much as places are beside the gap, nan where impacts have
    made that grow to a hundredth, where those in other steps tell that they are off by more of
    themselves, where contacts strike in one step that would not move alike, or where a run ends
    before it takes an impact that is due: they want steps of a microsecond.
    Not where surfaces wear, nor where ideal joints rub beside contacts: `jaxclear.sensitivity` is
    the way there.

    Source: Moreau 1988, in Nonsmooth Mechanics and Applications, 1; Jean 1999, Comput. Methods
    Appl. Mech. Eng. 177, 235.
    """

    pathwise: ClassVar = False
    projects: ClassVar = True
    step: Scalar = quantity(1e-4, "s", "largest step", above=0)
    theta: Scalar = quantity(
        0.5, "1", "weight of a step's end in its mean speed", at_least=0, at_most=1, kw_only=True
    )
    gamma: Scalar = quantity(
        0.5,
        "1",
        "share of a step within which a gap must close to count as closed",
        at_least=0,
        kw_only=True,
    )
    most_sweeps: Scalar = quantity(
        200.0, "1", "most sweeps over the contacts in a step", at_least=1, kw_only=True
    )
    tolerance: Scalar = quantity(
        1e-12,
        "1",
        "residual of the contact laws, relative to the largest velocity",
        above=0,
        kw_only=True,
    )
    project: bool = eqx.field(static=True, default=True, kw_only=True)

    @property
    def promise(self):
        return RIGID

    def with_finer_steps(self, share):
        return eqx.tree_at(lambda own: own.step, self, share * self.step)

    @property
    def opens_loops(self):
        return True

    @property
    def formulation(self):
        return RigidContact()

    def asked_step(self):
        return self.step

    @property
    def through_contacts(self):
        return True

    @property
    def first_order_slopes(self):
        return True

    def beyond_touches(self, mechanism):
        joints = [mechanism.connections[name].joint for name in mechanism.topology.clearances]
        if any(joint.maps() for joint in joints):
            return "how surfaces that wear move with impacts"
        if rubbing_in(mechanism.connections):
            return "how friction in ideal joints moves with impacts"
        return ""

    def first_warm_start(self, model, start, state):
        warm_start = self.formulation.warm_start(model)
        moves = nothing_moved(state, warm_start) if model.system.bearings else None
        return warm_start, moves

    @property
    def _settings(self):
        return MoreauJeanSettings(
            self.theta, self.gamma, self.most_sweeps, self.tolerance, self.project
        )

    def known_states(self, model, times, states, end, warm_start):
        if not model.system.bearings:
            return states
        last, moves = warm_start
        _, h = divide(Interval(times[-2], times[-1], end, True), self.step)
        arrays, rest = eqx.partition((model, self._settings), eqx.is_array)
        now = arrays, (times[-1], h), end, last
        return known_at_end(self.formulation, rest, now, moves, states)

    def advance(self, model, interval, state, warm_start):
        settings = self._settings

        def step(model, settings, time_step, state, last):
            end, last = self.formulation.step(model, time_step, state, last, settings)
            return closed(model, time_step.end, end, time_step.length), last

        arrays, rest = eqx.partition((model, settings), eqx.is_array)
        known = through_impacts(step, self.formulation, rest)

        def followed(time_step, state, last):
            last, moves = last
            if moves is None:
                end, last = step(model, settings, time_step, state, last)
            else:
                end, last, moves = known(arrays, tuple(time_step), state, last, moves)
            return end, (last, moves)

        found = searching_steps(interval, self.step, followed, (state, warm_start), LOOSE)
        if not model.system.bearings:
            return found
        state = trusted_impacts(found.state, found.warm_start[1].figures)
        return found._replace(state=derived_once(NO_SECOND, state))
