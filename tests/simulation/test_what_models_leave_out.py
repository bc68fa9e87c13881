"""What a run says of its model: friction taken as Coulomb's, collars that are left out, forces that
statics does not tell, parts that follow their force in the gap at once."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators.checks import Check
from tests.rigs.cells import slow
from tests.rigs.four_bars import four_bar
from tests.rigs.overconstrained import parallel_cranks

RADIUS, CLEARANCE, LOAD = 10e-3, 0.05e-3, 200.0
CONTACT = jc.contact.HuntCrossley(stiffness=1e9, restitution=0.5)
THREE_ZONES = jc.friction.ThreeZone(static_speed=1e-3, kinetic_speed=1e-2)
STEPS = {
    "permanent": jc.integrator.NonColliding(1e-4),
    "rigid": jc.integrator.MoreauJean(2e-5),
    "regularised": jc.integrator.NonColliding(1e-4, regularised=True),
}


SIZES = {"bearing_radius": RADIUS, "clearance": CLEARANCE}
FLANGE = jc.clearance.Flange(CONTACT, radius=1.4 * RADIUS, clearance=1e-4)


def pressed(friction, torque=0.0, speed=0.0, inertia=1e-3):
    joint = jc.clearance.PlanarJournalBearing(CONTACT, friction, **SIZES)
    loads = {"load": jc.load.Force(jc.Marker("rotor"), (0.0, -LOAD, 0.0))}
    loads["torque"] = jc.load.Torque(jc.Marker("rotor"), torque)
    joints = {"B": jc.Connection(joint, "ground", "rotor")}
    speeds = {"rotor": (0.0, 0.0, speed)}
    return jc.Mechanism({"rotor": jc.Body(1.0, inertia)}, joints, loads, speeds=speeds)


def figure(rig, integrator, check=Check.COULOMB_FRICTION, duration=0.01):
    """A run, and its largest figure of a check."""
    state = None if isinstance(integrator, jc.integrator.NonColliding) else jc.resting_state(rig)
    how = {"save": 101, "balance": True, "throw": False, "state": state}
    run = jc.simulate(rig, duration, integrator=integrator, **how)
    found = run.invariants.figures.get(check)
    return run, None if found is None else float(jnp.max(found.worst))


@pytest.mark.slow
@pytest.mark.parametrize("law", [*slow(THREE_ZONES), jc.friction.Dahl()])
@pytest.mark.parametrize("rung", ["permanent", "rigid"])
def test_a_joint_that_sticks_where_its_law_creeps_or_yields_says_so(rung, law):
    run, share = figure(pressed(law, torque=0.5 * 0.1 * LOAD * RADIUS), STEPS[rung])
    assert share == pytest.approx(1.0, rel=1e-3)
    assert any("taken as Coulomb" in sentence for sentence in run.warnings)


@pytest.mark.slow
def test_what_a_law_takes_beside_coulombs_is_told_as_large_as_it_is():
    """Beside a tight compliant run, at a speed at which friction is nearly static."""
    speeds = {"static_speed": 3e-3, "kinetic_speed": 0.15}
    law = jc.friction.AdamsStep(mu_static=0.18, mu_kinetic=0.1, **speeds)
    rig = pressed(law, speed=0.04 / RADIUS, inertia=1.0)
    run, share = figure(rig, STEPS["permanent"])
    oracle, nothing = figure(rig, jc.integrator.Adaptive())
    lost = [float(one.energy_balance().friction_loss[-1]) for one in (run, oracle)]
    assert nothing is None
    # the compliant journal climbs its bearing first
    assert share > 0.3 and share == pytest.approx(1 - lost[0] / lost[1], rel=0.1)


FAST = [(THREE_ZONES, "permanent", 0.0), (THREE_ZONES, "rigid", 0.0)]
FAST += [(THREE_ZONES, "regularised", None), (jc.friction.Coulomb(), "permanent", None)]


@pytest.mark.slow
@pytest.mark.parametrize(("law", "rung", "wanted"), FAST)
def test_a_joint_that_slides_fast_or_by_coulombs_law_says_nothing(law, rung, wanted):
    _, share = figure(pressed(law, speed=20.0), STEPS[rung])
    assert share == wanted


def spun(along=0.0, fast=0.0, **numbers):
    joint = jc.clearance.JournalBearing(CONTACT, length=0.02, **SIZES, **numbers)
    return jc.Mechanism(
        {"rotor": jc.Body(1.0, (1e-3,) * 3)},
        {"B": jc.Connection(joint, "ground", "rotor")},
        {"load": jc.load.Force(jc.Marker("rotor"), (0.0, -LOAD, along))},
        speeds={"rotor": (0.0, 0.0, fast, 0.0, 0.0, 5.0)},
    )


def test_a_journal_that_only_its_collars_or_the_model_hold_along_its_axis_says_so():
    """Of two forces at a right angle the share of the one along the axis."""
    along, steps = 0.25 * LOAD, STEPS["permanent"]
    for rig, check, said in (
        (spun(along, flange=FLANGE), Check.COLLAR_FORCE, 'Collars of joint "B"'),
        (spun(along), Check.UNHELD_FORCE, "nothing but this model holds its journal"),
    ):
        run, share = figure(rig, steps, check)
        assert share == pytest.approx(along / (along + LOAD), rel=1e-6)
        assert any(said in sentence for sentence in run.warnings)
    assert figure(spun(along, flange=FLANGE), steps, Check.UNHELD_FORCE)[1] is None


def test_a_journal_that_the_other_joints_of_its_loop_may_hold_says_nothing_of_its_axis():
    """A coupler on two cranks, loaded across the plane of its motion: their feet carry it too."""
    start = {"start": {"foot 0": 0.6}, "guess": {"foot 1": 0.6, "top 0": -0.6}}
    rig = parallel_cranks(2, spatial=True, **start)
    joint = jc.clearance.JournalBearing(CONTACT, **SIZES)
    across = jc.load.Force(jc.Marker("coupler", (0.0, 0.0, 0.0)), (0.0, 0.0, -LOAD))
    rig = rig.with_joint("top 1", joint).with_loads({**rig.loads, "across": across})
    run = jc.simulate(rig, 0.02, integrator=STEPS["permanent"], save=11, throw=False)
    assert float(jnp.max(run.invariants.figures[Check.UNHELD_FORCE].worst)) == 0.0


@pytest.mark.parametrize("rung", ["compliant", "rigid"])
@pytest.mark.parametrize(("journal_length", "reach"), [(None, 0.02), (0.03, 0.005)])
def test_a_journal_that_slides_out_of_its_bearing_says_so(rung, journal_length, reach):
    """It slides freely: after a time t it is v t along."""
    rig = spun(fast=2.2, journal_length=journal_length)
    steps = {"compliant": jc.integrator.Adaptive(), "rigid": STEPS["rigid"]}[rung]

    def left(rig):
        run = jc.simulate(rig, 0.01, integrator=steps, save=11, throw=False)
        return run, float(jnp.max(run.invariants.figures[Check.JOURNAL_REACH].worst))

    run, share = left(rig)
    assert share == pytest.approx((2.2 * 0.01 - reach) / 0.02, abs=1e-3)
    assert any("slides out of" in sentence for sentence in run.warnings)
    assert left(spun(fast=0.4))[1] == 0.0


@pytest.mark.parametrize("offset", [0.0, 0.02])
def test_what_statics_does_not_tell_of_a_joint_that_always_touches_is_told(offset):
    """A spatial four-bar whose follower runs in another plane: the bearing between them carries
    the moment of that distance alone, but for a couple of forces along the axes that no motion
    changes; closed form of how little would be left of the moment."""
    rig = jc.scenes.four_bar("spatial", friction=False, wear=False, follower_offset=offset)
    run = jc.simulate(rig, 0.2, integrator=jc.integrator.NonColliding(4e-3), save=51, throw=False)
    told = float(jnp.max(run.invariants.figures[Check.INDETERMINATE_FORCE].worst))
    assert any("Statics leaves" in sentence for sentence in run.warnings) == (offset > 0)
    joint = rig.connections["B"].joint
    # The line from the bearing to the follower's foot in the plane of motion, seen from the bearing
    # as it lies in the coupler.
    foot = np.array([0.3, 0.0])
    tip, root = (np.asarray(run.marker("coupler", (x, 0.0)).position)[:, :2] for x in (0.4, 0.0))
    turned = lambda vectors: np.stack([vectors[:, 1], -vectors[:, 0]], axis=1)
    dot = lambda one, other: np.sum(one * other, axis=1)
    x = (tip - root) / 0.4
    way = np.stack([dot(foot - tip, x), dot(foot - tip, -turned(x))], axis=1)
    along = turned(way) / np.linalg.norm(way, axis=1)[:, None]
    force, moment = (
        np.asarray(own)[:, :2] for own in (run.contact("B").force, run.contact("B").torque)
    )
    left = moment - dot(moment, along)[:, None] * along

    def ends(moment):
        by_moment = turned(moment) / joint.length
        return np.stack([0.5 * force + by_moment, 0.5 * force - by_moment])

    sizes, others = (np.linalg.norm(ends(m), axis=2) for m in (moment, left))
    wanted = np.sum(abs(others - sizes)) / np.sum(sizes)
    assert told == pytest.approx(float(wanted), rel=2e-4, abs=1e-6)
    assert (told > 0.3) == (offset > 0)


def carried_round(turning, mass=2.0, rate=40.0):
    """A journal whose load, or whose bearing, goes round."""
    joint = jc.clearance.PlanarJournalBearing(CONTACT, **SIZES)
    going = lambda t: LOAD * jnp.stack([jnp.cos(rate * t), jnp.sin(rate * t), 0.0 * t])
    value = going if turning == "load" else (0.0, -LOAD, 0.0)
    turn = jc.joint.Revolute(drive=jc.drive.ConstantSpeed(rate if turning == "bearing" else 0.0))
    return jc.Mechanism(
        {"disc": jc.Body(1.0, 1e-3), "rotor": jc.Body(mass, 1e-3)},
        {"D": jc.Connection(turn, "ground", "disc"), "B": jc.Connection(joint, "disc", "rotor")},
        {"load": jc.load.Force(jc.Marker("rotor"), value)},
    )


@pytest.mark.parametrize("turning", ["load", "bearing"])
def test_the_force_that_would_move_a_part_in_its_gap_is_told(turning):
    """On a circle it is the lighter mass times the radial clearance times the square of the rate,
    less where looks are far apart: then the chord is; none where only the bearing goes round."""
    rate, duration, light = 40.0, 0.1, 1.0
    _, share = figure(carried_round(turning), STEPS["permanent"], Check.GAP_MOTION, duration)
    apart = 2 * duration / 100
    circle = CLEARANCE * (2 - 2 * np.cos(rate * apart)) / apart**2
    wanted = light * circle / LOAD if turning == "load" else 0.0
    assert share == pytest.approx(wanted, rel=0.01, abs=1e-5)


@pytest.mark.slow
def test_a_part_that_lags_in_its_gap_says_so():
    """A ball pendulum let go: along its rod its force grows faster than the whole bob can follow in
    the gap; a tight compliant run tells how far off the force is."""
    rub = jc.friction.CoulombTanh(mu_kinetic=0.1)
    joint = jc.clearance.BallSocket(CONTACT, rub, socket_radius=RADIUS, clearance=1e-4)
    rig = jc.Mechanism(
        {"bob": jc.Body(1.0, (1e-3,) * 3, (0.2, 0.0, 0.0))},
        {"B": jc.Connection(joint, "ground", "bob")},
        {"gravity": jc.load.Gravity((0.0, -9.81, 0.0))},
    )
    run, share = figure(rig, STEPS["permanent"], Check.GAP_MOTION, 0.02)
    oracle, nothing = figure(rig, jc.integrator.Adaptive(), Check.GAP_MOTION, 0.02)
    mean = [float(jnp.mean(one.contact("B").normal_force)) for one in (run, oracle)]
    assert nothing is None and mean[0] > 1.05 * mean[1]
    assert share > Check.GAP_MOTION.limit
    assert any('through the gap of joint "B"' in sentence for sentence in run.warnings)


@pytest.mark.slow
def test_ideal_joints_that_rub_in_a_loop_are_told_of_too():
    """Parallel hinges carry loads across their plane as each of them gives."""
    rub = jc.friction.CoulombTanh(mu_kinetic=0.1)
    hinge = jc.joint.PlainBearing(friction=rub, radius=RADIUS, length=0.02)
    links = {"crank": 0.1, "coupler": 0.4, "follower": 0.3}
    link = lambda long: jc.Body(1.0, (1e-4, 1e-2, 1e-2), com=(long / 2, 0.0, 0.0))
    drive = jc.drive.ConstantSpeed(10.0)
    told = []
    for load in ((0.0, -9.81, 0.0), (0.0, 0.0, -9.81)):
        gravity, guess = {"gravity": jc.load.Gravity(load)}, {"A": 0.81, "D": 1.32}
        rig = four_bar(links, 0.3, link, gravity, drive, guess=guess)
        for name in "ABD":
            rig = rig.with_joint(name, hinge)
        steps = jc.integrator.ImplicitStep(5e-4)
        run = jc.simulate(rig, 0.05, save=11, integrator=steps, throw=False)
        told.append(float(jnp.max(run.invariants.figures[Check.INDETERMINATE_FORCE].worst)))
    assert told[0] < 1e-9 and told[1] > 2 * Check.INDETERMINATE_FORCE.limit
