"""The picture of the README: `python notebooks/_figures/readme.py` writes it beside this file."""

from pathlib import Path

import matplotlib
import numpy as np
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


if __name__ == "__main__":
    picture().savefig(Path(__file__).with_name("four_bar.png"), dpi=85)
