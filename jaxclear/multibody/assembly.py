"""A consistent start: coordinates that close every loop, and speeds that keep it closed, from a
rough guess.

Gauss-Newton steps in the joints' own speeds, so rotations never leave their group; of many
solutions the one nearest the guess is taken. Journals start concentric in their bearings unless
asked otherwise. A loop that cannot be closed and a row that says nothing new are refused by name.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.components.clearance import AbstractPermanentJoint
from jaxclear.ground import factorisation
from jaxclear.ground import sparse as sp
from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import check_flags, expect
from jaxclear.ground.least_change import least_change
from jaxclear.ground.precision import check_double_precision
from jaxclear.multibody import constraints, kinematics
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.state import unpack_motion
from jaxclear.multibody.system import System, prepare

ITERATIONS = 30
# Largest change of a coordinate in one step [rad, m]: keeps the search on the branch of the guess.
LONGEST_STEP = 0.3
CLOSED = 1e-8


class Start(NamedTuple):
    """Consistent coordinates and speeds, and what is left of each closure (by name) [m, 1]."""

    coordinates: Float[Array, " q"]
    speeds: Float[Array, " v"]
    residuals: dict[str, Float[Array, " rows"]]
    jacobians: dict[str, Float[Array, "rows v"]]


def guess(mechanism: Mechanism) -> tuple[Array, Array]:
    """Coordinates and speeds from the mechanism's own rough start."""
    q: list[Any] = []
    v: list[Any] = []
    system = prepare(mechanism)
    for branch, link in zip(system.topology.branches, system.links, strict=True):
        if branch.coordinate_count:
            given = mechanism.start.get(branch.name)
            q.extend(link.joint.home if given is None else link.joint.start(given))
        v.extend(mechanism.speeds.get(branch.name, (0.0,) * branch.speed_count))
    return sp.stack(q), sp.stack(v)


def retract(system: System, q: Array, step: Array) -> Array:
    """Coordinates moved along speeds for unit time, quaternions renormalised."""
    parts: list[Any] = []
    own_q, own_step = unpack_motion(system, list(q) + list(step))
    for link, coordinates, move in zip(system.links, own_q, own_step, strict=True):
        if coordinates:
            parts.extend(link.joint.retracted(coordinates, move))
    return sp.stack(parts)


def named_closures(system: System, concentric: bool) -> dict[str, Any]:
    """Closures to satisfy at the start, by connection."""
    closures = dict(zip(system.topology.loops, system.closures, strict=True))
    return closures | (
        {name: b.closure for name, b in system.bearings.items()} if concentric else {}
    )


def _check_flat_bodies(mechanism: Mechanism, system: System, motions: tuple) -> None:
    """A body whose inertia is known about z only must turn about z only; what does not turn is
    known while tracing.
    """
    for branch, link, motion in zip(system.topology.branches, system.links, motions, strict=True):
        spin = sp.apply_transposed(link.frame.rotation, motion.twist.angular)
        if len(mechanism.bodies[branch.body].inertia) == 1 and not (
            sp.is_zero(spin[0]) and sp.is_zero(spin[1])
        ):
            raise ValueError(
                f'body "{branch.body}" has an inertia about its z axis only, but its joints let it '
                "turn about others; give "
                "3 or 6 numbers, or planar joints throughout (axes by name: numbers for an axis "
                "count as spatial)."
            )


def _rows(system, closures, q, v, time):
    """Residuals, rates and Jacobian of the closures, as arrays by name; last the residuals that no
    motion changes.
    """
    own_q, own_v = unpack_motion(system, list(q) + list(v))
    motions = kinematics.link_motions(system, own_q, own_v, time)
    out = {}
    for name, closure in closures.items():
        found = constraints.constraint_rows(system, motions, closure)
        rows = tuple(tuple(row.get(j, 0) for j in range(len(v))) for row in found.jacobian)
        jacobian = factorisation.to_array(rows).reshape(len(rows), len(v))
        out[name] = (
            sp.stack(found.residuals),
            sp.stack(found.rates),
            jacobian,
            sp.stack(found.fixed),
        )
    return out


def assemble_arrays(mechanism: Mechanism, concentric: bool = True, time: float = 0.0) -> Start:
    """The consistent start nearest the mechanism's guess; pure, so it maps and differentiates."""
    system = prepare(mechanism)
    closures = named_closures(system, concentric)
    q, v = guess(mechanism)
    _check_flat_bodies(
        mechanism,
        system,
        kinematics.link_motions(system, *unpack_motion(system, list(q) + list(v)), time),
    )
    if not closures or v.shape[0] == 0:
        return _started(q, v, _rows(system, closures, q, v, time))

    def stacked(q, v):
        rows = _rows(system, closures, q, v, time).values()
        return tuple(jnp.concatenate([row[i] for row in rows]) for i in range(3))

    def improve(q, _):
        residual, _, jacobian = stacked(q, jnp.zeros_like(v))
        step = -least_change(jacobian, residual, ones).change
        longest = jnp.maximum(jnp.max(jnp.abs(step)), LONGEST_STEP)
        step = step * (LONGEST_STEP / longest)
        return retract(system, q, step), None

    ones = jnp.ones_like(v)
    q, _ = jax.lax.scan(improve, q, length=ITERATIONS)
    for _ in range(2):
        _, rates, jacobian = stacked(q, v)
        v = v - least_change(jacobian, rates, ones).change
    return _started(q, v, _rows(system, closures, q, v, time))


def _started(q, v, rows) -> Start:
    residuals = {name: jnp.concatenate([found[0], found[3]]) for name, found in rows.items()}
    return Start(q, v, residuals, {name: found[2] for name, found in rows.items()})


assembled = eqx.filter_jit(assemble_arrays)


@answering
def assemble(mechanism: Mechanism, concentric: bool = True) -> Start:
    """Consistent start of a mechanism with numbers; refuses, by name, loops that do not close or
    say nothing new.

    `concentric=False` leaves clearance joints where the guess puts them and closes ideal loops
    only. Raises `ValueError`.
    """
    check_double_precision()
    expect(mechanism, Mechanism, "what is assembled", "a jaxclear.Mechanism")
    check_flags("assemble", concentric=concentric)
    start = assembled(mechanism, concentric)
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(start)):
        return start
    residuals = {
        name: np.abs(np.asarray(r)).max(initial=0.0) for name, r in start.residuals.items()
    }
    for name in mechanism.topology.loops:
        if not residuals[name] <= CLOSED:
            raise ValueError(
                f'the loop through joint "{name}" cannot be closed: {residuals[name]:.3g} m (or '
                "rad) remain after "
                f"{ITERATIONS} steps from the given start. Check the lengths around this loop, or "
                "give a better start="
                "{...} for the joints in it."
            )
    for name in mechanism.topology.clearances:
        if concentric and not residuals[name] <= CLOSED:
            raise ValueError(
                f'the journal of joint "{name}" cannot be brought to the middle of its bearing: '
                f"{residuals[name]:.3g} m "
                "(or rad) remain. Check the lengths, give a better start, or simulate with "
                "start_concentric=False."
            )
    _check_rank(mechanism, start)
    return start


def _check_rank(mechanism: Mechanism, start: Start) -> None:
    fitted = any(
        isinstance(connection.joint, AbstractPermanentJoint)
        for connection in mechanism.connections.values()
    )
    kept = np.zeros((0, len(start.speeds)))
    for name in mechanism.topology.loops:
        rows = np.asarray(start.jacobians[name])
        # A row that no motion changes; where joints always touch, those of the tree carry what it
        # would.
        superfluous = len(start.residuals[name]) > len(rows) and not fitted
        kept = np.vstack([kept, rows])
        dependent = np.linalg.matrix_rank(kept, tol=1e-9 * np.abs(kept).max(initial=1.0)) < len(
            kept
        )
        if superfluous or (dependent and not _singular_only_here(mechanism, start)):
            raise ValueError(
                f'the loop closed by joint "{name}" is overconstrained: one of its rows follows '
                "from the others, so its "
                "reaction is undetermined. For a planar mechanism give planar places (2 numbers) "
                "throughout; otherwise "
                "replace a revolute joint in this loop by a spherical, cylindrical or universal "
                "one."
            )
        if dependent:
            return


def _singular_only_here(mechanism: Mechanism, start: Start) -> bool:
    """True where the rows are independent at nearby coordinates: a singular position, not a
    superfluous joint.
    """
    system = prepare(mechanism)
    rng = np.random.default_rng(0)
    step = 1e-3 * rng.normal(size=start.speeds.shape)
    q = retract(system, start.coordinates, jnp.asarray(step))
    rows = _rows(system, named_closures(system, False), q, jnp.zeros_like(start.speeds), 0.0)
    jacobian = np.concatenate([np.asarray(r[2]) for r in rows.values()])
    return np.linalg.matrix_rank(jacobian, tol=1e-9 * np.abs(jacobian).max(initial=0.0)) == len(
        jacobian
    )
