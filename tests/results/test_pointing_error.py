"""Pointing error against closed forms, a matrix-exponential oracle and the engine's poses; its
order, its sum, its refusals."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import jaxclear as jc
from jaxclear import plot
from jaxclear.formulations.compliant import CompliantContact
from jaxclear.integrators import Outcome
from jaxclear.multibody import product_of_exponentials as exponentials
from jaxclear.multibody.product_of_exponentials import (
    chain,
    forward_kinematics,
    measured_configuration,
    nominal_motion,
    tip_error,
)
from jaxclear.results.state_history import StateHistory
from jaxclear.results.trajectory import RunStats
from tests.rigs.falling_journal import touching_journal
from tests.rigs.refusals import refusals

LAW = jc.contact.Flores(stiffness=1e8, restitution=0.5)
BODY = jc.Body(1.0, (1e-2, 1e-2, 1e-2))
TIP = jc.Marker("dish", at=(0.1, 0.4, 0.2), axis=(1.0, 2.0, 3.0))
TIP_AXES = np.array(jax.tree.map(float, TIP.pose().rotation))
Q = (0.7, -1.2)
# Offsets and tilts of journals in bearings [m, rad], free of turns about the axis, which are the
# joints' own.
DEVIATIONS = 1e-2 * np.array([[1.0, -2.0, 0.5, 0.8, 1.5, 0.0], [-0.7, 0.4, 1.1, -1.3, 0.6, 0.0]])
ALONG_X = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])


def bearing():
    return jc.clearance.JournalBearing(LAW, clearance=1e-3, length=0.05)


def antenna(first=None, second=None, turned=False, start=None):
    """Ground - bearing about z - arm - bearing about x - dish; `turned`: the second joint is given
    from the dish to the arm."""
    ends = (
        jc.Marker("arm", at=(0.5, 0.0, 0.05), axis="x"),
        jc.Marker("dish", at=(0.0, 0.0, -0.02), axis="x"),
    )
    return jc.Mechanism(
        {"arm": BODY, "dish": BODY},
        {
            "J1": jc.Connection(first or bearing(), "ground", "arm", at=(0.0, 0.0, 0.1)),
            "J2": jc.Connection(second or bearing(), *(ends[::-1] if turned else ends)),
        },
        start=start,
    )


def matrix(rotation=None, at=(0, 0, 0)):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.eye(3) if rotation is None else rotation, at
    return pose


def hat(twist):
    v, (x, y, z) = twist[:3], twist[3:]
    pose = np.zeros((4, 4))
    pose[:3, :3], pose[:3, 3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]], v
    return pose


def oracle(q, deviations, turned=False):
    """Poses of arm, dish and tip as a product of matrix exponentials (scipy)."""
    turn = np.array([0, 0, 0, 0, 0, 1.0])
    first, second = (
        expm(hat(d)) @ expm(hat(turn * angle)) for d, angle in zip(deviations, q, strict=True)
    )
    arm = matrix(at=(0, 0, 0.1)) @ first
    dish = matrix(ALONG_X, (0, 0, -0.02))
    second = np.linalg.inv(second) if turned else second
    dish = arm @ matrix(ALONG_X, (0.5, 0, 0.05)) @ second @ np.linalg.inv(dish)
    return arm, dish, dish @ matrix(TIP_AXES, (0.1, 0.4, 0.2))


def motion_about_z(angle):
    return jnp.asarray(expm(hat(angle * np.array([0, 0, 0, 0, 0, 1.0]))))


def setting(deviations, q=Q):
    motions = tuple(motion_about_z(angle) for angle in q)
    return exponentials.ChainConfiguration(motions, tuple(jnp.asarray(deviations)))


def trajectory(mechanism, poses):
    """A run whose saved states are these poses of arm and dish, (times, bodies, 4, 4)."""
    turns = Rotation.from_matrix(poses[..., :3, :3].reshape(-1, 3, 3)).as_quat()
    places = [poses[..., :3, 3].reshape(-1, 3), np.roll(turns, 1, axis=-1)]
    coordinates = np.concatenate(places, axis=1).reshape(len(poses), -1)
    states = jnp.asarray(np.concatenate([coordinates, np.zeros((len(poses), 12))], axis=1))
    time = jnp.linspace(0.0, 1.0, len(poses))
    history = StateHistory(mechanism, CompliantContact(), time, states, {}, False)
    stats = RunStats(*[jnp.asarray(0)] * 3)
    return jc.Trajectory(history, {}, jnp.asarray(Outcome.REACHED), time[-1], stats)


def posed(q, deviations):
    poses = np.stack([oracle(a, d)[:2] for a, d in zip(q, deviations, strict=True)])
    return trajectory(antenna(), poses)


@pytest.fixture(scope="module")
def wobbling():
    """The antenna at 21 instants, joints turning while journals go round in their bearings."""
    t = np.linspace(0, 1, 21)[:, None]
    q = np.array(Q) + np.array([1.5, -2.5]) * t
    swing = np.stack([np.cos(7 * t), np.sin(5 * t)], axis=1)
    return posed(q, 0.05 * DEVIATIONS * swing), q, 0.05 * DEVIATIONS * swing


@pytest.mark.slow
@pytest.mark.parametrize("turned", [False, True])
def test_adjoint_model_is_exact_to_first_order(turned):
    links = chain(antenna(turned=turned), "ground", TIP)

    def difference(scale):
        now = setting(scale * DEVIATIONS)
        error = tip_error(links, now)
        return np.linalg.norm(error.exact - sum(error.deviations))

    differences = np.array([difference(scale) for scale in (1.0, 0.5, 0.25, 0.125)])
    orders = np.log2(differences[:-1] / differences[1:])
    # Measured 2.0000 and 2.0017 at the coarsest: what is left is the third-order term at tilts of 1
    # degree.
    assert np.all(np.abs(orders - 2) < 0.01), orders


@pytest.mark.parametrize("turned", [False, True])
def test_product_of_exponentials_equals_scipy(turned):
    """To rounding of two dozen products of numbers near 1."""
    exact = {"rtol": 0, "atol": 1e-14}
    links = chain(antenna(turned=turned), "ground", TIP)
    arm, dish, tip = oracle(Q, DEVIATIONS, turned)
    np.testing.assert_allclose(forward_kinematics(links, setting(DEVIATIONS)), tip, **exact)
    found = measured_configuration(links, {"arm": jnp.asarray(arm), "dish": jnp.asarray(dish)})
    np.testing.assert_allclose(found.deviations, DEVIATIONS, **exact)
    for motion, angle in zip(found.motions, Q, strict=True):
        np.testing.assert_allclose(motion, motion_about_z(angle), **exact)
    displacement = np.linalg.inv(oracle(Q, 0 * DEVIATIONS, turned)[2]) @ tip
    error = tip_error(links, found)
    np.testing.assert_allclose(expm(hat(np.asarray(error.exact))), displacement, **exact)
    moved = np.linalg.norm(displacement[:3, 3])
    assert float(error.position_error) == pytest.approx(moved, rel=1e-12)
    assert float(error.pointing_angle) == pytest.approx(np.arccos(displacement[2, 2]), rel=1e-10)


@pytest.mark.slow
def test_product_of_exponentials_equals_the_engine():
    ideal = antenna(jc.joint.Revolute(), jc.joint.Revolute(), start={"J1": Q[0], "J2": Q[1]})
    speeds = {"J1": (jnp.array(2.0),), "J2": (jnp.array(-3.0),)}
    run = jc.simulate(eqx.tree_at(lambda m: m.speeds, ideal, speeds), 0.05, save=6)
    links, exact = chain(run.mechanism, "ground", TIP), {"rtol": 0, "atol": 1e-12}
    bodies = {name: run.body(name) for name in ("arm", "dish")}
    for k in range(0, len(run.time), 5):
        _, dish, tip = oracle((run.coordinate("J1")[k], run.coordinate("J2")[k]), 0 * DEVIATIONS)
        poses = {
            name: exponentials.transform(own.rotation[k], own.origin[k])
            for name, own in bodies.items()
        }
        np.testing.assert_allclose(poses["dish"], dish, **exact)
        found = forward_kinematics(links, measured_configuration(links, poses))
        np.testing.assert_allclose(found, tip, **exact)
    error = jc.pointing_error(run, TIP)
    assert error.contributions == {} and not error.model.any() and np.abs(error.exact).max() < 1e-15
    assert "share" not in error.sentence()


@pytest.mark.parametrize("angle", [0.0, 0.9, 3.0])
def test_single_bearing_moves_and_tilts_the_tip_as_geometry_says(angle):
    offset, tilt, length = 2e-4, 1e-3, 0.8
    rig = jc.Mechanism({"dish": BODY}, {"J": jc.Connection(bearing(), "ground", "dish")})
    links = chain(rig, "ground", jc.Marker("dish", at=(0.0, 0.0, length)))
    cases = ([offset, 0, 0, 0, 0, 0], [0, 0, 0, tilt, 0, 0])
    moved, tilted = (tip_error(links, now) for now in (setting([c], (angle,)) for c in cases))
    way = offset * np.array([np.cos(angle), -np.sin(angle), 0])
    np.testing.assert_allclose(moved.exact[:3], way, atol=1e-18)
    assert float(moved.position_error) == pytest.approx(offset, rel=1e-12)
    assert float(moved.pointing_angle) < 1e-12
    # A chord of the circle about the bearing; the model gives the arc.
    assert float(tilted.position_error) == pytest.approx(2 * length * np.sin(tilt / 2), rel=1e-10)
    assert np.linalg.norm(tilted.deviations[0][:3]) == pytest.approx(tilt * length, rel=1e-12)
    assert float(tilted.pointing_angle) == pytest.approx(tilt, rel=1e-10)


# What each leaves free: places x, y, z and turns r, s, t about these.
FREE = {
    jc.clearance.JournalBearing: "t",
    jc.clearance.PlanarJournalBearing: "zrst",
    jc.clearance.BallSocket: "rst",
    jc.clearance.SliderGuide: "yz",
    jc.joint.Prismatic: "z",
}


@pytest.mark.parametrize("joint", FREE)
def test_nominal_motion_keeps_what_the_ideal_joint_leaves_free(joint):
    free = FREE[joint]
    rows = joint.rows if joint is jc.joint.Prismatic else joint.ideal_rows
    twist = np.array([0.3, -0.2, 0.4, 0.5, -0.3, 0.6])
    relative = jnp.asarray(matrix(Rotation.from_rotvec(twist[3:]).as_matrix(), twist[:3]))
    motion = nominal_motion(rows, relative)
    place, turn = motion[:3, 3], motion[:3, :3]
    np.testing.assert_allclose(
        place, [t if letter in free else 0 for t, letter in zip(twist, "xyz", strict=False)]
    )
    for row in rows:
        if len(row) > 1:
            assert abs(turn["xyz".index(row[0]), "xyz".index(row[2])]) < 1e-15
    # Kept as it is by a second pass, and no other rotation that keeps the rows is nearer.
    np.testing.assert_allclose(nominal_motion(rows, motion), motion, atol=1e-15)
    if free in ("t", "yz"):
        angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (200, 2))
        axes, angles = ("Z", angles[:, :1]) if free == "t" else ("XZ", angles)
        others = Rotation.from_euler(axes, angles)
        apart = (Rotation.from_rotvec(twist[3:]) * others.inv()).magnitude()
        distance = Rotation.from_matrix(relative[:3, :3] @ turn.T).magnitude()
        assert distance <= apart.min() and apart.min() < 1.2 * distance


@pytest.mark.slow
def test_nominal_motion_of_an_axis_that_stands_across_is_finite_with_its_derivative():
    """The child's z axis along the parent's x, to rounding and beyond: the shortest turn is not one
    but many, and the given pose is kept."""
    across = jnp.asarray(matrix(ALONG_X, np.zeros(3)))
    for share in (1.0, 1 + 2.0**-50, 1 - 2.0**-50):
        given = across.at[:3, 2].set(jnp.array([share, 1e-30, 0.0]))
        turn, moved = jax.jvp(lambda pose: nominal_motion(("x.z",), pose), (given,), (given,))
        assert np.isfinite(turn).all() and np.isfinite(moved).all()
    leant = jnp.asarray(matrix(Rotation.from_euler("y", 1.0).as_matrix(), np.zeros(3)))
    np.testing.assert_allclose(nominal_motion(("x.z",), leant), np.eye(4), atol=1e-15)


@pytest.mark.slow
def test_error_over_a_run_recovers_deviations_and_adds_up(wobbling):
    run, _, deviations = wobbling
    error = jc.pointing_error(run, TIP)
    np.testing.assert_allclose(error.deviations["J1"], deviations[:, 0], atol=1e-14)
    np.testing.assert_allclose(error.deviations["J2"], deviations[:, 1], atol=1e-14)
    np.testing.assert_allclose(sum(error.contributions.values()), error.model, rtol=0, atol=1e-18)
    assert 0 < error.model_error < 1e-3
    table = error.budget()
    assert list(table.index) == ["J1", "J2", "model", "exact"]
    for what, unit in (("pointing", "rad"), ("position", "m")):
        shares = table.loc[["J1", "J2"], f"share of {what} [1]"]
        assert shares.sum() == pytest.approx(1.0, rel=1e-12)
        assert table.loc["model", f"rms {what} [{unit}]"] > 0
    said = str(error)
    assert said == error.sentence() and '"J1"' in said and "% of the mean square" in said
    plays = error.budget(by_play=True)
    assert list(plays.index[:3]) == ["J1 across", "J1 along", "J1 tilt"]
    for name, whole in error.contributions.items():
        parts = [twist for play, twist in error.plays.items() if play.startswith(f"{name} ")]
        assert len(parts) == 3
        np.testing.assert_allclose(sum(parts), whole, rtol=0, atol=1e-18)
    # Along the axis of J1, which is that of the ground: as far as the journal went.
    far = np.linalg.norm(error.plays["J1 along"], axis=1)
    np.testing.assert_allclose(far, np.abs(deviations[:, 0, 2]), atol=1e-16)
    single = jc.pointing_error(run, TIP, "arm")
    assert list(single.contributions) == ["J2"]
    np.testing.assert_allclose(single.model, error.contributions["J2"], atol=1e-16)
    assert len(plot.pointing_budget(error).axes) == 4


@pytest.mark.slow
def test_error_maps_and_differentiates_at_zero_deviation():
    links = chain(antenna(), "ground", TIP)

    def error(deviations):
        found = tip_error(links, setting(deviations))
        return found.exact, sum(found.deviations), found.pointing_angle, found.position_error

    exact, adjoint, *lengths = jax.jit(jax.jacfwd(error))(jnp.zeros((2, 6)))
    np.testing.assert_allclose(exact, adjoint, rtol=0, atol=1e-14)
    assert np.abs(adjoint).max() > 0.1
    assert all(np.all(np.isfinite(slope)) for slope in lengths)
    many = jax.vmap(lambda scale: forward_kinematics(links, setting(scale * DEVIATIONS)))(
        jnp.linspace(0.0, 1.0, 3)
    )
    np.testing.assert_allclose(many[2], oracle(Q, DEVIATIONS)[2], rtol=0, atol=1e-14)


@pytest.mark.slow
def test_response_differentiates_with_and_without_deviations(wobbling):
    run, q, deviations = wobbling
    angle = jc.response.PointingAngle(TIP, "arm")
    put = lambda run, states: eqx.tree_at(lambda r: r.states, run, states)
    slope = eqx.filter_jit(lambda run: jax.grad(lambda own: angle(put(run, own)))(run.states))
    assert np.all(np.isfinite(slope(posed(q, 0 * deviations))))
    found, step = float(slope(run)[3, 11]), 1e-6
    low, high = (float(angle(put(run, run.states.at[3, 11].add(h)))) for h in (-step, step))
    # A central difference of a number near 1e-4: rounding over the step.
    assert found == pytest.approx((high - low) / (2 * step), abs=1e-9, rel=1e-5)
    assert abs(found) > 1e-4


@pytest.mark.slow
def test_response_is_the_rms_or_the_peak(wobbling):
    run, kind = wobbling[0], jc.response.PointingAngle
    angle = jc.pointing_error(run, TIP, "arm").pointing_angle
    assert float(kind(TIP, "arm")(run)) == pytest.approx(np.sqrt(np.mean(angle**2)))
    assert float(kind(TIP, "arm", peak=True)(run)) == pytest.approx(angle.max())
    named = jc.pointing_error(run, "dish").pointing_angle
    assert float(kind("dish", peak=True)(run)) == pytest.approx(named.max())


@pytest.mark.slow
def test_simulated_journal_moves_the_tip_by_its_offset():
    run = jc.simulate(touching_journal(), 0.05, save=11, state=jc.State(concentric=False))
    error = jc.pointing_error(run, jc.Marker("journal", at=(0.3, 0.0), axis="x"))
    offset = np.linalg.norm(run.contact("B").offset, axis=1)
    np.testing.assert_allclose(error.position_error, offset, rtol=0, atol=1e-15)
    np.testing.assert_allclose(error.model, error.exact, rtol=0, atol=1e-15)
    assert offset.max() > 0.99e-3 and error.pointing_angle.max() < 1e-12


def closed_loop():
    return jc.Mechanism(
        {"arm": BODY, "dish": BODY},
        {
            "J1": jc.Connection(jc.joint.Revolute(), "ground", "arm"),
            "J2": jc.Connection(jc.joint.Revolute(), "arm", "dish", at=(0.5, 0.0)),
            "J3": jc.Connection(bearing(), "ground", jc.Marker("dish", at=(0.0, 0.5))),
        },
    )


def test_way_through_a_loop_is_the_one_named():
    rig = closed_loop()
    assert chain(rig, "ground", TIP, ("J1",)).names == ("J1", "J2")
    assert chain(rig, "ground", TIP, ("J3",)).names == ("J3",)
    assert [joint.forward for joint in chain(rig, "arm", TIP, ("J3",)).joints] == [False, True]


FROM_GROUND = lambda *way: chain(closed_loop(), "ground", TIP, *way)
test_chain_that_is_not_there_says_so = refusals(
    {
        'no body "nothing" for the tip; there are "ground", "arm", "dish"': lambda: chain(
            closed_loop(), "ground", jc.Marker("nothing")
        ),
        'no body "nothing" for the base': lambda: chain(closed_loop(), "nothing", TIP),
        'the tip is on the base "dish" itself': lambda: chain(closed_loop(), "dish", TIP),
        'from "ground" to "dish" must be serial, but it runs by J1 - J2 or by J3; name '
        "connections in `through`": FROM_GROUND,
        'no joint to go through "J9"; there are "J1", "J2", "J3"': lambda: FROM_GROUND(("J9",)),
        'no chain of joints leads from "ground" to "dish" through .J1., .J3.': lambda: FROM_GROUND(
            ("J1", "J3")
        ),
    }
)


def test_error_that_cannot_be_says_so(wobbling, monkeypatch):
    run = wobbling[0]
    with pytest.raises(
        ValueError, match=r"the tip is \(0, 0\); it must be a jaxclear.Marker or the"
    ):
        jc.pointing_error(run, (0, 0))
    monkeypatch.setattr(jc.clearance.JournalBearing, "ideal_rows", ("x", "x.y"))
    with pytest.raises(ValueError, match='joint "J1" becomes an ideal joint with the rows x, x.y'):
        jc.pointing_error(run, TIP)


def test_an_angle_that_no_clearance_can_turn_is_refused():
    """In the plane journals move a tip and do not turn it: the angle is 0 of any clearance."""
    planar = jc.clearance.PlanarJournalBearing(jc.contact.Rigid(), clearance=1e-3)
    rod = jc.Mechanism(
        {"rod": jc.Body(1.0, 1e-2, com=(0.1, 0.0))},
        {"pin": jc.Connection(planar, "ground", "rod")},
        {"gravity": jc.load.Gravity((0.0, -9.81))},
    )
    steps = jc.integrator.NonColliding(1e-3)
    run = jc.simulate(rod, 2e-3, save=2, integrator=steps, verify=False)
    for tip in ("rod", jc.Marker("rod", (0.2, 0.0), axis="x")):
        with pytest.raises(ValueError, match='of "rod" is 0 whatever the clearances: .* planar'):
            jc.response.PointingAngle(tip)(run)
    ideal = rod.with_joint("pin", jc.joint.Revolute())
    assert jc.response.PointingAngle("rod")(jc.simulate(ideal, 2e-3, save=2, verify=False)) == 0
