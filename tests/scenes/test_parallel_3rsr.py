"""The 3RSR parallel mechanism: closed forms of the ideal one, and the claims of its paper."""

import numpy as np
import pytest

import jaxclear as jc
from jaxclear import plot
from jaxclear.scenes.parallel_3rsr import (
    CIRCLE,
    GRAVITY,
    HIGHEST,
    LOWEST,
    PLATFORM_MASS,
    QUIET,
    RATTLING,
    ROD,
    ROD_MASS,
    ROD_RADIUS,
    SOCKET_RADIUS,
    parallel_3rsr,
)
from tests.rigs.refusals import refusals

LEGS = np.arange(3)
TURNS = 2 * np.pi * LEGS / 3
OUTWARDS = np.stack([np.cos(TURNS), np.sin(TURNS), 0 * TURNS], axis=1)
UP = np.array([0.0, 0.0, 1.0])
SAVES = 401


def unlike_drives():
    """Three that differ in place, amplitude, frequency and phase."""
    return [
        jc.drive.Harmonic(0.2, 1.0, -1.5, 1.0),
        jc.drive.Harmonic(0.15, 2.0, 0.3, 1.1),
        jc.drive.Harmonic(0.1, 0.5, 1.0, 0.9),
    ]


def angles(drives, time):
    return np.stack([[float(drive.motion(t)[0]) for drive in drives] for t in time])


@pytest.fixture(scope="module")
def unlike():
    return jc.simulate(parallel_3rsr("ideal", drives=unlike_drives()), QUIET, save=SAVES)


@pytest.fixture(scope="module")
def ideal():
    return jc.simulate(parallel_3rsr("ideal", period=QUIET), QUIET, save=SAVES)


def slack(clearance=0.5e-3, period=QUIET, cycles=2, saves=2000, **scene):
    rig = parallel_3rsr("one", clearance, period=period, **scene)
    return jc.simulate(rig, cycles * period, save=cycles * saves + 1)


def platform_of(run):
    """Its place and axes over time."""
    body = run.body("platform")
    return np.asarray(body.origin), np.asarray(body.rotation)


def test_the_platform_is_the_mirror_image_of_the_ground(unlike):
    """Legs of two rods alike bend at the mirror: forwards from the drives to the platform."""
    feet, (place, axes) = CIRCLE * OUTWARDS, platform_of(unlike)
    for i in range(0, SAVES, 20):
        angle = angles(unlike_drives(), [unlike.time[i]])[0][:, None]
        balls = feet + ROD * (np.cos(angle) * OUTWARDS + np.sin(angle) * UP)
        normal = np.cross(balls[1] - balls[0], balls[2] - balls[0])
        normal /= np.linalg.norm(normal)
        mirrored = feet - 2 * np.outer((feet - balls[0]) @ normal, normal)
        np.testing.assert_allclose(place[i] + feet @ axes[i].T, mirrored, atol=1e-8)


def test_inverse_kinematics_give_the_drive_angles_back(unlike):
    """Backwards: a ball lies in the mirror between both feet of its leg, in the leg's own plane, a
    rod's length away."""
    feet, (place, axes) = CIRCLE * OUTWARDS, platform_of(unlike)
    for i in range(0, SAVES, 20):
        away = place[i] + feet @ axes[i].T - feet
        # away . (ball - foot) = |away|^2 / 2, with ball - foot = L (cos(a) outwards + sin(a) up).
        outwards, up = (away * OUTWARDS).sum(axis=1), away[:, 2]
        size, towards = np.hypot(outwards, up), np.arctan2(up, outwards)
        found = towards - np.arccos((away**2).sum(axis=1) / (2 * ROD * size))
        wanted = angles(unlike_drives(), [unlike.time[i]])[0]
        np.testing.assert_allclose(found, wanted, atol=1e-7)


def force_of_level_motion(time, period):
    """Force on a transmission rod at its ball, outwards and upwards, where all drives are alike:
    the platform only rises and falls, and each leg carries a third."""
    middle, half, pace = (HIGHEST + LOWEST) / 2, (HIGHEST - LOWEST) / 2, 2 * np.pi / period
    angle = middle - half * np.cos(pace * time)
    speed, acceleration = half * pace * np.sin(pace * time), half * pace**2 * np.cos(pace * time)
    outwards = -np.sin(angle) * acceleration - np.cos(angle) * speed**2
    upwards = np.cos(angle) * acceleration - np.sin(angle) * speed**2
    # The rod's centre of mass: half-way between ball (L cos, L sin) and platform (0, 2 L sin).
    out, up = ROD / 2 * outwards, 3 * ROD / 2 * upwards
    at_platform = PLATFORM_MASS * (GRAVITY + 2 * ROD * upwards) / 3
    vertical = at_platform + ROD_MASS * (up + GRAVITY)
    # Moments about the rod's centre of mass, at its ends the ball's force and the platform's.
    inertia = ROD_MASS * (ROD**2 / 12 + ROD_RADIUS**2 / 4)
    lever_out, lever_up = ROD / 2 * np.cos(angle), ROD / 2 * np.sin(angle)
    both_outward = -(lever_out * (vertical + at_platform) + inertia * acceleration) / lever_up
    horizontal = (ROD_MASS * out + both_outward) / 2
    return np.stack([horizontal, vertical], axis=1)


@pytest.mark.slow
def test_the_multiplier_of_an_ideal_ball_is_the_force_of_the_closed_form(ideal):
    wanted, outwards = force_of_level_motion(np.asarray(ideal.time), QUIET), OUTWARDS[1]
    assert "S2" in ideal.mechanism.topology.loops
    force = np.asarray(ideal.reaction("S2").force)
    np.testing.assert_allclose(force @ outwards, wanted[:, 0], atol=1e-5)
    np.testing.assert_allclose(force[:, 2], wanted[:, 1], atol=1e-5)
    np.testing.assert_allclose(force @ np.cross(outwards, UP), 0.0, atol=1e-5)


test_bad_input_is_refused_by_name = refusals(
    {
        'no joint "S4" in kind of parallel_3rsr': lambda: parallel_3rsr(("S4",)),
        "period of parallel_3rsr": lambda: parallel_3rsr(period=0.0),
        "drives of parallel_3rsr are 2": lambda: parallel_3rsr(drives=unlike_drives()[:2]),
    }
)


@pytest.mark.slow(sample=False)
def test_reactions_do_not_depend_on_where_the_loops_are_closed(unlike):
    """The same mechanism with another ball in the tree and the other two closing loops."""
    rig = unlike.mechanism
    turned = jc.Mechanism(
        rig.bodies,
        dict(reversed(rig.connections.items())),
        rig.loads,
        guess={"S3": rig.guess["S1"]} | {f"B{leg + 1}": -LOWEST for leg in LEGS},
    )
    assert set(turned.topology.loops) == {"S1", "S2"} != set(rig.topology.loops)
    other = jc.simulate(turned, QUIET, save=SAVES)
    for name in ("A1", "S1", "S2", "S3", "B2"):
        one, two = unlike.reaction(name), other.reaction(name)
        np.testing.assert_allclose(one.force, two.force, atol=1e-4)
        np.testing.assert_allclose(one.torque, two.torque, atol=1e-5)


@pytest.mark.slow
def test_energy_balances():
    rig = parallel_3rsr("ideal", drives=unlike_drives())
    fine = jc.integrator.Adaptive(rtol=1e-10, atol=1e-12)
    found = jc.simulate(rig, QUIET, balance=True, save=SAVES, integrator=fine).energy_balance()
    assert np.ptp(found.potential) > 1.0
    assert np.abs(found.error).max() < 1e-9 * np.ptp(found.potential)


def beside_ideal(run, ideal, window=0.05):
    """Largest difference of the ball's mean force over `window` [s] from that of the ideal ball,
    over the last cycle, and rms of the difference that is not filtered."""
    force, saves = np.asarray(run.reaction("S1").force), len(ideal.time)
    off = force[-saves:] - np.asarray(ideal.reaction("S1").force)
    width = round(window / float(ideal.time[1]))
    filtered = [np.convolve(part, np.ones(width) / width, "valid") for part in off.T]
    return np.abs(filtered).max(), np.sqrt((off**2).sum(axis=1).mean())


@pytest.mark.slow
def test_the_filtered_force_tends_to_the_ideal_reaction_with_the_clearance():
    """Claim (a), without friction, which an ideal ball does not have; with it a share of the
    friction's own remains."""
    ideal = jc.simulate(parallel_3rsr("ideal", period=QUIET), QUIET, save=2001)
    scene = {"friction": False, "wear": False}
    off = [beside_ideal(slack(c, **scene), ideal)[0] for c in (5e-4, 5e-5, 5e-6)]
    order = np.log10(np.array(off[:-1]) / off[1:])
    # Positions change with the first power; the bounces that the fall leaves die away as well.
    assert (order > 1.0).all() and (order < 2.0).all() and off[-1] < 0.01
    rubbing = beside_ideal(slack(5e-6, wear=False), ideal)[0]
    assert 0.05 < rubbing < 0.3


@pytest.mark.slow
def test_the_force_oscillates_where_the_joint_rattles_and_not_where_it_is_quiet():
    """Claim (b): the period decides."""
    share, rough = {}, {}
    for period in (QUIET, RATTLING):
        ideal = jc.simulate(parallel_3rsr("ideal", period=period), period, save=2001)
        run = slack(period=period, cycles=4)
        depth = np.asarray(run.contact("S1").indentation)[-2000:]
        share[period], rough[period] = (depth <= 0).mean(), beside_ideal(run, ideal)[1]
    assert share[QUIET] == 0 and rough[QUIET] < 1.0
    assert share[RATTLING] > 0.3 and rough[RATTLING] > 50.0


@pytest.mark.slow
def test_worn_volume_over_the_drive_angle_is_alike_in_every_settled_cycle():
    """Claim (c). The first cycle, which falls through the play, is left out."""
    saves, cycles = 400, 6
    volume = np.asarray(slack(cycles=cycles, saves=saves).worn_volume("S1", "socket"))
    lost = np.diff(volume[::saves])
    assert lost[0] > 1.1 * lost[1]
    np.testing.assert_allclose(lost[1:], lost[1], rtol=1e-3)
    curves = np.stack([volume[k * saves : (k + 1) * saves] for k in range(1, cycles)])
    curves -= curves[:, :1]
    assert np.abs(curves - curves[0]).max() < 0.01 * lost[1]


@pytest.mark.slow
def test_wear_is_irregular_and_its_volume_is_that_of_the_map():
    """Claim (d): few cells carry most."""
    run = slack(saves=400)
    depth = np.asarray(run.worn_depth("S1", "socket"))
    wear_map = run.mechanism.connections["S1"].joint.maps()["socket"][0]
    volume = float(run.worn_volume("S1", "socket")[-1])
    assert (depth * np.asarray(wear_map.areas())).sum() == pytest.approx(volume, rel=1e-9)
    assert (depth > 0.01 * depth.max()).mean() < 0.25
    flat, space = (draw(run, "S1", "socket") for draw in (plot.wear_unrolled, plot.wear_surface))
    assert flat.axes[0].get_ylabel() == "elevation [deg]"
    assert max(map(abs, space.axes[0].get_zlim())) < 1.5e3 * SOCKET_RADIUS


@pytest.mark.slow
def test_balls_that_all_have_play_carry_alike():
    """A third of a turn apart; drives that are alike leave no leg before another."""
    rig = parallel_3rsr("all", period=QUIET, wear=False)
    run = jc.simulate(rig, QUIET, save=2001)
    mean = np.stack([np.asarray(run.reaction(f"S{k + 1}").force)[1000:].mean(axis=0) for k in LEGS])
    out, up = (mean * OUTWARDS).sum(axis=1), mean[:, 2]
    np.testing.assert_allclose(out, out.mean(), rtol=0.02)
    np.testing.assert_allclose(up, up.mean(), rtol=0.02)
