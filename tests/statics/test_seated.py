"""A start in contact: journals lie where their reactions press them, and do not fall."""

import warnings

import jax
import numpy as np
import pytest

import jaxclear as jc

TURN = 0.1
LAW = jc.contact.CarvalhoMartins(stiffness=1e10, restitution=0.5)


def slider_crank(kind=jc.clearance.PlanarJournalBearing, wear=True, push=-400.0):
    """A crank that is driven, and a slider that a force pushes towards it."""
    numbers = {"bearing_radius": 10e-3, "clearance": 0.1e-3, "length": 20e-3}
    if wear:
        numbers["bearing_wear"] = jc.Wearing(jc.wear.Archard(), (36, 1))
    pin = kind(LAW, jc.friction.CoulombTanh(mu_kinetic=0.1), **numbers)
    turning = jc.joint.Revolute(drive=jc.drive.ConstantSpeed(2 * np.pi / TURN))
    return jc.Mechanism(
        {
            "crank": jc.Body(0.2, 1e-4, com=(0.02, 0.0)),
            "rod": jc.Body(0.3, 5e-4, com=(0.1, 0.0)),
            "slider": jc.Body(0.5, 1e-4),
        },
        {
            "O": jc.Connection(turning, "ground", "crank"),
            "A": jc.Connection(pin, jc.Marker("crank", (0.04, 0.0)), "rod"),
            "B": jc.Connection(jc.joint.Revolute(), jc.Marker("rod", (0.2, 0.0)), "slider"),
            "G": jc.Connection(jc.joint.Prismatic(), "ground", "slider", axis="x"),
        },
        {"g": jc.load.Gravity(), "push": jc.load.Force(jc.Marker("slider"), (push, 0.0))},
    )


def test_other_numbers_rest_by_the_same_programs(caplog):
    """A program was made of each depth that was tried."""
    bearing = jc.clearance.PlanarJournalBearing(LAW, clearance=1e-4)
    pressed = lambda load: jc.Mechanism(
        {"shaft": jc.Body(1.0, 1e-3)},
        {"J": jc.Connection(bearing, "ground", "shaft")},
        {"load": jc.load.Force(jc.Marker("shaft"), (0.0, -load))},
    )
    jc.resting_state(pressed(100.0))
    with jax.log_compiles():
        jc.resting_state(pressed(150.0))
    assert not [each for each in caplog.records if each.msg.startswith("Compiling")]


@pytest.mark.slow
def test_a_seated_journal_carries_its_reaction_from_the_first_instant_on():
    """That of the joint which always touches; from the middle it falls through its play first."""
    rig = slider_crank(wear=False)
    integrator = jc.integrator.Adaptive(rtol=1e-6, atol=1e-9)
    wanted = jc.simulate(rig, 1e-3, save=2, integrator=jc.integrator.NonColliding(1e-5))
    force = wanted.contact("A").normal_force[0, 0]
    assert force > 100.0
    runs = [
        jc.simulate(rig, 1e-3, save=21, integrator=integrator, state=state).contact("A")
        for state in (jc.resting_state(rig), None)
    ]
    # it rocks a little about its seat: the bearing gives way, which the ideal joint does not
    np.testing.assert_allclose(runs[0].normal_force[:, 0], force, rtol=0.03)
    np.testing.assert_allclose(runs[0].normal_force[0, 0], force, rtol=1e-3)
    assert float(runs[1].normal_force[:5].max()) == 0.0


@pytest.mark.slow
def test_the_first_cycle_of_a_seated_start_wears_as_the_settled_one():
    """From the middle ten times as far from it."""
    rig = slider_crank()
    problem = lambda state: jc.steady_cycle(rig, TURN, state=state, cycles=8, throw=False)
    lost = [
        [float(one.volumes["A"]["bearing"]) for one in problem(state).settling.cycles]
        for state in (None, jc.resting_state(rig))
    ]
    settled = np.mean([own[-1] for own in lost])
    fallen, seated = (abs(own[0] / settled - 1) for own in lost)
    assert seated < 2e-4 and fallen > 5 * seated


@pytest.mark.slow
def test_a_journal_in_a_worn_hole_is_seated_on_its_wall():
    rig = slider_crank()
    deep = {"A": {"bearing": np.full((36, 1), 5e-5)}}
    new, worn = (jc.resting_state(rig, worn) for worn in (None, deep))
    away = [
        np.linalg.norm(jc.simulate(rig, 1e-6, save=2, state=one).contact("A").offset[0])
        for one in (new, worn)
    ]
    np.testing.assert_allclose(away[1] - away[0], 5e-5, rtol=1e-3)


def test_a_mechanism_without_play_is_seated_as_it_starts():
    rig = slider_crank()
    ends = rig.connections["A"].parent, rig.connections["A"].child
    ideal = rig.connections | {"A": jc.Connection(jc.joint.Revolute(), *ends)}
    assert jc.resting_state(jc.Mechanism(rig.bodies, ideal, rig.loads)).motion is None


@pytest.mark.slow(sample=False)
def test_journals_that_their_loops_hold_back_rest_together():
    """The reaction alone would tilt the journal of the spatial four-bar by twice its play over its
    length, which the planes of its links do not allow: a collar and both ends share the load."""
    rig = jc.scenes.four_bar("spatial", wear=False, friction=False)
    instant = {"save": 2, "integrator": jc.integrator.NonColliding(1e-7)}
    wanted = np.asarray(jc.simulate(rig, 1e-7, **instant).reaction("B").force[0])
    fine = jc.integrator.Adaptive(rtol=1e-8, atol=1e-11)
    run = jc.simulate(rig, 1e-3, save=21, integrator=fine, state=jc.resting_state(rig))
    found = np.asarray(run.reaction("B").force)
    # its speeds are those of the journal in the middle: dampers act a little
    np.testing.assert_allclose(found[0, :2], wanted[:2], rtol=5e-2)
    # ends and a collar carry, and go on to
    forces = np.asarray(run.contact("B").normal_force)
    assert (forces[0, [0, 1]] > 0).all() and (forces[0, 2:] > 0).any()
    assert np.linalg.norm(found[:, :2], axis=1).min() > 0.5 * np.linalg.norm(wanted)


@pytest.mark.slow
def test_where_a_journal_lies_is_not_taken_for_the_length_of_a_link():
    """It is as long as the clearance, beside which every radius would look like a slip of unit."""
    pin = jc.clearance.PlanarJournalBearing(
        LAW, bearing_radius=10e-3, clearance=0.1e-3, length=20e-3
    )
    rotor = jc.Mechanism(
        {"rotor": jc.Body(10.0, 1e-3)},
        {"B": jc.Connection(pin, "ground", "rotor")},
        {"g": jc.load.Gravity()},
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error", jc.UnusualMagnitude)
        jc.resting_state(rotor)


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("friction", [None, jc.friction.Ambrosio(mu_kinetic=0.1)])
def test_a_door_sags_by_the_play_of_its_hinges(friction):
    """Hinges lean the other way than each other: twice the clearance over the distance of their
    outer ends, times the width. It warned that the reactions of ideal hinges are not unique, and
    with friction it was refused for that."""
    width, height, length, rim = 0.8, 1.5, 0.03, 14e-3
    clearance, axial = 0.2e-3, 0.1e-3
    numbers = {"bearing_radius": 6e-3, "clearance": clearance, "length": length}
    numbers["friction"] = friction
    flange = jc.clearance.Flange(LAW, clearance=axial, radius=rim)
    top = (0.0, 0.0, height)
    hinges = {
        "lower": jc.Connection(
            jc.clearance.JournalBearing(LAW, flange=flange, **numbers), "ground", "door"
        ),
        "upper": jc.Connection(
            jc.clearance.JournalBearing(LAW, **numbers),
            jc.Marker("ground", top),
            jc.Marker("door", top),
        ),
    }
    door = {"door": jc.Body(20.0, (4.0, 5.0, 1.1), com=(width / 2, 0.0, height / 2))}
    rig = jc.Mechanism(door, hinges, {"g": jc.load.Gravity((0.0, 0.0, -9.81))})
    run = jc.simulate(rig, 1e-3, save=3, state=jc.resting_state(rig))
    sag = -np.asarray(run.marker("door", (width, 0.0, 0.0)).position)[:, 2]
    # The hinges' ends give under the moment, the collar under the weight; its rim leans with them.
    weight = 20.0 * 9.81
    give = lambda force: (force / 1e10) ** (2 / 3)
    end = give(weight * (width / 2 - rim) / (height + length))
    lean = 2 * (clearance + end) / (height + length)
    wanted = lean * (width - rim) + axial + give(weight)
    np.testing.assert_allclose(sag, wanted, rtol=2e-3)


def hung_door(friction):
    """A door at rest on a hinge with play, which its weight hangs straight down from."""
    numbers = {"bearing_radius": 6e-3, "clearance": 0.2e-3, "length": 30e-3}
    pin = jc.clearance.PlanarJournalBearing(LAW, friction, **numbers)
    return jc.Mechanism(
        {"door": jc.Body(20.0, 1.1, com=(0.0, -0.4))},
        {"hinge": jc.Connection(pin, "ground", "door")},
        {"g": jc.load.Gravity((0.0, -9.81))},
    )


@pytest.mark.parametrize(
    "friction",
    [None, pytest.param(jc.friction.CoulombTanh(mu_kinetic=0.1), marks=pytest.mark.slow)],
)
def test_what_rests_on_its_contacts_has_no_forces_that_steps_could_change(friction):
    """Implicit steps rest where their bias moves the door by b h g / 2, which is no speed; that
    half the steps halve this was said to change all the forces there are."""
    rig = hung_door(friction)
    integrator = jc.integrator.ImplicitStep(1e-5)
    run = jc.simulate(rig, 0.05, save=101, integrator=integrator, state=jc.resting_state(rig))
    np.testing.assert_allclose(run.body("door").velocity, 0.0, atol=1e-9)
    assert run.warnings == ()


@pytest.mark.slow
def test_a_mechanism_whose_numbers_jax_has_changed_is_seated_as_it_is():
    """JAX sorts the names of dictionaries, and the tree grows by their order: bodies had each
    other's places, 0.3 m deep in their bearings, and nothing was said."""
    pin = jc.clearance.PlanarJournalBearing(LAW, bearing_radius=10e-3, clearance=0.1e-3)
    rig = jc.Mechanism(
        {"upper": jc.Body(1.0, 0.01, com=(0.1, 0.0)), "lower": jc.Body(1.0, 0.01, com=(0.1, 0.0))},
        {
            "Z": jc.Connection(pin, "ground", "upper"),
            "C": jc.Connection(pin, jc.Marker("upper", (0.3, 0.0)), "lower"),
        },
        {"gravity": jc.load.Gravity()},
        start={"upper": (0.0, 0.0, -1.0)},
        guess={"lower": (0.16, -0.25, -1.0)},
    )
    same = jax.tree.map(lambda number: 1.0 * number, rig)
    assert list(same.bodies) == ["upper", "lower"] and list(same.connections) == ["Z", "C"]
    ends = [
        jc.simulate(one, 1e-4, save=3, integrator=jc.integrator.ImplicitStep(1e-5), state=state)
        for one in (rig, same)
        for state in (jc.resting_state(one),)
    ]
    np.testing.assert_array_equal(ends[0].states, ends[1].states)
    assert float(ends[1].contact("Z").indentation.max()) < 1e-4


def test_a_law_without_coulombs_coefficients_is_seated_without_friction():
    class Felt(jc.friction.AbstractSlipFriction):
        def coefficient(self, slip_speed):
            return 0.1 * slip_speed

    bearing = jc.clearance.PlanarJournalBearing(LAW, Felt(), clearance=0.1e-3)
    rig = jc.Mechanism(
        {"shaft": jc.Body(1.0, 1e-3)},
        {"B": jc.Connection(bearing, "ground", "shaft")},
        {"load": jc.load.Force(jc.Marker("shaft"), (0.0, -200.0))},
    )
    seats = jax.tree.leaves(jc.resting_state(rig))
    smooth = rig.with_joint("B", jc.clearance.PlanarJournalBearing(LAW, clearance=0.1e-3))
    for part, other in zip(seats, jax.tree.leaves(jc.resting_state(smooth)), strict=True):
        np.testing.assert_allclose(part, other, atol=1e-12)
