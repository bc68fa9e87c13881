"""Bodies that move in the plane: what points out of it is never lost silently, and guides have
walls along every axis in it."""

import numpy as np
import pytest

import jaxclear as jc

LAW = jc.contact.CarvalhoMartins(stiffness=1e8)
HINGE = jc.clearance.JournalBearing(LAW, clearance=1e-4)
ARM = {"mass": 1.0, "inertia": 1e-2}


def hinged(com=(0.1, 0.0), at=(0.0, 0.0), loads=None, inertia=1e-2, weight=(0.0, -9.81)):
    """An arm that nothing but a bearing holds."""
    return jc.Mechanism(
        {"arm": jc.Body(1.0, inertia, com)},
        {"B": jc.Connection(HINGE, "ground", "arm", at=at)},
        {"weight": jc.load.Gravity(weight)} | (loads or {}),
    )


def pushed(force, place=(0.1, 0.0)):
    return hinged(loads={"push": jc.load.Force(jc.Marker("arm", place), force)})


def sprung(height):
    ends = jc.Marker("ground", (0.2, 0.0, height)), jc.Marker("arm", (0.1, 0.0))
    return hinged(loads={"spring": jc.load.Spring(*ends, 100.0)})


OUT_OF_PLANE = {
    "weight": (lambda: hinged(weight=(0.0, 0.0, -9.81)), 'load "weight" pulls along z'),
    "centre of mass": (lambda: hinged((0.1, 0.0, 0.02)), "centre of mass lies beside it"),
    "marker": (lambda: hinged(at=(0.0, 0.0, 0.01)), 'marker of joint "B" lies beside it'),
    "force": (lambda: pushed((0.0, 0.0, 1.0)), 'load "push" acts out of it'),
    "force in time": (lambda: pushed(lambda t: (0.0, 0.0, 3.0 * t)), 'load "push" acts out of it'),
    "place of a force": (lambda: pushed((1.0, 0.0), (0.1, 0.0, 0.02)), 'load "push" lies beside'),
    "spring": (lambda: sprung(0.1), 'marker of load "spring" lies beside it'),
    "torque": (
        lambda: hinged(loads={"turn": jc.load.Torque(jc.Marker("arm"), (1.0, 0.0, 0.0))}),
        'load "turn" acts out of it',
    ),
}


@pytest.mark.parametrize("name", OUT_OF_PLANE)
def test_what_points_out_of_the_plane_of_a_planar_body_is_refused(name):
    make, sentence = OUT_OF_PLANE[name]
    with pytest.raises(ValueError, match=f'body "arm" has an inertia about its z axis.*{sentence}'):
        make()


def test_numbers_in_the_plane_are_taken_however_many():
    for rig in (hinged((0.1, 0.0, 0.0)), hinged(weight=(0.0, -9.81, 0.0)), sprung(0.0)):
        assert rig.topology.speed_count == 3


def test_in_space_the_same_hinge_falls():
    rig = hinged((0.1, 0.0, 0.0), inertia=(1e-3, 1e-2, 1e-2), weight=(0.0, 0.0, -9.81))
    body = jc.simulate(rig, 2e-3, save=2, integrator=jc.integrator.FixedStep(1e-5)).body("arm")
    assert float(body.velocity[-1, 2]) == pytest.approx(-9.81 * 2e-3, rel=1e-6)


def guided(**axis):
    guide = jc.clearance.SliderGuide(LAW, clearance=1e-4)
    return jc.Mechanism(
        {"slider": jc.Body(**ARM)},
        {"G": jc.Connection(guide, "ground", "slider", **axis)},
        {"weight": jc.load.Gravity((-9.81, -9.81))},
    )


@pytest.mark.parametrize("integrator", [None, jc.integrator.NonColliding(1e-3)])
@pytest.mark.parametrize(
    "axis", [*(pytest.param(a, marks=pytest.mark.slow) for a in ("x", "-x", "y")), "-y"]
)
def test_a_guide_has_walls_along_every_axis_of_the_plane(axis, integrator):
    """It slides freely along its axis and is stopped across it."""
    run = jc.simulate(guided(axis=axis), 0.03, save=11, integrator=integrator)
    along, across = (0, 1) if "x" in axis else (1, 0)
    fallen = np.asarray(run.body("slider").com)[-1]
    assert fallen[along] == pytest.approx(-0.5 * 9.81 * 0.03**2, rel=1e-3)
    # The clearance, and what a wall of 1e8 N/m^1.5 gives way.
    assert -1.2e-4 < fallen[across] <= 0.0
    assert float(np.max(run.contact("G").normal_force)) > 1.0


def test_a_guide_out_of_the_plane_is_refused():
    for axis in ({}, {"axis": (1.0, 0.0, 0.0)}):
        with pytest.raises(
            ValueError, match='joint "G" is a SliderGuide whose axis .* must lie in'
        ):
            guided(**axis)


# --- an axis beside markers ---


def test_an_axis_beside_a_marker_is_refused():
    marker = jc.Marker("ground", axis="x")
    for ends in ((marker, jc.Marker("slider", axis="x")), (marker, "slider")):
        with pytest.raises(ValueError, match="is given an axis beside it; put the axis into the"):
            jc.Connection(jc.joint.Prismatic(), *ends, axis="y")
    with pytest.raises(TypeError, match='Prismatic has no argument "axis"'):
        jc.joint.Prismatic(axis="x")


@pytest.mark.parametrize("turned", [{"axis": "x"}, {"axis": (0.0, 1.0, 1.0)}, {"axis": "-y"}])
def test_a_body_beside_a_marker_is_turned_as_the_marker(turned):
    """So it starts as it is drawn, and slides along the marker's axis."""
    rig = jc.Mechanism(
        {"slider": jc.Body(1.0, (1e-2, 1e-2, 1e-2))},
        {"G": jc.Connection(jc.joint.Prismatic(), jc.Marker("ground", **turned), "slider")},
        start={"G": 0.3},
    )
    run = jc.simulate(rig, 1e-3, save=2, integrator=jc.integrator.FixedStep(1e-3))
    way = np.asarray(run.body("slider").com)[0]
    np.testing.assert_allclose(run.body("slider").rotation[0], np.eye(3), atol=1e-15)
    axis = {"x": (1, 0, 0), "-y": (0, -1, 0)}.get(turned["axis"], np.array((0, 1, 1)) / np.sqrt(2))
    np.testing.assert_allclose(way, 0.3 * np.array(axis), atol=1e-15)
