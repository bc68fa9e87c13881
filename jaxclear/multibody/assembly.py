"""A consistent start: coordinates that close every loop, and speeds that keep it closed.

What is given (`Mechanism.start`, `speeds`) is held, the rest is solved: Gauss-Newton steps in the
joints' own speeds, so rotations never leave their group, each the least one that meets the
equations of `start_equations`, metres measured by the longest arm. What cannot be met is refused by
name (`start_check`).
"""

import warnings
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxclear.ground import sparse as sp
from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import check_flags, expect
from jaxclear.ground.compiling import compiled_quickly
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.quantity import is_traced
from jaxclear.multibody import contact_point, kinematics, redundancy, start_check
from jaxclear.multibody.mechanism import Mechanism, ungiven, with_redundancy
from jaxclear.multibody.side_of_guess import warn_of_nearer_assembly
from jaxclear.multibody.start_equations import (
    GIVEN,
    GUESS,
    JOURNAL,
    LOOP,
    Ask,
    Start,
    ask,
    guess,
    is_solved,
    least,
    motions_at,
    nearer,
    outside_tree,
    position_blocks,
    settled,
    speed_blocks,
    stacked,
)
from jaxclear.multibody.system import readings

__all__ = [
    "Start",
    "assemble",
    "assemble_arrays",
    "assembled",
    "carried_on",
    "determined",
    "guess",
    "is_sound",
    "ready",
    "ready_from",
]

ITERATIONS = 30
# The same where rows are redundant and steps are damped.
SETTLING = 200
# A part may start this deep in another, as a share of the smaller radius in contact [1]: as deep as
# hard steel is ever pressed, less than a place that was mistaken.
DEEPEST = 2e-3


def assemble_arrays(
    mechanism: Mechanism,
    concentric: bool = True,
    time: Any = 0.0,
    rough: tuple[Array, Array] | None = None,
    worn: dict | None = None,
) -> Start:
    """The consistent start nearest `rough` coordinates and speeds, by default the mechanism's
    guess; of surfaces `worn` so deep [m]; pure, so it maps and differentiates."""
    asked = ask(mechanism, concentric, worn)
    q, v = guess(mechanism) if rough is None else rough
    start_check.check_flat_bodies(mechanism, asked.system, motions_at(asked, q, v, time)[2])
    if is_solved(asked):
        return _started(asked, q, v, time)

    def approach(q, _):
        asked_for = [b for b in position_blocks(asked, q, time) if b.kind in (GIVEN, GUESS)]
        return nearer(asked, q, asked_for), None

    def improve(q, _):
        return nearer(asked, q, position_blocks(asked, q, time)), None

    if outside_tree(asked):
        # What is told of other joints than those of the tree first, so that the search for closed
        # loops begins where it was told.
        q, _ = jax.lax.scan(approach, q, length=ITERATIONS)
    if asked.system.topology.searched:
        # Far from closed, redundant rows contradict each other, and others may lead astray.
        q = closest(asked, q, time)
    q, _ = jax.lax.scan(improve, q, length=ITERATIONS)
    # The second time for rounding only: rates are linear in the speeds.
    for _ in range(2):
        v = v - least(asked, speed_blocks(asked, q, v, time)).change
    return _started(asked, q, v, time)


def closest(asked: Ask, q: Array, time: Any) -> Array:
    """Coordinates that miss closed loops, and what is given, by least: also where no coordinates
    close the loops, or where some of their rows are redundant."""

    def settle(q, _):
        held = [b for b in position_blocks(asked, q, time) if b.kind in (LOOP, GIVEN)]
        return settled(asked, q, held), None

    return jax.lax.scan(settle, q, length=SETTLING)[0]


def carried_on(mechanism: Mechanism, coordinates: Array, speeds: Array, time: Any) -> Start:
    """The start at a `time` [s] from coordinates and speeds of a run: they themselves where its
    loops are closed, as far as a run keeps them, otherwise the nearest that close them. Nothing
    that is given for a start is held; pure.
    """
    bare = ungiven(mechanism)
    asked = ask(bare, False)
    found = assemble_arrays(bare, False, time, (coordinates, speeds))
    left = stacked(asked, position_blocks(asked, coordinates, time))[1]
    closed = jnp.max(jnp.abs(left), initial=0.0) <= start_check.HELD * asked.arm
    q, v = (
        jnp.where(closed, own, nearest)
        for own, nearest in ((coordinates, found.coordinates), (speeds, found.speeds))
    )
    return found._replace(coordinates=q, speeds=v, depths={})


def _started(asked: Ask, q: Array, v: Array, time: Any) -> Start:
    """The start with all by which it is judged."""
    positions, speeds = position_blocks(asked, q, time), speed_blocks(asked, q, v, time)
    closures = [block for block in positions if block.kind in (LOOP, JOURNAL)]
    return Start(
        q,
        v,
        {b.name: jnp.concatenate([b.left, b.fixed]) for b in closures},
        {b.name: b.jacobian for b in closures},
        {b.name: b.left for b in speeds if b.kind == LOOP},
        {b.name: b.left / b.measure for b in positions if b.kind == GIVEN},
        {b.name: b.left / b.measure for b in speeds if b.kind == GIVEN},
        _depths(asked, q, v, time),
    )


def _depths(asked: Ask, q: Array, v: Array, time: Any) -> dict[str, Array]:
    """Overlap [m] of each clearance joint, and the one allowed; none where journals are concentric
    by construction."""
    if asked.concentric and not asked.mechanism.start:
        return {}
    motions = motions_at(asked, q, v, time)[2]
    out, worn = {}, readings(asked.system, asked.worn)
    for name, bearing in asked.system.bearings.items():
        pose = kinematics.relative_motion(bearing.closure, motions)[1]
        depths = contact_point.depths(bearing.joint, pose, worn.get(name, {}))
        allowed = DEEPEST * jnp.min(sp.stack(bearing.radii))
        out[name] = jnp.stack([jnp.max(sp.stack(depths)), allowed])
    return out


def is_sound(mechanism: Mechanism, start: Start) -> Bool[Array, ""]:
    """Whether the start keeps what is asked of it, as `assemble` wants it."""
    fine = [jnp.all(fine) for _, _, fine in start_check.verdicts(mechanism, start)]
    return jnp.all(jnp.stack(fine)) if fine else jnp.array(True)


@compiled_quickly
def _closest(mechanism: Mechanism, time: Any) -> Start:
    asked = ask(mechanism, False)
    q, v = guess(mechanism)
    return _started(asked, closest(asked, q, time), v, time)


assembled = compiled_quickly(assemble_arrays)


@compiled_quickly
def _judged(mechanism: Mechanism, concentric: bool, worn: dict | None) -> tuple[Start, Array]:
    start = assemble_arrays(mechanism, concentric, worn=worn)
    return start, is_sound(mechanism, start)


@compiled_quickly
def _carried_on(mechanism: Mechanism, *rest: Any) -> tuple[Start, Array]:
    start = carried_on(mechanism, *rest)
    return start, is_sound(mechanism, start)


@answering
def assemble(mechanism: Mechanism, concentric: bool = True) -> Start:
    """Consistent start of a mechanism with numbers; refuses, by name, what cannot be: loops that do
    not close, more given than they leave free, parts deep in each other.

    `concentric=False` leaves clearance joints where the guess puts them and closes ideal loops
    only. Raises `ValueError`; warns where the guess has led to a way to assemble that is not the
    nearest.
    """
    check_double_precision()
    expect(mechanism, Mechanism, "what is assembled", "a jaxclear.Mechanism")
    check_flags("assemble", concentric=concentric)
    return ready(mechanism, concentric)[1]


def ready(
    mechanism: Mechanism, concentric: bool = True, worn: dict | None = None
) -> tuple[Mechanism, Start]:
    """A mechanism that knows which rows of its loops are redundant, and its start, both as
    `assemble` wants them, of surfaces `worn` so deep [m] (None: new ones). What is being traced is
    taken as it comes."""
    bare, judged = with_redundancy(mechanism, None), lambda m: _judged(m, concentric, worn)
    start, sound = judged(bare)
    if is_traced(start):
        return mechanism, judged(mechanism)[0]
    known, start, sound = _known(bare, start, sound, 0.0, judged)
    if not sound:
        start_check.refuse(known, start)
    warn_of_nearer_assembly(known if known.topology.searched else bare, start, judged)
    return known, start


def ready_from(
    mechanism: Mechanism, coordinates: Array, speeds: Array, time: Any
) -> tuple[Mechanism, Start]:
    """`ready`, from coordinates and speeds of a run (`carried_on`)."""
    bare = with_redundancy(mechanism, None)
    begin = lambda m: _carried_on(m, coordinates, speeds, time)
    start, sound = begin(bare)
    if is_traced(start):
        return mechanism, begin(mechanism)[0]
    known, start, sound = _known(bare, start, sound, time, begin)
    if not sound:
        start_check.refuse(known, start)
    return known, start


def _known(
    bare: Mechanism, start: Start, sound: Any, time: Any, assembled: Callable
) -> tuple[Mechanism, Start, Any]:
    """The mechanism with its redundancy, the start, and whether it is sound, assembled anew where
    rows depend on each other, closed by as many as are independent, and where a damped search
    closes loops that were not."""
    if not bare.topology.loops:
        return bare, start, sound
    place = start
    if not sound:
        place = _closest(bare, time)
    elif not redundancy.is_suspect(bare, start):
        return bare, start, sound
    found = redundancy.redundancy(bare, place, time)
    known = with_redundancy(bare, found)
    if known.topology.depend:
        return known, *assembled(known)
    if not sound and start_check.open_by(place) == 0 < start_check.open_by(start):
        far = with_redundancy(bare, redundancy.searched(found, start))
        other, closed = assembled(far)
        if closed:
            return far, other, closed
    if sound and redundancy.depend(start):
        warnings.warn(
            "the mechanism stands at a position in which the rows of its loops depend on each "
            "other (links in one line, say): it can leave it in more than one way, and a run from "
            "there fails. Start it beside this position.",
            stacklevel=4,
        )
    # Rows that nearly depend on each other lead a search astray: what is missed is told from where
    # it is least.
    return known, min(start, place, key=start_check.open_by), sound


def determined(
    mechanism: Mechanism, concentric: bool = True, worn: dict | None = None
) -> tuple[tuple[str, ...], Mechanism]:
    """Names of coordinates that `start` gives although loops, drives, concentric journals and what
    is given before determine them, and the mechanism that knows its redundant rows. Raises
    `ValueError` for a start that is refused."""
    known, start = ready(mechanism, concentric, worn)
    told = mechanism.start and not is_traced(start)
    return start_check.determined(known, start) if told else (), known
