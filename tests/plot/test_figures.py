"""The field's standard figures show what the run holds, with units; every figure draws in the axes
that it is given."""

import inspect

import equinox as eqx
import jax
import matplotlib.figure
import numpy as np
import pytest
from matplotlib.axes import Axes

import jaxclear as jc
from jaxclear import plot
from jaxclear.plot.signal import TimeCurve, at_periods, signal, spectral_density

SPEED = 50.0
PERIOD = 1e-3


def axes_of(count, space=False):
    figure = matplotlib.figure.Figure()
    kind = {"projection": "3d"} if space else {}
    return figure.subplots(1, count, squeeze=False, subplot_kw=kind).ravel()


def pointing(run):
    return jc.pointing_error(run, "slider", through=("A", "B"))


# Every figure of a run: how it is asked for, panels, and whether it is in space.
OF_RUNS = {
    "angular_velocity": (lambda run, **k: plot.angular_velocity(run, run, "rod", **k), 2),
    "bifurcation": (
        lambda run, **k: plot.bifurcation({2e-4: run}, "slider", period=PERIOD, **k),
        1,
    ),
    "displacement": (lambda run, **k: plot.displacement({"own": run}, run, "rod", **k), 3),
    "hysteresis": (lambda run, **k: plot.hysteresis(run, "B", **k), 2),
    "journal_orbit": (lambda run, **k: plot.journal_orbit(run, "B", **k), 1),
    "modes": (lambda run, **k: plot.modes(run, **k), 1),
    "path": (lambda run, **k: plot.path(run, "rod", jc.Marker("rod", (0.06, 0.02)), **k), 1),
    "phase_portrait": (lambda run, **k: plot.phase_portrait(run, "slider", **k), 1),
    "poincare_section": (lambda run, **k: plot.poincare_section(run, "B", period=PERIOD, **k), 1),
    "pointing_budget": (lambda run, **k: plot.pointing_budget(pointing(run), **k), 4),
    "spectrum": (lambda run, **k: plot.spectrum(run, "B", "force", period=PERIOD, **k), 1),
    "wear_surface": (lambda run, **k: plot.wear_surface(run, "B", **k), 1),
    "wear_unrolled": (lambda run, **k: plot.wear_unrolled(run, "B", **k), 2),
}


def drawing(name):
    return inspect.signature(getattr(plot, name)).parameters


def test_every_figure_takes_axes():
    for name in set(plot.__all__) - {"animate", "end_centres"}:
        assert drawing(name)["ax"].kind == inspect.Parameter.KEYWORD_ONLY, name
        assert drawing(name)["ax"].default is None, name


# What takes long to compute before it is drawn.
LONG = {"pointing_budget"}
EACH = [pytest.param(n, marks=[pytest.mark.slow] * (n in LONG)) for n in OF_RUNS]


@pytest.mark.parametrize("name", EACH)
def test_a_figure_draws_in_the_axes_it_is_given_and_returns_them(run, name):
    draw, count = OF_RUNS[name]
    axes = axes_of(count, space=name == "wear_surface")
    found = draw(run, ax=axes[0] if count == 1 else axes)
    if count == 1:
        assert found is axes[0] and isinstance(found, Axes)
    else:
        assert list(found.flat) == list(axes)
    assert all(axis.has_data() for axis in axes)
    with pytest.raises(ValueError, match=rf"ax of plot\.{name}|in space|in the plane"):
        draw(run, ax=axes_of(count + 1, space=name == "wear_surface"))


@pytest.mark.parametrize("name", [n for n in EACH if n.values != ("wear_surface",)])
def test_every_axis_says_what_it_is_and_in_which_unit(run, name):
    draw, _ = OF_RUNS[name]
    figure = draw(run)
    assert isinstance(figure, matplotlib.figure.Figure)
    panels = [axis for axis in figure.axes if axis.get_label() != "<colorbar>"]
    texts = [axis.get_xlabel() for axis in panels] + [axis.get_ylabel() for axis in panels]
    said = [text for text in texts if text]
    assert said and all(("[" in text and text.endswith("]")) or "%" in text for text in said), said


def test_a_driven_crank_turns_with_its_speed(run):
    own = signal(run, "crank", "turn")
    np.testing.assert_allclose(own.rates, SPEED, rtol=1e-9)
    np.testing.assert_allclose(np.diff(own.values), SPEED * 1e-4, rtol=1e-6)
    assert own.rates_in_unit()[1] == "angular velocity of crank [rad/s]"


def test_the_rate_of_a_signal_is_its_slope(run):
    for of, axis in (("rod", "x"), ("rod", "turn"), ("G", None), ("A", None), ("slider", "y")):
        own = signal(run, of, axis)
        middle = 0.5 * (own.rates[1:] + own.rates[:-1])
        off = np.abs(np.diff(own.values) / np.diff(own.time) - middle)
        jumps = np.abs(np.diff(own.rates))
        assert np.all(off <= 0.51 * jumps + 2e-3 * np.abs(own.rates).max() + 1e-12), of


def test_a_motion_that_repeats_is_one_point_of_its_section():
    """Every second period is two."""
    time = np.linspace(0.0, 5.0, 1001)
    turn = 2 * np.pi * time
    own = TimeCurve(time, np.sin(turn), 2 * np.pi * np.cos(turn), "m", "x", "velocity x")
    times, values, rates = at_periods(own, 1.0, 0.3, 5.0)
    assert len(times) == 5
    np.testing.assert_allclose(values, np.sin(0.6 * np.pi), atol=1e-7)
    np.testing.assert_allclose(rates, 2 * np.pi * np.cos(0.6 * np.pi), atol=1e-5)
    time = np.linspace(0.0, 8.0, 3001)
    own = TimeCurve(time, np.sin(np.pi * time), np.pi * np.cos(np.pi * time), "m", "x", "")
    _, values, _ = at_periods(own, 1.0, 0.5, 8.0)
    np.testing.assert_allclose(np.unique(values.round(6)), [-1.0, 1.0])


def test_a_spectrum_holds_the_power_of_its_tone():
    """A tone of amplitude a has the mean square a^2 / 2, at its frequency."""
    time = np.arange(4000) * 1e-3
    values = 3.0 + 0.7 * np.sin(2 * np.pi * 40.0 * time)
    frequency, density = spectral_density(time, values, 3)
    assert frequency[density.argmax()] == pytest.approx(40.0, abs=0.5)
    assert np.trapezoid(density, frequency) == pytest.approx(0.5 * 0.7**2, rel=0.01)
    with pytest.raises(ValueError, match="evenly spread"):
        spectral_density(np.linspace(0, 1, 50) ** 2, np.zeros(50), 3)


def test_friction_of_a_journal_opposes_its_turning(run):
    """Of a law of the sliding speed, apart from the journal's own path along the wall."""
    figure = plot.hysteresis(run, "B")
    _, over_speed = figure.axes[:2]
    points = np.concatenate(over_speed.collections[0].get_segments())
    rubbing = np.abs(points[:, 1]) > 0.1 * np.abs(points[:, 1]).max()
    assert rubbing.any() and np.all(points[rubbing, 0] * points[rubbing, 1] < 0)
    assert over_speed.get_xlabel() == "angular velocity in B [rad/s]"
    assert figure.axes[0].get_ylabel() == "friction torque on the child [N m]"


def test_an_orbit_stays_in_its_clearance(run):
    figure = plot.journal_orbit(run, "B")
    path = np.concatenate(figure.axes[0].collections[0].get_segments())
    deepest = 1e6 * float(np.max(run.contact("B").indentation))
    assert np.linalg.norm(path, axis=1).max() == pytest.approx(200.0 + deepest, rel=1e-6)
    assert 0.0 < deepest < 10.0


def test_wrong_names_end_in_sentences(run):
    for call, sentence in (
        (lambda: plot.phase_portrait(run, "wheel"), 'body or joint "wheel"'),
        (lambda: plot.phase_portrait(run, "B", "force"), "has no rate"),
        (lambda: plot.phase_portrait(run, "A", "force"), 'no axis "force" of joint "A"'),
        (lambda: plot.poincare_section(run, "B", period=1.0), "no whole period"),
        (lambda: plot.bifurcation({}, "B", period=1.0), "runs of bifurcation is empty"),
        (lambda: plot.journal_orbit(run, "A"), "clearance joint"),
        (lambda: plot.journal_orbit(run, "B", plane="zz"), "plane of journal_orbit"),
    ):
        with pytest.raises(ValueError, match=sentence):
            call()


@pytest.mark.parametrize("name", ["path", "overview", "animate"])
def test_a_batch_is_no_run_to_draw(run, name):
    both = jax.tree.map(lambda x: np.stack([x, x]) if eqx.is_array(x) else x, run)
    rest = ("rod",) if name == "path" else ()
    with pytest.raises(ValueError, match=r"batch of 2 runs: take one of them, run\[i\]"):
        getattr(plot, name)(both, *rest)


def test_paths_are_drawn_over_the_mechanism_with_equal_axes(run):
    """The curve is the run's, the pin of the ground a triangle, the slider on a dashed rail."""
    marker = jc.Marker("rod", (0.06, 0.02))
    axis = plot.path(run, marker).axes[0]
    (curve,) = (line for line in axis.lines if line.get_label() == "rod at (0.06, 0.02) m")
    np.testing.assert_allclose(curve.get_xydata(), 1e3 * np.asarray(run.path(marker))[:, :2])
    assert axis.get_aspect() == 1.0
    assert [line.get_marker() for line in axis.lines].count("^") == 1
    assert [line.get_linestyle() for line in axis.lines].count("--") == 1
    assert {text.get_text().strip() for text in axis.texts} == {"O", "A", "B", "G"}
    with pytest.raises(ValueError, match="no point to draw"):
        plot.path(run)
    with pytest.raises(ValueError, match='no body "bar"'):
        plot.path(run, "bar")


def test_paths_in_space_are_drawn_in_space():
    """A body that turns about x leaves the plane."""
    joint = jc.Connection(jc.joint.Revolute(), "ground", "bar", axis="x")
    bar = jc.Body(1.0, (0.1, 0.1, 0.1), (0.0, 0.1, 0.0))
    swing = jc.Mechanism({"bar": bar}, {"O": joint}, speeds={"O": 3.0})
    found = plot.path(jc.simulate(swing, 0.5, save=11, verify=False), "bar")
    assert found.axes[0].name == "3d" and found.axes[0].get_zlabel() == "z [mm]"
