"""A mechanism with one of everything: the one whose program must not depend on its numbers."""

import jaxclear as jc


def full_loop(speed=10.0):
    """Clearance, friction with and without memory, wear, every kind of load, a drive, a loop and
    its stabilisation."""
    law = jc.contact.CarvalhoMartins(stiffness=1e8, restitution=0.8)
    wear = jc.Wearing(jc.wear.Archard(wear_coefficient=1e-4, hardness=2e9), cells=(12, 1))
    bearing = jc.clearance.PlanarJournalBearing(law, jc.friction.LuGre(), bearing_wear=wear)
    marker = jc.Marker("coupler", (0.1, 0.0))
    return jc.Mechanism(
        {name: jc.Body(0.5, 1e-3, (0.1, 0.01)) for name in ("crank", "coupler", "rocker", "blade")},
        {
            "O": jc.Connection(
                jc.joint.Revolute(drive=jc.drive.RampUp(speed, 0.05)), "ground", "crank"
            ),
            "A": jc.Connection(jc.joint.Revolute(), "crank", "coupler", at=(0.1, 0.0)),
            "B": jc.Connection(jc.joint.Revolute(), "coupler", "rocker", at=(0.3, 0.0)),
            "D": jc.Connection(
                jc.joint.Revolute(), "ground", jc.Marker("rocker", (0.25, 0.0)), at=(0.3, 0.0)
            ),
            "C": jc.Connection(bearing, "rocker", jc.Marker("blade", (0.02, 0.0)), at=(0.3, 0.05)),
        },
        {
            "gravity": jc.load.Gravity(),
            "push": jc.load.Force(marker, (1.0, 2.0)),
            "twist": jc.load.Torque(marker, 0.1),
            "spring": jc.load.Spring(jc.Marker("ground", (0.2, 0.4)), marker, 10.0, 0.1, 0.5),
            "hinge": jc.load.JointSpring("A", 1.0, 0.1, 0.01),
            "motor": jc.load.JointTorque("A", 0.02),
        },
        guess={"A": -0.5, "D": 0.3},
    )
