"""What a run says of worn depths that hang on the number of cells: beside finer ones."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.components.sphere_map import SphereMap
from jaxclear.components.wall_map import WallMap
from jaxclear.components.wear_map import AreaMap, CylinderMap
from jaxclear.integrators.checks import Check
from jaxclear.simulation.invariants import narrowness

LIMIT = Check.WEAR_BY_CELLS.limit
LINE = CylinderMap((36, 1), 10e-3, 20e-3, 1e-4)
WALL = CylinderMap((36, 12), 10e-3, 20e-3, 1e-4)
SOCKET = SphereMap((36, 18), 10e-3, 1e-4)
GUIDE = WallMap((2, 40), 0.1, 0.0, 0.02, 0.01, 1e-4, 0.01)


def scar(wear_map, half_width):
    """A parabola so many cells wide to either side of a place that lies in no cell's middle."""
    around, along = wear_map.cells
    i, j = np.arange(around)[:, None] - 7.3, np.arange(along)[None] - 8.4
    if around == 2:
        i = 1e9 * (np.arange(2)[:, None] == 0)
    return jnp.asarray(np.maximum(1 - (i**2 + (j**2 if along > 1 else 0)) / half_width**2, 0))


@pytest.mark.parametrize(
    "wear_map", [LINE, WALL, SOCKET, GUIDE], ids=["line", "wall", "ball", "guide"]
)
def test_a_scar_of_a_cell_or_two_is_told_and_a_wide_one_is_not(wear_map):
    told = [float(narrowness(wear_map, scar(wear_map, width))) for width in (1.2, 2.0, 5.0, 30.0)]
    assert np.all(np.diff(told) < 0)
    assert told[1] > LIMIT and told[2] < LIMIT and told[3] < 0.01


def test_walls_of_a_guide_are_apart_and_ends_of_a_bearing_are_not_edges():
    one_side = jnp.asarray([np.ones(40), np.zeros(40)])
    assert float(narrowness(GUIDE, one_side)) == 0.0
    assert float(narrowness(WALL, jnp.ones(WALL.cells))) == pytest.approx(0.0, abs=1e-15)
    last_row = jnp.zeros(WALL.cells).at[:, -1].set(1.0)
    assert float(narrowness(WALL, last_row)) > LIMIT


def test_one_depth_for_a_surface_has_no_cells_to_tell_of():
    assert float(narrowness(AreaMap(1e-4), jnp.full((1, 1), 1e-6))) == 0.0


def test_what_has_hardly_worn_is_judged_beside_what_has():
    narrow = scar(LINE, 1.2)
    assert float(narrowness(LINE, narrow, 1e3)) < 1e-3


def pressed(cells):
    """A ball that creeps in its socket under a steady load."""
    socket = jc.clearance.BallSocket(
        jc.contact.CarvalhoMartins(stiffness=1e10, restitution=0.5),
        jc.friction.CoulombTanh(mu_kinetic=0.1, transition_speed=1e-2),
        socket_radius=10e-3,
        clearance=1e-4,
        socket_wear=jc.Wearing(jc.wear.Archard(wear_coefficient=1e-4), cells),
    )
    rig = jc.Mechanism(
        bodies={"ball": jc.Body(mass=1.0, inertia=(1e-3, 1e-3, 1e-3))},
        connections={"B": jc.Connection(socket, "ground", "ball")},
        loads={"pressed": jc.load.Force(jc.Marker("ball"), (0.0, -2000.0, 0.0))},
        speeds={"ball": (0.0, 0.0, 0.0, 0.0, 0.0, 20.0)},
    )
    return jc.simulate(rig, 5e-3, save=101)


def test_a_run_on_coarse_cells_says_so():
    run = pressed((16, 8))
    assert any("more cells" in sentence for sentence in run.warnings)


@pytest.mark.slow
def test_a_run_that_says_nothing_is_right():
    coarse, fine, finer = (pressed(cells) for cells in ((16, 8), (72, 36), (108, 54)))
    depths = [float(run.worn_depth("B", "socket").max()) for run in (coarse, fine, finer)]
    said = [bool(run.invariants.beyond()[Check.WEAR_BY_CELLS]) for run in (coarse, fine, finer)]
    assert said == [True, False, False]
    assert depths[0] < 0.75 * depths[2] and depths[1] == pytest.approx(depths[2], rel=0.03)
