"""Ideal joints that rub: Coulomb's friction, Archard's volume by the reaction, in closed form."""

import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.cells import slow

MU, LOAD, RADIUS, LENGTH, INERTIA = 0.1, 200.0, 8e-3, 20e-3, 1e-3
GRIP = MU / np.sqrt(1 + MU**2)
LAW = jc.wear.Archard()
RATE = float(LAW.wear_coefficient / LAW.hardness)
NON_COLLIDING = jc.integrator.NonColliding(1e-3)
RIGID = jc.integrator.MoreauJean(1e-3)
ADAPTIVE = jc.integrator.Adaptive(rtol=1e-9, atol=1e-11)
# At 1000 transition speeds tanh is 1 to rounding.
FAST = jc.friction.CoulombTanh(mu_kinetic=MU, transition_speed=1e-5)
STICKS = jc.friction.Coulomb(mu_kinetic=MU)


# It rests after 0.05 s.
BRAKING = GRIP * LOAD * RADIUS / INERTIA
SPEED = 0.05 * BRAKING


def rotor(friction, speed=SPEED, **numbers):
    """A rotor in a plain bearing that a constant force presses down."""
    joint = jc.joint.PlainBearing(friction, radius=RADIUS, **numbers)
    return jc.Mechanism(
        {"rotor": jc.Body(1.0, INERTIA)},
        {"B": jc.Connection(joint, "ground", "rotor")},
        {"load": jc.load.Force(jc.Marker("rotor"), (0.0, -LOAD))},
        speeds={} if speed is None else {"B": speed},
    )


@pytest.mark.parametrize(
    ("integrator", "law"),
    [
        (NON_COLLIDING, STICKS),
        *slow((RIGID, STICKS), (RIGID, jc.friction.ThreeZone(mu_static=MU, mu_kinetic=MU))),
    ],
)
def test_a_plain_bearing_brakes_with_the_friction_circle_and_wears_by_archard(integrator, law):
    """Deceleration sin(arctan mu) F r / I until it rests, and not beyond; V = k N s / H. Of a law
    that is a function of the speed rigid steps take the coefficients."""
    rig = rotor(law, length=LENGTH, wear=jc.Wearing(LAW, acceleration=1e4))
    run = jc.simulate(rig, 0.1, integrator=integrator, save=11, balance=True)
    left = np.maximum(SPEED - BRAKING * np.asarray(run.time), 0.0)
    np.testing.assert_allclose(run.speed("B"), left, atol=1e-9)
    energies = run.energy_balance()
    np.testing.assert_allclose(energies.friction_loss[-1], 0.5 * INERTIA * SPEED**2, rtol=1e-12)
    assert float(np.abs(energies.error).max()) < 1e-12
    slid = RADIUS * 0.5 * SPEED * 0.05
    volume = 1e4 * RATE * LOAD / np.sqrt(1 + MU**2) * slid
    np.testing.assert_allclose(run.worn_volume("B", "bearing")[-1], volume, rtol=1e-9)
    sunk = run.worn_depth("B", "bearing")
    np.testing.assert_allclose(sunk, volume / (2 * RADIUS * LENGTH), rtol=1e-9)
    contact = run.contact("B")
    np.testing.assert_allclose(contact.traction[2].sum(), GRIP * LOAD, rtol=1e-9)
    np.testing.assert_allclose(contact.slip_speed[2], RADIUS * left[2], rtol=1e-9)
    np.testing.assert_allclose(run.reaction("B").force[3, :2], [0.0, LOAD], atol=1e-9)
    pressed = 0.05 * LOAD * (1 + 1 / np.sqrt(1 + MU**2))
    np.testing.assert_allclose(run.contact_impulse("B")[-1], pressed, rtol=1e-9)


def test_a_bearing_turned_under_a_constant_load_wears_archards_volume():
    """On a rung of error control, where the load is found with the acceleration."""
    mechanism = rotor(None, length=LENGTH, wear=jc.Wearing(LAW))
    run = jc.simulate(mechanism, 2 * np.pi / SPEED, integrator=ADAPTIVE, save=3)
    assert list(run.combined_modes()["B"]) == ["contact"]
    volume = RATE * LOAD * RADIUS * 2 * np.pi
    np.testing.assert_allclose(run.worn_volume("B", "bearing")[-1], volume, rtol=1e-12)


def oscillator(**numbers):
    """A flywheel on a torsion spring in a clamped bush."""
    joint = jc.joint.PlainBearing(**numbers, radius=RADIUS, load=LOAD)
    return jc.Mechanism(
        {"wheel": jc.Body(1.0, INERTIA)},
        {"B": jc.Connection(joint, "ground", "wheel")},
        {"spring": jc.load.JointSpring("B", 40.0)},
        start={"B": 0.05},
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "integrator"),
    [
        pytest.param(STICKS, jc.integrator.NonColliding(1e-4), id="NonColliding"),
        pytest.param(STICKS, jc.integrator.MoreauJean(1e-4), id="MoreauJean"),
        pytest.param(FAST, ADAPTIVE, id="Adaptive"),
    ],
)
def test_constant_friction_takes_the_same_from_every_half_swing(law, integrator):
    """x_n = x_0 - 2 n M / k, until the spring cannot overcome friction."""
    half = np.pi * np.sqrt(INERTIA / 40.0)
    mechanism = oscillator(friction=law)
    run = jc.simulate(mechanism, 5 * half, integrator=integrator, save=6)
    lost = 2 * MU * LOAD * RADIUS / 40.0 * np.arange(6)
    # the midpoint rule at 1/157 of a half swing
    np.testing.assert_allclose(np.abs(run.coordinate("B")), 0.05 - lost, atol=2e-6)


def crank(kind, at_slider=None, guess=None, drive=None, slide=None, **numbers):
    """A crank, a rod and a slider; friction in every joint, but another one `at_slider` if that is
    given. A spring holds the crank back, which turns freely or by its drive."""
    pin = kind(**numbers)
    first = pin if drive is None else kind(**numbers, drive=drive)
    bar = lambda length: jc.Body(0.5, 0.5 * length**2 / 12, com=(0.5 * length, 0.0))
    return jc.Mechanism(
        {"crank": bar(0.1), "rod": bar(0.3), "slider": jc.Body(1.0, 1e-3)},
        {
            "A": jc.Connection(first, "ground", "crank"),
            "B": jc.Connection(pin, "crank", "rod", at=(0.1, 0.0)),
            "C": jc.Connection(at_slider or pin, jc.Marker("rod", (0.3, 0.0)), "slider"),
            "D": jc.Connection(slide or jc.joint.Prismatic(), "ground", "slider", axis="x"),
        },
        {"g": jc.load.Gravity()} | ({} if drive else {"spring": jc.load.JointSpring("A", 5.0)}),
        start={} if drive else {"A": 1.0},
        speeds={} if drive else {"A": 30.0},
        guess=guess,
    )


@pytest.mark.slow
def test_joints_of_a_loop_that_come_to_rest_together_do_so_in_steps_of_any_length():
    """Where the crank turns round, three joints of one freedom rest at once, and share what holds
    it in no unique way: what their slips differ by, as the loop closes to the order of the step, is
    no reason to pass friction on from one to the next (of four of these steps that took 200 000
    sweeps and did not end). Motion is of the first order in steps that stick."""
    jam = crank(jc.joint.PlainBearing, friction=jc.friction.Coulomb(mu_kinetic=0.5), radius=20e-3)
    ends = {}
    for step in (4.124626382901348e-06, 1e-5, 2.4244620170823306e-05, 3.455107294592218e-05, 1e-4):
        steps = jc.integrator.NonColliding(step, max_sweeps=100.0)
        run = jc.simulate(jam, 0.06, integrator=steps, save=121, throw=False)
        assert run.succeeded, run.result
        ends[step] = float(run.speed("A")[-1])
    shortest, *others = ends.values()
    np.testing.assert_allclose(others, shortest, rtol=2e-3)
    few = jc.integrator.NonColliding(1e-5, max_sweeps=2.0)
    run = jc.simulate(jam, 0.06, integrator=few, save=121, throw=False)
    assert not run.succeeded and "Allow more of them (max_sweeps)" in run.result


@pytest.mark.slow
def test_a_plain_bearing_is_a_journal_bearing_whose_play_vanishes():
    """Where joints always touch the play enters by the arm of friction alone: the same friction in
    a loop, in its tree and where it closes."""
    plain = crank(jc.joint.PlainBearing, friction=STICKS, radius=RADIUS)
    play = crank(
        jc.clearance.PlanarJournalBearing,
        contact=jc.contact.Rigid(),
        friction=STICKS,
        bearing_radius=RADIUS,
        clearance=1e-11,
    )
    one, other = (
        jc.simulate(m, 0.2, integrator=NON_COLLIDING, save=21, balance=True) for m in (plain, play)
    )
    for joint in "ABC":
        wanted = other.contact(joint)
        for name in ("normal_force", "traction", "slip_speed"):
            found = getattr(one.contact(joint), name)
            np.testing.assert_allclose(found, getattr(wanted, name), rtol=1e-9, atol=1e-9)
    assert float(one.energy_balance().friction_loss[-1]) > 0.01


@pytest.mark.slow
def test_friction_in_a_loop_closes_the_energy_balance_and_does_not_depend_on_the_rung():
    law = jc.friction.CoulombTanh(mu_kinetic=MU, transition_speed=1e-2)
    smooth = crank(jc.joint.PlainBearing, friction=law, radius=RADIUS)
    runs = [
        jc.simulate(smooth, 0.1, integrator=integrator, save=11, balance=True)
        for integrator in (
            ADAPTIVE,
            jc.integrator.FixedStep(1e-5),
            jc.integrator.NonColliding(1e-4),
        )
    ]
    for run in runs[:2]:
        energies = run.energy_balance()
        assert float(np.abs(energies.error).max()) < 1e-9 * float(energies.kinetic.max())
    np.testing.assert_allclose(runs[0].states[-1, :2], runs[1].states[-1, :2], rtol=1e-6)
    # second order in its steps
    np.testing.assert_allclose(runs[0].states[-1, :2], runs[2].states[-1, :2], rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("integrator", "within"), [(ADAPTIVE, 1e-9), (jc.integrator.ImplicitStep(1e-3), 1e-6)]
)
def test_a_drive_gives_what_friction_in_its_own_joint_takes(integrator, within):
    drive = jc.drive.ConstantSpeed(SPEED)
    rig = rotor(FAST, None, drive=drive, wear=jc.Wearing(LAW), length=LENGTH)
    run = jc.simulate(rig, 0.5, save=3, balance=True, integrator=integrator)
    energies, loss = run.energy_balance(), GRIP * LOAD * RADIUS * SPEED * 0.5
    np.testing.assert_allclose(energies.friction_loss[-1], loss, rtol=within)
    np.testing.assert_allclose(energies.input[-1], loss, rtol=within)
    assert float(np.abs(energies.error).max()) < 1e-9 * loss
    volume = RATE * LOAD / np.sqrt(1 + MU**2) * RADIUS * SPEED * 0.5
    np.testing.assert_allclose(run.worn_volume("B", "bearing")[-1], volume, rtol=within)


def slider(friction, arm, **numbers):
    """A carriage on a slideway, pulled at a distance from it."""
    joint = jc.joint.Slideway(friction, length=0.2, **numbers)
    return jc.Mechanism(
        {"carriage": jc.Body(2.0, 1e-2)},
        {"S": jc.Connection(joint, "ground", "carriage", axis="x")},
        {"pull": jc.load.Force(jc.Marker("carriage", (0.0, arm)), (50.0, 0.0))},
    )


@pytest.mark.parametrize("arm", [0.5, 1.1])
@pytest.mark.parametrize("integrator", [RIGID, *slow(NON_COLLIDING)])
def test_a_carriage_pulled_beside_its_guide_jams_beyond_half_its_length_over_mu(integrator, arm):
    """Two ends carry F a / l each: friction 2 mu F a / l, and no motion from a = l / (2 mu) on."""
    run = jc.simulate(slider(STICKS, arm), 0.1, integrator=integrator, save=3)
    speed = max(0.0, 50.0 * (1 - 2 * MU * arm / 0.2)) / 2.0 * 0.1
    np.testing.assert_allclose(run.speed("S")[-1], speed, atol=1e-9)


def test_what_cannot_rub_is_refused():
    with pytest.raises(ValueError, match='joint "B" has friction Coulomb, which is no function'):
        jc.simulate(rotor(STICKS), 0.1)
    with pytest.raises(ValueError, match='joint "B" has friction Dahl, which is no function'):
        jc.simulate(rotor(jc.friction.Dahl()), 0.1)
    with pytest.raises(ValueError, match='joint "B" has friction Coulomb, which is no function'):
        jc.simulate(rotor(STICKS), 0.1, integrator=jc.integrator.ImplicitStep())
    with pytest.raises(ValueError, match="PlainBearing with wear has no length"):
        jc.joint.PlainBearing(wear=jc.Wearing(LAW))
    with pytest.raises(ValueError, match="Slideway with wear has no width"):
        jc.joint.Slideway(wear=jc.Wearing(LAW), length=0.1)


def test_a_study_of_a_joint_that_rubs_controls_its_error():
    """How fast its friction answers is not known before the run."""
    mass = jc.Variable(lambda m: m.bodies["rotor"].mass, tolerance=0.1)
    problem = jc.Problem(
        rotor(FAST), lambda run: run.coordinate("B")[-1], {"mass": mass}, duration=0.01
    )
    assert isinstance(problem.integrator, jc.integrator.Adaptive)
    assert 'friction in joint "B"' in problem.why_integrator


@pytest.mark.parametrize(
    "integrator",
    [*slow(jc.integrator.FixedStep(1e-3)), NON_COLLIDING],
)
def test_friction_is_in_the_reaction_of_the_joint_that_closes_the_loop_too(integrator):
    """A parallelogram whose pins, clamped, rub by mu F r."""
    law = STICKS if integrator is NON_COLLIDING else FAST
    pin = jc.joint.PlainBearing(law, radius=RADIUS, load=LOAD)
    crank = jc.joint.Revolute(jc.drive.ConstantSpeed(3.0))
    ends = jc.Marker("rod", (0.3, 0.0)), jc.Marker("rocker", (0.0, 0.1))
    joints = {
        "O": jc.Connection(crank, "ground", "crank"),
        "A": jc.Connection(pin, "crank", "rod", at=(0.0, 0.1)),
        "B": jc.Connection(pin, *ends),
        "D": jc.Connection(pin, "ground", "rocker", at=(0.3, 0.0)),
    }
    bodies = {name: jc.Body(0.1, 1e-4) for name in ("crank", "rod", "rocker")}
    rig = jc.Mechanism(bodies, joints)
    assert rig.topology.closing == ("B",)
    run = jc.simulate(rig, 0.01, save=3, integrator=integrator, verify=False)
    for name, way in (("A", -1), ("B", 1), ("D", 1)):
        torque = np.asarray(run.reaction(name).torque[1:, 2])
        np.testing.assert_allclose(torque, -way * MU * LOAD * RADIUS, rtol=1e-6)
