"""Scene files of ready mechanisms, to begin with: each runs as it is, states what varies of it, and
what is asked of it.
"""

import math
from collections.abc import Callable

import click

import jaxclear as jc
from jaxclear.files.scene import scene_text
from jaxclear.scenes.antenna import BASE, TIP

# Half of the allowed variation [m]; assumed, of a usual machining grade.
GRADE = 20e-6


def _slider_crank() -> jc.Scene:
    return jc.Scene(
        jc.scenes.slider_crank(),
        duration=0.126,
        save=253,
        variables={
            "clearance": _place(lambda rig: rig.connections["B"].joint.clearance),
            "rod length": _place(lambda rig: rig.connections["B"].parent.at[0]),
        },
        responses={
            "mean force": jc.response.MeanContactForce("B"),
            "peak force": jc.response.PeakContactForce("B"),
        },
        description="Slider-crank at 50 rad/s with 0.2 mm of clearance between rod and slider.",
    )


def _four_bar() -> jc.Scene:
    return jc.Scene(
        jc.scenes.four_bar("planar"),
        duration=2 * math.pi / 10.0,
        save=501,
        variables={
            "clearance": _place(lambda rig: rig.connections["B"].joint.clearance),
            "coupler length": _place(lambda rig: rig.connections["B"].parent.at[0]),
        },
        responses={
            "worn depth": jc.response.PeakWornDepth("B"),
            "mean force": jc.response.MeanContactForce("B"),
        },
        description="Four-bar that wears in the joint between coupler and follower, one turn.",
    )


def _antenna() -> jc.Scene:
    rig = jc.scenes.antenna("spatial", 100e-6)
    return jc.Scene(
        rig,
        duration=1.0,
        save=101,
        integrator=jc.integrator.NonColliding(1e-3),
        variables={
            f"{name} clearance": _place(
                lambda rig, name=name: rig.connections[name].joint.clearance
            )
            for name in ("J1", "J2")
        },
        responses={"pointing error": jc.response.PointingAngle(TIP, BASE)},
        description="Antenna on a satellite, a period of its drive; joints always in contact.",
    )


def _place(where: Callable) -> jc.Variable:
    return jc.Variable(where, tolerance=GRADE)


EXAMPLES = {"slider-crank": _slider_crank, "four-bar": _four_bar, "antenna": _antenna}


def example(name: str) -> None:
    """Prints the scene file of a ready mechanism."""
    click.echo(scene_text(EXAMPLES[name]()), nl=False)
