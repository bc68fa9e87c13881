"""A fast slider-crank with a loose joint against itself written by hand: two coordinates, flights
and contacts by turns, each solved for itself by scipy up to the event that ends it.

5000 rpm, rod on slider with half a millimetre of clearance: the journal crosses it within 0.1 ms
and strikes at 0.8 to 4.4 m/s, eighteen times in the half turn that is compared. Impacts part
neighbouring paths by a factor of some thousand in that time."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxclear as jc

CRANK, ROD, ROD_MASS, ROD_INERTIA, SLIDER = 0.05, 0.12, 0.21, 2.5e-4, 0.14
SPEED, CLEARANCE, RADIUS, MU, RESTITUTION = 5000 * math.pi / 30, 0.5e-3, 10e-3, 0.03, 0.9
STIFFNESS, INNER, OUTER = 4e10, 1e-4, 1e-3
INERTIA = ROD_INERTIA + ROD_MASS * (ROD / 2) ** 2
TURN = 2 * math.pi / SPEED
TIMES = np.linspace(0.0, TURN / 2, 61)


def forces(time, y, impact_speed):
    """(accelerations of rod and slider, indentation, its rate); impact_speed None: in flight."""
    angle, place, turning, sliding = y
    c, s, cr, sr = (f(a) for a in (SPEED * time, angle) for f in (math.cos, math.sin))
    # Offset of the slider's pin from the end of the rod, and its rate.
    ex, ey = place - CRANK * c - ROD * cr, -CRANK * s - ROD * sr
    vx = sliding + CRANK * SPEED * s + ROD * turning * sr
    vy = -CRANK * SPEED * c - ROD * turning * cr
    # Product of mass, half length and the crank pin's acceleration.
    moment = ROD_MASS * ROD / 2 * CRANK * SPEED**2 * (s * cr - c * sr)
    size = math.hypot(ex, ey)
    nx, ny = (ex / size, ey / size) if size > 0 else (0.0, 0.0)
    depth, rate = size - CLEARANCE, nx * vx + ny * vy
    push = 0.0
    if impact_speed is not None and depth > 0:
        loss = 1 + 0.75 * (1 - RESTITUTION**2) * rate / impact_speed
        normal = STIFFNESS * depth**1.5 * max(loss, 0.0)
        reach = RADIUS + depth / 2
        slip = nx * vy - ny * vx - turning * reach
        share = min(max((abs(slip) - INNER) / (OUTER - INNER), 0.0), 1.0)
        drag = -math.copysign(MU * share, slip) * normal
        push, side = -normal * nx - drag * ny, -normal * ny + drag * nx
        moment -= ROD * (cr * side - sr * push) + reach * drag
    return moment / INERTIA, push / SLIDER, depth, rate


def by_hand(rtol):
    """The slider's place [m] at TIMES, and the speeds [m/s] and instants [s] of all impacts."""
    time, y = 0.0, np.array([0.0, CRANK + ROD, -CRANK * SPEED / ROD, 0.0])
    impact_speed, places, speeds, instants = None, np.full(len(TIMES), CRANK + ROD), [], []
    while time < TIMES[-1]:

        def slope(t, y, speed=impact_speed):
            return [y[2], y[3], *forces(t, y, speed)[:2]]

        def event(t, y, speed=impact_speed):
            return forces(t, y, speed)[2]

        event.terminal, event.direction = True, 1.0 if impact_speed is None else -1.0
        found = solve_ivp(
            slope,
            (time, TIMES[-1]),
            y,
            "DOP853",
            dense_output=True,
            events=event,
            rtol=rtol,
            atol=1e-2 * rtol,
            # Flights are smooth and long; none of them may jump over a contact.
            max_step=5e-6,
            first_step=min(1e-9, TIMES[-1] - time),
        )
        inside = (time < TIMES) & (found.t[-1] >= TIMES)
        if inside.any():
            places[inside] = found.sol(TIMES[inside])[1]
        time, y = found.t[-1], found.y[:, -1]
        if found.status == 1 and impact_speed is None:
            impact_speed = forces(time, y, None)[3]
            speeds.append(impact_speed)
            instants.append(time)
        else:
            impact_speed = None
    return places, speeds, instants


@pytest.fixture(scope="module")
def hand():
    return by_hand(1e-11)


@pytest.fixture(scope="module")
def rig():
    contact = jc.contact.LankaraniNikravesh(stiffness=STIFFNESS, restitution=RESTITUTION)
    bearing = jc.clearance.PlanarJournalBearing(
        contact,
        jc.friction.Ambrosio(mu_kinetic=MU, inner_speed=INNER, outer_speed=OUTER),
        bearing_radius=RADIUS,
        clearance=CLEARANCE,
    )
    return jc.scenes.slider_crank(bearing, crank_speed=SPEED, gravity=None)


def error(rig, hand, integrator):
    """Largest distance [m] of the slider from the hand-written solution up to each time."""
    run = jc.simulate(rig, TIMES[-1], save=TIMES, integrator=integrator)
    return np.maximum.accumulate(np.abs(np.asarray(run.coordinate("G")) - hand[0]))


def test_the_case_strikes_often_and_hard(hand):
    assert len(hand[1]) == 18 and max(hand[1]) > 4 and min(hand[1]) < 1


@pytest.mark.slow
def test_adaptive_runs_agree_with_the_events_by_hand(rig, hand):
    """A micrometre is a thousandth of the bearing's play; at its default tolerance the run keeps it
    through all impacts, because its steps end where contacts close and part."""
    errors = {
        rtol: error(rig, hand, jc.integrator.Adaptive(rtol=rtol, atol=1e-2 * rtol))
        for rtol in (1e-7, 1e-9, 1e-11)
    }
    assert errors[1e-7].max() < 1e-6
    # Tighter ones leave less, by chance not always in proportion.
    assert errors[1e-9].max() < 1e-7
    assert errors[1e-11].max() < 1e-9


@pytest.mark.parametrize(
    "integrator",
    [jc.integrator.FixedStep(1e-7), jc.integrator.ImplicitStep(1e-7, rebound=1.0)],
    ids=["explicit", "implicit"],
)
def test_fixed_steps_agree_with_the_events_by_hand(rig, hand, integrator):
    assert error(rig, hand, integrator).max() < 1e-6


def test_touches_are_noted_when_and_as_they_happen(rig, hand):
    """At two saving times alone. Within 1 us, at speeds near 1 m/s the micrometre of the paths."""
    precise = jc.integrator.Adaptive(rtol=1e-9, atol=1e-11)
    table = jc.simulate(rig, TIMES[-1], save=jc.Saving(2, 40), integrator=precise).events()
    touches = table[table["event"] == "touch"]
    np.testing.assert_allclose(touches["time [s]"], hand[2], atol=1e-6)
    np.testing.assert_allclose(touches["speed [m/s]"], hand[1], atol=1e-3)
