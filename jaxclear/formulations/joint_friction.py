"""Friction and wear of ideal joints where forces follow from the state: friction is a share of the
reaction, and changes it, so both are sought together at every evaluation.

Nothing here is evaluated in a mechanism without such joints.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxclear.complementarity import BoxedGaussSeidel, JointFriction
from jaxclear.complementarity.joint_friction import Caught, Interval, OfReaction, Opposed
from jaxclear.formulations.base import ContactReport
from jaxclear.formulations.loads_over_step import LoadsInStep
from jaxclear.formulations.model import Instant, Model
from jaxclear.formulations.permanent_reactions import (
    Answer,
    FrictionResponse,
    PermanentJoint,
    friction_response,
    joint_part,
    placed,
    sliding_speeds,
    touching,
    with_friction,
)
from jaxclear.formulations.permanent_report import pressing, report
from jaxclear.formulations.permanent_wear import ends_that_wear, wear_rates
from jaxclear.formulations.state_rate import Passive, link_accelerations
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part
from jaxclear.multibody import dynamics
from jaxclear.multibody.dynamics import Solution
from jaxclear.multibody.forces import Forces
from jaxclear.multibody.kinematics import along
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.topology import rubbing_in

# Friction that accelerates a joint by less than this share of what it gives the mechanism's whole
# mass does not move it.
UNMOVED = 1e-12


class NonCollidingSettings(NamedTuple):
    """Most sweeps over the joints in a step, change of the friction at which they end relative to
    its bound, and the width over which friction is rounded at its bound, relative to it (None:
    exact)."""

    max_sweeps: Any
    tolerance: Any
    relaxation: Any | None

    def solver(self) -> BoxedGaussSeidel:
        """What finds the friction."""
        return BoxedGaussSeidel(self.tolerance, self.max_sweeps, self.relaxation)


def _carried(k: int, joint: Any, response: FrictionResponse) -> Callable:
    """The forces that joint k carries at some friction, as laws of `JointFriction` ask for them."""
    ends = lambda friction, ratio: joint.carrying_ends(*response.at(friction).reactions[k], ratio)
    return lambda friction, ratio: [end.force for end in ends(friction, ratio)]


def set_valued_friction(
    fixed, slips, before, ahead, h, mass, response: FrictionResponse
) -> JointFriction:
    """Coulomb's law in ideal joints at the end of a step, as a problem for their friction.

    A joint that slides is held back by kinetic friction, and caught by static friction where it
    would reverse.

    Args:
        fixed: joints that touch all the time.
        slips: rates of sliding of each.
        before, ahead: changes from the speeds at which slips were read to those at the step's
            start, and
            to those at its end without friction.
        h: length of the step [s].
        mass: of the mechanism, scale of what counts as immovable [kg].
        response: of the mechanism to friction.
    """
    blocks: list[Any] = []
    for k, (joint, sliding) in enumerate(zip((one.joint for one in fixed), slips, strict=True)):
        if joint.friction is None:
            blocks.append(None)
            continue
        law, slip = joint.friction.coulomb(), [each.at(before) for each in sliding]
        carried = _carried(k, joint, response)
        if joint.components > 1:
            share = joint.friction_ratio(law.bound(sp.norm(tuple(slip))))
            blocks.append(Caught(share, carried))
            continue
        against = caught = joint.friction_ratio(law.bound(jnp.abs(slip[0])))
        if law.mu_static is not None:
            caught = joint.friction_ratio(law.bound(jnp.zeros_like(slip[0])))
        low, high = (jnp.where(back, against, caught) for back in (slip[0] > 0, slip[0] < 0))
        blocks.append(OfReaction(low, high, carried))
    # What friction in each joint adds to each joint's slip at the step's end.
    rates = [each for part in slips for each in part]
    delassus = [
        [h * along(each.row, unit.accelerations) for unit in response.units] for each in rates
    ]
    # A joint that drives move slides whatever friction does (only rounding, of either sign,
    # answers): there it is full.
    softest = [
        UNMOVED * h * one.joint.arm**2 / mass for one in fixed for _ in range(one.joint.components)
    ]
    free = [each.at(ahead) for each in rates]
    return JointFriction(delassus, free, tuple(blocks), softest, placed(fixed))


def with_rows_of_loads(
    problem: JointFriction,
    loads: LoadsInStep,
    response: FrictionResponse,
    before: list,
    ahead: list,
    h: Any,
    mass: Any,
) -> JointFriction:
    """The friction problem with loads whose force the step solves for, behind the joints.

    What runs into a stop in the step goes back at its end with the stop's share of its speed.

    Args:
        problem: of the joints' friction.
        loads: stops and dry friction in the step.
        response: of the mechanism to friction and these loads.
        before, ahead: changes from the speeds at which loads were read to those at the step's
            start, and
            to those at its end without friction and these loads.
        h: length of the step [s].
        mass: of the mechanism, scale of what counts as immovable [kg].
    """
    free = [rate.at(ahead) for rate in loads.rates]
    moves = [
        [h * along(rate.row, unit.accelerations) for unit in response.units] for rate in loads.rates
    ]
    first, blocks = problem.components(), list(problem.blocks)
    for k, stop in enumerate(loads.stops):
        closed = stop.beyond - 0.5 * h * free[k] >= 0
        low, high = jnp.zeros(()), jnp.where(closed, jnp.inf, 0.0)
        lightness = moves[k][first + k] / h
        if stop.side.stop.restitution is None:
            followed, spring = stop.followed(lightness, h), stop.spring()
            low, high = jnp.where(followed, spring, low), jnp.where(followed, spring, high)
        struck = jnp.minimum(stop.opening.at(before), 0.0)
        free[k] = free[k] + stop.restitution(lightness) * jnp.where(closed, struck, 0.0)
        blocks.append(Interval(low, high))
    blocks += [Interval(-rub.bound, rub.bound) for rub in loads.rubs]
    places = [problem.place(k) for k in range(len(problem.blocks))]
    places += [slice(first + k, first + k + 1) for k in range(len(moves))]
    softest = [problem.softest[i] for i in range(first)] + [UNMOVED * h / mass] * len(moves)
    return JointFriction(
        [*problem.delassus, *moves],
        [*(problem.free_velocity[i] for i in range(first)), *free],
        tuple(blocks),
        softest,
        tuple(places),
    )


def moved_to_stops(
    loads: LoadsInStep, beyond: list, response: FrictionResponse, forces: list, h: Any
) -> tuple[list, Any]:
    """Projection of coordinates onto the stops beyond which they are, in the metric of the masses.

    Rigid stops that have pressed are touched; stiff ones stay as far beyond as their steady load
    deflects them.

    Args:
        loads: stops in the step.
        beyond: how far coordinates are beyond each stop at its end [rad, m].
        response: of the mechanism to the loads.
        forces: with which stops have pressed [N m, N].
        h: length of the step [s].

    Returns:
        The change of coordinates in terms of speeds; the energy [J] that it took out.
    """
    units = response.units[len(response.units) - len(loads.rates) :]
    rows = [stop.opening.row for stop in loads.stops]
    free = response.without.accelerations
    matrix, blocks, gaps = [], list[Any](), [-x for x in beyond]
    for k, stop in enumerate(loads.stops):
        matrix.append([h * along(rows[k], unit.accelerations) for unit in units[: len(rows)]])
        is_fixed = forces[k] > 0
        if stop.side.stop.restitution is None:
            is_fixed = is_fixed & ~stop.followed(matrix[k][k] / h, h)
            back = 1 + stop.restitution(matrix[k][k] / h)
            struck = back * positive_part(-stop.opening.value) / matrix[k][k]
            gaps[k] = gaps[k] + positive_part(forces[k] - struck) / stop.side.stop.stiffness
        most = jnp.where(is_fixed, jnp.inf, 0.0)
        blocks.append(Interval(-most, most))
    problem = JointFriction(matrix, gaps, tuple(blocks), [0.0] * len(rows))
    result = SETTINGS.solver().iterate(problem).z
    each = list(zip([h * result[k] for k in range(len(rows))], units, strict=False))
    direction = [sp.total(x * unit.accelerations[j] for x, unit in each) for j in range(len(free))]
    loss = sp.total(x * along(row, free) for (x, _), row in zip(each, rows, strict=True))
    return direction, loss


def regularised_friction(fixed, speeds, response: FrictionResponse) -> JointFriction:
    """Friction laws that are functions of the sliding speed, as a problem with known shares.

    Args:
        fixed: joints that touch all the time.
        speeds: sliding speed of each, in the middle of the step [m/s].
        response: of the mechanism to friction.

    Raises:
        ValueError: a law is set-valued or has bristles.
    """
    blocks: list[Any] = []
    for k, (one, slip) in enumerate(zip(fixed, speeds, strict=True)):
        law, carried = one.joint.friction, _carried(k, one.joint, response)
        if law is None:
            blocks.append(None)
            continue
        if law.set_valued or law.bristles:
            raise ValueError(
                f'joint "{one.name}" has friction {type(law).__name__}, which is no function of '
                "the sliding speed; for integrator"
                ".NonColliding(regularised=True) give one that is, such as friction.ThreeZone, or "
                "leave `regularised` out."
            )
        share = lambda size, one=one, law=law: one.joint.friction_ratio(law.coefficient(size))
        if one.joint.components > 1:
            blocks.append(Opposed(tuple(slip), share, carried))
            continue
        against = -jnp.sign(slip[0]) * share(jnp.abs(slip[0]))
        blocks.append(OfReaction(-against, against, carried))
    count, none = sum(one.joint.components for one in fixed), jnp.zeros(len(response.units))
    return JointFriction([none] * count, none, tuple(blocks), jnp.ones(count), placed(fixed))


SETTINGS = NonCollidingSettings(200.0, 1e-13, None)
# Last change of friction in a search, relative to the largest, beyond which there is no answer.
LOOSE = 1e-6


class Rubbing(NamedTuple):
    """What acts with the friction of the joints, the accelerations, the reactions, friction [N] and
    sliding speed [m/s] of each joint that touches all the time, of a ball three components."""

    forces: Forces
    solution: Solution
    answer: Answer
    friction: Any
    slips: list


def rubbing(model: Model, forces: Forces, q: tuple) -> Rubbing:
    """Friction of ideal joints with the accelerations and reactions that it causes.

    It is nan where friction and reactions increase each other without end (self-locking).

    Args:
        model: of the run.
        forces: all that acts but this friction.
        q: coordinates, a tuple for each link.
    """
    system = model.system
    fixed = touching(system)
    slips = [sliding_speeds(system, forces.motions, one) for one in fixed]
    response = friction_response(model, forces, q)
    problem = regularised_friction(fixed, slips, response)
    friction, rest, _ = SETTINGS.solver().iterate(problem)
    friction = jnp.where(rest > LOOSE, jnp.nan, friction)
    answer = response.at(friction)
    solution = link_accelerations(system, answer.accelerations, answer.multipliers)
    speeds = [x for slip in slips for x in slip]
    return Rubbing(with_friction(system, forces, friction), solution, answer, friction, speeds)


def solved(model: Model, forces: Forces, q: tuple) -> tuple[Forces, Solution, Passive]:
    """The equations of motion solved, with the friction of ideal joints.

    Args:
        model: of the run.
        forces: all that acts but this friction.
        q: coordinates, a tuple for each link.

    Returns:
        Forces with the friction, accelerations, and wear and losses of joints that rub.
    """
    fixed = touching(model.system)
    if not fixed:
        solution = dynamics.forward_dynamics(model.system, forces, model.stabilisation)
        return forces, solution, Passive()
    result = rubbing(model, forces, q)
    passive = passive_of(model, result.forces, q, result.answer, result.friction, result.slips)
    return result.forces, result.solution, passive


def passive_of(
    model: Model, forces: Forces, q: tuple, answer: Answer, friction: Any, slips: list
) -> Passive:
    """Wear rates, losses and normal forces of ideal joints that rub.

    Args:
        model: of the run.
        forces: with the motions at which they act.
        q: coordinates, a tuple for each link.
        answer: reactions of the joints.
        friction: components in all joints [N].
        slips: sliding speeds of these components [m/s].
    """
    fixed = touching(model.system)
    ends = ends_that_wear(model.system, answer, friction)
    rates = wear_rates(model, forces.motions, q, ends, slips)
    loss, driven = friction_losses(fixed, friction, slips)
    parts = zip(fixed, answer.reactions, placed(fixed), strict=True)
    pressed = [pressing(one, part, joint_part(friction, place)) for one, part, place in parts]
    return Passive(rates, loss, driven, pressed)


def friction_losses(fixed: tuple[PermanentJoint, ...], friction: Any, slips: list) -> tuple:
    """(power lost to friction, the part of it that drives supply) [W].

    Args:
        fixed: joints that touch all the time.
        friction: components in all joints [N].
        slips: sliding speeds of these components [m/s].
    """
    powers = [sp.neg(sp.mul(friction[k], slip)) for k, slip in enumerate(slips)]
    places = zip(fixed, placed(fixed), strict=True)
    driven = [powers[place.start] for one, place in places if one.driven]
    return sp.total(powers), sp.total(driven)


def contact(instant: Instant, forces: Forces, name: str) -> ContactReport:
    """Contact report of an ideal joint that rubs.

    Args:
        instant: at which it is read.
        forces: all that acts but the friction of ideal joints.
        name: of the joint.
    """
    result = rubbing(instant.model, forces, instant.q)
    joints = touching(instant.model.system)
    places = placed(joints)
    for k, joint in enumerate(joints):
        if joint.name == name:
            return report(
                instant, joint, result.answer.reactions[k], tuple(result.friction[places[k]])
            )
    raise KeyError(name)


def check_rubbing(mechanism: Mechanism, integrator: str) -> None:
    """Raises `ValueError` for friction in an ideal joint that is no function of its sliding
    speed."""
    for name, joint in rubbing_in(mechanism.connections).items():
        law = joint.friction
        if law is not None and (law.set_valued or law.bristles):
            raise ValueError(
                f'joint "{name}" has friction {type(law).__name__}, which is no function of the '
                f"sliding speed: for {integrator} give a {type(joint).__name__} one that is, such "
                "as friction.ThreeZone, or take integrator.NonColliding or MoreauJean, where "
                "friction sticks."
            )
