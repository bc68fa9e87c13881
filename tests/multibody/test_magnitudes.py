"""A number that no mechanism has is warned about once, with the likely slip; nothing that is built
is.

Bodies that move in the plane: what points out of it is never lost silently, and guides have
walls along every axis in it."""

import warnings

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.cells import slow

RIG = jc.scenes.slider_crank()
BEARING = jc.clearance.PlanarJournalBearing


def rebuilt(**changes):
    parts = {"bodies": RIG.bodies, "connections": RIG.connections, "loads": RIG.loads}
    return jc.Mechanism(**(parts | {"start": RIG.start} | changes))


def with_joint(joint):
    return rebuilt(
        connections=RIG.connections | {"B": jc.Connection(joint, "rod", "slider", at=(0.12, 0.0))}
    )


def with_rod(**changes):
    rod = {"mass": 0.21, "inertia": 2.5e-4, "com": (0.06, 0.0)} | changes
    return rebuilt(bodies=RIG.bodies | {"rod": jc.Body(**rod)})


def hertz(modulus):
    soft = jc.Material(modulus, 0.3)
    return jc.contact.Hertz(stiffness=jc.stiffness.HertzStiffness(soft, soft))


def chain(length, mass):
    """Crank and rod in other units of length and mass, inertias as they are."""
    pin = jc.joint.Revolute()
    return jc.Mechanism(
        {
            "crank": jc.Body(0.038 * mass, 7.4e-5),
            "rod": jc.Body(0.21 * mass, 2.5e-4, (0.12 * length, 0.0)),
        },
        {
            "O": jc.Connection(pin, "ground", "crank"),
            "A": jc.Connection(pin, "crank", "rod", at=(0.05 * length, 0.0)),
        },
    )


def screw(lead):
    nut = jc.Connection(jc.joint.Cylindrical(), "ground", "nut", at=(0.0, 0.1, 0.0))
    return jc.Mechanism(
        {"nut": jc.Body(1.0, (1e-3, 1e-3, 1e-3))},
        {"axle": nut},
        couplings={"thread": jc.coupling.Screw("axle", lead)},
    )


HERTZ = jc.contact.Hertz()
SLIPS = {
    "modulus in GPa": (lambda: with_joint(BEARING(hertz(207.0))), "B.*young_modulus = 207 Pa.*GPa"),
    "modulus in MPa": (lambda: with_joint(BEARING(hertz(207e3))), "young_modulus = 207000 Pa.*MPa"),
    "radius in cm and more": (
        lambda: with_joint(BEARING(HERTZ, bearing_radius=10.0)),
        'joint "B" has bearing_radius = 10 m beside links of 0.12 m: is it in mm',
    ),
    "clearance in mm": (
        lambda: with_joint(BEARING(HERTZ, bearing_radius=0.3, clearance=0.2)),
        'joint "B" has clearance = 0.2 m in a part of 0.3 m: is it in mm',
    ),
    "friction in per cent": (
        lambda: with_joint(BEARING(HERTZ, jc.friction.CoulombTanh(mu_kinetic=30))),
        'joint "B" has friction.mu_kinetic = 30; .* per cent',
    ),
    "Brinell hardness": (
        lambda: with_joint(
            BEARING(HERTZ, bearing_wear=jc.Wearing(jc.wear.Archard(hardness=200.0)))
        ),
        'joint "B" has bearing_wear.law.hardness = 200 Pa.*Brinell',
    ),
    "centre of mass in mm": (lambda: with_rod(com=(60.0, 0.0)), 'body "rod" has its com 60 m away'),
    "inertia in kg mm^2": (lambda: with_rod(inertia=250.0), 'body "rod" has inertia = 250.*kg mm'),
    "gravity in mm/s^2": (
        lambda: rebuilt(loads={"g": jc.load.Gravity((0.0, -9810.0))}),
        'load "g" has acceleration.* = -9810 m/s.*mm/s',
    ),
    "place in mm": (
        lambda: rebuilt(
            connections=RIG.connections
            | {"A": jc.Connection(jc.joint.Revolute(), "crank", "rod", at=(50.0, 0.0))}
        ),
        'joint "A" on body "crank" is 50 m away from its origin',
    ),
    "all lengths in mm": (
        lambda: chain(1e3, 1.0),
        'body "crank" is 50 m long and has 0.038 kg: is it in mm.*body "rod" is 120 m long',
    ),
    "masses in g": (
        lambda: chain(1.0, 1e3),
        'body "crank" has 38 kg within 0.05 m, more than any metal: is it in g.*body "rod"',
    ),
    "lead of a thread in mm": (
        lambda: screw(5.0),
        'coupling "thread" has lead = 5 m; mechanisms have -1 to 1 m: is it in mm',
    ),
    "a belt in mm": (
        lambda: rebuilt(couplings={"belt": jc.coupling.Belt("O", "A", 30.0, 10.0)}),
        'coupling "belt" has radius_a = 30 m beside links of 0.12 m: is it in mm',
    ),
    "a spring in mm": (
        lambda: rebuilt(
            loads={"s": jc.load.Spring(jc.Marker("rod"), jc.Marker("ground"), 1e3, 60.0)}
        ),
        'load "s" has free_length = 60 m beside links',
    ),
    "gravity across the plane": (
        lambda: rebuilt(loads={"g": jc.load.Gravity((0.0, 0.0, -9.81))}),
        'load "g" pulls along z, across the xy plane',
    ),
    "com beside the plane": (
        lambda: with_rod(com=(0.06, 0.0, 0.02)),
        'body "rod" moves in the xy plane and has its com beside it, at z = 0.02 m',
    ),
    "start in degrees": (
        lambda: jc.Mechanism(
            {"arm": jc.Body(1.0, 1e-2)},
            {"pin": jc.Connection(jc.joint.Revolute(), "ground", "arm")},
            start={"pin": 45.0},
        ),
        'start of "pin" is 45 rad: is it in degrees',
    ),
}


@pytest.mark.parametrize("slip", SLIPS)
def test_a_number_that_no_mechanism_has_is_warned_about_once(slip):
    build, sentence = SLIPS[slip]
    with pytest.warns(jc.UnusualMagnitude, match=sentence) as found:
        build()
    assert len(found) == 1 and found[0].filename == __file__


LIFT = jc.Connection(jc.joint.Prismatic(), "ground", "car", at=(1.0, 0.0, 0.0))
BUILT = {
    "a lift, which moves along z": lambda: jc.Mechanism(
        {"car": jc.Body(300.0, 60.0)}, {"shaft": LIFT}, {"g": jc.load.Gravity((0.0, 0.0, -9.81))}
    ),
    "gravity on a slope": lambda: rebuilt(loads={"g": jc.load.Gravity((0.0, -7.0, -7.0))}),
    "links in layers": lambda: rebuilt(
        bodies=RIG.bodies | {"rod": jc.Body(0.21, 2.5e-4, (0.06, 0.0, 0.01))},
        connections=RIG.connections
        | {"A": jc.Connection(jc.joint.Revolute(), "crank", "rod", at=(0.05, 0.0, 0.01))},
    ),
    "an arm with upright axes, drawn in space": lambda: jc.Mechanism(
        {"upper": jc.Body(2.0, 0.02, (0.15, 0.0)), "lower": jc.Body(1.0, 0.01, (0.1, 0.0))},
        {
            "shoulder": jc.Connection(jc.joint.Revolute(), "ground", "upper", at=(0.0, 0.0, 0.4)),
            "elbow": jc.Connection(jc.joint.Revolute(), "upper", "lower", at=(0.3, 0.0, 0.0)),
        },
        {"g": jc.load.Gravity((0.0, 0.0, -9.81))},
    ),
    "a boom": lambda: jc.Mechanism(
        {"boom": jc.Body(290.0, 3e5, (30.0, 0.0))},
        {"hinge": jc.Connection(jc.joint.Revolute(), "ground", "boom")},
    ),
    "a flywheel": lambda: jc.Mechanism(
        {"wheel": jc.Body(200.0, 9.0), "rod": jc.Body(0.2, 2e-4, (0.1, 0.0))},
        {
            "O": jc.Connection(jc.joint.Revolute(), "ground", "wheel"),
            "A": jc.Connection(jc.joint.Revolute(), "wheel", "rod", at=(0.03, 0.0)),
        },
    ),
}


@pytest.mark.parametrize("name", BUILT)
def test_what_is_built_is_not_warned_about(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error", jc.UnusualMagnitude)
        BUILT[name]()


@pytest.mark.parametrize("scene", jc.scenes.__all__)
def test_no_scene_is_warned_about(scene):
    with warnings.catch_warnings():
        warnings.simplefilter("error", jc.UnusualMagnitude)
        getattr(jc.scenes, scene)()
        getattr(jc.scenes, scene)("ideal")


def test_traced_numbers_are_not_looked_at():
    def built(mass, com):
        return with_rod(mass=mass, com=(com, 0.0)).bodies["rod"].mass

    with warnings.catch_warnings():
        warnings.simplefilter("error", jc.UnusualMagnitude)
        assert float(jax.jit(built)(1.0, 60.0)) == 1.0
        changed = eqx.tree_at(lambda rig: rig.bodies["rod"].com[0], RIG, jax.numpy.asarray(60.0))
        assert float(changed.bodies["rod"].com[0]) == 60.0


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
@pytest.mark.parametrize("axis", ["-y", *slow("x", "-x", "y", ((1.0, 0.0, 0.0),))])
def test_a_guide_has_walls_along_every_axis_of_the_plane(axis, integrator):
    """It slides freely along its axis and is stopped across it."""
    run = jc.simulate(guided(axis=axis), 0.03, save=11, integrator=integrator)
    along, across = (0, 1) if "x" in axis or axis[0] == 1.0 else (1, 0)
    fallen = np.asarray(run.body("slider").com)[-1]
    assert fallen[along] == pytest.approx(-0.5 * 9.81 * 0.03**2, rel=1e-3)
    # The clearance, and what a wall of 1e8 N/m^1.5 gives way.
    assert -1.2e-4 < fallen[across] <= 0.0
    assert float(np.max(run.contact("G").normal_force)) > 1.0


# --- an axis beside markers ---


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
