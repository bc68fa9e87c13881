"""Where a mechanism is and how far it has gone: what a difference of places is measured by."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.formulations.model import Instant, Model
from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import AROUND_A_KERNEL, compiled_quickly
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.pose import REST
from jaxclear.ground.quantity import Scalar
from jaxclear.multibody import contact_point, kinematics
from jaxclear.multibody.reach import driven_ways, narrowest_gap, reaches, rooms, turning
from jaxclear.multibody.system import System, longest_arm
from jaxclear.results.state_history import StateHistory
from jaxclear.simulation.looks import Looks, look

# A turn moves bodies by no more than so many arms; less than so many clearances is no way.
ACROSS, GAPS = 2.0, 100.0
# Beside the longest arm: what goes less far stands still, and rounding is no motion.
STILL = 1e-9
# Share of the way on which drives lead below which one is not measured by itself.
LEAST = 0.1
# How far drives lead, as `driven_ways` has it.
Led = list[tuple[Scalar, bool]]


def longest_way(model: Model, reach: Float[Array, " coordinates"], led: Led) -> Float[Array, ""]:
    """The longest way of a coordinate [m], where each has been so far from its start at most
    (`reach`), or a tenth of that on which drives lead: a joint that a spring holds still while its
    arm is swung goes nowhere by itself. No more than that of a turn there and back, no less than
    `GAPS` clearances, or `STILL`."""
    system, arm = model.system, longest_arm(model.system)
    turned = jnp.where(turning(system), jnp.minimum(reach, ACROSS), reach)
    longest = jnp.max(turned * reaches(system, arm), initial=0.0)
    longest = jnp.maximum(longest, STILL * arm)
    if system.bearings:
        longest = jnp.maximum(longest, GAPS * narrowest_gap(system))
    for way_led, turns in led:
        across = jnp.minimum(way_led, ACROSS) * arm if turns else way_led
        longest = jnp.maximum(longest, LEAST * across)
    return longest


class Whereabouts(NamedTuple):
    """Where a run was at its looks: `places` in gaps (as `_in_gaps`; None: there are none), and
    `gone`, how far centres of mass have gone [m] (without gaps: what the coordinates are as ways),
    with the `way` [m] by which that is measured."""

    places: Float[Array, "looks places"] | None
    gone: Float[Array, "looks components"]
    way: Float[Array, ""]


def _whereabouts(history: StateHistory) -> Whereabouts:
    model = history.model()
    looks = look(history, model, {})
    if not model.system.bearings:
        return _of_coordinates(looks)
    inside = lambda now, _: {"places": _in_gaps(now), "centres": _centres(now)}
    said = looks.of(inside)
    return _of_centres(model.system, said["centres"], said["places"])


# Of two runs that are compared; no other run pays for it.
whereabouts = compiled_quickly(_whereabouts, AROUND_A_KERNEL)


def _of_coordinates(looks: Looks) -> Whereabouts:
    model, times = looks.model, looks.history.time
    places = looks.history.states[:, : model.layout.coordinates]
    reach = jnp.max(abs(places - places[0]), axis=0)
    way = longest_way(model, reach, driven_ways(model.system, times))
    arms = reaches(model.system, longest_arm(model.system))
    return Whereabouts(None, places[looks.rows] * arms, way)


def _of_centres(
    system: System, centres: Float[Array, "looks centres"], places: Float[Array, "looks places"]
) -> Whereabouts:
    """By the longest way of a centre, or `GAPS` times as far as a part comes from the middle of its
    gap, where it has such `places`, if that is more."""
    gone = centres - centres[0]
    off_middle = safe_sqrt(jnp.sum(places.reshape(len(places), -1, 3) ** 2, axis=-1))
    furthest = jnp.max(off_middle * rooms(system), initial=0.0)
    way = jnp.maximum(jnp.max(abs(gone), initial=0.0), GAPS * furthest)
    return Whereabouts(places, gone, way)


def _centres(now: Instant) -> Float[Array, " components"]:
    """Where the centres of mass are [m] (3 components a body)."""
    places: list[Any] = []
    for link, motion in zip(now.model.system.links, now.motions, strict=True):
        inner = sp.scale(safe_divide(1.0, link.mass), link.first_moment)
        places += motion.pose.point(inner)
    return sp.stack(places)


def _in_gaps(now: Instant) -> Float[Array, " components"]:
    """Where each contact's parts are in their gap, beside its width: the vector from the middle
    along which it closes, in the bearing's axes (3 components a contact)."""
    places: list[Any] = []
    for name, bearing in now.model.system.bearings.items():
        _, pose, _ = kinematics.relative_motion(bearing.closure, now.motions)
        rooms = contact_point.depths(bearing.joint, REST, {})
        contacts = contact_point.gap_function(bearing.joint, pose, now.model.worn.get(name, {}))
        for room, contact in zip(rooms, contacts, strict=True):
            width = abs(room)
            share = safe_divide(contact.indentation + width, width)
            places += sp.scale(share, contact.slope)
    return sp.stack(places)
