"""Rows that follow from others everywhere are superfluous; at a singular position none is."""

import pytest

import jaxclear as jc
from jaxclear.multibody.assembly import ready

TURN = jc.joint.Revolute()


def four_bar(places, foot=(0.4, 0.0, 0.0), rocker=(0.3, 0.0, 0.0), inertia=(1e-2, 1e-2, 1e-2)):
    """Crank, coupler and rocker; places of joints by so many numbers."""
    bodies = dict.fromkeys(("crank", "coupler", "rocker"), jc.Body(1.0, inertia))
    rocker = jc.Marker("rocker", rocker[:places])
    return jc.Mechanism(
        bodies,
        {
            "O": jc.Connection(TURN, "ground", "crank"),
            "A": jc.Connection(TURN, "crank", "coupler", at=(0.1, 0.0, 0.0)[:places]),
            "B": jc.Connection(TURN, "coupler", "rocker", at=(0.4, 0.0, 0.0)[:places]),
            "D": jc.Connection(TURN, "ground", rocker, at=foot[:places]),
        },
        guess={"O": 1.0, "A": -0.6},
    )


def over_driven():
    turning = jc.joint.Revolute(drive=jc.drive.ConstantSpeed(1.0))
    tip = jc.Marker("arm", (0.0, 0.0, 0.1))
    held = jc.Connection(jc.joint.Spherical(), "ground", tip, at=(0.0, 0.0, 0.1))
    pin = jc.Connection(turning, "ground", "arm")
    return jc.Mechanism({"arm": jc.Body(1.0, (1e-2, 1e-2, 1e-2))}, {"pin": pin, "tip": held})


@pytest.mark.filterwarnings("ignore:guess=.* has led to")
@pytest.mark.parametrize(
    ("build", "rows"),
    [
        (lambda: four_bar(3), {"z", "x.z", "y.z"}),
        (lambda: four_bar(2), {"z", "x.z", "y.z"}),
        (over_driven, {"x", "y", "z"}),
    ],
    ids=["planar loop in space", "its places two numbers each", "held and driven"],
)
def test_rows_that_follow_from_others_are_found(build, rows):
    rig = build()
    found = ready(rig)[0].topology.redundancy
    assert {name for _, name in found.rows} == rows
    assert {*"OABD"} & {*rig.connections} <= {*found.joints}


def test_singular_position_is_no_superfluous_joint():
    """A stretched parallelogram has dependent rows there only, and the user is warned."""
    crank, foot = (-0.1, 0.0, 0.0), (0.4, 0.0, 0.0)
    parallelogram = four_bar(2, foot, crank, inertia=1e-2)
    stretched = jc.Mechanism(parallelogram.bodies, parallelogram.connections)
    with pytest.warns(UserWarning, match="links in one line"):
        assert ready(stretched)[0].topology.redundancy is None
