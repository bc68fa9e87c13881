"""Worn depth against the number of cells: it converges, and a run that wears costs little more.

Walls worn by given volumes: a pin pressed one way, rigid (the area between two circles, in closed
form) and elastic, a tilted journal, a ball. Then the four-bar with three-dimensional clearance:
deepest cell, volume, and CPU time beside the same run without wear, and what hangs on its saving
times. The order is that between three numbers of cells.
"""

import json
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import about, arguments, report, side_by_side
from jaxclear.components.sphere_map import SphereMap
from jaxclear.components.wear_map import AbstractWearMap, CylinderMap
from jaxclear.scenes.four_bar import four_bar

RADIUS, LENGTH, CLEARANCE = 10e-3, 20e-3, 0.1e-3
# Depth of the pin's scar [m], overlap of elastic contacts [m], fall of the tilted journal's [m].
DEPTH, OVERLAP, FALL = 10e-6, 0.5e-6, 30e-6
LOSSES, DIRECTION = 50, 0.31
# Of the four-bar: duration [s], saving times, cells around and along.
SPAN, SAVES, GRIDS = 1.26, 631, ((18, 5), (36, 10), (72, 20), (144, 40), (288, 80))
# Saving times over 0.5 s of it; the last are those that others are held against.
SPAN_OF_SAVES, COUNTS, STEP = 0.5, (126, 251, 501, 1001, 2001, 4001, 8001), 5e-6


def deepest(wear_map: AbstractWearMap, volume: float, place: tuple) -> float:
    """Depth of the deepest cell [m] after the volume [m3] has been lost at one place."""
    events = jnp.full((1,), volume / LOSSES), jnp.asarray(place)[None]
    lose = lambda _, depth: wear_map.deposit(depth, *events)
    depth = jax.jit(lambda: jax.lax.fori_loop(0, LOSSES, lose, jnp.zeros(wear_map.cells)))()
    found = float(jnp.sum(depth * wear_map.areas()))
    assert abs(found / volume - 1) < 1e-12, "volume is lost on the way"
    return float(jnp.max(depth))


def with_orders(rows: list[dict[str, Any]], names: list[str]) -> list[dict[str, Any]]:
    """The rows with the orders that the last three of each figure show; none where there are not
    three yet."""
    for name in names:
        changes = np.abs(np.diff([row[name] for row in rows]))
        orders = [None, None, *np.log2(changes[:-1] / changes[1:]).tolist()]
        for row, order in zip(rows, orders, strict=True):
            row[f"order, {name.split(' [')[0]}"] = order
    return rows


def shapes(cells: tuple[int, ...]) -> list[dict[str, Any]]:
    """Depths of given volumes, finer and finer; `cells` around."""
    reach = CLEARANCE + DEPTH
    half = math.acos(CLEARANCE / reach)
    volume = 2 * RADIUS * LENGTH * (reach * math.sin(half) - CLEARANCE * half)
    x, y = math.cos(DIRECTION), math.sin(DIRECTION)
    narrow = math.sqrt(0.5 * CLEARANCE / OVERLAP)
    ball = (x, y, 0.0, x * x, x * y, 0.0, y * y, 0.0, narrow**2)
    rows = []
    for around in cells:
        line = CylinderMap((around, 1), RADIUS, LENGTH, CLEARANCE)
        wall = CylinderMap((around, around // 3), RADIUS, LENGTH, CLEARANCE)
        sphere = SphereMap((around, around // 2), RADIUS, CLEARANCE)
        rows.append(
            {
                "cells around": around,
                "rigid pin [um]": 1e6 * deepest(line, volume, (x, y, 0.0, 0.0, 0.0)),
                "elastic pin [um]": 1e6 * deepest(line, volume, (x, y, 0.0, narrow, 0.0)),
                "tilted [um]": 1e6 * deepest(wall, 0.1 * volume, (x, y, FALL, narrow, 1.0)),
                "ball [um]": 1e6 * deepest(sphere, 0.1 * volume, ball),
            }
        )
    print(f"closed form of the rigid pin: {1e6 * DEPTH:g} um")
    return with_orders(rows, list(rows[0])[1:])


def runs(grids: tuple[tuple[int, int], ...], integrator: Any) -> list[dict[str, Any]]:
    """The four-bar's joint on maps of these cells."""
    run = lambda rig: jc.simulate(rig, SPAN, save=SAVES, integrator=integrator)
    rigs = {grid: four_bar("spatial", cells=grid) for grid in grids}
    cases = {"none": lambda: run(four_bar("spatial", wear=False)).history.states}
    for grid, rig in rigs.items():
        cases[grid] = lambda rig=rig: run(rig).history.states
    spent = side_by_side(cases)
    rows = []
    for grid, rig in rigs.items():
        found = run(rig)
        rows.append(
            {
                "cells": f"{grid[0]} x {grid[1]}",
                "deepest cell [um]": 1e6 * float(found.worn_depth("B", "bearing").max()),
                "volume [mm^3]": 1e9 * float(found.worn_volume("B", "bearing")[-1]),
                "CPU, over no wear": spent[grid][1] / spent["none"][1],
            }
        )
    return rows


def by_saves(counts: tuple[int, ...]) -> list[dict[str, Any]]:
    """The four-bar's joint at so many saving times, beside the last of them: its deepest cell, and
    what other cells have lost."""
    rig, integrator = four_bar("spatial"), jc.integrator.FixedStep(STEP)
    depths = [
        np.asarray(
            jc.simulate(rig, SPAN_OF_SAVES, save=count, integrator=integrator).worn["B"]["bearing"]
        )
        for count in counts
    ]
    return [
        {
            "saving times": count,
            "deepest cell over that of the last": float(depth.max() / depths[-1].max()),
            "moved elsewhere": float(0.5 * np.abs(depth - depths[-1]).sum() / depths[-1].sum()),
        }
        for count, depth in zip(counts, depths, strict=True)
    ]


def main() -> None:
    options = arguments(__doc__)
    cells = (24, 48, 96, 192) if options.quick else (24, 48, 96, 192, 384)
    report("worn depth: walls worn by given volumes", shapes(cells), options)
    grids = GRIDS[1:4] if options.quick else GRIDS
    for integrator in (jc.integrator.FixedStep(2e-5), jc.integrator.ImplicitStep()):
        name = type(integrator).__name__
        report(f"worn depth: the four-bar, {name}", runs(grids, integrator), options)
    counts = COUNTS[:3] if options.quick else COUNTS
    report("worn depth: the four-bar, by saving times", by_saves(counts), options)
    if options.json is not None:
        told = {"about": about("benchmarks.claims.worn_depth", options.json)}
        known = json.loads(options.json.read_text())
        options.json.write_text(json.dumps(told | known | told, indent=1) + "\n")


if __name__ == "__main__":
    main()
