"""How deep a force presses is the law of contact the other way round."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.laws.contact.base import SHALLOWEST, indentation_under
from jaxclear.laws.stiffness import Shape, fitted

SHAPE = Shape(9.95e-3, 10e-3, 20e-3)
LAWS = [
    jc.contact.Hertz(stiffness=1e10),
    jc.contact.Hertz(stiffness=1e10, exponent=1.1),
    jc.contact.Hertz(stiffness=1e10, exponent=2.2),
    jc.contact.Liu(),
    jc.contact.BaiZhao(),
    jc.contact.Johnson(),
    jc.contact.Radzimovsky(),
    jc.contact.Goldsmith(),
    jc.contact.BallInSocket(),
    jc.contact.KelvinVoigt(),
    jc.contact.AdamsImpact(),
]


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_the_law_gives_the_force_back_and_its_slope(law):
    law = fitted(law, SHAPE)
    force = jnp.asarray([100.0, 1e3, 1e4, 1e6])
    depth = jax.vmap(lambda f: indentation_under(law, f))(force)
    least = law.elastic_force(jnp.asarray(SHALLOWEST))
    np.testing.assert_allclose(jax.vmap(law.elastic_force)(depth), force + least, rtol=1e-6)
    slope = jax.vmap(jax.grad(lambda f: indentation_under(law, f)))(force)
    steep = jax.vmap(jax.grad(law.elastic_force))(depth)
    np.testing.assert_allclose(slope, 1 / steep, rtol=1e-5)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_no_force_presses_next_to_nothing_with_a_finite_slope(law):
    law = fitted(law, SHAPE)
    depth, slope = jax.value_and_grad(lambda f: indentation_under(law, f))(0.0)
    assert depth == pytest.approx(SHALLOWEST, rel=1e-9) and np.isfinite(slope) and slope > 0


def test_rigid_parts_do_not_overlap():
    assert indentation_under(jc.contact.Rigid(), 1e3) == 0.0
