"""Worn depth against the number of cells: it converges, and a run that wears costs little more.

Walls worn by given volumes: a pin pressed one way, rigid (the area between two circles, in closed
form) and elastic, a tilted journal, a ball; and what a run tells of cells that are too few. Then a
turn of the planar four-bar, as it is designed. Then the four-bar with three-dimensional clearance:
deepest cell, volume, and CPU time beside the same run without wear. And the 3RSR's socket, after a
settled cycle and after a million. The order is that between three numbers of cells. Then what hangs
on saving times, of five kinds of surface, and last stated errors of depths over true ones: of
walls that contacts wear which stand still or go to and fro, narrower and wider than cells; and of
flanks of a play, which have one cell and no error of cells, that of the steps of runs.
"""

import itertools
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, report, side_by_side, sign
from jaxclear.commands.design import TURN, WEAR_SAVES
from jaxclear.components.sphere_map import SphereMap
from jaxclear.components.wall_map import WallMap
from jaxclear.components.cylinder_map import CylinderMap
from jaxclear.components.surface import AbstractSurface
from jaxclear.components.wear_map import AbstractWearMap
from jaxclear.errors.estimates import factor_of_cells
from jaxclear.integrators.checks import Check
from jaxclear.native import scan
from jaxclear.scenes.four_bar import four_bar
from jaxclear.scenes.parallel_3rsr import QUIET, parallel_3rsr
from jaxclear.simulation.invariants import narrowness

RADIUS, LENGTH, CLEARANCE = 10e-3, 20e-3, 0.1e-3
# Depth of the pin's scar [m], overlap of elastic contacts [m], fall of the tilted journal's [m].
DEPTH, OVERLAP, FALL = 10e-6, 0.5e-6, 30e-6
LOSSES, DIRECTION = 50, 0.31
# Of what the figure of cells tells: shares of the volumes, directions, cells around.
SHARES, DIRECTIONS = (0.01, 0.1, 1.0), (0.31, 0.35)
OF_FIGURES, FINEST = (12, 18, 24, 36, 48, 72, 96, 144), 288
# Of the planar four-bar: cells around.
IN_PLANE = (36, 72, 144, 288, 576)
# Of the four-bar: duration [s], saving times, cells around and along.
SPAN, SAVES, GRIDS = 1.26, 631, ((18, 5), (36, 10), (72, 20), (144, 80), (144, 320))
# Cells along that a tilted journal's scar needs, which is about a millimetre of 30.
AROUND, ROWS = 144, (40, 80, 160, 320)
# Of stated errors: cells around (of a guide along), the finest, and between which ratios a stated
# error is right. Contacts go to and fro twice, in so many updates.
OF_ERRORS, TRUE_CELLS = (24, 36, 48, 72, 96, 144, 288), {"journal": 4608, "guide": 4608}
ALL_CELLS, RIGHT, UPDATES = 1152, (0.5, 5.0), 48
# Steps [s] of runs whose flanks wear, and those of the true depths.
FLANK_STEPS, TRUE_STEP = (4e-4, 3e-4, 2e-4, 1e-4), 5e-6
# Saving times.
COUNTS = (2, 21, 501, 2001)

# Of the 3RSR: cells of azimuth and of elevation after a cycle, the most of them after a million;
# cycles that it settles in, saving times of a cycle, and by how many cycles a million stand for.
BALL_CELLS, MOST_OF_A_LIFE = (12, 24, 48, 96, 192, 384), 192
SETTLED, BALL_SAVES, LIFE, CYCLES = 3, 200, 1e6, 160
PARTS = {
    "given": "worn depth: walls",
    "figure": "worn depth: the figure of cells",
    "plane": "worn depth: the planar four-bar",
    "four-bar": "worn depth: the four-bar",
    "along": "worn depth: the four-bar, finer along",
    "3RSR": "worn depth: the 3RSR",
    "saves": "worn depth: by saving times",
    "errors": "worn depth: stated errors over true ones",
}


def worn(wear_map: AbstractWearMap, volume: float, place: tuple) -> np.ndarray:
    """Depths [m] after the volume [m3] has been lost at one place."""
    events = jnp.full((1,), volume / LOSSES), jnp.asarray(place)[None]
    lose = lambda _, depth: wear_map.deposit(depth, *events)
    depth = jax.jit(lambda: jax.lax.fori_loop(0, LOSSES, lose, jnp.zeros(wear_map.cells)))()
    found = float(jnp.sum(depth * wear_map.areas()))
    assert abs(found / volume - 1) < 1e-12, "volume is lost on the way"
    return np.asarray(depth)


def deepest(wear_map: AbstractWearMap, volume: float, place: tuple) -> float:
    """Depth of the deepest cell [m] after the volume [m3] has been lost at one place."""
    return float(worn(wear_map, volume, place).max())


def with_orders(rows: list[dict[str, Any]], names: list[str]) -> list[dict[str, Any]]:
    """The rows with the orders that the last three of each figure show; none where there are not
    three yet."""
    for name in names:
        known = [row[name] for row in rows if row[name] is not None]
        changes = np.abs(np.diff(known))
        orders = [None, None, *np.log2(changes[:-1] / changes[1:]).tolist()]
        orders += [None] * (len(rows) - len(known))
        for row, order in zip(rows, orders, strict=True):
            row[f"order, {name.split(' [')[0]}"] = order
    return rows


def given(around: int, direction: float = DIRECTION) -> dict[str, tuple]:
    """By shape the arguments of `worn`, on a map of so many cells around."""
    reach = CLEARANCE + DEPTH
    half = math.acos(CLEARANCE / reach)
    volume = 2 * RADIUS * LENGTH * (reach * math.sin(half) - CLEARANCE * half)
    x, y = math.cos(direction), math.sin(direction)
    narrow = math.sqrt(0.5 * CLEARANCE / OVERLAP)
    ball = (x, y, 0.0, x * x, x * y, 0.0, y * y, 0.0, narrow**2)
    line = CylinderMap((around, 1), RADIUS, LENGTH, CLEARANCE)
    wall = CylinderMap((around, around // 3), RADIUS, LENGTH, CLEARANCE)
    sphere = SphereMap((around, around // 2), RADIUS, CLEARANCE)
    return {
        "rigid pin": (line, volume, (x, y, 0.0, 0.0, 0.0)),
        "elastic pin": (line, volume, (x, y, 0.0, narrow, 0.0)),
        "tilted": (wall, 0.1 * volume, (x, y, FALL, narrow, 1.0)),
        "ball": (sphere, 0.1 * volume, ball),
    }


def shapes(cells: tuple[int, ...]) -> list[dict[str, Any]]:
    """Depths of given volumes, finer and finer; `cells` around."""
    rows = [
        {"cells around": around}
        | {f"{shape} [um]": 1e6 * deepest(*own) for shape, own in given(around).items()}
        for around in cells
    ]
    print(f"closed form of the rigid pin: {1e6 * DEPTH:g} um")
    return with_orders(rows, list(rows[0])[1:])


def told(cells: tuple[int, ...], finest: int) -> list[dict[str, Any]]:
    """What the figure of a run's cells tells, beside how far its deepest cell is from that of the
    `finest` map: of all shapes, at two places in a cell, worn a little and much."""
    found = []
    for share, direction in itertools.product(SHARES, DIRECTIONS):
        best = {
            shape: worn(own, share * volume, place).max()
            for shape, (own, volume, place) in given(finest, direction).items()
        }
        for around in cells:
            for shape, (own, volume, place) in given(around, direction).items():
                depth = worn(own, share * volume, place)
                off = abs(float(depth.max() / best[shape] - 1))
                found.append((float(narrowness(own, jnp.asarray(depth))), off))
    figures, errors = np.array(found).T
    bounds = [0.0, 0.05, 0.1, Check.WEAR_BY_CELLS.limit, 0.3, 0.5, 1.0]
    return [
        {
            "figure": f"{low:g} to {high:g}",
            "depths": int(np.sum(own)),
            "least off": float(errors[own].min(initial=1.0)),
            "median": float(np.median(errors[own])),
            "most": float(errors[own].max(initial=0.0)),
        }
        for low, high in itertools.pairwise(bounds)
        if np.any(own := (figures >= low) & (figures < high))
    ]


def planar(cells: tuple[int, ...]) -> list[dict[str, Any]]:
    """The bearing of the planar four-bar after a turn, and what its run tells of its cells."""
    rows, deepest = [], jc.response.PeakWornDepth("B")
    for around in cells:
        run = jc.simulate(
            four_bar("planar", 1e-4, cells=(around, 1)),
            TURN,
            save=WEAR_SAVES,
            integrator=jc.integrator.FixedStep(1e-5),
            verify=True,
        )
        stated = run.estimate(deepest)
        rows.append(
            {
                "cells around": around,
                "deepest cell [um]": 1e6 * float(run.worn_depth("B", "bearing").max()),
                "deepest place [um]": 1e6 * float(stated.value),
                "stated error [um]": 1e6 * float(stated.error),
                "figure": float(run.invariants.figures[Check.WEAR_BY_CELLS].worst[0]),
            }
        )
    return with_orders(rows, ["deepest cell [um]"])


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


def along(rows: tuple[int, ...]) -> list[dict[str, Any]]:
    """The four-bar's joint on finer and finer rows, and how much of its scar's length they see:
    that of the deepest column, where it is deeper than a fiftieth of its deepest cell."""
    found = []
    for count in rows:
        rig = four_bar("spatial", cells=(AROUND, count))
        run = jc.simulate(rig, SPAN, save=SAVES, integrator=jc.integrator.FixedStep(2e-5))
        depth = np.asarray(run.worn_depth("B", "bearing"))
        column, row = np.unravel_index(depth.argmax(), depth.shape)
        scar = depth[column, count // 2 :] if row >= count // 2 else depth[column, : count // 2]
        length = 1e3 * rig.connections["B"].joint.length / count
        found.append(
            {
                "cells": f"{AROUND} x {count}",
                "deepest cell [um]": 1e6 * float(depth.max()),
                "its scar is long [mm]": float(length * np.sum(scar > 0.02 * depth.max())),
                "volume in the last rows [1]": float(depth[:, [0, -1]].sum() / depth.sum()),
            }
        )
        print(found[-1], flush=True)
    return with_orders(found, ["deepest cell [um]"])


def with_saves() -> dict[str, tuple[Any, float, Any, str, str]]:
    """By kind of surface: mechanism, duration [s], integrator, joint and surface."""
    turn, steps = 2 * math.pi / 10, jc.integrator.ImplicitStep(1e-4)
    return {
        "journal, tilted": (four_bar("spatial"), 2 * turn, steps, "B", "bearing"),
        "journal, planar": (four_bar("planar"), 2 * turn, steps, "B", "bearing"),
        "journal of a slider-crank": (
            jc.scenes.slider_crank(wear=True),
            0.1,
            jc.integrator.FixedStep(1e-5),
            "B",
            "bearing",
        ),
        "ball": (parallel_3rsr(), 0.2, jc.integrator.NonColliding(2e-4), "S1", "socket"),
        "guide": (jc.scenes.guide("wearing"), 0.5, jc.integrator.NonColliding(1e-4), "P", "guide"),
    }


def by_saves(counts: tuple[int, ...]) -> list[dict[str, Any]]:
    """Surfaces in runs of so many saving times, beside one that saves, and so wears, at each step:
    deepest cell beside the volume, what cells have lost elsewhere, and CPU time beside 501 saves.
    Motions differ a little, as steps end at saving times, so depths are those of a volume of 1."""
    rows = []
    for kind, (rig, duration, integrator, joint, surface) in with_saves().items():
        steps = round(duration / float(integrator.step))
        run = lambda save, how=(rig, duration, integrator): jc.simulate(
            how[0], how[1], save=save, integrator=how[2], verify=False
        )

        def shape(save, run=run, of=(joint, surface)):
            depth = np.asarray(run(save).worn[of[0]][of[1]])
            return depth / depth.sum()

        fine = shape(steps + 1)
        spent = side_by_side({save: lambda save=save, run=run: run(save).worn for save in counts})
        for save in counts:
            depth = shape(save)
            rows.append(
                {
                    "surface": kind,
                    "saving times": save,
                    "deepest cell, off [%]": 100 * float(depth.max() / fine.max() - 1),
                    "moved elsewhere [%]": 50 * float(np.abs(depth - fine).sum()),
                    "CPU, over 501 saving times": spent[save][1] / spent[501][1],
                }
            )
            print(rows[-1], flush=True)
    return rows


def surface(kind: str, around: int, coarseness: float) -> AbstractSurface:
    """A surface of so many cells around, of which so many side by side are one."""
    return {
        "journal": lambda: CylinderMap(
            (around, 1), RADIUS, LENGTH, CLEARANCE, coarseness=coarseness
        ),
        "journal, tilted": lambda: CylinderMap(
            (around, around // 3), RADIUS, LENGTH, CLEARANCE, coarseness=coarseness
        ),
        "ball": lambda: SphereMap((around, around // 2), RADIUS, CLEARANCE, coarseness=coarseness),
        "guide": lambda: WallMap(
            (2, around), 0.12, 0.0, 0.04, 0.01, CLEARANCE, 0.01, coarseness=coarseness
        ),
    }[kind]()


def losses(kind: str, own: AbstractSurface, case: dict[str, float]) -> tuple[jax.Array, jax.Array]:
    """Volumes and location features of a contact with an `indentation` [m] that begins at a `place`
    [rad or m] and goes `swing` to either side of it; `fall` of the overlap [m]."""
    turns = 4 * np.pi * np.arange(UPDATES + 1) / UPDATES
    path = case["place"] + case["swing"] * np.sin(turns)
    middle, half = 0.5 * (path[1:] + path[:-1]), 0.5 * np.abs(np.diff(path))
    ones, fall = np.ones(UPDATES), case["fall"] * np.ones(UPDATES)
    if kind == "guide":
        place = middle, middle**2 + half**2 / 3, fall, case["indentation"] * ones, ones, ones
    else:
        narrow = float(own.narrowness(jnp.asarray(case["indentation"]))) * ones
        shares = np.linspace(-1.0, 1.0, 41)[:, None] * half
        level = 0.2 if kind == "ball" else 0.0
        x, y = (np.cos(level) * f(middle + shares) for f in (np.cos, np.sin))
        z = np.sin(level) * np.ones_like(x)
        pairs = (x, x), (x, y), (x, z), (y, y), (y, z)
        of_ball = *(each.mean(0) for each in (x, y, z)), *((a * b).mean(0) for a, b in pairs)
        of_journal = x.mean(0), y.mean(0), fall
        place = (*of_ball, narrow) if kind == "ball" else (*of_journal, narrow, ones * (fall > 0))
    volumes = jnp.full((UPDATES, 1), case["volume"] / UPDATES)
    return volumes, jnp.asarray(np.stack(place, axis=1))[:, None]


@eqx.filter_jit
def worn_in_turn(own: AbstractSurface, events: tuple) -> jax.Array:
    """Depths [m] after losses one after the other."""
    nothing = jnp.zeros(own.cells), None, (jnp.zeros(own.cells),)
    turn = lambda now, event: (own.deposit_in_turn(now[0], None, now[2], *event), ())
    return scan(turn, nothing, events, long=True)[0][0]


def cases() -> list[tuple[str, dict[str, float]]]:
    """Kinds of surface with what wears them: shallow scars and deep ones, of narrow contacts and of
    wide ones, that stand still or go to and fro."""
    pin = lambda depth: 2 * RADIUS * LENGTH * CLEARANCE * math.sqrt(2 * depth / CLEARANCE) * depth
    found = []
    for kind, depths, indentations, fall, share in (
        ("journal", (0.2e-6, 2e-6, 20e-6), (0.05e-6, 2e-6), 0.0, 0.67),
        ("journal, tilted", (0.5e-6, 10e-6), (0.2e-6, 2e-6), FALL, 0.1),
        ("ball", (0.5e-6, 10e-6), (0.2e-6, 2e-6), 0.0, 0.05),
    ):
        for depth, indentation, swing in itertools.product(depths, indentations, (0.0, 0.4)):
            volume = share * pin(depth) * (1 + 3 * swing)
            how = {"indentation": indentation, "swing": swing, "fall": fall, "volume": volume}
            found += [(kind, how | {"place": place}) for place in DIRECTIONS]
    for volume, fall, swing in itertools.product((1e-13, 1e-11), (0.0, 5e-6, 100e-6), (0.0, 0.02)):
        how = {"indentation": 1e-6, "swing": swing, "fall": fall, "volume": volume}
        found.append(("guide", how | {"place": 0.0031}))
    return found


def stated_over_true(cells: tuple[int, ...]) -> list[dict[str, Any]]:
    """By kind of surface how many stated errors of depths are right, too small and too large."""
    ratios: dict[tuple[str, str], list[float]] = {}
    for kind, case in cases():

        def depths(around, coarseness, kind=kind, case=case):
            own = surface(kind, around, coarseness)
            events = losses(kind, own, case)
            depth = worn_in_turn(own, events)
            features, narrow = jnp.mean(events[1], axis=(0, 1)), narrowness(own, depth)
            deepest = {"place": float(own.deepest(depth)), "cell": float(depth.max())}
            return deepest, factor_of_cells(own, features, depth, narrow)

        true = depths(TRUE_CELLS.get(kind, ALL_CELLS), 1.0)[0]["place"]
        for around in cells:
            (fine, factor), (coarse, _) = depths(around, 1.0), depths(around, 2.0)
            for how, depth in fine.items():
                stated = factor * abs(depth - coarse[how])
                ratios.setdefault((kind, how), []).append(stated / max(abs(true - depth), 1e-30))
    ratios["flank", "place"] = on_flanks()
    return _rows_of_ratios(ratios)


def _rows_of_ratios(ratios: dict[tuple[str, str], list[float]]) -> list[dict[str, Any]]:
    """Of stated over true errors, by kind of surface and how depths are read."""
    rows = []
    for (kind, how), of_kind in ratios.items():
        own = np.array(of_kind)
        low, high = float(np.mean(own < RIGHT[0])), float(np.mean(own > RIGHT[1]))
        rows.append(
            {
                "surface": kind,
                "deepest": how,
                "depths": len(own),
                "right [%]": 100 * (1 - low - high),
                "too small [%]": 100 * low,
                "too large [%]": 100 * high,
                "median": float(np.median(own)),
            }
        )
        print(rows[-1], flush=True)
    return rows


def on_flanks() -> list[float]:
    """Stated over true errors of the depths of both flanks of a reducer that swings a wheel to and
    fro."""
    law = jc.wear.Archard(wear_coefficient=1e-4, hardness=2e9)
    sizes = {"slide": 0.2, "area": 1e-4, "pitch_radius": 0.05}
    play = jc.clearance.Backlash(1e-3, wear=law, **sizes)
    motor = jc.coupling.Motor(2e-5)
    gear = jc.coupling.Gear(motor, "A", ratio=100, stiffness=2e3, damping=2.0, play=play)
    servo = jc.load.Servo("A", lambda t: 0.5 * jnp.sin(2 * jnp.pi * t), kp=400.0, kd=25.0)
    rig = jc.Mechanism(
        {"wheel": jc.Body(2.0, 0.5)},
        {"A": jc.Connection(jc.joint.Revolute(), "ground", "wheel")},
        {"servo": servo},
        couplings={"gear": gear},
    )
    depths = {name: jc.response.PeakWornDepth("gear", name) for name in ("upper", "lower")}

    def runs(step, verify):
        integrator = jc.integrator.ImplicitStep(step)
        return jc.simulate(rig, 2.0, save=21, integrator=integrator, verify=verify)

    fine = runs(TRUE_STEP, False)
    ratios = []
    for run in (runs(step, True) for step in FLANK_STEPS):
        for depth in depths.values():
            stated = run.estimate(depth)
            true = abs(float(stated.value) - float(depth(fine)))
            ratios.append(float(stated.error) / max(true, 1e-30))
    return ratios


def parallel(cells: tuple[int, ...]) -> list[dict[str, Any]]:
    """The quiet 3RSR's socket: what a cycle takes off once it has settled, and what a million do,
    each of those that are run standing for as many as it must."""
    rows = []
    for around in cells:
        rig = parallel_3rsr(period=QUIET, cells=(around, around))
        begun = _cycles(rig, SETTLED)[0]
        cycle, _ = _cycles(rig, 1, begun)
        before, after = (run.worn_depth("S1", "socket") for run in (begun, cycle))
        row = {"cells": f"{around} x {around}", "a cycle [nm]": 1e9 * float((after - before).max())}
        row |= {"a million [mm]": None, "volume [mm^3]": None}
        if around <= MOST_OF_A_LIFE:
            row |= _million(rig, begun)
        print(row, flush=True)
        rows.append(row)
    return with_orders(rows, ["a cycle [nm]", "a million [mm]"])


def _million(rig: jc.Mechanism, begun: jc.Trajectory) -> dict[str, float]:
    """Depth and volume after a million cycles."""
    many = eqx.tree_at(
        lambda own: own.connections["S1"].joint.socket_wear.acceleration,
        rig,
        jnp.asarray(LIFE / CYCLES),
    )
    run, volume = _cycles(many, CYCLES, begun)
    depth = float(run.worn_depth("S1", "socket").max())
    return {"a million [mm]": 1e3 * depth, "volume [mm^3]": 1e9 * volume}


def _cycles(
    rig: jc.Mechanism, count: int, begun: jc.Trajectory | None = None
) -> tuple[jc.Trajectory, float]:
    """(the last of so many cycles after those of a run, volume lost in all [m3])."""
    how, volume = jc.integrator.ImplicitStep(5e-5, rebound=1.0), 0.0
    for _ in range(count):
        state = None if begun is None else begun.state()
        begun = jc.simulate(rig, QUIET, save=BALL_SAVES + 1, integrator=how, state=state)
        volume += float(begun.worn_volume("S1", "socket")[-1])
    return begun, volume


def main() -> None:
    options = arguments(__doc__, only={"choices": list(PARTS), "help": "this part alone"})
    asked = [options.only] if options.only else [part for part in PARTS if part != "along"]
    for part in asked:
        measured = {
            "given": given_rows,
            "figure": figure_rows,
            "plane": plane_rows,
            "four-bar": four_bar_rows,
            "along": along_rows,
            "3RSR": parallel_rows,
            "saves": save_rows,
            "errors": error_rows,
        }[part]
        measured(options)
    sign("benchmarks.claims.worn_depth", options.json, [PARTS[part] for part in asked])


def along_rows(options: Any) -> None:
    """Of the four-bar, along its bearing."""
    rows = ROWS[:3] if options.quick else ROWS
    report("worn depth: the four-bar, finer along", along(rows), options)


def parallel_rows(options: Any) -> None:
    """Of the 3RSR."""
    cells = BALL_CELLS[:4] if options.quick else BALL_CELLS
    report(PARTS["3RSR"], parallel(cells), options)


def save_rows(options: Any) -> None:
    """Of saving times."""
    report(PARTS["saves"], by_saves(COUNTS), options)


def error_rows(options: Any) -> None:
    """Of stated errors."""
    cells = OF_ERRORS[:3] if options.quick else OF_ERRORS
    report(PARTS["errors"], stated_over_true(cells), options)


def given_rows(options: Any) -> None:
    """Of given volumes."""
    cells = (24, 48, 96, 192) if options.quick else (24, 48, 96, 192, 384)
    report("worn depth: walls worn by given volumes", shapes(cells), options)


def figure_rows(options: Any) -> None:
    """Of what a run's cells tell of themselves."""
    cells, finest = (OF_FIGURES[:4], 72) if options.quick else (OF_FIGURES, FINEST)
    report(PARTS["figure"], told(cells, finest), options)


def plane_rows(options: Any) -> None:
    """Of the planar four-bar."""
    report(PARTS["plane"], planar(IN_PLANE[:3] if options.quick else IN_PLANE), options)


def four_bar_rows(options: Any) -> None:
    """Of the four-bar."""
    grids = GRIDS[1:4] if options.quick else GRIDS
    for integrator in (jc.integrator.FixedStep(2e-5), jc.integrator.ImplicitStep()):
        name = type(integrator).__name__
        report(f"worn depth: the four-bar, {name}", runs(grids, integrator), options)
    along_rows(options)


if __name__ == "__main__":
    main()
