"""Friction of joints that always touch, over a step: Coulomb's law with bounds that follow the
reactions, or a law that is a function of the sliding speed."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.components.clearance import carried_load
from jaxclear.formulations.contact_rows import along
from jaxclear.formulations.permanent_reactions import FrictionResponse
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide, safe_sqrt

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


def _total(joint, reaction, friction, total):
    """Sum of the sizes of the forces that a joint carries, with the last such sum to tell their
    share of friction.
    """
    return carried_load(joint.carrying_ends(*reaction, safe_divide(friction, total)))


def set_valued_friction(
    joints, slips, v, h, mass, response: FrictionResponse, settings: NonCollidingSettings
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
    end = [x + h * response.without.accelerations[j] for j, x in enumerate(v)]
    gains = [
        [joint.arm * h * along(sliding.row, unit.accelerations) for unit in response.units]
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
                _total(joints[k], response.at(friction).reactions[k], friction[k], total[k])
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


def regularised_friction(
    held, speeds, response: FrictionResponse, settings: NonCollidingSettings
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
        reactions = response.at(before).reactions
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
