"""Where parts touch, against brute force: real cylinders, rims and corners, discretised and
compared point by point."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.ground import sparse as sp

RADIUS, CLEARANCE, LENGTH = 10e-3, 1e-4, 20e-3
JOURNAL = RADIUS - CLEARANCE
COLLAR = jc.clearance.Flange(jc.contact.Hertz(), radius=14e-3, clearance=2e-4)
BEARING = jc.clearance.JournalBearing(
    jc.contact.Hertz(), bearing_radius=RADIUS, clearance=CLEARANCE, length=LENGTH, flange=COLLAR
)
AROUND = np.linspace(0, 2 * np.pi, 20001)


def tilted(tilt, direction):
    """Axis (third column) and a perpendicular pair of a journal tilted by an angle towards a
    direction."""
    axis = np.array(
        [np.sin(tilt) * np.cos(direction), np.sin(tilt) * np.sin(direction), np.cos(tilt)]
    )
    first = np.cross([0.3, 0.8, 0.1], axis)
    first /= np.linalg.norm(first)
    return axis, first, np.cross(axis, first)


def vectors(offset, axis):
    return tuple(jnp.asarray(x) for x in offset), (tuple(jnp.asarray(x) for x in axis),)


def deepest_in_plane(offset, axis, first, second, height):
    """How far the tilted journal's surface reaches beyond the wall, in the plane z = height."""
    ring = offset + JOURNAL * (np.cos(AROUND)[:, None] * first + np.sin(AROUND)[:, None] * second)
    cut = ring + ((height - ring[:, 2]) / axis[2])[:, None] * axis
    return np.hypot(cut[:, 0], cut[:, 1]).max() - RADIUS


@pytest.mark.parametrize("seed", range(40))
def test_end_planes_of_a_tilted_journal(seed):
    rng = np.random.default_rng(seed)
    offset = np.append(rng.uniform(-1.2, 1.2, 2) * CLEARANCE, rng.uniform(-1, 1) * 1e-3)
    tilt = rng.uniform(0, 2.5) * CLEARANCE / (LENGTH / 2)
    axis, first, second = tilted(tilt, rng.uniform(0, 2 * np.pi))
    found = BEARING.indentations(*vectors(offset, axis), {})[:2]
    centres = BEARING.end_centres(*vectors(offset, axis))
    for indentation, centre, height in zip(found, centres, (-LENGTH / 2, LENGTH / 2), strict=True):
        brute = deepest_in_plane(offset, axis, first, second, height)
        eccentricity = float(jnp.hypot(centre[0], centre[1]))
        # the ellipse of the section is deepest beside the direction of the eccentricity, by r t_n
        # t_p / |c|
        turned = (JOURNAL * np.tan(tilt) ** 2 / 2) ** 2 / (2 * eccentricity)
        spacing = JOURNAL * (AROUND[1] / 2) ** 2
        assert (
            -spacing - JOURNAL * tilt**4
            <= brute - indentation
            <= 1.2 * turned + JOURNAL * tilt**4 + 1e-15
        )


STEEP = 1.5 * CLEARANCE / (LENGTH / 2)


@pytest.mark.parametrize(
    ("situation", "eccentricity", "tilt", "touching"),
    [
        ("no contact", 0.5, 0.0, (False, False)),
        ("no contact, tilted", 0.0, 0.5 * STEEP, (False, False)),
        ("one point", 0.8, 0.4 * STEEP, (False, True)),
        ("two opposite points", 0.0, STEEP, (True, True)),
        ("line contact", 1.02, 0.0, (True, True)),
        ("line contact, leaning", 1.02, 1e-3 * STEEP, (True, True)),
    ],
)
def test_the_four_situations_of_a_journal(situation, eccentricity, tilt, touching):
    axis = tilted(tilt, 0.0)[0]
    place = vectors((eccentricity * CLEARANCE, 0.0, 0.0), axis)
    indentations = BEARING.indentations(*place, {})
    assert tuple(bool(x > 0) for x in indentations[:2]) == touching
    normals = [
        np.array(sp.dense(touch.normal))
        for touch in BEARING.contact_candidates(*place, indentations)[:2]
    ]
    if situation == "two opposite points":
        np.testing.assert_allclose(normals[0], -normals[1], atol=1e-12)
    if situation.startswith("line"):
        np.testing.assert_allclose(normals[0], normals[1], atol=1e-12)
    if situation == "line contact":
        np.testing.assert_allclose(indentations[0], indentations[1], rtol=1e-12)


@pytest.mark.parametrize("seed", range(10))
def test_collar_touches_with_its_lowest_point(seed):
    rng = np.random.default_rng(seed)
    offset = np.append(rng.uniform(-1, 1, 2) * CLEARANCE, rng.uniform(-2, 2) * 2e-4)
    axis, first, second = tilted(rng.uniform(0.1, 2) * STEEP, rng.uniform(0, 2 * np.pi))
    found = BEARING.indentations(*vectors(offset, axis), {})[2:]
    contact_candidates = BEARING.contact_candidates(
        *vectors(offset, axis), BEARING.indentations(*vectors(offset, axis), {})
    )[2:]
    for end, indentation, touch in zip((-1, 1), found, contact_candidates, strict=True):
        # the rim of a face whose middle stands over it by a thousandth of the clearance
        centre = offset + end * (LENGTH / 2 + 2e-4 + 2e-7) * axis
        rim = centre + 14e-3 * (np.cos(AROUND)[:, None] * first + np.sin(AROUND)[:, None] * second)
        nearest = rim[np.argmin(end * rim[:, 2])]
        # a rim of 20000 points misses the lowest by a quadratic error, and the face is lower than
        # its rim by crown^2 / (2 radius tilt)
        beyond = 2e-7**2 / (2 * 14e-3 * np.hypot(*axis[:2])) + 1e-11
        lowest = LENGTH / 2 - end * nearest[2]
        assert lowest - 1e-11 <= float(indentation) <= lowest + beyond
        np.testing.assert_allclose(np.array(sp.dense(touch.place)), nearest, atol=14e-3 * AROUND[1])


def test_contact_point_of_a_collar_crosses_its_axis_where_the_tilt_passes_through_zero():
    """And in one direction only: the torque of the axial force has no jump, and turns the journal
    upright."""
    tilts = np.linspace(-1, 1, 201) * 1e-4
    places = []
    for tilt in tilts:
        offset, axes = vectors((0.0, 0.0, 0.0), (np.sin(tilt), 0.0, np.cos(tilt)))
        upper = BEARING.contact_candidates(offset, axes, BEARING.indentations(offset, axes, {}))[3]
        places.append(float(sp.dense(upper.place)[0]) - (LENGTH / 2 + 2e-4) * np.sin(tilt))
    steps = np.diff(places)
    assert (steps > 0).all() and steps.max() < 14e-3 * 1e-6 / (2e-7 / 14e-3)
    assert abs(places[100]) < 1e-12 and places[-1] == pytest.approx(14e-3, rel=0.02)


def test_collars_of_a_centred_journal_leave_their_clearance():
    indentations = BEARING.indentations(*vectors((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), {})
    np.testing.assert_allclose(indentations[2:], [-2e-4, -2e-4], rtol=1e-12)


@pytest.mark.parametrize("seed", range(10))
def test_guide_stops_the_corners_of_its_slider(seed):
    rng = np.random.default_rng(seed)
    guide = jc.clearance.SliderGuide(
        jc.contact.Hertz(), width=20e-3, length=40e-3, clearance=CLEARANCE
    )
    angle, offset = rng.normal() * 5e-3, np.append(rng.normal(size=2) * 1e-4, rng.normal())
    across, along = (np.cos(angle), 0.0, -np.sin(angle)), (np.sin(angle), 0.0, np.cos(angle))
    corners = {
        (i, j): offset + i * 10e-3 * np.array(across) + j * 20e-3 * np.array(along)
        for i in (-1, 1)
        for j in (-1, 1)
    }
    axes = tuple(tuple(jnp.asarray(x) for x in axis) for axis in (across, along))
    place = tuple(jnp.asarray(x) for x in offset)
    indentations = guide.indentations(place, axes, {})
    contact_candidates = guide.contact_candidates(place, axes, indentations)
    for (side, _), corner, indentation, touch in zip(
        corners, corners.values(), indentations, contact_candidates, strict=True
    ):
        np.testing.assert_allclose(indentation, side * corner[0] - (10e-3 + CLEARANCE), atol=1e-17)
        np.testing.assert_allclose(np.array(sp.dense(touch.place)), corner, rtol=1e-13, atol=1e-17)
    # the slider as a whole reaches as far as its corners
    edge = np.concatenate(
        [
            np.linspace(a, b, 101)
            for a, b in zip(corners.values(), list(corners.values())[1:], strict=False)
        ]
    )
    assert max(indentations) >= np.abs(edge[:, 0]).max() - (10e-3 + CLEARANCE) - 1e-15
