"""A problem of a stranger: a model that knows its own derivative and when it fails."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.studies.base import SampleResult


class Cantilever(jc.AbstractProblem):
    """Deflection of a beam's tip under a load [m]; it fails where the beam would yield."""

    variables: dict[str, jc.Dimension]
    names: tuple[str, ...] = eqx.field(static=True, default=("length", "height"))
    response_names: tuple[str, ...] = eqx.field(static=True, default=("deflection",))
    variable_units: tuple[str, ...] = eqx.field(static=True, default=("m", "m"))
    correlation: None = None

    def nominal(self):
        return jnp.stack([self.variables[name].nominal for name in self.names])

    def units(self):
        return {"deflection": "m"}

    def evaluate(self, values, *, discrete_derivatives=False):
        length, height = values
        stress = 6 * 100.0 * length / (0.01 * height**2)
        outcome = jnp.where(
            stress < 250e6, jc.integrator.Outcome.REACHED, jc.integrator.Outcome.OUT_OF_RANGE
        )
        deflection = 4 * 100.0 * length**3 / (210e9 * 0.01 * height**3)
        return SampleResult({"deflection": deflection}, outcome, jnp.zeros(()))

    def sample_memory(self):
        return 64

    def most_together(self):
        return 1000

    def rerun(self, values, index, chunk):
        return self.evaluate(values)

    def ending(self, outcome, ended):
        return "the beam holds." if outcome == 0 else "the beam would yield."

    def parts(self):
        return {}


@pytest.fixture
def beam():
    return Cantilever(
        {
            "length": jc.Dimension(0.5, jc.distribution.Normal(5e-3)),
            "height": jc.Dimension(12e-3, jc.distribution.Normal(0.5e-3)),
        }
    )


def test_problem_from_outside_is_sampled_and_its_failures_named(beam):
    study = jc.monte_carlo(beam, 64)
    length, height = study.values.T
    yields = 600.0 * length / (0.01 * height**2) >= 250e6
    np.testing.assert_array_equal(study.failed, np.flatnonzero(yields))
    np.testing.assert_allclose(
        study.responses["deflection"][~yields],
        (400.0 * length**3 / (2.1e9 * height**3))[~yields],
    )
    assert "the beam would yield." in study.failures()[int(study.failed[0])]


def test_problem_from_outside_is_differentiated(beam):
    slope = jax.grad(lambda v: beam.evaluate(v).responses["deflection"])(beam.nominal())
    found = jc.sensitivity(
        beam, "length", sample=64, difference_samples=16, methods=("regression", "pathwise")
    )
    answer = found.derivatives["deflection", "length"]
    assert answer.estimates["pathwise"].value == pytest.approx(float(slope[0]), rel=0.1)
