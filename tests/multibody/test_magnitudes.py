"""A number that no mechanism has is warned about once, with the likely slip; nothing that is built
is.
"""

import warnings

import equinox as eqx
import jax
import pytest

import jaxclear as jc

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
