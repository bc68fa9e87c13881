"""How much another friction law than Coulomb's would take where a run takes Coulomb's with its
coefficients: told from the saved states. They are one where a joint slides fast and long, and
others where it sticks, slides slowly, or its bristles yield.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.formulations.base import AbstractFormulation, ContactReport
from jaxclear.formulations.model import Model
from jaxclear.formulations.permanent_reactions import touching
from jaxclear.ground.numerics import safe_divide
from jaxclear.simulation.bristles import settling_length

# A joint that rubs less than this share of what the one that rubs most does is judged beside that.
NEGLIGIBLE = 0.01


def laws_of_others(model: Model, formulation: AbstractFormulation) -> dict[str, Any]:
    """By joint the friction law that is taken as Coulomb's and is another."""
    if not formulation.rubs_as_coulombs:
        return {}
    laws = {
        name: own.friction
        for name, bearing in model.system.bearings.items()
        for own in bearing.contact_laws
        if own.friction is not None
    }
    laws |= {held.name: held.joint.friction for held in touching(model.system)}
    return {name: law for name, law in laws.items() if law is not None and not law.set_valued}


def taken(laws: dict[str, Any], report: Callable[[str], ContactReport]) -> Float[Array, "3 joints"]:
    """Of each joint, of which a `report` tells at a look: the power [W] that Coulomb's law and its
    own take, the larger of both, and how far they are apart; and what its bristles take until they
    yield under the friction of this instant [J]."""
    columns = []
    for name, law in laws.items():
        told = report(name)
        contacts = zip(told.normal_force, told.traction, told.slip_speed, strict=True)
        own = [_of_contact(law, *numbers) for numbers in contacts]
        columns.append(jnp.stack([sum(part) for part in zip(*own, strict=True)]))
    return jnp.stack(columns, axis=1)


def _of_contact(law: Any, normal: Any, drag: Any, slip: Any) -> tuple[Any, Any, Any]:
    """The same of one contact, from normal force [N], friction [N] and slip [m/s]."""
    creep, settled = 0.0, 0.0
    if law.bristles:
        settled = drag * settling_length(law)
    else:
        # As the law begins, through rest: the slip at which its friction holds the contact.
        creep = safe_divide(drag, normal * law.largest_slope(0.0))
    slides = slip > creep
    fast = jnp.where(slides, slip, 1.0)
    coulombs = jnp.where(slides, normal * law.coulomb().bound(fast), drag) * slip
    its_own = jnp.where(slides, normal * law.steady_coefficient(fast) * slip, drag * creep)
    return jnp.maximum(coulombs, its_own), abs(coulombs - its_own), settled


def coulomb_friction(
    found: Float[Array, "looks 3 joints"], times: Float[Array, " looks"]
) -> Float[Array, " joints"]:
    """By joint the share of its friction loss that its own law takes and Coulomb's does not, or the
    other way round, from what was `taken` at looks at these times [s]."""
    power, apart, settled = (found[:, k] for k in range(3))
    widths = jnp.diff(times)[:, None]
    over_run = lambda rate: jnp.sum(0.5 * widths * (rate[1:] + rate[:-1]), axis=0)
    yielded = settled[0] + jnp.sum(abs(jnp.diff(settled, axis=0)), axis=0)
    whole, other = over_run(power) + yielded, over_run(apart) + yielded
    return safe_divide(other, jnp.maximum(whole, NEGLIGIBLE * jnp.max(whole, initial=0.0)))
