"""How far a part sinks into a worn wall by a loss: the one level at which it overlaps by as much as
the loss and the load ask for, wherever the search begins.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

from jaxclear.components import sphere_map as sphere_contact
from jaxclear.components import wear_map as cylinder_contact
from jaxclear.components.contact_patch import depth_lost, ways
from jaxclear.components.sphere_map import SphereMap
from jaxclear.components.wear_map import CylinderMap

CLEARANCE = 0.1e-3
WALL, SOCKET = CylinderMap((36, 4), 10e-3, 20e-3, CLEARANCE), SphereMap((36, 18), 10e-3, CLEARANCE)
SINGLE = pytest.mark.parametrize(
    "wear_map", [pytest.param(WALL, marks=pytest.mark.slow), SOCKET], ids=["wall", "socket"]
)
CASES = 24


def parts(wear_map):
    """(loss of a volume at a place, its patch on walls worn so deep), as `deposit` takes them."""
    if isinstance(wear_map, SphereMap):
        loss = lambda volume, event: sphere_contact.loss_of(wear_map.wall, volume, event)
        return loss, lambda own, depth: own.patch(wear_map.directions(), depth, wear_map.areas()[0])
    loss = lambda volume, event: cylinder_contact.loss_of(wear_map.wall, volume, event)
    rows = jnp.arange(wear_map.cells[1])

    def patch(own, depth):
        columns = jax.tree.map(lambda each: each[:, None], own.columns(ways(wear_map.cells[0])))
        return own.cell(columns, rows, depth)._replace(area=wear_map.areas()[0])

    return loss, patch


def cases(wear_map):
    """Depths, volumes and places: grooves as of a part that has sunk, and rough walls."""
    rng = np.random.default_rng(3)
    angle = rng.uniform(0, 2 * np.pi, CASES)
    x, y, length = np.cos(angle), np.sin(angle), np.sinc(rng.choice([0.0, 0.1, 0.5], CASES) / np.pi)
    if isinstance(wear_map, SphereMap):
        places = [x, y, 0 * x, x * x, x * y, 0 * x, y * y, 0 * x, 0 * x]
    else:
        fall, end = rng.choice([0.0, 1e-5], CASES), rng.choice([-1.0, 0.0, 1.0], CASES)
        places = [length * x, length * y, fall, 0 * x, end]
    away = np.asarray(wear_map.angles())[:, None] - angle[:, None, None]
    sunk = 10.0 ** rng.uniform(-7, -4.5, (CASES, 1, 1))
    groove = np.maximum((CLEARANCE + sunk) * np.cos(away) - CLEARANCE, 0.0)
    rough = sunk * rng.uniform(0, 1, (CASES, *wear_map.cells))
    depths = np.where(np.arange(CASES)[:, None, None] % 2, groove, rough)
    volumes = 10.0 ** rng.uniform(-16, -11, CASES)
    return jnp.asarray(depths), jnp.asarray(volumes), jnp.stack(places, axis=1)


@SINGLE
def test_a_part_sinks_to_the_one_level_that_its_overlap_asks_for(wear_map):
    """As Brent's method finds it, which brackets it; from 0.1 mm above as from its own start."""
    loss_of, patch_of = parts(wear_map)

    def sought(depth, volume, event):
        own = loss_of(volume, event)
        patch, start = patch_of(own, depth), own.start(depth)
        found = [depth_lost(volume, patch._replace(start=start + up)) for up in (0.0, CLEARANCE)]
        begun = depth, wear_map.reading(depth), (jnp.zeros_like(depth),)
        after = wear_map.deposit_in_turn(*begun, volume[None], event[None])[0]
        return found, after - depth, patch, own.load.overlap

    depths, volumes, places = cases(wear_map)
    found, in_turn, patches, loads = jax.jit(jax.vmap(sought))(depths, volumes, places)
    for i in range(CASES):
        patch = jax.tree.map(lambda each, i=i: np.asarray(each)[i], patches)

        def missing(level, patch=patch, i=i):
            overlap = np.asarray(patch.outline.at(level)[0])
            return float(np.sum(overlap * patch.area) - volumes[i] - loads[i])

        wanted = brentq(missing, 0.9 * CLEARANCE, 5 * CLEARANCE, xtol=1e-18, rtol=1e-15)
        own = found[0][0][i]
        for lost, level in found:
            assert abs(float(level[i]) - wanted) < 1e-9 * (wanted - CLEARANCE) + 1e-17, i
            np.testing.assert_allclose(lost[i], own, rtol=0, atol=1e-8 * own.max())
        # Rounding of the depths is in their difference.
        np.testing.assert_allclose(
            in_turn[i], own, rtol=0, atol=1e-8 * own.max() + 1e-15 * depths[i].max()
        )
        np.testing.assert_allclose(jnp.sum(own * wear_map.areas()), volumes[i], rtol=1e-12)
