"""A consistent start: coordinates that close every loop, and speeds that keep it closed.

What is given (`Mechanism.start`, `speeds`) is held, the rest is solved: Gauss-Newton steps in the
joints' own speeds, so rotations never leave their group, each the least one that meets the
equations of `start_equations`, metres measured by the longest arm. What cannot be met is refused by
name (`start_check`). Where the guess is not met other beginnings are tried (`assembly_modes`).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from jaxclear.ground import sparse as sp
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_flags
from jaxclear.ground.compiling import map_many
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.quantity import is_traced, is_tracing, with_quantities
from jaxclear.ground.warning import warn
from jaxclear.multibody import (
    assembly_modes,
    contact_point,
    redundancy,
    start_check,
)
from jaxclear.multibody.assembly_modes import Beginning, Mode, Nominal, beginning_at_guess
from jaxclear.multibody.forces import relative_motions
from jaxclear.multibody.mechanism import (
    Mechanism,
    check_mechanism,
    loosened,
    ungiven,
    with_redundancy,
    without_stabilisation,
)
from jaxclear.multibody.motors_at_start import with_motors
from jaxclear.multibody.newton import Near, closed, least_step, nearer
from jaxclear.multibody.start_equations import (
    JOURNAL,
    LOOP,
    START,
    Ask,
    Start,
    blocks_at,
    guess,
    guess_blocks,
    is_solved,
    jacobians,
    leaves_free,
    motions_at,
    outside_tree,
    place_at,
    position_blocks,
    scale,
    speed_blocks,
    stacked,
    start_problem,
)
from jaxclear.multibody.system import readings
from jaxclear.multibody.topology import Redundancy
from jaxclear.native import in_one
from jaxclear.native.compiled import compiled_quickly

ITERATIONS = 30
# The last of them.
CLOSING = 5
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
    straight: bool = True,
) -> Start:
    """The consistent start nearest to the guess, as arrays; pure, so it maps and differentiates.

    Args:
        mechanism: whose `start` and `speeds` are met, and whose `guess` is approached.
        concentric: whether journals are put in the middle of their bearings as far as loops allow.
        time: start of the run [s].
        rough: coordinates and speeds at which the search begins, which decides the mode; None:
            at the
            mechanism's guess.
        worn: depth maps [m] of surfaces that are worn at the start, by joint and surface; None:
            new.
        straight: whether beams start straight and at rest as far as the other equations allow.
    """
    problem = start_problem(mechanism, concentric, worn)._replace(straight=straight)
    values = guess(mechanism, problem.system) if rough is None else rough
    return _solve_start(problem, *values, time, rough is None)


def _approach_guess(problem: Ask, q: Array, time: Any) -> Array:
    """Rough coordinates led to what is told of other joints than those of the tree, so
    that the search for closed loops begins where it was told: loops and guesses share what
    contradicts."""
    if is_solved(problem.mechanism, problem.concentric) or not outside_tree(problem.mechanism):
        return q

    def approach(q, _):
        place = place_at(problem, q, time)
        blocks = blocks_at(problem, place)
        fixed = [block for block in blocks if block.kind == START]
        rest = [block for block in blocks if block.kind != START]
        return nearer(problem, q, fixed, Near(rest + guess_blocks(problem, place), 1.0)), None

    return jax.lax.scan(approach, q, length=ITERATIONS)[0]


def _solve_start(
    problem: Ask,
    q: Array,
    v: Array,
    time: Any,
    led: bool = False,
    is_drawn: bool = False,
) -> Start:
    """The consistent start to which a search leads from rough coordinates and speeds, `led` to what
    is told of other joints first, or which are the start (`is_drawn`)."""
    mechanism = problem.mechanism
    start_check.check_flat_bodies(mechanism, problem.system, motions_at(problem, q, v, time)[2])
    if is_drawn or is_solved(mechanism, problem.concentric):
        return in_one(lambda: _make_start(problem, q, v, time))

    def search():
        start = _approach_guess(problem, q, time) if led else q
        return _searched(problem, start, v, time)

    # In a batch more may move the one than the other.
    there, moving = in_one(search)
    return in_one(lambda: _make_start(problem, there, moving, time))


def _searched(problem: Ask, q: Array, v: Array, time: Any) -> tuple[Array, Array]:
    """Coordinates and speeds of the consistent start to which a search leads from rough ones."""
    mechanism = problem.mechanism

    def improve(q, weight):
        place = place_at(problem, q, time)
        fixed = blocks_at(problem, place)
        if not mechanism.guess or not leaves_free(problem, fixed):
            return nearer(problem, q, fixed), None
        return nearer(problem, q, fixed, Near(guess_blocks(problem, place), weight)), None

    if problem.system.topology.searched:
        # Far from closed, redundant rows contradict each other, and others may lead astray.
        q = closest(problem, q, time)
    # At last loops alone: what is not the least yet leaves them open by its square.
    weights = jnp.where(jnp.arange(ITERATIONS) < ITERATIONS - CLOSING, 1.0, 0.0)
    q, _ = jax.lax.scan(improve, q, weights)
    # The second time for rounding only: rates are linear in the speeds.
    for _ in range(2):
        v = v - least_step(problem, speed_blocks(problem, q, v, time)).change
    return with_motors(mechanism, problem.system, q, v, time)


def closest(problem: Ask, q: Array, time: Any) -> Array:
    """Coordinates that violate loops and given values least, by damped steps.

    It also serves where no coordinates close the loops, or some of their rows are redundant.

    Args:
        problem: equations of the start (`start_problem`).
        q: coordinates of the tree at which the search begins, shape (coordinates,).
        time: instant [s] of the drives.
    """

    return closed(problem, q, time, SETTLING, (LOOP, START), damped=True)


def carried_on(mechanism: Mechanism, coordinates: Array, speeds: Array, time: Any) -> Start:
    """The start from coordinates and speeds of a run; pure. Nothing that `start` gives is imposed.

    They are kept where they close the loops to the accuracy of a start, otherwise the nearest that
    do.

    Args:
        mechanism: whose loops must close; its `start`, `speeds` and `guess` are ignored.
        coordinates: of the tree, shape (coordinates,).
        speeds: free speeds, shape (speeds,).
        time: instant [s] of this state.
    """
    bare = ungiven(mechanism)
    problem = start_problem(bare, False)
    result = assemble_arrays(bare, False, time, (coordinates, speeds), straight=False)
    rest = stacked(problem, position_blocks(problem, coordinates, time))[1]
    is_saved = jnp.max(jnp.abs(rest), initial=0.0) <= start_check.EXACT * problem.arm
    q, v = (
        jnp.where(is_saved, part, nearest)
        for part, nearest in ((coordinates, result.coordinates), (speeds, result.speeds))
    )
    return result._replace(coordinates=q, speeds=v, depths={})


def _make_start(problem: Ask, q: Array, v: Array, time: Any) -> Start:
    """The start with all by which it is judged."""
    solved, place = is_solved(problem.mechanism, problem.concentric), place_at(problem, q, time)
    positions, speeds = blocks_at(problem, place), speed_blocks(problem, q, v, time)
    # How far coordinates of the tree are from a guess is read off them.
    carried = {branch.name for branch in problem.system.topology.branches}
    closures = [block for block in positions if block.kind in (LOOP, JOURNAL)]
    return Start(
        q,
        v,
        {b.name: jnp.concatenate([b.rest, b.fixed]) for b in closures},
        dict(zip([b.name for b in closures], jacobians(problem, closures), strict=True)),
        {b.name: b.rest for b in speeds if b.kind == LOOP},
        {b.name: b.rest / b.measure for b in positions if b.kind == START},
        {b.name: b.rest / b.measure for b in speeds if b.kind == START},
        _start_overlaps(problem, q, v, time),
        {b.name: b.rest / b.measure for b in guess_blocks(problem, place) if b.name not in carried},
        scale(problem, [] if solved else positions)[0],
    )


def _start_overlaps(problem: Ask, q: Array, v: Array, time: Any) -> dict[str, Array]:
    """Overlap [m] of each clearance joint, and the one allowed; none where journals are concentric
    by construction."""
    if problem.concentric and not problem.mechanism.start:
        return {}
    motions = motions_at(problem, q, v, time)[2]
    worn = readings(problem.system, problem.worn)

    def one(joint, pose, radii, worn):
        depths = contact_point.depths(joint, pose, worn)
        return jnp.stack([jnp.max(sp.stack(depths)), DEEPEST * jnp.min(sp.stack(radii))])

    bearings = problem.system.bearings
    relative = relative_motions(problem.system, motions)
    calls = [
        (bearing.joint, view.pose, bearing.radii, worn.get(name, {}))
        for (name, bearing), view in zip(bearings.items(), relative, strict=True)
    ]
    return dict(zip(bearings, map_many(one, calls), strict=True))


def is_sound(mechanism: Mechanism, start: Start) -> Bool[Array, ""]:
    """Whether the start keeps what is asked of it, as `assemble` wants it."""
    array = jnp if is_traced(start) else np
    fine = [array.all(fine) for _, _, fine in start_check.verdicts(mechanism, start)]
    return array.all(array.stack(fine)) if fine else array.asarray(True)


@compiled_quickly
def _search_closest(mechanism: Mechanism, time: Any) -> Start:
    """The search for coordinates that miss closed loops by least."""
    problem = start_problem(mechanism, False)
    q, v = guess(mechanism)
    return in_one(lambda: _make_start(problem, closest(problem, q, time), v, time))


class Judged(NamedTuple):
    """A start, whether it is sound, where its search began, and the longest arm [m]."""

    start: Start
    sound: Any
    seed: Any
    arm: Any


@compiled_quickly
def _find_start(
    mechanism: Mechanism,
    concentric: bool,
    worn: dict | None,
    begin: Beginning | None = None,
    is_drawn: bool = False,
) -> tuple[Start, Array, Array]:
    """The search for a start that closes all loops."""
    problem = start_problem(mechanism, concentric, worn)
    seed, v = guess(mechanism, problem.system)
    if is_drawn:
        q = seed
    elif begin is None:
        q = _approach_guess(problem, seed, 0.0)
    else:
        q = jnp.where(begin.is_set, begin.coordinates, seed)
        q = jnp.where(begin.led, _approach_guess(problem, q, 0.0), q)
    return _solve_start(problem, q, v, 0.0, is_drawn=is_drawn), seed, problem.arm


def _judge_start(mechanism: Any, *rest: Any) -> Judged:
    """The start to which a search leads, judged where its numbers are."""
    mechanism = without_stabilisation(mechanism)
    start, *place = _find_start(mechanism, *rest)
    return Judged(start, is_sound(mechanism, start), *place)


@compiled_quickly
def _distance_of_guess(mechanism: Mechanism, concentric: bool, worn: dict | None) -> Array:
    """By how much the guess misses all that is asked of a start, beside what is rounding [1]."""
    problem = start_problem(mechanism, concentric, worn)
    q, v = guess(mechanism, problem.system)
    place = place_at(problem, q, 0.0)
    missed = [
        jnp.abs(block.rest) / block.measure
        for block in (*blocks_at(problem, place), *guess_blocks(problem, place))
    ]
    speeds = [jnp.abs(block.rest) / block.measure for block in speed_blocks(problem, q, v, 0.0)]
    size = start_check.ROUNDED * (1.0 + jnp.max(jnp.abs(q), initial=0.0) / problem.arm)
    fast = 1.0 + jnp.max(jnp.abs(v), initial=0.0)
    return jnp.max(jnp.concatenate([jnp.zeros(1), *missed, *(x / fast for x in speeds)])) / size


def _is_drawn(mechanism: Mechanism, concentric: bool, worn: dict | None) -> bool:
    """Whether the guess is a start already, as where a drawing is read; not looked at where drives
    move joints, which others must follow."""
    if mechanism.driven or is_solved(mechanism, concentric):
        return False
    bare = without_stabilisation(mechanism)
    return bool(_distance_of_guess(bare, concentric, worn) <= 1.0)


@compiled_quickly
def _find_carried_on(mechanism: Mechanism, *rest: Any) -> Start:
    """The start from coordinates and speeds of another run."""
    return carried_on(mechanism, *rest)


def _carry_on_and_judge(mechanism: Mechanism, *rest: Any) -> tuple[Start, Any]:
    """The same, and whether it is sound."""
    mechanism = without_stabilisation(mechanism)
    start = _find_carried_on(mechanism, *rest)
    return start, is_sound(mechanism, start)


@answering
def assemble(mechanism: Mechanism, concentric: bool = True) -> Start:
    """Assemble a mechanism: coordinates that close every loop, and speeds that keep it closed.

    Warns where the guess has led to a way to assemble that is not the nearest.

    Args:
        mechanism: the mechanism, with numbers.
        concentric: whether journals lie in the middle of their bearings; False leaves joints with
            clearance where the guess puts them and closes ideal loops only.

    Returns:
        the consistent start.

    Raises:
        ValueError: with the joint's name, if loops do not close, more is given than they leave
            free, or parts would start deep in each other.
    """
    check_double_precision()
    check_mechanism(mechanism, "what is assembled")
    check_flags("assemble", concentric=concentric)
    return ready(with_quantities(mechanism), concentric).start


class FirstSearch(NamedTuple):
    """A mechanism that knows which rows of its loops are redundant, the start to which its guess
    leads and whether that is sound; `sought`: the mechanism that is searched from other beginnings
    (None: there is nothing to search), `tree` its coordinates, `concentric` and `worn` as of
    `assemble_arrays`."""

    mechanism: Mechanism
    start: Start
    sound: Any
    tree: assembly_modes.Coordinates
    sought: Mechanism | None
    concentric: bool
    worn: dict | None

    @property
    def is_doubted(self) -> bool:
        """Whether redundant rows were told at a place where loops are open: what is nearest to
        closing a loop lies stretched in one line, where rows depend that elsewhere do not."""
        values = self.mechanism.topology.depend and not self.sound
        return bool(values and start_check.open_by(self.start) > 0)

    def without_redundancy(self) -> "FirstSearch":
        """The same with all rows."""
        bare = with_redundancy(self.mechanism, None)
        return self._replace(mechanism=bare, sought=bare)

    @property
    def is_taken(self) -> bool:
        """Whether no other beginning is tried: the start is where it was guessed, or what is wrong
        with it is not where it stands."""
        if self.sought is None:
            return True
        if self.sound:
            return assembly_modes.has_landed(self.tree, self.start)
        return start_check.is_placed(self.start)

    def search(self, begin: Beginning, guess: dict | None = None) -> tuple[Start, Any]:
        """The start to which another beginning leads, of another guess for the same names (None:
        its own), and whether it is sound."""
        mechanism = self.sought
        if guess is not None:
            mechanism = eqx.tree_at(lambda m: m.guess, mechanism, guess)
        result = _judge_start(mechanism, self.concentric, self.worn, begin)
        if not result.sound:
            # Begun far away it may be on the way still.
            on = assembly_modes.at(result.start.coordinates)
            result = _judge_start(mechanism, self.concentric, self.worn, on)
        return result.start, result.sound

    def modes(self, count: int) -> list[Mode]:
        """The modes to which this search and so many others lead."""
        part = [(beginning_at_guess(self.mechanism), 1)]
        if self.sought is None:
            return assembly_modes.modes(self.tree, lambda _: (self.start, self.sound), part)
        others = assembly_modes.beginnings(self.mechanism, self.tree, count - 1)
        out = [*part, *((begin, 1) for begin in others)]
        search = lambda begin: self[1:3] if begin is part[0][0] else self.search(begin)
        return assembly_modes.modes(self.tree, search, out)


def first_search(mechanism: Mechanism, concentric: bool, worn: dict | None = None) -> FirstSearch:
    """The start to which the search from the mechanism's guess leads, and what other searches need.

    Args:
        mechanism: with numbers (not traced); its redundancy is determined anew.
        concentric, worn: mode of journals and depth maps [m] as in `assemble_arrays`.
    """
    bare = with_redundancy(mechanism, None)
    begin = beginning_at_guess(mechanism)
    first = _judge_start(bare, concentric, worn, begin, _is_drawn(bare, concentric, worn))
    tree = assembly_modes.Coordinates(bare, first.seed, first.arm)
    judged = lambda m: _judge_start(m, concentric, worn, begin)[:2]
    is_near = lambda: assembly_modes.is_near_seed(tree, first.start)
    values, start, sound = _add_redundancy(bare, first.start, first.sound, 0.0, judged, is_near)
    # Redundant rows that motion never changes say nothing new.
    searched = values if values.topology.searched else bare
    sought = None if is_solved(bare, concentric) else searched
    return FirstSearch(values, start, sound, tree, sought, concentric, worn)


class Nearest(NamedTuple):
    """A mechanism that knows its redundant rows, its start nearest to what is guessed, whether that
    is sound, a sentence where another mode is about as near, and whether other beginnings than the
    guess have led to it."""

    mechanism: Mechanism
    start: Start
    sound: Any
    doubt: str = ""
    searched: bool = False


def nearest(mechanism: Mechanism, concentric: bool = True, worn: dict | None = None) -> Nearest:
    """The start nearest to the guess; other beginnings are searched where the first misses it.

    Warns where another mode is about as near. A traced mechanism gets the first search only.

    Args:
        mechanism: with its `guess`, from which distances are measured.
        concentric: whether journals are put in the middle of their bearings.
        worn: depth maps [m] by joint and surface; None: new surfaces.
    """
    if is_traced((mechanism, worn)) or is_tracing():
        return Nearest(mechanism, *_judge_start(mechanism, concentric, worn)[:2])
    first = first_search(mechanism, concentric, worn)
    result = [] if first.is_taken else first.modes(assembly_modes.SEARCHES)
    start, sound = (result[0].start, True) if result else (first.start, first.sound)
    if not result and first.is_doubted:
        other = first.without_redundancy()
        result = other.modes(assembly_modes.SEARCHES)
        if result:
            begin = assembly_modes.at(result[0].start.coordinates)
            judged = lambda m: _judge_start(m, concentric, worn, begin)[:2]
            values = _add_redundancy(other.mechanism, result[0].start, True, 0.0, judged)
            first, start, sound = other._replace(mechanism=values[0]), *values[1:]
    text = [assembly_modes.ambiguity_warning(first.mechanism, first.tree, result)] if sound else []
    text += [first.tree.turn_warning(mechanism, start)] if sound else []
    doubt = " ".join(filter(None, text))
    if doubt:
        warn(doubt)
    elsewhere = not np.array_equal(start.coordinates, first.start.coordinates)
    return Nearest(first.mechanism, start, sound, doubt, elsewhere)


def ready(mechanism: Mechanism, concentric: bool = True, worn: dict | None = None) -> Nearest:
    """The mechanism with its redundant rows, and its start, both as `assemble` needs them.

    Args:
        mechanism: traced or with numbers; only with numbers its start is checked.
        concentric: whether journals are put in the middle of their bearings.
        worn: depth maps [m] by joint and surface; None: new surfaces.

    Raises:
        ValueError: the start does not meet what `start` and `speeds` give, or loops do not close.
    """
    result = nearest(mechanism, concentric, worn)
    if not is_traced(result.start) and not result.sound:
        start_check.refuse(result.mechanism, result.start)
    return result


def ready_from_state(
    mechanism: Mechanism, coordinates: Array, speeds: Array, time: Any
) -> tuple[Mechanism, Start]:
    """The mechanism with its redundant rows, and the start from a state of a run (`carried_on`).

    Args:
        mechanism: whose redundancy is determined anew at this state.
        coordinates: of the tree, shape (coordinates,).
        speeds: free speeds, shape (speeds,).
        time: instant [s] of this state.

    Raises:
        ValueError: no start near the state closes the loops.
    """
    bare = with_redundancy(mechanism, None)
    begin = lambda m: _carry_on_and_judge(m, coordinates, speeds, time)
    start, sound = begin(bare)
    if is_traced(start):
        return mechanism, begin(mechanism)[0]
    values, start, sound = _add_redundancy(bare, start, sound, time, begin)
    if not sound:
        start_check.refuse(values, start)
    return values, start


def _add_redundancy(
    bare: Mechanism,
    start: Start,
    sound: Any,
    time: Any,
    assembled: Callable,
    is_near: Callable[[], bool] = lambda: True,
) -> tuple[Mechanism, Start, Any]:
    """The mechanism with its redundancy, the start, and whether it is sound, assembled anew where
    rows that depend on each other have left loops open or have led far away (not `is_near`), closed
    by as many as are independent, and where a damped search closes loops that were not."""
    if not bare.topology.loops:
        return bare, start, sound
    place = start
    if not sound:
        place = _search_closest(without_stabilisation(bare), jnp.asarray(time, float))
    elif not redundancy.is_suspect(bare, start):
        return bare, start, sound
    result = redundancy.redundancy(bare, place, time)
    values = with_redundancy(bare, result)
    if values.topology.depend:
        # Loops that are closed but for rounding need not be closed anew.
        is_closed = sound and start_check.open_by(start, start_check.ROUNDED) == 0
        is_final = is_closed and is_near()
        return (values, start, sound) if is_final else (values, *assembled(values))
    if not sound and start_check.open_by(place) == 0 < start_check.open_by(start):
        far = with_redundancy(bare, redundancy.with_search(result, start))
        other, fine = assembled(far)
        if fine:
            return far, other, fine
    if sound and redundancy.has_dependent_rows(start):
        warn(
            "the mechanism stands at a position in which the rows of its loops depend on each "
            "other (links in one line, say): it can leave it in more than one way, and a run from "
            "there fails. Start it beside this position.",
        )
    # Rows that nearly depend on each other lead a search astray: what is missed is told from where
    # it is least.
    return values, min(start, place, key=start_check.open_by), sound


class Sampled(NamedTuple):
    """What samples of a mechanism share: names of coordinates that `start` gives although loops,
    drives, concentric journals and what is given before determine them (they move with the numbers
    that vary), which rows of loops are redundant, and the mode."""

    determined: tuple[str, ...]
    redundancy: Redundancy | None
    nominal: Nominal | None


def sampled(mechanism: Mechanism, concentric: bool, worn: dict | None) -> Sampled:
    """What samples share with the nominal mechanism: determined names, redundancy and the mode.

    Args:
        mechanism: the nominal one, with numbers.
        concentric: whether journals are put in the middle of their bearings.
        worn: depth maps [m] by joint and surface; None: new surfaces.

    Raises:
        ValueError: the nominal start is refused.
    """
    result = ready(mechanism, concentric, worn)
    values, start = result.mechanism, result.start
    if is_traced(start):
        return Sampled((), values.topology.redundancy, None)
    names = start_check.determined_names(values, start) if mechanism.start else ()
    if is_solved(mechanism, concentric):
        return Sampled(names, values.topology.redundancy, None)
    if names:
        # Their rows are held no more.
        begin = assembly_modes.at(start.coordinates)
        start = _judge_start(loosened(values, names), concentric, worn, begin).start
    mode = assembly_modes.nominal(values, start, result.searched)
    return Sampled(names, values.topology.redundancy, mode)
