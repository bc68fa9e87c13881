"""How far a mechanism has gone: what a difference of places is measured by."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.formulations.model import Model
from jaxclear.ground.numerics import safe_sqrt
from jaxclear.ground.quantity import Scalar
from jaxclear.multibody.reach import driven_ways, narrowest_gap, reaches, rooms, turning
from jaxclear.multibody.system import System, longest_arm
from jaxclear.simulation.tally import Tally

# A turn moves bodies by no more than so many arms; less than so many clearances is no way.
ACROSS, GAPS = 2.0, 100.0
# Beside the longest arm: what goes less far stands still, and rounding is no motion.
STILL = 1e-9
# Share of the way on which drives lead below which one is not measured by itself.
LEAST = 0.1
# How far drives lead, as `driven_ways` has it.
Led = list[tuple[Scalar, bool]]


def longest_way(model: Model, tally: Tally, led: Led) -> Float[Array, ""]:
    """The longest way of a coordinate [m], or a tenth of that on which drives lead: a joint that a
    spring holds still while its arm is swung goes nowhere by itself. No more than that of a turn
    there and back, no less than `GAPS` clearances, or `STILL`."""
    system, way, arm = model.system, tally.reach, longest_arm(model.system)
    turned = jnp.where(turning(system), jnp.minimum(way, ACROSS), way)
    longest = jnp.max(turned * reaches(system, arm), initial=0.0)
    longest = jnp.maximum(longest, STILL * arm)
    if system.bearings:
        longest = jnp.maximum(longest, GAPS * narrowest_gap(system))
    for way_led, turns in led:
        across = jnp.minimum(way_led, ACROSS) * arm if turns else way_led
        longest = jnp.maximum(longest, LEAST * across)
    return longest


def of_coordinates(
    model: Model, states: Float[Array, "looks n"], tally: Tally, times: Float[Array, " time"]
) -> tuple[Float[Array, "looks coordinates"], Float[Array, ""]]:
    """(what the coordinates of states are as ways [m], by which way they are measured [m])."""
    reach = reaches(model.system, longest_arm(model.system))
    led = driven_ways(model.system, times)
    return states[:, : model.layout.coordinates] * reach, longest_way(model, tally, led)


def of_centres(
    system: System, centres: Float[Array, "looks centres"], places: Float[Array, "looks places"]
) -> tuple[Float[Array, "looks centres"], Float[Array, ""]]:
    """(how far centres of mass have gone [m], by which way that is measured [m]): the longest, or
    `GAPS` times as far as a part comes from the middle of its gap, where it has such `places`, if
    that is more."""
    gone = centres - centres[0]
    off_middle = safe_sqrt(jnp.sum(places.reshape(len(places), -1, 3) ** 2, axis=-1))
    furthest = jnp.max(off_middle * rooms(system), initial=0.0)
    return gone, jnp.maximum(jnp.max(abs(gone), initial=0.0), GAPS * furthest)
