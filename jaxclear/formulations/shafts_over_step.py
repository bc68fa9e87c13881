"""Couplings with stiffness over an implicit step, so that no step is too long for a stiff one.

What acts is the mean over the step at a mean rate (`transmissions.mean_torque`): springs give back
what they have taken. It is found with what contacts do (`LinearLaws`); the torque at the predicted
place, which the equations of motion know, is taken out of them.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxclear.formulations.contact_rows import FreeMotion
from jaxclear.formulations.delassus import LinearLaws
from jaxclear.formulations.laws_over_step import Averaging
from jaxclear.formulations.model import Model
from jaxclear.ground import sparse as sp
from jaxclear.multibody import transmissions
from jaxclear.multibody.rows import LinearRate
from jaxclear.multibody.transmissions import Compliance, CouplingTwist


class ShaftOverStep(NamedTuple):
    """A coupling over a step of a `length` [s]: what lies between its sides, its rate, its twist
    as the step begins, and where a shaft's far end is (None: it has none)."""

    compliance: Compliance
    rates: tuple[LinearRate]
    twist: Any
    end: Any
    length: Any
    reaches: tuple

    def linear(self, rates: tuple) -> LinearLaws:
        """Its law about a mean rate."""
        torque = lambda rate: transmissions.mean_torque(
            self.compliance, CouplingTwist(self.twist, rate), self.end, self.length
        )
        rate = jnp.asarray(rates[0], float)
        value, slope = jax.jvp(torque, (rate,), (jnp.ones_like(rate),))
        return LinearLaws([-value], [jnp.maximum(slope, 0.0)], rates)


def shafts_over_step(
    model: Model, free_motion: FreeMotion, back: list, averaging: Averaging
) -> tuple[tuple[ShaftOverStep, ...], FreeMotion]:
    """The couplings with stiffness over a step, and the free motion without them; `back`: by how
    much the speeds at its start differ from those in its middle."""
    system, forces = model.system, free_motion.forces
    length = averaging.length
    result, right = [], list(free_motion.right)
    for name, train in system.transmissions.items():
        pressing = forces.pressing[name]
        states = forces.followed.states.get(name)
        end = states[0] if train.has_twist and states is not None else None
        row = transmissions.twist_direction(forces.motions, train).jacobian(system, forces.motions)
        rate = LinearRate(pressing.twist.rate, {j: x / train.scale for j, x in row.items()})
        start = pressing.twist.value - 0.5 * length * rate.at(back)
        compliance = transmissions.compliance_of(train)
        reaches = averaging.reaches
        result.append(ShaftOverStep(compliance, (rate,), start, end, length, reaches))
        for j, entry in rate.row.items():
            right[j] = sp.add(right[j], sp.mul(pressing.torque, entry))
    return tuple(result), free_motion._replace(right=tuple(right)) if result else free_motion
