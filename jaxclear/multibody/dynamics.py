"""The equations of motion: from coordinates, speeds and a time to accelerations, in named stages.

move -> contacts -> loads -> balance of forces -> accelerations. Alike limbs and clearance joints
are traced once. A stage takes what it uses and returns plain tuples, so each can be checked by
itself.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.components.joint import drive_of
from jaxclear.components.load import Action, MarkerMotion
from jaxclear.ground import factorisation
from jaxclear.ground import sparse as sp
from jaxclear.ground.grouping import map_alike
from jaxclear.ground.pose import STILL, Pose, Twist
from jaxclear.multibody import contact_point, loops, tree
from jaxclear.multibody.contact_point import JointReport, Relative
from jaxclear.multibody.loops import Baumgarte
from jaxclear.multibody.system import System, body_loads, coordinate_loads
from jaxclear.multibody.tree import NOTHING, Motion, Wrench


class Forces(NamedTuple):
    """Everything that acts, at one instant."""

    motions: tuple[Motion, ...]
    reports: dict[str, JointReport]
    wrenches: tuple[Wrench, ...]
    coordinate_forces: tuple
    stored: Any
    damping_loss: Any
    external_power: Any


class Solution(NamedTuple):
    """Free accelerations per link, and multipliers of the closure rows."""

    accelerations: tuple[tuple, ...]
    multipliers: tuple


def move(system: System, q: tuple, v: tuple, time: Any) -> tuple[Motion, ...]:
    """Motion of every link."""
    calls = [
        tuple(tuple(part[i] for i in limb) for part in (system.links, q, v)) + (time,)
        for limb in system.topology.limbs
    ]
    with jax.named_scope("move"):
        return tuple(motion for limb in map_alike(tree.move, calls) for motion in limb)


def relative_motion(
    closure: loops.Closure, motions: tuple[Motion, ...]
) -> tuple[loops.Sides, Pose, Relative]:
    """The closure's markers, and the child's marker as seen from the parent's."""
    view = loops.sides(closure, tuple(m.pose for m in motions), tuple(m.twist for m in motions))
    pose = loops.relative_pose(view)
    return (
        view,
        pose,
        Relative(pose, *loops.relative_velocity(pose, view.parent_twist, view.child_twist)),
    )


def touch(
    system: System, motions: tuple[Motion, ...], memories: dict, worn: dict
) -> dict[str, JointReport]:
    """Report of every clearance joint; `worn` are depth maps by joint and surface."""
    names = list(system.bearings)
    calls = []
    for name in names:
        bearing = system.bearings[name]
        relative = relative_motion(bearing.closure, motions)[2]
        calls.append(
            (bearing.joint, bearing.contact_laws, relative, memories[name], worn.get(name, {}))
        )
    with jax.named_scope("touch"):
        return dict(zip(names, map_alike(contact_point.evaluate, calls), strict=True))


def _add(wrenches: list[Wrench], link: int | None, wrench: Wrench) -> None:
    if link is not None:
        old = wrenches[link]
        wrenches[link] = Wrench(
            sp.plus(old.force, wrench.force), sp.plus(old.torque, wrench.torque)
        )


def add_pair(
    wrenches: list[Wrench], closure: loops.Closure, pose: Pose, force: sp.Vec, torque: sp.Vec
) -> None:
    """Add a wrench on the closure's child about its marker, in the parent marker's axes, and its
    opposite on the parent.
    """
    on_child = Wrench(
        sp.apply_transposed(pose.rotation, force), sp.apply_transposed(pose.rotation, torque)
    )
    back = tuple(sp.neg(x) for x in force)
    moment = sp.plus(torque, sp.cross(pose.translation, force))
    on_parent = Wrench(back, tuple(sp.neg(x) for x in moment))
    _add(wrenches, closure.child_link, tree.carry_wrench(closure.child, on_child))
    _add(wrenches, closure.parent_link, tree.carry_wrench(closure.parent, on_parent))


def act(
    system: System, motions: tuple[Motion, ...], reports: dict[str, JointReport], q, v, time: Any
) -> Forces:
    """Wrench of contacts and loads on every link, and forces on coordinates."""
    wrenches = [NOTHING] * len(system.links)
    for name, report in reports.items():
        closure = system.bearings[name].closure
        add_pair(
            wrenches, closure, relative_motion(closure, motions)[1], report.force, report.torque
        )
    stored, damping, external = 0, 0, 0
    with jax.named_scope("loads"):
        for name, load in body_loads(system):
            places = system.load_markers[name]
            sights = tuple(_sight(place, motions) for place in places)
            effect = load.effect(time, sights)
            for action, (link, marker) in zip(effect.actions, places, strict=True):
                _add(wrenches, link, _wrench_of(action, link, marker, motions))
            stored, damping = sp.add(stored, effect.stored), sp.add(damping, effect.dissipated)
            external = sp.add(external, effect.external)
    forces = [(0,) * len(motion.columns) for motion in motions]
    for _, load in coordinate_loads(system):
        index = system.topology.branches.index(system.topology.branch_of(load.connection))
        force, energy, loss, power = load.force(time, q[index][0], v[index][0])
        forces[index] = (sp.add(forces[index][0], force),)
        stored, damping, external = (
            sp.add(stored, energy),
            sp.add(damping, loss),
            sp.add(external, power),
        )
    return Forces(motions, reports, tuple(wrenches), tuple(forces), stored, damping, external)


def _sight(place, motions):
    link, marker = place
    if link is None:
        return MarkerMotion(marker, sp.ZERO, sp.ZERO)
    pose = motions[link].pose.after(marker)
    twist = tree.carry_twist(marker, motions[link].twist)
    return MarkerMotion(
        pose, sp.apply(pose.rotation, twist.linear), sp.apply(pose.rotation, twist.angular)
    )


def _wrench_of(action: Action, link, marker: Pose, motions):
    if link is None:
        return NOTHING
    rotation = motions[link].pose.after(marker).rotation
    local = Wrench(
        sp.apply_transposed(rotation, action.force), sp.apply_transposed(rotation, action.torque)
    )
    return tree.carry_wrench(marker, local)


def equations(system: System, forces: Forces) -> tuple[list, list]:
    """Per limb its mass matrix and the generalised forces, less those that hold zero free
    accelerations.
    """
    motions, limbs = forces.motions, system.topology.limbs
    ground = tuple(sp.neg(x) for x in system.gravity)

    def limb_equations(links, limb_motions, loads):
        return tree.mass_matrix(links, limb_motions), tree.bias_forces(
            links, limb_motions, ground, loads
        )

    calls = [
        tuple(tuple(part[i] for i in limb) for part in (system.links, motions, forces.wrenches))
        for limb in limbs
    ]
    with jax.named_scope("equations"):
        masses, right = [], []
        for limb, (mass, bias) in zip(limbs, map_alike(limb_equations, calls), strict=True):
            applied = [force for i in limb for force in forces.coordinate_forces[i]]
            right.append(tuple(sp.sub(f, b) for f, b in zip(applied, bias, strict=True)))
            masses.append(mass)
    return masses, right


def solve(system: System, forces: Forces, stabilisation: Baumgarte | None) -> Solution:
    """Free accelerations under the forces, with the loops closed."""
    motions, limbs = forces.motions, system.topology.limbs
    masses, right = equations(system, forces)
    factors = [factorisation.factor(mass) if mass else None for mass in masses]
    if system.closures:
        with jax.named_scope("loops"):
            free = [
                factorisation.solve(f, r) if f else () for f, r in zip(factors, right, strict=True)
            ]
            rows, wanted = closure_targets(system, motions, stabilisation)
            multipliers, pulls = _multipliers(system, rows, wanted, factors, free)
            right = [
                tuple(sp.add(r, p) for r, p in zip(rs, ps, strict=True))
                for rs, ps in zip(right, pulls, strict=True)
            ]
    else:
        multipliers = ()
    flat = [
        list(factorisation.solve(f, r)) if f else [] for f, r in zip(factors, right, strict=True)
    ]
    accelerations: list[tuple] = [()] * len(motions)
    for limb, values in zip(limbs, flat, strict=True):
        for i in limb:
            count = len(motions[i].columns)
            accelerations[i], values = tuple(values[:count]), values[count:]
    return Solution(tuple(accelerations), multipliers)


def ancestry(system: System, link: int | None) -> list[int]:
    """Links from a link to its root, the link first."""
    if link is None:
        return []
    limb = next(limb for limb in system.topology.limbs if link in limb)
    chain = [link]
    while system.links[chain[-1]].parent >= 0:
        chain.append(limb[system.links[chain[-1]].parent])
    return chain


def jacobian_columns(
    system: System, motions: tuple[Motion, ...], link: int | None
) -> dict[int, Twist]:
    """Twist of a link for each free unit speed (by its index) that moves it, in the link's axes."""
    columns: dict[int, Twist] = {}
    for index in reversed(ancestry(system, link)):
        columns = {
            j: tree.carry_twist(motions[index].relative, twist) for j, twist in columns.items()
        }
        start = system.topology.branches[index].speeds.start
        columns |= {start + k: column for k, column in enumerate(motions[index].columns)}
    return columns


class ClosureRows(NamedTuple):
    """Rows of one closure that motion changes: their places in the closure, values, rates,
    Jacobian. `fixed`: values of those that no motion changes."""

    kept: list[int]
    values: tuple
    rates: tuple
    jacobian: list[dict[int, Any]]
    fixed: tuple


def relative_rows(
    system: System, motions: tuple[Motion, ...], closure: loops.Closure, pose: Pose, rates: Callable
) -> list[dict[int, Any]]:
    """Rows (by speed index) of what `rates` draws, linearly, from the closure's `pose`, relative
    velocity and spin.
    """
    rows: list[dict[int, Any]] = [{} for _ in rates(pose, sp.ZERO, sp.ZERO)]
    ends = ((closure.parent_link, closure.parent), (closure.child_link, closure.child))
    for side, (link, marker) in enumerate(ends):
        for j, column in jacobian_columns(system, motions, link).items():
            twist = loops.marker_twist(column, marker)
            pair = (twist, STILL) if side == 0 else (STILL, twist)
            for row, entry in zip(
                rows, rates(pose, *loops.relative_velocity(pose, *pair)), strict=True
            ):
                if not sp.is_zero(entry):
                    row[j] = sp.add(row.get(j, 0), entry)
    return rows


def closure_rows(
    system: System, motions: tuple[Motion, ...], closure: loops.Closure
) -> ClosureRows:
    """Residuals, rates and Jacobian (by speed index) of a closure's rows."""
    _, pose, relative = relative_motion(closure, motions)
    values = loops.residuals(closure.rows, pose)
    rates = loops.row_rates(closure.rows, pose, relative.velocity, relative.spin)
    jacobian = relative_rows(
        system, motions, closure, pose, lambda *own: loops.row_rates(closure.rows, *own)
    )
    kept = [i for i, row in enumerate(jacobian) if row or not sp.is_zero(rates[i])]
    fixed = tuple(
        value for i, value in enumerate(values) if i not in kept and not sp.is_zero(value)
    )
    return ClosureRows(
        kept, *[[part[i] for i in kept] for part in (values, rates, jacobian)], fixed
    )


def closure_targets(
    system: System, motions: tuple[Motion, ...], stabilisation: Baumgarte | None
) -> tuple[list, list]:
    """Jacobian rows of all closures (by speed index), and what each must give for the free
    accelerations.
    """
    ground = tuple(sp.neg(x) for x in system.gravity)
    accelerations = _accelerate(system, motions, None)
    rows: list[dict[int, Any]] = []
    wanted = []
    for closure in system.closures:
        found = closure_rows(system, motions, closure)
        view, pose, _ = relative_motion(closure, motions)
        # A marker on the ground shares the fictitious acceleration that stands for gravity.
        ends = [
            tree.carry_twist(
                marker, Twist(ground, sp.ZERO) if link is None else accelerations[link]
            )
            for link, marker in (
                (closure.parent_link, closure.parent),
                (closure.child_link, closure.child),
            )
        ]
        second = loops.row_accelerations(closure.rows, pose, view, *ends)
        for i, value, rate in zip(found.kept, found.values, found.rates, strict=True):
            target = sp.neg(second[i])
            if stabilisation is not None:
                target = sp.sub(target, sp.mul(2.0 * stabilisation.alpha, rate))
                target = sp.sub(target, sp.mul(stabilisation.beta * stabilisation.beta, value))
            wanted.append(target)
        rows.extend(found.jacobian)
    return rows, wanted


def _multipliers(system, rows, wanted, factors, free):
    """Solve J M^-1 J^T lambda = wanted - J a_free by limbs; returns lambda and J^T lambda per
    limb."""
    offsets, spans = 0, []
    for values in free:
        spans.append((offsets, offsets + len(values)))
        offsets += len(values)
    free_flat = [x for values in free for x in values]
    inverse_rows = []
    for row in rows:
        responses: dict[int, Any] = {}
        for (start, stop), factored in zip(spans, factors, strict=True):
            if any(start <= j < stop for j in row):
                column = tuple(row.get(j, 0) for j in range(start, stop))
                responses |= dict(
                    zip(range(start, stop), factorisation.solve(factored, column), strict=True)
                )
        inverse_rows.append(responses)
    schur = [
        [sp.total(sp.mul(a, other.get(j, 0)) for j, a in row.items()) for other in inverse_rows]
        for row in rows
    ]
    right = [
        sp.sub(target, sp.total(sp.mul(a, free_flat[j]) for j, a in row.items()))
        for row, target in zip(rows, wanted, strict=True)
    ]
    multipliers = factorisation.solve(factorisation.factor(schur), tuple(right))
    pulls = [0] * offsets
    for row, multiplier in zip(rows, multipliers, strict=True):
        for j, entry in row.items():
            pulls[j] = sp.add(pulls[j], sp.mul(entry, multiplier))
    return multipliers, [tuple(pulls[start:stop]) for start, stop in spans]


def _accelerate(
    system: System, motions: tuple[Motion, ...], accelerations: tuple | None
) -> tuple[Twist, ...]:
    """Spatial acceleration of every link, gravity's fictitious part included; None: for zero free
    accelerations.
    """
    ground = tuple(sp.neg(x) for x in system.gravity)
    out: list[Twist] = []
    for limb in system.topology.limbs:
        links, own = (tuple(part[i] for i in limb) for part in (system.links, motions))
        free = None if accelerations is None else tuple(accelerations[i] for i in limb)
        out.extend(tree.accelerate(links, own, free, ground))
    return tuple(out)


def joint_wrenches(system: System, forces: Forces, solution: Solution) -> tuple[Wrench, ...]:
    """Wrench that each link receives through its inboard joint (drive and coordinate loads
    included), in the link's frame.

    Multipliers of loop closures act as loads here.
    """
    wrenches = list(forces.wrenches)
    for closure, force, torque, pose in closure_wrenches(
        system, forces.motions, solution.multipliers
    ):
        add_pair(wrenches, closure, pose, force, torque)
    accelerations = _accelerate(system, forces.motions, solution.accelerations)
    out: list[Wrench] = []
    for limb in system.topology.limbs:
        parts = [
            tuple(part[i] for i in limb)
            for part in (system.links, forces.motions, accelerations, wrenches)
        ]
        out.extend(tree.transmit(*parts))
    return tuple(out)


def closure_wrenches(system: System, motions, multipliers: tuple):
    """(closure, force, torque, pose) on each closure's child about its marker, in the parent
    marker's axes.
    """
    position = 0
    for closure in system.closures:
        _, pose, _ = relative_motion(closure, motions)
        force, torque = sp.ZERO, sp.ZERO
        columns = sp.transpose(pose.rotation)
        for i in closure_rows(system, motions, closure).kept:
            row, multiplier = closure.rows[i], multipliers[position]
            axis = sp.IDENTITY[loops.AXIS[row[0]]]
            if len(row) == 1:
                force = sp.plus(force, sp.scale(multiplier, axis))
            else:
                torque = sp.plus(
                    torque, sp.scale(multiplier, sp.cross(columns[loops.AXIS[row[2]]], axis))
                )
            position += 1
        yield closure, force, torque, pose


def powers(system: System, forces: Forces, solution: Solution) -> list:
    """Rates of the energies of the balance, in the order of `state.ENERGIES`."""
    driven = 0
    wrenches = joint_wrenches(system, forces, solution)
    for index, link in enumerate(system.links):
        if drive_of(link.joint) is not None:
            driven = sp.add(
                driven, tree.work(_slide(system, forces.motions, index), wrenches[index])
            )
    reports = forces.reports.values()
    return [
        sp.add(driven, forces.external_power),
        sp.total(r.contact_power for r in reports),
        sp.total(r.contact_loss for r in reports),
        sp.total(r.friction_loss for r in reports),
        forces.damping_loss,
    ]


def _slide(system, motions, index):
    """Twist of a link relative to its parent link."""
    chain = ancestry(system, index)
    twist = motions[index].twist
    if len(chain) == 1:
        return twist
    inboard = tree.carry_twist(motions[index].relative, motions[chain[1]].twist)
    return Twist(sp.minus(twist.linear, inboard.linear), sp.minus(twist.angular, inboard.angular))


def mechanical_energy(system: System, forces: Forces) -> tuple[Any, Any]:
    """(kinetic energy, potential energy of gravity and springs) [J]; gravity's is zero at the
    ground's origin.
    """
    kinetic, potential = 0.0, forces.stored
    for link, motion in zip(system.links, forces.motions, strict=True):
        v, w = motion.twist
        kinetic = kinetic + 0.5 * (
            sp.add(sp.mul(link.mass, sp.dot(v, v)), sp.dot(w, sp.apply(link.inertia, w)))
            + sp.mul(2.0, sp.dot(v, sp.cross(w, link.moment)))
        )
        centre = sp.plus(
            sp.scale(link.mass, motion.pose.translation),
            sp.apply(motion.pose.rotation, link.moment),
        )
        potential = sp.sub(potential, sp.dot(system.gravity, centre))
    return kinetic, jnp.asarray(potential, float)
