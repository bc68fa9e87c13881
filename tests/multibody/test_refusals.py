"""What a mechanism, its parts, a start or a run is refused for, in one table. What any single
argument is refused for, a wrong kind or a number out of its range, the tables of bad input try."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.laws.stiffness import Shape
from tests.multibody import test_couplings as couplings
from tests.multibody import test_gears as gears
from tests.multibody.test_exchanged_joints import arm as two_links
from tests.multibody.test_joints_that_close_loops import screw_press
from tests.multibody.test_magnitudes import guided
from tests.multibody.test_parts_that_roll_on_the_ground import rolling
from tests.multibody.test_play import one_arm
from tests.multibody.test_read_only_parts import BODY, RIG
from tests.multibody.test_servos import arm as served
from tests.multibody.test_worn_flanks import held, one_way, worn_play

NAN = float("nan")
LAW = jc.contact.Hertz()
Bearing, Journal = jc.clearance.PlanarJournalBearing, jc.clearance.JournalBearing
Guide, Socket = jc.clearance.SliderGuide, jc.clearance.BallSocket
Gear, Rack, Ratio, Motor = jc.coupling.Gear, jc.coupling.Rack, jc.coupling.Ratio, jc.coupling.Motor
Screw, Belt, Servo = jc.coupling.Screw, jc.coupling.Belt, jc.load.Servo
Capstan, Latch = jc.coupling.Capstan, jc.coupling.Latch
Adaptive, MoreauJean = jc.integrator.Adaptive, jc.integrator.MoreauJean
PLANAR = Bearing(LAW, clearance=1e-4)
TURN, BALL, FIXED = jc.joint.Revolute(), jc.joint.Spherical(), jc.joint.Fixed()
TURNING = jc.joint.Revolute(drive=jc.drive.ConstantSpeed(1.0))
STILL = jc.joint.Revolute(drive=jc.drive.ConstantPosition(0.0))
TORQUE = {"m": jc.load.JointTorque("pin", 1.0)}


def arm(**changes):
    return jc.Body(**({"mass": 1.0, "inertia": (1e-2, 1e-2, 1e-2)} | changes))


def rig(
    joint=TURN, *, body=None, loads=None, parent="ground", child="arm", at=None, axis="z", **changes
):
    """One body "arm" held to the ground by one joint "pin"."""
    pin = jc.Connection(joint, parent, child, at=at, axis=axis)
    return jc.Mechanism({"arm": arm() if body is None else body}, {"pin": pin}, loads, **changes)


def marker(body="arm", **changes):
    return jc.Marker(body, **changes)


def four_bar(foot=0.4, drives=""):
    """Crank, coupler and rocker in the plane, some of their joints driven."""
    joints = {name: TURNING if name in drives else TURN for name in "OABD"}
    rocker = jc.Marker("rocker", (0.3, 0.0))
    return jc.Mechanism(
        {name: jc.Body(1.0, 1e-2) for name in ("crank", "coupler", "rocker")},
        {
            "O": jc.Connection(joints["O"], "ground", "crank"),
            "A": jc.Connection(joints["A"], "crank", "coupler", at=(0.1, 0.0)),
            "B": jc.Connection(joints["B"], "coupler", "rocker", at=(0.4, 0.0)),
            "D": jc.Connection(joints["D"], "ground", rocker, at=(foot, 0.0)),
        },
        guess=None if drives else {"O": 1.0, "A": -0.6},
    )


def out_of_reach():
    """A journal that its bearing is too far from."""
    ends = jc.Connection(PLANAR, "ground", marker(at=(0.3, 0.0)), at=(0.5, 0.0))
    pin = jc.Connection(TURN, "ground", "arm")
    return jc.Mechanism({"arm": arm(inertia=1.0)}, {"pin": pin, "B": ends})


def rack_along_its_pinion():
    """A rack that slides along its pinion's axis."""
    slide = jc.Connection(jc.joint.Prismatic(), "ground", "b", axis="z")
    return jc.Mechanism(
        {"a": arm(), "b": arm()},
        {"A": jc.Connection(TURN, "ground", "a"), "B": slide},
        couplings={"mesh": Rack("A", "B", 0.02)},
    )


def geared():
    return couplings.gear_pair()


def played(integrator, **more):
    """A run of an arm behind a gear with play."""
    gear = Gear(Motor(1e-3), "L", 3.0, play=1e-3, **more)
    return jc.simulate(one_arm(couplings={"G": gear}), 0.1, integrator=integrator)


def ran(**changes):
    return jc.simulate(rig(), **({"duration": 1.0} | changes))


def unframed():
    """A run with set-valued friction by compliant contacts."""
    bearing = Bearing(LAW, jc.friction.Coulomb())
    return jc.simulate(rig(bearing, body=arm(inertia=1.0)), 1.0)


def gear_with_error(error):
    return Gear("A", "B", 3.0, transmission_error=error)


REFUSED = [
    # mechanisms
    ("no chain of joints .* 'leg'", lambda: jc.Mechanism({"arm": arm(), "leg": arm()}, RIGS)),
    ('load "m" .* "pin"', lambda: rig(BALL, loads=TORQUE)),
    ('load "m" .* "pin", whose coordinate is driven', lambda: rig(TURNING, loads=TORQUE)),
    ('load "m" .* "pin", which must have one, .* it has 4', lambda: rig(Socket(LAW), loads=TORQUE)),
    (r"Marker has at\[0\] = nan m; it must be finite", lambda: rig(at=(NAN, 0, 0))),
    ("Body .* positive definite", lambda: rig(body=arm(inertia=(1, 1, 1, 2, 0, 0)))),
    ("Body .* larger than the sum", lambda: rig(body=arm(inertia=(1, 1, 3)))),
    (r"Body has inertia\[0\] = nan", lambda: rig(body=arm(inertia=(NAN, 1, 1)))),
    ('joint "pin": .* does not fit', lambda: rig(Journal(LAW, clearance=1e-20))),
    ("BallSocket has socket_radius", lambda: rig(Socket(LAW, socket_radius=1e-5))),
    ("SliderGuide has width", lambda: rig(Guide(LAW, width=1e-5))),
    ("a journal of length 0.01", lambda: Journal(LAW, length=2e-2, journal_length=1e-2)),
    ('joint "pin": .* length', lambda: rig(Socket(jc.contact.Johnson()))),
    ('speeds names "pin", whose motion is prescribed', lambda: rig(FIXED, speeds={"pin": 1.0})),
    ('start names "pin", whose motion is prescribed', lambda: rig(TURNING, start={"pin": 1.0})),
    ("start.*pin.* = nan", lambda: rig(start={"pin": NAN})),
    ('start of "pin" ends in a quaternion', lambda: rig(BALL, start={"pin": (0, 0, 0, 0)})),
    ('joint "." is driven but closes a loop', lambda: four_bar(drives="OABD")),
    # parts
    ('axis of a marker on "arm" is .up.', lambda: marker(axis="up")),
    ("Marker has axis = .*; it must be 2 or 3", lambda: marker(axis=(0, 1, 0, 0))),
    ('"arm" points along -z.*axis="-z"', lambda: marker(axis=(0, 0, -2.0))),
    ('quaternion of a marker on "arm" is zero', lambda: marker(quaternion=(0, 0, 0, 0))),
    ("Marker has quaternion = .*; it must be 4 numbers", lambda: marker(quaternion=(1, 0, 0))),
    ('"arm" takes a quaternion .* not both', lambda: marker(quaternion=(1, 0, 0, 0), axis="x")),
    ("Marker has at = .*; it must be 2 or 3", lambda: marker(at=(0, 0, 0, 0))),
    ('"arm" gives `at` beside', lambda: jc.Connection(TURN, marker(), "leg", at=(1, 0))),
    ("put the axis into the m", lambda: jc.Connection(TURN, marker("ground"), marker(), axis="x")),
    ("coarseness of a Wearing must be", lambda: jc.Wearing(jc.wear.Archard(), coarseness=1.5)),
    ("whole numbers", lambda: jc.Wearing(jc.wear.Archard(), cells=(12.5, 1))),
    ("value = 5.0; it must be 2 or 3", lambda: jc.load.Force(marker(), jnp.asarray(5.0))),
    ("value = .*; it must be 2 or 3", lambda: jc.load.Force(marker(), (1, 0, 0, 0))),
    ("does not fit", lambda: Shape(1e-2, 1e-2)),
    ("needs lower or upper, or both", lambda: jc.load.JointStop("elbow", stiffness=1.0)),
    ("lower must be below upper", lambda: jc.load.JointStop("elbow", 0.3, 0.2, stiffness=1.0)),
    # starts
    ('start of "pin" needs 1 number', lambda: jc.assemble(rig(start={"pin": (1.0, 2.0)}))),
    ('"pin" need 1 number, not 2', lambda: jc.assemble(rig(speeds={"pin": (1.0, 2.0)}))),
    ('loop through joint "." cannot be closed', lambda: jc.assemble(four_bar(3.0))),
    ('journal of joint "B" cannot be brought to the mid', lambda: jc.assemble(out_of_reach())),
    ("an inertia about its z axis only", lambda: jc.assemble(rig(BALL, body=arm(inertia=1.0)))),
    ("2 were found", lambda: jc.assemblies(four_bar(0.3, "O")).guess(2)),
    ("at least 1", lambda: jc.assemblies(four_bar(), 0)),
    ("a jaxclear.Mechanism", lambda: jc.assemblies(3)),
    ("cannot be closed", lambda: jc.assemblies(four_bar(3.0, "O"))),
    # runs
    ("duration is inf", lambda: ran(duration=np.inf)),
    ("duration is nan", lambda: ran(duration=NAN)),
    ("save=1: .* at least 2", lambda: ran(save=1)),
    ("save=2.5: .* whole number", lambda: ran(save=2.5)),
    ("save='all'", lambda: ran(save="all")),
    ("must increase", lambda: ran(save=[0.0, 0.5, 0.4])),
    ("must increase from 0 or later to at most the duration", lambda: ran(save=[0.0, 2.0])),
    ("must increase", lambda: ran(save=[-1.0, 0.5])),
    ("must increase", lambda: ran(save=[0.1, NAN, 0.5])),
    ('joint "pin" has set-valued friction Coulomb', unframed),
    # parts that are exchanged
    ('"elbw" in this mechanism.*Did you mean "elb', lambda: two_links().with_joint("elbw", PLANAR)),
    ('in place of "elbow" is a ContactForce', lambda: two_links().with_joint("elbow", LAW)),
    ("one of jaxclear.joint", lambda: two_links().with_joint("elbow", jc.joint.Prismatic)),
    ("a SliderGuide, which without its", lambda: two_links().with_joint("elbow", Guide(LAW))),
    ("in a plane, and nothing else holds", lambda: two_links(True).with_joint("elbow", PLANAR)),
    ('"G" is a Prismatic; a Plan', lambda: jc.scenes.slider_crank().with_joint("G", PLANAR)),
    ('"O" is driven, and a Plana', lambda: jc.scenes.slider_crank().with_joint("O", PLANAR)),
    ("directions", lambda: screw_press(0.01).with_joint("thread", jc.joint.Prismatic())),
    ('no body "hand" in this mechanism; there are', lambda: RIG.with_body("hand", BODY)),
    ('in place of "fore" is 3.0; it must be a', lambda: RIG.with_body("fore", 3.0)),
    ("motor", lambda: RIG.with_load("motor", 2.0)),
    # what acts on joints
    ('"elbow", which has clearance', lambda: with_rotor(two_links().with_joint("elbow", PLANAR))),
    ('"B", which closes a loop', lambda: with_rotor(jc.scenes.slider_crank("ideal"), "B")),
    ("driven; leave the drive out", lambda: served(Servo("A", 0.3, 200.0), joint=STILL)),
    ("no coupling.Motor turns", lambda: served(Servo("A", 0.3, 200.0, encoder="motor"))),
    ('no encoder of a Servo "tacho"', lambda: served(Servo("A", 0.3, 200.0, encoder="tacho"))),
    ("delay without a period", lambda: served(Servo("A", 0.3, 200.0, delay=2))),
    ("a step in place of steps_per_save", lambda: sampled_by_saves()),
    # couplings of coordinates
    ("twice", lambda: geared().with_coupling("x", Ratio("A", "A", 1.0))),
    ('"Z"', lambda: geared().with_coupling("x", Ratio("A", "Z", 1.0))),
    ("another name", lambda: geared().with_coupling("A", Ratio("A", "B", 1.0))),
    ('"x"', lambda: geared().with_coupling("x", None)),
    ("jaxclear.coupling", lambda: geared().with_coupling("x", TURN)),
    ("it has 2", lambda: couplings.gear_pair(turn=jc.joint.Cylindrical())),
    ("all of which are driven", lambda: both_driven()),
    # gears, racks, belts, screws
    ("twice", lambda: gears.pair(Gear("A", "A", 2.0))),
    ("leave it out", lambda: Gear("A", "B", 2.0, pressure_angle=0.0)),
    ("lead = 0", lambda: Screw("A", 0.0)),
    ('"C"', lambda: gears.pair(Gear("A", "C", 2.0))),
    ("one axis", lambda: gears.pair(Gear("A", "B", 1.0, internal=True))),
    ("wheels on one axis", lambda: gears.pair(Gear("A", "B", 2.0), distance=0.0)),
    ("not parallel", lambda: gears.pair(Gear("A", "B", 2.0), axes=("z", "y"))),
    ("whose parts slide", lambda: gears.pair(Rack("A", "B", 0.02))),
    ("does not lie across", rack_along_its_pinion),
    ("to itself", lambda: gears.press().with_coupling("x", Gear("slide", "guide", 2.0))),
    ("same again after a turn", lambda: gear_with_error(lambda turn: 1e-3 * turn)),
    ("one number", lambda: gear_with_error(lambda turn: (turn, turn))),
    ('"roll" rolls on what joint "road" slides.*which side', lambda: rolling(below=0.0)),
    ("efficiency and neither", lambda: Gear("A", "B", 3.0, efficiency=0.9)),
    ("friction and neither", lambda: Screw("S", 8e-3, friction=0.1, diameter=0.03)),
    ("friction and diameter together", lambda: Screw("S", 8e-3, friction=0.1)),
    ("pretension, and needs", lambda: Belt("A", "B", 0.1, 0.1, pretension=9.0)),
    ("fewer than two joints", lambda: Capstan("A", friction=0.2, wrap=3.0, stiffness=1e5)),
    # play, motors
    ("more than one of its ends", lambda: Gear(Motor(1.0), Motor(1.0), 2.0)),
    ("neither stiffness nor play", lambda: Gear("A", "B", 2.0, damping=1.0)),
    ("neither play nor stiffness", lambda: Latch("L")),
    ("no body that teeth", lambda: Gear(Motor(1.0), "L", 2.0, pressure_angle=0.3)),
    (
        "a coupling and a joint",
        lambda: one_arm(couplings={"L": jc.coupling.Latch("L", stiffness=1.0)}),
    ),
    ("alone; give the", lambda: jc.coupling.OneWay(Motor(1e-3), "L", stiffness=1.0, damping=1.0)),
    ("a body and a joint", lambda: jc.coupling.Rope(("L", Motor(1e-3)), (0.1, 0.1), stiffness=1.0)),
    ('no joint "G.motor"', lambda: one_arm({"T": jc.load.JointTorque("G.motor", 1.0)})),
    ("without stiffness", lambda: played(Adaptive())),
    ("give damping, or take flank.Stop", lambda: played(Adaptive(), stiffness=9.0)),
    ("or the restitution of rigid ones", lambda: played(MoreauJean(1e-3))),
    ("give damping, or take flank.Stop", lambda: played(MoreauJean(1e-3), stiffness=9.0)),
    # flanks that wear
    ("needs slide", lambda: worn_play(area=None)),
    ("no wear", lambda: jc.clearance.Backlash(1e-3, slide=0.2)),
    ("give its play the pitch_radius", lambda: one_way(worn_play(pitch_radius=None))),
    ("leave its pitch_radius out", lambda: held(worn_play())),
    ("rigid or seated", lambda: jc.simulate(one_way(worn_play()), 0.1, integrator=MoreauJean())),
    # guides in the plane
    ('joint "G" is a SliderGuide whose axis .* must lie in', lambda: guided()),
    ('joint "G" is a SliderGuide whose axis .* must lie in', lambda: guided(axis=(1.0, 0.0, 1.0))),
]
RIGS = {"pin": jc.Connection(TURN, "ground", "arm")}


def with_rotor(mechanism, joint="elbow"):
    return mechanism.with_loads({"rotor": jc.load.RotorInertia(joint, 0.1)})


def sampled_by_saves():
    """A run of a sampled servo whose steps are a share of saving times."""
    steps = jc.integrator.FixedStep(steps_per_save=10)
    return jc.simulate(served(Servo("A", 0.3, 200.0, period=0.01)), 1.0, integrator=steps)


def both_driven():
    driven = geared().with_loads({}).with_joint("A", TURNING)
    return driven.with_joint("B", TURNING)


@pytest.mark.parametrize(("sentence", "build"), REFUSED, ids=[row[0] for row in REFUSED])
def test_what_cannot_be_is_refused(sentence, build):
    with pytest.raises(ValueError, match=sentence):
        build()


RUN_READINGS = [
    ('no body "leg" in this mechanism; there is "arm"', lambda run: run.body("leg")),
    ('no clearance joint "pin"', lambda run: run.contact("pin")),
    ('no joint "hip"', lambda run: run.reaction("hip")),
    ('no joint or floating body "hip"', lambda run: run.coordinate("hip")),
    ('"bearing" of joint "pin" does not wear', lambda run: run.worn_volume("pin", "bearing")),
    ("balance=True", lambda run: run.energy_balance()),
]


def test_a_run_is_asked_for_what_it_has():
    """Its motion under a torque by one number, about z: 2 rad/s^2, exact for the integrator."""
    run = jc.simulate(rig(loads={"motor": jc.load.Torque(marker(), 2e-2)}), 0.1, save=2)
    np.testing.assert_allclose(run.speed("pin")[-1], 0.2, rtol=1e-9)
    for sentence, read in RUN_READINGS:
        with pytest.raises(ValueError, match=sentence):
            read(run)


def test_traced_numbers_are_not_checked():
    """A mechanism may be built inside a traced function: values are unknown there, structure is
    checked all the same."""

    def mass_of(mass):
        return rig(Journal(LAW, clearance=mass * 1e-4), body=arm(mass=mass)).bodies["arm"].mass

    assert jax.grad(mass_of)(-1.0) == 1.0
    with pytest.raises(ValueError, match='refers to body "leg"'):
        jax.jit(lambda mass: rig(child="leg", body=arm(mass=mass)).bodies["arm"].mass)(jnp.ones(()))
