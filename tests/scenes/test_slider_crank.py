"""The slider-crank: its ideal motion in closed form, what is left out, and its checks."""

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.scenes.slider_crank import CRANK, ROD, slider_crank


@pytest.mark.parametrize("kind", ["ideal", jc.joint.Revolute()], ids=["by word", "own joint"])
def test_the_ideal_slider_moves_as_geometry_says(kind):
    run = jc.simulate(slider_crank(kind, crank_speed=30.0), 0.25, save=26)
    angle = 30.0 * np.asarray(run.time)
    place = CRANK * np.cos(angle) + np.sqrt(ROD**2 - (CRANK * np.sin(angle)) ** 2)
    # what Baumgarte's stabilisation leaves of the loop's drift
    np.testing.assert_allclose(run.body("slider").com[:, 0], place, atol=1e-8)


def test_what_is_left_out_is_absent_and_what_is_given_is_there():
    bare = slider_crank(friction=False, gravity=None)
    joint = bare.connections["B"].joint
    assert joint.friction is None is joint.bearing_wear and not bare.loads
    drive, friction = jc.drive.RampUp(50.0, 0.02), jc.friction.Dahl()
    own = slider_crank(friction=friction, wear=True, drive=drive)
    joint = own.connections["B"].joint
    assert joint.friction == friction and isinstance(joint.bearing_wear, jc.Wearing)
    assert own.connections["O"].joint.drive is drive and set(own.loads) == {"gravity"}


def test_an_unknown_word_is_refused():
    with pytest.raises(ValueError, match='no kind "spatial" .*; there are "planar", "ideal"'):
        slider_crank("spatial")
