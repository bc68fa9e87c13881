"""Positions of mechanisms that their loops do not determine: springs, freedoms that are left, play
in angle, journals that share a load; against closed forms, scipy and the search by loops."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq, minimize, minimize_scalar

import jaxclear as jc
from jaxclear.statics import least_energy
from jaxclear.statics.position_path import spots_along
from jaxclear.statics.positions import Positions
from jaxclear.statics.quasi_static import posed

LAW = jc.contact.Hertz(stiffness=1e9)
RADIUS, ARM, FORCE, PLAY, STIFFNESS = 12e-3, 0.15, 4.0, 60e-6, 40.0


def journal(clearance=PLAY):
    return jc.clearance.PlanarJournalBearing(LAW, bearing_radius=4e-3, clearance=clearance)


def servo(force=FORCE, stiffness=STIFFNESS, horns=1, apart=0.0, free_lever=False):
    """A lever that pins of coaxial horns turn by their holes; horns are held by springs, or by
    drives where there is no stiffness. `apart` [rad]: angle between the rests of two horns."""
    bodies = {"lever": jc.Body(0.05, 2e-4)}
    joints = {"L": jc.Connection(jc.joint.Revolute(), "ground", "lever")}
    loads = {}
    for i in range(horns):
        name, angle = f"horn{i}", apart * (i - 0.5 * (horns - 1))
        drive = None if stiffness else jc.drive.Position(lambda t: 0.0 * t)
        bodies[name] = jc.Body(0.02, 1e-4)
        joints[f"M{i}"] = jc.Connection(jc.joint.Revolute(drive=drive), "ground", name)
        pin = jc.Marker(name, (RADIUS * np.cos(angle), RADIUS * np.sin(angle)))
        joints[f"B{i}"] = jc.Connection(journal(), pin, jc.Marker("lever", (RADIUS, 0.0)))
        if stiffness:
            loads[f"S{i}"] = jc.load.JointSpring(f"M{i}", stiffness)
    if not free_lever:
        loads["F"] = jc.load.Force(jc.Marker("lever", (ARM, 0.0)), (0.0, force))
    return jc.Mechanism(bodies, joints, loads)


# A pin may turn against a hole on its own circle by the angle over the chord of the clearance.
ANGLE = 2 * np.arcsin(0.5 * PLAY / RADIUS)


def lost(stands, joint="L"):
    return float(jc.response.LostMotion(joint)(stands))


@pytest.fixture(scope="module")
def sprung():
    return jc.positions(servo(), {}, reverse_loads=True)


def test_a_held_horn_leaves_its_lever_the_angle_of_its_play():
    stands = jc.positions(servo(stiffness=None), {"M0": [0.0, 0.7]}, reverse_loads=True)
    turned = np.asarray(stands.coordinate("L") - stands.reversed.coordinate("L"))
    np.testing.assert_allclose(turned, 2 * ANGLE, rtol=1e-9)
    assert np.all(stands.is_solved) and not stands.warnings
    # The pin pushes along its offset.
    push, lies = np.asarray(stands.reaction("B0"))[:, :2], np.asarray(stands.offset("B0"))[:, :2]
    np.testing.assert_allclose(np.linalg.norm(lies, axis=1), PLAY, rtol=1e-9)
    cosine = np.sum(push * lies, axis=1) / np.linalg.norm(push, axis=1) / PLAY
    np.testing.assert_allclose(cosine, -1.0, rtol=1e-12)
    kept = stands.to_dataset()
    for name in stands.scene.mechanism.bodies:
        there, back = kept[f"{name}.com"].values, kept[f"reversed {name}.com"].values
        np.testing.assert_array_equal(there, stands.body(name).com)
        np.testing.assert_array_equal(back, stands.reversed.body(name).com)


def test_springs_of_horns_add_to_the_play(sprung):
    """k phi = F l cos(phi + angle), lever and horn turned by phi and the angle of the play."""
    turn = lambda phi: STIFFNESS * phi - FORCE * ARM * np.cos(phi + ANGLE)
    wanted = brentq(turn, 0.0, 0.1, xtol=1e-15) + ANGLE
    assert float(sprung.coordinate("L")[0]) == pytest.approx(wanted, rel=1e-9)
    assert lost(sprung) == pytest.approx(2 * wanted, rel=1e-9)
    torque = STIFFNESS * (wanted - ANGLE)
    push = np.asarray(sprung.reaction("B0"))[0]
    arm = RADIUS * np.cos(0.5 * ANGLE)
    assert np.linalg.norm(push[:2]) == pytest.approx(torque / arm, rel=1e-6)
    # A journal's own coordinate is how far it is turned in its bearing.
    assert float(sprung.coordinate("B0")[0]) == pytest.approx(ANGLE, rel=1e-6)


@pytest.mark.slow
def test_two_horns_share_the_load():
    """Their rests apart by less than the play: first one carries, then both."""
    apart = 0.4 * ANGLE
    stands = jc.positions(servo(horns=2, apart=apart), {}, reverse_loads=True)
    # lever x, horns x - angle -+ apart / 2 from their rests, to first order in the small angles
    turn = lambda x: 2 * STIFFNESS * (x - ANGLE) - FORCE * ARM * np.cos(x)
    wanted = brentq(turn, 0.0, 0.1, xtol=1e-15)
    assert lost(stands) == pytest.approx(2 * wanted, rel=2e-5)
    pushes = [np.linalg.norm(stands.reaction(name)[0]) for name in ("B0", "B1")]
    shares = STIFFNESS * (wanted - ANGLE + np.array([0.5, -0.5]) * apart) / RADIUS
    np.testing.assert_allclose(pushes, shares, rtol=1e-4)


def test_reversed_loads_leave_springs_as_they_are():
    """A preload that the load does not overcome holds the pin on its side both ways."""
    rig = servo(force=1.0)
    loads = rig.loads | {"P": jc.load.JointSpring("L", 20.0, 0.1)}
    stands = jc.positions(rig.with_loads(loads), {}, reverse_loads=True)
    ends = [float(own.coordinate("L")[0]) for own in (stands, stands.reversed)]
    for end, force in zip(ends, (1.0, -1.0), strict=True):
        turn = lambda x, f=force: STIFFNESS * (x - ANGLE) + 20.0 * (x - 0.1) - f * ARM * np.cos(x)
        assert end == pytest.approx(brentq(turn, -0.1, 0.1, xtol=1e-15), rel=1e-9)


def test_what_nothing_presses_is_named():
    stands = jc.positions(servo(free_lever=True), {})
    (said,) = stands.warnings
    assert said.startswith('"L" moves freely at 1 of 1 positions') and said in str(stands)
    assert float(stands.coordinate("L")[0]) == pytest.approx(0.0, abs=0.01 * ANGLE)


def pendulum(angle=0.0, spring=None):
    """A rod that hangs from a journal; `angle` from below at which it is guessed."""
    loads = {"gravity": jc.load.Gravity((0.0, -9.81))}
    if spring is not None:
        loads["S"] = jc.load.Spring(
            jc.Marker("ground", (0.0, 0.3)), jc.Marker("rod", (0.0, -0.2)), spring, 0.1
        )
    return jc.Mechanism(
        {"rod": jc.Body(0.4, 2e-3, (0.0, -0.1))},
        {"P": jc.Connection(journal(), "ground", "rod")},
        loads,
        guess={"P": angle},
    )


def test_a_pendulum_hangs_in_its_journal_from_wherever_it_is_guessed():
    for angle in (0.0, 2.0):
        stands = jc.positions(pendulum(angle), {})
        assert float(stands.coordinate("P")[0]) == pytest.approx(0.0, abs=1e-9)
        np.testing.assert_allclose(stands.offset("P")[0], (0.0, -PLAY, 0.0), atol=1e-12)
        assert not stands.warnings


def test_an_unstable_equilibrium_is_left_and_said():
    stands = jc.positions(pendulum(np.pi), {})
    assert np.cos(float(stands.coordinate("P")[0])) == pytest.approx(1.0, abs=1e-9)
    assert any("unstable" in said for said in stands.warnings)


def test_what_nothing_holds_is_refused():
    falls = jc.Mechanism(
        {"rod": jc.Body(0.4, 2e-3)},
        {"P": jc.Connection(jc.joint.Prismatic(), "ground", "rod", axis="y")},
        {"gravity": jc.load.Gravity((0.0, -9.81))},
    )
    with pytest.raises(ValueError, match='finds no rest at position 0: joint "P", free to'):
        jc.positions(falls, {})


def test_what_does_not_fit_is_refused_by_its_joint():
    with pytest.raises(ValueError, match='the journal of joint "B[01]" fits least'):
        jc.positions(servo(stiffness=None, horns=2, apart=3 * ANGLE), {"M0": [0.0], "M1": [0.0]})


def scissors(clearance=PLAY):
    """Two bars that journals join, one to the ground, one to a block that a spring holds in an
    inclined guide: three journals, three springs, no drive."""
    bar = lambda: jc.Body(0.6, 3e-3, (0.1, 0.0))
    end, way = (0.2, 0.0), (np.cos(TILT), np.sin(TILT), 0.0)
    return jc.Mechanism(
        {"left": bar(), "right": bar(), "block": jc.Body(0.2, 1e-4)},
        {
            "A": jc.Connection(journal(clearance), "ground", "left"),
            "G": jc.Connection(
                jc.joint.Prismatic(),
                jc.Marker("ground", (0.3, 0.0), axis=way),
                jc.Marker("block", axis=way),
            ),
            "B": jc.Connection(journal(clearance), "block", "right"),
            "C": jc.Connection(journal(clearance), jc.Marker("left", end), jc.Marker("right", end)),
        },
        {
            "gravity": jc.load.Gravity((0.0, -9.81)),
            "block": jc.load.JointSpring("G", 900.0, 2e-3),
            "tie": jc.load.Spring(
                jc.Marker("left", (0.1, 0.02)), jc.Marker("right", (0.1, -0.02)), 300.0, 0.1
            ),
            "hook": jc.load.Spring(
                jc.Marker("ground", (0.05, 0.3)), jc.Marker("left", (0.15, 0.0)), 200.0, 0.1
            ),
        },
        guess={"left": (0.0, 0.0, 0.72), "right": (0.3, 0.0, 2.42)},
    )


TILT = 0.3


def least_by_scipy(clearance=PLAY):
    """Poses (x, y, angle) of both bars and the place of the block at the least energy within the
    clearances, by SLSQP; unknowns are places in the order of what they move."""
    angle = np.arccos(0.15 / 0.2)
    home = np.array([0.0, 0.0, angle, 0.0, 0.0, np.pi - angle, 0.0])
    sizes = np.array([clearance, clearance, 1.0, clearance, clearance, 1.0, 0.1])
    turn = lambda a: np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    slope = np.array([np.cos(TILT), np.sin(TILT)])

    def points(u):
        pose = home + sizes * u
        hole = np.array([0.3, 0.0]) + pose[6] * slope
        origin = pose[:2], hole + pose[3:5]
        return pose, hole, lambda i, at: origin[i] + turn(pose[3 * i + 2]) @ np.array(at)

    def energy(u):
        pose, hole, place = points(u)
        spring = lambda k, free, a, b: 0.5 * k * (np.hypot(*(a - b)) - free) ** 2
        weight = 0.6 * (place(0, (0.1, 0.0))[1] + place(1, (0.1, 0.0))[1]) + 0.2 * hole[1]
        tie = spring(300.0, 0.1, place(0, (0.1, 0.02)), place(1, (0.1, -0.02)))
        hook = spring(200.0, 0.1, np.array([0.05, 0.3]), place(0, (0.15, 0.0)))
        return 9.81 * weight + tie + hook + 450.0 * (pose[6] - 2e-3) ** 2

    gap = lambda u: points(u)[2](0, (0.2, 0.0)) - points(u)[2](1, (0.2, 0.0))
    room = lambda u: np.array([1 - u[0] ** 2 - u[1] ** 2, 1 - u[3] ** 2 - u[4] ** 2])
    start = np.zeros(7)
    for factor in (100.0, 1.0):
        # A wide gap at C first: the circle of its clearance is narrow beside the ways of the bars.
        limits = [
            {"type": "ineq", "fun": room},
            {
                "type": "ineq",
                "fun": lambda u, f=factor: 1 - np.sum(gap(u) ** 2) / (f * clearance) ** 2,
            },
        ]
        found = minimize(
            energy,
            start,
            constraints=limits,
            method="SLSQP",
            options={"ftol": 1e-15, "maxiter": 2000},
        )
        start = found.x
    pose, hole, _ = points(found.x)
    pose[3:5] += hole
    return pose


def test_a_derivative_is_that_of_the_closed_form():
    """k phi = F l cos(phi + angle): by the force, the stiffness and the clearance, of all samples
    at once."""
    study = jc.PositionProblem(
        servo(),
        lambda own: own.coordinate("L")[0],
        {
            "force": jc.Variable(lambda m: m.loads["F"].value[1], tolerance=0.4),
            "stiffness": jc.Variable(lambda m: m.loads["S0"].stiffness, tolerance=2.0),
            "clearance": jc.Variable(lambda m: m.connections["B0"].joint.clearance, tolerance=2e-5),
        },
        positions={},
    )
    ask = lambda v: study.evaluate(v).responses["response"]
    at = jnp.stack([study.nominal(), study.nominal() * jnp.array([0.5, 1.2, 0.7])])
    found, slopes = jax.jit(jax.vmap(jax.value_and_grad(ask)))(at)
    for (force, stiffness, clearance), turned, slope in zip(at, found, slopes, strict=True):
        angle = 2 * np.arcsin(0.5 * clearance / RADIUS)
        turn = lambda phi, f=force, k=stiffness, a=angle: k * phi - f * ARM * np.cos(phi + a)
        phi = brentq(turn, 0.0, 0.1, xtol=1e-15)
        assert float(turned) == pytest.approx(phi + angle, rel=1e-9)
        stiff = stiffness + force * ARM * np.sin(phi + angle)
        of_angle = stiffness / stiff / RADIUS / np.sqrt(1 - (0.5 * clearance / RADIUS) ** 2)
        wanted = [ARM * np.cos(phi + angle) / stiff, -phi / stiff, of_angle]
        np.testing.assert_allclose(slope, wanted, rtol=1e-7)


@pytest.mark.slow
def test_samples_near_the_nominal_mechanism_rest_where_a_search_finds_and_need_none(monkeypatch):
    """Newton's method on the contacts that carry the nominal mechanism, also under reversed loads;
    a whole search took forty turns."""
    study = jc.PositionProblem(
        servo(),
        {"turned": lambda own: own.coordinate("L")[0], "lost": jc.response.LostMotion("L")},
        {
            "force": jc.Variable(lambda m: m.loads["F"].value[1], tolerance=0.4),
            "clearance": jc.Variable(lambda m: m.connections["B0"].joint.clearance, tolerance=2e-5),
        },
        positions={},
        reverse_loads=True,
    )
    at = study.nominal() * jnp.array([[0.9, 1.2], [1.1, 0.8]])
    searched = [jc.positions(study.with_values(own), {}, reverse_loads=True) for own in at]
    monkeypatch.setattr(least_energy, "MOST_TURNS", 0)
    found = jax.jit(jax.vmap(study.evaluate))(at)
    assert np.all(found.outcome == jc.integrator.Outcome.REACHED)
    for i, own in enumerate(searched):
        turned = float(own.coordinate("L")[0]), float(own.reversed.coordinate("L")[0])
        assert float(found.responses["turned"][i]) == pytest.approx(turned[0], abs=1e-14)
        assert float(found.responses["lost"][i]) == pytest.approx(turned[0] - turned[1], abs=1e-14)


@pytest.fixture(scope="module")
def shut():
    """A study of the scissors: angle of the left bar; clearance and weight of a bar vary."""
    return jc.PositionProblem(
        scissors(),
        {
            "angle": lambda own: own.coordinate("left")[0, 2],
            "push": lambda own: own.reaction("C")[0, 0],
        },
        {
            "clearance": jc.Variable(lambda m: m.connections["C"].joint.clearance, tolerance=2e-5),
            "mass": jc.Variable(lambda m: m.bodies["left"].mass, tolerance=0.1),
        },
        positions={},
    )


@pytest.mark.slow
def test_springs_and_journals_rest_where_scipy_finds_the_least_energy(shut):
    stands = shut.detail(shut.nominal())
    wanted = least_by_scipy()
    found = np.hstack([stands.coordinate(name)[0] for name in ("left", "right", "G")])
    # SLSQP is right to the root of its accuracy in energy.
    np.testing.assert_allclose(found, wanted, atol=0.02 * PLAY)
    lies = [np.linalg.norm(stands.offset(name)[0]) for name in "ABC"]
    np.testing.assert_allclose(lies, PLAY, rtol=1e-9)


@pytest.mark.slow(sample=False)  # compiles three programs
def test_derivatives_are_those_of_differences(shut):
    ask = jax.jit(lambda v: jnp.stack(list(shut.evaluate(v).responses.values())))
    at = shut.nominal()
    forward, backward = jax.jit(jax.jacfwd(ask))(at), jax.jit(jax.jacrev(ask))(at)
    np.testing.assert_allclose(forward, backward, rtol=1e-9)
    for i, step in enumerate((2e-7, 1e-3)):
        move = step * np.eye(2)[i]
        near = (ask(at + move) - ask(at - move)) / (2 * step)
        far = (ask(at + 2 * move) - ask(at - 2 * move)) / (4 * step)
        np.testing.assert_allclose(forward[:, i], (4 * near - far) / 3, rtol=1e-6)


@pytest.mark.slow
def test_samples_are_batched_and_each_is_as_alone(shut):
    study = jc.monte_carlo(shut, 8)
    assert not study.failed.size
    clearance, mass = study.values[3]
    rig = eqx.tree_at(
        lambda m: (m.connections["C"].joint.clearance, m.bodies["left"].mass),
        scissors(),
        (jnp.asarray(clearance), jnp.asarray(mass)),
    )
    alone = jc.positions(rig, {}).coordinate("left")[0, 2]
    assert study.responses["angle"][3] == pytest.approx(float(alone), rel=1e-11)


def four_bar():
    return jc.scenes.four_bar("planar", 0.2e-3, friction=False, wear=False)


@pytest.mark.slow
def test_energy_and_loops_find_the_same_place():
    """Of a mechanism that its loops determine."""
    angles, rig = np.array([0.4, 1.9]), four_bar()
    by_loops = jc.positions(rig, {"O": angles})
    scene = posed(rig, ("O",), loose=True)
    start, way = least_energy.initial_rest(scene.at(angles[:1]))
    position = jnp.asarray(angles[:, None])
    spots = spots_along(scene, angles[:, None], way, start)
    by_energy = Positions(scene, position, *way.read(scene, position, spots))
    np.testing.assert_allclose(by_energy.coordinate("D"), by_loops.coordinate("D"), atol=1e-12)
    np.testing.assert_allclose(by_energy.offset("B"), by_loops.offset("B"), atol=1e-12)
    np.testing.assert_allclose(by_energy.reaction("A"), by_loops.reaction("A"), atol=1e-8)


def block(axis, other):
    """A block on an inclined guide, on which a lever pivots about the ground by a loose pin."""
    guide = {"axis": axis}
    return jc.Mechanism(
        {"block": jc.Body(0.3, 1e-4), "lever": jc.Body(0.1, 1e-4, (0.05, 0.0))},
        {
            "G": jc.Connection(
                jc.joint.Prismatic(), jc.Marker("ground", **guide), jc.Marker("block", **other)
            ),
            "O": jc.Connection(jc.joint.Revolute(), "ground", "lever", at=(0.0, -0.08)),
            "P": jc.Connection(
                journal(), jc.Marker("block", (0.0, 0.0)), jc.Marker("lever", (0.08, 0.0))
            ),
        },
        {"F": jc.load.Torque(jc.Marker("lever"), 0.4)},
        guess={"O": np.pi / 2},
    )


def test_an_inclined_guide_by_numbers_holds_a_pin():
    """Lost motion by the chord of the clearance: 2 c / distance."""
    slope = (np.cos(0.5), np.sin(0.5), 0.0)
    stands = jc.positions(block(slope, {"axis": slope}), {"G": [0.0]}, reverse_loads=True)
    wanted = 4 * np.arcsin(0.5 * PLAY / 0.08)
    assert lost(stands, "O") == pytest.approx(wanted, rel=1e-9)
    assert lost(stands, "O") == pytest.approx(2 * PLAY / 0.08, rel=1e-6)


def slider_crank(axis):
    rig = jc.scenes.slider_crank(clearance=0.1e-3)
    old = rig.connections["G"]
    turned = [
        jc.Marker(m.body, None if m.at is None else m.at, axis=axis)
        for m in (old.parent, old.child)
    ]
    connections = rig.connections | {"G": jc.Connection(old.joint, *turned)}
    return jc.Mechanism(rig.bodies, connections, rig.loads, guess=rig.guess)


@pytest.mark.slow
def test_an_axis_by_numbers_is_that_of_its_name():
    """Five rows of the guide, of which two are independent: those are taken."""
    crank = np.array([0.3, 2.0])
    named = jc.positions(jc.scenes.slider_crank(clearance=0.1e-3), {"O": crank})
    given = jc.positions(slider_crank((1.0, 0.0, 0.0)), {"O": crank})
    assert given.carried is None and given.scene.rows is not None
    np.testing.assert_allclose(given.coordinate("G"), named.coordinate("G"), atol=1e-12)


def test_a_lever_whose_spring_balances_its_weight_stands_anywhere():
    """A spring without free length: k a b = m g l balances everywhere; a softer one nowhere but
    hanging down."""
    lever = lambda share: jc.Mechanism(
        {"lever": jc.Body(0.5, 1e-3, (0.1, 0.0))},
        {"O": jc.Connection(jc.joint.Revolute(), "ground", "lever")},
        {
            "gravity": jc.load.Gravity((0.0, -9.81)),
            "S": jc.load.Spring(
                jc.Marker("ground", (0.0, 0.2)),
                jc.Marker("lever", (0.15, 0.0)),
                share * 0.5 * 9.81 * 0.1 / (0.2 * 0.15),
            ),
        },
        guess={"O": 0.4},
    )
    balanced = jc.positions(lever(1.0), {})
    assert float(balanced.coordinate("O")[0]) == pytest.approx(0.4, abs=1e-6)
    assert balanced.warnings and balanced.warnings[0].startswith('"O" moves freely')
    hangs = jc.positions(lever(0.7), {})
    assert np.sin(float(hangs.coordinate("O")[0])) == pytest.approx(-1.0, abs=1e-12)
    assert not hangs.warnings


def test_positions_of_a_drive_lead_a_sprung_lever_along():
    """A crank pulls a lever by a spring: freedoms left are followed from one position to the
    next."""
    rig = jc.Mechanism(
        {"crank": jc.Body(0.1, 1e-4), "lever": jc.Body(0.1, 1e-4)},
        {
            "C": jc.Connection(jc.joint.Revolute(), "ground", "crank"),
            "L": jc.Connection(jc.joint.Revolute(), "ground", "lever", at=(0.3, 0.0)),
        },
        {
            "pull": jc.load.Spring(
                jc.Marker("crank", (0.1, 0.0)), jc.Marker("lever", (-0.1, 0.0)), 500.0, 0.05
            ),
            "back": jc.load.JointSpring("L", 1.0),
        },
    )
    angles = np.array([0.0, 1.2, 2.4])
    found = np.asarray(jc.positions(rig, {"C": angles}).coordinate("L"))
    for crank, lever in zip(angles, found, strict=True):
        start = 0.1 * np.array([np.cos(crank), np.sin(crank)])

        def energy(x, start=start):
            end = np.array([0.3, 0.0]) - 0.1 * np.array([np.cos(x), np.sin(x)])
            return 250.0 * (np.hypot(*(end - start)) - 0.05) ** 2 + 0.5 * x**2

        best = minimize(lambda x, e=energy: e(x[0]), [lever], tol=1e-14)
        assert lever == pytest.approx(best.x[0], abs=1e-6)


LENGTH, WIDTH = 0.04, 0.02


def test_a_loose_slider_tilts_between_its_walls():
    """Angular play of a slider in a guide: (l / 2) sin + (w / 2) cos = w / 2 + c."""
    half = 0.25
    guide = jc.Marker("ground", quaternion=_inclined(half))
    rig = jc.Mechanism(
        {"slider": jc.Body(0.3, 1e-4)},
        {
            "G": jc.Connection(
                jc.clearance.SliderGuide(LAW, width=WIDTH, length=LENGTH, clearance=PLAY),
                guide,
                jc.Marker("slider", quaternion=_inclined(0.0)),
            )
        },
        {
            "T": jc.load.Torque(jc.Marker("slider"), 0.3),
            "S": jc.load.Spring(
                jc.Marker("ground", (-0.2, -0.05)), jc.Marker("slider"), 100.0, 0.1
            ),
        },
        guess={"slider": (0.0, 0.0, 2 * half)},
    )
    stands = jc.positions(rig, {}, reverse_loads=True)
    tilts = [float(own.coordinate("slider")[0, 2]) - 2 * half for own in (stands, stands.reversed)]
    room = lambda a: 0.5 * LENGTH * np.sin(a) + 0.5 * WIDTH * np.cos(a) - 0.5 * WIDTH - PLAY
    wanted = brentq(room, 0.0, 0.1, xtol=1e-15)
    np.testing.assert_allclose(tilts, (wanted, -wanted), rtol=1e-8)


def _inclined(half):
    """Quaternion of a guide along x, turned about z by twice an angle: z along it, x across."""
    along = np.array([0.5, 0.5, 0.5, 0.5])
    w, x, y, z = along
    c, s = np.cos(half), np.sin(half)
    return (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)


def test_a_shaft_leans_in_a_long_bearing_and_stands_on_its_collar():
    """Weight beside the bearing: ends of the journal on opposite walls, (2 c - lean terms) / L."""
    length = 0.03
    flange = jc.clearance.Flange(LAW, radius=9e-3, clearance=0.1e-3)
    bearing = jc.clearance.JournalBearing(
        LAW, bearing_radius=6e-3, clearance=PLAY, length=length, flange=flange
    )
    rig = jc.Mechanism(
        {"shaft": jc.Body(0.5, (1e-3, 1e-3, 1e-4), (0.2, 0.0, 0.01))},
        {"J": jc.Connection(bearing, "ground", "shaft")},
        {"gravity": jc.load.Gravity((0.0, 0.0, -9.81))},
    )
    stands = jc.positions(rig, {})
    assert np.all(stands.is_solved)
    seat = np.asarray(stands.seats["J"])[0]
    force, torque = np.split(np.asarray(stands.reaction("J"))[0], 2)
    assert force[2] == pytest.approx(0.5 * 9.81, rel=1e-9)
    # Each end as far from the middle as the ellipse of a leaning journal lets it.
    lean = np.hypot(seat[3], seat[4])
    assert 0.5 * length * lean == pytest.approx(PLAY - 0.5 * (6e-3 - PLAY) * lean**2, rel=1e-6)
    assert lean == pytest.approx(2 * PLAY / length, rel=2e-3)
    assert np.hypot(torque[0], torque[1]) == pytest.approx(0.5 * 9.81 * 0.2, rel=2e-2)
    # It may turn about its axis, wherever its weight leans it.
    assert any('body "shaft" moves freely' in said for said in stands.warnings)
    assert seat[2] < -0.5 * 0.1e-3


def test_a_slider_crank_that_a_joint_closes_rests_where_its_energy_is_least():
    turn = jc.joint.Revolute()
    rig = jc.Mechanism(
        {
            "crank": jc.Body(0.1, 1e-4, com=(0.02, 0.0)),
            "rod": jc.Body(0.1, 1e-4, com=(0.05, 0.0)),
            "slider": jc.Body(0.2, 1e-4),
        },
        {
            "O": jc.Connection(turn, "ground", "crank"),
            "A": jc.Connection(turn, "crank", "rod", at=(0.04, 0.0)),
            "B": jc.Connection(turn, "rod", "slider", at=(0.1, 0.0)),
            "G": jc.Connection(jc.joint.Prismatic(), "ground", "slider", axis="x"),
        },
        {"spring": jc.load.JointSpring("O", 3.0, 0.5), "weight": jc.load.Gravity((0.0, -9.81))},
        guess={"O": 0.4, "A": -0.6},
    )

    def energy(turned):
        height = 0.04 * np.sin(turned)
        weights = 0.1 * 0.5 * height + 0.1 * (height - 0.05 * height / 0.1)
        return 1.5 * (turned - 0.5) ** 2 + 9.81 * weights

    least = minimize_scalar(energy, bounds=(-0.5, 1.2), options={"xatol": 1e-10})
    found = jc.positions(rig, {}).coordinate("O")[0]
    np.testing.assert_allclose(found, least.x, atol=1e-7)
