"""Derivatives of rigid contact in steps are those of the motion through impacts: beside closed
cases, and beside motions that go from impact to impact by hand.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import jaxclear as jc

CLEARANCE, BEARING = 1e-3, 10e-3
JOINT = lambda rig: rig.connections["B"].joint
# What varies, by name.
PLACES = {
    "clearance": lambda rig: JOINT(rig).clearance,
    "x": lambda rig: rig.start["journal"][0],
    "y": lambda rig: rig.start["journal"][1],
    "vx": lambda rig: rig.speeds["journal"][0],
    "vy": lambda rig: rig.speeds["journal"][1],
    "spin": lambda rig: rig.speeds["journal"][2],
    "restitution": lambda rig: JOINT(rig).contact.restitution,
    "mu": lambda rig: JOINT(rig).friction.mu_kinetic,
}

# Of a run; speeds count over 5 ms.
RESPONSES = "right", "up", "speed"


def journal(restitution, mu=None, start=(1e-4, 2e-4), speeds=(0.05, -0.2, 0.0), gravity=None):
    friction = None if mu is None else jc.friction.Coulomb(mu_kinetic=mu)
    law = jc.contact.Rigid(restitution=restitution)
    bearing = jc.clearance.PlanarJournalBearing(
        law, friction, clearance=CLEARANCE, bearing_radius=BEARING
    )
    return jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {} if gravity is None else {"gravity": jc.load.Gravity((0.0, -gravity))},
        start={"journal": (*start, 0.0)},
        speeds={"journal": speeds},
    )


def problem(rig, body, names, places=PLACES):
    read = (
        lambda run: run.body(body).com[-1, 0],
        lambda run: run.body(body).com[-1, 1],
        lambda run: 5e-3 * run.body(body).velocity[-1, 0],
    )
    return jc.Problem(
        rig,
        dict(zip(RESPONSES, read, strict=True)),
        {name: jc.Variable(places[name], tolerance=1e-9) for name in names},
        duration=0.01,
        integrator=jc.integrator.MoreauJean(1e-6),
        save=2,
        state=jc.State(concentric=False),
    )


def slopes_of(asked):
    """(answers, their derivatives) as a function of values, end [s] and step [s]."""

    @jax.jit
    def both(values, end, step):
        own = eqx.tree_at(lambda p: (p.duration, p.integrator.step), asked, (end, step))

        def answer(v):
            responses = own.evaluate(v).responses
            return jnp.stack([responses[name] for name in RESPONSES])

        return answer(values), jax.jacfwd(answer)(values)

    return both


def differences(motion, values):
    steps = np.diag(1e-6 * np.maximum(abs(values), 1e-3))
    ways = [(motion(values + d) - motion(values - d)) / (2 * d.sum()) for d in steps]
    return np.stack(ways, -1)


def errors(found, wanted):
    """Of the derivative by each number, beside its own size, of responses for which it is known.
    Each by itself is right to a fiftieth, or nan."""
    known = ~np.isnan(found)
    assert (abs(found - wanted)[known] <= 0.02 * abs(wanted)[known] + 1e-12).all()
    off = np.where(known.any(axis=0), np.where(known, found - wanted, 0.0), np.nan)
    return np.linalg.norm(off, axis=0) / np.linalg.norm(wanted, axis=0)


def test_a_bounce_has_the_derivatives_of_its_closed_form():
    """y = -2 c - y0 - v0 T without loss: (-2, -1, -T) (../refdata/diff_contact_gradients, one
    bounce)."""
    end = 0.012
    rig = journal(1.0, start=(0.0, 2e-4), speeds=(0.0, -0.2, 0.0))
    asked = problem(rig, "journal", ("clearance", "y", "vy"))
    asked = eqx.tree_at(lambda own: own.duration, asked, end)
    height = lambda v: asked.evaluate(v).responses["up"]
    slope = jax.jit(lambda way: jax.jvp(height, (asked.nominal(),), (way,))[1])
    np.testing.assert_allclose(list(map(slope, jnp.eye(3))), (-2.0, -1.0, -end), rtol=1e-9)


def two_balls(gap, radius, force):
    """One is a ring, the other a journal in it: it closes the gap upwards."""
    ring = jc.clearance.PlanarJournalBearing(
        jc.contact.Rigid(restitution=1.0), clearance=gap, bearing_radius=radius
    )
    upwards = lambda name: jc.Marker(name, axis="y")
    return jc.Mechanism(
        {"ball": jc.Body(1.0, 1.0), "ring": jc.Body(1.0, 1.0)},
        {
            "B": jc.Connection(ring, "ring", "ball"),
            "G": jc.Connection(jc.joint.Prismatic(), upwards("ground"), upwards("ring")),
        },
        {"push": jc.load.Force(jc.Marker("ball"), (0.0, force))},
        start={"ball": (0.0, 0.0, 0.0), "G": 0.0},
        speeds={"ball": (0.0, 0.0, 0.0), "G": 0.0},
    )


@pytest.mark.slow(sample=False)
def test_a_driven_ball_that_strikes_another_has_the_derivatives_of_its_closed_form():
    """Loss x2(T)^2 by both places and speeds, and how the struck ball moves on
    (../refdata/diff_contact_gradients, driven two balls): 1e-3 in steps of 0.1 ms."""
    second, force = -1.4142135623730951, 3 * np.sqrt(2)
    places = {
        "first": lambda rig: rig.start["ball"][1],
        "second": lambda rig: rig.start["G"],
        "speed of the first": lambda rig: rig.speeds["ball"][1],
        "speed of the second": lambda rig: rig.speeds["G"],
    }
    rig = two_balls(-second - 0.4, 5.0, force)
    asked = problem(rig, "ring", tuple(places), places)
    answer, found = slopes_of(asked)(asked.nominal(), 1.0, 1e-4)
    last = second + float(answer[1])
    assert last == pytest.approx(-0.50906146, rel=1e-3)
    # There speeds count along axes at 45 degrees.
    wanted = (-0.5638024, -0.4543205, -0.49779078 * 2**0.5, -0.22213092 * 2**0.5)
    np.testing.assert_allclose(2 * last * np.asarray(found[1]), wanted, rtol=1e-3)


def bounced(values, end):
    """(right, up, speed) of a journal without weight, and how many impacts it had; every impact
    by Newton's law and a percussion within Coulomb's cone."""
    c, x, y, vx, vy, spin, restitution, mu = values
    place, speed, time, count = np.array([x, y]), np.array([vx, vy]), 0.0, 0
    arm = BEARING - c
    while True:
        a, b = speed @ speed, place @ speed
        flight = -2 * b / a
        if count == 0:
            flight = (-b + np.sqrt(b * b - a * (place @ place - c * c))) / a
        if time + flight > end:
            place = place + (end - time) * speed
            return np.array([*place, 5e-3 * speed[0]]), count
        place, time, count = place + flight * speed, time + flight, count + 1
        normal = place / c
        across = np.array([-normal[1], normal[0]])
        push = (1 + restitution) * (normal @ speed)
        most = abs(across @ speed + arm * spin) / (1 + arm * arm / 1e-4)
        rub = -np.sign(across @ speed + arm * spin) * min(mu * push, most)
        speed = speed - push * normal + rub * across
        spin = spin + arm * rub / 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(("spin", "end", "count"), [(30.0, 0.03, 4), (0.5, 0.045, 3)])
def test_a_journal_that_strikes_sliding_and_sticking_has_the_derivatives_of_its_motion(
    spin, end, count
):
    """By all its numbers; measured 5e-4 in steps of 1 us."""
    asked = problem(journal(0.8, 0.2, speeds=(0.05, -0.2, spin)), "journal", tuple(PLACES))
    values, both = np.asarray(asked.nominal()), slopes_of(asked)
    assert bounced(values, end)[1] == count
    wanted = differences(lambda v: bounced(v, end)[0], values)
    acts = np.linalg.norm(wanted, axis=0) > 0
    for step, within in ((1e-6, 1e-3), (2e-7, 2e-4)):
        found = np.asarray(both(values, end, step)[1])
        off = errors(found[:, acts], wanted[:, acts])
        # What does not move the first impacts may be refused.
        assert np.nanmax(off) < within and np.isnan(off).sum() <= 1
        np.testing.assert_allclose(found[:, ~acts], 0.0, atol=1e-12)


@pytest.mark.slow(sample=False)
def test_through_six_bounces_a_derivative_is_right_to_a_hundredth():
    """Or nan, where the steps do not determine it."""
    names = ("clearance", "x", "y", "vx", "vy")
    asked = problem(journal(0.8), "journal", names)
    both, rest = slopes_of(asked), np.array([0.0, 0.8, 0.0])
    end, step = 0.1, 2e-7
    values = np.asarray(asked.nominal())
    motion = lambda v: bounced([*v, *rest], end)
    assert motion(values)[1] == 6
    found = np.asarray(both(values, end, step)[1])
    assert errors(found, differences(lambda v: motion(v)[0], values)).max() < 1e-2
    assert np.isnan(both(values, end, 1e-4)[1]).all()


def settled(values, end):
    """(right, up, speed) of a journal that is dropped and comes to rest on its wall by ever smaller
    bounces, then swings along it as a pendulum; how many bounces above 2 um/s."""
    c, x, restitution = values
    g, place, speed, time, count = 9.81, np.array([x, 0.0]), np.zeros(2), 0.0, 0
    fallen = lambda t: place + t * speed - np.array([0.0, 0.5 * g * t * t])
    while True:
        low, high = 0.0, 1e-4
        if count:
            normal = place / np.linalg.norm(place)
            across = speed @ speed - (normal @ speed) ** 2
            back = -2 * (normal @ speed) / (-g * normal[1] + across / c)
            low, high = 0.2 * back, 0.25 * back
        while np.linalg.norm(fallen(high)) < c:
            high *= 1.05
        flight = brentq(lambda t: c - np.linalg.norm(fallen(t)), low, high, xtol=1e-16, rtol=1e-14)
        if time + flight > end:
            return np.array([*fallen(end - time), 5e-3 * speed[0]]), count
        place, time, count = fallen(flight), time + flight, count + 1
        normal = place / c
        speed = speed - np.array([0.0, g * flight])
        closing = normal @ speed
        speed = speed - (1 + restitution) * closing * normal
        if restitution * closing < 2e-6:
            break
    swing = lambda t, y: (y[1], -g / c * np.sin(y[0]))
    angle = np.arctan2(place[0], -place[1])
    begun = angle, speed @ (np.cos(angle), np.sin(angle)) / c
    how = {"rtol": 1e-12, "atol": 1e-13}
    angle, turning = solve_ivp(swing, (time, end), begun, **how).y[:, -1]
    return np.array(
        [c * np.sin(angle), -c * np.cos(angle), 5e-3 * c * turning * np.cos(angle)]
    ), count


@pytest.mark.slow(sample=False)
def test_a_journal_that_comes_to_rest_on_its_wall_has_the_derivatives_of_its_motion():
    """By all its bounces, and while it swings on the wall: 1.5e-3 in steps of 1 us, a fifth of
    that in steps of 0.2 us. By the restitution, which moves the last and smallest ones most, it may
    be refused."""
    names = ("clearance", "x", "restitution")
    rig = journal(0.5, start=(1e-4, 0.0), speeds=(0.0, 0.0, 0.0), gravity=9.81)
    asked = problem(rig, "journal", names)
    values, both = np.asarray(asked.nominal()), slopes_of(asked)
    for end, count in ((0.04, 4), (0.1, 17)):
        assert settled(values, end)[1] == count
        wanted = differences(lambda v, end=end: settled(v, end)[0], values)
        for step, within in ((1e-6, 2e-3), (2e-7, 4e-4)):
            off = errors(np.asarray(both(values, end, step)[1]), wanted)
            assert off[:2].max() < within and not off[2] >= within


RODS = {
    "clearance": lambda rig: JOINT(rig).clearance,
    "slider": lambda rig: rig.bodies["slider"].mass,
}


def cranked(values, end):
    """(right, up, speed) of the slider of `scenes.slider_crank` from impact to impact."""
    c, mass = values
    crank, rod, rod_mass, turning, restitution, g = 0.05, 0.12, 0.21, 50.0, 0.9, 9.81
    inertia = 2.5e-4 + rod_mass * (0.5 * rod) ** 2

    def offset(t, y):
        """Of the journal from its bearing, and its rate."""
        (a, x, da, dx), b = y, turning * t
        place = x - crank * np.cos(b) - rod * np.cos(a), -crank * np.sin(b) - rod * np.sin(a)
        rate = (
            dx + crank * turning * np.sin(b) + rod * da * np.sin(a),
            -crank * turning * np.cos(b) - rod * da * np.cos(a),
        )
        return np.array(place), np.array(rate)

    def rates(t, y):
        pull = -crank * turning**2 * np.array([np.cos(turning * t), np.sin(turning * t)])
        turn = np.array([-np.sin(y[0]), np.cos(y[0])]) @ (pull + np.array([0.0, g]))
        return y[2], y[3], -rod_mass * 0.5 * rod * turn / inertia, 0.0

    gap = lambda t, y: c - np.linalg.norm(offset(t, y)[0])
    gap.terminal, gap.direction = True, -1
    y, time, count = np.array([0.0, crank + rod, -turning * crank / rod, 0.0]), 0.0, 0
    how = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14, "events": gap, "max_step": 5e-5}
    while True:
        found = solve_ivp(rates, (time, end), y, **how)
        time, y = found.t[-1], found.y[:, -1].copy()
        if found.status != 1:
            return np.array([y[1], 0.0, 5e-3 * y[3]]), count
        place, rate = offset(time, y)
        normal, count = place / np.linalg.norm(place), count + 1
        row = np.array([rod * (np.sin(y[0]) * normal[0] - np.cos(y[0]) * normal[1]), normal[0]])
        light = row / (inertia, mass)
        y[2:] -= (1 + restitution) * (normal @ rate) / (row @ light) * light


@pytest.mark.slow(sample=False)
def test_a_slider_crank_has_the_derivatives_of_its_motion():
    """Through one, two and four impacts; after thirteen of them steps of 0.2 us do not tell."""
    law = jc.contact.Rigid(restitution=0.9)
    rig = jc.scenes.slider_crank(clearance=2e-4, friction=None, contact=law)
    asked = problem(rig, "slider", tuple(RODS), RODS)
    asked = eqx.tree_at(lambda p: p.state, asked, jc.State())
    values, both = np.asarray(asked.nominal()), slopes_of(asked)
    for end, count in ((0.002, 1), (0.004, 2), (0.007, 4)):
        assert cranked(values, end)[1] == count
        wanted = differences(lambda v, end=end: cranked(v, end)[0], values)
        found = np.asarray(both(values, end, 2e-7)[1])
        assert errors(found, wanted).max() < 1e-2
    assert np.isnan(both(values, 0.013, 2e-7)[1][0]).all()


def test_what_is_not_known_of_impacts_is_refused_with_a_sentence():
    worn = jc.scenes.slider_crank(contact=jc.contact.Rigid(restitution=0.5), wear=True)
    asked = problem(worn, "slider", tuple(RODS), RODS)
    asked = eqx.tree_at(lambda p: p.state, asked, jc.State())
    height = lambda v: asked.evaluate(v).responses["right"]
    with pytest.raises(ValueError, match="does not know how surfaces that wear move with impacts"):
        jax.eval_shape(jax.jacfwd(height), asked.nominal())
