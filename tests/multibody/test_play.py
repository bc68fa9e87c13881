"""Play, stiffness and motors of couplings: against the exact motion of two masses, and laws."""

import functools
import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear import Scalar, quantity
from tests.rigs.cells import slow

REFERENCE = json.loads(
    (Path(__file__).parents[1] / "refdata/play_between_two_masses.json").read_text()
)
LAWS = {"stop": jc.flank.Stop(), "nordin": jc.flank.Nordin()}
TIGHT = jc.integrator.Adaptive(rtol=1e-12, atol=1e-13)
TURN = jc.joint.Revolute()
SLOW = pytest.mark.slow
MOTOR = jc.coupling.Motor


@functools.cache
def sine(amplitude, rate):
    """One function for the same numbers: mechanisms with it are one program."""
    return lambda t: amplitude * jnp.sin(rate * t)


def one_arm(loads=None, couplings=None, **more):
    bodies = {"load": jc.Body(1.0, more.pop("inertia", 0.05))}
    joints = {"L": jc.Connection(TURN, "ground", "load")}
    return jc.Mechanism(bodies, joints, loads or {}, couplings=couplings or {}, **more)


def two_masses(case, half=None, motor=True):
    """The reference's motor and load; the motor a body of its own where it is no `Motor`."""
    own = REFERENCE[case]["parameters"]
    half = own["b"] if half is None else half
    play = jc.clearance.Backlash(2 * half, law=LAWS[own["law"]])
    more = {"play": play, "stiffness": own["k"], "damping": own["d"]}
    name = "G.motor" if motor else "M"
    loads = {
        "motor": jc.load.JointTorque(name, sine(own["motor"][1], own["rate"])),
        "damper": jc.load.JointSpring(name, damping=own["kd"]),
    }
    start = {"speeds": {name: REFERENCE[case]["start"]["motor_speed"], "L": 0.0}}
    if motor:
        gear = jc.coupling.Gear(jc.coupling.Motor(own["Jm"]), "L", 1.0, **more)
        return one_arm(loads, {"G": gear}, inertia=own["Jl"], **start)
    bodies = {"load": jc.Body(1.0, own["Jl"]), "motor": jc.Body(1.0, own["Jm"])}
    joints = {n: jc.Connection(TURN, "ground", b) for n, b in (("L", "load"), ("M", "motor"))}
    couplings = {"G": jc.coupling.Ratio("L", "M", 1.0, **more)}
    return jc.Mechanism(bodies, joints, loads, couplings=couplings, **start)


def missed(run, case, motor="G.motor"):
    """By how much places and speeds are off, each beside nothing [rad, rad/s]."""
    known = REFERENCE[case]
    parts = ((run.coordinate, "motor", "load"), (run.speed, "motor_speed", "load_speed"))
    return [
        max(
            np.max(np.abs(np.asarray(read(name)) - known[key]))
            for name, key in ((motor, first), ("L", second))
        )
        for read, first, second in parts
    ]


@pytest.mark.parametrize("case", LAWS)
def test_two_masses_move_exactly(case):
    known = REFERENCE[case]
    times = np.array(known["time"])
    save = jc.Saving(times, events=20)
    run = jc.simulate(two_masses(case), times[-1], save=save, integrator=TIGHT)
    assert max(missed(run, case)) < 1e-9
    touches = run.events("G")
    touches = touches[touches["event"] == "touch"]["time [s]"].to_numpy()
    np.testing.assert_allclose(touches, known["touch_times"], rtol=0, atol=1e-9)
    # by usual steps, the motor a body on its axis
    usual = jc.simulate(two_masses(case, motor=False), times[-1], save=times)
    assert max(missed(usual, case, "M")) < 1e-6


def bounced(time, half, speed, stiffness, damping):
    """Place and speed of a unit inertia between two flanks that it leaves where their torque would
    pull: flights, and damped half waves, from the middle on."""
    decay = 0.5 * damping
    rate = np.sqrt(stiffness - decay * decay)
    contact = np.arctan2(2 * decay * rate, decay * decay - rate * rate) / rate
    depth = lambda t: speed * np.exp(-decay * t) * np.sin(rate * t) / rate
    moving = lambda t: (
        speed * np.exp(-decay * t) * (np.cos(rate * t) - decay / rate * np.sin(rate * t))
    )
    sign, place = 1.0, 0.0
    while True:
        flight = (half - place) / speed
        if time < flight:
            return sign * (place + speed * time), sign * speed
        time -= flight
        if time < contact:
            return sign * (half + depth(time)), sign * moving(time)
        time -= contact
        sign, place, speed = -sign, -half - depth(contact), -moving(contact)


@pytest.mark.parametrize(
    "duration, damping, rtols",
    [
        (10.0, 0.05, (1e-4, 1e-7, 1e-9, 1e-11, 1e-12)),
        (300.0, 0.0, (1e-9, 1e-10, 1e-11)),
    ],
)
@pytest.mark.parametrize("second, radian", [(1.0, 1.0), (1e-3, 1e3), (1e3, 1e-3), (1.0, 1e3)])
def test_flanks_are_met_in_time_at_every_tolerance_and_scale(
    duration, damping, rtols, second, radian
):
    """Global errors follow the tolerance: of a lossless bounce by the square of the contacts, 840
    in the longer run. Touches are placed within 1e-12 of the longest arm, here 1."""
    half, speed, stiffness = 0.2 * radian, 2.0 * radian / second, 400.0 / second**2
    play = jc.clearance.Backlash(2 * half, law=jc.flank.Stop())
    hold = jc.coupling.Latch("L", 0.0, play=play, stiffness=stiffness, damping=damping / second)
    rig = one_arm(couplings={"h": hold}, inertia=1.0, speeds={"L": speed})
    exact = bounced(duration * second, half, speed, stiffness, damping / second)
    for rtol in rtols:
        method = jc.integrator.Adaptive(rtol=rtol, atol=1e-2 * rtol * radian)
        run = jc.simulate(rig, duration * second, save=11, integrator=method, verify=False)
        off = (run.coordinate("L")[-1] - exact[0]) / half, (run.speed("L")[-1] - exact[1]) / speed
        counted = min(rtol, 3e-7)
        assert np.max(np.abs(off)) < (1e3 if damping else 1e6) * counted + 1e-11 / half


@pytest.mark.parametrize(
    ("case", "step"),
    [("nordin", jc.integrator.FixedStep(2e-5)), ("stop", jc.integrator.ImplicitStep(2e-5))],
)
def test_fixed_steps_meet_it(case, step):
    known = REFERENCE[case]
    run = jc.simulate(
        two_masses(case), known["time"][-1], save=np.array(known["time"]), integrator=step
    )
    # of order 1 in the steps in which a flank is met
    places, speeds = missed(run, case)
    assert places < 1e-6 and speeds < 2e-4


def test_slope_by_the_play_is_that_of_the_motion():
    known = REFERENCE["stop"]

    def end(half):
        run = jc.simulate(
            two_masses("stop", half), known["time"][-1], save=2, integrator=TIGHT, throw=False
        )
        return jnp.stack([run.coordinate("G.motor")[-1], run.coordinate("L")[-1]])

    found = jax.jacfwd(end)(known["parameters"]["b"])
    np.testing.assert_allclose(found, known["slope"], rtol=0, atol=known["slope_disagreement"])


class LoadServo(jc.load.AbstractStateLoad):
    """Torque on a motor by the place of the load and the motor's own speed."""

    kp: Scalar = quantity(unit="N m/rad", meaning="gain on the place")
    kd: Scalar = quantity(unit="N m s/rad", meaning="gain on the speed")

    def coordinates(self):
        return ("G.motor", "L")

    def states(self):
        return ()

    def effect(self, time, positions, speeds, states):
        torque = -self.kp * positions[1] - self.kd * speeds[0]
        return jc.load.CoordinateEffect((torque, 0.0), (), 0.0, 0.0, torque * speeds[0])


def test_a_servo_hunts_in_its_play_with_the_known_period():
    known = REFERENCE["hunting"]
    own, state = known["parameters"], known["state"]
    play = jc.clearance.Backlash(2 * own["b"], law=jc.flank.Stop())
    gear = jc.coupling.Gear(
        jc.coupling.Motor(own["Jm"]), "L", 1.0, play=play, stiffness=own["k"], damping=own["d"]
    )
    rig = one_arm(
        {"servo": LoadServo(own["kp"], own["kd"])},
        {"G": gear},
        inertia=own["Jl"],
        start={"G.motor": state["motor"], "L": state["motor"] + own["b"]},
        speeds={"G.motor": state["motor_speed"], "L": state["load_speed"]},
    )
    period = known["period"]
    run = jc.simulate(rig, 3 * period, save=jc.Saving(1501, events=10), integrator=TIGHT)
    found = run.events("G")
    upper = found[(found["event"] == "touch") & (found["contact"] == "upper")]["time [s]"]
    # it touches three times before it stays
    upper = upper.to_numpy()
    np.testing.assert_allclose(upper[3:] - upper[:-3], period, rtol=1e-6)
    for name, key in (("G.motor", "amplitude_motor"), ("L", "amplitude_load")):
        places = np.asarray(run.coordinate(name))[-501:]
        # between saving times a peak hides (pi / 500)^2 / 2 of itself at most
        assert 0.5 * np.ptp(places) == pytest.approx(known[key], rel=3e-5)


def driven_arm(coupling, load="G.motor"):
    return one_arm({"T": jc.load.JointTorque(load, sine(0.2, 9.0))}, coupling)


def test_a_rigid_motor_is_its_inertia_times_the_ratio_squared():
    ratio, inertia = 7.0, 3e-4
    gear = jc.coupling.Gear(jc.coupling.Motor(inertia), "L", ratio)
    rig = driven_arm({"L": gear}, "L.motor")
    assert rig.topology.coordinate_count == 1 and not rig.topology.loops
    told = one_arm(
        {
            "T": jc.load.JointTorque("L", sine(ratio * 0.2, 9.0)),
            "rotor": jc.load.RotorInertia("L", ratio**2 * inertia),
        }
    )
    step = jc.integrator.FixedStep(1e-3)
    one, other = (jc.simulate(m, 1.0, save=11, integrator=step, balance=True) for m in (rig, told))
    np.testing.assert_allclose(one.coordinate("L"), other.coordinate("L"), rtol=1e-12, atol=1e-15)
    turned = np.asarray(one.coordinate("L.motor"))
    np.testing.assert_allclose(turned, ratio * np.asarray(one.coordinate("L")), rtol=1e-14)
    kinetic = np.asarray(one.energy_balance().kinetic)
    np.testing.assert_allclose(kinetic, other.energy_balance().kinetic, rtol=1e-12, atol=1e-18)
    # what the gear gives moves the load alone
    given = np.asarray(one.transmitted("L"))
    share = 0.05 / (0.05 + ratio**2 * inertia)
    wanted = share * ratio * 0.2 * np.sin(9 * np.asarray(one.time))
    np.testing.assert_allclose(given, wanted, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    "coupling, ratio",
    [
        (lambda m, **k: jc.coupling.Belt(m, "L", 0.02, 0.1, crossed=True, **k), -5.0),
        (lambda m, **k: jc.coupling.Ratio("L", m, 0.2, **k), 5.0),
        pytest.param(lambda m, **k: jc.coupling.Ratio(m, "L", 5.0, **k), 5.0, marks=SLOW),
        pytest.param(lambda m, **k: jc.coupling.Gear(m, "L", 5.0, **k), 5.0, marks=SLOW),
    ],
)
def test_what_is_stiff_moves_as_what_is_rigid(coupling, ratio):
    motor = jc.coupling.Motor(1e-3)
    rigid = jc.simulate(driven_arm({"G": coupling(motor)}), 0.5, save=11)
    assert np.asarray(rigid.coordinate("G.motor")) == pytest.approx(
        ratio * np.asarray(rigid.coordinate("L")), rel=1e-12
    )
    off = []
    for stiffness in (1e3, 1e4):
        rig = driven_arm({"G": coupling(motor, stiffness=stiffness, damping=0.3)})
        run = jc.simulate(rig, 0.5, save=11)
        off.append(np.max(np.abs(np.asarray(run.coordinate("L") - rigid.coordinate("L")))))
    # wind-up falls with the stiffness
    assert off[1] < 0.2 * off[0] < 1e-3


@pytest.mark.parametrize("law", [*slow(jc.flank.Nordin), jc.flank.Stop])
def test_no_shaft_is_too_stiff_for_implicit_steps(law):
    """The step is 300 times as long as the shaft's vibration; places are off by no more than the
    play."""
    play = jc.clearance.Backlash(1e-3, law=law())
    gear = jc.coupling.Gear(
        jc.coupling.Motor(1e-3), "L", 5.0, play=play, stiffness=1e9, damping=1.0
    )
    rigid = driven_arm({"G": jc.coupling.Gear(jc.coupling.Motor(1e-3), "L", 5.0)})
    runs = [
        jc.simulate(rig, 1.0, save=11, integrator=jc.integrator.ImplicitStep(1e-3))
        for rig in (driven_arm({"G": gear}), rigid)
    ]
    one, other = (np.asarray(run.coordinate("L")) for run in runs)
    assert np.ptp(other) > 0.1
    np.testing.assert_allclose(one, other, rtol=0, atol=2e-3)


@pytest.mark.parametrize("law", [jc.flank.Nordin, jc.flank.Stop, jc.flank.ElastoBacklash])
def test_the_energy_balance_closes(law):
    play = jc.clearance.Backlash(4e-3, middle=1e-3, law=law())
    gear = jc.coupling.Gear(
        jc.coupling.Motor(1e-3), "L", 3.0, play=play, stiffness=800.0, damping=0.4
    )
    run = jc.simulate(driven_arm({"G": gear}), 1.0, save=21, balance=True, integrator=TIGHT)
    energy = run.energy_balance()
    assert np.max(np.asarray(energy.damping_loss)) > 1e-4
    assert np.all(np.diff(np.asarray(energy.damping_loss)) > -1e-9)
    # energies follow a motion that is held; that of a spring which the other part leaves ends in a
    # kink within a step
    allowed = 1e-9 if law is jc.flank.Nordin else 1e-5
    assert np.max(np.abs(np.asarray(energy.error))) < allowed


def wheels(**more):
    """Two wheels, the second held, a torque on the first."""
    held = jc.joint.Revolute(jc.drive.ConstantPosition(0.0))
    bodies = {"a": jc.Body(0.1, 1e-4), "b": jc.Body(0.2, 4e-4)}
    joints = {
        "A": jc.Connection(TURN, "ground", "a"),
        "B": jc.Connection(held, jc.Marker("ground", (0.09, 0.0)), jc.Marker("b")),
    }
    loads = {
        "T": jc.load.JointTorque("A", 0.3),
        "rest": jc.load.JointSpring("A", damping=0.05),
    }
    gear = jc.coupling.Gear("A", "B", 2.0, **more)
    return jc.Mechanism(bodies, joints, loads, couplings={"mesh": gear})


def test_wheels_wind_up_by_torque_and_play():
    """At rest: torque on b over the stiffness, and half the play, both seen at b; the force acts at
    the pitch point."""
    rig = wheels(play=jc.clearance.Backlash(2e-3), stiffness=500.0, damping=2.0)
    run = jc.simulate(rig, 3.0, save=3)
    ratio, torque = 2.0, 0.3
    wanted = ratio * (ratio * torque / 500.0 + 1e-3)
    assert float(run.coordinate("A")[-1]) == pytest.approx(wanted, rel=1e-6)
    assert abs(float(run.coupling("mesh").torque[-1])) == pytest.approx(ratio * torque, rel=1e-6)
    radius = 0.09 / 3
    force = np.asarray(run.reaction("mesh").force)[-1]
    assert np.linalg.norm(force) == pytest.approx(torque / radius, rel=1e-6)
    bearing = np.asarray(run.reaction("A").force)[-1]
    assert np.linalg.norm(bearing) == pytest.approx(torque / radius, rel=1e-6)


class Integrating(jc.load.AbstractStateLoad):
    """A torque that is what a coordinate has gathered over time, times a gain."""

    joint: str = eqx.field(static=True)
    gain: Scalar = quantity(unit="N m/(rad s)", meaning="gain")

    def coordinates(self):
        return (self.joint,)

    def states(self):
        return (jc.load.LoadState("sum", "rad s", 0.5),)

    def effect(self, time, positions, speeds, states):
        force = -self.gain * states[0]
        return jc.load.CoordinateEffect((force,), (positions[0],), 0.0, 0.0, force * speeds[0])


@pytest.mark.parametrize(
    "integrator, off",
    [
        (jc.integrator.Adaptive(), 1e-6),
        pytest.param(jc.integrator.FixedStep(1e-3), 1e-9, marks=SLOW),
        (jc.integrator.ImplicitStep(1e-3), 1e-3),
        (jc.integrator.MoreauJean(1e-3), 1e-2),
        pytest.param(jc.integrator.NonColliding(1e-3), 1e-2, marks=SLOW),
    ],
)
def test_a_load_with_a_state_is_carried_by_every_integrator(integrator, off):
    """J q'' = -g y, y' = q: y''' = -(g / J) y."""
    gain = 0.4
    rig = one_arm({"I": Integrating("L", gain)}, start={"L": 0.1}, speeds={"L": 0.0})
    run = jc.simulate(rig, 0.8, save=5, integrator=integrator)
    system = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-gain / 0.05, 0.0, 0.0]])
    values, vectors = np.linalg.eig(system)
    shares = np.linalg.solve(vectors, np.array([0.5, 0.1, 0.0]))
    moved = ((vectors * shares) @ np.exp(np.outer(values, np.asarray(run.time)))).real
    np.testing.assert_allclose(run.coordinate("L"), moved[1], rtol=0, atol=off)
    # a run goes on where it has ended, its states too
    half = jc.simulate(rig, 0.4, save=5, integrator=integrator)
    on = jc.simulate(rig, 0.4, save=5, integrator=integrator, state=half.state())
    np.testing.assert_allclose(on.coordinate("L")[-1], moved[1][-1], rtol=0, atol=off)


def test_a_motor_of_which_nothing_is_told_starts_along_with_its_joint():
    play = jc.clearance.Backlash(1e-3, middle=2e-4)
    gear = jc.coupling.Gear(
        jc.coupling.Motor(1e-3), "L", 50.0, play=play, stiffness=1e4, damping=9.0
    )
    rig = one_arm(couplings={"G": gear}, start={"L": 0.4}, speeds={"L": -0.1})
    start = jc.assemble(rig)
    np.testing.assert_allclose(start.coordinates, [0.4, 50 * (0.4 - 2e-4)], rtol=1e-12)
    np.testing.assert_allclose(start.speeds, [-0.1, -5.0], rtol=1e-12)
    run = jc.simulate(rig, 0.5, save=3)
    assert float(run.coordinate("L")[-1]) == pytest.approx(0.35, rel=1e-9)


def test_motors_are_coordinates_and_no_bodies():
    rig = two_masses("nordin")
    assert tuple(rig.bodies) == ("load",)
    told = rig.parameters()
    assert 'couplings["G"].a.inertia' in set(told["name"])
    assert "Motor" in str(rig) and "Nordin" in str(rig)
    run = jc.simulate(rig, 0.1, save=5)
    data = run.to_dataset()
    assert data["G"].twist.shape == (5,) and data["G.motor"].coordinate.shape == (5,)
    assert "motor" not in data and "load" in data
    with pytest.raises(ValueError, match="no coupling"):
        run.coupling("L")


def test_a_stiff_drive_that_uses_up_its_steps_says_what_takes_them():
    rig = driven_by_a_motor(6e-4, friction=0.5)
    says = 'as the springs of "G", "friction" vibrate.*integrator.ImplicitStep'
    with pytest.raises(jc.SimulationError, match=says):
        jc.simulate(rig, 0.2, save=2, integrator=jc.integrator.Adaptive(max_steps=50))


def driven_by_a_motor(play, friction=None):
    """A body behind a gear with play, whose motor a sine drives."""
    loads = {"drive": jc.load.JointTorque("G.motor", sine(0.05, 40.0))}
    if friction is not None:
        loads["friction"] = jc.load.JointFriction("L", torque=friction, presliding=1e-4)
    more = {"stiffness": 2e4, "damping": 15.0, "play": jc.clearance.Backlash(play)}
    gear = jc.coupling.Gear(MOTOR(2e-5), "L", ratio=100.0, **more)
    return one_arm(loads, {"G": gear}, inertia=0.1)


def end_by_play(integrator, friction=None):
    def end(play):
        rig = driven_by_a_motor(play, friction)
        run = jc.simulate(rig, 0.2, save=2, integrator=integrator, throw=False, verify=False)
        return run.coordinate("L")[-1]

    return end


def slope_by_play(integrator, friction=None):
    return jax.jacfwd(end_by_play(integrator, friction))(6e-4)


def test_slopes_of_fixed_steps_by_play_are_those_of_the_motion():
    slope = slope_by_play(jc.integrator.FixedStep(2e-5))
    assert slope == pytest.approx(-0.36773, rel=1e-2)


@pytest.mark.slow
def test_slopes_by_play_of_a_body_with_friction_are_those_of_the_motion():
    """A bristle that has yielded moves no more."""
    assert slope_by_play(TIGHT, 0.5) == pytest.approx(2.13211, rel=1e-3)
    # One that yields within a step is judged as of first order: right, or not given.
    slope = slope_by_play(jc.integrator.FixedStep(2e-5), 0.5)
    assert np.isnan(slope) or slope == pytest.approx(2.13211, rel=1e-2)


@pytest.mark.parametrize(
    "integrator",
    [
        jc.integrator.FixedStep(1e-4, "heun"),
        jc.integrator.FixedStep(1e-4, steps_per_save=10),
        jc.integrator.ImplicitStep(1e-4),
        jc.integrator.MoreauJean(1e-4),
    ],
)
def test_slopes_that_do_not_know_when_flanks_meet_are_refused(integrator):
    with pytest.raises(ValueError, match='flanks of coupling "G" meet and part'):
        jax.eval_shape(jax.jacfwd(end_by_play(integrator)), 6e-4)


def test_a_rotor_is_no_body_of_the_answers():
    """Its turns, wrapped at pi, would be what the arm's error is judged beside."""
    gear = jc.coupling.Gear(MOTOR(2e-5), "L", 100, stiffness=2e3, damping=20.0)
    pushed = one_arm({"push": jc.load.JointTorque("L", -12.0)}, {"gear": gear}, inertia=0.5)
    run = jc.simulate(pushed, 0.1, save=21, verify=True)
    row = next(line for line in str(run).splitlines() if line.startswith("orientation"))
    farthest = np.max(np.abs(run.coordinate("L")))
    np.testing.assert_allclose(float(row.split("]")[1].split()[0]), farthest, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.verified
def test_the_peak_of_a_flank_is_that_of_all_steps_in_its_unit():
    """A wheel of inertia J that meets a flank of stiffness k at a speed w presses by w sqrt(k J) at
    the most; of three saving times none sees it."""
    inertia, speed, stiffness = 0.5, 2.0, 4e4
    play = jc.clearance.Backlash(2e-2, law=jc.flank.Stop())
    hold = jc.coupling.Latch("L", 0.0, play=play, stiffness=stiffness)
    rig = one_arm(couplings={"hold": hold}, inertia=inertia, speeds={"L": speed})
    run = jc.simulate(rig, 0.04, save=jc.Saving(3, events=4))
    peak = jc.response.PeakTransmitted("hold")
    largest = speed * np.sqrt(stiffness * inertia)
    assert abs(run.transmitted("hold")).max() < 0.5 * largest
    assert float(peak(run)) == pytest.approx(largest, rel=1e-4)
    assert peak.unit_in(rig) == "N m" and run.estimate(peak).error < 1e-3 * largest
    (told,) = [told for told in run.verification.entries if told.name == 'peak transmitted, "hold"']
    assert told.value == pytest.approx(largest, rel=1e-4) and told.unit == "N m"
    assert "rad, N m" in str(run.extremes)
    events = run.events()
    assert events["speed [rad/s]"].to_numpy() == pytest.approx(speed, rel=1e-4)


@pytest.mark.verified
def test_what_couplings_transmit_is_a_standard_answer():
    """Two wheels under a torque T, geared 1:1 by a shaft: half of it goes through."""
    turn = jc.joint.Revolute
    rig = lambda **shaft: jc.Mechanism(
        {"a": jc.Body(1.0, 0.1), "b": jc.Body(1.0, 0.1)},
        {
            "A": jc.Connection(turn(), "ground", "a"),
            "B": jc.Connection(turn(), jc.Marker("ground", (0.1, 0.0)), "b"),
        },
        {"torque": jc.load.JointTorque("A", 3.0)},
        couplings={"shaft": jc.coupling.Ratio("B", "A", 1.0, **shaft)},
    )
    run = jc.simulate(rig(), 0.1, save=5)
    told = {told.name: told for told in run.verification.entries}
    for kind in ("mean", "peak"):
        row = told[f'{kind} transmitted, "shaft"']
        assert row.value == pytest.approx(1.5, rel=1e-6) and row.unit == "N m"
    assert not run.warnings and not jc.simulate(rig(stiffness=1e3), 0.1, save=5).warnings


@pytest.mark.parametrize(
    ("integrator", "near"),
    [
        (jc.integrator.FixedStep(1e-4), 1e-8),
        pytest.param(jc.integrator.ImplicitStep(1e-4), 2e-5, marks=SLOW),
    ],
)
def test_a_stiff_coupling_follows_a_side_that_a_drive_turns(integrator, near):
    """The twist e of a load that starts at rest, I e'' + d e' + k e = 0 with e'(0) = the drive's
    speed: W exp(-z t) sin(w t) / w."""
    inertia, stiffness, damping, speed = 0.05, 50.0, 0.2, 3.0
    joints = {
        "A": jc.Connection(jc.joint.Revolute(drive=jc.drive.ConstantSpeed(speed)), "ground", "a"),
        "L": jc.Connection(TURN, "ground", "load"),
    }
    gives = {"stiffness": stiffness, "damping": damping}
    rig = jc.Mechanism(
        {"a": jc.Body(1.0, 0.01), "load": jc.Body(1.0, inertia)},
        joints,
        couplings={"G": jc.coupling.Ratio("L", "A", 1.0, **gives)},
        speeds={"L": 0.0},
    )
    run = jc.simulate(rig, 0.2, save=5, integrator=integrator, verify=False)
    time, decay = np.asarray(run.time), 0.5 * damping / inertia
    fast = np.sqrt(stiffness / inertia - decay**2)
    twist = speed * np.exp(-decay * time) * np.sin(fast * time) / fast
    np.testing.assert_allclose(run.coordinate("L"), speed * time - twist, atol=near)
