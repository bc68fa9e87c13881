"""A mechanism in a live view: a pulled body rests where the spring balances its weight, no frame
compiles, keys pause and start again, what fails says why, and without a window a sentence does."""

import jax
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.backend_bases import CloseEvent, KeyEvent, MouseEvent, TimerBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import jaxclear as jc

MASS, LENGTH, FALL, STIFFNESS = 2.0, 0.4, 9.81, 300.0


class Ticking(TimerBase):
    runs = False

    def _timer_start(self):
        self.runs = True

    def _timer_stop(self):
        self.runs = False


class Canvas(FigureCanvasAgg):
    """A canvas that counts how often the whole figure is drawn, with a timer that could tick."""

    draws = 0

    def draw(self):
        self.draws += 1
        super().draw()

    def new_timer(self, interval=None, callbacks=None):
        self.timer = Ticking(interval, callbacks)
        return self.timer


def pendulum(axis="z", joint=None, damping=3.0):
    """A rod whose centre of mass is `LENGTH` from its hinge, hanging along -y (or -z)."""
    at = None if axis == "z" else (0.0, 0.0, 0.0)
    hinge = [jc.Marker(name, at, axis) for name in ("ground", "rod")]
    inertia = 0.01 if axis == "z" else (0.01, 0.01, 0.01)
    down = (0.0, -FALL) if axis == "z" else (0.0, 0.0, -FALL)
    return jc.Mechanism(
        {"rod": jc.Body(MASS, inertia, (LENGTH, 0.0))},
        {"hinge": jc.Connection(joint or jc.joint.Revolute(), *hinge)},
        {"gravity": jc.load.Gravity(down), "oil": jc.load.JointSpring("hinge", damping=damping)},
        start={"hinge": -0.5 * np.pi if axis == "z" else 0.5 * np.pi},
    )


def opened(rig, **how):
    figure = Figure(figsize=(8.0, 4.5), layout="constrained")
    Canvas(figure)
    return jc.view(rig, figure=figure, **how)


def point(view, name, place):
    """An event of the pointer at a place of the mechanism [m]."""
    canvas = view.figure.canvas
    unit = 1e3 if "[mm]" in view.figure.axes[0].get_xlabel() else 1.0
    x, y = view.figure.axes[0].transData.transform(unit * np.asarray(place))
    canvas.callbacks.process(name, MouseEvent(name, canvas, x, y, 1))


def press(view, key):
    canvas = view.figure.canvas
    canvas.callbacks.process("key_press_event", KeyEvent("key_press_event", canvas, key))


@pytest.fixture
def programs():
    """Seconds of every program that JAX builds from now on."""
    built = []

    def listen(event, seconds, **_):
        if event == "/jax/core/compile/jaxpr_to_mlir_module_duration":
            built.append(seconds)

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield built
    jax.monitoring.unregister_event_duration_listener(listen)


@pytest.mark.parametrize("axis, plane", [("z", "xy"), ("y", "xz")])
def test_a_pulled_pendulum_rests_where_the_spring_balances_its_weight(axis, plane, programs):
    view = opened(pendulum(axis), stiffness=STIFFNESS, plane=plane)
    programs.clear()
    across, up = 0, 2 if plane == "xz" else 1
    point(view, "button_press_event", (0.0, -0.6 * LENGTH))
    pointer = np.array([0.5, -0.1])
    point(view, "motion_notify_event", pointer)
    for _ in range(30):
        view.step(0.1)
    # Potential energy m g l sin(a) - k r (x cos(a) + y sin(a)), r where the spring pulls.
    reach = 0.6 * LENGTH
    a = np.arctan2(
        STIFFNESS * reach * pointer[1] - MASS * FALL * LENGTH, STIFFNESS * reach * pointer[0]
    )
    place = np.asarray(view.run.body("rod").com)[-1]
    expected = LENGTH * np.array([np.cos(a), np.sin(a)])
    np.testing.assert_allclose(place[[across, up]], expected, atol=1e-3 * LENGTH)
    assert not programs, "a frame has built a program"
    drawn = view.figure.canvas.draws
    point(view, "button_release_event", pointer)
    for _ in range(30):
        view.step(0.1)
    place = np.asarray(view.run.body("rod").com)[-1]
    np.testing.assert_allclose(place[[across, up]], [0.0, -LENGTH], atol=1e-3 * LENGTH)
    assert not programs
    assert view.figure.canvas.draws == drawn, "a frame draws what stands still"


def test_space_pauses_enter_starts_again_and_closing_ends_the_run():
    view = opened(pendulum())
    view.step(0.1)
    time = float(view.state.start_time)
    press(view, " ")
    view.step(0.1)
    assert float(view.state.start_time) == time
    press(view, " ")
    view.step(0.1)
    np.testing.assert_allclose(float(view.state.start_time), time + 0.1)
    press(view, "enter")
    view.step(0.1)
    np.testing.assert_allclose(float(view.state.start_time), 0.1)
    canvas = view.figure.canvas
    assert canvas.timer.runs and canvas.timer.callbacks
    canvas.callbacks.process("close_event", CloseEvent("close_event", canvas))
    assert not canvas.timer.runs


def test_frames_take_as_long_as_passes_times_the_speed():
    view = opened(pendulum(), speed=0.25)
    before = float(view.state.start_time)
    view._clock -= 0.04
    view.step()
    passed = float(view.state.start_time) - before
    assert 0.25 * 0.04 <= passed <= 0.25 / 15
    assert "s" in view.figure.axes[0].texts[0].get_text()


def test_a_pull_that_fails_says_why_and_keeps_the_last_good_state():
    # A spring that no step of these follows.
    view = opened(pendulum(), stiffness=1e12, integrator=jc.integrator.ImplicitStep(1e-3))
    view.step(1 / 30)
    state = view.state
    point(view, "button_press_event", (0.0, -0.6 * LENGTH))
    point(view, "motion_notify_event", (0.4, 0.0))
    for _ in range(5):
        view.step(1 / 30)
    assert view.is_paused and "ended early" in view.message
    assert "ended early" in view.figure.axes[0].texts[0].get_text().replace("\n", " ")
    assert np.isfinite(float(view.state.start_time))
    press(view, " ")
    view.step(1 / 30)
    assert not view.message and view.state is not state
    assert np.isfinite(np.asarray(view.run.states)).all()


def test_a_journal_is_drawn_in_its_clearance_circle():
    view = opened(jc.scenes.slider_crank(), speed=0.1)
    for _ in range(3):
        view.step(1e-3)
    orbit = next(ax for ax in view.figure.axes if "journal in B" in ax.get_title())
    offset = np.asarray(view.run.contact("B").offset)[-1, :2] / 0.2e-3
    np.testing.assert_allclose(np.ravel(orbit.lines[1].get_data()), offset, atol=1e-6)


@pytest.mark.parametrize(
    "how, sentence",
    [
        ({"speed": 0.0}, "speed of view is 0"),
        ({"stiffness": -1.0}, "stiffness of view is -1"),
        ({"plane": "zx"}, "plane of view"),
        ({"integrator": 3}, "the integrator"),
    ],
)
def test_wrong_arguments_get_a_sentence(how, sentence):
    with pytest.raises(ValueError, match=sentence):
        opened(pendulum(), **how)
    with pytest.raises(ValueError, match="what is shown"):
        opened(3)


def test_without_a_window_a_sentence_says_what_is_missing():
    before = plt.get_backend()
    plt.switch_backend("agg")
    try:
        with pytest.raises(
            ValueError, match=r"there is no window.*backend_agg.*%matplotlib widget"
        ):
            jc.view(pendulum())
        assert not plt.get_fignums()
    finally:
        plt.switch_backend(before)
