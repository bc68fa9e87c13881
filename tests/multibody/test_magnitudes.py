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
