"""One small rig for every clearance joint: a heavy body that only the joint holds, and a light one
hinged to it.

The heavy body floats, so its coordinates are the pose of the journal in the bearing: any situation
can be posed exactly."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from jaxclear.formulations.compliant import CompliantContact
from jaxclear.formulations.model import Model
from jaxclear.multibody.state import lay_out
from jaxclear.multibody.system import prepare, readings
from jaxclear.simulation.wear import unworn

RADIUS, LENGTH = 20e-3, 30e-3
# Parameters of a rig, with a value that nobody would call extreme.
USUAL = {
    "clearance": 1e-4,
    "stiffness": 1e9,
    "mu": 0.1,
    "transition_speed": 1e-3,
    "light_mass": 0.1,
    "worn_depth": 1e-6,
}


def _wearing():
    return jc.Wearing(
        jc.wear.Archard(wear_coefficient=1e-4, hardness=2e9), cells=(12, 4), acceleration=1e3
    )


def _static(p, **numbers):
    return {"mu_static": 1.5 * p["mu"], "mu_kinetic": p["mu"], **numbers}


def _step(p):
    """Speeds of a law that steps from static to kinetic friction."""
    return {"static_speed": p["transition_speed"], "kinetic_speed": 10 * p["transition_speed"]}


def _lugre(p):
    speed = p["transition_speed"]
    return jc.friction.LuGre(**_static(p, stribeck_speed=10 * speed, presliding=1e-3 * speed))


def _bearing(kind, p, law, friction, **more):
    size = {"bearing_radius": RADIUS, "clearance": p["clearance"], "length": LENGTH}
    return kind(law, friction, **size, **more)


def _ball(p, law, friction, **more):
    return jc.clearance.BallSocket(
        law, friction, socket_radius=RADIUS, clearance=p["clearance"], **more
    )


def planar(p):
    law = jc.contact.CarvalhoMartins(stiffness=p["stiffness"], restitution=0.8)
    friction = jc.friction.ThreeZone(**_static(p, **_step(p)))
    wear = {"bearing_wear": _wearing(), "journal_wear": _wearing()}
    return _bearing(jc.clearance.PlanarJournalBearing, p, law, friction, **wear)


def planar_conformal(p):
    law = jc.contact.Liu(modulus=p["stiffness"], restitution=0.8)
    friction = jc.friction.Dahl(mu_kinetic=p["mu"], presliding=p["transition_speed"] * 1e-3)
    return _bearing(jc.clearance.PlanarJournalBearing, p, law, friction)


def journal(p):
    law = jc.contact.Johnson(modulus=p["stiffness"], restitution=0.8)
    speed = p["transition_speed"]
    friction = jc.friction.Stribeck(**_static(p, stribeck_speed=10 * speed, transition_speed=speed))
    return _bearing(jc.clearance.JournalBearing, p, law, friction)


def journal_that_wears(p):
    law = jc.contact.Gonthier(stiffness=p["stiffness"], restitution=0.8)
    friction = jc.friction.Threlfall(mu_kinetic=p["mu"], transition_speed=p["transition_speed"])
    wear = {"bearing_wear": _wearing(), "journal_wear": _wearing()}
    return _bearing(jc.clearance.JournalBearing, p, law, friction, **wear)


def journal_with_collars(p):
    law = jc.contact.Flores(stiffness=p["stiffness"], restitution=0.8)
    rub = jc.friction.CoulombTanh(mu_kinetic=p["mu"], transition_speed=p["transition_speed"])
    collar = jc.clearance.Flange(law, rub, radius=1.4 * RADIUS, clearance=p["clearance"])
    return _bearing(jc.clearance.JournalBearing, p, law, _lugre(p), flange=collar)


def ball(p):
    law = jc.contact.ModifiedFlores(modulus=p["stiffness"], restitution=0.8)
    speed = p["transition_speed"]
    friction = jc.friction.BengisuAkay(**_static(p, peak_speed=speed, decay=1 / speed))
    return _ball(p, law, friction, socket_wear=_wearing(), ball_wear=_wearing())


def ball_with_bristles(p):
    law = jc.contact.HuntCrossley(stiffness=p["stiffness"], restitution=0.8)
    return _ball(p, law, _lugre(p))


def guide(p):
    law = jc.contact.AdamsImpact(stiffness=p["stiffness"], damping=1e3, full_damping_depth=1e-6)
    sizes = {"width": RADIUS, "length": LENGTH, "breadth": RADIUS, "guide_length": 20 * LENGTH}
    wear = {"guide_wear": _wearing(), "slider_wear": _wearing()}
    rub = jc.friction.AdamsStep(**_static(p, **_step(p)))
    return jc.clearance.SliderGuide(law, rub, clearance=p["clearance"], **sizes, **wear)


ROUND = (journal, journal_that_wears, journal_with_collars, ball, ball_with_bristles)
JOINTS = {joint.__name__: joint for joint in (planar, planar_conformal, *ROUND, guide)}


def build(kind, p):
    """The rig with parameters `p`; they may be traced."""
    flat, light = kind.startswith("planar"), p["light_mass"]
    moments = 1e-3 if flat else (1e-3, 2e-3, 1.5e-3)
    lighter = light * 1e-3 if flat else tuple(light * x for x in moments)
    place = (0.05, 0.0) if flat else (0.05, 0.0, 0.01)
    weight = jc.load.Gravity((0.0, -9.81) if flat else (1.0, -9.81, 0.3))
    return jc.Mechanism(
        {"heavy": jc.Body(1.0, moments), "light": jc.Body(light, lighter, com=(0.1, 0.02))},
        {
            "B": jc.Connection(JOINTS[kind](p), "ground", "heavy"),
            "hinge": jc.Connection(jc.joint.Revolute(), "heavy", "light", at=place),
        },
        {"gravity": weight},
    )


def pattern(shape):
    """A worn surface with no symmetry, between 0 and 1."""
    i, j = np.indices(shape)
    around = 2 * np.pi * i / shape[0]
    return 0.5 + 0.3 * np.sin(1.0 + around) + 0.2 * np.cos(2.0 + 3.0 * j + 2 * around)


@cache
def layout(kind):
    return lay_out(prepare(build(kind, USUAL)))


def rate(kind, p, state):
    """Rate of the state, with surfaces worn to `worn_depth`."""
    mechanism = build(kind, p)
    system = prepare(mechanism)
    worn = jax.tree.map(lambda depth: p["worn_depth"] * pattern(depth.shape), unworn(system))
    model = Model(system, readings(system, worn), None, lay_out(system))
    return CompliantContact().rate(model, jnp.asarray(0.1), state)[0]


def pose(kind, *, eccentricity, direction, height, tilt, tilt_direction, turn):
    """Coordinates of the heavy body: offset of length `eccentricity` in the bearing's plane, axis
    tilted by `tilt`."""
    x, y = eccentricity * np.cos(direction), eccentricity * np.sin(direction)
    if kind.startswith("planar"):
        return [x, y, turn]
    half = np.array([np.cos(tilt_direction), np.sin(tilt_direction), 0.0]) * np.sin(tilt / 2)
    a, b = np.cos(turn / 2), np.sin(turn / 2)
    w, v = np.cos(tilt / 2), half
    turned = [w * a - v[2] * b, v[0] * a + v[1] * b, v[1] * a - v[0] * b, v[2] * a + w * b]
    return [x, y, height, *turned]
