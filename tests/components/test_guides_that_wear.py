"""A slider in a guide, both of which wear: volumes and depths by closed forms.

A flat face that is pressed against a wall and goes to and fro leaves a trough: while it is shallow
beside how far the parts overlap, pressure is even under the face and the depth is that of a
trapezoid; once it is deep, the wall has the shape of the face, a box. The face itself wears evenly.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear import plot
from jaxclear.components.wall_map import WallMap
from tests.rigs.cells import slow

LAW = jc.wear.Archard()
RATE = float(LAW.wear_coefficient / LAW.hardness)
LOAD, WIDTH, LENGTH, BREADTH, CLEARANCE = 200.0, 20e-3, 40e-3, 10e-3, 0.1e-3
AMPLITUDE, SPEED = 50e-3, 2 * np.pi * 10
# Two to and fro; a stroke in whole saving intervals.
DURATION, SAVES = 0.2, 81
WAY = 8 * AMPLITUDE
CONTACT = jc.contact.HuntCrossley(stiffness=1e9, restitution=0.3)
RUNGS = {
    "permanent": jc.integrator.NonColliding(2.5e-4),
    "implicit": jc.integrator.ImplicitStep(2e-5),
    "rigid": jc.integrator.MoreauJean(2.5e-4),
    "fixed": jc.integrator.FixedStep(2e-6),
    "adaptive": jc.integrator.Adaptive(),
}


def guide(cells=80, walls=0.16, acceleration=1.0, **given):
    wears = jc.Wearing(LAW, (4, cells), acceleration)
    usual = {
        "width": WIDTH,
        "length": LENGTH,
        "clearance": CLEARANCE,
        "breadth": BREADTH,
        "guide_length": walls,
        "guide_wear": wears,
        "slider_wear": wears,
    }
    return jc.clearance.SliderGuide(CONTACT, **usual | given)


def to_and_fro(joint, load=LOAD, start=AMPLITUDE, speed=0.0):
    """A slider that a spring drives to and fro, under a load across the guide."""
    return jc.Mechanism(
        {"slider": jc.Body(1.0, 1e-3)},
        {"P": jc.Connection(joint, "ground", "slider", axis="x")},
        {
            "load": jc.load.Force(jc.Marker("slider"), (0.0, -load)),
            "spring": jc.load.JointSpring("P", SPEED**2),
        },
        start={"P": start},
        speeds={"P": speed},
    )


def run(rig, rung="permanent", **given):
    state = None if rung == "permanent" else jc.resting_state(rig)
    given = {"save": SAVES, "integrator": RUNGS[rung], "state": state} | given
    return jc.simulate(rig, DURATION, **given)


def even(places):
    """Share of the largest depth of a trough that a flat face digs going to and fro, pressed
    evenly."""
    ramp = (AMPLITUDE + 0.5 * LENGTH - abs(places)) / LENGTH
    return np.clip(ramp, 0.0, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("rung", RUNGS)
def test_a_slider_that_goes_to_and_fro_wears_an_even_trough_and_its_own_face_evenly(rung):
    """Both lose k F s / H; the trough is k F n / (H b) deep where all of the face has passed n
    times, on joints that always touch as on those with play."""
    joint = guide()
    found = run(to_and_fro(joint), rung)
    within = 1e-7 if rung == "permanent" else 2e-4
    for surface in ("guide", "slider"):
        wear_map, _ = joint.maps()[surface]
        volume = float(found.worn_volume("P", surface)[-1])
        np.testing.assert_allclose(volume, RATE * LOAD * WAY, rtol=within)
        depth = np.asarray(found.worn_depth("P", surface))
        np.testing.assert_allclose(np.sum(depth * wear_map.areas()), volume, rtol=1e-12)
        assert np.all(depth >= 0) and np.all(depth[1] == 0)
    passes = WAY / (2 * AMPLITUDE)
    deepest = RATE * LOAD * passes / BREADTH
    trough, places = found.worn_depth("P", "guide")[0], joint.maps()["guide"][0].places()
    # Cells of 2 mm round the ramp's ends, and where the slider turns round.
    np.testing.assert_allclose(trough, deepest * even(places), atol=0.03 * deepest)
    flat = abs(places) < AMPLITUDE - 0.5 * LENGTH
    np.testing.assert_allclose(np.mean(trough[flat]), deepest, rtol=2e-3)
    own = RATE * LOAD * WAY / (LENGTH * BREADTH)
    np.testing.assert_allclose(found.worn_depth("P", "slider")[0], own, rtol=1e-3)
    # Forces at an instant swing where contacts settle.
    assert found.outcome == 0 and (rung != "permanent" or not found.invariants.warnings)


@pytest.mark.parametrize("cells", [80, *slow(321)])
def test_a_deep_trough_has_the_shape_of_the_face(cells):
    """A way of 2 a that a face of length L wears by V: V / (b (L + 2 a)) deep, a box."""
    walls = WallMap((2, cells), 0.16, 0.0, LENGTH, BREADTH, CLEARANCE, 0.5 * WIDTH)
    box = 50e-6
    volume = box * BREADTH * (LENGTH + 2 * AMPLITUDE)
    place = [0.0, AMPLITUDE**2 / 3, 0.0, 0.1e-6, 0.0]
    events = jnp.array([[*place, end] for end in (-1.0, 1.0)])
    depth = jnp.zeros(walls.cells)
    deposit = jax.jit(lambda *lost: walls.deposit(*lost))
    # A loss at once as large as what the load overlaps leaves waves of some per cent.
    losses = 400
    for _ in range(losses):
        depth = deposit(depth, jnp.full(2, 0.5 * volume / losses), events)
    places = np.asarray(walls.places())
    inside = abs(places) < AMPLITUDE + 0.5 * LENGTH - 2e-3
    np.testing.assert_allclose(depth[0][inside], box, rtol=0.03)
    np.testing.assert_allclose(np.sum(depth * walls.areas()), volume, rtol=1e-12)


def test_a_tilted_face_wears_away_a_wedge_at_its_corner():
    """A face that leans by a slope q: the wedge that it loses by V is as deep as its tip was in the
    wall, sqrt(2 q V / b), and falls by q."""
    face = WallMap((2, 200), LENGTH, 0.0, LENGTH, BREADTH, CLEARANCE, 0.5 * WIDTH)
    slope, deepest = 5e-3, 50e-6
    volume = BREADTH * deepest**2 / (2 * slope)
    event = jnp.array([[0.0, 0.0, slope * LENGTH, 0.01e-6, 1.0, 1.0]])
    depth, deposit = jnp.zeros(face.cells), jax.jit(lambda *lost: face.deposit(*lost))
    for _ in range(200):
        depth = deposit(depth, jnp.full(1, volume / 200), event)
    away = 0.5 * LENGTH - np.asarray(face.places())
    wedge = np.maximum(deepest - slope * away, 0.0)
    np.testing.assert_allclose(depth[1], wedge, atol=0.03 * deepest)
    np.testing.assert_allclose(float(np.sum(depth * face.areas())), volume, rtol=1e-12)


def test_both_worn_parts_widen_the_gap_where_a_corner_is():
    joint = guide()
    walls, faces = (joint.maps()[surface][0] for surface in ("guide", "slider"))
    on_walls = jnp.stack([1e-6 * (1 + walls.places() / 0.16), 2e-6 + 0 * walls.places()])
    on_faces = jnp.stack([3e-6 * (1 + faces.places() / LENGTH), 1e-6 + 0 * faces.places()])
    read = {"guide": walls.reading(on_walls), "slider": faces.reading(on_faces)}
    offset, axes = (jnp.asarray(1e-5), 0, jnp.asarray(0.02)), ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    new = np.array(joint.indentations(offset, axes, {}))
    lost = new - np.array(joint.indentations(offset, axes, read))
    # Lower back and front, upper back and front; a line is read as it is, up to the edge.
    at = 0.02 + 0.5 * LENGTH * np.array([-1.0, 1.0])
    expected = [*(1e-6 * (1 + at / 0.16) + 3e-6 * (1 + np.array([-0.5, 0.5]))), 3e-6, 3e-6]
    np.testing.assert_allclose(lost, expected, rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("rung", RUNGS)
def test_a_slider_that_leaves_its_walls_ends_the_run_by_a_sentence(rung):
    """Corners reach 70 mm, walls 65 mm: within a saving interval of when they are passed."""
    rig = to_and_fro(guide(walls=0.13), start=0.0, speed=AMPLITUDE * SPEED)
    found = run(rig, rung, throw=False)
    assert "left the walls of its guide" in found.result and "guide_length" in found.result
    left = np.arcsin((0.065 - 0.5 * LENGTH) / AMPLITUDE) / SPEED
    assert left - DURATION / (SAVES - 1) <= float(found.ended) <= left
    assert np.all(np.isfinite(found.worn_depth("P", "guide")))
    with pytest.raises(jc.SimulationError, match="left the walls of its guide"):
        run(rig, rung)


@pytest.mark.slow
def test_parts_worn_by_as_much_as_their_play_still_keep_the_books():
    """As deep as the clearance; the slider lies deeper by what both have lost where it stands."""
    joint = guide(acceleration=2e5)
    rig = to_and_fro(joint)
    found = run(rig, "implicit")
    deep = {s: float(found.worn_depth("P", s).max()) for s in ("guide", "slider")}
    assert min(deep.values()) > 0.5 * CLEARANCE and max(deep.values()) > CLEARANCE
    np.testing.assert_allclose(
        float(found.worn_volume("P", "guide")[-1]), 2e5 * RATE * LOAD * WAY, rtol=0.01
    )
    again = jc.simulate(rig, 1e-3, save=2, state=found.state(), integrator=RUNGS["implicit"])
    assert np.all(again.worn_depth("P", "guide") >= found.worn_depth("P", "guide"))


@pytest.mark.slow(sample=False)
def test_derivatives_of_wear_are_those_of_differences():
    """By hardness, breadth and load, of volumes, of depths and of one on the ramp; by hardness
    volume goes with one over it."""

    def told(given):
        hardness, breadth, load = given
        wears = jc.Wearing(jc.wear.Archard(hardness=hardness), (4, 40), 1e4)
        joint = guide(guide_wear=wears, slider_wear=wears, breadth=breadth)
        found = run(to_and_fro(joint, load), save=21, throw=False)
        trough = found.worn_depth("P", "guide")[0]
        parts = trough.max() * 1e6, found.worn_depth("P", "slider")[0, 0] * 1e6
        return jnp.stack([found.worn_volume("P", "guide")[-1] * 1e9, *parts, trough[8] * 1e6])

    usual, h = jnp.array([2e9, BREADTH, LOAD]), 1e-5
    slopes = np.asarray(jax.jacfwd(lambda scale: told(usual * scale))(jnp.ones(3)))
    for k in range(3):
        step = jnp.zeros(3).at[k].set(h)
        difference = (told(usual * (1 + step)) - told(usual * (1 - step))) / (2 * h)
        np.testing.assert_allclose(slopes[:, k], difference, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(slopes[0, 0], -told(usual)[0], rtol=1e-9)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"breadth": None}, "no breadth"),
        ({"guide_length": None}, "no guide_length"),
        ({"guide_length": 0.03}, "as long as the slider"),
        ({"guide_wear": jc.Wearing(LAW, worn_radius=True)}, "flat walls have no radius"),
    ],
)
def test_a_guide_that_does_not_tell_where_it_wears_is_refused(given, sentence):
    with pytest.raises(ValueError, match=sentence):
        guide(**given)


@pytest.mark.slow
def test_a_slider_alone_may_wear():
    joint = guide(guide_wear=None, guide_length=None)
    found = run(to_and_fro(joint), save=5)
    assert set(found.worn["P"]) == {"slider"}
    np.testing.assert_allclose(found.worn_volume("P", "slider")[-1], RATE * LOAD * WAY, rtol=1e-7)


def test_worn_guides_are_drawn_and_written(tmp_path):
    joint = guide(acceleration=1e4)
    found = run(to_and_fro(joint))
    for surface in ("guide", "slider"):
        worn = float(found.worn_volume("P", surface)[-1])
        assert worn == pytest.approx(1e4 * RATE * LOAD * WAY, rel=1e-4)
        left, right = plot.wear_unrolled(found, "P", surface).axes
        assert left.get_xlim() == pytest.approx(
            tuple(1e3 * float(joint.maps()[surface][0].length) * np.array([-0.5, 0.5]))
        )
        deepest = 1e6 * float(found.worn_depth("P", surface).max())
        assert right.patches[0].get_height() == pytest.approx(deepest)
        with pytest.raises(ValueError, match="is flat"):
            plot.wear_surface(found, "P", surface)
    assert "guide_wear Wearing" in str(found.mechanism)
    assert found.to_dataset()["P/guide"].worn_depth.shape == (2, 80)
    assert found.to_vtk(tmp_path / "series", frames=2).exists()
