"""A joint with clearance becomes its ideal joint as the clearance vanishes: error in proportion to
the clearance.

A journal cannot be further than c + indentation from the middle, so with a stiff, strongly damped
contact (indentation below 1e-6 m) the motion is that of the ideal mechanism up to O(c). The
observed order is the slope of log error over log c."""

import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.cells import slow

CLEARANCES = np.array([4e-4, 2e-4, 1e-4])
# A constant damper needs no memory; 100 s/m makes every rebound below 1e-2 m/s die within one
# bounce.
CONTACT = {"stiffness": 3e11, "loss_per_speed": 100.0}


def swinging_bar(pin, inertia=(2e-3, 2e-3, 1e-4)):
    """A bar hung in the joint, pulled along its axis so that the journal tilts all it can."""
    return jc.Mechanism(
        {"bar": jc.Body(0.5, inertia, (0.1, 0.0, 0.0))},
        {"B": jc.Connection(pin, "ground", "bar")},
        {"gravity": jc.load.Gravity((2.0, -9.81, 5.0))},
    )


def history(rig, duration, body):
    fine = jc.integrator.Adaptive(rtol=1e-7, atol=1e-10)
    return np.asarray(jc.simulate(rig, duration, save=101, integrator=fine).body(body).com)


def observed_order(errors):
    return np.polyfit(np.log(CLEARANCES), np.log(errors), 1)[0]


@pytest.mark.slow
def test_slider_crank_with_clearance_tends_to_the_ideal_one():
    law = jc.contact.MarhefkaOrin(**CONTACT)
    moved = lambda joint: history(jc.scenes.slider_crank(joint), 0.25, "slider")
    ideal = moved(jc.joint.Revolute())
    bearings = [jc.clearance.PlanarJournalBearing(law, clearance=c) for c in CLEARANCES]
    errors = np.array([np.abs(moved(bearing) - ideal).max() for bearing in bearings])
    assert (errors < 3 * CLEARANCES).all() and abs(observed_order(errors) - 1) < 0.15


@pytest.mark.parametrize("kind", ["JournalBearing", *slow("BallSocket")])
def test_bar_in_a_spatial_joint_with_clearance_tends_to_the_ideal_one(kind):
    law = jc.contact.MarhefkaOrin(**CONTACT)
    if kind == "BallSocket":
        ideal = jc.joint.Spherical()
        pins = [jc.clearance.BallSocket(law, clearance=c) for c in CLEARANCES]
    else:
        ideal = jc.joint.Revolute()
        pins = [
            jc.clearance.JournalBearing(
                law, clearance=c, flange=jc.clearance.Flange(law, clearance=c)
            )
            for c in CLEARANCES
        ]
    wanted = history(swinging_bar(ideal), 0.15, "bar")
    errors = [np.abs(history(swinging_bar(pin), 0.15, "bar") - wanted).max() for pin in pins]
    assert abs(observed_order(errors) - 1) < 0.2
