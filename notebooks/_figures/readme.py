"""The pictures of the README: `python notebooks/_figures/readme.py` writes them beside it."""

from pathlib import Path

import matplotlib
import matplotlib.image
import numpy as np
from matplotlib.backend_bases import MouseEvent
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import jaxclear as jc
from jaxclear import plot

MICRO = 1e6


def picture() -> Figure:
    """The four-bar's joint with clearance over two turns: where its journal is, what it carries,
    what it wears.
    """
    run = jc.simulate(jc.scenes.four_bar("spatial", 0.2e-3), 1.26, save=1261)
    joint = run.mechanism.connections["B"].joint
    figure = Figure(figsize=(12.0, 3.4), layout="constrained")
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.0, 1.5, 1.5))
    turn = np.linspace(0, 2 * np.pi, 300)
    reach = MICRO * float(joint.clearance)
    left.plot(reach * np.cos(turn), reach * np.sin(turn), "r-", lw=0.8)
    left.plot(*(MICRO * plot.end_centres(run, "B")[1]).T, ".", ms=2.5, alpha=0.4)
    left.set_aspect("equal")
    left.set(xlabel="x [µm]", ylabel="y [µm]", title="journal in the clearance circle")
    force = np.asarray(run.contact("B").normal_force).sum(axis=1)
    middle.plot(run.time, force, lw=0.7)
    middle.set(xlabel="time [s]", ylabel="normal force [N]", title="what the joint carries")
    middle.set_ylim(0, 1.1 * np.percentile(force, 99.5))
    depth = MICRO * np.asarray(run.worn["B"]["bearing"])
    around = np.linspace(0, 360, depth.shape[0] + 1)
    along = 1e3 * np.linspace(-0.5, 0.5, depth.shape[1] + 1) * float(joint.length)
    norm = matplotlib.colors.PowerNorm(0.5, vmin=0.0, vmax=depth.max())
    mesh = right.pcolormesh(around, along, depth.T, cmap="inferno", norm=norm)
    figure.colorbar(mesh, ax=right, label="worn depth [µm]")
    right.set(xlabel="direction [°]", ylabel="along the bearing [mm]", title="what it wears")
    return figure


def arm() -> jc.Mechanism:
    """Two links that hang from a shoulder, with 1 mm of clearance in the elbow."""
    elbow = jc.clearance.PlanarJournalBearing(
        jc.contact.LankaraniNikravesh(restitution=0.9),
        jc.friction.Ambrosio(mu_kinetic=0.1),
        bearing_radius=20e-3,
        clearance=1e-3,
    )
    return jc.Mechanism(
        bodies={
            "upper arm": jc.Body(2.0, 0.01, (0.15, 0.0)),
            "forearm": jc.Body(1.0, 0.005, (0.12, 0.0)),
        },
        connections={
            "shoulder": jc.Connection(jc.joint.Revolute(), "ground", "upper arm"),
            "elbow": jc.Connection(elbow, jc.Marker("upper arm", (0.3, 0.0)), "forearm"),
        },
        loads={
            "gravity": jc.load.Gravity((0.0, -9.81)),
            "shoulder friction": jc.load.JointSpring("shoulder", damping=0.3),
        },
        start={"shoulder": -1.2, "elbow": 0.4},
    )


def live_view() -> np.ndarray:
    """Pixels of the live view while the forearm is pulled aside."""
    figure = Figure(figsize=(5.6, 3.2), dpi=160, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    view = jc.view(arm(), figure=figure)
    axis = figure.axes[0]

    def pointer(event: str, x: float, y: float) -> None:
        at = axis.transData.transform((x, y))
        canvas.callbacks.process(event, MouseEvent(event, canvas, *at, 1))

    x, y = axis.lines[1].get_xydata()[1]
    pointer("button_press_event", x, y)
    for share in np.linspace(0.0, 1.0, 18):
        pointer("motion_notify_event", x + share * (430 - x), y + share * (20 - y))
        view.step(1 / 30)
    return np.asarray(canvas.buffer_rgba())


if __name__ == "__main__":
    here = Path(__file__).parent
    picture().savefig(here / "four_bar.png", dpi=85)
    matplotlib.image.imsave(here / "live_view.png", live_view())
