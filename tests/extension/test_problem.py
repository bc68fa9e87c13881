"""A problem of a stranger: a model that knows its own derivative and when it fails."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxclear.integrator import Outcome

import jaxclear as jc
from jaxclear.studies.experiment import Cost, Description, ResponseInfo, SampleResult


class Cantilever(jc.AbstractExperiment):
    """Deflection of a beam's tip under a load [m]; it fails where the beam would yield."""

    load: jnp.ndarray
    response_names: tuple[str, ...] = eqx.field(static=True, default=("deflection",))

    def evaluate(self, setting, *, discrete_derivatives=False):
        beam = setting(self.subject)
        length, height = beam["length"], beam["height"]
        stress = 6 * self.load * length / (0.01 * height**2)
        outcome = jnp.where(stress < 250e6, Outcome.REACHED, Outcome.OUT_OF_RANGE)
        deflection = 4 * self.load * length**3 / (210e9 * 0.01 * height**3)
        return SampleResult({"deflection": deflection}, outcome, jnp.zeros(()))

    def cost(self):
        return Cost(memory=64, batch=1000)

    def describe(self):
        return Description(
            "A cantilever",
            {"deflection": ResponseInfo("m")},
            {Outcome.OUT_OF_RANGE: "the beam would yield."},
        )


@pytest.fixture
def beam():
    varied = {
        "length": jc.Dimension(0.5, jc.distribution.Normal(5e-3)),
        "height": jc.Dimension(12e-3, jc.distribution.Normal(0.5e-3)),
    }
    return jc.Problem.of(Cantilever(jnp.asarray(100.0)), varied)


def test_problem_from_outside_is_sampled_and_its_failures_named(beam, tmp_path):
    study = jc.monte_carlo(beam, 64)
    table = np.genfromtxt(study.to_csv(tmp_path / "sample.csv"), delimiter=",", names=True)
    np.testing.assert_array_equal(table["deflection_m"], study.responses["deflection"])
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
