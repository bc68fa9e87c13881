"""One step of a mechanism whose clearance joints always touch: ideal joints, whose reactions rub in
the gap.

The equations are evaluated once, half a step ahead. Reactions R and the sliding speeds s at the
step's end are linear in the friction T of the joints, s = s0 + W T; Coulomb's law asks T in [-B,
B], B = grip(mu) times the sum of the forces R splits into, T = B against sliding, s = 0 in between.
This is a horizontal complementarity problem where the directions of the carried forces are known (a
guide); a journal's turn with T and are iterated upon with it. Coordinates move by exponentials of
the mean speeds, so rotations stay on their group. Source: antenna paper (000), sections 3 and 4.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.components.clearance import AbstractPermanentJoint, carried_load
from jaxclear.formulations.contact_rows import ContactJacobianRow, TimeStep, along
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.pose import FLIP
from jaxclear.multibody import constraints, dynamics, energy, kinematics
from jaxclear.multibody.dynamics import Solution
from jaxclear.multibody.forces import Forces, add_action_and_reaction, applied_forces
from jaxclear.multibody.loops import Baumgarte
from jaxclear.multibody.state import Layout, unpack_motion
from jaxclear.multibody.system import System

# Components of the impulse of a joint that always touches: force and torque on the child, friction.
COMPONENTS = 7
# Friction that accelerates a joint by less than this share of what it gives the mechanism's whole
# mass does not move it.
UNMOVED = 1e-12


class NonCollidingSettings(NamedTuple):
    """Most sweeps over the joints in a step, change of the friction at which they end relative to
    its bound, the width over which friction is rounded at its bound, relative to it (None: exact),
    and whether laws of friction are taken as the functions of the sliding speed that they are,
    instead of as Coulomb's."""

    most_sweeps: Any
    tolerance: Any
    relaxation: Any | None
    regularised: bool = False


class Reaction(NamedTuple):
    """Force [N] and torque [N m] on a joint's child about its marker, in the parent marker's
    axes."""

    force: sp.Vec
    torque: sp.Vec


class Answer(NamedTuple):
    """What follows from the friction of the joints: free accelerations, closure multipliers,
    reactions of touching joints.
    """

    accelerations: Any
    multipliers: Any
    reactions: tuple[Reaction, ...]


class PermanentJoint(NamedTuple):
    """A joint that always touches: its connection, and the link that it holds in the tree or the
    loop that it closes.
    """

    name: str
    joint: AbstractPermanentJoint
    link: int | None
    loop: int | None


class Slip(NamedTuple):
    """Speed of such a joint, offset + row @ speeds; what drives prescribe is in the offset."""

    row: ContactJacobianRow
    offset: Any

    def at(self, speeds: Any) -> Any:
        return sp.add(self.offset, along(self.row, speeds))


def touching(system: System) -> tuple[PermanentJoint, ...]:
    """Joints that always touch: those of the tree in its order, then those that close loops."""
    branches, loops = system.topology.branches, system.topology.loops
    found = [
        PermanentJoint(branch.connection, system.links[i].joint, i, None)
        for i, branch in enumerate(branches)
    ]
    found += [PermanentJoint(name, system.closing[i], None, i) for i, name in enumerate(loops)]
    return tuple(held for held in found if isinstance(held.joint, AbstractPermanentJoint))


def impulse_counts(system: System) -> tuple[tuple[str, int], ...]:
    """Components of impulse by joint, as `state.lay_out` wants them."""
    return tuple((held.name, COMPONENTS) for held in touching(system))


def slip_of(system: System, motions: tuple, held: PermanentJoint, speeds: list) -> Slip:
    """How a joint's speed follows from the mechanism's `speeds`, at which the motions are taken."""
    if held.loop is None:
        return Slip({system.topology.branches[held.link].speeds.start: 1}, 0)
    rates = held.joint.speeds_at
    closure = system.closures[held.loop]
    _, pose, relative = kinematics.relative_motion(closure, motions)
    (row,) = kinematics.relative_jacobian(system, motions, closure, pose, rates)
    (speed,) = held.joint.speeds_at(*relative)
    return Slip(row, sp.sub(speed, along(row, speeds)))


def displace(system: System, q: list, speeds: list, h: Any) -> list:
    """Coordinates after speeds have been held for `h` [s], by the joints' exponential maps."""
    out: list[Any] = []
    for link, place, v in zip(system.links, *unpack_motion(system, [*q, *speeds]), strict=True):
        if place:
            out.extend(link.joint.moved(place, tuple(h * x for x in v)))
    return out


def step(
    system: System,
    layout: Layout,
    stabilisation: Baumgarte | None,
    time_step: TimeStep,
    entries: list,
    last: list,
    settings: NonCollidingSettings,
) -> tuple[list, list]:
    """Entries of the state after the step, and what the next is handed as `last`: the accelerations
    over it, then the largest change of friction, relative to its bound, with which a search for it
    has ended so far."""
    h = time_step.length
    q, v = entries[: layout.coordinates], entries[layout.coordinates : layout.memory_start]
    middle = [x + 0.5 * h * a for x, a in zip(v, last[:-1], strict=True)]
    halfway = displace(system, q, v, 0.5 * h)
    at = unpack_motion(system, [*halfway, *middle])
    time = time_step.start + 0.5 * h
    motions = kinematics.link_motions(system, *at, time)
    forces = applied_forces(system, motions, {}, *at, time)
    held = touching(system)
    slips = [slip_of(system, motions, one, middle) for one in held]

    def respond(friction):
        return sp.dense(_answer(system, stabilisation, forces, motions, at[0], held, friction))

    rest = jnp.zeros(len(held))
    none, push = jax.linearize(respond, rest)
    units = [push(rest.at[k].set(1.0)) for k in range(len(held))]
    joints = [one.joint for one in held]
    if settings.regularised:
        friction, left = _rub(held, [slip.at(middle) for slip in slips], none, units, settings)
    else:
        friction, left = _solve(
            joints, slips, v, h, sp.total(link.mass for link in system.links), none, units, settings
        )
    found = _at(none, units, friction)
    after = [x + h * found.accelerations[j] for j, x in enumerate(v)]
    mean = [0.5 * (a + b) for a, b in zip(v, after, strict=True)]
    state = [*displace(system, q, mean, h), *after]
    for k, reaction in enumerate(found.reactions):
        state += [
            entries[len(state) + i] + h * x
            for i, x in enumerate((*reaction.force, *reaction.torque, friction[k]))
        ]
    if layout.energies:
        solution = Solution(
            tuple(tuple(found.accelerations[b.speeds]) for b in system.topology.branches),
            found.multipliers,
        )
        rates = energy.powers(system, with_friction(system, forces, friction), solution)
        rates[3] = -sp.total(
            joint.arm * friction[k] * slips[k].at(mean) for k, joint in enumerate(joints)
        )
        state += [x + h * rate for x, rate in zip(entries[len(state) :], rates, strict=True)]
    return state, [*(found.accelerations[j] for j in range(len(v))), jnp.maximum(last[-1], left)]


def with_friction(system: System, forces: Forces, friction: Any) -> Forces:
    """The forces, with friction [N] added in each joint that touches, in the order of
    `touching`."""
    coordinate_forces, wrenches = list(forces.coordinate_forces), list(forces.wrenches)
    for k, held in enumerate(touching(system)):
        if held.loop is None:
            own = coordinate_forces[held.link][0]
            coordinate_forces[held.link] = (sp.add(own, held.joint.arm * friction[k]),)
            continue
        closure = system.closures[held.loop]
        pose = kinematics.relative_motion(closure, forces.motions)[1]
        add_action_and_reaction(wrenches, closure, pose, *held.joint.friction_wrench(friction[k]))
    return forces._replace(wrenches=tuple(wrenches), coordinate_forces=tuple(coordinate_forces))


def _answer(system, stabilisation, forces, motions, q, touching_joints, friction) -> Answer:
    """How the mechanism answers friction [N] in its touching joints."""
    forces = with_friction(system, forces, friction)
    solution = dynamics.forward_dynamics(system, forces, stabilisation)
    wrenches = dynamics.joint_wrenches(system, forces, solution)
    closed = []
    if any(held.link is None for held in touching_joints):
        closed = [
            Reaction(force, torque)
            for _, force, torque, _ in constraints.constraint_wrenches(
                system, motions, solution.multipliers
            )
        ]
    reactions = tuple(
        closed[held.loop]
        if held.link is None
        else _reaction(system, held.link, q[held.link], wrenches[held.link])
        for held in touching_joints
    )
    return Answer(
        sp.stack([a for own in solution.accelerations for a in own]),
        solution.multipliers,
        reactions,
    )


def _reaction(system, index, q, wrench) -> Reaction:
    """From the wrench that a link receives to the reaction on the connection's child in the parent
    marker's axes.
    """
    joint, branch = system.links[index].joint, system.topology.branches[index]
    pose = joint.motion(q)
    if not branch.reversed:
        return Reaction(
            sp.apply(pose.rotation, wrench.force), sp.apply(pose.rotation, wrench.torque)
        )
    force, torque = (tuple(sp.neg(x) for x in sp.apply(FLIP, part)) for part in wrench)
    return Reaction(force, sp.minus(torque, sp.cross(pose.translation, force)))


def _at(none: Answer, units: list[Answer], friction: Any) -> Answer:
    """The answer at some friction."""
    return jax.tree.map(
        lambda x, *slopes: x + sum(s * friction[k] for k, s in enumerate(slopes)), none, *units
    )


def _total(joint, reaction, friction, total):
    """Sum of the sizes of the forces that a joint carries, with the last such sum to tell their
    share of friction.
    """
    return carried_load(joint.carrying_ends(*reaction, safe_divide(friction, total)))


def _solve(
    joints, slips, v, h, mass, none: Answer, units: list[Answer], settings: NonCollidingSettings
) -> tuple[Any, Any]:
    """Friction of each joint [N] that satisfies Coulomb's law at the end of the step.

    A joint that slides is held back by kinetic friction, and caught by static friction where it
    would turn round.
    """
    count = len(joints)
    if all(joint.friction is None for joint in joints):
        return jnp.zeros(count), 0.0
    grips: list[Any] = []
    for joint, sliding in zip(joints, slips, strict=True):
        if joint.friction is None:
            grips.append(None)
            continue
        law, slip = joint.friction.coulomb(), joint.arm * sliding.at(v)
        against = joint.friction_ratio(law.bound(jnp.abs(slip)))
        caught = (
            against
            if law.mu_static is None
            else joint.friction_ratio(law.bound(jnp.zeros_like(slip)))
        )
        grips.append((jnp.where(slip > 0, against, caught), jnp.where(slip < 0, against, caught)))

    # Speeds at the step's end without friction, and what friction in each joint adds to each
    # joint's slip.
    end = [x + h * none.accelerations[j] for j, x in enumerate(v)]
    gains = [
        [joint.arm * h * along(sliding.row, unit.accelerations) for unit in units]
        for joint, sliding in zip(joints, slips, strict=True)
    ]

    def improve(carry):
        friction, total, _, sweeps = carry
        before, largest = friction, jnp.zeros(())
        for k in range(count):
            if grips[k] is None:
                continue
            slip = joints[k].arm * slips[k].at(end) + sp.dot(gains[k], friction)
            total = total.at[k].set(
                _total(joints[k], _at(none, units, friction).reactions[k], friction[k], total[k])
            )
            low, high = (grip * total[k] for grip in grips[k])
            # A joint that drives move slides whatever friction does (only rounding, of either sign,
            # answers): there it is full.
            stiff = UNMOVED * h * joints[k].arm ** 2 / mass
            wanted = friction[k] - slip / jnp.maximum(gains[k][k], stiff)
            friction = friction.at[k].set(_within(wanted, low, high, settings.relaxation))
            largest = jnp.maximum(largest, jnp.maximum(low, high))
        change = jnp.max(jnp.abs(friction - before)) / jnp.where(largest > 0, largest, 1.0)
        return friction, total, change, sweeps + 1

    return _repeat(improve, count, settings)


def _rub(
    held, speeds, none: Answer, units: list[Answer], settings: NonCollidingSettings
) -> tuple[Any, Any]:
    """Friction of each joint [N] by laws that are functions of the sliding speed, here at the
    middle of the step.
    """
    shares: list[Any] = []
    joints = [one.joint for one in held]
    for one, joint, speed in zip(held, joints, speeds, strict=True):
        law, slip = joint.friction, joint.arm * speed
        if law is not None and (law.set_valued or law.bristles):
            raise ValueError(
                f'joint "{one.name}" has friction {type(law).__name__}, which is no function of '
                "the sliding speed; for integrator"
                ".NonColliding(regularised=True) give one that is, such as friction.ThreeZone, or "
                "leave `regularised` out."
            )
        shares.append(
            jnp.zeros(())
            if law is None
            else -jnp.sign(slip) * joint.friction_ratio(law.coefficient(jnp.abs(slip)))
        )

    def improve(carry):
        before, total, _, sweeps = carry
        reactions = _at(none, units, before).reactions
        total = jnp.stack(
            [_total(joint, reactions[k], before[k], total[k]) for k, joint in enumerate(joints)]
        )
        friction = jnp.stack(shares) * total
        largest = jnp.max(total)
        change = jnp.max(jnp.abs(friction - before)) / jnp.where(largest > 0, largest, 1.0)
        return friction, total, change, sweeps + 1

    return _repeat(improve, len(joints), settings)


def _repeat(improve, count, settings: NonCollidingSettings) -> tuple[Any, Any]:
    """Sweeps until friction changes by less than the tolerance: friction, and its last change
    relative to its bound.
    """

    def unfinished(carry):
        return (carry[2] > settings.tolerance) & (carry[3] < settings.most_sweeps)

    start = jnp.zeros(count)
    friction, _, change, _ = jax.lax.while_loop(
        unfinished, improve, (start, start, jnp.asarray(jnp.inf), jnp.zeros((), int))
    )
    return friction, change


def _within(x, low, high, relaxation):
    """x moved into [-low, high]; with `relaxation`, rounded over that share of the bounds (Chen &
    Harker 1993, SIAM J. Matrix Anal. Appl. 14, 1168): exact as it vanishes."""
    if relaxation is None:
        return jnp.clip(x, -low, high)
    width = relaxation * 0.5 * (low + high)
    root = lambda y: safe_sqrt(y * y + width * width)
    return 0.5 * (root(x + low) - root(x - high) + high - low)
