"""Studies of a mechanism over positions: samples, derivatives, yields without a run."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import fsolve

import jaxclear as jc

ANGLES = np.linspace(0.0, 2 * np.pi, 6, endpoint=False)


def rig(clearance=0.2e-3):
    return jc.scenes.four_bar("planar", clearance, friction=False, wear=False)


VARIABLES = {
    "clearance": jc.Variable(lambda m: m.connections["B"].joint.clearance, tolerance=40e-6),
    "crank": jc.Variable(lambda m: m.connections["A"].parent.at[0], tolerance=20e-6),
}


@pytest.fixture(scope="module")
def asked():
    ideal = jc.positions(jc.scenes.four_bar("ideal"), {"O": ANGLES}).coordinate("D")

    def largest(stands):
        return jnp.max(jnp.abs(stands.coordinate("D") - ideal))

    def last(stands):
        return (stands.coordinate("D") - ideal)[-1]

    return jc.PositionProblem(
        rig(), {"largest": largest, "last": last}, VARIABLES, positions={"O": ANGLES}
    )


def test_one_of_a_batch_is_read_as_any_other(asked):
    nominal = asked.nominal()
    batch = jax.vmap(asked.detail)(jnp.stack([nominal, nominal + 1e-5]))
    alone = asked.detail(nominal)
    for read in (lambda own: own.coordinate("D"), lambda own: own.offset("B")):
        np.testing.assert_allclose(read(batch[0]), read(alone), atol=1e-12)
        with pytest.raises(ValueError, match="a batch of 2 runs"):
            read(batch)
    assert str(batch) == "A batch of 2 at positions each; positions[i] is one."


@pytest.mark.slow  # compiles three programs
def test_a_sample_is_the_mechanism_built_with_its_numbers(asked):
    study = jc.monte_carlo(asked, 32)
    assert not study.failed.size and study.problem.variable_units == ("m", "m")
    clearance, crank = study.values[5]
    alone = rig(clearance)
    pin = jc.Connection(jc.joint.Revolute(), "crank", "coupler", at=(crank, 0.0))
    joints = alone.connections | {"A": pin}
    built = jc.Mechanism(alone.bodies, joints, alone.loads, guess={"A": 0.81, "D": 1.32})
    places = jc.positions(built, {"O": ANGLES}).coordinates
    np.testing.assert_allclose(study.rerun(5).coordinates, places, atol=1e-11)


def test_a_sample_that_cannot_be_assembled_has_failed(asked):
    wide = {"crank": jc.Variable(VARIABLES["crank"].where, jc.distribution.Uniform(0.4))}
    study = jc.monte_carlo(
        jc.PositionProblem(rig(), asked.response["last"], wide, positions={"O": ANGLES}), 32
    )
    # Grashof: the crank goes round while it and the longest link are no longer than the others.
    outside = np.abs(study.values[:, 0]) > 0.21
    assert outside.any() and not outside.all()
    assert {*np.flatnonzero(outside)} <= {*study.failed}
    index = int(np.flatnonzero(outside)[0])
    assert "cannot be assembled at every position" in study.failures()[index]


@pytest.mark.slow  # the derivative takes 10 s to compile
def test_derivatives_are_exact_through_assembly_and_seats(asked):
    response = lambda values: asked.evaluate(values).responses["last"]
    at = asked.nominal()
    forward, backward = jax.jit(jax.jacfwd(response))(at), jax.jit(jax.grad(response))(at)
    value = jax.jit(response)
    for i, step in enumerate(1e-5 * np.eye(2)):
        # central, of order 4; a sample is settled to 1e-12 of the links or better
        near = (value(at + step) - value(at - step)) / 2e-5
        far = (value(at + 2 * step) - value(at - 2 * step)) / 4e-5
        assert float(forward[i]) == pytest.approx(float((4 * near - far) / 3), rel=1e-7)
    np.testing.assert_allclose(forward, backward, rtol=1e-12)


def follower_with(offset, crank):
    """Angle of the follower, by the closed loop, with the journal of B at an offset."""
    turn = lambda angle: np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def open_by(angles):
        end = turn(crank) @ (0.1, 0.0) + turn(angles[0]) @ (np.array([0.4, 0.0]) + offset)
        return end - np.array([0.3, 0.0]) - turn(angles[1]) @ (0.3, 0.0)

    return fsolve(open_by, (crank + 0.81, 1.32), xtol=1e-12)[1]


@pytest.mark.slow  # runs in time
def test_pose_errors_are_those_of_the_slow_motion_in_permanent_contact():
    """To the square of the clearance and of the step: the slow motion is that of the ideal
    mechanism and tells where the journal lies; with it there the loop is closed by hand."""
    turns, many, speed = 8, 400, 0.03
    angles = np.linspace(0.0, 0.5, turns + 1)[1:-1]

    def errors(clearance):
        mechanism = jc.scenes.four_bar(
            "planar", clearance, crank_speed=speed, friction=False, wear=False
        )
        steps = turns * many
        integrator = jc.integrator.NonColliding(0.5 / speed / steps)
        run = jc.simulate(mechanism, 0.5 / speed, save=steps + 1, integrator=integrator)
        seats = np.asarray(run.contact("B").offset)[:, :2]
        # a mean over the step that ends there; with the next one, of second order at the instant
        seats = 0.5 * (seats[many:-1:many] + seats[many + 1 :: many])
        slow = [follower_with(seat, angle) for seat, angle in zip(seats, angles, strict=True)]
        stands = jc.positions(mechanism, {"O": angles}).coordinate("D")
        ideal = [follower_with(np.zeros(2), angle) for angle in angles]
        return np.asarray(stands) - slow, np.asarray(stands) - ideal

    (wide, size), (narrow, _) = errors(0.2e-3), errors(0.1e-3)
    assert np.abs(wide).max() < 2e-3 * np.abs(size).max()
    np.testing.assert_allclose(wide / narrow, 4.0, rtol=0.05)
