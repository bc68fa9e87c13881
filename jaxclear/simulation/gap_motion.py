"""How joints that always touch would move in their gaps. The model puts the inner part where its
force presses it, at once; a body takes time for the way, and lags where its force turns fast.
"""

from collections.abc import Iterable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.body import GROUND
from jaxclear.formulations.base import ContactReport
from jaxclear.formulations.model import Instant, Model
from jaxclear.formulations.permanent_reactions import touching
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide
from jaxclear.multibody.mechanism import Mechanism


def in_gaps(model: Model) -> dict[str, Any]:
    """The gap of each joint that always touches and has one."""
    gaps = {one.name: getattr(one.joint, "gap", None) for one in touching(model.system)}
    return {name: gap for name, gap in gaps.items() if gap is not None}


def placed(
    reports: dict[str, ContactReport], now: Instant, mechanism: Mechanism
) -> Float[Array, "13 joints"]:
    """Of joints that are told of at a look: the rotation of the bearing in the ground; as means
    since the look before, where the inner part is in its gap, in the bearing's axes [m], and the
    sum of the normal forces [N]."""
    columns = []
    for name, report in reports.items():
        marker = mechanism.connections[name].parent
        turn = marker.pose().rotation
        index = now.model.system.topology.index(marker.body)
        if index is not None:
            frame = now.model.system.links[index].frame
            turn = sp.product(now.motions[index].pose.after(frame).rotation, turn)
        turned = [x for row in turn for x in row]
        columns.append(sp.stack((*turned, *report.offset, jnp.sum(report.normal_force))))
    return jnp.stack(columns, axis=1)


def masses(names: Iterable[str], mechanism: Mechanism) -> Float[Array, " joints"]:
    """The lighter of the bodies that each of these joints connects [kg]."""

    def lighter(name: str) -> Any:
        connection = mechanism.connections[name]
        bodies = (connection.parent.body, connection.child.body)
        return jnp.min(jnp.stack([mechanism.bodies[b].mass for b in bodies if b != GROUND]))

    return jnp.stack([jnp.asarray(lighter(name), float) for name in names])


def gap_motion(
    found: Float[Array, "looks 13 joints"],
    times: Float[Array, " looks"],
    heavy: Float[Array, " joints"],
) -> Float[Array, " joints"]:
    """By joint the force that moves the lighter body along in the gap beside the forces there, from
    where parts were `placed` at looks at these times [s]. Where a force turns round between two
    looks, parts part, which `Trajectory.switchings` tells, and nothing is counted."""
    if len(found) < 4:
        return jnp.zeros(len(heavy))
    # Halfway between two looks, for which means stand.
    turns = 0.5 * (found[1:, :9] + found[:-1, :9]).reshape(-1, 3, 3, len(heavy))
    places = jnp.einsum("labj,lbj->laj", turns, found[1:, 9:12])
    times, forces = 0.5 * (times[1:] + times[:-1]), found[2:-1, 12]
    lengths = jnp.diff(times)[:, None, None]
    speeds = jnp.diff(places, axis=0) / lengths
    between = 0.5 * (lengths[1:] + lengths[:-1])
    moved = heavy * jnp.linalg.norm(jnp.diff(speeds, axis=0) / between, axis=1)
    stays = jnp.sum(places[1:] * places[:-1], axis=1) > 0
    counted = jnp.where(stays[1:] & stays[:-1], moved, 0.0)
    width = between[:, 0]
    return safe_divide(jnp.sum(width * counted, axis=0), jnp.sum(width * forces, axis=0))
