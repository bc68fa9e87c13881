"""A mechanism over positions of its drives, without time: `positions`.

Each position is sought from where its neighbour stood, by the loops and seats where these determine
it (`quasi_static`), else by the potential energy (`least_energy`); the first ones are reached in
steps, on the way of assembly on which they began.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground import factorisation
from jaxclear.ground import sparse as sp
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_flags, expect
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.quantity import is_traced, with_quantities
from jaxclear.ground.wording import described
from jaxclear.multibody import constraints
from jaxclear.multibody.assembly import nearest, ready
from jaxclear.multibody.mechanism import Mechanism, check_mechanism
from jaxclear.multibody.redundancy import DEPENDENT, is_new, rank_of
from jaxclear.multibody.start_check import EXACT
from jaxclear.multibody.start_constraints import speed_scales
from jaxclear.multibody.system import longest_arm, prepare
from jaxclear.native.compiled import compiled_quickly
from jaxclear.statics import least_energy
from jaxclear.statics.least_energy import ByEnergy, Rest
from jaxclear.statics.positions import Positions
from jaxclear.statics.quasi_static import (
    SETTLED,
    ByLoops,
    Posed,
    Spot,
    Undetermined,
    loop_method,
    loop_rows,
    moved_by,
    open_loops,
    posed,
    residuals_of,
    standing_motion,
)

# Steps from a position to the next, at the least and at the most: they are halved where coordinates
# move by more than the first bound within one, or the way of assembly changes and they move by more
# than the second [rad, shares of the longest arm]. What moves further, however short the step, has
# jumped: a mechanism follows its drive without jumps, but for the root of what is left to a dead
# point.
STEPS_BETWEEN, MOST_BETWEEN = 4, 256
FURTHEST, FURTHEST_ACROSS = 0.3, 0.06


# Rows that a clearance joint closes as its play vanishes, in the order of a seat's numbers.
PLACES = ("x", "y", "z", "x.z", "y.z")


class Sought(NamedTuple):
    """A mechanism whose positions are sought, how, and where it stands at each of them."""

    scene: Posed
    method: ByLoops | ByEnergy
    spots: Spot | Rest


def sought(mechanism: Mechanism, drives: tuple[str, ...], position: np.ndarray) -> Sought:
    """Where a mechanism stands at each position of its drives, and by which method.

    By its loops where they determine it, with every journal where its own reaction presses it;
    otherwise by its energy.

    Args:
        mechanism: under its loads.
        drives: joints and motors that are held.
        position: their positions, shape (positions, drives) [rad, m].

    Raises:
        ValueError: for what has no equilibrium, and for the first position that is not reached.
    """
    scene, method = _by_loops(mechanism, drives, position[0])
    if method is not None:
        spots = spots_along(scene, position, method)
        _check_closed(scene, position, spots.q, lambda i: method.opened(_take_at(spots.seats, i)))
        return Sought(scene, method, spots)
    scene = posed(mechanism, drives, loose=True)
    if is_traced((scene, jnp.zeros(1))):
        raise ValueError(
            "where a mechanism rests by its energy is sought with numbers and cannot be traced: "
            "ask a jaxclear.PositionProblem, which is differentiated and batched."
        )
    start, by_energy = least_energy.initial_rest(scene.at(position[0]))
    spots = spots_along(scene, position, by_energy, start)
    _check_closed(scene, position, spots.q, lambda i: {})
    return Sought(scene, by_energy, spots)


def _take_at(spots: Any, i: int) -> Any:
    return jax.tree.map(lambda x: x[i], spots)


def _check_closed(scene: Posed, position: np.ndarray, q: Array, seats: Callable) -> None:
    """Raises `ValueError` where positions, or couplings, contradict each other in rows of loops
    that were not asked."""
    rows = loop_rows(*standing_motion(scene.at(position[0]), q[0], seats(0)))
    if scene.rows is None and not any(row.fixed for row in rows):
        return
    for i, now in enumerate(position):
        system, motions = standing_motion(scene.at(now), q[i], seats(i))
        residuals = open_loops(system, motions)
        worst = max(residuals, key=lambda name: float(residuals[name]))
        if float(residuals[worst]) > EXACT * max(1.0, float(longest_arm(system))):
            raise ValueError(
                f'{_named(scene, now)} leaves "{worst}" open by {float(residuals[worst]):.3g} m '
                "(or rad): what is held, joints and couplings contradict each other there. Leave "
                "one of them out."
            )


def _by_loops(mechanism: Mechanism, drives: tuple[str, ...], first: np.ndarray) -> tuple[Any, Any]:
    """The scene, and how it is sought by its loops; None where these do not determine it."""
    try:
        scene = posed(mechanism, drives)
    except ValueError:
        # A joint of which it is not known where a load presses it; what is wrong with the question
        # is refused by `sought`.
        return None, None
    here = scene.at(first)
    middle: dict[str, tuple[int, ...]] = dict.fromkeys(scene.gaps, ())
    free = scene.mechanism.topology.speed_count
    places = jnp.zeros(scene.mechanism.topology.coordinate_count)
    rows = len(jax.eval_shape(lambda q: _loops(here, q, ByLoops(middle).opened({}))[0], places))
    if rows < free:
        return None, None
    if rows != free:
        return _choose_rows(scene, here, free)
    try:
        method = loop_method(scene)
    except Undetermined:
        # Leaning journals let rows speak that say nothing in the plane.
        return None, None
    return (
        (scene, method)
        if rank_of(np.asarray(_assemble_spot(here, method)[2])) == free
        else (None, None)
    )


def _choose_rows(scene: Posed, here: Posed, free: int) -> tuple[Any, Any]:
    """The scene with as many independent rows as there are free coordinates, and how it is sought;
    None where there are not, or where others do not follow as journals lie in their seats."""
    try:
        q = ready(here.mechanism).start.coordinates
    except ValueError:
        return None, None
    method, before = ByLoops(dict.fromkeys(scene.gaps, ())), None
    while method != before:
        rows = np.asarray(_loop_slopes(here, q, method)[0])
        if rank_of(rows) != free:
            return None, None
        chosen = tuple(i for i, new in enumerate(is_new(rows)) if new)
        scene = dataclasses.replace(scene, rows=chosen)
        method, before = moved_by(scene, method), method
    anywhere = {n: tuple(map(PLACES.index, gap.ideal_rows)) for n, gap in scene.gaps.items()}
    every, shifts = map(np.asarray, _loop_slopes(here, q, ByLoops(anywhere)))
    if len(every) != len(rows):
        return None, None
    residual = shifts - rows @ np.linalg.lstsq(rows, shifts, rcond=DEPENDENT)[0]
    return (scene, method) if np.abs(residual).max(initial=0.0) <= DEPENDENT else (None, None)


def _loops(scene: Posed, q: Array, seats: dict[str, tuple]) -> tuple[Array, Array]:
    """Jacobian of all rows of loops (rows, v), and what counts as much as a radian in each."""
    system, motions = standing_motion(scene, q, seats)
    loops, count, arm = loop_rows(system, motions), system.topology.speed_count, longest_arm(system)
    rows = tuple(tuple(x.get(j, 0) for j in range(count)) for loop in loops for x in loop.jacobian)
    each = zip(system.closures, loops, strict=True)
    units = [x for closure, loop in each for x in constraints.measures(closure, loop, arm)]
    dense = factorisation.to_array(rows).reshape(len(rows), count)
    return dense * speed_scales(system, arm), sp.stack(units)


@compiled_quickly
def _loop_slopes(scene: Posed, q: Array, method: ByLoops) -> tuple[Array, Array]:
    """How rows of loops change with coordinates and with the seats of journals in the middle, in
    shares of a radian or the longest arm."""
    rows, units = _loops(scene, q, method.opened(method.middle()))
    arm = longest_arm(prepare(scene.mechanism))
    residual = lambda seats: sp.stack(residuals_of(scene, q, method.opened(seats)))
    middle = method.middle()
    shifts = jax.jacfwd(residual)(middle) if jax.tree.leaves(middle) else middle
    sizes = {
        n: jnp.stack([arm if k < 3 else jnp.ones(()) for k in x])
        for n, x in method.moving.items()
        if x
    }
    none = jnp.zeros((len(units), 0))
    every = jnp.concatenate([none, *(shifts[n] * size for n, size in sizes.items())], axis=1)
    return rows / units[:, None], every / units[:, None]


def _assemble_spot(scene: Posed, method: ByLoops) -> tuple[Spot, Any, Any]:
    start = nearest(scene.mechanism)
    spot = Spot(start.start.coordinates, method.middle(), jnp.zeros(()), jnp.zeros(()))
    system = prepare(scene.mechanism)
    none = jnp.zeros((0, system.topology.speed_count))
    rows = jnp.concatenate([none, *start.start.jacobians.values()])
    return spot, start.sound, rows * speed_scales(system, longest_arm(system))


def _lead(scene: Posed, start: Any, before: np.ndarray, now: np.ndarray, method: Any) -> Any:
    """The spot at the next position, led there in steps that are halved where it moves far. Raises
    `ValueError` where it jumps, however short the steps: the sign of the loops' determinant tells
    two ways of assembly apart, and spatial loops may have more of one sign."""
    scale, spot = _coordinate_scales(scene), start
    share, size = 0.0, 1.0 / STEPS_BETWEEN
    while share < 1.0:
        result = method.alone(scene.at(before + (share + size) * (now - before)), spot)
        moved = float(np.max(np.abs(result.q - spot.q) / scale, initial=0.0))
        settled = bool(result.change <= SETTLED)
        same = bool(result.branch == spot.branch)
        if settled and moved <= (FURTHEST if same else FURTHEST_ACROSS):
            spot, share = result, share + size
            # Twice as long again where the longer step begins at a multiple of itself.
            size *= 2.0 if size < 1.0 / STEPS_BETWEEN and share % (2.0 * size) == 0.0 else 1.0
        elif size > 1.0 / MOST_BETWEEN:
            size *= 0.5
        elif settled:
            _refuse_jump(scene, now)
        else:
            return result
    return spot


def _coordinate_scales(scene: Posed) -> np.ndarray:
    """What each coordinate's moves are measured by, (coordinates,): the longest arm for lengths
    [m], 1 for angles."""
    system, topology = prepare(scene.mechanism), scene.mechanism.topology
    arm, scales = float(longest_arm(system)), []
    for link, branch in zip(system.links, topology.branches, strict=True):
        scales += [arm if u == "m" else 1.0 for u in link.joint.units[: branch.coordinate_count]]
    return np.array(scales)


def _named(scene: Posed, now: np.ndarray) -> str:
    """A position in words."""
    return ", ".join(f"{n} = {x:.6g}" for n, x in zip(scene.drives, now, strict=True))


def _refuse_jump(scene: Posed, now: np.ndarray) -> NoReturn:
    raise ValueError(
        f"the mechanism jumps to another way of its assembly before {_named(scene, now)}: a dead "
        "point lies between this position and the one before, or close by. Give positions on one "
        "side of it."
    )


def spots_along(scene: Posed, position: np.ndarray, method: Any, start: Any = None) -> Any:
    """Solutions at each position, one after the other.

    Args:
        scene: the mechanism.
        position: of the drives, shape (positions, drives).
        method: by loops or by energy.
        start: of the search at the first position; None: as the mechanism is assembled.

    Raises:
        ValueError: for the first position that is not reached.
    """
    spot, sound = (start, True) if start is not None else _first_spot(scene.at(position[0]), method)
    spots, before = [], position[0]
    for i, now in enumerate(position):
        spot = _lead(scene, spot, before, now, method) if i else method.alone(scene.at(now), spot)
        if not (sound and spot.change <= SETTLED):
            _refuse_position(scene, method, spot, i, now)
        spots.append(spot)
        before = now
    return least_energy.stacked(spots)


def _first_spot(scene: Posed, method: ByLoops) -> tuple[Spot, Any]:
    """Where the search begins, and whether the mechanism is assembled there."""
    if scene.rows is None:
        return _assemble_spot(scene, method)[:2]
    start = ready(scene.mechanism)[1]
    return Spot(start.coordinates, method.middle(), jnp.zeros(()), jnp.zeros(())), True


def _refuse_position(scene: Posed, method: Any, spot: Any, i: int, now: np.ndarray) -> NoReturn:
    """Raises `ValueError` for a position at which nothing was found."""
    loops, deep = ({n: float(x) for n, x in x.items()} for x in method.amiss(scene.at(now), spot))
    amiss = {n: x for n, x in (loops | deep).items() if not x <= SETTLED}
    where = _named(scene, now)
    place = f"at position {i}" + (f" ({where})" if where else "")
    if not amiss:
        raise ValueError(
            f"the mechanism finds no rest {place}: {_moving(scene.at(now), method, spot)} moves "
            "away under its loads. Hold it, or give it a spring or a stop."
        )
    name = max(amiss, key=lambda x: np.nan_to_num(amiss[x], nan=np.inf))
    kind = "the loop through" if name in loops else "the journal of"
    raise ValueError(
        f"the mechanism cannot be assembled {place}: no place of its bodies closes the loops "
        "there, or a dead point lies on the way from the position before; "
        f'{kind} joint "{name}" fits least. Give positions within reach, closer together.'
    )


def _moving(scene: Posed, method: Any, spot: Any) -> str:
    """What a further search moves furthest."""
    further = np.abs(np.asarray(method.alone(scene, spot).q - spot.q)) / _coordinate_scales(scene)
    further = np.nan_to_num(further, nan=np.inf)
    if not further.size or further.max() <= SETTLED:
        return "something that nothing holds"
    index = int(further.argmax())
    branches = scene.mechanism.topology.branches
    branch = next(b for b in branches if b.coordinates.start <= index < b.coordinates.stop)
    return f'{"body" if branch.connection is None else "joint"} "{branch.name}", free to move,'


def positions_at(
    scene: Posed, position: Float[Array, "positions drives"], starts: Any, method: Any
) -> Positions:
    """The mechanism at positions of its drives, each from its own start; pure.

    A sample that falls to another mode of assembly than its start's counts as not solved.

    Args:
        scene: the mechanism.
        position: of the drives.
        starts: with a first axis of positions.
        method: by loops or by energy.
    """
    spots = method.each(scene, position, starts)
    read = method.read(scene, position, spots)
    finite = jnp.all(jnp.isfinite(spots.q), axis=-1)
    # From where the nominal mechanism stands a sample may fall to another way of assembly.
    is_sound = read.is_solved & finite & (spots.branch == starts.branch)
    return Positions(scene, position, *read._replace(is_solved=is_sound))


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
    mechanism: Mechanism, positions: Mapping[str, Any], *, reverse_loads: bool = False
) -> Positions:
    """A mechanism at rest at positions of its drives, without time.

    Loads are quasi-static, as at 0 s; they act without friction and inertia, and contacts are
    rigid. Where the loops determine everything else each journal rests where its reaction presses
    it. Elsewhere (springs, free coordinates, journals that share a load, play in angle) the
    mechanism rests where its potential energy is least, near the start, from one position to the
    next. `start` and `guess` of the mechanism choose between ways to assemble it.

    Args:
        mechanism: the `Mechanism`.
        positions: coordinates [rad, m] by joint, as many of each; every drive must be among them;
            {} for a mechanism without drives, at rest once. A motor with play or stiffness is held
            by its own name (its coupling's and ".motor"): the joint then rests on the flank on
            which loads press it, twisted by them.
        reverse_loads: whether to compute the positions under reversed loads too (`.reversed`), for
            lost motion; springs and stops stay as they are. False by default.

    Returns:
        The `Positions`; their `warnings` name parts that nothing holds.

    Raises:
        ValueError: if an argument is wrong, or the mechanism cannot reach a position.
    """
    check_double_precision()
    check_mechanism(mechanism, "what is positioned")
    check_flags("positions", reverse_loads=reverse_loads)
    drives, places = checked_positions(positions)
    scene, method, starts = sought(with_quantities(mechanism), drives, places)
    return both(scene, jnp.asarray(places), starts, method, reverse_loads)


def both(
    scene: Posed, places: Array, starts: Any, method: Any, reverse_loads: bool, others: Any = None
) -> Positions:
    """The positions, with those under reversed loads where these are wanted.

    Args:
        scene: the mechanism.
        places: positions of the drives, shape (positions, drives).
        starts: with a first axis of positions.
        method: by loops or by energy.
        reverse_loads: whether the second are computed.
        others: their starts; None: the same.

    Raises:
        ValueError: no load of the mechanism reverses.
    """
    result = positions_at(scene, places, starts, method)
    if not reverse_loads:
        return result
    if all(load.springs_back() for load in scene.mechanism.loads.values()):
        raise ValueError(
            "no load of this mechanism reverses (springs, stops, controllers and friction stay as "
            "they are), so reverse_loads would find no lost motion: add a "
            "jaxclear.load.JointTorque, as large as the friction of the joint, a Force or Gravity."
        )
    other = positions_at(scene, places, starts if others is None else others, method.reversed)
    return eqx.tree_at(lambda p: p.other, result, other, is_leaf=lambda x: x is None)
