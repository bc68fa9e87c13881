"""A drawing's lines on the mechanism that they tolerance."""

from typing import Any

import numpy as np

from jaxclear.components.body import GROUND
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import expect
from jaxclear.plot.canvas import panels, readable
from jaxclear.statics.position_path import positions
from jaxclear.studies.tolerance.drawing import Drawing

# Radius of the largest zone, as a share of the mechanism's size; lines of zones in one place.
LARGEST = 0.06
DASHES = ("-", "--", ":", "-.")


@answering
def drawing(drawn: Drawing, *, ax: Any = None) -> Any:
    """A mechanism in its x-y plane where its drives begin, with the zones and fits of its drawing.

    Zones are magnified alike, by the factor in the title; directions and lengths are texts.

    Args:
        drawn: a `Drawing`.
        ax: `matplotlib.axes.Axes` to draw in; by default a new figure.

    Returns:
        The figure, or the axes that were given.

    Raises:
        ValueError: if `drawn` is something else.
    """
    expect(drawn, Drawing, "what is drawn", "a jaxclear.Drawing")
    mechanism = drawn.mechanism
    joints = {name: mechanism.connections[name].joint for name in mechanism.driven}
    there = positions(mechanism, {n: [float(j.drive.motion(0.0)[0])] for n, j in joints.items()})
    points, bodies = {}, dict[str, list]()
    for name, connection in dict.items(mechanism.connections):
        for side in ("parent", "child"):
            marker = getattr(connection, side)
            ground = marker.body == GROUND
            place = (*(marker.at or ()), 0.0, 0.0) if ground else there.marker(marker).position[0]
            points[f"{name}.{side}"] = np.array([float(x) for x in place[:2]])
            bodies.setdefault(marker.body, []).append(points[f"{name}.{side}"])
    every = np.array(list(points.values()))
    extent = float(np.ptp(every, axis=0).max()) or 1.0
    factor, unit = readable([extent], "m")
    sheet = panels("drawing", ax, size=(7.5, 5.0))
    axis = sheet.one
    for name, own in bodies.items():
        x, y = factor * np.array(own).T
        line = {"marker": "^", "ls": ""} if name == GROUND else {"lw": 5, "alpha": 0.3}
        axis.plot(x, y, color="0.4", solid_capstyle="round", **line)
    sizes = {n: line.limits[-1][1] - line.limits[-1][0] for n, line in drawn.lines.items()}
    zones = {n: own for n, own in sizes.items() if drawn.lines[n].variable.parts}
    magnified = 2 * LARGEST * extent / max([float(own) for own in zones.values()], default=1.0)
    turn = np.linspace(0.0, 2 * np.pi, 100)
    for k, name in enumerate(drawn.names):
        feature, specification, variable, _ = drawn.lines[name]
        place = feature.rpartition(" at ")[2]
        place = place if place in points else f"{feature.removeprefix('joint ')}.parent"
        round_ = np.column_stack([np.cos(turn), np.sin(turn)]) * bool(variable.parts)
        radius = 0.5 * magnified * float(sizes[name])
        x, y = (factor * (points.get(place, every.mean(axis=0)) + radius * round_)).T
        how = {"ls": DASHES[k % len(DASHES)], "marker": "" if variable.parts else "x"}
        axis.plot(x, y, color=f"C{k}", lw=1.6, label=f"{name}: {specification}", **how)
    axis.set_aspect("equal")
    axis.margins(0.2)
    axis.set_xlabel(f"x [{unit}]")
    axis.set_ylabel(f"y [{unit}]")
    factor = float(f"{magnified:.2g}")
    sheet.title(f"Drawing, zones magnified {factor:g} times" if zones else "Drawing")
    sheet.legend()
    return sheet.done()
