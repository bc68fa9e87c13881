"""Worn depth against the number of cells: it converges.

Walls worn by given volumes: a pin pressed one way, rigid (the area between two circles, in closed
form) and elastic, a tilted journal, a ball. Then a turn of the planar four-bar, as it is designed.
The order is that between three numbers of cells. Then what hangs on saving times, of five kinds of
surface, and last stated errors of depths over true ones: of walls that contacts wear which stand
still or go to and fro, narrower and wider than cells; and of flanks of a play, which have one cell
and no error of cells, that of the steps of runs.
"""

import itertools
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import run_tables, side_by_side
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
from jaxclear.scenes.parallel_3rsr import parallel_3rsr
from jaxclear.simulation.invariants import narrowness

RADIUS, LENGTH, CLEARANCE = 10e-3, 20e-3, 0.1e-3
# Depth of the pin's scar [m], overlap of elastic contacts [m], fall of the tilted journal's [m].
DEPTH, OVERLAP, FALL = 10e-6, 0.5e-6, 30e-6
LOSSES, DIRECTION = 50, 0.31
DIRECTIONS = (0.31, 0.35)
# Cells around: of walls worn by given volumes, and of the planar four-bar.
OF_SHAPES, IN_PLANE = (24, 48, 96, 192, 384), (72, 144, 288)
# Of stated errors: cells around (of a guide along), the finest, and between which ratios a stated
# error is right. Contacts go to and fro twice, in so many updates.
OF_ERRORS, TRUE_CELLS = (24, 48, 96, 144), {"journal": 4608, "guide": 4608}
ALL_CELLS, RIGHT, UPDATES = 1152, (0.5, 5.0), 48
# Steps [s] of runs whose flanks wear, and those of the true depths.
FLANK_STEPS, TRUE_STEP = (4e-4, 3e-4, 2e-4, 1e-4), 5e-6
# Saving times.
COUNTS = (2, 21, 501, 2001)


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


def _some(options: Any, sizes: tuple[int, ...], few: int) -> tuple[int, ...]:
    return sizes[:few] if options.quick else sizes


TABLES = {
    "worn depth: walls worn by given volumes": lambda o: shapes(_some(o, OF_SHAPES, 4)),
    "worn depth: the planar four-bar": lambda o: planar(_some(o, IN_PLANE, 2)),
    "worn depth: by saving times": lambda _: by_saves(COUNTS),
    "worn depth: stated errors over true ones": lambda o: stated_over_true(_some(o, OF_ERRORS, 3)),
}

if __name__ == "__main__":
    run_tables(TABLES)
