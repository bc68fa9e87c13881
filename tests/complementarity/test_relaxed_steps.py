"""Slopes through an impact by relaxed steps: their limit, and what no relaxation gives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.claims.relaxation import RESTITUTION, push, pushed, rebound, slopes
from jaxclear.complementarity import InteriorPoint
from tests.rigs.lemke import Lemke

STEPS = 20
# An impact of each falls elsewhere in its step, and none at the end of one.
GAPS = jnp.linspace(0.451, 0.549, 6)


@pytest.mark.slow
def test_slopes_tend_to_those_of_exact_contact_as_the_relaxation_goes():
    place, limit = slopes(push, Lemke(), STEPS, GAPS)
    # The step's own error: h times the speeds that meet.
    np.testing.assert_allclose(limit, jax.vmap(jax.grad(pushed))(GAPS), rtol=0.05)
    away = []
    for kappa in (1e-7, 1e-8, 1e-9):
        relaxed, own = slopes(push, InteriorPoint(kappa), STEPS, GAPS)
        away.append([np.abs(relaxed - place).max(), np.abs(own - limit).max()])
    # In proportion to kappa where no impulse and gap vanish together.
    shares = np.array(away[1:]) / np.array(away[:-1])
    assert np.all(np.abs(shares - 0.1) < 0.005)


@pytest.mark.slow
def test_no_relaxation_moves_the_instant_of_a_rebound():
    """Newton's law at the speeds: the slope is that of a flight which turns at a fixed instant."""
    for solver in (InteriorPoint(1e-2), InteriorPoint(1e-8), Lemke()):
        _, own = slopes(rebound, solver, STEPS, GAPS)
        np.testing.assert_allclose(own, 1.0, rtol=1e-9)
        assert abs(own + RESTITUTION).min() > 1  # that of the motion is its negative
