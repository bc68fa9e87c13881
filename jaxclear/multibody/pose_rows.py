"""Rows of a closure that are functions of the relative pose of its two markers: any residual, whose
rates, accelerations and wrench follow by differentiation.

A row's gradient is a wrench W on the child about its marker, in the parent marker's axes: the rate
of the residual is the power of W along the relative motion, and a multiplier times W is the row's
reaction. What is structurally zero in a pose does not move, so rows are differentiated by the
other entries only; a row that depends on none of them is dropped as others are.
"""

import functools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Literal

from jaxclear.components.joint import AbstractJoint
from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import Pose

# For a turn about an axis the two others, in order.
OTHERS = {"turn x": (1, 2), "turn y": (2, 0), "turn z": (0, 1)}


class CoordinateOf(eqx.Module):
    """Reads the single coordinate [rad, m] of a joint off the relative pose of its markers."""

    joint: AbstractJoint

    def residuals(self, pose: Pose) -> tuple:
        return self.joint.coordinates_at(pose)


# The rows of text that a joint may state.
STATED = ("x", "y", "z", *(f"{a}.{b}" for a in "xyz" for b in "xyz"))


class BeyondMotion(eqx.Module):
    """What a pose T departs from the own motion of a joint, E = motion(q(T))^-1 T: displacements
    along the child's axes [m] and turns about them [rad], those named in `rows`."""

    joint: AbstractJoint
    rows: tuple[str, ...] = eqx.field(static=True)

    def residuals(self, pose: Pose) -> tuple:
        rotation, translation = departure_from_motion(self.joint, pose)
        return tuple(
            translation["xyz".index(row)] if len(row) == 1 else _turn(rotation, *OTHERS[row])
            for row in self.rows
        )


def closing_rows(joint: AbstractJoint) -> tuple[str, ...]:
    """The rows by which a joint closes a loop: those that it states, else as many of the six ways
    in which a pose may depart from its motion as it leaves no speeds for.

    Which ways these are its motion at home tells, with any numbers in the place of its own, so that
    they are those of its class. Raises `ValueError`, with a sentence that goes behind the joint's
    name.
    """
    if joint.rows is not None:
        return joint.rows
    leaves, form = jax.tree.flatten(joint)
    with jax.ensure_compile_time_eval():
        return _choose_directions(form, tuple(x.shape if eqx.is_array(x) else x for x in leaves))


# Ways in which a pose may depart from a motion, in the order of a twist.
DIRECTIONS = ("x", "y", "z", "turn x", "turn y", "turn z")
# Beside the largest: what is left of a way that says no more than others is rounding.
NOTHING_NEW = 1e-9


@functools.cache
def _choose_directions(form: Any, leaves: tuple) -> tuple[str, ...]:
    from scipy.linalg import qr

    # No two numbers alike, and none 0 or 1.
    joint = jax.tree.unflatten(
        form,
        [
            jnp.asarray(0.3 + 0.7 / (2 + i) + 0.01 * np.arange(np.prod(x, dtype=int)).reshape(x))
            if isinstance(x, tuple)
            else x
            for i, x in enumerate(leaves)
        ],
    )
    fixed = 6 - len(joint.columns(joint.home))
    home = joint.motion(tuple(jnp.asarray(x, float) for x in joint.home))
    pose = Pose(
        tuple(tuple(jnp.asarray(x, float) for x in row) for row in home.rotation),
        tuple(jnp.asarray(x, float) for x in home.translation),
    )
    slopes = gradients(BeyondMotion(joint, DIRECTIONS), pose)[1]
    matrix = np.array([[float(x) for part in s.wrench(pose) for x in part] for s in slopes])
    _, sizes, order = qr(matrix.T, pivoting=True)
    sizes = np.abs(np.diag(sizes))
    rank = int(np.sum(sizes > NOTHING_NEW * max(sizes[0], NOTHING_NEW)))
    if not np.all(np.isfinite(matrix)) or rank != fixed:
        raise ValueError(
            f"holds {rank} of the six freedoms of a body by its motion at home and leaves "
            f"{6 - fixed} by its columns; the two must add to 6. See that coordinates_at is the "
            "inverse of motion, or state the joint's rows."
        )
    return tuple(sorted((DIRECTIONS[i] for i in order[:fixed]), key=DIRECTIONS.index))


def departure_from_motion(joint: AbstractJoint, pose: Pose) -> Pose:
    """What a pose departs from the motion of a joint, in the axes of the child."""
    return joint.motion(joint.coordinates_at(pose)).inverse().after(pose)


def reading_of(joint: AbstractJoint) -> BeyondMotion | None:
    """What reads the rows of a joint that closes a loop; None where they say it themselves."""
    return None if joint.rows is not None else BeyondMotion(joint, closing_rows(joint))


def check_rows(name: str, joint: AbstractJoint) -> None:
    """Raises `ValueError` where what a joint holds and what it leaves free do not make six."""
    kind = type(joint).__name__
    if joint.rows is None:
        try:
            closing_rows(joint)
        except ValueError as error:
            raise ValueError(f'joint "{name}", a {kind}, {error}') from None
        return
    unknown = [row for row in joint.rows if row not in STATED]
    if unknown:
        raise ValueError(
            f'joint "{name}", a {kind}, states the row {unknown[0]!r}; rows are "x", "y", "z", or '
            'two axes such as "x.z". State none, and they follow from its motion.'
        )
    rows, free = len(joint.rows), len(joint.columns(joint.home))
    if rows + free != 6:
        raise ValueError(
            f'joint "{name}", a {kind}, holds {rows} of the six freedoms of a body by its rows and '
            f"leaves {free} by its columns; the two must add to 6. State no rows, and they follow "
            "from its motion."
        )


def _turn(rotation: sp.Mat, i: int, j: int) -> Any:
    """Angle [rad] of a rotation about the axis that lies across the axes i and j."""
    sine = sp.sub(rotation[j][i], rotation[i][j])
    if sp.is_zero(sine):
        return 0
    cosine = jnp.asarray(sp.add(rotation[i][i], rotation[j][j]), float)
    # Half a turn about another axis has no angle about this one.
    none = (sine == 0) & (cosine == 0)
    return jnp.arctan2(sine, jnp.where(none, 1.0, cosine))


class Gradient(NamedTuple):
    """Derivative of a row by the entries of the pose: those of the rotation, by column, and of the
    translation; zero where structurally so."""

    columns: sp.Mat
    translation: sp.Vec

    def wrench(self, pose: Pose) -> tuple[sp.Vec, sp.Vec]:
        """(force [N], torque [N m]) of a multiplier 1."""
        axes = sp.transpose(pose.rotation)
        arms = [sp.cross(axis, column) for axis, column in zip(axes, self.columns, strict=True)]
        return self.translation, sp.plus(*arms)


def gradients(reading: Any, pose: Pose) -> tuple[tuple, list[Gradient]]:
    """(residuals, gradient of each) of what reads a pose."""
    entries = _entries_of_pose(pose)
    free = [i for i, x in enumerate(entries) if not isinstance(x, int)]
    read, kinds = _restrict_to_entries(reading, entries, free)
    if not free:
        return tuple(kinds), [Gradient((sp.ZERO,) * 3, sp.ZERO) for _ in kinds]
    values, pull = jax.vjp(read, *(entries[i] for i in free))
    moving = [i for i, structural in enumerate(kinds) if structural is None]
    depend = _dependence_of_results(read, [entries[i] for i in free])
    result: list[Gradient] = [Gradient((sp.ZERO,) * 3, sp.ZERO) for _ in kinds]
    for k, i in enumerate(moving):
        slopes: list[Any] = [0] * len(entries)
        seed = tuple(jnp.full_like(x, float(j == k)) for j, x in enumerate(values))
        for j, (place, slope) in enumerate(zip(free, pull(seed), strict=True)):
            slopes[place] = slope if j in depend[k] else 0
        rows = [tuple(slopes[3 * r : 3 * r + 3]) for r in range(3)]
        result[i] = Gradient(sp.transpose(tuple(rows)), tuple(slopes[9:]))
    plain = iter(values)
    return tuple(next(plain) if kind is None else kind for kind in kinds), result


def rate(gradient: Gradient, pose: Pose, velocity: sp.Vec, spin: sp.Vec) -> Any:
    """Rate of a row for a relative velocity and spin.

    Args:
        gradient: of the row by the pose.
        pose: the child's marker in the parent's.
        velocity, spin: of the child as seen from the parent, in its axes [m/s, rad/s].
    """
    force, torque = gradient.wrench(pose)
    return sp.add(sp.dot(force, velocity), sp.dot(torque, spin))


def accelerations(
    reading: Any,
    pose: Pose,
    slopes: list[Gradient],
    motion: tuple[sp.Vec, sp.Vec],
    second: tuple[sp.Vec, sp.Vec],
) -> tuple:
    """Second derivative of each row, by differentiating its reading twice along the motion.

    Args:
        reading: function of the pose that gives the residuals.
        pose: the child's marker in the parent's.
        slopes: gradients of all rows at this pose.
        motion: relative velocity and spin, as seen from the moving parent [m/s, rad/s].
        second: rates of the two [m/s2, rad/s2].
    """
    (velocity, spin), (linear, angular) = motion, second
    swings = [sp.cross(spin, axis) for axis in sp.transpose(pose.rotation)]
    rates = (*[x for row in sp.transpose(tuple(swings)) for x in row], *velocity)
    entries = _entries_of_pose(pose)
    moving = [
        i for i, x in enumerate(entries) if not isinstance(x, int) and not sp.is_zero(rates[i])
    ]
    bends: list[Any] = [0] * len(slopes)
    if moving:
        read, kinds = _restrict_to_entries(reading, entries, moving)
        along = tuple(jnp.asarray(rates[i], float) for i in moving)
        single = lambda *part: jax.jvp(read, part, along)[1]
        twice = iter(jax.jvp(single, tuple(entries[i] for i in moving), along)[1])
        bends = [next(twice) if kind is None else 0 for kind in kinds]
    out = []
    for slope, bend in zip(slopes, bends, strict=True):
        wheeled = [sp.dot(sp.cross(spin, t), g) for t, g in zip(swings, slope.columns, strict=True)]
        out.append(sp.total((bend, rate(slope, pose, linear, angular), *wheeled)))
    return tuple(out)


def _entries_of_pose(pose: Pose) -> tuple:
    return (*[x for row in pose.rotation for x in row], *pose.translation)


def _restrict_to_entries(reading: Any, entries: tuple, free: list[int]) -> tuple[Callable, list]:
    """(the residuals that are no structural numbers as a function of the free entries of a pose,
    for each residual the structural number that it is, None for none)."""
    kinds: list[Any] = []

    def read(*part):
        total = list(entries)
        for i, x in zip(free, part, strict=True):
            total[i] = x
        pose = Pose(tuple(tuple(total[3 * r : 3 * r + 3]) for r in range(3)), tuple(total[9:]))
        result = reading.residuals(pose)
        kinds[:] = [x if isinstance(x, int) else None for x in result]
        return tuple(jnp.asarray(x, float) for x in result if not isinstance(x, int))

    jax.eval_shape(read, *(entries[i] for i in free))
    return read, kinds


def _dependence_of_results(read: Callable, values: list) -> list[set[int]]:
    """For each result of a function the numbers of the arguments on which it depends."""
    program = jax.make_jaxpr(read)(*values).jaxpr
    on: dict[Any, set[int]] = {variable: {i} for i, variable in enumerate(program.invars)}

    def of(atoms) -> Iterator[int]:
        for atom in atoms:
            if not isinstance(atom, Literal):
                yield from on.get(atom, ())

    for equation in program.eqns:
        result = set(of(equation.invars))
        on |= dict.fromkeys(equation.outvars, result)
    return [set(of([variable])) for variable in program.outvars]
