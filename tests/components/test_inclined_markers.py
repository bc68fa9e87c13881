"""Markers whose axis is inclined in the plane, by its direction or by an angle."""

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.ground import sparse as sp

SLOPE, GRAVITY, END = np.deg2rad(35.0), 9.81, 0.5
DIRECTION = (np.cos(SLOPE), np.sin(SLOPE))
INCLINED = {
    "two numbers": {"axis": DIRECTION},
    "three numbers": {"axis": (*DIRECTION, 0.0)},
    "an array": {"axis": 7.0 * np.array([*DIRECTION, 0.0])},
    "an angle": {"axis": "x", "angle": SLOPE},
}


def frame(**turned):
    rotation = jc.Marker("part", **turned).pose().rotation
    return np.asarray(sp.dense(rotation), float).reshape(3, 3)


@pytest.mark.parametrize("name, numbers", [("x", (3.0, 0.0, 0.0)), ("y", (0.0, 0.5, 0.0))])
def test_a_named_axis_is_that_of_its_numbers(name, numbers):
    np.testing.assert_allclose(frame(axis=name), frame(axis=numbers), atol=1e-15)


@pytest.mark.parametrize("how", INCLINED)
def test_an_inclined_frame_turns_that_of_x_about_z(how):
    turn = np.array(sp.dense(jc.pose.rotation_z(SLOPE)), float).reshape(3, 3)
    np.testing.assert_allclose(frame(**INCLINED[how]), turn @ frame(axis="x"), atol=1e-15)


def test_an_angle_turns_every_other_orientation():
    turn = np.array(sp.dense(jc.pose.rotation_z(SLOPE)), float).reshape(3, 3)
    for way in ({"axis": (1.0, 2.0, 2.0)}, {"quaternion": (1.0, 0.5, 0.0, 0.2)}, {"axis": "-z"}):
        np.testing.assert_allclose(frame(angle=SLOPE, **way), turn @ frame(**way), atol=1e-15)


def slope(**turned):
    """A block that slides down a slope: s = g sin(angle) t^2 / 2."""
    ends = (
        jc.Marker("ground", **turned),
        jc.Marker("block", axis="-x" if "angle" in turned else "x"),
    )
    return jc.Mechanism(
        {"block": jc.Body(1.0, 1e-3)},
        {"guide": jc.Connection(jc.joint.Prismatic(), *ends)},
        {"gravity": jc.load.Gravity((0.0, -GRAVITY))},
    )


def test_a_block_slides_along_a_direction_of_numbers():
    run = jc.simulate(slope(axis=(-DIRECTION[0], -DIRECTION[1], 0.0)), END, save=3)
    way = float(np.ravel(run.coordinate("guide"))[-1])
    assert abs(way / (0.5 * GRAVITY * np.sin(SLOPE) * END**2) - 1) < 1e-7
    # Parts that are joined in the plane stay in it.
    np.testing.assert_allclose(run.body("block").origin[:, 2], 0.0, atol=1e-12)


def test_the_slope_of_a_guide_varies_by_its_angle():
    rig = slope(axis="-x", angle=SLOPE)
    steps = jc.integrator.FixedStep(0.05, method="rk4")

    def way(angle):
        other = eqx.tree_at(lambda own: own.connections["guide"].parent.angle, rig, angle)
        run = jc.simulate(other, END, save=3, integrator=steps, throw=False)
        return run.coordinate("guide").ravel()[-1]

    found, slid = jax.jvp(way, (SLOPE,), (1.0,))
    scale = 0.5 * GRAVITY * END**2
    np.testing.assert_allclose([found, slid], scale * np.array([np.sin(SLOPE), np.cos(SLOPE)]))


def test_a_loop_closes_through_a_guide_of_an_inclined_direction():
    crank, rod, turned = 0.04, 0.15, 0.8
    joints = {
        "O": jc.Connection(jc.joint.Revolute(drive=jc.drive.ConstantSpeed(5.0)), "ground", "crank"),
        "A": jc.Connection(jc.joint.Revolute(), jc.Marker("crank", (crank, 0.0)), "rod"),
        "B": jc.Connection(jc.joint.Revolute(), jc.Marker("rod", (rod, 0.0)), "block"),
        "guide": jc.Connection(
            jc.joint.Prismatic(),
            jc.Marker("ground", axis=(*DIRECTION, 0.0)),
            jc.Marker("block", axis="x"),
        ),
    }
    bodies = {name: jc.Body(1.0, 1e-3) for name in ("crank", "rod", "block")}
    rig = jc.Mechanism(bodies, joints, guess={"guide": 0.18})
    steps = jc.integrator.FixedStep(turned / 500.0)
    run = jc.simulate(rig, turned / 5.0, save=2, integrator=steps)
    # The connecting rod's other end on the line through the crank's axis.
    along, across = crank * np.cos(turned - SLOPE), crank * np.sin(turned - SLOPE)
    place = along + np.sqrt(rod**2 - across**2)
    assert abs(float(np.ravel(run.coordinate("guide"))[-1]) - place) < 1e-6


def test_numbers_beside_an_axis_that_turns_the_frame_over_are_refused():
    ends = jc.Marker("ground", axis=DIRECTION), jc.Marker("block", axis="-x")
    with pytest.raises(ValueError, match='on "block" goes along "-x" there.*the angle about z'):
        jc.Connection(jc.joint.Prismatic(), *ends)
