"""What a run says of worn depths that hang on the number of cells: beside finer ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.components.cylinder_map import CylinderMap
from jaxclear.components.sphere_map import SphereMap
from jaxclear.components.wall_map import WallMap
from jaxclear.components.wear_map import AreaMap
from jaxclear.errors import verification
from jaxclear.errors.estimates import factor_of_cells, factors_of_cells
from jaxclear.integrators.checks import Check
from jaxclear.native import scan
from jaxclear.simulation.invariants import narrowness
from tests.rigs.cells import slow

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
    assert list(factors_of_cells(run)) == ["B, socket"]
    assert any("more cells" in sentence for sentence in run.warnings)


@pytest.mark.slow
def test_a_run_that_says_nothing_is_right():
    coarse, fine, finer = (pressed(cells) for cells in ((16, 8), (72, 36), (108, 54)))
    depths = [float(run.worn_depth("B", "socket").max()) for run in (coarse, fine, finer)]
    said = [bool(run.invariants.beyond()[Check.WEAR_BY_CELLS]) for run in (coarse, fine, finer)]
    assert said == [True, False, False]
    assert depths[0] < 0.85 * depths[2] and depths[1] == pytest.approx(depths[2], rel=0.03)


@pytest.mark.parametrize("shift", [0.0, 0.2, 0.5])
def test_the_deepest_place_is_that_of_the_parabola_whose_means_the_cells_are(shift):
    """A trough of 1 - (x/w)^2 with w = 3.3 cells, whose middle lies off that of a cell."""
    x, width = np.arange(36) - 20.0 - shift, 3.3
    mean = np.maximum(1.0 - (x * x + 1 / 12) / width**2, 0.0)
    assert float(LINE.deepest(jnp.asarray(mean)[:, None])) == pytest.approx(1.0)
    # Scars of flat faces have edges, where a parabola would be 1.17.
    level = jnp.zeros(GUIDE.cells).at[1, 5:20].set(1.0)
    assert float(GUIDE.deepest(level)) == 1.0
    # Wear that grows straight towards an end is deepest at the edge.
    ramp = jnp.broadcast_to(jnp.arange(WALL.cells[1]) + 0.5, WALL.cells)
    assert float(WALL.deepest(ramp)) == pytest.approx(WALL.cells[1])


PLACES = {
    "wall": (0.6, 0.7, 2e-5, 22.0, 1.0),
    "ball": (0.48, 0.64, 0.6, 0.2304, 0.3072, 0.288, 0.4096, 0.384, 400.0),
    "guide": (0.003, 5e-5, 1e-6, 2e-6, 1.0, -1.0),
}


MAPS = {
    "wall": lambda m, **how: CylinderMap((24 * m, 4 * m), 10e-3, 20e-3, 1e-4, **how),
    "ball": lambda m, **how: SphereMap((24 * m, 12 * m), 10e-3, 1e-4, **how),
    "guide": lambda m, **how: WallMap((2, 12 * m), 0.12, 0.0, 0.04, 0.01, 1e-4, 0.01, **how),
}


@pytest.mark.parametrize("kind", [*slow("ball", "wall"), "guide"])
def test_cells_twice_as_wide_are_those_of_a_map_with_half_as_many(kind):
    fine, coarse = MAPS[kind](2, coarseness=2.0), MAPS[kind](1)
    event, volume = jnp.asarray(PLACES[kind])[None], jnp.asarray([1e-12])

    def lose(wear_map):
        depth = wear_map.deposit(jnp.zeros(wear_map.cells), volume, event)
        begun = depth, wear_map.reading(depth), (jnp.zeros_like(depth),)
        turn = lambda now, _: (wear_map.deposit_in_turn(*now, volume, event), ())
        depth, reading, _ = scan(turn, begun, np.zeros(1), long=True)[0]
        read = {
            "wall": lambda: wear_map.depth_at_end(reading, 0.6, 0.7, 1),
            "ball": lambda: wear_map.depth_towards(reading, 0.48, 0.64, 0.6),
            "guide": lambda: wear_map.depth_at(reading, 1, 0.0137),
        }[kind]()
        return depth, read, wear_map.deepest(depth)

    (wide, *told), (half, *wanted) = (
        jax.jit(lambda wear_map=wear_map: lose(wear_map))() for wear_map in (fine, coarse)
    )
    sides = [a // b for a, b in zip(fine.cells, coarse.cells, strict=True)]
    half = np.kron(half, np.ones(sides))
    # A sphere's band between two latitudes is not split in halves of equal area.
    within = 0.02 if kind == "ball" else 1e-9
    np.testing.assert_allclose(wide, half, rtol=0, atol=within * half.max())
    np.testing.assert_allclose(told, wanted, rtol=within)


NARROW, LOST = 0.05, 1e-18


def narrow_events(kind, coarseness):
    """(map, location features) of a contact of half a width of 0.05 rad, or 1 mm long, on cells of
    0.17 rad, or 3 mm; true depth [m] where it loses a volume that changes no shape."""
    x, y = np.cos(0.31), np.sin(0.31)
    indentation = jnp.asarray(1e-4 * NARROW**2)
    if kind == "guide":
        surface = WallMap((2, 40), 0.12, 0.0, 0.04, 0.01, 1e-4, 0.01, coarseness=coarseness)
        return surface, (0.0031, 0.0031**2, 4e-5, 1e-6, 1.0, 1.0), LOST / (0.01 * 0.5e-3)
    radius, length, size = 10e-3, 20e-3, (36, 1) if kind == "line" else (36, 18)
    if kind == "line":
        surface = CylinderMap(size, radius, length, 1e-4, coarseness=coarseness)
        place = x, y, 0.0, float(surface.narrowness(indentation)), 0.0
        return surface, place, LOST / (radius * length * NARROW * np.pi / 2)
    surface = SphereMap(size, radius, 1e-4, coarseness=coarseness)
    narrowness = float(surface.narrowness(indentation))
    place = x, y, 0.0, x * x, x * y, 0.0, y * y, 0.0, narrowness
    return surface, place, LOST / (2 / 3 * np.pi * (radius * NARROW) ** 2)


def lose(surface, volume, event):
    """Depths of a surface that loses a volume, and the deepest place."""
    depth = surface.deposit(jnp.zeros(surface.cells), volume, event)
    return depth, surface.deepest(depth)


@pytest.mark.parametrize("kind", ["line", *slow("ball", "guide")])
def test_the_error_of_a_scar_narrower_than_a_cell_is_that_of_its_contact(kind):
    """Hertz's pressure over the contact's own width."""
    depths, worn = [], jax.jit(lose)
    for coarseness in (2.0, 1.0):
        surface, place, true = narrow_events(kind, coarseness)
        depth, deepest = worn(surface, jnp.full(1, LOST), jnp.asarray(place)[None])
        depths.append(float(deepest))
    coarse, fine = depths
    factor = factor_of_cells(surface, jnp.asarray(place), depth, 1.0)
    stated = factor * abs(fine - coarse)
    assert fine < 0.5 * true
    # Of flat faces the contact's end lies anywhere in a cell.
    least = 1 / 3 if kind == "guide" else 1.0
    assert least * (true - fine) < stated < 3.0 * (true - fine)


def rubbing(cells):
    """The pin of a slider-crank that hammers."""
    law = jc.wear.Archard(wear_coefficient=2e-2, hardness=1e9)
    joint = jc.clearance.PlanarJournalBearing(
        jc.contact.CarvalhoMartins(stiffness=3e8, restitution=0.6),
        jc.friction.CoulombTanh(mu_kinetic=0.1, transition_speed=1e-2),
        bearing_radius=9e-3,
        clearance=1.5e-4,
        length=0.02,
        bearing_wear=jc.Wearing(law, (cells, 1)),
    )
    rig = jc.scenes.slider_crank(joint, crank_speed=60.0)
    return jc.simulate(rig, 4 * np.pi / 60, verify=True)


@pytest.mark.slow(sample=False)
def test_the_stated_error_of_a_depth_holds_its_cells():
    """Steps alone would say 4e-4."""
    deepest = jc.response.PeakWornDepth("B")
    true = float(deepest(rubbing(576)))
    for cells, off in ((36, 0.03), (48, 0.01), (72, 0.005)):
        told = rubbing(cells).estimate(deepest)
        assert abs(float(told.value) / true - 1) < off
        assert float(told.error) > 0.5 * abs(float(told.value) - true)
        assert "wider cells" in told.why


def test_the_first_line_of_a_long_run_that_wears_says_that_it_is_not_verified(monkeypatch):
    monkeypatch.setattr(verification, "MOST_STEPS", 10)
    assert "Not verified" in pressed((16, 8)).result
