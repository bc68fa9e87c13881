r"""Rows of couplings between coordinates, $\sum_i r_i q_i = c$: residual, and the direction of the
multiplier, whose rate and Jacobian are the row's.

A coordinate that the tree carries is read, whole turns and all, and its entry of the Jacobian is
its factor; one outside the tree is read between its two markers, as loads read it
(`closure_coordinates`), its whole turns so that the sum is least.
"""

from typing import Any

import jax.numpy as jnp

from jaxclear.ground import sparse as sp
from jaxclear.multibody import kinematics, pose_rows
from jaxclear.multibody.loops import CoordinateSum
from jaxclear.multibody.rows import Direction, OnClosure, OnLink
from jaxclear.multibody.tree import Motion, Wrench


def read_sum(motions: tuple[Motion, ...], row: CoordinateSum) -> tuple[Any, Direction]:
    """(residual, direction of the multiplier) of the row."""
    residual, turn = 0 if row.total is None else sp.neg(row.total), None
    places: list[OnLink | OnClosure] = []
    for term in row.terms:
        if term.link is not None:
            position = motions[term.link].coordinates[0]
            places.append(OnLink(term.link, term.factor))
        else:
            pose = kinematics.relative_motion(term.closure, motions)[1]
            (position,), (slope,) = pose_rows.gradients(term.reading, pose)
            unit = Wrench(*slope.wrench(pose))
            places.append(OnClosure(term.closure, pose, unit, term.joint, term.factor))
            turn = 2 * jnp.pi * term.factor if term.turn else turn
        residual = sp.add(residual, sp.mul(term.factor, position))
    if turn is not None:
        residual = residual - turn * jnp.round(residual / turn)
    return residual, Direction(tuple(places))
