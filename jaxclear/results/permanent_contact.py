"""What a run of joints that always touch tells of them: who carries, who rubs, and when that
changes.

Reactions are means over the saving intervals, so save every step where instants matter; they are
written at an interval's end, where the states stand.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.components.clearance import (
    SITUATIONS,
    AbstractPermanentJoint,
    CarryingEnd,
    carried_load,
    situation,
)
from jaxclear.formulations import permanent
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide
from jaxclear.multibody import kinematics
from jaxclear.multibody.system import prepare
from jaxclear.results.trajectory import (
    ContactHistory,
    Trajectory,
    layout_of,
    mean_forces,
    over_time,
)

# A guide's friction adds to the moment and so to the sizes; a pass shrinks the error of the ratio
# to half of it or, at worst, to (1 + mu width / length) / 2.
PASSES = 40
LINE = SITUATIONS.index("a line (points on one side)")


def touching(run: Trajectory) -> tuple[str, ...]:
    """Connections whose joint always touches."""
    return tuple(held.name for held in permanent.touching(prepare(run.mechanism)))


class IntervalMeans(NamedTuple):
    """A joint's mean reaction and friction over a saving interval, where it is carried, and the
    joint's speed at the end.
    """

    force: Any
    torque: Any
    ends: tuple[CarryingEnd, ...]
    speed: Any


def _means(joint: AbstractPermanentJoint, parts: Any, speed: Any) -> IntervalMeans:
    """From the components of a joint's mean reaction."""
    numbers = [parts[i] for i in range(permanent.COMPONENTS)]
    force, torque, friction = tuple(numbers[:3]), tuple(numbers[3:6]), numbers[6]

    def improve(_, ratio):
        # Half the way: friction that adds to the forces more than the forces to friction would
        # overshoot.
        return 0.5 * (
            ratio + safe_divide(friction, carried_load(joint.carrying_ends(force, torque, ratio)))
        )

    ratio = jax.lax.fori_loop(0, PASSES, improve, jnp.zeros(()))
    return IntervalMeans(parts[:3], parts[3:6], joint.carrying_ends(force, torque, ratio), speed)


def _over_means(run: Trajectory, name: str, function: Any) -> Any:
    """Maps a function of `Means` over the saving times."""
    layout = layout_of(prepare(run.mechanism), run.balanced, run.formulation)
    start = [joint for joint, _ in layout.impulses].index(name) * permanent.COMPONENTS
    parts = mean_forces(run, layout)[:, start : start + permanent.COMPONENTS]
    joint = run.mechanism.connections[name].joint
    return jax.vmap(lambda *own: function(_means(joint, *own)))(parts, _speed(run, name))


def _speed(run: Trajectory, name: str) -> Float[Array, " time"]:
    """Speed of a joint at the saving times."""
    if run.mechanism.topology.branch_of(name) is not None:
        return run.speed(name)[:, 0]
    joint = run.mechanism.connections[name].joint

    def one(now):
        closure = now.system.closures[now.system.topology.loops.index(name)]
        relative = kinematics.relative_motion(closure, now.motions)[2]
        return joint.speeds_at(*relative)[0]

    return over_time(run, one)


@eqx.filter_jit
def contact(run: Trajectory, name: str) -> ContactHistory:
    """Contacts of a joint that always touches, numbered as those of the clearance joint."""
    joint = run.mechanism.connections[name].joint

    def one(now):
        found = sorted((c for end in now.ends for c in end.contacts), key=lambda c: c.index)
        places = jnp.stack([sp.stack(contact.place) for contact in found])
        normal = sp.stack([contact.normal_force for contact in found])
        traction = jnp.abs(sp.stack([contact.friction for contact in found]))
        slip = jnp.full(len(found), jnp.abs(joint.arm * now.speed))
        offsets = jnp.stack([sp.stack(end.offset) for end in now.ends])
        offset, lean = jnp.mean(offsets, 0), jnp.zeros(3)
        if len(now.ends) == 2:
            lean = (offsets[1] - offsets[0]) / (now.ends[1].height - now.ends[0].height)
        axis = (lean + jnp.array([0.0, 0.0, 1.0])) / jnp.sqrt(1 + lean @ lean)
        return ContactHistory(
            offset,
            axis,
            jnp.zeros(len(found)),
            normal,
            slip,
            traction,
            places,
            now.force,
            now.torque,
        )

    return _over_means(run, name, one)


@eqx.filter_jit
def situations(run: Trajectory, name: str) -> Int[Array, " time"]:
    """How a joint carries at every saving time: index into `SITUATIONS`."""
    return _over_means(run, name, lambda now: situation(now.ends))


@eqx.filter_jit
def _sides(run: Trajectory, name: str):
    """Product of the two ends' forces: below zero while they press on opposite sides; and their
    sum.
    """

    def one(now):
        first, last = now.ends[0].force, now.ends[-1].force
        return sp.dot(first, last), sp.stack(sp.plus(first, last))

    return _over_means(run, name, one)


def switchings(run: Trajectory, name: str) -> Any:
    """Instants at which a joint begins to carry in another way, as a pandas table (time [s], from,
    to).

    Between two ways of two points the instant is where the forces of the ends change sign against
    each other, read off a straight line between the middles of the saving intervals; others are
    known to an interval. A line that changes sides within an interval becomes a line again, at the
    instant of no force.
    """
    import pandas

    codes, products, sums, time = (
        np.asarray(x) for x in (situations(run, name), *_sides(run, name), run.time)
    )
    middles = np.concatenate([time[:1], 0.5 * (time[1:] + time[:-1])])
    rows = []
    for i in range(2, len(codes)):
        turned = sums[i] @ sums[i - 1]
        if codes[i] == codes[i - 1] and (codes[i] != LINE or turned >= 0):
            continue
        instant = 0.5 * (middles[i] + middles[i - 1])
        if products[i] * products[i - 1] < 0:
            instant = middles[i - 1] + (middles[i] - middles[i - 1]) * products[i - 1] / (
                products[i - 1] - products[i]
            )
        elif codes[i] == codes[i - 1]:
            before = sums[i - 1] @ sums[i - 1]
            instant = middles[i - 1] + (middles[i] - middles[i - 1]) * before / (before - turned)
        other = ", on the other side" if codes[i] == codes[i - 1] else ""
        rows.append((instant, SITUATIONS[codes[i - 1]], SITUATIONS[codes[i]] + other))
    return pandas.DataFrame(rows, columns=["time [s]", "from", "to"])
