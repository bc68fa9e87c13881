"""Couplings of bodies against closed forms: gear pairs, planetary sets, racks, belts, screws, and
what their bearings carry."""

import warnings
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.components.coupling import AbstractBodyCoupling
from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import Pose
from jaxclear.multibody.meshes import Count, Mesh
from tests.rigs.cells import slow, slow_but
from tests.rigs.planetary import PLANET, RING, SUN, planetary_accelerations
from tests.rigs.planetary import planetary as tied

TURN = jc.joint.Revolute()
J_A, J_B, R_A, R_B = 1e-4, 2e-3, 0.02, 0.06
DRIVING, LOAD = 0.2, -0.3
TEETH = np.radians(20.0)
STEPS = jc.integrator.FixedStep(1e-3)


def pair(coupling, distance=R_A + R_B, axes=("z", "z"), joints=(TURN, TURN), turned_round=False):
    """Two shafts on the ground, under torques, coupled."""
    places = [
        jc.Marker("ground", (x, 0.0, 0.0), axis=a)
        for x, a in zip((0.0, distance), axes, strict=True)
    ]
    own = [jc.Marker(body, axis=a) for body, a in zip("ab", axes, strict=True)]
    ends = list(zip(places, own, strict=True))
    if turned_round:
        ends[1] = ends[1][::-1]
    return jc.Mechanism(
        {"a": jc.Body(0.3, (J_A,) * 3), "b": jc.Body(1.0, (J_B,) * 3)},
        {n: jc.Connection(j, *e) for n, j, e in zip("AB", joints, ends, strict=True)},
        {"m": jc.load.JointTorque("A", DRIVING), "l": jc.load.JointTorque("B", LOAD)},
        couplings={"mesh": coupling},
    )


RATIO = R_B / R_A
# (coupling, distance of the axes, turns of b for one of a)
PAIRS = {
    "gear": (jc.coupling.Gear("A", "B", RATIO), R_A + R_B, -1 / RATIO),
    "involutes": (jc.coupling.Gear("A", "B", RATIO, pressure_angle=TEETH), 0.08, -1 / RATIO),
    "ring": (jc.coupling.Gear("A", "B", RATIO, internal=True), R_B - R_A, 1 / RATIO),
    "ring first": (jc.coupling.Gear("A", "B", 1 / RATIO, internal=True), R_B - R_A, RATIO),
    "belt": (jc.coupling.Belt("A", "B", R_A, R_B), 0.3, 1 / RATIO),
    "crossed": (jc.coupling.Belt("A", "B", R_A, R_B, crossed=True), 0.3, -1 / RATIO),
}


def assert_bearing_carries(run, pressure_angle):
    """Wheel a's bearing carries the force on the line of action; b lies at positive x."""
    force, load = run.transmitted("mesh"), np.asarray(run.reaction("A").force)
    np.testing.assert_allclose(np.linalg.norm(load, axis=1), np.abs(force), rtol=1e-9)
    # pressed apart, the bearing holds wheel a towards b
    apart = np.sign(force * pressure_angle) * np.abs(force) * np.sin(abs(pressure_angle))
    np.testing.assert_allclose(load[:, 0], apart, rtol=1e-9)
    np.testing.assert_allclose(run.reaction("mesh").force, load, rtol=1e-9, atol=1e-9)


SLOW = pytest.mark.slow
SHORT = ("involutes",)  # the others differ from this by a sign or a radius


@pytest.mark.parametrize("name", slow_but(SHORT, PAIRS))
def test_wheels_turn_by_their_ratio(name):
    coupling, distance, share = PAIRS[name]
    run = jc.simulate(pair(coupling, distance), 0.4, save=5, balance=True, integrator=STEPS)
    wanted = (DRIVING + LOAD * share) / (J_A + J_B * share**2)
    angle = 0.5 * wanted * np.asarray(run.time) ** 2
    # up to 12 turns, a parabola is exact for the integrator: rounding, over angles of 70 rad
    np.testing.assert_allclose(run.coordinate("A"), angle, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(run.coordinate("B"), share * angle, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(run.energy_balance().error, 0.0, atol=1e-9)
    np.testing.assert_allclose(run.drift()["mesh"], 0.0, atol=1e-12)
    assert run.warnings == ()
    # the torque on a, by the radius where the force acts
    torque = J_A * wanted - DRIVING
    radius = {"involutes": R_A * np.cos(TEETH), "ring first": R_B}.get(name, R_A)
    np.testing.assert_allclose(run.transmitted("mesh"), torque / radius, rtol=1e-11)
    if name == "involutes":
        assert_bearing_carries(run, TEETH)


@pytest.mark.parametrize("turned_round", [False, *slow(True)])
def test_axes_that_point_opposite_ways_mesh_alike(turned_round):
    gear = jc.coupling.Gear("A", "B", RATIO, pressure_angle=-TEETH)
    rig = pair(gear, axes=("z", "-z"), turned_round=turned_round)
    run = jc.simulate(rig, 0.2, save=3, integrator=STEPS)
    a, b = np.asarray(run.coordinate("A")), run.coordinate("B")
    share = (-1 if turned_round else 1) / RATIO
    np.testing.assert_allclose(b, share * a, rtol=1e-12, atol=1e-12)
    assert abs(a[-1]) > 1.0
    assert_bearing_carries(run, -TEETH)


def planetary(teeth=None):
    """With one planet that meshes with sun and ring."""
    gear = jc.coupling.Gear
    inner = gear("S", "P", PLANET / SUN, pressure_angle=teeth)
    outer = gear("P", "R", RING / PLANET, internal=True, pressure_angle=teeth)
    return tied({"inner": inner, "outer": outer})


@pytest.mark.parametrize("teeth", [*slow(None), TEETH])
def test_a_planetary_set_turns_as_willis_says(teeth):
    run = jc.simulate(planetary(teeth=teeth), 0.3, save=4, balance=True, integrator=STEPS)
    turns = 0.5 * planetary_accelerations()[:, None] * np.asarray(run.time) ** 2
    found = np.array([run.coordinate(n) for n in "SC"])
    # constant accelerations, over up to 30 turns: rounding and what drift the loops have
    np.testing.assert_allclose(found, turns, rtol=1e-9, atol=1e-9)
    s, c, r = (np.asarray(run.coordinate(n))[1:] for n in "SCR")
    np.testing.assert_allclose((r - c) / (s - c), -SUN / RING, rtol=1e-9)
    np.testing.assert_allclose(run.energy_balance().error, 0.0, atol=1e-9)
    assert run.warnings == ()


def rack_rig(coupling, side=1.0):
    """A pinion on the ground and a rack that slides along y beside it."""
    return jc.Mechanism(
        {"pinion": jc.Body(0.3, (J_A,) * 3), "bar": jc.Body(0.5, (1e-3,) * 3)},
        {
            "A": jc.Connection(TURN, "ground", "pinion"),
            "S": jc.Connection(
                jc.joint.Prismatic(),
                jc.Marker("ground", (side * R_A, 0.03, 0.0), axis="y"),
                jc.Marker("bar", axis="y"),
            ),
        },
        {"m": jc.load.JointTorque("A", DRIVING)},
        couplings={"teeth": coupling},
    )


@pytest.mark.parametrize(
    ("teeth", "side"), [(TEETH, 1.0), (-TEETH, -1.0), pytest.param(None, -1.0, marks=SLOW)]
)
def test_a_rack_goes_as_its_pinion_rolls(teeth, side):
    rig = rack_rig(jc.coupling.Rack("A", "S", R_A, pressure_angle=teeth), side)
    run = jc.simulate(rig, 0.2, save=5, balance=True, integrator=STEPS)
    wanted = DRIVING / (J_A + 0.5 * R_A**2)
    angle = 0.5 * wanted * np.asarray(run.time) ** 2
    np.testing.assert_allclose(run.coordinate("A"), angle, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(run.coordinate("S"), side * R_A * angle, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(run.energy_balance().error, 0.0, atol=1e-9)
    push = side * 0.5 * R_A * wanted
    cosine = 1.0 if teeth is None else np.cos(teeth)
    np.testing.assert_allclose(run.transmitted("teeth"), push / cosine, rtol=1e-11)
    apart = 0.0 if teeth is None else np.tan(teeth) * push * side
    # the bearing holds the pinion against what presses it from the rack
    force = np.asarray(run.reaction("A").force)[0]
    np.testing.assert_allclose(force, (apart, push, 0.0), atol=1e-10)


def press(lead=0.005):
    """A nut that slides and a spindle that turns, on one thread that a cylindrical joint guides."""
    return jc.Mechanism(
        {"spindle": jc.Body(1.0, (2e-4, 2e-4, 3e-4)), "nut": jc.Body(2.0, (1e-3,) * 3)},
        {
            "turn": jc.Connection(TURN, "ground", "spindle"),
            "slide": jc.Connection(jc.joint.Prismatic(), "ground", "nut"),
            "guide": jc.Connection(jc.joint.Cylindrical(), "spindle", "nut"),
        },
        {"g": jc.load.Gravity((0.0, 0.0, -9.81)), "t": jc.load.JointTorque("turn", 0.05)},
        couplings={"thread": jc.coupling.Screw("guide", lead)},
    )


@pytest.mark.parametrize("lead", [0.005, *slow(-0.02)])
def test_a_screw_press_falls_as_its_formula(lead):
    run = jc.simulate(press(lead), 0.5, save=6, balance=True, integrator=STEPS)
    # the nut turns by minus the spindle's turn on it
    pitch = -lead / (2 * np.pi)
    turned = (0.05 - 2.0 * 9.81 * pitch) / (3e-4 + 2.0 * pitch**2)
    angle = 0.5 * turned * np.asarray(run.time) ** 2
    assert angle[-1] > 8 * np.pi or lead < 0
    np.testing.assert_allclose(run.coordinate("turn"), angle, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(run.coordinate("slide"), pitch * angle, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(run.energy_balance().error, 0.0, atol=1e-9)
    force = 2.0 * (9.81 + pitch * turned)
    np.testing.assert_allclose(run.transmitted("thread"), force, rtol=1e-9)
    np.testing.assert_allclose(run.reaction("thread").force[:, 2], force, rtol=1e-9)


JOURNAL = jc.clearance.PlanarJournalBearing(
    jc.contact.LankaraniNikravesh(restitution=0.9, stiffness=1e11), clearance=5e-5
)


@pytest.mark.parametrize("loose", ["B", *slow("AB")])
def test_a_bearing_with_clearance_feels_the_teeth(loose):
    """The journal goes to the wall where the force presses it, and wheels roll on the teeth."""
    gear = jc.coupling.Gear("A", "B", RATIO, pressure_angle=-TEETH)
    rig = jc.Mechanism(
        {"a": jc.Body(0.3, J_A), "b": jc.Body(1.0, J_B)},
        {
            "A": jc.Connection(JOURNAL if "A" in loose else TURN, "ground", "a"),
            "B": jc.Connection(JOURNAL, jc.Marker("ground", (R_A + R_B, 0.0)), jc.Marker("b")),
        },
        # balanced torques, so that the force is steady
        {
            "m": jc.load.JointTorque("A", DRIVING),
            "l": jc.load.JointTorque("B", DRIVING * RATIO),
            "da": jc.load.JointSpring("A", damping=1e-3),
        },
        speeds={"A": 3.0} if loose == "B" else None,
        couplings={"mesh": gear},
    )
    run = jc.simulate(rig, 1.0, save=101, integrator=jc.integrator.ImplicitStep(1e-4))
    late = slice(-20, None)
    offset = np.asarray(run.contact("B").offset)[late]
    force = np.asarray(run.contact("B").force)[late].mean(axis=0)
    # what the teeth press is held by the bearing
    pressed = DRIVING / (R_A * np.cos(TEETH))
    np.testing.assert_allclose(np.linalg.norm(force), pressed, rtol=0.02)
    np.testing.assert_allclose(np.linalg.norm(offset, axis=1), 5e-5, rtol=0.05)
    # offset and force lie along the line of action, against each other
    along = offset.mean(axis=0)
    along /= np.linalg.norm(along)
    np.testing.assert_allclose(along, -force / np.linalg.norm(force), atol=0.02)
    np.testing.assert_allclose(abs(along[0]), np.sin(TEETH), atol=0.02)
    assert float(run.drift()["mesh"].max()) < 1e-7


def test_derivatives_pass_through_gears():
    def end(ratio):
        rig = pair(jc.coupling.Gear("A", "B", ratio, pressure_angle=TEETH))
        return jc.simulate(rig, 0.1, save=2, integrator=STEPS).coordinate("A")[-1]

    share = -1 / RATIO
    above, below = DRIVING + LOAD * share, J_A + J_B * share**2
    slope = 0.5 * 0.1**2 * (LOAD * below - above * 2 * J_B * share) / below**2
    exact = slope / RATIO**2
    np.testing.assert_allclose(jax.jvp(end, (RATIO,), (1.0,))[1], exact, rtol=1e-9)


@pytest.mark.slow(sample=False)
def test_derivatives_go_backwards_through_gears_and_screws():
    def end(distance):
        rig = pair(jc.coupling.Gear("A", "B", RATIO, pressure_angle=TEETH), distance)
        run = jc.simulate(rig, 0.1, save=2, integrator=STEPS)
        return run.transmitted("mesh")[-1]

    share = -1 / RATIO
    wanted = (DRIVING + LOAD * share) / (J_A + J_B * share**2)
    exact = -(J_A * wanted - DRIVING) / (R_A * np.cos(TEETH)) / (R_A + R_B)
    # the force is as the radius, hence as the distance of the axes
    np.testing.assert_allclose(jax.grad(end)(jnp.asarray(R_A + R_B)), exact, rtol=1e-9)

    def sunk(lead):
        return jc.simulate(press(lead), 0.1, save=2, integrator=STEPS).coordinate("slide")[-1]

    def closed(lead):
        pitch = -lead / (2 * jnp.pi)
        turned = (0.05 - 2.0 * 9.81 * pitch) / (3e-4 + 2.0 * pitch**2)
        return pitch * 0.5 * turned * 0.1**2

    np.testing.assert_allclose(jax.jvp(sunk, (0.02,), (1.0,))[1], jax.grad(closed)(0.02), rtol=1e-9)


MEMBERS = [
    jc.coupling.Gear("A", "B", 2.5),
    jc.coupling.Gear("A", "B", 2.5, pressure_angle=-0.3),
    jc.coupling.Gear("A", "B", 2.5, pressure_angle=0.3, internal=True),
    jc.coupling.Belt("A", "B", 0.02, 0.05),
    jc.coupling.Belt("A", "B", 0.02, 0.05, crossed=True),
    jc.coupling.Rack("A", "B", 0.02),
    jc.coupling.Rack("A", "B", 0.02, pressure_angle=0.3),
]


@pytest.mark.parametrize("coupling", MEMBERS, ids=str)
def test_a_frame_that_turns_with_both_parts_feels_nothing(coupling):
    """Forces of a mesh are in balance on its two parts alone: what is read is their relative pose,
    and all of it lies on one line of action."""
    from jaxclear.multibody.meshes import Mesh
    from jaxclear.multibody.pose_rows import gradients

    rack = isinstance(coupling, jc.coupling.Rack)
    rotation = jc.pose.AXES["y"] if rack else sp.IDENTITY
    drawn = sp.dense(Pose(rotation, (0.02 if rack else 0.09, 0.0, 0.0)))
    reading = Mesh(coupling, drawn, (None,) * len(coupling.angles(drawn)))
    moved = Pose(jc.pose.rotation_z(0.3), (1e-4, -2e-4, 0.0)).after(drawn)
    (residual,), (slope,) = gradients(reading, sp.dense(moved))
    force, torque = (np.array([float(x) for x in part]) for part in slope.wrench(moved))
    # in the plane of the wheels, and the line of action is as far from a as its rolling radius
    assert abs(force[2]) < 1e-12
    centre = np.array([float(x) for x in moved.translation])
    about_a = torque + np.cross(centre, force)
    radius = abs(float(coupling.radii(drawn)[0]))
    np.testing.assert_allclose(abs(about_a[2]), radius, rtol=1e-2)
    assert np.isfinite(float(residual))
    if getattr(coupling, "pressure_angle", None) is not None and not rack:
        # on the common tangent of the base circles: a unit force, whatever the distance
        np.testing.assert_allclose(np.linalg.norm(force), 1.0, rtol=1e-9)
        np.testing.assert_allclose(abs(about_a[2]), radius, rtol=1e-9)


def test_every_coupling_of_bodies_is_tried():
    tried = {type(own) for own in MEMBERS} | {jc.coupling.Screw}
    members = AbstractBodyCoupling.__subclasses__()
    assert tried == {kind for kind in members if kind.__module__.startswith("jaxclear.")}


@pytest.mark.parametrize("turns", [7.0, -9.5])
def test_a_rack_counts_the_turns_that_its_pinion_starts_with(turns):
    across = jc.Marker("ground", (0.0, -0.02, 0.0), axis="x")
    rig = jc.Mechanism(
        {"a": jc.Body(0.3, (J_A,) * 3), "b": jc.Body(1.0, (J_B,) * 3)},
        {
            "A": jc.Connection(TURN, "ground", "a"),
            "B": jc.Connection(jc.joint.Prismatic(), across, jc.Marker("b", axis="x")),
        },
        couplings={"mesh": jc.coupling.Rack("A", "B", 0.02)},
        start={"A": turns},
    )
    np.testing.assert_allclose(jc.assemble(rig).coordinates, [turns, 0.02 * turns], rtol=1e-9)


@pytest.mark.slow
def test_ways_to_assemble_keep_couplings():
    rig, turned = pair(jc.coupling.Gear("A", "B", RATIO)), (0.3, -0.3 / RATIO)
    guess = dict(zip("AB", turned, strict=True))
    guessed = jc.Mechanism(rig.bodies, rig.connections, couplings=rig.couplings, guess=guess)
    ways = jc.assemblies(guessed, 8)
    assert len(ways) == 1
    np.testing.assert_allclose(ways.coordinates[0], turned, atol=1e-12)


def test_a_transmission_error_is_added_to_the_turns():
    # twice a turn of b, 1 mrad, seen at a
    error = lambda turn: 1e-3 * jnp.sin(2 * turn)
    gear = jc.coupling.Gear("A", "B", RATIO, transmission_error=error)
    run = jc.simulate(pair(gear), 0.4, save=41, balance=True, integrator=STEPS)
    turned = np.asarray(run.coordinate("B"))
    assert np.ptp(turned) > 6.0
    wanted = -(RATIO * turned + np.asarray(error(turned)))
    np.testing.assert_allclose(run.coordinate("A"), wanted, rtol=0, atol=1e-8)
    np.testing.assert_allclose(run.energy_balance().error, 0.0, atol=1e-6)


def test_wheels_that_no_body_carries_together_are_told():
    arms = {
        "O": jc.Connection(TURN, "ground", "arm"),
        "A": jc.Connection(TURN, "ground", "a"),
        "B": jc.Connection(TURN, jc.Marker("arm", (0.08, 0.0)), "b"),
    }
    bodies = {"arm": jc.Body(1.0, 1e-2), "a": jc.Body(0.3, J_A), "b": jc.Body(1.0, J_B)}
    gear = {"mesh": jc.coupling.Gear("A", "B", 3.0)}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # a planet on its carrier
        jc.Mechanism(bodies, arms, couplings=gear)
    aside = jc.Connection(TURN, jc.Marker("ground", (0.01, 0.0)), "a")
    with pytest.warns(UserWarning, match="no body carries together"):
        jc.Mechanism(bodies, arms | {"A": aside}, couplings=gear)


@pytest.mark.parametrize("counted", [(True, True), (True, False), (False, True)])
def test_wheels_that_mesh_have_no_residual_whatever_turns_either_has_made(counted):
    """Also where a coordinate counts the turns of one wheel only: those of the other follow."""
    gear = jc.coupling.Gear("A", "B", RATIO)

    def turned(angle, place):
        x, y = np.cos(angle), np.sin(angle)
        return Pose(((x, -y, 0.0), (y, x, 0.0), (0.0, 0.0, 1.0)), (place, 0.0, 0.0))

    drawn = turned(0.0, R_A + R_B)
    counts = tuple(Count(1.0, 0.0, 0, i) if each else None for i, each in enumerate(counted))
    mesh = Mesh(gear, drawn, counts)
    for angle in (1.0, 4.0, 12.0, 26.5, -33.0):
        angles = angle, -angle / RATIO
        pose = turned(angles[0], 0.0).inverse().after(turned(angles[1], R_A + R_B))
        within_a_turn = mesh.residuals(pose)[0]
        found = mesh.counted(within_a_turn, pose, (SimpleNamespace(coordinates=angles),))
        assert abs(float(found)) < 1e-14
