"""Wear maps: volume is conserved, reading is smooth and periodic, and both agree with splines made
elsewhere."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BSpline

from jaxclear.components.cylinder_map import CylinderMap
from jaxclear.components.sphere_map import SphereMap
from jaxclear.components.wall_map import WallMap
from jaxclear.ground.numerics import direction_angle
from jaxclear.native import scan
from tests.rigs.cells import slow

CLEARANCE = 0.1e-3
CYLINDER = CylinderMap((12, 5), 10e-3, 20e-3, CLEARANCE)
SPHERE = SphereMap((12, 6), 10e-3, CLEARANCE)
# Cells eight times as wide as high, and the other way round.
WIDE, HIGH = (SphereMap(cells, 10e-3, CLEARANCE) for cells in ((6, 24), (48, 3)))
WALLS = WallMap((2, 12), 0.12, 0.01, 0.04, 0.01, CLEARANCE, 0.01)
HUMP = BSpline.basis_element([-1.5, -0.5, 0.5, 1.5], extrapolate=False)


def cylinder_events():
    """(x, y), how the overlap falls, one over the width, the end; mean directions are no unit
    vectors."""
    angles = [0.0, 1e-9, np.pi / 2, np.pi, -np.pi, -1e-9, 2.0, 2 * np.pi / 12]
    events = [
        (spread * np.cos(a), spread * np.sin(a), fall, narrowness, end)
        for a in angles
        for spread in (1.0, 0.999, 0.5)
        for fall in (0.0, 1e-12, 5e-5, 2e-4, -1e-5)
        for narrowness in (0.0, 22.0)
        for end in (-1.0, 0.0, 1.0)
    ]
    # every seventh: of each kind some
    return np.array([*events[::7], (0.0, 0.0, 0.0, 0.0, 1.0)])


def sphere_events():
    rng = np.random.default_rng(0)
    corners = [
        (0, 0, 1),
        (0, 0, -1),
        (1, 0, 0),
        (0, -1, 0),
        (-1, 0, 0),
        (-1, -1e-12, 0),
        (1e-9, 0, 1),
        (0, 0, 0),
        (1e-60, 0, -1),
    ]
    return np.array([*corners, *rng.normal(size=(40, 3))], float)


def sphere_places(events):
    """Location features of contacts that stand still."""
    found = []
    for x, y, z in events:
        size = np.sqrt(x * x + y * y + z * z)
        x, y, z = (np.array([x, y, z]) / size) if size > 1e-30 else (0.0, 0.0, 0.0)
        found.append((x, y, z, x * x, x * y, x * z, y * y, y * z, 500.0))
    return np.array(found)


def wall_events():
    """(place, its square, how the overlap falls, overlap, wall, end) of ways of several lengths;
    the last leaves the walls by half of the face."""
    events = [
        (place, place**2 + half**2 / 3, fall, overlap, wall, end)
        for place in (-0.0383, 0.0, 0.0137, 0.0391)
        for half in (0.0, 1e-9, 1.1e-3, 0.0187)
        for fall in (0.0, 1e-12, 1e-6, -1e-6, 5e-5, 2e-4, -2e-4)
        for overlap in (0.0, 1e-7, 1e-5)
        for wall in (0.0, 1.0)
        for end in (-1.0, 1.0)
    ]
    return np.array([*events[::29], (0.06, 0.06**2, 0.0, 1e-6, 0.0, -1.0)])


MAPS = {
    "cylinder": (CYLINDER, cylinder_events()),
    "sphere": (SPHERE, sphere_places(sphere_events())),
    "wide": (WIDE, sphere_places(sphere_events())),
    "high": (HIGH, sphere_places(sphere_events())),
    "walls": (WALLS, wall_events()),
}
SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=SLOW if n in ("sphere", "wide", "high") else ()) for n in MAPS]
)
def test_volume_is_conserved(name):
    wear_map, events = MAPS[name]
    areas, new = np.asarray(wear_map.areas()), np.zeros(wear_map.cells)
    alone = jax.jit(jax.vmap(lambda event: wear_map.deposit(new, jnp.array([1e-12]), event[None])))
    depths = np.asarray(alone(events))
    assert np.all(depths >= 0)
    # rounding of a sum over a few cells
    np.testing.assert_allclose(np.sum(depths * areas, axis=(1, 2)), 1e-12, rtol=1e-13)
    lost = np.full(len(events), 1e-12)
    together = jax.jit(lambda *given: wear_map.deposit(new, *given))(lost, events)
    np.testing.assert_allclose(np.sum(together * areas), 1e-12 * len(events), rtol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("name", MAPS)
def test_cell_by_cell_a_kernel_takes_off_what_the_whole_map_loses(name):
    """And its reading is that of the depth; so are their slopes, and both of a batch."""
    wear_map, events = MAPS[name]
    events, count = jnp.asarray(events), len(events)
    rng = np.random.default_rng(0)
    # Squares change twice as much.
    rates = jnp.full(events.shape[1], 0.1).at[1].set(0.2 if wear_map is WALLS else 0.1)
    depths = jnp.asarray(rng.uniform(0.0, 1.0, (count, *wear_map.cells)))
    depths = depths * 10.0 ** rng.uniform(-10, -6, (count, 1, 1))
    volumes = jnp.asarray(10.0 ** rng.uniform(-15, -11, (count, 2))).at[::3, 1].set(0.0)

    def whole(depth, volume, event):
        depth = wear_map.deposit(depth, volume, event)
        return depth, wear_map.reading(depth)

    def cell_by_cell(depth, volume, event):
        turn = lambda now, _: (wear_map.deposit_in_turn(*now, volume, event), ())
        begun = depth, wear_map.reading(depth), (jnp.zeros_like(depth), jnp.zeros_like(depth))
        return scan(turn, begun, np.zeros(1), long=True)[0][:2]

    def told(deposit):
        pairs = depths, volumes, jnp.stack([events, jnp.roll(events, 1, axis=0)], axis=1)
        moved = lambda *given: jax.jvp(
            deposit, given, (0.1 * given[0], 0.1 * given[1], rates * given[2])
        )
        return jax.jit(jax.vmap(moved))(*pairs)

    # Of narrow contacts what is lost is a difference of like numbers.
    for one, other in zip(*(jax.tree.leaves(told(f)) for f in (cell_by_cell, whole)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-9 * np.max(abs(other)))


def test_areas_add_up():
    np.testing.assert_allclose(CYLINDER.areas().sum(), 2 * np.pi * 10e-3 * 20e-3, rtol=1e-14)
    np.testing.assert_allclose(SPHERE.areas().sum(), 4 * np.pi * (10e-3) ** 2, rtol=1e-14)


@pytest.mark.parametrize("name", [*slow("cylinder"), *slow("sphere"), "walls"])
def test_deposit_has_finite_derivatives(name):
    """Along all arguments at once: one that is no number makes the sum none."""
    wear_map, events = MAPS[name]

    def slope(volume, event):
        lost = lambda volume, event: wear_map.deposit(
            jnp.zeros(wear_map.cells), volume[None], event[None]
        )
        return jax.jvp(lost, (volume, event), (1.0, jnp.ones_like(event)))[1]

    derivative = jax.jit(jax.vmap(slope, (None, 0)))
    for volume in (0.0, 1e-12):
        assert np.all(np.isfinite(derivative(volume, events)))


@pytest.mark.slow
def test_a_batch_enters_the_wide_deposit_where_a_sample_needs_it():
    """A wide contact reaches all cells, at several times the cost: a branch of its own also in a
    batch, and each sample gets what it gets alone."""
    worn = CylinderMap((48, 3), 10e-3, 20e-3, CLEARANCE)
    narrow, wide = ((0.6, 0.8, 0.0, one_over, 0.0) for one_over in (22.0, 0.9))
    deposit = lambda event: worn.deposit(jnp.zeros(worn.cells), jnp.full(1, 1e-13), event[None])
    batch = jax.vmap(deposit)
    cond = [
        each
        for each in jax.make_jaxpr(batch)(jnp.array([narrow, wide])).eqns
        if each.primitive.name == "cond"
    ]
    assert [each.invars[0].aval.shape for each in cond] == [()]
    for events in ((narrow, narrow), (narrow, wide)):
        found = jax.jit(batch)(jnp.array(events))
        alone = [jax.jit(deposit)(jnp.array(event)) for event in events]
        # The narrow one's loss ends within 0.6 rad, the wide one's does not.
        np.testing.assert_allclose(found, alone, rtol=1e-12, atol=1e-24)
    reached = np.sum(np.any(found > 0, axis=2), axis=1)
    assert reached[0] <= 11 < reached[1]


@pytest.mark.slow
def test_deposit_derivative_is_the_change():
    event, step = jnp.array([[0.6, 0.7, 5e-5, 22.0, -1.0]]), 1e-7

    @jax.jit
    def total(angle):
        moved = event.at[0, :2].set(jnp.stack([jnp.cos(angle), jnp.sin(angle)]))
        return CYLINDER.deposit(jnp.zeros(CYLINDER.cells), jnp.array([1e-12]), moved)

    difference = (total(0.9 + step) - total(0.9 - step)) / (2 * step)
    slope = np.asarray(jax.jacfwd(total)(0.9))
    # rounding over the step
    np.testing.assert_allclose(slope, difference, atol=2e-6 * np.abs(slope).max())


def test_line_contact_wears_towards_the_loaded_end():
    deposit = eqx.filter_jit(CYLINDER.deposit)
    for end, row in ((-1.0, 0), (1.0, -1)):
        depth = deposit(
            jnp.zeros(CYLINDER.cells), jnp.array([1e-12]), jnp.array([[1.0, 0.0, 1e-5, 22.0, end]])
        )
        assert np.argmax(np.asarray(depth).sum(0)) == row % 5


def test_cylinder_reads_the_spline_of_its_map():
    depth = jnp.asarray(np.random.default_rng(1).uniform(0, 1e-6, CYLINDER.cells))
    read = jax.jit(
        lambda angle: [
            CYLINDER.depth_at_end(CYLINDER.reading(depth), jnp.cos(angle), jnp.sin(angle), end)
            for end in (-1, 1)
        ]
    )
    for angle in np.linspace(-3.1, 9.2, 57):
        position = (angle / (2 * np.pi) * 12 - 0.5) % 12
        for found, row, inner in zip(read(angle), (0, -1), (1, -2), strict=True):
            last, inside = np.asarray(depth)[:, row], np.asarray(depth)[:, inner]
            # from the middle of the last cell to the edge
            edge = last + 0.5 * np.maximum(last - inside, 0.0)
            distance = (position - np.arange(12) + 6) % 12 - 6
            expected = np.nan_to_num(HUMP(distance)) @ edge
            # rounding of the angle over a cell
            np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_reading_is_smooth_and_periodic():
    depth = jnp.asarray(np.random.default_rng(2).uniform(0, 1e-6, CYLINDER.cells))
    reading = CYLINDER.reading(depth)

    @jax.jit
    def read(angle):
        return CYLINDER.depth_at_end(reading, jnp.cos(angle), jnp.sin(angle), 1)

    edges = jnp.concatenate([jnp.arange(13), jnp.arange(12) + 0.5]) * (2 * jnp.pi / 12)
    for function in (read, jax.jit(jax.grad(read))):
        below, above = (jax.vmap(function)(edges + shift) for shift in (-1e-9, 1e-9))
        # a slope of 1e-6 m (curvature 1e-5) over 2e-9 rad
        np.testing.assert_allclose(below, above, atol=1e-13)
        np.testing.assert_allclose(function(0.3), function(0.3 + 2 * np.pi), rtol=1e-10)


def test_sphere_reads_what_it_holds():
    even, read = jnp.full(SPHERE.cells, 3e-7), eqx.filter_jit(SPHERE.depth_towards)
    for event in sphere_events():
        np.testing.assert_allclose(read(even, *event), 3e-7, rtol=1e-13)
    depth = jnp.asarray(np.random.default_rng(3).uniform(0, 1e-6, SPHERE.cells))
    azimuth, elevation = 1.234, 0.2
    x, y, z = (
        np.cos(azimuth) * np.cos(elevation),
        np.sin(azimuth) * np.cos(elevation),
        np.sin(elevation),
    )
    around = np.nan_to_num(HUMP((azimuth / (2 * np.pi) * 12 - 0.5 - np.arange(12) + 6) % 12 - 6))
    along = np.nan_to_num(HUMP((elevation / np.pi + 0.5) * 6 - 0.5 - np.arange(6)))
    np.testing.assert_allclose(
        read(depth, x, y, z),
        around @ np.asarray(depth) @ along,
        rtol=1e-12,
    )


@jax.jit
def angle_and_slopes(place):
    angle = lambda place: direction_angle(place[0], place[1])
    return angle(place), jax.grad(angle)(place), jax.hessian(angle)(place)


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-160, 1e-60, 1e-40, 1.0])
def test_direction_angle_is_finite_to_the_second_derivative(size):
    assert all(np.all(np.isfinite(x)) for x in angle_and_slopes(np.array([0.6, -0.8]) * size))


@pytest.mark.slow
@pytest.mark.parametrize(
    "half_arc, within", [(1e-10, 1e-6), (1e-7, 1e-6), (1e-5, 1e-6), (1e-3, 3e-2)]
)
def test_a_ball_that_hardly_moves_wears_as_one_that_stands_still(half_arc, within):
    """What is lost is cut into as many arcs as there are saving times. Cells two fifths of a radian
    wide resolve none of these; of the shortest rounding leaves no direction, and in which one means
    over cells are taken is told."""
    sphere = SphereMap((16, 8), radius=10e-3, clearance=1e-4)
    turns = np.linspace(-half_arc, half_arc, 201)
    elevation = 0.23
    level = np.cos(elevation)
    # Along the meridian, where cells are longer than wide.
    ways = np.stack([np.cos(elevation + turns), 0 * turns, np.sin(elevation + turns)], axis=1)
    narrow = sphere.narrowness(1.6e-6)

    def lost(ways):
        x, y, z = ways.T
        products = np.stack([x * x, x * y, x * z, y * y, y * z], axis=1)
        features = np.concatenate([ways.mean(0), products.mean(0), [narrow]])
        depth = sphere.deposit(np.zeros((16, 8)), np.array([1e-14]), features[None])
        return np.asarray(depth)

    still = np.array([[level, 0.0, np.sin(elevation)]])
    found, wanted = lost(ways), lost(still)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=within * wanted.max())
