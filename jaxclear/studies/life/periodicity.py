"""How far a state is from the one a cycle before, each thing in its own measure.

Poses are compared, not coordinates: a crank that has made a whole turn stands where it stood, and a
quaternion and its opposite are one attitude. A journal counts in shares of its clearance, because
that is what decides its contact.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.multibody.system import longest_arm
from jaxclear.results import histories
from jaxclear.results.state_history import StateHistory, columns, over_time


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
