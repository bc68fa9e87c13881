"""Normal forces of contacts that damp, from their motion: such a contact presses hardest before it
is deepest, as early as at its touch, so that its deepest indentation does not tell how hard.
"""

import jax.numpy as jnp

from jaxclear.components.clearance import ContactLaws
from jaxclear.formulations.contacts_over_step import ContactOverStep
from jaxclear.formulations.impact_speed import ContactMotion, PerContact
from jaxclear.formulations.model import Model, State
from jaxclear.ground import sparse as sp
from jaxclear.ground.quantity import Scalar
from jaxclear.multibody.contact_point import impact_speed_now
from jaxclear.multibody.state import impact_speed_places
from jaxclear.multibody.system import System


def told_by_depth(laws: ContactLaws) -> bool:
    """Whether a contact presses hardest where it is deepest, or by a law that follows its worn
    radius, which is not known between saving times."""
    return laws.contact.lossless or laws.unfitted is not None


def damped(system: System) -> bool:
    """Whether some contact's largest force is not told by its depth."""
    return not all(map(told_by_depth, _laws(system)))


def normal_forces(model: Model, state: State, motion: ContactMotion) -> PerContact:
    """Normal force [N] of every possible contact that damps, 0 of the others, from its motion and
    the impact speed that the state remembers."""
    forces: list[Scalar | float] = []
    places = impact_speed_places(model.layout)
    for k, (laws, place) in enumerate(zip(_laws(model.system), places, strict=True)):
        if told_by_depth(laws):
            forces.append(0.0)
            continue
        rate = motion.rates[k]
        speed = impact_speed_now(None if place is None else state[place], rate)
        forces.append(laws.contact.normal_force(motion.depths[k], rate, speed))
    return jnp.asarray(sp.stack(forces))


def forces_at_start(system: System, contacts: list[ContactOverStep], faster: list) -> tuple:
    """The same where an implicit step begins with these contacts, which close faster than their
    speeds tell (`midpoint_step`) [m/s]; () where none damps."""
    if not damped(system):
        return ()
    return tuple(
        0.0
        if told_by_depth(contact.point.laws)
        else contact.point.laws.contact.normal_force(
            contact.depth, sp.add(contact.approach, more), contact.memory.impact_speed
        )
        for contact, more in zip(contacts, faster, strict=True)
    )


def _laws(system: System) -> list[ContactLaws]:
    return [own for bearing in system.bearings.values() for own in bearing.contact_laws]
