"""A mechanism over positions of its drive: journals lie where the potential energy is least, and
derivatives are those of the solved equations."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq, minimize

import jaxclear as jc
from jaxclear.statics.position_path import positions_at, spots_along
from jaxclear.statics.quasi_static import find_spot, loop_method, posed
from tests.rigs.cells import slow

CRANK, COUPLER, FOLLOWER, GROUND, CLEARANCE, GRAVITY = 0.1, 0.4, 0.3, 0.3, 0.3e-3, 9.81
ANGLES = np.array([0.2, 1.5, 2.8, 4.1, 5.4])


def journal(clearance):
    law = jc.contact.Hertz(stiffness=1e9)
    return jc.clearance.PlanarJournalBearing(contact=law, clearance=clearance)


def four_bar(slack="AB", clearance=CLEARANCE):
    """A four-bar whose joints named in `slack` have clearance."""
    joint = lambda name: journal(clearance) if name in slack else jc.joint.Revolute()
    return jc.Mechanism(
        {
            "crank": jc.Body(0.5, 1e-3, (0.5 * CRANK, 0.0)),
            "coupler": jc.Body(1.4, 2e-2, (0.5 * COUPLER, 0.02)),
            "follower": jc.Body(1.6, 1e-2, (0.5 * FOLLOWER, 0.0)),
        },
        {
            "O": jc.Connection(
                jc.joint.Revolute(drive=jc.drive.ConstantSpeed(1.0)), "ground", "crank"
            ),
            "A": jc.Connection(joint("A"), "crank", "coupler", at=(CRANK, 0.0)),
            "B": jc.Connection(
                joint("B"),
                jc.Marker("coupler", (COUPLER, 0.0)),
                jc.Marker("follower", (FOLLOWER, 0.0)),
            ),
            "D": jc.Connection(joint("D"), "ground", "follower", at=(GROUND, 0.0)),
        },
        {"gravity": jc.load.Gravity((0.0, -GRAVITY))},
        guess={"A": 0.81, "D": 1.32},
    )


def direction(angle):
    return np.array([np.cos(angle), np.sin(angle)])


def ideal_angles(crank):
    """Ground-axes angles of coupler and follower of the ideal four-bar, from its closure."""
    tip = CRANK * direction(crank)

    def miss(follower):
        end = np.array([GROUND, 0.0]) + FOLLOWER * direction(follower)
        return np.hypot(*(end - tip)) - COUPLER

    follower = brentq(miss, 0.3, 2.6, xtol=1e-15)
    end = np.array([GROUND, 0.0]) + FOLLOWER * direction(follower)
    return np.arctan2(*(end - tip)[::-1]), follower


def least_energy(crank, clearance, gravity):
    """Angle of the follower at the least potential energy that offsets of A and B within their
    clearance allow, by scipy's SLSQP: nothing of reactions is in it. Unknowns in clearances."""
    tip, ideal = CRANK * direction(crank), ideal_angles(crank)
    sizes = np.array([1.0, 1.0, 1 / COUPLER, 1 / FOLLOWER]) * clearance

    def places(x):
        offset, angles = x[:2] * clearance, ideal + x[2:] * sizes[2:]
        a = tip + offset
        follower = np.array([GROUND, 0.0]) + FOLLOWER * direction(angles[1])
        return a, angles, (follower - a - COUPLER * direction(angles[0])) / clearance

    def height(x):
        a, (coupler, follower), _ = places(x)
        own = a[1] + 0.5 * COUPLER * np.sin(coupler) + 0.02 * np.cos(coupler)
        return 1.4 * own + 1.6 * 0.5 * FOLLOWER * np.sin(follower)

    level, sign = height(np.zeros(4)), np.sign(gravity)
    limits = [
        {"type": "ineq", "fun": lambda x: 1 - x[0] ** 2 - x[1] ** 2},
        {"type": "ineq", "fun": lambda x: 1 - np.sum(places(x)[2] ** 2)},
    ]
    found = minimize(
        lambda x: sign * (height(x) - level) / clearance,
        np.zeros(4),
        constraints=limits,
        method="SLSQP",
        options={"ftol": 1e-11, "maxiter": 500},
    )
    assert found.success
    return places(found.x)[1][1]


@pytest.fixture(scope="module")
def found():
    return jc.positions(four_bar(), {"O": ANGLES}, reverse_loads=True)


@pytest.mark.slow
def test_without_clearance_bodies_stand_where_the_loop_closes():
    stands = jc.positions(four_bar(slack=""), {"O": ANGLES})
    closed = np.array([ideal_angles(angle) for angle in ANGLES])
    np.testing.assert_allclose(stands.coordinate("D"), closed[:, 1], atol=1e-12)
    np.testing.assert_allclose(
        stands.coordinate("A") + ANGLES, closed[:, 0] % (2 * np.pi), atol=1e-12
    )


def test_journals_lie_where_the_potential_energy_is_least(found):
    """Within what SLSQP finds: its coordinates are right to the root of its accuracy in energy."""
    for way, gravity in ((found, GRAVITY), (found.reversed, -GRAVITY)):
        for i, angle in enumerate(ANGLES):
            follower = least_energy(angle, CLEARANCE, gravity)
            slip = float(way.coordinate("D")[i]) - ideal_angles(angle)[1]
            assert slip == pytest.approx(follower - ideal_angles(angle)[1], rel=1e-3)
        for joint in "AB":
            lengths = np.linalg.norm(way.offset(joint), axis=1)
            np.testing.assert_allclose(lengths, CLEARANCE, rtol=1e-12)


def test_a_journal_lies_opposite_to_its_reaction(found):
    for joint in "AB":
        force = np.asarray(found.reaction(joint))[:, :3]
        lies = -CLEARANCE * force / np.linalg.norm(force, axis=1, keepdims=True)
        np.testing.assert_allclose(found.offset(joint), lies, atol=1e-9 * CLEARANCE)


def test_lost_motion_is_the_way_from_load_to_reversed_load(found):
    ways = [np.asarray(way.coordinate("D")) for way in (found, found.reversed)]
    lost = float(jc.response.LostMotion("D")(found))
    assert lost == np.abs(ways[0] - ways[1]).max() > CLEARANCE


def test_coordinates_of_the_drive_and_places_are_told(found):
    np.testing.assert_array_equal(found.coordinate("O"), ANGLES)
    tip = CRANK * np.stack([np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES], 1)
    np.testing.assert_allclose(found.marker("crank", (CRANK, 0.0)).position, tip, atol=1e-15)
    away = np.asarray(found.marker("coupler", (0.0, 0.0)).position) - tip
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), CLEARANCE, rtol=1e-9)


@pytest.mark.parametrize(
    ("mechanism", "positions", "sentence"),
    [
        (four_bar(), {"A": ANGLES}, 'joint "O" is driven and its positions are not told'),
        (four_bar(), {"O": ANGLES, "Q": ANGLES}, 'no joint "Q" to be held'),
        *slow((four_bar(), {"O": ANGLES, "D": ANGLES}, r"cannot be assembled .* 0 \(O = 0.2")),
        (four_bar(), {"O": [1.0, np.nan]}, "must be finite numbers in a row"),
        (four_bar(), {"O": ANGLES, "D": [1.0]}, "as many coordinates of each"),
    ],
)
def test_what_cannot_be_asked_is_refused_with_a_sentence(mechanism, positions, sentence):
    with pytest.raises(ValueError, match=sentence):
        jc.positions(mechanism, positions)


def test_a_position_out_of_reach_is_named():
    """A crank longer than the rod that it leads."""
    crank = jc.Mechanism(
        {name: jc.Body(1.0, 1e-2) for name in ("crank", "rod", "block")},
        {
            "pin": jc.Connection(jc.joint.Revolute(), "ground", "crank"),
            "knee": jc.Connection(jc.joint.Revolute(), "crank", "rod", at=(0.2, 0.0)),
            "end": jc.Connection(jc.joint.Revolute(), "rod", "block", at=(0.15, 0.0)),
            "way": jc.Connection(
                jc.joint.Prismatic(), jc.Marker("ground", axis="x"), jc.Marker("block", axis="x")
            ),
        },
        guess={"knee": -0.3, "way": 0.34},
    )
    with pytest.raises(ValueError, match=r"at position 2 \(pin = 1.2\)"):
        jc.positions(crank, {"pin": [0.1, 0.6, 1.2]})


@pytest.mark.slow
def test_the_way_of_assembly_is_told_and_a_fall_to_the_other_is_found_out():
    """A four-bar closes in two ways, whose loops' determinants have opposite signs."""
    scene = posed(four_bar(""), ("O",))
    way, places = loop_method(scene), ANGLES[:2, None]
    here = spots_along(scene, places, way)
    assert np.all(here.branch == here.branch[0]) and abs(here.branch[0]) == 1
    # Started near the other way, mirrored at the line from A to D, but told to be on this one.
    elbow = np.arctan2(CRANK * np.sin(ANGLES[:2]), CRANK * np.cos(ANGLES[:2]) - GROUND)
    mirrored = np.array(here.q)
    for i, angle in enumerate(elbow):
        stands = positions_at(
            scene, places[i : i + 1], jax.tree.map(lambda x: x[i : i + 1], here), way
        )
        follower = float(stands.coordinate("D")[0])
        coupler = float(stands.coordinate("A")[0])
        mirrored[i] = np.where(np.isclose(here.q[i], follower), 2 * angle - follower, mirrored[i])
        turned = 2 * angle - (ANGLES[i] + coupler) - ANGLES[i]
        mirrored[i] = np.where(np.isclose(here.q[i], coupler), turned, mirrored[i])
    fallen = eqx.tree_at(lambda spot: spot.q, here, jnp.asarray(mirrored))
    there = positions_at(scene, places, fallen, way)
    assert not np.any(there.is_solved) and np.all(positions_at(scene, places, here, way).is_solved)
    gone = jax.vmap(lambda own, start: find_spot(scene.at(own), start, way))(places, fallen)
    np.testing.assert_array_equal(gone.branch, -here.branch)
    assert np.all(gone.change < 1e-9)


def six_bar():
    """A crank (0.2358 m) drives the coupler of a four-bar by a rod: two loops, up to six ways to
    assemble it at one position, so that several have one sign."""
    lengths = {"crank": 0.2358, "rod": 0.1781, "left": 0.3715, "coupler": 0.3219, "right": 0.2281}
    hinge = lambda parent, child, at=(0.0, 0.0), of=(0.0, 0.0): jc.Connection(
        jc.joint.Revolute(), jc.Marker(parent, at), jc.Marker(child, of)
    )
    end = {name: (length, 0.0) for name, length in lengths.items()}
    return jc.Mechanism(
        {name: jc.Body(1.0, 1e-2, (0.5 * length, 0.0)) for name, length in lengths.items()},
        {
            "F": hinge("ground", "crank", (0.8732, -0.1047)),
            "E": hinge("crank", "rod", end["crank"]),
            "O": hinge("ground", "left"),
            "A": hinge("left", "coupler", end["left"]),
            "B": hinge("coupler", "right", end["coupler"], end["right"]),
            "D": hinge("ground", "right", (0.7587, 0.0)),
            "C": hinge("rod", "coupler", end["rod"], (0.3165, 0.277)),
        },
        guess={"E": 1.76604, "O": 0.505952, "A": -1.350362, "D": -2.872894},
    )


SIX_BAR_START = 1.3691


@pytest.fixture(scope="module")
def far_apart():
    return jc.positions(six_bar(), {"F": SIX_BAR_START + np.array([0.0, 0.75, 1.5])})


@pytest.mark.slow
def test_a_path_of_far_positions_is_that_of_near_ones(far_apart):
    near = jc.positions(six_bar(), {"F": SIX_BAR_START + np.linspace(0.0, 1.5, 61)})
    moved = np.abs(np.diff(np.asarray(near.coordinates), axis=0))
    assert moved.max() < 0.3
    np.testing.assert_allclose(far_apart.coordinates, near.coordinates[::30], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("turns", "sentence"),
    [
        ([0.0, 0.5, 1.0, 1.5, 1.7], "cannot be assembled at position 4"),
        ([0.0, 1.5, 2.0], "jumps to another way of its assembly before F = 3.3691"),
    ],
)
def test_a_path_that_jumps_is_refused_though_the_loops_keep_their_sign(turns, sentence):
    """The way on which it was assembled ends 1.55 rad on, at a dead point; others of the same sign
    go on, 0.7 rad away."""
    with pytest.raises(ValueError, match=sentence):
        jc.positions(six_bar(), {"F": SIX_BAR_START + np.array(turns)})


def test_what_a_run_starts_with_holds_no_position():
    """The slider's place at one position of the crank was held at all of them, and none closed."""
    rig = jc.scenes.slider_crank(clearance=0.1e-3)
    started = jc.Mechanism(rig.bodies, rig.connections, rig.loads, start={"G": 0.17})
    crank = np.array([0.3, 2.0])
    found = jc.positions(started, {"O": crank})
    ideal = 0.05 * np.cos(crank) + np.sqrt(0.12**2 - (0.05 * np.sin(crank)) ** 2)
    # The journal is off by its clearance of 0.1 mm at the most, and the rod leans.
    np.testing.assert_allclose(found.coordinate("G"), ideal, atol=1.2e-4)


def test_positions_are_shown_in_words(found):
    assert str(found) == "5 positions, also under reversed loads: O from 0.2 to 5.4 rad."


@pytest.mark.parametrize("closing", ["A", *slow("D")])
def test_a_reaction_holds_the_loads_on_its_coordinate_wherever_the_loop_is_cut(closing):
    """A torsion spring in a joint that closes the loop, or that the tree carries."""
    rig, stiffness = four_bar(slack=""), 2.0
    order = [name for name in "OABD" if name != closing] + [closing]
    sprung = jc.Mechanism(
        rig.bodies,
        {name: rig.connections[name] for name in order},
        rig.loads | {"spring": jc.load.JointSpring("A", stiffness)},
        guess={"A": 0.81, "D": 1.32},
    )
    found = jc.positions(sprung, {"O": ANGLES[:1]})
    torque = -stiffness * (ideal_angles(ANGLES[0])[0] - ANGLES[0])
    np.testing.assert_allclose(found.reaction("A")[0, 5], torque, rtol=1e-9)


def test_a_motor_that_is_held_is_read_by_its_name():
    """A motor behind a gear of 100 turns by 30 rad where its arm, but for its twist, by 0.3."""
    mechanism = jc.Mechanism(
        {"arm": jc.Body(2.0, 0.1, (0.3, 0.0))},
        {"hinge": jc.Connection(jc.joint.Revolute(), "ground", "arm")},
        {"gravity": jc.load.Gravity((0.0, -9.81))},
        couplings={
            "gear": jc.coupling.Gear(jc.coupling.Motor(2e-5), "hinge", ratio=100, stiffness=2e4)
        },
    )
    rests = jc.positions(mechanism, {"gear.motor": [30.0, 10.0]})
    np.testing.assert_array_equal(rests.coordinate("gear.motor"), [30.0, 10.0])
    hinge = np.asarray(rests.coordinate("hinge"))
    twist = 2.0 * 9.81 * 0.3 * np.cos(hinge) / 2e4
    np.testing.assert_allclose(hinge, [0.3, 0.1] - twist, rtol=1e-9)
    with pytest.raises(ValueError, match='"hinge", "gear.motor"'):
        rests.coordinate("gear")
