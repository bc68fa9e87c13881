"""What a run says of wear that its parts or its saving times leave wrong: a pin that only swings in
a bush, both of which wear, beside the area between two circles, a ball beside the volume between
two spheres, the corners of a tilted slider beside wedges; and paths between saving times."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxclear as jc
from jaxclear.integrators.checks import Check
from tests.components.test_guides_that_wear import RUNGS, guide, to_and_fro
from tests.rigs.cells import slow
from tests.rigs.wearing_ring import wearing_ring
from tests.rigs.worn_scar import LAW, LOAD, RADIUS, SPEED, TURN, crescent, depth_of, lost, scar

CLEARANCE, CELLS, LOSS = 1e-4, 72, crescent(30e-6, 1e-4)


def worn_over(turns, journal=True):
    """The run in which each worn part loses the same volume over so many turns of the pin."""
    rig = scar(CLEARANCE, CELLS, journal).mechanism
    factor = jnp.asarray(LOSS / (turns * lost(CLEARANCE)))
    surfaces = ("bearing_wear", "journal_wear") if journal else ("bearing_wear",)
    where = lambda rig: [getattr(rig.connections["B"].joint, s).acceleration for s in surfaces]
    rig = eqx.tree_at(where, rig, [factor] * len(surfaces))
    step = jc.integrator.NonColliding(turns * TURN / 96)
    return jc.simulate(rig, turns * TURN, save=25, integrator=step, verify=False)


def test_a_pin_that_only_swings_says_how_much_too_deep_its_scars_are():
    """Both lose half of one crescent, as they conform: as a check tells, its depth is a fifth less
    than that of a crescent of one volume each."""
    run = worn_over(0.03)
    volumes = [float(run.worn_volume("B", s)[-1]) for s in ("bearing", "journal")]
    found = max(float(np.max(run.worn["B"][s])) for s in ("bearing", "journal"))
    true = 0.5 * depth_of(sum(volumes), CLEARANCE)
    figure = float(np.max(run.invariants.figures[Check.BOTH_WORN].worst))
    assert Check.BOTH_WORN.limit < (found - true) / found <= 1.1 * figure
    assert figure < 0.25
    assert any("parts of joint" in sentence for sentence in run.warnings)


def cap(depth):
    """Volume [m3] of the overlap of two spheres of nearly one radius, so deep [m]."""
    return math.pi * RADIUS**2 * depth**2 / (CLEARANCE + depth)


RATE = float(LAW.wear_coefficient / LAW.hardness)


def swinging_ball(depth):
    """A ball that swings in its socket, both of which lose as much as a cap so deep [m]; the run,
    the volume that both lose there, and the depth [m] of a scar of some volume [m3]."""
    wears = jc.Wearing(LAW, (72, 36), cap(depth) / (RATE * LOAD * 0.03 * 2 * math.pi * RADIUS))
    joint = jc.clearance.BallSocket(
        jc.contact.Rigid(),
        socket_radius=RADIUS,
        clearance=CLEARANCE,
        socket_wear=wears,
        ball_wear=wears,
    )
    rig = jc.Mechanism(
        {"rotor": jc.Body(1.0, (1e-3,) * 3)},
        {"J": jc.Connection(joint, "ground", "rotor")},
        {"load": jc.load.Force(jc.Marker("rotor"), (0.0, -LOAD, 0.0))},
        speeds={"rotor": (0.0, 0.0, 0.0, 0.0, 0.0, SPEED)},
    )
    step = jc.integrator.NonColliding(0.03 * TURN / 96)
    run = jc.simulate(rig, 0.03 * TURN, save=25, integrator=step, verify=False)
    return run, lambda volume: brentq(lambda d: cap(d) - volume, 1e-9, 1e-3)


FACE, BREADTH, MOMENT, SWING, LAPS = 40e-3, 10e-3, 6.0, 1e-4, 4


def tilted_slider(depth, wall=True):
    """As `swinging_ball`: a slider that a moment presses with two corners against its guide, to and
    fro by a part of a cell; both lose as much as a wedge so deep [m] at each corner."""
    slope = 2 * CLEARANCE / FACE
    wedge = BREADTH * depth**2 / (2 * slope)
    wears = jc.Wearing(LAW, (4, 400), wedge / (RATE * MOMENT / FACE * 4 * SWING * LAPS))
    joint = jc.clearance.SliderGuide(
        jc.contact.Rigid(),
        length=FACE,
        clearance=CLEARANCE,
        breadth=BREADTH,
        guide_length=0.05,
        guide_wear=wears if wall else None,
        slider_wear=wears,
    )
    rig = jc.Mechanism(
        {"slider": jc.Body(1.0, 1e-3)},
        {"J": jc.Connection(joint, "ground", "slider", axis="x")},
        {
            "moment": jc.load.Torque(jc.Marker("slider"), MOMENT),
            "spring": jc.load.JointSpring("J", 100.0),
        },
        start={"J": SWING},
    )
    duration = 0.2 * math.pi * LAPS
    step = jc.integrator.NonColliding(duration / (96 * LAPS))
    run = jc.simulate(rig, duration, save=24 * LAPS + 1, integrator=step, verify=False)
    # At two corners.
    return run, lambda volume: math.sqrt(slope * volume / BREADTH)


@pytest.mark.parametrize("kind", [*slow(swinging_ball), tilted_slider])
def test_balls_and_sliders_that_only_swing_say_how_much_too_deep_their_scars_are(kind):
    """As the pin; the area of a cap, and of a wedge, goes with its depth, so the share is more."""
    run, depth_of_scar = kind(20e-6)
    surfaces = run.worn["J"]
    volume = sum(float(run.worn_volume("J", s)[-1]) for s in surfaces)
    found = max(float(np.max(depth)) for depth in surfaces.values())
    true = 0.5 * depth_of_scar(volume)
    figure = float(np.max(run.invariants.figures[Check.BOTH_WORN].worst))
    assert 0.2 < (found - true) / found <= 1.05 * figure < 1.05 * (1 - 0.5**0.5)
    assert any('parts of joint "J"' in sentence for sentence in run.warnings)


def test_a_slider_that_wears_alone_says_nothing():
    run, _ = tilted_slider(20e-6, wall=False)
    assert Check.BOTH_WORN not in run.invariants.figures


def test_a_flat_slider_that_travels_says_nothing():
    """A face that lies flat wears evenly, whatever its wall does."""
    run = jc.simulate(
        to_and_fro(guide(acceleration=1e4)),
        0.2,
        save=81,
        integrator=RUNGS["permanent"],
        verify=False,
    )
    assert np.max(run.invariants.figures[Check.BOTH_WORN].worst) < 0.01


@pytest.mark.parametrize("journal", [True, False])
def test_a_pin_that_turns_round_or_does_not_wear_says_nothing(journal):
    run = worn_over(3.0, journal)
    assert (Check.BOTH_WORN in run.invariants.figures) == journal
    assert not any("parts of joint" in sentence for sentence in run.warnings)


@pytest.mark.parametrize(
    ("saves", "steps", "around", "cells"),
    [(19, 37, 36, 2.0), *slow((73, 9, 36, 0.5)), (301, 1, 576, 1.92)],
)
def test_counted_steps_say_how_far_contacts_move_between_updates(saves, steps, around, cells):
    """A turn over so many cells; by one step, whose contact stands at one place, as by many."""
    rig, turn = wearing_ring(cells=around), 0.05
    step = jc.integrator.ImplicitStep(steps_per_save=steps)
    run = jc.simulate(rig, turn, save=saves, integrator=step, verify=False)
    figure = float(run.invariants.figures[Check.WEAR_AT_SAVES].worst[0])
    assert figure == pytest.approx(cells, rel=0.2)
    said = any("whose steps are counted wears at these" in sentence for sentence in run.warnings)
    assert said == (cells > 1)


def test_runs_that_wear_whenever_a_contact_has_moved_have_no_such_figure():
    run = worn_over(0.03, journal=False)
    assert Check.WEAR_AT_SAVES not in run.invariants.figures
