"""What cycles lose, put on the surfaces of a life: losses of the same cells as one."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxclear.components.cylinder_map import CylinderMap
from jaxclear.components.sphere_map import SphereMap
from jaxclear.components.wall_map import WallMap
from jaxclear.components.wear_map import AreaMap
from jaxclear.studies.life import losses
from jaxclear.studies.life.cycle import cycle_request
from tests.rigs.worn_scar import LENGTH, RADIUS, scar

BEARING = CylinderMap((36, 1), RADIUS, LENGTH, 1e-4)
# In the arc between two columns: nothing is next to the edge of a bin.
WALL = CylinderMap((36, 12), RADIUS, LENGTH, 1e-4)
CELL = 2 * math.pi / 36


def lean(column, half_width=2.0, fall=0.0, end=0.0):
    """Features of a journal that leans towards a place around [cells]."""
    angle = (column + 0.5) * CELL
    return (math.cos(angle), math.sin(angle), fall, 1 / (half_width * CELL), end)


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Few losses may become one."""
    monkeypatch.setattr(losses, "FEWEST", 1)


def merged(wear_map, *cycles, resolution=0.5):
    """Volumes and features of what some cycles of losses of 1 mm3 at these features leave."""
    some = []
    for features in cycles:
        places = jnp.asarray(features)[:, None]
        marks = None if wear_map is None else jax.vmap(wear_map.footprint)(places[:, 0])
        volumes = np.full((len(features), 1), 1e-9)
        marks = None if marks is None else marks[:, None]
        some.append((1.0, {("B", "wall"): (volumes, np.asarray(places))}, {("B", "wall"): marks}))
    return losses.merge(some, resolution)["B", "wall"][0]


def test_losses_of_the_same_cells_are_one_of_their_volume_whatever_their_cycle():
    """Volumes, and features weighted with them, stay; the order is that of the first of each."""
    one, other = [lean(c) for c in (20.1, 3.1, 20.15)], [lean(c) for c in (3.15, 9.1)]
    volumes, places = merged(BEARING, one, other)
    np.testing.assert_allclose(volumes, [2e-9, 2e-9, 1e-9])
    np.testing.assert_allclose(volumes @ places, 1e-9 * np.sum(one + other, axis=0), rtol=1e-12)
    columns = np.arctan2(places[:, 1], places[:, 0]) / CELL % 36 - 0.5
    np.testing.assert_allclose(columns, [20.125, 3.125, 9.1], atol=1e-3)
    finer = merged(BEARING, one, other, resolution=0.02)
    assert len(finer[0]) == 5 and finer[0].sum() == pytest.approx(5e-9)


GUIDE = WallMap((2, 40), 0.1, 0.0, 0.02, 0.01, 1e-4, 0.01)
PUSHED = (0.01, 0.0001, 0.0, 1e-6, 0.0, 1.0)


def ball(x, y, z, narrowness=400.0):
    """Features of a ball that stands still."""
    return (x, y, z, x * x, x * y, x * z, y * y, y * z, narrowness)


@pytest.mark.parametrize(
    ("wear_map", "one", "other"),
    [
        (BEARING, lean(3.1), lean(4.1)),
        (BEARING, lean(3.1, 2.1), lean(3.1, 4.1)),
        (WALL, lean(3.1, end=1.0), lean(3.1, end=-1.0)),
        (WALL, lean(3.1, fall=1e-6, end=1.0), lean(3.1, fall=1e-4, end=1.0)),
        (SphereMap((36, 18), RADIUS, 1e-4), ball(1, 0, 0), ball(0.8, 0, 0.6)),
        (SphereMap((36, 18), RADIUS, 1e-4), ball(1, 0, 0, 4.0), ball(1, 0, 0, 20.0)),
        (GUIDE, PUSHED, (0.02, 0.0004, *PUSHED[2:])),
        (GUIDE, PUSHED, (*PUSHED[:2], 1e-6, *PUSHED[3:])),
        (GUIDE, PUSHED, (*PUSHED[:4], 1.0, 1.0)),
        (GUIDE, PUSHED, (*PUSHED[:4], 0.0, -1.0)),
    ],
    ids=[
        *("place around", "width", "end", "fall", "place on a ball", "width on a ball"),
        *("place on a guide", "tilt", "wall", "corner"),
    ],
)
def test_losses_of_other_cells_stay_apart(wear_map, one, other):
    assert len(merged(wear_map, [one, other, one])[0]) == 2


def test_one_depth_has_one_loss_and_a_map_without_footprints_all_of_its():
    assert len(merged(AreaMap(1e-4), [lean(3.1), lean(9.1)])[0]) == 1
    assert len(merged(None, [lean(3.1), lean(3.1)], [lean(3.1)])[0]) == 3


def test_no_loss_is_more_than_a_share_of_all_unless_it_was(monkeypatch):
    """A contact that stays where it is wears its wall bit by bit, in the order of time."""
    monkeypatch.setattr(losses, "FEWEST", 8)
    still, other = [lean(3.1)] * 30, [lean(9.1)] * 2
    volumes, _ = merged(BEARING, other + still)
    assert len(volumes) == 1 + 8 and volumes.sum() == pytest.approx(32e-9)
    assert volumes[1:].max() <= 4.001e-9
    assert len(merged(BEARING, [lean(3.1)] * 3)[0]) == 3


def test_a_load_that_goes_round_wears_a_ring_from_a_tenth_of_its_losses():
    """A turn in 2 000 losses over 36 cells takes the same depth off all of them: the volume over
    the area."""
    problem = scar(1e-4, 36)
    request = cycle_request(problem, problem.nominal())
    angles = np.arange(2000) * 2 * math.pi / 2000
    features = [lean(angle / CELL) for angle in angles]
    one = merged(BEARING, features, resolution=0.25)
    assert len(one[0]) <= 200
    depth = 20e-6
    volume = depth * 2 * math.pi * RADIUS * LENGTH / one[0].sum()
    some, counts = losses.side_by_side([(volume, {("B", "bearing"): [one]})])
    worn = {"B": {"bearing": np.zeros((1, 36, 1))}}
    result = losses.wear_in_parts(request, worn, some, counts, np.array([8]))["B"]["bearing"]
    np.testing.assert_allclose(result, depth, rtol=5e-3)
    assert float(result.mean()) == pytest.approx(depth, rel=1e-9)
