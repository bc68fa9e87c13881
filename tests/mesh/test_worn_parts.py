"""Meshes of worn parts: whole, well shaped, and losing the volume that the map says."""

import jax
import jax.numpy as jnp
import meshio
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.mesh.block_mesh import BlockMesh, join_blocks
from tests.rigs.cells import slow_but

THICKNESS = 4e-3
WEAR = jc.wear.Archard(wear_coefficient=1e-4, hardness=2e9)


LAW = jc.contact.HuntCrossley(stiffness=1e9, restitution=0.9)


def bearing(wearing, **more):
    return jc.clearance.JournalBearing(
        LAW, bearing_radius=10e-3, clearance=0.2e-3, length=30e-3, bearing_wear=wearing, **more
    )


def mechanism():
    """A bearing and its journal that wear, and a socket that does."""
    wearing = jc.Wearing(WEAR, cells=(24, 8))
    journal = bearing(wearing, journal_wear=wearing)
    ball = jc.clearance.BallSocket(LAW, socket_radius=15e-3, clearance=0.5e-3, socket_wear=wearing)
    body = jc.Body(1.0, inertia=(1e-3, 1e-3, 1e-3))
    return jc.Mechanism(
        {"pin": body, "ball": body},
        {"B": jc.Connection(journal, "ground", "pin"), "S": jc.Connection(ball, "ground", "ball")},
    )


SURFACES = [("B", "bearing"), ("B", "journal"), ("S", "socket")]
ids = [surface for _, surface in SURFACES]


@pytest.fixture(scope="module")
def solids():
    rig = mechanism()
    return {
        surface: jc.mesh.solid(rig, joint, surface, thickness=THICKNESS)
        for joint, surface in SURFACES
    }


def exact_volume(surface):
    inner, outer = 10e-3, 10e-3 + THICKNESS
    return {
        "bearing": np.pi * (outer**2 - inner**2) * 30e-3,
        "journal": np.pi * 9.8e-3**2 * 30e-3,
        "socket": 4 / 3 * np.pi * ((15e-3 + THICKNESS) ** 3 - 15e-3**3),
    }[surface]


@pytest.mark.parametrize("surface", ids)
def test_a_new_part_has_the_volume_of_its_shape(solids, surface):
    """Chords instead of arcs: with 24 around 1.1 % less in a plane section, more on a sphere."""
    new = solids[surface].new
    assert float(new.volume()) == pytest.approx(exact_volume(surface), rel=0.035)
    assert float(new.scaled_jacobians().min()) > 0.3


def first_layer(solid):
    """Height of the cells at the wall, the least edge into the material [m]."""
    cells, points = solid.new.hexahedra(), np.asarray(solid.new.points)
    edges = points[cells[:, [1, 3, 4]]] - points[cells[:, :1]]
    return np.linalg.norm(edges, axis=-1).min()


def patterns():
    """A cell, a ridge, an edge, every other row and random depths, the deepest 1."""
    shapes = np.zeros((5, 24, 8))
    shapes[0, 5, 3] = shapes[1, 5] = shapes[2, :, 0] = shapes[3, ::2] = 1.0
    shapes[4] = np.random.default_rng(1).uniform(size=(24, 8))
    return shapes


@pytest.mark.parametrize("surface", slow_but(["socket"], ids))
def test_no_cell_is_inverted_at_twice_the_first_layer(solids, surface):
    solid = solids[surface]
    least = jax.jit(jax.vmap(lambda depth: solid.worn(depth).scaled_jacobians().min()))
    depths = 2 * first_layer(solid) * patterns()
    assert np.all(least(depths) > 0.2)
    for before, after in zip(solid.new.groups, solid.worn(depths[0]).groups, strict=True):
        np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize("surface", ids)
def test_an_affine_displacement_is_met_exactly(solids, surface):
    solid = solids[surface]
    draw = np.random.default_rng(0)
    stretch, shift = 1e-3 * draw.normal(size=(3, 3)), 1e-3 * draw.normal(size=3)
    wanted = solid.new.points @ stretch.T + shift
    found = solid.follow(wanted[solid.follow.wall])
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-17)


@pytest.mark.slow
def test_the_mesh_loses_what_the_map_has_lost():
    """To second order in the cells: volume of a smooth pit, by the mesh and by its formula."""
    errors = []
    for around in (24, 48):
        journal = bearing(jc.Wearing(WEAR, cells=(around, around // 3)))
        body = jc.Body(1.0, inertia=(1e-3, 1e-3, 1e-3))
        rig = jc.Mechanism({"pin": body}, {"B": jc.Connection(journal, "ground", "pin")})
        solid = jc.mesh.solid(rig, "B", thickness=THICKNESS)
        wear_map = journal.maps()["bearing"][0]
        along = np.cos(np.pi * np.asarray(wear_map.heights()) / 30e-3) ** 2
        depth = 1e-5 * (1 + np.cos(np.asarray(wear_map.angles())))[:, None] * along
        lost = float(solid.new.volume() - solid.worn(jnp.asarray(depth)).volume())
        errors.append(abs(lost / (1e-5 * 2 * np.pi * 10e-3 * 15e-3) - 1))
    assert errors[0] < 0.03
    assert errors[1] < errors[0] / 3


def test_points_follow_the_depth_linearly(solids):
    solid = solids["bearing"]
    depth = 1e-5 * jnp.asarray(np.random.default_rng(2).uniform(size=(24, 8)))
    points = lambda depth: solid.worn(depth).points
    tangent = jax.jit(lambda depth: jax.jvp(points, (depth,), (depth,))[1])(depth)
    np.testing.assert_allclose(tangent, solid.displacement(depth), atol=1e-18)
    assert float(jnp.abs(tangent).max()) > 5e-6


def test_the_shape_of_a_sheared_box_is_the_sine_of_its_angle():
    grid = np.stack(np.meshgrid(*[np.arange(3.0)] * 3, indexing="ij"), -1)
    angle = 0.7
    sheared = grid @ np.array([[1, 0, 0], [np.cos(angle), np.sin(angle), 0], [0, 0, 1]])
    mesh = join_blocks([sheared[None]])
    np.testing.assert_allclose(mesh.scaled_jacobians(), np.sin(angle), rtol=1e-12)
    assert float(mesh.volume()) == pytest.approx(8 * np.sin(angle))
    turned = BlockMesh(mesh.points * jnp.array([1, 1, -1]), mesh.groups)
    assert float(turned.scaled_jacobians().max()) < 0


@pytest.mark.parametrize("ending", ["vtu", "vtk", "xdmf", "inp", "msh"])
def test_a_written_mesh_is_read_back(solids, tmp_path, ending):
    """What moved and how well shaped it is by those formats that keep it when meshio reads them."""
    solid = solids["bearing"]
    worn = solid.worn(jnp.full((24, 8), 1e-4))
    read = meshio.read(jc.mesh.write(tmp_path / f"bush.{ending}", worn, solid.new))
    np.testing.assert_allclose(read.points, worn.points, atol=1e-15)
    np.testing.assert_array_equal(read.cells_dict["hexahedron"], worn.hexahedra())
    if ending in ("vtu", "vtk", "xdmf"):
        moved = np.linalg.norm(read.point_data["displacement"], axis=1)
        assert moved.max() == pytest.approx(1e-4)
        assert read.cell_data["scaled_jacobian"][0].min() > 0.9


def test_a_part_worn_through_is_not_written(solids, tmp_path):
    worn = solids["bearing"].worn(jnp.full((24, 8), 1.5 * THICKNESS))
    with pytest.raises(ValueError, match="cells are inverted .* worn through"):
        jc.mesh.write(tmp_path / "bush.vtu", worn)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("joint", "surface", "options", "sentence"),
    [
        ("A", "bearing", {}, 'joint \'A\' has no bearing that wears.*"B" bearing, "B" journal'),
        ("S", "bearing", {}, "joint 'S' has no bearing that wears"),
        ("B", "bearing", {"thickness": 0.0}, 'thickness of the bearing of "B" is 0'),
        ("B", "journal", {"thickness": 6e-3}, "half its radius, 0.0049 m, is the most"),
        ("B", "bearing", {"cells": (24, 8)}, "three numbers: around, along, through"),
        ("B", "bearing", {"cells": (26, 8, 4)}, "must be a multiple of 4"),
        ("B", "bearing", {"cells": (24, 8.0, 4)}, "must be a whole number"),
        ("B", "bearing", {"cells": (20, 8, 4)}, "would miss worn places.*at least 24 and 8"),
    ],
)
def test_mistakes_get_a_sentence(joint, surface, options, sentence):
    with pytest.raises(ValueError, match=sentence):
        jc.mesh.solid(mechanism(), joint, surface, **{"thickness": THICKNESS, **options})
