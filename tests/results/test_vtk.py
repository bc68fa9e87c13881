"""A run as files for viewers is read back as it was."""

from xml.etree import ElementTree

import meshio
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.components.cylinder_map import CylinderMap
from jaxclear.results.solids import parts, wall


@pytest.fixture(scope="module")
def run():
    rig = jc.scenes.slider_crank(wear=True, crank_speed=50.0)
    return jc.simulate(rig, 4e-3, save=41, integrator=jc.integrator.FixedStep(2e-5))


def test_a_series_holds_bodies_where_they_were(run, tmp_path):
    corners = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, 0.01, 0.0]])
    path = run.to_vtk(tmp_path / "series", frames=5, meshes={"rod": (corners, [[0, 1, 2]])})
    told = ElementTree.parse(path).getroot().findall("./Collection/DataSet")
    assert [float(one.get("timestep")) for one in told] == pytest.approx(run.time[::10])
    number = 1 + list(run.mechanism.bodies).index("rod")
    for one, at in zip(told, range(0, 41, 10), strict=True):
        mesh = meshio.read(path.parent / one.get("file"))
        triangles, body = mesh.cells_dict["triangle"], mesh.cell_data_dict["body"]["triangle"]
        own = triangles[body == number][-1]
        for index, corner in zip(own, corners, strict=True):
            wanted = np.asarray(run.marker("rod", tuple(corner)).position)[at]
            np.testing.assert_allclose(mesh.points[index], wanted, atol=1e-12)
        last = mesh.point_data["velocity"][own]
        spin = np.asarray(run.body("rod").spin)[at]
        arms = mesh.points[own[1]] - mesh.points[own[0]]
        np.testing.assert_allclose(last[1] - last[0], np.cross(spin, arms), atol=1e-9)


def test_a_series_holds_worn_walls(run, tmp_path):
    path = run.to_vtk(tmp_path, frames=2)
    mesh = meshio.read(path.parent / "run_00001.vtu")
    depth = np.asarray(run.worn_depth("B", "bearing"))
    np.testing.assert_array_equal(mesh.cell_data_dict["worn depth"]["quad"], depth.ravel())
    assert depth.max() > 0
    centre = np.asarray(run.marker("rod", (0.12, 0.0)).position)[-1]
    wall_points = mesh.points[np.unique(mesh.cells_dict["quad"])]
    reach = np.linalg.norm((wall_points - wall_points.mean(axis=0))[:, :2], axis=1)
    np.testing.assert_allclose(reach, 10e-3, atol=2e-6)
    np.testing.assert_allclose(wall_points.mean(axis=0), centre, atol=1e-6)


def test_a_worn_wall_has_lost_its_volume():
    """A bore of 10 mm, 20 mm long, worn by 0.1 mm all over: as a tube, up to its chords."""
    depth = np.full((72, 10), 1e-4)
    own = wall(CylinderMap((72, 10), 10e-3, 20e-3, 1e-4), "bearing", depth)
    np.testing.assert_allclose(np.linalg.norm(own.points[:, :2], axis=1), 10.1e-3)
    assert own.points[:, 2].min() == -10e-3 and own.points[:, 2].max() == 10e-3
    first = own.points[own.corners]
    sides = np.linalg.norm(first[:, 1] - first[:, 0], axis=1)
    np.testing.assert_allclose(sides, 2 * 10.1e-3 * np.sin(np.pi / 72))


def test_a_file_is_no_folder(run, tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(ValueError, match="is a file; give a folder"):
        run.to_vtk(tmp_path / "taken")


@pytest.mark.slow
def test_a_body_that_only_joins_others_is_seen_by_its_joints():
    """One of 1e-12 of the others' mass, as between two hinges of one part."""
    arm = jc.Body(1.0, (0.1, 0.2, 0.2))
    between = jc.Body(1e-12, (1e-12, 1e-12, 1e-12))
    rig = jc.Mechanism(
        {"between": between, "arm": arm},
        {
            "yaw": jc.Connection(jc.joint.Revolute(), "ground", "between"),
            "pitch": jc.Connection(jc.joint.Revolute(), "between", "arm", axis="y"),
        },
    )
    run = jc.simulate(rig, 0.01, save=2, integrator=jc.integrator.FixedStep(1e-2))
    solids = parts(run, {}, 1.0)
    assert 0 < np.ptp(solids["between"].triangles.points, axis=0).max() < 0.2
    assert not len(solids["between"].solid.points)
    assert len(solids["arm"].solid.points)
