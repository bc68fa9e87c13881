"""A part that was exchanged in a built mechanism (`equinox.tree_at`) for what is none, or has other
coordinates, is named before anything is traced."""

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxclear as jc

RIG = jc.Mechanism(
    {"arm": jc.Body(1.0, 0.1, (0.5, 0.0)), "tip": jc.Body(1.0, 0.1, (0.5, 0.0))},
    {
        "shoulder": jc.Connection(
            jc.joint.Revolute(drive=jc.drive.ConstantSpeed(1.0)), "ground", "arm"
        ),
        "elbow": jc.Connection(jc.joint.Revolute(), jc.Marker("arm", (1.0, 0.0)), "tip"),
    },
    {"gravity": jc.load.Gravity((0.0, -9.81))},
)
BEARING = jc.clearance.PlanarJournalBearing(jc.contact.HuntCrossley(stiffness=1e7, restitution=0.9))
SHOULDER, ELBOW = (lambda m, name=name: m.connections[name].joint for name in ("shoulder", "elbow"))
EXCHANGED = {
    "no drive": (lambda m: SHOULDER(m).drive, None, 'joint "shoulder" .* drive was put in or left'),
    "a drive more": (lambda m: ELBOW(m).drive, jc.drive.ConstantSpeed(1.0), 'joint "elbow" .*driv'),
    "another joint": (ELBOW, jc.joint.Spherical(), 'joint "elbow" .*with_joint'),
    "clearance": (ELBOW, BEARING, 'joint "elbow" .*changed'),
    "no joint": (ELBOW, None, 'joint "elbow" is None; it must be one of jaxclear.joint'),
    "no connection": (lambda m: m.connections["elbow"], None, 'joint "elbow" is None'),
    "no body": (lambda m: m.bodies["tip"], None, 'body "tip" is None'),
    "no mass": (lambda m: m.bodies["tip"].mass, None, 'body "tip" has mass = None'),
    "no load": (lambda m: m.loads["gravity"], None, 'load "gravity" is None'),
}


def exchanged(case):
    where, part, sentence = EXCHANGED[case]
    return eqx.tree_at(where, RIG, part, is_leaf=lambda x: x is None), sentence


@pytest.mark.parametrize("case", EXCHANGED)
def test_an_exchanged_part_is_named_by_a_run(case):
    rig, sentence = exchanged(case)
    with pytest.raises(ValueError, match=sentence):
        jc.simulate(rig, 0.1)


@pytest.mark.parametrize("case", ["no drive", "no joint"])
def test_an_exchanged_part_is_named_by_whatever_takes_a_mechanism(case):
    rig, sentence = exchanged(case)
    speed = {"speed": lambda run: run.speed("elbow")[-1]}
    for call in (
        jc.assemble,
        jc.assemblies,
        jc.resting_state,
        lambda rig: jc.positions(rig, {"shoulder": [0.0]}),
        lambda rig: jc.Problem(rig, speed, {}, duration=0.1),
        lambda rig: jc.steady_cycle(rig, 2 * np.pi),
        lambda rig: jax.jit(lambda mass: jc.simulate(rig, 0.1, throw=False).outcome)(1.0),
    ):
        with pytest.raises(ValueError, match=sentence):
            call(rig)
