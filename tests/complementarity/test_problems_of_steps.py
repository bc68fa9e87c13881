"""The problems that time steps pose, taken from runs and solved again by Lemke's method.

A callback writes down every problem of a run and what the step's solver found; the run then goes
through XLA, not as a kernel, with the same arithmetic.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.complementarity import (
    LCP,
    BoxedGaussSeidel,
    FrictionContact,
    InteriorPoint,
    JointFriction,
    Outcome,
    ProjectedGaussSeidel,
)
from jaxclear.complementarity.joint_friction import OfReaction
from tests.rigs.cells import slow
from tests.rigs.guide_by_hand import friction_problem
from tests.rigs.lemke import lemke

RIGID = jc.contact.Rigid(restitution=0.4)


def recorded(monkeypatch, solver, what, run):
    """(parts of the problem, friction or percussions) of every step of a run."""
    found, iterate = [], solver.iterate

    def recording(self, problem, *start, **options):
        answer = iterate(self, problem, *start, **options)
        jax.debug.callback(
            lambda *x: found.append(jax.tree.map(np.asarray, x)), what(problem), answer.z
        )
        return answer

    monkeypatch.setattr(solver, "iterate", recording)
    jax.clear_caches()
    run()
    jax.effects_barrier()
    monkeypatch.undo()
    jax.clear_caches()
    return found


def falling_slider(friction):
    """A slider that falls askew in a guide that stands still, and strikes its walls."""
    guide = jc.clearance.SliderGuide(RIGID, friction, clearance=1e-3, length=0.04, width=0.02)
    return jc.Mechanism(
        {"slider": jc.Body(1.0, 1e-4)},
        {"P": jc.Connection(guide, "ground", "slider", axis="x")},
        {"gravity": jc.load.Gravity((0.3, -9.81))},
        speeds={"slider": (0.2, -0.05, 1.0)},
    )


# The problems are read out of the loop by a callback, for which there is no machine code.
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:jaxclear runs a time loop through XLA:RuntimeWarning")
@pytest.mark.parametrize(
    "mu",
    [None, *slow(0.2)],  # XLA is long at written-out Newton steps
)
def test_percussions_of_a_falling_slider(monkeypatch, mu):
    """Percussions of a stiff body at four corners need not be unique; what they do to it is."""
    friction = None if mu is None else jc.friction.Coulomb(mu_kinetic=mu)
    integrator = jc.integrator.MoreauJean(2e-4, project=False)
    run = lambda: jc.simulate(falling_slider(friction), 0.04, save=3, integrator=integrator)
    data = lambda p: (*p.acting(), p.mu)
    found = recorded(monkeypatch, ProjectedGaussSeidel, data, run)
    pressed = [(parts, r) for parts, r in found if np.any(r)]
    assert len(found) >= 200 and len(pressed) > 20
    for (matrix, offset, mu), r in pressed[:: max(1, len(pressed) // 12)]:
        referee = lemke(FrictionContact(matrix, offset, mu))
        size = np.abs(offset).max()
        np.testing.assert_allclose(matrix @ r, matrix @ referee.z, atol=1e-10 * size)
        assert FrictionContact(matrix, offset, mu).residual(r, matrix @ r + offset) < 1e-10 * size


def corners(problem):
    """(W, s_0, the bounds' ratio, n at T = 0 and 1 without and with a ratio of 1) of one guide."""
    (law,) = problem.blocks
    forces = lambda friction, ratio: jnp.stack(
        [force[0] for force in law.carried(jnp.full(1, friction), ratio)]
    )
    n = jnp.stack(
        [forces(t, ratio) for t, ratio in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0))]
    )
    return problem.delassus[0][0], problem.free_velocity[0], law.low, n


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:jaxclear runs a time loop through XLA:RuntimeWarning")
@pytest.mark.parametrize("drive", [True, False])
def test_friction_of_the_slider_in_its_guide(monkeypatch, drive):
    """The horizontal LCP of both corners, for a crank that is driven and one that is let go."""
    free = {"drive": None, "crank_angle": -2.2, "crank_speed": 0.0}
    rig = jc.scenes.guide(**({} if drive else free))
    step, steps = 2e-3, 400 if drive else 120
    integrator = jc.integrator.NonColliding(step)
    run = lambda: jc.simulate(rig, steps * step, save=4, integrator=integrator)
    found = recorded(monkeypatch, BoxedGaussSeidel, corners, run)
    assert len(found) >= steps
    refereed = 0
    for (response, slip, mu, (at_rest, pulled, turned, _)), friction in found[:: steps // 12]:
        # The moment of friction at half the width, per unit of the sum of the signed forces.
        lever = (turned - at_rest) / at_rest.sum()
        slope = pulled - at_rest
        for lean in (1.0, -1.0):
            # Both corners on one wall: the sum of the signed forces is the sum of their sizes.
            problem = friction_problem(at_rest, slope + lean * lever, mu, slip, response)
            referee = lemke(problem)
            n = (referee.z - referee.w)[:2]
            if np.all(lean * n > 0):
                total = np.abs(n).sum()
                own = float(referee.w[2]) - mu * total
                np.testing.assert_allclose(friction[0], own, atol=1e-10 * total)
                refereed += 1
    assert refereed >= 4


def test_boxes_in_closed_form():
    """A block pushed along the ground: it sticks below mu N, and slides beyond."""
    load, mass, step = 10.0, 2.0, 1e-2
    for push, expected in ((1.5, -1.5), (5.0, -2.0), (-5.0, 2.0)):
        law = OfReaction(0.2, 0.2, lambda *_: [(load, 0, 0)])
        problem = JointFriction([[step / mass]], [push * step / mass], (law,), [0.0])
        found = BoxedGaussSeidel().solve(problem)
        assert found.solved and float(found.residual) < 1e-12
        np.testing.assert_allclose(found.z, expected, rtol=1e-12)
        np.testing.assert_allclose(found.w, (push + expected) * step / mass, atol=1e-15)
        rounded = BoxedGaussSeidel(relaxation=1e-3).solve(problem)
        assert rounded.solved and abs(rounded.z[0] - expected) < 2e-3 * 0.2 * load
        # 0 <= s+ perp B + T >= 0 and 0 <= B - T perp s- >= 0 as a linear problem of s+ and B - T.
        bound, inverse = 0.2 * load, step / mass
        matrix = np.array([[0.0, -1.0], [1.0, inverse]])
        offset = np.array([2 * bound, -inverse * bound - push * step / mass])
        by_path = InteriorPoint(inverse * (1e-3 * bound / 2) ** 2).solve(LCP(matrix, offset))
        assert by_path.solved
        np.testing.assert_allclose(bound - rounded.z[0], by_path.z[1], rtol=1e-8)
    frictionless = JointFriction([[1.0]], [1.0], (None,), [0.0])
    assert BoxedGaussSeidel().solve(frictionless).z == 0.0
    lost = BoxedGaussSeidel(max_sweeps=1.0).solve(problem)
    assert lost.outcome == Outcome.LIMIT


def test_joints_that_stick_and_contradict_each_other_by_little_stop_what_they_hold():
    """Two clamps on one shaft, whose slips differ by 1e-9 of the speed that they stop, as those of
    a loop do that closes to the order of a step: they share what holds it in no unique way, and
    sweeps that passed the difference on would end after 4e8 of them."""
    inverse, load, speed = 0.5, 10.0, 1.0
    rows = [[inverse, inverse], [inverse, inverse]]
    law = OfReaction(0.4, 0.4, lambda *_: [(load, 0, 0)])
    problem = JointFriction(rows, [speed, speed * (1 + 1e-9)], (law, law), [0.0, 0.0])
    found = BoxedGaussSeidel().iterate(problem)
    assert int(found.sweeps) < 10 and float(found.residual) <= 1e-13
    np.testing.assert_allclose(found.z.sum(), -speed / inverse, rtol=2e-9)
    np.testing.assert_array_less(abs(found.z), 0.4 * load)
