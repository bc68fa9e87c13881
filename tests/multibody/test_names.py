"""Names say nothing: a mechanism whose parts are called otherwise moves alike to the last bit, and
each part's numbers stand under its name."""

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.cells import slow

SMOOTH = jc.friction.CoulombTanh(mu_kinetic=0.2, transition_speed=1e-2)
WEARS = jc.Wearing(jc.wear.Archard(wear_coefficient=1e-3, hardness=1e9), cells=(8, 1))


def _loose(clearance, film=None):
    law = jc.contact.HuntCrossley(stiffness=1e9, restitution=0.6)
    if film is None:
        kinds = {"friction": SMOOTH, "bearing_wear": WEARS}
    else:
        law, kinds = jc.contact.Hertz(stiffness=1e9), {"film": film}
    return jc.clearance.PlanarJournalBearing(law, clearance=clearance, **kinds)


def _arms(names, elements):
    """Three arms that hang from each other by parts of two `kinds`, called by these names."""
    first, second = names
    bodies = {
        first: jc.Body(1.0, 0.02, com=(0.15, 0.0)),
        second: jc.Body(0.5, 0.004, com=(0.4, 0.0)),
    }
    joints = elements.get("joints", [jc.joint.Revolute(), jc.joint.Revolute()])
    connections = {
        first: jc.Connection(joints[0], "ground", first),
        second: jc.Connection(joints[1], first, second, at=(0.3, 0.0)),
    }
    loads = {"gravity": jc.load.Gravity()}
    loads |= dict(zip(names, elements["loads"](*names), strict=True)) if "loads" in elements else {}
    couplings = None
    if "couplings" in elements:
        couplings = dict(zip(names, elements["couplings"](*names), strict=True))
    return jc.Mechanism(bodies, connections, loads, couplings=couplings)


def _servos(first, second):
    reference = {"ki": 50.0, "kd": 2.0}
    return [
        jc.load.Servo(first, 0.2, kp=40.0, **reference),
        jc.load.Servo(second, -0.4, kp=20.0, **reference),
    ]


def _stops(first, second):
    return [
        jc.load.JointStop(first, lower=-0.03, stiffness=2e3, restitution=0.5),
        jc.load.JointStop(second, lower=-0.2, upper=0.05, stiffness=1e3, restitution=0.8),
    ]


def _rigid_stops(first, second):
    return [
        jc.load.JointStop(first, lower=-0.03, restitution=0.5),
        jc.load.JointStop(second, lower=-0.2, upper=0.05, restitution=0.8),
    ]


def _dry(first, second):
    kinds = {"presliding": 1e-4, "settling_time": 1e-3}
    return [
        jc.load.JointFriction(first, 0.5, **kinds),
        jc.load.JointFriction(second, 0.2, **kinds),
    ]


def _gears(first, second):
    gear, motor = jc.coupling.Gear, jc.coupling.Motor
    wear = jc.wear.Archard(wear_coefficient=1e-4, hardness=1e9)
    worn = {"wear": wear, "slide": 0.5, "area": 1e-5, "pitch_radius": 0.02}
    return [
        gear(motor(1e-3), first, 5.0, stiffness=500.0, damping=1.0, play=2e-3),
        gear(
            motor(1e-4),
            second,
            9.0,
            stiffness=90.0,
            damping=0.1,
            play=jc.clearance.Backlash(4e-3, **worn),
        ),
    ]


EXPLICIT, IMPLICIT = jc.integrator.FixedStep(2e-5), jc.integrator.ImplicitStep(1e-4)
ADAPTIVE, RIGID = jc.integrator.Adaptive(), jc.integrator.MoreauJean(1e-4)
GAPS = {"joints": [_loose(1e-4), _loose(2e-4)]}
FILM = {"joints": [_loose(5e-5, jc.film.ShortHalfFilm(viscosity=0.1)), _loose(2e-4)]}
RUBBING = {
    "joints": [
        jc.joint.PlainBearing(SMOOTH, radius=r, length=0.02, wear=WEARS) for r in (0.01, 0.03)
    ]
}
MIXED = {
    "joints": [_loose(1e-4), jc.joint.PlainBearing(SMOOTH, radius=0.02, length=0.02, wear=WEARS)]
}
CASES = {
    "gaps, implicit": (GAPS, IMPLICIT),
    "gears": ({"couplings": _gears}, IMPLICIT),
}
SLOW = {
    "gaps, rigid": (GAPS, RIGID),
    "film and gap": (FILM, IMPLICIT),
    "servos": ({"loads": _servos}, EXPLICIT),
    "gaps, explicit": (GAPS, EXPLICIT),
    "gaps, adaptive": (GAPS, ADAPTIVE),
    "rubbing": (RUBBING, IMPLICIT),
    "rubbing, rigid": (RUBBING, RIGID),
    "mixed": (MIXED, IMPLICIT),
    "stops": ({"loads": _stops}, IMPLICIT),
    "rigid stops": ({"loads": _rigid_stops}, RIGID),
    "dry": ({"loads": _dry}, ADAPTIVE),
}


def _numbers_by_place(run, names):
    """What a run tells of each part, by its place in the mechanism."""
    result = {"states": run.history.states, "peaks": run.extremes}
    for place, name in zip(("first", "second"), names, strict=True):
        result[f"motion, {place}"] = run.body(name).com
        result[f"worn, {place}"] = run.worn.get(name)
        if name in run.formulation.contact_joints(run.mechanism):
            result[f"contact, {place}"] = run.contact(name)
            result[f"mean force, {place}"] = jc.response.MeanContactForce(name)(run)
        result[f"reaction, {place}"] = run.reaction(name)
        if name in run.mechanism.couplings:
            result[f"coupling, {place}"] = run.coupling(name)
    return {
        what: [np.asarray(x) for x in jax.tree.leaves(part) if eqx.is_array(x)]
        for what, part in result.items()
    }


def _numbers(case, names):
    elements, integrator = (CASES | SLOW)[case]
    rig = _arms(names, elements)
    run = jc.simulate(rig, 0.05, integrator=integrator, save=11, balance=True, verify=False)
    return _numbers_by_place(run, names)


@pytest.mark.parametrize("case", [*CASES, *slow(*SLOW)])
def test_names_do_not_matter(case):
    one, other = (_numbers(case, names) for names in (("a", "b"), ("b", "a")))
    assert one.keys() == other.keys()
    for what in one:
        for a, b in zip(one[what], other[what], strict=True):
            np.testing.assert_array_equal(a, b, err_msg=what)
