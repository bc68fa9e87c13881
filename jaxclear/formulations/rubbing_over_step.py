r"""Friction and wear of ideal joints over an implicit step: friction is a share of the reaction,
the share that of the sliding speed when friction is taken, the reaction that of the step before.

Along each sliding direction $T = -d\,s$ with $d = \mu(|s|) N / |s|$, taken about the speed found
last and solved for together with the contacts; friction that brakes a joint within a step is taken
as late as `laws_over_step` says. Reactions change from step to step by what forces do, so friction
is right to the first order of the step.

Nothing here is evaluated in a mechanism without such joints.
"""

from typing import Any, NamedTuple

from jaxclear.complementarity.joint_friction import across
from jaxclear.components.clearance import carried_load
from jaxclear.formulations.contact_rows import MiddleOfStep, lightness
from jaxclear.formulations.delassus import LinearLaws
from jaxclear.formulations.joint_friction import passive_of
from jaxclear.formulations.laws_over_step import Averaging, Outset
from jaxclear.formulations.model import Model
from jaxclear.formulations.permanent_reactions import (
    PermanentJoint,
    Reaction,
    answer_to,
    sliding_rates,
    touching,
    with_friction,
)
from jaxclear.formulations.state_rate import Passive
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import rounded_norm, safe_divide
from jaxclear.multibody.contact_point import SLIP_ROUNDING
from jaxclear.multibody.dynamics import Solution
from jaxclear.multibody.forces import Forces
from jaxclear.multibody.rows import LinearRate, combine_rates
from jaxclear.multibody.state import unpack_motion


class JointOverStep(NamedTuple):
    """A joint that touches all the time over a step: how it slides (`slips` by component), the
    directions among these components in which friction moves it, the `rates` along these, what it
    carried last [N], and after how much of the step its friction is taken [s], whatever moves it
    (`reaches`)."""

    pair: PermanentJoint
    slips: tuple[LinearRate, ...]
    directions: tuple[tuple, ...]
    rates: tuple[LinearRate, ...]
    load: Any
    reaches: tuple

    def outset(self, unmoved: tuple, carried_on: tuple) -> Outset:
        """From the forces of the step before."""
        return Outset(unmoved, carried_on, (0.0,) * len(unmoved))

    def linear(self, rates: tuple, forces: tuple) -> LinearLaws:
        """Its friction about the speeds along its rows: a damper."""
        none = [0.0] * len(rates)
        return LinearLaws(none, [self.resistance(rates)] * len(rates) if rates else none, none)

    def resistance(self, rates: Any) -> Any:
        """Friction over the sliding speed [N s/m]."""
        size, joint = rounded_norm(*rates, width=SLIP_ROUNDING), self.pair.joint
        return joint.friction_ratio(joint.friction.coefficient(size)) / size * self.load

    def friction(self, forces: tuple, change: list) -> list:
        """Friction [N] of every component, from the forces along the rows; where a drive has the
        say that of the mean speeds, a `change` from those in the middle."""
        if self.directions:
            return [sp.dot(forces, parts) for parts in zip(*self.directions, strict=True)]
        if self.pair.joint.friction is None:
            return [0.0 * self.load] * self.pair.joint.components
        slid = [slip.at(change) for slip in self.slips]
        resistance = self.resistance(slid)
        return [-resistance * x for x in slid]


def joints_over_step(
    model: Model, middle: MiddleOfStep, reactions: tuple[Reaction, ...], averaging: Averaging
) -> tuple[JointOverStep, ...]:
    """Ideal joints that rub, as a step begins.

    Args:
        model: of the run.
        middle: of the step.
        reactions: of these joints in the step before.
        averaging: length of the step and bias.
    """
    diagonal = middle.free_motion.diagonal
    system, motions = model.system, middle.free_motion.forces.motions
    result = []
    for fixed, reaction in zip(touching(system), reactions, strict=True):
        slips, directions = sliding_rates(system, motions, fixed), _directions(fixed, reaction)
        rates = tuple(combine_rates(direction, slips) for direction in directions)
        ratio = 0.0 if fixed.joint.components == 1 else (0.0,) * fixed.joint.components
        load = carried_load(fixed.joint.carrying_ends(*reaction, ratio))
        reaches: tuple = ()
        if rates:
            mean = sp.total(lightness(rate.row, diagonal) for rate in rates) / len(rates)
            braked = averaging.length * mean * load
            braked = braked * fixed.joint.friction.largest_slope(averaging.length)
            reaches = ((averaging.length * averaging.taken_after(braked),) * 2,) * len(rates)
        result.append(JointOverStep(fixed, slips, directions, rates, load, reaches))
    return tuple(result)


def _directions(joint: PermanentJoint, reaction: Reaction) -> tuple[tuple, ...]:
    """Directions among the components of a joint's sliding speed in which friction moves it: of a
    ball two across the force; none where nothing rubs, or a drive has the say."""
    if joint.joint.friction is None or joint.driven:
        return ()
    if joint.joint.components == 1:
        return ((1,),)
    size = sp.norm(reaction.force)
    return across(tuple(safe_divide(x, size) for x in reaction.force))


def rubbed(
    model: Model,
    joints: tuple[JointOverStep, ...],
    forces: Forces,
    middle: MiddleOfStep,
    total: Solution,
    rubs: list,
    change: list,
) -> tuple[Passive, tuple[Reaction, ...], Forces]:
    """What joints that rub do in a step.

    Args:
        model: of the run.
        joints: over the step.
        forces: of contacts and loads.
        middle: of the step.
        total: accelerations and multipliers of the step.
        rubs: friction of every component [N].
        change: from the speeds in the middle to the mean ones.

    Returns:
        Wear and losses, the joints' reactions, and the forces with their friction.
    """
    system = model.system
    fixed = touching(system)
    q = unpack_motion(system, [*middle.halfway, *middle.predicted])[0]
    forces = with_friction(system, forces, sp.stack(rubs))
    answer = answer_to(system, forces, q, fixed, total)
    slips = [slip.at(change) for joint in joints for slip in joint.slips]
    passive = passive_of(model, forces, q, answer, rubs, slips)
    return passive, answer.reactions, forces
