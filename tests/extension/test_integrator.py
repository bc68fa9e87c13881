"""An integrator of a stranger, in a study of a response of a stranger."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from jaxclear import Scalar, quantity
from tests.extension.test_clearance_joint import dropped
from tests.extension.test_response import LowestPoint


class Ralston(jc.integrator.AbstractIntegrator):
    """Explicit steps of order 2 (Ralston 1962, Math. Comput. 16, 431) through compliant contact."""

    pathwise: ClassVar = True
    projects: ClassVar = True
    step: Scalar = quantity(1e-4, "s", "length of a step", above=0)

    @property
    def formulation(self):
        return jc.formulation.CompliantContact()

    def first_warm_start(self, model, start, state):
        return ()

    def advance(self, model, interval, state, warm_start):
        count = jnp.ceil((interval.stop - interval.start) / self.step * (1 - 1e-9)).astype(int)
        h = (interval.stop - interval.start) / count
        rate = lambda time, y: self.formulation.rate(model, time, y)[0]

        def one(i, y):
            time = interval.start + i * h
            first = rate(time, y)
            return y + h * (first / 4 + 3 / 4 * rate(time + 2 / 3 * h, y + 2 / 3 * h * first))

        end = jax.lax.fori_loop(0, count, one, state)
        return jc.integrator.Advance(end, count, 0 * count, (), jc.integrator.Outcome.REACHED)


def test_integrator_and_response_from_outside_serve_a_study():
    lowest = LowestPoint("ball")
    fall = np.sqrt(2 * 1e-2 / 9.81)
    where = lambda rig: rig.connections["gap"].joint.clearance
    varied = {"c": jc.Variable(where, tolerance=1e-3)}
    how = {"duration": 0.8 * fall, "integrator": Ralston()}
    problem = jc.Problem(dropped(), {"lowest": lowest}, varied, **how)
    found = jc.monte_carlo(problem, samples=4)
    # No sample has reached the floor: a parabola, exact for a method of order 2.
    np.testing.assert_allclose(found.responses["lowest"], -0.64e-2, rtol=1e-9)
    assert problem.units() == {"lowest": "m"}
    reference = jc.simulate(dropped(), 2 * fall, save=101)
    end = jc.simulate(dropped(), 2 * fall, save=101, integrator=Ralston(step=2e-5))
    # sqrt(K/m) h = 0.04: the bounce is off by its square, of a depth of 6e-5 m.
    np.testing.assert_allclose(lowest(end), lowest(reference), atol=1e-6)
