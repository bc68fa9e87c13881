"""An animation is one page that shows a run and needs nothing else."""

import base64
import html.parser
import io
import json
import re

import jax
import jax.numpy as jnp
import matplotlib.image
import meshio
import numpy as np
import pytest

import jaxclear as jc
from jaxclear import plot
from jaxclear.plot.animation.animate import Animation, hiding
from jaxclear.plot.animation.insets import pushes
from jaxclear.results import solids
from jaxclear.results.relative_motion import relative_motion
from jaxclear.results.solids import Part
from tests.integrators.test_no_recompilation import compilations
from tests.plot import browser

SLOW_INTEGRATOR = jc.integrator.ImplicitStep()


@pytest.fixture(scope="module")
def page(run):
    return plot.animate(run, title="slider-crank", slower=1000.0, fps=10)


class Tags(html.parser.HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.found, self.text = [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.found.append((tag, dict(attributes)))


def told(page):
    """What the page's own script is given."""
    return json.loads(re.search(r"const RUN = (.*);\n", page.html)[1].replace("<\\/", "</"))


def numbers(packed):
    flat = np.frombuffer(base64.b64decode(packed["f32"]), np.float32)
    return flat.reshape(packed["shape"])


def test_the_page_loads_nothing(page):
    """Neither scripts nor styles nor pictures come from elsewhere."""
    for tag, attributes in Tags(page.html).found:
        assert not {"src", "href"} & set(attributes), (tag, attributes)
    own = page.html[page.html.index("const RUN") :]
    assert not re.search(r"https?:|fetch\(|XMLHttpRequest|import\(", own)


def test_the_page_names_bodies_and_joints(page, run):
    data = told(page)
    assert [body["name"] for body in data["bodies"]] == list(run.mechanism.bodies)
    assert [joint["name"] for joint in data["joints"]] == ["B"]
    assert data["title"] == "slider-crank" and data["slower"] == 1000.0
    assert len(data["arrows"]) == 1, "every contact has an arrow"
    assert len(numbers(data["time"])) == page.frames == 41


def test_the_inset_holds_the_gap_of_the_run(page, run):
    """Centre, wall, direction of contact and force are those that the run tells."""
    (joint,) = told(page)["joints"]
    (view,) = joint["views"]
    own = run.contact("B")
    np.testing.assert_allclose(numbers(view["centre"]), own.offset[:, :2], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(numbers(view["wall"]), axis=1), 2e-4, rtol=1e-6)
    np.testing.assert_allclose(numbers(joint["force"]), own.normal_force, rtol=1e-6)
    pressed = np.asarray(own.normal_force)[:, 0] > 0
    centre, ways = numbers(view["centre"]), numbers(view["ways"])[:, 0]
    assert pressed.any()
    np.testing.assert_allclose(
        centre[pressed] / np.linalg.norm(centre[pressed], axis=1)[:, None], ways[pressed], atol=1e-5
    )
    np.testing.assert_allclose(numbers(view["worn"]), run.worn_depth("B", "bearing")[:, 0])


def test_arrows_end_where_contacts_are_and_push_the_journal(run):
    """In the ground frame; they are there while the contact presses, and point as the force that
    the journal receives but for friction."""
    every = np.arange(len(run.time))
    found = pushes(run, every, len(every), 0.2)
    own, (matrices,) = run.contact("B"), found.matrices
    force = np.asarray(own.normal_force)[:, 0]
    assert found.largest == force.max() and found.names == ("B, contact",)
    pressed = force > 0
    marker = run.mechanism.connections["B"].parent
    turn = np.asarray(run.body("rod").rotation)
    hole = np.asarray(run.marker(marker).position)
    place = hole + np.einsum("tij,tj->ti", turn, own.place[:, 0])
    np.testing.assert_allclose(matrices[pressed, :3, 3], place[pressed], atol=1e-6)
    along = matrices[:, :3, 2] / np.linalg.norm(matrices[:, :3, 2], axis=1)[:, None]
    received = np.einsum("tij,tj->ti", turn, own.force)
    aligned = np.einsum("ti,ti->t", along, received)[pressed]
    np.testing.assert_allclose(aligned, force[pressed], rtol=1e-3)
    size = np.linalg.norm(matrices[:, :3, 2], axis=1)
    assert size[~pressed].max() < 1e-6 < 0.007 < size[pressed].min()


def test_directions_of_contacts_are_one_program(run):
    """Frames of another number compile it, and not each of its operations by itself."""
    show = lambda frames: pushes(run, np.arange(frames), frames, 0.2)
    show(5)
    assert compilations(lambda: show(6)) <= 1


def shares(page):
    """Which share of the end's depth the bearing has at each frame, cell by cell."""
    (view,) = told(page)["joints"][0]["views"]
    found = np.frombuffer(base64.b64decode(view["grown"]["u8"]), np.uint8)
    return found.reshape(view["grown"]["shape"]) / 255.0


def test_the_walls_colours_add_up_to_the_volume_worn_by_then(page, run):
    """Cells are alike, and bytes tell shares to 1/510; two places wear one after the other."""
    share, worn = shares(page), np.asarray(run.worn_depth("B", "bearing")[:, 0])
    volume = np.asarray(run.worn_volume("B", "bearing"))
    assert share.shape == (page.frames, len(worn)) and np.all(np.diff(share, axis=0) >= 0)
    assert 0 < volume[20] < volume[34] < volume[-1]
    # Surfaces are updated a little before a frame, at the latest at the frame before.
    shown, share_of = share @ worn / worn.sum(), volume / volume[-1]
    assert np.all(shown <= share_of + 0.003) and np.all(shown[1:] >= share_of[:-1] - 0.003)
    assert abs(shown[-1] - 1.0) < 0.003


@pytest.mark.slow
def test_a_run_that_goes_on_shows_what_was_worn_before(run):
    """Begun in the middle of a contact: its frames are the last of the run that did not stop."""
    integrator = jc.integrator.FixedStep(2e-5)
    first = jc.simulate(run.mechanism, 3.4e-3, save=35, integrator=integrator)
    on = jc.simulate(run.mechanism, 6e-4, save=7, integrator=integrator, state=first.state())
    later = shares(plot.animate(on, slower=10000.0, fps=10))
    whole = shares(plot.animate(run, slower=1000.0, fps=10))[34:]
    assert later.shape == whole.shape
    # Surfaces are updated a little before a frame, in either run at other times.
    begun, end = (np.asarray(own.worn["B"]["bearing"][:, 0]) for own in (first, on))
    assert 0 < begun.sum() < end.sum()
    worn = end > 0
    np.testing.assert_allclose(later[0][worn], begun[worn] / end[worn], atol=0.005)
    np.testing.assert_allclose(later[-1], whole[-1], atol=0.005)


@pytest.mark.slow
def test_a_wall_that_wears_no_further_keeps_its_colour(page, run):
    rig = jc.scenes.slider_crank(wear=True, crank_speed=1e-3)
    how = {"integrator": jc.integrator.FixedStep(2e-5), "state": jc.State(worn=run.worn)}
    resting = jc.simulate(rig, 4e-3, save=41, **how)
    assert np.all(shares(plot.animate(resting, slower=1000.0, fps=10)) == 1)


def test_a_notebook_shows_the_page_and_a_file_keeps_it(page, tmp_path):
    path = page.save(tmp_path / "run.html")
    assert path.read_text(encoding="utf-8") == page.html
    assert isinstance(page, Animation) and page._repr_html_().startswith("<iframe srcdoc=")
    with pytest.raises(ValueError, match=r'run.gif ends in ".gif"; an animation is a page'):
        page.save(tmp_path / "run.gif")


@pytest.mark.parametrize("moments", [(0.01, 0.02, 0.025), (0.01, 0.02, 0.025, 1e-3, -2e-3, 5e-4)])
def test_a_body_without_a_mesh_is_the_cuboid_with_its_inertia(moments):
    """Sides a, b, c of a uniform cuboid have the moments m (b^2 + c^2) / 12."""
    body = jc.Body(2.0, moments)
    turn, sides = solids._cuboid(body, np.zeros((0, 3)), 1.0)
    squares = sides**2
    own = np.diag(2.0 / 12.0 * (squares.sum() - squares))
    wanted = np.array(jax.tree.map(float, body.inertia_matrix()))
    np.testing.assert_allclose(turn @ own @ turn.T, wanted, rtol=1e-9, atol=1e-15)


def test_a_body_is_no_larger_than_its_joints_are_apart():
    """Whatever its inertia; where they are in one place a tenth of the mechanism."""
    body = jc.Body(1.0, (10.0, 20.0, 25.0))
    for joints, most in (([[0.0, 0.0, 0.0]], 0.1), ([[0.35, 0.0, 0.0], [-0.35, 0.0, 0.0]], 0.7)):
        solid = solids.solid_of_body(body, np.array(joints), 1.0)
        assert np.ptp(solid.points, axis=0).max() == pytest.approx(most, rel=1e-9)


def test_a_planar_bar_lies_between_its_joints():
    """Wherever its centre of mass is: so a coupler is not drawn beside its pins."""
    joints = np.array([[0.1, 0.0, 0.0], [0.5, 0.3, 0.0]])
    body = jc.Body(1.0, 0.5**2 / 12, com=(0.28, 0.2))
    solid = solids.solid_of_body(body, joints, 1.0)
    bar = solid.points[:24]
    np.testing.assert_allclose(bar.mean(axis=0) @ [-0.6, 0.8, 0.0], joints[0] @ [-0.6, 0.8, 0.0])
    assert np.ptp(bar @ [0.8, 0.6, 0.0]) == pytest.approx(0.5)


def test_joints_of_the_ground_are_fastened_to_a_plate(run):
    """A square of the ground's colour behind the pin; the rails of the slider need none."""
    ground = solids.parts(run, {}, 0.2)["ground"]
    pin, ring = ground.joints["O"], solids._joint(run.mechanism.connections["O"], 0.2, (0, 0))[0]
    assert np.ptp(pin.points[:, 0]) == pytest.approx(1.5 * np.ptp(ring.points[:, 0]))
    assert pin.points[:, 2].min() < ring.points[:, 2].min()
    assert len(ground.joints["G"].points) == 2 * len(solids.make_box((1, 1, 1)).points)


def test_what_lies_between_the_eye_and_a_joint_is_glass():
    """And neither what lies beside the joint, nor behind it, nor what never comes before it."""
    still, away = np.eye(4)[None], np.eye(4)
    away[0, 3] = 9.0
    cube = lambda x, y: Part(solids.make_box((1, 1, 1)).moved(np.eye(3), np.array([x, y, 0.0])), {})
    pin = Part(solids.join_parts([]), {"B": solids.rod(0.1, 0.2)})
    own = {"pin": pin, "front": cube(2, 0), "beside": cube(2, 2), "behind": cube(-2, 0)}
    own |= {"gone": cube(3, 0)}
    moves = dict.fromkeys(own, still) | {"gone": away[None]}
    found = hiding(own, moves, [("B", "pin")], np.array([6.0, 0.0, 0.0]))
    assert found == {"front"}
    moves["gone"] = np.stack([away, np.eye(4)])
    assert hiding(own, moves, [("B", "pin")], np.array([6.0, 0.0, 0.0])) == {"front", "gone"}


def test_solids_are_closed():
    """Every solid has the volume that its measures say, by Gauss's theorem."""
    volume = lambda solid: abs(
        np.einsum("ti,ti->t", *(lambda p: (p[:, 0], np.cross(p[:, 1], p[:, 2])))(
            solid.points[solid.corners])).sum() / 6)  # fmt: skip
    assert volume(solids.make_box((1, 2, 3))) == pytest.approx(6)
    assert volume(solids.rod(0.5, 2.0)) == pytest.approx(0.5 * np.pi, rel=0.02)
    assert volume(solids.make_tube(0.5, 1.0, 1.0)) == pytest.approx(0.75 * np.pi, rel=0.02)
    assert volume(solids.make_ball(1.0)) == pytest.approx(4 / 3 * np.pi, rel=0.04)


def test_relative_motion_is_that_of_the_coordinates(run):
    """Of a joint of the tree its coordinate and speed, of one with clearance its gap's."""
    moved = relative_motion(run, "A")
    np.testing.assert_allclose(moved.turn, run.coordinate("A"), atol=1e-12)
    np.testing.assert_allclose(moved.spin, run.speed("A"), atol=1e-10)
    gap = relative_motion(run, "B")
    np.testing.assert_allclose(gap.offset, run.contact("B").offset, atol=1e-14)
    force = np.asarray(run.contact("B").normal_force)[:, 0]
    free = (force[1:] == 0) & (force[:-1] == 0) & (np.abs(np.diff(gap.rate[:, 0])) < 0.03)
    assert free.sum() > 20
    slopes = np.diff(gap.offset[:, 0]) / np.diff(np.asarray(run.time))
    middle = 0.5 * (gap.rate[1:, 0] + gap.rate[:-1, 0])
    np.testing.assert_allclose(slopes[free], middle[free], atol=2e-5)


def test_wrong_arguments_end_in_sentences(run, tmp_path):
    for meshes, sentence in (
        ({"wheel": "wheel.stl"}, 'body "wheel"'),
        ({"rod": tmp_path / "none.stl"}, "no such file"),
        ({"rod": 3}, 'mesh of "rod"'),
        ({"rod": (np.zeros((3, 3)), [[0, 1, 7]])}, "triangles indices of the points"),
        ([], "meshes is an empty list"),
    ):
        with pytest.raises(ValueError, match=sentence):
            plot.animate(run, meshes=meshes)
    for trace in ("rod", ["rod"], True):
        with pytest.raises(ValueError, match="trace"):
            plot.animate(run, trace=trace)
    with pytest.raises(ValueError, match="slower of animate"):
        plot.animate(run, slower=0.0)


@pytest.mark.skipif(browser.PATH is None, reason="no browser is installed that could open the page")
@pytest.mark.slow
def test_the_page_plays_in_a_browser_without_a_network(run, tmp_path):
    """It draws bodies and insets, moves with its slider, and asks for nothing but itself."""
    solid = meshio.Mesh(*_corner())
    solid.write(tmp_path / "slider.stl")
    page = plot.animate(run, meshes={"slider": tmp_path / "slider.stl"})
    path = page.save(tmp_path / "run.html")
    with browser.opened(path, tmp_path / "profile") as opened:
        opened.until("document.body && document.body.dataset.ready === 'yes'")
        assert opened.run("document.getElementById('play').textContent") == "Pause"
        assert opened.run("document.querySelectorAll('#insets canvas').length") == 1
        assert "slider" in opened.run("document.getElementById('bodies').textContent")
        pictures = []
        for at in (0.0, 3.9e-3):
            opened.run(f"animation.go({at})")
            opened.until(f"Math.abs(document.getElementById('time').value - {at}) < 1e-5")
            opened.run("new Promise((done) => setTimeout(done, 1500))")
            opened.until("animation.state.playing === false")
            image = matplotlib.image.imread(io.BytesIO(opened.picture()))[..., :3]
            pictures.append(image)
        opened.call(
            "Emulation.setDeviceMetricsOverride",
            width=420, height=700, deviceScaleFactor=1, mobile=False,
        )  # fmt: skip
        opened.until("document.getElementById('canvasTarget').clientWidth === 420")
        low = "document.getElementById('canvasTarget').getBoundingClientRect().bottom"
        assert opened.run(f"document.getElementById('insets').getBoundingClientRect().top >= {low}")
        assert opened.run("document.documentElement.scrollWidth <= 420")
        assert not opened.faults
        assert all(url.startswith(("file:", "blob:", "data:")) for url in opened.asked)
    # The scene, left, and the inset, right, hold colours, that of the wear ever more; an empty page
    # is grey.
    shares = [
        [(np.ptp(part, axis=-1) > 0.2).mean() for part in (image[:500, :800], image[20:200, -320:])]
        for image in pictures
    ]
    assert min(scene for scene, _ in shares) > 0.01
    assert shares[1][1] > 0.01 and shares[1][1] > 1.5 * shares[0][1]


def _corner():
    return np.eye(4, 3) * 0.02, [
        ("triangle", np.array([[0, 1, 2], [0, 1, 3], [1, 2, 3], [0, 2, 3]]))
    ]


@pytest.mark.slow(sample=False)
@pytest.mark.parametrize("kind", ["four_bar", "parallel_3rsr", "antenna", "guide"])
def test_every_kind_of_joint_has_its_inset(kind):
    rig, duration, integrator = {
        "four_bar": (jc.scenes.four_bar("spatial"), 0.02, SLOW_INTEGRATOR),
        "parallel_3rsr": (jc.scenes.parallel_3rsr("one"), 0.02, SLOW_INTEGRATOR),
        "antenna": (jc.scenes.antenna(), 0.2, jc.integrator.NonColliding()),
        "guide": (jc.scenes.guide(friction="regularised"), 0.02, SLOW_INTEGRATOR),
    }[kind]
    run = jc.simulate(rig, duration, save=21, integrator=integrator)
    data = told(plot.animate(run))
    kinds = {"guide": ["slot"], "antenna": ["round"] * 2}.get(kind, ["round"] * 2)
    for joint in data["joints"]:
        assert [view["kind"] for view in joint["views"]] == kinds
        assert joint["clearance"] > 0
        for view in joint["views"]:
            if view["kind"] == "round":
                reach = np.linalg.norm(numbers(view["centre"]), axis=1).max()
                assert reach < 1.05 * joint["clearance"]
    assert jnp.isfinite(jnp.asarray(numbers(data["time"]))).all()
