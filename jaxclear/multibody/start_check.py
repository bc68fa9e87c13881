"""What a start is refused for, in sentences that name the joint and say what would be right."""

from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxclear.components.clearance.backlash import middle_of
from jaxclear.components.load_base import AbstractCoordinateLoad
from jaxclear.ground import sparse as sp
from jaxclear.ground.quantity import is_traced
from jaxclear.ground.wording import listed
from jaxclear.multibody import transmissions
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.newton import which_independent
from jaxclear.multibody.start_equations import Start, motions_at, retract, start_problem
from jaxclear.multibody.system import System
from jaxclear.multibody.topology import coordinate_joint, moves_along
from jaxclear.native.compiled import compiled_quickly

# What may be left of a closure [m, 1].
CLOSED = 1e-8
# What is left of an equation that is met but for rounding, beside the size of its numbers.
ROUNDED = 1e-14
# By how much a given number may be missed [rad, longest arms]: numbers written with six digits
# close a loop that leaves them no freedom.
EXACT = 1e-6
# How far a coordinate may start beyond a stop, or inside a flank [rad, longest arms]: as deep as
# contacts of hard parts are ever pressed.
PRESSED = 2e-3
# Beside the longest arm: a loop that is open by less may be one whose lengths ought to fit.
NEARLY = 0.05


def check_flat_bodies(mechanism: Mechanism, system: System, motions: tuple) -> None:
    """Raises `ValueError` for a body with an inertia about z only that turns about other axes.

    Which spins are structurally zero is known while tracing.

    Args:
        mechanism: with the inertias of its bodies.
        system: with the frames of the links.
        motions: motion of every link at the start.
    """
    for branch, link, motion in zip(system.topology.branches, system.links, motions, strict=True):
        if branch.motor:
            continue
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


def verdicts(mechanism: Mechanism, start: Start) -> Iterator[tuple[Any, str, Any]]:
    """(what writes the sentence, the joint's name, whether all is well there) for everything that
    is asked of a start, in the order in which it is told."""
    fast = 1.0 + _most(start.speeds)
    for name in mechanism.topology.loops:
        yield _open_loop, name, _most(start.residuals[name]) <= CLOSED
    for name in mechanism.topology.loops:
        yield _dead_point_sentence, name, _most(start.rates[name]) <= CLOSED * fast
    for name, missed in start.missed.items():
        yield _missed_coordinate_sentence, name, _most(missed) <= EXACT
    for name, missed in start.missed_speeds.items():
        yield _missed_speed_sentence, name, _most(missed) <= EXACT * fast
    for name in mechanism.topology.clearances:
        # What is given may hold a journal elsewhere, but not deep in the wall.
        if name in start.residuals and not mechanism.start:
            yield _eccentric_sentence, name, _most(start.residuals[name]) <= CLOSED
    for name, (depth, allowed) in start.depths.items():
        yield _overlap_sentence, name, depth <= allowed


def open_by(start: Start, allowed: float = CLOSED) -> float:
    """By how much loops are open [m, 1]; 0 where that is allowed, so that they count as closed."""
    most = max((float(_most(rest)) for rest in start.residuals.values()), default=0.0)
    return most if not most <= allowed else 0.0


def is_placed(start: Start) -> bool:
    """Whether loops are closed and coordinates as they are given: what is wrong, if anything, is
    none of the place."""
    missed = max((float(_most(rest)) for rest in start.missed.values()), default=0.0)
    return open_by(start) == 0.0 and missed <= EXACT


def refuse(mechanism: Mechanism, start: Start) -> None:
    """Raises `ValueError` for a start, of a mechanism with numbers, that is not what was asked
    for."""
    for sentence, name, fine in verdicts(mechanism, start):
        if not np.all(np.asarray(fine)):
            raise ValueError(sentence(mechanism, start, name))


def _most(values: Any) -> Any:
    array = jnp if is_traced(values) else np
    return array.max(array.abs(values), initial=0.0)


def _loop(mechanism: Mechanism, name: str) -> str:
    """What closes a loop, in words."""
    kind = "coupling" if name in mechanism.couplings else "loop through joint"
    return f'{kind} "{name}"'


def _open_loop(mechanism: Mechanism, start: Start, name: str) -> str:
    missed = _most(start.residuals[name])
    exactly = (
        " Loops that hold each other (parallel cranks, a ring of skew hinges) close only where "
        f"lengths and axes fit exactly, to {CLOSED:.0e} m."
        if missed <= NEARLY * float(start_problem(mechanism, False).arm)
        else ""
    )
    remedy = (
        "Check the lengths around this loop, or give a better start={...} or guess={...} for the "
        f"joints in it.{exactly}"
    )
    if name in mechanism.couplings:
        remedy = (
            "It counts whole turns: give start={...} or guess={...} that fit it for its joints, "
            f"{listed(mechanism.couplings[name].joints())}."
        )
    return (
        f"the {_loop(mechanism, name)} cannot be closed: {missed:.3g} m (or rad) remain from the "
        f"given start. {remedy}"
    )


def _dead_point_sentence(mechanism: Mechanism, start: Start, name: str) -> str:
    loop, drives = _loop(mechanism, name), ", ".join(map(repr, mechanism.driven))
    remain = f"{_most(start.rates[name]):.3g} m/s (or rad/s) remain"
    if not np.any(start.jacobians[name]):
        return (
            f"the drives of {drives} contradict the {loop}, which no other joint can follow: "
            f"{remain}. Drive fewer joints, or give drives that fit."
        )
    return (
        f"the mechanism stands at a dead point: the {loop} cannot follow the drive of {drives} "
        f"from here, {remain}. Drive another joint, or start elsewhere."
    )


def _eccentric_sentence(mechanism: Mechanism, start: Start, name: str) -> str:
    return (
        f'the journal of joint "{name}" cannot be brought to the middle of its bearing: '
        f"{_most(start.residuals[name]):.3g} m (or rad) remain. Check the lengths, give a better "
        "start or guess, or simulate with state=jaxclear.State(concentric=False)."
    )


def _overlap_sentence(mechanism: Mechanism, start: Start, name: str) -> str:
    depth, allowed = map(float, start.depths[name])
    return (
        f'the parts of joint "{name}" start {depth:.3g} m deep in each other; more than '
        f"{allowed:.2g} m cannot be meant. Check the lengths, and what start= gives: coordinates "
        "given are held, also where they throw a journal out of its bearing; rough ones belong "
        "into guess=."
    )


def _missed_coordinate_sentence(mechanism: Mechanism, start: Start, name: str) -> str:
    joint = coordinate_joint(name, mechanism.bodies, mechanism.connections)
    values, missed = mechanism.start[name], start.missed[name]
    entry = f'"{name}": {_in_words(values)}'
    if name not in determined_names(mechanism, start):
        return (
            f"no way to assemble with start={{{entry}}} was found from the guess of the other "
            f"joints: {_most(missed):.3g} (rad, or longest arms) remain. Give start= or "
            "guess= for more of the joints around it, nearer to the wanted position; or it lies "
            "out of reach."
        )
    where = f"miss it by {_most(missed):.3g} (rad, or longest arms)"
    if len(missed) == 1:
        place = float(values[0]) + float(missed[0]) * _scale_of_joint(mechanism, joint)
        where = f"put it at {place:.6g} {joint.units[0]}"
    return (
        f"start={{{entry}}} is more than the mechanism leaves free: {_holding(mechanism, name)} "
        f'and what start gives before {where}. Leave "{name}" out, or give it as '
        f"guess={{{entry}}}, which chooses between the ways to assemble without being held."
    )


def _missed_speed_sentence(mechanism: Mechanism, start: Start, name: str) -> str:
    missed = start.missed_speeds[name]
    return (
        f'speeds={{"{name}": {_in_words(mechanism.speeds[name])}}} is more than the mechanism '
        f"leaves free: {_holding(mechanism, name)} and the speeds given before miss it by "
        f'{_most(missed):.3g} (rad/s, or longest arms a second). Leave "{name}" out; it '
        "follows from the others."
    )


def _holding(mechanism: Mechanism, name: str) -> str:
    """What holds a mechanism beside what is given, in words: of couplings those of this joint, or
    all."""
    every = mechanism.couplings
    named = [coupling for coupling, each in every.items() if name in each.joints()]
    word = "coupling" if len(named or every) == 1 else "couplings"
    return f"its loops, drives, {word} {listed(named or every)}" if every else "its loops, drives"


def _in_words(values: tuple) -> str:
    numbers = [f"{float(x):.6g}" for x in values]
    return numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"


def _scale_of_joint(mechanism: Mechanism, joint: Any) -> float:
    return float(start_problem(mechanism, False).arm) if joint.units[0] == "m" else 1.0


def determined_names(mechanism: Mechanism, start: Start) -> tuple[str, ...]:
    """Names of what `start` gives although loops, drives and what is given before determine it, and
    so do journals that lie in the middle of their bearings."""
    rest = [_most(start.residuals.get(name, np.inf)) for name in mechanism.topology.clearances]
    concentric = all(x <= CLOSED for x in rest)
    free = _free(mechanism, concentric, start.coordinates, jnp.asarray(_small_step_from(start)))
    return tuple(name for name in mechanism.start_arguments["start"] if not free[name])


@compiled_quickly
def _free(mechanism: Mechanism, concentric: bool, q: Any, jolt: Any) -> dict[str, Any]:
    problem = start_problem(mechanism, concentric)
    return which_independent(problem, retract(problem.system, q, jolt))


def _small_step_from(start: Start) -> np.ndarray:
    """A small step from the start, to where no position is singular by chance."""
    return 1e-3 * np.random.default_rng(0).normal(size=start.speeds.shape)


def beyond_limits(mechanism: Mechanism, start: Start) -> str:
    """A sentence where a coordinate starts beyond a stop or inside the flank of a play; "" where
    none does, and for what is being traced."""
    stops: dict[str, Any] = {n: load for n, load in mechanism.loads.items() if _sides_of_stop(load)}
    plays = {n: load for n, load in mechanism.couplings.items() if load.gives and load.play}
    if not (stops or plays) or is_traced((mechanism, start)):
        return ""
    arm, *depths = _limits_exceeded(mechanism, tuple(stops), tuple(plays), start.coordinates)
    texts = []
    for name, depth in zip((*stops, *plays), map(float, depths), strict=True):
        slides = moves_along(mechanism, stops.get(name, plays.get(name)))
        if depth > PRESSED * (float(arm) if slides else 1.0):
            where = f"{depth:.3g} {'m' if slides else 'rad'}"
            what = f'inside a flank of coupling "{name}"'
            if name in stops:
                what = f'beyond stop "{name}" of joint "{stops[name].coordinates()[0]}"'
            texts.append(f"The start lies {where} {what}")
    if not texts:
        return ""
    more = f", and {len(texts) - 1} more such" if len(texts) > 1 else ""
    return (
        f"{texts[0]}{more}, whose spring throws it out: give start={{...}} within (of an imported "
        "model keyframe=...)."
    )


def _sides_of_stop(load: Any) -> tuple:
    return load.sides() if isinstance(load, AbstractCoordinateLoad) else ()


@compiled_quickly
def _limits_exceeded(
    mechanism: Mechanism, stops: tuple[str, ...], plays: tuple[str, ...], q: Any
) -> list:
    """The longest arm [m], and how far the start is beyond stops and inside flanks [rad, m];
    stops of joints outside the tree are not looked at."""
    problem = start_problem(mechanism, False)
    system, still = problem.system, jnp.zeros(problem.system.topology.speed_count)
    motions = motions_at(problem, q, still, 0.0)[2]
    result = [problem.arm]
    for name in stops:
        load: Any = mechanism.loads[name]
        branch = system.topology.branch_of(load.coordinates()[0])
        motion = None if branch is None else motions[system.topology.branches.index(branch)]
        place = [] if motion is None else motion.coordinates[:1]
        depths = [side.beyond(x) for side in _sides_of_stop(load) for x in place]
        result.append(jnp.max(sp.stack(depths), initial=0.0))
    for name in plays:
        giving = system.transmissions[name]
        play = giving.coupling.play
        twist = transmissions.twist_of(motions, giving).value
        result.append(jnp.abs(sp.sub(twist, middle_of(play))) - 0.5 * play.play)
    return result
