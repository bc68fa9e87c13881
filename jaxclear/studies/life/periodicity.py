"""How far a state is from the one a cycle before, each thing in its own measure; and whether the
drives of a machine repeat after a period, once.

Poses are compared, not coordinates: a crank that has made a whole turn stands where it stood, and a
quaternion and its opposite are one attitude. A journal counts in shares of its clearance, because
that is what decides its contact.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.components.joint.base import drive_of
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.warning import warn
from jaxclear.multibody.system import longest_arm
from jaxclear.results import histories
from jaxclear.results.state_history import StateHistory, columns, over_time
from jaxclear.studies.problem import Problem

# A place within this of where it was [rad, m] is the same place; a period is written with so many
# digits.
SAME_PLACE = 1e-5
# Parts of a cycle after which drives are looked at: no drive repeats after a ratio of Fibonacci
# numbers that does not repeat throughout.
LOOKS = (0.0, 2 / 13, 3 / 8, 8 / 13, 7 / 8)


def apart(history: StateHistory) -> dict[str, Float[Array, ""]]:
    """How far the last saved state is from the first, by what it is of: places of bodies in longest
    arms of the mechanism, attitudes [rad], velocities in the largest in between (a spin counts as
    the speed of a longest arm that turns so), journals in clearances, angles that wind up springs
    [rad]."""
    motions = {name: histories.body(history, name) for name in history.mechanism.bodies}
    arm = longest_arm(history.model().system)
    fastest = jnp.max(
        jnp.stack(
            [jnp.max(_size(own.velocity) + arm * _size(own.spin)) for own in motions.values()]
        )
    )
    found = {}
    for name, own in motions.items():
        found[f'the place of "{name}"'] = _change(own.com) / arm
        # For small angles this is the angle.
        turned = _size((own.rotation[-1] - own.rotation[0]).reshape(-1)) / jnp.sqrt(2.0)
        found[f'the attitude of "{name}"'] = turned
        found[f'the velocity of "{name}"'] = safe_divide(_change(own.velocity), fastest)
        found[f'the spin of "{name}"'] = safe_divide(arm * _change(own.spin), fastest)
    for name, clearance in _clearances(history).items():
        offset = over_time(history, lambda now: now.pose(name).translation)
        found[f'the journal in joint "{name}"'] = _change(columns(offset)) / clearance
    layout = history.layout()
    for i, name in enumerate(layout.angles):
        angle = history.states[:, layout.angle_start + i]
        found[f'the angle of joint "{name}"'] = jnp.abs(angle[-1] - angle[0])
    return found


def _clearances(history: StateHistory) -> dict[str, Any]:
    """Clearance [m] of each joint whose journal moves freely in it."""
    mechanism = history.mechanism
    joints = {name: mechanism.connections[name].joint for name in mechanism.topology.clearances}
    known = {name: getattr(joint, "clearance", None) for name, joint in joints.items()}
    return {name: size for name, size in known.items() if eqx.is_array(size)}


def _change(values: Float[Array, "time n"]) -> Float[Array, ""]:
    return _size(values[-1] - values[0])


def _size(values: Float[Array, "*batch n"]) -> Float[Array, " *batch"]:
    return safe_sqrt(jnp.sum(values * values, axis=-1))


def restless(problem: Problem, begins: float, period: float = 0.0) -> dict[str, tuple]:
    """The drives that do not repeat from a time [s] to a `period` later, by default the problem's:
    by joint, what they move it by [rad, m], and how far that is from where it was."""
    ends, found = begins + (period or float(problem.duration)), {}
    for name, joint in _driven(problem):
        before, after = (float(drive_of(joint).motion(t)[0]) for t in (begins, ends))
        poses = [joint.motion((q,)) for q in (before, after)]
        parts = [np.array([[*p.rotation[i], p.translation[i]] for i in range(3)]) for p in poses]
        away = float(np.linalg.norm(parts[1] - parts[0]))
        if away > SAME_PLACE:
            found[name] = after - before, away
    return found


def _driven(problem: Problem) -> list[tuple[str, Any]]:
    connections = problem.mechanism.connections
    return [(name, connections[name].joint) for name in problem.mechanism.driven]


def check_period(owner: str, problem: Problem, begins: float, cycles: int = 1) -> None:
    """Raises `ValueError` where a drive does not repeat over a cycle that begins at a time [s], nor
    over the last of so many: it may be on its way up to what it does for ever."""
    later = restless(problem, begins + (cycles - 1) * float(problem.duration))
    for name, (moved, away) in restless(problem, begins).items():
        if name not in later:
            continue
        unit = problem.mechanism.connections[name].joint.units[0]
        turn = 2 * np.pi * float(problem.duration) / abs(moved)
        more = f" A turn of it takes {turn:.4g} s; cycles are given by name, cycles=..."
        raise ValueError(
            f'the drive of joint "{name}" moves it by {moved:.6g} {unit} in a period of '
            f"{float(problem.duration):.6g} s, which leaves it {away:.2g} from where it was: give "
            f"{owner} the period after which the drives repeat."
            f"{more if unit == 'rad' and turn < problem.duration else ''}"
        )


def warn_of_several(owner: str, problem: Problem) -> None:
    """Warns where all drives repeat after a part of the period already, as whole turns tell."""
    begins, period = float(problem.state.begins), float(problem.duration)
    turns = [
        (float(drive.motion(begins + period)[0]) - float(drive.motion(begins)[0])) / (2 * np.pi)
        for drive, unit in ((drive_of(joint), joint.units[0]) for _, joint in _driven(problem))
        if unit == "rad"
    ]
    times = int(np.gcd.reduce([round(abs(turn)) for turn in turns])) if turns else 0
    parts = (restless(problem, begins + share * period, period / times) for share in LOOKS)
    if times < 2 or restless(problem, begins) or any(parts):
        return
    warn(
        f"the drives repeat after {period / times:.4g} s already, {times} times in the period of "
        f"{period:.6g} s that {owner} is given: a cycle is as long as that. How many cycles there "
        "are is given by name, cycles=..."
    )
