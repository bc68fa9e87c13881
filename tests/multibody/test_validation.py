"""Every sentence that refuses a mechanism or a run is tripped once, and names the culprit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.laws.stiffness import Shape
from jaxclear.multibody.assembly import ready

NAN = float("nan")
Bearing, Journal, Guide = (
    jc.clearance.PlanarJournalBearing,
    jc.clearance.JournalBearing,
    jc.clearance.SliderGuide,
)
Socket = jc.clearance.BallSocket
LAW = jc.contact.Hertz()


def arm(**changes):
    return jc.Body(**({"mass": 1.0, "inertia": (1e-2, 1e-2, 1e-2)} | changes))


def rig(
    joint=None, *, body=None, loads=None, parent="ground", child="arm", at=None, axis="z", **changes
):
    """One body "arm" held to the ground by one joint "pin"."""
    pin = jc.Connection(
        jc.joint.Revolute() if joint is None else joint, parent, child, at=at, axis=axis
    )
    return jc.Mechanism({"arm": arm() if body is None else body}, {"pin": pin}, loads, **changes)


def four_bar(
    joint=jc.joint.Revolute, places=2, last=(0.4, 0.0, 0.0), drives=(), inertia=None, **changes
):
    """Crank, coupler and rocker; `places` numbers each, all joints alike."""
    corner = lambda *x: tuple(x[:places]) if places == 2 else x
    inertia = inertia or (1e-2 if places == 2 else (1e-2, 1e-2, 1e-2))
    drive = {name: jc.drive.ConstantSpeed(1.0) for name in drives}
    make = lambda name: joint(drive=drive[name]) if name in drive else joint()
    return jc.Mechanism(
        {name: jc.Body(1.0, inertia) for name in ("crank", "coupler", "rocker")},
        {
            "O": jc.Connection(make("O"), "ground", "crank"),
            "A": jc.Connection(make("A"), "crank", "coupler", at=corner(0.1, 0.0, 0.0)),
            "B": jc.Connection(make("B"), "coupler", "rocker", at=corner(0.4, 0.0, 0.0)),
            "D": jc.Connection(
                make("D"), "ground", jc.Marker("rocker", corner(0.3, 0.0, 0.0)), at=corner(*last)
            ),
        },
        guess=None if drives else {"O": 1.0, "A": -0.6},
        **changes,
    )


def marker(body="arm", **changes):
    return jc.Marker(body, **changes)


MECHANISMS = {
    # names and types
    "no bodies": (lambda: jc.Mechanism({}, {}), "at least one body"),
    "bodies without names": (lambda: jc.Mechanism([arm()], {}), "bodies is .* dictionary"),
    "no connections": (lambda: jc.Mechanism({"arm": arm()}, None), "connections is None"),
    "body called ground": (
        lambda: jc.Mechanism({"ground": arm()}, {}),
        '"ground" is the fixed frame',
    ),
    "body of another kind": (lambda: rig(body=3.0), 'body "arm" is 3.0'),
    "connection of another kind": (
        lambda: jc.Mechanism({"arm": arm()}, {"pin": "Revolute"}),
        'joint "pin" is',
    ),
    "joint of another kind": (
        lambda: rig("Revolute"),
        "Connection has joint = 'Revolute'.* such as jaxclear.joint.Revolute",
    ),
    "joint's class": (
        lambda: rig(jc.joint.Revolute),
        "Connection has joint = the class Revolute; .* build one",
    ),
    "unknown body": (lambda: rig(child="leg"), 'joint "pin" refers to body "leg"'),
    "joined to itself": (lambda: rig(parent="arm"), 'joint "pin" joins "arm" to itself'),
    "out of reach": (
        lambda: jc.Mechanism(
            {"arm": arm(), "leg": arm()},
            {"pin": jc.Connection(jc.joint.Revolute(), "ground", "arm")},
        ),
        "no chain of joints .* 'leg'",
    ),
    "load of another kind": (lambda: rig(loads={"g": 9.81}), 'load "g" is 9.81'),
    "load on unknown body": (
        lambda: rig(loads={"f": jc.load.Force(marker("leg"), (1, 0))}),
        'load "f" .* "leg"',
    ),
    "load on unknown connection": (
        lambda: rig(loads={"m": jc.load.JointTorque("hip", 1.0)}),
        'no joint "hip" for load "m"',
    ),
    "coordinate load on three coordinates": (
        lambda: rig(jc.joint.Spherical(), loads={"m": jc.load.JointTorque("pin", 1.0)}),
        'load "m" .* "pin"',
    ),
    "coordinate load on a driven joint": (
        lambda: rig(
            jc.joint.Revolute(drive=jc.drive.ConstantSpeed(1.0)),
            loads={"m": jc.load.JointTorque("pin", 1.0)},
        ),
        'load "m" .* "pin", whose coordinate is driven',
    ),
    "coordinate load on a ball with clearance": (
        lambda: rig(jc.clearance.BallSocket(LAW), loads={"m": jc.load.JointTorque("pin", 1.0)}),
        'load "m" .* "pin", which must have one, .* it has 4',
    ),
    "two gravities": (
        lambda: rig(loads={"g": jc.load.Gravity(), "h": jc.load.Gravity()}),
        "more than one load.Gravity",
    ),
    "stabilisation by name": (lambda: rig(stabilisation="none"), "stabilisation is 'none'"),
    # slots
    "no contact law": (lambda: rig(Journal(None)), "JournalBearing has contact = None"),
    "contact law's class": (
        lambda: rig(Journal(jc.contact.Hertz)),
        "JournalBearing has contact = the function Hertz.* call it",
    ),
    "laws exchanged": (
        lambda: rig(Journal(jc.friction.Dahl(), LAW)),
        "JournalBearing has contact = a Dahl",
    ),
    "friction by number": (lambda: rig(Socket(LAW, 0.1)), "BallSocket has friction = 0.1"),
    "wear law without a map": (
        lambda: rig(Bearing(LAW, bearing_wear=jc.wear.Archard())),
        "PlanarJournalBearing has bearing_wear = an Archard",
    ),
    "drive by number": (
        lambda: rig(jc.joint.Revolute(drive=10.0)),
        "Revolute has drive = 10.0",
    ),
    "collar's law": (
        lambda: rig(Journal(LAW, flange=jc.clearance.Flange("steel"))),
        "Flange has contact = .steel.",
    ),
    "clearance left out": (
        lambda: rig(Journal(LAW, clearance=None)),
        "JournalBearing has clearance = None",
    ),
    "force on a name": (
        lambda: rig(loads={"f": jc.load.Force("arm", (1, 0))}),
        "load.Force has marker = .arm.; it must be a jaxclear.Marker",
    ),
    "spring from a name": (
        lambda: rig(loads={"s": jc.load.Spring("arm", marker())}),
        "load.Spring has start = .arm.",
    ),
    # numbers
    "mass": (lambda: rig(body=arm(mass=0.0)), "Body has mass = 0 kg; it must be above 0"),
    "mass not a number": (lambda: rig(body=arm(mass=NAN)), "Body has mass = nan"),
    "mass without bound": (lambda: rig(body=arm(mass=np.inf)), "Body has mass = inf"),
    "planar inertia": (lambda: rig(body=arm(inertia=-1.0)), "Body has inertia -1.0"),
    "inertia not definite": (
        lambda: rig(body=arm(inertia=(1, 1, 1, 2, 0, 0))),
        "Body .* positive definite",
    ),
    "inertia of no body": (
        lambda: rig(body=arm(inertia=(1, 1, 3))),
        "Body .* larger than the sum",
    ),
    "inertia not a number": (
        lambda: rig(body=arm(inertia=(NAN, 1, 1))),
        r"Body has inertia\[0\] = nan",
    ),
    "centre of four": (
        lambda: rig(body=arm(com=(0, 0, 0, 0))),
        r"Body has com = \(.*; it must be 2 or 3 numbers",
    ),
    "place not a number": (
        lambda: rig(at=(NAN, 0, 0)),
        r"Marker has at\[0\] = nan m; it must be finite",
    ),
    "force not a number": (
        lambda: rig(loads={"f": jc.load.Force(marker(), (NAN, 0))}),
        r"load.Force has value\[0\] = nan N",
    ),
    "no clearance": (
        lambda: rig(Bearing(LAW, clearance=0.0)),
        "PlanarJournalBearing has clearance = 0 m",
    ),
    "negative clearance": (
        lambda: rig(Socket(LAW, clearance=-1e-4)),
        "clearance.BallSocket has clearance = -0.0001 m",
    ),
    "clearance below rounding": (
        lambda: rig(Journal(LAW, clearance=1e-20)),
        'joint "pin": .* does not fit',
    ),
    "bearing within its clearance": (
        lambda: rig(Journal(LAW, bearing_radius=1e-5)),
        "JournalBearing has bearing_radius",
    ),
    "socket within its clearance": (
        lambda: rig(Socket(LAW, socket_radius=1e-5)),
        "BallSocket has socket_radius",
    ),
    "guide within its clearance": (lambda: rig(Guide(LAW, width=1e-5)), "SliderGuide has width"),
    "corner without radius": (
        lambda: rig(Guide(LAW, corner_radius=0.0)),
        "has corner_radius = 0 m",
    ),
    "bearing without length": (
        lambda: rig(Bearing(LAW, length=0.0)),
        "PlanarJournalBearing has length = 0 m",
    ),
    "short journal": (
        lambda: rig(Journal(LAW, length=2e-2, journal_length=1e-2)),
        "JournalBearing has a journal of length 0.01",
    ),
    "line law in a socket": (lambda: rig(Socket(jc.contact.Johnson())), 'joint "pin": .* length'),
    # starts
    "start of nothing": (
        lambda: rig(start={"hip": 1.0}),
        'start names "hip", which carries no coordinates',
    ),
    "speed of a joint without coordinates": (
        lambda: rig(jc.joint.Fixed(), speeds={"pin": 1.0}),
        'speeds names "pin", whose motion is prescribed or fixed',
    ),
    "start of a drive": (
        lambda: rig(jc.joint.Revolute(drive=jc.drive.ConstantSpeed(1.0)), start={"pin": 1.0}),
        'start names "pin", whose motion is prescribed',
    ),
    "start not a number": (lambda: rig(start={"pin": NAN}), "start.*pin.* = nan"),
    "start without rotation": (
        lambda: rig(jc.joint.Spherical(), start={"pin": (0, 0, 0, 0)}),
        'start of "pin" ends in a quaternion',
    ),
    "all joints of a loop driven": (
        lambda: four_bar(drives="OABD"),
        'joint "." is driven but closes a loop',
    ),
}


@pytest.mark.parametrize("mistake", MECHANISMS)
def test_mechanism_refuses(mistake):
    build, sentence = MECHANISMS[mistake]
    with pytest.raises(ValueError, match=sentence):
        build()


PARTS = {
    "inertia of two": (lambda: jc.Body(1.0, (1, 1)), "Body has inertia = .* it must be 1 number"),
    "centre by one number": (lambda: arm(com=0.3), "Body has com = 0.3; it must be 2 or 3"),
    "mass by text": (lambda: arm(mass="heavy"), "Body has mass = 'heavy'; it must be one number"),
    "mass by array": (lambda: arm(mass=np.ones(3)), r"Body has mass = an array of shape \(3,\)"),
    "axis by another name": (lambda: marker(axis="up"), 'axis of a marker on "arm" is .up.'),
    "axis of four": (lambda: marker(axis=(0, 1, 0, 0)), "Marker has axis = .*; it must be 2 or 3"),
    "axis of no length": (lambda: marker(axis=(0, 0, 0)), 'axis of a marker on "arm" is zero'),
    "axis along -z by numbers": (
        lambda: marker(axis=(0, 0, -2.0)),
        '"arm" points along -z.*axis="-z"',
    ),
    "quaternion of zeros": (
        lambda: marker(quaternion=(0, 0, 0, 0)),
        'quaternion of a marker on "arm" is zero',
    ),
    "quaternion of three": (
        lambda: marker(quaternion=(1, 0, 0)),
        "Marker has quaternion = .*; it must be 4 numbers",
    ),
    "quaternion beside an axis": (
        lambda: marker(quaternion=(1, 0, 0, 0), axis="x"),
        '"arm" takes a quaternion .* not both',
    ),
    "place of four": (lambda: marker(at=(0, 0, 0, 0)), "Marker has at = .*; it must be 2 or 3"),
    "place beside a marker": (
        lambda: jc.Connection(jc.joint.Revolute(), marker(), "leg", at=(1, 0)),
        '"arm" gives `at` beside',
    ),
    "few cells": (lambda: jc.Wearing(jc.wear.Archard(), cells=(3, 1)), "at least 4 cells"),
    "cells one and a half wide": (
        lambda: jc.Wearing(jc.wear.Archard(), coarseness=1.5),
        "coarseness of a Wearing must be 1 or 2",
    ),
    "half cells": (lambda: jc.Wearing(jc.wear.Archard(), cells=(12.5, 1)), "whole numbers"),
    "wear by another law": (lambda: jc.Wearing(LAW), "Wearing has law = .* one of jaxclear.wear"),
    "ramp of no duration": (
        lambda: jc.drive.RampUp(1.0, 0.0),
        "drive.RampUp has duration = 0 s; it must be above 0",
    ),
    "force by one number": (
        lambda: jc.load.Force(marker(), 5.0),
        "load.Force has value = 5.0; it must be 2 or 3",
    ),
    "force by one number of JAX": (
        lambda: jc.load.Force(marker(), jnp.asarray(5.0)),
        "load.Force has value = 5.0; it must be 2 or 3",
    ),
    "force of four": (
        lambda: jc.load.Force(marker(), (1, 0, 0, 0)),
        "load.Force has value = .*; it must be 2 or 3",
    ),
    "torque of two": (
        lambda: jc.load.Torque(marker(), (1, 0)),
        "load.Torque has value = .*; it must be 1 or 3",
    ),
    "gravity by one number": (
        lambda: jc.load.Gravity(9.81),
        "load.Gravity has acceleration = 9.81",
    ),
    "journal that does not fit": (lambda: Shape(1e-2, 1e-2), "does not fit"),
    "method": (
        lambda: jc.integrator.FixedStep(method="magic"),
        'no fixed-step method "magic"; there are',
    ),
    "step": (lambda: jc.integrator.FixedStep(step=0.0), "integrator.FixedStep has step = 0 s"),
    "tolerance": (
        lambda: jc.integrator.Adaptive(atol=0.0),
        "integrator.Adaptive has atol = 0",
    ),
    "negative tolerance": (
        lambda: jc.integrator.Adaptive(rtol=-1e-3),
        "integrator.Adaptive has rtol = -0.001",
    ),
}


@pytest.mark.parametrize("mistake", PARTS)
def test_part_refuses(mistake):
    build, sentence = PARTS[mistake]
    with pytest.raises(ValueError, match=sentence):
        build()


def over_driven():
    turning = jc.joint.Revolute(drive=jc.drive.ConstantSpeed(1.0))
    held = jc.Connection(
        jc.joint.Spherical(), "ground", marker(at=(0.0, 0.0, 0.1)), at=(0.0, 0.0, 0.1)
    )
    return jc.Mechanism(
        {"arm": arm()}, {"pin": jc.Connection(turning, "ground", "arm"), "tip": held}
    )


def out_of_reach():
    ends = jc.Connection(Bearing(LAW), "ground", marker(at=(0.3, 0.0)), at=(0.5, 0.0))
    return jc.Mechanism(
        {"arm": arm(inertia=1.0)},
        {"pin": jc.Connection(jc.joint.Revolute(), "ground", "arm"), "B": ends},
    )


STARTS = {
    "coordinates": (
        lambda: rig(start={"pin": (1.0, 2.0)}),
        'start of "pin" needs 1 number',
    ),
    "speeds": (lambda: rig(speeds={"pin": (1.0, 2.0)}), 'speeds of "pin" need 1 number, not 2'),
    "loop that cannot close": (
        lambda: four_bar(last=(3.0, 0.0, 0.0)),
        'loop through joint "." cannot be closed',
    ),
    "journal out of reach": (out_of_reach, 'journal of joint "B" cannot be brought to the middle'),
    "flat body in space": (
        lambda: rig(jc.joint.Spherical(), body=arm(inertia=1.0)),
        'body "arm" has an inertia about its z axis only',
    ),
}


@pytest.mark.parametrize("mistake", STARTS)
def test_start_refuses(mistake):
    build, sentence = STARTS[mistake]
    with pytest.raises(ValueError, match=sentence):
        jc.assemble(build())


RUNS = {
    "duration": ({"duration": 0.0}, "duration is 0.0; it must be"),
    "endless": ({"duration": np.inf}, "duration is inf"),
    "no time": ({"duration": NAN}, "duration is nan"),
    "one save": ({"save": 1}, "save=1: .* at least 2"),
    "part of a save": ({"save": 2.5}, "save=2.5: .* whole number"),
    "save by text": ({"save": "all"}, "save='all'"),
    "backward saves": ({"save": [0.0, 0.5, 0.4]}, "must increase"),
    "late saves": ({"save": [0.0, 2.0]}, "must increase from 0 or later to at most the duration"),
    "early saves": ({"save": [-1.0, 0.5]}, "must increase"),
    "saves that are no number": ({"save": [0.1, NAN, 0.5]}, "must increase"),
    "integrator by name": ({"integrator": "rk4"}, "integrator is 'rk4'"),
}


@pytest.mark.parametrize("mistake", RUNS)
def test_run_refuses(mistake):
    changes, sentence = RUNS[mistake]
    with pytest.raises(ValueError, match=sentence):
        jc.simulate(rig(), **({"duration": 1.0} | changes))


def test_compliant_run_refuses_set_valued_friction():
    with pytest.raises(ValueError, match='joint "pin" has set-valued friction Coulomb'):
        jc.simulate(rig(Bearing(LAW, jc.friction.Coulomb()), body=arm(inertia=1.0)), 1.0)


ASKED = {
    "body": (lambda run: run.body("leg"), 'no body "leg" in this mechanism; there is "arm"'),
    "contact": (lambda run: run.contact("pin"), 'no clearance joint "pin"'),
    "reaction": (lambda run: run.reaction("hip"), 'no joint "hip"'),
    "coordinate": (lambda run: run.coordinate("hip"), 'no joint or floating body "hip"'),
    "worn volume": (
        lambda run: run.worn_volume("pin", "bearing"),
        'surface "bearing" of joint "pin" does not wear',
    ),
    "energies": (lambda run: run.energy_balance(), "balance=True"),
}


@pytest.fixture(scope="module")
def trajectory():
    return jc.simulate(rig(), 0.1, save=3)


@pytest.mark.parametrize("question", ASKED)
def test_trajectory_refuses(question, trajectory):
    ask, sentence = ASKED[question]
    with pytest.raises(ValueError, match=sentence):
        ask(trajectory)


@pytest.mark.filterwarnings("ignore:guess=.* has led to")
@pytest.mark.parametrize(
    ("build", "rows"),
    [
        (lambda: four_bar(places=3), {"z", "x.z", "y.z"}),
        (lambda: four_bar(places=2, inertia=(1e-2,) * 3), {"z", "x.z", "y.z"}),
        (over_driven, {"x", "y", "z"}),
    ],
    ids=["planar loop in space", "its places two numbers each", "held and driven"],
)
def test_rows_that_follow_from_others_are_found(build, rows):
    found = ready(build())[0].topology.redundancy
    assert {name for _, name in found.rows} == rows
    assert {*"OABD"} & {*build().connections} <= {*found.joints}


def test_singular_position_is_no_superfluous_joint():
    """A stretched parallelogram has dependent rows there only; none of them is redundant, and
    the user is told."""
    stretched = jc.Mechanism(
        {name: jc.Body(1.0, 1e-2) for name in ("crank", "coupler", "rocker")},
        {
            "O": jc.Connection(jc.joint.Revolute(), "ground", "crank"),
            "A": jc.Connection(jc.joint.Revolute(), "crank", "coupler", at=(0.1, 0.0)),
            "B": jc.Connection(jc.joint.Revolute(), "coupler", "rocker", at=(0.3, 0.0)),
            "D": jc.Connection(
                jc.joint.Revolute(), "ground", jc.Marker("rocker", (-0.1, 0.0)), at=(0.3, 0.0)
            ),
        },
    )
    with pytest.warns(UserWarning, match="links in one line"):
        assert ready(stretched)[0].topology.redundancy is None


def test_traced_numbers_are_not_checked():
    """A mechanism may be built inside a traced function: values are unknown there, structure is
    checked all the same.
    """

    def mass_of(mass):
        return rig(Journal(LAW, clearance=mass * 1e-4), body=arm(mass=mass)).bodies["arm"].mass

    assert jax.grad(mass_of)(-1.0) == 1.0
    with pytest.raises(ValueError, match='refers to body "leg"'):
        jax.jit(lambda mass: rig(child="leg", body=arm(mass=mass)).bodies["arm"].mass)(jnp.ones(()))


def test_torque_by_one_number_acts_about_z():
    spun = rig(loads={"motor": jc.load.Torque(marker(), 2e-2)})
    end = jc.simulate(spun, 0.1, save=2)
    # constant acceleration of 2 rad/s2 is exact for the integrator
    np.testing.assert_allclose(end.speed("pin")[-1], 0.2, rtol=1e-9)


def test_an_axis_beside_two_markers_is_refused():
    ends = jc.Marker("ground"), jc.Marker("arm")
    with pytest.raises(ValueError, match="put the axis into the markers"):
        jc.Connection(jc.joint.Prismatic(), *ends, axis="x")
