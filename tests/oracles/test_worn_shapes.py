"""Worn walls against closed forms: the area between two circles, Hertz's contact area, the slope of
a tilted journal, even wear of what turns; and depths that do not go with the cells."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import jaxclear as jc
from jaxclear.components.cylinder_map import CylinderMap
from jaxclear.components.sphere_map import SphereMap
from tests.rigs.cells import slow

RADIUS, LENGTH, CLEARANCE = 10e-3, 20e-3, 0.1e-3
ALONG_X = (1.0, 0.0)


def cylinder(around, along=1):
    return CylinderMap((around, along), RADIUS, LENGTH, CLEARANCE)


def worn_by(wear_map, volume, place, saves=40):
    """Depth after the volume [m3] has been lost at one place, bit by bit."""
    share = jnp.full((saves, 1), volume / saves)
    return np.asarray(_worn(wear_map, share, jnp.tile(jnp.asarray(place), (saves, 1, 1))))


@eqx.filter_jit
def _worn(wear_map, volumes, places):
    """One program for all losses of one shape on one map."""
    one = lambda depth, event: (wear_map.deposit(depth, *event), None)
    return jax.lax.scan(one, jnp.zeros(wear_map.cells), (volumes, places))[0]


def narrow(overlap):
    """One over the half width [1/rad] of a line contact whose outlines overlap so deep [m]; 0: as
    wide as a cell."""
    return math.sqrt(0.5 * CLEARANCE / overlap) if overlap else 0.0


def pressed(angle=0.0, overlap=0.0):
    """Features of a parallel journal that always leans to one side."""
    return (math.cos(angle), math.sin(angle), 0.0, narrow(overlap), 0.0)


def crescent(depth):
    """Volume between the bearing's circle and that of the journal which has sunk so deep [m3]: the
    wall lies at R_B, the journal's surface at (c + depth) cos(angle) - c beyond it."""
    reach = CLEARANCE + depth
    half = math.acos(CLEARANCE / reach)
    return 2 * RADIUS * LENGTH * (reach * math.sin(half) - CLEARANCE * half)


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0.0, 0.31])
@pytest.mark.parametrize("depth", [2e-6, 30e-6, 3e-4])
def test_a_pin_pressed_one_way_wears_the_area_between_two_circles(depth, angle):
    volume = crescent(depth)
    found = worn_by(cylinder(240), volume, pressed(angle))
    # a cell is the mean over its width, here a hundredth of a radian squared
    np.testing.assert_allclose(found.max(), depth, rtol=0.08 if depth < 1e-5 else 0.02)
    wide = 2 * np.pi / 240 * np.count_nonzero(found > 0.01 * depth)
    assert abs(wide - 2 * math.acos(CLEARANCE / (CLEARANCE + depth))) < 4 * np.pi / 240
    np.testing.assert_allclose(found.sum() * cylinder(240).areas()[0, 0], volume, rtol=1e-12)


@pytest.mark.slow
def test_depth_converges_with_the_cells():
    """With an elastic contact, whose width the cells resolve, the order is above 1; a volume that
    went into the cells about the contact would be twice as deep on twice as many."""
    depths = [
        worn_by(cylinder(around), crescent(5e-6), pressed(0.31, 1e-6)).max()
        for around in (48, 96, 192, 384)
    ]
    away = np.abs(np.array(depths[:-1]) / depths[-1] - 1)
    # where the deepest point lies within its cell counts too
    assert away[0] > 0.02 and np.all(away < [0.12, 0.01, 0.005])


@pytest.mark.slow
@pytest.mark.parametrize("overlap", [0.3e-6, 1e-6])
def test_the_first_wear_is_as_wide_as_hertz_contact(overlap):
    """b = sqrt(2 R d) of the effective radius R = R_B^2/c, and a semi-ellipse of pressure."""
    around = 1440
    found = worn_by(cylinder(around), 1e-18, pressed(0.0, overlap), saves=1)[:, 0]
    place = (np.arange(around) + 0.5) * 2 * np.pi / around
    place = RADIUS * np.where(place > np.pi, place - 2 * np.pi, place)
    half_width = math.sqrt(2 * RADIUS**2 / CLEARANCE * overlap)
    hertz = np.sqrt(np.clip(1 - (place / half_width) ** 2, 0, None))
    expected = 1e-18 / LENGTH / (np.pi / 2 * half_width) * hertz
    # the contact's edge lies within a cell; the overlap is a hundredth of the clearance
    np.testing.assert_allclose(found, expected, atol=0.1 * expected.max())
    np.testing.assert_allclose(found[:5], expected[:5], rtol=6e-3)


def still(direction, overlap=0.0):
    """Features of a ball that always leans to one side."""
    x, y, z = np.asarray(direction) / np.linalg.norm(direction)
    return (x, y, z, x * x, x * y, x * z, y * y, y * z, narrow(overlap) ** 2)


@pytest.mark.slow
@pytest.mark.parametrize("towards", [(1.0, 0.2, 0.1), (0.0, 0.0, 1.0), (0.1, 0.0, 1.0)])
def test_a_ball_first_wears_a_circle_as_hertz_has_it(towards):
    """Also at a pole of the map, where the cells are smallest."""
    overlap, wear_map = 2e-6, SphereMap((240, 120), RADIUS, CLEARANCE)
    found = worn_by(wear_map, 1e-18, still(towards, overlap), saves=1)
    towards = np.asarray(towards) / np.linalg.norm(towards)
    angle = np.arccos(np.clip(np.asarray(wear_map.directions()) @ towards, -1, 1))
    half = math.sqrt(2 * overlap / CLEARANCE)
    hertz = np.sqrt(np.clip(1 - (angle / half) ** 2, 0, None))
    expected = 1e-18 / (2 / 3 * np.pi * (RADIUS * half) ** 2) * hertz
    # cells are an eighth of the half-width; the edge lies within one
    np.testing.assert_allclose(found.max(), expected.max(), rtol=0.03)
    np.testing.assert_allclose(found, expected, atol=0.3 * expected.max())
    np.testing.assert_allclose(np.sum(found * wear_map.areas()), 1e-18, rtol=1e-12)


def test_a_tilted_journal_wears_its_own_slope_into_the_edge():
    fall, around, along = 0.03e-3, 240, 80
    wear_map = cylinder(around, along)
    found = worn_by(wear_map, 2e-11, (*ALONG_X, fall, 0.0, 1.0))
    ridge = found.max(axis=0)
    touched = np.flatnonzero(ridge > 0.05 * ridge.max())
    assert touched[-1] == along - 1 and len(touched) > 6
    slopes = np.diff(ridge[touched[2:]]) / (LENGTH / along)
    np.testing.assert_allclose(slopes, fall / LENGTH, rtol=0.05)
    # across, each row is the journal's circle: as wide as its own depth asks
    for row in touched[4:]:
        half = math.acos(CLEARANCE / (CLEARANCE + ridge[row]))
        wide = np.count_nonzero(found[:, row] > 0.02 * ridge[row]) * 2 * np.pi / around
        assert abs(wide - 2 * half) < 6 * np.pi / around


@pytest.mark.slow
def test_both_ends_of_a_parallel_journal_wear_its_whole_length_evenly():
    wear_map = cylinder(72, 12)
    places = [[(*ALONG_X, 0.0, narrow(1e-6), end) for end in (-1.0, 1.0)]] * 10
    found = np.asarray(_worn(wear_map, jnp.full((10, 2), 1e-13), jnp.asarray(places)))
    np.testing.assert_allclose(found, found[:, :1] * np.ones((1, 12)), atol=1e-3 * found.max())
    np.testing.assert_allclose(found.sum() * wear_map.areas()[0, 0], 2e-12, rtol=1e-12)


def moved(saves, swing, turns, fine=20_000):
    """(volumes, features) that so many saves see of a contact which swings to and fro [rad], and
    turns, while its load and its width change; it loses as it slides where it turns."""
    time = (np.arange(fine) + 0.5) / fine
    angle = 0.3 + swing * np.sin(2 * np.pi * time) + 2 * np.pi * turns * time
    load = 1 + 0.5 * np.cos(2 * np.pi * time)
    lost = load * np.abs(np.gradient(angle)) if turns else load
    width = narrow(1e-6) / np.sqrt(load)
    columns = np.stack([np.cos(angle), np.sin(angle), 0 * angle, width, 0 * angle], -1)
    lost, columns = lost.reshape(saves, -1), columns.reshape(saves, -1, 5)
    volumes = lost.sum(axis=1, keepdims=True)
    means = (lost[..., None] * columns).sum(axis=1) / volumes
    return jnp.asarray(1e-13 * volumes / lost.sum()), jnp.asarray(means)[:, None]


@pytest.mark.slow
@pytest.mark.parametrize("swing, turns", [(1.5, 0), (1.0, 1)])
def test_depth_is_the_same_at_any_number_of_saves(swing, turns):
    """What is lost over an arc is its convolution with the contact's width, so arcs add up; those
    widened by the contact were off by 6 and 12 %."""
    wear_map = cylinder(144)
    wanted = np.asarray(_worn(wear_map, *moved(2000, swing, turns)))
    for saves in (50, 100, 500):
        found = np.asarray(_worn(wear_map, *moved(saves, swing, turns)))
        np.testing.assert_allclose(found.max(), wanted.max(), rtol=5e-3)
        assert np.abs(found - wanted).sum() < 5e-3 * wanted.sum()


def ball_moved(saves, way, fine=20_000):
    """(volumes, features) that so many saves see of a ball that goes along an arc, or in an eight,
    while its load and its width change."""
    time = (np.arange(fine) + 0.5) / fine
    swing = 1.2 * np.sin(2 * np.pi * time)
    if way == "arc":
        x, y, z = np.cos(swing), np.sin(swing) * math.cos(0.7), np.sin(swing) * math.sin(0.7)
    else:
        rise = 0.5 * np.sin(4 * np.pi * time + 0.4)
        x, y, z = np.cos(rise) * np.cos(swing), np.cos(rise) * np.sin(swing), np.sin(rise)
    load = 1 + 0.5 * np.cos(2 * np.pi * time)
    columns = [x, y, z, x * x, x * y, x * z, y * y, y * z, narrow(2e-6) ** 2 / load]
    lost, columns = load.reshape(saves, -1), np.stack(columns, -1).reshape(saves, -1, 9)
    volumes = lost.sum(axis=1, keepdims=True)
    means = (lost[..., None] * columns).sum(axis=1) / volumes
    return jnp.asarray(1e-13 * volumes / lost.sum()), jnp.asarray(means)[:, None]


@pytest.mark.slow
@pytest.mark.parametrize("way, within", [("arc", 5e-3), ("eight", 1e-2)])
def test_depth_of_a_ball_is_the_same_at_any_number_of_saves(way, within):
    """An arc is known from mean products of directions, a bend of the way within one is not. Nor do
    cells that resolve no arc, down to arcs of a hundredth of one, hang on it."""
    wear_map = SphereMap((96, 48), RADIUS, CLEARANCE)
    wanted, areas = np.asarray(_worn(wear_map, *ball_moved(2000, way))), wear_map.areas()
    for saves in (50, 100, 500):
        found = np.asarray(_worn(wear_map, *ball_moved(saves, way)))
        np.testing.assert_allclose(found.max(), wanted.max(), rtol=5e-3)
        assert np.sum(np.abs(found - wanted) * areas) < within * np.sum(wanted * areas)
    if way == "eight":
        coarse = SphereMap((36, 18), RADIUS, CLEARANCE)
        deepest = [np.max(_worn(coarse, *ball_moved(saves, way))) for saves in (50, 500, 2000)]
        assert max(deepest) < 1.01 * min(deepest)


@pytest.mark.parametrize("saves", [1, 24, *slow(100)])
@pytest.mark.parametrize("around", [12, *slow(72, 200)])
def test_a_contact_that_turns_wears_evenly_at_any_resolution(around, saves):
    """Mean directions of a contact that has gone through an arc between two saving times are
    shorter than one: by that the arc is known, and filled."""
    wear_map, turns = cylinder(around), 3
    middle = (np.arange(saves * turns) + 0.5) * 2 * np.pi / saves
    length = np.sinc(1 / saves)
    places = [(length * np.cos(a), length * np.sin(a), 0.0, narrow(1e-6), 0.0) for a in middle]
    volume = 1e-11
    shares = jnp.full((len(places), 1), volume / len(places))
    found = np.asarray(_worn(wear_map, shares, jnp.asarray(places)[:, None]))
    expected = volume / (2 * np.pi * RADIUS * LENGTH)
    # the first turn cuts where no neighbour has yet cut
    np.testing.assert_allclose(found, expected, rtol=0.02)
    np.testing.assert_allclose(found.sum() * wear_map.areas()[0, 0], volume, rtol=1e-12)


@pytest.mark.slow
def test_a_ball_in_full_turn_wears_a_groove_that_is_its_own_circle():
    wear_map, saves, turns = SphereMap((96, 121), RADIUS, CLEARANCE), 60, 4
    depth = 20e-6
    profile = lambda e, d: max((CLEARANCE + d) * math.cos(e) - CLEARANCE, 0.0)
    half = lambda d: math.acos(CLEARANCE / (CLEARANCE + d))
    across = lambda d: quad(lambda e: profile(e, d) * math.cos(e), 0, half(d))[0]
    groove = lambda d: 4 * math.pi * RADIUS**2 * across(d)
    volume = groove(depth)
    assert brentq(lambda d: groove(d) - volume, 1e-6, 1e-4) == pytest.approx(depth)
    angles = (np.arange(saves * turns * 40) + 0.5) * 2 * np.pi / saves / 40
    x, y = (f(angles).reshape(-1, 40) for f in (np.cos, np.sin))
    none = np.zeros(len(x))
    means = [p.mean(axis=1) for p in (x, y)] + [none]
    means += [p.mean(axis=1) for p in (x * x, x * y)] + [none, (y * y).mean(axis=1), none, none]
    places = jnp.asarray(np.stack(means, axis=-1))[:, None]
    found = np.asarray(_worn(wear_map, jnp.full((len(x), 1), volume / len(x)), places))
    # the first turn cuts where no neighbour has yet cut
    np.testing.assert_allclose(found.max(axis=1), depth, rtol=0.12)
    elevation = (np.arange(121) + 0.5) / 121 * np.pi - np.pi / 2
    expected = [profile(e, depth) for e in elevation]
    np.testing.assert_allclose(found.mean(axis=0), expected, atol=0.05 * depth)


@pytest.mark.slow
@pytest.mark.parametrize("around", [72, 288])
@pytest.mark.parametrize("volume", [2e-13, 2e-11, 2e-10])
def test_no_loss_however_large_digs_waves(around, volume):
    """A direction that wanders, and losses up to far beyond what the contact overlaps: the wall has
    no more ups and downs than the two places at which the direction turns back leave."""
    swing = 0.4 * np.sin(2 * np.pi * np.arange(300) / 173.0)
    places = jnp.asarray([pressed(a, 1e-8) for a in swing])[:, None]
    found = np.asarray(_worn(cylinder(around), jnp.full((300, 1), volume / 300), places))[:, 0]
    assert np.all(np.isfinite(found))
    ups_and_downs = np.abs(np.diff(np.roll(found, around // 2))).sum() / found.max()
    assert ups_and_downs < 4.0


def turning_ring(cells, clearance=CLEARANCE, acceleration=1.0):
    """A journal pressed down in a ring that turns about it, once in 0.1 s."""
    joint = jc.clearance.PlanarJournalBearing(
        jc.contact.HuntCrossley(stiffness=1e9, restitution=0.1),
        bearing_radius=RADIUS,
        clearance=clearance,
        length=LENGTH,
        bearing_wear=jc.Wearing(jc.wear.Archard(), cells=cells, acceleration=acceleration),
    )
    turn = jc.joint.Revolute(drive=jc.drive.ConstantSpeed(20 * math.pi))
    return jc.Mechanism(
        {"ring": jc.Body(1.0, 1e-3), "journal": jc.Body(0.1, 1e-5)},
        {
            "pivot": jc.Connection(turn, "ground", "ring"),
            "B": jc.Connection(joint, "ring", "journal"),
        },
        {"load": jc.load.Force(jc.Marker("journal"), (0.0, -100.0, 0.0))},
    )


@pytest.mark.slow
def test_a_ring_that_turns_about_a_loaded_journal_wears_evenly_and_by_archard():
    steps = jc.integrator.ImplicitStep(1e-4)
    run = jc.simulate(turning_ring((72, 1)), 0.3, save=151, integrator=steps)
    depth = run.worn_depth("B", "bearing")
    volume = float(run.worn_volume("B", "bearing")[-1])
    law = jc.wear.Archard()
    # k F s / H: three turns of the wall below the journal, which touches from the start on
    expected = float(law.wear_coefficient / law.hardness) * 100.0 * 3 * 2 * math.pi * RADIUS
    np.testing.assert_allclose(volume, expected, rtol=0.05)
    np.testing.assert_allclose(depth, volume / (2 * math.pi * RADIUS * LENGTH), rtol=0.1)


@pytest.mark.parametrize("cells", [(24, 96), *slow(((48, 96),), ((288, 20),))])
def test_a_socket_that_turns_about_a_loaded_ball_wears_hertz_contact_drawn_around(cells):
    """What its law presses by d under a load F, (F/K)^(2/3), is a contact of half the width a =
    R sqrt(d/c), whose pressure goes with sqrt(1 - (x^2 + y^2)/a^2). A turn draws it along x around
    the socket: across, its integral is as 1 - (y/a)^2. Archard's volume k F s/H over a circle of
    2 pi R and over 4/3 a, the area of that parabola beside its height, is the depth in the middle:
    3 V/(8 pi R a). The deepest cells hold the mean of the parabola over a row beside the middle."""
    load, stiffness, speed, rate = 100.0, 1e10, 20 * math.pi, 200.0
    joint = jc.clearance.BallSocket(
        jc.contact.HuntCrossley(stiffness=stiffness, restitution=0.1),
        socket_radius=RADIUS,
        clearance=CLEARANCE,
        socket_wear=jc.Wearing(jc.wear.Archard(), cells, rate),
    )
    turn = jc.joint.Revolute(drive=jc.drive.ConstantSpeed(speed))
    mechanism = jc.Mechanism(
        {"ring": jc.Body(1.0, (1e-3,) * 3), "ball": jc.Body(0.1, (1e-5,) * 3)},
        {
            "pivot": jc.Connection(turn, "ground", "ring"),
            "B": jc.Connection(joint, "ring", "ball"),
        },
        {"load": jc.load.Force(jc.Marker("ball"), (0.0, -load, 0.0))},
        # The ball stays as it is turned.
        speeds={"B": (0.0, 0.0, -speed)},
    )
    run = jc.simulate(mechanism, 0.3, save=151, integrator=jc.integrator.NonColliding())
    law = jc.wear.Archard()
    slid = speed * 0.3 * RADIUS
    volume = rate * float(law.wear_coefficient / law.hardness) * load * slid
    half = RADIUS * math.sqrt((load / stiffness) ** (2 / 3) / CLEARANCE)
    depth = 3 * volume / (8 * math.pi * RADIUS * half)
    row = math.pi * RADIUS / cells[1]
    # Its depth is a twentieth of the overlap d/2, so the wall hardly conforms; and a contact is
    # widened by a cell, a hundredth of its width.
    wanted = depth * (1 - (row / half) ** 2 / 3)
    np.testing.assert_allclose(run.worn_depth("B", "socket").max(axis=1).mean(), wanted, rtol=0.03)


def depth_between_circles(area, inner, outer):
    """How deep a disc of one radius lies beyond the circle of another where it reaches beyond it by
    an area, by the area that two circles share."""

    def beyond(away):
        chord = 0.5 * (away * away + outer * outer - inner * inner) / away
        shared = outer * outer * math.acos(chord / outer) + inner * inner * math.acos(
            (away - chord) / inner
        )
        return math.pi * inner * inner - shared + away * math.sqrt(outer * outer - chord * chord)

    away = brentq(lambda e: beyond(e) - area, 1.000001 * (outer - inner), 0.1 * outer, xtol=1e-16)
    return away + inner - outer


# The shaft loses a quarter of the clearance, or two and a half of it.
@pytest.mark.parametrize(("of_shaft", "within"), [(0.1, 2e-3), (1.0, 4e-3)])
def test_a_shaft_wears_into_its_bush_and_becomes_thinner_all_round(of_shaft, within):
    """Under a constant load either loses k F s / H: the bush to where the shaft's circle lies in
    its own, the shaft evenly; of a small clearance both in proportion to sliding.
    Source: Dickrell & Sawyer 2004, Tribol. Trans. 47, 257 (wear of a shaft and of a bushing)."""
    turns, load, gap = 20, 200.0, 5e-6
    law = jc.wear.Archard()
    inner, way = RADIUS - gap, 2 * math.pi * turns * (RADIUS - gap)
    volume = float(law.wear_coefficient / law.hardness) * load * way
    # 40 um of the bush in 20 turns, a share of it on the shaft.
    lost = [80e-6 * RADIUS * LENGTH * share for share in (1, of_shaft)]
    wears = [jc.Wearing(law, (288, 1), each / volume) for each in lost]
    joint = jc.clearance.PlanarJournalBearing(
        jc.contact.CarvalhoMartins(stiffness=1e13),
        bearing_radius=RADIUS,
        clearance=gap,
        length=LENGTH,
        bearing_wear=wears[0],
        journal_wear=wears[1],
    )
    rig = jc.Mechanism(
        {"shaft": jc.Body(1.0, 1e-3)},
        {"B": jc.Connection(joint, "ground", "shaft")},
        {"load": jc.load.Force(jc.Marker("shaft"), (0.0, -load))},
        speeds={"shaft": (0.0, 0.0, 4 * math.pi * turns)},
    )
    integrator = jc.integrator.NonColliding(2e-4)
    run = jc.simulate(rig, 0.5, save=3, integrator=integrator, verify=False)
    bush, shaft = (run.worn_depth("B", surface) for surface in ("bearing", "journal"))
    for surface, whole in zip(("bearing", "journal"), lost, strict=True):
        volumes = run.worn_volume("B", surface)
        np.testing.assert_allclose(volumes, whole * np.array([0, 0.5, 1]), rtol=1e-9, atol=1e-25)
    thinner = lost[1] / (2 * np.pi * inner * LENGTH)
    # As a scar only widens, its shape is that of the shaft in the end.
    deepest = depth_between_circles(lost[0] / LENGTH, inner - thinner, RADIUS)
    np.testing.assert_allclose(jnp.max(bush), deepest, rtol=within)
    # What is lost at first and at last, by a contact that widens, is not even.
    np.testing.assert_allclose(shaft, thinner, rtol=0.05)
