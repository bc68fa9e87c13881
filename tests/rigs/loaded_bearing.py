"""A journal pressed into its bearing by a load that swings: at rest it creeps and rolls, spinning
it slides."""

import math

import jax.numpy as jnp

import jaxclear as jc
from jaxclear.components.load import AbstractBodyLoad, Action, Effect
from jaxclear.ground import sparse as sp

# Of the swing: frequency [Hz], amplitude [rad].
FREQUENCY, SWING = 25.0, 0.5
CLEARANCE_RATIO, DENSITY = 1e-2, 1.0 / 10e-3**2


class SwingingLoad(AbstractBodyLoad):
    """A force [N] downwards whose direction swings."""

    marker: jc.Marker
    force: jc.Scalar = jc.quantity(1.0, "N", "load")

    def markers(self):
        return (self.marker,)

    def effect(self, time, motions):
        angle = SWING * jnp.sin(2 * math.pi * FREQUENCY * time)
        force = (self.force * jnp.sin(angle), -self.force * jnp.cos(angle), 0)
        power = sp.dot(force, motions[0].velocity)
        return Effect((Action(self.marker, force, sp.ZERO),), 0, 0, power)


def loaded_bearing(load, friction, *, radius=10e-3, stiffness=1e9, sliding=False, updates=None):
    """The journal under `load` [N]; 1 kg at a radius of 10 mm; `sliding`: at 1 m/s at first;
    `updates`: of its surface in a run, at most."""
    mass = DENSITY * radius**2
    joint = jc.clearance.PlanarJournalBearing(
        jc.contact.CarvalhoMartins(stiffness=stiffness),
        friction,
        bearing_radius=radius,
        clearance=CLEARANCE_RATIO * radius,
        bearing_wear=jc.Wearing(jc.wear.Archard(), updates=updates),
    )
    return jc.Mechanism(
        {"journal": jc.Body(mass, 0.5 * mass * radius**2)},
        {"B": jc.Connection(joint, "ground", "journal")},
        {"load": SwingingLoad(jc.Marker("journal"), load)},
        speeds={"journal": (0.0, 0.0, (1.0 if sliding else 0.0) / radius)},
    )


def losses(run):
    """Friction loss [J], worn volume [m^3], worn depth [m] at the end of a run."""
    return (
        float(run.energy_balance().friction_loss[-1]),
        float(run.worn_volume("B", "bearing")[-1]),
        float(run.worn_depth("B", "bearing").max()),
    )
