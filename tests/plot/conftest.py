"""One run for all figures."""

import pytest

import jaxclear as jc


@pytest.fixture(scope="session")
def run():
    """A slider-crank whose journal, 0.2 mm loose, is thrown against its bearing and wears it."""
    rig = jc.scenes.slider_crank(wear=True, crank_speed=50.0)
    return jc.simulate(rig, 4e-3, save=41, integrator=jc.integrator.FixedStep(2e-5))
