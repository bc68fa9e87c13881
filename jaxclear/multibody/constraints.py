r"""Constraints of the joints that close loops: residuals, Jacobian, what the accelerations must
give, and the reactions.

For residuals :math:`\Phi(q, t) = 0` the accelerations satisfy :math:`\Phi_q \dot v = \gamma` with
:math:`\gamma = -(\ddot\Phi \text{ at } \dot v = 0) - 2\alpha\dot\Phi - \beta^2\Phi`, the last two
Baumgarte's (Nikravesh 1988, Computer-Aided Analysis of Mechanical Systems, section 3.2; see
`loops`). Reactions are :math:`\Phi_q^T \lambda`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import STILL, Pose, Twist
from jaxclear.multibody import kinematics, loops, pose_rows, tree
from jaxclear.multibody.coordinate_sums import read_sum
from jaxclear.multibody.kinematics import JacobianRow
from jaxclear.multibody.loops import Baumgarte, Closure, CoordinateSum, Relative
from jaxclear.multibody.meshes import Mesh
from jaxclear.multibody.rows import Row, add_wrenches, row_of_wrench, wrench_in_joint
from jaxclear.multibody.system import System
from jaxclear.multibody.tree import NOTHING, Motion, Wrench


def sum_acceleration(motions: tuple[Motion, ...], row: CoordinateSum, second: Any) -> Any:
    """Second derivative of a sum of coordinates at zero free accelerations.

    Args:
        motions: motion of every link; drives contribute their prescribed accelerations.
        row: the sum, the reading of a closure without markers.
        second: function of a closure: its relative velocity and spin, and the rates of both.
    """
    out = 0
    for term in row.terms:
        if term.link is not None:
            prescribed = motions[term.link].prescribed
            driven = prescribed[0] if prescribed else 0
        else:
            pose = kinematics.relative_motion(term.closure, motions)[1]
            slopes = pose_rows.gradients(term.reading, pose)[1]
            driven = pose_rows.accelerations(term.reading, pose, slopes, *second(term.closure))[0]
        out = sp.add(out, sp.mul(term.factor, driven))
    return out


class ConstraintRows(NamedTuple):
    """Rows of one closure that motion changes: their places in the closure, residuals, rates,
    Jacobian (by speed index). `fixed`: residuals of those that no motion changes, by place;
    `slopes`: gradients of all rows by the relative pose, of a closure that has a reading."""

    moving: list[int]
    residuals: tuple
    rates: tuple
    jacobian: list[JacobianRow]
    fixed: dict[int, Any]
    slopes: Any = None


class Dependence(NamedTuple):
    """Of the rows of all closures only `rank` are independent. `measures`: for each row what makes
    its residual a length [1, m], by which forces and torques are compared."""

    rank: int
    measures: tuple


class DrivenLoop(NamedTuple):
    """A loop, or several that share bodies, whose free speeds are no more than its rows: drives
    alone move it. Its rows among those of all closures, and these speeds."""

    rows: tuple[int, ...]
    columns: tuple[int, ...]


class ClosureEquations(NamedTuple):
    """Jacobian rows of all closures (by speed index), what each must give for the free
    accelerations, of which kind each is (`kinds`, equal entries: displacements, or angles, of one
    closure; None: not of a loop that drives hold), and how the rows depend on each other; None:
    not at all."""

    rows: list[JacobianRow]
    targets: list
    kinds: tuple
    dependence: Dependence | None


def measures(closure: Closure, rows: ConstraintRows, arm: Any) -> list:
    """Scale of each moving row by which residuals compare with radians: 1 for angles.

    Args:
        closure: names its rows; those of lengths are scaled.
        rows: of this closure; only `moving` ones count.
        arm: longest arm of the mechanism [m], the scale of lengths.
    """
    return [arm if loops.is_length(closure.rows[i]) else 1.0 for i in rows.moving]


def dependence(system: System, rows: list[ConstraintRows]) -> Dependence | None:
    """How the rows of all closures depend on each other."""
    redundancy = system.topology.redundancy
    names = [
        closure.rows[i]
        for closure, part in zip(system.closures, rows, strict=True)
        for i in part.moving
    ]
    if redundancy is None or redundancy.rank == len(names):
        return None
    measures = tuple(1 if loops.is_length(name) else system.arm for name in names)
    return Dependence(redundancy.rank, measures)


def driven_loops(rows: Sequence[Mapping[int, Any]]) -> list[DrivenLoop]:
    """The loops that drives hold, from the rows of all by free speed."""
    groups: list[tuple[set[int], set[int]]] = []
    for i, row in enumerate(rows):
        one = ({i}, set(row))
        separate = [group for group in groups if not group[1] & one[1]]
        for group in groups:
            if group[1] & one[1]:
                one = (one[0] | group[0], one[1] | group[1])
        groups = [*separate, one]
    return [
        DrivenLoop(tuple(sorted(numbers)), tuple(sorted(columns)))
        for numbers, columns in groups
        if len(numbers) == len(columns)
    ]


def row_kinds(system: System, rows: list[ConstraintRows]) -> tuple:
    """Of the rows of all closures that drives hold which count alike, by equal entries; None for
    the others."""
    kinds = [
        (k, loops.is_length(closure.rows[i]))
        for k, (closure, part) in enumerate(zip(system.closures, rows, strict=True))
        for i in part.moving
    ]
    constrained = {
        i for one in driven_loops([row for part in rows for row in part.jacobian]) for i in one.rows
    }
    return tuple(kind if i in constrained else None for i, kind in enumerate(kinds))


def constraint_rows(
    system: System,
    motions: tuple[Motion, ...],
    closure: Closure,
    relative: Relative | None = None,
    jacobian: list[JacobianRow] | None = None,
) -> ConstraintRows:
    """Residuals, rates and Jacobian of a closure's rows, split in moving and fixed ones.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        closure: pair of markers, or sum of coordinates.
        relative: motion of its markers; None: computed from `motions`.
        jacobian: of all its rows, by speed index; None: computed.
    """
    if isinstance(closure.reading, CoordinateSum):
        residual, direction = read_sum(motions, closure.reading)
        rate = direction.linear_rate(system, motions)
        return ConstraintRows([0], (residual,), (rate.value,), [rate.row], {})
    if relative is None:
        relative = kinematics.relative_motion(closure, motions)[2]
    pose = relative.pose
    slopes = None
    row_rates: Callable = lambda *motion: loops.row_rates(closure.rows, *motion)
    if closure.reading is None:
        residuals = loops.residuals(closure.rows, pose)
    else:
        residuals, slopes = pose_rows.gradients(closure.reading, pose)
        row_rates = lambda *motion: tuple(pose_rows.rate(slope, *motion) for slope in slopes)
    rates = row_rates(pose, relative.velocity, relative.spin)
    if jacobian is None:
        jacobian = kinematics.relative_jacobian(system, motions, closure, pose, row_rates)
    residuals = _counted(closure, residuals, pose, motions)
    moving = [i for i, row in enumerate(jacobian) if row or not sp.is_zero(rates[i])]
    fixed = {
        i: value for i, value in enumerate(residuals) if i not in moving and not sp.is_zero(value)
    }
    return ConstraintRows(
        moving,
        tuple(residuals[i] for i in moving),
        tuple(rates[i] for i in moving),
        [jacobian[i] for i in moving],
        fixed,
        slopes,
    )


def residuals(motions: tuple[Motion, ...], closure: Closure) -> tuple:
    """Residual of each row of a closure [m, rad, 1]; 0 where structurally satisfied.

    Args:
        motions: motion of every link at one instant, in the order of `system.links`.
        closure: pair of markers, or sum of coordinates.
    """
    if isinstance(closure.reading, CoordinateSum):
        return read_sum(motions, closure.reading)[:1]
    pose = kinematics.relative_motion(closure, motions)[1]
    return _counted(closure, loops.residuals_of(closure, pose), pose, motions)


def _counted(closure: Closure, residuals: tuple, pose: Pose, motions: tuple[Motion, ...]) -> tuple:
    """Residuals with the whole turns of what meshes."""
    if not isinstance(closure.reading, Mesh):
        return residuals
    return (closure.reading.counted(residuals[0], pose, motions),)


def acceleration_equations(
    system: System, motions: tuple[Motion, ...], stabilisation: Baumgarte | None
) -> ClosureEquations:
    """Constraint equations of all closures at acceleration level, J a = gamma.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link at one instant, in the order of `system.links`.
        stabilisation: Baumgarte's terms in gamma; None: without.
    """
    accelerations = kinematics.link_accelerations(system, motions, None)
    # A marker on the ground shares the fictitious acceleration that stands for gravity.
    ground = Twist(kinematics.upward(system), sp.ZERO)
    every = [constraint_rows(system, motions, closure) for closure in system.closures]

    def relative(closure):
        view, pose, (_, *moving) = kinematics.relative_motion(closure, motions)
        ends = [
            tree.transform_twist(marker, ground if link is None else accelerations[link])
            for link, marker in (
                (closure.parent_link, closure.parent),
                (closure.child_link, closure.child),
            )
        ]
        return pose, moving, loops.relative_acceleration(pose, view, *ends)

    gamma = []
    for closure, part in zip(system.closures, every, strict=True):
        if isinstance(closure.reading, CoordinateSum):
            of_closure = lambda motion: relative(motion)[1:]
            second = (sum_acceleration(motions, closure.reading, of_closure),)
        else:
            pose, moving, faster = relative(closure)
            second = (
                loops.row_accelerations(closure.rows, pose, moving[1], *faster)
                if closure.reading is None
                else pose_rows.accelerations(closure.reading, pose, part.slopes, moving, faster)
            )
        for i, residual, rate in zip(part.moving, part.residuals, part.rates, strict=True):
            target = sp.neg(second[i])
            if stabilisation is not None:
                target = sp.sub(target, sp.mul(2.0 * stabilisation.alpha, rate))
                target = sp.sub(target, sp.mul(stabilisation.beta * stabilisation.beta, residual))
            gamma.append(target)
    rows = [row for part in every for row in part.jacobian]
    return ClosureEquations(rows, gamma, row_kinds(system, every), dependence(system, every))


def closing_rows(
    system: System, motions: tuple[Motion, ...], every: Iterable[tuple[Closure, dict[int, Any]]]
) -> list[Row]:
    """Forces of joints that close loops and of rigid couplings, as rows.

    Args:
        system: names the closures (`topology.loops`).
        motions: motion of every link at one instant, in the order of `system.links`.
        every: each closure with the multipliers [N, N m] of its moving rows, by row index, in
            the order
            of `system.closures`.
    """
    rows = []
    for name, (closure, forces) in zip(system.topology.loops, every, strict=True):
        if isinstance(closure.reading, CoordinateSum):
            rows += [Row(name, read_sum(motions, closure.reading)[1], forces[0])] if forces else []
            continue
        pose = kinematics.relative_motion(closure, motions)[1]
        rows.append(row_of_wrench(name, closure, pose, wrench_of_rows(closure, pose, forces), name))
    return rows


def multipliers_by_closure(
    system: System, motions: tuple[Motion, ...], multipliers: tuple
) -> Iterator[tuple[Closure, dict[int, Any]]]:
    """Each closure with the multipliers of its moving rows, by row index.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: motion of every link; it decides which rows move.
        multipliers: of the moving rows of all closures, one after another [N, N m].
    """
    position = 0
    for closure in system.closures:
        rows = constraint_rows(system, motions, closure).moving
        yield closure, dict(zip(rows, multipliers[position : position + len(rows)], strict=True))
        position += len(rows)


def wrench_of_rows(closure: Closure, pose: Pose, multipliers: dict[int, Any]) -> Wrench:
    """The wrench on a closure's child about its marker, in the parent marker's axes.

    Args:
        closure: pair of markers.
        pose: the child's marker in the parent's.
        multipliers: [N, N m] by row index; rows that are missing carry nothing.
    """
    force, torque = sp.ZERO, sp.ZERO
    if closure.reading is not None:
        slopes = pose_rows.gradients(closure.reading, pose)[1]
        for i, multiplier in multipliers.items():
            pushed, turning = slopes[i].wrench(pose)
            force = sp.plus(force, sp.scale(multiplier, pushed))
            torque = sp.plus(torque, sp.scale(multiplier, turning))
        return Wrench(force, torque)
    columns = sp.transpose(pose.rotation)
    for i, multiplier in multipliers.items():
        row = closure.rows[i]
        axis = sp.IDENTITY[loops.AXIS[row[0]]]
        if loops.is_length(row):
            force = sp.plus(force, sp.scale(multiplier, axis))
        else:
            turning = sp.cross(columns[loops.AXIS[row[2]]], axis)
            torque = sp.plus(torque, sp.scale(multiplier, turning))
    return Wrench(force, torque)


def wrenches_of_rows(
    system: System, motions: tuple[Motion, ...], multipliers: tuple[dict[int, Any], ...]
) -> tuple[list[Wrench], list[Wrench]]:
    """Wrenches by which multipliers act through closures and tree joints of a mechanism at rest.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        motions: poses of the links; their twists are ignored.
        multipliers: for each closure, [N, N m] by row index.

    Returns:
        The wrench on each closure's child about its marker, in the parent marker's axes; and
        what each
        link receives through its inboard joint, in the link's frame.
    """
    rows = closing_rows(system, motions, zip(system.closures, multipliers, strict=True))
    closing = [
        wrench_in_joint([row for row in rows if row.owner == name], name)
        for name in system.topology.loops
    ]
    acting = [NOTHING] * len(system.links)
    add_wrenches(acting, rows)
    through = list(acting)
    still = tuple(motion._replace(twist=STILL) for motion in motions)
    for subtree in system.topology.subtrees:
        parts: tuple = (system.links, still, [STILL] * len(still), acting)
        wrenches = tree.joint_wrenches(*kinematics.by_subtree(subtree, *parts))
        for i, wrench in zip(subtree, wrenches, strict=True):
            through[i] = wrench
    return closing, through
