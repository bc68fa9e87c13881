"""Motion that is read from a run, against closed forms and rates of velocities."""

import copy
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.scenes.slider_crank import CRANK, ROD

GRAVITY, SPEED, LENGTH = 9.81, 50.0, 0.3
# Of closed forms: what Adaptive's tolerances leave of a place, and rounding of forces.
EXACT = {"rtol": 1e-9, "atol": 1e-8}


def pendulum(length=LENGTH):
    return jc.Mechanism(
        {"rod": jc.Body(2.0, 0.03, com=(length, 0.0))},
        {"pin": jc.Connection(jc.joint.Revolute(), "ground", "rod")},
        {"gravity": jc.load.Gravity((0.0, -GRAVITY))},
    )


@pytest.fixture(scope="module")
def swing():
    return jc.simulate(pendulum(), 0.5, save=11)


@pytest.fixture(scope="module")
def driven():
    return jc.simulate(jc.scenes.slider_crank("ideal"), 0.1, save=21)


def test_a_pendulum_accelerates_as_its_moments_say(swing):
    angle, speed = swing.coordinate("pin"), swing.speed("pin")
    turning = -2.0 * GRAVITY * LENGTH * np.cos(angle) / (0.03 + 2.0 * LENGTH**2)
    body, zero = swing.body("rod"), 0 * angle
    along, across = [np.cos(angle), np.sin(angle), zero], [-np.sin(angle), np.cos(angle), zero]
    wanted = LENGTH * (turning * np.stack(across) - speed**2 * np.stack(along)).T
    np.testing.assert_allclose(body.acceleration, wanted, **EXACT)
    np.testing.assert_allclose(
        body.angular_acceleration, np.stack([zero, zero, turning], 1), **EXACT
    )
    # What a pin carries is all that accelerates, beside the weight: Newton's law.
    force = swing.reaction("pin").force + 2.0 * np.array([0.0, -GRAVITY, 0.0])
    np.testing.assert_allclose(2.0 * body.acceleration, force, **EXACT)


def test_an_accelerometer_on_a_turning_crank_reads_the_centripetal_acceleration(driven, tmp_path):
    """And its path is a table of places over time, with units: a circle."""
    pin = jc.Marker("crank", (CRANK, 0.0))
    marker, table = driven.marker(pin), driven.path(pin)
    angle = SPEED * np.asarray(driven.time)
    tip = CRANK * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    turned = CRANK * SPEED * np.stack([-np.sin(angle), np.cos(angle), 0 * angle], 1)
    np.testing.assert_allclose(marker.position, tip, **EXACT)
    np.testing.assert_allclose(marker.velocity, turned, **EXACT)
    np.testing.assert_allclose(marker.acceleration, -(SPEED**2) * tip, **EXACT)
    # Its x axis runs along the crank; gravity is felt upwards.
    felt = [GRAVITY * np.sin(angle) - SPEED**2 * CRANK, GRAVITY * np.cos(angle), 0 * angle]
    np.testing.assert_allclose(marker.specific_force, np.stack(felt, 1), **EXACT)
    turned = jc.Marker("crank", (CRANK, 0.0), axis="x")
    np.testing.assert_allclose(driven.marker(turned).specific_force[:, 2], felt[0], **EXACT)
    np.testing.assert_allclose(np.asarray(table), tip, **EXACT)
    assert list(table.columns) == ["x [m]", "y [m]", "z [m]"] and table.index.name == "time [s]"
    np.testing.assert_array_equal(driven.path("rod"), driven.body("rod").com)
    table.to_csv(tmp_path / "path.csv")
    first, *_ = (tmp_path / "path.csv").read_text().splitlines()
    assert first == "time [s],x [m],y [m],z [m]"


def test_a_slider_accelerates_as_its_crank_drives_it(driven):
    def place(time):
        angle = SPEED * time
        return CRANK * jnp.cos(angle) + jnp.sqrt(ROD**2 - (CRANK * jnp.sin(angle)) ** 2)

    # Beside what pulls a loop back that the tolerances leave off by 1e-9 m.
    wanted = jax.vmap(jax.grad(jax.grad(place)))(driven.time)
    np.testing.assert_allclose(driven.body("slider").acceleration[:, 0], wanted, atol=5e-5)


@pytest.mark.parametrize("law", ["spatial", "contact"])
def test_accelerations_are_rates_of_velocities(law):
    """Of a tumbling body on a spring, with a marker turned on it, and of a journal that strikes."""
    if law == "spatial":
        spring = jc.load.Spring(
            jc.Marker("ground", (0.1, 0.4, 0.0)), jc.Marker("top", (0.05, 0.02, 0.1)), 400.0, 0.2
        )
        rig = jc.Mechanism(
            {"top": jc.Body(1.5, (0.01, 0.02, 0.025), com=(0.01, 0.0, 0.03))},
            {"ball": jc.Connection(jc.joint.Spherical(), "ground", "top")},
            {"gravity": jc.load.Gravity((0.0, 0.0, -GRAVITY)), "spring": spring},
            speeds={"ball": (3.0, -5.0, 8.0)},
        )
        where = jc.Marker("top", (0.1, -0.2, 0.05), axis=(1.0, 2.0, 2.0))
        steps, saves, duration = jc.integrator.FixedStep(1e-4, "munthe_kaas4"), 101, 0.01
    else:
        rig = jc.scenes.slider_crank(contact=jc.contact.KelvinVoigt(stiffness=1e5, damping=10.0))
        where = jc.Marker("rod", (ROD, 0.0))
        steps, saves, duration = jc.integrator.FixedStep(1e-5), 2001, 0.02
    run = jc.simulate(rig, duration, save=saves, integrator=steps)
    marker, body, time = run.marker(where), run.body(where.body), np.asarray(run.time)
    pairs = (
        (marker.position, marker.velocity),
        (marker.velocity, marker.acceleration),
        (body.velocity, body.acceleration),
        (body.spin, body.angular_acceleration),
    )
    # Contact closes within a saving interval here and there: most differences see none of it.
    share = 1.0 if law == "spatial" else 0.95
    for value, rate in pairs:
        value, rate = np.asarray(value), np.asarray(rate)
        central = (value[2:] - value[:-2]) / (time[2:] - time[:-2])[:, None]
        off = np.abs(central - rate[1:-1]).max(axis=1) / np.abs(rate).max()
        assert np.quantile(off, share) < 1e-4
    if law == "contact":
        assert np.asarray(run.contact("B").normal_force).max() > 10.0


def test_contact_forces_that_are_means_give_mean_accelerations():
    """Over saving intervals of one step Moreau's run gains its accelerations times the step, what
    projection and the turning of axes within the step leave aside."""
    steps = jc.integrator.MoreauJean(1e-4)
    rig = jc.scenes.slider_crank(contact=jc.contact.Rigid(restitution=0.0), friction=False)
    run = jc.simulate(rig, 0.02, save=201, integrator=steps)
    slider = run.body("slider")
    gained = np.diff(np.asarray(slider.velocity), axis=0)[:, 0] / 1e-4
    np.testing.assert_allclose(slider.acceleration[1:, 0], gained, atol=0.02 * np.abs(gained).max())


def test_accelerations_differentiate():
    def pull(length):
        run = jc.simulate(pendulum(length), 0.1, save=3, throw=False)
        return run.marker("rod", (0.1, 0.0)).acceleration[0, 1]

    value, slope = jax.value_and_grad(pull)(LENGTH)
    inertia = 0.03 + 2.0 * LENGTH**2
    assert float(value) == pytest.approx(-0.1 * 2.0 * GRAVITY * LENGTH / inertia)
    wanted = -0.1 * 2.0 * GRAVITY * (0.03 - 2.0 * LENGTH**2) / inertia**2
    assert float(slope) == pytest.approx(wanted)


def test_a_driven_joint_moves_as_its_drive(driven, swing):
    np.testing.assert_allclose(driven.coordinate("O"), SPEED * driven.time)
    np.testing.assert_array_equal(driven.speed("O"), np.full(21, SPEED))
    assert float(jc.response.FinalCoordinate("O")(driven)) == pytest.approx(0.1 * SPEED)
    assert swing.coordinate("pin").shape == swing.speed("pin").shape == swing.time.shape


def test_what_a_run_does_not_hold_is_said(driven, swing):
    welded = pendulum().with_joint("pin", jc.joint.Fixed())
    marker = jc.Marker("rod", (0.1, 0.0))
    for sentence, read in {
        'a marker on "rod" has its place; leave `at` out': lambda: swing.marker(marker, (0.2, 0.0)),
        'no body "ground"': lambda: swing.marker("ground", (0.1, 0.0)),
        'no body "bar"': lambda: driven.path("bar"),
        "the point of a path is 3": lambda: driven.path(3),
        '"B" carries no coordinates: it has clearance, closes': lambda: driven.coordinate("B"),
        '"pin" carries no coordinates: .* is welded': lambda: jc.simulate(
            welded, 0.1, save=2
        ).speed("pin"),
        '"O" has 1 coordinates; the index': lambda: jc.response.FinalCoordinate("O", 1)(driven),
    }.items():
        with pytest.raises(ValueError, match=sentence):
            read()
    with pytest.raises(AttributeError, match=r"run\.path\(marker\)"):
        driven.position  # noqa: B018


@pytest.fixture(scope="module")
def batch():
    lengths = jnp.array([0.2, LENGTH, 0.4])
    return jax.vmap(lambda own: jc.simulate(pendulum(own), 0.5, save=11, throw=False))(lengths)


def test_one_run_of_a_batch_is_read_as_any_other(batch, swing):
    one = batch[1]
    np.testing.assert_allclose(one.body("rod").com, swing.body("rod").com, rtol=1e-9, atol=1e-9)
    felt = (run.marker("rod", (0.1, 0.0)).acceleration for run in (one, swing))
    np.testing.assert_allclose(*felt, atol=1e-6)
    assert one.result == "The run reached its end." and "rod" in one.to_dataset()
    assert [float(own.mechanism.bodies["rod"].com[0]) for own in batch] == [0.2, LENGTH, 0.4]
    assert str(batch) == "A batch of 3 runs, of which 3 reached their end; run[i] is one."
    ends = jax.vmap(jc.response.FinalCoordinate("pin"))(batch)
    np.testing.assert_array_equal(ends, [own.coordinate("pin")[-1] for own in batch])
    with pytest.raises(IndexError, match="run 3 was asked for; the batch has 3"):
        batch[3]
    with pytest.raises(ValueError, match="this is one run, not a batch"):
        swing[0]


def test_a_batch_says_how_it_is_read(batch):
    for read in (
        lambda runs: runs.body("rod"),
        lambda runs: runs.coordinate("pin"),
        lambda runs: runs.reaction("pin"),
        lambda runs: runs.drift(),
        lambda runs: runs.worn_depth("pin", "bearing"),
        lambda runs: runs.state(),
        lambda runs: runs.result,
        lambda runs: runs.warnings,
        lambda runs: runs.to_dataset(),
        lambda runs: runs.estimate(jc.response.FinalCoordinate("pin")),
        jc.response.FinalCoordinate("pin"),
    ):
        with pytest.raises(ValueError, match=r"a batch of 3 runs: take one of them, run\[i\]"):
            read(batch)


def test_evaluate_compiles_and_keeps_its_program():
    traced = []

    def end(run):
        traced.append(run)
        return run.coordinate("pin")[-1]

    length = jc.Variable(lambda rig: rig.bodies["rod"].com[0], tolerance=0.01)
    problem = jc.Problem(pendulum(), end, {"length": length}, duration=0.1, save=3)
    compiled, nominal = jax.jit(problem.evaluate), problem.nominal()
    first = float(compiled(nominal).responses["response"])
    often = len(traced)
    alone = float(problem.evaluate(nominal).responses["response"])
    assert first == pytest.approx(alone, rel=1e-12)
    again = len(traced)
    assert float(compiled(nominal + 0.01).responses["response"]) != first
    assert len(traced) == again and often > 0


def test_data_are_a_tree_by_body_and_joint():
    run = jc.simulate(jc.scenes.slider_crank(wear=True), 0.002, save=3, balance=True)
    tree, flat = run.to_dataset(), run.to_dataset(flat=True)
    assert tree.attrs["result"] == run.result == flat.attrs["result"]
    np.testing.assert_array_equal(tree["crank"].com, run.body("crank").com)
    assert tree["crank"].acceleration.attrs["units"] == "m/s^2"
    assert tree["B/bearing"].worn_depth.dims == ("around", "along")
    assert tree["B"].normal_force.dims == ("time", "contact")
    assert {"what", "versions"} <= set(tree.attrs) and "time" in tree["rod"].coords
    for name, column in flat.data_vars.items():
        path, _, field = name.rpartition(".")
        place = tree[path.replace(".", "/")] if path else tree
        np.testing.assert_array_equal(place[field], column)
    for other in (pickle.loads(pickle.dumps(tree)), copy.copy(tree)):
        assert other.identical(tree)
