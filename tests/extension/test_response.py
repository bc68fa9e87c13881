"""A response of a stranger: a number drawn from a run, with its unit."""

import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from tests.extension.test_clearance_joint import dropped


class LowestPoint(jc.response.AbstractResponse):
    """Lowest height of a body's centre of mass [m]."""

    body: str
    unit: str = "m"

    def __call__(self, run):
        return jnp.min(run.body(self.body).com[:, 1])


def test_response_from_outside_is_the_number_with_its_unit():
    lowest, time = LowestPoint("ball"), 0.03
    run = jc.simulate(dropped(), time, save=4)
    # free fall: a parabola is exact for the integrator
    np.testing.assert_allclose(lowest(run), -0.5 * 9.81 * time**2, rtol=1e-9)
    assert lowest.unit == "m"
