"""Couplings of coordinates against closed forms, elimination on the mechanism's own mass matrix,
and another program.

What is wrong with a coupling, or given against one, is said by the coupling's name."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.multibody.topology import Redundancy
from tests.rigs.planetary import RING, SUN
from tests.rigs.planetary import planetary as tied

TURN = jc.joint.Revolute()
J_PINION, J_WHEEL, R_PINION, R_WHEEL = 1e-4, 2e-3, 0.02, 0.06
DRIVING, LOAD = 0.2, -0.3


def gear_pair(ratio=-R_PINION / R_WHEEL, offset=None, turn=TURN):
    """Two shafts on the ground, wheel and pinion, under torques."""
    return jc.Mechanism(
        {"pinion": jc.Body(0.3, J_PINION), "wheel": jc.Body(1.0, J_WHEEL)},
        {
            "A": jc.Connection(TURN, "ground", "pinion"),
            "B": jc.Connection(turn, jc.Marker("ground", (0.08, 0.0)), jc.Marker("wheel")),
        },
        {"m": jc.load.JointTorque("A", DRIVING), "l": jc.load.JointTorque("B", LOAD)},
        couplings={"mesh": jc.coupling.Ratio("B", "A", ratio, offset)},
    )


def test_a_gear_pair_turns_as_its_formula():
    run = jc.simulate(gear_pair(), 0.1, save=6, balance=True)
    share = R_PINION / R_WHEEL
    wanted = (DRIVING - LOAD * share) / (J_PINION + J_WHEEL * share**2)
    angle = 0.5 * wanted * np.asarray(run.time) ** 2
    # a parabola is exact for the integrator: rounding
    np.testing.assert_allclose(run.coordinate("A"), angle, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(run.coordinate("B"), -share * angle, rtol=1e-12, atol=1e-14)
    torque = -J_WHEEL * wanted * share - LOAD
    np.testing.assert_allclose(run.transmitted("mesh"), torque, rtol=1e-12)
    # it loads no bearing
    np.testing.assert_allclose(run.reaction("A").force, 0.0, atol=1e-12)
    np.testing.assert_allclose(run.energy_balance().error, 0.0, atol=1e-9)
    assert run.warnings == ()


def planetary():
    """With its two meshes as ratios as seen from the carrier."""
    return tied({"willis": jc.coupling.Differential("R", "S", "C", SUN / RING)})


def test_a_differential_shares_as_willis_says():
    run = jc.simulate(planetary(), 0.05, save=3, integrator=jc.integrator.FixedStep(1e-3))
    sun, ring, carrier = (np.asarray(run.coordinate(n))[1:] for n in "SRC")
    np.testing.assert_allclose((ring - carrier) / (sun - carrier), -0.03 / 0.06, rtol=1e-12)


@pytest.mark.parametrize(
    "integrator",
    [
        jc.integrator.ImplicitStep(1e-3),
        jc.integrator.NonColliding(1e-3),
        jc.integrator.MoreauJean(1e-3),
    ],
    ids=lambda x: type(x).__name__,
)
def test_a_ratio_holds_in_every_integrator(integrator):
    rig = gear_pair(offset=0.1)
    run = jc.simulate(rig, 0.05, save=3, integrator=integrator)
    wheel, pinion = run.coordinate("B"), run.coordinate("A")
    np.testing.assert_allclose(wheel, 0.1 - pinion * R_PINION / R_WHEEL, rtol=1e-12, atol=1e-13)
    share = R_PINION / R_WHEEL
    wanted = (DRIVING - LOAD * share) / (J_PINION + J_WHEEL * share**2)
    # a first-order method is off by half a step beside the duration, at the most
    np.testing.assert_allclose(pinion[-1] - pinion[0], 0.5 * wanted * 0.05**2, rtol=0.03)


def test_a_drive_moves_what_follows_it_and_pays_for_it():
    """A rack that a driven pinion moves by a ratio in m/rad, against gravity."""
    speed, radius, mass = 3.0, 0.02, 2.0
    rig = jc.Mechanism(
        {"pinion": jc.Body(0.3, J_PINION), "rack": jc.Body(mass, (1e-3, 1e-3, 1e-3))},
        {
            "A": jc.Connection(
                jc.joint.Revolute(jc.drive.Harmonic(1.0, speed)), "ground", "pinion"
            ),
            "S": jc.Connection(jc.joint.Prismatic(), "ground", "rack"),
        },
        {"g": jc.load.Gravity((0.0, 0.0, -9.81))},
        couplings={"rack": jc.coupling.Ratio("S", "A", radius)},
    )
    assert "ratio 0.02" in str(rig)
    run = jc.simulate(rig, 0.4, save=5, balance=True, integrator=jc.integrator.FixedStep(2e-4))
    way = run.coordinate("S")
    np.testing.assert_allclose(way - way[0], radius * _turned(run, "pinion"), atol=1e-11)
    np.testing.assert_allclose(run.energy_balance().error, 0.0, atol=1e-9)
    # what the drive gives moves the pinion too, and lifts the rack
    given = np.asarray(run.energy_balance().input)
    lifted = mass * 9.81 * (way - way[0])
    fast = np.asarray(run.speed("S"))
    moving = 0.5 * (mass + J_PINION / radius**2) * (fast**2 - fast[0] ** 2)
    np.testing.assert_allclose(given, lifted + moving, atol=1e-9)


def _turned(run, body):
    rotation = np.asarray(run.body(body).rotation)
    angle = np.unwrap(np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]))
    return angle - angle[0]


def test_a_ratio_reaches_a_joint_outside_the_tree():
    """The wheel's bearing with clearance: the torque acts on its coordinate, over whole turns."""
    bearing = jc.clearance.PlanarJournalBearing(
        jc.contact.LankaraniNikravesh(restitution=0.9, stiffness=1e8), clearance=1e-4
    )
    rig = gear_pair(-1.0).with_joint("B", bearing)
    assert rig.topology.branch_of("B") is None
    run = jc.simulate(rig, 0.5, save=26, integrator=jc.integrator.FixedStep(1e-4))
    wheel, pinion = (_turned(run, body) for body in ("wheel", "pinion"))
    wanted = (DRIVING - LOAD) / (J_PINION + J_WHEEL)
    # nothing presses the journal, so it stays in the middle; more than four turns
    np.testing.assert_allclose(pinion, 0.5 * wanted * np.asarray(run.time) ** 2, atol=1e-9)
    np.testing.assert_allclose(wheel, -pinion, atol=1e-9)
    np.testing.assert_allclose(run.transmitted("mesh")[0], -J_WHEEL * wanted - LOAD, rtol=1e-9)
    through = run.reaction("B").torque[:, 2]
    np.testing.assert_allclose(through, run.transmitted("mesh") + LOAD, rtol=1e-9)
    with pytest.raises(ValueError, match="whole turns are not counted"):
        rig.with_joint("A", bearing)


def test_derivatives_pass_through_a_ratio():
    def end(ratio):
        rig = gear_pair(ratio)
        step = jc.integrator.FixedStep(1e-3)
        return jc.simulate(rig, 0.1, save=2, integrator=step).coordinate("A")[-1]

    ratio = -R_PINION / R_WHEEL
    numerator, below = DRIVING + LOAD * ratio, J_PINION + J_WHEEL * ratio**2
    exact = 0.5 * 0.1**2 * (LOAD * below - numerator * 2 * J_WHEEL * ratio) / below**2
    # closed form, the motion is exact: rounding
    np.testing.assert_allclose(jax.grad(end)(jnp.asarray(ratio)), exact, rtol=1e-10)


def test_mujoco_couples_alike():
    mujoco = pytest.importorskip("mujoco")
    text = """<mujoco><option timestep="1e-4" integrator="RK4" gravity="0 0 0"/><worldbody>
      <body name="pinion"><joint name="A" axis="0 0 1"/><inertial pos="0 0 0" mass="0.3"
        diaginertia="1e-4 1e-4 1e-4"/></body>
      <body name="wheel" pos="0.08 0 0"><joint name="B" axis="0 0 1"/><inertial pos="0 0 0" mass="1"
        diaginertia="2e-3 2e-3 2e-3"/></body></worldbody>
      <equality><joint joint1="B" joint2="A" polycoef="0 -0.3333333333333333 0 0 0"
        solref="2e-4 1" solimp="0.9999 0.9999 1e-3"/></equality></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for _ in range(1000):
        data.qfrc_applied[:] = (DRIVING, LOAD)
        mujoco.mj_step(model, data)
    run = jc.simulate(gear_pair(), 0.1, save=2)
    ours = [float(run.coordinate(n)[-1]) for n in "AB"]
    # MuJoCo's equality is soft: impedance 0.9999
    np.testing.assert_allclose(data.qpos, ours, rtol=1e-3)


def test_couplings_stay_with_the_mechanism():
    rig = gear_pair(offset=0.2)
    kept = [rig.with_loads({}), rig.with_joint("A", jc.joint.PlainBearing())]
    assert all(list(own.couplings) == ["mesh"] for own in kept)
    assert 'couplings["mesh"].ratio' in set(rig.parameters()["name"])


REFUSED_TURN = 2 * np.pi
WHEEL = jc.Body(1.0, 1e-3)
PIN = jc.joint.Revolute()


def pair(couplings, names="ab", **given):
    """Wheels 0.1 m apart."""
    joints = {
        name.upper(): jc.Connection(PIN, "ground", name, at=(0.1 * i, 0.0))
        for i, name in enumerate(names)
    }
    return jc.Mechanism(dict.fromkeys(names, WHEEL), joints, couplings=couplings, **given)


GEAR, MESHED = {"mesh": jc.coupling.Gear("A", "B", 2.0)}, {"B": 1.0, "A": -2.0}
Ratio = jc.coupling.Ratio


def test_couplings_that_contradict_each_other_are_warned_about():
    two = {"one": Ratio("B", "A", 2.0), "two": Ratio("B", "A", 3.0)}
    with pytest.warns(UserWarning, match='couplings "one", "two" together leave joint "B" one'):
        pair(two)
    round_ = {"ab": Ratio("A", "B", 2.0), "bc": Ratio("B", "C", 2.0), "ca": Ratio("C", "A", 2.0)}
    with pytest.warns(UserWarning, match='couplings "ab", "bc", "ca" together leave joint "A"'):
        pair(round_, "abc")


@pytest.mark.parametrize(
    "couplings",
    [
        {"one": Ratio("B", "A", 2.0), "two": Ratio("B", "A", 2.0)},
        {"ab": Ratio("A", "B", 2.0), "bc": Ratio("B", "C", 2.0), "ca": Ratio("C", "A", 0.25)},
        {"one": Ratio("B", "A", 2.0), "two": jc.coupling.Differential("A", "B", "C")},
    ],
)
def test_couplings_that_leave_motion_are_not(couplings):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pair(couplings, "abc")


def test_what_is_given_against_a_coupling_names_it():
    with pytest.raises(ValueError, match='its loops, drives, coupling "mesh" and what'):
        jc.assemble(pair(GEAR, start={"B": 1.0, "A": 1.0}, speeds=MESHED))
    with pytest.raises(ValueError, match='drives, coupling "mesh" and the speeds given before'):
        jc.assemble(pair(GEAR, start=MESHED, speeds={"B": 1.0, "A": 1.0}))


@pytest.mark.filterwarnings("ignore:.*is it in degrees")
def test_whole_turns_that_a_coupling_counts_are_met_or_said():
    with pytest.raises(ValueError, match='coupling "mesh" cannot be closed.*whole turns.*"A", "B"'):
        jc.assemble(pair(GEAR, start={"B": -7 * REFUSED_TURN}))
    with pytest.warns(UserWarning, match='"B" is met but for 6 whole turns.*"mesh"') as said:
        jc.assemble(pair(GEAR, guess={"B": -7 * REFUSED_TURN}))
    assert {each.filename for each in said} == {__file__}
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        warnings.filterwarnings("ignore", message=".*is it in degrees")
        found = jc.assemble(pair(GEAR, guess={"B": -7 * REFUSED_TURN, "A": 14 * REFUSED_TURN}))
    np.testing.assert_allclose(
        np.asarray(found.coordinates)[:2], (14 * REFUSED_TURN, -7 * REFUSED_TURN), atol=1e-6
    )


def test_redundant_rows_of_couplings_are_called_by_the_coupling():
    said = str(Redundancy(1, rows=(("two", ""), ("pin", "turn"), ("pin", "x"))))
    assert 'loops coupling "two"; turn, x of joint "pin" follow' in said
    assert 'reactions in "pin" the least' in str(
        Redundancy(1, rows=(("pin", "x"),), joints=("pin",))
    )


def tied_twice(second):
    """Pinion and wheel of 3:1, geared, and tied once more."""
    couplings = {"mesh": jc.coupling.Gear("A", "B", 3.0), "second": second}
    plain = gear_pair()
    return jc.Mechanism(plain.bodies, plain.connections, plain.loads, couplings=couplings)


@pytest.mark.slow
def test_shares_of_couplings_that_say_the_same_are_not_unique():
    """Two equal rows: any split meets the equations; a chain of two has one."""
    run = jc.simulate(tied_twice(jc.coupling.Ratio("B", "A", -1 / 3)), 1e-3, save=2)
    for name in ("mesh", "second"):
        with pytest.warns(UserWarning, match=f'what coupling "{name}" transmits is not unique'):
            run.transmitted(name)
    with pytest.warns(UserWarning, match='reaction of coupling "mesh" is not unique'):
        assert not run.reaction("mesh").unique
    soft = jc.coupling.Ratio("B", "A", -1 / 3, stiffness=1e3)
    run = jc.simulate(tied_twice(soft), 1e-3, save=2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run.transmitted("mesh"), run.transmitted("second")
        assert run.reaction("mesh").unique


FAR, PULL = 0.3, 60.0


def belt_drive(belt, torque=None, turned=None):
    """A pulley that is held at an angle or by a torque, and one that stands still."""
    held = None if turned is None else jc.drive.ConstantPosition(turned)
    turn = lambda drive: jc.joint.Revolute(drive=drive)
    return jc.Mechanism(
        {"a": jc.Body(0.5, 1e-3), "b": jc.Body(1.0, 3e-3)},
        {
            "A": jc.Connection(turn(held), "ground", "a"),
            "B": jc.Connection(
                turn(jc.drive.ConstantPosition(0.0)), jc.Marker("ground", (FAR, 0.0)), "b"
            ),
        },
        {} if torque is None else {"motor": jc.load.JointTorque("A", torque)},
        couplings={"belt": belt},
    )


def carried_by(tight, slack, sine):
    """Force of two strands on a pulley, of unit vectors (cos, sin) and (cos, -sin)."""
    return np.hypot((tight + slack) * np.sqrt(1 - sine**2), (tight - slack) * sine)


@pytest.mark.parametrize(
    "radius, crossed, turned",
    [(0.06, False, 2e-3), (0.06, True, 2e-3), (0.04, False, 0.03)],
    ids=["open", "crossed", "slack"],
)
def test_bearings_carry_both_strands_of_a_belt(radius, crossed, turned):
    """Statics: strands of half the stiffness each pull by F0 + T / 2 r and F0 - T / 2 r, or one
    alone."""
    own, stiffness = 0.04, 800.0
    belt = jc.coupling.Belt(
        "A", "B", own, radius, crossed=crossed, stiffness=stiffness, pretension=PULL
    )
    run = jc.simulate(belt_drive(belt, turned=turned), 1e-3, save=2)
    stretch = 0.5 * stiffness * turned / own
    tight, slack = PULL + stretch, max(PULL - stretch, 0.0)
    sine = (radius + own if crossed else radius - own) / FAR
    for joint in "AB":
        found = np.linalg.norm(run.reaction(joint).force[-1])
        assert found == pytest.approx(carried_by(tight, slack, sine), rel=1e-9)


@pytest.mark.slow
def test_the_shaft_of_a_chain_carries_its_tight_strand():
    """4 N m on 40 mm: 100 N, whichever way."""
    chain = jc.coupling.Belt("A", "B", 0.04, 0.06)
    for torque in (4.0, -4.0):
        run = jc.simulate(belt_drive(chain, torque), 1e-3, save=2)
        found = np.linalg.norm(run.reaction("A").force[-1])
        assert found == pytest.approx(100.0, rel=1e-9)
