"""A journal that falls, slides and wears in its bearing: the mechanism that several tests of this
room run."""

import jaxclear as jc


def touching_journal():
    """A journal that falls from the middle of its bearing under gravity, with friction and wear."""
    bearing = jc.clearance.PlanarJournalBearing(
        jc.contact.Flores(stiffness=1e8, restitution=0.5),
        jc.friction.CoulombTanh(mu_kinetic=0.1, transition_speed=1e-2),
        clearance=1e-3,
        bearing_wear=jc.Wearing(jc.wear.Archard()),
    )
    return jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {"gravity": jc.load.Gravity()},
        speeds={"journal": (0.05, 0.0, 2.0)},
    )
