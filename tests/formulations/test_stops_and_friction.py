"""Stops and dry friction on coordinates, and play with rigid flanks: closed forms, in every kind of
step."""

import json
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.laws.rebound import damping_ratio_of, restitution_of
from tests.rigs.cells import slow
from tests.rigs.slider_cranks import slider_crank

MASS, SPEED, GRAVITY = 2.0, 1.5, 10.0
RIGID = jc.integrator.MoreauJean(1e-4)
SLOW = pytest.mark.slow
PERMANENT = jc.integrator.NonColliding(1e-3)


def slide(*loads, speed=SPEED, start=-0.1, pull=0.0):
    """A mass on a slide, 0.1 m before 0."""
    return jc.Mechanism(
        {"mass": jc.Body(MASS, 1e-3)},
        {"slide": jc.Connection(jc.joint.Prismatic(), "ground", "mass", axis="x")},
        {type(load).__name__: load for load in loads} | {"pull": jc.load.Gravity((pull, 0.0))},
        start={"slide": start},
        speeds={"slide": speed},
    )


def ran(rig, duration, integrator=RIGID, save=101):
    return jc.simulate(rig, duration, save=save, integrator=integrator, balance=True, verify=False)


@pytest.mark.parametrize(
    "integrator", [RIGID, jc.integrator.NonColliding(1e-4)], ids=["rigid", "permanent"]
)
def test_bounces_on_a_rigid_stop_end_with_the_geometric_series_of_their_times(integrator):
    """t = t_1 + 2 e v / (g (1 - e)); the stop then carries the weight."""
    share = 0.5
    stop = jc.load.JointStop("slide", upper=0.0, restitution=share)
    first = np.sqrt(2 * 0.1 / GRAVITY)
    end = first + 2 * share * GRAVITY * first / (GRAVITY * (1 - share))
    run = ran(slide(stop, speed=0.0, pull=GRAVITY), 0.6, integrator, save=601)
    place, time = np.asarray(run.coordinate("slide")), np.asarray(run.time)
    # An instant is off by a step of each bounce, their speeds by as much.
    highest = [place[(time > a) & (time < b)].min() for a, b in ((0.15, 0.27), (0.28, 0.34))]
    np.testing.assert_allclose(highest, [-0.1 * share**2, -0.1 * share**4], rtol=0.01)
    assert np.abs(place[time > end + 0.005]).max() < 1e-6
    assert place[time < end - 0.03][-1] < -1e-4
    np.testing.assert_allclose(np.asarray(run.transmitted("JointStop"))[-1], -MASS * GRAVITY)
    balance = run.energy_balance()
    np.testing.assert_allclose(balance.damping_loss[-1], MASS * GRAVITY * 0.1, rtol=1e-4)
    assert np.abs(balance.error).max() < 1e-10


def test_what_runs_into_a_stop_without_restitution_in_permanent_contact_stays_there():
    stop = jc.load.JointStop("slide", upper=0.0, restitution=0.0)
    run = ran(slide(stop, speed=0.0, pull=GRAVITY), 0.6, PERMANENT, save=601)
    place, time = np.asarray(run.coordinate("slide")), np.asarray(run.time)
    landed = time > np.sqrt(2 * 0.1 / GRAVITY) + 1e-3
    np.testing.assert_allclose(place[landed], 0.0, atol=1e-15)
    np.testing.assert_allclose(place[~landed][:-2], -0.1 + 5 * time[~landed][:-2] ** 2, atol=1e-9)
    np.testing.assert_allclose(np.asarray(run.transmitted("JointStop"))[-1], -MASS * GRAVITY)
    assert np.abs(run.energy_balance().error).max() < 1e-12


@pytest.mark.parametrize(
    ("integrator", "stiffness"),
    [
        (RIGID, 1e12),
        (PERMANENT, 1e5),
        *slow((RIGID, 1e5), (PERMANENT, 1e12)),
    ],
)
def test_a_stiff_stop_is_rigid_where_steps_do_not_follow_its_spring(integrator, stiffness):
    """It gives way by its load over its stiffness at rest, or by less than a step's fall."""
    damping = 2 * np.sqrt(stiffness * MASS)
    stop = jc.load.JointStop("slide", upper=0.0, stiffness=stiffness, damping=damping)
    run = ran(slide(stop, speed=0.5, pull=GRAVITY), 1.0, integrator)
    assert run.succeeded
    way = MASS * GRAVITY / stiffness
    h = float(integrator.step)
    np.testing.assert_allclose(
        np.asarray(run.coordinate("slide"))[-1], way, atol=max(GRAVITY * h * h, 1e-3 * way)
    )


@pytest.mark.parametrize("share", [0.05, 0.3, 0.9])
@pytest.mark.parametrize("stiffness", [1e5, 1e7])
def test_a_springy_stop_gives_back_the_share_it_is_asked_for(share, stiffness):
    """Whatever its stiffness, and whatever turns with the coordinate."""
    stop = jc.load.JointStop("slide", upper=0.0, restitution=share, stiffness=stiffness)
    rig = slide(stop, jc.load.RotorInertia("slide", 3.0))
    run = ran(rig, 0.2, jc.integrator.Adaptive(), save=3)
    np.testing.assert_allclose(np.asarray(run.speed("slide"))[-1], -share * SPEED, rtol=1e-4)


def unfolding_arm(share):
    """An arm whose elbow a drive stretches within 0.2 s: about the shoulder, whose stop is met
    later, its inertia goes from 0.10 to 0.42 kg m^2."""

    def stretch(time):
        part = jnp.clip(time / 0.2, 0.0, 1.0)
        return np.pi * (1 - part * part * (3 - 2 * part))

    half = jc.Body(1.0, 0.01, com=(0.2, 0.0))
    elbow = jc.joint.Revolute(drive=jc.drive.Position(stretch))
    joints = {
        "shoulder": jc.Connection(jc.joint.Revolute(), "ground", "upper"),
        "elbow": jc.Connection(elbow, jc.Marker("upper", (0.4, 0.0)), "lower"),
    }
    stop = jc.load.JointStop("shoulder", upper=1.5, stiffness=1e5, restitution=share)
    return jc.Mechanism(
        {"upper": half, "lower": half}, joints, {"stop": stop}, speeds={"shoulder": 5.0}
    )


@pytest.mark.parametrize(
    "integrator",
    [
        jc.integrator.ImplicitStep(1e-4),
        *slow(jc.integrator.Adaptive(), jc.integrator.FixedStep(1e-4)),
    ],
    ids=["implicit", "adaptive", "fixed"],
)
def test_a_stop_gives_back_its_share_whatever_the_inertia_was_at_the_start(integrator):
    """Newton's rule of impact. The steps of fixed length meet the stop within a hundredth of its
    contact."""
    share = 0.4
    run = ran(unfolding_arm(share), 1.2, integrator, save=25)
    speed, time = np.asarray(run.speed("shoulder")), np.asarray(run.time)
    before, after = speed[np.searchsorted(time, 0.2)], speed[-1]
    assert before > 0 > after
    np.testing.assert_allclose(after, -share * before, rtol=5e-3)
    assert np.abs(run.energy_balance().error).max() < 1e-2 * run.energy_balance().kinetic[0]


def test_the_speed_that_a_stop_gives_back_has_the_slope_of_its_share():
    """Of -e v by e, also where the inertia changes before the stop is met; slopes by a hundredth,
    the most by which steps may leave them off."""
    rig = unfolding_arm(0.4)

    def after(share):
        run = jc.simulate(unfolding_arm(share), 1.2, save=25, verify=False, throw=False)
        return run.speed("shoulder")[-1]

    before = ran(rig, 1.2, jc.integrator.Adaptive(), save=25).speed("shoulder")[5]
    slope = jax.jvp(after, (0.4,), (1.0,))[1]
    np.testing.assert_allclose(slope, -before, rtol=1e-2)


@pytest.mark.parametrize("ratio", [0.01, 0.3, 1.0, 4.0])
def test_restitution_of_a_bounded_damper_is_that_of_its_equation(ratio):
    """x'' = -clip(x + 2 zeta x', 0, 2 x) from x = 0, x' = 1, in short steps."""
    found = ran(
        slide(
            jc.load.JointStop(
                "slide", upper=0.0, stiffness=MASS * 1e4, damping=2 * ratio * MASS * 100.0
            )
        ),
        0.25,
        jc.integrator.FixedStep(1e-5),
        save=3,
    )
    share = -np.asarray(found.speed("slide"))[-1] / SPEED
    np.testing.assert_allclose(float(restitution_of(ratio)), share, rtol=1e-3)
    np.testing.assert_allclose(float(damping_ratio_of(restitution_of(ratio))), ratio, rtol=2e-6)


def test_derivatives_pass_through_the_bounces_of_a_rigid_stop():
    """Behind the first bounce q = -e (v t - a), a the way to the stop."""
    stop = jc.load.JointStop("slide", upper=0.0, restitution=0.5)

    def end(speed):
        run = jc.simulate(
            slide(stop, speed=speed),
            0.12,
            save=3,
            integrator=jc.integrator.MoreauJean(1e-5),
            throw=False,
            verify=False,
        )
        return run.coordinate("slide")[-1]

    place, slope = jax.jvp(end, (jnp.asarray(SPEED),), (jnp.ones(()),))
    np.testing.assert_allclose(place, -0.5 * (SPEED * 0.12 - 0.1), rtol=1e-3)
    np.testing.assert_allclose(slope, -0.5 * 0.12, rtol=1e-3)


HOLDING = {
    # Accuracy of the place beside what rigid friction gives, from where friction holds or slides.
    "rigid": (jc.integrator.MoreauJean(1e-3), 1e-12),
    "permanent": (PERMANENT, 1e-7),
    "compliant": (jc.integrator.Adaptive(), 2e-4),
}


@pytest.mark.parametrize("kind", ["compliant", "rigid", *slow("permanent")])
def test_friction_holds_under_a_ramp_and_breaks_away_at_its_torque(kind):
    """5 N of friction under 2 t N: at rest up to 2.5 s, then m q'' = 2 t - 5."""
    integrator, accuracy = HOLDING[kind]
    ramp = jc.load.JointTorque("slide", lambda t: 2.0 * t)
    rig = slide(jc.load.JointFriction("slide", 5.0), ramp, speed=0.0)
    run = ran(rig, 3.5, integrator, save=36)
    time = np.asarray(run.time)
    way = np.asarray(run.coordinate("slide")) + 0.1
    slid = np.maximum(time - 2.5, 0.0)
    np.testing.assert_allclose(way, slid**3 / (3 * MASS), atol=max(accuracy, 5e-4))
    np.testing.assert_allclose(way[time < 2.4], 0.0, atol=accuracy)
    held = -np.asarray(run.transmitted("JointFriction"))
    at = time - 0.05 if kind != "compliant" else time
    np.testing.assert_allclose(held[1:24], 2.0 * at[1:24], atol=0.01)
    np.testing.assert_allclose(held[-1], 5.0, rtol=1e-9)
    assert np.abs(run.energy_balance().error).max() < 1e-5


FROM_REST = {
    "compliant": (jc.integrator.Adaptive(), 2e-3),
    "implicit": (jc.integrator.ImplicitStep(1e-4), 5e-3),
    "fixed": (jc.integrator.FixedStep(1e-4), 5e-3),
    "permanent": (PERMANENT, 1e-9),
}


@pytest.mark.parametrize(
    ("kind", "turns"),
    [
        ("implicit", False),
        ("permanent", True),
        *(pytest.param(kind, False, marks=SLOW) for kind in ("compliant", "fixed", "permanent")),
        pytest.param("compliant", True, marks=SLOW),
    ],
)
def test_what_little_more_than_its_friction_pushes_from_rest_goes_by_the_rest(kind, turns):
    """0.5 kg (kg m^2) under 1.0 N (N m) and 0.8 of friction: 0.4 t^2 / 2, whatever the joint."""
    integrator, accuracy = FROM_REST[kind]
    joint = jc.joint.Revolute() if turns else jc.joint.Prismatic()
    rig = jc.Mechanism(
        {"part": jc.Body(0.5, 0.5)},
        {"J": jc.Connection(joint, "ground", "part")},
        {"push": jc.load.JointTorque("J", 1.0), "friction": jc.load.JointFriction("J", 0.8)},
    )
    way = float(np.ravel(ran(rig, 0.2, integrator, save=3).coordinate("J"))[-1])
    np.testing.assert_allclose(way, 0.5 * 0.4 * 0.2**2, rtol=accuracy)


@pytest.mark.parametrize("lightness", [1e-3, 1.0, 1e3])
def test_friction_that_holds_takes_steps_of_one_length_whatever_it_holds(lightness):
    """A part at rest under half of its friction stays where it is."""
    rig = jc.Mechanism(
        {"part": jc.Body(0.5 / lightness, 1e-3)},
        {"J": jc.Connection(jc.joint.Prismatic(), "ground", "part", axis="x")},
        {"pull": jc.load.JointTorque("J", 0.5), "friction": jc.load.JointFriction("J", 1.0)},
    )
    run = ran(rig, 0.5, jc.integrator.Adaptive(), save=3)
    # Half of the deflection 4 a t^2 at most, of a the deceleration by friction, t = 50 us.
    assert abs(np.asarray(run.coordinate("J"))).max() < 1.1e-5
    assert int(run.accepted_steps) < 1e4


SINE = lambda t: jnp.sin(20.0 * t)


@pytest.mark.parametrize(
    ("integrator", "presliding", "wanted", "within"),
    [
        (jc.integrator.Adaptive(rtol=1e-8, atol=1e-11), {}, -0.13574, 5e-3),
        *slow(
            (
                jc.integrator.Adaptive(jc.integrator.MuntheKaas(4)),
                {"presliding": 1e-4},
                -0.13643,
                1e-2,
            ),
            (jc.integrator.Adaptive(diffrax.Kvaerno5()), {"presliding": 1e-4}, -0.13643, 1e-2),
        ),
    ],
    ids=["usual", "on groups", "implicit"],
)
def test_slopes_by_the_friction_are_those_of_set_valued_friction(
    integrator, presliding, wanted, within
):
    """Of where a body that a sine pulls is after half a second: beside differences of set-valued
    steps of 10 us, by 2 % of the torque; of bristles that yield late, of steps with the bristle
    held at its bound. Without the bound loops of diffrax had -0.089; steps end beside the instants
    at which bristles yield."""

    def end(torque):
        rig = jc.Mechanism(
            {"part": jc.Body(1.0, 0.1)},
            {"J": jc.Connection(jc.joint.Revolute(), "ground", "part")},
            {
                "pull": jc.load.JointTorque("J", SINE),
                "friction": jc.load.JointFriction("J", torque, **presliding),
            },
        )
        run = jc.simulate(rig, 0.5, save=6, integrator=integrator, throw=False, verify=False)
        return run.coordinate("J")[-1]

    assert float(jax.jacfwd(end)(0.5)) == pytest.approx(wanted, rel=within)


def test_friction_with_a_transition_speed_creeps_in_every_step():
    friction = jc.load.JointFriction("slide", 5.0, 1e-2)
    rig = slide(friction, jc.load.JointTorque("slide", 2.5), speed=0.0)
    for integrator in (RIGID, PERMANENT, jc.integrator.Adaptive()):
        speed = np.asarray(ran(rig, 1.0, integrator, save=3).speed("slide"))[-1]
        np.testing.assert_allclose(speed, 1e-2 * np.arctanh(0.5), rtol=1e-4)


TWO = {"inertias": (0.02, 0.05), "half": 2e-3, "damping": 0.3, "torque": (2.0, 30.0)}
SHAKEN = (
    jc.load.JointTorque("motor", lambda t: TWO["torque"][0] * jnp.sin(TWO["torque"][1] * t)),
    jc.load.JointSpring("motor", damping=TWO["damping"]),
)


def two_masses(play, *loads, stiffness=None, damping=None, speed=0.0):
    """A motor and its load, with play between them; the motor is shaken, or as the loads say."""
    motor, load = TWO["inertias"]
    turning = jc.joint.Revolute()
    return jc.Mechanism(
        {"rotor": jc.Body(1.0, motor), "wheel": jc.Body(1.0, load)},
        {
            "motor": jc.Connection(turning, "ground", "rotor"),
            "load": jc.Connection(turning, "ground", "wheel"),
        },
        {f"load {i}": own for i, own in enumerate(loads or SHAKEN)},
        couplings={
            "gear": jc.coupling.Ratio(
                "load", "motor", 1.0, play=play, stiffness=stiffness, damping=damping
            )
        },
        speeds={"motor": speed},
    )


PATH = Path(__file__).parents[1] / "refdata" / "rigid_flanks.json"
FLANKS = {case["restitution"]: case for case in json.loads(PATH.read_text())["cases"]}


@pytest.mark.parametrize("share", FLANKS)
def test_rigid_flanks_meet_as_exact_ones(share):
    """To the first order of the steps: impacts are taken up to a step late."""
    motor, load = FLANKS[share]["motor"], FLANKS[share]["load"]
    play = jc.clearance.Backlash(2 * TWO["half"], restitution=share)
    rig = two_masses(play, stiffness=1e5, damping=10.0, speed=0.2)
    run = ran(rig, FLANKS[share]["duration"], jc.integrator.MoreauJean(1e-5), save=len(motor))
    np.testing.assert_allclose(run.coordinate("motor"), motor, atol=1e-5)
    np.testing.assert_allclose(run.coordinate("load"), load, atol=1e-5)
    gear = run.coupling("gear")
    assert np.abs(gear.twist).max() < TWO["half"] + 1e-6
    assert set(np.asarray(gear.flank)[1:]) <= {-1, 0, 1}
    assert np.abs(run.energy_balance().error).max() < 1e-5


REVERSING = {
    "compliant": (jc.integrator.Adaptive(rtol=1e-7, atol=1e-10), 2e-5),
    "rigid": (jc.integrator.MoreauJean(2e-4), 1e-3),
    "permanent": (PERMANENT, 2e-6),
}


@pytest.mark.parametrize("kind", ["permanent", *slow("compliant", "rigid")])
def test_reversal_value_of_a_load_held_by_friction_is_play_and_wind_up(kind):
    """2 b + 2 t / k, with a servo that sees the motor."""
    integrator, accuracy = REVERSING[kind]
    stiffness, torque = 500.0, 0.4
    play = jc.clearance.Backlash(2 * TWO["half"])
    to_and_fro = jc.load.Servo(
        "motor", lambda t: 0.05 * jnp.sin(0.5 * jnp.pi * t), kp=2000.0, kd=20.0
    )
    friction = jc.load.JointFriction("load", torque)
    rig = two_masses(play, to_and_fro, friction, stiffness=stiffness, damping=1.0)
    run = ran(rig, 8.0, integrator, save=801)
    if kind == "permanent":
        twist = np.asarray(run.coupling("gear").twist)
    else:
        twist = np.asarray(run.coordinate("load") - run.coordinate("motor"))
    lost = twist[600] - twist[400]
    np.testing.assert_allclose(lost, 2 * TWO["half"] + 2 * torque / stiffness, rtol=accuracy)
    np.testing.assert_allclose(np.abs(run.transmitted("load 1")).max(), torque, rtol=1e-6)


def lever_on_a_gear(play, servo=None, **gear):
    """A lever of 0.1 m on a motor's gear of 100:1."""
    weight = {"gravity": jc.load.Gravity((0.0, -GRAVITY)), "servo": servo}
    reducer = jc.coupling.Gear(jc.coupling.Motor(2e-5), "hinge", 100.0, play=play, **gear)
    return jc.Mechanism(
        {"lever": jc.Body(1.0, 0.05, (0.1, 0.0))},
        {"hinge": jc.Connection(jc.joint.Revolute(), "ground", "lever")},
        {} if servo is None else weight,
        couplings={"gear": reducer},
    )


def test_seated_play_is_the_ideal_motion_and_the_lost_one():
    """A lever that a servo on its motor swings: where it stands in compliant steps is where it
    stands without play and what is lost."""
    servo = jc.load.Servo("hinge", lambda t: 0.3 * jnp.sin(3 * t), kp=900.0, kd=60.0)
    rig = lever_on_a_gear(jc.clearance.Backlash(4e-3), servo, stiffness=500.0, damping=5.0)
    compliant, seated = (
        ran(rig, 1.0, own, save=11) for own in (jc.integrator.Adaptive(), PERMANENT)
    )
    told, known = seated.coupling("gear"), compliant.coupling("gear")
    place = np.asarray(seated.coordinate("hinge")) + np.asarray(told.twist)
    np.testing.assert_allclose(place[4:], compliant.coordinate("hinge")[4:], atol=2e-5)
    np.testing.assert_allclose(told.torque[4:], known.torque[4:], rtol=5e-3)
    np.testing.assert_array_equal(told.flank[4:], known.flank[4:])


def test_another_flank_presses_where_what_is_transmitted_turns_round():
    play = jc.clearance.Backlash(2 * TWO["half"])
    run = ran(two_masses(play, stiffness=1e5, damping=10.0), 1.0, PERMANENT, save=1001)
    gear, table = run.coupling("gear"), run.switchings("gear")
    np.testing.assert_allclose(np.asarray(run.coordinate("load") - run.coordinate("motor")), 0.0)
    sides = np.asarray(gear.twist)[1:] - np.asarray(gear.torque)[1:] / 1e5
    np.testing.assert_allclose(np.abs(sides), TWO["half"])
    turned = np.flatnonzero(np.diff(np.sign(np.asarray(gear.torque)[1:])))
    assert len(table) == len(turned) > 5


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: jc.load.JointStop("slide", upper=0.0), "needs restitution"),
        (
            lambda: ran(
                slide(jc.load.JointStop("slide", upper=0.0, restitution=0.5)),
                0.1,
                jc.integrator.Adaptive(),
            ),
            'load "JointStop" is a JointStop without stiffness, which is rigid',
        ),
    ],
)
def test_what_is_missing_is_said(make, sentence):
    with pytest.raises(ValueError, match=sentence):
        make()


def test_lost_motion_of_play_is_that_of_both_flanks():
    """A lever on a motor's gear: on the flank on which its weight presses it, wound up by it; under
    the reversed weight on the other."""
    half, stiffness, lever = 2e-3, 500.0, 0.1
    servo = jc.load.Servo("hinge", 0.5, kp=10.0)
    rig = lever_on_a_gear(jc.clearance.Backlash(2 * half), servo, stiffness=stiffness, damping=1.0)
    held = np.array([0.0, 30.0])
    found = jc.positions(rig, {"gear.motor": held}, reverse_loads=True)
    # The servo acts on the motor, which is held. On gears the joint turns the other way.
    for side, own in ((-1, found), (1, found.reversed)):
        angle = np.asarray(own.coordinate("hinge"))
        wound = GRAVITY * lever * np.cos(angle) / stiffness
        np.testing.assert_allclose(angle, held / 100 + side * (half + wound), atol=1e-9)
    with pytest.raises(ValueError, match='coupling "gear" has play and no stiffness'):
        jc.positions(lever_on_a_gear(LOOSE, servo), {"hinge": [0.0]})


LOOSE = jc.clearance.Backlash(1e-3, restitution=0.0)


@pytest.mark.parametrize("integrator", [RIGID, PERMANENT], ids=["rigid", "permanent"])
def test_losses_beside_rigid_flanks_are_refused(integrator):
    rig = lever_on_a_gear(LOOSE, stiffness=500.0, damping=1.0, efficiency=0.9)
    with pytest.raises(ValueError, match="has play and loses power to friction"):
        jc.simulate(rig, 0.1, integrator=integrator)


SPRINGY = jc.load.JointStop("G", lower=0.55, stiffness=1e5, restitution=0.4)
DRY = jc.load.JointFriction("G", 30.0)


@pytest.mark.parametrize(
    ("load", "integrator"),
    [
        (SPRINGY, jc.integrator.ImplicitStep(1e-3)),
        (DRY, jc.integrator.MoreauJean(1e-3)),
        (DRY, jc.integrator.NonColliding(1e-3)),
        *slow((SPRINGY, jc.integrator.Adaptive()), (DRY, jc.integrator.Adaptive())),
    ],
)
def test_a_run_may_begin_in_a_dead_centre_where_nothing_moves_along_the_coordinate(
    load, integrator
):
    """Crank and rod in line, and but for a small angle; the crank is pushed."""
    loads = {"load": load, "push": jc.load.JointTorque("O", 20.0)}
    runs = [ran(slider_crank(loads, angle), 0.15, integrator) for angle in (0.0, 1e-6)]
    exact, near = (np.asarray(run.coordinate("G")) for run in runs)
    assert np.abs(near - 0.7).max() > 0.1
    np.testing.assert_allclose(exact, near, rtol=0, atol=1e-5)
