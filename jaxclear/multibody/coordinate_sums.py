r"""Rows of couplings between coordinates, $\sum_i r_i q_i = c$: residual, rate, Jacobian, second
derivative, and the direction of the multiplier.

A coordinate that the tree carries is read, whole turns and all, and its entry of the Jacobian is
its factor; one outside the tree is read between its two markers, as loads read it
(`closure_coordinates`), its whole turns so that the sum is least.
"""

from typing import Any

import jax.numpy as jnp

from jaxclear.ground import sparse as sp
from jaxclear.multibody import kinematics, pose_rows
from jaxclear.multibody.kinematics import JacobianRow
from jaxclear.multibody.loops import CoordinateSum, SummedCoordinate
from jaxclear.multibody.rows import Direction, OnClosure, OnLink
from jaxclear.multibody.tree import Motion, Wrench


def sum_equation(
    system: Any, motions: tuple[Motion, ...], row: CoordinateSum
) -> tuple[Any, Any, JacobianRow]:
    """(residual, rate, Jacobian by speed index) of the row."""
    residual, rate, turn = 0 if row.total is None else sp.neg(row.total), 0, None
    jacobian: JacobianRow = {}
    for term in row.terms:
        if term.link is not None:
            motion = motions[term.link]
            position, speed = motion.coordinates[0], motion.speeds[0]
            own: JacobianRow = {}
            if motion.columns:
                own = {system.topology.branches[term.link].speeds.start: 1}
        else:
            position, speed, own = _outside(system, motions, term)
            turn = 2 * jnp.pi * term.factor if term.turn else turn
        residual = sp.add(residual, sp.mul(term.factor, position))
        rate = sp.add(rate, sp.mul(term.factor, speed))
        for j, entry in own.items():
            jacobian[j] = sp.add(jacobian.get(j, 0), sp.mul(term.factor, entry))
    if turn is not None:
        residual = residual - turn * jnp.round(residual / turn)
    return residual, rate, jacobian


def _outside(
    system: Any, motions: tuple[Motion, ...], term: SummedCoordinate
) -> tuple[Any, Any, JacobianRow]:
    """(coordinate, speed, Jacobian) of a joint outside the tree."""
    _, pose, relative = kinematics.relative_motion(term.closure, motions)
    (position,), (slope,) = pose_rows.gradients(term.reading, pose)
    rates = lambda *own: (pose_rows.rate(slope, *own),)
    jacobian = kinematics.relative_jacobian(system, motions, term.closure, pose, rates)
    return position, rates(pose, relative.velocity, relative.spin)[0], jacobian[0]


def sum_direction(motions: tuple[Motion, ...], row: CoordinateSum) -> Direction:
    """The direction of the row's multiplier."""
    places: list[OnLink | OnClosure] = []
    for term in row.terms:
        if term.link is not None:
            places.append(OnLink(term.link, term.factor))
        else:
            pose = kinematics.relative_motion(term.closure, motions)[1]
            (slope,) = pose_rows.gradients(term.reading, pose)[1]
            unit = Wrench(*slope.wrench(pose))
            places.append(OnClosure(term.closure, pose, unit, term.joint, term.factor))
    return Direction(tuple(places))
