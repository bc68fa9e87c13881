"""Steps of mechanisms whose clearance joints always touch: the cheapest rung, without impacts, with
friction that sticks.
"""

from typing import ClassVar

import equinox as eqx

from jaxclear.formulations.joint_friction import NonCollidingSettings
from jaxclear.formulations.loop_closing import closed
from jaxclear.formulations.permanent import PermanentContact
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.integrators.base import (
    PERMANENT,
    AbstractIntegrator,
    searching_steps,
    with_step_times,
)

# Last change of friction in a search, relative to its bound, beyond which it may be far from the
# solution.
LOOSE = 1e-6


class NonColliding(AbstractIntegrator):
    """Joints with a small clearance taken as always in contact: motion of the ideal mechanism,
    reactions carried in the gap, set-valued Coulomb friction that truly sticks. No impacts, no
    stiffness, so steps follow the motion alone.

    Use where joints stay pressed (slow or well-loaded mechanisms); where a reaction passes through
    zero a real journal would cross its gap and strike, which `Trajectory.switchings` reports and
    compliant integrators show. Clearance joints are the same as there, one word changed; a
    regularised friction law gives its coefficients, and a run says how much of the loss changes by
    that (`Check.COULOMB_FRICTION`). Collars carry, and neither rub nor wear (`Check.COLLAR_FORCE`).
    What no motion of a loop changes, such as forces along parallel axes, its closing joint does not
    carry (`Check.INDETERMINATE_FORCE`), and parts follow their forces in their gaps at once
    (`Check.GAP_MOTION`). Midpoint rule, order 2 in smooth motion and 1 across stick and slip;
    coordinates on groups move by exponentials. Steps should end where loads jump.

    A journal on a film moves as the reaction drives it (Booker's mobility method): its joint rubs
    by the film alone, whose couple is that of the force of the step before.

    A stop (`load.JointStop`) is rigid, and gives its restitution back within a step; dry friction
    (`load.JointFriction`) sticks; the play of couplings is seated (`clearance.Backlash`). Joints of
    a closed loop that stick together share what holds it in no unique way.

    Args:
        step: largest step [s], > 0.
        max_sweeps: largest number of sweeps over the joints in a step [1], >= 1; where they end
            far from the laws (a guide about to lock itself), the run ends and says so.
        tolerance: change of a joint's friction relative to its bound at which sweeps end [1], > 0.
        relaxation: share of the bound over which Coulomb's law is rounded [1], > 0, by the
            relaxation of interior points (products of slacks and slips are not 0): a joint then
            creeps, and the error is of its order; None: the complementarity problem itself.
        regularised: whether to take a friction law as the function of the sliding speed that it is,
            for comparison: the joint creeps, and steps must be short compared with the time in
            which friction stops a joint that slides at the law's transition speed.

    Source: antenna paper (000) and guide paper (004); films: Booker 1965, J. Basic Eng. 87, 168.
    """

    pathwise: ClassVar = True
    projects: ClassVar = True
    promise: ClassVar = PERMANENT
    first_order_slopes: ClassVar = True
    opens_loops: ClassVar = True
    step: Scalar = quantity(1e-3, "s", above=0)
    max_sweeps: Scalar = quantity(20_000.0, "1", at_least=1, kw_only=True)
    tolerance: Scalar = quantity(1e-13, "1", above=0, kw_only=True)
    relaxation: Scalar | None = quantity(None, "1", above=0, kw_only=True)
    regularised: bool = eqx.field(static=True, default=False, kw_only=True)

    def with_finer_steps(self, share):
        return with_step_times(self, share)

    @property
    def formulation(self):
        return PermanentContact(self.regularised)

    def requested_step(self):
        return self.step

    def beyond_flanks(self, mechanism):
        # The motion is the ideal one; play is added to it.
        return ""

    def first_warm_start(self, model, start, state):
        return self.formulation.warm_start(model)

    def law_residual(self, model, warm_start):
        return warm_start[-1] if self.formulation.impulses(model.system) else None

    def advance(self, model, interval, state, warm_start):
        settings = NonCollidingSettings(self.max_sweeps, self.tolerance, self.relaxation)

        def step(time_step, state, last):
            end, last = self.formulation.step(model, time_step, state, last, settings)
            return closed(model, time_step.end, end, time_step.length), last

        return searching_steps(model, interval, self.step, step, (state, warm_start), LOOSE)
