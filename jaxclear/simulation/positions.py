"""A mechanism over positions of its drives, without time: `positions`.

Each position is sought from where its neighbour stood, by its loops (`spot`) or its energy
(`least_energy`); the first are reached in steps, on one way of assembly (`position_path`).
"""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.formulations.quasi_static import Posed
from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import check_flags, expect
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.wording import described
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.results.positions import Positions
from jaxclear.simulation.position_path import sought


def positions_at(
    scene: Posed, position: Float[Array, "positions drives"], starts: Any, way: Any
) -> Positions:
    """The mechanism at positions of its drives, each from its own start; pure."""
    spots = way.each(scene, position, starts)
    found = way.read(scene, position, spots)
    finite = jnp.all(jnp.isfinite(spots.q), axis=-1)
    # From where the nominal mechanism stands a sample may fall to another way of assembly.
    kept = found.found & finite & (spots.branch == starts.branch)
    return eqx.tree_at(lambda own: own.found, found, kept)


def checked_positions(positions: Any) -> tuple[tuple[str, ...], np.ndarray]:
    """Joints that are held, and their coordinates (positions, joints) [rad, m]."""
    expect(positions, Mapping, "positions", "a dictionary from joints to their coordinates")
    columns = {}
    for name, values in positions.items():
        try:
            column = np.asarray(values, float)
        except (TypeError, ValueError):
            column = np.full((), np.nan)
        if column.ndim != 1 or not len(column) or not np.all(np.isfinite(column)):
            raise ValueError(
                f'positions of joint "{name}" are {described(values)}; they must be finite numbers '
                "in a row [rad, m]."
            )
        columns[name] = column
    if not columns:
        return (), np.zeros((1, 0))
    if len({len(column) for column in columns.values()}) > 1:
        raise ValueError("positions must tell as many coordinates of each joint as of the others.")
    return tuple(columns), np.stack(list(columns.values()), axis=1)


@answering
def positions(
    mechanism: Mechanism, positions: Mapping[str, Any], *, both_ways: bool = False
) -> Positions:
    """A mechanism at rest at positions of its drives, without time.

    `positions`: coordinates [rad, m] by joint, as many of each; every drive must be among them. {}
    for a mechanism without drives, which then stands once. `start` and `guess` of the mechanism
    choose between ways to assemble. Loads are quasi-static, as at 0 s; they act without friction
    and inertia, and contacts are rigid. `both_ways`: also under reversed loads (`.reversed`), for
    lost motion; springs and stops stay as they are.

    Where the loops determine everything else each journal lies where its own reaction presses it.
    Elsewhere (springs, freedoms that are left, journals that share a load, play in angle) the
    mechanism rests where its potential energy is least: near the start, from one position to the
    next. What nothing holds is named by `warnings` of the result. Raises `ValueError` with a
    sentence for what cannot be asked or is out of reach.
    """
    check_double_precision()
    expect(mechanism, Mechanism, "what is positioned", "a jaxclear.Mechanism")
    check_flags("positions", both_ways=both_ways)
    held, places = checked_positions(positions)
    scene, way, starts = sought(mechanism, held, places)
    return both(scene, jnp.asarray(places), starts, way, both_ways)


def both(scene: Posed, places: Array, starts: Any, way: Any, both_ways: bool) -> Positions:
    """The positions, with those under reversed loads where these are wanted."""
    found = positions_at(scene, places, starts, way)
    if not both_ways:
        return found
    other = positions_at(scene, places, starts, way.reversed)
    return eqx.tree_at(lambda p: p.other, found, other, is_leaf=lambda x: x is None)
