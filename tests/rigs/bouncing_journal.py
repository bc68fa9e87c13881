"""A journal that falls from rest from the middle of its bearing, straight down, and bounces."""

import jaxclear as jc

MASS, GRAVITY = 2.0, 9.81
# Not set down in the middle at its start again.
LEFT_THERE = jc.State(concentric=False)
CLEARANCE = lambda mechanism: mechanism.connections["B"].joint.clearance


def falling(law):
    """The journal, with a contact law."""
    bearing = jc.clearance.PlanarJournalBearing(law, clearance=1e-3)
    return jc.Mechanism(
        {"journal": jc.Body(MASS, 1e-3)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {"gravity": jc.load.Gravity((0.0, -GRAVITY))},
    )
