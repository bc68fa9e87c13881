r"""Couplings that give: from the twist of a transmission to its torque, by stiffness, damping and
play.

The twist s is what is left of the coupling's equation, by the same residual, rate and gradient as
its rigid row; the torque T acts along that gradient against it. With play there are two flanks, an
upper one at s = m + b and a lower one at m - b, of which each is a possible contact: its depth is
positive where it presses, so that steps find touches and releases as they do those of joints.

A flank that is left where its torque would pull has, while it presses, the torque beside the
stiffness for a depth; where the shaft's far end is a state (`flank.Nordin`) a flank that is apart
is met by that end. Which flanks count as pressing may be told (`shares`), so that within a step the
equations are smooth.
"""

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from jaxclear.components.clearance.backlash import middle_of
from jaxclear.components.function_of_angle import value_and_slope
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part, safe_divide, safe_sqrt
from jaxclear.ground.quantity import constant
from jaxclear.laws.transmission import bounded_damper, one_sided
from jaxclear.multibody import kinematics, pose_rows
from jaxclear.multibody.coordinate_sums import read_sum
from jaxclear.multibody.loops import Closure, CoordinateSum
from jaxclear.multibody.meshes import Mesh
from jaxclear.multibody.rows import Direction, OnClosure, OnLink
from jaxclear.multibody.state import Layout
from jaxclear.multibody.system import (
    TWIST,
    System,
    Transmission,
    flanks_that_wear,
    with_worn_flanks,
)
from jaxclear.multibody.tree import Motion, Wrench


class CouplingTwist(NamedTuple):
    """Twist [rad, m] of a transmission, its rate."""

    value: Any
    rate: Any


class Pressing(NamedTuple):
    """What a transmission does at an instant: its `torque` [N m, N] against the twist; the rate of
    its far end (None: it has none); `stored` energy [J] and `dissipated` power [W]; of its flanks,
    upper and lower, depths, their rates (of a far end that presses not known: 0) and torques; none
    without play."""

    torque: Any
    end_rate: Any
    stored: Any
    dissipated: Any
    twist: CouplingTwist
    depths: tuple = ()
    rates: tuple = ()
    torques: tuple = ()


def twist_of(motions: tuple[Motion, ...], train: Transmission) -> CouplingTwist:
    """The twist of a transmission as the links move."""
    closure = train.closure
    if isinstance(closure.reading, CoordinateSum):
        residual, direction = read_sum(motions, closure.reading)
        rate = direction.rate(motions)
    else:
        _, pose, relative = kinematics.relative_motion(closure, motions)
        (residual,), (slope,) = pose_rows.gradients(closure.reading, pose)
        residual = closure.reading.counted(residual, pose, motions)
        rate = pose_rows.rate(slope, pose, relative.velocity, relative.spin)
    value, fast = residual / train.scale, rate / train.scale
    wobble = _wobble(motions, train)
    if wobble is None:
        return CouplingTwist(value, fast)
    more, slope, speed = wobble
    return CouplingTwist(value + more, fast + slope * speed)


def _wobble(motions: tuple[Motion, ...], train: Transmission) -> tuple[Any, Any, Any] | None:
    """What the transmission error of a coupling with a motor adds to a twist [rad], its derivative
    by the coordinate on which it hangs [1], and the speed of this [rad/s]; None of one without."""
    error, reading = train.coupling.transmission_error, train.closure.reading
    if error is None or not isinstance(reading, CoordinateSum):
        return None
    moving = motions[reading.terms[0].link]
    value, slope = value_and_slope(error, moving.coordinates[0])
    share = 1 / train.coupling.ratio
    return share * value, share * slope, moving.speeds[0]


def twist_direction(motions: tuple[Motion, ...], train: Transmission) -> Direction:
    """The direction of a force along the twist of a transmission, times its `scale`."""
    closure, wobble = train.closure, _wobble(motions, train)
    if isinstance(closure.reading, CoordinateSum):
        direction = read_sum(motions, closure.reading)[1]
        if wobble is None:
            return direction
        first = closure.reading.terms[0].link
        return Direction((*direction.places, OnLink(first, train.scale * wobble[1])))
    pose = kinematics.relative_motion(closure, motions)[1]
    (slope,) = pose_rows.gradients(closure.reading, pose)[1]
    return Direction((OnClosure(closure, pose, Wrench(*slope.wrench(pose))),))


class Compliance(NamedTuple):
    """What lies between the two sides of a transmission: play, stiffness, damping; of a belt the
    twist at which one strand goes `slack` (None: neither does)."""

    play: Any
    stiffness: Any
    damping: Any
    slack: Any = None


def compliance_of(train: Transmission) -> Compliance:
    """What lies between the two sides of a transmission."""
    coupling = train.coupling
    return Compliance(coupling.play, coupling.stiffness, coupling.damping, coupling.slack_twist())


def press_flanks(
    spring: Compliance, twist: CouplingTwist, end: Any = None, shares: Any = None
) -> Pressing:
    """Torque, energy and flanks of a transmission at a twist.

    Args:
        spring: play, stiffness and damping.
        twist: at the instant, with its rate [rad, rad/s; m, m/s].
        end: position of the shaft's far end from the middle of the gap; None: the law has none.
        shares: 1 for touching and 0 for apart, of the upper and lower flank; None: by position.
    """
    play, stiffness, damping, slack = spring
    if slack is not None:
        return _strand_pressing(spring, twist)
    if play is None:
        viscous = 0 if damping is None else damping * twist.rate
        loss = sp.mul(viscous, twist.rate)
        elastic = stiffness * twist.value
        return Pressing(sp.add(elastic, viscous), None, 0.5 * elastic * twist.value, loss, twist)
    half = 0.5 * play.play
    place = sp.sub(twist.value, middle_of(play))
    sides = ((place - half, twist.rate), (-place - half, -twist.rate))
    torques = []
    for depth, rate in sides:
        viscous = 0.0 if damping is None else damping * rate
        torques.append(play.law.torque(stiffness * depth, viscous))
    # At rest a shaft needs no damping.
    if end is not None and damping is not None:
        return _with_end(spring, twist, (place, half, end), (torques, shares))
    depths: tuple = tuple(side[0] for side in sides)
    rates = tuple(side[1] for side in sides)
    if play.law.separates_by_torque:
        by_torque = [torque / stiffness for torque in torques]
        depths = tuple(map(jnp.minimum, depths, by_torque))
        if shares is not None:
            each = zip(shares, by_torque, depths, strict=True)
            depths = tuple(jnp.where(share > 0, a, b) for share, a, b in each)
    touching = shares
    if shares is None:
        touching = [jnp.where(depth >= 0, 1.0, 0.0) for depth in depths]
    acting = [share * torque for share, torque in zip(touching, torques, strict=True)]
    stored, loss = 0, 0
    for (depth, rate), torque in zip(sides, acting, strict=True):
        # What is left in a flank as it goes back without the other part is lost.
        stored = stored + 0.5 * stiffness * positive_part(depth) * depth
        loss = loss + torque * rate - jnp.where(depth > 0, stiffness * depth * rate, 0.0)
    parts = (acting[0] - acting[1], None, stored, loss, twist)
    return Pressing(*parts, depths, rates, tuple(acting))


def _strand_pressing(belt: Compliance, twist: CouplingTwist) -> Pressing:
    """The same of a belt whose two strands share its stiffness, and pull alone."""
    half = None if belt.damping is None else 0.5 * belt.damping
    pulls = [
        one_sided(belt.slack + sign * twist.value, sign * twist.rate, 0.5 * belt.stiffness, half)
        for sign in (1.0, -1.0)
    ]
    stored, loss = (sp.add(*(getattr(x, part) for x in pulls)) for part in ("stored", "dissipated"))
    return Pressing(pulls[0].force - pulls[1].force, None, stored, loss, twist)


def _with_end(spring: Compliance, twist: CouplingTwist, places: tuple, flanks: tuple) -> Pressing:
    """The same of a shaft in series with the gap: `places` (from the middle of the gap, half of it,
    far end), `flanks` (torques as if touching, shares)."""
    (place, half, end), (torques, shares), rate = places, flanks, twist.rate
    _, stiffness, damping, _ = spring
    gaps = (end - half, -end - half)
    touched = [(gap >= 0) & (torque >= 0) for gap, torque in zip(gaps, torques, strict=True)]
    natural = [jnp.where(each, 1.0, 0.0) for each in touched]
    touching = natural if shares is None else shares
    acting = [share * torque for share, torque in zip(touching, torques, strict=True)]
    free = 1.0 - touching[0] - touching[1]
    slack = (stiffness / damping) * (place - end)
    end_rate = free * (rate + slack)
    wound = sum(
        share * (sign * place - half) for share, sign in zip(touching, (1.0, -1.0), strict=True)
    )
    wound = jnp.abs(wound) + free * jnp.abs(place - end)
    stored = 0.5 * stiffness * wound * wound
    torque = acting[0] - acting[1]
    loss = (1 - free) * damping * rate * rate + free * stiffness * wound * wound * (
        stiffness / damping
    )
    depths, rates = [], []
    for k, (gap, pressed) in enumerate(zip(gaps, torques, strict=True)):
        sign = 1.0 if k == 0 else -1.0
        by_torque = gap >= 0 if shares is None else shares[k] > 0
        depths.append(jnp.where(by_torque, pressed / stiffness, gap))
        rates.append(sign * end_rate)
    parts = (torque, end_rate, stored, loss, twist)
    return Pressing(*parts, tuple(depths), tuple(rates), tuple(acting))


def _mean_depth(depth: Any, path: Any) -> tuple[Any, Any]:
    """From a depth so far on, negative where nothing is touched: the mean depth where something is,
    times the share of the way, and that share."""
    first, last = positive_part(depth), positive_part(depth + path)
    share = jnp.where(path == 0, jnp.where(depth > 0, 1.0, 0.0), safe_divide(last - first, path))
    return 0.5 * (first + last) * share, share


def _mean_strand_torque(belt: Compliance, twist: CouplingTwist, length: Any) -> Any:
    """The same of a belt."""
    torques = []
    for sign in (1.0, -1.0):
        depth, share = _mean_depth(belt.slack + sign * twist.value, sign * length * twist.rate)
        elastic = 0.5 * belt.stiffness * depth
        viscous = 0.0 if belt.damping is None else 0.5 * belt.damping * share * sign * twist.rate
        torques.append(elastic + bounded_damper(elastic, viscous))
    return torques[0] - torques[1]


def mean_torque(spring: Compliance, twist: CouplingTwist, end: Any, length: Any) -> Any:
    """Mean torque [N m, N] over a step, by the discrete gradient of the spring's energy.

    A damper acts on the share of the step's travel on which its flank touches.

    Args:
        spring: play, stiffness and damping.
        twist: at the start of the step, with its mean rate over the step.
        end: position of the shaft's far end at the start (`press_flanks`); None: the law has none.
        length: of the step [s].

    Source: Gonzalez 1996, J. Nonlinear Sci. 6, 449, doi:10.1007/BF02440162.
    """
    play, stiffness, damping, slack = spring
    if slack is not None:
        return _mean_strand_torque(spring, twist, length)
    if play is None:
        viscous = 0 if damping is None else damping * twist.rate
        return sp.add(stiffness * (twist.value + 0.5 * length * twist.rate), viscous)
    half = 0.5 * play.play
    place = sp.sub(twist.value, middle_of(play))
    torques = []
    for sign in (1.0, -1.0):
        depth, path = sign * place - half, sign * length * twist.rate
        if end is not None:
            # A shaft that has let go is met where its end is.
            gap = sign * end - half
            depth = jnp.where(gap >= 0, depth, gap)
        touched, share = _mean_depth(depth, path)
        elastic = stiffness * touched
        viscous = 0.0 if damping is None else damping * share * sign * twist.rate
        torques.append(positive_part(play.law.torque(elastic, viscous)))
    return torques[0] - torques[1]


def end_at_start(train: Transmission, twist: CouplingTwist) -> Any:
    """Where a relaxed shaft's far end is from the middle of its gap."""
    play = train.coupling.play
    half = 0.5 * play.play
    return jnp.clip(twist.value - middle_of(play), -half, half)


def torque_on_flanks(train: Transmission, depths: Any, rates: Any) -> Any:
    """Torques [N m, N] of flanks at given depths and rates, by the law of `press_flanks`.

    Args:
        train: transmission with play.
        depths: indentation of each flank [rad, m].
        rates: their rates [rad/s, m/s].
    """
    coupling = train.coupling
    elastic = coupling.stiffness * depths
    if train.has_twist:
        return jnp.maximum(elastic, 0.0)
    viscous: Any = 0.0 if coupling.damping is None else coupling.damping * rates
    if coupling.play.law.separates_by_torque:
        # As it falls off the depth is the torque's own.
        viscous = positive_part(viscous)
    return jnp.where(depths >= 0, coupling.play.law.torque(elastic, viscous), 0.0)


def within_gaps(system: System, layout: Layout, entries: list) -> list:
    """The entries of a state with the far ends of shafts clipped to their gaps.

    The correction is a constant: derivatives stay as they were.

    Args:
        system: with the transmissions' plays.
        layout: where the far ends sit.
        entries: of the state, scalars.
    """
    result = list(entries)
    for i, (owner, state) in enumerate(layout.states):
        train = system.transmissions.get(owner)
        if train is not None and state == TWIST:
            place, half = layout.state_start + i, 0.5 * train.coupling.play.play
            moved = jnp.clip(result[place], -half, half) - result[place]
            result[place] = result[place] + constant(moved)
    return result


def between_worn_flanks(
    system: System, layout: Layout, worn: tuple[dict, dict], state: Array
) -> Array:
    """The state with far ends of shafts moved along with the flanks on which they lie.

    Off its flank a shaft would transmit nothing.

    Args:
        system: with the transmissions whose flanks wear.
        layout: where the far ends sit.
        worn: depths [m] by coupling and flank, before and after the update.
        state: shape (n,).
    """
    flanks = flanks_that_wear(system)
    for i, (owner, name) in enumerate(layout.states):
        if owner not in flanks or name != TWIST:
            continue
        plays = [with_worn_flanks(system, each).transmissions[owner].coupling.play for each in worn]
        (half, middle), (wider, moved) = ((0.5 * p.play, middle_of(p)) for p in plays)
        end = state[layout.state_start + i]
        on_lower = (end <= -half) & ((end < half) | (moved < middle))
        inside = jnp.clip(end + middle - moved, -wider, wider)
        on_flank = jnp.where(on_lower, -wider, jnp.where(end >= half, wider, inside))
        state = state.at[layout.state_start + i].set(on_flank)
    return state


def pulls_of_centres(
    motions: tuple[Motion, ...], meshes: Iterable[tuple[Closure, Any]]
) -> Iterator[OnClosure]:
    """What draws the axes of couplings of bodies together, from their closures and the forces [N]
    along their residuals."""
    for closure, force in meshes:
        if not isinstance(closure.reading, Mesh):
            continue
        pose = kinematics.relative_motion(closure, motions)[1]
        pull = closure.reading.coupling.pull_of_centres(force, pose)
        if pull is not None:
            x, y, _ = pose.translation
            share = -pull / safe_sqrt(jnp.asarray(sp.add(sp.mul(x, x), sp.mul(y, y)), float))
            wrench = Wrench((sp.mul(share, x), sp.mul(share, y), 0), sp.ZERO)
            yield OnClosure(closure, pose, wrench)
