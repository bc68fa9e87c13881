"""A mechanism that runs in a window while its bodies are pulled with the pointer: `jaxclear.view`.

Each frame is a run from the state in which the last one ended. The pointer pulls by a spring, a
`load.Spring` between the ground and the body; its stiffness and the place of its end on the ground
are numbers, so that no frame compiles anything. Only what moves is drawn anew.
"""

import textwrap
import time
from typing import Any

import equinox as eqx
import numpy as np
from matplotlib.backend_bases import TimerBase

from jaxclear.components.body import GROUND, Marker
from jaxclear.components.load import AbstractLoad, Spring
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_name, check_number, expect
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.integrators.implicit_step import ImplicitStep
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.plot.canvas import IN_PANEL, readable
from jaxclear.plot.motion import PLANES
from jaxclear.results.relative_motion import marker_frame
from jaxclear.results.solids import rows_of, size_of, slides
from jaxclear.results.state_history import State
from jaxclear.simulation.simulate import simulate

# Time of a frame [s], and the longest that one makes up for after a slow one.
FRAME, LONGEST = 1 / 30, 1 / 15
# Saved instants of a frame; the path of a journal shows so many of them.
SAVES, TRAIL = 11, 300
# The weight of all bodies, at this fall [m/s^2], stretches the spring by this share of their size.
FALL, STRETCH = 9.81, 0.1
MOST_INSETS = 3
NO_WINDOW = (
    "there is no window: matplotlib draws by {}. In a notebook write `%matplotlib widget` before "
    "(pip install ipympl); elsewhere install a toolkit for windows, such as PyQt6. "
    "jaxclear.plot.animate(run) makes a page of a run that any browser shows."
)
KEYS = "drag a body to pull it · space: pause · enter: start again"


@answering
def view(
    mechanism: Mechanism,
    *,
    speed: float = 1.0,
    stiffness: float | None = None,
    plane: str = "xy",
    integrator: AbstractIntegrator | None = None,
    state: State | None = None,
    figure: Any = None,
) -> "LiveView":
    """Open a window in which the mechanism runs and its bodies are pulled with the pointer.

    Drag a body: a damped spring pulls it to the pointer. Space pauses, enter starts again, closing
    the window ends the run. Beside the mechanism journals move in their clearance circles. A run
    that fails shows its sentence, lets the body go and waits for space in its last good state.

    Args:
        mechanism: the mechanism.
        speed: how fast it runs [s of the mechanism per s], > 0; 1 by default, less is slow motion.
        stiffness: stiffness of the spring [N/m], > 0; by default the weight of all bodies
            stretches it by a tenth of their size.
        plane: name of the plane that is drawn and pulled in: "xy" (default), "xz" or "yz".
        integrator: one of `jaxclear.integrator`; by default `ImplicitStep(1e-4)`.
        state: state in which it begins; the mechanism's start by default.
        figure: an empty `matplotlib.figure.Figure` to draw in; by default a new window.

    Returns:
        the `LiveView`; its `state` is the last one, from which `jaxclear.simulate` goes on.

    Raises:
        ValueError: if an argument is wrong, the mechanism cannot start, or there is no window.
    """
    expect(mechanism, Mechanism, "what is shown", "a jaxclear.Mechanism")
    check_number("speed of view", speed, "1", above=0)
    check_name("plane of view", plane, PLANES)
    if stiffness is not None:
        check_number("stiffness of view", stiffness, "N/m", above=0)
    integrator = ImplicitStep(1e-4) if integrator is None else integrator
    if figure is not None:
        return LiveView(mechanism, figure, speed, stiffness, plane, integrator, state)
    import matplotlib.pyplot as plt

    figure = plt.figure("jaxclear", figsize=(8.0, 4.5), layout="constrained")
    try:
        if type(figure.canvas.new_timer()) is TimerBase:
            raise ValueError(NO_WINDOW.format(type(figure.canvas).__module__))
        shown = LiveView(mechanism, figure, speed, stiffness, plane, integrator, state)
    except ValueError:
        plt.close(figure)
        raise
    plt.show()
    return shown


class LiveView:
    """A mechanism that runs in a figure, as `jaxclear.view` opens it.

    `state` is the last state, `run` the last frame, `message` what a failed run says ("": none).
    """

    def __init__(
        self,
        mechanism: Mechanism,
        figure: Any,
        speed: float,
        stiffness: float | None,
        plane: str,
        integrator: AbstractIntegrator,
        state: State | None,
    ):
        self.mechanism, self.figure, self.speed, self.state = mechanism, figure, speed, state
        self.message, self.is_paused, self._start, self._integrator = "", False, state, integrator
        self._plane, self._clock, self._stiffness = list(PLANES[plane]), time.monotonic(), 0.0
        self._depth = [k for k in range(3) if k not in self._plane]
        self._pulled, self._point, self._pointer = "", np.zeros(3), np.zeros(3)
        sides = [x for c in mechanism.connections.values() for x in (c.parent, c.child)]
        # What is given by two numbers stays in the plane; so does a pull on it.
        self._count = 2 if all(len(side.at or ()) < 3 for side in sides) else 3
        self._poses, self._corners = {GROUND: (np.eye(3)[None], np.zeros((1, 3)))}, {}
        for name, body in mechanism.bodies.items():
            ends = [marker_frame(side)[1] for side in sides if side.body == name]
            com = marker_frame(Marker(name, body.com))[1]
            self._corners[name] = np.array(ends if len(ends) > 1 else [*ends, com])
        self._pullable = mechanism.with_loads({**mechanism.loads, **self._pulls()})
        for _ in range(2):  # from its start, and from a state: each is a program
            self._advance(FRAME)
        if self.message:
            raise ValueError(self.message)
        size, bodies = size_of(self.run), mechanism.bodies.values()
        weight = FALL * sum(float(body.mass) for body in bodies)
        self._stiffness = weight / (STRETCH * size) if stiffness is None else stiffness
        self._lay_out(size)
        figure.live_view = self  # matplotlib's own references to what listens are weak
        timer = figure.canvas.new_timer(interval=int(500 * FRAME))
        timer.add_callback(self.step)
        connect = figure.canvas.mpl_connect
        for name in ("button_press", "motion_notify", "button_release"):
            connect(f"{name}_event", self._follow_pointer)
        connect("draw_event", self._paint)
        connect("key_press_event", self._press_key)
        connect("close_event", lambda _: timer.stop())
        timer.start()
        self._draw()

    def step(self, duration: float | None = None) -> None:
        """Simulate and draw a frame.

        Args:
            duration: its time [s], > 0; by default `speed` times that since the last frame.
        """
        before, self._clock = self._clock, time.monotonic()
        if not self.is_paused:
            passed = min(max(self._clock - before, 0.1 * FRAME), LONGEST)
            self._advance(self.speed * passed if duration is None else duration)
            self._draw()

    def _pulls(self) -> dict[str, AbstractLoad]:
        """A spring from every body to the pointer, of which at most one pulls."""
        to, at = (tuple(map(float, x[: self._count])) for x in (self._pointer, self._point))
        springs: dict[str, AbstractLoad] = {}
        for name, body in self.mechanism.bodies.items():
            stiffness = self._stiffness if name == self._pulled else 0.0
            damping = 2 * float(np.sqrt(stiffness * float(body.mass)))
            ends = Marker(GROUND, to), Marker(name, at)
            springs[f"pull of {name}"] = Spring(*ends, stiffness=stiffness, damping=damping)
        return springs

    def _advance(self, duration: float) -> None:
        """Simulate `duration` [s] from the last state, pulled to the pointer."""
        if self._pulled:  # in the plane alone
            place = self._places(self._pulled, self._point)[-1, 0]
            self._pointer[self._depth] = place[self._depth]
        pulls = self._pulls()
        places: Any = lambda rig: [rig.loads[name] for name in pulls]
        pulled = eqx.tree_at(places, self._pullable, [*pulls.values()])
        options: Any = {"state": self.state, "save": SAVES, "verify": False, "throw": False}
        run = simulate(pulled, duration, integrator=self._integrator, **options)
        if run.succeeded:
            self.run, self.state = run, run.state()
            for name in self._corners:
                motion = run.body(name)
                self._poses[name] = np.asarray(motion.rotation), np.asarray(motion.origin)
        else:
            self._pulled, self.message, self.is_paused = "", run.result, True

    def _places(self, body: str, points: np.ndarray) -> np.ndarray:
        """Points of a body, given in its frame, over the last frame, shape (time, point, 3) [m]."""
        rotation, origin = self._poses[body]
        return origin[:, None] + np.atleast_2d(points) @ rotation.transpose(0, 2, 1)

    def _lay_out(self, size: float) -> None:
        """Axes, what stands still in them, and the lines and the text that move."""
        connections = self.mechanism.connections
        gaps: Any = {n: getattr(c.joint, "gap", c.joint) for n, c in connections.items()}
        loose = {
            n: getattr(g, "clearance", None) for n, g in gaps.items() if {"x", "y"} <= rows_of(g)
        }
        self._loose = {
            n: float(clearance) for n, clearance in loose.items() if clearance is not None
        }
        names = [*self._loose][:MOST_INSETS]
        rows = [["", *names[k : k + 1]] for k in range(len(names) or 1)]
        panels = self.figure.subplot_mosaic(rows, width_ratios=(3, 1)[: len(rows[0])])
        self._axis = axis = panels.pop("")
        self._scale, unit = readable([size], "m")

        def moving(axis: Any, style: str, **look: Any) -> Any:
            return axis.plot([], [], style, animated=True, **look)[0]

        look: Any = {"lw": 6, "ms": 16, "alpha": 0.7, "pickradius": 10}
        styles = {n: "-" if np.ptp(x, axis=0).any() else "s" for n, x in self._corners.items()}
        self._lines = {n: moving(axis, x, label=n, **look) for n, x in styles.items()}
        self._joints = moving(axis, "o", color="0.3", mfc="w")
        self._spring = moving(axis, "--o", color="C3", ms=5, lw=2)
        self._orbits = {
            n: [moving(x, style, c="C0", lw=1) for style in "-o"] for n, x in panels.items()
        }
        look = {"va": "top", "fontsize": 8, "transform": axis.transAxes, "animated": True}
        self._text = axis.text(0.01, 0.98, "", **look)
        turn = np.linspace(0, 2 * np.pi, 100)
        for name, panel in panels.items():
            panel.plot(np.cos(turn), np.sin(turn), "r-", lw=0.8)
            panel.set(aspect="equal", xticks=(), yticks=(), xlim=(-1.2, 1.2), ylim=(-1.2, 1.2))
            panel.set_title(f"journal in {name}", fontsize=8)
        for connection in connections.values():
            if GROUND in (connection.parent.body, connection.child.body):
                side = connection.parent if connection.parent.body == GROUND else connection.child
                axes, at = marker_frame(side)
                place, along = self._scale * at[self._plane], axes[self._plane, 2]
                axis.plot(*place, "^", color="0.6", ms=12, zorder=1)
                if slides(connection.joint) and np.any(along):
                    axis.axline(place, place + along, color="0.6", ls="--", lw=1, zorder=0)
        x, y = ("xyz"[k] for k in self._plane)
        axis.set_xlabel(f"{x} [{unit}]\n{KEYS}", fontsize=8)
        axis.set_ylabel(f"{y} [{unit}]", fontsize=8)
        axis.set_aspect("equal", adjustable="datalim")
        axis.legend(loc="upper right", fontsize=8, markerscale=0.5)

    def _draw(self) -> None:
        """Bring what moves to where it is; draw it alone while the picture holds it."""
        plane, scale = self._plane, self._scale
        places = {n: scale * self._places(n, x)[-1][:, plane] for n, x in self._corners.items()}
        for name, corners in places.items():
            self._lines[name].set_data(*np.append(corners, corners[:1], axis=0).T)
        every, ends = np.concatenate([*places.values()]), np.zeros((0, 3))
        self._joints.set_data(*every.T)
        if self._pulled:
            ends = np.append(self._places(self._pulled, self._point)[-1], [self._pointer], axis=0)
        self._spring.set_data(*scale * ends.T[plane])
        sentence = textwrap.fill(self.message, IN_PANEL)
        self._text.set_text(f"{float(self.run.time[-1]):.3f} s\n{sentence}")
        self._text.set_color("C3" if sentence else "0.3")
        for name, (path, journal) in self._orbits.items():
            c = self.mechanism.connections[name]
            (axes, at), (_, pin) = marker_frame(c.parent), marker_frame(c.child)
            away = self._places(c.child.body, pin) - self._places(c.parent.body, at)
            offset = (away @ self._poses[c.parent.body][0] @ axes)[:, 0, :2] / self._loose[name]
            trail = np.hstack([path.get_data(), offset.T])[:, -TRAIL:]
            path.set_data(*trail)
            journal.set_data(*trail[:, -1:])
        canvas, margin = self.figure.canvas, 0.3 * np.ptp(every, axis=0).max()
        if not all(self._axis.dataLim.contains(*corner) for corner in every):
            self._axis.update_datalim(np.concatenate([every - margin, every + margin]))
            self._axis.autoscale_view()
            canvas.draw()
        else:
            canvas.restore_region(self._background)
            self._paint()
            canvas.blit(self.figure.bbox)

    def _paint(self, event: Any = None) -> None:
        """Draw what moves, after the whole figure (an event of which there is) upon that."""
        if event is not None:
            self._background = self.figure.canvas.copy_from_bbox(self.figure.bbox)
        lines = [*self._lines.values(), self._joints, self._spring, self._text]
        for line in lines + [line for orbit in self._orbits.values() for line in orbit]:
            self.figure.draw_artist(line)

    def _follow_pointer(self, event: Any) -> None:
        """Pull the body under a button that is pressed to the pointer until it is released."""
        if event.name == "button_release_event":
            self._pulled = ""
        # A toolbar that zooms has the pointer for itself.
        if event.inaxes is not self._axis or self.figure.canvas.widgetlock.locked():
            return
        self._pointer[self._plane] = np.array([event.xdata, event.ydata]) / self._scale
        if event.name == "button_press_event":
            for name, line in self._lines.items():
                if line.contains(event)[0]:
                    rotation, origin = (x[-1] for x in self._poses[name])
                    middle = self._places(name, self._corners[name])[-1].mean(axis=0)
                    self._pointer[self._depth] = middle[self._depth]
                    self._pulled, self._point = name, (self._pointer - origin) @ rotation

    def _press_key(self, event: Any) -> None:
        """Space pauses and goes on, enter starts again."""
        if event.key == "enter":
            self.state, self._pulled = self._start, ""
        if event.key in (" ", "enter"):
            self.is_paused = event.key == " " and not self.is_paused
            self.message, self._clock = "", time.monotonic()
