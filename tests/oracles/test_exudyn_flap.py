"""The flap with one slack joint, against Exudyn with the contact law as a user force: the flight
through the play, the impact, and the contact that follows."""

import json
from pathlib import Path

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.scenes.flap import BEARING_LENGTH, BEARING_RADIUS

REFERENCE = json.loads((Path(__file__).parents[1] / "refdata/exudyn_flap.json").read_text())
TIMES = np.array(REFERENCE["time"])


def without_friction(slack):
    """The scene with one slack joint; Exudyn's force acts at the centres, so has no friction."""
    rig = jc.scenes.flap([slack])
    old = rig.connections[slack]
    joint = jc.clearance.PlanarJournalBearing(
        old.joint.contact,
        bearing_radius=BEARING_RADIUS,
        clearance=old.joint.clearance,
        length=BEARING_LENGTH,
    )
    slack_joint = {slack: jc.Connection(joint, old.parent, old.child)}
    return jc.Mechanism(rig.bodies, rig.connections | slack_joint, guess=rig.guess)


def angle(run, body):
    quaternion = np.asarray(run.body(body).quaternion)[1:]
    return 2 * np.arctan2(quaternion[:, 3], quaternion[:, 0])


@pytest.mark.slow
@pytest.mark.parametrize("slack", ["J1", "J2", "J3", "J4"])
def test_flap_takes_up_its_play_as_in_exudyn(slack):
    fine = jc.integrator.Adaptive(rtol=1e-8, atol=1e-11)
    run = jc.simulate(without_friction(slack), TIMES[-1], save=TIMES, integrator=fine)
    assert not run.warnings
    touching = np.asarray(run.contact(slack).indentation)[1:, 0] > 0
    assert touching.any() and not touching[0]
    for body, wanted in REFERENCE["angles"][slack].items():
        error = np.abs(angle(run, body) - wanted).max()
        assert error < REFERENCE["tolerance"], f"{body}: {error:.2e} rad"
