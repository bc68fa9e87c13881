"""What a mechanism starts with: closed loops, given values held, and derivatives of both."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.ground.factorisation import least_change
from jaxclear.multibody import assembly
from jaxclear.multibody.assembly import assemble_arrays
from tests.rigs.cells import slow, slow_but

ROD = 0.12


def started(rig, where):
    """Coordinates and speeds at the start, as a function of a number of the mechanism."""

    def start(value):
        found = assemble_arrays(eqx.tree_at(where, rig, value))
        return jnp.concatenate([found.coordinates, found.speeds])

    return start


def rod_length(rig):
    return rig.connections["B"].parent.at[0]


# A start that closes exactly, and one that does not.
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["planar", "ideal"])
@pytest.mark.parametrize("length", [ROD, 0.13])
def test_the_derivative_of_a_start_is_that_of_its_differences(kind, length):
    start = jax.jit(started(jc.scenes.slider_crank(kind), rod_length))
    step = 1e-6
    differences = (start(length + step) - start(length - step)) / (2 * step)
    # (x, y, xd, yd): the slider is where crank and rod end; the rod turns at -r w / l.
    expected = [0.0, 1.0, 50.0 * 0.05 / length**2, 0.0]
    for derivative in (jax.jacfwd(start)(length), jax.jacrev(start)(length)):
        np.testing.assert_allclose(derivative, expected, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(derivative, differences, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("inertia", [1e-3, (1e-3, 1e-3, 1e-3)], ids=["plane", "space"])
def test_loops_that_are_far_from_closed_close_in_runs_and_in_studies(inertia):
    """Three of forty guesses drawn at random ended in a dead point that is none."""
    link = lambda mass, far: jc.Body(mass, inertia, (far, 0.0))
    turning = jc.joint.Revolute(drive=jc.drive.ConstantSpeed(20.0))
    rocker, ground = jc.Marker("rocker", (0.25, 0.0)), jc.Marker("ground", (0.3, 0.0))
    rig = jc.Mechanism(
        {"crank": link(0.5, 0.05), "rod": link(1.0, 0.15), "rocker": link(0.7, 0.1)},
        {
            "O": jc.Connection(turning, "ground", "crank"),
            "A": jc.Connection(jc.joint.Revolute(), "crank", "rod", at=(0.1, 0.0)),
            "B": jc.Connection(jc.joint.Revolute(), "rod", "rocker", at=(0.3, 0.0)),
            "D": jc.Connection(jc.joint.Revolute(), ground, rocker),
        },
        guess={"A": -1.12901129, "D": -0.46004131},
    )
    problem = jc.Problem(
        rig,
        {"turned": jc.response.FinalCoordinate("A")},
        {"mass": jc.Variable(lambda rig: rig.bodies["rod"].mass, tolerance=0.1)},
        duration=0.01,
    )
    # How far the rod is turned about the crank where the three other sides are as long.
    gap = 0.3 - 0.1
    told = np.arccos((gap**2 + 0.3**2 - 0.25**2) / (2 * gap * 0.3))
    assert abs(float(jc.assemble(rig).coordinates[0])) == pytest.approx(told, abs=1e-9)
    run = jc.simulate(rig, 0.01, save=2, integrator=problem.integrator)
    found = jax.jit(problem.evaluate)(problem.nominal()).responses["turned"]
    assert float(found) == pytest.approx(float(run.coordinate("A")[-1]), abs=1e-9)


def test_a_batch_of_starts_calls_no_factorisation_of_another_library():
    """Two threads whose batched factorisations meet there wait for each other for ever."""
    for rig in (jc.scenes.antenna(), jc.scenes.four_bar("ideal")):
        numbers, rest = eqx.partition(rig, eqx.is_inexact_array)
        many = jax.tree.map(lambda x: jnp.stack([x, x]), numbers)

        def coordinates(own, rest=rest):
            return assemble_arrays(eqx.combine(own, rest)).coordinates

        called = re.findall(
            r"custom_call @(\w+)", jax.jit(jax.vmap(coordinates)).lower(many).as_text()
        )
        # Kernels of this package's own do not wait.
        assert not [name for name in called if not name.startswith("jaxclear_")]


def test_the_least_change_meets_what_it_can_and_moves_no_further():
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(4, 6))
    rows[2] = rows[0] - 2 * rows[1]
    scales = rng.uniform(0.1, 10.0, 6)
    targets = np.array([1.0, 2.0, 7.0, -1.0])
    change, met = least_change(*map(jnp.asarray, (rows, targets, scales)))
    assert met.tolist() == [True, True, False, True]
    free = [0, 1, 3]
    expected = scales * (np.linalg.pinv(rows[free] * scales) @ targets[free])
    np.testing.assert_allclose(change, expected, atol=1e-13)


# --- what is given is held ---

BEARING = jc.clearance.PlanarJournalBearing(
    jc.contact.CarvalhoMartins(stiffness=1e9), clearance=1e-4
)
JOINTS = {"ideal": jc.joint.Revolute(), "bearing": BEARING}
CRANK = 0.05


def slider_crank(joint="ideal", drive=None, slide=None, rod=ROD, **given):
    return jc.Mechanism(
        {
            "crank": jc.Body(0.3, 1e-4, (0.5 * CRANK, 0.0)),
            "rod": jc.Body(0.21, 2.5e-4, (0.5 * rod, 0.0)),
            "slider": jc.Body(0.14, 1e-4),
        },
        {
            "O": jc.Connection(jc.joint.Revolute(drive=drive), "ground", "crank"),
            "A": jc.Connection(jc.joint.Revolute(), "crank", "rod", at=(CRANK, 0.0)),
            "B": jc.Connection(JOINTS[joint], "rod", "slider", at=(rod, 0.0)),
            "G": jc.Connection(
                jc.joint.Prismatic(drive=slide),
                jc.Marker("ground", axis="x"),
                jc.Marker("slider", axis="x"),
            ),
        },
        {"gravity": jc.load.Gravity()},
        **given,
    )


def read(rig, name):
    """Coordinate and speed by which joint `name` starts, from the motion of its markers."""
    run = jc.simulate(rig, 1e-6, save=2, integrator=jc.integrator.FixedStep(1e-6))
    angles, spins = {"ground": 0.0}, {"ground": 0.0}
    for body in rig.bodies:
        rotation = np.asarray(run.body(body).rotation)[0]
        angles[body] = np.arctan2(rotation[1, 0], rotation[0, 0])
        spins[body] = np.asarray(run.body(body).spin)[0, 2]
    if name == "G":
        slider = run.body("slider")
        return float(slider.com[0, 0]), float(slider.velocity[0, 0])
    ends = [getattr(rig.connections[name], side).body for side in ("parent", "child")]
    turn = angles[ends[1]] - angles[ends[0]]
    return np.angle(np.exp(1j * turn)), spins[ends[1]] - spins[ends[0]]


FAST = {("A", "bearing"), ("B", "ideal"), ("G", "bearing")}


@pytest.mark.parametrize(
    ("name", "joint"),
    [
        pytest.param(name, joint, marks=() if (name, joint) in FAST else pytest.mark.slow)
        for name in "OABG"
        for joint in JOINTS
    ],
)
def test_given_coordinates_and_speeds_are_held_whatever_joint_they_name(name, joint):
    """Of a crank that nothing drives; one start serves the ideal joint and the bearing, and joint B
    carries no coordinate in either."""
    given = {"O": (0.6, 10.0), "A": (-0.9, 7.0), "B": (0.25, -3.0), "G": (0.155, 0.4)}[name]
    rough = {"O": 0.6, "A": -0.85, "G": 0.155}
    rough.pop(name, None)
    rig = slider_crank(joint, start={name: given[0]}, speeds={name: given[1]}, guess=rough)
    np.testing.assert_allclose(read(rig, name), given, rtol=1e-9, atol=1e-12)


def test_the_rest_of_a_start_is_solved():
    angle, speed = 0.6, 10.0
    start = jc.assemble(slider_crank(start={"O": angle}, speeds={"O": speed}, guess={"G": 0.16}))
    tilt = -np.arcsin(CRANK / ROD * np.sin(angle))
    turning = -speed * CRANK * np.cos(angle) / (ROD * np.cos(tilt))
    along = CRANK * np.cos(angle) + ROD * np.cos(tilt)
    going = -CRANK * np.sin(angle) * speed - ROD * np.sin(tilt) * turning
    np.testing.assert_allclose(start.coordinates, [angle, tilt - angle, along], atol=1e-14)
    np.testing.assert_allclose(start.speeds, [speed, turning - speed, going], atol=1e-12)


SPEED = jc.drive.ConstantSpeed(50.0)
REFUSED = {
    "surplus of a driven loop": (
        lambda: slider_crank(drive=SPEED, start={"G": 0.165}),
        r'start=\{"G": 0.165\} is more than the mechanism leaves free.*put it at 0.17 m',
    ),
    "other branch of a driven loop": (
        lambda: slider_crank(drive=SPEED, start={"G": -0.17}),
        r'start=\{"G": -0.17\} is more than the mechanism leaves free',
    ),
    "out of reach of a free loop": (
        lambda: slider_crank(start={"G": -0.18}),
        r'no way to assemble with start=\{"G": -0.18\} was found',
    ),
    "second of two given": (
        lambda: slider_crank(start={"O": 0.6, "A": -0.7}, guess={"G": 0.16}),
        r'start=\{"A": -0.7\} is more than .* put it at -0.8374',
    ),
    "first given is held though not first of the alphabet": (
        lambda: slider_crank(start={"O": 0.6, "B": 0.5}, guess={"A": -0.8, "G": 0.16}),
        r'start=\{"B": 0.5\} is more than .* put it at 0.237494',
    ),
    "place of a body": (
        lambda: slider_crank(drive=SPEED, start={"slider": (0.16, 0.0, 0.0)}),
        r'start=\{"slider": \(0.16, 0, 0\)\} is more than',
    ),
    "surplus of speed": (
        lambda: slider_crank(start={"O": 0.6}, speeds={"O": 1.0, "B": 3.0}, guess={"G": 0.16}),
        r'speeds=\{"B": 3\} is more than the mechanism leaves free',
    ),
    "journal out of its bearing": (
        lambda: slider_crank("bearing", drive=SPEED, start={"G": 0.175}),
        r'parts of joint "B" start 0.0049 m deep in each other',
    ),
    "dead point": (
        lambda: slider_crank(slide=jc.drive.ConstantSpeed(-1.0, 0.17)),
        "stands at a dead point.* joint \"B\" cannot follow the drive of 'G'",
    ),
}


QUICK = "surplus of a driven loop", "other branch of a driven loop", "out of reach of a free loop"
QUICK += ("surplus of speed", "journal out of its bearing", "dead point")


@pytest.mark.parametrize("name", slow_but(QUICK, REFUSED))
def test_a_start_that_cannot_be_held_is_refused_by_name(name):
    make, sentence = REFUSED[name]
    with pytest.raises(ValueError, match=sentence):
        jc.assemble(make())


def test_what_is_given_is_sought_from_elsewhere_where_homes_do_not_lead_to_it():
    start = jc.assemble(slider_crank(start={"G": -0.165}))
    assert float(start.coordinates[2]) == -0.165


@pytest.mark.parametrize("joint", JOINTS)
def test_the_other_branch_is_assembled_where_it_is_guessed(joint):
    start = jc.assemble(slider_crank(joint, start={"G": -0.165}, guess={"O": 2.8, "A": 0.4}))
    assert float(start.coordinates[2]) == -0.165
    assert 2.5 < float(start.coordinates[0]) < 3.1


def test_a_surplus_that_closes_the_loop_is_accepted():
    start = jc.assemble(slider_crank(drive=SPEED, start={"G": 0.17}))
    np.testing.assert_allclose(start.coordinates, [0.0, 0.17], atol=1e-15)


@pytest.mark.parametrize("joint", JOINTS)
@pytest.mark.slow
def test_a_surplus_moves_with_the_lengths_that_vary(joint):
    """The slider of a driven crank stands where the rod puts it, in a sample of a study and in a
    run of the same numbers."""
    rig = slider_crank(joint, drive=SPEED, start={"G": 0.17})
    rod = jc.Variable(lambda m: m.connections["B"].parent.at[0], tolerance=1e-3)
    step = jc.integrator.FixedStep(1e-6)
    problem = jc.Problem(
        rig,
        {"x": jc.response.FinalCoordinate("G")},
        {"rod": rod},
        duration=1e-6,
        save=2,
        integrator=step,
    )
    sample = eqx.filter_jit(problem.evaluate)(jnp.array([0.121]))
    alone = jc.simulate(problem.with_values(jnp.array([0.121])), 1e-6, save=2, integrator=step)
    assert int(sample.outcome) == 0
    assert float(sample.responses["x"]) == pytest.approx(0.171, abs=1e-7)
    assert float(alone.coordinate("G")[-1]) == float(sample.responses["x"])


def test_a_journal_starts_where_it_is_given():
    """Also where journals are concentric by default."""
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(BEARING, "ground", "journal")},
        start={"journal": (5e-5, -2e-5, 0.3)},
        speeds={"journal": (0.05, 0.0, 2.0)},
    )
    for concentric in (True, False):
        start = jc.assemble(rig, concentric)
        np.testing.assert_array_equal(start.coordinates, [5e-5, -2e-5, 0.3])
        np.testing.assert_array_equal(start.speeds, [0.05, 0.0, 2.0])


@pytest.mark.parametrize("concentric", [True, False])
def test_a_start_deep_in_a_wall_is_refused(concentric):
    for joint, place in ((BEARING, (0.02, 0.0, 0.0)), (GUIDE, (0.0, 0.003, 0.0))):
        rig = jc.Mechanism(
            {"slider": jc.Body(1.0, 1e-4)},
            {"B": jc.Connection(joint, "ground", "slider", axis="x" if joint is GUIDE else None)},
            start={"slider": place},
        )
        with pytest.raises(ValueError, match=r'joint "B" start 0.0(199|029) m deep in each other'):
            jc.assemble(rig, concentric)


def hollowed():
    """A journal that lies in a hollow 1 mm deep of its bearing, and a state in which this is worn
    out."""
    wearing = jc.Wearing(jc.wear.Archard(), cells=(72, 1))
    joint = jc.clearance.PlanarJournalBearing(
        jc.contact.CarvalhoMartins(stiffness=1e8), clearance=1e-4, bearing_wear=wearing
    )
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(joint, "ground", "journal")},
        start={"journal": (0.0, -0.9e-3, 0.0)},
    )
    worn = {"B": {"bearing": np.full((72, 1), 1e-3)}}
    return rig, jc.State(worn=worn)


@pytest.mark.slow
def test_a_start_in_a_worn_hollow_is_judged_on_the_worn_surface():
    """In simulate, and in a study."""
    rig, state = hollowed()
    with pytest.raises(ValueError, match=r'joint "B" start 0.0008 m deep in each other'):
        jc.simulate(rig, 1e-4, save=2, integrator=jc.integrator.FixedStep(1e-5))
    jc.simulate(rig, 1e-4, save=2, state=state, integrator=jc.integrator.FixedStep(1e-5))
    problem = jc.Problem(
        rig,
        {"y": lambda run: run.coordinate("journal")[-1, 1]},
        {"mass": jc.Variable(lambda m: m.bodies["journal"].mass, tolerance=0.1)},
        duration=1e-4,
        save=2,
        state=state,
        integrator=jc.integrator.FixedStep(1e-5),
    )
    sample = jax.jit(problem.evaluate)(problem.nominal())
    assert int(sample.outcome) == 0 and float(sample.responses["y"]) == pytest.approx(-0.9e-3)


GUIDE = jc.clearance.SliderGuide(jc.contact.CarvalhoMartins(stiffness=1e8), clearance=1e-4)


def test_what_is_given_is_differentiated():
    """The start follows what is given, and the loop what follows from it."""
    rig = slider_crank(start={"O": 0.6}, speeds={"O": 10.0}, guess={"A": -0.8, "G": 0.16})
    start = jax.jit(started(rig, lambda m: m.start["O"][0]))
    step = 1e-6
    differences = (start(0.6 + step) - start(0.6 - step)) / (2 * step)
    for derivative in (jax.jacfwd(start)(0.6), jax.jacrev(start)(0.6)):
        assert float(derivative[0]) == pytest.approx(1.0, abs=1e-12)
        np.testing.assert_allclose(derivative, differences, rtol=1e-7, atol=1e-7)


def limited(place, **limits):
    """An arm of two limits, or with play behind a coupling."""
    turn = jc.Connection(jc.joint.Revolute(), "ground", "arm")
    return jc.Mechanism({"arm": jc.Body(2.0, 0.5)}, {"A": turn}, start={"A": place}, **limits)


STOPPED = {"loads": {"ends": jc.load.JointStop("A", -0.5, 0.5, stiffness=1e4)}}
HELD = {"couplings": {"hold": jc.coupling.Latch("A", 0.0, play=2e-2, stiffness=1e4, damping=1.0)}}


@pytest.mark.parametrize(
    "limits, inside, beyond, said",
    [
        (STOPPED, 0.5, 0.6, '0.1 rad beyond stop "ends" of joint "A"'),
        (STOPPED, -0.5001, -0.8, '0.3 rad beyond stop "ends" of joint "A"'),
        (HELD, 0.01, -0.06, '0.05 rad inside a flank of coupling "hold"'),
    ],
)
def test_a_start_beyond_a_stop_or_inside_a_flank_says_so(limits, inside, beyond, said):
    """As far as contacts of hard parts give way it may be meant."""
    assert not jc.simulate(limited(inside, **limits), 1e-3, save=2).warnings
    (sentence,) = jc.simulate(limited(beyond, **limits), 1e-3, save=2).warnings
    assert said in sentence


def hanging(spread):
    """Three bars in line below each other, drawn so far apart [m] that their pins miss by it."""
    pin = jc.clearance.PlanarJournalBearing(
        jc.contact.Rigid(), None, bearing_radius=10e-3, clearance=1e-4
    )
    # Of names of its own, so that it is compiled anew.
    names, length = [f"bar {i} of {spread}" for i in range(3)], 0.1
    bar = jc.Body(0.1, 1e-4, (length / 2, 0.0))
    ends = [jc.Marker("ground"), *(jc.Marker(name, (length, 0.0)) for name in names[:-1])]
    places = {name: (0.0, -i * length - spread, -np.pi / 2) for i, name in enumerate(names)}
    return jc.Mechanism(
        dict.fromkeys(names, bar),
        {f"pin of {n}": jc.Connection(pin, e, n) for n, e in zip(names, ends, strict=True)},
        guess=places,
    )


@pytest.mark.parametrize("spread", [0.0, 1e-5])
def test_what_is_drawn_closed_is_not_searched(spread, monkeypatch):
    """The pins of bars that hang in line are a length apart."""
    searched, search = [], assembly._searched
    monkeypatch.setattr(assembly, "_searched", lambda *asked: searched.append(1) or search(*asked))
    start = jc.assemble(hanging(spread))
    wanted = [(0.0, -0.1 * i, -np.pi / 2) for i in range(3)]
    np.testing.assert_allclose(np.reshape(start.coordinates, (3, 3)), wanted, atol=1e-12)
    assert bool(searched) == bool(spread)


def test_where_drives_move_joints_speeds_follow_a_drawn_position():
    """A parallelogram, drawn closed: its far crank turns as the driven one does."""
    hinge, drive = jc.joint.Revolute, jc.drive.ConstantSpeed(3.0, 1.0)
    bar = jc.Body(1.0, 0.1)
    rig = jc.Mechanism(
        {"crank": bar, "coupler": bar, "rocker": bar},
        {
            "A": jc.Connection(hinge(drive=drive), "ground", "crank"),
            "B": jc.Connection(hinge(), jc.Marker("crank", (1.0, 0.0)), "coupler"),
            "D": jc.Connection(hinge(), jc.Marker("ground", (2.0, 0.0)), "rocker"),
            "C": jc.Connection(
                hinge(), jc.Marker("coupler", (2.0, 0.0)), jc.Marker("rocker", (1.0, 0.0))
            ),
        },
        start={"B": -1.0, "D": 1.0},
    )
    np.testing.assert_allclose(jc.assemble(rig).speeds, (-3.0, 3.0), atol=1e-9)


@pytest.mark.parametrize("crank", [0.5, *slow(-0.7)])
def test_superfluous_rows_lead_to_no_other_mode(crank):
    """A planar four-bar of hinges in space closes as one whose loop has only the rows of a plane:
    by the crank's angle, triangles tell where coupler and rocker are (law of cosines)."""
    short, rod, long, foot = 0.05, 0.18, 0.12, np.array([0.2, 0.0])
    # As drawn: the crank lies along x, the others up.
    reach = foot - (short, 0.0)
    ahead = (rod**2 - long**2 + reach[0] ** 2) / (2 * reach[0])
    top = np.array([short + ahead, np.sqrt(rod**2 - ahead**2)])
    place = lambda point: (*map(float, point), 0.0)
    # An axis in numbers may be any: its loop has all rows of space.
    normal = (0.0, 0.0, 1.0)
    hinge, bar = jc.joint.Revolute(), jc.Body(0.2, (1e-4, 1e-4, 2e-4))
    rig = jc.Mechanism(
        {"crank": bar, "coupler": bar, "rocker": bar},
        {
            "O": jc.Connection(hinge, "ground", "crank", axis=normal),
            "A": jc.Connection(hinge, "crank", "coupler", at=(short, 0.0, 0.0), axis=normal),
            "B": jc.Connection(
                hinge,
                jc.Marker("coupler", place(top - (short, 0.0)), normal),
                jc.Marker("rocker", place(top - foot), normal),
            ),
            "D": jc.Connection(hinge, "ground", "rocker", at=place(foot), axis=normal),
        },
        guess={"O": crank},
    )
    tip = short * np.array([np.cos(crank), np.sin(crank)])
    apart = foot - tip
    size = np.hypot(*apart)
    angle = np.arctan2(apart[1], apart[0])
    inner = np.arccos((rod**2 + size**2 - long**2) / (2 * rod * size))
    drawn = np.arctan2(top[1], top[0] - short)
    there = tip + rod * np.array([np.cos(angle + inner), np.sin(angle + inner)]) - foot
    rocker = np.arctan2(there[1], there[0]) - np.arctan2(*(top - foot)[::-1])
    wanted = crank, angle + inner - drawn - crank, rocker
    np.testing.assert_allclose(jc.assemble(rig).coordinates, wanted, atol=1e-8)
