"""A heavy slider-crank that a torque on its crank pushes."""

import jaxclear as jc


def slider_crank(loads, angle, pin=None, slide=None):
    """Crank of 0.2 m and rod of 0.5 m, from this angle [rad] of the crank. `pin`: joints at both
    ends of the crank; `slide`: of the slider."""
    turn, pin = jc.joint.Revolute(), pin or jc.joint.Revolute()
    return jc.Mechanism(
        {
            "crank": jc.Body(1.0, 0.01, com=(0.1, 0.0)),
            "rod": jc.Body(0.5, 0.005, com=(0.25, 0.0)),
            "slider": jc.Body(2.0, 0.01),
        },
        {
            "O": jc.Connection(pin, "ground", "crank"),
            "A": jc.Connection(pin, "crank", "rod", at=(0.2, 0.0)),
            "B": jc.Connection(turn, "rod", "slider", at=(0.5, 0.0)),
            "G": jc.Connection(slide or jc.joint.Prismatic(), "ground", "slider", axis="x"),
        },
        loads,
        start={"O": angle},
    )
