r"""Laws over a step: what acts along rows as a function of their mean rates, where a step sets out
from, and what laws remember behind it.

Forces along an element's rows are functions of the rows' mean rates over the step, $p = p_0 - D
(\dot r - \dot r_0)$ about given rates $\dot r_0$ (`linear`). A normal force, or a spring's, is the
mean of the law over the way that is gone, so that it does the work of the law (a discrete
gradient): Gonzalez 1996, J. Nonlinear Sci. 6, 449, doi:10.1007/BF02440162; for contact Laursen &
Chawla 1997, Int. J. Numer. Methods Eng. 40, 863.

A law over a step has for each of its rows `reaches` (changes of the mean rate by an acceleration
that the rows add, and by one without them [s]), says with `outset` from which rates and forces an
iteration sets out, and is `linear` about rates.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.components.clearance import ContactLaws
from jaxclear.formulations.contact_rows import FreeMotion
from jaxclear.formulations.delassus import LinearLaws
from jaxclear.formulations.impact_speed import taken_in_flight
from jaxclear.formulations.model import Model
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part, safe_divide, safe_sqrt
from jaxclear.laws.friction.base import Unhindered
from jaxclear.multibody import transmissions
from jaxclear.multibody.contact_point import PointState, slip_speed
from jaxclear.multibody.rows import LinearRate
from jaxclear.multibody.transmissions import Compliance, CouplingTwist

# Added to the inverse of an effective mass [1/kg], so that a contact which nothing can move has
# one.
LEAST_LIGHTNESS = 1e-12


class Averaging(NamedTuple):
    """How forces are averaged over a step: its length [s], and its bias: 0 averages contact forces
    over the step, 1 takes them at its end (in between the theta method's 2 theta - 1).
    """

    length: Any
    bias: Any

    @property
    def reaches(self) -> tuple[Any, Any]:
        """Change of a mean rate by an acceleration that contact adds, and by one without contact
        [s]."""
        return 0.5 * (1 + self.bias) * self.length, 0.5 * self.length

    def taken_after(self, braked: Any) -> Any:
        """The share of a step after which friction is taken that would brake, at its steepest, so
        much of a slip in it [1]."""
        return jnp.maximum(0.5 * (1 + self.bias), 1 - 1 / jnp.maximum(braked, 1.0))


class RowAtStart(NamedTuple):
    """A row as a step begins: its rate [m/s], the accelerations [m/s^2] along it without contact
    and by what contact added in the step before, and about the inverse of the mass that it moves
    [1/kg]."""

    rate: Any
    free: Any
    last: Any
    lightness: Any


def mean_rates(rows: list[RowAtStart], reaches: tuple) -> tuple[tuple, tuple]:
    """Mean rates of rows over a step without contact, and with what contact added in the step
    before."""
    unmoved: tuple = ()
    carried_on: tuple = ()
    for row, (reach, time) in zip(rows, reaches, strict=True):
        unmoved = (*unmoved, sp.add(row.rate, sp.mul(time, row.free)))
        carried_on = (*carried_on, sp.add(unmoved[-1], sp.mul(reach, row.last)))
    return unmoved, carried_on


class Outset(NamedTuple):
    """Of the rows of a law: mean rates without contact, those from which an iteration sets out, and
    the forces that belong to these."""

    unmoved: tuple
    rates: tuple
    forces: tuple


class Braking(NamedTuple):
    """When a contact's friction is taken: after the share `theta` [1] of the step, `reach` [s]
    after its start; and the slip that a unit of friction takes away by then (`yielding`
    [m/(N s)])."""

    theta: Any
    reach: Any
    yielding: Any


class SlipAtStart(NamedTuple):
    """Slip [m/s] in one sliding direction as a step begins: along the direction in the middle of
    the step (`along`), along the direction at the start (`current`), and by how much more the slip
    at the end of the step will be along the direction there than along the one in the middle
    (`turn`); `traction` [N]: that of the step before."""

    along: Any
    current: Any
    turn: Any
    traction: Any


class PastSlip(NamedTuple):
    """What a step hands on of one sliding direction: friction [N], and the slip at its end along
    the direction in its middle (`along`) and along the one at its end (`current`)."""

    traction: Any
    along: Any
    current: Any


class ContactOverStep(NamedTuple):
    """The laws of a contact over a step: its indentation [m] and the rate of that [m/s] as the step
    begins, the mass that it stops [kg], what its laws remember, when its friction is taken (None:
    nothing rubs), how it slides."""

    averaging: Averaging
    laws: ContactLaws
    depth: Any
    approach: Any
    mass: Any
    memory: PointState
    braking: Braking | None
    slips: tuple[SlipAtStart, ...]

    @property
    def reaches(self) -> tuple:
        across = () if self.braking is None else ((self.braking.reach,) * 2,) * len(self.slips)
        return (self.averaging.reaches, *across)

    def outset(self, unmoved: tuple, carried_on: tuple) -> Outset:
        """A contact that is closed at the start sets out from the forces of the step before, one
        that is open from where an impact would end."""
        closed, length, normal = self.depth > 0, self.averaging.length, unmoved[0]
        struck = (self._deepest(self.depth + length * normal) - self.depth) / length
        result: list[tuple] = [(normal, jnp.where(closed, carried_on[0], struck), 0.0)]
        for slip, rate in zip(self.slips, unmoved[1:], strict=True):
            rate = rate + self._turned(slip)
            traction = jnp.where(closed, slip.traction, 0.0)
            result.append((rate, jnp.where(closed, slip.current, rate), traction))
        return Outset(*zip(*result, strict=True))

    def _deepest(self, free: Any) -> Any:
        """About the indentation at which the mass comes to rest, if less than the `free` one to
        which it would go unhindered: where Newton's iteration does well to set out."""
        work = self.laws.contact.elastic_force(free) * positive_part(free)
        # Hertz: m v^2 / 2 = F(d) d / (5/2), so d / free = (5/4 m v^2 / work)^(2/5); by square
        # roots, to the power 3/8.
        energy = 5 / 4 * self.mass * positive_part(self.approach) ** 2
        quarter = safe_sqrt(safe_sqrt(safe_divide(energy, work)))
        return jnp.where(work > 0, free * jnp.minimum(quarter * safe_sqrt(quarter), 1.0), free)

    def _turned(self, slip: SlipAtStart) -> Any:
        """What a slip gains as its direction turns until friction is taken."""
        assert self.braking is not None
        return (2 * self.braking.theta - 1) * slip.turn

    def mean_force(self, rate: Any) -> Any:
        """Normal force that does over the step the work of the law along the way.

        The mean of the law over the indentations passed through, by Radau's rule (right end and a
        third before the left), times the share of the way in contact; moved towards the force at
        the end by the bias, which can only take energy out.
        """
        length, bias = self.averaging
        end = self.depth + length * rate
        low, high = positive_part(self.depth), positive_part(end)
        inside = (self.depth > 0) & (end > 0)
        share = jnp.where(inside, 1.0, safe_divide(high - low, end - self.depth))
        early, late = (
            self.laws.contact.normal_force(d, rate, self.memory.impact_speed)
            for d in (low + (high - low) / 3, high)
        )
        return share * (late + 3 / 4 * (1 - bias) * (early - late))

    def linear(self, rates: tuple, forces: tuple) -> LinearLaws:
        """The normal force is linear in its own row (Newton); what friction is, its law says."""
        normal, slope = jax.value_and_grad(self.mean_force)(jnp.asarray(rates[0], float))
        rubbing, resisting, slip = [], [], rates[1:]
        if self.braking is not None:
            yielding = self.braking.yielding
            free = tuple(s - yielding * force for s, force in zip(slip, forces[1:], strict=True))
            unhindered = Unhindered(slip_speed(free), yielding)
            known = self.memory.bristles, slip, slip_speed(slip), unhindered
            rubbing, resisting = self.laws.friction.linearised(normal, *known, *self.averaging)
        return LinearLaws([-normal, *rubbing], [positive_part(slope), *resisting], rates)

    def depth_worked_for(self, rate: Any, force: Any) -> Any:
        """Indentation at the end of the step: where the rate leads, but no deeper than the force
        has worked for. (An unfinished iteration ends with less than the law's force at the depth it
        reaches.)"""
        share = jnp.clip(safe_divide(-force, self.mean_force(rate)), 0.0, 1.0)
        low, end = positive_part(self.depth), self.depth + self.averaging.length * rate
        return jnp.where(end > low, low + share * (end - low), end)

    def slips_at_end(self, rates: tuple) -> tuple:
        """Slip at the end of the step along the directions in its middle."""
        if self.braking is None:
            return ()
        lengthened = 1 / self.braking.theta
        return tuple(
            s.along + lengthened * (slip - s.along - self._turned(s))
            for s, slip in zip(self.slips, rates[1:], strict=True)
        )

    def memory_after(self, rates: tuple, normal: Any) -> PointState:
        """What is remembered at the end of the step; bristles of an open contact straighten."""
        if not self.memory.bristles:
            return self.memory
        slip, law = rates[1:], self.laws.friction
        known = normal, self.memory.bristles, slip, slip_speed(slip)
        return self.memory._replace(bristles=law.bristles_after(*known, *self.averaging))


def contact_at_start(
    averaging: Averaging,
    laws: ContactLaws,
    indentation: Any,
    rows: list[RowAtStart],
    depth: Any,
    memory: PointState,
    past: tuple[PastSlip, ...],
) -> tuple[tuple, Outset]:
    """The laws of a contact as a step begins, and where its iteration sets out.

    From the middle of the last step to that of this one a sliding direction has turned; until the
    end of this one it turns half as far again.

    Args:
        averaging: length of the step and bias.
        laws: of the contact.
        indentation: in the middle to which the speeds at the start lead [m].
        rows: of the contact: the normal one, then the sliding directions.
        depth: indentation at the start [m].
        memory: impact speed and bristles.
        past: slip that the step before handed on, for each sliding direction.
    """
    (normal, *across), length = rows, averaging.length
    if memory.impact_speed is not None:
        flight = depth, indentation, normal.rate, 0.5 * length * normal.free
        memory = memory._replace(impact_speed=taken_in_flight(memory.impact_speed, flight, length))
    braking, slips = None, []
    if across:
        lightness = sp.total(row.lightness for row in across) / len(across)
        strength = laws.contact.elastic_force(depth + length * positive_part(normal.rate))
        strength = strength * laws.friction.largest_slope(length)
        theta = averaging.taken_after(length * lightness * strength)
        braking = Braking(theta, theta * length, theta * length * lightness)
    for row, last in zip(across, past, strict=True):
        turn = jnp.where(depth > 0, 0.5 * sp.sub(row.rate, last.along), 0.0)
        current = jnp.where(depth > 0, last.current, row.rate)
        slips.append(SlipAtStart(row.rate, current, turn, last.traction))
    mass = 1.0 / (normal.lightness + LEAST_LIGHTNESS)
    values = depth, normal.rate, mass, memory, braking, tuple(slips)
    law = ContactOverStep(averaging, laws, *values)
    return values, law.outset(*mean_rates(rows, law.reaches))


class SpringOverStep(NamedTuple):
    """A coupling with stiffness over a step of a `length` [s]: what lies between its sides, its
    twist as the step begins, and where a shaft's far end is (None: it has none). What acts is the
    mean over the step: springs give back what they have taken."""

    rates: tuple[LinearRate]
    reaches: tuple
    compliance: Compliance
    twist: Any
    end: Any
    length: Any

    def outset(self, unmoved: tuple, carried_on: tuple) -> Outset:
        """From the forces of the step before."""
        return Outset(unmoved, carried_on, (0.0,))

    def linear(self, rates: tuple, forces: tuple) -> LinearLaws:
        """The torque about a mean rate."""
        torque = lambda rate: transmissions.mean_torque(
            self.compliance, CouplingTwist(self.twist, rate), self.end, self.length
        )
        value, slope = jax.value_and_grad(torque)(jnp.asarray(rates[0], float))
        return LinearLaws([-value], [jnp.maximum(slope, 0.0)], rates)


def springs_over_step(
    model: Model, free_motion: FreeMotion, back: list, averaging: Averaging
) -> tuple[tuple[SpringOverStep, ...], FreeMotion]:
    """Couplings with stiffness over a step, and the free motion without them.

    Args:
        model: of the run.
        free_motion: equations of motion in the middle of the step.
        back: change from the speeds in its middle to those at its start.
        averaging: length of the step and bias.
    """
    system, forces = model.system, free_motion.forces
    result, right = [], list(free_motion.right)
    for name, train in system.transmissions.items():
        pressing = forces.pressing[name]
        states = forces.followed.states.get(name)
        end = states[0] if train.has_twist and states is not None else None
        row = transmissions.twist_direction(forces.motions, train).jacobian(system, forces.motions)
        rate = LinearRate(pressing.twist.rate, {j: x / train.scale for j, x in row.items()})
        start = pressing.twist.value - 0.5 * averaging.length * rate.at(back)
        places = transmissions.compliance_of(train), start, end, averaging.length
        result.append(SpringOverStep((rate,), (averaging.reaches,), *places))
        # The torque at the predicted place, which the equations of motion know.
        for j, entry in rate.row.items():
            right[j] = sp.add(right[j], sp.mul(pressing.torque, entry))
    return tuple(result), free_motion._replace(right=tuple(right))
