"""Linkages that move although their rows are redundant: parallel cranks in closed form, spatial
hinges that are parallel, Bennett's and Bricard's rings by the equations between their angles.

Parallel cranks carry their coupler along a circle: with theta the angle of the cranks, I theta'' =
-g G cos(theta), I and G moments of all masses, to rounding for any number of cranks."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxclear as jc
from tests.rigs.cells import slow
from tests.rigs.overconstrained import APART, COUPLER, CRANK, GRAVITY, LENGTH, parallel_cranks, ring

COUNT, ANGLE = 3, 0.6
PRECISE = jc.integrator.Adaptive(rtol=1e-10, atol=1e-12)
NEARBY = {"foot 1": ANGLE, "foot 2": ANGLE, "top 0": -ANGLE}
INERTIA = COUNT * (1e-3 + CRANK * LENGTH**2 / 4) + COUPLER * LENGTH**2
MOMENT = COUNT * CRANK * LENGTH / 2 + COUPLER * LENGTH


def cranks(**kwargs):
    return parallel_cranks(COUNT, start={"foot 0": ANGLE}, guess=NEARBY, **kwargs)


def angle(times, gravity=GRAVITY, start=(ANGLE, 0.0)):
    """Angle of the cranks and its rate."""

    def field(_, y):
        return [y[1], -gravity * MOMENT / INERTIA * np.cos(y[0])]

    return solve_ivp(field, (0.0, times[-1]), start, "DOP853", times, rtol=1e-13, atol=1e-13).y


@pytest.fixture(scope="module")
def swung():
    return jc.simulate(cranks(), 1.0, save=101, integrator=PRECISE, balance=True)


def off(run, start=ANGLE):
    """How far the coupler is from its circle's place [m], through the positions in which all links
    lie in one line."""
    theta = angle(np.asarray(run.time), start=(start, 0.0))[0]
    place = LENGTH * np.stack([np.cos(theta), np.sin(theta), 0 * theta], axis=1)
    return np.abs(run.marker("coupler", (0.0,) * (2 + run_is_spatial(run))).position - place).max()


def run_is_spatial(run):
    return len(run.mechanism.bodies["coupler"].inertia) > 1


@pytest.mark.slow
def test_three_parallel_cranks_over_ten_seconds():
    """Some forty times through the line, where the coupler may turn off: at a tight tolerance a run
    is right or ends with its sentence (6 of these 21 starts do)."""
    ended = 0
    for start in np.linspace(0.4, 0.9, 21):
        near = {"foot 1": start, "foot 2": start, "top 0": -start}
        rig = parallel_cranks(COUNT, start={"foot 0": start}, guess=near)
        run = jc.simulate(rig, 10.0, save=101, integrator=PRECISE, throw=False)
        if run.succeeded:
            assert off(run, start) < 1e-4
        else:
            assert run.result.startswith("The run ended early")
            ended += 1
    assert ended < 11


def by_hand(theta, spin_rate, spin):
    """Forces on the coupler at the tops of the second and third crank: the least of those with
    which every part moves as it does (moments about the feet and the first top, and along the
    circle)."""
    along = np.array([np.cos(theta), np.sin(theta)])
    across, weight = np.array([-along[1], along[0]]), np.array([0.0, -GRAVITY])
    acceleration = LENGTH * (spin_rate * across - spin**2 * along)
    needed = (1e-3 + CRANK * LENGTH**2 / 4) * spin_rate + CRANK * GRAVITY * LENGTH / 2 * along[0]
    lever = LENGTH * across
    centre = np.array([0.5 * APART * (COUNT - 1) + 0.02, 0.01])
    own = COUPLER * (weight - acceleration)
    moment = centre[0] * own[1] - centre[1] * own[0]
    rows = [[*-lever, 0, 0], [0, 0, *-lever], [*lever, *lever], [0, APART, 0, 2 * APART]]
    right = [needed, needed, needed - lever @ own, -moment]
    return np.linalg.lstsq(np.array(rows), np.array(right), rcond=1e-10)[0].reshape(2, 2)


@pytest.mark.slow
def test_reactions_are_the_least_that_hold_the_motion(swung):
    theta, spin = angle(np.asarray(swung.time))
    rate = -GRAVITY * MOMENT / INERTIA * np.cos(theta)
    with pytest.warns(UserWarning, match='reaction of joint "top ." is not unique'):
        found = {i: swung.reaction(f"top {i}") for i in range(COUNT)}
    assert not any(own.unique for own in found.values())
    for k in (0, 20, 57):
        wanted = by_hand(theta[k], rate[k], spin[k])
        for i in (1, 2):
            np.testing.assert_allclose(found[i].force[k, :2], wanted[i - 1], atol=1e-7)
    # However the cranks share it, their sum is what moves the coupler.
    sin, cos = np.sin(theta), np.cos(theta)
    circle = np.stack([-sin * rate - cos * spin**2, cos * rate - sin * spin**2], axis=1)
    total = sum(own.force[:, :2] for own in found.values())
    wanted = COUPLER * (LENGTH * circle + np.array([0.0, GRAVITY]))
    np.testing.assert_allclose(total, wanted, atol=1e-7)


def test_friction_of_a_given_normal_force_asks_for_no_reaction():
    """A clamped foot with a friction torque above g G cos(theta) holds; with one below it swings,
    by work and energy over steps of 1 ms."""
    for torque in (1.5 * GRAVITY * MOMENT, 0.3 * GRAVITY * MOMENT):
        dry = jc.friction.Coulomb(mu_kinetic=1.0)
        clamped = jc.joint.PlainBearing(dry, radius=1e-2, load=torque / 1e-2)
        step = jc.integrator.NonColliding(1e-3)
        run = jc.simulate(cranks(crank=clamped), 0.15, save=4, integrator=step)
        theta, rate = (np.asarray(x) for x in (run.coordinate("foot 0"), run.speed("foot 0")))
        if torque > GRAVITY * MOMENT:
            np.testing.assert_allclose(theta, ANGLE, atol=1e-12)
            continue
        fallen = GRAVITY * MOMENT * (np.sin(ANGLE) - np.sin(theta)) - torque * (ANGLE - theta)
        np.testing.assert_allclose(INERTIA / 2 * rate**2, fallen, atol=1e-4 * GRAVITY * MOMENT)
        assert theta[-1] < 0.2


@pytest.mark.parametrize(
    "integrator", [jc.integrator.MoreauJean(1e-4), jc.integrator.NonColliding(1e-4)]
)
def test_friction_of_a_reaction_that_is_not_unique_is_refused(integrator):
    """By its joint; ImplicitStep and FixedStep take the least reactions."""
    rubs = jc.joint.PlainBearing(jc.friction.Coulomb(mu_kinetic=0.1), radius=8e-3)
    with pytest.raises(ValueError, match='friction in joint "foot 0" follows its reaction'):
        jc.simulate(cranks(crank=rubs), 0.01, save=3, integrator=integrator)


def test_three_parallel_cranks_swing_as_one(swung):
    assert off(swung) < 1e-9
    # Of the largest energy, some 1 J.
    assert np.abs(swung.energy_balance().error).max() < 1e-9
    assert max(float(drift.max()) for drift in swung.drift().values()) < 1e-12
    sentence = 'overconstrained: of the rows that close loops x of joint "top 2" follows'
    assert sentence in str(swung) and sentence in str(swung.mechanism)
    assert sentence not in str(cranks())


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_reactions_of_two_cranks_are_unique():
    near = {"foot 1": ANGLE, "top 0": -ANGLE}
    run = jc.simulate(parallel_cranks(2, start={"foot 0": ANGLE}, guess=near), 0.1, save=3)
    assert run.mechanism.topology.redundancy is None and run.reaction("top 1").unique


@pytest.mark.parametrize("longer", [*slow(1e-3), 1e-6])
def test_crank_of_another_length_is_refused_by_what_is_missed(longer):
    with pytest.raises(ValueError, match='joint "top 1" cannot be closed') as refused:
        jc.assemble(cranks(longer=longer))
    missed = float(re.search(r"closed: (\S+) m", str(refused.value))[1])
    assert 0.2 * longer < missed < 2 * longer
    assert "fit exactly" in str(refused.value)


@pytest.mark.slow
def test_speeds_of_redundant_loops_are_assembled():
    start = jc.assemble(cranks(speeds={"top 0": 3.0}))
    np.testing.assert_allclose(start.speeds, [-3.0, 3.0, -3.0, -3.0], atol=1e-12)


@pytest.mark.slow
def test_cranks_that_lie_in_one_line_start_moving():
    """There rows are fewer than elsewhere; three cranks can leave the line in one way only. 1e-6:
    until they have left it by 1e-7 rad the lost row holds nothing."""
    run = jc.simulate(parallel_cranks(COUNT), 0.2, save=[0.1], integrator=PRECISE)
    assert run.mechanism.topology.redundancy.rank == 3
    wanted = angle(np.array([0.1]), start=(0.0, 0.0))[0, -1]
    for i in range(COUNT):
        np.testing.assert_allclose(run.coordinate(f"foot {i}")[1], wanted, atol=1e-6)


@pytest.mark.slow
def test_derivative_is_that_of_the_motion():
    """By gravity, through 300 steps of Runge and Kutta, against the closed form's."""
    end = lambda run: run.coordinate("foot 2")[-1]
    varied = {"g": jc.Variable(lambda m: m.loads["gravity"].acceleration[1], tolerance=1.0)}
    how = {"duration": 0.3, "save": 2, "integrator": jc.integrator.FixedStep(1e-3)}
    problem = jc.Problem(cranks(), end, varied, **how)
    turned = lambda g: problem.evaluate(g).responses["response"]
    found = jax.jit(jax.jacfwd(turned))(jnp.array([-GRAVITY]))
    ends = [angle(np.array([0.3]), GRAVITY + d)[0, -1] for d in (-1e-4, 1e-4)]
    np.testing.assert_allclose(found[0], -(ends[1] - ends[0]) / 2e-4, rtol=1e-6)


INTEGRATORS = {
    "FixedStep": jc.integrator.FixedStep(1e-4),
    "ImplicitStep": jc.integrator.ImplicitStep(1e-4),
    "MoreauJean": jc.integrator.MoreauJean(1e-4),
    "NonColliding": jc.integrator.NonColliding(1e-4),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", INTEGRATORS)
@pytest.mark.parametrize("held", [jc.Baumgarte(), jc.Projection(), None], ids=["B", "P", "none"])
def test_every_integrator_moves_redundant_loops(name, held):
    """1e-5 m: the implicit ones are of second order in steps of 1e-4 s."""
    run = jc.simulate(cranks(stabilisation=held), 0.5, save=51, integrator=INTEGRATORS[name])
    assert off(run) < 1e-5


def worn_in(friction):
    rig = cranks()
    law = jc.contact.Flores(stiffness=1e8, restitution=0.9)
    bearing = jc.clearance.PlanarJournalBearing(law, friction, clearance=1e-4)
    held = rig.connections["top 2"]
    loose = {"top 2": jc.Connection(bearing, held.parent, held.child)}
    joints = {name: own for name, own in rig.connections.items() if name != "top 2"}
    given = {"start": {"foot 0": ANGLE}, "guess": NEARBY}
    return jc.Mechanism(rig.bodies, joints | loose, rig.loads, **given)


@pytest.mark.slow
def test_friction_that_would_follow_an_open_reaction_is_refused():
    rung = jc.integrator.NonColliding(1e-4)
    assert off(jc.simulate(worn_in(None), 0.1, save=3, integrator=rung)) < 1e-5
    with pytest.raises(ValueError, match='friction in joint "top 2" follows its reaction'):
        jc.simulate(worn_in(jc.friction.Coulomb(mu_kinetic=0.1)), 0.1, integrator=rung)


@pytest.mark.slow
def test_parallel_hinges_in_space_move_as_pins_in_the_plane():
    """Four hinges whose axes are parallel, all places with three coordinates."""
    run = jc.simulate(cranks(spatial=True), 0.5, save=26, integrator=PRECISE)
    assert ("top 1", "z") in run.mechanism.topology.redundancy.rows
    assert off(run) < 1e-9


def test_forces_across_the_plane_are_not_unique():
    """A pendulum on two parallel hinges, whose places are two numbers each, across gravity: statics
    tells what both carry together, its weight, and nothing of how they share it."""
    hinge = jc.joint.Revolute()
    rig = jc.Mechanism(
        {"bar": jc.Body(2.0, (1e-2, 1e-2, 1e-2), (0.1, 0.0))},
        {
            "left": jc.Connection(hinge, "ground", "bar"),
            "right": jc.Connection(hinge, "ground", "bar"),
        },
        {"gravity": jc.load.Gravity((0.0, 0.0, -GRAVITY))},
        speeds={"left": 1.0},
    )
    run = jc.simulate(rig, 0.01, save=2, integrator=PRECISE)
    with pytest.warns(UserWarning, match='reaction of joint "(left|right)" is not unique'):
        found = [run.reaction(name) for name in ("left", "right")]
    assert not any(own.unique for own in found)
    np.testing.assert_allclose(sum(own.force[:, 2] for own in found), 2.0 * GRAVITY, rtol=1e-12)


A, B, ALPHA, BETA = 0.1, 0.1 * np.sin(1.1) / np.sin(0.5), 0.5, 1.1


@pytest.mark.slow
def test_bennett_linkage_keeps_the_equation_between_its_angles():
    """tan(theta_1 / 2) tan(theta_2 / 2) = -sin((beta + alpha) / 2) / sin((beta - alpha) / 2), and
    opposite angles make up a turn (Bennett 1903, Engineering 76, 777); 10 s."""
    ratio = -np.sin((BETA + ALPHA) / 2) / np.sin((BETA - ALPHA) / 2)
    second = 2 * np.arctan(ratio / np.tan(0.4))
    near = {"2": second, "3": -0.8, "0": -second}
    rig = ring([A, B, A, B], [ALPHA, BETA, ALPHA, BETA], start={"1": 0.8}, guess=near)
    run = jc.simulate(rig, 10.0, save=501, integrator=PRECISE, balance=True)
    assert run.mechanism.topology.redundancy.rank == 2
    first, second, fourth = (np.asarray(run.coordinate(name)) for name in "120")
    halves = first / 2, second / 2
    product = np.prod(np.sin(halves), axis=0) - ratio * np.prod(np.cos(halves), axis=0)
    assert B * np.abs(product).max() < 1e-6
    assert B * np.abs(np.sin((second + fourth) / 2)).max() < 1e-6
    assert np.abs(run.energy_balance().error).max() < 1e-9


@pytest.mark.slow
def test_bricard_linkage_keeps_the_equation_between_its_angles():
    """Threefold symmetric, twists of 90 degrees: cos(theta) + cos(phi) + cos(theta) cos(phi) = 0,
    angles alternating (Chen, You & Tarnai 2005, Int. J. Solids Struct. 42, 2287,
    doi:10.1016/j.ijsolstr.2004.09.014); 10 s."""
    theta = 1.0
    phi = np.arccos(-np.cos(theta) / (1 + np.cos(theta)))
    angles = {name: (theta, phi)[i % 2] for i, name in enumerate("123450")}
    twists, start = [np.pi / 2, -np.pi / 2] * 3, {"1": angles.pop("1")}
    rig = ring([0.1] * 6, twists, start=start, guess=angles)
    run = jc.simulate(rig, 10.0, save=501, integrator=PRECISE, balance=True)
    assert run.mechanism.topology.redundancy.rank == 4
    first, second, third = (np.asarray(run.coordinate(name)) for name in "123")
    left = np.cos(first) + np.cos(second) + np.cos(first) * np.cos(second)
    assert 0.1 * np.abs(left).max() < 1e-6
    assert 0.1 * np.abs(first - third).max() < 1e-6
    assert np.abs(run.energy_balance().error).max() < 1e-9
