"""Slopes through an impact by relaxed steps: their limit, and what no relaxation gives.

*Push*: a body of 1 kg that a force drives closes a gap, strikes another one without rebound and
pushes it against drag; impulse and gap at the end of a step are complementary (Stewart & Trinkle
1996, Int. J. Numer. Methods Eng. 39, 2673). *Rebound*: a ball flies against a wall and back; where
the gap closes within half a step, impulse and Newton's law of impact are (Moreau).
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxclear.complementarity import LCP, InteriorPoint
from tests.rigs.lemke import Lemke

FORCE, DRAG, SPEED, RESTITUTION, DURATION = 4.0, 2.0, 1.0, 0.8, 1.0
STEPS = 20
# An impact of each falls elsewhere in its step, and none at the end of one.
GAPS = jnp.linspace(0.451, 0.549, 6)


def pushed(gap: Any) -> Any:
    """Way of the second body [m]: from their meeting on both go at half the speed of the first,
    then ever nearer to that at which drag takes the force."""
    meeting = jnp.sqrt(2 * gap / FORCE)
    left, last, rate = DURATION - meeting, FORCE / DRAG, DRAG / 2
    return last * left + (FORCE * meeting / 2 - last) / rate * (1 - jnp.exp(-rate * left))


def push(solver: Any, steps: int, gap: Any) -> Any:
    """The same by steps."""
    h = DURATION / steps

    def step(state, _):
        apart, first, second, gone = state
        first, second = first + h * FORCE, second * (1 - h * DRAG)
        free = apart + h * (second - first)
        impulse = solver.solve(LCP(jnp.array([[2 * h]]), free[None])).z[0]
        first, second = first - impulse, second + impulse
        return (apart + h * (second - first), first, second, gone + h * second), None

    return jax.lax.scan(step, (gap, 0.0, 0.0, 0.0), None, steps)[0][3]


def rebound(solver: Any, steps: int, gap: Any) -> Any:
    """Place of the ball before the wall [m], by steps."""
    h = DURATION / steps

    def step(state, _):
        apart, speed = state
        law = (1 + RESTITUTION) * speed
        impulse = solver.solve(LCP(jnp.eye(1), law[None])).z[0]
        after = jnp.where(apart + 0.5 * h * speed <= 0, speed + impulse, speed)
        return (apart + h * 0.5 * (speed + after), after), None

    return jax.lax.scan(step, (gap, jnp.asarray(-SPEED)), None, steps)[0][0]


@eqx.filter_jit
def slopes(way: Any, solver: Any, steps: int, gaps: Any) -> tuple[Any, Any]:
    """(places, their slopes by the gap)."""
    return jax.vmap(lambda gap: jax.jvp(lambda g: way(solver, steps, g), (gap,), (1.0,)))(gaps)


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
