"""Closing the loops that the spanning tree leaves open, by multipliers.

Each row of a joint that closes a loop is a displacement ("x") or the cosine between two axes
("x.z"), seen from the parent's marker. Rows, their rates and their accelerations are exact, so
drift is the integrator's alone; it is held by Baumgarte's terms (Baumgarte 1972, Comput. Methods
Appl. Mech. Eng. 1, 1) or closed anew after every step, and reported. A row that is structurally
zero is dropped.
"""

from typing import Any, NamedTuple

import equinox as eqx

from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import REST, STILL, Pose, Twist
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.multibody.tree import transform_twist

AXIS = {"x": 0, "y": 1, "z": 2}
# The row of a coupling, by what is left of it: a length, or an angle.
LENGTH, TURN = "way", "turn"


class Baumgarte(AbstractQuantified):
    r"""Baumgarte's stabilisation, :math:`\ddot\Phi + 2\alpha\dot\Phi + \beta^2\Phi = 0`: drift of a
    row decays like :math:`e^{-\alpha t}` where beta = alpha.

    Args:
        alpha: damping of the drift [1/s], >= 0.
        beta: stiffness of the drift [1/s], >= 0.

    Source: Baumgarte 1972, Comput. Methods Appl. Mech. Eng. 1, 1,
    doi:10.1016/0045-7825(72)90018-7.
    """

    alpha: Scalar = quantity(50.0, "1/s", at_least=0)
    beta: Scalar = quantity(50.0, "1/s", at_least=0)


class Projection(AbstractQuantified):
    """Moves coordinates and speeds back onto the closed loops after every step, by the least change
    in the metric of the masses.

    One Newton step each, which leaves the square of a step's drift. For integrators with fixed
    steps; error control would take the jumps for errors.

    Source: Eich 1993, SIAM J. Numer. Anal. 30, 1467, doi:10.1137/0730076.
    """


class AsNeeded(AbstractQuantified):
    """Loops of a mechanism that says nothing, held as the integrator of a run needs it: closed anew
    after every step (`projects`), or by Baumgarte's terms where error control follows them or steps
    are so exact that they drift by rounding alone.
    """

    baumgarte: Baumgarte = eqx.field(default_factory=Baumgarte)
    projects: bool = eqx.field(static=True, default=False)


class Closure(eqx.Module):
    """A pair of markers in the frames of two links (None: ground) and the rows that tie them.
    `reading`: what reads the residuals of the rows off the relative pose (`pose_rows`), where the
    rows themselves do not say it; None elsewhere.
    """

    parent: Pose
    child: Pose
    parent_link: int | None = eqx.field(static=True)
    child_link: int | None = eqx.field(static=True)
    rows: tuple[str, ...] = eqx.field(static=True)
    reading: Any = None


class SummedCoordinate(eqx.Module):
    """The coordinate of a `joint` times a `factor`: that which the tree carries with a `link`, or
    what a `reading` says of the pose in a `closure`; `turn`: an angle whose whole turns are not
    counted there."""

    joint: str = eqx.field(static=True)
    factor: Any
    reading: Any
    closure: Any  # a Closure; None where the tree carries the coordinate
    link: Any = eqx.field(static=True)  # a whole number; None outside the tree
    turn: bool = eqx.field(static=True)


class CoordinateSum(eqx.Module):
    """A sum of coordinates that has a constant total (None: 0): the reading of a closure that ties
    no markers."""

    terms: tuple[SummedCoordinate, ...]
    total: Any


class Relative(NamedTuple):
    """Motion of the child's marker as seen from the (moving) parent's marker, in the parent
    marker's axes: pose, velocity [m/s] and angular velocity [rad/s]. In a clearance joint the
    child's marker is the journal's, the parent's the bearing's.
    """

    pose: Pose
    velocity: sp.Vec
    spin: sp.Vec


def reverse_relative(relative: Relative, turn: sp.Mat) -> Relative:
    """The parent's marker as seen from the child's, both markers turned by `turn` (columns: the new
    axes in the old)."""
    (rotation, _), velocity, spin = relative
    pose = relative.pose.inverse()
    # Seen from the child the parent goes the other way, and turns about it.
    back = sp.minus(sp.cross(spin, relative.pose.translation), velocity)
    rotated = sp.product(sp.transpose(turn), sp.product(pose.rotation, turn))
    into = lambda vector: sp.apply_transposed(turn, sp.apply_transposed(rotation, vector))
    return Relative(
        Pose(rotated, sp.apply_transposed(turn, pose.translation)),
        into(back),
        tuple(sp.neg(x) for x in into(spin)),
    )


class Sides(NamedTuple):
    """Marker frames of a closure at an instant: poses in the ground, twists and accelerations in
    their own axes.
    """

    parent_pose: Pose
    child_pose: Pose
    parent_twist: Twist
    child_twist: Twist


def marker_pose(link_pose: Pose | None, marker: Pose) -> Pose:
    """Pose of a marker in the ground, from that of its link (None: the ground itself)."""
    return marker if link_pose is None else link_pose.after(marker)


def marker_twist(twist: Twist | None, marker: Pose) -> Twist:
    """Twist (or spatial acceleration) of a marker, from that of its link."""
    return STILL if twist is None else transform_twist(marker, twist)


def sides(closure: Closure, poses: tuple, twists: tuple) -> Sides:
    """Poses and twists of a closure's two markers.

    Args:
        closure: pair of markers.
        poses: of all links in the ground.
        twists: of all links, in their own axes.
    """

    def of(link, values):
        return None if link is None else values[link]

    return Sides(
        marker_pose(of(closure.parent_link, poses), closure.parent),
        marker_pose(of(closure.child_link, poses), closure.child),
        marker_twist(of(closure.parent_link, twists), closure.parent),
        marker_twist(of(closure.child_link, twists), closure.child),
    )


def relative_pose(view: Sides) -> Pose:
    """The child's marker in the parent's marker."""
    return (
        view.parent_pose.inverse().after(view.child_pose)
        if view.parent_pose is not REST
        else view.child_pose
    )


def relative_velocity(pose: Pose, parent: Twist, child: Twist) -> tuple[sp.Vec, sp.Vec]:
    """Velocity [m/s] and spin [rad/s] of the child as seen from the moving parent, in its axes.

    Args:
        pose: the child's marker in the parent's.
        parent: twist of the parent's marker, in its own axes.
        child: twist of the child's marker, in its own axes.
    """
    part = sp.apply(pose.rotation, child.linear)
    carried = sp.plus(parent.linear, sp.cross(parent.angular, pose.translation))
    return sp.minus(part, carried), sp.minus(sp.apply(pose.rotation, child.angular), parent.angular)


def is_length(row: str) -> bool:
    """Whether what is left of a row is a length [m]; an angle [rad] or a cosine [1] elsewhere."""
    return len(row) == 1 or row == LENGTH


def residuals_of(closure: Closure, pose: Pose) -> tuple:
    """Value of each row of a closure [m, rad, 1]; 0 where structurally satisfied."""
    if closure.reading is None:
        return residuals(closure.rows, pose)
    return closure.reading.residuals(pose)


def residuals(rows: tuple[str, ...], pose: Pose) -> tuple:
    """Value of each row: a displacement [m] or a cosine [1]; 0 where structurally satisfied."""
    columns = sp.transpose(pose.rotation)
    return tuple(
        pose.translation[AXIS[row]] if is_length(row) else columns[AXIS[row[2]]][AXIS[row[0]]]
        for row in rows
    )


def row_rates(rows: tuple[str, ...], pose: Pose, velocity: sp.Vec, spin: sp.Vec) -> tuple:
    """Rate of each row [m/s, 1/s].

    Args:
        rows: names of lengths ("x") and of products of axes, by which the closure is tied.
        pose: the child's marker in the parent's.
        velocity, spin: relative motion in the parent's axes [m/s, rad/s] (`relative_velocity`).
    """
    columns = sp.transpose(pose.rotation)
    return tuple(
        velocity[AXIS[row]]
        if is_length(row)
        else sp.cross(spin, columns[AXIS[row[2]]])[AXIS[row[0]]]
        for row in rows
    )


def relative_acceleration(
    pose: Pose, view: Sides, parent: Twist, child: Twist
) -> tuple[sp.Vec, sp.Vec]:
    """Rates of the relative velocity and spin, in the moving parent's axes [m/s2, rad/s2].

    Args:
        pose: the child's marker in the parent's.
        view: twists of the two markers.
        parent, child: spatial accelerations [m/s2, rad/s2] of the markers, in their own axes.
    """
    velocity, _ = relative_velocity(pose, view.parent_twist, view.child_twist)
    turning = view.parent_twist.angular

    def material(acceleration, twist):
        return sp.plus(acceleration.linear, sp.cross(twist.angular, twist.linear))

    carried = sp.plus(
        material(parent, view.parent_twist),
        sp.cross(parent.angular, pose.translation),
        sp.cross(turning, sp.cross(turning, pose.translation)),
        sp.scale(2, sp.cross(turning, velocity)),
    )
    linear = sp.minus(sp.apply(pose.rotation, material(child, view.child_twist)), carried)
    part_spin = sp.apply(pose.rotation, view.child_twist.angular)
    angular = sp.minus(
        sp.minus(sp.apply(pose.rotation, child.angular), parent.angular),
        sp.cross(turning, part_spin),
    )
    return linear, angular


def row_accelerations(rows, pose: Pose, spin: sp.Vec, linear: sp.Vec, angular: sp.Vec) -> tuple:
    """Second derivative of each row [m/s2, 1/s2].

    Args:
        rows: names of lengths and of products of axes.
        pose: the child's marker in the parent's.
        spin: relative angular velocity [rad/s].
        linear, angular: rates of the relative velocity and spin (`relative_acceleration`).
    """
    columns = sp.transpose(pose.rotation)
    out: list[Any] = []
    for row in rows:
        if is_length(row):
            out.append(linear[AXIS[row]])
        else:
            axis = columns[AXIS[row[2]]]
            rotated = sp.plus(sp.cross(angular, axis), sp.cross(spin, sp.cross(spin, axis)))
            out.append(rotated[AXIS[row[0]]])
    return tuple(out)
