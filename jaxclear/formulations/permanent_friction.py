"""Friction of joints that always touch, over a step, posed as a problem: Coulomb's law with bounds
that follow the reactions, or a law that is a function of the sliding speed."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxclear.complementarity import BoxedGaussSeidel, JointFriction
from jaxclear.complementarity.joint_friction import Caught, Opposed
from jaxclear.formulations.permanent_reactions import FrictionResponse, placed
from jaxclear.ground import sparse as sp
from jaxclear.multibody.kinematics import along

# Friction that accelerates a joint by less than this share of what it gives the mechanism's whole
# mass does not move it.
UNMOVED = 1e-12


class NonCollidingSettings(NamedTuple):
    """Most sweeps over the joints in a step, change of the friction at which they end relative to
    its bound, and the width over which friction is rounded at its bound, relative to it (None:
    exact)."""

    most_sweeps: Any
    tolerance: Any
    relaxation: Any | None

    def solver(self) -> BoxedGaussSeidel:
        """What finds the friction."""
        return BoxedGaussSeidel(self.tolerance, self.most_sweeps, self.relaxation)


def _carried(joints, response: FrictionResponse) -> Callable:
    """The forces that joint k carries at some friction, as `JointFriction` asks for them."""

    def carried(k, friction, ratio):
        ends = joints[k].carrying_ends(*response.at(friction).reactions[k], ratio)
        return [end.force for end in ends]

    return carried


def set_valued_friction(held, slips, v, h, mass, response: FrictionResponse) -> JointFriction:
    """Coulomb's law at the end of a step of length h [s] from the speeds v; `slips` of each joint.

    A joint that slides is held back by kinetic friction, and caught by static friction where it
    would turn round.
    """
    ratios: list[Any] = []
    for joint, sliding in zip((one.joint for one in held), slips, strict=True):
        if joint.friction is None:
            ratios.append(None)
            continue
        law, slip = joint.friction.coulomb(), [joint.arm * each.at(v) for each in sliding]
        if joint.components > 1:
            ratios.append(Caught(joint.friction_ratio(law.bound(sp.norm(tuple(slip))))))
            continue
        against = caught = joint.friction_ratio(law.bound(jnp.abs(slip[0])))
        if law.mu_static is not None:
            caught = joint.friction_ratio(law.bound(jnp.zeros_like(slip[0])))
        pair = (jnp.where(slip[0] > 0, against, caught), jnp.where(slip[0] < 0, against, caught))
        ratios.append(pair)
    # Speeds at the step's end without friction, and what friction in each joint adds to each
    # joint's slip.
    end = [x + h * response.without.accelerations[j] for j, x in enumerate(v)]
    rows = [(one.joint.arm, each) for one, own in zip(held, slips, strict=True) for each in own]
    free = [arm * each.at(end) for arm, each in rows]
    delassus = [
        [arm * h * along(each.row, unit.accelerations) for unit in response.units]
        for arm, each in rows
    ]
    # A joint that drives move slides whatever friction does (only rounding, of either sign,
    # answers): there it is full.
    softest = [UNMOVED * h * arm**2 / mass for arm, _ in rows]
    carried = _carried([one.joint for one in held], response)
    return JointFriction(delassus, free, tuple(ratios), carried, softest, placed(held))


def regularised_friction(held, speeds, response: FrictionResponse) -> JointFriction:
    """Laws that are functions of the sliding speed, here at the middle of the step: friction's
    share of the load is known, and a box without width holds it there.
    """
    ratios: list[Any] = []
    for one, speed in zip(held, speeds, strict=True):
        law, slip = one.joint.friction, [one.joint.arm * x for x in speed]
        if law is None:
            ratios.append(None)
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
            ratios.append(Opposed(tuple(slip), share))
            continue
        against = -jnp.sign(slip[0]) * share(jnp.abs(slip[0]))
        ratios.append((-against, against))
    places = placed(held)
    count = sum(one.joint.components for one in held)
    none, joints = jnp.zeros(count), [one.joint for one in held]
    carried = _carried(joints, response)
    free = [none] * count
    return JointFriction(free, none, tuple(ratios), carried, jnp.ones(count), places)
