"""Wear of the inner part: a journal in the plane, a ball in its socket. What moves the load round
on one surface leaves it still on the other, by closed forms.

How far a part sinks into a worn wall by a loss: the one level at which it overlaps by as much as
the loss and the load ask for, wherever the search begins."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxclear as jc
from jaxclear.components.cylinder_map import CylinderMap
from jaxclear.components.sphere_map import SphereMap
from tests.mesh.test_worn_parts import mechanism as worn_parts
from tests.rigs.cells import slow

LOAD, SPEED, RADIUS, CLEARANCE, LENGTH = 200.0, 12.0, 10e-3, 0.05e-3, 20e-3
DURATION, SAVES = 0.5, 51
LAW = jc.wear.Archard()
RATE = float(LAW.wear_coefficient / LAW.hardness)
TURNED = SPEED * DURATION
CONTACT = jc.contact.HuntCrossley(stiffness=1e9, restitution=0.1)
WEARS = jc.Wearing(LAW, cells=(48, 24))
RUNGS = {
    "permanent": jc.integrator.NonColliding(1e-3),
    "compliant": jc.integrator.ImplicitStep(2e-5),
    "rigid": jc.integrator.MoreauJean(1e-3),
}


def journal(**surfaces):
    return jc.clearance.PlanarJournalBearing(
        CONTACT, bearing_radius=RADIUS, clearance=CLEARANCE, length=LENGTH, **surfaces
    )


def ball(**surfaces):
    return jc.clearance.BallSocket(CONTACT, socket_radius=RADIUS, clearance=CLEARANCE, **surfaces)


def turning(joint, upside_down=False):
    """A rotor that turns about z, pressed down along y by a constant load, all along."""
    planar = isinstance(joint, jc.clearance.PlanarJournalBearing)
    ends = jc.Marker("ground"), jc.Marker("rotor")
    return jc.Mechanism(
        {"rotor": jc.Body(1.0, 1e-3 if planar else (1e-3,) * 3)},
        {"B": jc.Connection(joint, *(ends[::-1] if upside_down else ends))},
        {"load": jc.load.Force(jc.Marker("rotor"), (0.0, -LOAD, 0.0))},
        speeds={"rotor": (0.0, 0.0, SPEED) if planar else (0.0, 0.0, 0.0, 0.0, 0.0, SPEED)},
    )


def run(rig, rung):
    state = jc.resting_state(rig) if rung != "permanent" else None
    return jc.simulate(rig, DURATION, save=SAVES, integrator=RUNGS[rung], state=state)


def where(wear_map):
    return (np.arange(wear_map.cells[0]) + 0.5) * 2 * np.pi / wear_map.cells[0]


def ran_under(angles, begin, way):
    """Whether a load that goes round from `begin` by `way` [rad] has passed these places by half a
    radian and more (the contact's width), and whether it stayed away from them by as much."""
    behind = np.mod(np.sign(way) * (angles - begin), 2 * np.pi)
    return (behind > 0.5) & (behind < abs(way) - 0.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joint", "inner", "rung"),
    [
        (joint, name, rung)
        for joint, name in ((journal, "journal"), (ball, "ball"))
        for rung in RUNGS
    ],
)
def test_the_inner_part_wears_round_about_and_the_outer_one_where_it_is_pressed(joint, inner, rung):
    """Both lose k F s / H. The load stands still in the socket; on the ball it goes backwards."""
    outer = {"journal": "bearing", "ball": "socket"}[inner]
    asked = joint(**{f"{inner}_wear": WEARS, f"{outer}_wear": WEARS})
    found = run(turning(asked), rung)
    wanted = RATE * LOAD * (RADIUS - CLEARANCE) * TURNED
    within = 1e-9 if rung == "permanent" else 0.01
    depths = {}
    for surface in (inner, outer):
        wear_map = asked.maps()[surface][0]
        volume = float(found.worn_volume("B", surface)[-1])
        np.testing.assert_allclose(volume, wanted, rtol=within)
        depths[surface] = np.asarray(found.worn_depth("B", surface))
        total = np.sum(depths[surface] * np.asarray(wear_map.areas()))
        np.testing.assert_allclose(total, volume, rtol=1e-9)
    round_about = where(asked.maps()[inner][0])
    passed = ran_under(round_about, -0.5 * np.pi, -TURNED)
    assert passed.sum() > 30
    around = depths[inner].sum(axis=1)
    np.testing.assert_allclose(around[passed], around[passed].mean(), rtol=0.15)
    below = np.cos(round_about + 0.5 * np.pi) > 0
    assert np.all(depths[outer][~below] == 0) and depths[outer].max() > 3 * depths[inner].max()


@pytest.mark.parametrize(("joint", "inner"), [(journal, "journal"), (ball, "ball")])
def test_a_worn_inner_part_leaves_a_wider_gap_where_it_is_worn_and_turns_with_it(joint, inner):
    asked = joint(**{f"{inner}_wear": WEARS})
    wear_map, _ = asked.maps()[inner]
    depth = 1e-6 * (1.0 + np.cos(where(wear_map)))[:, None] * np.ones(wear_map.cells)
    read = {inner: wear_map.reading(jnp.asarray(depth))}
    offset = (jnp.asarray(0.0), jnp.asarray(1.2 * CLEARANCE), 0)
    for turned in (0.0, 0.4, 2.0):
        c, s = np.cos(turned), np.sin(turned)
        axes = ((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0))[: len(asked.axes)]
        (overlap,) = asked.indentations(offset, axes, read)
        # Along y lies what was 90 degrees less its turn from the part's own x.
        lost = 1e-6 * (1 + np.cos(0.5 * np.pi - turned))
        # Splines smooth a cosine by its bend over a cell.
        assert float(overlap) == pytest.approx(0.2 * CLEARANCE - lost, abs=1e-8)


@pytest.mark.slow
def test_a_ball_that_its_socket_is_seen_from_wears_in_its_own_axes():
    """The socket on the rotor and the ball on the ground: the ball wears where it is pressed."""
    asked = ball(ball_wear=WEARS, socket_wear=WEARS)
    found = run(turning(asked, upside_down=True), "permanent")
    on_ball, on_socket = (np.asarray(found.worn_depth("B", s)) for s in ("ball", "socket"))
    still = np.cos(where(asked.maps()["ball"][0]) - 0.5 * np.pi) > 0
    assert np.all(on_ball[~still] == 0) and on_ball.max() > 3 * on_socket.max()
    # The socket slides past a ball that stays below: at its own radius, but for the first step.
    volume = float(found.worn_volume("B", "ball")[-1])
    np.testing.assert_allclose(volume, RATE * LOAD * RADIUS * TURNED, rtol=1e-4)


def test_worn_balls_are_drawn_and_not_meshed():
    from jaxclear import plot

    found = run(turning(ball(ball_wear=WEARS)), "permanent")
    assert (
        plot.wear_surface(found, "B", "ball").axes and plot.wear_unrolled(found, "B", "ball").axes
    )
    with pytest.raises(ValueError, match="has no ball that wears and could be meshed"):
        jc.mesh.solid(worn_parts(), "S", "ball", thickness=1e-3)


PLAY = 0.1e-3
WALL, SOCKET = CylinderMap((36, 4), 10e-3, 20e-3, PLAY), SphereMap((36, 18), 10e-3, PLAY)
SINGLE = pytest.mark.parametrize("wear_map", [*slow(WALL), SOCKET], ids=["wall", "socket"])
CASES = 24


def patch_of(wear_map, contact, depth):
    """The cells of a map, worn so deep, under a contact."""
    around, along = wear_map.cells
    columns = wear_map.in_columns(contact, jnp.arange(around))
    shared = jax.tree.map(lambda each: each[:, None], columns)
    return wear_map.patch(contact, shared, jnp.arange(along), depth)


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
    groove = np.maximum((PLAY + sunk) * np.cos(away) - PLAY, 0.0)
    rough = sunk * rng.uniform(0, 1, (CASES, *wear_map.cells))
    depths = np.where(np.arange(CASES)[:, None, None] % 2, groove, rough)
    volumes = 10.0 ** rng.uniform(-16, -11, CASES)
    return jnp.asarray(depths), jnp.asarray(volumes), jnp.stack(places, axis=1)


@SINGLE
def test_a_part_sinks_to_the_one_level_that_its_overlap_asks_for(wear_map):
    """As Brent's method finds it, which brackets it; from 0.1 mm above as from its own start."""

    def sought(depth, volume, event):
        contact = wear_map.contact(volume, event)
        patch, start = patch_of(wear_map, contact, depth), wear_map.start(contact, depth)
        found = [wear_map.loss(contact, patch, start + up) for up in (0.0, PLAY)]
        begun = depth, wear_map.reading(depth), (jnp.zeros_like(depth),)
        after = wear_map.deposit_in_turn(*begun, volume[None], event[None])[0]
        return found, after - depth, patch, contact.overlap

    depths, volumes, places = cases(wear_map)
    found, in_turn, patches, loads = jax.jit(jax.vmap(sought))(depths, volumes, places)
    removed = volumes * (volumes / (volumes + loads)) ** 2
    areas = np.asarray(wear_map.areas())
    for i in range(CASES):
        patch = jax.tree.map(lambda each, i=i: np.asarray(each)[i], patches)

        def missing(level, patch=patch, i=i):
            overlap = np.asarray(patch.outline.at(level)[0])
            return float(np.sum(overlap * areas) - removed[i] - loads[i])

        wanted = brentq(missing, 0.9 * PLAY, 5 * PLAY, xtol=1e-18, rtol=1e-15)
        own = found[0][0][i]
        for lost, level in found:
            assert abs(float(level[i]) - wanted) < 1e-9 * (wanted - PLAY) + 1e-17, i
            np.testing.assert_allclose(lost[i], own, rtol=0, atol=1e-8 * own.max())
        # Rounding of the depths is in their difference.
        np.testing.assert_allclose(
            in_turn[i], own, rtol=0, atol=1e-8 * own.max() + 1e-15 * depths[i].max()
        )
        np.testing.assert_allclose(jnp.sum(own * wear_map.areas()), volumes[i], rtol=1e-12)
