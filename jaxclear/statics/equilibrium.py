r"""A mechanism at rest at coordinates of all its bodies: what acts along its freedoms, by how much
its loops are open, and how much room its journals have.

At rest the forces of loads and springs, of loops (multipliers :math:`\lambda`) and of contacts
(normal forces :math:`p`) balance along every free speed,

.. math:: f(q) + \Phi_q^T \lambda + g_q^T p = 0,\quad \Phi(q) = 0,\quad
          g(q) \ge 0,\ p \ge 0,\ g\,p = 0,

which is where the potential energy is least, if there is one, with loops closed and journals inside
their bearings. Gaps are those of the joints themselves, so every joint with clearance serves:
angular and axial play, several journals that share a load, and freedoms that loops leave need
nothing of their own. Friction, inertia and the indentation of contacts are left out.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.components.clearance import AbstractClearance
from jaxclear.formulations.permanent_reactions import Reaction
from jaxclear.ground import sparse as sp
from jaxclear.multibody import closure_coordinates, constraints, contact_point, kinematics
from jaxclear.multibody.forces import with_rows
from jaxclear.multibody.rows import Row, row_of_wrench
from jaxclear.multibody.start_constraints import speed_scales
from jaxclear.multibody.start_equations import retract
from jaxclear.multibody.state import unpack_motion
from jaxclear.multibody.system import System, longest_arm, prepare
from jaxclear.multibody.tree import Motion, Wrench
from jaxclear.native.compiled import compiled_quickly
from jaxclear.statics.quasi_static import Posed, acting, loop_rows, open_loops, reactions_of, unheld

# Of the slope [1] of a gap at the middle, beside 1: rounding.
LEVEL = 1e-9


class Terms(NamedTuple):
    """What is to be 0 at rest, without units (`Measures`): the `balance` of forces along the free
    speeds, the `loops`; and the `gaps` of all contacts, at least 0."""

    balance: Float[Array, " v"]
    loops: Float[Array, " rows"]
    gaps: Float[Array, " contacts"]


class Measures(NamedTuple):
    """What counts as 1: of each free speed that is held for unit time (1 rad, or the longest arm
    [m]), of loops [m, 1], of gaps the longest arm [m], of work the `energy` [J]."""

    speeds: Float[Array, " v"]
    loops: Float[Array, " rows"]
    arm: Any
    energy: Any

    def multipliers(self, closing: Array) -> Array:
        """Of rows of loops [N, N m]."""
        return closing * self.energy / self.loops

    def pushes(self, pushing: Array) -> Array:
        """Normal forces [N]."""
        return pushing * self.energy / self.arm


class Resting(NamedTuple):
    """A mechanism where it rests: as `quasi_static.Standing`, what is read of a position."""

    system: System
    motions: tuple[Motion, ...]
    reactions: dict[str, Reaction]


class Rounded(eqx.Module):
    """Which contacts of each joint have gaps that are largest, and level, in its middle, such as a
    round bore's: where their slope has no direction."""

    level: dict[str, tuple[bool, ...]] = eqx.field(static=True)

    def gaps(self, name: str, joint: AbstractClearance, depths: tuple) -> list:
        r"""The gaps [m] of a joint; those level in the middle as :math:`g - g^2 / 2 g_0`.

        That is :math:`(c^2 - e^2) / 2c` for a round bore: smooth in the middle, 0 at the wall with
        the same slope.

        Args:
            name: of the joint.
            joint: geometry of the clearance.
            depths: indentation of each possible contact [m].
        """
        middles = _overlaps_of(joint, jnp.zeros(6))
        out: list[Any] = []
        for level, depth, middle in zip(self.level[name], depths, middles, strict=True):
            gap = sp.neg(depth)
            out.append(gap + 0.5 * gap * gap / middle if level else gap)
        return out


def rounded(mechanism: Any) -> Rounded:
    """Of a mechanism with numbers."""
    levels = {}
    for name in mechanism.topology.clearances:
        steep, middle = _overlaps_at_middle(mechanism.connections[name].joint)
        levels[name] = tuple(map(bool, (np.asarray(steep) < LEVEL) & (np.asarray(middle) < 0)))
    return Rounded(levels)


@compiled_quickly
def _overlaps_at_middle(joint: AbstractClearance) -> tuple[Array, Array]:
    """Of each overlap in the middle the largest slope [1], and itself [m]."""
    overlaps, middle = lambda place: jnp.stack(_overlaps_of(joint, place)), jnp.zeros(6)
    return jnp.abs(jax.jacfwd(overlaps)(middle)).max(axis=1), overlaps(middle)


def _overlaps_of(joint: AbstractClearance, place: Array) -> list:
    """Indentations [m] of a joint whose journal is moved from the middle and leant, to first order,
    by three numbers each."""
    offset, lean = tuple(place[:3]), tuple(place[3:])
    axes = tuple(sp.plus(sp.cross(lean, sp.IDENTITY[k]), sp.IDENTITY[k]) for k in joint.axes)
    axes = tuple(tuple(jnp.asarray(x, float) for x in axis) for axis in axes)
    return [jnp.asarray(x, float) for x in joint.indentations(offset, axes, {})]


class Case(NamedTuple):
    """A mechanism whose drives hold their joints, ready: which way its loads act (`side`), near
    which angles coordinates outside the tree are read, and how its gaps are rounded."""

    system: System
    side: Any
    angles: dict[str, Any]
    rounded: Rounded


def case_of(scene: Posed, side: Any, angles: dict[str, Any], how: Rounded) -> Case:
    """The prepared mechanism of a scene with the side of its loads.

    Args:
        scene: mechanism with positions of its drives.
        side: 1, or -1 for reversed loads.
        angles: [rad] near which coordinates outside the tree are read, by joint.
        how: which gaps are rounded in the middle.
    """
    return Case(prepare(scene.mechanism), side, angles, how)


def _motions_at_rest(system: System, q: Array) -> tuple[tuple, tuple[Motion, ...]]:
    """Coordinates by link, and the motion of every link at rest."""
    still = (0,) * system.topology.speed_count
    places, rates = unpack_motion(system, [*q, *still])
    return places, kinematics.link_motions(system, places, rates, 0.0)


def work(case: Case, q: Array) -> Float[Array, " v"]:
    """Forces of loads and springs along the free speeds [N m, N]."""
    motions = _motions_at_rest(case.system, q)[1]
    system, forces = acting(case.system, motions, case.side, case.angles)
    return -sp.stack(unheld(system, forces))


def restraints(case: Case, q: Array) -> tuple[Array, Array]:
    """What is left of the loops' closure [m, 1], and the gaps of all contacts [m]."""
    system = case.system
    motions = _motions_at_rest(system, q)[1]
    rows = [rows_of.residuals for rows_of in loop_rows(system, motions)]
    gaps: list[Any] = []
    for name, bearing in system.bearings.items():
        pose = kinematics.relative_motion(bearing.closure, motions)[1]
        depths = contact_point.depths(bearing.joint, pose, {})
        gaps += case.rounded.gaps(name, bearing.joint, depths)
    return sp.stack([x for rows_of in rows for x in rows_of]), sp.stack(gaps)


def terms(case: Case, measures: Measures, q: Array, closing: Array, pushing: Array) -> Terms:
    """Dimensionless residuals of the equilibrium: balance of forces, loops, gaps.

    Args:
        case: mechanism and side of its loads.
        measures: scales of speeds, loops, energy and lengths.
        q: coordinates of the tree, shape (coordinates,).
        closing: multipliers of the loops, dimensionless.
        pushing: normal forces at the gaps, dimensionless.
    """

    def at_step(step):
        loops, gaps = restraints(case, retract(case.system, q, measures.speeds * step))
        return loops / measures.loops, gaps / measures.arm

    (loops, gaps), along = jax.vjp(at_step, jnp.zeros(len(measures.speeds)))
    (pushes,) = along((closing, pushing))
    return Terms(work(case, q) * measures.speeds / measures.energy + pushes, loops, gaps)


def measures_of(case: Case, q: Array) -> Measures:
    """Measures at coordinates; of work what all weights do over the longest arm, and the most that
    a force there does over a radian or that arm, or a spring over the play beside it; 1 where
    nothing acts."""
    system = case.system
    arm = jax.lax.stop_gradient(longest_arm(system))
    speeds = speed_scales(system, arm)
    motions = _motions_at_rest(system, q)[1]
    each = zip(system.closures, loop_rows(system, motions), strict=True)
    units = [x for closure, u in each for x in constraints.measures(closure, u, arm)]
    rooms = _gaps_in_middle(case)
    # There, and a play away along every freedom; a radian where there is none.
    play = jnp.max(rooms, initial=0.0, where=rooms > 0) / arm if len(rooms) else 1.0
    both = jnp.array([0.0, 1.0])[:, None] * play * speeds
    there, changed = jax.vmap(lambda step: work(case, retract(system, q, step)) * speeds)(both)
    weight = sum(link.mass for link in system.links) * sp.norm(system.gravity)
    energy = weight * arm + jnp.max(jnp.abs(there), initial=0.0)
    energy = energy + jnp.max(jnp.abs(changed - there), initial=0.0)
    energy = jax.lax.stop_gradient(jnp.where(energy > 0, energy, 1.0))
    return Measures(speeds, jax.lax.stop_gradient(sp.stack(units)), arm, energy)


def _gaps_in_middle(case: Case) -> Array:
    """Gaps of all contacts [m] in the middle of their joints."""
    joints = [bearing.joint for bearing in case.system.bearings.values()]
    return -sp.stack([depth for joint in joints for depth in _overlaps_at_middle(joint)])


def play(case: Case, measures: Measures) -> Any:
    """The least play of a journal, beside the longest arm; 1 where there is none."""
    rooms = jax.lax.stop_gradient(_gaps_in_middle(case)) / measures.arm
    return jnp.min(rooms, initial=1.0, where=rooms > 0)


def angles_near(case: Case, q: Array) -> dict[str, Any]:
    """Angles [rad] of joints outside the tree on which loads act, near those of the case."""
    motions = _motions_at_rest(case.system, q)[1]
    return {
        name: closure_coordinates.read(case.system, name, motions, near).position
        for name, near in case.angles.items()
    }


def rest_at(case: Case, q: Array, multipliers: Array, pushes: Array) -> Resting:
    """The mechanism at rest, with the reaction of every joint.

    Reactions are on the joint's child about its marker, in the parent marker's axes.

    Args:
        case: mechanism and side of its loads.
        q: coordinates of the tree at rest, shape (coordinates,).
        multipliers: of the loops [N, N m].
        pushes: normal force [N] at each gap, joint after joint.
    """
    places, motions = _motions_at_rest(case.system, q)
    system, forces = acting(case.system, motions, case.side, case.angles)
    contacts, first = list[Row](), 0
    for name, bearing in system.bearings.items():
        pose = kinematics.relative_motion(bearing.closure, motions)[1]
        gaps = contact_point.gap_function(bearing.joint, pose, {})
        axes = tuple(sp.transpose(pose.rotation)[k] for k in bearing.joint.axes)
        force, torque = sp.ZERO, sp.ZERO
        for contact, push in zip(gaps, pushes[first : first + len(gaps)], strict=True):
            force = sp.plus(force, sp.scale(-push, contact.slope))
            turns = zip(axes, contact.axis_slopes, strict=True)
            torque = sp.plus(torque, *(sp.scale(-push, sp.cross(a, turn)) for a, turn in turns))
        first += len(gaps)
        contacts.append(row_of_wrench(name, bearing.closure, pose, Wrench(force, torque), name))
    forces = with_rows(forces, contacts)
    reactions = reactions_of(system, forces, tuple(multipliers), places)
    return Resting(system, motions, reactions)


def journal_offsets(case: Case, q: Array) -> dict[str, Array]:
    """Where each journal lies: offset (x, y, z) [m] and slope (dx/dz, dy/dz) of its axis [1]."""
    motions = _motions_at_rest(case.system, q)[1]
    out = {}
    for name, bearing in case.system.bearings.items():
        pose = kinematics.relative_motion(bearing.closure, motions)[1]
        axis = sp.transpose(pose.rotation)[2]
        slope = [sp.mul(1 / jnp.asarray(axis[2], float), x) for x in axis[:2]]
        out[name] = sp.stack([*pose.translation, *slope])
    return out


def list_residuals(case: Case, q: Array) -> tuple[dict[str, Any], dict[str, Any]]:
    """By how much each loop is open [m, 1], by the joint that closes it, and how deep each journal
    lies in its bearing [m]."""
    motions = _motions_at_rest(case.system, q)[1]
    deep = {}
    for name, bearing in case.system.bearings.items():
        pose = kinematics.relative_motion(bearing.closure, motions)[1]
        deep[name] = jnp.max(sp.stack(contact_point.depths(bearing.joint, pose, {})))
    return open_loops(case.system, motions), deep


class Carried(eqx.Module):
    """What holds a mechanism at each of its positions, where energy says where it rests: as in
    `simulation.least_energy.Rest`, with positions first."""

    closing: Float[Array, "positions rows"]
    pushes: Float[Array, "positions contacts"]
    angles: dict[str, Array]
    loose: Float[Array, "positions v"]
    split: Array
    rounded: Rounded
    side: Any
