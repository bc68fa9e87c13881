"""Tables over time: through their numbers, smooth as they say, differentiable, and refused where a
drive would jump.

Every drive: speed and acceleration are the derivatives of its position."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import interpolate

import jaxclear as jc
from jaxclear.components.drive import AbstractDrive
from tests.components.test_ideal_joints import members
from tests.rigs.cells import slow

TIMES = np.array([0.0, 0.1, 0.25, 0.5, 0.7, 1.0])
VALUES = np.sin(3 * TIMES)
BETWEEN = np.linspace(0.0, 1.0, 101)
REFERENCE = {
    "cubic": interpolate.CubicSpline(TIMES, VALUES),
    "monotone": interpolate.PchipInterpolator(TIMES, VALUES),
    "linear": interpolate.make_interp_spline(TIMES, VALUES, 1),
}


SLOW = pytest.mark.slow
INTERPOLATIONS = ["cubic", *slow("monotone", "linear")]


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_it_is_scipys_interpolation(interpolation):
    table = jc.TimeTable(TIMES, VALUES, interpolation, factor=2.0)
    found = jax.jit(jax.vmap(table))(BETWEEN)
    np.testing.assert_allclose(found, 2 * REFERENCE[interpolation](BETWEEN), atol=1e-14)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize("beyond", [*slow("held"), "straight"])
def test_its_integral_is_that_of_its_values(interpolation, beyond):
    """By trapezia on 2e5 pieces, beyond both ends too; these are off by their steps' square."""
    table = jc.TimeTable(TIMES, VALUES, interpolation, beyond=beyond)
    values = jax.jit(jax.vmap(table))
    for end in (-0.4, 0.33, 1.0, 1.7):
        at = np.linspace(0.0, end, 200_001)
        wanted = np.trapezoid(values(at), at)
        np.testing.assert_allclose(table.integral(end), wanted, atol=1e-9)


@SLOW
def test_a_repeated_table_has_no_kink_where_it_begins_anew():
    times = np.linspace(0.0, 2.0, 81)
    table = jc.TimeTable(times, np.cos(np.pi * times), beyond="repeated")
    at = jnp.array([-1.3, 1.999999, 2.000001, 7.1])
    rate = jax.vmap(jax.grad(table))
    # A spline of 40 pieces a turn follows a cosine to the fourth power of a piece.
    np.testing.assert_allclose(jax.vmap(table)(at), np.cos(np.pi * at), atol=1e-6)
    np.testing.assert_allclose(rate(at), -np.pi * np.sin(np.pi * at), atol=1e-4)
    np.testing.assert_allclose(table.integral(8.5), np.sin(np.pi * 8.5) / np.pi, atol=1e-6)


def test_derivatives_by_values_are_those_of_a_changed_table():
    at_a_time = jax.jit(lambda values: jc.TimeTable(TIMES, values)(0.37))
    found = jax.jit(jax.jacfwd(at_a_time))(VALUES)
    wanted = [at_a_time(VALUES + row) - at_a_time(VALUES) for row in np.eye(6)]
    np.testing.assert_allclose(found, wanted, atol=1e-12)


@SLOW
def test_a_drive_and_loads_take_a_table():
    """A crank that a table turns moves as one that the function itself turns."""
    function = lambda time: 2 * time + 0.3 * jnp.sin(5 * time)
    table = jc.TimeTable.sampled(function, np.linspace(0.0, 1.0, 401), beyond="straight")
    for drive in (
        jc.drive.Position(table),
        jc.drive.Speed(jc.TimeTable.sampled(jax.grad(function), np.linspace(0.0, 1.0, 401))),
    ):
        for own, other in zip(
            drive.motion(0.4321), jc.drive.Position(function).motion(0.4321), strict=True
        ):
            # Spline: fourth, third and second power of a piece of 2.5 ms.
            np.testing.assert_allclose(own, other, rtol=2e-5)
    force = jc.TimeTable([0.0, 1.0], [[0.0, 1.0], [2.0, 3.0]], "linear")
    np.testing.assert_allclose(jc.load.Force(jc.Marker("rod"), force).value(0.5), [1.0, 2.0])


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: jc.TimeTable([0.0], [1.0]), "two or more finite numbers"),
        (lambda: jc.TimeTable([0.0, 0.0], [1.0, 2.0]), "must rise"),
        (lambda: jc.TimeTable([0.0, 1.0], [1.0]), "one row, for each of its 2 times"),
        (lambda: jc.TimeTable([0.0, 1.0], [1.0, np.nan]), "must be finite"),
        (lambda: jc.TimeTable([0.0, 1.0], [1.0, 2.0], "cubical"), 'Did you mean "cubic"'),
        (lambda: jc.TimeTable([0, 1], [1, 2], beyond="repeated"), "end with the value"),
        (lambda: jc.drive.Position(jc.TimeTable(TIMES, VALUES, "linear")), "its speed jumps"),
        (lambda: jc.drive.Position(jc.TimeTable(TIMES, VALUES)), "held beyond its ends, where it"),
        (lambda: jc.load.JointTorque("A", jc.TimeTable([0, 1], [[1, 2], [3, 4]])), "1 number"),
    ],
)
def test_what_is_no_table_is_refused(make, sentence):
    with pytest.raises(ValueError, match=sentence):
        make()


def test_a_csv_file_gives_a_table(tmp_path):
    path = tmp_path / "force.csv"
    path.write_text("t, Fx, Fy, note\n0, 1, 2, a\n0.5, 3, 4, b\n1, 5, 6, c\n")
    table = jc.TimeTable.from_csv(path, "t", ["Fx", "Fy"], "linear")
    np.testing.assert_allclose(table(0.25), [2.0, 3.0])
    for names, sentence in (
        (("time", "Fx"), 'no column "time" in force.csv'),
        (("t", "note"), "holds what is no number"),
    ):
        with pytest.raises(ValueError, match=sentence):
            jc.TimeTable.from_csv(path, *names)
    with pytest.raises(ValueError, match=r"none\.csv is no file"):
        jc.TimeTable.from_csv(tmp_path / "none.csv", "t", "Fx")


EXAMPLES = {
    "ConstantSpeed": jc.drive.ConstantSpeed(3.0, 0.2),
    "ConstantPosition": jc.drive.ConstantPosition(0.7),
    "Harmonic": jc.drive.Harmonic(0.3, 2.0, 0.1, 0.05),
    "RampUp": jc.drive.RampUp(5.0, 0.4, 0.1),
    "Position": jc.drive.Position(lambda time: jnp.sin(3 * time) + time**3),
    "Speed": jc.drive.Speed(lambda time: jnp.cos(2 * time) * jnp.exp(-time), 0.3),
}


@pytest.mark.parametrize(
    "kind",
    sorted(members(AbstractDrive), key=lambda kind: kind.__name__),
    ids=lambda kind: kind.__name__,
)
def test_speed_and_acceleration_are_derivatives(kind):
    motion = jax.jit(
        lambda time: jnp.stack(
            [jnp.asarray(x, float) for x in EXAMPLES[kind.__name__].motion(time)]
        )
    )
    step = 1e-5
    for time in (0.03, 0.21, 0.39, 0.41, 1.7):
        change = (motion(time + step) - motion(time - step)) / (2 * step)
        # central differences: step^2/6 times third derivatives of order 100, and rounding over the
        # step
        np.testing.assert_allclose(change[:2], motion(time)[1:], rtol=1e-7, atol=3e-9)
        exact = jax.jvp(motion, (time,), (1.0,))[1]
        np.testing.assert_allclose(exact[:2], motion(time)[1:], rtol=1e-12, atol=1e-12)


def test_ramp_joins_smoothly():
    ramp = EXAMPLES["RampUp"]
    for time in (0.0, 0.4):
        before, after = (
            np.array(ramp.motion(jnp.asarray(time + shift))) for shift in (-1e-9, 1e-9)
        )
        # position and speed are continuous, the acceleration of a cubic step is zero at either end
        np.testing.assert_allclose(before, after, atol=1e-6)
    np.testing.assert_allclose(ramp.motion(0.4)[0], 0.1 + 5.0 * 0.2, rtol=1e-14)


def test_prescribed_speed_integrates_to_its_position():
    drive = EXAMPLES["Speed"]
    for time in (0.0, 0.3, 2.0):
        # integral of cos(2 t) exp(-t)
        closed = (np.exp(-time) * (2 * np.sin(2 * time) - np.cos(2 * time)) + 1) / 5
        # Gauss-Legendre of order 16 on an analytic function
        np.testing.assert_allclose(drive.motion(time)[0], 0.3 + closed, rtol=1e-13)


@pytest.mark.parametrize(
    ("drive", "angle"),
    [
        (jc.drive.Position(lambda t: 0.5), 0.5),
        (jc.drive.Position(lambda t: 2.0 * t), 0.02),
        (jc.drive.Speed(lambda t: 3.0), 0.03),
        (jc.drive.Speed(jnp.sin), 1 - np.cos(0.01)),
    ],
    ids=["constant place", "place", "constant speed", "speed"],
)
def test_functions_of_time_drive_a_mechanism(drive, angle):
    crank = jc.Mechanism(
        {"crank": jc.Body(mass=1.0, inertia=1e-2, com=(1.0, 0.0))},
        {"O": jc.Connection(jc.joint.Revolute(drive=drive), "ground", "crank")},
    )
    run = jc.simulate(crank, 0.01, save=3, integrator=jc.integrator.FixedStep(1e-3))
    end = run.body("crank").com[-1]
    np.testing.assert_allclose(end, (np.cos(angle), np.sin(angle), 0.0), atol=1e-12)


def test_a_torque_may_be_a_function_that_returns_a_number():
    inertia, torque = 0.5, 2.0
    wheel = jc.Mechanism(
        {"wheel": jc.Body(mass=1.0, inertia=inertia)},
        {"O": jc.Connection(jc.joint.Revolute(), "ground", "wheel")},
        {"motor": jc.load.Torque(jc.Marker("wheel"), lambda t: torque)},
    )
    turned = jc.simulate(wheel, 0.1, save=3).coordinate("O")[-1]
    np.testing.assert_allclose(turned, 0.5 * torque / inertia * 0.1**2, rtol=1e-9)


@pytest.mark.slow
def test_a_study_takes_a_mechanism_with_a_table():
    """A torque that rises as a ramp: I w = M T / 2."""
    ramp = jc.load.JointTorque("A", jc.TimeTable([0.0, 1.0], [0.0, 1.0], "linear"))
    rig = jc.Mechanism(
        {"bar": jc.Body(1.0, 2.0)},
        {"A": jc.Connection(jc.joint.Revolute(), "ground", "bar")},
        {"M": ramp},
    )
    problem = jc.Problem(
        rig,
        lambda run: run.speed("A")[-1],
        {"inertia": jc.Variable(lambda rig: rig.bodies["bar"].inertia[0], tolerance=0.1)},
        duration=1.0,
        integrator=jc.integrator.FixedStep(0.1),
        save=2,
    )
    found = jax.jit(problem.evaluate)(problem.nominal())
    np.testing.assert_allclose(found.responses["response"], 0.25, rtol=1e-12)
